/* generate_dynamics ROBOT.urdf PREFIX OUT.c: writes the dynamics of a robot while the wing is built. */
#include <stdio.h>

#include "core/file.h"
#include "sim/dynamics_generator.h"

int main(int argc, char **argv)
{
    td_robot *robot = NULL;
    td_generated generated = {0};
    td_error error = {0};
    if (argc != 4) {
        fprintf(stderr, "usage: generate_dynamics ROBOT.urdf PREFIX OUT.c\n");
        return 2;
    }
    td_status status = td_robot_read(&robot, argv[1], &error);
    if (status == TD_OK) status = td_dynamics_generate(&generated, robot, argv[2], &error);
    if (status == TD_OK) status = td_file_write(argv[3], generated.code, generated.size, &error);
    if (status == TD_OK)
        fprintf(stderr, "%s: inverse %zu operations, without Coriolis %zu, forward %zu, mass matrix %zu\n",
                argv[3], generated.inverse_flops, generated.inverse_no_coriolis_flops,
                generated.forward_flops, generated.mass_flops);
    else
        fprintf(stderr, "generate_dynamics: %s\n", error.message);
    td_generated_free(&generated);
    td_robot_free(&robot);
    return status == TD_OK ? 0 : 1;
}
