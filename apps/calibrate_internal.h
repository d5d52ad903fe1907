/* The parts of `teledimos calibrate`. */
#ifndef TELEDIMOS_APPS_CALIBRATE_INTERNAL_H
#define TELEDIMOS_APPS_CALIBRATE_INTERNAL_H

#include <jansson.h>

#include "apps/gate.h"
#include "calib/calibrate.h"
#include "calib/coverage.h"
#include "calib/model_choice.h"
#include "calib/projected_uncertainty.h"
#include "core/dataset.h"
#include "core/schema.h"

/* What follows from a calibration: how far to trust it, and what would help. */
typedef struct calibrate_trust {
    td_coverage coverage[TD_RIG_MAX_CAMERAS];
    bool has_choice[TD_RIG_MAX_CAMERAS]; /* false: not asked for, or too few views */
    td_model_choice choice[TD_RIG_MAX_CAMERAS];
    td_uncertainty_map *map; /* NULL: the views leave something open */
    double projected_px;     /* median of the map, of the worst camera, at the middle board's distance; NaN */
    double middle_distance_m; /* NaN */
} calibrate_trust;

typedef struct calibrate_job {
    const td_dataset *dataset;
    const td_observations *observations;
    const td_calibration *calibration;
    const td_calibrate_options *options;
    const calibrate_trust *trust;
    const gate_result *gate;
    char hash[65]; /* SHA-256 of description and images */
    bool reused;   /* points were taken from an earlier run's corners.csv */
} calibrate_job;

/* calibrate_trust.c */
td_status calibrate_trust_run(calibrate_trust *trust, const calibrate_job *job, bool models, td_error *error);
void calibrate_trust_free(calibrate_trust *trust);
/* Median (and most) of the map over a camera's image at a distance: the mean would be its corners'. */
double calibrate_map_median(const td_uncertainty_map *map, int camera, int distance, double *most);
/* The map as a table: camera, distance_m, x_px, y_px, sigma_px. */
td_status calibrate_write_map(const calibrate_job *job, const char *path, td_error *error);

/* calibrate_gate.c */
extern const gate_row calibrate_gate_defaults[];
extern const size_t calibrate_gate_count;
void calibrate_judge(gate_result *result, const gate_row *rows, const calibrate_job *job);

/* calibrate_result.c */
extern const td_schema_row calibrate_schema[];
extern const size_t calibrate_schema_count;
json_t *calibrate_result(const calibrate_job *job);
json_t *calibrate_provenance(const calibrate_job *job);

/* calibrate_report.c */
td_status calibrate_report(const calibrate_job *job, const char *path, td_error *error);
void calibrate_table(const calibrate_job *job);

#endif
