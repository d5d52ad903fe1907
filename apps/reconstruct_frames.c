/* What teledimos reconstruct knows of each frame before it looks at an image. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "core/csv.h"
#include "core/file.h"
#include "core/joint_table.h"
#include "core/rig_formats.h"

static const char *const pose_columns[7] = {"x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"};

static td_status find_rig(reconstruct_job *work, td_error *error)
{
    const char *path = work->how->rig ? work->how->rig : work->dataset->rig;
    const char *own = work->how->rig ? NULL : work->dataset->rig_text;
    if (!path)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dataset %s names no rig: give --rig RIG (teledimos calibrate makes one)",
                       work->dataset->name);
    if (own)
        TD_TRY(td_rig_parse(&work->rig, own, strlen(own), path, error));
    else
        TD_TRY(td_rig_import(&work->rig, &path, 1, NULL, error));
    if (work->rig->count < 2)
        return td_fail(error, TD_ERROR_DATA, "%s: a rig of one camera has no pair", path);
    return td_pair_init(&work->pair, work->rig, work->how->camera[0], work->how->camera[1], error);
}

static td_status find_robot(reconstruct_job *work, td_error *error)
{
    const td_dataset_arm *arm = work->dataset->arm;
    if (!arm || !arm->urdf) return TD_OK;
    TD_TRY(td_robot_read(&work->robot, arm->urdf, error));
    work->mount = *arm->mount ? td_robot_find_link(work->robot, arm->mount) : 0;
    if (work->mount < 0)
        return td_fail(error, TD_ERROR_DATA, "%s has no link %s (mount)", arm->urdf, arm->mount);
    for (int j = 0; j < work->robot->joint_count; j++) {
        const td_dataset_sigma *s =
            work->robot->joint[j].kind == TD_JOINT_PRISMATIC ? &arm->slide : &arm->angle;
        work->sigma_q[j] = s->all;
        for (int k = 0; k < s->count; k++)
            if (strcmp(s->joint[k], work->robot->joint[j].name) == 0) work->sigma_q[j] = s->sigma[k];
    }
    return TD_OK;
}

static int column_of_camera(const td_dataset *d, const char *name)
{
    for (int c = 0; c < d->camera_count; c++)
        if (strcmp(d->camera[c].name, name) == 0) return c;
    return -1;
}

static td_status find_images(reconstruct_job *work, td_error *error)
{
    const td_dataset *d = work->dataset;
    work->count = d->frame_count;
    work->frame = calloc(work->count + 1, sizeof *work->frame);
    if (!work->frame) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu frames", work->count);
    for (int side = 0; side < 2; side++) {
        const char *name = work->rig->camera[work->how->camera[side]].name;
        int c = column_of_camera(d, name);
        if (c < 0)
            return td_fail(error, TD_ERROR_DATA, "dataset %s has no images of the rig's camera %s", d->name,
                           name);
        for (size_t i = 0; i < work->count; i++) work->frame[i].image[side] = d->frame[i].image[c];
    }
    for (size_t i = 0; i < work->count; i++) {
        work->frame[i].name = d->frame[i].name;
        work->frame[i].time_s = d->frame[i].time_s;
        work->frame[i].epipolar_px = NAN;
    }
    return TD_OK;
}

/* The base's pose in a row. Without any of its numbers it is found later; with some of them the frame fails
 * alone, and is named. */
static void read_pose(reconstruct_frame *f, td_pose *pose, const td_csv *csv, size_t row, const int column[7])
{
    double v[7], norm = 0;
    td_error error = {0};
    int empty = 0;
    for (int k = 0; k < 7; k++) empty += !*td_csv_cell(csv, row, column[k]);
    f->place = empty == 7 ? PLACE_UNKNOWN : PLACE_GIVEN;
    if (empty == 7) return;
    for (int k = 0; k < 7; k++)
        if (td_csv_real(&v[k], csv, row, column[k], k < 3 ? -1e7 : -2, k < 3 ? 1e7 : 2, &error) != TD_OK) {
            f->failed = true;
            snprintf(f->reason, sizeof f->reason, "%s", error.message);
            return;
        }
    for (int k = 3; k < 7; k++) norm += v[k] * v[k];
    if (fabs(norm - 1) > 1e-3) {
        f->failed = true;
        snprintf(f->reason, sizeof f->reason,
                 "%s:%zu: qw, qx, qy, qz: not a unit quaternion (its length is %.4g)", csv->name,
                 csv->line[row + 1], sqrt(norm));
        return;
    }
    memcpy(pose->t, v, sizeof pose->t);
    for (int k = 0; k < 4; k++) pose->q[k] = v[3 + k] / sqrt(norm);
}

/* Frame of a map without poses of the base: that of the vehicle if the rig knows it, else the left camera's
 * with its axes as a vehicle has them, x forward, y left, z up. */
static td_pose rig_alone(const td_rig *rig)
{
    static const double turned[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, zero[3] = {0};
    return rig->has_vehicle ? rig->vehicle_from_rig : td_pose_from_rotation(turned, zero);
}

static void place_rig(reconstruct_job *work, reconstruct_frame *f, const td_pose *site_from_base)
{
    td_pose base_from_rig = rig_alone(work->rig);
    if (work->robot && work->rig->has_vehicle) {
        td_pose root_from_link[TD_ROBOT_MAX_LINKS];
        td_robot_forward(root_from_link, work->robot, f->q);
        base_from_rig = td_pose_compose(&root_from_link[work->mount], &work->rig->vehicle_from_rig);
    }
    f->vehicle_from_rig = base_from_rig;
    f->site_from_rig = td_pose_compose(site_from_base, &base_from_rig);
}

static td_status read_skew(reconstruct_job *work, const td_csv *csv, td_error *error)
{
    int column[2];
    for (int side = 0; side < 2; side++) {
        char name[TD_NAME_SIZE + 8];
        snprintf(name, sizeof name, "%s_time_s", work->rig->camera[work->how->camera[side]].name);
        column[side] = td_csv_column(csv, name);
    }
    work->has_skew = column[0] >= 0 && column[1] >= 0;
    if (!work->has_skew) return TD_OK;
    for (size_t i = 0; i < work->count; i++) {
        double t[2];
        for (int side = 0; side < 2; side++)
            TD_TRY(td_csv_real(&t[side], csv, i, column[side], -1e12, 1e12, error));
        work->frame[i].skew_s = t[1] - t[0];
    }
    return TD_OK;
}

static td_status read_table(reconstruct_job *work, const td_csv *csv, td_error *error)
{
    int column[7], found = 0;
    if (csv->rows != work->count)
        return td_fail(error, TD_ERROR_DATA, "%s has changed while it was read", csv->name);
    for (int k = 0; k < 7; k++) found += (column[k] = td_csv_column(csv, pose_columns[k])) >= 0;
    if (found && found < 7)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: a base pose needs the columns x_m, y_m, z_m, qw, qx, qy and qz", csv->name);
    const bool findable = work->dataset->site_tags.tag_count > 0 || (work->how->prior && work->how->start);
    if (!found && work->count > 1 && !findable)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s has %zu frames but no poses of the base (columns x_m, y_m, z_m, qw, qx, qy, qz): without "
            "them only one frame makes a map, unless tags stand on the site (site_tags in dataset.yaml) or a "
            "map "
            "of it and a first place are given (--prior, --start)",
            csv->name, work->count);
    work->has_poses = found || findable;
    if (work->robot) TD_TRY(td_joint_table_read(&work->q, NULL, csv, work->robot, NULL, error));
    TD_TRY(read_skew(work, csv, error));
    for (size_t i = 0; i < work->count; i++) {
        reconstruct_frame *f = &work->frame[i];
        td_pose base = td_pose_identity();
        if (work->robot) f->q = work->q + i * (size_t)work->robot->joint_count;
        if (found) read_pose(f, &base, csv, i, column);
        if (!found && findable) f->place = PLACE_UNKNOWN;
        place_rig(work, f, &base);
    }
    return TD_OK;
}

static void hash_tags(td_hash *hash, const td_dataset *d)
{
    const double sigma[2] = {d->site_tags_sigma_rad, d->site_tags_sigma_m};
    td_hash_add(hash, sigma, sizeof sigma);
    for (int i = 0; i < d->site_tags.tag_count; i++) {
        const td_target_tag *t = &d->site_tags.tag[i];
        const double number[2] = {t->id, t->size_m};
        td_hash_add(hash, number, sizeof number);
        td_hash_add(hash, t->target_from_tag.q, sizeof t->target_from_tag.q);
        td_hash_add(hash, t->target_from_tag.t, sizeof t->target_from_tag.t);
    }
}

/* What the map depends on besides the images: rig, table, robot, options. */
static td_status make_key(reconstruct_job *work, const td_csv *csv, td_error *error)
{
    td_hash *hash = NULL;
    char *rig = NULL, options[400], sha[TD_HASH_HEX_SIZE];
    const reconstruct_how *h = work->how;
    TD_TRY(td_rig_to_yaml(&rig, work->rig, error));
    td_status status = td_hash_new(&hash, error);
    if (status == TD_OK) {
        td_hash_add(hash, rig, strlen(rig));
        for (size_t k = 0; k < (csv->rows + 1) * csv->columns; k++)
            td_hash_add(hash, csv->cell[k], strlen(csv->cell[k]) + 1);
        snprintf(options, sizeof options,
                 "%s %d %d %.17g %.17g %d %d %d %d %d %.17g %.17g %.17g %.17g %.17g %.17g %d %.17g",
                 TD_VERSION, h->camera[0], h->camera[1], h->near_m, h->far_m, (int)h->dense.method,
                 h->dense.lowest, h->dense.levels, h->dense.speckle, h->gate_every, h->fusion.cell_m,
                 h->fusion.region[0], h->fusion.region[1], h->fusion.region[2], h->fusion.region[3],
                 h->fusion.gate_sigma, h->fusion.believe_frames, h->fusion.correlation_px);
        td_hash_add(hash, options, strlen(options) + 1);
        if (h->start) td_hash_add(hash, h->start, 4 * sizeof *h->start);
        hash_tags(hash, work->dataset);
        if (work->robot && td_hash_file(sha, work->dataset->arm->urdf, NULL) == TD_OK)
            td_hash_add(hash, sha, sizeof sha);
        if (h->prior && td_hash_file(sha, h->prior, NULL) == TD_OK) td_hash_add(hash, sha, sizeof sha);
        status = td_hash_finish(work->key, &hash, error);
    }
    free(rig);
    return status;
}

td_status reconstruct_frames(reconstruct_job *work, td_error *error)
{
    td_csv *csv = NULL;
    TD_TRY(find_rig(work, error));
    TD_TRY(find_robot(work, error));
    TD_TRY(find_images(work, error));
    const td_dataset *d = work->dataset;
    td_status status = d->table_text
                           ? td_csv_parse(&csv, d->table_text, strlen(d->table_text), d->table, error)
                           : td_csv_read(&csv, d->table, error);
    if (status == TD_OK) status = read_table(work, csv, error);
    if (status == TD_OK) status = make_key(work, csv, error);
    td_csv_free(&csv);
    return status;
}
