/* What the rooms of `teledimos capture` share. */
#ifndef TELEDIMOS_APPS_CAPTURE_INTERNAL_H
#define TELEDIMOS_APPS_CAPTURE_INTERNAL_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

#include "apps/live.h"
#include "core/image.h"
#include "core/schema.h"
#include "core/status.h"

enum { CAPTURE_CAMERAS = 2, CAPTURE_NAME_SIZE = 64 };

/* ---- capture_measure.c ---- */

/* What an image tells of the camera's settings. */
typedef struct capture_measure {
    double focus;            /* see capture_measure.c; 0: no structure at all */
    double brightness_share; /* mean grey, of white */
    double saturated_share;  /* of the pixels: 254 or 255 in a channel */
} capture_measure;
capture_measure capture_measure_image(const td_image *image);
/* Of an image of three channels: whether any pixel is not grey. */
bool capture_has_colour(const td_image *image);

/* ---- capture_dataset.c ---- */

/* The dataset that grows. */
typedef struct capture_dataset {
    const char *folder, *model;
    const char *format; /* "pgm", "png" */
    bool colour;
    json_t *target;   /* owned; NULL: none given */
    char about[1200]; /* where the images come from */
    int cameras;
    char name[CAPTURE_CAMERAS][CAPTURE_NAME_SIZE];
    char *table; /* frames.csv, as it is to be written */
    size_t table_size, table_capacity;
    int columns, column_of[2 + CAPTURE_CAMERAS]; /* of frame, time_s, images */
    long next;                                   /* number of the next frame */
    size_t found, adopted; /* frames that were there; images of them that no table named */
    bool has_target, begun, unwritten;
    double written_s, write_took_s;
} capture_dataset;

/* Looks whether the folder holds a dataset already, and goes on with that. A new one is made with its first
 * image. */
td_status capture_dataset_open(capture_dataset *d, td_error *error);
/* Stores one image of each camera as the next frame. */
td_status capture_dataset_add(capture_dataset *d, td_image *const *image, double time_s, td_error *error);
/* Writes frames.csv when it is due; `now`: at once. */
td_status capture_dataset_flush(capture_dataset *d, bool now, td_error *error);
void capture_dataset_close(capture_dataset *d);

/* ---- capture_screen.c: the terminal ---- */

typedef struct capture_screen {
    bool keys, line, text, colour; /* keys are read; a status line is drawn; the picture as text */
    bool tty;
    double drawn_s;
} capture_screen;

void capture_screen_open(capture_screen *s, bool keys, bool text, bool quiet);
void capture_screen_close(capture_screen *s);
/* "freeze", "store", "done" for a key pressed; NULL: none. Never waits. */
const char *capture_screen_pressed(capture_screen *s);
/* Draws the pictures (when the screen shows them) and the line, at most 5 times a second unless `now`. */
void capture_screen_draw(capture_screen *s, const td_image *const *image, int count, const char *line,
                         bool now);
/* One picture, where the cursor is. */
void capture_screen_print(const capture_screen *s, const td_image *image);
/* Takes the line away, for a message. */
void capture_screen_clear(capture_screen *s);

/* ---- capture_result.c ---- */

/* What was done. */
typedef struct capture_camera {
    capture_measure last, sum; /* sum: over `measured` images */
    size_t measured;
    int width, height;
} capture_camera;

typedef struct capture_tally {
    size_t stored, seen, unreadable, dropped;
    double first_s, last_s;            /* times of the first and last image seen */
    double begun_s, ended_s;           /* by the monotonic clock */
    double skew_sum_s, skew_largest_s; /* over `skews` pairs */
    size_t skews;
    const char *ended_by;
    capture_camera camera[CAPTURE_CAMERAS];
} capture_tally;

/* Images a second of those seen; NaN: fewer than two. */
double capture_rate(const capture_tally *t);

extern const td_schema_row capture_schema[];
extern const size_t capture_schema_count;
json_t *capture_result(const capture_dataset *d, const capture_tally *t, const char *const *source);
json_t *capture_result_open(const char *path, const td_image *image, const capture_measure *m);
json_t *capture_result_list(void);
/* Checks it; writes it as `path` (NULL: nowhere), prints it as JSON when asked to. */
td_status capture_result_put(const json_t *result, const char *path, bool print, td_error *error);

#endif
