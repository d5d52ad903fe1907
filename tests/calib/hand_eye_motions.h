/* Simulated views of a hand-eye calibration: truth, and noise where it belongs. */
#ifndef TELEDIMOS_TESTS_CALIB_HAND_EYE_MOTIONS_H
#define TELEDIMOS_TESTS_CALIB_HAND_EYE_MOTIONS_H

#include "calib/hand_eye.h"
#include "core/random.h"
#include "tests/check.h"

typedef struct hand_eye_truth {
    td_hand_eye_setup setup;
    td_pose x, z;
} hand_eye_truth;

static inline td_pose random_pose(td_random *random, double turn, double shift)
{
    double xi[6];
    for (int k = 0; k < 3; k++) {
        xi[k] = turn * (2 * td_random_uniform(random) - 1);
        xi[3 + k] = 0;
    }
    td_pose p = td_pose_exp(xi);
    for (int k = 0; k < 3; k++) p.t[k] = shift * (2 * td_random_uniform(random) - 1);
    return p;
}

static inline hand_eye_truth random_truth(td_random *random, td_hand_eye_setup setup)
{
    hand_eye_truth truth = {.setup = setup};
    truth.x = random_pose(random, 1.5, setup == TD_EYE_TO_HAND ? 0.8 : 0.1);
    truth.z = random_pose(random, 1.5, setup == TD_EYE_TO_HAND ? 0.1 : 0.8);
    return truth;
}

/* rig_from_target of a hand's pose, by the equations at the head of hand_eye.h. */
static inline td_pose true_target(const hand_eye_truth *truth, const td_pose *base_from_hand)
{
    td_pose to_rig, seen;
    if (truth->setup == TD_EYE_TO_HAND) {
        td_pose rig_from_base = td_pose_inverse(&truth->x);
        to_rig = td_pose_compose(&rig_from_base, base_from_hand);
    } else {
        td_pose base_from_rig = td_pose_compose(base_from_hand, &truth->x);
        to_rig = td_pose_inverse(&base_from_rig);
    }
    seen = td_pose_compose(&to_rig, &truth->z);
    return seen;
}

/* base_from_hand exp(noise): at the hand. */
static inline td_pose with_noise(const td_pose *pose, td_random *random, double rad, double m)
{
    double xi[6];
    for (int k = 0; k < 6; k++) xi[k] = (k < 3 ? rad : m) * td_random_normal(random);
    td_pose d = td_pose_exp(xi);
    return td_pose_compose(pose, &d);
}

/* Hand poses within +-turn about each axis and half a metre, and what the cameras then see. */
static inline void simulate_views(td_hand_eye_view *view, size_t count, const hand_eye_truth *truth,
                                  td_random *random, double turn, double noise_rad, double noise_m)
{
    td_pose centre = random_pose(random, 1.5, 0.5);
    for (size_t i = 0; i < count; i++) {
        view[i] = (td_hand_eye_view){0};
        snprintf(view[i].name, sizeof view[i].name, "view%zu", i + 1);
        td_pose step = random_pose(random, turn, 0.25), hand = td_pose_compose(&centre, &step);
        td_pose seen = true_target(truth, &hand);
        view[i].base_from_hand = with_noise(&hand, random, noise_rad, noise_m);
        view[i].rig_from_target = with_noise(&seen, random, noise_rad, noise_m);
        for (int k = 0; k < 6; k++) view[i].covariance[7 * k] = k < 3 ? 1e-6 : 1e-8;
    }
}

static inline void check_pose_near(const td_pose *a, const td_pose *b, double rad, double m)
{
    td_pose inverse = td_pose_inverse(a), d = td_pose_compose(&inverse, b);
    check_near(td_pose_angle(&d), 0, rad);
    check_near(td_pose_distance(&d), 0, m);
}

#endif
