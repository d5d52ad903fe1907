/* A robot as a tree of links and joints, from URDF, and what URDF cannot say from a YAML file beside it.
 *
 * A link's frame is its joint's frame after the joint's motion. Joint k moves child against parent:
 * parent_from_child(q) = origin_k Motion(axis_k, q_k): a turn (revolute, continuous) or a shift (prismatic).
 * The state of a robot is the vector q of its moving joints, in the order of `joint` (rad or m).
 *
 * The YAML beside x.urdf is x.yaml; all but its first line may be missing:
 *
 *   teledimos: robot 1
 *   joints:
 *     - {name: boom, acceleration_rad_s2: 0.7}                       (prismatic: acceleration_m_s2)
 *   cylinders:
 *     - name: boom
 *       joint: boom                                                  (revolute)
 *       count: 2                                                     (1 when missing)
 *       bore_m: 0.12
 *       rod_m: 0.085
 *       root_m: [0.69, -0.04, 0.234]
 *       eye_m: [2.2342, 0.0, 0.9507]                                 (or a four_bar:)
 *       four_bar: {parent_pivot_m: [x, y, z], child_pivot_m: [x, y, z], parent_bar_m: 0.579,
 *                  child_bar_m: 0.561, branch: -1}
 *       shortest_m: 1.825
 *       longest_m: 3.084
 *       pressure_pa: 34.3e6                                          (unlimited when missing)
 *       flow_m3_s: 7.07e-3                                           (unlimited when missing)
 *   suspension:                                                      (rigid where missing)
 *     heave: {stiffness_n_m: 1.3e7, damping_ns_m: 1.5e5}
 *     pitch: {stiffness_nm_rad: 3.7e7, damping_nms_rad: 4.3e5}
 *     roll: {stiffness_nm_rad: 1.6e7, damping_nms_rad: 1.8e5} */
#ifndef TELEDIMOS_CORE_ROBOT_H
#define TELEDIMOS_CORE_ROBOT_H

#include <stdbool.h>
#include <stddef.h>

#include "pose.h"
#include "rig.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    TD_ROBOT_MAX_JOINTS = 64,
    TD_ROBOT_MAX_LINKS = 256,
    TD_ROBOT_MAX_SHAPES = 8,
    TD_ROBOT_MAX_CYLINDERS = 8
};

typedef enum td_joint_kind {
    TD_JOINT_FIXED,
    TD_JOINT_REVOLUTE,
    TD_JOINT_CONTINUOUS,
    TD_JOINT_PRISMATIC
} td_joint_kind;

/* Collision shapes: boxes, spheres, cylinders of URDF. A cylinder is taken as the capsule that holds it: its
 * ends are rounded outwards. Meshes are left out, and counted. */
typedef enum td_primitive_kind {
    TD_PRIMITIVE_BOX,
    TD_PRIMITIVE_CAPSULE,
    TD_PRIMITIVE_SPHERE
} td_primitive_kind;
typedef struct td_primitive {
    td_primitive_kind kind;
    td_pose link_from_shape; /* capsule: along z */
    double size[3];          /* m: box: full lengths; capsule: radius, length between the centres of its ends;
                                sphere: radius */
} td_primitive;

typedef struct td_robot_link {
    char name[TD_NAME_SIZE];
    int parent;               /* link; -1: the root */
    int joint;                /* that moves it against its parent; -1: fixed to it, or the root */
    td_pose parent_from_link; /* at q = 0 */
    double mass_kg, com_m[3],
        inertia[9]; /* in the link's frame about its centre of mass, row-major; 0: not given */
    int shape_count;
    td_primitive shape[TD_ROBOT_MAX_SHAPES];
    int mesh_count; /* collision meshes, which are left out */
} td_robot_link;

typedef struct td_robot_joint {
    char name[TD_NAME_SIZE];
    td_joint_kind kind;
    int link;            /* its child */
    double axis[3];      /* unit vector in the child's frame */
    double lower, upper; /* rad or m; -INFINITY, INFINITY */
    double speed;        /* rad/s or m/s; INFINITY */
    double acceleration; /* rad/s^2 or m/s^2, from the YAML; INFINITY */
    double effort;       /* N m or N; INFINITY */
} td_robot_joint;

/* A hydraulic cylinder that drives a joint. Directly: its root is fixed to the joint's parent link, its rod
 * eye to the child. Through a four-bar (the bucket): the eye is the joint of two bars, one from a pivot on
 * the parent, one from a pivot on the child. All points in the plane across the joint's axis. */
typedef struct td_cylinder {
    char name[TD_NAME_SIZE];
    int joint;
    int count;            /* cylinders side by side */
    double bore_m, rod_m; /* diameters */
    double root[3];       /* in the parent link's frame, m */
    bool four_bar;
    double eye[3];                          /* directly: in the child link's frame */
    double parent_pivot[3], child_pivot[3]; /* four-bar: in the parent's and the child's frame */
    double parent_bar_m, child_bar_m;       /* from each pivot to the rod eye */
    int branch; /* four-bar: on which side of the line between the pivots the eye is: 1, -1 */
    double shortest_m, longest_m;
    double pressure_pa, flow_m3_s; /* limits; INFINITY. The flow is that to all `count` together */
} td_cylinder;

typedef struct td_robot {
    char name[TD_NAME_SIZE];
    int link_count, joint_count, cylinder_count;
    td_robot_link link[TD_ROBOT_MAX_LINKS];    /* parents before children */
    td_robot_joint joint[TD_ROBOT_MAX_JOINTS]; /* the moving ones, parents before children */
    td_cylinder cylinder[TD_ROBOT_MAX_CYLINDERS];
    /* Heave (N/m, N s/m), pitch and roll (N m/rad, N m s/rad): stiffness and damping; 0: rigid. */
    double suspension_n_m[3], suspension_ns_m[3];
} td_robot;

/* From a URDF file (through urdfdom), and the YAML of the same name beside it when there is one. Refused,
 * naming it: no XML, two roots, loops, a missing link, limits the wrong way round, an axis of no length,
 * joints that mimic, float or slide in a plane, numbers that are none, more links, joints or depth than fit.
 * A cylinder is refused unless, over its joint's whole range, its bars close, it passes no dead centre and
 * its stroke suffices: so length and angle are each other's inverse there. td_robot_parse takes the texts
 * themselves (yaml may be NULL); `name` is for messages. */
TD_API td_status td_robot_read(td_robot **robot, const char *path, td_error *error);
TD_API td_status td_robot_parse(td_robot **robot, const char *urdf, size_t urdf_size, const char *yaml,
                                size_t yaml_size, const char *name, td_error *error);
TD_API void td_robot_free(td_robot **robot);
TD_API int td_robot_find_link(const td_robot *robot, const char *name);  /* -1: none */
TD_API int td_robot_find_joint(const td_robot *robot, const char *name); /* -1: none */

/* root_from_link of every link (link_count). */
TD_API void td_robot_forward(td_pose *root_from_link, const td_robot *robot, const double *q);
/* Geometric Jacobian (6, joint_count), row-major, of a link's pose in the root's frame: the left perturbation
 * (pose.h) of root_from_link by each q; columns of joints that do not move it are 0. Its last three rows are
 * thus the velocity of the link's point that is at the root's origin; that of a point p is tau + omega x p.
 */
TD_API void td_robot_jacobian(double *jacobian, const td_robot *robot, const td_pose *root_from_link,
                              int link);
/* Derivative (6,6) of root_from_link's left perturbation by a left perturbation of the fixed transform
 * parent_from_link of link `moved`; zero when `link` does not hang on it. */
TD_API void td_robot_link_derivative(double *derivative, const td_robot *robot, const td_pose *root_from_link,
                                     int link, int moved);
/* False, and the first joint out of its limits in *joint (may be NULL). */
TD_API bool td_robot_within_limits(const td_robot *robot, const double *q, int *joint);

/* Length of a cylinder at a joint angle, and the angle at a length (within the joint's limits); lever = d
 * length / d angle, m. False outside the reach of the bars. */
TD_API bool td_cylinder_length(double *length_m, double *lever_m, const td_robot *robot,
                               const td_cylinder *cylinder, double angle);
TD_API bool td_cylinder_angle(double *angle, const td_robot *robot, const td_cylinder *cylinder,
                              double length_m);
/* Area that oil fills, m^2, of all `count` together: the bore's while they grow, the annulus' else. */
TD_API double td_cylinder_area(const td_cylinder *cylinder, bool grows);
/* Oil taken, m^3/s, by all `count` together while the joint at `angle` turns at `rate`; its sign is that of
 * the piston's speed (positive: outwards). False outside the reach of the bars. */
TD_API bool td_cylinder_flow(double *flow_m3_s, const td_robot *robot, const td_cylinder *cylinder,
                             double angle, double rate);
/* What all the pumps give where nothing else is known, m^3/s: the largest of the cylinders' limits;
 * INFINITY without cylinders. */
TD_API double td_robot_pump(const td_robot *robot);

#ifdef __cplusplus
}
#endif
#endif
