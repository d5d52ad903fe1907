/* A URDF in Orocos KDL, for tests/core/test_robot.c. */
#ifndef TELEDIMOS_TESTS_CORE_ROBOT_KDL_H
#define TELEDIMOS_TESTS_CORE_ROBOT_KDL_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct kdl_robot kdl_robot;

kdl_robot *kdl_robot_read(const char *path); /* NULL: not read */
void kdl_robot_free(kdl_robot *robot);
int kdl_robot_joint_count(const kdl_robot *robot);
const char *kdl_robot_joint_name(const kdl_robot *robot, int index);
/* root_from_link, and KDL's Jacobian (6, joints), row-major: [velocity of the link's origin; angular
 * velocity], in the root's frame. q in KDL's order. 0: failed. */
int kdl_robot_solve(double rotation[9], double t[3], double *jacobian, const kdl_robot *robot,
                    const double *q, const char *link);

#ifdef __cplusplus
}
#endif
#endif
