/* A target before a camera that an arm moves, or that moves freely. */
#ifndef TELEDIMOS_TESTS_VISUAL_SCENE_H
#define TELEDIMOS_TESTS_VISUAL_SCENE_H

#include "servo/visual_servo.h"
#include "tests/servo/servo_robots.h"

/* Normal distortion, 640 by 480. */
static inline td_camera lens(void)
{
    return (td_camera){.model = TD_CAMERA_BROWN5,
                       .width = 640,
                       .height = 480,
                       .parameter = {600, 602, 318, 241, -0.2, 0.05, 1e-3, -5e-4, 0}};
}

/* Where things are: links as td_servo_eye. */
typedef struct scene {
    td_servo_eye eye;
    td_pose link_from_target;
    int points;
    double point[TD_SERVO_MAX_POINTS][3]; /* of the target */
    double sigma_px;                      /* added */
} scene;

static inline void square_target(scene *s, double half)
{
    const double corner[4][3] = {{-half, -half, 0}, {half, -half, 0}, {half, half, 0}, {-half, half, 0}};
    memcpy(s->point, corner, sizeof corner);
    s->points = 4;
}

static inline td_pose pose_at(double x, double y, double z, double rx, double ry, double rz)
{
    const double omega[3] = {rx, ry, rz};
    td_pose p = {.t = {x, y, z}};
    td_rotation_exp(p.q, omega);
    return p;
}

static inline td_pose camera_from_target(const scene *s, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, s->eye.robot, q);
    const td_pose camera = td_pose_compose(at + s->eye.camera_link, &s->eye.link_from_camera),
                  target = td_pose_compose(at + s->eye.target_link, &s->link_from_target),
                  camera_from_root = td_pose_inverse(&camera);
    return td_pose_compose(&camera_from_root, &target);
}

/* What the camera shows of a target there: points in its image, in front of it and of the target's face. */
static inline td_servo_sight view_from(const scene *s, const td_pose *pose, td_random *random)
{
    td_servo_sight sight = {
        .kind = TD_SERVO_POINTS, .count = s->points, .pose_seen = true, .camera_from_target = *pose};
    for (int i = 0; i < s->points; i++) {
        td_servo_point *p = sight.point + i;
        double at[3];
        td_pose_transform(at, pose, s->point[i]);
        p->seen = td_camera_project(p->pixel, NULL, NULL, &s->eye.camera, at);
        for (int k = 0; k < 2 && random; k++) p->pixel[k] += s->sigma_px * td_random_normal(random);
        p->depth_m = at[2];
        p->sigma_px = s->sigma_px;
        p->seen = p->seen && p->pixel[0] >= 0 && p->pixel[0] <= s->eye.camera.width - 1 && p->pixel[1] >= 0 &&
                  p->pixel[1] <= s->eye.camera.height - 1;
    }
    return sight;
}

static inline td_servo_sight view_at(const scene *s, const double *q, td_random *random)
{
    const td_pose pose = camera_from_target(s, q);
    return view_from(s, &pose, random);
}

static inline bool whole_in_view(const td_servo_sight *sight, double least_m, double edge_px,
                                 const td_camera *c)
{
    for (int i = 0; i < sight->count; i++) {
        const td_servo_point *p = sight->point + i;
        if (!p->seen || p->depth_m < least_m || p->pixel[0] < edge_px || p->pixel[1] < edge_px ||
            p->pixel[0] > c->width - 1 - edge_px || p->pixel[1] > c->height - 1 - edge_px)
            return false;
    }
    return true;
}

/* The machine that the controllers are told of, tau w' = v - w, solved exactly over a period. */
static inline void pass_period(td_plant_state *s, const td_robot *robot, const double *v, double period_s,
                               double lag_s)
{
    const double rest = lag_s > 0 ? exp(-period_s / lag_s) : 0;
    for (int k = 0; k < robot->joint_count; k++) {
        s->q[k] += v[k] * period_s + (s->dq[k] - v[k]) * lag_s * (1 - rest);
        s->dq[k] = v[k] + (s->dq[k] - v[k]) * rest;
    }
    s->time_s += period_s;
}

#endif
