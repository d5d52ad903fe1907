/* teledimos panel: the master station's server and the operator's page. A scenario's session in real time,
 * seen and led over the network. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_model.h"
#include "apps/panel_door.h"
#include "apps/panel_internal.h"
#include "core/document.h"

static const char *scenario_path, *listen_at, *token_file, *certificate, *key_file, *on_miss, *left_source,
    *right_source, *target_words;
static double rate_hz = 10;
static cli_common common;
static cli_list origins, places;
static bool insecure;
static int port = -1, most_clients = 256;
static double for_s;
static machine_address far = {.period_s = 0.1};

static cli_option options[] = {
    {CLI_INT, "port", 0, &port, "N", "of 127.0.0.1; 0: any free one; default 8765", 0, 65535, NULL},
    {CLI_STRING, "listen", 0, &listen_at, "HOST:PORT",
     "another address of this machine (IPv4; 0.0.0.0: all): needs --token-file, and --cert and --key or "
     "--insecure",
     0, 0, NULL},
    {CLI_STRING, "token-file", 0, &token_file, "FILE",
     "who connects must know its first line: ws://…/?token=…, or Authorization: Bearer …", 0, 0, NULL},
    {CLI_STRING, "cert", 0, &certificate, "FILE", "certificate for TLS (PEM)", 0, 0, NULL},
    {CLI_STRING, "key", 0, &key_file, "FILE", "its private key (PEM)", 0, 0, NULL},
    {CLI_FLAG, "insecure", 0, &insecure, NULL,
     "without TLS: the token and all that is ordered can be read and changed on the way", 0, 0, NULL},
    {CLI_LIST, "origin", 0, &origins, "URL",
     "pages from there may connect too, as https://app.foxglove.dev; may be given several times", 0, 0, NULL},
    {CLI_INT, "clients", 0, &most_clients, "N", "at most so many at once; default 256", 1, 4096, NULL},
    {CLI_REAL, "for", 0, &for_s, "S", "ends after so many seconds; default: with SIGINT or SIGTERM", 0.01,
     1e7, NULL},
    {CLI_STRING, "on-miss", 0, &on_miss, "POLICY",
     "what a missed deadline does: stop, catch-up (late ticks follow at once) or slip (time falls behind)", 0,
     0, task_miss_names},
    {.type = CLI_HEADING, .name = "The machine that does it"},
    MACHINE_ADDRESS_OPTIONS(far),
    {.type = CLI_HEADING, .name = "Pictures"},
    {CLI_STRING, "left", 0, &left_source, "SOURCE",
     "pictures to acquire: a camera, a video, a folder or a pattern, as teledimos capture takes them", 0, 0,
     NULL},
    {CLI_STRING, "right", 0, &right_source, "SOURCE", "and those of the pair's other camera", 0, 0, NULL},
    {CLI_REAL, "rate", 0, &rate_hz, "HZ", "pictures a second; default 10", 0.1, 100, NULL},
    {CLI_STRING, "target", 0, &target_words, "TARGET",
     "what is seen, for the dataset that is stored: 'marks 6x6 30mm diameter 20.7mm'", 0, 0, NULL},
    {CLI_LIST, "bench", 0, &places, "DATASET",
     "a dataset, or a folder of pictures, that may be opened; may be given several times", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for the products: recording.mcap, audit.jsonl, result.yaml, log.jsonl",
                       "nothing is drawn"),
};

static cli_command command = {
    .name = "panel",
    .summary = "a session in real time, seen and led over the network (Foxglove)",
    .usage = "SCENARIO -o DIR [options]",
    .text =
        "Runs the session of a scenario with a task (see teledimos simulate) in real time, and serves a page "
        "to lead it by: http://127.0.0.1:8765/ in a browser. Parameters, orders, the state of the session, "
        "curves of what is wanted and what is, and the machine on its ground in 3D, live or from a "
        "recording. Where a token is asked for, give it to the page as ?token=…; the page itself holds "
        "nothing "
        "and is served to all.\n\n"
        "The same goes "
        "over "
        "the Foxglove WebSocket protocol: Foxglove, and any client of its protocol, sees the machine move, "
        "its "
        "joints, forces, the ground, events and deadlines, and leads it. The same messages go into "
        "recording.mcap, written as they come.\n\n"
        "The session begins prepared and at rest; orders that the scenario holds are left out. Services are "
        "the orders of its behaviour: Prepare, "
        "StartSim, "
        "Pause, Resume, Abort, UserStop, Reinit, Validate, Download, Execute, Manual, Automatic and Jog "
        "{joint, stick, for_s}. Durations, laws and goals of the task and the generator's alpha and power "
        "are "
        "parameters, to be set while nothing runs. Many may watch; one holds control (TakeControl), gives it "
        "back (ReleaseControl) or hands it over (ReleaseControl with {to: N}). When the operator's "
        "connection "
        "is lost, or answers nothing for 3 s, the machine is stopped (UserStop).\n\n"
        "It listens to this machine alone. Elsewhere (--listen) a token is demanded, and TLS, or --insecure "
        "said aloud. Pages in a browser are taken from this server's own address, and from those that "
        "--origin "
        "names. audit.jsonl gets a line for each order, its answer, each refusal and who held control, and "
        "is "
        "only ever added to; where it cannot be written, only what stops the machine is obeyed. A watcher "
        "who is slow skips what is no longer new; one who reads nothing for 10 "
        "s "
        "is put out.\n\n"
        "Pictures: --left and --right are shown live (/acquire), frozen and stored (Freeze, Store) in "
        "DIR/acquired; datasets named by --bench, and that one, are opened, calibrated and matched by clicks "
        "(OpenBench, FindMarks, Calibrate, MatchPoint …; see teledimos workbench). Each client has a bench "
        "of "
        "its own, four in all, in a process of its own; what is left on the disk is for who holds "
        "control.\n\n"
        "--machine: the master station of a machine in a process of its own (teledimos machine). Download "
        "sends the task that was simulated and validated here, with its hash and results, and the machine "
        "checks it by its own simulation; Execute has it done there, while the simulated machine goes with "
        "it. Pause, Resume, Abort, UserStop, Reinit, Manual, Automatic and Jog reach the machine. "
        "/measured/tf, /measured/joints and /measured/machine show it as it measures itself, /link its phase "
        "and the link's figures, /camera/left and /camera/right what it sees. A panel that is lost stops the "
        "machine; begun again it shows where and why it stands, and moves it after Reinit.\n\n"
        "SIGINT and SIGTERM stop the machine and end the recording. teledimos simulate SCENARIO --replay "
        "DIR/recording.mcap does the session again, unless parameters were changed. On a busy machine "
        "real-time priority keeps the ticks (chrt -f 10 teledimos panel …).\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the simulation broke off.",
    .examples =
        "  teledimos panel datasets/zx200/paper.yaml -o panel\n"
        "  teledimos panel datasets/zx200/paper.yaml -o panel --origin https://app.foxglove.dev\n"
        "  teledimos panel datasets/zx200/dig.yaml -o panel --port 0 --for 60\n"
        "  openssl rand -hex 32 >token; chmod 600 token\n"
        "  teledimos machine datasets/zx200/dig.yaml --listen 127.0.0.1:7421 --token-file token -o site "
        "--for 90 & sleep 3\n"
        "  teledimos panel datasets/zx200/dig.yaml -o panel --port 0 --for 20 --machine 127.0.0.1:7421 "
        "--machine-token-file token\n"
        "  teledimos panel datasets/zx200/paper.yaml -o panel --bench datasets/visp-marks --bench "
        "datasets/aloe\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &scenario_path,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "panel"},
    {"version", TD_SCHEMA_STRING, true, false, "of the program"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"robot", TD_SCHEMA_STRING, true, false, "its name"},
    {"task", TD_SCHEMA_STRING, true, false, "its name"},
    {"url", TD_SCHEMA_STRING, true, false, "where it was served"},
    {"time_s", TD_SCHEMA_REAL, true, false, "of the session"},
    {"phase", TD_SCHEMA_STRING, true, false, "of the session at its end"},
    {"deadlines", TD_SCHEMA_OBJECT, true, false, "of the session's periods"},
    {"deadlines.on_miss", TD_SCHEMA_STRING, true, false, "stop, catch-up or slip"},
    {"deadlines.tolerance_s", TD_SCHEMA_REAL, true, false, "later than this is missed"},
    {"deadlines.ticks", TD_SCHEMA_INT, true, false, "periods"},
    {"deadlines.misses", TD_SCHEMA_INT, true, false, "of them missed"},
    {"deadlines.late_p50_s", TD_SCHEMA_REAL, true, false, "half of the ticks are later than this"},
    {"deadlines.late_p99_s", TD_SCHEMA_REAL, true, false, "one in a hundred is later than this"},
    {"deadlines.late_max_s", TD_SCHEMA_REAL, true, false, "the latest"},
    {"deadlines.cpu_share", TD_SCHEMA_REAL, true, false, "the session's processor time over its time"},
    {"clients", TD_SCHEMA_OBJECT, true, false, "who connected"},
    {"clients.most", TD_SCHEMA_INT, true, false, "at once"},
    {"clients.turned_away", TD_SCHEMA_INT, true, false, "not let in: token, origin, number, subprotocol"},
    {"clients.put_out", TD_SCHEMA_INT, true, false, "read nothing, answered no ping, or were too slow"},
    {"orders", TD_SCHEMA_OBJECT, true, false, "what they asked for"},
    {"orders.passed", TD_SCHEMA_INT, true, false, "on to the session"},
    {"orders.accepted", TD_SCHEMA_INT, true, false, "by it"},
    {"orders.refused", TD_SCHEMA_INT, true, false, "by it or before; and messages that are none"},
    {"orders.faults", TD_SCHEMA_INT, true, false, "messages that are none"},
    {"messages", TD_SCHEMA_OBJECT, true, false, "of channels"},
    {"messages.sent", TD_SCHEMA_INT, true, false, "to all clients"},
    {"messages.skipped", TD_SCHEMA_INT, true, false, "no longer new when a client could take them"},
    {"messages.samples_dropped", TD_SCHEMA_INT, true, false, "never seen by the server, which was busy"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the output folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "a name"},
};

typedef struct panel {
    scenario scenario;
    task_run run;
    panel_options options;
    char host[64], url[120];
    panel_parameter parameter[PANEL_MAX_PARAMETERS];
    int parameter_count;
    panel_link link;
    panel_counts counts;
    uint64_t dropped;
    far_machine *machine;
} panel;

/* ---- the result ---- */

static json_t *whole(uint64_t number)
{
    return json_integer((json_int_t)number);
}

static json_t *deadlines_json(const panel *p)
{
    const td_clock_counts *c = &p->run.live.counts;
    return json_pack("{s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "on_miss",
                     task_miss_names[p->scenario.task->miss], "tolerance_s",
                     td_json_real(p->scenario.task->tolerance_s), "ticks", whole(c->ticks), "misses",
                     whole(c->misses), "late_p50_s", td_json_real(1e-9 * (double)td_clock_late(c, 0.5)),
                     "late_p99_s", td_json_real(1e-9 * (double)td_clock_late(c, 0.99)), "late_max_s",
                     td_json_real(1e-9 * (double)c->late_max_ns), "cpu_share",
                     td_json_real(p->run.time_s > 0 ? p->run.cpu_s / p->run.time_s : 0));
}

static json_t *result(const panel *p)
{
    const panel_counts *c = &p->counts;
    json_t *root =
        json_pack("{s:s, s:s, s:s, s:s, s:s, s:s, s:o, s:s, s:o}", "job", "panel", "version", TD_VERSION,
                  "scenario", p->scenario.name, "robot", p->scenario.robot->name, "task",
                  p->scenario.task->task->name, "url", p->url, "time_s", td_json_real(p->run.time_s), "phase",
                  td_phase_text(p->run.phase), "deadlines", deadlines_json(p));
    json_object_set_new(root, "clients",
                        json_pack("{s:o, s:o, s:o}", "most", whole(c->most_clients), "turned_away",
                                  whole(c->turned_away), "put_out", whole(c->slow)));
    json_object_set_new(root, "orders",
                        json_pack("{s:o, s:o, s:o, s:o}", "passed", whole(c->orders), "accepted",
                                  whole(c->accepted), "refused", whole(c->refused), "faults",
                                  whole(c->faults)));
    json_object_set_new(root, "messages",
                        json_pack("{s:o, s:o, s:o}", "sent", whole(c->sent), "skipped", whole(c->skipped),
                                  "samples_dropped", whole(p->dropped)));
    json_object_set_new(root, "products",
                        json_pack("{s:s, s:s, s:s, s:s}", "result", "result.yaml", "recording",
                                  "recording.mcap", "audit", "audit.jsonl", "log", "log.jsonl"));
    return root;
}

static void table(const void *done)
{
    const panel *p = done;
    const panel_counts *c = &p->counts;
    const td_clock_counts *t = &p->run.live.counts;
    printf("%.1f s, %llu periods, %llu deadlines missed; late by %.3f ms (99 %%), %.3f ms (most)\n",
           p->run.time_s, (unsigned long long)t->ticks, (unsigned long long)t->misses,
           1e-6 * (double)td_clock_late(t, 0.99), 1e-6 * (double)t->late_max_ns);
    printf("clients: %llu at most, %llu turned away, %llu put out; %llu messages sent, %llu skipped\n",
           (unsigned long long)c->most_clients, (unsigned long long)c->turned_away,
           (unsigned long long)c->slow, (unsigned long long)c->sent, (unsigned long long)c->skipped);
    printf("orders: %llu passed on, %llu accepted, %llu refused; in the end: %s\n",
           (unsigned long long)c->orders, (unsigned long long)c->accepted, (unsigned long long)c->refused,
           td_phase_text(p->run.phase));
}

/* ---- what was asked for ---- */

static td_status read_options(panel *p, td_error *error)
{
    p->options = (panel_options){.host = "127.0.0.1",
                                 .port = port < 0 ? 8765 : port,
                                 .token_file = token_file,
                                 .certificate = certificate,
                                 .key = key_file,
                                 .insecure = insecure,
                                 .origin = origins.value,
                                 .origin_count = origins.count,
                                 .most_clients = most_clients,
                                 .for_s = for_s,
                                 .bench = {.source = {left_source, right_source},
                                           .target = target_words,
                                           .rate_hz = rate_hz,
                                           .place = places.value,
                                           .places = places.count}};
    if (right_source && !left_source) return td_fail(error, TD_ERROR_ARGUMENT, "--right goes with --left");
    if (places.count > PANEL_BENCH_PLACES)
        return td_fail(error, TD_ERROR_ARGUMENT, "--bench: %zu are given; at most %d are opened",
                       places.count, PANEL_BENCH_PLACES);
    if (listen_at && port >= 0) return td_fail(error, TD_ERROR_ARGUMENT, "--listen and --port: one of them");
    if (!certificate != !key_file) return td_fail(error, TD_ERROR_ARGUMENT, "--cert and --key go together");
    if (!listen_at) return TD_OK;
    TD_TRY(panel_door_address(p->host, sizeof p->host, &p->options.port, listen_at, error));
    p->options.host = p->host;
    if (panel_door_is_local(p->host)) return TD_OK;
    if (!token_file)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--listen %s: others reach this address: give --token-file FILE (openssl rand -hex 32 "
                       "makes a token)",
                       listen_at);
    if (!certificate && !insecure)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--listen %s: without TLS others read the token on its way: give --cert and --key, or "
                       "say --insecure",
                       listen_at);
    return TD_OK;
}

static td_status read_scenario(panel *p, job *j)
{
    scenario *s = &p->scenario;
    if (!scenario_path)
        return td_fail(&j->error, TD_ERROR_ARGUMENT, "SCENARIO is missing (usage: teledimos %s %s)",
                       command.name, command.usage);
    TD_TRY(scenario_read(s, scenario_path, &j->error));
    if (!s->task)
        return td_fail(&j->error, TD_ERROR_DATA, "%s: it has a motion; the panel leads a task", s->path);
    for (int i = 0; on_miss && task_miss_names[i]; i++)
        if (strcmp(on_miss, task_miss_names[i]) == 0) s->task->miss = (td_miss_policy)i;
    if (s->has_ground)
        TD_TRY(
            station_ground_map(&s->map, &s->ground, common.output, common.threads, &j->progress, &j->error));
    p->parameter_count = panel_parameters_of(p->parameter, s);
    return TD_OK;
}

/* ---- the session ---- */

static td_status lead(panel *p, job *j)
{
    static const task_inputs none = {.end = -1}; /* the operator's, not the scenario's */
    struct live *live = NULL;
    td_status status =
        panel_live_begin(&live, &p->link, &p->scenario, p->parameter, &p->options, j->log, &j->error);
    if (status == TD_OK)
        status = task_run_session(&p->run, &p->scenario, p->scenario.options.base, &none, live, &j->progress,
                                  &j->error);
    panel_live_end(&live);
    return status == TD_ERROR_ARGUMENT ? TD_ERROR_DATA : status;
}

static td_status serve(panel *p, job *j)
{
    panel_server *server = NULL;
    TD_TRY(panel_link_begin(&p->link, &j->error));
    td_status status = panel_server_new(&server, &p->link, &p->scenario, p->parameter, p->parameter_count,
                                        common.output, &p->options, j->log, &j->error);
    if (status == TD_OK) {
        snprintf(p->url, sizeof p->url, "%s", panel_server_url(server));
        if (!common.quiet)
            fprintf(stderr, "panel: %s\npage: http%s%s\n", p->url, p->url + 2, token_file ? "?token=…" : "");
        if (insecure && !panel_door_is_local(p->options.host))
            td_log_write(&j->log, TD_LOG_WARNING, "panel",
                         "without TLS: the token and all orders can be read and changed on their way");
        if (p->machine) status = far_machine_start(p->machine, p->link.wake, p->link.user, &j->error);
        if (status == TD_OK) status = lead(p, j);
        far_machine_stop(p->machine);
        const td_status finished = panel_server_finish(&server, &p->counts, p->run.input.end, p->run.time_s,
                                                       status == TD_OK ? &j->error : NULL);
        if (status == TD_OK) status = finished;
    }
    panel_server_free(&server);
    p->dropped = atomic_load(&p->link.dropped);
    panel_link_end(&p->link);
    return status;
}

static td_status find_machine(panel *p, td_error *error)
{
    char model[TD_HASH_HEX_SIZE];
    const scenario *s = &p->scenario;
    if (!far.at) return TD_OK;
    if (!s->has_ground)
        return td_fail(error, TD_ERROR_DATA, "%s: a machine's scenario has a ground", s->path);
    TD_TRY(machine_model(model, s, error));
    TD_TRY(
        far_machine_new(&p->machine, &far, model, s->robot->joint_count, fmax(0.5, 6 * s->period_s), error));
    p->options.machine = p->machine;
    return TD_OK;
}

static td_status run(panel *p, job *j)
{
    TD_TRY(read_options(p, &j->error));
    TD_TRY(read_scenario(p, j));
    TD_TRY(find_machine(p, &j->error));
    TD_TRY(serve(p, j));
    (void)terminal_take_interrupt(); /* that is how it ends */
    const job_output output = {NULL, table, p};
    return job_finish(j, result(p), &output);
}

int main(int argc, char **argv)
{
    job j;
    int code = job_begin(&j, &command, &common, schema, sizeof schema / sizeof *schema, true, argc, argv);
    if (code >= 0) return code;
    panel *p = calloc(1, sizeof *p);
    td_status status = p ? run(p, &j) : td_fail(&j.error, TD_ERROR_MEMORY, "out of memory");
    const bool broke = p && p->run.phase == TD_PHASE_FAILED;
    if (status == TD_OK && broke)
        td_log_write(&j.log, TD_LOG_WARNING, "panel", "the session broke off: %s",
                     td_fault_text(p->run.fault));
    code = job_end(&j, status, broke);
    if (p) {
        far_machine_free(&p->machine);
        scenario_free(&p->scenario);
        task_run_free(&p->run);
    }
    free(p);
    return code;
}
