/* A frame's images into disparities: read, looked at for the gate, rectified, matched, the machine itself
 * left out. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/look_pair.h"
#include "apps/reconstruct_internal.h"

static td_status read_images(td_image *image[2], reconstruct_job *work, reconstruct_frame *f, td_error *error)
{
    double time_s[2] = {NAN, NAN};
    TD_TRY(reconstruct_frame_hash(f->sha256, work, f, error));
    for (int side = 0; side < 2; side++) {
        const td_rig_camera *c = &work->rig->camera[work->how->camera[side]];
        if (!f->image[side]) return td_fail(error, TD_ERROR_DATA, "it has no image of camera %s", c->name);
        TD_TRY(reconstruct_image_read(&image[side], &time_s[side], &work->video[side], f->image[side], 1,
                                      error));
        if (image[side]->width != c->camera.width || image[side]->height != c->camera.height)
            return td_fail(error, TD_ERROR_DATA, "%s is of %d x %d px, camera %s of the rig of %d x %d",
                           f->image[side], image[side]->width, image[side]->height, c->name, c->camera.width,
                           c->camera.height);
    }
    if (!isfinite(f->time_s)) f->time_s = time_s[0];
    if (!work->has_skew && isfinite(time_s[0]) && isfinite(time_s[1])) f->skew_s = time_s[1] - time_s[0];
    return TD_OK;
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

void reconstruct_view_free(reconstruct_view *view)
{
    td_image_free(&view->left);
    td_disparity_free(&view->disparity);
}

static td_status match(reconstruct_view *view, reconstruct_job *work, reconstruct_frame *f,
                       td_image *const raw[2], td_error *error)
{
    look_shares shares;
    const look_body body = {.robot = work->robot,
                            .mount = work->mount,
                            .q = f->q,
                            .sigma_q = work->sigma_q,
                            .vehicle_from_rig = f->vehicle_from_rig,
                            .left_from_rig = work->rig->camera[work->pair.left].camera_from_rig};
    td_status status =
        look_match(&view->left, &view->disparity, &shares, work->depth, raw, &work->how->dense, &body, error);
    f->matched = shares.matched;
    f->masked = shares.masked;
    return status;
}

td_status reconstruct_measure(reconstruct_view *view, reconstruct_job *work, size_t index, td_error *error)
{
    reconstruct_frame *f = &work->frame[index];
    td_image *raw[2] = {NULL, NULL};
    double began = terminal_now_s();
    *view = (reconstruct_view){0};
    if (f->failed) return TD_OK;
    td_error why = {0};
    td_status status = read_images(raw, work, f, &why);
    if (status == TD_OK && work->how->gate_every && index % (size_t)work->how->gate_every == 0)
        look_at_epipolar(work, f, raw);
    if (status == TD_OK) status = match(view, work, f, raw, &why);
    td_image_free(&raw[0]);
    td_image_free(&raw[1]);
    f->seconds = terminal_now_s() - began;
    if (status == TD_OK) return TD_OK;
    reconstruct_view_free(view);
    if (status == TD_ERROR_MEMORY || status == TD_ERROR_CANCELLED) return *error = why, status;
    f->failed = true;
    snprintf(f->reason, sizeof f->reason, "%s", why.message);
    return TD_OK;
}
