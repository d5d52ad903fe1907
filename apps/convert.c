/* teledimos convert: a rig from the files of one tool to those of another. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/rig_formats.h"
#include "core/schema.h"

enum { LONGEST_FILE = 16 << 20 };

static const char *from_path[TD_RIG_MAX_CAMERAS];
static cli_common common;
static const char *from_name, *to_name, *camera_name;
static bool approximate;
static int width, height;
static double unit_m = 1;

static const char *const read_words[] = {"teledimos", "opencv", "ros", "kalibr", "visp", "mrcal", NULL};
static const char *const write_words[] = {"teledimos", "opencv", "ros",    "kalibr", "visp",
                                          "mrcal",     "urdf",   "ros-tf", NULL};

static cli_option options[] = {
    {CLI_STRING, "from", 0, &from_name, "FORMAT",
     "teledimos, opencv, ros, kalibr, visp or mrcal; default: what the files look like", 0, 0, read_words},
    {CLI_STRING, "to", 0, &to_name, "FORMAT",
     "one of these, or urdf or ros-tf: the poses alone, as joints of a URDF, or as arguments of ROS' "
     "static_transform_publisher; default: by the ending of TO (.yml opencv, .xml visp, .cameramodel mrcal, "
     "camchain….yaml kalibr, rig….yaml teledimos, .urdf urdf)",
     0, 0, write_words},
    {CLI_FLAG, "approximate", 0, &approximate, NULL,
     "where the format cannot hold a camera's model, write its nearest one by least squares over the image, "
     "and say "
     "how far it is off at most; default: refuse",
     0, 0, NULL},
    {CLI_STRING, "camera", 0, &camera_name, "NAME", "only this camera", 0, 0, NULL},
    {CLI_INT, "width", 0, &width, "PX", "width of the images, where the files do not tell it", 1, 65535,
     NULL},
    {CLI_INT, "height", 0, &height, "PX", "height of the images, where the files do not tell it", 1, 65535,
     NULL},
    {CLI_REAL, "unit-m", 0, &unit_m, "M",
     "length of FROM's unit of translations in metres (OpenCV's is what the board's squares were given in): "
     "0.001 "
     "for mm",
     1e-9, 1e9, NULL},
    CLI_COMMON_OPTIONS(
        common,
        "TO: a file; a folder (ending in /); for ros and mrcal, which have a file for each camera, "
        "a name with %s for the camera's. urdf and ros-tf go to standard output without it",
        "this job draws none"),
};

static cli_command command = {
    .name = "convert",
    .summary = "turn a rig into the files of another tool, or those into a rig",
    .usage = "FROM… -o TO [--from FORMAT] [--to FORMAT] [options]",
    .text = "Reads the cameras of FROM (several files where a tool has one for each camera, in the rig's "
            "order, or "
            "keeps intrinsics and extrinsics apart) and writes them to TO: exactly, or not at all, unless "
            "--approximate is given. What a format has no word for (the covariance, vehicle_from_rig, in "
            "some the "
            "poses) is said in a note.",
    .examples = "  teledimos calibrate datasets/opencv-stereo -o out\n"
                "  teledimos convert out/rig.yaml -o stereo.yml\n"
                "  teledimos convert out/rig.yaml -o camchain.yaml --approximate\n"
                "  teledimos convert out/rig.yaml --to ros -o ros/\n"
                "  teledimos convert ros/left.yaml ros/right.yaml -o rig-from-ros.yaml\n"
                "  teledimos convert out/rig.yaml --to ros-tf\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = TD_RIG_MAX_CAMERAS,
    .positional = from_path,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "convert"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"from", TD_SCHEMA_STRING, true, false, "format read"},
    {"to", TD_SCHEMA_STRING, true, false, "format written"},
    {"inputs", TD_SCHEMA_STRINGS, true, false, "file names"},
    {"cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, "a camera as it was read"},
    {"cameras.*.model", TD_SCHEMA_STRING, true, false, "pinhole, brown5, brown8, fisheye"},
    {"cameras.*.width_px", TD_SCHEMA_INT, true, false, "of its images"},
    {"cameras.*.height_px", TD_SCHEMA_INT, true, false, "of its images"},
    {"exact", TD_SCHEMA_BOOL, true, false, "models and parameters are the same to the last bit"},
    {"largest_error_px", TD_SCHEMA_REAL, true, false, "of an approximation, over all images; 0: exact"},
    {"remark", TD_SCHEMA_STRING, true, false, "what was approximated or is not held; may be empty"},
    {"products", TD_SCHEMA_STRINGS, true, false, "file names"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

static bool ends_in(const char *text, const char *end)
{
    const size_t length = strlen(text), tail = strlen(end);
    return length >= tail && !strcmp(text + length - tail, end);
}

/* The format that a file's name asks for; NULL: none. */
static const char *format_of_name(const char *path)
{
    const char *slash = strrchr(path, '/'), *base = slash ? slash + 1 : path;
    const bool yaml = ends_in(base, ".yaml");
    if (ends_in(base, ".cameramodel")) return "mrcal";
    if (ends_in(base, ".xml")) return "visp";
    if (ends_in(base, ".urdf")) return "urdf";
    if (ends_in(base, ".yml")) return "opencv";
    if (yaml && !strncmp(base, "camchain", 8)) return "kalibr";
    if (yaml && !strncmp(base, "rig", 3)) return "teledimos";
    return NULL;
}

/* What was read; the name is for the result only. */
static const char *format_read(void)
{
    char *text = NULL;
    size_t size = 0;
    if (from_name) return from_name;
    const char *name = NULL;
    if (td_file_read(&text, &size, from_path[0], LONGEST_FILE, NULL) == TD_OK)
        name = td_rig_format_name(td_rig_format_guess(text, size));
    free(text);
    return name ? name : "unknown";
}

/* ---- poses alone ---- */

static void add_joint(FILE *out, const char *parent, const char *child, const td_pose *parent_from_child)
{
    char *origin = td_pose_to_urdf(parent_from_child);
    fprintf(out,
            "<link name=\"%s\"/>\n<joint name=\"%s_from_%s\" type=\"fixed\">\n  <parent link=\"%s\"/>\n"
            "  <child link=\"%s\"/>\n  %s\n</joint>\n",
            child, parent, child, parent, child, origin ? origin : "");
    free(origin);
}

static void add_transform(FILE *out, const char *parent, const char *child, const td_pose *parent_from_child)
{
    char *line = td_pose_to_ros(parent_from_child, parent, child);
    fprintf(out, "%s\n", line ? line : "");
    free(line);
}

/* vehicle, rig, and a frame NAME_optical_frame (x right, y down, z forward) for each camera. */
static td_status write_poses(char **text, const td_rig *rig, bool urdf, td_error *error)
{
    size_t size = 0;
    FILE *out = open_memstream(text, &size);
    if (!out) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    void (*add)(FILE *, const char *, const char *, const td_pose *) = urdf ? add_joint : add_transform;
    if (urdf) fprintf(out, "<link name=\"%s\"/>\n", rig->has_vehicle ? "vehicle" : "rig");
    if (rig->has_vehicle) add(out, "vehicle", "rig", &rig->vehicle_from_rig);
    for (int i = 0; i < rig->count; i++) {
        char frame[TD_NAME_SIZE + 16];
        snprintf(frame, sizeof frame, "%s_optical_frame", rig->camera[i].name);
        const td_pose rig_from_camera = td_pose_inverse(&rig->camera[i].camera_from_rig);
        add(out, "rig", frame, &rig_from_camera);
    }
    return fclose(out) == 0 ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

static td_status export_poses(td_rig_export_report *report, const td_rig *rig, bool urdf, td_error *error)
{
    char *text = NULL;
    td_status status = write_poses(&text, rig, urdf, error);
    snprintf(report->remark, sizeof report->remark, "Poses alone: intrinsics and distortion are not held.");
    if (status == TD_OK && !common.output) fputs(text, stdout);
    if (status == TD_OK && common.output) {
        status = td_file_write(common.output, text, strlen(text), error);
        report->file[0] = strdup(common.output);
        report->file_count = report->file[0] ? 1 : 0;
    }
    free(text);
    return status;
}

/* ---- the result ---- */

static json_t *make_result(const td_rig *rig, const td_rig_export_report *report)
{
    json_t *root = json_object(), *inputs = json_array(), *products = json_array(), *cameras = json_object();
    json_object_set_new(root, "job", json_string("convert"));
    json_object_set_new(root, "version", json_string(TD_VERSION));
    json_object_set_new(root, "from", json_string(format_read()));
    json_object_set_new(root, "to", json_string(to_name));
    for (size_t i = 0; i < command.positional_count; i++)
        json_array_append_new(inputs, json_string(from_path[i]));
    json_object_set_new(root, "inputs", inputs);
    for (int i = 0; i < rig->count; i++) {
        const td_camera *c = &rig->camera[i].camera;
        json_object_set_new(cameras, rig->camera[i].name,
                            json_pack("{s:s, s:i, s:i}", "model", td_camera_model_name(c->model), "width_px",
                                      c->width, "height_px", c->height));
    }
    json_object_set_new(root, "cameras", cameras);
    json_object_set_new(root, "exact", json_boolean(report->largest_error_px == 0));
    json_object_set_new(root, "largest_error_px", td_json_real(report->largest_error_px));
    json_object_set_new(root, "remark", json_string(report->remark));
    for (size_t i = 0; i < report->file_count; i++)
        json_array_append_new(products, json_string(report->file[i]));
    json_object_set_new(root, "products", products);
    return root;
}

static td_status print_json(const td_rig *rig, const td_rig_export_report *report, td_error *error)
{
    json_t *result = make_result(rig, report);
    char *text = NULL;
    td_status status = td_schema_check(result, schema, SCHEMA_COUNT, error);
    if (status == TD_OK) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK) fputs(text, stdout);
    free(text);
    json_decref(result);
    return status;
}

static void print_table(const td_rig *rig, const td_rig_export_report *report)
{
    if (report->largest_error_px > 0)
        printf("%d camera%s written, off by up to %.3g px:", rig->count, rig->count > 1 ? "s" : "",
               report->largest_error_px);
    else
        printf("%d camera%s written, exact:", rig->count, rig->count > 1 ? "s" : "");
    for (size_t i = 0; i < report->file_count; i++) printf(" %s", report->file[i]);
    printf("\n");
    if (*report->remark && !common.quiet) printf("note: %s\n", report->remark);
}

static td_status run(const td_rig *rig, td_error *error)
{
    td_rig_export_report report = {0};
    const bool urdf = !strcmp(to_name, "urdf"), poses = urdf || !strcmp(to_name, "ros-tf");
    td_status status;
    if (poses)
        status = export_poses(&report, rig, urdf, error);
    else
        status =
            td_rig_export(rig, common.output, td_rig_format_from_name(to_name), approximate, &report, error);
    if (status == TD_OK && common.json) status = print_json(rig, &report, error);
    if (status == TD_OK && !common.json && common.output) print_table(rig, &report);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    td_rig_export_report_free(&report);
    return status;
}

/* What wrong usage there is, as a sentence; NULL: none. */
static const char *wrong_usage(void)
{
    if (!command.positional_count) return "FROM is missing";
    if (!to_name && common.output) to_name = format_of_name(common.output);
    const bool poses = to_name && (!strcmp(to_name, "urdf") || !strcmp(to_name, "ros-tf"));
    if ((!common.output || !*common.output) && (!poses || common.json)) return "-o TO is missing";
    if (!to_name) return "--to FORMAT is missing, for the name of TO does not tell it";
    return NULL;
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
    const char *wrong = wrong_usage();
    if (wrong) {
        cli_complain(command.name, "%s (usage: teledimos %s %s)", wrong, command.name, command.usage);
        return EXIT_USAGE;
    }
    td_linalg_single_thread();
    td_error error = {0};
    td_rig *rig = NULL;
    const td_rig_import_options import = {.format = td_rig_format_from_name(from_name),
                                          .width = width,
                                          .height = height,
                                          .unit_m = unit_m,
                                          .camera = camera_name};
    td_status status = td_rig_import(&rig, from_path, command.positional_count, &import, &error);
    if (status == TD_OK) status = run(rig, &error);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    td_rig_free(&rig);
    return status == TD_OK ? EXIT_DONE : status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
