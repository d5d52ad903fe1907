#include "apps/look.h"

#include <math.h>
#include <stdlib.h>

#include "apps/terminal.h"
#include "recon/epipolar_gate.h"

struct look {
    const td_scene *scene;
    const td_rig *truth, *believed;
    int mount;
    look_options options;
    td_stereo_view *view;
    td_depth_camera *depth;
    td_fusion *fusion;
    td_pair pair;
    td_rig_belief *belief;   /* NULL: the rig has no covariance */
    td_image *raw[2], *left; /* of the last pair */
};

look_options look_options_default(void)
{
    return (look_options){.camera = {0, 1},
                          .near_m = 2,
                          .far_m = 25,
                          .view = td_view_options_default(),
                          .dense = td_dense_options_default(),
                          .fusion = td_fusion_options_default()};
}

void look_free(look **l)
{
    if (!l || !*l) return;
    td_stereo_view_free(&(*l)->view);
    td_depth_camera_free(&(*l)->depth);
    td_fusion_free(&(*l)->fusion);
    td_rig_belief_free(&(*l)->belief);
    for (int side = 0; side < 2; side++) td_image_free(&(*l)->raw[side]);
    td_image_free(&(*l)->left);
    free(*l);
    *l = NULL;
}

static td_status make(look *l, td_error *error)
{
    look_options *o = &l->options;
    TD_TRY(td_stereo_view_new(&l->view, l->scene, error));
    TD_TRY(
        td_depth_camera_new(&l->depth, l->believed, o->camera[0], o->camera[1], o->near_m, o->far_m, error));
    td_depth_camera_range(&o->dense.lowest, &o->dense.levels, l->depth);
    TD_TRY(td_dense_options_check(&o->dense, error));
    TD_TRY(td_pair_init(&l->pair, l->believed, o->camera[0], o->camera[1], error));
    if (l->believed->covariance) TD_TRY(td_rig_belief_new(&l->belief, &l->pair, error));
    return td_fusion_new(&l->fusion, &o->fusion, error);
}

td_status look_new(look **out, const td_scene *scene, const td_rig *truth, const td_rig *believed, int mount,
                   const look_options *options, td_error *error)
{
    look *l = *out = calloc(1, sizeof *l);
    if (!l) return td_fail(error, TD_ERROR_MEMORY, "no memory to look");
    *l = (look){.scene = scene,
                .truth = truth,
                .believed = believed,
                .mount = mount,
                .options = options ? *options : look_options_default()};
    if (!truth->has_vehicle || !believed->has_vehicle) {
        look_free(out);
        return td_fail(error, TD_ERROR_DATA,
                       "the rig does not say how it is mounted: vehicle_from_rig is missing (teledimos "
                       "vehicle makes it)");
    }
    td_status status = make(l, error);
    if (status != TD_OK) look_free(out);
    return status;
}

void look_ground_changed(look *l, int column, int row, int columns, int rows)
{
    td_stereo_view_update(l->view, column, row, columns, rows);
}

td_status look_prior(look *l, const td_elevation *prior, double sigma_m, td_error *error)
{
    return td_fusion_prior(l->fusion, prior, sigma_m, error);
}

static td_pose vehicle_from_rig(const look *l, const td_rig *rig, const double *q)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    td_robot_forward(root_from_link, l->scene->robot, q);
    return td_pose_compose(&root_from_link[l->mount], &rig->vehicle_from_rig);
}

static double mean_grey(const td_image *image)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    double sum = 0;
    for (size_t i = 0; i < pixels; i++) sum += image->data[i];
    return sum / (double)pixels;
}

static td_status render(look_result *result, look *l, uint64_t frame, td_error *error)
{
    const td_pose from_rig = vehicle_from_rig(l, l->truth, l->scene->q);
    const td_pose site_from_rig = td_pose_compose(&l->scene->site_from_vehicle, &from_rig);
    TD_TRY(td_stereo_view_move(l->view, error));
    for (int side = 0; side < 2; side++) {
        td_view *seen = NULL;
        TD_TRY(td_stereo_view_render(&seen, l->view, l->truth, l->options.camera[side], &site_from_rig, frame,
                                     &l->options.view, error));
        td_image_free(&l->raw[side]);
        l->raw[side] = seen->image;
        result->grey[side] = mean_grey(seen->image);
        seen->image = NULL;
        td_view_free(&seen);
    }
    return TD_OK;
}

static td_status fuse(look_result *result, look *l, const td_pose *site_from_vehicle, const double *q,
                      const double *pose_covariance, double time_s, td_error *error)
{
    td_disparity *disparity = NULL;
    const look_body body = {.robot = l->scene->robot,
                            .mount = l->mount,
                            .q = q,
                            .sigma_q = l->options.sigma_q,
                            .vehicle_from_rig = vehicle_from_rig(l, l->believed, q),
                            .left_from_rig = l->believed->camera[l->options.camera[0]].camera_from_rig};
    td_image_free(&l->left);
    const double began = terminal_now_s();
    td_status status =
        look_match(&l->left, &disparity, &result->shares, l->depth, l->raw, &l->options.dense, &body, error);
    result->match_s = terminal_now_s() - began;
    const td_fusion_frame seen = {.camera = l->depth,
                                  .disparity = disparity,
                                  .site_from_rig = td_pose_compose(site_from_vehicle, &body.vehicle_from_rig),
                                  .pose_covariance = pose_covariance,
                                  .time_s = time_s};
    if (status == TD_OK) status = td_fusion_add(l->fusion, &seen, &result->tally, error);
    result->fuse_s = terminal_now_s() - began - result->match_s;
    td_disparity_free(&disparity);
    return status;
}

td_status look_now(look_result *result, look *l, const td_pose *site_from_vehicle, const double *q,
                   const double *pose_covariance, uint64_t frame, double time_s, td_error *error)
{
    *result = (look_result){0};
    const double began = terminal_now_s();
    td_status status = render(result, l, frame, error);
    result->render_s = terminal_now_s() - began;
    if (status == TD_OK) status = fuse(result, l, site_from_vehicle, q, pose_covariance, time_s, error);
    return status;
}

td_status look_given(look_result *result, look *l, td_image *pair[2], const td_pose *site_from_vehicle,
                     const double *q, double time_s, td_error *error)
{
    *result = (look_result){0};
    for (int side = 0; side < 2; side++) {
        td_image_free(&l->raw[side]);
        l->raw[side] = pair[side];
        pair[side] = NULL;
        result->grey[side] = mean_grey(l->raw[side]);
    }
    return fuse(result, l, site_from_vehicle, q, NULL, time_s, error);
}

static const double BAND_PX = 8; /* wide enough for a rig that is not rightly believed */

td_status look_check(look_rig *rig, look *l, td_error *error)
{
    td_match_options o = td_match_options_default();
    td_match *match = NULL;
    td_match_tally tally;
    td_epipolar_gate gate = {0};
    size_t count = 0, known = 0;
    double square = 0;
    o.near_m = l->options.near_m;
    o.far_m = l->options.far_m;
    o.band_px = BAND_PX;
    o.interest.count = 400;
    o.threads = l->options.dense.threads;
    *rig = (look_rig){.rms_px = NAN, .sigma_px = NAN, .belief = {.sigmas = NAN, .limit = NAN}};
    if (!l->raw[0]) return td_fail(error, TD_ERROR_ARGUMENT, "no pair of images yet");
    td_status status = td_match_automatic(&match, &count, &tally, &l->pair, l->raw[0], l->raw[1], &o, error);
    if (status == TD_OK) status = td_epipolar_gate_check(&gate, &l->pair, match, count, error);
    for (size_t i = 0; status == TD_OK && i < count; i++) {
        const double sigma = td_pair_residual_sigma(&l->pair, match[i].left, match[i].right);
        if (isfinite(sigma)) square += sigma * sigma, known++;
    }
    rig->rms_px = gate.rms_px;
    if (known) rig->sigma_px = sqrt(square / (double)known);
    if (status == TD_OK && l->belief) status = td_rig_belief_add(l->belief, match, count, error);
    if (status == TD_OK && l->belief) status = td_rig_belief_check(&rig->belief, l->belief, error);
    free(match);
    return status;
}

td_view_options *look_view(look *l)
{
    return &l->options.view;
}

td_status look_map(td_elevation **map, const look *l, td_error *error)
{
    return td_fusion_map(map, NULL, l->fusion, error);
}

td_status look_anew(look *l, td_error *error)
{
    td_fusion_free(&l->fusion);
    if (l->belief) td_rig_belief_clear(l->belief);
    return td_fusion_new(&l->fusion, &l->options.fusion, error);
}

const td_image *look_left(const look *l)
{
    return l->left;
}
