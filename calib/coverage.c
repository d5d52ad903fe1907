#include "calib/coverage.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define DEGREES 57.29577951308232
/* A tilt that tells focal length from distance: below it the change of scale over the board is lost in the
 * noise (Zhang 2000, section 5.1: the error falls with the angle, best near 45 degrees). */
#define TILT_WANTED_DEG 15.0
/* Distances of a smaller ratio than this count as one. */
#define DISTANCE_RATIO 1.5
/* So many parts of the image can be named in one sentence. */
enum { PARTS = 3, NAMED_PARTS = 3 };

static TD_PRINTF(2, 3) void add(char text[TD_TEXT_SIZE], const char *format, ...)
{
    size_t length = strlen(text);
    if (length) snprintf(text + length, TD_TEXT_SIZE - length, "; ");
    length = strlen(text);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text + length, TD_TEXT_SIZE - length, format, arguments);
    va_end(arguments);
}

/* Points of view v that count: seen and, with a calibration, in use. */
static size_t count_points(td_coverage *coverage, int camera, size_t v, const td_calibration *calibration,
                           const td_observations *o)
{
    const td_detection *d = td_observations_get(o, v, camera);
    const td_observed_camera *c = &o->camera[camera];
    size_t n = 0, row = v * (size_t)o->camera_count + (size_t)camera;
    for (size_t p = 0; d->found && p < d->count; p++) {
        const double *seen = d->point + 2 * p;
        if (!isfinite(seen[0]) || !isfinite(seen[1])) continue;
        if (calibration && !calibration->used[row * d->count + p]) continue;
        n++;
        double x = (seen[0] + 0.5) / c->width, y = (seen[1] + 0.5) / c->height;
        if (!(x >= 0 && x < 1 && y >= 0 && y < 1)) continue;
        coverage
            ->points[(int)(y * TD_COVERAGE_ROWS) * TD_COVERAGE_COLUMNS + (int)(x * TD_COVERAGE_COLUMNS)]++;
    }
    return n;
}

/* Distance and tilts of the board in one view. On the plane n . x = d the depth grows along x by -nx / nz. */
static void measure_pose(td_coverage *coverage, int camera, size_t v, const td_calibration *calibration,
                         const td_observations *o)
{
    const td_pose pose = td_pose_compose(&calibration->rig->camera[camera].camera_from_rig,
                                         &calibration->view[v].rig_from_target);
    size_t count = td_target_point_count(&o->target);
    double centre[3] = {0}, p[3], n[3];
    const double z[3] = {0, 0, 1};
    for (size_t i = 0; i < count; i++) {
        td_target_point(p, &o->target, i);
        for (int k = 0; k < 3; k++) centre[k] += p[k] / (double)count;
    }
    if (!isnan(o->height_m[v])) centre[2] -= o->height_m[v];
    td_pose_transform(centre, &pose, centre);
    double distance = sqrt(centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2]);
    coverage->nearest_m = fmin(coverage->nearest_m, distance); /* fmin and fmax pass over NaN */
    coverage->farthest_m = fmax(coverage->farthest_m, distance);
    td_pose_rotate(n, &pose, z);
    coverage->tilt_rad = fmax(coverage->tilt_rad, acos(fmin(fabs(n[2]), 1)));
    const double away[TD_COVERAGE_TILTS] = {atan2(-n[0], n[2]), atan2(n[0], n[2]), atan2(-n[1], n[2]),
                                            atan2(n[1], n[2])};
    for (int i = 0; i < TD_COVERAGE_TILTS; i++) coverage->tilted[i] += away[i] * DEGREES >= TILT_WANTED_DEG;
}

/* The ninths of the image that hold no point. */
static void missing_parts(td_coverage *coverage)
{
    static const char *const names[PARTS * PARTS] = {"upper left", "top",    "upper right",
                                                     "left side",  "middle", "right side",
                                                     "lower left", "bottom", "lower right"};
    size_t points[PARTS * PARTS] = {0};
    for (int row = 0; row < TD_COVERAGE_ROWS; row++)
        for (int column = 0; column < TD_COVERAGE_COLUMNS; column++)
            points[row * PARTS / TD_COVERAGE_ROWS * PARTS + column * PARTS / TD_COVERAGE_COLUMNS] +=
                coverage->points[row * TD_COVERAGE_COLUMNS + column];
    char list[128] = "";
    int empty = 0, shown = 0;
    for (int i = 0; i < PARTS * PARTS; i++) empty += !points[i];
    if (!empty) return;
    if (empty > NAMED_PARTS) {
        add(coverage->missing,
            "%d of 9 parts of the image have no point, bring the target near its edges and corners", empty);
        return;
    }
    for (int i = 0; i < PARTS * PARTS; i++) {
        if (points[i]) continue;
        const char *comma = !shown ? "" : shown == empty - 1 ? " and " : ", ";
        shown++;
        snprintf(list + strlen(list), sizeof list - strlen(list), "%sthe %s", comma, names[i]);
    }
    add(coverage->missing, "%s of the image %s no point", list, empty > 1 ? "have" : "has");
}

/* What the poses lack; a target with depth (several planes, known heights) needs no tilt. */
static void missing_poses(td_coverage *c, const td_observations *o)
{
    bool depth = !td_target_is_flat(&o->target);
    for (size_t v = 0; v < o->view_count; v++) depth |= !isnan(o->height_m[v]);
    if (isnan(c->nearest_m) || depth) return;
    bool sideways = c->tilted[0] + c->tilted[1] > 0, lengthways = c->tilted[2] + c->tilted[3] > 0;
    if (!sideways || !lengthways)
        add(c->missing, "no board is tilted %s by more than %.0f degrees",
            sideways     ? "up or down"
            : lengthways ? "to the left or right"
                         : "to any side",
            TILT_WANTED_DEG);
    if (c->farthest_m < DISTANCE_RATIO * c->nearest_m)
        add(c->missing, "all boards are between %.2g and %.2g m, also take some nearer and farther",
            c->nearest_m, c->farthest_m);
}

void td_coverage_measure(td_coverage *coverage, int camera, const td_calibration *calibration,
                         const td_observations *observations)
{
    *coverage = (td_coverage){.nearest_m = NAN, .farthest_m = NAN, .tilt_rad = NAN};
    for (size_t v = 0; v < observations->view_count; v++) {
        if (!count_points(coverage, camera, v, calibration, observations)) continue;
        coverage->views++;
        if (calibration) measure_pose(coverage, camera, v, calibration, observations);
    }
    size_t filled = 0, cells = (size_t)TD_COVERAGE_ROWS * TD_COVERAGE_COLUMNS;
    for (size_t i = 0; i < cells; i++) filled += coverage->points[i] > 0;
    coverage->image_share = (double)filled / (double)cells;
    const char *name = observations->camera[camera].name;
    if (!coverage->views) {
        snprintf(coverage->missing, sizeof coverage->missing, "%s: no view shows the target", name);
        return;
    }
    missing_parts(coverage);
    missing_poses(coverage, observations);
    if (!coverage->missing[0]) return;
    char text[TD_TEXT_SIZE];
    memcpy(text, coverage->missing, sizeof text);
    snprintf(coverage->missing, sizeof coverage->missing, "%s: %.*s", name, TD_TEXT_SIZE - TD_NAME_SIZE - 3,
             text);
}
