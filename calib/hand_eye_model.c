/* The one equation of hand-eye calibration, its residual at the hand and its derivatives. */
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

const char *td_hand_eye_setup_name(td_hand_eye_setup setup)
{
    static const char *const name[TD_HAND_EYE_SETUP_COUNT] = {"eye-in-hand", "eye-to-hand", "robot-world"};
    return (int)setup >= 0 && setup < TD_HAND_EYE_SETUP_COUNT ? name[setup] : NULL;
}

const char *td_hand_eye_x_name(td_hand_eye_setup setup)
{
    return setup == TD_EYE_TO_HAND ? "base_from_rig" : "hand_from_rig";
}

const char *td_hand_eye_z_name(td_hand_eye_setup setup)
{
    return setup == TD_EYE_TO_HAND ? "hand_from_target" : "base_from_target";
}

td_pose td_hand_eye_predict(td_hand_eye_setup setup, const td_pose *x, const td_pose *z,
                            const td_pose *base_from_hand)
{
    td_pose back = td_pose_inverse(x);
    td_pose hand = setup == TD_EYE_TO_HAND ? *base_from_hand : td_pose_inverse(base_from_hand);
    td_pose rig_from_other = td_pose_compose(&back, &hand);
    return td_pose_compose(&rig_from_other, z);
}

void td_he_canonical(td_he_view *out, const td_hand_eye_view *view, size_t count, td_hand_eye_setup setup)
{
    for (size_t i = 0; i < count; i++) {
        out[i].index = i;
        out[i].hand = view[i].base_from_hand;
        if (setup == TD_EYE_TO_HAND) {
            out[i].sight = td_pose_inverse(&view[i].rig_from_target);
            td_pose_inverse_covariance(out[i].cov, &view[i].rig_from_target, view[i].covariance);
        } else {
            out[i].sight = view[i].rig_from_target;
            memcpy(out[i].cov, view[i].covariance, sizeof out[i].cov);
        }
    }
}

/* The sight at the state's scale, and base_from_hand as it implies: far sight^-1 near^-1. */
static td_pose implied_hand(const td_he_view *view, const td_he_state *state, td_pose *sight)
{
    *sight = view->sight;
    for (int i = 0; i < 3; i++) sight->t[i] *= state->scale;
    td_pose back = td_pose_inverse(sight), near_back = td_pose_inverse(&state->near);
    td_pose base_from_near = td_pose_compose(&state->far, &back);
    return td_pose_compose(&base_from_near, &near_back);
}

void td_he_residual(double d[6], const td_he_view *view, const td_he_state *state)
{
    td_pose sight, implied = implied_hand(view, state, &sight), said = td_pose_inverse(&view->hand);
    td_pose off = td_pose_compose(&said, &implied);
    td_pose_log(d, &off);
}

/* out (6,6) = blockdiag(r, r) a. */
static void rotate_rows(double out[36], const double r[9], const double a[36])
{
    for (int half = 0; half < 2; half++)
        for (int i = 0; i < 3; i++)
            for (int c = 0; c < 6; c++) {
                double sum = 0;
                for (int k = 0; k < 3; k++) sum += r[3 * i + k] * a[6 * (3 * half + k) + c];
                out[6 * (3 * half + i) + c] = sum;
            }
}

/* With H = far sight^-1 near^-1 and d = log(said^-1 H), to first order
 *     near <- Exp(a) near:     H <- H Exp(-a)
 *     far <- Exp(b) far:       H <- H Exp(Ad(H^-1) b)
 *     sight <- Exp(n) sight:   H <- H Exp(-Ad(near) n)
 * and d <- d + Jr^-1(d) (the exponent), Jr(d) = Jl(-d). The rows are then turned to the base's axes. */
void td_he_linearise_view(double g[6], double *j, double s[36], const td_he_view *view,
                          const td_he_state *state, int p)
{
    td_pose sight, implied = implied_hand(view, state, &sight), implied_back = td_pose_inverse(&implied);
    double d[6], minus[6], inverse[36], turned[36], r[9], adjoint[36], product[36];
    td_he_residual(d, view, state);
    for (int i = 0; i < 6; i++) minus[i] = -d[i];
    td_pose_left_jacobian_inverse(inverse, minus);
    td_pose_rotation(r, &view->hand);
    rotate_rows(turned, r, inverse);
    for (int half = 0; half < 2; half++)
        for (int i = 0; i < 3; i++) {
            g[3 * half + i] = 0;
            for (int k = 0; k < 3; k++) g[3 * half + i] += r[3 * i + k] * d[3 * half + k];
        }
    td_pose_adjoint(adjoint, &implied_back);
    td_multiply(product, turned, adjoint, 6, 6, 6);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 6; k++) {
            j[i * p + k] = -turned[6 * i + k];
            j[i * p + 6 + k] = product[6 * i + k];
        }
    td_pose_adjoint(adjoint, &state->near);
    td_multiply(product, turned, adjoint, 6, 6, 6);
    if (p > 12)
        for (int i = 0; i < 6; i++) {
            double sum = 0;
            for (int k = 0; k < 3; k++) sum -= product[6 * i + 3 + k] * view->sight.t[k];
            j[i * p + 12] = sum;
        }
    double half[36];
    td_multiply(half, product, view->cov, 6, 6, 6);
    td_multiply_transposed(s, half, product, 6, 6, 6);
}

td_status td_he_linear_new(td_he_linear *linear, size_t n, int p, td_error *error)
{
    *linear = (td_he_linear){.n = n, .p = p};
    size_t rows = 6 * n;
    double *all = calloc(rows + rows * (size_t)p + 36 * n + 3 * n, sizeof *all);
    if (!all) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", n);
    linear->g = all;
    linear->j = all + rows;
    linear->s = linear->j + rows * (size_t)p;
    linear->at = linear->s + 36 * n;
    return TD_OK;
}

void td_he_linear_free(td_he_linear *linear)
{
    free(linear->g);
    *linear = (td_he_linear){0};
}

void td_he_linearise(td_he_linear *linear, const td_he_view *view, const td_he_state *state)
{
    for (size_t i = 0; i < linear->n; i++) {
        td_he_linearise_view(linear->g + 6 * i, linear->j + 6 * i * (size_t)linear->p, linear->s + 36 * i,
                             &view[i], state, linear->p);
        memcpy(linear->at + 3 * i, view[i].hand.t, 3 * sizeof(double));
    }
}

void td_he_move(td_he_state *state, const double *beta, int p)
{
    state->near = td_pose_perturb(&state->near, beta);
    state->far = td_pose_perturb(&state->far, beta + 6);
    if (p > 12) state->scale += beta[12];
}
