#include "calib/rig_compare.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/significance_internal.h"
#include "core/linalg.h"

#define DEGREES 57.29577951308232
/* Directions of a difference whose sigma is below this share of the largest are left out of a test on
 * projections: there second-order terms of the others would be judged. */
#define LEAST_SIGMA 0.03
#define LEAST_PX 1e-3          /* no projection is known better than this */
#define LEAST_EIGENVALUE 1e-11 /* of a correlation matrix */
enum {
    GRID = TD_COMPARE_ROWS * TD_COMPARE_COLUMNS,
    FIT_STEPS = 30,
    MOST = TD_CAMERA_MAX_PARAMETERS + 6 /* parameters of a camera with its pose */
};

/* ---- the cameras that both rigs have ---- */

/* One rig's cameras in the common order, poses relative to the first of them, and their joint covariance: of
 * each camera its parameters, then its pose (none for the first). */
typedef struct common_rig {
    int count;
    const td_camera *camera[TD_RIG_MAX_CAMERAS];
    td_pose pose[TD_RIG_MAX_CAMERAS]; /* from the first */
    size_t first[TD_RIG_MAX_CAMERAS], n;
    double *covariance; /* (n,n); NULL: unknown */
} common_rig;

static size_t lens_count(const common_rig *r, int c)
{
    return (size_t)td_camera_parameter_count(r->camera[c]->model);
}

/* Pose k relative to the first: P = P_k P_0^-1, perturbed by xi_k - Ad(P) xi_0. */
static td_status common_make(common_rig *r, const td_rig *rig, const int *index, int count, td_error *error)
{
    *r = (common_rig){.count = count};
    td_pose back = td_pose_inverse(&rig->camera[index[0]].camera_from_rig);
    size_t all = td_rig_parameter_count(rig);
    for (int c = 0; c < count; c++) {
        r->camera[c] = &rig->camera[index[c]].camera;
        r->pose[c] = td_pose_compose(&rig->camera[index[c]].camera_from_rig, &back);
        r->first[c] = r->n;
        r->n += lens_count(r, c) + (c ? 6 : 0);
    }
    if (!rig->covariance) return TD_OK;
    double *map = calloc(r->n * all, sizeof *map);
    r->covariance = calloc(r->n * r->n, sizeof *r->covariance);
    td_status status =
        map && r->covariance ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", r->n);
    size_t base = td_rig_parameter_offset(rig, index[0]) + lens_count(r, 0);
    for (int c = 0; c < count && status == TD_OK; c++) {
        size_t from = td_rig_parameter_offset(rig, index[c]), lens = lens_count(r, c);
        double ad[36];
        for (size_t k = 0; k < lens + (c ? 6 : 0); k++) map[(r->first[c] + k) * all + from + k] = 1;
        td_pose_adjoint(ad, &r->pose[c]);
        for (size_t k = 0; k < 36 && c; k++) map[(r->first[c] + lens + k / 6) * all + base + k % 6] -= ad[k];
    }
    if (status == TD_OK) status = td_sandwich(r->covariance, map, rig->covariance, r->n, all, error);
    free(map);
    return status;
}

/* By name; by order when no name is shared. */
static int match(int index[2][TD_RIG_MAX_CAMERAS], const td_rig *a, const td_rig *b)
{
    int count = 0;
    for (int c = 0; c < a->count; c++) {
        int k = td_rig_find(b, a->camera[c].name);
        if (k < 0) continue;
        index[0][count] = c;
        index[1][count++] = k;
    }
    if (count) return count;
    for (; count < a->count && count < b->count; count++) index[0][count] = index[1][count] = count;
    return count;
}

/* ---- one camera's projections ---- */

/* Differences over the grid after the best common motion of the frame, and their derivatives. */
typedef struct field {
    td_pose b_from_a;
    size_t points, lens[2];
    int cell[GRID];
    double r[2 * GRID];
    double *by;     /* (2 points, lens[0] + lens[1]) by both cameras' parameters once the motion follows */
    double *follow; /* (6, lens[0] + lens[1]) the motion follows by minus this */
    double weight[GRID]; /* of each cell in the fit of the motion */
    int freedom;         /* of the motion: 3 or 6 */
    double square_mm;
} field;

static void field_free(field *f)
{
    free(f->by);
    free(f->follow);
}

static void grid_pixel(double pixel[2], const td_camera *camera, int cell)
{
    pixel[0] = (cell % TD_COMPARE_COLUMNS + 0.5) * camera->width / TD_COMPARE_COLUMNS - 0.5;
    pixel[1] = ((cell / TD_COMPARE_COLUMNS) + 0.5) * camera->height / TD_COMPARE_ROWS - 0.5;
}

/* A pixel's point through a's camera, the motion and b's camera: difference, by motion, by both lenses. */
typedef struct grid_row {
    double r[2], motion[2][6], lens[2][2 * TD_CAMERA_MAX_PARAMETERS];
} grid_row;

static bool grid_make(grid_row *row, const td_camera *a, const td_camera *b, const td_pose *b_from_a,
                      double distance, int cell, size_t freedom)
{
    double pixel[2], ray[3], by_a[3 * TD_CAMERA_MAX_PARAMETERS], x[3], u[2], d_point[6],
        by_b[2 * TD_CAMERA_MAX_PARAMETERS], move[18], rotation[9], turned[6], full[12],
        through[2 * TD_CAMERA_MAX_PARAMETERS];
    size_t na = (size_t)td_camera_parameter_count(a->model), nb = (size_t)td_camera_parameter_count(b->model);
    double far = isinf(distance) ? 1 : distance;
    grid_pixel(pixel, a, cell);
    if (!td_camera_unproject(ray, NULL, by_a, a, pixel)) return false;
    for (int k = 0; k < 3; k++) x[k] = far * ray[k];
    td_pose_transform(x, b_from_a, x);
    if (!td_camera_project(u, d_point, by_b, b, x)) return false;
    for (int k = 0; k < 2; k++) row->r[k] = u[k] - pixel[k];
    td_pose_transform_jacobian(move, x);
    td_multiply(full, d_point, move, 2, 3, 6);
    for (size_t e = 0; e < 2; e++)
        for (size_t k = 0; k < 6; k++) row->motion[e][k] = k < freedom ? full[6 * e + k] : 0;
    td_pose_rotation(rotation, b_from_a);
    td_multiply(turned, d_point, rotation, 2, 3, 3);
    td_multiply(through, turned, by_a, 2, 3, na);
    for (size_t e = 0; e < 2; e++) {
        for (size_t k = 0; k < na; k++) row->lens[e][k] = far * through[e * na + k];
        for (size_t k = 0; k < nb; k++) row->lens[e][na + k] = by_b[e * nb + k];
    }
    return true;
}

/* Normal equations of the motion, and their right sides: the residual, and each lens parameter. Cells count
 * by what is known of them (as in mrcal's "projection diff"): else corners that no view reached would turn
 * all. */
static bool motion_normal(field *f, double inverse[36], double *right, const td_camera *a, const td_camera *b,
                          double distance)
{
    size_t freedom = (size_t)f->freedom, n = f->lens[0] + f->lens[1];
    double h[36] = {0};
    grid_row row;
    memset(right, 0, 6 * (n + 1) * sizeof *right);
    f->points = 0;
    for (int cell = 0; cell < GRID; cell++) {
        if (!grid_make(&row, a, b, &f->b_from_a, distance, cell, freedom)) continue;
        f->cell[f->points] = cell;
        double weight = f->weight[cell];
        for (size_t e = 0; e < 2; e++) {
            f->r[2 * f->points + e] = row.r[e];
            for (size_t k = 0; k < freedom; k++) {
                for (size_t q = 0; q < freedom; q++)
                    h[k * freedom + q] += weight * row.motion[e][k] * row.motion[e][q];
                for (size_t q = 0; q < n; q++)
                    right[k * (n + 1) + q] += weight * row.motion[e][k] * row.lens[e][q];
                right[k * (n + 1) + n] += weight * row.motion[e][k] * row.r[e];
            }
        }
        f->points++;
    }
    return f->points >= 8 && td_invert_spd(inverse, h, freedom, NULL) == TD_OK;
}

/* Millimetres at the distance: where b sees the pixel against where a does. */
static double millimetres(const field *f, const td_camera *a, const td_camera *b, double distance,
                          size_t point)
{
    double pixel[2], ray_a[3], ray_b[3], sum = 0, length = 0;
    grid_pixel(pixel, a, f->cell[point]);
    if (!td_camera_unproject(ray_a, NULL, NULL, a, pixel) ||
        !td_camera_unproject(ray_b, NULL, NULL, b, pixel))
        return NAN;
    for (int k = 0; k < 3; k++) ray_a[k] *= distance;
    td_pose_transform(ray_a, &f->b_from_a, ray_a);
    for (int k = 0; k < 3; k++) length += ray_a[k] * ray_a[k];
    for (int k = 0; k < 3; k++) sum += pow(ray_a[k] - sqrt(length) * ray_b[k], 2);
    return 1e6 * sum;
}

static td_status field_init(field *f, const td_camera *a, const td_camera *b, double distance,
                            td_error *error)
{
    *f = (field){.b_from_a = td_pose_identity(), .freedom = isinf(distance) ? 3 : 6};
    f->lens[0] = (size_t)td_camera_parameter_count(a->model);
    f->lens[1] = (size_t)td_camera_parameter_count(b->model);
    size_t n = f->lens[0] + f->lens[1];
    for (int i = 0; i < GRID; i++) f->weight[i] = 1;
    f->by = calloc(2 * GRID * n, sizeof *f->by);
    f->follow = calloc(6 * n, sizeof *f->follow);
    return f->by && f->follow ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

/* Finds the motion, and how everything depends on the lenses when it follows. */
static td_status field_fit(field *f, const td_camera *a, const td_camera *b, double distance, td_error *error)
{
    size_t n = f->lens[0] + f->lens[1], freedom = (size_t)f->freedom;
    double inverse[36], *right = malloc(6 * (n + 1) * sizeof *right);
    bool good = right != NULL;
    if (!good) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    memset(f->follow, 0, 6 * n * sizeof *f->follow);
    f->square_mm = 0;
    for (int step = 0; step < FIT_STEPS && good; step++) {
        double xi[6] = {0}, length = 0;
        good = motion_normal(f, inverse, right, a, b, distance);
        for (size_t k = 0; k < freedom && good; k++) {
            for (size_t q = 0; q < freedom; q++) xi[k] -= inverse[k * freedom + q] * right[q * (n + 1) + n];
            length += xi[k] * xi[k];
        }
        if (!good || length < 1e-26) break;
        f->b_from_a = td_pose_perturb(&f->b_from_a, xi);
    }
    for (size_t k = 0; k < freedom && good; k++)
        for (size_t q = 0; q < n; q++)
            for (size_t e = 0; e < freedom; e++)
                f->follow[k * n + q] += inverse[k * freedom + e] * right[e * (n + 1) + q];
    grid_row row;
    for (size_t i = 0; i < f->points && good; i++) {
        grid_make(&row, a, b, &f->b_from_a, distance, f->cell[i], freedom);
        for (size_t e = 0; e < 2; e++)
            for (size_t q = 0; q < n; q++) {
                f->by[(2 * i + e) * n + q] = row.lens[e][q];
                for (size_t k = 0; k < freedom; k++)
                    f->by[(2 * i + e) * n + q] -= row.motion[e][k] * f->follow[k * n + q];
            }
        f->square_mm += isinf(distance) ? NAN : millimetres(f, a, b, distance, i);
    }
    free(right);
    return good ? TD_OK : TD_ERROR_DATA;
}

/* ---- tests ---- */

/* chi2 of a difference y = J x + nothing else, J (rows,n), x of covariance s: with s = S S^T and F = J S the
 * eigenvectors v of F^T F give (v^T F^T y)^2 / lambda^2, over eigenvalues that are not rounding. */
static td_status judge_linear(double *chi2, int *degrees, const double *y, const double *j, const double *s,
                              size_t rows, size_t n, double least, td_error *error)
{
    *chi2 = 0;
    *degrees = 0;
    double *work = calloc(4 * n * n + 3 * n + rows * n, sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    double *root = work, *vector = root + n * n, *h = vector + n * n, *unused = h + n * n,
           *value = unused + n * n, *scale = value + n, *along = scale + n, *f = along + n;
    /* S from the eigenvectors of the correlation matrix. */
    for (size_t i = 0; i < n; i++) scale[i] = sqrt(fmax(s[i * (n + 1)], 0));
    for (size_t i = 0; i < n * n; i++)
        h[i] = scale[i / n] > 0 && scale[i % n] > 0 ? s[i] / (scale[i / n] * scale[i % n]) : 0;
    td_status status = td_eigen_symmetric(value, vector, h, n, error);
    for (size_t i = 0; i < n && status == TD_OK; i++)
        for (size_t q = 0; q < n; q++)
            root[i * n + q] = scale[i] * vector[q * n + i] * sqrt(value[q] > LEAST_EIGENVALUE ? value[q] : 0);
    td_multiply(f, j, root, rows, n, n);
    memset(h, 0, n * n * sizeof *h);
    for (size_t r = 0; r < rows; r++)
        for (size_t i = 0; i < n; i++) {
            along[i] += f[r * n + i] * y[r];
            for (size_t k = 0; k < n; k++) h[i * n + k] += f[r * n + i] * f[r * n + k];
        }
    if (status == TD_OK) status = td_eigen_symmetric(value, vector, h, n, error);
    for (size_t q = 0; q < n && status == TD_OK; q++) {
        double part = 0;
        if (!(value[q] > least * least * value[n - 1]) || !(value[q] > 0)) continue;
        for (size_t i = 0; i < n; i++) part += vector[q * n + i] * along[i];
        *chi2 += part * part / (value[q] * value[q]);
        ++*degrees;
    }
    free(work);
    return status;
}

/* delta^T s^-1 delta over the directions that have variance. */
static td_status judge_direct(double *chi2, int *degrees, const double *delta, const double *s, size_t n,
                              td_error *error)
{
    *chi2 = 0;
    *degrees = 0;
    double *work = calloc(2 * n * n + 2 * n, sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    double *h = work, *vector = h + n * n, *value = vector + n * n, *scale = value + n;
    for (size_t i = 0; i < n; i++) scale[i] = sqrt(fmax(s[i * (n + 1)], 0));
    for (size_t i = 0; i < n * n; i++)
        h[i] = scale[i / n] > 0 && scale[i % n] > 0 ? s[i] / (scale[i / n] * scale[i % n]) : 0;
    td_status status = td_eigen_symmetric(value, vector, h, n, error);
    for (size_t q = 0; q < n && status == TD_OK; q++) {
        double part = 0;
        if (!(value[q] > LEAST_EIGENVALUE)) continue;
        for (size_t i = 0; i < n; i++) part += scale[i] > 0 ? vector[q * n + i] * delta[i] / scale[i] : 0;
        *chi2 += part * part / value[q];
        ++*degrees;
    }
    free(work);
    return status;
}

/* ---- the comparison ---- */

typedef struct comparison {
    common_rig rig[2];
    field *field; /* (count) */
    double distance;
} comparison;

/* Covariance of both lenses, (n,n). */
static void lens_covariance(double *s, const comparison *w, int c)
{
    const field *f = &w->field[c];
    size_t n = f->lens[0] + f->lens[1];
    memset(s, 0, n * n * sizeof *s);
    for (size_t side = 0; side < 2; side++) {
        const common_rig *r = &w->rig[side];
        size_t at = side ? f->lens[0] : 0;
        for (size_t i = 0; i < f->lens[side]; i++)
            for (size_t k = 0; k < f->lens[side]; k++)
                s[(at + i) * n + at + k] = r->covariance[(r->first[c] + i) * r->n + r->first[c] + k];
    }
}

/* Expected square of a point's difference. */
static double expected_square(const field *f, const double *s, size_t point)
{
    size_t n = f->lens[0] + f->lens[1];
    double sum = 0;
    for (size_t e = 0; e < 2; e++) {
        const double *by = f->by + (2 * point + e) * n;
        for (size_t p = 0; p < n; p++)
            for (size_t q = 0; q < n; q++) sum += by[p] * s[p * n + q] * by[q];
    }
    return fmax(sum, 0);
}

/* Equal models: the lens parameters themselves. Different ones: the projections, each in its own sigmas. */
static td_status judge_camera(td_compared_camera *out, const comparison *w, int c, const double *s,
                              td_error *error)
{
    const field *f = &w->field[c];
    const td_camera *a = w->rig[0].camera[c], *b = w->rig[1].camera[c];
    size_t n = f->lens[0] + f->lens[1], rows = 2 * f->points;
    double delta[TD_CAMERA_MAX_PARAMETERS], sum[TD_CAMERA_MAX_PARAMETERS * TD_CAMERA_MAX_PARAMETERS];
    if (a->model == b->model) {
        size_t lens = f->lens[0];
        for (size_t i = 0; i < lens; i++) {
            delta[i] = b->parameter[i] - a->parameter[i];
            for (size_t k = 0; k < lens; k++) sum[i * lens + k] = s[i * n + k] + s[(lens + i) * n + lens + k];
        }
        TD_TRY(judge_direct(&out->chi2, &out->degrees, delta, sum, lens, error));
    } else {
        double *y = malloc((rows + rows * n) * sizeof *y), *j = y + rows;
        if (!y) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu projections", rows);
        for (size_t i = 0; i < rows; i++) {
            double root = sqrt(f->weight[f->cell[i / 2]]);
            y[i] = root * f->r[i];
            for (size_t k = 0; k < n; k++) j[i * n + k] = root * f->by[i * n + k];
        }
        td_status status = judge_linear(&out->chi2, &out->degrees, y, j, s, rows, n, LEAST_SIGMA, error);
        free(y);
        if (status != TD_OK) return status;
    }
    out->p_value = td_chi2_tail(out->chi2, out->degrees);
    return TD_OK;
}

static void fill_field(td_compared_camera *out, const field *f, double distance)
{
    double square = 0;
    td_pose a_from_b = td_pose_inverse(&f->b_from_a);
    for (int i = 0; i < GRID; i++)
        out->difference_px[i][0] = out->difference_px[i][1] = out->expected_px[i] = NAN;
    for (size_t i = 0; i < f->points; i++) {
        double *d = out->difference_px[f->cell[i]], length = hypot(f->r[2 * i], f->r[2 * i + 1]);
        d[0] = f->r[2 * i], d[1] = f->r[2 * i + 1];
        out->most_px = fmax(out->most_px, length);
        square += length * length;
    }
    out->distance_m = distance;
    out->rms_px = sqrt(square / (double)f->points);
    out->rms_mm = sqrt(f->square_mm / (double)f->points);
    td_rotation_log(out->rotation_rad, a_from_b.q);
    memcpy(out->translation_m, a_from_b.t, sizeof a_from_b.t);
}

static td_status compare_camera(td_compared_camera *out, comparison *w, int c, td_error *error)
{
    const td_camera *a = w->rig[0].camera[c], *b = w->rig[1].camera[c];
    field *f = &w->field[c];
    double s[4 * TD_CAMERA_MAX_PARAMETERS * TD_CAMERA_MAX_PARAMETERS], sum = 0;
    bool known = w->rig[0].covariance && w->rig[1].covariance;
    out->sigma_px = out->chi2 = out->p_value = NAN;
    if (a->width != b->width || a->height != b->height)
        return td_fail(error, TD_ERROR_DATA, "camera %s: %dx%d px in one rig and %dx%d px in the other",
                       out->name, a->width, a->height, b->width, b->height);
    TD_TRY(field_init(f, a, b, w->distance, error));
    if (known) lens_covariance(s, w, c);
    for (int round = 0; round < (known ? 3 : 1); round++) {
        td_status status = field_fit(f, a, b, w->distance, error);
        if (status == TD_ERROR_DATA)
            return td_fail(error, TD_ERROR_DATA,
                           "camera %s: the two rigs' lenses have too little in common for a comparison",
                           out->name);
        if (status != TD_OK) return status;
        for (size_t i = 0; i < f->points && known && round < 2; i++)
            f->weight[f->cell[i]] = 1 / (expected_square(f, s, i) + LEAST_PX * LEAST_PX);
    }
    fill_field(out, f, w->distance);
    if (!known) return TD_OK;
    for (size_t i = 0; i < f->points; i++) {
        double expected = expected_square(f, s, i);
        out->expected_px[f->cell[i]] = sqrt(expected);
        sum += expected;
    }
    out->sigma_px = sqrt(sum / (double)f->points);
    return judge_camera(out, w, c, s, error);
}

/* log(b a^-1): what the second camera's relative pose of a must be perturbed by to be b's. */
static void pose_difference(double xi[6], const td_pose *a, const td_pose *b)
{
    td_pose back = td_pose_inverse(a), d = td_pose_compose(b, &back);
    td_pose_log(xi, &d);
}

static td_status compare_pair(td_compared_pair *out, const comparison *w, int c, td_error *error)
{
    const common_rig *a = &w->rig[0], *b = &w->rig[1];
    double xi[6], s[36] = {0}, chi2, baseline[2];
    int degrees;
    *out = (td_compared_pair){.second = c, .sigma_baseline_m = NAN, .p_value = NAN};
    pose_difference(xi, &a->pose[c], &b->pose[c]);
    for (int k = 0; k < 3; k++) {
        out->rotation_rad[k] = xi[k];
        out->translation_m[k] = xi[3 + k];
        out->sigma_rotation_rad[k] = out->sigma_translation_m[k] = NAN;
    }
    baseline[0] = td_pose_distance(&a->pose[c]);
    baseline[1] = td_pose_distance(&b->pose[c]);
    out->baseline_m = baseline[1] - baseline[0];
    if (!a->covariance || !b->covariance) return TD_OK;
    double variance = 0;
    for (int side = 0; side < 2; side++) {
        const common_rig *r = &w->rig[side];
        size_t row = r->first[c] + lens_count(r, c);
        for (size_t i = 0; i < 36; i++) {
            double v = r->covariance[(row + i / 6) * r->n + row + i % 6];
            s[i] += v;
            /* The length changes by tau along t only. */
            if (i / 6 >= 3 && i % 6 >= 3 && baseline[side] > 0)
                variance +=
                    r->pose[c].t[i / 6 - 3] * r->pose[c].t[i % 6 - 3] * v / (baseline[side] * baseline[side]);
        }
    }
    for (int k = 0; k < 3; k++) {
        out->sigma_rotation_rad[k] = sqrt(fmax(s[7 * k], 0));
        out->sigma_translation_m[k] = sqrt(fmax(s[7 * (k + 3)], 0));
    }
    out->sigma_baseline_m = sqrt(fmax(variance, 0));
    TD_TRY(judge_direct(&chi2, &degrees, xi, s, 6, error));
    out->p_value = td_chi2_tail(chi2, degrees);
    return TD_OK;
}

static bool same_models(const comparison *w)
{
    for (int c = 0; c < w->rig[0].count; c++)
        if (w->rig[0].camera[c]->model != w->rig[1].camera[c]->model) return false;
    return true;
}

/* Equal models: the parameters themselves, all together. */
static td_status judge_parameters(double *chi2, int *degrees, const comparison *w, td_error *error)
{
    const common_rig *a = &w->rig[0], *b = &w->rig[1];
    size_t n = a->n;
    double *delta = calloc(n + n * n, sizeof *delta), *s = delta + n;
    if (!delta) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    for (int c = 0; c < a->count; c++) {
        size_t lens = lens_count(a, c), row = a->first[c];
        for (size_t k = 0; k < lens; k++)
            delta[row + k] = b->camera[c]->parameter[k] - a->camera[c]->parameter[k];
        if (c) pose_difference(delta + row + lens, &a->pose[c], &b->pose[c]);
    }
    for (size_t i = 0; i < n * n; i++) s[i] = a->covariance[i] + b->covariance[i];
    td_status status = judge_direct(chi2, degrees, delta, s, n, error);
    free(delta);
    return status;
}

/* Adds to a row of derivatives by both rigs' parameters. */
static void add_lens(double *row, const comparison *w, int c, const double *by, double factor)
{
    const field *f = &w->field[c];
    for (size_t k = 0; k < f->lens[0] + f->lens[1]; k++) {
        bool second = k >= f->lens[0];
        size_t at = second ? w->rig[0].n + w->rig[1].first[c] + k - f->lens[0] : w->rig[0].first[c] + k;
        row[at] += factor * by[k];
    }
}

/* How a pose of b stands against a's when each camera's frame is moved by its field's motion T: E = T_k P_a
 * T_0^-1 P_b^-1, with d log E = dT_k + Ad(T_k) dP_a - Ad(T_k P_a T_0^-1) dT_0 - Ad(E) dP_b and Ad(E) = 1 to
 * first order. At infinity only the rotation is known. */
static void moved_pose(double *y, double *j, const comparison *w, int c, size_t width)
{
    const common_rig *a = &w->rig[0], *b = &w->rig[1];
    const field *f = &w->field[c], *base = &w->field[0];
    size_t rows = (size_t)f->freedom;
    td_pose back = td_pose_inverse(&base->b_from_a), here = td_pose_compose(&f->b_from_a, &a->pose[c]);
    double xi[6], of_a[36], of_base[36];
    here = td_pose_compose(&here, &back);
    pose_difference(xi, &b->pose[c], &here);
    td_pose_adjoint(of_a, &f->b_from_a);
    td_pose_adjoint(of_base, &here);
    size_t pose_a = a->first[c] + lens_count(a, c), pose_b = a->n + b->first[c] + lens_count(b, c);
    for (size_t i = 0; i < rows; i++) {
        double *row = j + i * width;
        y[i] = xi[i];
        add_lens(row, w, c, f->follow + i * (f->lens[0] + f->lens[1]), -1);
        for (size_t k = 0; k < rows; k++)
            add_lens(row, w, 0, base->follow + k * (base->lens[0] + base->lens[1]), of_base[6 * i + k]);
        for (size_t k = 0; k < 6; k++) row[pose_a + k] += of_a[6 * i + k];
        row[pose_b + i] -= 1;
    }
}

/* Each row in its own sigmas. */
static void scale_rows(double *y, double *j, const double *s, size_t rows, size_t n)
{
    for (size_t r = 0; r < rows; r++) {
        double variance = 0;
        for (size_t i = 0; i < n; i++)
            for (size_t k = 0; k < n; k++) variance += j[r * n + i] * s[i * n + k] * j[r * n + k];
        double factor = variance > 0 ? 1 / sqrt(variance) : 0;
        y[r] *= factor;
        for (size_t i = 0; i < n; i++) j[r * n + i] *= factor;
    }
}

/* Different models: all cameras' projections and, in sigmas too, how the frames that explain them best stand
 * to each other. */
static td_status judge_projections(double *chi2, int *degrees, const comparison *w, td_error *error)
{
    size_t width = w->rig[0].n + w->rig[1].n, rows = 0, at = 0;
    for (int c = 0; c < w->rig[0].count; c++) rows += 2 * w->field[c].points + 6;
    double *y = calloc(rows + rows * width + width * width, sizeof *y), *j = y + rows, *s = j + rows * width;
    if (!y) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu projections", rows);
    for (size_t side = 0, first = 0; side < 2; first += w->rig[side++].n)
        for (size_t i = 0; i < w->rig[side].n; i++)
            for (size_t k = 0; k < w->rig[side].n; k++)
                s[(first + i) * width + first + k] = w->rig[side].covariance[i * w->rig[side].n + k];
    for (int c = 0; c < w->rig[0].count; c++) {
        const field *f = &w->field[c];
        for (size_t i = 0; i < 2 * f->points; i++, at++) {
            double root = sqrt(f->weight[f->cell[i / 2]]);
            y[at] = root * f->r[i];
            add_lens(j + at * width, w, c, f->by + i * (f->lens[0] + f->lens[1]), root);
        }
        if (!c) continue;
        moved_pose(y + at, j + at * width, w, c, width);
        scale_rows(y + at, j + at * width, s, (size_t)f->freedom, width);
        at += (size_t)f->freedom;
    }
    td_status status = judge_linear(chi2, degrees, y, j, s, at, width, LEAST_SIGMA, error);
    free(y);
    return status;
}

static void write_text(td_rig_compare *out)
{
    double rms = 0, sigma = 0;
    int worst = 0, pair = -1;
    for (int c = 0; c < out->camera_count; c++) {
        rms += out->camera[c].rms_px * out->camera[c].rms_px / out->camera_count;
        sigma += out->camera[c].sigma_px * out->camera[c].sigma_px / out->camera_count;
        if (out->camera[c].p_value < out->camera[worst].p_value) worst = c;
    }
    rms = sqrt(rms), sigma = sqrt(sigma);
    for (int k = 0; k < out->pair_count; k++)
        if (out->pair[k].p_value < (pair < 0 ? out->camera[worst].p_value : out->pair[pair].p_value))
            pair = k;
    const td_compared_camera *camera = &out->camera[worst];
    if (isnan(out->p_value))
        snprintf(
            out->text, sizeof out->text,
            "the rigs differ by %.3f px RMS; whether that is significant is unknown: a rig has no covariance",
            rms);
    else if (!out->significant)
        snprintf(out->text, sizeof out->text,
                 "consistent: the rigs differ by %.3f px RMS, %.3f px are expected from their covariances (p "
                 "= %.2g)",
                 rms, sigma, out->p_value);
    else if (pair >= 0) {
        const td_compared_pair *p = &out->pair[pair];
        const double *r = p->rotation_rad, *t = p->translation_m;
        snprintf(out->text, sizeof out->text,
                 "different (p = %.2g): most in the pose of %s relative to %s, by %.3f degrees and %.3f mm; "
                 "p = %.2g",
                 out->p_value, out->camera[p->second].name, out->camera[0].name,
                 sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) * DEGREES,
                 1e3 * sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]), p->p_value);
    } else
        snprintf(out->text, sizeof out->text,
                 "different (p = %.2g): most in %s (p = %.2g), whose images differ by %.3f px RMS",
                 out->p_value, camera->name, camera->p_value, camera->rms_px);
}

static td_status run(td_rig_compare *out, comparison *w, double p_limit, td_error *error)
{
    double chi2;
    int degrees;
    for (int c = 0; c < out->camera_count; c++) TD_TRY(compare_camera(&out->camera[c], w, c, error));
    for (int c = 1; c < out->camera_count; c++)
        TD_TRY(compare_pair(&out->pair[out->pair_count++], w, c, error));
    out->p_value = NAN;
    if (w->rig[0].covariance && w->rig[1].covariance) {
        if (same_models(w))
            TD_TRY(judge_parameters(&chi2, &degrees, w, error));
        else
            TD_TRY(judge_projections(&chi2, &degrees, w, error));
        out->p_value = td_chi2_tail(chi2, degrees);
    }
    out->significant = out->p_value < p_limit;
    write_text(out);
    return TD_OK;
}

td_status td_rig_compare_run(td_rig_compare *compare, const td_rig *a, const td_rig *b, double distance_m,
                             double p_limit, td_error *error)
{
    int index[2][TD_RIG_MAX_CAMERAS];
    *compare = (td_rig_compare){.p_value = NAN};
    if (!(distance_m > 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "distance_m: %g must be > 0 or infinite", distance_m);
    if (!(p_limit > 0 && p_limit < 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "p_limit: %g is not between 0 and 1", p_limit);
    compare->camera_count = match(index, a, b);
    if (!compare->camera_count) return td_fail(error, TD_ERROR_DATA, "the two rigs have no camera in common");
    comparison w = {.distance = distance_m, .field = calloc(TD_RIG_MAX_CAMERAS, sizeof *w.field)};
    td_status status = w.field ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (int c = 0; c < compare->camera_count; c++)
        memcpy(compare->camera[c].name, a->camera[index[0][c]].name, TD_NAME_SIZE);
    if (status == TD_OK) status = common_make(&w.rig[0], a, index[0], compare->camera_count, error);
    if (status == TD_OK) status = common_make(&w.rig[1], b, index[1], compare->camera_count, error);
    if (status == TD_OK) status = run(compare, &w, p_limit, error);
    for (int c = 0; c < TD_RIG_MAX_CAMERAS && w.field; c++) field_free(&w.field[c]);
    free(w.field);
    free(w.rig[0].covariance);
    free(w.rig[1].covariance);
    return status;
}
