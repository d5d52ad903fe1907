/* What is wanted, what is seen, and when it is over. */
#include "servo/visual_servo.h"

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/random.h"
#include "servo/controller_internal.h"
#include "servo/lag.h"
#include "servo/visual_servo_internal.h"

enum { N = TD_ROBOT_MAX_JOINTS };
static const double AT_STOP = 1e-3; /* rad, m: a joint this near to where it must stop is there */

td_visual_servo_options td_visual_servo_options_default(void)
{
    return (td_visual_servo_options){.interaction = TD_INTERACTION_MEAN,
                                     .law = TD_SERVO_LAW_OWN,
                                     .gain_zero = 1.5,
                                     .gain_infinity = 0.4,
                                     .gain_slope = 5,
                                     .radius_m = 1,
                                     .singular_share = 1e-3,
                                     .damping = 0.01,
                                     .avoid_limits = true,
                                     .rho = 0.1,
                                     .rho1 = 0.3,
                                     .tune = 0.7,
                                     .limits = td_motion_limits_default(),
                                     .command = TD_COMMAND_RATE,
                                     .tolerance_px = 0.3,
                                     .tolerance_m = 1e-3,
                                     .tolerance_rad = 1e-3,
                                     .rest_px = 3,
                                     .rest_m = 0.01,
                                     .rest_rad = 0.01,
                                     .settle_s = 0.2,
                                     .loss_s = 5,
                                     .stall_s = 5,
                                     .limit_s = 120,
                                     .diverging = 3};
}

const char *td_servo_phase_name(td_servo_phase phase)
{
#define NAME(name, text) text,
    static const char *const names[] = {TD_SERVO_PHASE_LIST(NAME)};
#undef NAME
    return (unsigned)phase < TD_SERVO_PHASES ? names[phase] : "?";
}

/* ---- what is seen ---- */

static bool all_known(const double *value, int n)
{
    for (int k = 0; k < n; k++)
        if (!isfinite(value[k])) return false;
    return true;
}

/* x, y, Z of a point; Z is `depth_m` where its own is not known. */
static td_status read_point(double s[3], const td_servo_point *p, const td_camera *camera, double depth_m,
                            const char *whose, int index, td_error *error)
{
    double ray[3];
    if (!all_known(p->pixel, 2) || !isfinite(p->depth_m))
        return td_fail(error, TD_ERROR_DATA, "visual servo: point %d of the %s is no number", index, whose);
    if (p->depth_m < 0)
        return td_fail(error, TD_ERROR_DATA,
                       "visual servo: point %d of the %s lies behind the camera (depth %g m)", index, whose,
                       p->depth_m);
    if (!td_camera_unproject(ray, NULL, NULL, camera, p->pixel) || !(ray[2] > 0))
        return td_fail(error, TD_ERROR_DATA,
                       "visual servo: point %d of the %s, at (%g, %g) px, has no ray in front of the camera; "
                       "check the camera's parameters",
                       index, whose, p->pixel[0], p->pixel[1]);
    s[0] = ray[0] / ray[2], s[1] = ray[1] / ray[2];
    s[2] = p->depth_m > 0 ? p->depth_m : depth_m;
    if (s[2] > 0) return TD_OK;
    return td_fail(
        error, TD_ERROR_DATA,
        "visual servo: point %d of the %s has no depth; give it, or take the interaction matrix of "
        "the goal",
        index, whose);
}

static td_status check_pose(const td_pose *pose, const char *whose, td_error *error)
{
    double square = 0;
    for (int i = 0; i < 4; i++) square += pose->q[i] * pose->q[i];
    if (!(fabs(square - 1) < 1e-6) || !all_known(pose->t, 3))
        return td_fail(error, TD_ERROR_DATA, "visual servo: the pose of the %s is no number or no pose",
                       whose);
    if (!(pose->t[2] > 0))
        return td_fail(error, TD_ERROR_DATA,
                       "visual servo: the target of the %s lies behind the camera (depth %g m)", whose,
                       pose->t[2]);
    return TD_OK;
}

/* Those of the goal's points that are seen. */
td_status td_servo_gather(td_servo_features *f, int *index, const td_visual_servo *servo,
                          const td_servo_sight *sight, td_error *error)
{
    const td_visual_servo_options *o = &servo->options;
    f->kind = servo->goal.kind, f->interaction = o->interaction, f->radius_m = o->radius_m, f->count = 0;
    if (sight->kind != f->kind || (f->kind == TD_SERVO_POINTS && sight->count != servo->goal.count))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "visual servo: the view has other features than the goal (%d points instead of %d)",
                       sight->count, servo->goal.count);
    if (f->kind == TD_SERVO_POSE) {
        if (!sight->pose_seen) return TD_OK;
        TD_TRY(check_pose(&sight->camera_from_target, "view", error));
        const td_pose target_from_camera = td_pose_inverse(&sight->camera_from_target);
        f->goal_from_camera = td_pose_compose(&servo->goal.camera_from_target, &target_from_camera);
        f->count = 1;
        return TD_OK;
    }
    for (int i = 0; i < sight->count; i++) {
        if (!sight->point[i].seen) continue;
        const double depth_m = o->interaction == TD_INTERACTION_DESIRED ? servo->goal_point[i][2] : 0;
        TD_TRY(read_point(f->now[f->count], sight->point + i, &servo->eye.camera, depth_m, "view", i, error));
        memcpy(f->goal[f->count], servo->goal_point[i], sizeof f->goal[0]);
        index[f->count++] = i;
    }
    return TD_OK;
}

static bool enough(const td_servo_features *f)
{
    return f->count >= (f->kind == TD_SERVO_POSE ? 1 : TD_SERVO_LEAST_POINTS);
}

/* ---- start ---- */

static td_status check_goal(td_visual_servo *servo, td_error *error)
{
    const td_servo_sight *goal = &servo->goal;
    if (goal->kind == TD_SERVO_POSE) return check_pose(&goal->camera_from_target, "goal", error);
    if (goal->count < TD_SERVO_LEAST_POINTS || goal->count > TD_SERVO_MAX_POINTS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "visual servo: the goal has %d points, but must have %d to %d", goal->count,
                       TD_SERVO_LEAST_POINTS, TD_SERVO_MAX_POINTS);
    for (int i = 0; i < goal->count; i++)
        TD_TRY(read_point(servo->goal_point[i], goal->point + i, &servo->eye.camera, 0, "goal", i, error));
    return TD_OK;
}

static td_status check_number(const char *name, double value, double low, double high, td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "visual servo: %s is %g, but must lie between %g and %g", name,
                   value, low, high);
}

static td_status check_options(const td_visual_servo_options *o, bool arm, td_error *error)
{
    const double most = fmax(o->gain_zero, o->gain_infinity), lag_s = arm ? o->limits.lag_s : 0;
    TD_TRY(check_number("the period, s,", o->limits.period_s, 1e-4, 10, error));
    TD_TRY(check_number("the gain at zero, 1/s,", o->gain_zero, 1e-6, 1e3, error));
    TD_TRY(check_number("the gain at infinity, 1/s,", o->gain_infinity, 1e-6, o->gain_zero, error));
    TD_TRY(check_number("the gain's slope", o->gain_slope, 0, 1e6, error));
    TD_TRY(check_number("radius_m", o->radius_m, 1e-6, 1e6, error));
    TD_TRY(check_number("the singular share", o->singular_share, 0, 0.5, error));
    TD_TRY(check_number("the damping", o->damping, 0, 1e6, error));
    TD_TRY(check_number("rho", o->rho, 1e-6, 0.5, error));
    TD_TRY(check_number("rho1", o->rho1, 1e-6, 1, error));
    TD_TRY(check_number("tune", o->tune, 0, 1, error));
    TD_TRY(check_number("the tolerance, px,", o->tolerance_px, 1e-12, 1e6, error));
    TD_TRY(check_number("the tolerance, m,", o->tolerance_m, 1e-12, 1e6, error));
    TD_TRY(check_number("the tolerance, rad,", o->tolerance_rad, 1e-12, 4, error));
    TD_TRY(check_number("the rest, px,", o->rest_px, 0, 1e9, error));
    TD_TRY(check_number("the rest, m,", o->rest_m, 0, 1e9, error));
    TD_TRY(check_number("the rest, rad,", o->rest_rad, 0, 4, error));
    TD_TRY(check_number("the time to settle, s,", o->settle_s, 0, 1e6, error));
    TD_TRY(check_number("the time to be lost, s,", o->loss_s, 0, 1e9, error));
    TD_TRY(check_number("the time to stall, s,", o->stall_s, 1e-3, 1e9, error));
    TD_TRY(check_number("the time in all, s,", o->limit_s, 1e-3, 1e9, error));
    TD_TRY(check_number("the share that is divergence", o->diverging, 1, 1e9, error));
    if (o->law == TD_SERVO_LAW_VISP && o->radius_m != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "visual servo: ViSP's law weighs radians as metres; radius_m "
                       "must be 1 with it");
    if (most < td_lag_stable_gain(o->limits.period_s, lag_s)) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "visual servo: with a gain of %g 1/s, a period of %g s and a lag of %g s the loop is not "
                   "stable; take less than %.3g",
                   most, o->limits.period_s, lag_s, td_lag_stable_gain(o->limits.period_s, lag_s));
}

/* A transposed, so that what it reaches is a basis. */
static int reached(double share[6], const double *jacobian, int n, double radius_m)
{
    double turned[N * 6];
    td_task_inverse inverse;
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < n; k++) turned[k * 6 + i] = jacobian[i * n + k] * (i < 3 ? radius_m : 1);
    td_task_invert(&inverse, turned, NULL, n, 6, NULL, &(td_task_damping){0});
    for (int i = 0; i < 6; i++) {
        double square = inverse.rank == 6;
        for (int r = 0; r < inverse.rank && inverse.rank < 6; r++)
            square += inverse.basis[6 * r + i] * inverse.basis[6 * r + i];
        share[i] = sqrt(fmin(square, 1));
    }
    return inverse.rank;
}

/* The most that it has anywhere: looked for at places drawn from the joints' ranges. */
static int find_freedoms(const td_servo_eye *eye, double radius_m)
{
    enum { PLACES = 8 };
    td_random random = td_random_seed(1, 1);
    int most = 0;
    for (int i = 0; i < PLACES; i++) {
        double q[N], jacobian[6 * N], share[6];
        for (int k = 0; k < eye->robot->joint_count; k++) {
            const td_robot_joint *j = eye->robot->joint + k;
            const double low = fmax(j->lower, -3), high = fmin(j->upper, 3);
            q[k] = low + (high - low) * td_random_uniform(&random);
        }
        td_servo_jacobian(jacobian, NULL, eye, q);
        const int rank = reached(share, jacobian, eye->robot->joint_count, radius_m);
        if (rank > most) most = rank;
    }
    return most;
}

static td_status check_arm(td_visual_servo *servo, td_error *error)
{
    const td_servo_eye *eye = &servo->eye;
    const td_robot *robot = eye->robot;
    TD_TRY(td_controller_check(&servo->options.limits, servo->options.command, robot, error));
    const int links[2] = {eye->camera_link, eye->target_link};
    for (int i = 0; i < 2; i++)
        if (links[i] < 0 || links[i] >= robot->link_count)
            return td_fail(error, TD_ERROR_ARGUMENT, "visual servo: robot '%s' has no link %d", robot->name,
                           links[i]);
    servo->freedoms = find_freedoms(eye, servo->options.radius_m);
    if (servo->freedoms > 0) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "visual servo: no joint of robot '%s' moves the camera on '%s' against the target on '%s'",
                   robot->name, robot->link[links[0]].name, robot->link[links[1]].name);
}

td_status td_visual_servo_start(td_visual_servo *servo, const td_servo_eye *eye, const td_servo_sight *goal,
                                const td_visual_servo_options *options, td_error *error)
{
    memset(servo, 0, sizeof *servo);
    servo->eye = *eye, servo->goal = *goal, servo->freedoms = 6;
    servo->options = options ? *options : td_visual_servo_options_default();
    TD_TRY(td_camera_check(&eye->camera, error));
    TD_TRY(check_options(&servo->options, eye->robot != NULL, error));
    if (eye->robot) TD_TRY(check_arm(servo, error));
    TD_TRY(check_goal(servo, error));
    if (servo->options.law != TD_SERVO_LAW_VISP) return TD_OK;
    servo->module = dlopen(TD_SERVO_VISP_MODULE, RTLD_NOW | RTLD_LOCAL);
    if (servo->module && dlsym(servo->module, TD_SERVO_VISP_FUNCTION)) return TD_OK;
    const char *why = dlerror();
    td_visual_servo_end(servo);
    return td_fail(error, TD_ERROR_UNSUPPORTED,
                   "visual servo: the ViSP module cannot be loaded (%s); take our own law", why ? why : "?");
}

td_status td_visual_servo_retarget(td_visual_servo *servo, const td_servo_sight *goal,
                                   const td_pose *link_from_camera, td_error *error)
{
    td_visual_servo then = *servo;
    if (goal->kind != servo->goal.kind || goal->count != servo->goal.count)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "visual servo: the new goal has other features than the first (%d points instead of "
                       "%d)",
                       goal->count, servo->goal.count);
    then.goal = *goal;
    then.eye.link_from_camera = *link_from_camera;
    TD_TRY(check_goal(&then, error));
    *servo = then;
    return TD_OK;
}

void td_visual_servo_end(td_visual_servo *servo)
{
    if (servo->module) dlclose(servo->module);
    servo->module = NULL;
}

/* ---- a period ---- */

/* What a period knows. */
typedef struct moment {
    td_servo_features features;
    int index[TD_SERVO_MAX_POINTS]; /* of the goal's points */
    int rows, joints;
    double e[TD_SERVO_ROWS], twist[6 * N]; /* the camera's by the rates */
    double jacobian[TD_SERVO_ROWS * N];
    td_task_inverse all, free; /* of every joint, and without those at their stops */
} moment;

static void fill(moment *m, const td_visual_servo *servo, const double *q)
{
    double l[TD_SERVO_ROWS * 6];
    m->joints = servo->eye.robot ? servo->eye.robot->joint_count : 6;
    td_servo_jacobian(m->twist, NULL, &servo->eye, q);
    td_servo_error_of(m->e, &m->features);
    m->rows = td_servo_interaction(l, &m->features);
    for (int i = 0; i < m->rows; i++)
        for (int k = 0; k < m->joints; k++) {
            double sum = 0;
            for (int j = 0; j < 6; j++) sum += l[6 * i + j] * m->twist[j * m->joints + k];
            m->jacobian[i * m->joints + k] = sum;
        }
}

static td_status visp_law(double *rate, double *gain, const td_visual_servo *servo, const moment *m,
                          const bool *held, td_error *error)
{
    const td_visual_servo_options *o = &servo->options;
    const double settings[3] = {o->gain_zero, o->gain_infinity, o->gain_slope};
    double twist[6 * N];
    td_visp_servo_function *law;
    *(void **)&law = dlsym(servo->module, TD_SERVO_VISP_FUNCTION);
    for (int i = 0; i < 6 * m->joints; i++) twist[i] = held[i % m->joints] ? 0 : m->twist[i];
    return law(rate, gain, &m->features, twist, m->joints, settings, error);
}

static td_status apply_law(double *rate, double *gain, const td_visual_servo *servo, const moment *m,
                           const bool *held, td_error *error)
{
    if (servo->module) return visp_law(rate, gain, servo, m, held, error);
    *gain = td_servo_gain(&servo->options, m->free.step, m->joints);
    for (int k = 0; k < m->joints; k++) rate[k] = -*gain * m->free.step[k];
    return TD_OK;
}

/* Joints at their stops that are asked to go on. */
static bool find_stops(bool *held, const td_visual_servo *servo, const td_plant_state *state,
                       const double *rate)
{
    const td_motion_limits *l = &servo->options.limits;
    const td_robot *robot = servo->eye.robot;
    bool more = false;
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        const double rest = state->q[k] + l->lag_s * state->dq[k], near = l->margin + AT_STOP;
        const bool out = (rest <= j->lower + near && rate[k] < 0) || (rest >= j->upper - near && rate[k] > 0);
        if (!out || held[k]) continue;
        held[k] = more = true;
    }
    return more;
}

/* The second task, unless it would press a joint against its stop: that joint would hold up all the others.
 */
static void avoid(double *rate, td_servo_report *report, const td_visual_servo *servo, const moment *m,
                  const td_plant_state *state)
{
    double both[N] = {0};
    bool held[N];
    if (!td_servo_avoid(both, &servo->options, servo->eye.robot, state->q, rate, m->jacobian, m->e, &m->free,
                        m->rows))
        return;
    memcpy(held, report->at_stop, sizeof held);
    for (int k = 0; k < m->joints; k++) both[k] = held[k] ? 0 : both[k] + rate[k];
    if (find_stops(held, servo, state, both)) return;
    memcpy(rate, both, (size_t)m->joints * sizeof *rate);
    report->avoids = true;
}

static td_status find_rates(double *rate, td_servo_report *report, const td_visual_servo *servo, moment *m,
                            const td_plant_state *state, td_error *error)
{
    const td_visual_servo_options *o = &servo->options;
    const td_task_damping damping = {o->singular_share, servo->eye.robot ? o->damping : 0};
    td_task_invert(&m->all, m->jacobian, m->e, m->rows, m->joints, NULL, &damping);
    m->free = m->all;
    TD_TRY(apply_law(rate, &report->gain, servo, m, report->at_stop, error));
    if (!servo->eye.robot) return TD_OK;
    while (find_stops(report->at_stop, servo, state, rate)) {
        td_task_invert(&m->free, m->jacobian, m->e, m->rows, m->joints, report->at_stop, &damping);
        TD_TRY(apply_law(rate, &report->gain, servo, m, report->at_stop, error));
    }
    if (o->avoid_limits) avoid(rate, report, servo, m, state);
    return TD_OK;
}

/* ---- how far it is ---- */

static void measure_pose(td_servo_error *out, const double *e, double radius_m)
{
    out->rad = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) / radius_m;
    out->m = sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5]);
}

/* In pixels through the lens' derivative. */
static void measure(td_servo_report *report, const td_visual_servo *servo, const moment *m,
                    const td_servo_sight *sight)
{
    double rest[TD_SERVO_ROWS];
    for (int i = 0; i < m->rows; i++) rest[i] = m->e[i] - m->all.seen[i];
    if (m->features.kind == TD_SERVO_POSE) {
        measure_pose(&report->whole, m->e, m->features.radius_m);
        measure_pose(&report->controlled, m->all.seen, m->features.radius_m);
        measure_pose(&report->rest, rest, m->features.radius_m);
        return;
    }
    for (int i = 0; i < m->features.count; i++) {
        const double p[3] = {m->features.now[i][0], m->features.now[i][1], 1};
        const double *at = sight->point[m->index[i]].pixel, *goal = servo->goal.point[m->index[i]].pixel,
                     *seen = m->all.seen + 2 * i, *left = rest + 2 * i;
        double pixel[2], d[6];
        if (!td_camera_project(pixel, d, NULL, &servo->eye.camera, p)) continue;
        report->whole.px = fmax(report->whole.px, hypot(at[0] - goal[0], at[1] - goal[1]));
        report->controlled.px = fmax(report->controlled.px,
                                     hypot(d[0] * seen[0] + d[1] * seen[1], d[3] * seen[0] + d[4] * seen[1]));
        report->rest.px =
            fmax(report->rest.px, hypot(d[0] * left[0] + d[1] * left[1], d[3] * left[0] + d[4] * left[1]));
    }
}

/* By the tolerance: 1 and less is within it. */
static double share_of(const td_servo_error *x, double px, double m, double rad)
{
    return fmax(x->px > 0 ? x->px / px : 0, fmax(x->m > 0 ? x->m / m : 0, x->rad > 0 ? x->rad / rad : 0));
}

static void describe(char *text, size_t size, const td_visual_servo *servo, const td_servo_error *e)
{
    if (servo->goal.kind == TD_SERVO_POINTS)
        snprintf(text, size, "%.3g px", e->px);
    else
        snprintf(text, size, "%.3g mm and %.3g mrad", 1e3 * e->m, 1e3 * e->rad);
}

/* ---- when it is over ---- */

static void stop(td_visual_servo *servo, td_servo_phase phase, const char *why)
{
    servo->phase = phase;
    snprintf(servo->reason, sizeof servo->reason, "%s", why);
}

/* Within the tolerance for long enough. */
static void arrive(td_visual_servo *servo, const td_servo_report *r)
{
    const td_visual_servo_options *o = &servo->options;
    char rest[64], why[256];
    describe(rest, sizeof rest, servo, &r->rest);
    if (share_of(&r->rest, o->rest_px, o->rest_m, o->rest_rad) <= 1) {
        snprintf(why, sizeof why, "the goal is met; %s are left that the arm does not control", rest);
        stop(servo, TD_SERVO_CONVERGED, why);
    } else if (r->freedoms < servo->freedoms) {
        snprintf(why, sizeof why, "out of reach: here the arm is singular; %s are left", rest);
        stop(servo, TD_SERVO_UNREACHABLE, why);
    } else if (servo->freedoms < 6) {
        snprintf(why, sizeof why, "the goal is met in the %d dimensions that the arm controls; %s are left",
                 servo->freedoms, rest);
        stop(servo, TD_SERVO_REDUCED, why);
    } else {
        snprintf(why, sizeof why,
                 "no small motion brings it nearer, yet %s are left; start elsewhere, or use the pose", rest);
        stop(servo, TD_SERVO_MINIMUM, why);
    }
}

/* No nearer for too long. */
static void give_up(td_visual_servo *servo, const td_servo_report *r, const moment *m)
{
    char left[64], joints[128] = "", why[256];
    size_t used = 0;
    describe(left, sizeof left, servo, &r->controlled);
    for (int k = 0; servo->eye.robot && k < m->joints && used < sizeof joints; k++)
        if (servo->stopped[k])
            used += (size_t)snprintf(joints + used, sizeof joints - used, "%s%s", used ? ", " : "",
                                     servo->eye.robot->joint[k].name);
    if (joints[0]) {
        snprintf(why, sizeof why, "out of reach: at its stop: %s; %s are left", joints, left);
        stop(servo, TD_SERVO_UNREACHABLE, why);
    } else if (m->all.damped > 0) {
        snprintf(why, sizeof why, "out of reach: the arm is nearly singular (stretched out?); %s are left",
                 left);
        stop(servo, TD_SERVO_UNREACHABLE, why);
    } else {
        snprintf(why, sizeof why, "no nearer for %g s; %s are left", servo->options.stall_s, left);
        stop(servo, TD_SERVO_STALLED, why);
    }
}

static void judge(td_visual_servo *servo, const td_servo_report *r, const moment *m)
{
    const td_visual_servo_options *o = &servo->options;
    const double floor = 10, /* tolerances: from nearer than that, noise is no divergence */
        whole = share_of(&r->whole, o->tolerance_px, o->tolerance_m, o->tolerance_rad),
                 controlled = share_of(&r->controlled, o->tolerance_px, o->tolerance_m, o->tolerance_rad);
    const bool first = !(servo->first > 0);
    if (first) servo->first = fmax(whole, floor), servo->best = INFINITY;
    servo->settled_s = controlled <= 1 ? servo->settled_s + o->limits.period_s : 0;
    servo->best_s += o->limits.period_s;
    if (controlled < 0.95 * servo->best) {
        servo->best = controlled, servo->best_s = 0;
        memset(servo->stopped, 0, sizeof servo->stopped);
    }
    for (int k = 0; k < N; k++) servo->stopped[k] |= r->at_stop[k];
    if (servo->settled_s > o->settle_s) {
        arrive(servo, r);
    } else if (whole > o->diverging * servo->first) {
        char text[64], why[256];
        describe(text, sizeof text, servo, &r->whole);
        snprintf(why, sizeof why,
                 "it goes away from the goal: %s off, more than %g times what it was; check hand-eye, depths "
                 "and the points' order",
                 text, o->diverging);
        stop(servo, TD_SERVO_DIVERGED, why);
    } else if (controlled > 1 && servo->best_s > o->stall_s) {
        give_up(servo, r, m);
    }
}

/* Enough is seen, or it holds. */
static bool look(td_visual_servo *servo, const td_servo_features *f)
{
    const td_visual_servo_options *o = &servo->options;
    char seen[96];
    if (enough(f)) {
        servo->phase = TD_SERVO_MOVING;
        servo->reason[0] = 0;
        servo->unseen_s = 0;
        return true;
    }
    if (f->kind == TD_SERVO_POSE)
        snprintf(seen, sizeof seen, "the target is out of sight");
    else
        snprintf(seen, sizeof seen, "%d of %d points are in sight, and %d are needed", f->count,
                 servo->goal.count, TD_SERVO_LEAST_POINTS);
    servo->unseen_s += o->limits.period_s;
    servo->settled_s = 0;
    stop(servo, TD_SERVO_HOLDING, seen);
    if (!(servo->unseen_s > o->loss_s)) return false;
    char why[256];
    snprintf(why, sizeof why, "the target is lost: for %g s %s", o->loss_s, seen);
    stop(servo, TD_SERVO_LOST, why);
    return false;
}

/* The rates that are wanted; 0 where it holds or is over. */
static td_status think(double *rate, td_servo_report *report, td_visual_servo *servo,
                       const td_servo_sight *sight, const td_plant_state *state, td_error *error)
{
    moment m;
    if (servo->phase > TD_SERVO_HOLDING) return TD_OK;
    servo->time_s += servo->options.limits.period_s;
    if (servo->eye.robot && !all_known(state->q, servo->eye.robot->joint_count))
        return td_fail(error, TD_ERROR_DATA, "visual servo: a joint's angle is no number");
    TD_TRY(td_servo_gather(&m.features, m.index, servo, sight, error));
    if (look(servo, &m.features)) {
        fill(&m, servo, state ? state->q : NULL);
        report->freedoms = reached(report->share, m.twist, m.joints, servo->options.radius_m);
        TD_TRY(find_rates(rate, report, servo, &m, state, error));
        measure(report, servo, &m, sight);
        judge(servo, report, &m);
    }
    if (servo->phase <= TD_SERVO_HOLDING && servo->time_s > servo->options.limit_s) {
        char why[256];
        snprintf(why, sizeof why, "not there after %g s", servo->options.limit_s);
        stop(servo, TD_SERVO_LATE, why);
    }
    if (servo->phase != TD_SERVO_MOVING) memset(rate, 0, N * sizeof *rate);
    return TD_OK;
}

td_status td_visual_servo_step(td_servo_report *report, td_visual_servo *servo, const td_servo_sight *sight,
                               const td_plant_state *state, td_error *error)
{
    double rate[N] = {0};
    const td_visual_servo_options *o = &servo->options;
    memset(report, 0, sizeof *report);
    td_status status = think(rate, report, servo, sight, state, error);
    if (status != TD_OK) memset(rate, 0, sizeof rate);
    if (servo->eye.robot) {
        const td_status given =
            td_controller_give(&report->command, servo->rate, rate, &o->limits, o->command, servo->eye.robot,
                               state, true, status == TD_OK ? error : NULL);
        if (status == TD_OK) status = given;
    } else {
        memcpy(report->twist, rate, sizeof report->twist);
    }
    report->phase = servo->phase;
    memcpy(report->reason, servo->reason, sizeof report->reason);
    return status;
}
