/* Real sets for hand-eye calibration as views: the robot's poses from their files, the target's from the
 * images. False, with a message, when a set is not there. */
#ifndef TELEDIMOS_TESTS_CALIB_HAND_EYE_DATA_H
#define TELEDIMOS_TESTS_CALIB_HAND_EYE_DATA_H

#include "calib/calibrate.h"
#include "calib/chessboard.h"
#include "calib/hand_eye.h"
#include "calib/tags.h"
#include "core/parallel.h"
#include "core/robot_poses.h"
#include "tests/check.h"

enum { REAL_VIEWS_MAX = 32 };

typedef struct real_set {
    const char *images, *poses; /* below TELEDIMOS_DATA; images: without number and ending */
    int digits;                 /* of an image's number */
    int columns, rows;          /* 0: a tag */
    double size_m;
    const td_camera *camera; /* NULL: calibrated from the same images */
} real_set;

static const td_camera franka_camera = {
    .model = TD_CAMERA_PINHOLE,
    .width = 640,
    .height = 480,
    .parameter = {607.5931396484375, 607.574951171875, 323.46282958984375, 243.25529479980469}};
/* The squares of the in-hand set as its files state them, by which the published figures were made, and as
 * they are (the sheet's edge is a ruler). */
static const real_set franka_in_hand = {.images = "visp-eye-in-hand/franka_image-",
                                        .poses = "visp-eye-in-hand/franka_pose_rPe_%d.yaml",
                                        .digits = 1,
                                        .columns = 9,
                                        .rows = 6,
                                        .size_m = 0.0236,
                                        .camera = &franka_camera};
static const real_set franka_in_hand_true = {.images = "visp-eye-in-hand/franka_image-",
                                             .poses = "visp-eye-in-hand/franka_pose_rPe_%d.yaml",
                                             .digits = 1,
                                             .columns = 9,
                                             .rows = 6,
                                             .size_m = 0.0262,
                                             .camera = &franka_camera};
static const real_set franka_to_hand = {.images = "visp-eye-to-hand/franka_image-",
                                        .poses = "visp-eye-to-hand/franka_pose_rPe_%d.yaml",
                                        .digits = 1,
                                        .size_m = 0.048,
                                        .camera = &franka_camera};
static const real_set kuka_2 = {"kuka_2/im_", "kuka_2/RobotPosesVec.txt", 2, 24, 17, 0.015, NULL};

typedef struct real_work {
    const real_set *set;
    td_observations *seen;
    td_pose *tag; /* (views) */
    bool *found;
} real_work;

static inline void look_at_image(size_t index, void *user)
{
    real_work *w = user;
    char path[1024];
    td_image *image = NULL;
    snprintf(path, sizeof path, "%s/%s%0*d.png", getenv("TELEDIMOS_DATA"), w->set->images, w->set->digits,
             (int)index + 1);
    if (td_image_read(&image, path, 1, NULL) != TD_OK) return;
    if (w->set->columns) {
        td_detection *d = td_observations_get(w->seen, index, 0);
        td_detection_free(d);
        w->found[index] = td_chessboard_detect(d, image, &w->seen->target, NULL) == TD_OK && d->found;
    } else {
        td_tag *tag = NULL;
        size_t count = 0;
        if (td_tags_find(&tag, &count, image, "tag36h11", 0, 0, NULL) == TD_OK && count == 1)
            w->found[index] =
                td_tag_pose(&w->tag[index], NULL, NULL, &tag[0], w->set->size_m, w->set->camera);
        free(tag);
    }
    td_image_free(&image);
}

static inline void poses_by_calibration(real_work *w, const td_camera *camera)
{
    td_error error = {0};
    td_calibrate_options o = td_calibrate_options_default();
    td_rig *known = td_rig_new();
    o.plain = true;
    o.leave_one_out = false;
    w->seen->camera[0] =
        (td_observed_camera){.name = "camera", .model = camera ? camera->model : TD_CAMERA_BROWN5};
    w->seen->camera[0].width = camera ? camera->width : 1920;
    w->seen->camera[0].height = camera ? camera->height : 1200;
    if (camera) {
        known->count = 1;
        strcpy(known->camera[0].name, "camera");
        known->camera[0].camera = *camera;
        known->camera[0].camera_from_rig = td_pose_identity();
        o.known = known;
        o.hold[0] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION;
    }
    td_calibration *c = NULL;
    check_ok(td_calibrate(&c, w->seen, &o, &error), error);
    print_message("board against image: %.3f px RMS\n", c->rms_px);
    for (size_t v = 0; v < c->view_count; v++) w->tag[v] = c->view[v].rig_from_target;
    td_calibration_free(&c);
    td_rig_free(&known);
}

static inline size_t read_real_set(td_hand_eye_view view[REAL_VIEWS_MAX], const real_set *set)
{
    const char *data = getenv("TELEDIMOS_DATA");
    char path[1024];
    td_error error = {0};
    td_robot_poses *robot = NULL;
    snprintf(path, sizeof path, "%s/%s", data ? data : "", set->poses);
    if (!data || td_robot_poses_read(&robot, path, NULL, &error) != TD_OK || robot->count > REAL_VIEWS_MAX) {
        print_message("skipped: no %s (TELEDIMOS_DATA)\n", set->poses);
        td_robot_poses_free(&robot);
        return 0;
    }
    size_t count = robot->count;
    td_target target = {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1};
    target.plane[0] = (td_target_plane){set->columns ? set->columns : 2, set->columns ? set->rows : 2,
                                        set->size_m, td_pose_identity()};
    td_pose tag[REAL_VIEWS_MAX];
    bool found[REAL_VIEWS_MAX] = {0};
    real_work work = {.set = set, .tag = tag, .found = found};
    check_ok(td_observations_new(&work.seen, &target, 1, count, &error), error);
    for (size_t i = 0; i < count; i++)
        snprintf(work.seen->view_name[i], sizeof work.seen->view_name[i], "%zu", i + 1);
    check_ok(td_parallel_for(count, 0, look_at_image, &work, NULL, "images"), error);
    for (size_t i = 0; i < count; i++)
        if (!found[i]) fail_msg("%s: nothing found in image %zu", set->images, i + 1);
    if (set->columns) poses_by_calibration(&work, set->camera);
    for (size_t i = 0; i < count; i++) {
        view[i] =
            (td_hand_eye_view){.base_from_hand = robot->pose[i].base_from_hand, .rig_from_target = tag[i]};
        snprintf(view[i].name, sizeof view[i].name, "%zu", i + 1);
    }
    td_observations_free(&work.seen);
    td_robot_poses_free(&robot);
    return count;
}

#endif
