/* Square tags: AprilTags of either border, found one by one, and targets made of them. */
#ifndef TELEDIMOS_CALIB_TAGS_H
#define TELEDIMOS_CALIB_TAGS_H

#include "../core/camera.h"
#include "../core/pose.h"
#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_tag {
    int id;
    int border;       /* cells: 1 or 2, as it was read */
    int wrong_bits;   /* corrected while decoding */
    double corner[8]; /* px: upper left, upper right, lower right, lower left as the tag is read */
    double sigma[4];  /* px, standard deviation of each coordinate of a corner; 0: not measured */
    double blur;      /* px, median over its corners */
} td_tag;

/* All tags of a dictionary in the grey image, whatever their border (`border` 0) or of the given one, in the
 * order of id, then place. The search, of three passes, ends when there are `enough` (0: all are wanted).
 * *tags is to be freed with free(). */
TD_API td_status td_tags_find(td_tag **tags, size_t *count, const td_image *image, const char *dictionary,
                              int border, size_t enough, td_error *error);

/* Pose of one tag from its corners by least squares over the camera's whole model, with covariance (6,6) of
 * the pose's perturbation (pose.h; may be NULL). Both minima of a flat target are tried; `ratio` (may be
 * NULL) is the other's RMS over the best's: near 1, the tag may be tilted the other way. False when the
 * corners have no pose. */
TD_API bool td_tag_pose(td_pose *camera_from_tag, double *covariance, double *ratio, const td_tag *tag,
                        double size_m, const td_camera *camera);

/* An aprilgrid or single tags: every tag of the target that is seen gives four points. Found with one tag;
 * remarks name tags of another border, dictionary or number. */
TD_API td_status td_tags_detect(td_detection *detection, const td_image *image, const td_target *target,
                                td_error *error);

#ifdef __cplusplus
}
#endif
#endif
