/* What a hand-eye calibration is made from: the target's pose in the rig, view by view, and the robot's. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/hand_eye_internal.h"
#include "core/rig_formats.h"

/* Of a stream of poses, the views that are used: as far from one another as this, and no more than MOST. */
#define VIEW_TURN 0.17  /* rad */
#define VIEW_SHIFT 0.05 /* m */
#define STREAM_GAP_S 0.2
enum { MOST_STREAM_VIEWS = 120 };

/* Of poses of a target that came without a covariance, until hand_eye_solve.c finds it. */
#define POSE_RAD 1e-4
#define POSE_M 1e-4

#define LEAST_BEND 0.001 /* of a lens, worth a word */

static td_status no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

/* ---- Cameras ---- */

static td_status calibrate_here(td_rig **rig, hand_eye_job *job, td_error *error)
{
    td_calibrate_options o = td_calibrate_options_default();
    td_calibration *c = NULL;
    o.leave_one_out = false;
    o.threads = job->how->threads;
    o.progress = job->how->progress;
    o.log = job->how->log;
    td_status status = td_calibrate(&c, job->observations, &o, error);
    if (status != TD_OK)
        return td_error_prefix(error, status, "calibrating the cameras from the same images");
    *rig = td_rig_copy(c->rig);
    snprintf(job->rig_from, sizeof job->rig_from,
             "calibrated from the same images (%zu views, %.3f px RMS); its own uncertainty is not in sigma",
             c->view_count, c->rms_px);
    td_calibration_free(&c);
    return *rig ? TD_OK : no_memory(error);
}

/* How far the first camera's intrinsics moved, in the new calibration's sigmas. */
static double intrinsics_moved(const td_rig *given, const td_rig *found)
{
    double most = 0;
    size_t n = td_rig_parameter_count(found);
    for (int i = 0; i < 4 && found->covariance; i++) {
        double sigma = sqrt(fmax(found->covariance[(size_t)i * (n + 1)], 1e-12));
        most = fmax(most, fabs(found->camera[0].camera.parameter[i] - given->camera[0].camera.parameter[i]) /
                              sigma);
    }
    return most;
}

static td_status read_rig(td_rig **rig, const char *path, const hand_eye_job *job, td_error *error)
{
    const td_observations *o = job->observations;
    td_rig_import_options how = {
        .format = TD_RIG_FORMAT_COUNT, .width = o->camera[0].width, .height = o->camera[0].height};
    TD_TRY(td_rig_import(rig, &path, 1, &how, error));
    if ((*rig)->count == 1 && o->camera_count == 1)
        memcpy((*rig)->camera[0].name, o->camera[0].name, sizeof o->camera[0].name);
    return TD_OK;
}

/* Whether the held cameras lack distortion that the views tell of; taken in if that is wanted. */
static td_status check_lenses(hand_eye_job *job, td_rig *rig, td_error *error)
{
    const td_observations *o = job->observations;
    for (int c = 0; c < o->camera_count; c++) {
        td_lens_check check;
        TD_TRY(td_lens_check_make(&check, rig, c, o, error));
        if (!check.terms) continue;
        snprintf(job->lens, sizeof job->lens, "camera %s is %s", o->camera[c].name, check.text);
        if (!job->how->find_lens) continue;
        rig->camera[td_rig_find(rig, o->camera[c].name)].camera = check.camera;
        free(rig->covariance); /* of another model */
        rig->covariance = NULL;
    }
    return TD_OK;
}

static td_status find_rig(hand_eye_job *job, td_error *error)
{
    const char *path = job->how->rig ? job->how->rig : job->dataset->rig;
    td_rig *given = NULL;
    job->moved_sigma = NAN;
    if (!path) return calibrate_here(&job->rig, job, error);
    TD_TRY(read_rig(&given, path, job, error));
    if (!job->how->free_intrinsics) {
        job->rig = given;
        TD_TRY(check_lenses(job, given, error));
        snprintf(job->rig_from, sizeof job->rig_from, "%s, held%s", path,
                 *job->lens && job->how->find_lens ? ", with the distortion that the views tell of" : "");
        return TD_OK;
    }
    td_status status = calibrate_here(&job->rig, job, error);
    if (status == TD_OK) job->moved_sigma = intrinsics_moved(given, job->rig);
    td_rig_free(&given);
    return status;
}

/* ---- Pairing ---- */

static td_status make_room(hand_eye_job *job, size_t count, td_error *error)
{
    job->view = calloc(count + 1, sizeof *job->view);
    job->source = calloc(count + 1, sizeof *job->source);
    return job->view && job->source ? TD_OK : no_memory(error);
}

static void add_view(hand_eye_job *job, const char *name, const td_pose *robot, const td_pose *target,
                     const double *covariance, size_t source)
{
    td_hand_eye_view *view = &job->view[job->count];
    snprintf(view->name, sizeof view->name, "%s", name);
    view->base_from_hand = *robot;
    view->rig_from_target = *target;
    memset(view->covariance, 0, sizeof view->covariance);
    if (covariance) memcpy(view->covariance, covariance, sizeof view->covariance);
    for (int k = 0; k < 6 && !covariance; k++)
        view->covariance[7 * k] = k < 3 ? POSE_RAD * POSE_RAD : POSE_M * POSE_M;
    job->source[job->count++] = source;
}

/* Whether the frames and the robot's poses both have times. */
static bool have_times(const td_dataset *d, const td_robot_poses *robot)
{
    for (size_t i = 0; i < d->frame_count; i++)
        if (isnan(d->frame[i].time_s)) return false;
    for (size_t i = 0; i < robot->count; i++)
        if (isnan(robot->pose[i].time_s)) return false;
    return d->frame_count > 0 && robot->count > 0;
}

static td_status pair_images(hand_eye_job *job, const td_view_pose *seen, const td_robot_poses *robot,
                             td_error *error)
{
    const td_dataset *d = job->dataset;
    bool timed = robot->count != d->frame_count && have_times(d, robot);
    if (!timed && robot->count != d->frame_count)
        return td_fail(error, TD_ERROR_DATA,
                       "%s holds %zu poses, but frames.csv %zu frames: they belong together in their order "
                       "(unless both have time_s)",
                       d->robot.path, robot->count, d->frame_count);
    TD_TRY(make_room(job, d->frame_count, error));
    for (size_t v = 0; v < d->frame_count; v++) {
        td_pose pose;
        if (!seen[v].seen) continue;
        if (!timed)
            pose = robot->pose[v].base_from_hand;
        else if (!td_robot_poses_at(&pose, robot, d->frame[v].time_s + job->offset_s, STREAM_GAP_S))
            continue;
        add_view(job, d->frame[v].name, &pose, &seen[v].rig_from_target, seen[v].covariance, v);
    }
    return TD_OK;
}

/* The first image's reason speaks for all when the target is in none. */
static td_status check_seen(const td_observations *o, td_error *error)
{
    size_t slots = o->view_count * (size_t)o->camera_count, first = slots;
    for (size_t i = slots; i-- > 0;) {
        if (o->detection[i].found) return TD_OK;
        if (*o->detection[i].reason) first = i;
    }
    return td_fail(error, TD_ERROR_DATA, "the target is in none of the images; frame %s: %s",
                   o->view_name[first < slots ? first / (size_t)o->camera_count : 0],
                   first < slots ? o->detection[first].reason : "no image");
}

/* Poses through the rig as it is held; where it has no distortion, and the views could not tell of any, with
 * what a lens may do to them. A lens that they do tell of is named, and is the user's to take in. */
static td_status find_targets(td_view_pose *seen, hand_eye_job *job, td_error *error)
{
    const size_t used = strlen(job->rig_from);
    double bend;
    if (*job->lens) return td_view_poses(seen, job->rig, job->observations, error);
    TD_TRY(td_view_poses_unsure(seen, &bend, job->rig, job->observations, error));
    if (bend >= LEAST_BEND)
        snprintf(
            job->rig_from + used, sizeof job->rig_from - used,
            "; its lens, said to have no distortion, is taken as unsure by %.1f %% at the image's corner",
            100 * bend);
    return TD_OK;
}

static td_status views_of_images(hand_eye_job *job, const td_robot_poses *robot, td_error *error)
{
    td_observe_options o = {
        .threads = job->how->threads, .progress = job->how->progress, .log = job->how->log};
    TD_TRY(td_observe(&job->observations, job->dataset, &o, error));
    TD_TRY(check_seen(job->observations, error));
    TD_TRY(find_rig(job, error));
    td_view_pose *seen = calloc(job->observations->view_count + 1, sizeof *seen);
    if (!seen) return no_memory(error);
    td_status status = find_targets(seen, job, error);
    if (status == TD_OK) status = pair_images(job, seen, robot, error);
    free(seen);
    return status;
}

/* ---- Poses of the target ---- */

static bool has_times(const td_robot_poses *poses)
{
    for (size_t i = 0; i < poses->count; i++)
        if (isnan(poses->pose[i].time_s)) return false;
    return poses->count > 0;
}

static td_status find_offset(hand_eye_job *job, const td_robot_poses *robot, const td_robot_poses *target,
                             td_error *error)
{
    const char *how = job->how->offset;
    if (strcmp(how, "none") == 0) return TD_OK;
    job->has_offset = true;
    job->sigma_offset_s = NAN;
    if (strcmp(how, "auto") != 0) {
        char *end;
        job->offset_s = strtod(how, &end);
        if (*end || end == how || !isfinite(job->offset_s))
            return td_fail(error, TD_ERROR_ARGUMENT, "--time-offset %s: is auto, none, or seconds", how);
        return TD_OK;
    }
    size_t n = robot->count, m = target->count;
    double *time = malloc((n + m + 1) * sizeof *time);
    td_pose *pose = malloc((n + m + 1) * sizeof *pose);
    td_status status = time && pose ? TD_OK : no_memory(error);
    for (size_t i = 0; i < n + m && status == TD_OK; i++) {
        const td_robot_pose *p = i < n ? &robot->pose[i] : &target->pose[i - n];
        time[i] = p->time_s;
        pose[i] = p->base_from_hand;
    }
    if (status == TD_OK)
        status =
            td_time_offset(&job->offset_s, &job->sigma_offset_s, time, pose, n, time + n, pose + n, m, error);
    free(time);
    free(pose);
    return status;
}

/* Far enough from the last view to say something new. */
static bool is_new(const td_hand_eye_view *last, const td_pose *robot)
{
    td_pose inverse = td_pose_inverse(&last->base_from_hand), step = td_pose_compose(&inverse, robot);
    return td_pose_angle(&step) > VIEW_TURN || td_pose_distance(&step) > VIEW_SHIFT;
}

static td_status pair_streams(hand_eye_job *job, const td_robot_poses *robot, const td_robot_poses *target,
                              td_error *error)
{
    TD_TRY(find_offset(job, robot, target, error));
    TD_TRY(make_room(job, target->count, error));
    for (size_t i = 0; i < target->count; i++) {
        const td_robot_pose *t = &target->pose[i];
        td_pose pose;
        char name[TD_NAME_SIZE];
        if (!td_robot_poses_at(&pose, robot, t->time_s + job->offset_s, STREAM_GAP_S)) continue;
        if (job->count && !is_new(&job->view[job->count - 1], &pose)) continue;
        snprintf(name, sizeof name, "%.3f s", t->time_s - target->pose[0].time_s);
        add_view(job, name, &pose, &t->base_from_hand, NULL, i);
    }
    size_t every = (job->count + MOST_STREAM_VIEWS - 1) / MOST_STREAM_VIEWS, kept = 0;
    for (size_t i = 0; every > 1 && i < job->count; i += every) job->view[kept++] = job->view[i];
    if (every > 1) job->count = kept;
    return TD_OK;
}

static td_status views_of_poses(hand_eye_job *job, const td_robot_poses *robot, td_error *error)
{
    td_robot_poses *target = NULL;
    const td_dataset_poses *from = &job->dataset->target_poses;
    snprintf(job->rig_from, sizeof job->rig_from, "poses of the target were given: %s", from->path);
    job->moved_sigma = NAN;
    TD_TRY(td_robot_poses_read(&target, from->path, &from->how, error));
    td_status status;
    if (has_times(robot) && has_times(target)) {
        status = pair_streams(job, robot, target, error);
    } else if (robot->count != target->count) {
        status = td_fail(error, TD_ERROR_DATA,
                         "%s holds %zu poses, but %s %zu: without times they belong together in their order",
                         job->dataset->robot.path, robot->count, from->path, target->count);
    } else {
        status = make_room(job, target->count, error);
        for (size_t i = 0; i < target->count && status == TD_OK; i++) {
            char name[TD_NAME_SIZE];
            snprintf(name, sizeof name, "%zu", i + 1);
            add_view(job, *robot->pose[i].name ? robot->pose[i].name : name, &robot->pose[i].base_from_hand,
                     &target->pose[i].base_from_hand, NULL, i);
        }
    }
    td_robot_poses_free(&target);
    return status;
}

td_status hand_eye_views(hand_eye_job *job, td_error *error)
{
    td_robot_poses *robot = NULL;
    const td_dataset *d = job->dataset;
    if (!d->robot.path)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: dataset.yaml names no robot poses; add robot: {poses: FILE} (--init writes an example)",
            d->folder);
    TD_TRY(td_robot_poses_read(&robot, d->robot.path, &d->robot.how, error));
    td_status status =
        d->target_poses.path ? views_of_poses(job, robot, error) : views_of_images(job, robot, error);
    td_robot_poses_free(&robot);
    if (status == TD_OK && job->count < 3)
        status =
            td_fail(error, TD_ERROR_DATA,
                    "%zu views have both the target and a robot pose; 3 are the least, 10 or more do well",
                    job->count);
    return status;
}

/* ---- Reprojection ---- */

double hand_eye_view_rms(const hand_eye_job *job, size_t view, const td_pose *rig_from_target)
{
    const td_observations *o = job->observations;
    double sum = 0, p[3], pixel[2];
    size_t n = 0;
    if (!o) return NAN;
    for (int c = 0; c < o->camera_count; c++) {
        int k = td_rig_find(job->rig, o->camera[c].name);
        const td_detection *d = td_observations_get(o, job->source[view], c);
        if (k < 0 || !d->found) continue;
        td_pose pose = td_pose_compose(&job->rig->camera[k].camera_from_rig, rig_from_target);
        for (size_t i = 0; i < d->count; i++) {
            if (!isfinite(d->point[2 * i])) continue;
            td_target_point(p, &o->target, i);
            td_pose_transform(p, &pose, p);
            if (!td_camera_project(pixel, NULL, NULL, &job->rig->camera[k].camera, p)) return INFINITY;
            sum += pow(pixel[0] - d->point[2 * i], 2) + pow(pixel[1] - d->point[2 * i + 1], 2);
            n++;
        }
    }
    return n ? sqrt(sum / (double)n) : NAN;
}
