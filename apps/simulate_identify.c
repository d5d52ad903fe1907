/* teledimos simulate --identify: a log is read, the machine's parameters are identified from it, and a motion
 * is proposed that tells more of them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/simulate_internal.h"
#include "core/csv.h"
#include "core/document.h"
#include "core/file.h"
#include "core/number.h"
#include "core/random.h"

/* Between rows of the proposed motion's table, s. */
static const double TABLE_S = 0.05;

/* ---- the log ---- */

static td_status no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the log");
}

static td_status read_column(double *out, size_t stride, const td_csv *csv, int column, td_error *error)
{
    for (size_t i = 0; i < csv->rows; i++)
        TD_TRY(td_csv_real(out + i * stride, csv, i, column, -1e12, 1e12, error));
    return TD_OK;
}

/* "boom_rad", "boom_rate_rad_s", "boom_force_n", a motor's "swing_torque_nm": as log.csv names them. */
static void column_name(char name[TD_NAME_SIZE + 16], const td_robot *robot, int joint, int what)
{
    const bool motor = simulate_is_motor(robot, joint),
               slides = robot->joint[joint].kind == TD_JOINT_PRISMATIC;
    const char *const ends[3] = {slides ? "m" : "rad", slides ? "rate_m_s" : "rate_rad_s",
                                 !motor   ? "force_n"
                                 : slides ? "torque_n"
                                          : "torque_nm"};
    snprintf(name, TD_NAME_SIZE + 16, "%s_%s", robot->joint[joint].name, ends[what]);
}

/* All joints' columns of one kind; *out stays NULL when `optional` and none is there. */
static td_status read_joints(double **out, const td_csv *csv, const td_robot *robot, int what, bool optional,
                             td_error *error)
{
    const size_t n = (size_t)robot->joint_count;
    int column[TD_ROBOT_MAX_JOINTS], found = 0;
    char name[TD_NAME_SIZE + 16];
    for (int k = 0; k < robot->joint_count; k++) {
        column_name(name, robot, k, what);
        column[k] = td_csv_column(csv, name);
        found += column[k] >= 0;
    }
    if (optional && found == 0) return TD_OK;
    for (int k = 0; k < robot->joint_count; k++) {
        column_name(name, robot, k, what);
        if (column[k] < 0)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: it has no column %s; a log names its columns as simulate's log.csv does",
                           csv->name, name);
    }
    *out = calloc(csv->rows * n + 1, sizeof **out);
    if (!*out) return no_memory(error);
    for (size_t k = 0; k < n; k++) TD_TRY(read_column(*out + k, n, csv, column[k], error));
    return TD_OK;
}

static td_status read_base(double **out, const td_csv *csv, td_error *error)
{
    static const char *const names[6] = {"base_x_m",      "base_y_m",       "base_z_m",
                                         "base_roll_rad", "base_pitch_rad", "base_yaw_rad"};
    int column[6], found = 0, missing = 0;
    for (int k = 0; k < 6; k++) {
        column[k] = td_csv_column(csv, names[k]);
        if (column[k] < 0) missing = k;
        found += column[k] >= 0;
    }
    if (found == 0) return TD_OK;
    if (found < 6)
        return td_fail(error, TD_ERROR_FORMAT, "%s: it has columns of the base, but no %s", csv->name,
                       names[missing]);
    *out = calloc(csv->rows * 6 + 1, sizeof **out);
    if (!*out) return no_memory(error);
    for (size_t k = 0; k < 6; k++) TD_TRY(read_column(*out + k, 6, csv, column[k], error));
    return TD_OK;
}

static td_status read_log(identify_job *j, td_error *error)
{
    const td_robot *robot = j->scenario->robot;
    td_csv *csv = NULL;
    TD_TRY(td_csv_read(&csv, j->path, error));
    td_status status = TD_OK;
    const int time = td_csv_column(csv, "time_s");
    j->count = csv->rows;
    j->time_s = calloc(csv->rows + 1, sizeof *j->time_s);
    if (!j->time_s)
        status = no_memory(error);
    else if (time < 0)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: it has no column time_s", csv->name);
    if (status == TD_OK) status = read_column(j->time_s, 1, csv, time, error);
    if (status == TD_OK) status = read_joints(&j->position, csv, robot, 0, false, error);
    if (status == TD_OK) status = read_joints(&j->rate, csv, robot, 1, true, error);
    if (status == TD_OK) status = read_joints(&j->force, csv, robot, 2, false, error);
    if (status == TD_OK && j->scenario->options.base != TD_MACHINE_FIXED)
        status = read_base(&j->base, csv, error);
    td_csv_free(&csv);
    return status;
}

static td_identification_options options_of(const scenario *s)
{
    td_identification_options o = td_identification_options_default(s->robot);
    o.site_from_vehicle = s->options.site_from_anchor;
    memcpy(o.gravity, s->options.gravity, sizeof o.gravity);
    o.slip = s->options.slip;
    memcpy(o.viscous, s->options.viscous, sizeof o.viscous);
    memcpy(o.coulomb, s->options.coulomb, sizeof o.coulomb);
    return o;
}

/* ---- the proposed motion ---- */

static td_status make_table(motion *m, const td_excitation *e, td_error *error)
{
    const size_t n = (size_t)e->joints, count = (size_t)ceil(e->duration_s / TABLE_S) + 1;
    *m = (motion){.kind = "table", .command = TD_COMMAND_RATE, .count = count};
    m->time_s = calloc(count, sizeof *m->time_s);
    m->value = calloc(count * n, sizeof *m->value);
    if (!m->time_s || !m->value) return td_fail(error, TD_ERROR_MEMORY, "no memory for a motion");
    for (size_t i = 0; i < count; i++) {
        m->time_s[i] = fmin((double)i * TABLE_S, e->duration_s);
        td_excitation_at(NULL, m->value + i * n, NULL, e, m->time_s[i]);
    }
    memset(m->value + (count - 1) * n, 0, n * sizeof *m->value);
    return TD_OK;
}

/* Samples of a run with the noise that the log had, as td_motion_log has them. */
static td_motion_log noisy_log(double *room, const identify_job *j, uint64_t seed)
{
    const size_t n = (size_t)j->scenario->robot->joint_count, count = j->run.count;
    double *time = room, *q = time + count, *dq = q + count * n, *force = dq + count * n,
           *base = force + count * n;
    td_random random = td_random_seed(seed, 29);
    for (size_t i = 0; i < count; i++) {
        const td_plant_state *s = &j->run.sample[i].state;
        time[i] = s->time_s;
        for (size_t k = 0; k < n; k++) {
            const td_identified_joint *noise = j->id->joint + k;
            q[i * n + k] = s->q[k] + noise->sigma_position * td_random_normal(&random);
            dq[i * n + k] = s->dq[k] + (j->rate ? noise->sigma_rate : 0) * td_random_normal(&random);
            force[i * n + k] = s->force[k] + noise->sigma_force * td_random_normal(&random);
        }
        memcpy(base + 6 * i, s->site_from_vehicle.t, 3 * sizeof *base);
        simulate_angles(base + 6 * i + 3, &s->site_from_vehicle);
        for (size_t k = 0; k < 6; k++) base[6 * i + k] += j->id->sigma_base[k] * td_random_normal(&random);
    }
    return (td_motion_log){.name = "the proposed motion",
                           .count = count,
                           .time_s = time,
                           .position = q,
                           .rate = j->rate ? dq : NULL,
                           .force = force,
                           .base = j->base ? base : NULL};
}

/* What it would tell: simulated with the robot file's parameters, and identified. A motion that the machine
 * cannot follow leaves `then` NULL. */
static td_status try_proposal(identify_job *j, uint64_t seed, const td_progress *progress, td_error *error)
{
    const td_identification_options o = options_of(j->scenario);
    scenario s = *j->scenario;
    td_error why = {0};
    s.start.site_from_vehicle = s.options.site_from_anchor;
    memcpy(s.start.q, j->proposed.start, sizeof s.start.q);
    memset(s.start.dq, 0, sizeof s.start.dq);
    s.duration_s = j->proposed.duration_s;
    s.log_s = 0.02;
    s.period_s = 0;
    td_status status = make_table(&s.motion, &j->proposed, error);
    if (status == TD_OK) status = simulate_run(&j->run, &s, true, progress, error);
    const size_t n = (size_t)s.robot->joint_count;
    double *room = status == TD_OK ? calloc(j->run.count * (7 + 3 * n), sizeof *room) : NULL;
    if (status == TD_OK && !room) status = no_memory(error);
    if (status == TD_OK && !j->run.unstable) {
        const td_motion_log log = noisy_log(room, j, seed);
        const td_status tried = td_identify(&j->then, &log, s.robot, &o, &why);
        if (tried == TD_ERROR_MEMORY) status = no_memory(error);
    }
    free(room);
    motion_free(&s.motion);
    return status;
}

static td_status propose(identify_job *j, uint64_t seed, const td_progress *progress, td_error *error)
{
    const td_robot *robot = j->scenario->robot;
    const td_identification_options o = options_of(j->scenario);
    td_excitation_options e = td_excitation_options_default(robot);
    e.seed = seed;
    for (int k = 0; k < robot->joint_count; k++) e.sigma_force[k] = j->id->joint[k].sigma_force;
    TD_TRY(td_excitation_propose(&j->proposed, robot, &o, &e, progress, error));
    return j->scenario->options.hydraulics ? try_proposal(j, seed, progress, error) : TD_OK;
}

td_status identify_run(identify_job *j, uint64_t seed, const td_progress *progress, td_error *error)
{
    const td_identification_options o = options_of(j->scenario);
    TD_TRY(read_log(j, error));
    const td_motion_log log = {.name = j->path,
                               .count = j->count,
                               .time_s = j->time_s,
                               .position = j->position,
                               .rate = j->rate,
                               .force = j->force,
                               .base = j->base};
    TD_TRY(td_identify(&j->id, &log, j->scenario->robot, &o, error));
    return propose(j, seed, progress, error);
}

void identify_free(identify_job *j)
{
    free(j->time_s);
    free(j->position);
    free(j->rate);
    free(j->force);
    free(j->base);
    td_identification_free(&j->id);
    td_identification_free(&j->then);
    run_free(&j->run);
}

/* ---- the proposed motion as files ---- */

static td_status write_table(const identify_job *j, const char *path, td_error *error)
{
    const td_robot *robot = j->scenario->robot;
    const size_t n = (size_t)robot->joint_count;
    char *text = NULL, number[TD_NUMBER_SIZE];
    size_t size = 0;
    motion m = {0};
    td_status status = make_table(&m, &j->proposed, error);
    FILE *f = status == TD_OK ? open_memstream(&text, &size) : NULL;
    if (status == TD_OK && !f) status = no_memory(error);
    if (f) {
        fputs("time_s", f);
        for (size_t k = 0; k < n; k++)
            fprintf(f, ",%s_%s", robot->joint[k].name,
                    robot->joint[k].kind == TD_JOINT_PRISMATIC ? "m_s" : "rad_s");
        for (size_t i = 0; i < m.count; i++) {
            fprintf(f, "\n%s", td_number_format(number, m.time_s[i], 12));
            for (size_t k = 0; k < n; k++)
                fprintf(f, ",%s", td_number_format(number, m.value[i * n + k], 10));
        }
        fputc('\n', f);
        if (fclose(f) != 0) status = no_memory(error);
    }
    if (status == TD_OK) status = td_file_write(path, text, size, error);
    free(text);
    motion_free(&m);
    return status;
}

/* The path of the robot's file from anywhere. */
static td_status absolute_path(char *out, size_t size, const char *path, td_error *error)
{
    char here[1024];
    if (path[0] == '/') {
        snprintf(out, size, "%s", path);
        return TD_OK;
    }
    if (!getcwd(here, sizeof here)) return td_fail(error, TD_ERROR_IO, "the present folder has no path");
    snprintf(out, size, "%s/%s", here, path);
    return TD_OK;
}

/* The scenario as it is, with another start and motion. */
static td_status write_scenario(const identify_job *j, const char *path, td_error *error)
{
    const scenario *s = j->scenario;
    json_t *root = NULL, *joints = json_object(), *start = NULL;
    char robot[2100], *text = NULL;
    td_status status = td_document_read(&root, s->path, error);
    if (status == TD_OK) status = absolute_path(robot, sizeof robot, s->robot_path, error);
    if (status == TD_OK) {
        for (int k = 0; k < s->robot->joint_count; k++)
            json_object_set_new(joints, s->robot->joint[k].name, td_json_real(j->proposed.start[k]));
        start = json_object_get(root, "start");
        if (!start) json_object_set_new(root, "start", start = json_object());
        json_object_set(start, "joints", joints);
        json_object_del(start, "rates");
        json_object_del(root, "control");
        json_object_set_new(root, "name", json_string("proposed"));
        json_object_set_new(root, "about",
                            json_string("a motion that tells more of the machine's parameters"));
        json_object_set_new(root, "robot", json_string(robot));
        json_object_set_new(root, "duration_s", td_json_real(j->proposed.duration_s));
        json_object_set_new(root, "log_s", td_json_real(0.02));
        json_object_set_new(
            root, "motion",
            json_pack("{s:s, s:s, s:s}", "kind", "table", "command", "rate", "file", "proposed.csv"));
        status = td_document_to_yaml(&text, root, 12, error);
    }
    if (status == TD_OK) status = td_file_write(path, text, strlen(text), error);
    free(text);
    json_decref(joints);
    json_decref(root);
    return status;
}

td_status identify_write(const identify_job *j, const char *folder, td_error *error)
{
    char *table = td_path_join(folder, "proposed.csv"), *file = td_path_join(folder, "proposed.yaml");
    td_status status = table && file ? td_folder_make(folder, error) : no_memory(error);
    if (status == TD_OK) status = write_table(j, table, error);
    if (status == TD_OK) status = write_scenario(j, file, error);
    free(table);
    free(file);
    return status;
}
