/* The solution, the tip's sigma over the working space, and the arm poses that would help. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"
#include "core/linalg.h"

enum { MAP_POSES = 20000 };

/* ---- the map ---- */

static bool is_above(const td_robot *robot, int above, int link)
{
    for (; link >= 0; link = robot->link[link].parent)
        if (link == above) return true;
    return false;
}

/* The joints between mount and tip that have limits: those that turn without end (a slew) stay at zero, so
 * that what is left is a side view of the arm. */
static int map_joints(int *joint, const vehicle_job *job)
{
    int n = 0;
    for (int j = 0; j < job->robot->joint_count; j++) {
        const td_robot_joint *one = &job->robot->joint[j];
        if (is_above(job->robot, one->link, job->data.mount) == is_above(job->robot, one->link, job->tip))
            continue;
        if (one->kind != TD_JOINT_CONTINUOUS && isfinite(one->lower) && isfinite(one->upper)) joint[n++] = j;
    }
    return n;
}

typedef struct map_pose {
    double x, z, sigma_mm;
} map_pose;

/* The pose of number `index` of `levels` to the power of n. */
static void map_q(double *q, const vehicle_job *job, const int *joint, int n, int levels, size_t index)
{
    for (int j = 0; j < job->robot->joint_count; j++)
        q[j] = fmin(fmax(0, job->robot->joint[j].lower), job->robot->joint[j].upper);
    for (int i = 0; i < n; i++) {
        const td_robot_joint *one = &job->robot->joint[joint[i]];
        q[joint[i]] =
            one->lower + (one->upper - one->lower) * (double)(index % (size_t)levels) / (levels - 1);
        index /= (size_t)levels;
    }
}

static td_status map_at(map_pose *at, const vehicle_job *job, const double *q, td_error *error)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    double covariance[9], value[3], p[3];
    TD_TRY(td_vehicle_tip_sigma(covariance, job->result, &job->data, job->tip, q, error));
    TD_TRY(td_eigen_symmetric(value, NULL, covariance, 3, error));
    td_robot_forward(root_from_link, job->robot, q);
    td_pose vehicle_from_root = td_pose_inverse(&root_from_link[job->data.vehicle]);
    td_pose_transform(p, &vehicle_from_root, root_from_link[job->tip].t);
    *at = (map_pose){p[0], p[2], 1e3 * sqrt(fmax(value[2], 0))};
    return TD_OK;
}

static void fill_map(vehicle_map *map, const map_pose *at, size_t count)
{
    map->x_min = map->x_max = at[0].x;
    map->z_min = map->z_max = at[0].z;
    for (size_t i = 0; i < count; i++) {
        map->x_min = fmin(map->x_min, at[i].x);
        map->x_max = fmax(map->x_max, at[i].x);
        map->z_min = fmin(map->z_min, at[i].z);
        map->z_max = fmax(map->z_max, at[i].z);
    }
    for (size_t i = 0; i < VEHICLE_MAP_ROWS * VEHICLE_MAP_COLUMNS; i++) map->value[i] = NAN;
    if (!(map->x_max > map->x_min + 1e-6 && map->z_max > map->z_min + 1e-6)) return;
    for (size_t i = 0; i < count; i++) {
        double x = (at[i].x - map->x_min) / (map->x_max - map->x_min) * (VEHICLE_MAP_COLUMNS - 1);
        double z = (at[i].z - map->z_min) / (map->z_max - map->z_min) * (VEHICLE_MAP_ROWS - 1);
        double *cell = &map->value[(size_t)lround(z) * VEHICLE_MAP_COLUMNS + (size_t)lround(x)];
        *cell = fmax(*cell, at[i].sigma_mm); /* that of NaN and a number is the number */
    }
    map->made = true;
}

static td_status make_map(vehicle_job *job, td_error *error)
{
    int joint[TD_ROBOT_MAX_JOINTS], n = map_joints(joint, job), levels = 2;
    if (n == 0) return TD_OK;
    while (pow(levels + 1, n) <= MAP_POSES) levels++;
    if (pow(levels, n) > MAP_POSES) return TD_OK; /* too many joints for a grid */
    size_t count = (size_t)lround(pow(levels, n));
    map_pose *at = calloc(count, sizeof *at);
    td_status status = at ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < count && status == TD_OK; i++) {
        double q[TD_ROBOT_MAX_JOINTS];
        map_q(q, job, joint, n, levels, i);
        status = map_at(&at[i], job, q, error);
    }
    if (status == TD_OK) fill_map(&job->map, at, count);
    free(at);
    return status;
}

/* ---- the next poses ---- */

/* What the cameras would see of the points were the arm at q, as now estimated, added to `data`. */
static void foresee(td_vehicle_data *data, const vehicle_job *job, const double *q)
{
    const td_robot *robot = job->robot;
    td_pose root_from_link[TD_ROBOT_MAX_LINKS],
        rig_from_mount = td_pose_inverse(&job->result->mount_from_rig);
    double at[TD_ROBOT_MAX_JOINTS];
    size_t pose = data->pose_count++, n = (size_t)robot->joint_count;
    memcpy(data->q + pose * n, q, n * sizeof *q);
    for (size_t j = 0; j < n; j++) at[j] = q[j] + job->result->offset[j];
    td_robot_forward(root_from_link, robot, at);
    td_pose mount_from_root = td_pose_inverse(&root_from_link[data->mount]);
    for (int p = 0; p < data->point_count; p++)
        for (int c = 0; c < data->rig->count; c++) {
            const td_camera *camera = &data->rig->camera[c].camera;
            td_vehicle_sight sight = {
                .pose = pose, .camera = c, .point = p, .sigma_px = data->sight[0].sigma_px};
            double x[3];
            td_pose_transform(x, &root_from_link[data->point[p].link], job->result->place[p]);
            td_pose_transform(x, &mount_from_root, x);
            td_pose_transform(x, &rig_from_mount, x);
            td_pose_transform(x, &data->rig->camera[c].camera_from_rig, x);
            if (!isfinite(x[0]) || !td_camera_project(sight.pixel, NULL, NULL, camera, x)) continue;
            if (sight.pixel[0] < 0 || sight.pixel[1] < 0 || sight.pixel[0] > camera->width - 1 ||
                sight.pixel[1] > camera->height - 1)
                continue;
            data->sight[data->sight_count++] = sight;
        }
}

/* One pose after the other: each as if those before had been taken. */
static td_status advise(vehicle_job *job, td_error *error)
{
    td_vehicle_data data = job->data;
    td_vehicle_options o = td_vehicle_options_default();
    td_vehicle *now = NULL;
    const td_vehicle *from = job->result;
    size_t n = (size_t)job->robot->joint_count;
    size_t more = VEHICLE_MOST_ADVICE * (size_t)data.point_count * (size_t)data.rig->count;
    td_status status = TD_OK;
    o.tip = job->tip;
    o.outlier_sigma = job->how->outlier_sigma;
    data.pose_name = NULL;
    data.q = malloc(((data.pose_count + VEHICLE_MOST_ADVICE) * n + 1) * sizeof *data.q);
    data.sight = malloc((data.sight_count + more) * sizeof *data.sight);
    if (!data.q || !data.sight) status = td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) {
        memcpy(data.q, job->data.q, data.pose_count * n * sizeof *data.q);
        memcpy(data.sight, job->data.sight, data.sight_count * sizeof *data.sight);
    }
    for (size_t i = 0; i < VEHICLE_MOST_ADVICE && status == TD_OK; i++) {
        size_t seen = data.sight_count;
        status = td_vehicle_advise(job->advice_q[i], job->advice[i], from, &data, error);
        if (status != TD_OK) break;
        job->advice_count = i + 1;
        foresee(&data, job, job->advice_q[i]);
        td_vehicle_free(&now);
        if (data.sight_count == seen || td_vehicle_solve(&now, &data, &o, NULL) != TD_OK || now->null_count)
            break;
        from = now;
    }
    td_vehicle_free(&now);
    free(data.q);
    free(data.sight);
    return status;
}

td_status vehicle_solve(vehicle_job *job, td_error *error)
{
    td_vehicle_options o = td_vehicle_options_default();
    o.tip = job->tip;
    o.closed_only = job->how->closed;
    o.outlier_sigma = job->how->outlier_sigma;
    o.progress = job->how->progress;
    o.log = job->how->log;
    TD_TRY(td_vehicle_solve(&job->result, &job->data, &o, error));
    if (job->how->closed || job->result->null_count) return TD_OK;
    TD_TRY(make_map(job, error));
    return job->how->advise ? advise(job, error) : TD_OK;
}
