/* From views to a start for the joint problem: every camera alone, then the cameras relative to one another.
 *
 * A view's labelling can be off by a turn of the board (a symmetric grid, or a numbering by hand), and a file
 * list can swap two cameras' images. Either shows as a relative pose that disagrees with the other views':
 * the relative pose is therefore the one on which most views agree, over all turns, and the views that
 * disagree are explained or dropped. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/calibrate_internal.h"
#include "core/parallel.h"

/* ---- one camera alone ---- */

typedef struct mono {
    td_bundle bundle; /* only this camera's points are used */
    td_status status;
    td_error error;
    double rms;
} mono;

typedef struct mono_work {
    mono *mono; /* (cameras) */
    const td_calibrate_options *options;
} mono_work;

static size_t views_in_use(const td_bundle *bundle, int camera)
{
    size_t views = 0;
    for (size_t v = 0; v < bundle->observations->view_count; v++)
        views += td_bundle_used(bundle, v, camera) > 0;
    return views;
}

static double view_rms(const td_bundle *bundle, size_t view, int camera)
{
    size_t points = td_target_point_count(&bundle->observations->target), n = 0;
    double sum = 0, r[2];
    for (size_t p = 0; p < points; p++) {
        if (!bundle->used[td_bundle_index(bundle, view, camera, p)]) continue;
        if (!td_bundle_residual(r, bundle, view, camera, p)) return INFINITY;
        sum += r[0] * r[0] + r[1] * r[1];
        n++;
    }
    return n ? sqrt(sum / (double)n) : 0;
}

/* The other pose at which a small plane looks nearly the same: its normal mirrored at the line of sight to
 * its centre (Schweighofer and Pinz 2006). A view can settle in the wrong one of the two. */
static td_pose mirrored_pose(const td_pose *camera_from_target, const td_target *target)
{
    double centre[3], sight[3], normal[3], axis[3], first[3], last[3];
    const double z[3] = {0, 0, 1};
    td_target_point(first, target, 0);
    td_target_point(last, target, td_target_point_count(target) - 1);
    for (int i = 0; i < 3; i++) centre[i] = (first[i] + last[i]) / 2;
    td_pose_transform(sight, camera_from_target, centre);
    td_pose_rotate(normal, camera_from_target, z);
    double length = sqrt(sight[0] * sight[0] + sight[1] * sight[1] + sight[2] * sight[2]);
    for (int i = 0; i < 3; i++)
        axis[i] =
            (normal[(i + 1) % 3] * sight[(i + 2) % 3] - normal[(i + 2) % 3] * sight[(i + 1) % 3]) / length;
    double s = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    double c = (normal[0] * sight[0] + normal[1] * sight[1] + normal[2] * sight[2]) / length,
           angle = 2 * atan2(s, c);
    if (!(s > 0)) return *camera_from_target;
    /* Turn about the centre: p -> R (p - sight) + sight. */
    double omega[3], moved[3];
    for (int i = 0; i < 3; i++) omega[i] = axis[i] / s * angle;
    td_pose turn = td_pose_identity();
    td_rotation_exp(turn.q, omega);
    td_pose_rotate(moved, &turn, sight);
    for (int i = 0; i < 3; i++) turn.t[i] = sight[i] - moved[i];
    return td_pose_compose(&turn, camera_from_target);
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Tries the mirrored pose for views that fit worse than the others; true when one was taken. */
static bool unmirror(td_bundle *bundle, int camera)
{
    size_t views = bundle->observations->view_count, n = 0;
    double *rms = malloc((views + 1) * sizeof *rms);
    bool changed = false;
    if (!rms || bundle->observations->target.plane_count > 1 ||
        !td_target_is_flat(&bundle->observations->target)) {
        free(rms);
        return false;
    }
    for (size_t v = 0; v < views; v++)
        if (td_bundle_used(bundle, v, camera)) rms[n++] = view_rms(bundle, v, camera);
    qsort(rms, n, sizeof *rms, compare_doubles);
    double limit = n ? 1.5 * rms[(n - 1) / 2] : 0;
    free(rms);
    for (size_t v = 0; v < views; v++) {
        double before = td_bundle_used(bundle, v, camera) ? view_rms(bundle, v, camera) : 0;
        if (!(before > limit) || !isnan(bundle->observations->height_m[v])) continue;
        td_pose *pose = &bundle->rig_from_target[bundle->pose_of_view[v]], kept = *pose;
        *pose = mirrored_pose(pose, &bundle->observations->target);
        if (td_bundle_solve_view(bundle, v, NULL, NULL) == TD_OK && view_rms(bundle, v, camera) < before)
            changed = true;
        else
            *pose = kept;
    }
    return changed;
}

/* Negative focal lengths with the scene turned by half about the axis give the same images: back to positive
 * ones. */
static void make_upright(td_bundle *bundle, int camera)
{
    td_camera *c = &bundle->rig->camera[camera].camera;
    if (!(c->parameter[0] < 0 && c->parameter[1] < 0)) return;
    for (int i = 0; i < 2; i++) c->parameter[i] = -c->parameter[i];
    if (c->model == TD_CAMERA_BROWN5 || c->model == TD_CAMERA_BROWN8) {
        c->parameter[6] = -c->parameter[6]; /* p1, p2: the only terms that are even */
        c->parameter[7] = -c->parameter[7];
    }
    const td_pose half_turn = {{0, 0, 0, 1}, {0, 0, 0}};
    for (size_t i = 0; i < bundle->pose_count; i++)
        bundle->rig_from_target[i] = td_pose_compose(&half_turn, &bundle->rig_from_target[i]);
}

/* Plain least squares, then a robust pass where the residuals' tail asks for it. */
static td_status mono_refine(mono *m, int camera, const td_calibrate_options *options, td_error *error)
{
    td_solve_options solve = td_solve_options_default();
    /* A start for the joint solve needs no more digits than this. */
    solve.function_tolerance = 1e-7;
    solve.max_iterations = 50;
    TD_TRY(td_bundle_solve(&m->bundle, NULL, NULL, &solve, error));
    make_upright(&m->bundle, camera);
    for (int round = 0; round < 3 && unmirror(&m->bundle, camera); round++)
        TD_TRY(td_bundle_solve(&m->bundle, NULL, NULL, &solve, error));
    size_t points;
    m->rms = sqrt(td_bundle_square_sum(&m->bundle, camera, &points) / (double)(points ? points : 1));
    double noise = td_robust_noise(&m->bundle, camera);
    if (options->plain || !(m->rms > 2 * noise)) return TD_OK;
    const td_loss loss = {TD_LOSS_CAUCHY, fmax(3 * noise, 0.05), 2};
    TD_TRY(td_bundle_solve(&m->bundle, &loss, NULL, &solve, error));
    m->rms = sqrt(td_bundle_square_sum(&m->bundle, camera, &points) / (double)(points ? points : 1));
    return TD_OK;
}

static td_status mono_start(mono *m, int camera, const td_calibrate_options *options, td_error *error)
{
    const td_observations *o = m->bundle.observations;
    td_camera *c = &m->bundle.rig->camera[camera].camera;
    bool *has_pose = calloc(o->view_count + 1, sizeof *has_pose);
    td_pose *pose = malloc((o->view_count + 1) * sizeof *pose);
    td_status status = TD_OK;
    bool keep = options->known && (options->hold[camera] & TD_HOLD_INTRINSICS);
    if (!has_pose || !pose)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", o->view_count);
    else
        status = td_first_estimate(c, pose, has_pose, o, camera, options->method, keep, error);
    for (size_t v = 0; v < o->view_count && status == TD_OK; v++) {
        if (has_pose[v])
            m->bundle.rig_from_target[m->bundle.pose_of_view[v]] = pose[v];
        else
            td_bundle_drop(&m->bundle, v, camera);
    }
    free(has_pose);
    free(pose);
    return status;
}

static void mono_run(size_t index, void *user)
{
    mono_work *work = user;
    mono *m = &work->mono[index];
    int camera = (int)index;
    if (!views_in_use(&m->bundle, camera)) return;
    m->status = mono_start(m, camera, work->options, &m->error);
    if (m->status == TD_OK) m->status = mono_refine(m, camera, work->options, &m->error);
}

static td_status run_monos(mono *monos, const td_bundle *bundle, const td_calibrate_options *options,
                           td_error *error)
{
    int cameras = bundle->rig->count;
    for (int c = 0; c < cameras; c++) {
        TD_TRY(td_bundle_copy(&monos[c].bundle, bundle, error));
        for (int other = 0; other < cameras; other++) {
            if (other == c) continue;
            for (size_t v = 0; v < bundle->observations->view_count; v++)
                td_bundle_drop(&monos[c].bundle, v, other);
        }
        monos[c].bundle.rig->camera[c].camera_from_rig = td_pose_identity();
        monos[c].bundle.hold[c] |= TD_HOLD_POSE;
    }
    mono_work work = {monos, options};
    TD_TRY(td_parallel_for((size_t)cameras, options->threads, mono_run, &work, NULL, NULL));
    for (int c = 0; c < cameras; c++)
        if (monos[c].status != TD_OK) {
            if (error) *error = monos[c].error;
            return td_error_prefix(error, monos[c].status, "camera %s", bundle->rig->camera[c].name);
        }
    return TD_OK;
}

/* ---- turns of the board ---- */

/* px by which a turned labelling must explain a view better than the given one, besides halving the
 * disagreement. */
#define CLEARLY 1.0

/* How many turns map the grid onto itself: 4, 2, or 1 when there are several planes or the points are
 * numbered. */
static int turn_count(const td_target *target)
{
    if (target->plane_count != 1 || td_target_tag_count(target)) return 1;
    return target->plane[0].columns == target->plane[0].rows ? 4 : 2;
}

/* The motion of the board by `turn` of its turns about its centre. */
static td_pose turn_motion(const td_target *target, int turn)
{
    const double quarter = 1.57079632679489661923;
    double angle = (turn_count(target) == 4 ? turn : 2 * turn) * quarter;
    double w = (target->plane[0].columns - 1) * target->plane[0].spacing_m;
    double h = (target->plane[0].rows - 1) * target->plane[0].spacing_m;
    const double omega[3] = {0, 0, angle}, centre[3] = {w / 2, h / 2, 0};
    td_pose motion = {{1, 0, 0, 0}, {0, 0, 0}};
    double moved[3];
    td_rotation_exp(motion.q, omega);
    td_pose_rotate(moved, &motion, centre);
    for (int i = 0; i < 3; i++) motion.t[i] = centre[i] - moved[i];
    return motion;
}

/* Point `index` is moved onto this point by the turn. */
static size_t turn_index(const td_target *target, int turn, size_t index)
{
    size_t columns = (size_t)target->plane[0].columns, rows = (size_t)target->plane[0].rows;
    size_t x = index % columns, y = index / columns;
    if (turn_count(target) == 2) return turn ? columns * rows - 1 - index : index;
    for (int i = 0; i < turn; i++) {
        size_t old = x;
        x = columns - 1 - y;
        y = old;
    }
    return y * columns + x;
}

static void turn_detection(td_detection *d, const td_target *target, int turn)
{
    double *point = malloc(2 * d->count * sizeof *point), *sigma = malloc(d->count * sizeof *sigma);
    if (point && sigma) {
        for (size_t i = 0; i < d->count; i++) {
            size_t k = turn_index(target, turn, i);
            point[2 * k] = d->point[2 * i];
            point[2 * k + 1] = d->point[2 * i + 1];
            sigma[k] = d->sigma[i];
        }
        memcpy(d->point, point, 2 * d->count * sizeof *point);
        memcpy(d->sigma, sigma, d->count * sizeof *sigma);
    }
    free(point);
    free(sigma);
}

/* ---- relative poses ---- */

/* Largest distance (px) between where camera `c` sees the board's outer corners at two poses. */
static double disagreement(const td_camera *c, const td_target *target, const td_pose *a, const td_pose *b)
{
    size_t columns = (size_t)target->plane[0].columns, count = td_target_point_count(target);
    if (td_target_tag_count(target)) columns = count / 3; /* numbered otherwise: some points that lie apart */
    const size_t corner[4] = {0, columns - 1, count - columns, count - 1};
    double worst = 0;
    for (int i = 0; i < 4; i++) {
        double p[3], x[3], u[2], v[2];
        td_target_point(p, target, corner[i]);
        td_pose_transform(x, a, p);
        if (!td_camera_project(u, NULL, NULL, c, x)) return 1e6;
        td_pose_transform(x, b, p);
        if (!td_camera_project(v, NULL, NULL, c, x)) return 1e6;
        worst = fmax(worst, hypot(u[0] - v[0], u[1] - v[1]));
    }
    return fmin(worst, 1e6);
}

/* Two cameras and the views that both saw. */
typedef struct pair {
    int base, camera;
    const mono *monos;
    const td_target *target;
    size_t *view, count;
} pair;

static const td_pose *pose_in(const pair *p, int camera, size_t view)
{
    const td_bundle *b = &p->monos[camera].bundle;
    return &b->rig_from_target[b->pose_of_view[view]];
}

/* camera_from_base as view `v` has it, its points in the camera turned by `turn`. */
static td_pose relative_of_view(const pair *p, size_t v, int turn)
{
    td_pose motion = turn_motion(p->target, turn), back = td_pose_inverse(&motion);
    td_pose turned = td_pose_compose(pose_in(p, p->camera, v), &back);
    td_pose target_from_base = td_pose_inverse(pose_in(p, p->base, v));
    return td_pose_compose(&turned, &target_from_base);
}

/* How far view `v` disagrees with a relative pose, px, and by which turn of the board least. */
static double view_disagreement(int *turn, const pair *p, size_t v, const td_pose *camera_from_base)
{
    const td_camera *c = &p->monos[p->camera].bundle.rig->camera[p->camera].camera;
    td_pose expected = td_pose_compose(camera_from_base, pose_in(p, p->base, v));
    double best = INFINITY;
    *turn = 0;
    for (int k = 0; k < turn_count(p->target); k++) {
        td_pose motion = turn_motion(p->target, k), back = td_pose_inverse(&motion);
        td_pose turned = td_pose_compose(pose_in(p, p->camera, v), &back);
        double d = disagreement(c, p->target, &expected, &turned);
        if (d < (k ? best / 2 - CLEARLY : best)) { /* as it was labelled, unless a turn is much better */
            best = d;
            *turn = k;
        }
    }
    return best;
}

/* The relative pose with the smallest median disagreement over the views, and that median. */
static double consensus(td_pose *camera_from_base, const pair *p, double *scratch)
{
    enum { MOST_CANDIDATES = 60 };
    size_t step = (p->count + MOST_CANDIDATES - 1) / MOST_CANDIDATES;
    double best = INFINITY;
    for (int turn = 0; turn < turn_count(p->target); turn++)
        for (size_t i = 0; i < p->count; i += step) {
            td_pose candidate = relative_of_view(p, p->view[i], turn);
            int unused;
            for (size_t k = 0; k < p->count; k++)
                scratch[k] = view_disagreement(&unused, p, p->view[k], &candidate);
            qsort(scratch, p->count, sizeof *scratch, compare_doubles);
            double median = scratch[(p->count - 1) / 2] + 1e-3 * scratch[p->count / 2];
            if (median < (turn ? best / 2 - CLEARLY : best)) {
                best = median;
                *camera_from_base = candidate;
            }
        }
    return best;
}

/* Explains the views that disagree: a turned board is put right, anything else is left out; both are named.
 */
static void explain(const pair *p, const td_pose *camera_from_base, double median, td_bundle *bundle,
                    td_observations *observations, td_calibration *result)
{
    const char *base = bundle->rig->camera[p->base].name, *camera = bundle->rig->camera[p->camera].name;
    double limit = fmax(8 * median, 0.01 * bundle->rig->camera[p->camera].camera.width);
    for (size_t i = 0; i < p->count; i++) {
        size_t v = p->view[i];
        td_calibrated_view *view = &result->view[v];
        int turn;
        double d = view_disagreement(&turn, p, v, camera_from_base);
        if (d <= limit) {
            if (!turn) continue;
            turn_detection(td_observations_get(observations, v, p->camera), p->target, turn);
            view->state = TD_VIEW_CORRECTED;
            snprintf(view->remark, sizeof view->remark,
                     "the points of %s were numbered with the board turned by %d degrees against %s; the "
                     "numbering was "
                     "put right",
                     camera, turn_count(p->target) == 4 ? 90 * turn : 180, base);
            continue;
        }
        view->state = TD_VIEW_OUTLIER;
        td_pose found = relative_of_view(p, v, 0), swapped = td_pose_inverse(&found);
        const td_camera *c = &p->monos[p->camera].bundle.rig->camera[p->camera].camera;
        td_pose in_base = *pose_in(p, p->base, v), expected = td_pose_compose(camera_from_base, &in_base);
        td_pose other = td_pose_compose(&swapped, &in_base);
        if (disagreement(c, p->target, &expected, &other) < 0.5 * d)
            snprintf(view->remark, sizeof view->remark,
                     "the images of %s and %s look swapped: exchange them in frames.csv", base, camera);
        else
            snprintf(view->remark, sizeof view->remark,
                     "%s and %s disagree on where the board is by %.0f px (all others by %.1f px): not taken "
                     "at the same "
                     "moment, or of another board",
                     base, camera, d, median);
        for (int k = 0; k < bundle->rig->count; k++) td_bundle_drop(bundle, v, k);
    }
}

static size_t shared_views(size_t *view, const mono *monos, int a, int b)
{
    size_t n = 0;
    for (size_t v = 0; v < monos[a].bundle.observations->view_count; v++)
        if (td_bundle_used(&monos[a].bundle, v, a) && td_bundle_used(&monos[b].bundle, v, b)) {
            if (view) view[n] = v;
            n++;
        }
    return n;
}

/* Ties each camera to one that is tied already and shares most views with it. */
static td_status tie_cameras(td_bundle *bundle, td_observations *observations, mono *monos,
                             td_calibration *result, const td_calibrate_options *options, td_error *error)
{
    int cameras = bundle->rig->count;
    bool tied[TD_RIG_MAX_CAMERAS] = {true};
    size_t *view = malloc((observations->view_count + 1) * sizeof *view);
    double *scratch = malloc((observations->view_count + 1) * sizeof *scratch);
    td_status status = TD_OK;
    if (!view || !scratch)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", observations->view_count);
    for (int round = 1; round < cameras && status == TD_OK; round++) {
        int base = -1, camera = -1;
        size_t most = 0;
        for (int a = 0; a < cameras; a++)
            for (int b = 0; b < cameras; b++) {
                size_t n = tied[a] && !tied[b] ? shared_views(NULL, monos, a, b) : 0;
                if (n > most) most = n, base = a, camera = b;
            }
        if (camera < 0) {
            for (camera = 0; tied[camera]; camera++) {
            }
            status = td_fail(
                error, TD_ERROR_DATA,
                "camera %s shares no view of the target with the others, so its place in the rig cannot be "
                "found: add views that it sees together with another camera",
                bundle->rig->camera[camera].name);
            break;
        }
        pair p = {base, camera, monos, &observations->target, view, shared_views(view, monos, base, camera)};
        td_pose camera_from_base;
        double median = consensus(&camera_from_base, &p, scratch);
        if (!options->plain) explain(&p, &camera_from_base, median, bundle, observations, result);
        td_rig_camera *c = &bundle->rig->camera[camera];
        if (!(bundle->hold[camera] & TD_HOLD_POSE))
            c->camera_from_rig =
                td_pose_compose(&camera_from_base, &bundle->rig->camera[base].camera_from_rig);
        tied[camera] = true;
    }
    free(view);
    free(scratch);
    return status;
}

td_status td_rig_start(td_bundle *bundle, td_observations *observations, td_calibration *result,
                       const td_calibrate_options *options, td_error *error)
{
    int cameras = bundle->rig->count;
    mono monos[TD_RIG_MAX_CAMERAS] = {0};
    td_status status = run_monos(monos, bundle, options, error);
    for (int c = 0; c < cameras && status == TD_OK; c++) {
        bundle->rig->camera[c].camera = monos[c].bundle.rig->camera[c].camera;
        result->camera[c].mono_rms_px = monos[c].rms;
        for (size_t v = 0; v < observations->view_count; v++)
            if (!td_bundle_used(&monos[c].bundle, v, c)) td_bundle_drop(bundle, v, c);
    }
    if (status == TD_OK) status = tie_cameras(bundle, observations, monos, result, options, error);

    /* Each view's pose from the first camera that saw it. */
    for (size_t v = 0; v < observations->view_count && status == TD_OK; v++)
        for (int c = 0; c < cameras; c++) {
            if (!td_bundle_used(bundle, v, c)) continue;
            td_pose rig_from_camera = td_pose_inverse(&bundle->rig->camera[c].camera_from_rig);
            size_t pose = bundle->pose_of_view[v];
            bundle->rig_from_target[pose] =
                td_pose_compose(&rig_from_camera, &monos[c].bundle.rig_from_target[pose]);
            break;
        }
    for (int c = 0; c < cameras; c++) td_bundle_free(&monos[c].bundle);
    return status;
}
