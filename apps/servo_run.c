/* One run of the servo: look, think, move, until the bucket is where the board says, or is not to come there.
 *
 * The goal is where the board stands: root_from_board = root_from_camera(q) camera_from_board, averaged over
 * the looks with a memory of MEMORY_S, for the board rests but the machine sways. Each period it is seen
 * anew from where the camera then is, and the law told of it (td_visual_servo_retarget): so the swing, which
 * moves the camera and the bucket together, is a freedom as the others are.
 *
 * Corners are off by noise, new in each image, and more than that by what their places in the image do to the
 * detector, which is the same as long as nothing moves, so that the loop does not average it out; of the
 * board's memory that is one look, however many, in which its corners stayed within STILL_PX. The residuals
 * of both targets have both, and enter the tip's sigma as if all were the same while nothing moves.
 *
 * A command is given a period after its image was taken: seeing takes time. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "apps/station.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/number.h"

static const double MEMORY_S = 2, REST_S = 1.5, STILL_PX = 0.25;
static const double OUT_OF_REACH_M = 0.1; /* beyond what a machine that stands askew leaves */
enum { FIRST_LOOKS = 5 };

typedef struct runner {
    const servo_scenario *s;
    const td_robot *robot;
    servo_run *run;
    servo_view *view;
    station *station;
    td_plant plant;
    td_visual_servo servo;
    bool begun;
    uint64_t frame;
    servo_look look;
    td_plant_state state;
    td_plant_command command; /* of the last image, given now */
    double rate[TD_ROBOT_MAX_JOINTS], last_rate[TD_ROBOT_MAX_JOINTS];
    size_t boards; /* seen */
    td_pose root_from_board;
    double board_image[36]; /* covariance of one look's left perturbation, were the corners' sigma 1 px */
    /* Of its memory: the corners' places since when they have not moved, the weight of the looks since then,
     * and the sum of the squares of the weights of the times before. */
    double still_px[TD_SERVO_MAX_POINTS][2], still_weight, before_squares;
    double residual_px2[2], freedoms[2]; /* of bucket and board: sums over the looks, with that memory */
    double see_s;
    size_t looks;
} runner;

void servo_run_free(servo_run *run)
{
    free(run->sample);
    td_image_free(&run->image);
    *run = (servo_run){0};
}

bool servo_met(const servo_run *run)
{
    return run->phase == TD_SERVO_CONVERGED;
}

/* ---- the goal ---- */

static void weigh_look(runner *r, double share)
{
    const servo_points *board = &r->look.board;
    bool still = r->boards > 1;
    for (int i = 0; i < board->count && still; i++)
        if (board->seen[i])
            still = hypot(board->pixel[i][0] - r->still_px[i][0], board->pixel[i][1] - r->still_px[i][1]) <=
                    STILL_PX;
    r->still_weight *= 1 - share;
    r->before_squares *= (1 - share) * (1 - share);
    if (!still) {
        memcpy(r->still_px, board->pixel, sizeof r->still_px);
        r->before_squares += r->still_weight * r->still_weight;
        r->still_weight = 0;
    }
    r->still_weight += share;
}

static void average_board(runner *r)
{
    const servo_points *board = &r->look.board;
    if (!board->has_pose) return;
    const td_pose camera = servo_camera_at(r->s, r->state.q),
                  seen = td_pose_compose(&camera, &board->camera_from_target);
    double ad[36], covariance[36], xi[6];
    td_pose_adjoint(ad, &camera);
    if (td_sandwich(covariance, ad, board->covariance, 6, 6, NULL) != TD_OK) return;
    for (int i = 0; i < 36; i++) r->board_image[i] = covariance[i] / board->variance_px2;
    const double least = r->s->options.limits.period_s / MEMORY_S,
                 share = fmin(1, fmax(1.0 / (double)++r->boards, least));
    weigh_look(r, share);
    if (r->boards == 1) r->root_from_board = seen;
    const td_pose back = td_pose_inverse(&r->root_from_board), way = td_pose_compose(&seen, &back);
    td_pose_log(xi, &way);
    for (int i = 0; i < 6; i++) xi[i] *= share;
    r->root_from_board = td_pose_perturb(&r->root_from_board, xi);
}

static td_status sight_of_goal(td_servo_sight *goal, const runner *r, const td_pose *root_from_camera,
                               td_error *error)
{
    const td_pose camera_from_root = td_pose_inverse(root_from_camera),
                  camera_from_board = td_pose_compose(&camera_from_root, &r->root_from_board),
                  pose = td_pose_compose(&camera_from_board, &r->s->board_from_bucket);
    *goal = (td_servo_sight){.kind = TD_SERVO_POINTS, .count = r->look.bucket.count};
    for (int i = 0; i < goal->count; i++) {
        td_servo_point *p = goal->point + i;
        double at[3];
        td_pose_transform(at, &pose, r->look.bucket.at[i]);
        p->depth_m = at[2];
        if (!td_camera_project(p->pixel, NULL, NULL, servo_view_camera(r->view), at))
            return td_fail(error, TD_ERROR_DATA,
                           "the goal cannot be seen: corner %d of the bucket's tags would be at (%.2f, %.2f, "
                           "%.2f) m from the camera; choose a goal in view, or turn the machine to it",
                           i, at[0], at[1], at[2]);
        p->seen = true;
    }
    return TD_OK;
}

static td_servo_sight sight_of_bucket(const servo_points *bucket)
{
    td_servo_sight sight = {.kind = TD_SERVO_POINTS, .count = bucket->count};
    for (int i = 0; i < bucket->count; i++) {
        td_servo_point *p = sight.point + i;
        double at[3] = {0};
        memcpy(p->pixel, bucket->pixel[i], sizeof p->pixel);
        p->sigma_px = bucket->sigma_px[i];
        if (bucket->has_pose) td_pose_transform(at, &bucket->camera_from_target, bucket->at[i]);
        p->depth_m = at[2];
        p->seen = bucket->seen[i] && at[2] > 0;
    }
    return sight;
}

static td_status aim(runner *r, td_error *error)
{
    td_servo_sight goal;
    const td_pose camera = servo_camera_at(r->s, r->state.q);
    TD_TRY(sight_of_goal(&goal, r, &camera, error));
    if (r->begun) return td_visual_servo_retarget(&r->servo, &goal, &camera, error);
    const td_servo_eye eye = {.camera = *servo_view_camera(r->view),
                              .robot = r->robot,
                              .camera_link = 0,
                              .target_link = r->s->bucket.link,
                              .link_from_camera = camera};
    TD_TRY(td_visual_servo_start(&r->servo, &eye, &goal, &r->s->options, error));
    r->begun = true;
    return TD_OK;
}

/* ---- the truth, to judge by ---- */

static td_pose tool_at(const runner *r, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, r->robot, q);
    return at[r->s->tool];
}

/* Where the board says the tip is to be, in the root's frame. */
static void wanted_tip(double p[3], const runner *r, const td_pose *root_from_board)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, r->robot, r->state.q);
    const td_pose root_from_target = td_pose_compose(at + r->s->bucket.link, &r->s->bucket.link_from_target),
                  target_from_root = td_pose_inverse(&root_from_target),
                  root_from_goal = td_pose_compose(root_from_board, &r->s->board_from_bucket);
    double of_target[3];
    td_pose_transform(of_target, &target_from_root, at[r->s->tool].t);
    td_pose_transform(p, &root_from_goal, of_target);
}

static void tip_error(double e[3], const runner *r)
{
    double wanted[3];
    const td_pose root_from_site = td_pose_inverse(&r->state.site_from_vehicle),
                  board = td_pose_compose(&root_from_site, &r->s->board.link_from_target),
                  tool = tool_at(r, r->state.q);
    wanted_tip(wanted, r, &board);
    for (int i = 0; i < 3; i++) e[i] = tool.t[i] - wanted[i];
}

static void count_violations(runner *r)
{
    const td_motion_limits *l = &r->s->options.limits;
    for (int k = 0; k < r->robot->joint_count; k++) {
        const td_robot_joint *j = r->robot->joint + k;
        const double step = fabs(r->rate[k] - r->last_rate[k]) / l->period_s;
        if (r->state.q[k] < j->lower || r->state.q[k] > j->upper || fabs(r->state.dq[k]) > j->speed ||
            fabs(r->rate[k]) > j->speed * l->speed_share * (1 + 1e-9) ||
            step > j->acceleration * l->acceleration_share * (1 + 1e-9))
            r->run->limit_violations++;
    }
}

/* ---- a period ---- */

static servo_sample *take_sample(runner *r, td_error *error)
{
    servo_run *run = r->run;
    if (run->count == run->room) {
        const size_t room = run->room ? 2 * run->room : 256;
        servo_sample *more = realloc(run->sample, room * sizeof *more);
        if (!more) {
            td_fail(error, TD_ERROR_MEMORY, "no memory for the log");
            return NULL;
        }
        run->sample = more;
        run->room = room;
    }
    servo_sample *a = run->sample + run->count++;
    double e[3], tip[3];
    *a = (servo_sample){.time_s = r->state.time_s,
                        .phase = r->servo.phase,
                        .bucket_seen = r->look.bucket.has_pose,
                        .board_seen = r->look.board.has_pose,
                        .whole_px = NAN,
                        .controlled_px = NAN};
    memcpy(a->q, r->state.q, sizeof a->q);
    memcpy(a->dq, r->state.dq, sizeof a->dq);
    tip_error(e, r);
    a->tip_error_m = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
    const td_pose tool = tool_at(r, r->state.q);
    td_pose_transform(tip, &r->state.site_from_vehicle, tool.t);
    const double height = tip[2] - station_height(r->station, tip[0], tip[1]);
    if (height < run->clearance_m) run->clearance_m = height;
    for (int i = 0; i < 4; i++)
        for (int c = 0; c < 2; c++) {
            a->now[2 * i + c] = r->look.bucket.seen[i] ? r->look.bucket.pixel[i][c] : NAN;
            a->goal[2 * i + c] = r->begun ? r->servo.goal.point[i].pixel[c] : NAN;
        }
    return a;
}

static bool is_hidden(const runner *r)
{
    const servo_scenario *s = r->s;
    return r->state.time_s >= s->hide_from_s - 1e-9 &&
           r->state.time_s < s->hide_from_s + s->hide_for_s - 1e-9;
}

static void add_residuals(runner *r, int which, const servo_points *points)
{
    const double left = 1 - r->s->options.limits.period_s / MEMORY_S;
    if (!points->has_pose) return;
    r->residual_px2[which] *= left, r->freedoms[which] *= left;
    r->residual_px2[which] += points->freedoms * points->residual_px2;
    r->freedoms[which] += points->freedoms;
}

static td_status look_now(runner *r, td_error *error)
{
    TD_TRY(r->plant.state(r->plant.self, &r->state, error));
    TD_TRY(servo_view_look(&r->look, r->view, &r->state, r->frame++, is_hidden(r), error));
    average_board(r);
    add_residuals(r, 0, &r->look.bucket);
    add_residuals(r, 1, &r->look.board);
    r->see_s += r->look.seconds;
    r->looks++;
    return TD_OK;
}

/* When it is over: it only brakes. */
static td_status do_not_look(runner *r, td_error *error)
{
    servo_points *const points[2] = {&r->look.bucket, &r->look.board};
    for (int k = 0; k < 2; k++) {
        points[k]->has_pose = false;
        memset(points[k]->seen, 0, sizeof points[k]->seen);
    }
    return r->plant.state(r->plant.self, &r->state, error);
}

static td_status move_on(runner *r, td_error *error)
{
    TD_TRY(r->plant.command(r->plant.self, &r->command, error));
    return r->plant.step(r->plant.self, r->s->options.limits.period_s, error);
}

static td_status period(runner *r, td_error *error)
{
    td_servo_report report;
    const bool over = r->servo.phase > TD_SERVO_HOLDING;
    if (over)
        TD_TRY(do_not_look(r, error));
    else
        TD_TRY(look_now(r, error));
    const double began = terminal_now_s();
    TD_TRY(aim(r, error));
    const td_servo_sight sight = sight_of_bucket(&r->look.bucket);
    TD_TRY(td_visual_servo_step(&report, &r->servo, &sight, &r->state, error));
    r->see_s += terminal_now_s() - began;
    memcpy(r->last_rate, r->rate, sizeof r->rate);
    memcpy(r->rate, r->servo.rate, sizeof r->rate);
    servo_sample *a = take_sample(r, error);
    if (!a) return TD_ERROR_MEMORY;
    memcpy(a->rate, r->rate, sizeof a->rate);
    count_violations(r);
    if (!over && report.freedoms > 0) {
        a->whole_px = report.whole.px;
        a->controlled_px = report.controlled.px;
        r->run->freedoms = report.freedoms;
    }
    if (!over) {
        r->run->iterations++;
        r->run->time_s = r->state.time_s;
        if (report.phase == TD_SERVO_HOLDING) r->run->lost_s += r->s->options.limits.period_s;
    }
    TD_TRY(move_on(r, error));
    r->command = report.command;
    return TD_OK;
}

/* ---- from start to rest ---- */

static td_status begin(runner *r, const double *q, uint64_t seed, int threads, td_error *error)
{
    td_plant_state start = {0};
    station_ground ground = {.sigma_m = 0.03};
    TD_TRY(servo_view_new(&r->view, r->s, seed, threads, error));
    const td_scene *scene = servo_view_scene(r->view);
    td_machine_options machine = td_machine_options_default(r->robot);
    start.site_from_vehicle = scene->site_from_vehicle;
    memcpy(start.q, q, sizeof start.q);
    machine.site_from_anchor = start.site_from_vehicle;
    TD_TRY(station_new(&r->station, r->robot, &machine, &start, scene->ground, &ground, error));
    r->plant = station_plant(r->station);
    r->command.kind = r->s->options.command;
    return TD_OK;
}

/* At rest, for the goal's first place. False: one of them is not in sight. */
static td_status first_looks(bool *seen, runner *r, td_error *error)
{
    bool bucket = false;
    for (int i = 0; i < FIRST_LOOKS; i++) {
        TD_TRY(look_now(r, error));
        bucket = r->look.bucket.has_pose;
        TD_TRY(move_on(r, error));
    }
    *seen = bucket && r->boards > 0;
    if (*seen) return TD_OK;
    r->run->phase = TD_SERVO_LOST;
    snprintf(r->run->reason, sizeof r->run->reason, "%s in sight at the start",
             bucket          ? "the board is not"
             : r->boards > 0 ? "the bucket's tag is not"
                             : "neither the bucket's tag nor the board is");
    return TD_OK;
}

/* Covariance (3,3) of the tip's error where the corners of both targets have this sigma. A board that is
 * believed elsewhere moves the goal as a camera would that stands elsewhere, and the arm goes after it as far
 * as it can. */
static bool tip_covariance(double covariance[9], runner *r, double corner_px)
{
    td_servo_sigma sigma;
    const double origin[3] = {0};
    const int lens = td_camera_parameter_count(servo_view_camera(r->view)->model), n = lens + 12;
    double *board = calloc((size_t)n * (size_t)n, sizeof *board);
    if (!board) return false;
    for (int i = 0; i < 6; i++)
        memcpy(board + (lens + i) * n + lens, r->board_image + 6 * i, 6 * sizeof *board);
    const td_servo_sight sight = sight_of_bucket(&r->look.bucket);
    const bool known =
        aim(r, NULL) == TD_OK && td_visual_servo_sigma(&sigma, &r->servo, r->state.q, &sight, r->s->tool,
                                                       origin, board, NULL) == TD_OK;
    free(board);
    const double memory = r->before_squares + r->still_weight * r->still_weight;
    for (int i = 0; i < 9 && known; i++)
        covariance[i] =
            corner_px * corner_px * (memory * sigma.common[i] + sigma.image[i] / r->look.bucket.variance_px2);
    return known;
}

static void judge_tip(runner *r)
{
    servo_run *run = r->run;
    double covariance[9], inverse[9], along[3];
    tip_error(run->tip_error, r);
    run->sigmas = NAN;
    for (int i = 0; i < 3; i++) run->sigma_tip[i] = NAN;
    const double freedoms = r->freedoms[0] + r->freedoms[1];
    run->corner_px = freedoms > 0 ? sqrt((r->residual_px2[0] + r->residual_px2[1]) / freedoms) : NAN;
    if (!servo_met(run) || !r->look.bucket.has_pose || !tip_covariance(covariance, r, run->corner_px)) return;
    for (int i = 0; i < 3; i++) run->sigma_tip[i] = sqrt(covariance[4 * i]);
    if (td_invert_spd(inverse, covariance, 3, NULL) != TD_OK) return;
    td_multiply(along, inverse, run->tip_error, 3, 3, 1);
    run->sigmas =
        sqrt(along[0] * run->tip_error[0] + along[1] * run->tip_error[1] + along[2] * run->tip_error[2]);
}

static double steady_of(const servo_run *run, double settle_s)
{
    double most = NAN;
    if (!servo_met(run)) return NAN;
    for (size_t i = 0; i < run->count; i++)
        if (run->sample[i].time_s > run->time_s - settle_s + 1e-9 && !isnan(run->sample[i].controlled_px))
            most = fmax(most, run->sample[i].controlled_px);
    return most;
}

/* A goal that no camera could see, or a machine that went where it cannot stand. */
static td_status give_up(runner *r, const char *why)
{
    r->run->phase = TD_SERVO_UNREACHABLE;
    snprintf(r->run->reason, sizeof r->run->reason, "%.255s", why);
    return TD_OK;
}

/* Before anything moves. */
static bool can_reach(runner *r)
{
    double q[TD_ROBOT_MAX_JOINTS];
    const td_pose goal = td_pose_compose(&r->root_from_board, &r->s->board_from_bucket);
    memcpy(q, r->state.q, sizeof q);
    const double left = servo_reach(q, r->s, &goal);
    if (left <= OUT_OF_REACH_M) return true;
    r->run->phase = TD_SERVO_UNREACHABLE;
    snprintf(r->run->reason, sizeof r->run->reason,
             "out of reach: the bucket would come no nearer than %.2f m; it was not moved. Set the goal "
             "nearer, or drive nearer to it",
             left);
    return false;
}

static td_status all_the_way(runner *r, const td_progress *progress, td_error *error)
{
    const td_visual_servo_options *o = &r->s->options;
    const size_t most = (size_t)(o->limit_s / o->limits.period_s);
    bool seen = false;
    TD_TRY(first_looks(&seen, r, error));
    if (!seen) return TD_OK;
    if (!can_reach(r)) return TD_OK;
    while (!r->begun || r->servo.phase <= TD_SERVO_HOLDING) {
        td_error why = {0};
        const td_status status = period(r, &why);
        if (status == TD_ERROR_DATA) return give_up(r, why.message);
        if (status != TD_OK) return td_fail(error, status, "%s", why.message);
        if (!td_progress_report(progress, "bringing the bucket there", (size_t)r->run->iterations, most))
            return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
    r->run->phase = r->servo.phase;
    snprintf(r->run->reason, sizeof r->run->reason, "%s", r->servo.reason);
    for (double t = 0; t < REST_S; t += o->limits.period_s) TD_TRY(period(r, error));
    return look_now(r, error);
}

td_status servo_run_one(servo_run *run, const servo_scenario *s, const double *q, uint64_t seed, int threads,
                        const td_progress *progress, td_error *error)
{
    runner r = {.s = s, .robot = s->scene->scene.robot, .run = run};
    *run = (servo_run){.clearance_m = INFINITY, .phase = TD_SERVO_MOVING};
    memcpy(run->start, q, sizeof run->start);
    td_status status = begin(&r, q, seed, threads, error);
    if (status == TD_OK) status = all_the_way(&r, progress, error);
    if (status == TD_OK) status = r.plant.state(r.plant.self, &r.state, error);
    if (status == TD_OK) {
        judge_tip(&r);
        run->steady_px = steady_of(run, s->options.settle_s);
        run->loop_hz = r.see_s > 0 ? (double)r.looks / r.see_s : 0;
        const td_image *image = servo_view_image(r.view);
        if (image && td_image_new(&run->image, image->width, image->height, 1, NULL) == TD_OK)
            memcpy(run->image->data, image->data, (size_t)image->width * (size_t)image->height);
    }
    td_visual_servo_end(&r.servo);
    station_free(&r.station);
    servo_view_free(&r.view);
    if (status != TD_OK) servo_run_free(run);
    return status;
}

/* ---- motion.csv ---- */

static void put(FILE *f, double value)
{
    char text[TD_NUMBER_SIZE];
    fprintf(f, ",%s", isnan(value) ? "" : td_number_format(text, value, 10));
}

td_status servo_log_write(const servo_run *run, const td_robot *robot, const char *path, td_error *error)
{
    static const char *const corner[4] = {"ul", "ur", "lr", "ll"};
    char *text = NULL, number[TD_NUMBER_SIZE];
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path);
    fputs("time_s,phase,bucket_seen,board_seen,whole_px,controlled_px,tip_error_m", f);
    for (int k = 0; k < robot->joint_count; k++)
        fprintf(f, ",%s_rad,%s_rate_rad_s,%s_command_rad_s", robot->joint[k].name, robot->joint[k].name,
                robot->joint[k].name);
    for (int i = 0; i < 4; i++)
        fprintf(f, ",%s_x_px,%s_y_px,%s_goal_x_px,%s_goal_y_px", corner[i], corner[i], corner[i], corner[i]);
    fputc('\n', f);
    for (size_t i = 0; i < run->count; i++) {
        const servo_sample *a = run->sample + i;
        fprintf(f, "%s,%s,%d,%d", td_number_format(number, a->time_s, 10), td_servo_phase_name(a->phase),
                a->bucket_seen, a->board_seen);
        put(f, a->whole_px);
        put(f, a->controlled_px);
        put(f, a->tip_error_m);
        for (int k = 0; k < robot->joint_count; k++) put(f, a->q[k]), put(f, a->dq[k]), put(f, a->rate[k]);
        for (int k = 0; k < 4; k++)
            put(f, a->now[2 * k]), put(f, a->now[2 * k + 1]), put(f, a->goal[2 * k]),
                put(f, a->goal[2 * k + 1]);
        fputc('\n', f);
    }
    const bool failed = fclose(f) != 0;
    const td_status status = failed ? td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path)
                                    : td_file_write(path, text, size, error);
    free(text);
    return status;
}
