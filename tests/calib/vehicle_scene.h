/* The excavator of datasets/zx200, a stereo rig on its upper structure or undercarriage, points on
 * the arm (stick) and on the ground, and what the cameras and the joints' sensors say of arm poses. */
#ifndef TELEDIMOS_TESTS_VEHICLE_SCENE_H
#define TELEDIMOS_TESTS_VEHICLE_SCENE_H

#include "calib/vehicle.h"
#include "core/random.h"
#include "tests/check.h"

enum { SCENE_POSES = 60, SCENE_POINTS = 12, SCENE_JOINTS = 4, SCENE_SIGHTS = SCENE_POSES * SCENE_POINTS * 2 };
enum { SWING, BOOM, STICK, BUCKET };

typedef struct scene {
    td_robot *robot;
    td_rig *rig;
    td_vehicle_data data;
    td_pose mount_from_rig;        /* truth */
    double offset[SCENE_JOINTS];   /* truth */
    double place[SCENE_POINTS][3]; /* truth */
    td_vehicle_point point[SCENE_POINTS];
    double reading[SCENE_POSES * SCENE_JOINTS], angle[SCENE_POSES * SCENE_JOINTS]; /* noisy; true */
    double sigma_q[SCENE_JOINTS], offset_prior[SCENE_JOINTS];
    td_vehicle_sight sight[SCENE_SIGHTS];
    double pixel[SCENE_SIGHTS][2]; /* without noise */
} scene;

static inline td_rig *scene_rig(void)
{
    td_rig *rig = td_rig_new();
    rig->count = 2;
    for (int c = 0; c < 2; c++) {
        td_rig_camera *camera = &rig->camera[c];
        snprintf(camera->name, sizeof camera->name, c ? "right" : "left");
        camera->camera =
            (td_camera){TD_CAMERA_BROWN5, 1280, 960, {900, 901, 640, 480, -0.1, 0.05, 1e-4, 2e-4}};
        camera->camera_from_rig = td_pose_identity();
    }
    td_rotation_exp(rig->camera[1].camera_from_rig.q, (double[]){0.002, 0.01, -0.003});
    rig->camera[1].camera_from_rig.t[0] = -0.6;
    return rig;
}

/* Rig above the cab's or the undercarriage's front, looking forward. */
static inline td_pose scene_mount_pose(bool on_cab)
{
    /* Camera x right = -y, y down = -z, z forward = x; then a slight tilt. */
    const double r[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, on_top[3] = {0.9, 0.35, 1.7},
                 below[3] = {1.6, 0.2, 1.1};
    td_pose straight = td_pose_from_rotation(r, on_cab ? on_top : below);
    td_pose tilt = td_pose_exp((double[]){0.03, on_cab ? 0.06 : -0.15, 0.02, 0, 0, 0});
    td_pose turned = straight;
    memset(turned.t, 0, sizeof turned.t);
    turned = td_pose_compose(&tilt, &turned);
    memcpy(turned.t, straight.t, sizeof turned.t);
    return turned;
}

static inline bool scene_sees(double pixel[2], const scene *s, const td_pose *root_from_link, int camera,
                              int p)
{
    double x[3];
    td_pose mount_from_root = td_pose_inverse(&root_from_link[s->data.mount]);
    td_pose rig_from_mount = td_pose_inverse(&s->mount_from_rig);
    td_pose_transform(x, &root_from_link[s->point[p].link], s->place[p]);
    td_pose_transform(x, &mount_from_root, x);
    td_pose_transform(x, &rig_from_mount, x);
    td_pose_transform(x, &s->rig->camera[camera].camera_from_rig, x);
    const td_camera *c = &s->rig->camera[camera].camera;
    return x[2] > 0.5 && td_camera_project(pixel, NULL, NULL, c, x) && pixel[0] > 0 && pixel[1] > 0 &&
           pixel[0] < c->width && pixel[1] < c->height;
}

/* True arm poses within the limits in which all points on the arm are seen by both cameras; `slew`: half the
 * range of the swing. */
static inline void scene_poses(scene *s, size_t poses, double slew, uint64_t seed)
{
    td_random random = td_random_seed(seed, 7);
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    s->data.pose_count = poses;
    s->data.sight_count = 0;
    for (size_t k = 0; k < poses; k++) {
        double *q = s->angle + k * SCENE_JOINTS, pixel[2];
        bool ok = false;
        for (int tries = 0; !ok && tries < 100000; tries++) {
            for (int j = 0; j < SCENE_JOINTS; j++) {
                const td_robot_joint *joint = &s->robot->joint[j];
                double low = j == SWING ? -slew : joint->lower, high = j == SWING ? slew : joint->upper;
                q[j] = low + 0.02 * (j > 0) + (high - low - 0.04 * (j > 0)) * td_random_uniform(&random);
            }
            td_robot_forward(root_from_link, s->robot, q);
            ok = true;
            for (int p = 0; p < s->data.point_count && ok; p++)
                for (int c = 0; c < 2 && ok && s->point[p].link != 0; c++)
                    ok = scene_sees(pixel, s, root_from_link, c, p);
        }
        assert_true(ok);
        for (int p = 0; p < s->data.point_count; p++)
            for (int c = 0; c < 2; c++) {
                if (!scene_sees(pixel, s, root_from_link, c, p)) continue;
                size_t n = s->data.sight_count++;
                s->sight[n] = (td_vehicle_sight){k, c, p, {0, 0}, 0.2};
                memcpy(s->pixel[n], pixel, sizeof pixel);
            }
    }
}

/* What is read and seen, with noise `share` times the model's. */
static inline void scene_measure(scene *s, double share, uint64_t seed)
{
    td_random random = td_random_seed(seed, 1);
    for (size_t i = 0; i < s->data.pose_count * SCENE_JOINTS; i++)
        s->reading[i] = s->angle[i] - s->offset[i % SCENE_JOINTS] +
                        share * s->sigma_q[i % SCENE_JOINTS] * td_random_normal(&random);
    for (size_t n = 0; n < s->data.sight_count; n++)
        for (int i = 0; i < 2; i++)
            s->sight[n].pixel[i] = s->pixel[n][i] + share * s->sight[n].sigma_px * td_random_normal(&random);
}

/* Six known points on the stick; 0.05 degrees of joint noise, 0.2 px. */
static inline void scene_make(scene *s, bool on_cab)
{
    static const double place[6][3] = {{0.35, 0.25, 0.1}, {1.2, -0.25, -0.05}, {2.5, 0.2, 0.25},
                                       {1.0, -0.2, 0.25}, {1.7, 0.3, -0.1},    {2.1, -0.3, 0.0}};
    td_error error;
    memset(s, 0, sizeof *s);
    check_ok(td_robot_read(&s->robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    s->rig = scene_rig();
    s->mount_from_rig = scene_mount_pose(on_cab);
    int cab = td_robot_find_link(s->robot, "upper"), mount = on_cab ? cab : 0;
    s->data = (td_vehicle_data){.robot = s->robot,
                                .rig = s->rig,
                                .mount = mount,
                                .vehicle = mount,
                                .q = s->reading,
                                .sigma_q = s->sigma_q,
                                .offset_prior = s->offset_prior,
                                .point_count = 6,
                                .point = s->point,
                                .sight = s->sight};
    for (int p = 0; p < 6; p++) {
        snprintf(s->point[p].name, TD_NAME_SIZE, "s%d", p + 1);
        s->point[p].link = td_robot_find_link(s->robot, "arm");
        memcpy(s->place[p], place[p], sizeof s->place[p]);
        memcpy(s->point[p].place, place[p], sizeof s->place[p]);
    }
    for (int j = 0; j < SCENE_JOINTS; j++) s->sigma_q[j] = 0.05 / 57.29577951308232;
}

/* Four points of a board on the ground, of known place or free. */
static inline void scene_add_board(scene *s, bool is_free)
{
    for (int i = 0; i < 4; i++) {
        int p = s->data.point_count++;
        snprintf(s->point[p].name, TD_NAME_SIZE, "g%d", i + 1);
        s->point[p].link = 0;
        double *x = s->place[p];
        x[0] = 7.5 + 0.8 * (i % 2);
        x[1] = i / 2 * 0.9 - 0.4;
        x[2] = 0.3 * (i == 3);
        for (int k = 0; k < 3; k++) {
            s->point[p].place[k] = is_free ? NAN : x[k];
            s->point[p].sigma[k] = is_free ? INFINITY : 0;
        }
    }
}

static inline void scene_free_place(scene *s, int p, int k)
{
    s->point[p].place[k] = NAN;
    s->point[p].sigma[k] = INFINITY;
}

static inline void scene_drop(scene *s)
{
    td_robot_free(&s->robot);
    td_rig_free(&s->rig);
}

#endif
