/* The table of formats, and what they go through in common: an import is read, checked and brought to the
 * first camera's frame; an export is brought into the format's models first, so that writers are exact. */
#include "core/rig_formats.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/document_internal.h"
#include "core/file.h"
#include "core/rig_formats_internal.h"

/* NULL: rig.yaml, which core/rig.h reads and writes. */
static const td_rig_room *const rooms[TD_RIG_FORMAT_COUNT] = {
    [TD_RIG_OPENCV] = &td_rig_room_opencv, [TD_RIG_ROS] = &td_rig_room_ros,
    [TD_RIG_KALIBR] = &td_rig_room_kalibr, [TD_RIG_VISP] = &td_rig_room_visp,
    [TD_RIG_MRCAL] = &td_rig_room_mrcal,
};

const char *td_rig_format_name(td_rig_format format)
{
    if ((int)format < 0 || format >= TD_RIG_FORMAT_COUNT) return NULL;
    return format == TD_RIG_TELEDIMOS ? "teledimos" : rooms[format]->name;
}

td_rig_format td_rig_format_from_name(const char *name)
{
    int format = 0;
    while (name && format < TD_RIG_FORMAT_COUNT &&
           strcmp(name, td_rig_format_name((td_rig_format)format)) != 0)
        format++;
    return name ? (td_rig_format)format : TD_RIG_FORMAT_COUNT;
}

static bool holds(const char *text, size_t size, const char *word)
{
    const size_t length = strlen(word);
    for (size_t i = 0; i + length <= size; i++)
        if (text[i] == *word && !memcmp(text + i, word, length)) return true;
    return false;
}

td_rig_format td_rig_format_guess(const char *text, size_t size)
{
    static const struct {
        const char *word[2];
        td_rig_format format;
    } signs[] = {{{"teledimos:", "cameras:"}, TD_RIG_TELEDIMOS},
                 {{"LENSMODEL_", "intrinsics"}, TD_RIG_MRCAL},
                 {{"opencv-matrix", ""}, TD_RIG_OPENCV},
                 {{"<opencv_storage", ""}, TD_RIG_OPENCV},
                 {{"%YAML:", ""}, TD_RIG_OPENCV},
                 {{"<root", "<camera"}, TD_RIG_VISP},
                 {{"camera_model:", "cam0"}, TD_RIG_KALIBR},
                 {{"distortion_model", "camera_matrix"}, TD_RIG_ROS}};
    for (size_t i = 0; i < sizeof signs / sizeof *signs; i++)
        if (holds(text, size, signs[i].word[0]) && holds(text, size, signs[i].word[1]))
            return signs[i].format;
    return TD_RIG_FORMAT_COUNT;
}

/* ---- reading ---- */

static td_status choose_format(td_rig_format *format, const td_rig_text *file, size_t count,
                               const td_rig_import_options *options, td_error *error)
{
    *format = options->format;
    for (size_t i = 0; i < count && options->format == TD_RIG_FORMAT_COUNT; i++) {
        const td_rig_format seen = td_rig_format_guess(file[i].text, file[i].size);
        if (strspn(file[i].text, " \t\r\n") >= file[i].size)
            return td_fail(error, TD_ERROR_FORMAT, "%s: is empty", file[i].name);
        if (seen == TD_RIG_FORMAT_COUNT)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: looks like no format known here (rig.yaml, OpenCV, ROS, Kalibr, ViSP, "
                           "mrcal); say which it is",
                           file[i].name);
        if (i && seen != *format)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: looks like %s, but %s like %s; give files of one format", file[i].name,
                           td_rig_format_name(seen), file[0].name, td_rig_format_name(*format));
        *format = seen;
    }
    return TD_OK;
}

static td_status read_own(td_rig **rig, const td_rig_text *file, size_t count, td_error *error)
{
    if (count != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: a rig.yaml holds all its cameras; give one file, not %zu", file[0].name, count);
    return td_rig_parse(rig, file[0].text, file[0].size, file[0].name, error);
}

/* Brown without distortion is the pinhole; its covariance is of other parameters, so only foreign rigs. */
static void simplify(td_camera *camera)
{
    if (camera->model == TD_CAMERA_FISHEYE) return;
    for (int i = 4; i < TD_CAMERA_MAX_PARAMETERS; i++)
        if (camera->parameter[i] != 0) return;
    camera->model = TD_CAMERA_PINHOLE;
}

static void list_names(char *list, size_t size, const td_rig *rig)
{
    size_t used = 0;
    list[0] = 0;
    for (int i = 0; i < rig->count && used < size; i++)
        used += (size_t)snprintf(list + used, size - used, "%s%s", i ? ", " : "", rig->camera[i].name);
}

/* Keeps one camera; what else there was, the covariance too, goes. */
static td_status keep_camera(td_rig *rig, const char *name, const char *file, td_error *error)
{
    char list[256], shown[TD_SHOWN_SIZE];
    const int index = td_rig_find(rig, name);
    list_names(list, sizeof list, rig);
    if (index < 0)
        return td_fail(error, TD_ERROR_NOT_FOUND, "%s: has no camera %s; there are %s", file,
                       td_text_shown(shown, name), list);
    if (rig->count == 1) return TD_OK;
    const td_rig_camera kept = rig->camera[index];
    rig->camera[0] = kept;
    rig->camera[0].camera_from_rig = td_pose_identity();
    rig->count = 1;
    rig->has_vehicle = false;
    free(rig->covariance);
    rig->covariance = NULL;
    return TD_OK;
}

static void to_first_camera(td_rig *rig, double unit_m)
{
    const td_pose identity = td_pose_identity(), first = rig->camera[0].camera_from_rig;
    const td_pose any_from_first = td_pose_inverse(&first);
    const bool moved = memcmp(&first, &identity, sizeof first) != 0;
    for (int i = 0; i < rig->count; i++) {
        td_pose *pose = &rig->camera[i].camera_from_rig;
        if (moved) *pose = i ? td_pose_compose(pose, &any_from_first) : identity;
        for (int k = 0; k < 3; k++) pose->t[k] *= unit_m;
    }
}

static td_status finish(td_rig_reading *reading, const td_rig_text *file, td_error *error)
{
    td_rig *rig = reading->rig;
    const td_rig_import_options *options = reading->options;
    char list[256];
    for (int i = 0; i < rig->count; i++) {
        td_camera *camera = &rig->camera[i].camera;
        if (!camera->width || !camera->height) {
            camera->width = options->width;
            camera->height = options->height;
        }
        if (camera->width < 1 || camera->height < 1)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: does not tell the size of camera %s's images; give width and height",
                           file->name, rig->camera[i].name);
        simplify(camera);
    }
    if (options->camera) TD_TRY(keep_camera(rig, options->camera, file->name, error));
    list_names(list, sizeof list, rig);
    if (rig->count > 1 && reading->poses_unknown)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: the poses of %s to one another are not told; name one camera", file->name, list);
    if (rig->count > 0) to_first_camera(rig, options->unit_m > 0 ? options->unit_m : 1);
    td_error why;
    if (td_rig_check(rig, &why) != TD_OK)
        return td_fail(error, TD_ERROR_FORMAT, "%s: %s", file->name, why.message);
    return TD_OK;
}

/* {imported_from: kalibr, files: […]}. */
static td_status tell_origin(td_rig *rig, const td_rig_room *room, const td_rig_text *file, size_t count,
                             td_error *error)
{
    json_t *files = json_array();
    for (size_t i = 0; i < count; i++) {
        json_t *name = json_string(file[i].name);
        json_array_append_new(files, name ? name : json_string("?")); /* a name that is not UTF-8 */
    }
    rig->provenance = json_pack("{s:s, s:o}", "imported_from", room->name, "files", files);
    return rig->provenance ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a rig");
}

static td_status read_foreign(td_rig **rig, const td_rig_room *room, const td_rig_text *file, size_t count,
                              const td_rig_import_options *options, td_error *error)
{
    td_rig_reading reading = {.rig = td_rig_new(), .options = options};
    if (!reading.rig) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a rig", file->name);
    td_status status = room->read(&reading, file, count, error);
    if (status == TD_OK) status = finish(&reading, file, error);
    if (status == TD_OK) status = tell_origin(reading.rig, room, file, count, error);
    if (status == TD_OK)
        *rig = reading.rig;
    else
        td_rig_free(&reading.rig);
    return status;
}

td_status td_rig_import_text(td_rig **rig, const td_rig_text *file, size_t count,
                             const td_rig_import_options *options, td_error *error)
{
    const td_rig_import_options guess = {.format = TD_RIG_FORMAT_COUNT};
    if (!options) options = &guess;
    td_rig_format format;
    if (!count) return td_fail(error, TD_ERROR_ARGUMENT, "no file is given");
    TD_TRY(choose_format(&format, file, count, options, error));
    if ((int)format < 0 || format >= TD_RIG_FORMAT_COUNT)
        return td_fail(error, TD_ERROR_ARGUMENT, "format: %d is none", (int)format);
    if (format != TD_RIG_TELEDIMOS) return read_foreign(rig, rooms[format], file, count, options, error);
    td_rig *made = NULL;
    TD_TRY(read_own(&made, file, count, error));
    td_status status = options->camera ? keep_camera(made, options->camera, file->name, error) : TD_OK;
    if (status == TD_OK)
        *rig = made;
    else
        td_rig_free(&made);
    return status;
}

td_status td_rig_import(td_rig **rig, const char *const *path, size_t count,
                        const td_rig_import_options *options, td_error *error)
{
    enum { MOST = TD_RIG_MAX_CAMERAS };
    td_rig_text file[MOST] = {{0}};
    char *bytes[MOST] = {NULL};
    if (count > MOST)
        return td_fail(error, TD_ERROR_ARGUMENT, "%zu files are given, but a rig has at most %d cameras",
                       count, MOST);
    td_status status = TD_OK;
    for (size_t i = 0; status == TD_OK && i < count; i++) {
        file[i].name = path[i];
        status = td_file_read(&bytes[i], &file[i].size, path[i], TD_DOCUMENT_SIZE, error);
        file[i].text = bytes[i];
    }
    if (status == TD_OK) status = td_rig_import_text(rig, file, count, options, error);
    for (size_t i = 0; i < count; i++) free(bytes[i]);
    return status;
}

/* ---- writing ---- */

/* Says what a camera would lose, or lost. */
static td_status express(td_camera *camera, const td_rig_camera *from, const td_rig_room *room,
                         bool approximate, td_rig_export_report *report, td_error *error)
{
    const td_rig_shape *shape = NULL;
    double largest = 0;
    const bool exact = td_rig_holds(&from->camera, room->shape, room->shape_count);
    TD_TRY(td_rig_express(camera, &shape, &largest, &from->camera, room->shape, room->shape_count, error));
    if (exact) return TD_OK;
    const char *model = td_camera_model_name(from->camera.model);
    if (!isfinite(largest))
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "camera %s: %s holds no model like this %s, not even nearly; choose another format",
                       from->name, room->title, model);
    if (!approximate)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "camera %s: %s cannot hold this %s; its nearest model, %s, is off by up to %.3g px: "
                       "allow an approximation, or choose another format",
                       from->name, room->title, model, shape->name, largest);
    report->largest_error_px = fmax(report->largest_error_px, largest);
    td_rig_add_remark(report->remark, sizeof report->remark, "%s: %s instead of %s, off by up to %.3g px.",
                      from->name, shape->name, model, largest);
    return TD_OK;
}

static void remark_losses(td_rig_export_report *report, const td_rig *rig, const td_rig *expressed,
                          const td_rig_room *room)
{
    const char *const lost[2] = {rig->covariance ? "the covariance" : NULL,
                                 rig->has_vehicle ? "vehicle_from_rig" : NULL};
    if (room->remark) room->remark(report->remark, sizeof report->remark, expressed);
    if (lost[0] || lost[1])
        td_rig_add_remark(report->remark, sizeof report->remark, "%s%s%s %s not held by the format.",
                          lost[0] ? lost[0] : "", lost[0] && lost[1] ? " and " : "", lost[1] ? lost[1] : "",
                          lost[0] && lost[1] ? "are" : "is");
}

/* The same rig in the room's models. */
static td_status express_rig(td_rig **expressed, const td_rig *rig, const td_rig_room *room, bool approximate,
                             td_rig_export_report *report, td_error *error)
{
    TD_TRY(td_rig_check(rig, error));
    td_rig *made = td_rig_new();
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for a rig");
    td_status status = TD_OK;
    made->count = rig->count;
    for (int i = 0; status == TD_OK && i < rig->count; i++) {
        made->camera[i] = rig->camera[i];
        status = express(&made->camera[i].camera, rig->camera + i, room, approximate, report, error);
    }
    if (status == TD_OK) remark_losses(report, rig, made, room);
    if (status == TD_OK)
        *expressed = made;
    else
        td_rig_free(&made);
    return status;
}

static td_status write_text(char **text, const td_rig *expressed, int camera, const td_rig_room *room,
                            td_error *error)
{
    td_text out = {0};
    room->write(&out, expressed, camera);
    if (out.failed) {
        free(out.data);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the text of a rig");
    }
    *text = out.data;
    return TD_OK;
}

static td_status check_format(td_rig_format format, td_error *error)
{
    if ((int)format >= 0 && format < TD_RIG_FORMAT_COUNT) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "format: %d is none", (int)format);
}

td_status td_rig_export_text(char **text, const td_rig *rig, int camera, td_rig_format format,
                             bool approximate, td_rig_export_report *report, td_error *error)
{
    td_rig_export_report unseen = {0};
    td_rig *expressed = NULL;
    TD_TRY(check_format(format, error));
    if (format == TD_RIG_TELEDIMOS) return td_rig_to_yaml(text, rig, error);
    TD_TRY(express_rig(&expressed, rig, rooms[format], approximate, report ? report : &unseen, error));
    if (camera < 0 || camera >= rig->count) camera = 0;
    td_status status = write_text(text, expressed, camera, rooms[format], error);
    td_rig_free(&expressed);
    return status;
}

static bool is_folder(const char *path)
{
    struct stat seen;
    const size_t length = strlen(path);
    return (length && path[length - 1] == '/') || (stat(path, &seen) == 0 && S_ISDIR(seen.st_mode));
}

/* `pattern` with the first %s replaced; NULL: out of memory. */
static char *with_name(const char *pattern, const char *name)
{
    td_text out = {0};
    const char *at = strstr(pattern, "%s");
    td_text_add(&out, pattern, at ? (size_t)(at - pattern) : strlen(pattern));
    if (at) td_text_format(&out, "%s%s", name, at + 2);
    if (!out.failed) return out.data;
    free(out.data);
    return NULL;
}

/* The file of `camera`. */
static td_status make_path(char **made, const char *path, const char *file, bool per_camera,
                           const td_rig *rig, int camera, td_error *error)
{
    const char *name = rig->camera[camera].name;
    char *pattern = is_folder(path) ? td_path_join(path, file) : td_path_join("", path);
    if (!pattern) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const bool several = per_camera && rig->count > 1, named = strstr(pattern, "%s") != NULL;
    *made = named && per_camera ? with_name(pattern, name) : with_name("%s", pattern);
    free(pattern);
    if (!*made) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (!several || named) return TD_OK;
    free(*made);
    *made = NULL;
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "%s: this format has a file for each of the %d cameras; give a folder (ending in /), or a "
                   "name with %%s for the camera's",
                   path, rig->count);
}

/* All texts and names first, so that nothing is written when one of them cannot be made. */
static td_status write_files(td_rig_export_report *report, const td_rig *rig, const char *path,
                             const char *file, const td_rig_room *room, td_error *error)
{
    char *text[TD_RIG_MAX_CAMERAS] = {NULL};
    const int count = room && room->file_per_camera ? rig->count : 1;
    td_status status = TD_OK;
    for (int i = 0; status == TD_OK && i < count; i++) {
        status = room ? write_text(&text[i], rig, i, room, error) : td_rig_to_yaml(&text[i], rig, error);
        if (status != TD_OK) break;
        status = make_path(&report->file[i], path, file, count > 1 || (room && room->file_per_camera), rig, i,
                           error);
        if (status == TD_OK) report->file_count = (size_t)i + 1;
    }
    for (int i = 0; status == TD_OK && i < count; i++) {
        char *folder = td_path_folder(report->file[i]);
        status =
            folder ? td_folder_make(folder, error) : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
        if (status == TD_OK) status = td_file_write(report->file[i], text[i], strlen(text[i]), error);
        free(folder);
    }
    for (int i = 0; i < count; i++) free(text[i]);
    return status;
}

td_status td_rig_export(const td_rig *rig, const char *path, td_rig_format format, bool approximate,
                        td_rig_export_report *report, td_error *error)
{
    td_rig_export_report own = {0};
    TD_TRY(check_format(format, error));
    td_rig *expressed = NULL;
    const td_rig_room *room = rooms[format];
    td_status status = TD_OK;
    if (room) status = express_rig(&expressed, rig, room, approximate, &own, error);
    if (status == TD_OK)
        status = write_files(&own, room ? expressed : rig, path, room ? room->file : "rig.yaml", room, error);
    td_rig_free(&expressed);
    if (report && status == TD_OK)
        *report = own;
    else
        td_rig_export_report_free(&own);
    return status;
}

void td_rig_export_report_free(td_rig_export_report *report)
{
    if (!report) return;
    for (size_t i = 0; i < sizeof report->file / sizeof *report->file; i++) free(report->file[i]);
    *report = (td_rig_export_report){0};
}
