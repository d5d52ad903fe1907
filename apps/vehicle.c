/* teledimos vehicle: where the cameras sit on a machine, from what they see of its arm. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/terminal.h"
#include "apps/vehicle_internal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"

static const char *dataset_path, *rig_path, *robot_path, *mount_name;
static cli_common common;
static cli_list gates, offsets;
static bool accept, advise, init, closed;
static double outlier_sigma = 5;

static cli_option options[] = {
    {CLI_STRING, "rig", 0, &rig_path, "FILE",
     "calibration of the cameras, as rig.yaml or a file of OpenCV, ROS, Kalibr, ViSP or mrcal; default: the "
     "dataset's",
     0, 0, NULL},
    {CLI_STRING, "robot", 0, &robot_path, "URDF",
     "the machine's links and joints, with the YAML of the same name beside it; default: the dataset's", 0, 0,
     NULL},
    {CLI_STRING, "mount", 0, &mount_name, "LINK",
     "link that carries the rig (cab or undercarriage); default: the dataset's", 0, 0, NULL},
    {CLI_LIST, "offsets", 0, &offsets, "JOINT=SIGMA_DEG",
     "find the zero offset of this joint too: its prior in degrees (mm where it slides), or free; may be "
     "repeated",
     0, 0, NULL},
    {CLI_FLAG, "closed", 0, &closed, NULL,
     "the closed way alone: in each pose six known points or more are triangulated, their frame found, and "
     "the mean taken; without sigma",
     0, 0, NULL},
    {CLI_REAL, "outlier-sigma", 0, &outlier_sigma, "N",
     "leave out sights farther off than this many sigmas; 0: none; default 5", 0, 100, NULL},
    {CLI_FLAG, "advise", 0, &advise, NULL, "say which poses of the arm would help most next", 0, 0, NULL},
    {CLI_FLAG, "init", 0, &init, NULL,
     "write an example of a dataset into the folder DATASET, to fill in, and end", 0, 0, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL,
     "end with status 0, and write the rig, even when the gate refuses; not where a direction is open", 0, 0,
     NULL},
    CLI_COMMON_OPTIONS(common, "folder for the products: rig.yaml, result.yaml, report.html, log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "vehicle",
    .summary = "where the cameras sit on a machine, and what that is worth at the bucket's tip",
    .usage = "DATASET -o DIR [--rig RIG] [--robot URDF] [options]",
    .text =
        "Points on a link of the arm (known, roughly known or unknown in its frame), or boards fixed to it "
        "or "
        "to the ground, are seen in many poses of the arm; the joints' sensors say how it stood. One "
        "least-squares problem over all poses and cameras gives vehicle_from_rig, the points' places and, on "
        "request, the zeros of the joints, with their covariance; it is written into rig.yaml.\n\n"
        "An arm whose joints are parallel leaves directions open (sideways along its pins; pitch against a "
        "free zero): they are named, with what to do, and no rig is written. Exit status: 0 done, 1 failed, "
        "2 "
        "wrong usage, 3 the gate refuses the result (--accept), or a direction is open.\n\n"
        "Of a dataset with target_poses (poses of a target on the arm, seen by the rig) the arm's own chain "
        "is "
        "calibrated: corrected origins of its joints.",
    .examples =
        "  teledimos vehicle datasets/zx200-stick -o x\n"
        "  teledimos vehicle datasets/zx200-stick -o y --offsets boom=0.1 --offsets arm=0.5 --advise\n"
        "  teledimos vehicle datasets/zx200-stick -o z --closed --json\n"
        "  teledimos vehicle my-machine --init\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &dataset_path,
};

static td_status write_text(const char *name, const char *text, size_t size, td_error *error)
{
    char *path = td_path_join(common.output, name);
    td_status status =
        path ? td_file_write(path, text, size, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

static td_status write_rig(const vehicle_job *job, td_error *error)
{
    char *path = td_path_join(common.output, "rig.yaml");
    td_rig *rig = job->wanted ? td_rig_copy(job->rig) : NULL;
    td_status status =
        path && (rig || !job->wanted) ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK && rig) {
        rig->has_vehicle = true;
        rig->vehicle_from_rig = job->result->vehicle_from_rig;
        json_t *provenance = rig->provenance ? json_deep_copy(rig->provenance) : json_object();
        json_object_set_new(provenance, "vehicle", vehicle_provenance(job));
        json_decref(rig->provenance);
        rig->provenance = provenance;
        status = td_rig_write(rig, path, error);
    } else if (status == TD_OK) {
        unlink(path); /* one of an earlier run would pass for this one's */
    }
    td_rig_free(&rig);
    free(path);
    return status;
}

/* In an order that ends with result.yaml: where it stands, the others do. */
static td_status write_products(const vehicle_job *job, const json_t *result, const char *log,
                                size_t log_size, td_error *error)
{
    char *yaml = NULL;
    TD_TRY(td_folder_make(common.output, error));
    char *report = td_path_join(common.output, "report.html");
    td_status status =
        report ? vehicle_report(job, report, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(report);
    if (status == TD_OK) status = write_rig(job, error);
    if (status == TD_OK) status = write_text("log.jsonl", log, log_size, error);
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = write_text("result.yaml", yaml, strlen(yaml), error);
    free(yaml);
    return status;
}

static td_status print_result(const vehicle_job *job, const json_t *result, td_error *error)
{
    if (common.json) {
        char *text = NULL;
        TD_TRY(td_document_to_json(&text, result, 15, error));
        fputs(text, stdout);
        free(text);
    } else {
        vehicle_table(job);
        printf("\nreport: %s/report.html\n", common.output);
        if (!job->wanted)
            printf("rig.yaml was not written: mend what the reasons name%s\n",
                   job->result->null_count ? "" : ", or pass --accept");
    }
    return fflush(stdout) == 0 && !ferror(stdout)
               ? TD_OK
               : td_fail(error, TD_ERROR_IO, "standard output cannot be written");
}

static td_status finish(vehicle_job *job, const gate_row *rows, terminal *term, char **log, size_t *log_size,
                        td_error *error)
{
    vehicle_judge(job, rows);
    json_t *result = vehicle_result(job);
    td_status status = td_schema_check(result, vehicle_schema, vehicle_schema_count, error);
    fflush(term->log_file);
    if (status == TD_OK && terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK) status = write_products(job, result, *log, *log_size, error);
    if (status == TD_OK) status = print_result(job, result, error);
    json_decref(result);
    return status;
}

static td_status write_kinematic(const vehicle_kinematic *k, const vehicle_job *job, const json_t *result,
                                 const char *log, size_t log_size, td_error *error)
{
    char *yaml = NULL;
    TD_TRY(td_folder_make(common.output, error));
    char *report = td_path_join(common.output, "report.html");
    td_status status = report ? vehicle_kinematic_report(k, job, report, error)
                              : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(report);
    if (status == TD_OK) status = write_text("log.jsonl", log, log_size, error);
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = write_text("result.yaml", yaml, strlen(yaml), error);
    free(yaml);
    return status;
}

/* Poses of a target instead of points: the chain itself is calibrated. */
static td_status run_kinematic(vehicle_job *job, terminal *term, char **log, size_t *log_size,
                               td_error *error)
{
    vehicle_kinematic k = {0};
    char *text = NULL;
    td_status status = vehicle_read_robot(job, error);
    if (status == TD_OK) status = vehicle_kinematic_solve(&k, job, error);
    terminal_clear(term);
    json_t *result = NULL;
    if (status == TD_OK) {
        vehicle_kinematic_judge(&k, job);
        job->wanted = k.gate.verdict != VERDICT_REFUSED || accept;
        result = vehicle_kinematic_result(&k, job);
        status = td_schema_check(result, vehicle_kinematic_schema, vehicle_kinematic_schema_count, error);
    }
    fflush(term->log_file);
    if (status == TD_OK && terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK) status = write_kinematic(&k, job, result, *log, *log_size, error);
    if (status == TD_OK && common.json) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && !text) {
        vehicle_kinematic_table(&k, job);
        printf("\nreport: %s/report.html\n", common.output);
    }
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    free(text);
    json_decref(result);
    td_kinematic_free(&k.result);
    return status;
}

static td_status solve(vehicle_job *job, gate_row *rows, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, vehicle_gate_count, gates.value[i], error));
    TD_TRY(vehicle_read_robot(job, error));
    TD_TRY(vehicle_read(job, error));
    return vehicle_solve(job, error);
}

static int run(void)
{
    td_error error = {0};
    td_dataset *dataset = NULL;
    gate_row rows[8];
    terminal term;
    char *log = NULL;
    size_t log_size = 0;
    memcpy(rows, vehicle_gate_defaults, vehicle_gate_count * sizeof *rows);
    terminal_init(&term, common.quiet, common.verbose);
    term.log_file = open_memstream(&log, &log_size);
    td_log logger = terminal_log(&term);
    td_progress progress = terminal_progress(&term);
    const vehicle_how how = {.rig = rig_path,
                             .robot = robot_path,
                             .mount = mount_name,
                             .offsets = &offsets,
                             .closed = closed,
                             .advise = advise,
                             .accept = accept,
                             .threads = common.threads,
                             .outlier_sigma = outlier_sigma,
                             .progress = &progress,
                             .log = &logger};
    vehicle_job *job = calloc(1, sizeof *job);
    td_status status = job && term.log_file ? td_dataset_read(&dataset, dataset_path, &error)
                                            : td_fail(&error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) {
        job->dataset = dataset;
        job->how = &how;
        if (!dataset->target_poses.path) status = solve(job, rows, &error);
    }
    terminal_clear(&term);
    if (status == TD_OK && dataset->target_poses.path)
        status = run_kinematic(job, &term, &log, &log_size, &error);
    else if (status == TD_OK)
        status = finish(job, rows, &term, &log, &log_size, &error);
    int code = EXIT_DONE;
    if (status != TD_OK) {
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
        code = status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    } else if (!job->wanted) {
        code = EXIT_REFUSED;
    }
    if (term.log_file) fclose(term.log_file);
    free(log);
    if (job) vehicle_free(job);
    free(job);
    td_dataset_free(&dataset);
    return code;
}

static int write_example(void)
{
    td_error error = {0};
    if (vehicle_init(dataset_path, &error) == TD_OK) {
        printf("%s: dataset.yaml, angles.csv and sights.csv are there to be filled in\n", dataset_path);
        return EXIT_DONE;
    }
    cli_complain(command.name, "%s", error.message);
    return error.status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}

int main(int argc, char **argv)
{
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, vehicle_gate_defaults, vehicle_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int status = cli_parse(&command, argc, argv);
    if (status >= 0) return status;
    if (common.schema) {
        char *text = td_schema_describe(vehicle_schema, vehicle_schema_count);
        char *kinematic = td_schema_describe(vehicle_kinematic_schema, vehicle_kinematic_schema_count);
        if (text && kinematic) printf("%s\nOf a dataset with target_poses:\n\n%s", text, kinematic);
        free(text);
        free(kinematic);
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
