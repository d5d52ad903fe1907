/* Views taken one after another by a person who follows the guidance, or none: what the test and the bench of
 * calib/next_view.h share. */
#ifndef TELEDIMOS_TESTS_CALIB_GUIDED_H
#define TELEDIMOS_TESTS_CALIB_GUIDED_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/next_view.h"
#include "calib/placement_internal.h"
#include "calib/projected_uncertainty.h"
#include "core/parallel.h"
#include "core/random.h"

enum { GUIDED_MOST = 24, GUIDED_SEEDS = 31, GUIDED_FIRST = 3 };

/* How the next view is found: as asked for; one of the poses that may be asked for, each as likely; a board
 * held anywhere, uniformly. The first two are held with the same sloppiness. */
typedef enum guided_way { GUIDED_ASKED, GUIDED_ANY_POSE, GUIDED_ANYWHERE } guided_way;

typedef struct guided_scene {
    const td_rig *rig; /* truth */
    td_target target;
    double near_m, far_m, distance_m, noise_px;
} guided_scene;

/* Every corner in the image, and half a square around: what a finder of whole chessboards needs. */
static inline bool guided_sees(const guided_scene *s, int camera, const td_pose *rig_from_target)
{
    const td_target_plane *plane = &s->target.plane[0];
    const td_camera *c = &s->rig->camera[camera].camera;
    for (int row = -1; row <= plane->rows; row++)
        for (int column = -1; column <= plane->columns; column++) {
            double p[3] = {plane->spacing_m * fmin(fmax(column, -0.5), plane->columns - 0.5),
                           plane->spacing_m * fmin(fmax(row, -0.5), plane->rows - 0.5), 0},
                   u[2];
            td_pose_transform(p, rig_from_target, p);
            td_pose_transform(p, &s->rig->camera[camera].camera_from_rig, p);
            if (!(p[2] > 0) || !td_camera_project(u, NULL, NULL, c, p)) return false;
            if (!(u[0] >= 0 && u[1] >= 0 && u[0] <= c->width - 1 && u[1] <= c->height - 1)) return false;
        }
    return true;
}

/* Writes view `view` of the observations, with noise, for every camera that sees the board. */
static inline void guided_take(td_observations *o, size_t view, const guided_scene *s,
                               const td_pose *rig_from_target, td_random *noise)
{
    for (int k = 0; k < s->rig->count; k++) {
        td_detection *d = td_observations_get(o, view, k);
        d->found = guided_sees(s, k, rig_from_target);
        for (size_t i = 0; i < d->count && d->found; i++) {
            double x[3];
            td_target_point(x, &s->target, i);
            td_pose_transform(x, rig_from_target, x);
            td_pose_transform(x, &s->rig->camera[k].camera_from_rig, x);
            td_camera_project(d->point + 2 * i, NULL, NULL, &s->rig->camera[k].camera, x);
            for (int j = 0; j < 2; j++) d->point[2 * i + j] += s->noise_px * td_random_normal(noise);
            d->sigma[i] = s->noise_px;
        }
    }
}

static inline double guided_spread(td_random *random, double most)
{
    return most * (2 * td_random_uniform(random) - 1);
}

/* How a person holds a board that is asked for at a pose: 5 degrees and 10 % of its distance off, in each
 * direction, and again until the camera sees it; after many tries drawn back from the image's edge. */
static inline td_pose guided_sloppy(const guided_scene *s, int camera, const td_pose *asked,
                                    td_random *random)
{
    const td_target_plane *plane = &s->target.plane[0];
    td_pose camera_from_target = td_pose_compose(&s->rig->camera[camera].camera_from_rig, asked);
    td_pose rig_from_camera = td_pose_inverse(&s->rig->camera[camera].camera_from_rig);
    double middle[3] = {plane->spacing_m * (plane->columns - 1) / 2, plane->spacing_m * (plane->rows - 1) / 2,
                        0};
    double centre[6] = {0}, back[6] = {0};
    td_pose_transform(centre + 3, &camera_from_target, middle);
    for (int i = 0; i < 3; i++) back[3 + i] = -centre[3 + i];
    td_pose to_origin = td_pose_exp(back), turned = td_pose_compose(&to_origin, &camera_from_target);
    for (int tries = 0;; tries++) {
        double inward = tries < 20 ? 1 : pow(0.97, tries - 20), z = centre[5];
        double xi[6] = {0}, place[6] = {0};
        for (int i = 0; i < 3; i++) {
            xi[i] = guided_spread(random, 5 * 0.017453292519943295);
            place[3 + i] = (i < 2 ? inward : 1) * centre[3 + i] + guided_spread(random, 0.1 * z);
        }
        td_pose wobble = td_pose_exp(xi), move = td_pose_exp(place);
        td_pose held = td_pose_compose(&wobble, &turned);
        held = td_pose_compose(&move, &held);
        held = td_pose_compose(&rig_from_camera, &held);
        if (guided_sees(s, camera, &held)) return held;
    }
}

/* One of the poses among which the guidance searches. */
static inline td_pose guided_any_pose(int *camera, const guided_scene *s, td_random *random)
{
    td_board_shape shape = td_board_shape_of(&s->target);
    const double distance[3] = {s->near_m, sqrt(s->near_m * s->far_m), s->far_m};
    for (;;) {
        td_placement p = {.camera = (int)td_random_below(random, (uint32_t)s->rig->count)};
        p.across = (int)td_random_below(random, 3) - 1;
        p.down = (int)td_random_below(random, 3) - 1;
        p.distance = (int)td_random_below(random, 3);
        p.distance_m = distance[p.distance];
        uint32_t tilt = td_random_below(random, 9);
        p.tilt = tilt ? (td_tilt)((tilt + 1) / 2) : TD_TILT_NONE;
        p.tilt_deg = tilt ? (tilt % 2 ? 30 : 45) : 0;
        p.turned = td_random_below(random, 2);
        *camera = p.camera;
        if (td_placement_fit(&p, &shape, &s->rig->camera[p.camera])) return p.rig_from_target;
    }
}

/* Uniform over the image, distances, tilts and turns, whole in some camera's image. */
static inline td_pose guided_anywhere(const guided_scene *s, td_random *random)
{
    const td_target_plane *plane = &s->target.plane[0];
    for (;;) {
        int camera = (int)td_random_below(random, (uint32_t)s->rig->count);
        const td_camera *c = &s->rig->camera[camera].camera;
        const double pixel[2] = {c->width * td_random_uniform(random), c->height * td_random_uniform(random)};
        double tilt = 45 * 0.017453292519943295 * td_random_uniform(random);
        uint32_t way = td_random_below(random, 4);
        double z = s->near_m + (s->far_m - s->near_m) * td_random_uniform(random), ray[3];
        double place[6] = {0}, lean[6] = {0}, turn[6] = {0}, centre[6] = {0};
        turn[2] = td_random_below(random, 2) ? 1.5707963267948966 : 0;
        if (!td_camera_unproject(ray, NULL, NULL, c, pixel)) continue;
        lean[way / 2] = way % 2 ? tilt : -tilt;
        for (int i = 0; i < 3; i++) place[3 + i] = ray[i] / ray[2] * z;
        centre[3] = -plane->spacing_m * (plane->columns - 1) / 2;
        centre[4] = -plane->spacing_m * (plane->rows - 1) / 2;
        td_pose pose = td_pose_inverse(&s->rig->camera[camera].camera_from_rig);
        const double *const step[4] = {place, lean, turn, centre};
        for (int i = 0; i < 4; i++) {
            td_pose motion = td_pose_exp(step[i]);
            pose = td_pose_compose(&pose, &motion);
        }
        if (guided_sees(s, camera, &pose)) return pose;
    }
}

/* Root mean square of the projected uncertainty over the middles of 12 x 9 cells of all images; INFINITY: no
 * calibration. */
static inline double guided_sigma(const guided_scene *s, const td_calibration *c, const td_observations *o)
{
    enum { COLUMNS = 12, ROWS = 9, CELLS = COLUMNS * ROWS };
    td_projected_query query[2 * CELLS] = {0};
    double covariance[2 * CELLS * 4], sum = 0;
    size_t count = 0, seen = 0;
    if (!c) return INFINITY;
    for (int k = 0; k < s->rig->count; k++)
        for (int i = 0; i < CELLS; i++)
            query[count++] =
                (td_projected_query){k,
                                     {s->rig->camera[k].camera.width * (i % COLUMNS + 0.5) / COLUMNS,
                                      s->rig->camera[k].camera.height * (i / COLUMNS + 0.5) / ROWS},
                                     s->distance_m};
    if (td_projected_uncertainty(covariance, query, count, c, o, NULL) != TD_OK) return INFINITY;
    for (size_t i = 0; i < count; i++) {
        const double *v = covariance + 4 * i;
        if (isnan(v[0])) continue;
        sum += (v[0] + v[3]) / 2 + hypot((v[0] - v[3]) / 2, v[1]);
        seen++;
    }
    return seen ? sqrt(sum / (double)seen) : INFINITY;
}

/* sigma[n - 1]: projected uncertainty, px, with n views, for n up to `views`; false: something failed. */
static inline bool guided_run(double *sigma, const guided_scene *s, size_t views, guided_way way,
                              uint64_t seed)
{
    td_observations *o = NULL;
    td_random random = td_random_seed(seed, 3 + (uint64_t)way), noise = td_random_seed(seed, 17);
    td_calibrate_options options = td_calibrate_options_default();
    td_next_view_options how = td_next_view_options_default();
    td_calibration *c = NULL;
    options.leave_one_out = false;
    options.threads = 1;
    options.warp = TD_WARP_OFF;
    how.nearest_m = s->near_m;
    how.farthest_m = s->far_m;
    how.distance_m = s->distance_m;
    bool good = td_observations_new(&o, &s->target, s->rig->count, views, NULL) == TD_OK;
    for (int k = 0; k < s->rig->count && good; k++) {
        memcpy(o->camera[k].name, s->rig->camera[k].name, sizeof o->camera[k].name);
        o->camera[k].model = s->rig->camera[k].camera.model;
        o->camera[k].width = s->rig->camera[k].camera.width;
        o->camera[k].height = s->rig->camera[k].camera.height;
    }
    for (size_t v = 0; v < views && good; v++) {
        td_pose pose;
        o->view_count = v; /* those so far */
        if (way == GUIDED_ASKED) {
            td_next_view next;
            good = td_next_view_find(&next, c, o, &how, NULL) == TD_OK;
            if (!good) break;
            pose = guided_sloppy(s, next.camera, &next.rig_from_target, &random);
        } else if (way == GUIDED_ANY_POSE) {
            int camera;
            pose = guided_any_pose(&camera, s, &random);
            pose = guided_sloppy(s, camera, &pose, &random);
        } else {
            pose = guided_anywhere(s, &random);
        }
        o->view_count = v + 1;
        guided_take(o, v, s, &pose, &noise);
        td_calibration_free(&c);
        if (v + 1 >= GUIDED_FIRST && td_calibrate(&c, o, &options, NULL) != TD_OK) c = NULL;
        sigma[v] = guided_sigma(s, c, o);
    }
    if (o) o->view_count = views;
    td_calibration_free(&c);
    td_observations_free(&o);
    return good;
}

static inline int guided_compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

typedef struct guided_seeds {
    const guided_scene *scene;
    size_t views;
    guided_way way;
    double sigma[GUIDED_SEEDS][GUIDED_MOST];
    bool good[GUIDED_SEEDS];
} guided_seeds;

static inline void guided_seed(size_t index, void *user)
{
    guided_seeds *g = user;
    g->good[index] = guided_run(g->sigma[index], g->scene, g->views, g->way, 100 + index);
}

/* median[n - 1] over `seeds` runs, an odd number. */
static inline bool guided_curve(double *median, const guided_scene *s, size_t views, guided_way way,
                                size_t seeds)
{
    guided_seeds g = {.scene = s, .views = views, .way = way};
    double column[GUIDED_SEEDS];
    if (td_parallel_for(seeds, 0, guided_seed, &g, NULL, NULL) != TD_OK) return false;
    for (size_t k = 0; k < seeds; k++)
        if (!g.good[k]) return false;
    for (size_t v = 0; v < views; v++) {
        for (size_t k = 0; k < seeds; k++) column[k] = g.sigma[k][v];
        qsort(column, seeds, sizeof *column, guided_compare);
        median[v] = column[seeds / 2];
    }
    return true;
}

/* Number of views, between whole ones by logarithms, at which a falling curve comes down to `target`; NAN: it
 * does not. */
static inline double guided_views_to(const double *curve, size_t views, double target)
{
    for (size_t v = 0; v < views; v++) {
        if (!(curve[v] <= target)) continue;
        if (v == 0 || !isfinite(curve[v - 1])) return (double)(v + 1);
        return (double)v + (log(curve[v - 1]) - log(target)) / (log(curve[v - 1]) - log(curve[v]));
    }
    return NAN;
}

#endif
