/* teledimos machine: the machine as a process of its own, and the orders that a master gives it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"
#include "core/file.h"
#include "core/linalg.h"

static const char *words[2];
static cli_common common;
static machine_options given = {.common = &common, .period_s = 0.1, .image_hz = 0.5};

static cli_option options[] = {
    {.type = CLI_HEADING, .name = "The machine"},
    {CLI_STRING, "listen", 0, &given.listen, "HOST:PORT",
     "be the machine, and listen there (port 0: any that is free, which is printed)", 0, 0, NULL},
    {CLI_STRING, "cert", 0, &given.certificate, "FILE",
     "certificate, PEM: TLS, without which it listens on this computer only", 0, 0, NULL},
    {CLI_STRING, "key", 0, &given.key, "FILE", "the certificate's key, PEM", 0, 0, NULL},
    {CLI_STRING, "rig", 0, &given.rig, "RIG",
     "the stereo head whose images are sent (default: that of the scenario's site)", 0, 0, NULL},
    {CLI_STRING, "mount", 0, &given.mount, "LINK", "the link that carries it", 0, 0, NULL},
    {CLI_REAL, "image-rate", 0, &given.image_hz, "HZ", "pairs of images a second, at most; 0: none", 0, 20,
     NULL},
    {CLI_REAL, "for", 0, &given.for_s, "S", "end after so many seconds", 0, 1e7, NULL},
    {CLI_FLAG, "once", 0, &given.once, NULL, "end when the first master has gone", 0, 0, NULL},
    {CLI_REAL, "mass-sigma", 0, &given.mass_sigma, "SHARE",
     "what is true and not known: each link's mass is off by that standard deviation", 0, 0.3, NULL},
    {CLI_REAL, "zero-sigma", 0, &given.zero_sigma_deg, "DEG", "the same of each joint's zero", 0, 5, NULL},
    {.type = CLI_HEADING, .name = "Its master"},
    {CLI_STRING, "connect", 0, &given.connect, "HOST:PORT", "where the machine listens", 0, 0, NULL},
    {CLI_FLAG, "tls", 0, &given.tls, NULL, "TLS, with any certificate: the token alone says who is there", 0,
     0, NULL},
    {CLI_STRING, "ca", 0, &given.authority, "FILE",
     "TLS, and the machine's certificate must be believed by this one, PEM", 0, 0, NULL},
    {CLI_STRING, "images", 0, &given.images, "DIR", "run: its images are kept there", 0, 0, NULL},
    {CLI_LIST, "joint", 0, &given.joints, "NAME=RATE", "jog: a joint's rate, rad/s or m/s", 0, 0, NULL},
    {.type = CLI_HEADING, .name = "Both"},
    {CLI_STRING, "token-file", 0, &given.token, "FILE",
     "the token that both sides hold, 16 bytes or more, readable by its owner only (openssl rand -hex 32)", 0,
     0, NULL},
    {CLI_REAL, "period", 0, &given.period_s, "S",
     "of the heartbeat: who is not heard for three of them is lost", 0.02, 10, NULL},
    {CLI_FLAG, "plain", 0, &given.plain, NULL, "without TLS beyond this computer, too", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "the machine: folder for its record, audit.jsonl, which is only ever added to",
                       "what is true and not known"),
};

static cli_command command = {
    .name = "machine",
    .summary = "the simulated machine as a process of its own, and orders to it",
    .usage = "SCENARIO --listen HOST:PORT, or VERB [SCENARIO] --connect HOST:PORT",
    .text =
        "With --listen: the machine of SCENARIO (one with a ground: see teledimos simulate) stands in a "
        "world of "
        "solid bodies in real time, and obeys one master. It is given tasks, each with what its "
        "simulation on the "
        "master's side gave; it simulates the task itself from where it stands, and holds it only if the "
        "task's "
        "hash, the machine's model and the results agree. It translates the task to its joints itself, "
        "streams "
        "joints, forces and its own state each period, and images at a low rate on a link of their own. "
        "A master "
        "who is not heard for three periods of the heartbeat is lost: the machine stops, and moves again "
        "only "
        "after Reinit. What happens is recorded line by line in DIR/audit.jsonl. SIGTERM stops it and "
        "ends.\n\n"
        "With --connect: the master. VERB is status; run (simulates SCENARIO's task from where the "
        "machine stands, "
        "sends it, has it executed, and compares); stop, pause, resume, reinit; jog (moves joints at the "
        "rates of "
        "--joint, for --for seconds).\n\n"
        "Links are refused to whoever does not hold the token, which is never sent. Beyond this computer "
        "they are "
        "encrypted: --cert and --key on the machine's side, --tls or --ca on the master's.\n\n"
        "A REHEARSAL (see teledimos rehearse) in place of the scenario: the machine, its ground, soil and "
        "stereo head are as that draws its truth by --seed; DIR gets truth-before.tif and "
        "truth-after.tif.\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the machine refused, or stopped.",
    .examples =
        "  openssl rand -hex 32 >token; chmod 600 token\n"
        "  teledimos simulate datasets/zx200/dig.yaml -o site\n"
        "  teledimos machine datasets/zx200/dig.yaml --listen 127.0.0.1:7420 --token-file token -o site "
        "--for 600 & sleep 3\n"
        "  teledimos machine status --connect 127.0.0.1:7420 --token-file token\n"
        "  teledimos machine run datasets/zx200/dig.yaml --connect 127.0.0.1:7420 --token-file token -o "
        "site\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 1,
    .most = 2,
    .positional = words,
};

td_status machine_read(scenario *s, const machine_options *o, const char *path, const td_progress *progress,
                       td_error *error)
{
    const char *folder = o->common->output ? o->common->output : ".";
    TD_TRY(scenario_read(s, path, error));
    if (!s->task || !s->has_ground)
        return td_fail(error, TD_ERROR_DATA, "%s: a machine's scenario has a task and a ground", s->path);
    if (s->ground.site[0]) TD_TRY(td_folder_make(folder, error));
    return station_ground_map(&s->map, &s->ground, folder, o->common->threads, progress, error);
}

static bool is_verb(const char *word)
{
    static const char *const verbs[] = {"status", "run", "stop", "pause", "resume", "reinit", "jog"};
    for (size_t i = 0; i < sizeof verbs / sizeof *verbs; i++)
        if (strcmp(word, verbs[i]) == 0) return true;
    return false;
}

static td_status check(td_error *error)
{
    const bool with_scenario =
        given.connect && (strcmp(words[0], "run") == 0 || strcmp(words[0], "jog") == 0);
    if (!given.listen == !given.connect)
        return td_fail(error, TD_ERROR_ARGUMENT, "one of --listen and --connect is needed");
    if (given.listen && command.positional_count != 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "'%s' is one argument too many with --listen", words[1]);
    if (given.connect && !is_verb(words[0]))
        return td_fail(error, TD_ERROR_ARGUMENT, "'%s' is none of: status run stop pause resume reinit jog",
                       words[0]);
    if (given.connect && command.positional_count != (with_scenario ? 2 : 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s goes with%s SCENARIO", words[0],
                       with_scenario ? "" : "out");
    given.verb = words[0];
    given.scenario = given.listen ? words[0] : words[1];
    return TD_OK;
}

int main(int argc, char **argv)
{
    td_error error = {0};
    terminal term;
    bool refused = false;
    const int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    td_status status = check(&error);
    terminal_catch_signals();
    td_linalg_single_thread();
    terminal_init(&term, common.quiet, common.verbose);
    if (status == TD_OK)
        status = given.listen ? machine_serve(&given, &term, &error)
                              : machine_master(&given, &term, &refused, &error);
    terminal_clear(&term);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    if (status != TD_OK) return status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    return refused ? EXIT_REFUSED : EXIT_DONE;
}
