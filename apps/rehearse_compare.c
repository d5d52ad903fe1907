/* What was predicted, what was measured, and what is true. */
#include <math.h>
#include <stdlib.h>

#include "apps/rehearse_internal.h"

static const double AROUND_M = 0.6; /* the trench: its walls slide in */
static const double REACH_M = 11;   /* of the machine: where the map is compared with the truth */

static void corners(double polygon[4][2], const td_dig_floor *f)
{
    const double along = cos(f->heading_rad), across = sin(f->heading_rad);
    const double a[2] = {-AROUND_M, f->length_m + AROUND_M}, t = f->width_m / 2 + AROUND_M;
    for (int i = 0; i < 4; i++) {
        const double ahead = a[i == 1 || i == 2], aside = i < 2 ? -t : t;
        polygon[i][0] = f->start[0] + ahead * along - aside * across;
        polygon[i][1] = f->start[1] + ahead * across + aside * along;
    }
}

/* Of the cell around a point; NaN: outside. */
static double height_of(const td_elevation *map, double x, double y)
{
    const double c = nearbyint((x - map->origin[0]) / map->cell_m),
                 r = nearbyint((y - map->origin[1]) / map->cell_m);
    if (!(c >= 0 && r >= 0 && c < map->columns && r < map->rows)) return NAN;
    return (double)map->height[(size_t)r * (size_t)map->columns + (size_t)c];
}

static bool is_inside(const td_dig_floor *f, double x, double y)
{
    const double dx = x - f->start[0], dy = y - f->start[1], c = cos(f->heading_rad), s = sin(f->heading_rad);
    const double a = c * dx + s * dy, t = c * dy - s * dx;
    return a >= -AROUND_M && a <= f->length_m + AROUND_M && fabs(t) <= f->width_m / 2 + AROUND_M;
}

/* By how much the ground is lower around the trench: cells of two maps of one grid, of `seen` (NULL: all)
 * those whose height is known. */
static double cut_between(const td_elevation *before, const td_elevation *after, const td_elevation *seen,
                          const td_dig_floor *floor)
{
    double sum = 0;
    for (int row = 0; row < before->rows; row++)
        for (int c = 0; c < before->columns; c++) {
            const size_t i = (size_t)row * (size_t)before->columns + (size_t)c;
            const double x = before->origin[0] + c * before->cell_m,
                         y = before->origin[1] + row * before->cell_m;
            const double lower = (double)before->height[i] - (double)after->height[i];
            if (!(lower > 0) || !is_inside(floor, x, y)) continue;
            if (!seen || !isnan(height_of(seen, x, y))) sum += lower;
        }
    return sum * before->cell_m * before->cell_m;
}

/* The last map without what is not seen around the trench, and how large that is. */
static td_status seen_only(td_elevation **seen, double *unseen_m2, double *area_m2, const rehearse *r,
                           td_error *error)
{
    size_t unseen = 0, all = 0;
    TD_TRY(td_elevation_copy(seen, r->map, error));
    td_elevation *m = *seen;
    for (int row = 0; row < m->rows; row++)
        for (int c = 0; c < m->columns; c++) {
            const size_t i = (size_t)row * (size_t)m->columns + (size_t)c;
            const double x = m->origin[0] + c * m->cell_m, y = m->origin[1] + row * m->cell_m;
            if (!is_inside(&r->floor, x, y)) continue;
            all++;
            if (m->provenance[i] != TD_CELL_SIMULATED && !isnan(m->height[i])) continue;
            m->height[i] = m->sigma[i] = NAN;
            unseen++;
        }
    *unseen_m2 = (double)unseen * m->cell_m * m->cell_m;
    *area_m2 = (double)all * m->cell_m * m->cell_m;
    return TD_OK;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Besides the cells' own noise two errors are the same in all cells. The calibration's, of the ground that is
 * seen whole; and that of the steps, where windows and rays that meet both the wall and what lies before it
 * take the one for the other, everywhere to the same side. Steps are told by their sigma, of several times
 * the ground's. */
static double sigma_of_volume(const rehearse *r, const td_elevation *seen)
{
    static const double STEP = 3, CHANGED = 3;
    const size_t cells = (size_t)seen->columns * (size_t)seen->rows;
    double *sigma = malloc((cells + 1) * sizeof *sigma), ground = 0, steps = 0;
    size_t count = 0;
    if (!sigma) return NAN;
    for (int row = 0; row < seen->rows; row++)
        for (int c = 0; c < seen->columns; c++) {
            const size_t i = (size_t)row * (size_t)seen->columns + (size_t)c;
            const double x = seen->origin[0] + c * seen->cell_m, y = seen->origin[1] + row * seen->cell_m;
            const double both = hypot((double)seen->sigma[i], (double)r->map_before->sigma[i]);
            const double off = fabs((double)seen->height[i] - (double)r->map_before->height[i]);
            if (is_inside(&r->floor, x, y) && off > CHANGED * both) sigma[count++] = (double)seen->sigma[i];
        }
    qsort(sigma, count, sizeof *sigma, by_value);
    for (size_t i = 0; i < count; i++) *(sigma[i] > STEP * sigma[count / 2] ? &steps : &ground) += sigma[i];
    free(sigma);
    const double area = seen->cell_m * seen->cell_m;
    return hypot(r->volume.sigma_cut_m3, hypot(area * steps, area * ground));
}

static void compare_map(rehearse *r)
{
    const double *at = r->state.site_from_vehicle.t;
    const td_elevation *m = r->map;
    double square = 0;
    size_t count = 0, within = 0;
    for (int row = 0; row < m->rows; row++)
        for (int c = 0; c < m->columns; c++) {
            const size_t i = (size_t)row * (size_t)m->columns + (size_t)c;
            const double x = m->origin[0] + c * m->cell_m, y = m->origin[1] + row * m->cell_m;
            const double off = (double)m->height[i] - td_elevation_at(r->true_after, x, y, NULL);
            if (m->provenance[i] == TD_CELL_SIMULATED) continue;
            if (!isfinite(off) || !isfinite(m->sigma[i]) || hypot(x - at[0], y - at[1]) > REACH_M) continue;
            square += off * off;
            within += fabs(off) <= (double)m->sigma[i];
            count++;
        }
    r->map_rms_m = count ? sqrt(square / (double)count) : NAN;
    r->map_share = count ? (double)within / (double)count : NAN;
}

/* Height of the tool above ground that nobody dug, true less predicted: the prediction's is over the map as
 * it was seen, so that the calibration's error is in it as in whatever is done to the ground. */
static void compare_above(rehearse *r, rehearse_round *round, const task_sample *a, const double place[3])
{
    static const double SAME_M = 1e-3;
    double sigma;
    const double *at = a->tool_true.t;
    const double ground = td_elevation_at(r->true_before, at[0], at[1], NULL),
                 after = td_elevation_at(r->true_after, at[0], at[1], NULL),
                 seen = td_elevation_at(r->map_before, place[0], place[1], &sigma);
    if (!(fabs(ground - after) < SAME_M) || !isfinite(seen) || !isfinite(sigma)) return;
    const double off = (at[2] - ground) - (place[2] - seen);
    round->above_square += off * off;
    round->sigma_above_square += sigma * sigma + round->monitor.sigma_up_m * round->monitor.sigma_up_m;
    round->above_count++;
}

static void compare_tip(rehearse *r, rehearse_round *round)
{
    double d[MONITOR_MOST], tip[3], place[3];
    for (size_t i = 0; i < round->done.count; i++) {
        const task_sample *a = round->done.sample + i;
        if (!monitor_is_free(a) || a->phase != TD_PHASE_EXECUTING) continue;
        if (!monitor_compare(d, tip, place, &round->ahead, a, r->scenario.robot->joint_count)) continue;
        const double off = hypot(hypot(tip[0], tip[1]), tip[2]);
        round->tip_square += off * off;
        round->tip_most_m = fmax(round->tip_most_m, off);
        round->tip_count++;
        compare_above(r, round, a, place);
    }
}

td_status rehearse_compare(rehearse *r, td_error *error)
{
    double polygon[4][2];
    td_volume_options o = td_volume_options_default();
    td_error why = {0};
    td_elevation *seen = NULL;
    const td_elevation *predicted = NULL;
    double area = 0;
    if (r->true_after) compare_map(r);
    r->volume = (td_volume){.cut_m3 = NAN, .sigma_cut_m3 = NAN};
    for (int i = 0; i < r->round_count; i++) {
        rehearse_round *round = r->round + i;
        if (!round->executed) continue;
        round->predicted_m3 = cut_between(r->map_before, round->ahead.after, NULL, &r->floor);
        predicted = i < r->looked ? round->ahead.after : NULL; /* not looked at: nothing is measured */
        r->predicted_m3 = round->predicted_m3;
        if (r->true_after) compare_tip(r, round);
    }
    if (!(r->planned_m3 > 0)) return TD_OK;
    r->dug_m3 = r->true_after ? cut_between(r->true_before, r->true_after, NULL, &r->floor) : NAN;
    r->volume.cut_m3 = r->sigma_volume_m3 = r->seen_share = r->dug_seen_m3 = NAN;
    r->unseen_m2 = r->predicted_unseen_m3 = r->measured_m3 = r->sigma_measured_m3 = NAN;
    if (!predicted) return TD_OK;
    corners(polygon, &r->floor);
    o.polygon = (const double(*)[2])polygon;
    o.polygon_count = 4;
    TD_TRY(seen_only(&seen, &r->unseen_m2, &area, r, error));
    r->seen_share = 1 - r->unseen_m2 / fmax(area, 1e-9);
    if (r->true_after) r->dug_seen_m3 = cut_between(r->true_before, r->true_after, seen, &r->floor);
    r->predicted_unseen_m3 = r->predicted_m3 - cut_between(r->map_before, predicted, seen, &r->floor);
    const td_status status = td_volume_between(&r->volume, NULL, r->map_before, seen, &o, &why);
    if (status == TD_ERROR_MEMORY) td_elevation_free(&seen);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status != TD_OK) r->volume = (td_volume){.cut_m3 = NAN, .sigma_cut_m3 = NAN};
    r->sigma_volume_m3 = sigma_of_volume(r, seen);
    r->measured_m3 = r->volume.cut_m3 + r->predicted_unseen_m3;
    /* What the prediction is off is taken for the same in all of its cells. */
    r->sigma_measured_m3 = hypot(r->sigma_volume_m3, r->scatter_m * r->unseen_m2);
    td_elevation_free(&seen);
    return TD_OK;
}
