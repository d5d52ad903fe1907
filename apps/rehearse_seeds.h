/* teledimos rehearse, the same rehearsal with many truths: what is claimed of one, over many. */
#ifndef TELEDIMOS_APPS_REHEARSE_SEEDS_H
#define TELEDIMOS_APPS_REHEARSE_SEEDS_H

#include "apps/rehearse_internal.h"

/* One rehearsal. */
typedef struct seeds_row {
    uint64_t seed;
    double covariance; /* the rig's, times */
    bool ended;        /* not stopped */
    char why[600];
    verdict verdict;
    int rounds;                                          /* executed */
    double measured_m3, sigma_m3, dug_m3;                /* whole */
    double measured_seen_m3, sigma_seen_m3, dug_seen_m3; /* where it is seen */
    double seen_share;
    rehearse_tip tip;
    double rig_sigmas, probability, mass_error_kg, real_time, cpu_s;
    int unmeant, misses;
} seeds_row;

/* All of one covariance. */
typedef struct seeds_sum {
    double covariance;
    int seeds, ended, within_5, within_2_sigma, unmeant;
    double tip_median_m, sigma_tip_median_m, above_median_m, sigma_above_median_m, volume_median,
        mass_most_kg;
} seeds_sum;

enum { SEEDS_MOST = 1000, SEEDS_MOST_COVARIANCES = 16 };

typedef struct seeds {
    char name[TD_NAME_SIZE], scenario[TD_NAME_SIZE];
    size_t count, sum_count;
    seeds_row *row; /* (count) by covariance, then seed */
    seeds_sum sum[SEEDS_MOST_COVARIANCES];
    gate_result gate;
} seeds;

/* Whole numbers of seeds from `first`, each for each of the covariances (times; none: as the file says). */
td_status seeds_run(seeds *s, const char *path, uint64_t first, int count, const double *covariance,
                    size_t covariances, int threads, const td_progress *progress, td_error *error);
void seeds_free(seeds *s);
void seeds_judge(seeds *s, const gate_row *rows);
extern const td_schema_row seeds_schema[];
extern const size_t seeds_schema_count;
extern const gate_row seeds_gate_defaults[];
extern const size_t seeds_gate_count;
json_t *seeds_result(const seeds *s);
void seeds_table(const void *done);
td_status seeds_report(const void *done, const char *path, td_error *error);
/* seeds.csv */
td_status seeds_write(const seeds *s, const char *folder, td_error *error);

#endif
