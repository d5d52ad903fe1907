/* Any bytes as a rig of another tool, in each format: no crash; what is refused is refused in a sentence with
 * the file's name; and what is read can be written in every format that holds it, and comes back the same. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/rig_formats.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_same(const td_rig *a, const td_rig *b)
{
    if (a->count != b->count) abort();
    for (int i = 0; i < a->count; i++) {
        const td_camera *x = &a->camera[i].camera, *y = &b->camera[i].camera;
        for (int k = 0; k < TD_CAMERA_MAX_PARAMETERS; k++)
            if (x->parameter[k] != y->parameter[k]) abort();
        const td_pose inverse = td_pose_inverse(&b->camera[i].camera_from_rig);
        const td_pose apart = td_pose_compose(&a->camera[i].camera_from_rig, &inverse);
        if (!(td_pose_angle(&apart) < 1e-9)) abort();
        if (!(td_pose_distance(&apart) <= 1e-9 * (1 + td_pose_distance(&a->camera[i].camera_from_rig))))
            abort();
    }
}

/* What a format holds for certain: no fits, which take long and have tests of their own. */
static bool is_held(const td_rig *rig, td_rig_format format)
{
    const bool radial = format == TD_RIG_KALIBR || format == TD_RIG_VISP;
    for (int i = 0; i < rig->count; i++) {
        const td_camera_model model = rig->camera[i].camera.model;
        if (radial && model != TD_CAMERA_PINHOLE && model != TD_CAMERA_FISHEYE) return false;
        if (format == TD_RIG_MRCAL && model == TD_CAMERA_FISHEYE) return false;
    }
    return rig->count == 1 || format == TD_RIG_TELEDIMOS || format == TD_RIG_OPENCV ||
           format == TD_RIG_KALIBR;
}

static void write_and_read(const td_rig *rig)
{
    for (int f = 0; f < TD_RIG_FORMAT_COUNT; f++) {
        td_error error = {0};
        td_rig *back = NULL;
        char *text = NULL;
        if (!is_held(rig, (td_rig_format)f)) continue;
        if (td_rig_export_text(&text, rig, 0, (td_rig_format)f, false, NULL, &error) != TD_OK) abort();
        const td_rig_text file = {"written", text, strlen(text)};
        const td_rig_import_options options = {.format = (td_rig_format)f};
        if (td_rig_import_text(&back, &file, 1, &options, &error) != TD_OK) abort();
        check_same(rig, back);
        td_rig_free(&back);
        free(text);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    char *text = malloc(size + 1);
    if (!text) return 0;
    if (size) memcpy(text, data, size);
    text[size] = 0;
    for (int f = TD_RIG_OPENCV; f <= TD_RIG_FORMAT_COUNT; f++) {
        td_error error = {0};
        td_rig *rig = NULL;
        const td_rig_text file = {"fuzz", text, size};
        const td_rig_import_options options = {.format = (td_rig_format)f, .width = 640, .height = 480};
        if (td_rig_import_text(&rig, &file, 1, &options, &error) == TD_OK)
            write_and_read(rig);
        else if (rig || strncmp(error.message, "fuzz", 4) != 0 || strchr(error.message, '\n'))
            abort();
        td_rig_free(&rig);
    }
    free(text);
    return 0;
}
