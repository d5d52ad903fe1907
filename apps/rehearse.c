/* teledimos rehearse: the closed loop of looking, planning, simulating ahead, executing and looking again. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_address.h"
#include "apps/rehearse_seeds.h"
#include "core/file.h"
#include "core/number.h"

static const char *scenario_path, *replay_path;
static cli_common common;
static cli_list gates, covariances;
static bool accept;
static int seed_count = 0;
static machine_address far = {.period_s = 0.1};

static cli_option options[] = {
    {CLI_INT, "seeds", 0, &seed_count, "N",
     "instead: N rehearsals, their truths drawn by --seed and the seeds after it, and what holds of all of "
     "them: seeds.csv",
     1, SEEDS_MOST, NULL},
    {CLI_LIST, "rig-covariance", 0, &covariances, "TIMES",
     "the rig's covariance is so many times what it is in the rehearsal's file, as it is believed and as the "
     "truth is drawn from; with --seeds it may be repeated: a row of the table each. 0: known exactly",
     0, 0, NULL},
    {CLI_STRING, "replay", 0, &replay_path, "MCAP",
     "an earlier recording.mcap of the same rehearsal: its seed and covariance, so the same bytes", 0, 0,
     NULL},
    {.type = CLI_HEADING, .name = "A machine elsewhere"},
    MACHINE_ADDRESS_OPTIONS(far),
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(
        common,
        "folder for the products: before.tif, after.tif, truth.tif (after), recording.mcap (all "
        "that was executed), round-N/ahead and round-N/done with trajectory.csv, events.csv and "
        "recording.mcap, result.yaml, report.html, log.jsonl",
        "what is true and not known; the cameras' noise"),
};

static cli_command command = {
    .name = "rehearse",
    .summary = "the closed loop: look, plan, simulate ahead, execute, look again",
    .usage = "REHEARSAL -o DIR [options]",
    .text =
        "A trench dug by a machine that sees only with its cameras, in a world that is not quite as it is "
        "believed to be. REHEARSAL is a file that names a scenario as teledimos simulate takes it (machine, "
        "soil and task as they are believed; its site is the true world), the stereo head's rig with its "
        "covariance, and how far the truth is off: masses, soil, joint zeros and calibration are drawn by "
        "--seed.\n\n"
        "A round: both cameras are rendered from the true world by the true rig, with the arm in view, and "
        "fused into a map by the believed one. On that map the trench is planned and the task simulated "
        "ahead, every motion checked against the map with the probability of a contact that is not meant. "
        "What was simulated to its end is validated, downloaded with the hash of task, map and start, and "
        "executed by the true machine, which does the passes of the validated plan from wherever it is "
        "measured to stand; it sees the soil only where the bucket feels it. Joints, forces and the tool are "
        "compared with the prediction along the same motion; beyond 6 of their sigma over two seconds, or "
        "when a motion takes twice its time, the machine is stopped, with the reason. Then it looks again, "
        "and what still stands above the first plan's floor is planned anew, until it is not worth a pass. "
        "Sigma of the monitor are those of the same task done by further draws.\n\n"
        "Where soil was moved the map is what has been seen since; what no pose sees is taken as predicted, "
        "and "
        "measured_volume_m3 is of what is seen and, where nothing is, of what was predicted: their shares "
        "stand beside it, and the true volumes. The rig is checked by the "
        "epipolar "
        "lines of each place's first pair, and by all pairs of a look together against its own covariance "
        "(rig_sigmas: about 1). A rig that is not the head's, a dark camera, too few matches, a map with "
        "holes "
        "under the tracks or in the trench stop the loop, with the reason, before anything moves. The base's "
        "pose and the head's mount are taken as known without error. Afterwards the true motion is held "
        "against "
        "the true ground: unmeant_contacts counts what touched and was not told.\n\n"
        "--seeds rehearses many times and asks what holds of all: volumes within 5 % and 2 sigma, the tool's "
        "error, the soil's balance, contacts; --rig-covariance how errors and their predicted sigma follow "
        "the "
        "calibration's. recording.mcap holds all that was executed; with --replay it gives the same bytes of "
        "all products but result.yaml, report.html and log.jsonl, which tell computing times.\n\n"
        "--machine: what looks and digs is a machine in a process of its own (teledimos machine REHEARSAL "
        "--listen …), in real time. Its images come over the link, tasks go with the plan that was "
        "simulated, "
        "and its new ground is known by what it sees alone; figures of the truth are null.\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (--accept).",
    .examples =
        "  teledimos rehearse datasets/zx200/trench.yaml -o rehearsed\n"
        "  teledimos rehearse datasets/zx200/trench.yaml -o other --seed 7\n"
        "  teledimos rehearse datasets/zx200/trench.yaml -o again --replay other/recording.mcap\n"
        "  teledimos rehearse datasets/zx200/trench.yaml -o twenty --seeds 20\n"
        "  teledimos rehearse datasets/zx200/trench-chain.yaml -o chain --seeds 12 --rig-covariance 0 "
        "--rig-covariance 1 --rig-covariance 4 --rig-covariance 16\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &scenario_path,
};

static const char *whole_gate_help(void)
{
    static char text[4800] = GATE_HELP;
    gate_help(text, sizeof text, rehearse_gate_defaults, rehearse_gate_count);
    snprintf(text + strlen(text), sizeof text - strlen(text), "\nof --seeds:");
    gate_help(text, sizeof text, seeds_gate_defaults, seeds_gate_count);
    return text;
}

static td_status read_covariances(double *times, td_error *error)
{
    if (covariances.count > SEEDS_MOST_COVARIANCES || (covariances.count > 1 && !seed_count))
        return td_fail(error, TD_ERROR_ARGUMENT, "--rig-covariance: once, or with --seeds up to %d times",
                       SEEDS_MOST_COVARIANCES);
    for (size_t i = 0; i < covariances.count; i++)
        if (!td_number_real(times + i, covariances.value[i]) || !(times[i] >= 0 && times[i] <= 1e4))
            return td_fail(error, TD_ERROR_ARGUMENT, "--rig-covariance: '%s' is no number from 0 to 10000",
                           covariances.value[i]);
    return TD_OK;
}

/* ---- many ---- */

static td_status finish_seeds(seeds *s, const gate_row *rows, job *j)
{
    seeds_judge(s, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(td_folder_make(common.output, &j->error));
    TD_TRY(seeds_write(s, common.output, &j->error));
    const job_output output = {seeds_report, seeds_table, s};
    return job_finish(j, seeds_result(s), &output);
}

static td_status run_seeds(verdict *found, job *j)
{
    gate_row rows[8];
    double times[SEEDS_MOST_COVARIANCES];
    seeds s = {0};
    memcpy(rows, seeds_gate_defaults, seeds_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, seeds_gate_count, gates.value[i], &j->error));
    TD_TRY(read_covariances(times, &j->error));
    td_status status = seeds_run(&s, scenario_path, (uint64_t)common.seed, seed_count, times,
                                 covariances.count, common.threads, &j->progress, &j->error);
    if (status == TD_ERROR_ARGUMENT) status = TD_ERROR_DATA;
    if (status == TD_OK) status = finish_seeds(&s, rows, j);
    *found = s.gate.verdict;
    seeds_free(&s);
    return status;
}

/* Of --schema too, before the command line is parsed. */
static bool has_seeds(int argc, char **argv)
{
    for (int i = 1; i < argc; i++)
        if (strncmp(argv[i], "--seeds", 7) == 0) return true;
    return false;
}

/* ---- one ---- */

static td_status run(rehearse *r, rehearse_setup *setup, job *j)
{
    gate_row rows[8];
    memcpy(rows, rehearse_gate_defaults, rehearse_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, rehearse_gate_count, gates.value[i], &j->error));
    TD_TRY(rehearse_read(setup, &r->scenario, scenario_path, &j->error));
    double times[SEEDS_MOST_COVARIANCES];
    TD_TRY(read_covariances(times, &j->error));
    if (covariances.count) setup->truth.rig_covariance *= times[0];
    r->setup = setup;
    r->seed = (uint64_t)common.seed;
    if (replay_path && seed_count)
        return td_fail(&j->error, TD_ERROR_ARGUMENT, "--replay and --seeds: one of them");
    if (replay_path) TD_TRY(rehearse_replay(r, setup, replay_path, &j->error));
    r->threads = common.threads;
    r->progress = &j->progress;
    if (far.at) TD_TRY(rehearse_far_begin(r, &far, &j->error));
    td_status status = rehearse_run(r, &j->error);
    if (status == TD_ERROR_ARGUMENT) status = TD_ERROR_DATA;
    TD_TRY(status);
    rehearse_judge(r, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(td_folder_make(common.output, &j->error));
    TD_TRY(rehearse_write(r, common.output, &j->error));
    const job_output output = {rehearse_report, rehearse_table, r};
    return job_finish(j, rehearse_result(r), &output);
}

int main(int argc, char **argv)
{
    job j;
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = whole_gate_help();
    const bool many = has_seeds(argc, argv);
    verdict found = VERDICT_ACCEPTED;
    int code = job_begin(&j, &command, &common, many ? seeds_schema : rehearse_schema,
                         many ? seeds_schema_count : rehearse_schema_count, true, argc, argv);
    if (code >= 0) return code;
    rehearse *r = calloc(1, sizeof *r);
    rehearse_setup *setup = calloc(1, sizeof *setup);
    td_status status;
    if (!r || !setup)
        status = td_fail(&j.error, TD_ERROR_MEMORY, "out of memory");
    else if (!scenario_path)
        status = td_fail(&j.error, TD_ERROR_ARGUMENT, "REHEARSAL is missing (usage: teledimos %s %s)",
                         command.name, command.usage);
    else if (far.at && (replay_path || seed_count))
        status = td_fail(&j.error, TD_ERROR_ARGUMENT,
                         "--machine goes with neither --seeds nor --replay: what is true is the machine's");
    else if (seed_count) {
        status = run_seeds(&found, &j);
    } else {
        status = run(r, setup, &j);
        found = r->gate.verdict;
    }
    code = job_end(&j, status, found == VERDICT_REFUSED && !accept);
    if (r) rehearse_free(r);
    free(r);
    free(setup);
    return code;
}
