/* The world as a whole: made, reset, settled, commanded, stepped. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <threads.h>

#include "sim/world_internal.h"

/* Joints are set anew along their freedom at each step, so that what softness leaves of them would act as a
 * force that grows as the step falls; 0 makes ODE complain of its equations. */
static const double CFM = 1e-18;
static const double BURIED_M = 0.1; /* how deep the last link may start */
static const double QUIET = 1e-7;   /* m/s, rad/s: at rest */
/* ODE aborts the program on numbers that are none: what grows beyond this (rad/s, m/s; N) is refused before.
 */
static const double FASTEST = 1e4, STRONGEST_N = 1e9;
static const double SETTLES_S = 30, CHECKS_S = 0.25;

td_world_options td_world_options_default(const td_robot *robot)
{
    const double *k = robot->suspension_n_m;
    td_world_options o = {.machine = td_machine_options_default(robot), .step_s = 1e-3};
    o.tracks = (td_world_tracks){.points = 4,
                                 .half_length_m = k[0] > 0 ? 1.15 * sqrt(k[1] / k[0]) : 0,
                                 .half_gauge_m = k[0] > 0 ? sqrt(k[2] / k[0]) : 0,
                                 .friction = 0.7,
                                 .shear_n_m = k[0],
                                 .shear_ns_m = robot->suspension_ns_m[0],
                                 .relax_m = 0.07,
                                 .rolling = 0.05,
                                 .speed_m_s = 1.5,
                                 .lag_s = 0.2};
    return o;
}

/* ---- ODE, once a process ---- */

static once_flag ode_begun = ONCE_FLAG_INIT;

/* ODE writes what it thinks of its equations on stderr. */
static void stay_quiet(int number, const char *format, va_list arguments)
{
    (void)number, (void)format, (void)arguments;
}

/* Never closed: that would end it for other worlds and other users of ODE in the process. */
static void begin_ode(void)
{
    dInitODE2(0);
    dSetMessageHandler(stay_quiet);
}

/* ---- making ---- */

static td_status check_number(const char *name, double value, double low, double high, td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "world: %s %g is not within %g to %g", name, value, low, high);
}

static td_status check_tracks(const td_robot *r, const td_world_options *o, const td_elevation *ground,
                              td_error *error)
{
    static const char *const names[3] = {"heave", "pitch", "roll"};
    const td_world_tracks *t = &o->tracks;
    if (!ground && !o->height)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "world: machine '%s' stands on tracks, but there is no map; give one, or fix its base",
                       r->name);
    for (int i = 0; i < 3; i++)
        if (!(r->suspension_n_m[i] > 0) || !(r->suspension_ns_m[i] >= 0))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "world: the suspension of machine '%s' has no stiffness of %s; give heave, pitch and "
                "roll, or fix the base",
                r->name, names[i]);
    TD_TRY(check_number("points of each track", t->points, 2, TD_WORLD_MAX_POINTS / 2, error));
    TD_TRY(check_number("half the tracks' length, m,", t->half_length_m, 1e-3, 1e3, error));
    TD_TRY(check_number("half the tracks' gauge, m,", t->half_gauge_m, 1e-3, 1e3, error));
    TD_TRY(check_number("the tracks' friction", t->friction, 0, 100, error));
    TD_TRY(check_number("the tracks' shear stiffness, N/m,", t->shear_n_m, 1, 1e12, error));
    TD_TRY(check_number("the tracks' shear damping, N s/m,", t->shear_ns_m, 0, 1e12, error));
    TD_TRY(check_number("the tracks' relaxation, m,", t->relax_m, 1e-6, 1e3, error));
    TD_TRY(check_number("the tracks' rolling resistance", t->rolling, 0, 10, error));
    TD_TRY(check_number("the tracks' speed limit, m/s,", t->speed_m_s, 0, 100, error));
    return check_number("the tracks' lag, s,", t->lag_s, 1e-6, 1e3, error);
}

static td_status build(td_world *w, const td_robot *robot, td_error *error)
{
    const double *g = w->options.machine.gravity;
    td_machine_options hold = w->options.machine;
    TD_TRY(check_number("its step, s,", w->options.step_s, 1e-6, 0.1, error));
    if (hold.base == TD_MACHINE_SUSPENDED) TD_TRY(check_tracks(robot, &w->options, w->ground, error));
    if ((unsigned)hold.base <= TD_MACHINE_FLOATING) hold.base = TD_MACHINE_FIXED;
    TD_TRY(td_machine_new(&w->machine, robot, &hold, NULL, error));
    call_once(&ode_begun, begin_ode);
    w->ode = dWorldCreate();
    if (!w->ode)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the world of machine '%s'", robot->name);
    w->threading = dThreadingAllocateSelfThreadedImplementation();
    if (!w->threading)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the world of machine '%s'", robot->name);
    dWorldSetStepThreadingImplementation(w->ode, dThreadingImplementationGetFunctions(w->threading),
                                         w->threading);
    dWorldSetGravity(w->ode, g[0], g[1], g[2]);
    dWorldSetCFM(w->ode, CFM);
    dWorldSetAutoDisableFlag(w->ode, 0);
    TD_TRY(td_world_build_robot(w, error));
    if (w->options.machine.base == TD_MACHINE_SUSPENDED) td_world_build_tracks(w);
    for (int k = 0; k < robot->joint_count; k++)
        w->q[k] = fmax(robot->joint[k].lower, fmin(robot->joint[k].upper, 0));
    w->valve_gain_s = -hold.valve_s * expm1(-w->options.step_s / hold.valve_s);
    w->belt_gain = -expm1(-w->options.step_s / w->options.tracks.lag_s);
    w->fresh = true;
    td_world_place(w);
    return TD_OK;
}

td_status td_world_new(td_world **world, const td_robot *robot, const td_elevation *ground,
                       const td_world_options *options, td_error *error)
{
    *world = NULL;
    td_world *w = calloc(1, sizeof *w);
    if (!w) return td_fail(error, TD_ERROR_MEMORY, "no memory for the world of machine '%s'", robot->name);
    w->options = options ? *options : td_world_options_default(robot);
    w->ground = ground;
    const td_status status = build(w, robot, error);
    if (status != TD_OK)
        td_world_free(&w);
    else
        *world = w;
    return status;
}

void td_world_free(td_world **world)
{
    if (!world || !*world) return;
    td_world_free_stones(*world);
    if ((*world)->ode) dWorldDestroy((*world)->ode);
    if ((*world)->threading) dThreadingFreeImplementation((*world)->threading);
    td_machine_free(&(*world)->machine);
    free(*world);
    *world = NULL;
}

void td_world_set_ground(td_world *w, const td_elevation *ground)
{
    w->ground = ground;
}

/* ---- its state ---- */

/* The largest of its speeds; infinite when one is no number. */
static double fastest(const td_world *w)
{
    double most = 0;
    for (int i = 0; i < 6 + w->machine->robot.joint_count; i++) {
        const double speed = fabs(w->velocity[i]);
        if (!(speed <= most)) most = isnan(speed) ? INFINITY : speed;
    }
    return most;
}

static void still(td_world *w)
{
    memset(w->velocity, 0, sizeof w->velocity);
    memset(w->ahead, 0, sizeof w->ahead);
    memset(w->belt, 0, sizeof w->belt);
    memset(w->wanted, 0, sizeof w->wanted);
    w->fresh = true;
}

static void take(td_world *w, const td_plant_state *s)
{
    const int n = w->machine->robot.joint_count;
    const double *twist = s->twist;
    double turn[3], v[3];
    still(w);
    w->begun_s = s->time_s;
    w->steps = 0;
    w->owed_s = 0;
    if (w->options.machine.base != TD_MACHINE_FIXED) {
        td_world_body *b = w->body;
        b->pose = s->site_from_vehicle;
        td_machine_cross(turn, twist, b->com);
        for (int c = 0; c < 3; c++) v[c] = twist[3 + c] + turn[c];
        td_pose_rotate(w->velocity, &b->pose, twist);
        td_pose_rotate(w->velocity + 3, &b->pose, v);
    }
    for (int k = 0; k < n; k++) {
        w->q[k] = s->q[k];
        w->velocity[6 + k] = s->dq[k];
        w->force[k] = w->machine->actuator[k].sign * s->force[k];
        w->valve[k] = 0;
    }
    for (int i = 0; i < w->body_count; i++) {
        memset(w->body[i].push, 0, sizeof w->body[i].push);
        memset(w->body[i].step_push, 0, sizeof w->body[i].step_push);
    }
    for (int i = 0; i < w->point_count; i++) memset(w->point[i].shear, 0, sizeof w->point[i].shear);
    td_world_place(w);
}

static td_status check_place(const td_world *w, td_error *error)
{
    int link = 0;
    if (!(fastest(w) < FASTEST))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "world: machine '%s' starts at %g rad/s or m/s; the limit is %g",
                       w->machine->robot.name, fastest(w), FASTEST);
    TD_TRY(td_world_check_tracks(w, error));
    const double depth = w->options.buried ? 0 : td_world_buried(w, &link);
    if (depth > BURIED_M)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "world: link '%s' of machine '%s' starts %.2f m under the ground; raise the arm, or allow it "
            "to start buried",
            w->machine->robot.link[link].name, w->machine->robot.name, depth);
    return TD_OK;
}

td_status td_world_reset(td_world *w, const td_plant_state *state, td_error *error)
{
    td_world *before = malloc(sizeof *before);
    if (!before) return td_fail(error, TD_ERROR_MEMORY, "world: no memory to reset it");
    *before = *w;
    td_status status = td_machine_reset(w->machine, state, error);
    if (status == TD_OK) {
        take(w, state);
        status = check_place(w, error);
        if (status != TD_OK) *w = *before;
    }
    free(before);
    return status;
}

/* The cylinders' forces that hold the joints as they are, where the base is. */
static td_status bear(td_world *w, td_error *error)
{
    td_plant_state s = {.time_s = td_world_time(w), .site_from_vehicle = td_pose_identity()};
    td_machine *m = w->machine;
    m->options.site_from_anchor = w->body[0].pose;
    memcpy(s.q, w->q, sizeof s.q);
    TD_TRY(td_machine_reset(m, &s, error));
    TD_TRY(td_machine_settle(m, error));
    td_machine_state(m, &s);
    for (int k = 0; k < m->robot.joint_count; k++) w->force[k] = m->actuator[k].sign * s.force[k];
    memset(w->valve, 0, sizeof w->valve);
    return TD_OK;
}

static td_status rest(td_world *w, td_error *error)
{
    const double time = td_world_time(w);
    TD_TRY(bear(w, error));
    for (double t = 0; t < SETTLES_S && w->options.machine.base == TD_MACHINE_SUSPENDED; t += CHECKS_S) {
        TD_TRY(td_world_step(w, CHECKS_S, error));
        if (fastest(w) < QUIET) break;
    }
    if (w->options.machine.base == TD_MACHINE_SUSPENDED && !(fastest(w) < QUIET))
        return td_fail(
            error, TD_ERROR_CONVERGENCE,
            "world: machine '%s' finds no rest on the ground at (%.3f, %.3f) m: it slides or tips; start "
            "it on flatter ground",
            w->machine->robot.name, w->body[0].pose.t[0], w->body[0].pose.t[1]);
    still(w);
    w->begun_s = time;
    w->steps = 0;
    w->owed_s = 0;
    return TD_OK;
}

td_status td_world_settle(td_world *w, td_error *error)
{
    still(w);
    if (w->options.machine.base == TD_MACHINE_SUSPENDED) {
        for (int i = 0; i < w->point_count; i++) memset(w->point[i].shear, 0, sizeof w->point[i].shear);
        TD_TRY(td_world_stand(w, error));
        TD_TRY(check_place(w, error));
    }
    return rest(w, error);
}

void td_world_state(const td_world *w, td_plant_state *s)
{
    const td_machine *m = w->machine;
    const td_world_body *b = w->body;
    double now[6], turn[3];
    td_machine_view v;
    td_world_view(&v, w);
    *s = (td_plant_state){.time_s = td_world_time(w), .site_from_vehicle = b->pose};
    for (int i = 0; i < 6; i++) now[i] = w->velocity[i] + w->ahead[i];
    td_base_from_site(s->twist, &b->pose, now);
    td_base_from_site(s->twist + 3, &b->pose, now + 3);
    td_machine_cross(turn, s->twist, b->com);
    for (int c = 0; c < 3; c++) s->twist[3 + c] -= turn[c];
    td_machine_joint_readings(s, m, s->time_s, &v);
}

void td_world_links(td_pose *site_from_link, const td_world *w)
{
    for (int i = 0; i < w->machine->robot.link_count; i++)
        site_from_link[i] = td_pose_compose(&w->body[w->body_of[i]].pose, w->body_from_link + i);
}

void td_world_track(td_world_track_state *s, const td_world *w, bool right)
{
    *s = (td_world_track_state){.belt_m_s = w->belt[right], .touching = w->touching[right]};
    memcpy(s->force_n, w->track_force[right], sizeof s->force_n);
}

/* ---- commanded and stepped ---- */

td_status td_world_command(td_world *w, const td_plant_command *command, td_error *error)
{
    return td_machine_command(w->machine, command, NULL, error);
}

td_status td_world_drive(td_world *w, double left, double right, td_error *error)
{
    const double most = w->options.tracks.speed_m_s;
    if (w->options.machine.base != TD_MACHINE_SUSPENDED)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "world: machine '%s' does not stand on its tracks; it cannot drive",
                       w->machine->robot.name);
    if (!(fabs(left) <= most) || !(fabs(right) <= most))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "world: tracks at %g and %g m/s; the limit of machine '%s' is %g", left, right,
                       w->machine->robot.name, most);
    w->wanted[0] = left;
    w->wanted[1] = right;
    return TD_OK;
}

td_status td_world_push(td_world *w, int link, const double force[3], const double point[3], td_error *error)
{
    if (link < 0 || link >= w->machine->robot.link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "world: machine '%s' has no link %d to push",
                       w->machine->robot.name, link);
    td_world_body *b = w->body + w->body_of[link];
    double *sum = w->inside_step ? b->step_push : b->push, arm[3], moment[3];
    for (int c = 0; c < 3; c++) {
        if (!(fabs(force[c]) <= STRONGEST_N) || !isfinite(point[c]))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "world: a push of %g N on link '%s' is no number, or beyond %g N", force[c],
                           w->machine->robot.link[link].name, STRONGEST_N);
        arm[c] = point[c] - b->at[c];
    }
    td_machine_cross(moment, arm, force);
    for (int c = 0; c < 3; c++) {
        sum[c] += force[c];
        sum[3 + c] += moment[c];
    }
    return TD_OK;
}

static td_status one_step(td_world *w, td_error *error)
{
    if (w->options.before_step) {
        w->inside_step = true;
        w->options.before_step(w->options.before_step_user, w);
        w->inside_step = false;
    }
    td_world_load(w);
    if (w->point_count > 0) TD_TRY(td_world_tracks_push(w, error));
    td_world_touch(w);
    dWorldStep(w->ode, w->options.step_s);
    td_world_unload(w);
    w->steps++;
    for (int i = 0; i < w->body_count && w->options.before_step; i++)
        memset(w->body[i].step_push, 0, sizeof w->body[i].step_push);
    if (fastest(w) < FASTEST) return TD_OK;
    return td_fail(error, TD_ERROR_CONVERGENCE,
                   "world: machine '%s' speeds away at %.3f s: its step is too long for what acts on it",
                   w->machine->robot.name, td_world_time(w));
}

td_status td_world_step(td_world *w, double dt_s, td_error *error)
{
    td_status status = TD_OK;
    if (!(dt_s >= 0) || !isfinite(dt_s))
        return td_fail(error, TD_ERROR_ARGUMENT, "world: cannot step by %g s", dt_s);
    const double due = (w->owed_s + dt_s) / w->options.step_s, count = floor(due + 1e-6);
    w->owed_s = (due - count) * w->options.step_s;
    if (w->stone_count > 0) dAllocateODEDataForThread(dAllocateFlagCollisionData);
    for (double i = 0; i < count && status == TD_OK; i++) status = one_step(w, error);
    for (int i = 0; i < w->body_count; i++) memset(w->body[i].push, 0, sizeof w->body[i].push);
    return status;
}

/* ---- the plant ---- */

static td_status plant_command(void *self, const td_plant_command *command, td_error *error)
{
    return td_world_command(self, command, error);
}

static td_status plant_step(void *self, double dt_s, td_error *error)
{
    return td_world_step(self, dt_s, error);
}

static td_status plant_state(void *self, td_plant_state *state, td_error *error)
{
    (void)error;
    td_world_state(self, state);
    return TD_OK;
}

static td_status plant_reset(void *self, const td_plant_state *state, td_error *error)
{
    return td_world_reset(self, state, error);
}

static void plant_free(void *self)
{
    td_world *w = self;
    td_world_free(&w);
}

td_plant td_world_plant(td_world *world)
{
    return (td_plant){.self = world,
                      .robot = &world->machine->robot,
                      .command = plant_command,
                      .step = plant_step,
                      .state = plant_state,
                      .reset = plant_reset,
                      .free = plant_free};
}
