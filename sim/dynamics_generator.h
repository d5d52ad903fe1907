/* Writes C for the dynamics of one robot (sim/dynamics.h says of what): straight-line code, symbols
 * simplified and common subexpressions shared. The text depends on the robot alone. It ends in a table of its
 * functions, NULL for those that would be too long for a compiler. */
#ifndef TELEDIMOS_SIM_DYNAMICS_GENERATOR_H
#define TELEDIMOS_SIM_DYNAMICS_GENERATOR_H

#include <stddef.h>

#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_generated {
    char *code; /* C17, one file, needing <math.h> alone */
    size_t size;
    /* Additions, multiplications and divisions of each function, sines and cosines apart; 0: too long. */
    size_t inverse_flops, inverse_no_coriolis_flops, forward_flops, mass_flops;
} td_generated;

/* `prefix`: that of the functions' names. Refuses what td_dynamics_new refuses. */
TD_API td_status td_dynamics_generate(td_generated *generated, const td_robot *robot, const char *prefix,
                                      td_error *error);
TD_API void td_generated_free(td_generated *generated);

#ifdef __cplusplus
}
#endif
#endif
