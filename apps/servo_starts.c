/* Many runs from starts that are drawn: each on a thread of its own, none of its numbers depends on which. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "core/parallel.h"
#include "core/random.h"

enum { MOST_DRAWS = 200, MOST_TRIES = 20 };
static const double EDGE_PX = 15, CLEAR_M = 0.3, FACING = 0.7;
static const double RIM = 1.5; /* of a tag's half side: what must be seen of it, with the light around it */

typedef struct unit {
    servo_run run;
    td_status status;
    td_error error;
} unit;

typedef struct crew {
    const servo_scenario *s;
    uint64_t seed;
    unit *unit;
} crew;

void servo_starts_free(servo_starts *starts)
{
    for (size_t i = 0; starts->run && i < starts->count; i++) servo_run_free(starts->run + i);
    free(starts->run);
    *starts = (servo_starts){0};
}

/* All corners inside the image, and the target not seen too much from aside. */
static bool in_view(const servo_scenario *s, const servo_target *target, const td_pose *camera_from_target)
{
    double at[TD_SERVO_MAX_POINTS][3];
    const int count = servo_corners(at, target);
    const td_camera *c = &s->scene->rig->camera[s->camera].camera;
    const double ahead[3] = {0, 0, 1}, *t = camera_from_target->t;
    double into[3];
    td_pose_rotate(into, camera_from_target, ahead);
    if (!(into[0] * t[0] + into[1] * t[1] + into[2] * t[2] >
          FACING * sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])))
        return false;
    for (int i = 0; i < count; i++) {
        double p[3], pixel[2];
        td_pose_transform(p, camera_from_target, at[i]);
        if (!td_camera_project(pixel, NULL, NULL, c, p) || pixel[0] < EDGE_PX || pixel[1] < EDGE_PX ||
            pixel[0] > c->width - 1 - EDGE_PX || pixel[1] > c->height - 1 - EDGE_PX)
            return false;
    }
    return true;
}

/* No tag of the board, nor its rim, in the ground. */
static bool stands_free(const servo_scenario *s)
{
    const servo_target *board = &s->board;
    const td_elevation *ground = s->scene->scene.ground;
    double at[TD_SERVO_MAX_POINTS][3];
    const int count = servo_corners(at, board);
    for (int i = 0; i < count; i++) {
        const double *centre = board->tag[i / 4].target_from_tag.t;
        double p[3];
        for (int k = 0; k < 3; k++) at[i][k] = centre[k] + RIM * (at[i][k] - centre[k]);
        td_pose_transform(p, &board->link_from_target, at[i]);
        if (!(p[2] > td_elevation_at(ground, p[0], p[1], NULL))) return false;
    }
    return true;
}

static bool fits(const servo_scenario *s, const double *q)
{
    const td_scene *scene = &s->scene->scene;
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, scene->robot, q);
    const td_pose camera = servo_camera_at(s, q), camera_from_root = td_pose_inverse(&camera),
                  root_from_site = td_pose_inverse(&scene->site_from_vehicle),
                  camera_from_site = td_pose_compose(&camera_from_root, &root_from_site),
                  root_from_bucket = td_pose_compose(at + s->bucket.link, &s->bucket.link_from_target),
                  bucket = td_pose_compose(&camera_from_root, &root_from_bucket),
                  board = td_pose_compose(&camera_from_site, &s->board.link_from_target);
    double tip[3];
    td_pose_transform(tip, &scene->site_from_vehicle, at[s->tool].t);
    return tip[2] > td_elevation_at(scene->ground, tip[0], tip[1], NULL) + CLEAR_M &&
           in_view(s, &s->bucket, &bucket) && in_view(s, &s->board, &board);
}

/* Where the board is to stand so that the goal is met with joints q. */
static void place_board(servo_scenario *s, const double *q)
{
    const td_scene *scene = &s->scene->scene;
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, scene->robot, q);
    const td_pose bucket = td_pose_compose(at + s->bucket.link, &s->bucket.link_from_target),
                  bucket_from_board = td_pose_inverse(&s->board_from_bucket),
                  board = td_pose_compose(&bucket, &bucket_from_board);
    s->board.link_from_target = td_pose_compose(&scene->site_from_vehicle, &board);
}

/* The joints at the goal as the scenario has it. */
static void joints_at_goal(double *q, const servo_scenario *s)
{
    const td_pose root_from_site = td_pose_inverse(&s->scene->scene.site_from_vehicle),
                  board = td_pose_compose(&root_from_site, &s->board.link_from_target),
                  goal = td_pose_compose(&board, &s->board_from_bucket);
    memcpy(q, s->q, sizeof s->q);
    servo_reach(q, s, &goal);
}

static td_status draw(double *q, servo_scenario *s, td_random *random, td_error *error)
{
    const td_robot *robot = s->scene->scene.robot;
    double met[TD_ROBOT_MAX_JOINTS], goal[TD_ROBOT_MAX_JOINTS];
    joints_at_goal(met, s);
    memcpy(goal, met, sizeof goal);
    memcpy(q, s->q, sizeof s->q);
    for (int i = 0; i < MOST_DRAWS; i++) {
        for (int k = 0; k < robot->joint_count; k++) {
            q[k] = s->low[k] + (s->high[k] - s->low[k]) * td_random_uniform(random);
            goal[k] = met[k] + s->spread * (2 * td_random_uniform(random) - 1);
        }
        if (s->spread > 0) place_board(s, goal);
        if (td_robot_within_limits(robot, goal, NULL) && stands_free(s) && fits(s, q) && fits(s, goal))
            return TD_OK;
    }
    return td_fail(
        error, TD_ERROR_DATA,
        "%s: starts: of %d draws none has the bucket's tags and the board in view at the start "
        "and at the goal, the board free of the ground, and the tip %.1f m above it; change the ranges",
        s->path, MOST_DRAWS, CLEAR_M);
}

/* A start in whose first images the tags are not found, for all that geometry says, is drawn anew: the arm
 * may stand before them. */
static void do_unit(size_t index, void *user)
{
    const crew *c = user;
    unit *u = c->unit + index;
    td_random random = td_random_seed(c->seed, index + 1);
    for (int i = 0; i < MOST_TRIES && u->status == TD_OK; i++) {
        double q[TD_ROBOT_MAX_JOINTS];
        servo_scenario own = *c->s; /* lends its scene */
        const uint64_t noise = ((uint64_t)td_random_u32(&random) << 32) + index;
        servo_run_free(&u->run);
        u->status = draw(q, &own, &random, &u->error);
        if (u->status == TD_OK) u->status = servo_run_one(&u->run, &own, q, noise, 1, NULL, &u->error);
        if (u->run.phase != TD_SERVO_LOST || u->run.iterations > 0) break;
    }
    td_image_free(&u->run.image);
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median, 90 %, largest: the first of the sorted that so many do not exceed. */
static void find_quantiles(double quantile[3], double *value, int count)
{
    static const double share[3] = {0.5, 0.9, 1};
    if (count) qsort(value, (size_t)count, sizeof *value, compare);
    for (int i = 0; i < 3; i++) quantile[i] = count ? value[(int)ceil(share[i] * count) - 1] : NAN;
}

static td_status find_all_quantiles(servo_starts *starts)
{
    double *value = malloc(3 * starts->count * sizeof *value);
    double *const steady = value, *const tip = steady + starts->count, *const sigmas = tip + starts->count;
    int met = 0, judged = 0;
    if (!value) return TD_ERROR_MEMORY;
    for (size_t i = 0; i < starts->count; i++) {
        const servo_run *run = starts->run + i;
        const double *e = run->tip_error;
        if (!servo_met(run)) continue;
        steady[met] = run->steady_px;
        tip[met++] = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        if (!isnan(run->sigmas)) sigmas[judged++] = run->sigmas;
    }
    find_quantiles(starts->steady_px, steady, met);
    find_quantiles(starts->tip_m, tip, met);
    find_quantiles(starts->sigmas, sigmas, judged);
    free(value);
    return TD_OK;
}

static td_status count_up(servo_starts *starts)
{
    double square = 0;
    for (size_t i = 0; i < starts->count; i++) {
        const servo_run *run = starts->run + i;
        if (!servo_met(run)) continue;
        starts->met++;
        if (isnan(run->sigmas)) continue;
        starts->judged++;
        starts->covered += run->sigmas <= 3;
        square += run->sigmas * run->sigmas;
    }
    starts->rms_sigmas = starts->judged ? sqrt(square / 3 / starts->judged) : NAN;
    return find_all_quantiles(starts);
}

td_status servo_starts_run(servo_starts *starts, const servo_scenario *s, int count, uint64_t seed,
                           int threads, const td_progress *progress, td_error *error)
{
    *starts = (servo_starts){.count = (size_t)count, .run = calloc((size_t)count, sizeof *starts->run)};
    crew c = {.s = s, .seed = seed, .unit = calloc((size_t)count, sizeof *c.unit)};
    td_status status =
        starts->run && c.unit ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for starts");
    if (status == TD_OK) status = td_parallel_for((size_t)count, threads, do_unit, &c, progress, "starts");
    for (int i = 0; c.unit && i < count; i++) {
        if (starts->run) starts->run[i] = c.unit[i].run;
        if (status == TD_OK && c.unit[i].status != TD_OK)
            status = td_fail(error, c.unit[i].status, "start %d: %s", i + 1, c.unit[i].error.message);
    }
    free(c.unit);
    if (status == TD_OK && count_up(starts) != TD_OK)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for starts");
    else if (status == TD_ERROR_CANCELLED && error && !error->message[0])
        td_fail(error, status, "interrupted");
    return status;
}
