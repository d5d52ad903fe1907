/* What a session leaves: trajectory.csv, events.csv, recording.mcap; and its inputs read again from either of
 * the last two. All times are simulated ones, so the same inputs give the same bytes. */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_task_message.h"
#include "core/csv.h"
#include "core/file.h"
#include "core/number.h"

/* ---- which scenario ---- */

td_status task_hash_file(td_hash *hash, const char *path, td_error *error)
{
    char hex[TD_HASH_HEX_SIZE];
    TD_TRY(td_hash_file(hex, path, error));
    td_hash_add(hash, hex, strlen(hex));
    return TD_OK;
}

static td_status add_all(td_hash *hash, const void *user, td_error *error)
{
    const scenario *s = user;
    const td_machine_options *o = &s->options;
    const double number[] = {s->duration_s,
                             s->log_s,
                             s->period_s,
                             s->gain_1_s,
                             o->integrator.relative,
                             o->oil_n_m,
                             o->coriolis,
                             (double)o->integrator.method,
                             s->task->singularity,
                             s->task->miss == TD_MISS_STOP};
    char yaml[sizeof s->robot_path], hex[TD_HASH_HEX_SIZE];
    TD_TRY(task_hash_file(hash, s->path, error));
    TD_TRY(task_hash_file(hash, s->robot_path, error));
    snprintf(yaml, sizeof yaml, "%s", s->robot_path);
    char *end = strrchr(yaml, '.');
    if (end && (size_t)(end - yaml) + 6 <= sizeof yaml) memcpy(end, ".yaml", 6);
    if (task_hash_file(hash, yaml, NULL) != TD_OK) td_hash_add(hash, "none", 4);
    TD_TRY(td_task_hash(hex, s->task->task, error));
    td_hash_add(hash, hex, strlen(hex));
    if (s->has_ground && s->ground.has_soil) TD_TRY(task_hash_file(hash, s->ground.soil_path, error));
    if (s->map) {
        const td_elevation *m = s->map;
        const double place[] = {m->columns, m->rows, m->cell_m, m->origin[0], m->origin[1]};
        const size_t cells = (size_t)m->columns * (size_t)m->rows;
        td_hash_add(hash, place, sizeof place);
        td_hash_add(hash, m->height, cells * sizeof *m->height);
        td_hash_add(hash, m->sigma, cells * sizeof *m->sigma);
    }
    for (size_t i = 0; i < sizeof number / sizeof *number; i++) {
        char text[TD_NUMBER_SIZE];
        td_number_format(text, number[i], 0);
        td_hash_add(hash, text, strlen(text) + 1);
    }
    return TD_OK;
}

td_status task_identity(char hex[TD_HASH_HEX_SIZE], const scenario *s, td_error *error)
{
    return td_hash_make(hex, add_all, s, error);
}

/* ---- trajectory.csv ---- */

static void put(FILE *f, double value)
{
    char text[TD_NUMBER_SIZE];
    if (isfinite(value))
        fprintf(f, ",%s", td_number_format(text, value, 10));
    else
        fputc(',', f);
}

static void put_text(FILE *f, const char *text)
{
    fputc('"', f);
    for (; *text; text++) {
        if (*text == '"') fputc('"', f);
        fputc((unsigned char)*text < ' ' ? ' ' : *text, f);
    }
    fputc('"', f);
}

static void rows_of(FILE *f, const task_run *run, const scenario *s)
{
    const td_robot *r = s->robot;
    char text[TD_NUMBER_SIZE];
    fputs("time_s,phase,step,desired_x_m,desired_y_m,desired_z_m,desired_pitch_rad,actual_x_m,actual_y_m,"
          "actual_z_m,actual_pitch_rad,deviation_m,base_x_m,base_y_m,base_z_m,base_roll_rad,base_pitch_rad,"
          "base_yaw_rad,press_n,contact_n",
          f);
    for (int k = 0; k < r->joint_count; k++) {
        const bool slides = r->joint[k].kind == TD_JOINT_PRISMATIC;
        const char *name = r->joint[k].name, *at = slides ? "m" : "rad", *rate = slides ? "m_s" : "rad_s";
        fprintf(f, ",%s_desired_%s,%s_%s,%s_rate_%s,%s_command_%s,%s_force_%s", name, at, name, at, name,
                rate, name, simulate_is_motor(r, k) ? rate : "m3_s", name,
                simulate_is_motor(r, k) && !slides ? "nm" : "n");
    }
    fputs(s->map ? ",load_kg,depth_m\n" : "\n", f);
    for (size_t i = 0; i < run->count; i++) {
        const task_sample *a = run->sample + i;
        double rpy[3], off[3];
        fprintf(f, "%s,", td_number_format(text, a->time_s, 12));
        put_text(f, td_phase_text(a->phase));
        fprintf(f, ",%d", a->step + 1);
        for (int k = 0; k < 3; k++) put(f, a->tool_wanted.t[k]);
        put(f, a->pitch_wanted_rad);
        for (int k = 0; k < 3; k++) put(f, a->tool.t[k]), off[k] = a->tool.t[k] - a->tool_wanted.t[k];
        put(f, a->pitch_rad);
        put(f, hypot(hypot(off[0], off[1]), off[2]));
        simulate_angles(rpy, &a->state.site_from_vehicle);
        for (int k = 0; k < 3; k++) put(f, a->state.site_from_vehicle.t[k]);
        for (int k = 0; k < 3; k++) put(f, rpy[k]);
        put(f, a->press_n);
        put(f, a->contact_n);
        for (int k = 0; k < r->joint_count; k++) {
            put(f, a->wanted[k]);
            put(f, a->state.q[k]);
            put(f, a->state.dq[k]);
            put(f, a->command[k]);
            put(f, a->state.force[k]);
        }
        if (s->map) put(f, a->load_kg), put(f, a->depth_m);
        fputc('\n', f);
    }
}

/* ---- events.csv ---- */

static void event_row(FILE *f, const scenario *s, const task_note *n)
{
    char number[TD_NUMBER_SIZE];
    fprintf(f, "%ld,%s,%s,%s,", n->period, td_number_format(number, n->time_s, 12), note_kind_name(n->kind),
            n->name);
    if (n->joint >= 0) fprintf(f, "%s", s->robot->joint[n->joint].name);
    fputc(',', f);
    if (n->joint >= 0) fprintf(f, "%s", td_number_format(number, n->stick, 0));
    fputc(',', f);
    put_text(f, n->text);
    fputc('\n', f);
}

static void events_of(FILE *f, const task_run *run, const scenario *s, const char *identity)
{
    char number[TD_NUMBER_SIZE];
    fprintf(f, "period,time_s,kind,name,joint,stick,text\n0,0.0,scenario,%s,,,\"\"\n", identity);
    for (size_t i = 0; i < run->note_count; i++) event_row(f, s, run->note + i);
    fprintf(f, "%ld,%s,end,end,,,", run->input.end, td_number_format(number, run->time_s, 12));
    put_text(f, td_phase_text(run->phase));
    fputc('\n', f);
}

/* ---- recording.mcap ---- */

typedef struct recorder {
    td_mcap_writer *writer;
    int channel[TASK_CHANNELS];
    const scenario *s;
    task_sink to;
} recorder;

static td_status keep(void *user, task_channel channel, uint64_t ns, char *json, size_t size, td_error *error)
{
    recorder *r = user;
    const td_status status = td_mcap_write(r->writer, r->channel[channel], ns, json, size, error);
    free(json);
    return status;
}

td_status task_recording_begin(td_mcap_writer **writer, int channel[TASK_CHANNELS], const char *path,
                               bool on_ground, td_error *error)
{
    TD_TRY(td_mcap_writer_new(writer, path, NULL, error));
    for (int i = 0; i < TASK_CHANNELS; i++) {
        const td_mcap_channel about = task_channel_about((task_channel)i);
        if (i != TASK_TERRAIN || on_ground) TD_TRY(td_mcap_channel_add(*writer, channel + i, &about, error));
    }
    return TD_OK;
}

static td_status record_begin(recorder *r, const scenario *s, const char *path, const char *identity,
                              td_error *error)
{
    *r = (recorder){.s = s, .to = {.take = keep, .user = r, .period_s = s->period_s}};
    TD_TRY(task_recording_begin(&r->writer, r->channel, path, s->map != NULL, error));
    return task_message_begin(&r->to, s->robot, identity, error);
}

static td_status record_run(const task_sink *to, const task_run *run, const td_robot *robot, td_error *error)
{
    size_t next = 0, ground = 0;
    for (size_t i = 0; i < run->count; i++) {
        for (; next < run->note_count && run->note[next].time_s <= run->sample[i].time_s; next++)
            TD_TRY(task_message_note(to, robot, run->note + next, error));
        for (; ground < run->ground_count && run->ground[ground].time_s <= run->sample[i].time_s; ground++)
            TD_TRY(task_message_ground(to, run->ground + ground, error));
        TD_TRY(task_message_sample(to, robot, run->sample + i, error));
    }
    for (; ground < run->ground_count; ground++) TD_TRY(task_message_ground(to, run->ground + ground, error));
    for (; next < run->note_count; next++) TD_TRY(task_message_note(to, robot, run->note + next, error));
    return TD_OK;
}

static td_status record(const task_run *run, const scenario *s, const char *path, const char *identity,
                        td_error *error)
{
    recorder r;
    td_status status = record_begin(&r, s, path, identity, error);
    if (status == TD_OK) status = record_run(&r.to, run, s->robot, error);
    if (status == TD_OK) status = task_message_end(&r.to, run->input.end, run->time_s, error);
    if (status == TD_OK) status = td_mcap_finish(&r.writer, error);
    td_mcap_writer_free(&r.writer);
    return status;
}

/* ---- sessions one after another ---- */

static td_status record_parts(recorder *r, const task_part *part, size_t count, const task_given *given,
                              size_t given_count, td_error *error)
{
    const task_run nothing = {0}, *last = &nothing;
    const td_robot *robot = r->s->robot;
    for (size_t i = 0; i < given_count; i++)
        TD_TRY(task_message_input(&r->to, robot, 0, 0, given[i].kind, given[i].text, -1, 0, error));
    for (size_t i = 0; i < count; i++) {
        r->to.begun_s += last->time_s;
        TD_TRY(task_message_text(&r->to, "rehearsal", part[i].text, error));
        last = part[i].run ? part[i].run : &nothing;
        TD_TRY(record_run(&r->to, last, robot, error));
    }
    return task_message_end(&r->to, last->input.end, last->time_s, error);
}

td_status task_record_parts(const task_part *part, size_t count, const task_given *given, size_t given_count,
                            const scenario *s, const char *identity, const char *path, td_error *error)
{
    recorder r;
    td_status status = record_begin(&r, s, path, identity, error);
    if (status == TD_OK) status = record_parts(&r, part, count, given, given_count, error);
    if (status == TD_OK) status = td_mcap_finish(&r.writer, error);
    td_mcap_writer_free(&r.writer);
    return status;
}

/* ---- all of it ---- */

static td_status write_text(const task_run *run, const scenario *s, const char *identity, bool events,
                            const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path);
    if (events)
        events_of(f, run, s, identity);
    else
        rows_of(f, run, s);
    const td_status status = fclose(f) != 0
                                 ? td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the log", path)
                                 : td_file_write(path, text, size, error);
    free(text);
    return status;
}

td_status task_write(const task_run *run, const scenario *s, const char *folder, td_error *error)
{
    static const char *const names[] = {"trajectory.csv", "events.csv", "recording.mcap"};
    char identity[TD_HASH_HEX_SIZE];
    TD_TRY(task_identity(identity, s, error));
    TD_TRY(td_folder_make(folder, error));
    for (int i = 0; i < 3; i++) {
        char *path = td_path_join(folder, names[i]);
        if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
        const td_status status =
            i < 2 ? write_text(run, s, identity, i == 1, path, error) : record(run, s, path, identity, error);
        free(path);
        TD_TRY(status);
    }
    return task_write_ground(run, s, folder, error);
}

/* ---- reading inputs again ---- */

typedef struct replay {
    task_inputs *inputs;
    const scenario *s;
    const char *path;
    char identity[TD_HASH_HEX_SIZE];
    bool named, ended;
    task_given *given; /* (given_count) to be filled: the first of its kind each; others are passed over */
    size_t given_count;
} replay;

/* One row or message. `where` begins every complaint. */
static td_status take(replay *r, const char *where, long period, const char *kind, const char *name,
                      const char *joint, double stick, td_error *error)
{
    const long last = r->inputs->count ? r->inputs->item[r->inputs->count - 1].period : 0;
    if (!r->named && strcmp(kind, "scenario") != 0)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: no log of teledimos simulate: it does not begin with its scenario", r->path);
    if (strcmp(kind, "scenario") == 0) {
        if (strcmp(name, r->identity) != 0)
            return td_fail(
                error, TD_ERROR_DATA,
                "%s: it is a log of another scenario, robot, task or options (%.12s…, not %.12s… as "
                "%s): replay it with those it was made with",
                r->path, name, r->identity, r->s->path);
        r->named = true;
        return TD_OK;
    }
    if (r->ended || period < last || period > 100000000)
        return td_fail(error, TD_ERROR_FORMAT, "%s: period %ld is out of order", where, period);
    for (size_t i = 0; i < r->given_count; i++)
        if (strcmp(kind, r->given[i].kind) == 0)
            snprintf(r->given[i].text, sizeof r->given[i].text, "%s", name);
    if (strcmp(kind, "end") == 0) {
        r->ended = true;
        r->inputs->end = period;
        return TD_OK;
    }
    if (strcmp(kind, "machine") == 0)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: the session had a machine elsewhere, and the log does not tell all that it did: such a "
            "log is not replayed",
            where);
    if (strcmp(kind, "parameter") == 0)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: %s was changed in period %ld, so that the scenario does not tell what ran: such a "
            "log is not replayed",
            where, name, period);
    task_input input = {.period = period, .event = task_event_named(name), .joint = -1, .stick = stick};
    if (strcmp(kind, "report") == 0 && input.event != TD_EVENT_DEADLINE) return TD_OK;
    if (strcmp(kind, "order") != 0 && strcmp(kind, "report") != 0) return TD_OK;
    if (*joint) input.joint = td_robot_find_joint(r->s->robot, joint);
    if (input.event == TD_EVENT_COUNT || (*joint && input.joint < 0) || !(fabs(stick) <= 1) ||
        (input.event == TD_EVENT_JOG && input.joint < 0))
        return td_fail(error, TD_ERROR_FORMAT, "%s: '%s' of '%s' is no order", where, name, joint);
    return inputs_add(r->inputs, &input, error);
}

static td_status take_row(replay *r, const td_csv *csv, size_t row, const int *column, td_error *error)
{
    int period = 0;
    double stick = 0;
    char where[1200];
    const char *cell[7];
    for (int i = 0; i < 7; i++) cell[i] = td_csv_cell(csv, row, column[i]);
    TD_TRY(td_csv_int(&period, csv, row, column[0], 0, 100000000, error));
    if (*cell[5]) TD_TRY(td_csv_real(&stick, csv, row, column[5], -1, 1, error));
    snprintf(where, sizeof where, "%s:%zu", r->path, csv->line[row + 1]);
    return take(r, where, period, cell[2], cell[3], cell[4], stick, error);
}

static td_status read_csv(replay *r, td_error *error)
{
    static const char *const names[7] = {"period", "time_s", "kind", "name", "joint", "stick", "text"};
    int column[7];
    td_csv *csv = NULL;
    TD_TRY(td_csv_read(&csv, r->path, error));
    td_status status = TD_OK;
    for (int i = 0; i < 7 && status == TD_OK; i++) {
        column[i] = td_csv_column(csv, names[i]);
        if (column[i] < 0)
            status = td_fail(error, TD_ERROR_FORMAT,
                             "%s: no log of teledimos simulate: it has no column '%s' (events.csv has)",
                             r->path, names[i]);
    }
    for (size_t i = 0; status == TD_OK && i < csv->rows; i++) status = take_row(r, csv, i, column, error);
    td_csv_free(&csv);
    return status;
}

static td_status take_message(replay *r, const td_mcap_message *m, td_error *error)
{
    json_int_t period = 0;
    const char *kind = NULL, *name = NULL, *joint = NULL;
    double stick = 0;
    json_t *o = json_loadb(m->data, m->size, JSON_REJECT_DUPLICATES, NULL);
    const bool ok = o && json_unpack(o, "{s:I, s:s, s:s, s:s, s:F}", "period", &period, "kind", &kind, "name",
                                     &name, "joint", &joint, "stick", &stick) == 0;
    const td_status status = ok ? take(r, r->path, (long)period, kind, name, joint, stick, error)
                                : td_fail(error, TD_ERROR_FORMAT, "%s: a message of %s is none of ours",
                                          r->path, task_input_topic);
    json_decref(o);
    return status;
}

static td_status read_mcap(replay *r, td_error *error)
{
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    TD_TRY(td_mcap_open(&reader, r->path, 0, error));
    const int channel = td_mcap_find(reader, task_input_topic), count = td_mcap_about(reader)->channel_count;
    bool *wanted = calloc((size_t)count + 1, sizeof *wanted);
    td_status status = wanted ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a recording");
    if (status == TD_OK && channel < 0)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: no recording of teledimos simulate: it has no %s",
                         r->path, task_input_topic);
    if (status == TD_OK) {
        wanted[channel] = true;
        td_mcap_rewind(reader, wanted, 0);
        status = td_mcap_next(reader, &m, &more, error);
    }
    while (status == TD_OK && more) {
        status = take_message(r, &m, error);
        if (status == TD_OK) status = td_mcap_next(reader, &m, &more, error);
    }
    free(wanted);
    td_mcap_free(&reader);
    return status;
}

td_status task_replay_read(task_inputs *inputs, const char *path, const scenario *s, td_error *error)
{
    replay r = {.inputs = inputs, .s = s, .path = path};
    const size_t length = strlen(path);
    *inputs = (task_inputs){.end = -1};
    TD_TRY(task_identity(r.identity, s, error));
    TD_TRY(length > 5 && strcmp(path + length - 5, ".mcap") == 0 ? read_mcap(&r, error)
                                                                 : read_csv(&r, error));
    if (!r.ended) return td_fail(error, TD_ERROR_FORMAT, "%s: it has no end: the log was cut off", path);
    return TD_OK;
}

td_status task_given_read(task_given *given, size_t count, const char *path, const scenario *s,
                          const char *identity, td_error *error)
{
    task_inputs inputs = {.end = -1};
    replay r = {.inputs = &inputs, .s = s, .path = path, .given = given, .given_count = count};
    snprintf(r.identity, sizeof r.identity, "%s", identity);
    td_status status = read_mcap(&r, error);
    free(inputs.item);
    if (status == TD_OK && !r.ended)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: it has no end: the recording was cut off", path);
    for (size_t i = 0; i < count && status == TD_OK; i++)
        if (!given[i].text[0])
            status = td_fail(error, TD_ERROR_FORMAT,
                             "%s: it does not say its %s: it is no recording of this command", path,
                             given[i].kind);
    return status;
}
