/* The parts of the calibration wizard. */
#ifndef TELEDIMOS_APPS_WIZARD_INTERNAL_H
#define TELEDIMOS_APPS_WIZARD_INTERNAL_H

#include <jansson.h>

#include "apps/live.h"
#include "apps/wizard.h"
#include "calib/calibrate.h"
#include "calib/coverage.h"
#include "calib/next_view.h"
#include "core/source.h"

enum { WIZARD_CAMERAS = 2, WIZARD_PATH = 1024 };

/* What a person was asked; wizard.yaml. */
typedef struct wizard_answers {
    int camera_count;
    char name[WIZARD_CAMERAS][TD_NAME_SIZE];
    char source[WIZARD_CAMERAS][WIZARD_PATH]; /* folders: their whole path */
    char pattern[WIZARD_CAMERAS][128];        /* of names in a folder; "": every image */
    td_camera_model model;
    td_target target;
    json_t *target_mapping; /* as dataset.yaml says it */
} wizard_answers;

/* A picture, or a pair of them, that belongs to the dataset. */
typedef struct wizard_view {
    char name[TD_NAME_SIZE];
    char *image[WIZARD_CAMERAS]; /* as frames.csv has it: absolute, or below the folder of the results */
    double time_s;               /* NaN: none */
    td_detection detection[WIZARD_CAMERAS];
    bool told; /* that it was left out */
} wizard_view;

typedef struct wizard {
    const wizard_setup *setup;
    terminal *term;
    char *folder;
    wizard_answers answers;
    td_source *source[WIZARD_CAMERAS];
    int width[WIZARD_CAMERAS], height[WIZARD_CAMERAS]; /* px; 0: no picture yet */
    size_t count, capacity;
    wizard_view *view;

    /* What follows from the views. */
    td_observations *observations;
    td_calibration *calibration; /* NULL: too few views */
    td_coverage coverage[WIZARD_CAMERAS];
    td_next_view next;
    bool has_next;
    int skip;          /* suggestions passed over */
    double solve_s;    /* what the last solve took */
    size_t solved;     /* views in it */
    char trouble[512]; /* why there is no calibration yet; "" */

    /* What is seen now. */
    td_frame frame[WIZARD_CAMERAS];
    td_detection seen[WIZARD_CAMERAS];
    bool frozen, ended, take;
    double skew_s;

    live *page;
    bool text_picture, colour;
    int panel_lines; /* lines of the panel on the screen, to be drawn over */
} wizard;

/* wizard_ask.c: fills the answers from the setup or by asking. TD_ERROR_CANCELLED at the end of the input. */
td_status wizard_ask(wizard *w, td_error *error);

/* wizard_store.c */
td_status wizard_write_answers(const wizard *w, td_error *error);
td_status wizard_read_answers(wizard *w, td_error *error);
td_status wizard_write_views(const wizard *w, td_error *error);
/* Reads frames.csv and looks at its images again. */
td_status wizard_read_views(wizard *w, td_error *error);
/* Takes what is seen now into the dataset, storing pictures that are not files yet. */
td_status wizard_take(wizard *w, td_error *error);
bool wizard_has(const wizard *w, const char *image);
/* Whole path of a view's picture; to be freed with free(). */
char *wizard_image_path(const wizard *w, const wizard_view *view, int camera);

/* wizard_screen.c */
void wizard_say(wizard *w, const char *format, ...) TD_PRINTF(2, 3); /* a line that stays */
void wizard_draw(wizard *w);                                         /* the panel below them */
void wizard_clear(wizard *w);                                        /* takes the panel away */
void wizard_show_live(wizard *w);

#endif
