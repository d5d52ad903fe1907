/* teledimos simulate: a machine moved by given commands, left alone, or doing a task. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "core/file.h"

static const char *scenario_path, *method, *compile_folder, *identify_path, *replay_path, *on_miss;
static cli_common common;
static cli_list gates;
static bool accept, sweeping, no_coriolis, live_wanted;
static double duration_s = 0, oil_n_m = 0, relative = 0, period_s = 0, gain_1_s = 0;

static const char *const methods[] = {"auto", "adams", "bdf", NULL};

static cli_option options[] = {
    {CLI_FLAG, "sweep", 0, &sweeping, NULL,
     "besides: control period against stability, gain and the oil's stiffness against cost, Coriolis terms "
     "on "
     "and off; some thirty runs",
     0, 0, NULL},
    {CLI_STRING, "identify", 0, &identify_path, "LOG",
     "instead: inertias and frictions of the machine from a recorded motion (CSV as log.csv), what it does "
     "not "
     "tell, and a motion that tells more: proposed.yaml",
     0, 0, NULL},
    {CLI_STRING, "compile", 0, &compile_folder, "DIR",
     "generate the robot's equations as C, compile them into DIR ($CC, cc) and use them; kept there for the "
     "next "
     "run. Without: the zx200's are built in, another's are evaluated link by link, which is slower",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "Tasks"},
    {CLI_FLAG, "live", 0, &live_wanted, NULL,
     "in real time, led by keys: space pause and resume, a abort, r reinit, s start, q stop, m manual and "
     "back; "
     "in manual the arrows move joints 1 and 2, u and j joint 3, i and k joint 4",
     0, 0, NULL},
    {CLI_STRING, "replay", 0, &replay_path, "LOG",
     "the orders and missed deadlines of an earlier session (its events.csv or recording.mcap): the same "
     "bytes",
     0, 0, NULL},
    {CLI_STRING, "on-miss", 0, &on_miss, "POLICY",
     "what a missed deadline does: stop, catch-up (late ticks follow at once) or slip (time falls behind)", 0,
     0, task_miss_names},
    {.type = CLI_HEADING, .name = "In place of what the scenario says"},
    {CLI_REAL, "duration", 0, &duration_s, "S",
     "simulated time; a table, a step and a hold go on as they end", 1e-3, 1e5, NULL},
    {CLI_STRING, "method", 0, &method, "NAME", "integrator: auto, adams or bdf", 0, 0, methods},
    {CLI_REAL, "relative", 0, &relative, "R", "relative tolerance", 1e-13, 0.1, NULL},
    {CLI_REAL, "oil", 0, &oil_n_m, "N/M", "stiffness of the oil", 1, 1e14, NULL},
    {CLI_REAL, "period", 0, &period_s, "S", "control period", 1e-4, 1e3, NULL},
    {CLI_REAL, "gain", 0, &gain_1_s, "K", "gain of the controller, 1/s", 0, 1e6, NULL},
    {CLI_FLAG, "no-coriolis", 0, &no_coriolis, NULL, "without centrifugal and Coriolis terms", 0, 0, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(
        common,
        "folder for the products: log.csv (a task: trajectory.csv, events.csv, recording.mcap; on a ground "
        "before.tif and after.tif), result.yaml, "
        "report.html, log.jsonl",
        "--identify: the search of a motion"),
};

static cli_command command = {
    .name = "simulate",
    .summary = "a machine moved by given commands, or doing a task: motion, forces, sag",
    .usage = "SCENARIO -o DIR [options]",
    .text =
        "Integrates the equations of a machine on its suspension, its joints driven by hydraulic cylinders "
        "with their limits of pressure and flow. SCENARIO is a folder with scenario.yaml, or the file: the "
        "robot (URDF, and the YAML beside it for cylinders and suspension), where it starts (settled), how "
        "long, how it is moved, and how that is integrated.\n\n"
        "Motions: hold, trapezoid, step, sine, or a table (CSV of time_s and a column a joint: boom_rad_s "
        "for "
        "rates, boom_m3_s for flows, boom_n for forces; straight lines between rows). Without a motion and "
        "with machine: {hydraulics: false} the joints turn freely. control: {gain_1_s, period_s} closes a "
        "loop "
        "of positions around a motion of rates.\n\n"
        "A task (task: file.yaml, or written in place, instead of motion) is done step by step: each "
        "position "
        "step planned with its law, duration and via points within every limit, followed at the control "
        "period "
        "by joints commanded with flows; press steps against the scenario's contact plane; waits. The "
        "session "
        "is led by orders as the panel's (operator: in the scenario, or --live keys), and leaves "
        "trajectory.csv, events.csv and recording.mcap (Foxglove). A machine on its suspension is simulated "
        "once more with the suspension locked, to tell what of the tool's error is due to it. On a busy "
        "machine "
        "--live keeps its ticks with real-time priority (chrt -f 10 teledimos simulate …).\n\n"
        "On a ground (ground: {map: site.tif}, or {site: scene} that is rendered and reconstructed first, "
        "into "
        "DIR/site and DIR/map, and kept) the machine stands on its tracks in a world of solid bodies, with "
        "stones and with soil (soil: loam.yaml) that is dug: the task's drives, digs and dumps are done too. "
        "A "
        "trench is planned as passes on the map, each motion is checked against it before it runs, the edge "
        "is raised where the soil asks for more than force_n or than the machine holds (0.4 of its weight), "
        "and what still stands is cut again. "
        "duration_s is then the longest. Besides: before.tif and after.tif; volumes, forces, clearance and "
        "mass balance in the result.\n\n"
        "--identify estimates, from a log with columns as log.csv has them (positions and forces; rates and "
        "the "
        "base's pose where they are measured), the sums of masses, centres and inertias that the joints' "
        "forces "
        "show, and frictions, each with its sigma, and names what the motion does not tell.\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (--accept).",
    .examples = "  teledimos simulate datasets/zx200-motion -o motion\n"
                "  teledimos simulate datasets/zx200/paper.yaml -o paper\n"
                "  teledimos simulate datasets/zx200/paper.yaml -o live --live\n"
                "  teledimos simulate datasets/zx200/paper.yaml -o again --replay live/events.csv\n"
                "  teledimos simulate datasets/zx200/dig.yaml -o dig\n"
                "  teledimos simulate datasets/zx200-motion -o sweeps --sweep\n"
                "  teledimos simulate datasets/zx200-motion -o identified --identify motion/log.csv\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &scenario_path,
};

/* Of a task and of --identify too, whose gates follow that of a simulation. */
static const char *whole_gate_help(void)
{
    static char text[4800] = GATE_HELP;
    gate_help(text, sizeof text, simulate_gate_defaults, simulate_gate_count);
    snprintf(text + strlen(text), sizeof text - strlen(text), "\nof a task:");
    gate_help(text, sizeof text, task_gate_defaults, task_gate_count);
    snprintf(text + strlen(text), sizeof text - strlen(text), "\nof --identify:");
    gate_help(text, sizeof text, identify_gate_defaults, identify_gate_count);
    return text;
}

static td_status override(scenario *s, td_error *error)
{
    if (duration_s > 0) {
        if (strcmp(s->motion.kind, "trapezoid") == 0 || strcmp(s->motion.kind, "sine") == 0)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "--duration: a %s is as long as the scenario's duration_s; change it there",
                           s->motion.kind);
        s->duration_s = duration_s;
    }
    if (s->duration_s / s->log_s > SIMULATE_MAX_ROWS / 4)
        return td_fail(error, TD_ERROR_ARGUMENT, "--duration %g: more than %d rows of the log, every %g s",
                       s->duration_s, SIMULATE_MAX_ROWS / 4, s->log_s);
    if ((period_s > 0 || gain_1_s > 0) && s->motion.command != TD_COMMAND_RATE)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--period, --gain: a controller goes with a motion of rates");
    for (int i = 0; method && methods[i]; i++)
        if (strcmp(method, methods[i]) == 0) s->options.integrator.method = (td_integrator_method)i;
    if (relative > 0) s->options.integrator.relative = relative;
    if (oil_n_m > 0) s->options.oil_n_m = oil_n_m;
    if ((period_s > 0 || gain_1_s > 0) && !(s->period_s > 0)) s->period_s = 0.05, s->gain_1_s = 3;
    if (period_s > 0 && s->task)
        for (size_t i = 0; i < s->task->orders.count; i++)
            s->task->orders.item[i].period =
                lround((double)s->task->orders.item[i].period * s->period_s / period_s);
    if (period_s > 0) s->period_s = period_s;
    for (int i = 0; on_miss && s->task && task_miss_names[i]; i++)
        if (strcmp(on_miss, task_miss_names[i]) == 0) s->task->miss = (td_miss_policy)i;
    if (gain_1_s > 0) s->gain_1_s = gain_1_s;
    if (no_coriolis) s->options.coriolis = false;
    s->compile_folder = compile_folder;
    return TD_OK;
}

static td_status write_log(const simulate_job *s, job *j)
{
    TD_TRY(td_folder_make(common.output, &j->error));
    char *path = job_path(j, "log.csv");
    if (!path) return TD_ERROR_MEMORY;
    td_status status = simulate_log_write(&s->run, &s->scenario, path, &j->error);
    free(path);
    return status;
}

/* What the machine refuses is the scenario's fault, not that of the command line. */
static td_status simulate(simulate_job *s, job *j)
{
    td_status status = simulate_run(&s->run, &s->scenario, false, &j->progress, &j->error);
    if (status == TD_ERROR_ARGUMENT) status = TD_ERROR_DATA;
    if (status == TD_ERROR_DATA) return td_error_prefix(&j->error, status, "%s", s->scenario.path);
    if (status == TD_OK && sweeping)
        status = simulate_sweep(&s->sweep, &s->scenario, &j->progress, &j->error);
    return status;
}

/* ---- a task ---- */

/* What goes with what. */
static td_status check_task_options(const scenario *s, td_error *error)
{
    if (s->task && sweeping)
        return td_fail(error, TD_ERROR_ARGUMENT, "--sweep goes with a motion; %s has a task", s->path);
    if (s->task && live_wanted && replay_path)
        return td_fail(error, TD_ERROR_ARGUMENT, "--live and --replay: one of them");
    if (!s->task && (live_wanted || replay_path || on_miss))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--live, --replay, --on-miss go with a task; %s has a motion", s->path);
    return TD_OK;
}

static td_status simulate_task(task_job *t, job *j)
{
    const scenario *s = t->scenario;
    task_inputs replayed = {0};
    struct live *live = NULL;
    td_status status = TD_OK;
    if (replay_path) status = task_replay_read(&replayed, replay_path, s, &j->error);
    if (status == TD_OK && live_wanted) status = live_begin(&live, s, &j->term, j->log, &j->error);
    if (status == TD_OK)
        status = task_run_session(&t->run, s, s->options.base, replay_path ? &replayed : NULL, live,
                                  &j->progress, &j->error);
    live_end(&live);
    free(replayed.item);
    if (status != TD_OK || s->map || s->options.base != TD_MACHINE_SUSPENDED || !t->run.simulated)
        return status;
    t->has_locked = true;
    return task_run_session(&t->locked, s, TD_MACHINE_FIXED, &t->run.input, NULL, &j->progress, &j->error);
}

static td_status run_task(simulate_job *s, job *j)
{
    gate_row rows[8];
    task_job t = {.scenario = &s->scenario};
    memcpy(rows, task_gate_defaults, task_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, task_gate_count, gates.value[i], &j->error));
    if (s->scenario.has_ground)
        TD_TRY(station_ground_map(&s->scenario.map, &s->scenario.ground, common.output, common.threads,
                                  &j->progress, &j->error));
    td_status status = simulate_task(&t, j);
    if (status == TD_ERROR_ARGUMENT) status = TD_ERROR_DATA;
    if (status == TD_ERROR_DATA && !replay_path) td_error_prefix(&j->error, status, "%s", s->scenario.path);
    if (status == TD_OK) {
        task_judge(&t, rows);
        s->gate = t.gate;
        if (terminal_interrupted()) status = td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    }
    if (status == TD_OK) status = task_write(&t.run, &s->scenario, common.output, &j->error);
    const job_output output = {task_report, task_table, &t};
    j->schema = task_schema;
    j->schema_count = task_schema_count;
    if (status == TD_OK) status = job_finish(j, task_result(&t), &output);
    task_run_free(&t.run);
    task_run_free(&t.locked);
    return status;
}

/* ---- a motion ---- */

static td_status run(simulate_job *s, job *j)
{
    TD_TRY(scenario_read(&s->scenario, scenario_path, &j->error));
    TD_TRY(check_task_options(&s->scenario, &j->error));
    TD_TRY(override(&s->scenario, &j->error));
    if (s->scenario.task) return run_task(s, j);
    gate_row rows[8];
    memcpy(rows, simulate_gate_defaults, simulate_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, simulate_gate_count, gates.value[i], &j->error));
    TD_TRY(simulate(s, j));
    s->has_sweep = sweeping;
    simulate_judge(s, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(write_log(s, j));
    const job_output output = {simulate_report, simulate_table, s};
    return job_finish(j, simulate_result(s), &output);
}

static td_status identify(identify_job *i, simulate_job *s, job *j)
{
    gate_row rows[8];
    memcpy(rows, identify_gate_defaults, identify_gate_count * sizeof *rows);
    for (size_t k = 0; k < gates.count; k++)
        TD_TRY(gate_set(rows, identify_gate_count, gates.value[k], &j->error));
    if (sweeping)
        return td_fail(&j->error, TD_ERROR_ARGUMENT, "--sweep goes with a simulation, not with --identify");
    TD_TRY(scenario_read(&s->scenario, scenario_path, &j->error));
    TD_TRY(override(&s->scenario, &j->error));
    *i = (identify_job){.scenario = &s->scenario, .path = identify_path};
    td_status status = identify_run(i, (uint64_t)common.seed, &j->progress, &j->error);
    if (status != TD_OK) return status == TD_ERROR_ARGUMENT ? TD_ERROR_DATA : status;
    identify_judge(i, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(identify_write(i, common.output, &j->error));
    s->gate = i->gate;
    const job_output output = {identify_report, identify_table, i};
    return job_finish(j, identify_result(i), &output);
}

/* Of --schema with a scenario that has a task. */
static bool has_task(int argc, char **argv)
{
    bool found = false;
    for (int i = 1; i < argc; i++) {
        char *text = NULL;
        size_t size = 0;
        if (argv[i][0] == '-' || td_file_read(&text, &size, argv[i], 1 << 20, NULL) != TD_OK) continue;
        found = found || strncmp(text, "task:", 5) == 0 || strstr(text, "\ntask:");
        free(text);
    }
    return found;
}

/* The schema is chosen before the command line is parsed, for --schema. */
static bool identifies(int argc, char **argv)
{
    for (int i = 1; i < argc; i++)
        if (strncmp(argv[i], "--identify", 10) == 0) return true;
    return false;
}

int main(int argc, char **argv)
{
    job j;
    identify_job identification = {0};
    const bool identifying = identifies(argc, argv);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = whole_gate_help();
    const bool tasking = !identifying && has_task(argc, argv);
    const td_schema_row *schema = identifying ? identify_schema : tasking ? task_schema : simulate_schema;
    const size_t schema_count = identifying ? identify_schema_count
                                : tasking   ? task_schema_count
                                            : simulate_schema_count;
    int code = job_begin(&j, &command, &common, schema, schema_count, true, argc, argv);
    if (code >= 0) return code;
    simulate_job *s = calloc(1, sizeof *s);
    td_status status;
    if (!s)
        status = td_fail(&j.error, TD_ERROR_MEMORY, "out of memory");
    else if (!scenario_path)
        status = td_fail(&j.error, TD_ERROR_ARGUMENT, "SCENARIO is missing (usage: teledimos %s %s)",
                         command.name, command.usage);
    else
        status = identify_path ? identify(&identification, s, &j) : run(s, &j);
    code = job_end(&j, status, s && s->gate.verdict == VERDICT_REFUSED && !accept);
    identify_free(&identification);
    if (s) {
        scenario_free(&s->scenario);
        run_free(&s->run);
    }
    free(s);
    return code;
}
