/* The point and its covariance. The corrected pair (l', r') is where |l' - l|^2 + |r' - r|^2 is least on
 * g = [r';1]^T F [l';1] = 0, so that with a multiplier k
 *
 *   l' - l + k g_l = 0,   r' - r + k g_r = 0,   g = 0,
 *
 * and its derivatives by l, r and F follow from these five equations, exactly (implicit function theorem).
 * The point lies on the left ray y = K_l^-1 [l';1] at the depth z where it meets the right ray w = K_r^-1
 * [r';1]:
 *
 *   w x (R y z + t) = 0,   z = -(A . B) / (A . A),   A = w x R y,   B = w x t.
 *
 * Matching: the right pixel's covariance through all of this, the corrected left pixel's own motion included:
 * noise of the right pixel across the epipolar line moves both corrected pixels. Calibration: the rig's
 * covariance through the same, for pixels that stay as they were taken. */
#include "recon/triangulation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

enum { MAX_ROW = TD_RIG_MAX_CAMERAS * (TD_CAMERA_MAX_PARAMETERS + 6) };

/* A camera's undistorted pixel (2) and its derivatives. */
typedef struct undistorted {
    double pixel[2];
    double d_pixel[4];                                /* (2,2) by the pixel as taken */
    double d_parameter[2 * TD_CAMERA_MAX_PARAMETERS]; /* (2,count) */
    int count;
} undistorted;

/* Everything at the solution. */
typedef struct solution {
    const td_camera *left_camera, *right_camera;
    undistorted left, right;
    double l[3], r[3];              /* corrected, homogeneous */
    double f[9], e[9], rotation[9]; /* F = K_r^-T E K_l^-1, E = [t]x R; not scaled */
    const double *t;
    double kl[9], kr[9]; /* inverse camera matrices */
    double g[4], multiplier;
    double inverse[25];           /* of the five equations' matrix */
    double y[3], w[3], turned[3]; /* rays; turned = R y */
    double a[3], b[3], z;
    double point[3]; /* left camera's frame */
} solution;

/* A change of what the point depends on. */
typedef struct change {
    double left[2], right[2];     /* undistorted pixels */
    double left_k[4], right_k[4]; /* fx fy cx cy */
    double xi[6];                 /* left perturbation of right_from_left */
} change;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static void apply(double out[3], const double m[9], const double v[3])
{
    for (int i = 0; i < 3; i++) out[i] = dot(m + 3 * i, v);
}

static void apply_transposed(double out[3], const double m[9], const double v[3])
{
    for (int i = 0; i < 3; i++) out[i] = m[i] * v[0] + m[3 + i] * v[1] + m[6 + i] * v[2];
}

static void skew(double m[9], const double v[3])
{
    const double s[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
    memcpy(m, s, sizeof s);
}

static void inverse_matrix(double m[9], const td_camera *camera)
{
    const double *p = camera->parameter;
    const double inverse[9] = {1 / p[0], 0, -p[2] / p[0], 0, 1 / p[1], -p[3] / p[1], 0, 0, 1};
    memcpy(m, inverse, sizeof inverse);
}

/* ---- the point ---- */

/* The pixel that a camera without distortion and of the same matrix would see. */
static bool undistort(undistorted *u, const td_camera *camera, const double pixel[2])
{
    double ray[3], d_ray[6], d_camera[3 * TD_CAMERA_MAX_PARAMETERS];
    const double *k = camera->parameter;
    if (!td_camera_unproject(ray, d_ray, d_camera, camera, pixel) || !(ray[2] > 1e-9)) return false;
    u->count = td_camera_parameter_count(camera->model);
    for (int i = 0; i < 2; i++) {
        const double tangent = ray[i] / ray[2], scale = k[i] / ray[2];
        u->pixel[i] = k[i] * tangent + k[2 + i];
        for (int c = 0; c < 2; c++)
            u->d_pixel[2 * i + c] = scale * (d_ray[2 * i + c] - tangent * d_ray[4 + c]);
        double *row = u->d_parameter + i * u->count;
        for (int c = 0; c < u->count; c++)
            row[c] = scale * (d_camera[i * u->count + c] - tangent * d_camera[2 * u->count + c]);
        row[i] += tangent;
        row[2 + i] += 1;
    }
    return true;
}

static void set_matrices(solution *s, const td_pair *pair)
{
    double cross_t[9], part[9], right_transposed[9];
    s->t = pair->right_from_left.t;
    td_pose_rotation(s->rotation, &pair->right_from_left);
    skew(cross_t, s->t);
    td_multiply(s->e, cross_t, s->rotation, 3, 3, 3);
    inverse_matrix(s->kl, s->left_camera);
    inverse_matrix(s->kr, s->right_camera);
    for (int i = 0; i < 9; i++) right_transposed[i] = s->kr[i % 3 * 3 + i / 3];
    td_multiply(part, s->e, s->kl, 3, 3, 3);
    td_multiply(s->f, right_transposed, part, 3, 3, 3);
}

/* Where the corrected rays meet; false: behind a camera, or nowhere. */
static bool intersect(solution *s)
{
    apply(s->y, s->kl, s->l);
    apply(s->w, s->kr, s->r);
    apply(s->turned, s->rotation, s->y);
    cross(s->a, s->w, s->turned);
    cross(s->b, s->w, s->t);
    s->z = -dot(s->a, s->b) / dot(s->a, s->a);
    for (int i = 0; i < 3; i++) s->point[i] = s->z * s->y[i];
    return isfinite(s->z) && s->z > 0 && s->z * s->turned[2] + s->t[2] > 0;
}

static bool solve(solution *s, const td_pair *pair, const double left[2], const double right[2])
{
    s->left_camera = &pair->rig->camera[pair->left].camera;
    s->right_camera = &pair->rig->camera[pair->right].camera;
    if (!undistort(&s->left, s->left_camera, left) || !undistort(&s->right, s->right_camera, right))
        return false;
    set_matrices(s, pair);
    td_hartley_sturm(s->l, s->r, s->f, s->left.pixel, s->right.pixel);
    s->l[2] = s->r[2] = 1;
    return intersect(s);
}

/* ---- its derivatives ---- */

/* The matrix of the five equations by l', r' and k: [1 + k g_xx, g_x; g_x^T, 0], inverted. The multiplier is
 * read off the equations in the least-squares sense. */
static bool linearise(solution *s)
{
    double gl[3], gr[3], n = 0, d[4], matrix[25] = {0};
    apply_transposed(gl, s->f, s->r);
    apply(gr, s->f, s->l);
    for (int i = 0; i < 2; i++) {
        s->g[i] = gl[i];
        s->g[2 + i] = gr[i];
        d[i] = s->left.pixel[i] - s->l[i];
        d[2 + i] = s->right.pixel[i] - s->r[i];
    }
    s->multiplier = 0;
    for (int i = 0; i < 4; i++) {
        n += s->g[i] * s->g[i];
        s->multiplier += s->g[i] * d[i];
    }
    if (!(n > 0)) return false;
    s->multiplier /= n;
    /* The equations' scale is F's; with g of length 1 the matrix is well conditioned. */
    const double scale = 1 / sqrt(n);
    for (int i = 0; i < 4; i++) {
        matrix[6 * i] = 1;
        matrix[5 * i + 4] = matrix[20 + i] = scale * s->g[i];
    }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            matrix[5 * i + 2 + j] = matrix[5 * (2 + j) + i] = s->multiplier * s->f[3 * j + i];
    /* Symmetric but indefinite: by least squares, column after column. */
    for (size_t c = 0; c < 5; c++) {
        double unit[5] = {0}, column[5];
        size_t rank;
        unit[c] = 1;
        if (td_least_squares_linear(column, &rank, matrix, unit, 5, 5, NULL) != TD_OK || rank < 5)
            return false;
        for (size_t i = 0; i < 5; i++) s->inverse[5 * i + c] = column[i];
    }
    for (int i = 0; i < 5; i++) s->inverse[5 * i + 4] *= scale; /* the fifth equation was scaled */
    return true;
}

/* dF of a change: of K_l^-1, E and K_r^-T. */
static void change_of_f(double df[9], const solution *s, const change *c)
{
    double dkl[9] = {0}, dkr[9] = {0}, de[9], left[9], right[9], dt[3], part[9], rotated[9], more[9];
    for (int i = 0; i < 2; i++) {
        const double fl = s->left_camera->parameter[i], fr = s->right_camera->parameter[i];
        dkl[4 * i] = -c->left_k[i] / (fl * fl);
        dkr[4 * i] = -c->right_k[i] / (fr * fr);
        dkl[3 * i + 2] = -(c->left_k[2 + i] + s->kl[3 * i + 2] * c->left_k[i]) / fl;
        dkr[3 * i + 2] = -(c->right_k[2 + i] + s->kr[3 * i + 2] * c->right_k[i]) / fr;
    }
    cross(dt, c->xi, s->t);
    for (int i = 0; i < 3; i++) dt[i] += c->xi[3 + i];
    skew(part, dt);
    td_multiply(de, part, s->rotation, 3, 3, 3);
    skew(part, c->xi);
    td_multiply(rotated, part, s->rotation, 3, 3, 3);
    skew(part, s->t);
    td_multiply(more, part, rotated, 3, 3, 3);
    for (int i = 0; i < 9; i++) de[i] += more[i];
    /* K_r^-T dE K_l^-1 + dK_r^-T E K_l^-1 + K_r^-T E dK_l^-1. */
    td_multiply(part, de, s->kl, 3, 3, 3);
    td_multiply(left, s->e, dkl, 3, 3, 3);
    td_multiply(right, s->e, s->kl, 3, 3, 3);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            df[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                df[3 * i + j] += s->kr[3 * k + i] * (part[3 * k + j] + left[3 * k + j]) +
                                 dkr[3 * k + i] * right[3 * k + j];
        }
}

/* The corrected pair's change (4). */
static void change_of_pair(double moved[4], const solution *s, const change *c)
{
    double df[9], gl[3], gr[3], side[5];
    change_of_f(df, s, c);
    apply_transposed(gl, df, s->r);
    apply(gr, df, s->l);
    for (int i = 0; i < 2; i++) {
        side[i] = c->left[i] - s->multiplier * gl[i];
        side[2 + i] = c->right[i] - s->multiplier * gr[i];
    }
    side[4] = -dot(gr, s->r);
    for (int i = 0; i < 4; i++) {
        moved[i] = 0;
        for (int k = 0; k < 5; k++) moved[i] += s->inverse[5 * i + k] * side[k];
    }
}

/* The point's change (3), left camera's frame. */
static void change_of_point(double moved[3], const solution *s, const change *c)
{
    double pair[4], dy[3] = {0}, dw[3] = {0}, dt[3], dturned[3], part[3], da[3], db[3];
    change_of_pair(pair, s, c);
    for (int i = 0; i < 2; i++) {
        dy[i] = (pair[i] - c->left_k[2 + i] - s->y[i] * c->left_k[i]) / s->left_camera->parameter[i];
        dw[i] = (pair[2 + i] - c->right_k[2 + i] - s->w[i] * c->right_k[i]) / s->right_camera->parameter[i];
    }
    cross(dt, c->xi, s->t);
    for (int i = 0; i < 3; i++) dt[i] += c->xi[3 + i];
    cross(dturned, c->xi, s->turned);
    apply(part, s->rotation, dy);
    for (int i = 0; i < 3; i++) dturned[i] += part[i];
    cross(da, dw, s->turned);
    cross(part, s->w, dturned);
    for (int i = 0; i < 3; i++) da[i] += part[i];
    cross(db, dw, s->t);
    cross(part, s->w, dt);
    for (int i = 0; i < 3; i++) db[i] += part[i];
    const double dz = -(dot(da, s->b) + dot(s->a, db) + 2 * s->z * dot(s->a, da)) / dot(s->a, s->a);
    for (int i = 0; i < 3; i++) moved[i] = dz * s->y[i] + s->z * dy[i];
}

/* Writes a change of the point as column `column` of j (3,n), turned into the rig's frame. */
static void put(double *j, size_t n, size_t column, const double rig_from_left[9], const double moved[3])
{
    for (int i = 0; i < 3; i++) j[(size_t)i * n + column] = dot(rig_from_left + 3 * i, moved);
}

/* Columns of one camera's intrinsics and distortion. */
static void camera_columns(double *j, size_t n, size_t first, const double rig_from_left[9],
                           const solution *s, bool left)
{
    const undistorted *u = left ? &s->left : &s->right;
    for (int k = 0; k < u->count; k++) {
        change c = {0};
        double moved[3], *pixel = left ? c.left : c.right;
        for (int i = 0; i < 2; i++) pixel[i] = u->d_parameter[i * u->count + k];
        if (k < 4) (left ? c.left_k : c.right_k)[k] = 1;
        change_of_point(moved, s, &c);
        put(j, n, first + (size_t)k, rig_from_left, moved);
    }
}

/* j (3,n) by the rig's parameters. The left pose's perturbation Exp(xi) left_from_rig changes right_from_left
 * by Exp(-Ad xi), and the way from the left camera to the rig by Exp(-xi). */
static void calibration_jacobian(double *j, const td_pair *pair, const solution *s,
                                 const double rig_from_left[9])
{
    const size_t n = td_rig_parameter_count(pair->rig);
    const size_t left = td_rig_parameter_offset(pair->rig, pair->left);
    const size_t right = td_rig_parameter_offset(pair->rig, pair->right);
    double adjoint[36], by_xi[18];
    memset(j, 0, 3 * n * sizeof *j);
    camera_columns(j, n, left, rig_from_left, s, true);
    camera_columns(j, n, right, rig_from_left, s, false);
    td_pose_adjoint(adjoint, &pair->right_from_left);
    td_pose_transform_jacobian(by_xi, s->point);
    for (size_t k = 0; k < 6; k++) {
        change c = {0};
        double moved[3];
        c.xi[k] = 1;
        change_of_point(moved, s, &c);
        put(j, n, right + (size_t)s->right.count + k, rig_from_left, moved);
        for (size_t i = 0; i < 6; i++) c.xi[i] = -adjoint[6 * i + k];
        change_of_point(moved, s, &c);
        for (size_t i = 0; i < 3; i++) moved[i] -= by_xi[6 * i + k];
        put(j, n, left + (size_t)s->left.count + k, rig_from_left, moved);
    }
}

/* (3,2) by the right pixel as taken. */
static void matching_jacobian(double j[6], const solution *s, const double rig_from_left[9])
{
    for (size_t k = 0; k < 2; k++) {
        change c = {0};
        double moved[3];
        for (size_t i = 0; i < 2; i++) c.right[i] = s->right.d_pixel[2 * i + k];
        change_of_point(moved, s, &c);
        put(j, 2, k, rig_from_left, moved);
    }
}

/* The point, and both Jacobians (by_rig (3,n) may be NULL). */
static bool triangulate(td_point3 *point, double by_right[6], double *by_rig, const td_pair *pair,
                        const td_match *match)
{
    solution s;
    double rotation[9];
    if (!solve(&s, pair, match->left, match->right) || !linearise(&s)) return false;
    const td_pose rig_from_left = td_pose_inverse(&pair->rig->camera[pair->left].camera_from_rig);
    td_pose_rotation(rotation, &rig_from_left);
    td_pose_transform(point->p, &rig_from_left, s.point);
    point->residual_px = sqrt(pow(s.l[0] - s.left.pixel[0], 2) + pow(s.l[1] - s.left.pixel[1], 2) +
                              pow(s.r[0] - s.right.pixel[0], 2) + pow(s.r[1] - s.right.pixel[1], 2));
    matching_jacobian(by_right, &s, rotation);
    if (by_rig) calibration_jacobian(by_rig, pair, &s, rotation);
    return true;
}

/* s (3,3) = j c j^T for a right pixel's covariance c. */
static void matching_covariance(double s[9], const double j[6], const double c[4])
{
    double jc[6];
    td_multiply(jc, j, c, 3, 2, 2);
    td_multiply_transposed(s, jc, j, 3, 2, 3);
}

bool td_triangulate(td_point3 *point, const td_pair *pair, const td_match *match)
{
    const td_rig *rig = pair->rig;
    const size_t n = td_rig_parameter_count(rig);
    double by_right[6], by_rig[3 * MAX_ROW], part[3 * MAX_ROW];
    td_point3 made;
    if (!triangulate(&made, by_right, rig->covariance ? by_rig : NULL, pair, match)) return false;
    matching_covariance(made.matching, by_right, match->covariance);
    for (int i = 0; i < 9; i++) made.calibration[i] = NAN;
    if (rig->covariance) {
        td_multiply(part, by_rig, rig->covariance, 3, n, n);
        td_multiply_transposed(made.calibration, part, by_rig, 3, n, 3);
    }
    for (int i = 0; i < 9; i++) made.covariance[i] = made.matching[i] + made.calibration[i];
    *point = made;
    return true;
}

/* Jacobians of all points below one another, and the matches' own parts on the diagonal. */
static td_status joint_parts(double *jacobian, double *matching, const td_pair *pair, const td_match *match,
                             size_t count, td_error *error)
{
    const size_t n = td_rig_parameter_count(pair->rig);
    for (size_t i = 0; i < count; i++) {
        td_point3 point;
        double by_right[6];
        if (!triangulate(&point, by_right, jacobian + 3 * n * i, pair, &match[i]))
            return td_fail(error, TD_ERROR_DATA,
                           "match %zu: its rays do not meet before both cameras; leave it out", i);
        matching_covariance(matching + 9 * i, by_right, match[i].covariance);
        for (int k = 0; k < 9; k++)
            if (!isfinite(matching[9 * i + (size_t)k]))
                return td_fail(error, TD_ERROR_DATA, "match %zu: has no covariance; refine it first", i);
    }
    return TD_OK;
}

td_status td_triangulate_joint(double *covariance, const td_pair *pair, const td_match *match, size_t count,
                               td_error *error)
{
    const size_t n = td_rig_parameter_count(pair->rig), rows = 3 * count;
    if (!pair->rig->covariance)
        return td_fail(
            error, TD_ERROR_DATA,
            "the rig has no covariance, so what its error does to the points is not known; calibrate "
            "it with teledimos");
    double *jacobian = calloc(rows * n + 1, sizeof *jacobian),
           *matching = calloc(9 * count + 1, sizeof *matching);
    td_status status = jacobian && matching ? joint_parts(jacobian, matching, pair, match, count, error)
                                            : td_fail(error, TD_ERROR_MEMORY,
                                                      "no memory for the covariance of %zu points", count);
    if (status == TD_OK) status = td_sandwich(covariance, jacobian, pair->rig->covariance, rows, n, error);
    for (size_t i = 0; status == TD_OK && i < count; i++)
        for (size_t k = 0; k < 9; k++)
            covariance[(3 * i + k / 3) * rows + 3 * i + k % 3] += matching[9 * i + k];
    free(jacobian);
    free(matching);
    return status;
}
