/* teledimos compare: how far two rigs are apart, and whether that is more than their covariances allow. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "apps/gate.h"
#include "apps/terminal.h"
#include "calib/rig_compare.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/report.h"
#include "core/schema.h"

#define DEGREES 57.29577951308232

static const char *argument[2];
static cli_common common;
static cli_list gates;
static double distance_m = 0;

/* The one row; here what is below is refused. */
static gate_row gate = {"p_value", 1e-2, 1e-3, ""};

static cli_option options[] = {
    {CLI_REAL, "distance", 0, &distance_m, "M",
     "working distance at which the images are compared; default: infinite (rotations of a camera's frame "
     "are "
     "then taken out, shifts do not show)",
     1e-3, 1e6, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE",
     "p_value=0.001: the rigs count as different when calibrations of one rig are this far apart less often "
     "(a "
     "remark at ten times that): two good calibrations are refused once in a thousand times",
     0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for report.html and result.yaml; default: none is written",
                       "this job draws none"),
};

static cli_command command = {
    .name = "compare",
    .summary = "compare two rigs: difference over the images, with its significance",
    .usage = "A B [--distance M] [-o DIR] [options]",
    .text =
        "A and B are rig.yaml of the same cameras, calibrated from different images. Of each camera: by how "
        "many "
        "pixels its images of the world differ once a common motion of its frame is taken out, which the "
        "intrinsics leave open; of each camera with the first: the change of the relative pose. All together "
        "are judged by both covariances, taken to be independent. Cameras are matched by name.\n\nExit "
        "status: "
        "0 consistent, 1 failed, 2 wrong usage, 3 different.",
    .examples = "  teledimos calibrate datasets/opencv-stereo -o out\n"
                "  teledimos calibrate datasets/opencv-stereo -o plain --plain\n"
                "  teledimos compare out/rig.yaml plain/rig.yaml --distance 0.5 -o compared\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 2,
    .positional = argument,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "compare"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"a", TD_SCHEMA_STRING, true, false, "file"},
    {"b", TD_SCHEMA_STRING, true, false, "file"},
    {"distance_m", TD_SCHEMA_REAL, true, true, "at which images are compared; null: infinite"},
    {"p_value", TD_SCHEMA_REAL, true, true,
     "of a difference like this between calibrations of one rig; null: unknown"},
    {"significant", TD_SCHEMA_BOOL, true, false, "p_value is below the gate's"},
    {"cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, "a camera that both rigs have"},
    {"cameras.*.rms_px", TD_SCHEMA_REAL, true, false, "of the difference over the image"},
    {"cameras.*.most_px", TD_SCHEMA_REAL, true, false, "the largest difference"},
    {"cameras.*.rms_mm", TD_SCHEMA_REAL, true, true, "at the distance; null: infinite"},
    {"cameras.*.sigma_px", TD_SCHEMA_REAL, true, true, "RMS expected from both covariances"},
    {"cameras.*.rotation_deg", TD_SCHEMA_REALS, true, false, "taken out: a's frame from b's, about x y z"},
    {"cameras.*.translation_m", TD_SCHEMA_REALS, true, false, "taken out: a's frame from b's"},
    {"cameras.*.chi2", TD_SCHEMA_REAL, true, true, "of this camera's lens"},
    {"cameras.*.degrees", TD_SCHEMA_INT, true, false, "of freedom"},
    {"cameras.*.p_value", TD_SCHEMA_REAL, true, true, "of this camera's lens"},
    {"pairs", TD_SCHEMA_OBJECT, true, false, "each camera with the first, by name"},
    {"pairs.*", TD_SCHEMA_OBJECT, false, false, "the relative pose of b against a's"},
    {"pairs.*.rotation_deg", TD_SCHEMA_REALS, true, false, "about the second camera's x y z"},
    {"pairs.*.sigma_rotation_deg", TD_SCHEMA_REALS, true, true, "standard deviations"},
    {"pairs.*.translation_m", TD_SCHEMA_REALS, true, false, "along the second camera's x y z"},
    {"pairs.*.sigma_translation_m", TD_SCHEMA_REALS, true, true, "standard deviations"},
    {"pairs.*.baseline_m", TD_SCHEMA_REAL, true, false, "b's less a's"},
    {"pairs.*.sigma_baseline_m", TD_SCHEMA_REAL, true, true, "standard deviation"},
    {"pairs.*.p_value", TD_SCHEMA_REAL, true, true, "of this pose"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, false, false, "file name"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

typedef struct job {
    td_rig *rig[2];
    td_rig_compare compare;
    verdict verdict;
} job;

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

/* null when a number is unknown. */
static json_t *three(const double v[3], double factor)
{
    const double scaled[3] = {v[0] * factor, v[1] * factor, v[2] * factor};
    return isfinite(v[0] + v[1] + v[2]) ? td_json_reals(scaled, 3) : json_null();
}

static json_t *camera_json(const td_compared_camera *c)
{
    json_t *o = json_object();
    set(o, "rms_px", td_json_real(c->rms_px));
    set(o, "most_px", td_json_real(c->most_px));
    set(o, "rms_mm", td_json_real(c->rms_mm));
    set(o, "sigma_px", td_json_real(c->sigma_px));
    set(o, "rotation_deg", three(c->rotation_rad, DEGREES));
    set(o, "translation_m", three(c->translation_m, 1));
    set(o, "chi2", td_json_real(c->chi2));
    set(o, "degrees", json_integer(c->degrees));
    set(o, "p_value", td_json_real(c->p_value));
    return o;
}

static json_t *pair_json(const td_compared_pair *p)
{
    json_t *o = json_object();
    set(o, "rotation_deg", three(p->rotation_rad, DEGREES));
    set(o, "sigma_rotation_deg", three(p->sigma_rotation_rad, DEGREES));
    set(o, "translation_m", three(p->translation_m, 1));
    set(o, "sigma_translation_m", three(p->sigma_translation_m, 1));
    set(o, "baseline_m", td_json_real(p->baseline_m));
    set(o, "sigma_baseline_m", td_json_real(p->sigma_baseline_m));
    set(o, "p_value", td_json_real(p->p_value));
    return o;
}

static char *pair_name(char text[2 * TD_NAME_SIZE + 8], const td_rig_compare *c, int index, const char *dash)
{
    snprintf(text, 2 * TD_NAME_SIZE + 8, "%s%s%s", c->camera[c->pair[index].first].name, dash,
             c->camera[c->pair[index].second].name);
    return text;
}

static json_t *make_result(const job *j)
{
    const td_rig_compare *c = &j->compare;
    json_t *root = json_object(), *cameras = json_object(), *pairs = json_object(), *reasons = json_array(),
           *products = json_object();
    char name[2 * TD_NAME_SIZE + 8];
    set(root, "job", json_string("compare"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "a", json_string(argument[0]));
    set(root, "b", json_string(argument[1]));
    set(root, "distance_m", td_json_real(distance_m > 0 ? distance_m : NAN));
    set(root, "verdict", json_string(verdict_name(j->verdict)));
    json_array_append_new(reasons, json_string(c->text));
    set(root, "reasons", reasons);
    set(root, "p_value", td_json_real(c->p_value));
    set(root, "significant", json_boolean(c->significant));
    for (int k = 0; k < c->camera_count; k++) set(cameras, c->camera[k].name, camera_json(&c->camera[k]));
    for (int k = 0; k < c->pair_count; k++) set(pairs, pair_name(name, c, k, "-"), pair_json(&c->pair[k]));
    set(root, "cameras", cameras);
    set(root, "pairs", pairs);
    if (common.output) set(products, "report", json_string("report.html"));
    set(root, "products", products);
    return root;
}

static void print_table(const job *j)
{
    const td_rig_compare *c = &j->compare;
    char name[2 * TD_NAME_SIZE + 8];
    printf("\n%-10s %10s %12s %10s %10s %9s\n", "camera", "RMS px", "expected px", "most px", "RMS mm", "p");
    for (int k = 0; k < c->camera_count; k++) {
        const td_compared_camera *a = &c->camera[k];
        printf("%-10s %10.4f %12.4f %10.4f %10.4f %9.2g\n", a->name, a->rms_px, a->sigma_px, a->most_px,
               a->rms_mm, a->p_value);
    }
    for (int k = 0; k < c->pair_count; k++) {
        const td_compared_pair *p = &c->pair[k];
        printf("\n%s: rotation", pair_name(name, c, k, "–"));
        for (int i = 0; i < 3; i++)
            printf(" %+.4f ± %.4f°", p->rotation_rad[i] * DEGREES, p->sigma_rotation_rad[i] * DEGREES);
        printf(", translation");
        for (int i = 0; i < 3; i++)
            printf(" %+.3f ± %.3f", 1e3 * p->translation_m[i], 1e3 * p->sigma_translation_m[i]);
        printf(" mm, baseline %+.3f ± %.3f mm, p = %.2g\n", 1e3 * p->baseline_m, 1e3 * p->sigma_baseline_m,
               p->p_value);
    }
    printf("\n%s\n", c->text);
    if (common.output) printf("report: %s/report.html\n", common.output);
}

/* ---- the report ---- */

static void difference_plot(td_report *r, const td_compared_camera *c, const td_camera *camera)
{
    enum { CELLS = TD_COMPARE_ROWS * TD_COMPARE_COLUMNS };
    double x[CELLS], y[CELLS], dx[CELLS], dy[CELLS];
    char title[TD_NAME_SIZE + 64];
    double scale = 0.02 * camera->width / fmax(c->rms_px, 1e-3), step = pow(10, floor(log10(scale)));
    for (int i = 0; i < CELLS; i++) {
        x[i] = (i % TD_COMPARE_COLUMNS + 0.5) * camera->width / TD_COMPARE_COLUMNS - 0.5;
        y[i] = ((i / TD_COMPARE_COLUMNS) + 0.5) * camera->height / TD_COMPARE_ROWS - 0.5;
        dx[i] = c->difference_px[i][0];
        dy[i] = c->difference_px[i][1];
    }
    snprintf(title, sizeof title, "%s: B's image less A's, up to %.2f px", c->name, c->most_px);
    const td_series series = {.shape = TD_SHAPE_POINT,
                              .label = "difference",
                              .count = CELLS,
                              .x = x,
                              .y = y,
                              .dx = dx,
                              .dy = dy,
                              .vector_scale = floor(scale / step) * step};
    const td_axes axes = {.title = title,
                          .x_label = "x (px)",
                          .y_label = "y (px)",
                          .x_min = -0.5,
                          .x_max = camera->width - 0.5,
                          .y_min = -0.5,
                          .y_max = camera->height - 0.5,
                          .equal = 1,
                          .y_down = 1};
    td_report_plot(r, &axes, &series, 1);
}

/* A grey picture of a value over the image: black 0, white `most` and above. */
static void map_picture(td_report *r, const td_compared_camera *c, double most, bool expected)
{
    enum { ZOOM = 12 };
    td_image *image = NULL;
    char caption[TD_NAME_SIZE + 96];
    if (td_image_new(&image, TD_COMPARE_COLUMNS * ZOOM, TD_COMPARE_ROWS * ZOOM, 1, NULL) != TD_OK) return;
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++) {
            int cell = y / ZOOM * TD_COMPARE_COLUMNS + x / ZOOM;
            double value =
                expected ? c->expected_px[cell] : hypot(c->difference_px[cell][0], c->difference_px[cell][1]);
            image->data[y * image->width + x] = (uint8_t)(isfinite(value) ? 255 * fmin(value / most, 1) : 0);
        }
    snprintf(caption, sizeof caption, "%s: %s over the image, white is %.2g px and more", c->name,
             expected ? "difference expected from both covariances" : "length of the difference", most);
    td_report_picture(r, image, 0, caption, NULL, 0);
    td_image_free(&image);
}

static void report_tables(td_report *r, const td_rig_compare *c)
{
    static const char *const cameras[] = {"camera",    "RMS (px)", "expected (px)",
                                          "most (px)", "RMS (mm)", "p"};
    static const char *const pairs[] = {"pair", "rotation x, y, z (°)", "translation x, y, z (mm)",
                                        "baseline (mm)", "p"};
    char name[2 * TD_NAME_SIZE + 8];
    td_report_table_begin(r, cameras, 6);
    for (int k = 0; k < c->camera_count; k++) {
        const td_compared_camera *a = &c->camera[k];
        td_report_cell(r, TD_TONE_PLAIN, "%s", a->name);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", a->rms_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", a->sigma_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", a->most_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", a->rms_mm);
        td_report_cell(r, a->p_value < gate.refuse ? TD_TONE_BAD : TD_TONE_PLAIN, "%.2g", a->p_value);
        td_report_row_end(r);
    }
    td_report_table_end(r);
    if (!c->pair_count) return;
    td_report_table_begin(r, pairs, 5);
    for (int k = 0; k < c->pair_count; k++) {
        const td_compared_pair *p = &c->pair[k];
        const double *w = p->rotation_rad, *s = p->sigma_rotation_rad, *t = p->translation_m,
                     *u = p->sigma_translation_m;
        td_report_cell(r, TD_TONE_PLAIN, "%s", pair_name(name, c, k, "–"));
        td_report_cell(r, TD_TONE_PLAIN, "%+.4f ± %.4f, %+.4f ± %.4f, %+.4f ± %.4f", w[0] * DEGREES,
                       s[0] * DEGREES, w[1] * DEGREES, s[1] * DEGREES, w[2] * DEGREES, s[2] * DEGREES);
        td_report_cell(r, TD_TONE_PLAIN, "%+.3f ± %.3f, %+.3f ± %.3f, %+.3f ± %.3f", 1e3 * t[0], 1e3 * u[0],
                       1e3 * t[1], 1e3 * u[1], 1e3 * t[2], 1e3 * u[2]);
        td_report_cell(r, TD_TONE_PLAIN, "%+.3f ± %.3f", 1e3 * p->baseline_m, 1e3 * p->sigma_baseline_m);
        td_report_cell(r, p->p_value < gate.refuse ? TD_TONE_BAD : TD_TONE_PLAIN, "%.2g", p->p_value);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static td_status write_report(const job *j, const char *path, td_error *error)
{
    static const char *const words[] = {"consistent", "look again", "different"};
    const td_rig_compare *c = &j->compare;
    char subtitle[512];
    snprintf(subtitle, sizeof subtitle, "A: %s, B: %s", argument[0], argument[1]);
    td_report *r = td_report_new("Comparison of two rigs", subtitle);
    const char *sentence = c->text;
    td_report_verdict(r, verdict_tone(j->verdict), words[j->verdict], &sentence, 1);
    td_report_heading(r, "Differences");
    td_report_text(
        r, "Of each camera after the motion of its frame that explains most of the difference; expected is "
           "what both covariances give together, large where no view of a calibration reached.");
    report_tables(r, c);
    td_report_grid_begin(r, 2);
    for (int k = 0; k < c->camera_count; k++) {
        int index = td_rig_find(j->rig[0], c->camera[k].name);
        difference_plot(r, &c->camera[k], &j->rig[0]->camera[index < 0 ? k : index].camera);
    }
    td_report_grid_end(r);
    td_report_grid_begin(r, 2);
    for (int k = 0; k < c->camera_count; k++) {
        double most = fmax(fmin(c->camera[k].most_px, 10), 0.01);
        map_picture(r, &c->camera[k], most, false);
        if (isfinite(c->camera[k].sigma_px)) map_picture(r, &c->camera[k], most, true);
    }
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

static td_status run(job *j, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++) TD_TRY(gate_set(&gate, 1, gates.value[i], error));
    for (int k = 0; k < 2; k++) TD_TRY(td_rig_read(&j->rig[k], argument[k], error));
    td_status status = td_rig_compare_run(&j->compare, j->rig[0], j->rig[1],
                                          distance_m > 0 ? distance_m : INFINITY, gate.refuse, error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s and %s", argument[0], argument[1]);
    j->verdict = j->compare.significant                      ? VERDICT_REFUSED
                 : !(j->compare.p_value >= 10 * gate.refuse) ? VERDICT_WARNED
                                                             : VERDICT_ACCEPTED;
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
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)", argument[0] ? "B" : "A",
                     command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    td_error error = {0};
    job *j = calloc(1, sizeof *j);
    td_status status = j ? run(j, &error) : td_fail(&error, TD_ERROR_MEMORY, "out of memory");
    if (status != TD_OK)
        cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
    code = status == TD_OK               ? (j->compare.significant ? EXIT_REFUSED : EXIT_DONE)
           : status == TD_ERROR_ARGUMENT ? EXIT_USAGE
                                         : EXIT_FAILED;
    for (int k = 0; k < 2 && j; k++) td_rig_free(&j->rig[k]);
    free(j);
    return code;
}
