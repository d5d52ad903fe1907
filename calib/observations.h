/* All that was seen of one target by all cameras: the input of a calibration. */
#ifndef TELEDIMOS_CALIB_OBSERVATIONS_H
#define TELEDIMOS_CALIB_OBSERVATIONS_H

#include "../core/dataset.h"
#include "../core/log.h"
#include "../core/progress.h"
#include "detection.h"
#include "marks.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_observed_camera {
    char name[TD_NAME_SIZE];
    td_camera_model model; /* wished */
    int width, height;     /* px; 0: no image of this camera yet */
} td_observed_camera;

typedef struct td_observations {
    td_target target;
    int camera_count;
    td_observed_camera camera[TD_RIG_MAX_CAMERAS];
    size_t view_count;
    char (*view_name)[TD_NAME_SIZE]; /* (views) */
    double *height_m;                /* (views) board moved along its normal towards the cameras; NaN: free */
    td_detection *detection;         /* (views,cameras); found false where there is no image */
} td_observations;

/* Nothing seen yet; every detection is initialised. */
TD_API td_status td_observations_new(td_observations **observations, const td_target *target,
                                     int camera_count, size_t view_count, td_error *error);
TD_API void td_observations_free(td_observations **observations);
TD_API td_detection *td_observations_get(const td_observations *observations, size_t view, int camera);
/* What a detector saw, where it found the target; else nothing. It has as many points as the target. */
TD_API void td_observations_set(td_observations *observations, size_t view, int camera,
                                const td_detection *detection);
/* Number of points seen by a camera in a view. */
TD_API size_t td_observations_seen(const td_observations *observations, size_t view, int camera);

/* A person's numbering of marks, for one image. */
typedef struct td_image_clicks {
    char image[256]; /* file name, with as many of its folders as tell it from others */
    td_click click[TD_MAX_CLICKS];
    size_t count;
} td_image_clicks;

/* Reads a CSV with the columns image, mark (number, from 0), x_px, y_px. *clicks: free(). */
TD_API td_status td_clicks_read(td_image_clicks **clicks, size_t *count, const char *path, td_error *error);
TD_API td_status td_clicks_parse(td_image_clicks **clicks, size_t *count, const char *text, size_t size,
                                 const char *name, td_error *error);

typedef struct td_observe_options {
    int threads;                   /* 0: one per processor */
    const td_image_clicks *clicks; /* (click_count); may be NULL */
    size_t click_count;
    const td_progress *progress;
    const td_log *log;
} td_observe_options;

/* Reads every image of the dataset and finds the target in it, on several threads; or, when the dataset names
 * a file of corners, reads that. An image that cannot be read, or is of another size than the camera's first,
 * is an error that names it; a view without the target is not (its detection says why). */
TD_API td_status td_observe(td_observations **observations, const td_dataset *dataset,
                            const td_observe_options *options, td_error *error);

/* Points as CSV with the columns frame, camera, width_px, height_px (of the image), point (number in the
 * target, from 0), x_px, y_px, sigma_px (0: unknown); only points that were seen. `comment` (may be NULL)
 * becomes a first line behind
 * "# ". */
TD_API td_status td_observations_write(const td_observations *observations, const char *comment,
                                       const char *path, td_error *error);
/* Fills observations of which views, cameras and target are named; views and cameras that are not are
 * refused. */
TD_API td_status td_points_read(td_observations *observations, const char *path, td_error *error);
TD_API td_status td_points_parse(td_observations *observations, const char *text, size_t size,
                                 const char *name, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
