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

/* A person's word on which mark is which: mark `index` of the target lies near `pixel` (on the mark, or not
 * farther off than a quarter of its diameter and 4 px). */
typedef struct td_click {
    size_t index;
    double pixel[2]; /* px */
} td_click;

enum { TD_MAX_CLICKS = 9 };

/* A fitted mark: a blurred disc in perspective, to whose ellipse lens distortion adds a bulge. The centre is
 * the centre of gravity of the mark's area. sigma supposes that noise is independent from pixel to pixel; on
 * JPEG images it is 0.8 to 1.3 of the truth. */
typedef struct td_mark {
    double centre[2];       /* px */
    double shape[3];        /* a, b, c of a dx^2 + 2 b dx dy + c dy^2 = 1, px^-2 */
    double blur;            /* standard deviation of the edge's blur, with the pixel's own 0.29, px */
    double inside, outside; /* grey levels */
    double sigma;           /* standard deviation of each coordinate of the centre, px */
    double centroid[2];     /* step one's centre of gravity of the binary blob, px */
} td_mark;

/* Steps one and two: all round marks in the grey image that its border does not cut, whatever they belong to.
 * *marks is to be freed with free(). */
TD_API td_status td_marks_find(td_mark **marks, size_t *count, const td_image *image,
                               td_mark_polarity polarity, td_error *error);

/* All three steps and the numbering.
 *
 * A plane is seen when at least 60 % of its marks are, and no fewer than 8 (or all, if it has fewer), and
 * their place on its grid is beyond doubt: an outer row or column of which nothing is seen is not guessed,
 * and a further row of marks means another target. `found` when at least one plane is seen; `reason` then
 * tells what was not, and remarks on a diameter that differs from the target's. Points are the marks'
 * centres, that is, centres of gravity: subtract td_mark_bias to compare them with projected points.
 *
 * Without clicks the grid is found by itself: of a grid's symmetries (half turns, quarter turns too when
 * columns = rows) the one is taken for which columns run to the right and rows down in the image, or nearest
 * to it; mirror images never. Planes of the same size are taken from left to right in the image, if all of
 * them are seen.
 *
 * With clicks (4 to 9 in all; at least 4 on a plane, not all but one of them in line, determine it; fewer
 * choose among its symmetries) their numbering decides, of hidden outer rows too. Impossible clicks are
 * TD_ERROR_ARGUMENT; clicks that do not fit the image give found = false and a reason that names the click.
 */
TD_API td_status td_marks_detect(td_detection *detection, const td_image *image, const td_target *target,
                                 const td_click *click, size_t click_count, td_error *error);

/* The centre of the image of a disc is not the image of its centre. bias (2) px = centroid of the image of
 * the disc of the given diameter around `centre` (target frame, m), lying in the plane with unit `normal`,
 * minus the projection of `centre`; through the whole camera model, distortion included. False when some of
 * the disc has no image, or the model folds there. */
TD_API bool td_mark_bias(double bias[2], const td_camera *camera, const td_pose *camera_from_target,
                         const double centre[3], const double normal[3], double diameter_m);

#ifdef __cplusplus
}
#endif
#endif
