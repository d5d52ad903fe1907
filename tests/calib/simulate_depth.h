/* Simulated targets with depth: two planes, and one plane that a rail moves to known heights. */
#ifndef TELEDIMOS_TESTS_CALIB_SIMULATE_DEPTH_H
#define TELEDIMOS_TESTS_CALIB_SIMULATE_DEPTH_H

#include "tests/calib/simulate.h"

/* An open book of marks, its spine to the right of the first plane. The marks are too small for the centroid
 * of their image to be off the image of their centre. */
static inline td_target two_planes(void)
{
    const double open[6] = {0, 0.9, 0, 0, 0, 0}; /* the right page turned towards the camera */
    td_target t = {.kind = TD_TARGET_MARKS, .plane_count = 2, .diameter_m = 1e-4, .polarity = TD_MARK_DARK};
    t.plane[0] = (td_target_plane){6, 6, 0.02, td_pose_identity()};
    t.plane[1] = (td_target_plane){6, 6, 0.02, td_pose_exp(open)};
    t.plane[1].target_from_plane.t[0] = 0.12;
    return t;
}

/* Puts view `v` at height `height_m` of a rail that stands at `rig_from_target`. */
static inline void put_on_rail(td_observations *o, const simulation *s, size_t v,
                               const td_pose *rig_from_target, double height_m, double noise_px,
                               td_random *noise)
{
    o->height_m[v] = height_m;
    for (int k = 0; k < s->rig->count; k++) {
        td_detection *d = td_observations_get(o, v, k);
        for (size_t i = 0; i < d->count; i++) {
            double x[3];
            td_target_point(x, &s->target, i);
            x[2] -= height_m;
            td_pose_transform(x, rig_from_target, x);
            td_pose_transform(x, &s->rig->camera[k].camera_from_rig, x);
            assert_true(td_camera_project(d->point + 2 * i, NULL, NULL, &s->rig->camera[k].camera, x));
            for (int j = 0; j < 2; j++) d->point[2 * i + j] += noise_px * td_random_normal(noise);
            d->sigma[i] = noise_px;
        }
    }
}

/* Views `first` and after on one rail, 8 mm apart, that stands where the first pose of a scene is. */
static inline void put_rest_on_rail(td_observations *o, const simulation *s, uint64_t scene_seed,
                                    size_t first)
{
    td_random scene = td_random_seed(scene_seed, 11), noise = td_random_seed(77, 1);
    td_pose pose = simulated_pose(s, &scene);
    for (size_t v = first; v < o->view_count; v++)
        put_on_rail(o, s, v, &pose, 0.008 * (double)(v - first), 0.1, &noise);
}

/* The poses that simulate() gave its views. */
static inline void true_poses(td_pose *rig_from_target, const simulation *s, uint64_t scene_seed)
{
    td_random scene = td_random_seed(scene_seed, 11);
    for (size_t v = 0; v < s->views; v++) rig_from_target[v] = simulated_pose(s, &scene);
}

#endif
