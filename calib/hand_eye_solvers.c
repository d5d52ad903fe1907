#include "calib/hand_eye_solvers.h"

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/first_estimate_internal.h"
#include "calib/hand_eye_solvers_internal.h"
#include "core/linalg.h"

static const double degree = 0.017453292519943295;

/* On real sets the sound solvers lie within 1.2 of the best, those that fail beyond 2.4: two stands between.
 * The floor keeps rounding apart from failure where the data are exact. */
static const double worst_over_best = 2, floor_mm = 1e-3;

const char *td_hand_eye_solver_name(td_hand_eye_solver solver)
{
    static const char *const names[] = {"tsai",       "park", "horaud", "andreff",
                                        "daniilidis", "shah", "li",     "visp"};
    return solver < TD_SOLVER_COUNT ? names[solver] : NULL;
}

/* Every setup is A_i X B_i = Z, with B_i = rig_from_target and A_i = base_from_hand; eye-to-hand is the same
 * with base and hand exchanged, A_i = hand_from_base. */
typedef struct motions {
    size_t count;
    td_pose *a, *b;                          /* (count) */
    size_t thinned;                          /* what the solvers see of them: */
    double *a_matrix, *a_inverse, *b_matrix; /* (thinned,16) */
} motions;

static void motions_free(motions *m)
{
    free(m->a);
    free(m->b);
    free(m->a_matrix);
    free(m->a_inverse);
    free(m->b_matrix);
}

static td_status motions_gather(motions *m, td_hand_eye_setup setup, const td_hand_eye_view *view,
                                size_t count, td_error *error)
{
    size_t n = count < TD_SOLVERS_MAX_VIEWS ? count : TD_SOLVERS_MAX_VIEWS;
    *m = (motions){.count = count,
                   .a = malloc(count * sizeof *m->a),
                   .b = malloc(count * sizeof *m->b),
                   .thinned = n,
                   .a_matrix = malloc(16 * n * sizeof(double)),
                   .a_inverse = malloc(16 * n * sizeof(double)),
                   .b_matrix = malloc(16 * n * sizeof(double))};
    if (!m->a || !m->b || !m->a_matrix || !m->a_inverse || !m->b_matrix) {
        motions_free(m);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", count);
    }
    for (size_t i = 0; i < count; i++) {
        m->a[i] = setup == TD_EYE_TO_HAND ? td_pose_inverse(&view[i].base_from_hand) : view[i].base_from_hand;
        m->b[i] = view[i].rig_from_target;
    }
    for (size_t k = 0; k < n; k++) {
        size_t i = n < 2 ? 0 : k * (count - 1) / (n - 1);
        td_pose inverse = td_pose_inverse(&m->a[i]);
        td_pose_matrix(m->a_matrix + 16 * k, &m->a[i]);
        td_pose_matrix(m->a_inverse + 16 * k, &inverse);
        td_pose_matrix(m->b_matrix + 16 * k, &m->b[i]);
    }
    return TD_OK;
}

static bool pose_is_finite(const td_pose *p)
{
    double sum = 0;
    for (int k = 0; k < 4; k++) sum += p->q[k];
    for (int k = 0; k < 3; k++) sum += p->t[k];
    return isfinite(sum);
}

static td_status check_views(td_hand_eye_setup setup, const td_hand_eye_view *view, size_t count,
                             td_error *error)
{
    if (setup >= TD_HAND_EYE_SETUP_COUNT || (count && !view))
        return td_fail(error, TD_ERROR_ARGUMENT, "hand-eye: no such setup, or no views");
    if (count < 3)
        return td_fail(
            error, TD_ERROR_DATA,
            "%zu views do not determine a hand-eye transform: at least 3, with turns about two axes", count);
    for (size_t i = 0; i < count; i++)
        if (!pose_is_finite(&view[i].base_from_hand) || !pose_is_finite(&view[i].rig_from_target))
            return td_fail(error, TD_ERROR_ARGUMENT, "view %s: its pose of the %s holds no number",
                           view[i].name, pose_is_finite(&view[i].base_from_hand) ? "target" : "robot");
    return TD_OK;
}

/* Two turns about axes that are not parallel are what a closed form needs (Tsai and Lenz 1989, section II).
 * The scatter matrix of the rotation vectors between views has two large eigenvalues then. */
static td_status check_turns(const motions *m, td_error *error)
{
    double s[9] = {0}, value[3];
    size_t pairs = 0;
    for (size_t i = 0; i < m->thinned; i++)
        for (size_t j = i + 1; j < m->thinned; j++, pairs++) {
            const double *p = m->a_matrix + 16 * i, *q = m->a_matrix + 16 * j;
            double r[9], w[3];
            for (int k = 0; k < 9; k++)
                r[k] = p[k / 3] * q[k % 3] + p[4 + k / 3] * q[4 + k % 3] + p[8 + k / 3] * q[8 + k % 3];
            td_pose between = td_pose_from_rotation(r, (const double[3]){0});
            td_rotation_log(w, between.q);
            for (int k = 0; k < 9; k++) s[k] += w[k / 3] * w[k % 3];
        }
    TD_TRY(td_eigen_symmetric(value, NULL, s, 3, error));
    if (sqrt(fmax(value[2], 0) / (double)pairs) < 1e-3)
        return td_fail(error, TD_ERROR_DATA,
                       "the hand does not turn between the views; turn it by 30 degrees and more about two "
                       "axes");
    if (sqrt(fmax(value[1], 0) / value[2]) < 0.01)
        return td_fail(
            error, TD_ERROR_DATA,
            "the hand turns about parallel axes only, which leaves the shift along them open; turn "
            "it about a second axis too");
    return TD_OK;
}

/* ---- mean and scatter of Z ---- */

static td_pose target_seen(const motions *m, size_t i, const td_pose *x)
{
    td_pose ax = td_pose_compose(&m->a[i], x);
    return td_pose_compose(&ax, &m->b[i]);
}

/* Mean of A_i X B_i: of the translations, and of the rotations as the eigenvector of the sum of q q^T of the
 * largest eigenvalue (Markley, Cheng, Crassidis and Oshman 2007), for which q and -q are the same. */
static td_status mean_over_views(td_pose *z, const motions *m, const td_pose *x, td_error *error)
{
    double sum[16] = {0}, t[3] = {0}, value[4], vector[16];
    for (size_t i = 0; i < m->count; i++) {
        td_pose p = target_seen(m, i, x);
        for (int k = 0; k < 16; k++) sum[k] += p.q[k / 4] * p.q[k % 4];
        for (int k = 0; k < 3; k++) t[k] += p.t[k] / (double)m->count;
    }
    TD_TRY(td_eigen_symmetric(value, vector, sum, 4, error));
    for (int k = 0; k < 4; k++) z->q[k] = vector[12] < 0 ? -vector[12 + k] : vector[12 + k];
    memcpy(z->t, t, sizeof t);
    return TD_OK;
}

static void measure_scatter(td_solver_score *score, const motions *m)
{
    double shift = 0, turn = 0, distance = 0, n = (double)m->count;
    td_pose inverse = td_pose_inverse(&score->z);
    for (size_t i = 0; i < m->count; i++) {
        td_pose p = target_seen(m, i, &score->x), d = td_pose_compose(&inverse, &p);
        double angle = td_pose_angle(&d), far = td_pose_distance(&d), away = td_pose_distance(&m->b[i]);
        turn += angle * angle / n;
        shift += far * far / n;
        distance += away * away / n;
    }
    score->scatter_mm = 1e3 * sqrt(shift);
    score->scatter_deg = sqrt(turn) / degree;
    score->scatter_all_mm = 1e3 * sqrt(shift + distance * turn);
}

/* ---- the solvers ---- */

static td_status run_visp(double x[16], const motions *m, td_error *error)
{
    /* Kept open: loading takes 0.25 s, and a leave-one-out asks once for each view. */
    void *module = dlopen(TD_VISP_MODULE, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
    if (!module) return td_fail(error, TD_ERROR_UNSUPPORTED, "not installed: %s", dlerror());
    td_visp_hand_eye_function *calibrate;
    *(void **)&calibrate = dlsym(module, TD_VISP_HAND_EYE_FUNCTION);
    td_status status = calibrate ? calibrate(x, m->a_matrix, m->b_matrix, m->thinned, error)
                                 : td_fail(error, TD_ERROR_UNSUPPORTED, "not installed: %s has no %s",
                                           TD_VISP_MODULE, TD_VISP_HAND_EYE_FUNCTION);
    dlclose(module);
    return status;
}

/* A pose of a solver's matrix, if it is one: a rotation to 1e-3. */
static td_status accept(td_pose *pose, const double matrix[16], td_error *error)
{
    double r[9], square[9], nearest[9], t[3];
    for (int k = 0; k < 9; k++) r[k] = matrix[4 * (k / 3) + k % 3];
    for (int k = 0; k < 3; k++) t[k] = matrix[4 * k + 3];
    for (int k = 0; k < 12; k++)
        if (!isfinite(matrix[k])) return td_fail(error, TD_ERROR_DATA, "no number");
    td_multiply_transposed(square, r, r, 3, 3, 3);
    double off = 0;
    for (int k = 0; k < 9; k++) off = fmax(off, fabs(square[k] - (k % 4 == 0)));
    double determinant = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                         r[2] * (r[3] * r[7] - r[4] * r[6]);
    if (off > 1e-3 || determinant < 0)
        return td_fail(error, TD_ERROR_DATA, "no rotation (determinant %.3g)", determinant);
    TD_TRY(td_nearest_rotation(nearest, r, error));
    *pose = td_pose_from_rotation(nearest, t);
    return TD_OK;
}

static td_status solve_x(td_solver_score *score, const motions *m, td_error *error)
{
    double x[16];
    if (score->solver == TD_SOLVER_VISP)
        TD_TRY(run_visp(x, m, error));
    else
        TD_TRY(td_opencv_hand_eye(x, score->solver, m->a_matrix, m->b_matrix, m->thinned, error));
    TD_TRY(accept(&score->x, x, error));
    return mean_over_views(&score->z, m, &score->x, error);
}

/* A_i X B_i = Z reads B_i Z^-1 = X^-1 A_i^-1: OpenCV's world is our target, its gripper our A's. */
static td_status solve_x_and_z(td_solver_score *score, const motions *m, td_error *error)
{
    double z_inverse[16], x_inverse[16];
    td_pose p;
    TD_TRY(td_opencv_robot_world(z_inverse, x_inverse, score->solver, m->b_matrix, m->a_inverse, m->thinned,
                                 error));
    TD_TRY(accept(&p, x_inverse, error));
    score->x = td_pose_inverse(&p);
    TD_TRY(accept(&p, z_inverse, error));
    score->z = td_pose_inverse(&p);
    return TD_OK;
}

static void run_one(td_solver_score *score, td_hand_eye_solver solver, const motions *m)
{
    td_error error = {0};
    *score = (td_solver_score){.solver = solver,
                               .x = td_pose_identity(),
                               .z = td_pose_identity(),
                               .rms_px = NAN,
                               .scatter_mm = NAN,
                               .scatter_deg = NAN,
                               .scatter_all_mm = NAN};
    bool both = solver == TD_SOLVER_SHAH || solver == TD_SOLVER_LI;
    score->failed = (both ? solve_x_and_z(score, m, &error) : solve_x(score, m, &error)) != TD_OK;
    if (score->failed) {
        snprintf(score->why, sizeof score->why, "%.159s", error.message);
        score->x = score->z = td_pose_identity();
        return;
    }
    measure_scatter(score, m);
    score->failed = !isfinite(score->scatter_all_mm);
    if (score->failed) snprintf(score->why, sizeof score->why, "no number");
}

int td_hand_eye_solvers_best(const td_solver_score score[TD_SOLVER_COUNT])
{
    int best = -1;
    for (int i = 0; i < TD_SOLVER_COUNT; i++)
        if (!score[i].failed && (best < 0 || score[i].scatter_all_mm < score[best].scatter_all_mm)) best = i;
    return best;
}

static void mark_scattered(td_solver_score score[TD_SOLVER_COUNT])
{
    int best = td_hand_eye_solvers_best(score);
    if (best < 0) return;
    const td_solver_score *b = &score[best];
    for (int i = 0; i < TD_SOLVER_COUNT; i++) {
        td_solver_score *s = &score[i];
        if (s->failed || s->scatter_all_mm <= worst_over_best * b->scatter_all_mm + floor_mm) continue;
        s->failed = true;
        snprintf(s->why, sizeof s->why,
                 "%.3g degrees and %.3g mm of scatter: %s leaves %.3g degrees and %.3g mm", s->scatter_deg,
                 s->scatter_mm, td_hand_eye_solver_name(b->solver), b->scatter_deg, b->scatter_mm);
    }
}

td_status td_hand_eye_solvers_run(td_solver_score score[TD_SOLVER_COUNT], td_hand_eye_setup setup,
                                  const td_hand_eye_view *view, size_t count, td_error *error)
{
    TD_TRY(check_views(setup, view, count, error));
    motions m;
    TD_TRY(motions_gather(&m, setup, view, count, error));
    td_status status = check_turns(&m, error);
    if (status == TD_OK) {
        for (td_hand_eye_solver s = 0; s < TD_SOLVER_COUNT; s++) run_one(&score[s], s, &m);
        mark_scattered(score);
    }
    motions_free(&m);
    return status;
}
