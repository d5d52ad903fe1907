#include "apps/look_pair.h"

#include <math.h>
#include <stdlib.h>

#include "recon/own_body.h"

static void keep_matched(td_disparity *d, look_shares *shares)
{
    const size_t pixels = (size_t)d->width * (size_t)d->height;
    size_t matched = 0;
    for (size_t i = 0; i < pixels; i++) {
        matched += d->kind[i] == TD_DENSE_MATCHED;
        if (d->kind[i] != TD_DENSE_MATCHED) d->value[i] = d->sigma[i] = NAN;
    }
    shares->matched = (double)matched / (double)pixels;
}

/* Pixels that see the machine itself say nothing of the ground. */
static td_status leave_out(td_disparity *d, look_shares *shares, const td_depth_camera *depth,
                           const look_body *body, td_error *error)
{
    const td_rectification *r = td_depth_camera_rectification(depth);
    const size_t pixels = (size_t)d->width * (size_t)d->height;
    size_t masked = 0;
    if (!body->robot) return TD_OK;
    uint8_t *mask = calloc(pixels + 1, 1);
    if (!mask) return td_fail(error, TD_ERROR_MEMORY, "no memory for a mask");
    const td_pose rectified_from_rig = td_pose_compose(&r->rectified_from[0], &body->left_from_rig);
    const td_pose rig_from_vehicle = td_pose_inverse(&body->vehicle_from_rig);
    const td_pose camera_from_vehicle = td_pose_compose(&rectified_from_rig, &rig_from_vehicle);
    td_own_body_options o = td_own_body_options_default();
    o.sigma_q = body->sigma_q;
    o.mount = body->mount;
    td_status status =
        td_own_body_mask(mask, &r->camera, &camera_from_vehicle, body->robot, body->q, &o, error);
    for (size_t i = 0; i < pixels && status == TD_OK; i++) {
        if (!mask[i]) continue;
        masked++;
        d->value[i] = d->sigma[i] = NAN;
        d->kind[i] = TD_DENSE_NONE;
    }
    shares->masked = (double)masked / (double)pixels;
    free(mask);
    return status;
}

td_status look_match(td_image **left, td_disparity **disparity, look_shares *shares,
                     const td_depth_camera *depth, td_image *const raw[2], const td_dense_options *dense,
                     const look_body *body, td_error *error)
{
    td_image *right = NULL;
    *shares = (look_shares){0};
    td_status status = td_depth_camera_rectify(left, &right, depth, raw[0], raw[1], dense->threads, error);
    if (status == TD_OK) status = td_dense_match(disparity, *left, right, dense, error);
    td_image_free(&right);
    TD_TRY(status);
    keep_matched(*disparity, shares);
    return leave_out(*disparity, shares, depth, body, error);
}
