/* scenario.yaml: which robot, from where, how long, moved how, integrated how. All but the first, third and
 * duration_s may be missing (motion: only where hydraulics are off):
 *
 *   teledimos: scenario 1
 *   name: dig
 *   robot: ../zx200/zx200.urdf                    (with its YAML beside it)
 *   start:                                        (settled there: the base sunk in, the cylinders loaded)
 *     joints: {boom: -0.4, arm: 1.4}              (rad or m; 0 or the nearest stop)
 *     rates: {swing: 0.1}
 *     base: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}     (where its tracks stand while they bear nothing)
 *   duration_s: 6
 *   log_s: 0.02
 *   gravity_m_s2: [0, 0, -9.80665]
 *   motion: {kind: hold}
 *           {kind: trapezoid, command: rate, joints: {boom: -0.1}, ramp_s: 1}      (of flow, force or rate)
 *           {kind: step, command: flow, joints: {boom: -1e-3}, at_s: 0.5}
 *           {kind: sine, joints: {bucket: 0.3}, frequency_hz: 0.5}
 *           {kind: table, command: flow, file: commands.csv}    (time_s, boom_m3_s, swing_rad_s …)
 *   task: dig.yaml                                (in place of the motion; more in simulate_task_read.c)
 *   ground: {map: site.tif, soil: loam.yaml}      (with a task: in the world, on a map; more in station.h)
 *   control: {gain_1_s: 3, period_s: 0.05}        (positions controlled around a motion of rates, or of a
 * task) machine: {base: suspended, coriolis: true, hydraulics: true, oil_n_m: 1e8, oil_s: 0.01, valve_s:
 * 0.05, pump_m3_s: 7.07e-3, suspension_damping: 1, friction: 1}   (the last two: factors) integrator:
 * {method: auto, relative: 1e-4, max_step_s: 0} */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "apps/simulate_task.h"
#include "core/document.h"
#include "core/file.h"

/* Without a word in the scenario: what has gathered after the paper's manoeuvre is below 1e-6 rad. */
static const double DEFAULT_RELATIVE = 1e-4;

void scenario_free(scenario *s)
{
    td_robot_free(&s->robot);
    motion_free(&s->motion);
    task_setup_free(&s->task);
    td_elevation_free(&s->map);
}

static td_status real(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

static td_status flag(bool *value, const td_field *parent, const char *key, td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_bool(value, &field, error) : TD_OK;
}

/* ---- the robot, and where it begins ---- */

static td_status read_robot(scenario *s, const td_field *root, const char *folder, td_error *error)
{
    const td_field field = td_field_get(root, "robot");
    const char *name = NULL;
    TD_TRY(td_field_string(&name, &field, error));
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    snprintf(s->robot_path, sizeof s->robot_path, "%s", path);
    free(path);
    return td_robot_read(&s->robot, s->robot_path, error);
}

static td_status read_joints(double *value, const td_field *parent, const char *key, const scenario *s,
                             td_error *error)
{
    const td_field field = td_field_get(parent, key);
    if (!field.value) return TD_OK;
    const char *keys[TD_ROBOT_MAX_JOINTS + 1] = {NULL};
    for (int k = 0; k < s->robot->joint_count; k++) keys[k] = s->robot->joint[k].name;
    TD_TRY(td_field_check_keys(&field, keys, error));
    for (int k = 0; k < s->robot->joint_count; k++)
        TD_TRY(real(value + k, &field, keys[k], -1e6, 1e6, error));
    return TD_OK;
}

static td_status read_start(scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"joints", "rates", "base", NULL};
    const td_field start = td_field_get(root, "start");
    for (int k = 0; k < s->robot->joint_count; k++) {
        const td_robot_joint *j = s->robot->joint + k;
        s->start.q[k] = fmax(j->lower, fmin(j->upper, 0));
    }
    s->start.site_from_vehicle = td_pose_identity();
    if (!start.value) return TD_OK;
    TD_TRY(td_field_check_keys(&start, keys, error));
    const td_field base = td_field_get(&start, "base");
    if (base.value) TD_TRY(td_field_pose(&s->start.site_from_vehicle, &base, error));
    TD_TRY(read_joints(s->start.q, &start, "joints", s, error));
    return read_joints(s->start.dq, &start, "rates", s, error);
}

/* ---- the machine and its integrator ---- */

static td_status read_machine(scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"base",    "coriolis",  "hydraulics",         "oil_n_m",  "oil_s",
                                       "valve_s", "pump_m3_s", "suspension_damping", "friction", NULL};
    static const char *const bases[] = {"suspended", "fixed", "floating", NULL};
    td_machine_options *o = &s->options;
    const td_field machine = td_field_get(root, "machine");
    double friction = 1;
    int base = (int)o->base;
    if (!machine.value) return TD_OK;
    TD_TRY(td_field_check_keys(&machine, keys, error));
    const td_field base_field = td_field_get(&machine, "base");
    if (base_field.value)
        TD_TRY(td_field_choice(&base, &base_field, bases, "suspended, fixed or floating", error));
    o->base = (td_machine_base)base;
    TD_TRY(flag(&o->coriolis, &machine, "coriolis", error));
    TD_TRY(flag(&o->hydraulics, &machine, "hydraulics", error));
    TD_TRY(real(&o->oil_n_m, &machine, "oil_n_m", 1, 1e14, error));
    TD_TRY(real(&o->oil_s, &machine, "oil_s", 0, 10, error));
    TD_TRY(real(&o->valve_s, &machine, "valve_s", 1e-6, 1e3, error));
    TD_TRY(real(&o->pump_m3_s, &machine, "pump_m3_s", 1e-12, 1e6, error));
    TD_TRY(real(&o->suspension, &machine, "suspension_damping", 0, 1e6, error));
    TD_TRY(real(&friction, &machine, "friction", 0, 1e6, error));
    for (int k = 0; k < s->robot->joint_count; k++) o->viscous[k] *= friction, o->coulomb[k] *= friction;
    return TD_OK;
}

static td_status read_integrator(scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"method", "relative", "max_step_s", NULL};
    static const char *const methods[] = {"auto", "adams", "bdf", NULL};
    td_integrator_options *o = &s->options.integrator;
    const td_field field = td_field_get(root, "integrator");
    int method = (int)o->method;
    o->relative = DEFAULT_RELATIVE;
    if (!field.value) return TD_OK;
    TD_TRY(td_field_check_keys(&field, keys, error));
    const td_field method_field = td_field_get(&field, "method");
    if (method_field.value)
        TD_TRY(td_field_choice(&method, &method_field, methods, "auto, adams or bdf", error));
    o->method = (td_integrator_method)method;
    TD_TRY(real(&o->relative, &field, "relative", 1e-13, 0.1, error));
    return real(&o->max_step_s, &field, "max_step_s", 0, 1e6, error);
}

static td_status read_control(scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"gain_1_s", "period_s", NULL};
    const td_field control = td_field_get(root, "control");
    if (!control.value) return TD_OK;
    if (s->motion.command != TD_COMMAND_RATE)
        return td_field_fail(&control, error, "a controller of positions goes with a motion of rates");
    TD_TRY(td_field_check_keys(&control, keys, error));
    s->gain_1_s = 3;
    s->period_s = 0.05;
    TD_TRY(real(&s->gain_1_s, &control, "gain_1_s", 0, 1e6, error));
    return real(&s->period_s, &control, "period_s", 1e-4, 1e3, error);
}

static td_status read_times(scenario *s, const td_field *root, td_error *error)
{
    const td_field duration = td_field_get(root, "duration_s"), gravity = td_field_get(root, "gravity_m_s2");
    TD_TRY(td_field_real(&s->duration_s, &duration, 1e-3, 1e5, error));
    s->log_s = 0.02;
    TD_TRY(real(&s->log_s, root, "log_s", 1e-5, 1e5, error));
    if (s->duration_s / s->log_s > SIMULATE_MAX_ROWS / 4)
        return td_field_fail(&duration, error, "%g s every %g s are more than %d rows of the log",
                             s->duration_s, s->log_s, SIMULATE_MAX_ROWS / 4);
    if (gravity.value) TD_TRY(td_field_reals(s->options.gravity, 3, &gravity, -1e3, 1e3, error));
    return TD_OK;
}

static td_status read_all(scenario *s, const td_field *root, const char *folder, td_error *error)
{
    static const char *const keys[] = {
        "teledimos",    "name",    "about",      "robot",   "start",      "motion", "log_s",
        "gravity_m_s2", "machine", "integrator", "control", "duration_s", NULL};
    static const char *const task_keys[] = {
        "teledimos",      "name",         "about",   "robot",      "start",   "task",       "log_s",
        "contact",        "gravity_m_s2", "machine", "integrator", "control", "duration_s", "operator",
        "on_singularity", "generator",    "live",    "ground",     NULL};
    const td_field version = td_field_get(root, "teledimos"), name_field = td_field_get(root, "name"),
                   motion_field = td_field_get(root, "motion"), task_field = td_field_get(root, "task"),
                   ground = td_field_get(root, "ground");
    const char *text = NULL;
    TD_TRY(td_field_string(&text, &version, error));
    if (strcmp(text, "scenario 1") != 0)
        return td_field_fail(&version, error, "'%s' is not 'scenario 1'", text);
    TD_TRY(td_field_check_keys(root, task_field.value ? task_keys : keys, error));
    TD_TRY(td_field_string(&text, &name_field, error));
    snprintf(s->name, sizeof s->name, "%s", text);
    TD_TRY(read_robot(s, root, folder, error));
    s->options = td_machine_options_default(s->robot);
    TD_TRY(read_start(s, root, error));
    s->options.site_from_anchor = s->start.site_from_vehicle;
    TD_TRY(read_machine(s, root, error));
    TD_TRY(read_integrator(s, root, error));
    TD_TRY(read_times(s, root, error));
    if (ground.value) {
        s->has_ground = true;
        TD_TRY(station_ground_read(&s->ground, &ground, folder, error));
    }
    if (task_field.value) {
        TD_TRY(motion_none(&s->motion, s->robot, error));
        s->gain_1_s = 3, s->period_s = 0.05;
        TD_TRY(read_control(s, root, error));
        return task_setup_read(&s->task, s, root, folder, error);
    }
    if (motion_field.value) {
        TD_TRY(motion_read(&s->motion, &motion_field, s->robot, s->duration_s, folder, error));
    } else {
        const td_field none = {.parent = root, .name = "motion", .value = NULL};
        if (s->options.hydraulics)
            return td_field_fail(&none, error,
                                 "is missing; without one, machine: {hydraulics: false} lets the "
                                 "joints turn freely");
        TD_TRY(motion_none(&s->motion, s->robot, error));
    }
    return read_control(s, root, error);
}

td_status scenario_read(scenario *s, const char *path, td_error *error)
{
    struct stat about;
    const bool is_folder = stat(path, &about) == 0 && S_ISDIR(about.st_mode);
    char *file = is_folder ? td_path_join(path, "scenario.yaml") : td_path_join(".", path);
    char *folder = file ? td_path_folder(is_folder ? file : path) : NULL;
    json_t *root = NULL;
    if (!file || !folder) {
        free(file);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    }
    snprintf(s->path, sizeof s->path, "%s", is_folder ? file : path);
    td_status status = td_document_read(&root, s->path, error);
    const td_field top = {.parent = NULL, .name = s->path, .value = root};
    if (status == TD_OK) status = read_all(s, &top, folder, error);
    json_decref(root);
    free(file);
    free(folder);
    return status;
}
