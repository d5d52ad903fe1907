/* Simulated hand-eye data: a robot whose poses are off by independent noise and by a smooth field, and a
 * camera whose poses of the target are off by a correlated noise. */
#ifndef TELEDIMOS_TESTS_CALIB_HAND_EYE_SIMULATE_H
#define TELEDIMOS_TESTS_CALIB_HAND_EYE_SIMULATE_H

#include "calib/hand_eye.h"
#include "core/linalg.h"
#include "core/random.h"
#include "tests/check.h"

enum { MOST_VIEWS = 60, WAVES = 300 };

typedef struct robot_errors {
    double robot_rad, robot_m; /* independent, at the hand */
    double field_rad, field_m; /* smooth, in the base's axes */
    double length_m;           /* of the field, Matern 3/2 */
    double sight;              /* scale of the camera's noise; 0: none */
    double scale;              /* true size of the target over its given one; 0: 1 */
    double turn;               /* rad, largest turn of the hand; 0: 0.6 */
} robot_errors;

typedef struct hand_eye_scene {
    td_hand_eye_setup setup;
    td_pose x, z;
    size_t count;
    td_hand_eye_view view[MOST_VIEWS];
} hand_eye_scene;

/* A field of six components as a sum of cosines whose frequencies follow the spectrum of the Matern 3/2
 * covariance: Student's t with 3 degrees of freedom, over the length. */
typedef struct smooth_field {
    double frequency[6][WAVES][3], phase[6][WAVES];
} smooth_field;

static inline void draw_field(smooth_field *f, double length, td_random *random)
{
    for (int c = 0; c < 6; c++)
        for (int w = 0; w < WAVES; w++) {
            double chi = 0;
            for (int k = 0; k < 3; k++) {
                double n = td_random_normal(random);
                chi += n * n;
            }
            for (int k = 0; k < 3; k++)
                f->frequency[c][w][k] = td_random_normal(random) * sqrt(3 / chi) / length;
            f->phase[c][w] = 6.283185307179586 * td_random_uniform(random);
        }
}

static inline double field_at(const smooth_field *f, int c, const double p[3])
{
    double sum = 0;
    for (int w = 0; w < WAVES; w++)
        sum += cos(f->frequency[c][w][0] * p[0] + f->frequency[c][w][1] * p[1] +
                   f->frequency[c][w][2] * p[2] + f->phase[c][w]);
    return sum * sqrt(2.0 / WAVES);
}

/* Covariance of a flat target's pose seen at about 0.7 m: depth five times worse than across, and turns bound
 * to shifts. */
static inline void sight_covariance(double covariance[36], double factor[36], double scale)
{
    static const double sigma[6] = {3e-4, 3e-4, 8e-5, 4e-5, 4e-5, 2e-4};
    memset(factor, 0, 36 * sizeof *factor);
    for (int k = 0; k < 6; k++) factor[7 * k] = scale * sigma[k];
    factor[6 * 4 + 0] = scale * 2e-4; /* ty with rx */
    factor[6 * 3 + 1] = -scale * 2e-4;
    td_multiply_transposed(covariance, factor, factor, 6, 6, 6);
}

static inline td_pose posed(double rx, double ry, double rz, double x, double y, double z)
{
    const double turn[6] = {rx, ry, rz, 0, 0, 0};
    td_pose p = td_pose_exp(turn);
    p.t[0] = x;
    p.t[1] = y;
    p.t[2] = z;
    return p;
}

static inline void simulate_view(hand_eye_scene *s, size_t i, const robot_errors *e,
                                 const smooth_field *field, td_random *random)
{
    double turn = e->turn > 0 ? e->turn : 0.6, xi[6], d[6], factor[36];
    td_pose down = posed(3.0, 0.1, 0.05, 0.5, 0.1, 0.6);
    for (int k = 0; k < 6; k++) xi[k] = (k < 3 ? turn : 0.25) * (2 * td_random_uniform(random) - 1);
    td_pose lean = posed(xi[0], xi[1], xi[2], 0, 0, 0), hand = td_pose_compose(&down, &lean);
    for (int k = 0; k < 3; k++) hand.t[k] += xi[3 + k];
    td_pose seen = td_hand_eye_predict(s->setup, &s->x, &s->z, &hand);
    for (int k = 0; k < 6; k++)
        d[k] = (e->field_m > 0 || e->field_rad > 0)
                   ? (k < 3 ? e->field_rad : e->field_m) * field_at(field, k, hand.t)
                   : 0;
    td_pose turn_back = td_pose_inverse(&hand);
    double at_hand[6];
    td_pose_rotate(at_hand, &turn_back, d);
    td_pose_rotate(at_hand + 3, &turn_back, d + 3);
    for (int k = 0; k < 6; k++)
        at_hand[k] = -at_hand[k] - (k < 3 ? e->robot_rad : e->robot_m) * td_random_normal(random);
    td_pose off = td_pose_exp(at_hand);
    td_hand_eye_view *v = &s->view[i];
    snprintf(v->name, sizeof v->name, "%02zu", i);
    v->base_from_hand = td_pose_compose(&hand, &off);
    sight_covariance(v->covariance, factor, e->sight);
    double normal[6], noise[6];
    for (int k = 0; k < 6; k++) normal[k] = td_random_normal(random);
    td_multiply(noise, factor, normal, 6, 6, 1);
    v->rig_from_target = td_pose_perturb(&seen, noise);
    if (e->scale > 0)
        for (int k = 0; k < 3; k++) v->rig_from_target.t[k] /= e->scale;
}

static inline void simulate_hand_eye(hand_eye_scene *s, td_hand_eye_setup setup, size_t count,
                                     const robot_errors *e, uint64_t seed)
{
    td_random random = td_random_seed(seed, 7);
    smooth_field field = {0};
    *s = (hand_eye_scene){.setup = setup, .count = count};
    if (setup == TD_EYE_TO_HAND) {
        s->x = posed(-1.8, 0.9, -0.8, 1.2, 0.2, 0.5);
        s->z = posed(0.3, -0.2, 1.4, 0.02, -0.03, 0.08);
    } else {
        s->x = posed(0.05, -0.1, 1.5, 0.06, -0.03, 0.05);
        s->z = posed(3.1, 0.05, 0.3, 0.55, 0.05, 0.0);
    }
    if (e->field_m > 0 || e->field_rad > 0) draw_field(&field, e->length_m, &random);
    for (size_t i = 0; i < count; i++) simulate_view(s, i, e, &field, &random);
}

/* Errors of X, then Z, as pose.h's perturbation. */
static inline void hand_eye_error(double error[12], const td_hand_eye *r, const hand_eye_scene *s)
{
    td_pose back = td_pose_inverse(&s->x), off = td_pose_compose(&r->x, &back);
    td_pose_log(error, &off);
    back = td_pose_inverse(&s->z);
    off = td_pose_compose(&r->z, &back);
    td_pose_log(error + 6, &off);
}
#endif
