/* The machine goes through its scenario: commands in, samples out; and log.csv. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "apps/simulate_internal.h"
#include "core/file.h"
#include "core/number.h"

/* Times closer than this are one, s. */
static const double SAME_TIME = 1e-9;

void run_free(run_result *run)
{
    free(run->sample);
    free(run->event);
    *run = (run_result){0};
}

static double cpu_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void simulate_angles(double rpy[3], const td_pose *p)
{
    double r[9];
    td_pose_rotation(r, p);
    rpy[0] = atan2(r[7], r[8]);
    rpy[1] = atan2(-r[6], hypot(r[7], r[8]));
    rpy[2] = atan2(r[3], r[0]);
}

/* ---- one run ---- */

typedef struct driver {
    const scenario *s;
    td_machine *machine;
    double t, next_log, next_control, next_bend;
    size_t log_index, control_index;
    double command[TD_ROBOT_MAX_JOINTS], slope[TD_ROBOT_MAX_JOINTS];
    double command_s; /* when `command` was so */
} driver;

static td_status take_sample(run_result *run, const driver *d)
{
    const int n = d->s->robot->joint_count;
    sample *a = run->sample + run->count++;
    double way[TD_ROBOT_MAX_JOINTS];
    td_machine_state(d->machine, &a->state);
    a->energy = td_machine_energies(d->machine);
    a->count = td_machine_count(d->machine);
    motion_integral(way, &d->s->motion, d->t, n);
    for (int k = 0; k < n; k++) {
        a->command[k] = d->command[k] + d->slope[k] * (d->t - d->command_s);
        a->wanted[k] = d->s->start.q[k] + way[k];
    }
    return TD_OK;
}

/* The paper's controller: the rate that was planned, and gain times what is missing of the position. */
static void controller(driver *d)
{
    const scenario *s = d->s;
    const int n = s->robot->joint_count;
    td_plant_state state;
    double way[TD_ROBOT_MAX_JOINTS], next = 0;
    td_machine_state(d->machine, &state);
    motion_at(d->command, d->slope, &next, &s->motion, d->t, n);
    motion_integral(way, &s->motion, d->t, n);
    for (int k = 0; k < n; k++) {
        const double limit = s->robot->joint[k].speed;
        const double rate = d->command[k] + s->gain_1_s * (s->start.q[k] + way[k] - state.q[k]);
        d->command[k] = fmax(-limit, fmin(limit, rate));
        d->slope[k] = 0;
    }
}

static td_status give_command(driver *d, td_error *error)
{
    const scenario *s = d->s;
    td_plant_command c = {.kind = s->motion.command};
    d->command_s = d->t;
    if (!s->options.hydraulics) return TD_OK;
    if (s->period_s > 0) {
        controller(d);
        d->next_control = (double)++d->control_index * s->period_s;
    } else {
        motion_at(d->command, d->slope, &d->next_bend, &s->motion, d->t, s->robot->joint_count);
    }
    memcpy(c.value, d->command, sizeof c.value);
    return td_machine_command(d->machine, &c, d->slope, error);
}

static td_status begin(driver *d, td_error *error)
{
    const scenario *s = d->s;
    TD_TRY(td_machine_new(&d->machine, s->robot, &s->options, s->compile_folder, error));
    TD_TRY(td_machine_reset(d->machine, &s->start, error));
    TD_TRY(td_machine_settle(d->machine, error));
    td_plant_state state;
    td_machine_state(d->machine, &state);
    memcpy(state.dq, s->start.dq, sizeof state.dq);
    TD_TRY(td_machine_reset(d->machine, &state, error));
    d->next_bend = d->next_control = INFINITY;
    d->next_log = s->log_s;
    return give_command(d, error);
}

static td_status go_on(driver *d, run_result *run, td_error *error)
{
    const scenario *s = d->s;
    double to = fmin(fmin(d->next_log, d->next_bend), fmin(d->next_control, s->duration_s));
    const double begun = cpu_now();
    TD_TRY(td_machine_step(d->machine, to - d->t, error));
    run->cpu_s += cpu_now() - begun;
    d->t = to;
    if (d->t >= d->next_log - SAME_TIME || d->t >= s->duration_s) {
        take_sample(run, d);
        d->next_log = (double)(++d->log_index + 1) * s->log_s;
    }
    if (d->t >= fmin(d->next_bend, d->next_control) - SAME_TIME && d->t < s->duration_s)
        return give_command(d, error);
    return TD_OK;
}

static td_status keep_events(run_result *run, const td_machine *machine, td_error *error)
{
    const td_machine_event *event = td_machine_events(machine, &run->event_count);
    run->event = calloc(run->event_count + 1, sizeof *run->event);
    if (!run->event) return td_fail(error, TD_ERROR_MEMORY, "no memory for events");
    memcpy(run->event, event, run->event_count * sizeof *event);
    return TD_OK;
}

static td_status all_the_way(driver *d, run_result *run, bool may_fail, const td_progress *progress,
                             td_error *error)
{
    const size_t total = (size_t)ceil(d->s->duration_s / d->s->log_s);
    take_sample(run, d);
    while (d->t < d->s->duration_s) {
        td_status status = go_on(d, run, error);
        if (status == TD_ERROR_DATA && may_fail) {
            run->unstable = true;
            snprintf(run->why, sizeof run->why, "%s", error ? error->message : "");
            return TD_OK;
        }
        TD_TRY(status);
        if (!td_progress_report(progress, "simulating", d->log_index, total))
            return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
    return TD_OK;
}

td_status simulate_run(run_result *run, const scenario *s, bool may_fail, const td_progress *progress,
                       td_error *error)
{
    driver d = {.s = s};
    *run = (run_result){0};
    run->sample = calloc((size_t)(s->duration_s / s->log_s) + 4, sizeof *run->sample);
    if (!run->sample) return td_fail(error, TD_ERROR_MEMORY, "no memory for the log");
    td_status status = begin(&d, error);
    if (status == TD_OK) status = all_the_way(&d, run, may_fail, progress, error);
    if (status == TD_OK) status = keep_events(run, d.machine, error);
    if (status == TD_OK) run->counters = td_machine_count(d.machine);
    td_machine_free(&d.machine);
    return status;
}

/* ---- log.csv ---- */

static void put(FILE *f, double value)
{
    char text[TD_NUMBER_SIZE];
    fprintf(f, ",%s", td_number_format(text, value, 10));
}

static void write_head(FILE *f, const scenario *s)
{
    static const char *const command[] = {"m3_s", "n", "rad_s"};
    const td_robot *r = s->robot;
    fputs("time_s", f);
    for (int k = 0; k < r->joint_count; k++) {
        const char *name = r->joint[k].name;
        const bool motor = simulate_is_motor(r, k), slides = r->joint[k].kind == TD_JOINT_PRISMATIC;
        const char *angle = slides ? "m" : "rad", *rate = slides ? "m_s" : "rad_s",
                   *force = motor && !slides ? "nm" : "n";
        const char *unit = s->motion.command == TD_COMMAND_FORCE            ? force
                           : s->motion.command == TD_COMMAND_FLOW && !motor ? command[0]
                                                                            : rate;
        fprintf(f, ",%s_%s,%s_rate_%s,%s_command_%s,%s_%s_%s", name, angle, name, rate, name, unit, name,
                motor ? "torque" : "force", force);
        if (!motor) fprintf(f, ",%s_pressure_pa,%s_flow_m3_s", name, name);
    }
    fputs(",base_x_m,base_y_m,base_z_m,base_roll_rad,base_pitch_rad,base_yaw_rad,kinetic_j,gravity_j,"
          "suspension_j,oil_j,stops_j,method,order,step_s,rates,steps\n",
          f);
}

static void write_row(FILE *f, const scenario *s, const sample *a)
{
    char text[TD_NUMBER_SIZE];
    double rpy[3];
    fputs(td_number_format(text, a->state.time_s, 12), f);
    for (int k = 0; k < s->robot->joint_count; k++) {
        put(f, a->state.q[k]);
        put(f, a->state.dq[k]);
        put(f, a->command[k]);
        put(f, a->state.force[k]);
        if (simulate_is_motor(s->robot, k)) continue;
        put(f, a->state.pressure[k]);
        put(f, a->state.flow[k]);
    }
    for (int i = 0; i < 3; i++) put(f, a->state.site_from_vehicle.t[i]);
    simulate_angles(rpy, &a->state.site_from_vehicle);
    for (int i = 0; i < 3; i++) put(f, rpy[i]);
    const double energy[5] = {a->energy.kinetic, a->energy.gravity, a->energy.suspension, a->energy.oil,
                              a->energy.stops};
    for (int i = 0; i < 5; i++) put(f, energy[i]);
    fprintf(f, ",%s,%d", a->count.method == TD_INTEGRATOR_BDF ? "bdf" : "adams", a->count.order);
    put(f, a->count.step_s);
    fprintf(f, ",%ld,%ld\n", a->count.rates, a->count.steps);
}

td_status simulate_log_write(const run_result *run, const scenario *s, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path);
    write_head(f, s);
    for (size_t i = 0; i < run->count; i++) write_row(f, s, run->sample + i);
    const bool failed = fclose(f) != 0;
    td_status status = failed ? td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path)
                              : td_file_write(path, text, size, error);
    free(text);
    return status;
}
