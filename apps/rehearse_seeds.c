#include "apps/rehearse_seeds.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double cpu_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void keep(seeds_row *row, const rehearse *r)
{
    row->ended = !r->stopped;
    row->verdict = r->gate.verdict;
    snprintf(row->why, sizeof row->why, "%s", r->stopped ? r->why : "");
    for (int i = 0; i < r->round_count; i++) row->rounds += r->round[i].executed;
    row->measured_m3 = r->measured_m3;
    row->sigma_m3 = r->sigma_measured_m3;
    row->measured_seen_m3 = r->volume.cut_m3;
    row->sigma_seen_m3 = r->sigma_volume_m3;
    row->dug_seen_m3 = r->dug_seen_m3;
    row->dug_m3 = r->dug_m3;
    row->seen_share = r->seen_share;
    row->tip = rehearse_tips(r);
    row->rig_sigmas = r->rig_sigmas;
    row->probability = r->probability;
    row->mass_error_kg = r->mass_error_kg;
    row->real_time = r->real_time;
    row->unmeant = r->unmeant;
    row->misses = r->deadline_misses;
}

static td_status one(seeds_row *row, seeds *s, const char *path, uint64_t seed, double covariance,
                     int threads, const td_progress *progress, td_error *error)
{
    rehearse *r = calloc(1, sizeof *r);
    rehearse_setup *setup = calloc(1, sizeof *setup);
    const double began = cpu_now();
    td_status status = r && setup ? rehearse_read(setup, &r->scenario, path, error)
                                  : td_fail(error, TD_ERROR_MEMORY, "no memory for a rehearsal");
    if (status == TD_OK) {
        setup->truth.rig_covariance *= covariance;
        r->setup = setup;
        r->seed = seed;
        r->threads = threads;
        r->progress = progress;
        *row = (seeds_row){.seed = seed, .covariance = covariance};
        if (!s->name[0]) {
            snprintf(s->name, sizeof s->name, "%s", setup->name);
            snprintf(s->scenario, sizeof s->scenario, "%s", r->scenario.name);
        }
        status = rehearse_run(r, error);
    }
    if (status == TD_OK) {
        rehearse_judge(r, rehearse_gate_defaults);
        keep(row, r);
        row->cpu_s = cpu_now() - began;
    }
    if (r) rehearse_free(r);
    free(r);
    free(setup);
    return status;
}

/* ---- the sums ---- */

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Of the finite ones. */
static double median(double *value, size_t count)
{
    size_t known = 0;
    for (size_t i = 0; i < count; i++)
        if (isfinite(value[i])) value[known++] = value[i];
    if (!known) return NAN;
    qsort(value, known, sizeof *value, by_value);
    return (value[(known - 1) / 2] + value[known / 2]) / 2;
}

static void sum_up(seeds_sum *sum, const seeds_row *row, size_t count, double *scratch)
{
    *sum = (seeds_sum){.covariance = row->covariance, .seeds = (int)count};
    double *const value[5] = {scratch, scratch + count, scratch + 2 * count, scratch + 3 * count,
                              scratch + 4 * count};
    for (size_t i = 0; i < count; i++) {
        const seeds_row *o = row + i;
        const double off = fabs(o->measured_m3 - o->dug_m3),
                     off_seen = fabs(o->measured_seen_m3 - o->dug_seen_m3);
        sum->ended += o->ended;
        sum->within_5 += o->ended && off <= 0.05 * o->dug_m3 && off_seen <= 0.05 * o->dug_seen_m3;
        sum->within_2_sigma += o->ended && off <= 2 * o->sigma_m3 && off_seen <= 2 * o->sigma_seen_m3;
        sum->unmeant += o->unmeant;
        sum->mass_most_kg = fmax(sum->mass_most_kg, fabs(o->mass_error_kg));
        value[0][i] = o->tip.rms_m;
        value[1][i] = o->tip.sigma_m;
        value[2][i] = o->tip.above_m;
        value[3][i] = o->tip.sigma_above_m;
        value[4][i] = off / o->dug_m3;
    }
    sum->tip_median_m = median(value[0], count);
    sum->sigma_tip_median_m = median(value[1], count);
    sum->above_median_m = median(value[2], count);
    sum->sigma_above_median_m = median(value[3], count);
    sum->volume_median = median(value[4], count);
}

td_status seeds_run(seeds *s, const char *path, uint64_t first, int count, const double *covariance,
                    size_t covariances, int threads, const td_progress *progress, td_error *error)
{
    const size_t rows = (size_t)count, sums = covariances ? covariances : 1;
    *s = (seeds){.row = calloc(rows * sums, sizeof *s->row)};
    double *scratch = malloc(5 * rows * sizeof *scratch);
    td_status status = s->row && scratch ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a table");
    for (size_t c = 0; c < sums && status == TD_OK; c++) {
        for (size_t i = 0; i < rows && status == TD_OK; i++) {
            if (!td_progress_report(progress, "rehearsing", c * rows + i, rows * sums))
                status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
            if (status == TD_OK)
                status = one(s->row + s->count, s, path, first + i, covariances ? covariance[c] : 1,
                             threads, NULL, error);
            s->count += status == TD_OK;
        }
        if (status == TD_OK) sum_up(s->sum + s->sum_count++, s->row + c * rows, rows, scratch);
    }
    free(scratch);
    return status;
}

void seeds_free(seeds *s)
{
    free(s->row);
    s->row = NULL;
}
