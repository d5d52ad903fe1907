/* What camera-to-vehicle data must be before anything is computed from them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "calib/vehicle_internal.h"

const char *td_vehicle_pose_text(char text[TD_VEHICLE_POSE_TEXT], const td_vehicle_data *data, size_t pose)
{
    if (data->pose_name)
        snprintf(text, TD_VEHICLE_POSE_TEXT, "pose %.*s", TD_NAME_SIZE - 1, data->pose_name[pose]);
    else
        snprintf(text, TD_VEHICLE_POSE_TEXT, "pose %zu", pose);
    return text;
}

static td_status check_point(const td_vehicle_data *data, int p, td_error *error)
{
    const td_vehicle_point *point = &data->point[p];
    if (point->link < 0 || point->link >= data->robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "point %s: link %d: the robot %s has links 0 to %d",
                       point->name, point->link, data->robot->name, data->robot->link_count - 1);
    if (point->board < 0 || point->board > data->board_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "point %s: board %d: there are %d boards", point->name,
                       point->board, data->board_count);
    for (int i = 0; i < 3; i++) {
        double sigma = point->sigma[i], place = point->place[i];
        if (!(sigma >= 0))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "point %s: sigma of %c is %g: give 0 (exact), a length in m, or infinity (free)",
                           point->name, "xyz"[i], sigma);
        if (isfinite(sigma) && !(fabs(place) < 1e3))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "point %s: %c is %g m: give a length within 1000 m, or leave it free", point->name,
                           "xyz"[i], place);
        if (point->link == data->mount && !isfinite(sigma))
            return td_fail(
                error, TD_ERROR_DATA,
                "point %s is on %s, which carries the cameras, and its place is free: measure it, or "
                "take points on a link that moves against that one",
                point->name, data->robot->link[data->mount].name);
    }
    return TD_OK;
}

static td_status check_board(const td_vehicle_data *data, int b, td_error *error)
{
    const td_vehicle_board *board = &data->board[b];
    if (board->link < 0 || board->link >= data->robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "board %s: link %d: the robot %s has links 0 to %d",
                       board->name, board->link, data->robot->name, data->robot->link_count - 1);
    if (!(board->sigma_rad >= 0) || !(board->sigma_m >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "board %s: sigmas of its pose are %g rad and %g m: give 0 (exact) or more",
                       board->name, board->sigma_rad, board->sigma_m);
    if (board->link == data->mount && !(isfinite(board->sigma_rad) && isfinite(board->sigma_m)))
        return td_fail(
            error, TD_ERROR_DATA,
            "board %s is on %s, which carries the cameras, and its pose is free: measure it, or fix "
            "it to a link that moves against that one",
            board->name, data->robot->link[data->mount].name);
    for (int p = 0; p < data->point_count; p++) {
        const td_vehicle_point *point = &data->point[p];
        if (point->board == b + 1 && (point->link != board->link || point->sigma[0] != 0 ||
                                      point->sigma[1] != 0 || point->sigma[2] != 0))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "point %s: is of board %s: it must be exact in it, and on the same link",
                           point->name, board->name);
    }
    return TD_OK;
}

static td_status check_sight(const td_vehicle_data *data, size_t s, td_error *error)
{
    const td_vehicle_sight *sight = &data->sight[s];
    char text[TD_VEHICLE_POSE_TEXT];
    if (sight->pose >= data->pose_count || sight->camera < 0 || sight->camera >= data->rig->count ||
        sight->point < 0 || sight->point >= data->point_count)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "sight %zu: pose %zu, camera %d, point %d: there are %zu poses, %d cameras and %d points", s,
            sight->pose, sight->camera, sight->point, data->pose_count, data->rig->count, data->point_count);
    if (!isfinite(sight->pixel[0]) || !isfinite(sight->pixel[1]) || !(sight->sigma_px > 0) ||
        !isfinite(sight->sigma_px))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "sight %zu (point %s in %s by camera %s): pixel (%g, %g), sigma %g px: give "
                       "numbers, and a sigma above 0",
                       s, data->point[sight->point].name, td_vehicle_pose_text(text, data, sight->pose),
                       data->rig->camera[sight->camera].name, sight->pixel[0], sight->pixel[1],
                       sight->sigma_px);
    return TD_OK;
}

/* A reading may lie outside by its noise and by its zero's. */
static td_status check_reading(const td_vehicle_data *data, size_t pose, int j, td_error *error)
{
    const td_robot_joint *joint = &data->robot->joint[j];
    char text[TD_VEHICLE_POSE_TEXT];
    bool shift = joint->kind == TD_JOINT_PRISMATIC;
    double q = data->q[pose * (size_t)data->robot->joint_count + (size_t)j];
    double margin = 1e-6 + 5 * data->sigma_q[j] + fmin(3 * data->offset_prior[j], 0.2);
    double unit = shift ? 1 : 57.29577951308232;
    if (!isfinite(q))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: joint %s reads %g: give a number",
                       td_vehicle_pose_text(text, data, pose), joint->name, q);
    if (joint->kind == TD_JOINT_CONTINUOUS || (q >= joint->lower - margin && q <= joint->upper + margin))
        return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "%s: joint %s reads %.4g %s, outside its limits of %.4g to %.4g %s: check units, sign "
                   "and zero of the sensor, or the limits in the robot's file",
                   td_vehicle_pose_text(text, data, pose), joint->name, q * unit, shift ? "m" : "deg",
                   joint->lower * unit, joint->upper * unit, shift ? "m" : "deg");
}

static td_status check_joints(const td_vehicle_data *data, td_error *error)
{
    for (int j = 0; j < data->robot->joint_count; j++) {
        if (!(data->sigma_q[j] >= 0) || !isfinite(data->sigma_q[j]))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "joint %s: sigma of a reading is %g: give 0 or more (rad or m)",
                           data->robot->joint[j].name, data->sigma_q[j]);
        if (!(data->offset_prior[j] >= 0))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "joint %s: sigma of its zero is %g: give 0 (held), a prior in rad or m, or infinity "
                "(free)",
                data->robot->joint[j].name, data->offset_prior[j]);
        for (size_t k = 0; k < data->pose_count; k++) TD_TRY(check_reading(data, k, j, error));
    }
    return TD_OK;
}

td_status td_vehicle_check(const td_vehicle_data *data, const td_vehicle_options *options, td_error *error)
{
    if (!data || !data->robot || !data->rig)
        return td_fail(error, TD_ERROR_ARGUMENT, "vehicle: give a robot and a rig");
    int links = data->robot->link_count;
    if (data->mount < 0 || data->mount >= links || data->vehicle < 0 || data->vehicle >= links)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "vehicle: mount %d, vehicle %d: the robot %s has links 0 to %d", data->mount,
                       data->vehicle, data->robot->name, links - 1);
    if (options->tip < -1 || options->tip >= links)
        return td_fail(error, TD_ERROR_ARGUMENT, "vehicle: tip %d: the robot %s has links 0 to %d",
                       options->tip, data->robot->name, links - 1);
    if (!(options->outlier_sigma >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "outlier_sigma is %g: give 0 or more",
                       options->outlier_sigma);
    if (data->pose_count == 0 || data->sight_count == 0 || !data->q || !data->sigma_q ||
        !data->offset_prior || !data->sight)
        return td_fail(error, TD_ERROR_DATA,
                       "vehicle: no poses or no sights: there is nothing to solve from");
    if (data->point_count < 1 || data->point_count > TD_VEHICLE_MAX_POINTS || !data->point)
        return td_fail(error, TD_ERROR_ARGUMENT, "vehicle: %d points: give 1 to %d", data->point_count,
                       TD_VEHICLE_MAX_POINTS);
    if (data->board_count < 0 || data->board_count > TD_VEHICLE_MAX_BOARDS ||
        (data->board_count && !data->board))
        return td_fail(error, TD_ERROR_ARGUMENT, "vehicle: %d boards: give 0 to %d", data->board_count,
                       TD_VEHICLE_MAX_BOARDS);
    for (int b = 0; b < data->board_count; b++) TD_TRY(check_board(data, b, error));
    TD_TRY(td_rig_check(data->rig, error));
    for (int p = 0; p < data->point_count; p++) TD_TRY(check_point(data, p, error));
    for (size_t s = 0; s < data->sight_count; s++) TD_TRY(check_sight(data, s, error));
    return check_joints(data, error);
}

size_t td_vehicle_distinct_poses(const td_vehicle_model *model)
{
    const td_vehicle_data *data = model->data;
    size_t n = (size_t)data->robot->joint_count, distinct = 0;
    for (size_t k = 0; k < data->pose_count; k++) {
        bool seen = false;
        for (size_t i = 0; i < k && !seen; i++) {
            bool same = true;
            for (int c = 0; c < model->joints && same; c++) {
                size_t j = (size_t)model->joint[c];
                same = fabs(data->q[k * n + j] - data->q[i * n + j]) <= 1e-4 + 5 * data->sigma_q[j];
            }
            seen = same;
        }
        distinct += !seen;
    }
    return distinct;
}
