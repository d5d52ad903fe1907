/* teledimos servo: the bucket brought to a place that tags tell, by what a camera shows. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "core/file.h"

static const char *scenario_path;
static cli_common common;
static cli_list gates;
static bool accept;
static int starts;

static cli_option options[] = {
    {CLI_INT, "starts", 0, &starts, "N",
     "besides: N runs from starts drawn from the scenario's ranges, one a thread", 1, 100000, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for the products: motion.csv, result.yaml, report.html, log.jsonl",
                       "the images' noise and the starts"),
};

static cli_command command = {
    .name = "servo",
    .summary = "bring the bucket where tags say, by what a camera shows",
    .usage = "SCENARIO -o DIR [options]",
    .text = "Moves a machine in the world of solid bodies by visual servoing. Each control period the "
            "camera's image is rendered, with noise, and the tags in it are found: those of a board "
            "on the site, whose place (averaged over the looks of 2 s) tells where the bucket's tags "
            "are to be, and those of the bucket. Their corners' errors in the image become joint "
            "rates, within every limit of place, speed, acceleration and oil, and these flows into "
            "the cylinders; a command is given a period after its image. Where the tags are hidden "
            "the machine brakes and holds, goes on when they are back, and stops for good after "
            "loss_s. Towards a goal out of reach it is not moved; where it can go no nearer it stops; "
            "either way with the reason.\n\n"
            "SCENARIO is a folder with scenario.yaml, or the file: scene (ground, robot, rig and its "
            "mount, light and noise; as for render), tags (on the bucket's link and on the board, "
            "with their poses), goal (pose of the bucket's target in the board's frame), tool (link "
            "whose origin is the tip), control, hide {from_s, for_s}, and the ranges of starts. The "
            "camera, its mount and the tags' places are taken as exact.\n\n"
            "The tip's error is that of the truth. Its sigma follows from the corners', which the "
            "residuals of both targets tell, and which is taken for the same in each image: where "
            "nothing moves, the detector errs alike each time.\n\n"
            "--starts draws joints from the ranges and puts the board elsewhere by spread_rad. Left "
            "out are draws in which a tag is not wholly in view at the start or at the goal (15 px "
            "from the edge, seen no more than 46 degrees aside), is not found in the first images, or "
            "stands in the ground, the tip is less than 0.3 m above it, or the goal is beyond the "
            "joints' limits.\n\n"
            "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (--accept).",
    .examples = "  teledimos servo datasets/zx200/servo.yaml -o servo\n"
                "  teledimos servo datasets/zx200/servo.yaml -o starts --starts 20 --seed 1\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &scenario_path,
};

static const char *whole_gate_help(void)
{
    static char text[2400] = GATE_HELP;
    gate_help(text, sizeof text, servo_gate_defaults, servo_gate_count);
    return text;
}

static td_status write_log(const servo_job *s, job *j)
{
    TD_TRY(td_folder_make(common.output, &j->error));
    char *path = job_path(j, "motion.csv");
    if (!path) return TD_ERROR_MEMORY;
    const td_status status = servo_log_write(&s->run, s->scenario.scene->scene.robot, path, &j->error);
    free(path);
    return status;
}

/* What servo, machine or scene refuse is the scenario's fault, not that of the command line. */
static td_status move(servo_job *s, job *j)
{
    const uint64_t seed = (uint64_t)common.seed;
    td_status status =
        servo_run_one(&s->run, &s->scenario, s->scenario.q, seed, common.threads, &j->progress, &j->error);
    if (status == TD_ERROR_ARGUMENT) status = TD_ERROR_DATA;
    if (status == TD_ERROR_DATA) return td_error_prefix(&j->error, status, "%s", s->scenario.path);
    if (status == TD_OK && starts > 0)
        status =
            servo_starts_run(&s->starts, &s->scenario, starts, seed, common.threads, &j->progress, &j->error);
    return status == TD_ERROR_ARGUMENT ? TD_ERROR_DATA : status;
}

static td_status run(servo_job *s, job *j)
{
    gate_row rows[8];
    memcpy(rows, servo_gate_defaults, servo_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, servo_gate_count, gates.value[i], &j->error));
    TD_TRY(servo_scenario_read(&s->scenario, scenario_path, &j->error));
    TD_TRY(move(s, j));
    servo_judge(s, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(write_log(s, j));
    const job_output output = {servo_report, servo_table, s};
    return job_finish(j, servo_result(s), &output);
}

int main(int argc, char **argv)
{
    job j;
    servo_job s = {0};
    for (size_t i = 0; i < sizeof options / sizeof *options; i++)
        if (options[i].name && strcmp(options[i].name, "gate") == 0) options[i].help = whole_gate_help();
    int status = job_begin(&j, &command, &common, servo_schema, servo_schema_count, true, argc, argv);
    if (status >= 0) return status;
    if (!scenario_path) {
        cli_complain(command.name, "a scenario is missing (usage: teledimos servo %s)", command.usage);
        job_end(&j, TD_OK, false);
        return EXIT_USAGE;
    }
    const td_status done = run(&s, &j);
    const bool refused = s.gate.verdict == VERDICT_REFUSED && !accept;
    servo_run_free(&s.run);
    servo_starts_free(&s.starts);
    servo_scenario_free(&s.scenario);
    return job_end(&j, done, refused);
}
