/* teledimos workbench, between its files.
 *
 *   workbench.c            lines in, lines out, and what keeps it from being a burden
 *   workbench_acquire.c    a live source, or a pair: seen, frozen, stored
 *   workbench_open.c       the datasets that the command line allows, their pictures
 *   workbench_calibrate.c  marks, clicks, coverage, the solve
 *   workbench_match.c      a pair and its rig: candidates of a click, points in space */
#ifndef TELEDIMOS_APPS_WORKBENCH_INTERNAL_H
#define TELEDIMOS_APPS_WORKBENCH_INTERNAL_H

#include "apps/match_internal.h"
#include "calib/marks.h"
#include "core/dataset.h"
#include "core/document.h"

enum { WORKBENCH_PLACES = 32, WORKBENCH_LINE = 4096, WORKBENCH_POINTS = 300 };

/* ---- workbench.c ---- */

/* One line out, whole. `json` is taken. */
void workbench_answer(json_int_t id, json_t *json);
void workbench_fail(json_int_t id, const td_error *error);
void workbench_message(const char *channel, const char *json, size_t size);

/* An image as JPEG. */
td_status workbench_jpeg(json_t **picture, const td_image *image, int quality, td_error *error);
/* The folder "OUTPUT/name"; to be freed with free(). */
td_status workbench_folder(char **path, const char *output, const char *name, td_error *error);

/* ---- acquire ---- */

typedef struct workbench_source {
    const char *const *where; /* (count) 1 or 2 */
    int count;
    const char *output, *target;
    double rate_hz;
} workbench_source;
td_status workbench_acquire(const workbench_source *source, td_error *error);

/* ---- pictures ---- */

/* A dataset, or a folder of pictures. */
typedef struct workbench_place {
    char name[TD_NAME_SIZE];
    const char *path;
} workbench_place;

/* One camera's image of one frame. */
typedef struct workbench_view {
    bool looked;
    td_detection detection;
    td_click click[TD_MAX_CLICKS];
    size_t clicks;
} workbench_view;

/* Calibrating and matching each have a dataset open, so that one does not end the other's work. */
typedef enum workbench_use { WORKBENCH_CALIBRATE, WORKBENCH_MATCH, WORKBENCH_USES } workbench_use;

typedef struct workbench_open_place {
    const workbench_place *place; /* NULL: nothing is open */
    td_dataset *dataset;
    bool has_target;
} workbench_open_place;

typedef struct workbench {
    const char *output, *self; /* self: the folder of the programs */
    workbench_place place[WORKBENCH_PLACES];
    size_t places;
    workbench_open_place open[WORKBENCH_USES];
    /* Of what is calibrated: */
    workbench_view *view; /* (frames,cameras) */
    int width[TD_RIG_MAX_CAMERAS], height[TD_RIG_MAX_CAMERAS];
    /* Of what is matched, a pair: */
    match_job match; /* its points, as teledimos match has them */
    bool has_pair;
    long named;          /* points so far: each has a number of its own */
    td_match *candidate; /* (candidates) of the last click */
    size_t candidates;
    double clicked[2];
} workbench;

/* Each does one request: *answer, or the reason why not. `a` holds the arguments. */
typedef td_status workbench_work(json_t **answer, workbench *w, const td_field *a, td_error *error);
workbench_work workbench_benches, workbench_open, workbench_picture;     /* _open.c */
workbench_work workbench_marks, workbench_coverage, workbench_calibrate; /* _calibrate.c */
workbench_work workbench_pair, workbench_check, workbench_interest, workbench_click, workbench_choose, workbench_undo,
    workbench_export; /* _match.c */

void workbench_close(workbench *w);
/* The dataset at a place; *has_target: views of it can be calibrated. */
td_status workbench_dataset(td_dataset **dataset, bool *has_target, const workbench_place *place,
                            td_error *error);
/* The arguments `frame` and `camera` of what is open; `path` of their image. */
td_status workbench_image(size_t *frame, int *camera, const char **path, const workbench_open_place *open,
                          const td_field *a, td_error *error);
td_status workbench_frame(size_t *frame, const workbench_open_place *open, const td_field *a,
                          td_error *error);
/* The rig of a place: of its calibration here, else its own; NULL: neither. To be freed with free(). */
char *workbench_rig(const workbench *w, const workbench_place *place, const td_dataset *dataset,
                    bool *calibrated);
const workbench_place *workbench_find(const workbench *w, const char *name);
/* The numbers x, y: finite, and somewhere near an image. */
td_status workbench_pixel(double pixel[2], const td_field *a, td_error *error);
void workbench_unpair(workbench *w);

#endif
