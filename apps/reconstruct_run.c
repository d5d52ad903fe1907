/* Every frame into the map: gate, rectify, match, leave the machine itself out, fuse. A frame that fails is
 * named, the rest goes on. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "recon/own_body.h"

static td_status read_images(td_image *image[2], reconstruct_job *work, reconstruct_frame *f, td_error *error)
{
    char sha[2][TD_HASH_HEX_SIZE];
    for (int side = 0; side < 2; side++) {
        const td_rig_camera *c = &work->rig->camera[work->how->camera[side]];
        if (!f->image[side]) return td_fail(error, TD_ERROR_DATA, "it has no image of camera %s", c->name);
        TD_TRY(td_hash_file(sha[side], f->image[side], error));
        TD_TRY(td_image_read(&image[side], f->image[side], 1, error));
        if (image[side]->width != c->camera.width || image[side]->height != c->camera.height)
            return td_fail(error, TD_ERROR_DATA, "%s is of %d x %d px, camera %s of the rig of %d x %d",
                           f->image[side], image[side]->width, image[side]->height, c->name, c->camera.width,
                           c->camera.height);
    }
    return td_hash_bytes(f->sha256, sha, sizeof sha, error);
}

/* Whether the images belong to the rig, by a few hundred matches in a wide band. */
static void look_at_epipolar(reconstruct_job *work, reconstruct_frame *f, td_image *const image[2])
{
    td_match_options o = td_match_options_default();
    td_match *match = NULL;
    td_epipolar_gate gate;
    size_t count = 0;
    o.interest.count = 500;
    o.band_px = 6;
    o.most_sigma_px = 0;
    o.near_m = work->how->near_m;
    o.far_m = work->how->far_m;
    o.threads = work->how->dense.threads;
    if (td_match_automatic(&match, &count, NULL, &work->pair, image[0], image[1], &o, NULL) == TD_OK &&
        count >= 30 && td_epipolar_gate_check(&gate, &work->pair, match, count, NULL) == TD_OK)
        f->epipolar_px = gate.rms_px;
    free(match);
}

/* Pixels that see the machine itself say nothing of the ground. */
static td_status mask_own_body(td_disparity *d, reconstruct_job *work, reconstruct_frame *f, td_error *error)
{
    const td_rectification *r = td_depth_camera_rectification(work->depth);
    size_t pixels = (size_t)d->width * (size_t)d->height, masked = 0;
    if (!work->robot) return TD_OK;
    uint8_t *mask = calloc(pixels + 1, 1);
    if (!mask) return td_fail(error, TD_ERROR_MEMORY, "no memory for a mask");
    td_pose left_from_rig = work->rig->camera[work->pair.left].camera_from_rig;
    td_pose rectified_from_rig = td_pose_compose(&r->rectified_from[0], &left_from_rig);
    td_pose rig_from_vehicle = td_pose_inverse(&f->vehicle_from_rig);
    td_pose camera_from_vehicle = td_pose_compose(&rectified_from_rig, &rig_from_vehicle);
    td_own_body_options o = td_own_body_options_default();
    o.sigma_q = work->sigma_q;
    o.mount = work->mount;
    td_status status = td_own_body_mask(mask, &r->camera, &camera_from_vehicle, work->robot, f->q, &o, error);
    for (size_t i = 0; i < pixels && status == TD_OK; i++) {
        if (!mask[i]) continue;
        masked++;
        d->value[i] = d->sigma[i] = NAN;
        d->kind[i] = TD_DENSE_NONE;
    }
    f->masked = (double)masked / (double)pixels;
    free(mask);
    return status;
}

static void keep_matched(td_disparity *d, reconstruct_frame *f)
{
    size_t pixels = (size_t)d->width * (size_t)d->height, matched = 0;
    for (size_t i = 0; i < pixels; i++) {
        matched += d->kind[i] == TD_DENSE_MATCHED;
        if (d->kind[i] != TD_DENSE_MATCHED) d->value[i] = d->sigma[i] = NAN;
    }
    f->matched = (double)matched / (double)pixels;
}

static void show(reconstruct_job *work, td_image **left, td_disparity **disparity)
{
    td_image_free(&work->shown_left);
    td_disparity_free(&work->shown);
    work->shown_left = *left;
    work->shown = *disparity;
    *left = NULL;
    *disparity = NULL;
}

static td_status take(reconstruct_job *work, reconstruct_frame *f, td_image *const raw[2], td_error *error)
{
    const size_t index = (size_t)(f - work->frame);
    td_image *left = NULL, *right = NULL;
    td_disparity *disparity = NULL;
    td_status status =
        td_depth_camera_rectify(&left, &right, work->depth, raw[0], raw[1], work->how->dense.threads, error);
    if (status == TD_OK) status = td_dense_match(&disparity, left, right, &work->how->dense, error);
    if (status == TD_OK) {
        keep_matched(disparity, f);
        status = mask_own_body(disparity, work, f, error);
    }
    if (status == TD_OK) status = reconstruct_localise(work, index, disparity, raw, error);
    if (status == TD_OK) {
        const bool found = f->place != PLACE_GIVEN;
        const td_fusion_frame frame = {.camera = work->depth,
                                       .disparity = disparity,
                                       .site_from_rig = f->site_from_rig,
                                       .pose_covariance = found ? f->pose_covariance : NULL,
                                       .time_s = f->time_s};
        status = td_fusion_add(work->fusion, &frame, &f->tally, error);
    }
    if (status == TD_OK) show(work, &left, &disparity);
    td_image_free(&left);
    td_image_free(&right);
    td_disparity_free(&disparity);
    return status;
}

static td_status do_frame(reconstruct_job *work, size_t index, td_error *error)
{
    reconstruct_frame *f = &work->frame[index];
    td_image *raw[2] = {NULL, NULL};
    double began = terminal_now_s();
    td_error why = {0};
    td_status status = f->failed ? TD_ERROR_DATA : read_images(raw, work, f, &why);
    if (status == TD_OK && work->how->gate_every && index % (size_t)work->how->gate_every == 0)
        look_at_epipolar(work, f, raw);
    if (status == TD_OK) status = take(work, f, raw, &why);
    td_image_free(&raw[0]);
    td_image_free(&raw[1]);
    f->seconds = terminal_now_s() - began;
    f->done = true;
    if (status == TD_OK) return TD_OK;
    if (status == TD_ERROR_MEMORY || status == TD_ERROR_CANCELLED) return *error = why, status;
    f->failed = true;
    if (!f->reason[0]) snprintf(f->reason, sizeof f->reason, "%s", why.message);
    td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct", "frame %s is left out: %s", f->name,
                 f->reason);
    return TD_OK;
}

static td_status prepare(reconstruct_job *work, td_error *error)
{
    reconstruct_how *h = work->how;
    TD_TRY(
        td_depth_camera_new(&work->depth, work->rig, h->camera[0], h->camera[1], h->near_m, h->far_m, error));
    if (h->dense.levels <= 0) td_depth_camera_range(&h->dense.lowest, &h->dense.levels, work->depth);
    TD_TRY(td_dense_options_check(&h->dense, error));
    TD_TRY(reconstruct_state_load(work, error));
    if (work->fusion) return TD_OK;
    TD_TRY(td_fusion_new(&work->fusion, &h->fusion, error));
    if (!h->prior) return TD_OK;
    td_elevation *prior = NULL;
    TD_TRY(td_elevation_read(&prior, h->prior, error));
    td_status status = td_fusion_prior(work->fusion, prior, h->prior_sigma_m, error);
    td_elevation_free(&prior);
    return status;
}

td_status reconstruct_run(reconstruct_job *work, td_error *error)
{
    double began = terminal_now_s(), saved = began;
    TD_TRY(prepare(work, error));
    for (size_t i = work->resumed; i < work->count; i++) {
        if (!td_progress_report(work->how->progress, "reconstructing", i, work->count)) {
            if (i > work->resumed) TD_TRY(reconstruct_state_save(work, i, error));
            return td_fail(error, TD_ERROR_CANCELLED,
                           "interrupted after %zu of %zu frames: run again to go on", i, work->count);
        }
        TD_TRY(do_frame(work, i, error));
        if (terminal_now_s() - saved < 5 && i + 1 < work->count) continue;
        TD_TRY(reconstruct_state_save(work, i + 1, error));
        saved = terminal_now_s();
    }
    work->rms_epipolar_px = NAN;
    for (size_t i = 0; i < work->count; i++)
        if (isfinite(work->frame[i].epipolar_px))
            work->rms_epipolar_px =
                fmax(work->frame[i].epipolar_px, isfinite(work->rms_epipolar_px) ? work->rms_epipolar_px : 0);
    TD_TRY(td_fusion_map(&work->map, NULL, work->fusion, error));
    work->seconds = terminal_now_s() - began;
    return TD_OK;
}

void reconstruct_free(reconstruct_job *work)
{
    td_fusion_free(&work->fusion);
    td_depth_camera_free(&work->depth);
    td_rig_free(&work->rig);
    td_robot_free(&work->robot);
    td_elevation_free(&work->map);
    td_image_free(&work->shown_left);
    td_disparity_free(&work->shown);
    free(work->q);
    free(work->frame);
}
