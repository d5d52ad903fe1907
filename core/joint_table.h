/* Readings of a robot's joints in a table: a column a joint, its unit in the name: boom_rad, boom_deg, of one
 * that slides boom_m, boom_mm; or the length of the cylinder that drives it: boom_cylinder_m,
 * boom_cylinder_mm. */
#ifndef TELEDIMOS_CORE_JOINT_TABLE_H
#define TELEDIMOS_CORE_JOINT_TABLE_H

#include <stdbool.h>

#include "csv.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

/* *q is (rows, joints), rad or m, to be freed with free(). A joint without a column stands at 0, or at its
 * limit nearest to it; it is refused where needed[joint] (needed NULL: none is). *given (may be NULL): how
 * many joints have a column. Refused: two columns for one joint, lengths that a cylinder does not reach. */
TD_API td_status td_joint_table_read(double **q, int *given, const td_csv *csv, const td_robot *robot,
                                     const bool *needed, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
