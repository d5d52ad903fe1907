/* What the rooms of a robot share: a URDF as flat records, and the checks of what was read. */
#ifndef TELEDIMOS_CORE_ROBOT_INTERNAL_H
#define TELEDIMOS_CORE_ROBOT_INTERNAL_H

#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_URDF_NAME = 128, TD_URDF_MESSAGE = 512, TD_URDF_SIZE = 16 << 20, TD_URDF_DEPTH = 32 };

typedef struct td_urdf_link {
    char name[TD_URDF_NAME];
    bool has_inertial;
    td_pose link_from_inertial;
    double mass_kg, inertia[6]; /* xx xy xz yy yz zz, in the inertial frame */
    int shape_count, mesh_count;
    td_primitive shape[TD_ROBOT_MAX_SHAPES];
} td_urdf_link;

typedef struct td_urdf_joint {
    char name[TD_URDF_NAME], parent[TD_URDF_NAME], child[TD_URDF_NAME];
    td_joint_kind kind;
    td_pose parent_from_child;
    double axis[3];
    bool has_limit, has_mimic;
    double lower, upper, effort, speed;
} td_urdf_joint;

/* A model as urdfdom gives it: nothing judged yet. Names in the order of the file. */
typedef struct td_urdf {
    char name[TD_URDF_NAME];
    int link_count, joint_count;
    td_urdf_link link[TD_ROBOT_MAX_LINKS];
    td_urdf_joint joint[TD_ROBOT_MAX_LINKS];
} td_urdf;

/* What urdfdom complains of, begun empty; it holds words of the file. */
typedef struct td_urdf_why {
    char what[TD_URDF_MESSAGE], where[TD_URDF_MESSAGE];
} td_urdf_why;

/* The wall around urdfdom: fills the link_count links and joint_count joints whose names stand in `urdf`. */
bool td_urdfdom_parse(td_urdf *urdf, const char *text, size_t size, td_urdf_why *why);

/* A robot without what the YAML adds. `name` is the file's, for messages. */
td_status td_urdf_parse(td_robot *robot, const char *text, size_t size, const char *name, td_error *error);
/* Adds what the YAML beside it holds. */
td_status td_robot_parse_yaml(td_robot *robot, const char *text, size_t size, const char *name,
                              td_error *error);

/* What is wrong with a cylinder on this robot, in *why; false when nothing is. */
enum { TD_CYLINDER_WHY = 200 };
bool td_cylinder_is_wrong(char why[TD_CYLINDER_WHY], const td_robot *robot, const td_cylinder *cylinder);

#ifdef __cplusplus
}
#endif
#endif
