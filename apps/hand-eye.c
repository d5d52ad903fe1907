/* teledimos hand-eye: where the cameras sit on the robot, and where the target stands. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "apps/hand_eye_internal.h"
#include "apps/terminal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"

static const char *dataset_path, *rig_path, *setup_name, *model_name = "auto", *intrinsics = "held",
                                                         *offset = "auto";
static cli_common common;
static cli_list gates;
static bool accept, advise, init;
static double outlier_sigma = 4;

static const char *const setups[] = {"eye-in-hand", "eye-to-hand", "robot-world", NULL};
static const char *const models[] = {"exact", "independent", "field", "auto", NULL};
static const char *const holds[] = {"held", "lens", "free", NULL};

static cli_option options[] = {
    {CLI_STRING, "setup", 0, &setup_name, "NAME",
     "eye-in-hand (the cameras on the hand), eye-to-hand (the target on the hand), robot-world (as "
     "eye-in-hand, the "
     "target's place being what is asked); default: the dataset's",
     0, 0, setups},
    {CLI_STRING, "rig", 0, &rig_path, "FILE",
     "calibration of the cameras, as rig.yaml or a file of OpenCV, ROS, Kalibr, ViSP or mrcal; default: the "
     "dataset's, "
     "or calibrated from the same images",
     0, 0, NULL},
    {CLI_STRING, "intrinsics", 0, &intrinsics, "WHAT",
     "held (default): as the rig has them; where it has no distortion, and the views are too few to tell of "
     "any, sigma "
     "holds what a lens may do; lens: with the radial distortion that the views tell of where the rig has "
     "none; free: "
     "calibrated again from these images, with a warning when they move",
     0, 0, holds},
    {CLI_STRING, "robot", 0, &model_name, "MODEL",
     "the robot's poses: independent (noise at the hand, estimated), field (and a smooth error over the "
     "working space), "
     "auto (default: the field when the likelihood asks for it), exact (plain least squares; biased)",
     0, 0, models},
    {CLI_STRING, "time-offset", 0, &offset, "S",
     "of streams with times: auto (default), none, or seconds added to the target's", 0, 0, NULL},
    {CLI_REAL, "outlier-sigma", 0, &outlier_sigma, "N",
     "leave out views farther off than this many sigmas; 0: none; default 4", 0, 100, NULL},
    {CLI_FLAG, "advise", 0, &advise, NULL, "say which robot pose would help most next", 0, 0, NULL},
    {CLI_FLAG, "init", 0, &init, NULL,
     "write an example of a dataset into the folder DATASET, to fill in, and end", 0, 0, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for the products: result.yaml, report.html, log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "hand-eye",
    .summary = "where the cameras sit on a robot, with how far to trust it",
    .usage = "DATASET -o DIR [options]",
    .text =
        "From robot poses and images of a target (or poses of it): X, where the cameras sit, and Z, where "
        "the target "
        "stands.\n\n"
        "  eye-in-hand   base_from_hand X rig_from_target = Z   X = hand_from_rig, Z = base_from_target\n"
        "  eye-to-hand   X rig_from_target = base_from_hand Z   X = base_from_rig, Z = hand_from_target\n\n"
        "All closed forms are run and judged, the best begins the refinement. In it the robot's poses are "
        "measurements whose noise is estimated; views that do not fit are named and left out; confused "
        "conventions "
        "(inverted poses, mm for m, degrees for radians, the order of quaternions or of views), a wrong size "
        "of the "
        "target and motions that leave X open are named. Exit status: 0 done, 1 failed, 2 wrong usage, 3 the "
        "gate "
        "refuses the result (--accept).",
    .examples = "  teledimos hand-eye my-robot --init\n"
                "  teledimos hand-eye datasets/hand-eye-stereo -o x\n"
                "  teledimos hand-eye datasets/hand-eye-stereo -o y --robot exact --advise --json\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &dataset_path,
};

static int index_of(const char *const *words, const char *word)
{
    int i = 0;
    while (words[i] && strcmp(words[i], word) != 0) i++;
    return i;
}

static td_status write_text(const char *name, const char *text, size_t size, td_error *error)
{
    char *path = td_path_join(common.output, name);
    td_status status =
        path ? td_file_write(path, text, size, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

static td_status write_products(const hand_eye_job *job, const json_t *result, const char *log,
                                size_t log_size, td_error *error)
{
    char *yaml = NULL;
    TD_TRY(td_folder_make(common.output, error));
    char *report = td_path_join(common.output, "report.html");
    td_status status =
        report ? hand_eye_report(job, report, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(report);
    if (status == TD_OK) status = write_text("log.jsonl", log, log_size, error);
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = write_text("result.yaml", yaml, strlen(yaml), error);
    free(yaml);
    return status;
}

static td_status finish(hand_eye_job *job, const gate_row *rows, terminal *term, char **log, size_t *log_size,
                        td_error *error)
{
    hand_eye_judge(job, rows);
    json_t *result = hand_eye_result(job);
    char *text = NULL;
    td_status status = td_schema_check(result, hand_eye_schema, hand_eye_schema_count, error);
    fflush(term->log_file);
    if (status == TD_OK && terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK) status = write_products(job, result, *log, *log_size, error);
    if (status == TD_OK && common.json) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && !text) {
        hand_eye_table(job);
        printf("\nreport: %s/report.html\n", common.output);
    }
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    free(text);
    json_decref(result);
    return status;
}

static td_status prepare(td_dataset **dataset, hand_eye_how *how, gate_row *rows, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, hand_eye_gate_count, gates.value[i], error));
    TD_TRY(td_dataset_read(dataset, dataset_path, error));
    const char *setup = setup_name ? setup_name : (*dataset)->setup;
    if (!*setup)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--setup is missing: eye-in-hand (the cameras on the hand) or eye-to-hand (the target "
                       "on the hand)");
    how->setup = (td_hand_eye_setup)index_of(setups, setup);
    how->model = (td_robot_model)index_of(models, model_name);
    return TD_OK;
}

static int run(void)
{
    td_error error = {0};
    td_dataset *dataset = NULL;
    gate_row rows[8];
    terminal term;
    char *log = NULL;
    size_t log_size = 0;
    memcpy(rows, hand_eye_gate_defaults, hand_eye_gate_count * sizeof *rows);
    terminal_init(&term, common.quiet, common.verbose);
    term.log_file = open_memstream(&log, &log_size);
    td_log logger = terminal_log(&term);
    td_progress progress = terminal_progress(&term);
    hand_eye_how how = {.rig = rig_path,
                        .free_intrinsics = strcmp(intrinsics, "free") == 0,
                        .find_lens = strcmp(intrinsics, "lens") == 0,
                        .offset = offset,
                        .advise = advise,
                        .threads = common.threads,
                        .outlier_sigma = outlier_sigma,
                        .progress = &progress,
                        .log = &logger};
    hand_eye_job *job = calloc(1, sizeof *job);
    td_status status = job && term.log_file ? prepare(&dataset, &how, rows, &error)
                                            : td_fail(&error, TD_ERROR_MEMORY, "out of memory");
    if (job) {
        job->dataset = dataset;
        job->how = &how;
    }
    if (status == TD_OK) status = hand_eye_views(job, &error);
    if (status == TD_OK) status = hand_eye_solve(job, &error);
    terminal_clear(&term);
    if (status == TD_OK) status = finish(job, rows, &term, &log, &log_size, &error);
    int code = EXIT_DONE;
    if (status != TD_OK) {
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
        code = status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    } else if (job->gate.verdict == VERDICT_REFUSED && !accept) {
        code = EXIT_REFUSED;
    }
    if (term.log_file) fclose(term.log_file);
    free(log);
    if (job) hand_eye_free(job);
    free(job);
    td_dataset_free(&dataset);
    return code;
}

static int write_example(void)
{
    td_error error = {0};
    td_hand_eye_setup setup = (td_hand_eye_setup)(setup_name ? index_of(setups, setup_name) : 0);
    if (hand_eye_init(dataset_path, setup, &error) == TD_OK) {
        printf("%s: dataset.yaml, frames.csv and poses.csv are there to be filled in\n", dataset_path);
        return EXIT_DONE;
    }
    cli_complain(command.name, "%s", error.message);
    return error.status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}

int main(int argc, char **argv)
{
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, hand_eye_gate_defaults, hand_eye_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int status = cli_parse(&command, argc, argv);
    if (status >= 0) return status;
    if (common.schema) {
        char *text = td_schema_describe(hand_eye_schema, hand_eye_schema_count);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    if (!dataset_path) {
        cli_complain(command.name, "DATASET is missing (usage: teledimos %s %s)", command.name,
                     command.usage);
        return EXIT_USAGE;
    }
    if (init) return write_example();
    if (!common.output || !*common.output) {
        cli_complain(command.name, "-o DIR is missing (usage: teledimos %s %s)", command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    return run();
}
