/* Camera models: a point in the camera's frame to a pixel and back, with the derivatives of both.
 *
 * Camera frame: x right, y down, z forward. Pixel (0, 0) is the centre of the first pixel. Parameters, in
 * order: pinhole   fx fy cx cy brown5    fx fy cx cy k1 k2 p1 p2 k3             (Brown 1966; OpenCV's and ROS
 * "plumb_bob") brown8    fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6    (OpenCV's rational model, ROS
 * "rational_polynomial") fisheye   fx fy cx cy k1 k2 k3 k4                (Kannala and Brandt 2006; OpenCV's
 * fisheye, Kalibr "equi") The first four are the intrinsics (px), the others the distortion. */
#ifndef TELEDIMOS_CORE_CAMERA_H
#define TELEDIMOS_CORE_CAMERA_H

#include <stdbool.h>
#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_camera_model {
    TD_CAMERA_PINHOLE,
    TD_CAMERA_BROWN5,
    TD_CAMERA_BROWN8,
    TD_CAMERA_FISHEYE,
    TD_CAMERA_MODEL_COUNT
} td_camera_model;

enum { TD_CAMERA_MAX_PARAMETERS = 12 };

typedef struct td_camera {
    td_camera_model model;
    int width, height;                          /* px */
    double parameter[TD_CAMERA_MAX_PARAMETERS]; /* see above; unused ones are 0 */
} td_camera;

/* "pinhole", "brown5", …; NULL for a number that is no model. */
TD_API const char *td_camera_model_name(td_camera_model model);
/* TD_CAMERA_MODEL_COUNT if there is no such name. */
TD_API td_camera_model td_camera_model_from_name(const char *name);
/* Number of parameters: 4, 9, 12, 8. */
TD_API int td_camera_parameter_count(td_camera_model model);
/* "fx", "fy", …, "k4"; NULL out of range. */
TD_API const char *td_camera_parameter_name(td_camera_model model, int index);

/* Refuses sizes, focal lengths and numbers that no camera has, naming the field. */
TD_API td_status td_camera_check(const td_camera *camera, td_error *error);

/* Projects the point `p` (camera frame, m). Outputs: pixel (2) px; d_point (2,3) and d_parameter (2,count),
 * row-major, each may be NULL. Returns false, outputs untouched, where the model has no image of the point:
 * behind the camera (pinhole, Brown: z <= 0; fisheye: at the centre or straight behind). Brown models are
 * used as they stand outside the image too, where they may fold; td_camera_unproject tells. */
TD_API bool td_camera_project(double pixel[2], double *d_point, double *d_parameter, const td_camera *camera,
                              const double p[3]);

/* The unit direction `ray` (3) whose projection is `pixel` (px). Outputs d_pixel (3,2) and d_parameter
 * (3,count), row-major, each may be NULL. Newton's method with the analytic Jacobian; derivatives by the
 * implicit function theorem. Returns false, outputs untouched, when no ray is found that projects within 1e-9
 * px of the pixel on the near side of the model's fold. */
TD_API bool td_camera_unproject(double ray[3], double *d_pixel, double *d_parameter, const td_camera *camera,
                                const double pixel[2]);

/* K, row-major 3x3. */
TD_API void td_camera_matrix(double k[9], const td_camera *camera);

#ifdef __cplusplus
}
#endif
#endif
