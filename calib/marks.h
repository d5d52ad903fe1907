/* Finds circular marks on planes, by the three steps of the paper (section 3.2): binarise and take centres of
 * gravity; fit the parameters of each mark's model; discard what does not lie on the planes. */
#ifndef TELEDIMOS_CALIB_MARKS_H
#define TELEDIMOS_CALIB_MARKS_H

#include "../core/camera.h"
#include "../core/pose.h"
#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A person's word on which mark is which: mark `index` of the target lies near `pixel`. */
typedef struct td_click {
    size_t index;
    double pixel[2]; /* px */
} td_click;

enum { TD_MAX_CLICKS = 9 };

/* A fitted mark: an ellipse with blurred edge. */
typedef struct td_mark {
    double centre[2];       /* of the ellipse, px */
    double shape[3];        /* a, b, c of a dx^2 + 2 b dx dy + c dy^2 = 1, px^-2 */
    double blur;            /* standard deviation of the edge's blur, with the pixel's own 0.29, px */
    double inside, outside; /* grey levels */
    double sigma;           /* standard deviation of each coordinate of the centre, px */
    double centroid[2];     /* step one's centre of gravity, px */
} td_mark;

/* Steps one and two: all round marks in the image, whatever they belong to. *marks is to be freed with
 * free(). */
TD_API td_status td_marks_find(td_mark **marks, size_t *count, const td_image *image,
                               td_mark_polarity polarity, td_error *error);

/* All three steps and the numbering. Without clicks the grid is found by itself: for a grid with symmetries,
 * point 0 is the one for which columns run to the right and rows down in the image (nearest to it). With
 * clicks (4 to 9 in all, no three on a line in one plane; several planes: at least 4 on each, or as many as 9
 * allow when target and camera leave no doubt) their numbering decides. */
TD_API td_status td_marks_detect(td_detection *detection, const td_image *image, const td_target *target,
                                 const td_click *click, size_t click_count, td_error *error);

/* The centre of the image of a disc is not the image of its centre. bias (2) px = centroid of the image of
 * the disc of the given diameter around `centre` (target frame, m), lying in the plane with unit `normal`,
 * minus the projection of `centre`; through the whole camera model, distortion included. False when some of
 * the disc has no image. */
TD_API bool td_mark_bias(double bias[2], const td_camera *camera, const td_pose *camera_from_target,
                         const double centre[3], const double normal[3], double diameter_m);

#ifdef __cplusplus
}
#endif
#endif
