/* What the cameras of a rig see of a scene: rays through each distorted pixel, so that no image is resampled,
 * down a pyramid of the ground's highest and lowest cells, so that the time hardly grows with the map.
 *
 * Image formation, in this order: light (Lambert, sun with shadow off, ambient), blur of the lens (Gaussian),
 * vignetting (cos^4 law's share), exposure (gain, offset), noise (shot: variance in proportion to the light;
 * read), eight bits. */
#ifndef TELEDIMOS_SIM_STEREO_VIEW_H
#define TELEDIMOS_SIM_STEREO_VIEW_H

#include <stdint.h>

#include "../core/rig.h"
#include "../core/scene.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_view_options {
    int samples; /* n x n rays for a pixel that holds an edge or a picture, 1 to 8; default 3. Elsewhere one
                    suffices: grain finer than the pixel is left out */
    double blur_px;      /* standard deviation; default 0.6 */
    double vignetting;   /* 0: none, 1: cos^4; default 0.5 */
    double gain, offset; /* grey = gain * light * 255 + offset; default 1, 0 */
    double read_noise;   /* grey levels; default 1 */
    double shot_noise;   /* grey levels^2 of variance per grey level; default 0.02 */
    uint64_t seed;       /* of the noise; the frame's and the camera's number are mixed in */
    int threads;         /* 0: one per processor; the image does not depend on it */
} td_view_options;
TD_API td_view_options td_view_options_default(void);
/* As a scene's images are formed; seed and threads are the defaults. */
TD_API td_view_options td_view_options_of_scene(const td_scene_image *image);

typedef struct td_view {
    td_image *image; /* grey */
    float *depth;    /* (height,width) m along z of the camera, through each pixel's centre; NaN: sky */
    uint8_t *what;   /* (height,width) td_view_what of that ray */
} td_view;
typedef enum td_view_what {
    TD_SEES_SKY,
    TD_SEES_GROUND,
    TD_SEES_SOLID,
    TD_SEES_PICTURE,
    TD_SEES_ROBOT
} td_view_what;

/* A scene made ready for rays (pyramid over the ground, boxes around bodies). Borrows the scene. After the
 * ground's cells have changed in a rectangle, td_stereo_view_update brings it up to date; after the robot or
 * its vehicle has moved, td_stereo_view_move; after solids or fixed pictures have, a new one is needed. */
typedef struct td_stereo_view td_stereo_view;
TD_API td_status td_stereo_view_new(td_stereo_view **view, const td_scene *scene, td_error *error);
TD_API void td_stereo_view_update(td_stereo_view *view, int column, int row, int columns, int rows);
TD_API td_status td_stereo_view_move(td_stereo_view *view, td_error *error);
TD_API void td_stereo_view_free(td_stereo_view **view);

/* One camera's view. Several threads may render from one view object at a time. The directions of a camera's
 * pixels are made at its first view and kept (12 bytes a pixel). */
TD_API td_status td_stereo_view_render(td_view **out, const td_stereo_view *view, const td_rig *rig,
                                       int camera, const td_pose *site_from_rig, uint64_t frame,
                                       const td_view_options *options, td_error *error);
TD_API void td_view_free(td_view **view);

/* First surface along a ray from `origin` (site, m) in unit direction `ray`: distance, m; INFINITY: none. */
TD_API double td_stereo_view_cast(const td_stereo_view *view, const double origin[3], const double ray[3],
                                  td_view_what *what);

#ifdef __cplusplus
}
#endif
#endif
