/* Looking: at first from where the machine came, later in poses of the arm, with what has been dug. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"

static const double DARK_GREY = 6, DARK_GAIN = 1e-3, LEAST_MATCHED = 0.1;
/* Matches scatter by 0.04 px themselves; three times that and the rig's own sigma is another rig. */
static const double EPIPOLAR_TIMES = 3, EPIPOLAR_NOISE_PX = 0.04;

static void keep(rehearse *r)
{
    td_image *small = NULL;
    const td_image *left = look_left(r->look);
    if (r->film_count == REHEARSE_MAX_FILM || !left) return;
    if (td_image_shrink(&small, left, 1, NULL) == TD_OK) r->film[r->film_count++] = small;
}

/* An image that is no image says so itself; few matches are a sign of it, or of a rig that is wrong. */
static void judge(rehearse *r, const look_result *seen)
{
    static const char *const sides[] = {"left", "right"};
    for (int i = 0; i < 2; i++)
        if (seen->grey[i] < DARK_GREY)
            rehearse_stop(r,
                          "look %d: the %s camera is dark (its mean is %.1f grey levels): check it; the map "
                          "is as it was before",
                          r->looks, sides[i], seen->grey[i]);
    r->matched_least = fmin(r->matched_least, seen->shares.matched);
    if (!r->stopped && seen->shares.matched < LEAST_MATCHED)
        rehearse_stop(
            r,
            "look %d: only %.1f %% of the pixels are matched: the cameras see too little, or are not "
            "where the rig says",
            r->looks, 100 * seen->shares.matched);
}

/* The rig against the first pair of each place: the cameras may have been moved since they were calibrated.
 */
static td_status check_rig(rehearse *r, td_error *error)
{
    look_rig rig;
    td_error why = {0};
    const td_status status = look_check(&rig, r->look, &why);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status != TD_OK) {
        rehearse_stop(r, "look %d: the rig cannot be checked: %s", r->looks, why.message);
        return TD_OK;
    }
    const double allowed =
        EPIPOLAR_TIMES * hypot(EPIPOLAR_NOISE_PX, isfinite(rig.sigma_px) ? rig.sigma_px : 0);
    if (!(rig.rms_px <= r->epipolar_px)) r->epipolar_px = rig.rms_px, r->sigma_epipolar_px = rig.sigma_px;
    if (!(rig.belief.sigmas <= r->rig_sigmas)) r->rig_sigmas = rig.belief.sigmas;
    if (rig.rms_px > allowed)
        rehearse_stop(
            r,
            "look %d: matches lie %.2f px off their epipolar lines, where the rig's covariance allows "
            "%.2f px: the calibration is not that of this head; calibrate it again",
            r->looks, rig.rms_px, allowed);
    if (rig.belief.sigmas > rig.belief.limit)
        rehearse_stop(r,
                      "look %d: the images show a rig that is %.1f times its own sigma off, in %d directions "
                      "that %zu matches see, where %.1f is the most to be believed: the calibration is not "
                      "that of this head; calibrate it again",
                      r->looks, rig.belief.sigmas, rig.belief.freedom, rig.belief.inliers, rig.belief.limit);
    return TD_OK;
}

/* A pair of the machine elsewhere; `frame`: of the scene, -1: as it is now. */
static td_status one_there(rehearse *r, int frame, bool first, td_error *error)
{
    look_result seen;
    td_image *pair[2] = {NULL, NULL};
    td_pose site_from_vehicle;
    double q[TD_ROBOT_MAX_JOINTS] = {0};
    if (r->stopped) return TD_OK;
    r->looks++;
    if (!td_progress_report(r->progress, "looking", (size_t)r->looks, (size_t)r->looks + 1))
        return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(rehearse_far_look(r, frame, pair, &site_from_vehicle, q, error));
    if (r->stopped) return TD_OK;
    TD_TRY(look_given(&seen, r->look, pair, &site_from_vehicle, q, (double)r->looks, error));
    r->look_s += seen.match_s + seen.fuse_s;
    judge(r, &seen);
    if (!first) return TD_OK;
    keep(r);
    return r->stopped ? TD_OK : check_rig(r, error);
}

static td_status one(rehearse *r, const td_pose *site_from_vehicle, const double *q, bool first,
                     td_error *error)
{
    look_result seen;
    if (r->stopped) return TD_OK;
    r->looks++;
    if (r->setup->truth.dark_look && r->looks >= r->setup->truth.dark_look)
        look_view(r->look)->gain = DARK_GAIN;
    for (int k = 0; k < r->scenario.robot->joint_count; k++) r->scene->scene.q[k] = q[k] - r->truth.zero[k];
    r->scene->scene.site_from_vehicle = *site_from_vehicle;
    if (!td_progress_report(r->progress, "looking", (size_t)r->looks, (size_t)r->looks + 1))
        return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(look_now(&seen, r->look, site_from_vehicle, q, NULL, (uint64_t)r->looks, (double)r->looks, error));
    r->look_s += seen.match_s + seen.fuse_s;
    judge(r, &seen);
    if (!first) return TD_OK;
    keep(r);
    return r->stopped ? TD_OK : check_rig(r, error);
}

static td_status take_map(rehearse *r, td_error *error)
{
    td_elevation_free(&r->map);
    return look_map(&r->map, r->look, error);
}

static td_status make_look(rehearse *r, td_error *error)
{
    const station_ground *g = &r->scenario.ground;
    look_options o = look_options_default();
    o.view = td_view_options_of_scene(&r->scene->image);
    o.view.seed = r->seed;
    o.view.threads = o.dense.threads = o.fusion.threads = r->threads;
    o.fusion.cell_m = g->cell_m;
    if (g->has_region) memcpy(o.fusion.region, g->region, sizeof g->region);
    for (int k = 0; k < TD_ROBOT_MAX_JOINTS; k++) r->sigma_q[k] = r->setup->truth.joint_sigma_rad;
    o.sigma_q = r->sigma_q;
    return look_new(&r->look, &r->scene->scene, r->rig_true, r->rig, r->scene->mount_link, &o, error);
}

td_status rehearse_look_first(rehearse *r, td_error *error)
{
    const int count = (int)r->scene->frame_count;
    const int last = r->setup->last < 0 ? count - 1 : r->setup->last;
    if (last >= count)
        return td_fail(error, TD_ERROR_DATA, "%s: look.before: the scene has %d frames only", r->setup->path,
                       count);
    td_pose unused;
    td_scene_pose(r->scene, (size_t)r->setup->first, &unused);
    TD_TRY(make_look(r, error));
    for (int i = r->setup->first; i <= last && !r->stopped; i++)
        TD_TRY(r->far ? one_there(r, i, true, error)
                      : one(r, &r->scene->frame[i].site_from_vehicle, r->scene->frame[i].q, true, error));
    return r->stopped ? TD_OK : take_map(r, error);
}

/* ---- again ---- */

static const double LEAST_SCATTER_M = 0.03;
static const double AROUND_M = 0.3; /* what moved soil may reach beyond where it was predicted */
static const double OTHER = 3;      /* sigma: what is seen is not what was known */

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Cells where soil was moved since the last look, and those around. */
static td_status find_worked(bool **worked, const td_elevation *predicted, td_error *error)
{
    const int columns = predicted->columns, rows = predicted->rows;
    const int reach = (int)ceil(AROUND_M / predicted->cell_m);
    bool *found = *worked = calloc((size_t)columns * (size_t)rows, sizeof *found);
    if (!found) return td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    for (int row = 0; row < rows; row++)
        for (int c = 0; c < columns; c++) {
            if (predicted->provenance[(size_t)row * (size_t)columns + (size_t)c] != TD_CELL_SIMULATED)
                continue;
            for (int y = row - reach; y <= row + reach; y++)
                for (int x = c - reach; x <= c + reach; x++)
                    if (x >= 0 && y >= 0 && x < columns && y < rows)
                        found[(size_t)y * (size_t)columns + (size_t)x] = true;
        }
    return TD_OK;
}

static void copy_cell(td_elevation *to, const td_elevation *from, size_t i)
{
    to->height[i] = from->height[i];
    to->sigma[i] = from->sigma[i];
    to->count[i] = from->count[i];
    to->provenance[i] = from->provenance[i];
    to->time_s[i] = from->time_s[i];
}

/* What the prediction is off where it moved soil and the ground is seen: two thirds are less, for at the
 * trench's walls a cell more or less is half a metre. */
static td_status scatter(rehearse *r, const td_elevation *recent, const td_elevation *predicted,
                         td_error *error)
{
    const size_t cells = (size_t)recent->columns * (size_t)recent->rows;
    double *off = malloc(cells * sizeof *off);
    size_t seen = 0;
    if (!off) return td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    for (size_t i = 0; i < cells; i++) {
        const double d = (double)recent->height[i] - (double)predicted->height[i];
        if (predicted->provenance[i] == TD_CELL_SIMULATED && !isnan(d)) off[seen++] = fabs(d);
    }
    qsort(off, seen, sizeof *off, by_value);
    r->scatter_m = fmax(LEAST_SCATTER_M, seen ? off[(size_t)(0.68 * (double)seen)] : 0);
    free(off);
    return TD_OK;
}

/* Beside a cell that is not seen a step is seen in part only, its upper one: as if nothing had been. */
static void leave_out_edges(td_elevation *recent, const bool *worked)
{
    static const float UNSEEN = -1;
    const int columns = recent->columns, rows = recent->rows;
    for (int row = 1; row < rows - 1; row++)
        for (int c = 1; c < columns - 1; c++) {
            const size_t i = (size_t)row * (size_t)columns + (size_t)c;
            bool beside = false;
            for (int k = 0; k < 9 && worked[i] && !isnan(recent->height[i]); k++) {
                const size_t at = (size_t)(row + k / 3 - 1) * (size_t)columns + (size_t)(c + k % 3 - 1);
                beside |= isnan(recent->height[at]);
            }
            if (beside) recent->sigma[i] = UNSEEN;
        }
    for (size_t i = 0; i < (size_t)columns * (size_t)rows; i++)
        if (recent->sigma[i] == UNSEEN) {
            recent->height[i] = recent->sigma[i] = NAN;
            recent->count[i] = 0;
            recent->provenance[i] = TD_CELL_UNKNOWN;
        }
}

/* A cell on a step may be as high as the ground on either side, and no higher: its sigma, which stands for
 * both, is no more than that of a height anywhere between them. */
static void bound_steps(td_elevation *recent, const bool *worked)
{
    enum { REACH = 2, SIDE = 2 * REACH + 1 };
    static const float LEAST_M = 0.05F;
    const int columns = recent->columns, rows = recent->rows;
    for (int row = REACH; row < rows - REACH; row++)
        for (int c = REACH; c < columns - REACH; c++) {
            const size_t i = (size_t)row * (size_t)columns + (size_t)c;
            float low = recent->height[i], high = low;
            if (!worked[i] || !(recent->sigma[i] > LEAST_M)) continue;
            for (int k = 0; k < SIDE * SIDE; k++) {
                const size_t at =
                    (size_t)(row + k / SIDE - REACH) * (size_t)columns + (size_t)(c + k % SIDE - REACH);
                low = fminf(low, recent->height[at]);
                high = fmaxf(high, recent->height[at]);
            }
            recent->sigma[i] = fminf(recent->sigma[i], fmaxf(LEAST_M, (high - low) / sqrtf(12)));
        }
}

/* The ground as it is known now: where soil was moved, as it was seen since, for what was seen before is no
 * more; elsewhere as it was known, unless what is seen now is something else. What the cameras cannot see, as
 * the ground behind a wall of the trench, is taken as it was predicted, with that as its sigma. */
static void compose(rehearse *r, const td_elevation *recent, const td_elevation *predicted,
                    const bool *worked)
{
    td_elevation *m = r->map;
    const size_t cells = (size_t)m->columns * (size_t)m->rows;
    for (size_t i = 0; i < cells; i++) {
        const double off = (double)recent->height[i] - (double)m->height[i];
        const double sigma = hypot((double)recent->sigma[i], (double)m->sigma[i]);
        if (!isnan(recent->height[i]) && (worked[i] || !(fabs(off) <= OTHER * sigma))) {
            copy_cell(m, recent, i);
        } else if (worked[i] && !isnan(predicted->height[i])) {
            const bool moved = predicted->provenance[i] == TD_CELL_SIMULATED;
            copy_cell(m, predicted, i);
            if (moved || isnan(m->sigma[i])) m->sigma[i] = (float)r->scatter_m;
        }
    }
}

static td_status take_map_again(rehearse *r, td_error *error)
{
    const td_elevation *predicted = r->round[r->round_count - 1].ahead.after;
    td_elevation *recent = NULL;
    bool *worked = NULL;
    TD_TRY(look_map(&recent, r->look, error));
    td_status status = find_worked(&worked, predicted, error);
    if (status == TD_OK) leave_out_edges(recent, worked);
    if (status == TD_OK) bound_steps(recent, worked);
    if (status == TD_OK) status = scatter(r, recent, predicted, error);
    if (status == TD_OK) compose(r, recent, predicted, worked);
    r->looked = r->round_count;
    free(worked);
    td_elevation_free(&recent);
    return status;
}

void rehearse_show_stones(rehearse *r)
{
    td_elevation *g = r->scene->scene.ground;
    for (int i = 0; i < r->truth.ground.stone_count; i++) {
        const td_world_stone *stone = r->truth.ground.stone + i;
        const double radius = stone->shape.size[0];
        td_pose at = stone->shape.link_from_shape;
        if (r->station && !station_stone(&at, r->station, i)) continue;
        for (int row = 0; row < g->rows; row++)
            for (int c = 0; c < g->columns; c++) {
                float *z = g->height + (size_t)row * (size_t)g->columns + (size_t)c;
                const double off =
                    hypot(g->origin[0] + c * g->cell_m - at.t[0], g->origin[1] + row * g->cell_m - at.t[1]);
                if (off < radius) *z = fmaxf(*z, (float)(at.t[2] + sqrt(radius * radius - off * off)));
            }
    }
}

/* The scene's ground becomes what the machine has made of it. */
static td_status change_ground(rehearse *r, td_error *error)
{
    td_elevation *ground = r->scene->scene.ground;
    const td_elevation *now = NULL;
    TD_TRY(station_map(&now, r->station, error));
    memcpy(ground->height, now->height,
           (size_t)ground->columns * (size_t)ground->rows * sizeof *ground->height);
    rehearse_show_stones(r);
    look_ground_changed(r->look, 0, 0, ground->columns, ground->rows);
    return TD_OK;
}

td_status rehearse_look_again(rehearse *r, td_error *error)
{
    TD_TRY(look_anew(r->look, error));
    for (int i = 0; i < r->setup->pose_count && !r->stopped; i++) {
        TD_TRY(rehearse_move(r, r->setup->pose[i], error));
        if (r->stopped) return TD_OK;
        if (!r->far) TD_TRY(change_ground(r, error));
        for (int k = 0; k < r->setup->frames && !r->stopped; k++)
            TD_TRY(r->far ? one_there(r, -1, k == 0, error)
                          : one(r, &r->state.site_from_vehicle, r->state.q, k == 0, error));
    }
    return r->stopped ? TD_OK : take_map_again(r, error);
}
