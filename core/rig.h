/* A rig: cameras fixed to one another, what is known of them, and how well.
 *
 * The rig frame is the first camera's. rig.yaml holds all of this, in this order:
 *
 *   teledimos: rig 1
 *   cameras:
 *     - name: left
 *       model: brown5
 *       width: 640
 *       height: 480
 *       intrinsics: {fx: 536.1, fy: 536.0, cx: 342.3, cy: 235.5}
 *       distortion: {k1: -0.265, k2: -0.047, p1: 0.0018, p2: -0.0003, k3: 0.252}    (none for a pinhole)
 *       camera_from_rig: {q: [1.0, 0.0, 0.0, 0.0], t_m: [0.0, 0.0, 0.0]}
 *   vehicle_from_rig: {q: [w, x, y, z], t_m: [x, y, z]}                             (when known)
 *   covariance:                                                                     (when known)
 *     order: [left.fx, left.fy, …, left.tz, right.fx, …]
 *     matrix:
 *       - [0.81, 0.79, …]
 *   provenance: whatever made the rig, a mapping                                    (when known) */
#ifndef TELEDIMOS_CORE_RIG_H
#define TELEDIMOS_CORE_RIG_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

#include "camera.h"
#include "pose.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_RIG_MAX_CAMERAS = 16, TD_NAME_SIZE = 64 };

typedef struct td_rig_camera {
    char name[TD_NAME_SIZE]; /* letters, digits, - and _ */
    td_camera camera;
    td_pose camera_from_rig; /* identity for the first */
} td_rig_camera;

typedef struct td_rig {
    int count;
    td_rig_camera camera[TD_RIG_MAX_CAMERAS];
    bool has_vehicle;
    td_pose vehicle_from_rig; /* when has_vehicle */
    /* Joint covariance of, camera by camera: its parameters (camera.h's order), then the perturbation of its
     * camera_from_rig (pose.h's left perturbation: 3 rad, 3 m; zero for the first camera). NULL: unknown. */
    double *covariance; /* (n,n), n = td_rig_parameter_count */
    json_t *provenance; /* a mapping of whatever made the rig; may be NULL */
} td_rig;

TD_API td_rig *td_rig_new(void);
TD_API td_rig *td_rig_copy(const td_rig *rig);
TD_API void td_rig_free(td_rig **rig);

/* Sum over the cameras of parameters + 6, and the row of the covariance where camera `index` begins. */
TD_API size_t td_rig_parameter_count(const td_rig *rig);
TD_API size_t td_rig_parameter_offset(const td_rig *rig, int index);
/* "left.fx", …, "right.rx", "right.ry", "right.rz", "right.tx", …: the covariance's order. */
TD_API char *td_rig_parameter_name(char text[TD_NAME_SIZE + 8], const td_rig *rig, size_t index);
/* Index of the camera of this name, -1 if none. */
TD_API int td_rig_find(const td_rig *rig, const char *name);
/* Names, cameras, unit quaternions (|q| = 1 within 1e-12), the first camera at the rig's origin, symmetric
 * covariance (to 1e-9 of the standard deviations) with no negative variance and nothing for the first
 * camera's pose; names the field. */
TD_API td_status td_rig_check(const td_rig *rig, td_error *error);

/* rig.yaml; numbers survive to the last bit. A rig that td_rig_check refuses is not written. */
TD_API td_status td_rig_read(td_rig **rig, const char *path, td_error *error);
TD_API td_status td_rig_write(const td_rig *rig, const char *path, td_error *error);
/* The same from and to memory; `name` is for messages; *text is to be freed with free(). */
TD_API td_status td_rig_parse(td_rig **rig, const char *text, size_t size, const char *name, td_error *error);
TD_API td_status td_rig_to_yaml(char **text, const td_rig *rig, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
