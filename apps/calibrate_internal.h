/* The parts of `teledimos calibrate`. */
#ifndef TELEDIMOS_APPS_CALIBRATE_INTERNAL_H
#define TELEDIMOS_APPS_CALIBRATE_INTERNAL_H

#include <jansson.h>

#include "apps/gate.h"
#include "calib/calibrate.h"
#include "core/dataset.h"
#include "core/schema.h"

typedef struct calibrate_job {
    const td_dataset *dataset;
    const td_observations *observations;
    const td_calibration *calibration;
    const td_calibrate_options *options;
    const gate_result *gate;
    char hash[65]; /* SHA-256 of description and images */
    bool reused;   /* points were taken from an earlier run's corners.csv */
} calibrate_job;

/* calibrate_gate.c */
extern const gate_row calibrate_gate_defaults[];
extern const size_t calibrate_gate_count;
void calibrate_judge(gate_result *result, const gate_row *rows, const td_dataset *dataset,
                     const td_observations *observations, const td_calibration *calibration);

/* calibrate_result.c */
extern const td_schema_row calibrate_schema[];
extern const size_t calibrate_schema_count;
json_t *calibrate_result(const calibrate_job *job);
json_t *calibrate_provenance(const calibrate_job *job);

/* calibrate_report.c */
td_status calibrate_report(const calibrate_job *job, const char *path, td_error *error);
void calibrate_table(const calibrate_job *job);

#endif
