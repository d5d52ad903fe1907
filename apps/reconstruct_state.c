/* How far a reconstruction has come, so that it goes on after a kill: DIR/state/progress.yaml names the map's
 * file and the frames in it. The map is written to the file that the present progress does not name, then the
 * progress: at any moment one whole state is there. DIR/state/lock is locked as long as a process works on
 * DIR, for two would mix their maps. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
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
    json_t *o = json_pack(
        "{s:s, s:s, s:b, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:o}", "name",
        f->name, "sha256", f->sha256, "failed", f->failed, "reason", f->reason, "matched",
        td_json_real(f->matched), "masked", td_json_real(f->masked), "epipolar_px",
        td_json_real(f->epipolar_px), "seconds", td_json_real(f->seconds), "time_s", td_json_real(f->time_s),
        "skew_s", td_json_real(f->skew_s), "points", (json_int_t)t->points, "cells", (json_int_t)t->cells,
        "new_cells", (json_int_t)t->new_cells, "gated", (json_int_t)t->gated, "reset", (json_int_t)t->reset,
        "cleared", (json_int_t)t->cleared, "believed", (json_int_t)t->believed, "square_m2",
        td_json_real(t->square_m2));
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

static const char *const map_names[2] = {"map-0.bin", "map-1.bin"};

td_status reconstruct_state_save(reconstruct_job *work, size_t frames, td_error *error)
{
    const int other = 1 - work->saved_as;
    char *map = state_path(work, map_names[other]);
    td_status status = map ? reconstruct_photo_save(work, other, frames, error)
                           : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = td_fusion_save(work->fusion, map, error);
    if (status == TD_OK) status = write_progress(work, frames, map_names[other], error);
    if (status == TD_OK) work->saved_as = other;
    free(map);
    return status;
}

/* What a killed run was writing. */
static void sweep(const char *folder)
{
    DIR *list = opendir(folder);
    const struct dirent *entry;
    while (list && (entry = readdir(list))) {
        if (strncmp(entry->d_name, ".teledimos-", 11) != 0) continue;
        char *path = td_path_join(folder, entry->d_name);
        if (path) unlink(path);
        free(path);
    }
    if (list) closedir(list);
}

td_status reconstruct_state_lock(reconstruct_job *work, td_error *error)
{
    enum { TRIES = 30 }; /* 3 s: ranks of a run that was killed may take a moment to end */
    const struct timespec moment = {0, 100000000};
    char *folder = state_path(work, "."), *path = state_path(work, "lock");
    td_status status =
        folder && path ? td_folder_make(folder, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    struct flock lock = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
    if (status == TD_OK) {
        work->lock = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
        if (work->lock < 0)
            status = td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s", path, strerror(errno));
    }
    for (int i = 0; status == TD_OK && fcntl(work->lock, F_SETLK, &lock) != 0; i++) {
        if (errno != EACCES && errno != EAGAIN) break; /* a file system without locks */
        if (i == TRIES)
            status = td_fail(error, TD_ERROR_IO,
                             "%s: another run works on this folder: wait for it, or give another -o",
                             work->how->output);
        else
            nanosleep(&moment, NULL);
    }
    if (status == TD_OK) sweep(folder);
    if (status == TD_OK) sweep(work->how->output);
    free(folder);
    free(path);
    return status;
}

static td_status read_frame(reconstruct_frame *f, const td_field *at, td_error *error)
{
    const char *name, *sha, *reason;
    double counts[8];
    static const char *const keys[8] = {"points", "cells",   "new_cells", "gated",
                                        "reset",  "cleared", "believed",  "square_m2"};
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
    for (int k = 0; k < 8; k++) {
        field = td_field_get(at, keys[k]);
        TD_TRY(td_field_real(&counts[k], &field, 0, 1e15, error));
    }
    f->tally = (td_fusion_tally){(size_t)counts[0], (size_t)counts[1], (size_t)counts[2], (size_t)counts[3],
                                 (size_t)counts[4], (size_t)counts[5], (size_t)counts[6], counts[7]};
    double *const value[6] = {&f->matched, &f->masked, &f->epipolar_px, &f->seconds, &f->time_s, &f->skew_s};
    static const char *const names[6] = {"matched", "masked", "epipolar_px", "seconds", "time_s", "skew_s"};
    for (int k = 0; k < 6; k++) {
        field = td_field_get(at, names[k]);
        *value[k] = NAN;
        if (field.value && !json_is_null(field.value))
            TD_TRY(td_field_real(value[k], &field, k < 4 ? 0 : -1e12, 1e12, error));
    }
    TD_TRY(read_place(f, at, error));
    f->done = true;
    return TD_OK;
}

/* The images of the frames that were done must still be the same: one that was damaged may be whole now. */
static bool same_images(reconstruct_job *work, const reconstruct_frame *f)
{
    char sha[TD_HASH_HEX_SIZE];
    if (!*f->sha256) return f->failed;
    return reconstruct_frame_hash(sha, work, f, NULL) == TD_OK && strcmp(sha, f->sha256) == 0;
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
    work->saved_as = strcmp(name, map_names[1]) == 0;
    if (strcmp(name, map_names[work->saved_as]) != 0)
        return td_field_fail(&map, error, "no name of a map's file");
    TD_TRY(td_field_count(&count, &frames, 0, work->count, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field at = td_field_at(&frames, i, index);
        TD_TRY(read_frame(&work->frame[i], &at, error));
        if (!same_images(work, &work->frame[i])) return td_field_fail(&at, error, "its images have changed");
    }
    char *file = state_path(work, name);
    td_status status = file ? td_fusion_load(&work->fusion, &work->how->fusion, file, error)
                            : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(file);
    if (status == TD_OK) status = reconstruct_photo_load(work, work->saved_as, count, error);
    if (status == TD_OK) work->resumed = count;
    return status;
}

td_status reconstruct_state_load(reconstruct_job *work, td_error *error)
{
    const size_t size = work->count * sizeof *work->frame;
    char *path = state_path(work, "progress.yaml");
    reconstruct_frame *before = malloc(size + 1);
    json_t *root = NULL;
    td_error why = {0};
    td_status status = path && before ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK && access(path, F_OK) == 0) {
        memcpy(before, work->frame, size);
        td_status read = td_document_read(&root, path, &why);
        if (read == TD_OK) read = read_progress(work, root, path, &why);
        if (read != TD_OK) {
            td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct", "beginning anew: %s", why.message);
            td_fusion_free(&work->fusion);
            td_mosaic_free(&work->mosaic);
            work->resumed = 0;
            memcpy(work->frame, before, size);
        }
    }
    json_decref(root);
    free(before);
    free(path);
    return status;
}
