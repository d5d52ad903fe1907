/* teledimos measure, between its files: what was asked, and what was found. */
#ifndef TELEDIMOS_APPS_MEASURE_INTERNAL_H
#define TELEDIMOS_APPS_MEASURE_INTERNAL_H

#include "apps/gate.h"
#include "apps/job.h"
#include "recon/volume.h"

typedef enum measure_kind { MEASURE_VOLUME, MEASURE_PROFILE, MEASURE_SLOPE } measure_kind;

typedef struct measure_job {
    measure_kind kind;
    const char *path[2];  /* before and after; or the map */
    td_elevation *map[2]; /* the second: of a volume only */
    bool has_sigma;       /* a cell of each map has one */
    /* volume */
    double (*polygon)[2];
    size_t polygon_count;
    td_volume_options options;
    td_volume volume;
    /* profile */
    double from[2], to[2], step_m;
    td_profile_point *profile;
    size_t count, known;
    /* volume: the difference; slope: the slope */
    td_elevation *product;
    double slope_rad[3]; /* median, 95th percentile, steepest */
    size_t slope_cells;
    gate_result gate;
} measure_job;

extern const char *const measure_kinds[];
extern const td_schema_row measure_schema[];
extern const size_t measure_schema_count;
extern const gate_row measure_gate_defaults[];
extern const size_t measure_gate_count;

/* measure_input.c */
td_status measure_polygon_read(measure_job *m, const char *path, td_error *error);
td_status measure_point_parse(double point[2], const char *option, const char *text, td_error *error);
td_status measure_profile_write(const measure_job *m, const char *path, td_error *error);

/* measure_result.c */
void measure_judge(measure_job *m, const gate_row *rows);
json_t *measure_result(const measure_job *m);
void measure_table(const void *found);

/* measure_report.c */
td_status measure_report(const void *found, const char *path, td_error *error);

#endif
