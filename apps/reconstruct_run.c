/* Every frame into the map, in their order. A frame that fails is named, the rest goes on. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/reconstruct_internal.h"
#include "apps/reconstruct_team.h"
#include "core/file.h"

/* The state is saved so often that this takes at most this share of the time. */
static const double SAVING_SHARE = 0.05;

static void show(reconstruct_job *work, reconstruct_frame *f, reconstruct_view *view)
{
    td_image_free(&work->shown_left);
    td_disparity_free(&work->shown);
    work->shown_frame = f;
    work->shown_left = view->left;
    work->shown = view->disparity;
    *view = (reconstruct_view){0};
}

static td_status fuse(reconstruct_job *work, reconstruct_frame *f, const reconstruct_view *view,
                      td_error *error)
{
    double began = terminal_now_s();
    td_error why = {0};
    td_status status = reconstruct_localise(work, (size_t)(f - work->frame), view->disparity, &why);
    const td_fusion_frame frame = {.camera = work->depth,
                                   .disparity = view->disparity,
                                   .site_from_rig = f->site_from_rig,
                                   .pose_covariance = f->place == PLACE_GIVEN ? NULL : f->pose_covariance,
                                   .time_s = f->time_s};
    if (status == TD_OK) status = td_fusion_add(work->fusion, &frame, &f->tally, &why);
    if (status == TD_OK) status = reconstruct_photo_add(work, f, &frame, &why);
    f->seconds += terminal_now_s() - began;
    if (status == TD_OK) return TD_OK;
    if (status == TD_ERROR_MEMORY || status == TD_ERROR_IO) return *error = why, status;
    f->failed = true;
    snprintf(f->reason, sizeof f->reason, "%s", why.message);
    return TD_OK;
}

static td_status do_frame(reconstruct_job *work, size_t index, td_error *error)
{
    reconstruct_frame *f = &work->frame[index];
    reconstruct_view view = {0};
    td_status status = team_measure(&view, work, index, error);
    if (status == TD_OK && !f->failed) status = fuse(work, f, &view, error);
    if (status == TD_OK && !f->failed) show(work, f, &view);
    reconstruct_view_free(&view);
    TD_TRY(status);
    f->done = true;
    if (f->failed)
        td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct", "frame %s is left out: %s", f->name,
                     f->reason);
    return TD_OK;
}

td_status reconstruct_prepare(reconstruct_job *work, td_error *error)
{
    reconstruct_how *h = work->how;
    TD_TRY(
        td_depth_camera_new(&work->depth, work->rig, h->camera[0], h->camera[1], h->near_m, h->far_m, error));
    if (h->dense.levels <= 0) td_depth_camera_range(&h->dense.lowest, &h->dense.levels, work->depth);
    return td_dense_options_check(&h->dense, error);
}

td_status reconstruct_begin(reconstruct_job *work, td_error *error)
{
    reconstruct_how *h = work->how;
    TD_TRY(td_folder_make(h->output, error));
    TD_TRY(reconstruct_state_lock(work, error));
    TD_TRY(reconstruct_state_load(work, error));
    reconstruct_memory_foresee(work);
    if (work->fusion) return TD_OK;
    TD_TRY(td_fusion_new(&work->fusion, &h->fusion, error));
    TD_TRY(reconstruct_photo_begin(work, error));
    if (!h->prior) return TD_OK;
    td_elevation *prior = NULL;
    TD_TRY(td_elevation_read(&prior, h->prior, error));
    /* A foreign map names no frame: its coordinates are the site's. */
    if (prior->crs && strcmp(prior->frame, "world") == 0) strcpy(prior->frame, h->fusion.frame);
    td_status status = reconstruct_crs(work, prior->crs, error);
    if (status == TD_OK) status = td_fusion_prior(work->fusion, prior, h->prior_sigma_m, error);
    td_elevation_free(&prior);
    return status;
}

static td_status interrupted(reconstruct_job *work, size_t done, bool save, td_error *error)
{
    if (save) TD_TRY(reconstruct_state_save(work, done, error));
    return td_fail(error, TD_ERROR_CANCELLED, "interrupted after %zu of %zu frames: run again to go on", done,
                   work->count);
}

static td_status all_frames(reconstruct_job *work, td_error *error)
{
    double saved = terminal_now_s(), saving = 0;
    size_t kept = work->resumed;
    for (size_t i = work->resumed; i < work->count; i++) {
        const bool go_on = td_progress_report(work->how->progress, "reconstructing", i, work->count);
        td_status status = go_on ? do_frame(work, i, error) : TD_ERROR_CANCELLED;
        if (status == TD_ERROR_CANCELLED) return interrupted(work, i, i > kept, error);
        TD_TRY(status);
        const double now = terminal_now_s();
        if (now - saved < saving / SAVING_SHARE && i + 1 < work->count) continue;
        TD_TRY(reconstruct_state_save(work, i + 1, error));
        kept = i + 1;
        saved = terminal_now_s();
        saving = saved - now;
    }
    return TD_OK;
}

td_status reconstruct_run(reconstruct_job *work, td_error *error)
{
    double began = terminal_now_s();
    td_status status = all_frames(work, error);
    team_dismiss();
    TD_TRY(status);
    work->rms_epipolar_px = NAN;
    for (size_t i = 0; i < work->count; i++)
        if (isfinite(work->frame[i].epipolar_px))
            work->rms_epipolar_px =
                fmax(work->frame[i].epipolar_px, isfinite(work->rms_epipolar_px) ? work->rms_epipolar_px : 0);
    reconstruct_skew(work);
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
    td_mosaic_free(&work->mosaic);
    td_orthophoto_free(&work->photo);
    td_image_free(&work->shown_left);
    td_disparity_free(&work->shown);
    for (int side = 0; side < 2; side++) reconstruct_video_free(&work->video[side]);
    reconstruct_video_free(&work->coloured);
    if (work->lock > 0) close(work->lock);
    free(work->q);
    free(work->frame);
}
