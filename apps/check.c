/* teledimos check: has a calibrated rig drifted? */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "apps/gate.h"
#include "apps/terminal.h"
#include "calib/drift.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/report.h"
#include "core/schema.h"

static const char *argument[2];
static cli_common common;
static cli_list gates;
static double noise_px = 0;

/* The one row; here what is below is refused. */
static gate_row gate = {"p_value", 1e-2, 1e-3, ""};

static cli_option options[] = {
    {CLI_REAL, "noise", 0, &noise_px, "PX",
     "standard deviation of a found point's coordinates; default: from the residuals that no rig can explain",
     0, 100, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE",
     "p_value=0.001: the rig counts as drifted when residuals such as these come by chance less often than "
     "this "
     "(a remark at ten times that); at one in a thousand, a check on every working day raises one false "
     "alarm in "
     "four years",
     0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for report.html and result.yaml; default: none is written",
                       "this job draws none"),
};

static cli_command command = {
    .name = "check",
    .summary = "check a rig against new images, without solving for it",
    .usage = "RIG DATASET [-o DIR] [options]",
    .text =
        "Finds the target in the images of DATASET, fits its pose in each view with the cameras of RIG "
        "(rig.yaml) held, and judges the residuals: noise they must have, and the rig's own covariance lets "
        "expect some more. What is beyond both is drift; the check then says what has most likely moved. The "
        "images must be new ones: those the rig was calibrated from agree with it too well. One view will "
        "do, "
        "more see smaller changes. Outlying points and views are left out; a bent board is allowed "
        "for.\n\nExit status: 0 fine, 1 failed, 2 wrong usage, 3 drifted.",
    .examples = "  teledimos calibrate datasets/opencv-stereo -o out\n"
                "  teledimos check out/rig.yaml datasets/opencv-stereo\n"
                "  teledimos check out/rig.yaml datasets/opencv-stereo -o checked --gate p_value=0.01\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 2,
    .positional = argument,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "check"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"rig", TD_SCHEMA_STRING, true, false, "file that was checked"},
    {"dataset", TD_SCHEMA_STRING, true, false, "name"},
    {"p_value", TD_SCHEMA_REAL, true, true,
     "of residuals like these were the rig unchanged; null: no covariance"},
    {"drift_sigma", TD_SCHEMA_REAL, true, true, "the same as a number of standard deviations, at most 37"},
    {"drifted", TD_SCHEMA_BOOL, true, false, "p_value is below the gate's"},
    {"covariance_known", TD_SCHEMA_BOOL, true, false, "of the rig"},
    {"cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, "a camera"},
    {"cameras.*.views", TD_SCHEMA_INT, true, false, "used"},
    {"cameras.*.points", TD_SCHEMA_INT, true, false, "used"},
    {"cameras.*.rms_px", TD_SCHEMA_REAL, true, true, "residuals, every view at its own pose"},
    {"cameras.*.noise_px", TD_SCHEMA_REAL, true, true, "the same from the points' noise alone"},
    {"cameras.*.predicted_px", TD_SCHEMA_REAL, true, true, "the same from noise and the rig's covariance"},
    {"cameras.*.p_value", TD_SCHEMA_REAL, true, true, "of this camera alone"},
    {"pairs", TD_SCHEMA_OBJECT, true, false, "each camera with the first, by name"},
    {"pairs.*", TD_SCHEMA_OBJECT, false, false, "a pair"},
    {"pairs.*.views", TD_SCHEMA_INT, true, false, "in which both see the target"},
    {"pairs.*.points", TD_SCHEMA_INT, true, false, "in both"},
    {"pairs.*.epipolar_px", TD_SCHEMA_REAL, true, true,
     "RMS distance from the epipolar line in the second image"},
    {"pairs.*.predicted_epipolar_px", TD_SCHEMA_REAL, true, true, "the same, expected"},
    {"pairs.*.vertical_px", TD_SCHEMA_REAL, true, true, "mean of that distance, with its sign"},
    {"pairs.*.sigma_vertical_px", TD_SCHEMA_REAL, true, true, "standard deviation"},
    {"pairs.*.scale_error", TD_SCHEMA_REAL, true, true, "of the triangulated target, a fraction"},
    {"pairs.*.sigma_scale_error", TD_SCHEMA_REAL, true, true, "standard deviation"},
    {"pairs.*.p_value", TD_SCHEMA_REAL, true, true, "of these two cameras"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, false, false, "file name"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

typedef struct job {
    td_dataset *dataset;
    td_rig *rig;
    td_observations *observations;
    td_drift drift;
    double *residual; /* (views, cameras of the rig, points, 2) */
    verdict verdict;
} job;

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *camera_json(const td_drift_camera *c)
{
    json_t *o = json_object();
    set(o, "views", json_integer((json_int_t)c->views));
    set(o, "points", json_integer((json_int_t)c->points));
    set(o, "rms_px", td_json_real(c->rms_px));
    set(o, "noise_px", td_json_real(c->noise_px));
    set(o, "predicted_px", td_json_real(c->predicted_px));
    set(o, "p_value", td_json_real(c->p_value));
    return o;
}

static json_t *pair_json(const td_drift_pair *p)
{
    json_t *o = json_object();
    set(o, "views", json_integer((json_int_t)p->views));
    set(o, "points", json_integer((json_int_t)p->points));
    set(o, "epipolar_px", td_json_real(p->epipolar_px));
    set(o, "predicted_epipolar_px", td_json_real(p->predicted_epipolar_px));
    set(o, "vertical_px", td_json_real(p->vertical_px));
    set(o, "sigma_vertical_px", td_json_real(p->sigma_vertical_px));
    set(o, "scale_error", td_json_real(p->scale_error));
    set(o, "sigma_scale_error", td_json_real(p->sigma_scale_error));
    set(o, "p_value", td_json_real(p->p_value));
    return o;
}

static json_t *make_result(const job *j)
{
    const td_drift *d = &j->drift;
    json_t *root = json_object(), *cameras = json_object(), *pairs = json_object(), *reasons = json_array(),
           *products = json_object();
    set(root, "job", json_string("check"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "rig", json_string(argument[0]));
    set(root, "dataset", json_string(j->dataset->name));
    set(root, "verdict", json_string(verdict_name(j->verdict)));
    json_array_append_new(reasons, json_string(d->text));
    set(root, "reasons", reasons);
    set(root, "p_value", td_json_real(d->p_value));
    set(root, "drift_sigma", td_json_real(d->drift_sigma));
    set(root, "drifted", json_boolean(d->drifted));
    set(root, "covariance_known", json_boolean(d->covariance_known));
    for (int c = 0; c < j->rig->count; c++) set(cameras, j->rig->camera[c].name, camera_json(&d->camera[c]));
    for (size_t k = 0; k < d->pair_count; k++) {
        char name[2 * TD_NAME_SIZE + 2];
        snprintf(name, sizeof name, "%s-%s", j->rig->camera[d->pair[k].first].name,
                 j->rig->camera[d->pair[k].second].name);
        set(pairs, name, pair_json(&d->pair[k]));
    }
    set(root, "cameras", cameras);
    set(root, "pairs", pairs);
    if (common.output) set(products, "report", json_string("report.html"));
    set(root, "products", products);
    return root;
}

static void print_table(const job *j)
{
    const td_drift *d = &j->drift;
    printf("\n%-10s %6s %7s %12s %12s %12s %9s\n", "camera", "views", "points", "residual px", "expected px",
           "noise px", "p");
    for (int c = 0; c < j->rig->count; c++) {
        const td_drift_camera *k = &d->camera[c];
        printf("%-10s %6zu %7zu %12.4f %12.4f %12.4f %9.2g\n", j->rig->camera[c].name, k->views, k->points,
               k->rms_px, k->predicted_px, k->noise_px, k->p_value);
    }
    for (size_t k = 0; k < d->pair_count; k++) {
        const td_drift_pair *p = &d->pair[k];
        printf("\n%s–%s: epipolar distance %.4f px (expected %.4f), vertical %+.4f ± %.4f px, triangulated "
               "scale %+.3f "
               "± %.3f %%\n",
               j->rig->camera[p->first].name, j->rig->camera[p->second].name, p->epipolar_px,
               p->predicted_epipolar_px, p->vertical_px, p->sigma_vertical_px, 100 * p->scale_error,
               100 * p->sigma_scale_error);
    }
    printf("\n%s\n", d->text);
    if (common.output) printf("report: %s/report.html\n", common.output);
}

/* ---- the report ---- */

static void report_tables(td_report *r, const job *j)
{
    static const char *const cameras[] = {"camera",        "views",      "points", "residual (px)",
                                          "expected (px)", "noise (px)", "p"};
    static const char *const pairs[] = {
        "pair", "views", "epipolar distance (px)", "expected (px)", "vertical (px)", "scale error (%)", "p"};
    td_report_table_begin(r, cameras, 7);
    for (int c = 0; c < j->rig->count; c++) {
        const td_drift_camera *k = &j->drift.camera[c];
        td_report_cell(r, TD_TONE_PLAIN, "%s", j->rig->camera[c].name);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", k->views);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", k->points);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", k->rms_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", k->predicted_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", k->noise_px);
        td_report_cell(r, k->p_value < gate.refuse ? TD_TONE_BAD : TD_TONE_PLAIN, "%.2g", k->p_value);
        td_report_row_end(r);
    }
    td_report_table_end(r);
    if (!j->drift.pair_count) return;
    td_report_table_begin(r, pairs, 7);
    for (size_t k = 0; k < j->drift.pair_count; k++) {
        const td_drift_pair *p = &j->drift.pair[k];
        td_report_cell(r, TD_TONE_PLAIN, "%s–%s", j->rig->camera[p->first].name,
                       j->rig->camera[p->second].name);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", p->views);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", p->epipolar_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", p->predicted_epipolar_px);
        td_report_cell(r, TD_TONE_PLAIN, "%+.4f ± %.4f", p->vertical_px, p->sigma_vertical_px);
        td_report_cell(r, TD_TONE_PLAIN, "%+.3f ± %.3f", 100 * p->scale_error, 100 * p->sigma_scale_error);
        td_report_cell(r, p->p_value < gate.refuse ? TD_TONE_BAD : TD_TONE_PLAIN, "%.2g", p->p_value);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* Residuals of a camera over its image, from where the rig puts each point to where it was seen. */
static void residual_plot(td_report *r, const job *j, int camera)
{
    const td_rig_camera *c = &j->rig->camera[camera];
    const td_observations *o = j->observations;
    size_t points = td_target_point_count(&o->target), n = 0;
    int column = o->camera_count - 1;
    while (column >= 0 && strcmp(o->camera[column].name, c->name) != 0) column--;
    double *x = malloc((4 * o->view_count * points + 1) * sizeof *x);
    if (!x || column < 0) {
        free(x);
        return;
    }
    double *y = x + o->view_count * points, *dx = y + o->view_count * points,
           *dy = dx + o->view_count * points;
    for (size_t v = 0; v < o->view_count; v++)
        for (size_t p = 0; p < points; p++) {
            const double *e = j->residual + 2 * ((v * (size_t)j->rig->count + (size_t)camera) * points + p);
            if (!isfinite(e[0])) continue;
            const double *seen = td_observations_get(o, v, column)->point + 2 * p;
            x[n] = seen[0], y[n] = seen[1], dx[n] = -e[0], dy[n++] = -e[1];
        }
    char title[TD_NAME_SIZE + 32];
    double scale = 0.02 * c->camera.width / fmax(j->drift.camera[camera].rms_px, 1e-3);
    double step = pow(10, floor(log10(scale)));
    snprintf(title, sizeof title, "%s: residuals over the image", c->name);
    const td_series series = {.shape = TD_SHAPE_POINT,
                              .label = "used",
                              .count = n,
                              .x = x,
                              .y = y,
                              .dx = dx,
                              .dy = dy,
                              .vector_scale = floor(scale / step) * step};
    const td_axes axes = {.title = title,
                          .x_label = "x (px)",
                          .y_label = "y (px)",
                          .x_min = -0.5,
                          .x_max = c->camera.width - 0.5,
                          .y_min = -0.5,
                          .y_max = c->camera.height - 0.5,
                          .equal = 1,
                          .y_down = 1};
    if (n) td_report_plot(r, &axes, &series, 1);
    free(x);
}

static td_status write_report(const job *j, const char *path, td_error *error)
{
    static const char *const words[] = {"fine", "look again", "drifted"};
    char title[TD_NAME_SIZE + 32];
    snprintf(title, sizeof title, "Check of a rig by %s", j->dataset->name);
    td_report *r = td_report_new(title, argument[0]);
    const char *sentence = j->drift.text;
    td_report_verdict(r, verdict_tone(j->verdict), words[j->verdict], &sentence, 1);
    td_report_figures_begin(r);
    td_report_figure(r, "p, were the rig unchanged", verdict_tone(j->verdict), "%.2g", j->drift.p_value);
    td_report_figure(r, "as standard deviations", verdict_tone(j->verdict), "%.1f", j->drift.drift_sigma);
    td_report_figures_end(r);
    td_report_heading(r, "Residuals against what is expected");
    td_report_text(
        r, "Every view has its own pose. Expected is what the points' noise and the rig's own covariance "
           "give together. p is the probability of what the cameras' parameters could explain of "
           "residuals like these, were the rig unchanged.");
    report_tables(r, j);
    td_report_grid_begin(r, 2);
    for (int c = 0; c < j->rig->count; c++) residual_plot(r, j, c);
    td_report_grid_end(r);
    td_status status = r ? td_report_write(r, path, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_report_free(&r);
    return status;
}

static td_status write_products(const job *j, const json_t *result, td_error *error)
{
    char *yaml = NULL, *path = td_path_join(common.output, "result.yaml"),
         *report = td_path_join(common.output, "report.html");
    td_status status = path && report ? td_folder_make(common.output, error)
                                      : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (status == TD_OK) status = write_report(j, report, error);
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = td_file_write(path, yaml, strlen(yaml), error);
    free(yaml);
    free(path);
    free(report);
    return status;
}

static td_status finish(const job *j, td_error *error)
{
    json_t *result = make_result(j);
    char *text = NULL;
    td_status status = td_schema_check(result, schema, SCHEMA_COUNT, error);
    if (status == TD_OK && terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK && common.output) status = write_products(j, result, error);
    if (status == TD_OK && common.json) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && !text) print_table(j);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    json_decref(result);
    free(text);
    return status;
}

static td_status run(job *j, terminal *term, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++) TD_TRY(gate_set(&gate, 1, gates.value[i], error));
    TD_TRY(td_rig_read(&j->rig, argument[0], error));
    TD_TRY(td_dataset_read(&j->dataset, argument[1], error));
    td_log logger = terminal_log(term);
    td_progress progress = terminal_progress(term);
    const td_observe_options observe = {.threads = common.threads, .progress = &progress, .log = &logger};
    TD_TRY(td_observe(&j->observations, j->dataset, &observe, error));
    size_t slots =
        j->observations->view_count * (size_t)j->rig->count * td_target_point_count(&j->observations->target);
    td_drift_options o = td_drift_options_default();
    o.p_limit = gate.refuse;
    o.noise_px = noise_px;
    o.progress = &progress;
    o.residual = j->residual = malloc((2 * slots + 1) * sizeof *j->residual);
    if (!j->residual) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", slots);
    td_status status = td_drift_measure(&j->drift, j->rig, j->observations, &o, error);
    if (status != TD_OK)
        return td_error_prefix(error, status, "%s and dataset %s", argument[0], j->dataset->name);
    j->verdict = j->drift.drifted                                                        ? VERDICT_REFUSED
                 : !j->drift.covariance_known || !(j->drift.p_value >= 10 * gate.refuse) ? VERDICT_WARNED
                                                                                         : VERDICT_ACCEPTED;
    terminal_clear(term);
    return finish(j, error);
}

int main(int argc, char **argv)
{
    int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    if (common.schema) {
        char *text = td_schema_describe(schema, SCHEMA_COUNT);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    if (!argument[0] || !argument[1]) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)", argument[0] ? "DATASET" : "RIG",
                     command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    terminal term;
    terminal_init(&term, common.quiet, common.verbose);
    td_error error = {0};
    job j = {0};
    td_status status = run(&j, &term, &error);
    terminal_clear(&term);
    if (status != TD_OK)
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
    code = status == TD_OK               ? (j.drift.drifted ? EXIT_REFUSED : EXIT_DONE)
           : status == TD_ERROR_ARGUMENT ? EXIT_USAGE
                                         : EXIT_FAILED;
    free(j.residual);
    td_observations_free(&j.observations);
    td_rig_free(&j.rig);
    td_dataset_free(&j.dataset);
    return code;
}
