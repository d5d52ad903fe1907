/* Where the base stood in frames whose pose the table does not give.
 *
 * Tags on the site: least squares over all corners that both cameras see, in the cameras' whole model. The
 * errors of a tag's corners are those of finding them and, common to all four, that of where the tag is said
 * to stand: R = diag(sigma^2) + A S A^T. A tag that contradicts the others is left out. Else the ground
 * (recon/localisation.h), from where the last frame was. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "calib/tags.h"
#include "core/linalg.h"
#include "recon/localisation.h"

enum { SIDES = 2, CORNERS = 4, MOST_ROWS = SIDES * CORNERS * 2, STEPS = 30 };

static const double CONTRADICTS = 9; /* chi^2 per coordinate of a tag: 3 sigma each */
static const double LEAST_PX = 0.02; /* no corner is found better */
static const double AMBIGUOUS = 2;   /* RMS of the other pose over the best's */

const char *const reconstruct_place_name[] = {"given", "tags", "map", "unknown"};

/* ---- tags ---- */

typedef struct sights {
    const td_target *target;
    const td_camera *camera[SIDES];
    td_pose camera_from_rig[SIDES];
    td_detection seen[SIDES];
    double tag_sigma[2]; /* rad, m */
    bool used[TD_TARGET_MAX_TAGS];
} sights;

/* Residuals of a tag at the pose, their derivatives by its perturbation and by the tag's own. */
static size_t tag_rows(double *r, double *j, double *a, double *sigma, const sights *s, int tag,
                       const td_pose *rig_from_site)
{
    const td_pose *place = &s->target->tag[tag].target_from_tag;
    size_t rows = 0;
    for (int side = 0; side < SIDES; side++) {
        const td_pose camera_from_site = td_pose_compose(&s->camera_from_rig[side], rig_from_site);
        double turn[9];
        td_pose_rotation(turn, &camera_from_site);
        for (size_t k = 0; k < CORNERS; k++) {
            const size_t point = CORNERS * (size_t)tag + k;
            double p[3], x[3], pixel[2], by_x[6], by_p[6], lever[18], arm[3];
            if (!(s->seen[side].sigma[point] > 0)) continue;
            td_target_point(p, s->target, point);
            td_pose_transform(x, &camera_from_site, p);
            if (!td_camera_project(pixel, by_x, NULL, s->camera[side], x)) continue;
            td_multiply(by_p, by_x, turn, 2, 3, 3);
            td_pose_transform_jacobian(lever, p);
            td_multiply(j + 6 * rows, by_p, lever, 2, 3, 6);
            for (int i = 0; i < 12; i++) j[6 * rows + (size_t)i] *= -1; /* the site moves the other way */
            for (int i = 0; i < 3; i++) arm[i] = p[i] - place->t[i];
            td_pose_transform_jacobian(lever, arm);
            td_multiply(a + 6 * rows, by_p, lever, 2, 3, 6);
            for (int c = 0; c < 2; c++) {
                r[rows] = s->seen[side].point[2 * point + (size_t)c] - pixel[c];
                sigma[rows++] = fmax(s->seen[side].sigma[point], LEAST_PX);
            }
        }
    }
    return rows;
}

/* Adds a tag to the normal equations; its chi^2 over its coordinates in *fit. False: not seen. */
static bool add_tag(double n[36], double b[6], double *chi2, double *rows, const sights *s, int tag,
                    const td_pose *rig_from_site)
{
    double r[MOST_ROWS], j[6 * MOST_ROWS], a[6 * MOST_ROWS], sigma[MOST_ROWS], w[MOST_ROWS * MOST_ROWS];
    double wr[MOST_ROWS];
    const size_t count = tag_rows(r, j, a, sigma, s, tag, rig_from_site);
    if (!count) return false;
    for (size_t u = 0; u < count; u++)
        for (size_t v = 0; v < count; v++) {
            double sum = u == v ? sigma[u] * sigma[u] : 0;
            for (size_t k = 0; k < 6; k++)
                sum += a[6 * u + k] * a[6 * v + k] * s->tag_sigma[k / 3] * s->tag_sigma[k / 3];
            w[u * count + v] = sum;
        }
    if (td_invert_spd(w, w, count, NULL) != TD_OK) return false;
    td_multiply(wr, w, r, count, count, 1);
    *chi2 = 0;
    *rows = (double)count;
    for (size_t u = 0; u < count; u++) {
        *chi2 += r[u] * wr[u];
        for (size_t k = 0; k < 6; k++) {
            b[k] += j[6 * u + k] * wr[u];
            for (size_t v = 0; v < count; v++)
                for (size_t l = 0; l < 6; l++) n[6 * k + l] += j[6 * u + k] * w[u * count + v] * j[6 * v + l];
        }
    }
    return true;
}

/* chi^2 of all tags in use, the worst of them per coordinate, and the normal equations. */
static double evaluate(double n[36], double b[6], double *rows, int *worst, double *worst_fit,
                       const sights *s, const td_pose *site_from_rig)
{
    const td_pose rig_from_site = td_pose_inverse(site_from_rig);
    double sum = 0, chi2, count;
    memset(n, 0, 36 * sizeof *n);
    memset(b, 0, 6 * sizeof *b);
    *rows = *worst_fit = 0;
    for (int t = 0; t < s->target->tag_count; t++) {
        if (!s->used[t] || !add_tag(n, b, &chi2, &count, s, t, &rig_from_site)) continue;
        sum += chi2;
        *rows += count;
        if (chi2 / count > *worst_fit) {
            *worst_fit = chi2 / count;
            *worst = t;
        }
    }
    return sum;
}

/* Gauss and Newton with damping; false: no minimum. */
static bool minimise(td_pose *pose, const sights *s)
{
    double n[36], b[6], rows, fit, lambda = 1e-4;
    int worst = 0;
    double now = evaluate(n, b, &rows, &worst, &fit, s, pose);
    for (int i = 0; i < STEPS && rows >= 6 && lambda < 1e8; i++) {
        double damped[36], inverse[36], xi[6], other_n[36], other_b[6];
        memcpy(damped, n, sizeof n);
        for (int k = 0; k < 6; k++) damped[7 * k] *= 1 + lambda;
        if (td_invert_spd(inverse, damped, 6, NULL) != TD_OK) return false;
        td_multiply(xi, inverse, b, 6, 6, 1);
        const td_pose next = td_pose_perturb(pose, xi);
        const double then = evaluate(other_n, other_b, &rows, &worst, &fit, s, &next);
        if (!(then <= now)) {
            lambda *= 10;
            continue;
        }
        const bool done = now - then <= 1e-10 * now;
        *pose = next;
        now = then;
        memcpy(n, other_n, sizeof n);
        memcpy(b, other_b, sizeof b);
        lambda *= 0.1;
        if (done) break;
    }
    return rows >= 6;
}

/* The pose that one tag alone gives: of all seen by one camera, the surest about its tilt. */
static bool first_pose(td_pose *site_from_rig, double *ratio, const sights *s)
{
    bool any = false;
    *ratio = 0;
    for (int side = 0; side < SIDES; side++)
        for (int t = 0; t < s->target->tag_count; t++) {
            const td_target_tag *known = &s->target->tag[t];
            td_tag tag = {.id = known->id};
            td_pose camera_from_tag;
            double how;
            for (size_t k = 0; k < CORNERS; k++) {
                tag.sigma[k] = s->seen[side].sigma[CORNERS * (size_t)t + k];
                memcpy(tag.corner + 2 * k, s->seen[side].point + 2 * (CORNERS * (size_t)t + k),
                       2 * sizeof(double));
            }
            if (!s->used[t] || !(tag.sigma[0] > 0) ||
                !td_tag_pose(&camera_from_tag, NULL, &how, &tag, known->size_m, s->camera[side]) ||
                how < *ratio)
                continue;
            *ratio = how;
            const td_pose tag_from_camera = td_pose_inverse(&camera_from_tag);
            const td_pose site_from_camera = td_pose_compose(&known->target_from_tag, &tag_from_camera);
            *site_from_rig = td_pose_compose(&site_from_camera, &s->camera_from_rig[side]);
            any = true;
        }
    return any;
}

/* Sigma about the rig's own place from the covariance in the site: a point c moves by omega x c + tau. */
static void sigma_at(double sigma[6], const double covariance[36], const double c[3])
{
    const double a[36] = {1, 0,    0,     0, 0, 0, 0,     1, 0,    0, 0, 0, 0,    0,     1, 0, 0, 0,
                          0, c[2], -c[1], 1, 0, 0, -c[2], 0, c[0], 0, 1, 0, c[1], -c[0], 0, 0, 0, 1};
    double s[36];
    memset(sigma, 0, 6 * sizeof *sigma);
    if (td_sandwich(s, a, covariance, 6, 6, NULL) != TD_OK) return;
    for (int k = 0; k < 6; k++) sigma[k] = sqrt(fmax(s[7 * k], 0));
}

static td_status solve(reconstruct_frame *f, sights *s, td_error *error)
{
    double n[36], b[6], rows, fit, ratio;
    int worst = 0, tags = 0;
    td_pose pose;
    if (!first_pose(&pose, &ratio, s)) return td_fail(error, TD_ERROR_DATA, "it sees no tag of the site");
    for (;;) {
        tags = 0;
        for (int t = 0; t < s->target->tag_count; t++) tags += s->used[t];
        if (!minimise(&pose, s)) return td_fail(error, TD_ERROR_DATA, "the tags that it sees give no pose");
        const double chi2 = evaluate(n, b, &rows, &worst, &fit, s, &pose);
        if (fit > CONTRADICTS && tags > 2) {
            s->used[worst] = false;
            if (!first_pose(&pose, &ratio, s))
                return td_fail(error, TD_ERROR_DATA, "its tags contradict each other");
            continue;
        }
        if (fit > CONTRADICTS)
            return td_fail(
                error, TD_ERROR_DATA,
                "tag %d of the site lies %.1f sigma from where it is said to stand: check its place and "
                "size in site_tags, and the rig",
                s->target->tag[worst].id, sqrt(fit));
        const double scale = fmax(1, chi2 / fmax(rows - 6, 1));
        if (td_invert_spd(f->pose_covariance, n, 6, error) != TD_OK) return TD_ERROR_DATA;
        for (int k = 0; k < 36; k++) f->pose_covariance[k] *= scale;
        break;
    }
    if (tags == 1 && ratio < AMBIGUOUS && rows <= CORNERS * 2)
        return td_fail(error, TD_ERROR_DATA,
                       "the one tag that it sees may be tilted either way: it is too far off");
    f->site_from_rig = pose;
    f->place = PLACE_TAGS;
    sigma_at(f->pose_sigma, f->pose_covariance, pose.t);
    return TD_OK;
}

static td_status look_for_tags(sights *s, int side, reconstruct_job *work, const char *path, td_error *error)
{
    const td_rig_camera *c = &work->rig->camera[work->how->camera[side]];
    td_image *image = NULL;
    double time_s;
    s->camera[side] = &c->camera;
    s->camera_from_rig[side] = c->camera_from_rig;
    TD_TRY(reconstruct_image_read(&image, &time_s, &work->video[side], path, 1, error));
    td_status status = td_tags_detect(&s->seen[side], image, s->target, error);
    td_image_free(&image);
    for (size_t k = 0; status == TD_OK && k < s->seen[side].count; k++)
        s->used[k / CORNERS] |= s->seen[side].sigma[k] > 0;
    return status;
}

static td_status by_tags(reconstruct_job *work, reconstruct_frame *f, td_error *error)
{
    sights s = {.target = &work->dataset->site_tags,
                .tag_sigma = {work->dataset->site_tags_sigma_rad, work->dataset->site_tags_sigma_m}};
    td_status status = TD_OK;
    for (int side = 0; side < SIDES && status == TD_OK; side++)
        status = look_for_tags(&s, side, work, f->image[side], error);
    if (status == TD_OK) status = solve(f, &s, error);
    for (int side = 0; side < SIDES; side++) td_detection_free(&s.seen[side]);
    return status;
}

/* ---- ground ---- */

/* Where the base was in the frame before, or before the first. */
static bool last_base(td_pose *site_from_base, const reconstruct_job *work, size_t index)
{
    const double *start = work->how->start;
    for (size_t i = index; i-- > 0;) {
        const reconstruct_frame *f = &work->frame[i];
        if (f->failed || f->place == PLACE_UNKNOWN) continue;
        const td_pose rig_from_base = td_pose_inverse(&f->vehicle_from_rig);
        *site_from_base = td_pose_compose(&f->site_from_rig, &rig_from_base);
        return true;
    }
    if (!start) return false;
    *site_from_base =
        (td_pose){{cos(0.5 * start[3]), 0, 0, sin(0.5 * start[3])}, {start[0], start[1], start[2]}};
    return true;
}

static td_status by_ground(reconstruct_job *work, size_t index, const td_disparity *disparity,
                           td_error *error)
{
    reconstruct_frame *f = &work->frame[index];
    td_pose base;
    td_elevation *map = NULL;
    td_localisation found;
    if (!last_base(&base, work, index))
        return td_fail(error, TD_ERROR_DATA,
                       "its place is not given, and no frame before it has one to begin from: give the first "
                       "frame's pose, or --start");
    const td_pose start = td_pose_compose(&base, &f->vehicle_from_rig);
    const double around = work->how->far_m + td_localisation_options_default().search_m;
    const double region[4] = {start.t[0] - around, start.t[1] - around, start.t[0] + around,
                              start.t[1] + around};
    td_localisation_options o = td_localisation_options_default();
    o.correlation_px = work->how->fusion.correlation_px;
    TD_TRY(td_fusion_map_of(&map, NULL, work->fusion, region, error));
    td_status status = td_localise(&found, map, work->depth, disparity, &start, &o, error);
    td_elevation_free(&map);
    TD_TRY(status);
    f->site_from_rig = found.site_from_rig;
    f->place = PLACE_MAP;
    memcpy(f->pose_covariance, found.covariance, sizeof found.covariance);
    memcpy(f->pose_sigma, found.sigma, sizeof found.sigma);
    return TD_OK;
}

td_status reconstruct_localise(reconstruct_job *work, size_t index, const td_disparity *disparity,
                               td_error *error)
{
    reconstruct_frame *f = &work->frame[index];
    td_error tags = {0}, ground = {0};
    if (f->place != PLACE_UNKNOWN) return TD_OK;
    td_status status = TD_ERROR_DATA;
    const bool marked = work->dataset->site_tags.tag_count > 0;
    if (marked) status = by_tags(work, f, &tags);
    if (status == TD_ERROR_DATA) status = by_ground(work, index, disparity, &ground);
    if (status == TD_OK) return TD_OK;
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "no memory to locate frame %s", f->name);
    return td_fail(error, status, "it could not be located: %s%s%s", marked ? tags.message : "",
                   marked && ground.message[0] ? "; " : "", ground.message);
}
