/* Which corners and views do not belong, judged against robust (median) scales. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "calib/calibrate_internal.h"

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *x, size_t n)
{
    if (!n) return 0;
    qsort(x, n, sizeof *x, compare_doubles);
    return n % 2 ? x[n / 2] : (x[n / 2 - 1] + x[n / 2]) / 2;
}

/* The length of a residual of two equal Gaussian coordinates has median 1.1774 sigma (Rayleigh). */
#define RAYLEIGH_MEDIAN 1.1774100225154747

/* Lengths of residuals of the points in use; returns their number. */
static size_t lengths(double *out, const td_bundle *bundle, size_t view, int camera)
{
    size_t points = td_target_point_count(&bundle->observations->target), n = 0;
    double r[2];
    for (size_t p = 0; p < points; p++)
        if (bundle->used[td_bundle_index(bundle, view, camera, p)])
            out[n++] = td_bundle_residual(r, bundle, view, camera, p) ? hypot(r[0], r[1]) : 1e6;
    return n;
}

double td_robust_noise(const td_bundle *bundle, int camera)
{
    size_t views = bundle->observations->view_count,
           points = td_target_point_count(&bundle->observations->target);
    double *all = malloc((views * points + 1) * sizeof *all), noise = 0;
    size_t n = 0;
    if (!all) return 0;
    for (size_t v = 0; v < views; v++) n += lengths(all + n, bundle, v, camera);
    noise = median(all, n) / RAYLEIGH_MEDIAN;
    free(all);
    return noise;
}

/* Takes single corners of a view out of use; returns how many. */
static size_t mark_corners(td_bundle *bundle, size_t view, int camera, double limit)
{
    size_t points = td_target_point_count(&bundle->observations->target), marked = 0;
    double r[2];
    for (size_t p = 0; p < points; p++) {
        uint8_t *used = &bundle->used[td_bundle_index(bundle, view, camera, p)];
        if (!*used) continue;
        if (td_bundle_residual(r, bundle, view, camera, p) && hypot(r[0], r[1]) <= limit) continue;
        *used = 0;
        marked++;
    }
    return marked;
}

static double rms_of(const double *length, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += length[i] * length[i];
    return n ? sqrt(sum / (double)n) : 0;
}

/* One camera: `work` has room for all lengths, `rms` for all views. */
static bool mark_camera(td_bundle *bundle, td_calibration *result, int camera,
                        const td_calibrate_options *options, double *work, double *rms)
{
    size_t views = bundle->observations->view_count, seen = 0;
    bool changed = false;
    double noise = td_robust_noise(bundle, camera);
    for (size_t v = 0; v < views; v++) {
        size_t n = lengths(work, bundle, v, camera);
        if (n) rms[seen++] = median(work, n) / RAYLEIGH_MEDIAN * sqrt(2.0);
    }
    double usual = median(rms, seen);
    for (size_t v = 0; v < views; v++) {
        size_t n = lengths(work, bundle, v, camera);
        if (!n) continue;
        double own = median(work, n) / RAYLEIGH_MEDIAN;
        /* A view blurred as a whole is not made of outliers: its own scale counts too. */
        size_t marked = mark_corners(bundle, v, camera, options->outlier_sigma * fmax(noise, own));
        changed = changed || marked;
        size_t left = lengths(work, bundle, v, camera);
        double view_rms = rms_of(work, left);
        bool whole = view_rms > options->outlier_view * usual;
        if (!whole && marked * 4 <= n && left >= 4) continue;
        td_calibrated_view *view = &result->view[v];
        if (whole)
            snprintf(view->remark, sizeof view->remark,
                     "its points in %s are off by %.2f px RMS, %.1f times the usual %.2f px: blurred, moved, "
                     "bent, or badly "
                     "found",
                     bundle->rig->camera[camera].name, view_rms, view_rms / usual, usual);
        else
            snprintf(view->remark, sizeof view->remark, "%zu of its %zu points in %s are outliers", marked, n,
                     bundle->rig->camera[camera].name);
        view->state = TD_VIEW_OUTLIER;
        td_bundle_drop(bundle, v, camera);
        changed = true;
    }
    return changed;
}

td_status td_outliers_mark(bool *changed, td_bundle *bundle, td_calibration *result,
                           const td_calibrate_options *options, td_error *error)
{
    size_t views = bundle->observations->view_count,
           points = td_target_point_count(&bundle->observations->target);
    double *work = malloc((points + views + 1) * sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
    *changed = false;
    for (int c = 0; c < bundle->rig->count; c++)
        if (mark_camera(bundle, result, c, options, work, work + points)) *changed = true;
    free(work);
    return TD_OK;
}
