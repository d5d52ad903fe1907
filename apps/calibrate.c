/* teledimos calibrate: a dataset's images to a rig. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/calibrate_internal.h"
#include "apps/cli.h"
#include "apps/terminal.h"
#include "apps/wizard.h"
#include "core/document.h"
#include "core/file.h"
#include "core/hash.h"
#include "core/linalg.h"

static const char *dataset_path;
static cli_common common;
static cli_list fixes, gates, sources;
static bool resume;
static const char *target_words, *live_kind;
static const char *rig_path, *clicks_path, *method = "auto", *warp = "auto", *model;
static bool plain, accept, no_leave_one_out, no_models;

static const char *const methods[] = {"auto", "homography", "visp", "faugeras-toscani", NULL};
static const char *const warps[] = {"auto", "on", "off", NULL};
static const char *const lives[] = {"page", "text", "none", NULL};
static const char *const models[] = {"pinhole", "brown5", "brown8", "fisheye", NULL};

static cli_option options[] = {
    {.type = CLI_HEADING, .name = "How"},
    {CLI_STRING, "method", 0, &method, "NAME",
     "first estimate: homography (flat targets), faugeras-toscani (targets with depth), visp (virtual visual "
     "servoing), or auto (default)",
     0, 0, methods},
    {CLI_STRING, "model", 0, &model, "NAME",
     "lens model of all cameras, instead of the dataset's: pinhole, brown5, brown8, fisheye", 0, 0, models},
    {CLI_FLAG, "plain", 0, &plain, NULL,
     "least squares on all points alike: no outlier rejection, no board warp (what OpenCV and plain mrcal "
     "solve)",
     0, 0, NULL},
    {CLI_STRING, "warp", 0, &warp, "WHEN",
     "estimate the board's bulge: auto (default: kept when significant), on, off", 0, 0, warps},
    {CLI_LIST, "fix", 0, &fixes, "WHAT",
     "hold a part at the values of --rig: CAMERA.intrinsics (with the distortion), CAMERA.distortion, "
     "CAMERA.pose, or CAMERA for all; may be repeated",
     0, 0, NULL},
    {CLI_STRING, "rig", 0, &rig_path, "FILE",
     "rig.yaml with the values for --fix; its covariance is passed on", 0, 0, NULL},
    {CLI_STRING, "clicks", 0, &clicks_path, "FILE",
     "numbering of marks by hand: CSV with image, mark, x_px, y_px, up to nine for an image", 0, 0, NULL},
    {CLI_FLAG, "no-leave-one-out", 0, &no_leave_one_out, NULL, "skip leaving out views in turn", 0, 0, NULL},
    {CLI_FLAG, "no-models", 0, &no_models, NULL, "skip judging other lens models by views held out", 0, 0,
     NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "write rig.yaml and end with status 0 even when the gate refuses",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "The wizard (without DATASET, on a terminal); what is not given is asked"},
    {CLI_LIST, "source", 0, &sources, "SOURCE",
     "where pictures come from: a folder that fills (with a pattern of names behind it: 'pictures/left*'), a "
     "video, a camera as /dev/video0; twice for a pair",
     0, 0, NULL},
    {CLI_STRING, "target", 0, &target_words, "WORDS",
     "\"chessboard 9x6 25mm\", \"marks 7x5 30mm diameter 12mm\", \"aprilgrid 6x6 tag 88mm gap 0.3\", "
     "\"charuco 7x4 30mm tag 22mm aruco5x5_100\", or a mapping as in dataset.yaml",
     0, 0, NULL},
    {CLI_STRING, "live", 0, &live_kind, "HOW",
     "the live picture: page (in a browser on this machine; default), text (on the terminal; default over "
     "ssh), "
     "none",
     0, 0, lives},
    {CLI_FLAG, "resume", 0, &resume, NULL, "go on with what was begun in the folder of -o", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common,
                       "folder for the products: rig.yaml, result.yaml, report.html, points.csv, "
                       "uncertainty.csv, log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "calibrate",
    .summary = "calibrate cameras and their relative poses from images of a target",
    .usage = "[DATASET] -o DIR [options]",
    .text =
        "Without DATASET, on a terminal, this is the calibration wizard: it asks for the source of pictures "
        "and "
        "the target, looks at pictures as they come, tells which one to take next and when more of them no "
        "longer "
        "help, and leaves a dataset and its calibration in DIR. It can be ended at any time and gone on with "
        "(--resume).\n\n"
        "With DATASET it finds the target in every image, estimates each camera, then refines all cameras, "
        "views "
        "and the board's warp in one least-squares problem. Corners and views that do not fit are named and "
        "left "
        "out. Everything gets its standard deviation; a map tells how far projected points can be trusted "
        "over "
        "the image, views are left out in turn, other lens models are tried on views held out; a quality "
        "gate "
        "gives the verdict.\n\n"
        "DATASET is a folder with dataset.yaml and frames.csv:\n\n"
        "  # dataset.yaml\n"
        "  name: my-head\n"
        "  target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
        "  cameras:\n"
        "    - {name: left, model: brown5}\n"
        "    - {name: right, model: brown5}\n\n"
        "  # frames.csv\n"
        "  frame,left,right\n"
        "  01,left01.png,right01.png\n\n"
        "columns and rows count the points: a chessboard's inner corners, marks (with diameter_m), or tags. "
        "Other "
        "targets:\n\n"
        "  {kind: marks, columns: 7, rows: 5, spacing_m: 0.03, diameter_m: 0.012}\n"
        "  {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0.3}\n"
        "  {kind: charuco, columns: 7, rows: 4, spacing_m: 0.03, tag_size_m: 0.022, dictionary: "
        "aruco5x5_100}\n"
        "  {kind: tags, dictionary: tag36h11, border: 1, tags: [{id: 3, size_m: 0.1}]}\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (rig.yaml is then not "
        "written; --accept).",
    .examples =
        "  teledimos calibrate datasets/opencv-stereo -o out\n"
        "  teledimos calibrate datasets/visp-marks -o marks --json\n"
        "  teledimos calibrate datasets/opencv-stereo -o again --rig out/rig.yaml --fix left.intrinsics\n"
        "  teledimos calibrate datasets/opencv-stereo -o strict --gate rms_px=0.3\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &dataset_path,
};

static td_status parse_fix(td_calibrate_options *o, const td_dataset *dataset, const char *text,
                           td_error *error)
{
    size_t length = strcspn(text, ".");
    static const struct {
        const char *name;
        unsigned hold;
    } parts[] = {{"", TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION | TD_HOLD_POSE},
                 {".intrinsics", TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION},
                 {".distortion", TD_HOLD_DISTORTION},
                 {".pose", TD_HOLD_POSE}};
    for (int c = 0; c < dataset->camera_count; c++) {
        if (strlen(dataset->camera[c].name) != length || strncmp(dataset->camera[c].name, text, length) != 0)
            continue;
        for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
            if (strcmp(text + length, parts[i].name) == 0) {
                o->hold[c] |= parts[i].hold;
                return TD_OK;
            }
        return td_fail(error, TD_ERROR_ARGUMENT, "--fix %s: a camera has intrinsics, distortion and pose",
                       text);
    }
    return td_fail(error, TD_ERROR_ARGUMENT, "--fix %s: the dataset has no camera of that name", text);
}

static void hash_text(td_hash *hash, const char *text)
{
    td_hash_add(hash, text, strlen(text) + 1);
}

/* SHA-256 over what the result depends on: the description, and each frame's name and images by their bytes.
 * Where the images lie does not count. */
static td_status hash_dataset(char hex[65], const td_dataset *dataset, td_error *error)
{
    td_hash *hash;
    char part[65], *path = td_path_join(dataset->folder, "dataset.yaml");
    TD_TRY(td_hash_new(&hash, error));
    if (path && td_hash_file(part, path, NULL) == TD_OK) hash_text(hash, part);
    free(path);
    if (dataset->corners && td_hash_file(part, dataset->corners, NULL) == TD_OK) hash_text(hash, part);
    for (size_t v = 0; v < dataset->frame_count; v++) {
        hash_text(hash, dataset->frame[v].name);
        snprintf(part, sizeof part, "%.17g", dataset->frame[v].height_m);
        hash_text(hash, part);
        for (int c = 0; c < dataset->camera_count; c++) {
            const char *image = dataset->frame[v].image[c];
            hash_text(hash,
                      image && !dataset->corners && td_hash_file(part, image, NULL) == TD_OK ? part : "");
        }
    }
    return td_hash_finish(hex, &hash, error);
}

static td_status write_text(const char *folder, const char *name, const char *text, size_t size,
                            td_error *error)
{
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    td_status status = td_file_write(path, text, size, error);
    free(path);
    return status;
}

static td_status write_rig(const calibrate_job *job, const char *folder, bool wanted, td_error *error)
{
    char *path = td_path_join(folder, "rig.yaml");
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    td_status status = TD_OK;
    td_rig *rig = job->calibration->rig;
    json_decref(rig->provenance);
    rig->provenance = calibrate_provenance(job);
    if (wanted)
        status = td_rig_write(rig, path, error);
    else
        unlink(path); /* one of an earlier run would pass for this one's */
    free(path);
    return status;
}

static td_status write_map(const calibrate_job *job, const char *folder, td_error *error)
{
    char *path = td_path_join(folder, "uncertainty.csv");
    td_status status = path ? calibrate_write_map(job, path, error)
                            : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    free(path);
    return status;
}

/* Products in an order that ends with result.yaml: where it stands, the others do. */
static td_status write_products(const calibrate_job *job, json_t *result, const char *log, size_t log_size,
                                td_error *error)
{
    const char *folder = common.output;
    bool wanted = job->gate->verdict != VERDICT_REFUSED || accept;
    if (!wanted) json_object_del(json_object_get(result, "products"), "rig");
    TD_TRY(td_folder_make(folder, error));
    char comment[128], *path = td_path_join(folder, "points.csv"),
                       *report = td_path_join(folder, "report.html");
    snprintf(comment, sizeof comment, "points of dataset %s, sha256 %s", job->dataset->name, job->hash);
    td_status status = path && report ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (status == TD_OK) status = td_observations_write(job->observations, comment, path, error);
    if (status == TD_OK) status = calibrate_report(job, report, error);
    if (status == TD_OK && job->trust->map) status = write_map(job, folder, error);
    if (status == TD_OK) status = write_rig(job, folder, wanted, error);
    if (status == TD_OK) status = write_text(folder, "log.jsonl", log, log_size, error);
    char *yaml = NULL;
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = write_text(folder, "result.yaml", yaml, strlen(yaml), error);
    free(yaml);
    free(path);
    free(report);
    return status;
}

static td_status print_result(const calibrate_job *job, const json_t *result, td_error *error)
{
    if (common.json) {
        char *text = NULL;
        TD_TRY(td_document_to_json(&text, result, 15, error));
        fputs(text, stdout);
        free(text);
    } else {
        calibrate_table(job);
        printf("\nreport: %s/report.html\n", common.output);
        if (job->gate->verdict == VERDICT_REFUSED && !accept)
            printf("rig.yaml was not written: mend what the reasons name, or pass --accept\n");
    }
    return fflush(stdout) == 0 && !ferror(stdout)
               ? TD_OK
               : td_fail(error, TD_ERROR_IO, "standard output cannot be written");
}

static td_status finish(calibrate_job *job, gate_result *gate, const gate_row *rows, terminal *term,
                        char **log, size_t *log_size, td_error *error)
{
    calibrate_judge(gate, rows, job);
    job->gate = gate;
    json_t *result = calibrate_result(job);
    td_status status = td_schema_check(result, calibrate_schema, calibrate_schema_count, error);
    fflush(term->log_file);
    if (status == TD_OK && terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK) status = write_products(job, result, *log, *log_size, error);
    if (status == TD_OK) status = print_result(job, result, error);
    json_decref(result);
    return status;
}

static td_status read_inputs(td_dataset **dataset, td_rig **rig, td_image_clicks **clicks,
                             size_t *click_count, td_calibrate_options *o, gate_row *rows, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, calibrate_gate_count, gates.value[i], error));
    TD_TRY(td_dataset_read(dataset, dataset_path, error));
    for (int c = 0; model && c < (*dataset)->camera_count; c++)
        (*dataset)->camera[c].model = td_camera_model_from_name(model);
    if (rig_path) TD_TRY(td_rig_read(rig, rig_path, error));
    if (fixes.count && !*rig)
        return td_fail(error, TD_ERROR_ARGUMENT, "--fix needs the values to hold: --rig FILE");
    for (size_t i = 0; i < fixes.count; i++) TD_TRY(parse_fix(o, *dataset, fixes.value[i], error));
    if (clicks_path) TD_TRY(td_clicks_read(clicks, click_count, clicks_path, error));
    o->known = *rig;
    o->plain = plain;
    o->method = td_estimate_method_from_name(method);
    o->warp = strcmp(warp, "on") == 0 ? TD_WARP_ON : strcmp(warp, "off") == 0 ? TD_WARP_OFF : TD_WARP_AUTO;
    o->leave_one_out = !no_leave_one_out;
    o->threads = common.threads;
    return TD_OK;
}

static int run(void)
{
    td_error error = {0};
    td_dataset *dataset = NULL;
    td_rig *rig = NULL;
    td_image_clicks *clicks = NULL;
    td_observations *observations = NULL;
    td_calibration *calibration = NULL;
    calibrate_trust *trust = calloc(1, sizeof *trust);
    gate_row rows[16];
    gate_result *gate = calloc(1, sizeof *gate);
    memcpy(rows, calibrate_gate_defaults, calibrate_gate_count * sizeof *rows);

    terminal term;
    char *log = NULL;
    size_t log_size = 0;
    terminal_init(&term, common.quiet, common.verbose);
    term.log_file = open_memstream(&log, &log_size);
    td_log logger = terminal_log(&term);
    td_progress progress = terminal_progress(&term);
    td_calibrate_options o = td_calibrate_options_default();
    o.progress = &progress;
    o.log = &logger;
    td_observe_options observe = {.threads = common.threads, .progress = &progress, .log = &logger};

    td_status status =
        gate && trust && term.log_file ? TD_OK : td_fail(&error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK)
        status = read_inputs(&dataset, &rig, &clicks, &observe.click_count, &o, rows, &error);
    observe.clicks = clicks;
    if (status == TD_OK)
        td_log_write(&logger, TD_LOG_INFO, "calibrate", "reading %zu frames", dataset->frame_count);
    if (status == TD_OK) status = td_observe(&observations, dataset, &observe, &error);
    if (status == TD_OK) status = td_calibrate(&calibration, observations, &o, &error);
    calibrate_job job = {
        .dataset = dataset, .observations = observations, .calibration = calibration, .options = &o};
    if (status == TD_OK) status = calibrate_trust_run(trust, &job, !no_models, &error);
    job.trust = trust;
    if (status == TD_OK) status = hash_dataset(job.hash, dataset, &error);
    terminal_clear(&term);
    if (status == TD_OK) status = finish(&job, gate, rows, &term, &log, &log_size, &error);

    int code = EXIT_DONE;
    if (status != TD_OK) {
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
        code = status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    } else if (gate->verdict == VERDICT_REFUSED && !accept) {
        code = EXIT_REFUSED;
    }
    if (term.log_file) fclose(term.log_file);
    free(log);
    free(gate);
    calibrate_trust_free(trust);
    free(trust);
    free(clicks);
    td_calibration_free(&calibration);
    td_observations_free(&observations);
    td_rig_free(&rig);
    td_dataset_free(&dataset);
    return code;
}

/* A dataset taken by the wizard, then calibrated like any other. */
static int guide(void)
{
    td_error error = {0};
    char *folder = NULL;
    terminal term;
    terminal_init(&term, common.quiet, common.verbose);
    const wizard_setup setup = {.folder = common.output,
                                .sources = &sources,
                                .target = target_words,
                                .model = model,
                                .live = live_kind,
                                .resume = resume,
                                .threads = common.threads};
    td_status status = wizard_run(&folder, &setup, &term, &error);
    if (status != TD_OK) {
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
        return status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    }
    dataset_path = common.output = folder;
    int code = run();
    free(folder);
    return code;
}

int main(int argc, char **argv)
{
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, calibrate_gate_defaults, calibrate_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int status = cli_parse(&command, argc, argv);
    if (status >= 0) return status;
    if (common.schema) {
        char *text = td_schema_describe(calibrate_schema, calibrate_schema_count);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    bool for_wizard = sources.count || target_words || live_kind || resume;
    if (dataset_path && for_wizard) {
        cli_complain(command.name,
                     "--source, --target, --live and --resume are the wizard's: leave out DATASET");
        return EXIT_USAGE;
    }
    if (resume && !common.output) {
        cli_complain(command.name, "--resume needs the folder that was begun: -o DIR");
        return EXIT_USAGE;
    }
    bool wizard = !dataset_path && isatty(STDIN_FILENO) && isatty(STDERR_FILENO);
    if (!wizard && (!dataset_path || !common.output || !*common.output)) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)%s",
                     dataset_path ? "-o DIR" : "DATASET", command.name, command.usage,
                     dataset_path ? "" : "; the wizard, which needs none, runs on a terminal");
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    return wizard ? guide() : run();
}
