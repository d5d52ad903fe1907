/* EuRoC's folders (Burri et al. 2016): sensor.yaml and data.csv of each camera, poses of the body. */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/csv.h"
#include "core/dataset_layout_internal.h"
#include "core/document.h"
#include "core/file.h"

enum { CAMERAS = 2, LARGEST_FILE = 64 << 20, NAME_BYTES = 24, PATH_BYTES = 300 };

static const double LARGEST_GAP_S = 0.1;
static const double NANOSECOND = 1e-9;

static td_status out_of_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a dataset");
}

/* The folder that holds cam0: mav0 below, or the folder itself. */
static const char *prefix_of(const char *folder)
{
    if (td_dataset_has_file(folder, "mav0/cam0/data.csv")) return "mav0/";
    return td_dataset_has_file(folder, "cam0/data.csv") && td_dataset_has_file(folder, "cam0/sensor.yaml")
               ? ""
               : NULL;
}

bool td_dataset_is_euroc(const char *folder)
{
    return prefix_of(folder) != NULL;
}

/* ---- sensor.yaml ---- */

static td_status parse_model(td_camera *camera, const td_field *root, td_error *error)
{
    static const char *const models[] = {"radial-tangential", "radtan", "equidistant", "none", NULL};
    static const char *const kinds[] = {"pinhole", NULL};
    td_field kind = td_field_get(root, "camera_model"), model = td_field_get(root, "distortion_model");
    td_field size = td_field_get(root, "resolution"), intrinsics = td_field_get(root, "intrinsics");
    td_field distortion = td_field_get(root, "distortion_coefficients");
    int choice;
    double wide[2], d[4] = {0};
    TD_TRY(td_field_choice(&choice, &kind, kinds, "pinhole", error));
    TD_TRY(td_field_choice(&choice, &model, models, "radial-tangential, equidistant or none", error));
    TD_TRY(td_field_reals(wide, 2, &size, 1, 65535, error));
    camera->model = choice == 2 ? TD_CAMERA_FISHEYE : choice == 3 ? TD_CAMERA_PINHOLE : TD_CAMERA_BROWN5;
    camera->width = (int)wide[0];
    camera->height = (int)wide[1];
    TD_TRY(td_field_reals(camera->parameter, 4, &intrinsics, -1e6, 1e6, error));
    if (choice == 3) return TD_OK;
    TD_TRY(td_field_reals(d, 4, &distortion, -1e3, 1e3, error));
    memcpy(camera->parameter + 4, d, sizeof d); /* k1 k2 p1 p2, or fisheye's k1 … k4 */
    return TD_OK;
}

static td_status parse_pose(td_pose *body_from_camera, const td_field *root, td_error *error)
{
    td_field pose = td_field_get(root, "T_BS"), data = td_field_get(&pose, "data");
    double m[16], norm = 0;
    TD_TRY(td_field_reals(m, 16, &data, -1e5, 1e5, error));
    const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, t[3] = {m[3], m[7], m[11]};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            const double dot =
                r[3 * a] * r[3 * b] + r[3 * a + 1] * r[3 * b + 1] + r[3 * a + 2] * r[3 * b + 2];
            norm = fmax(norm, fabs(dot - (a == b)));
        }
    if (!(norm < 1e-3)) return td_field_fail(&data, error, "its upper left 3 x 3 numbers are no rotation");
    *body_from_camera = td_pose_from_rotation(r, t);
    return TD_OK;
}

static td_status read_sensor(td_rig_camera *camera, td_pose *body_from_camera, const char *folder,
                             const char *prefix, int index, td_error *error)
{
    char name[PATH_BYTES], *bytes = NULL;
    size_t size = 0;
    json_t *document = NULL;
    snprintf(name, sizeof name, "%scam%d/sensor.yaml", prefix, index);
    char *path = td_path_join(folder, name);
    if (!path) return out_of_memory(error);
    td_status status = td_file_read(&bytes, &size, path, LARGEST_FILE, error);
    if (status == TD_OK) {
        const size_t head =
            size && bytes[0] == '%' ? strcspn(bytes, "\n") : 0; /* %YAML:1.0, as OpenCV writes it */
        status = td_document_parse(&document, bytes + head, size - head, path, error);
    }
    if (status == TD_OK) {
        const td_field root = {NULL, path, document};
        snprintf(camera->name, sizeof camera->name, "cam%d", index);
        status = parse_model(&camera->camera, &root, error);
        if (status == TD_OK) status = parse_pose(body_from_camera, &root, error);
    }
    json_decref(document);
    free(bytes);
    free(path);
    return status;
}

/* vehicle: the body, whose poses are given. */
static td_status read_rig(char **text, const char *folder, const char *prefix, td_error *error)
{
    td_rig *rig = td_rig_new();
    td_pose body_from[CAMERAS];
    if (!rig) return out_of_memory(error);
    rig->count = CAMERAS;
    td_status status = TD_OK;
    for (int c = 0; status == TD_OK && c < CAMERAS; c++)
        status = read_sensor(&rig->camera[c], &body_from[c], folder, prefix, c, error);
    if (status == TD_OK) {
        const td_pose second_from_body = td_pose_inverse(&body_from[1]);
        rig->camera[0].camera_from_rig = td_pose_identity();
        rig->camera[1].camera_from_rig = td_pose_compose(&second_from_body, &body_from[0]);
        rig->has_vehicle = true;
        rig->vehicle_from_rig = body_from[0];
        status = td_rig_to_yaml(text, rig, error);
    }
    td_rig_free(&rig);
    return status;
}

/* ---- tables without a header of ours ---- */

/* Reads a table of `columns` cells a row under the names given: its own header is a comment. Blanks between
 * cells, where `blanks`, count as commas. */
static td_status read_table(td_csv **csv, const char *folder, const char *name, const char *header,
                            bool blanks, td_error *error)
{
    char *path = td_path_join(folder, name), *bytes = NULL;
    size_t size = 0;
    td_text text = {0};
    if (!path) return out_of_memory(error);
    td_status status = td_file_read(&bytes, &size, path, LARGEST_FILE - 1024, error);
    for (size_t i = 0; status == TD_OK && blanks && i < size; i++)
        if (bytes[i] == ' ' || bytes[i] == '\t') bytes[i] = ',';
    if (status == TD_OK) {
        td_text_format(&text, "%s\n", header);
        td_text_add(&text, bytes, size);
        status = text.failed ? out_of_memory(error) : td_csv_parse(csv, text.data, text.size, path, error);
    }
    free(text.data);
    free(bytes);
    free(path);
    return status;
}

/* ---- poses ---- */

typedef struct stamped {
    double time_s;
    td_pose pose;
} stamped;

typedef struct track {
    stamped *at;
    size_t count;
} track;

static int by_time(const void *a, const void *b)
{
    const double x = ((const stamped *)a)->time_s, y = ((const stamped *)b)->time_s;
    return (x > y) - (x < y);
}

/* `first`: the column of tx; scalar: that of the quaternion's real part. */
static td_status fill_track(track *t, const td_csv *csv, double unit_s, const int order[8], td_error *error)
{
    t->at = calloc(csv->rows + 1, sizeof *t->at);
    if (!t->at) return out_of_memory(error);
    for (size_t row = 0; row < csv->rows; row++) {
        double v[8], norm = 0;
        for (int k = 0; k < 8; k++)
            TD_TRY(td_csv_real(&v[k], csv, row, order[k], k ? -1e7 : -1e21, k ? 1e7 : 1e21, error));
        for (int k = 4; k < 8; k++) norm += v[k] * v[k];
        if (!(fabs(norm - 1) < 1e-2))
            return td_csv_fail(csv, row, order[4], error, "the quaternion's length is %.4g, not 1",
                               sqrt(norm));
        stamped *s = &t->at[t->count++];
        s->time_s = v[0] * unit_s;
        for (int k = 0; k < 3; k++) s->pose.t[k] = v[1 + k];
        for (int k = 0; k < 4; k++) s->pose.q[k] = v[4 + k] / sqrt(norm);
    }
    qsort(t->at, t->count, sizeof *t->at, by_time);
    return TD_OK;
}

static bool is_trajectory(const char *folder, const char *name)
{
    char head[64] = "";
    const size_t n = strlen(name);
    if (n < 5 || strcmp(name + n - 4, ".txt") != 0 || n >= PATH_BYTES) return false;
    char *path = td_path_join(folder, name);
    FILE *file = NULL;
    if (path && td_file_stream(&file, path, NULL) == TD_OK) {
        head[fread(head, 1, sizeof head - 1, file)] = 0;
        fclose(file);
    }
    free(path);
    return strncmp(head, "# timestamp", 11) == 0 && strstr(head, "tx ty tz qx qy qz qw");
}

/* The first by name of the trajectories beside mav0; "" when there is none. */
static void find_trajectory(char found[PATH_BYTES], const char *folder)
{
    DIR *directory = opendir(folder);
    found[0] = 0;
    for (const struct dirent *e; directory && (e = readdir(directory));)
        if (is_trajectory(folder, e->d_name) && (!*found || strcmp(e->d_name, found) < 0))
            snprintf(found, PATH_BYTES, "%s", e->d_name);
    if (directory) closedir(directory);
}

static td_status read_track(track *t, const char *folder, const char *prefix, td_error *error)
{
    char name[PATH_BYTES];
    td_csv *csv = NULL;
    td_status status = TD_OK;
    snprintf(name, sizeof name, "%sstate_groundtruth_estimate0/data.csv", prefix);
    if (td_dataset_has_file(folder, name)) {
        static const int order[8] = {0, 1, 2, 3, 4, 5, 6, 7};
        status =
            read_table(&csv, folder, name, "t,x,y,z,qw,qx,qy,qz,vx,vy,vz,wx,wy,wz,ax,ay,az", false, error);
        if (status == TD_OK) status = fill_track(t, csv, NANOSECOND, order, error);
    } else {
        static const int order[8] = {0, 1, 2, 3, 7, 4, 5, 6};
        find_trajectory(name, folder);
        if (*name) status = read_table(&csv, folder, name, "t,x,y,z,qx,qy,qz,qw", true, error);
        if (*name && status == TD_OK) status = fill_track(t, csv, 1, order, error);
    }
    td_csv_free(&csv);
    return status;
}

/* Straight on and turning evenly from one pose to the next; false: none near. */
static bool pose_at(td_pose *pose, const track *t, double time_s)
{
    size_t low = 0, high = t->count;
    while (low < high) { /* first at or after */
        const size_t middle = (low + high) / 2;
        if (t->at[middle].time_s < time_s)
            low = middle + 1;
        else
            high = middle;
    }
    const stamped *b = low < t->count ? &t->at[low] : NULL, *a = low > 0 ? &t->at[low - 1] : NULL;
    const double SAME_S = 2e-5; /* tables are rounded to that */
    if (b && b->time_s - time_s < SAME_S) return *pose = b->pose, true;
    if (a && time_s - a->time_s < SAME_S) return *pose = a->pose, true;
    if (!a || !b || time_s - a->time_s > LARGEST_GAP_S || b->time_s - time_s > LARGEST_GAP_S) return false;
    const double share = (time_s - a->time_s) / (b->time_s - a->time_s);
    td_pose from = a->pose, to = b->pose, turned;
    double turn[3];
    memset(from.t, 0, sizeof from.t);
    memset(to.t, 0, sizeof to.t);
    const td_pose back = td_pose_inverse(&from), by = td_pose_compose(&to, &back);
    td_rotation_log(turn, by.q);
    for (int k = 0; k < 3; k++) turn[k] *= share;
    td_pose part = td_pose_identity();
    td_rotation_exp(part.q, turn);
    turned = td_pose_compose(&part, &from);
    for (int k = 0; k < 3; k++) turned.t[k] = a->pose.t[k] + share * (b->pose.t[k] - a->pose.t[k]);
    *pose = turned;
    return true;
}

/* ---- frames ---- */

static td_status read_images(td_csv *csv[CAMERAS], const char *folder, const char *prefix, td_error *error)
{
    for (int c = 0; c < CAMERAS; c++) {
        char name[PATH_BYTES];
        snprintf(name, sizeof name, "%scam%d/data.csv", prefix, c);
        TD_TRY(read_table(&csv[c], folder, name, "timestamp,filename", false, error));
        for (size_t row = 0; row < csv[c]->rows; row++) {
            const char *stamp = td_csv_cell(csv[c], row, 0), *file = td_csv_cell(csv[c], row, 1);
            const size_t digits = strspn(stamp, "0123456789");
            if (!digits || stamp[digits] || digits >= NAME_BYTES)
                return td_csv_fail(csv[c], row, 0, error, "a time in nanoseconds is needed");
            if (!*file || strchr(file, '/') || strlen(file) > 200 || strpbrk(file, ",\"\n\r"))
                return td_csv_fail(csv[c], row, 1, error, "the name of a file in data/ is needed");
        }
    }
    return TD_OK;
}

/* The row of the same time, from `hint` on and then from the beginning; rows: there is none. */
static size_t row_of(const td_csv *csv, const char *stamp, size_t hint)
{
    for (size_t k = 0; k < csv->rows; k++) {
        const size_t row = (hint + k) % csv->rows;
        if (strcmp(td_csv_cell(csv, row, 0), stamp) == 0) return row;
    }
    return csv->rows;
}

static void write_row(td_text *out, const char *folder, const char *prefix, const char *stamp,
                      const char *const image[CAMERAS], const track *t)
{
    char name[CAMERAS][PATH_BYTES];
    bool there = false;
    td_pose pose;
    for (int c = 0; c < CAMERAS; c++) {
        name[c][0] = 0;
        if (!image[c]) continue;
        snprintf(name[c], sizeof name[c], "%scam%d/data/%s", prefix, c, image[c]);
        there |= td_dataset_has_file(folder, name[c]);
    }
    if (!there) return;
    const double time_s = strtod(stamp, NULL) * NANOSECOND;
    td_text_format(out, "%s,%.9f,%s,%s", stamp, time_s, name[0], name[1]);
    if (t->count && pose_at(&pose, t, time_s))
        td_text_format(out, ",%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", pose.t[0], pose.t[1], pose.t[2],
                       pose.q[0], pose.q[1], pose.q[2], pose.q[3]);
    else if (t->count)
        td_text_format(out, ",,,,,,,");
    td_text_format(out, "\n");
}

static td_status write_table(td_text *out, const char *folder, const char *prefix, const track *t,
                             td_error *error)
{
    td_csv *csv[CAMERAS] = {NULL, NULL};
    td_status status = read_images(csv, folder, prefix, error);
    td_text_format(out, "frame,time_s,cam0,cam1%s\n", t->count ? ",x_m,y_m,z_m,qw,qx,qy,qz" : "");
    for (size_t row = 0; status == TD_OK && row < csv[0]->rows; row++) {
        const char *stamp = td_csv_cell(csv[0], row, 0);
        const size_t other = row_of(csv[1], stamp, row);
        const char *const image[CAMERAS] = {td_csv_cell(csv[0], row, 1),
                                            other < csv[1]->rows ? td_csv_cell(csv[1], other, 1) : NULL};
        write_row(out, folder, prefix, stamp, image, t);
    }
    for (int c = 0; c < CAMERAS; c++) td_csv_free(&csv[c]);
    if (status == TD_OK && out->failed) status = out_of_memory(error);
    return status;
}

td_status td_dataset_euroc(td_dataset_layout *layout, const char *folder, td_error *error)
{
    const char *prefix = prefix_of(folder);
    char name[TD_NAME_SIZE];
    track t = {0};
    td_text table = {0}, yaml = {0};
    *layout = (td_dataset_layout){0};
    td_status status = read_rig(&layout->rig, folder, prefix, error);
    if (status == TD_OK) status = read_track(&t, folder, prefix, error);
    if (status == TD_OK) status = write_table(&table, folder, prefix, &t, error);
    free(t.at);
    td_dataset_layout_name(name, folder);
    td_text_format(&yaml,
                   "name: \"%s\"\nabout: a folder in EuRoC's layout\nrig: rig.yaml\n"
                   "cameras: [{name: cam0, model: brown5}, {name: cam1, model: brown5}]\n",
                   name);
    layout->table = table.data;
    layout->yaml = yaml.data;
    if (status == TD_OK && yaml.failed) status = out_of_memory(error);
    if (status != TD_OK) td_dataset_layout_free(layout);
    return status;
}
