/* How far a reconstruction has come, so that it goes on after a kill: DIR/state/progress.yaml names the map's
 * file and the frames in it. The map is written first under a new name, then the progress, then the map
 * before is taken away: at any moment one whole state is there. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/reconstruct_internal.h"
#include "core/document.h"
#include "core/file.h"

static char *state_path(const reconstruct_job *work, const char *name)
{
    char *folder = td_path_join(work->how->output, "state"),
         *path = folder ? td_path_join(folder, name) : NULL;
    free(folder);
    return path;
}

static json_t *frame_json(const reconstruct_frame *f)
{
    const td_fusion_tally *t = &f->tally;
    json_t *o = json_pack("{s:s, s:s, s:b, s:s, s:o, s:o, s:o, s:o, s:I, s:I, s:I, s:I, s:I, s:I}", "name",
                          f->name, "sha256", f->sha256, "failed", f->failed, "reason", f->reason, "matched",
                          td_json_real(f->matched), "masked", td_json_real(f->masked), "epipolar_px",
                          td_json_real(f->epipolar_px), "seconds", td_json_real(f->seconds), "points",
                          (json_int_t)t->points, "cells", (json_int_t)t->cells, "new_cells",
                          (json_int_t)t->new_cells, "gated", (json_int_t)t->gated, "reset",
                          (json_int_t)t->reset, "cleared", (json_int_t)t->cleared);
    if ((f->place == PLACE_TAGS || f->place == PLACE_MAP) && !f->failed) {
        json_object_set_new(o, "place", json_string(reconstruct_place_name[f->place]));
        json_object_set_new(o, "q", td_json_reals(f->site_from_rig.q, 4));
        json_object_set_new(o, "t_m", td_json_reals(f->site_from_rig.t, 3));
        json_object_set_new(o, "pose_sigma", td_json_reals(f->pose_sigma, 6));
    }
    return o;
}

/* Where a frame was found: the next one begins there. */
static td_status read_place(reconstruct_frame *f, const td_field *at, td_error *error)
{
    static const char *const names[] = {"tags", "map", NULL};
    const td_field place = td_field_get(at, "place"), q = td_field_get(at, "q"), t = td_field_get(at, "t_m");
    const td_field sigma = td_field_get(at, "pose_sigma");
    int choice;
    if (!place.value) return TD_OK;
    TD_TRY(td_field_choice(&choice, &place, names, "tags or map", error));
    TD_TRY(td_field_reals(f->site_from_rig.q, 4, &q, -2, 2, error));
    TD_TRY(td_field_reals(f->site_from_rig.t, 3, &t, -1e8, 1e8, error));
    TD_TRY(td_field_reals(f->pose_sigma, 6, &sigma, 0, 1e8, error));
    f->place = choice == 0 ? PLACE_TAGS : PLACE_MAP;
    return TD_OK;
}

static td_status write_progress(const reconstruct_job *work, size_t frames, const char *map, td_error *error)
{
    json_t *root = json_object(), *list = json_array();
    char *text = NULL, *path = state_path(work, "progress.yaml");
    json_object_set_new(root, "teledimos", json_string("reconstruction 1"));
    json_object_set_new(root, "key", json_string(work->key));
    json_object_set_new(root, "map", json_string(map));
    for (size_t i = 0; i < frames; i++) json_array_append_new(list, frame_json(&work->frame[i]));
    json_object_set_new(root, "frames", list);
    td_status status =
        path ? td_document_to_yaml(&text, root, 0, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = td_file_write(path, text, strlen(text), error);
    json_decref(root);
    free(text);
    free(path);
    return status;
}

td_status reconstruct_state_save(const reconstruct_job *work, size_t frames, td_error *error)
{
    char name[2][32];
    for (size_t k = 0; k < 2; k++) snprintf(name[k], sizeof name[k], "map-%zu.bin", (frames + k) % 2);
    char *folder = td_path_join(work->how->output, "state"), *map = state_path(work, name[0]);
    td_status status =
        folder && map ? td_folder_make(folder, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = td_fusion_save(work->fusion, map, error);
    if (status == TD_OK) status = write_progress(work, frames, name[0], error);
    free(folder);
    free(map);
    return status;
}

static td_status read_frame(reconstruct_frame *f, const td_field *at, td_error *error)
{
    const char *name, *sha, *reason;
    double counts[6];
    static const char *const keys[6] = {"points", "cells", "new_cells", "gated", "reset", "cleared"};
    td_field field = td_field_get(at, "name");
    TD_TRY(td_field_string(&name, &field, error));
    if (strcmp(name, f->name) != 0) return td_field_fail(&field, error, "another frame");
    field = td_field_get(at, "sha256");
    TD_TRY(td_field_string(&sha, &field, error));
    field = td_field_get(at, "reason");
    TD_TRY(td_field_string(&reason, &field, error));
    field = td_field_get(at, "failed");
    TD_TRY(td_field_bool(&f->failed, &field, error));
    snprintf(f->sha256, sizeof f->sha256, "%s", sha);
    snprintf(f->reason, sizeof f->reason, "%s", reason);
    for (int k = 0; k < 6; k++) {
        field = td_field_get(at, keys[k]);
        TD_TRY(td_field_real(&counts[k], &field, 0, 1e15, error));
    }
    f->tally = (td_fusion_tally){(size_t)counts[0], (size_t)counts[1], (size_t)counts[2],
                                 (size_t)counts[3], (size_t)counts[4], (size_t)counts[5]};
    double *const value[4] = {&f->matched, &f->masked, &f->epipolar_px, &f->seconds};
    static const char *const names[4] = {"matched", "masked", "epipolar_px", "seconds"};
    for (int k = 0; k < 4; k++) {
        field = td_field_get(at, names[k]);
        *value[k] = NAN;
        if (field.value && !json_is_null(field.value)) TD_TRY(td_field_real(value[k], &field, 0, 1e9, error));
    }
    TD_TRY(read_place(f, at, error));
    f->done = true;
    return TD_OK;
}

/* The images of the frames that were done must still be the same. */
static bool same_images(const reconstruct_frame *f)
{
    char sha[2][TD_HASH_HEX_SIZE], both[TD_HASH_HEX_SIZE];
    if (!*f->sha256) return f->failed;
    for (int side = 0; side < 2; side++)
        if (!f->image[side] || td_hash_file(sha[side], f->image[side], NULL) != TD_OK) return false;
    return td_hash_bytes(both, sha, sizeof sha, NULL) == TD_OK && strcmp(both, f->sha256) == 0;
}

static td_status read_progress(reconstruct_job *work, const json_t *document, const char *path,
                               td_error *error)
{
    const td_field root = {NULL, path, document};
    td_field key = td_field_get(&root, "key"), map = td_field_get(&root, "map"),
             frames = td_field_get(&root, "frames");
    const char *text, *name;
    size_t count;
    TD_TRY(td_field_string(&text, &key, error));
    if (strcmp(text, work->key) != 0)
        return td_field_fail(&key, error, "of another rig, table or other options");
    TD_TRY(td_field_string(&name, &map, error));
    if (strchr(name, '/')) return td_field_fail(&map, error, "no name of a file");
    TD_TRY(td_field_count(&count, &frames, 0, work->count, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field at = td_field_at(&frames, i, index);
        TD_TRY(read_frame(&work->frame[i], &at, error));
        if (!same_images(&work->frame[i])) return td_field_fail(&at, error, "its images have changed");
    }
    char *file = state_path(work, name);
    td_status status = file ? td_fusion_load(&work->fusion, &work->how->fusion, file, error)
                            : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(file);
    if (status == TD_OK) work->resumed = count;
    return status;
}

static void forget(reconstruct_job *work)
{
    for (size_t i = 0; i < work->count; i++) {
        reconstruct_frame *f = &work->frame[i];
        if (!f->done) continue;
        f->done = f->failed = false;
        f->reason[0] = f->sha256[0] = 0;
        f->matched = f->masked = f->seconds = 0;
        f->epipolar_px = NAN;
        f->tally = (td_fusion_tally){0};
        if (f->place != PLACE_GIVEN) f->place = PLACE_UNKNOWN;
    }
}

td_status reconstruct_state_load(reconstruct_job *work, td_error *error)
{
    char *path = state_path(work, "progress.yaml");
    json_t *root = NULL;
    td_error why = {0};
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (access(path, F_OK) == 0) {
        td_status status = td_document_read(&root, path, &why);
        if (status == TD_OK) status = read_progress(work, root, path, &why);
        if (status != TD_OK) {
            td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct", "beginning anew: %s", why.message);
            td_fusion_free(&work->fusion);
            work->resumed = 0;
            forget(work);
        }
    }
    json_decref(root);
    free(path);
    return TD_OK;
}
