/* Middlebury's rectified pairs (Scharstein and Szeliski 2002, Scharstein et al. 2014). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/dataset_layout_internal.h"
#include "core/file.h"
#include "core/number.h"

enum { LARGEST_FILE = 1 << 16, NAME_BYTES = 32 };

static const char *const pairs[][2] = {{"im0", "im1"}, {"im2", "im6"}, {"view1", "view5"}};
static const char *const endings[] = {"png", "ppm"};

static bool find_pair(char name[2][NAME_BYTES], const char *folder)
{
    for (size_t p = 0; p < sizeof pairs / sizeof *pairs; p++)
        for (size_t e = 0; e < sizeof endings / sizeof *endings; e++) {
            for (int side = 0; side < 2; side++)
                snprintf(name[side], NAME_BYTES, "%s.%s", pairs[p][side], endings[e]);
            if (td_dataset_has_file(folder, name[0]) && td_dataset_has_file(folder, name[1])) return true;
        }
    return false;
}

bool td_dataset_is_middlebury(const char *folder)
{
    char name[2][NAME_BYTES];
    return find_pair(name, folder);
}

/* ---- calib.txt: lines NAME=VALUE, matrices as [f 0 cx; 0 f cy; 0 0 1] ---- */

/* `count` numbers behind "key=" at the beginning of a line. */
static td_status numbers_of(double *value, size_t count, const char *text, const char *key, const char *path,
                            td_error *error)
{
    const size_t length = strlen(key);
    const char *at = text;
    while (at && !(strncmp(at, key, length) == 0 && at[length] == '=')) {
        at = strchr(at, '\n');
        if (at) at++;
    }
    if (!at) return td_fail(error, TD_ERROR_FORMAT, "%s: has no line %s=…", path, key);
    at += length + 1;
    const char *end = at + strcspn(at, "\r\n");
    for (size_t i = 0; i < count; i++) {
        at += strspn(at, " [;,\t");
        const size_t size = strcspn(at, " ];,\t\r\n");
        char number[64] = "", *rest;
        if (at < end && size > 0 && size < sizeof number) memcpy(number, at, size);
        value[i] = strtod(number, &rest);
        if (!*number || *rest || !(fabs(value[i]) < 1e9))
            return td_fail(error, TD_ERROR_FORMAT, "%s: %s: %zu numbers are needed, the %zu. is none", path,
                           key, count, i + 1);
        at += size;
    }
    return TD_OK;
}

static td_status fill_rig(td_rig *rig, const char *text, const char *path, td_error *error)
{
    double k[2][9], doffs, baseline, width, height;
    TD_TRY(numbers_of(k[0], 9, text, "cam0", path, error));
    TD_TRY(numbers_of(k[1], 9, text, "cam1", path, error));
    TD_TRY(numbers_of(&doffs, 1, text, "doffs", path, error));
    TD_TRY(numbers_of(&baseline, 1, text, "baseline", path, error));
    TD_TRY(numbers_of(&width, 1, text, "width", path, error));
    TD_TRY(numbers_of(&height, 1, text, "height", path, error));
    if (!(baseline > 0 && width >= 1 && height >= 1 && width <= 65535 && height <= 65535))
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: baseline %g mm, width %g and height %g px: no pair has these", path, baseline,
                       width, height);
    if (fabs(k[1][2] - k[0][2] - doffs) > 0.01)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: doffs is %g, but the principal points of cam1 and cam0 differ by %g px", path,
                       doffs, k[1][2] - k[0][2]);
    rig->count = 2;
    for (int c = 0; c < 2; c++) {
        td_rig_camera *camera = &rig->camera[c];
        snprintf(camera->name, sizeof camera->name, c ? "right" : "left");
        camera->camera =
            (td_camera){TD_CAMERA_PINHOLE, (int)width, (int)height, {k[c][0], k[c][4], k[c][2], k[c][5]}};
        camera->camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[0] = -1e-3 * baseline;
    return TD_OK;
}

static td_status read_rig(char **yaml, const char *folder, td_error *error)
{
    char *path = td_path_join(folder, "calib.txt"), *text = NULL;
    size_t size = 0;
    td_rig *rig = td_rig_new();
    td_status status =
        path && rig ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the rig of %s", folder);
    if (status == TD_OK) status = td_file_read(&text, &size, path, LARGEST_FILE, error);
    if (status == TD_OK) status = fill_rig(rig, text, path, error);
    if (status == TD_OK) status = td_rig_to_yaml(yaml, rig, error);
    td_rig_free(&rig);
    free(text);
    free(path);
    return status;
}

td_status td_dataset_middlebury(td_dataset_layout *layout, const char *folder, td_error *error)
{
    char image[2][NAME_BYTES], name[TD_NAME_SIZE];
    td_text yaml = {0}, table = {0};
    *layout = (td_dataset_layout){0};
    find_pair(image, folder);
    td_status status =
        td_dataset_has_file(folder, "calib.txt") ? read_rig(&layout->rig, folder, error) : TD_OK;
    td_dataset_layout_name(name, folder);
    td_text_format(&yaml,
                   "name: \"%s\"\nabout: a pair in Middlebury's layout\nrig: rig.yaml\n"
                   "cameras: [{name: left, model: pinhole}, {name: right, model: pinhole}]\n",
                   name);
    td_text_format(&table, "frame,left,right\n%s,%s,%s\n", name, image[0], image[1]);
    layout->yaml = yaml.data;
    layout->table = table.data;
    if (status == TD_OK && (yaml.failed || table.failed))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for a dataset");
    if (status != TD_OK) td_dataset_layout_free(layout);
    return status;
}
