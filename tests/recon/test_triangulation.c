/* Proves: the corrected pair meets the epipolar constraint and no pair of epipolar lines is nearer (searched
 * by brute force), also for rectified pairs, whose epipoles lie at infinity; pairs and points are OpenCV's to
 * 1e-6 (correctMatches, triangulatePoints), for distorted cameras too; the inverse depth has no bias at a
 * short baseline and large noise, where linear triangulation has one; the covariance of matching, that of
 * calibration and the joint one of several points are what simulated noise leaves, each by itself, and their
 * Jacobians are the central differences.
 * References: OpenCV; brute force; Monte Carlo by the model (left pixel exact, right pixel and rig drawn),
 * bounds of 99.9 % for its counts.
 * Blind to: rigs and matches whose own covariance is wrong. */
#include <string.h>

#include "core/linalg.h"
#include "core/random.h"
#include "recon/triangulation.h"
#include "tests/check.h"
#include "tests/recon/triangulation_opencv.h"

static const td_camera brown5 = {
    TD_CAMERA_BROWN5, 1280, 960, {1072.1, 1073.9, 662.3, 475.5, -0.265, 0.047, 0.0018, -0.0003, 0.052}};
static const td_camera brown8 = {
    TD_CAMERA_BROWN8,
    1280,
    960,
    {1060, 1062, 632.3, 481.5, 0.1, -0.07, 0.001, -0.0013, 0.02, 0.3, -0.05, 0.01}};
static const td_camera fisheye = {
    TD_CAMERA_FISHEYE, 1280, 960, {600, 602, 650, 476, 0.02, -0.01, 0.003, -0.001}};
static const td_camera pinhole = {TD_CAMERA_PINHOLE, 1280, 960, {800, 800, 640, 480}};

static const td_camera *const lefts[] = {&pinhole, &brown5, &brown8, &fisheye, &brown5};
static const td_camera *const rights[] = {&pinhole, &brown8, &brown5, &brown5, &fisheye};
/* Motion of the right camera: as built, rectified, one above the other, ahead, and turned in. */
static const double motions[][6] = {{0.02, -0.11, 0.015, -0.40, 0.02, 0.03},
                                    {0, 0, 0, -0.40, 0, 0},
                                    {0, 0, 0, 0, -0.30, 0},
                                    {0, 0, 0, 0.01, 0, -0.50},
                                    {0.01, 0.3, -0.02, -1.2, 0.03, 0.2}};
enum { PAIRS = 5, MOTIONS = 5 };

static bool full(void)
{
    const char *text = getenv("TELEDIMOS_FULL");
    return text && !strcmp(text, "1");
}

/* Three cameras: the pair is not the rig's first, so that the rig's frame is another. */
static td_rig *make_rig(const td_camera *left, const td_camera *right, const double motion[6])
{
    td_rig *rig = td_rig_new();
    const double second[6] = {0.03, -0.05, 0.02, 0.05, 0.01, -0.02};
    rig->count = 3;
    for (int i = 0; i < 3; i++) snprintf(rig->camera[i].name, TD_NAME_SIZE, "camera%d", i);
    rig->camera[0].camera = pinhole;
    rig->camera[1].camera = *left;
    rig->camera[2].camera = *right;
    rig->camera[0].camera_from_rig = td_pose_identity();
    rig->camera[1].camera_from_rig = td_pose_exp(second);
    rig->camera[2].camera_from_rig = td_pose_perturb(&rig->camera[1].camera_from_rig, motion);
    return rig;
}

static td_pair pair_of(const td_rig *rig)
{
    td_pair pair;
    td_error error = {0};
    check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
    return pair;
}

/* A point before both cameras, rig frame, and its pixels; false: not seen by both. */
static bool draw(double p[3], td_match *match, const td_pair *pair, td_random *random)
{
    double local[3], seen[3];
    local[2] = 1.5 + 4 * td_random_uniform(random);
    local[0] = (0.8 * td_random_uniform(random) - 0.4) * local[2];
    local[1] = (0.6 * td_random_uniform(random) - 0.3) * local[2];
    const td_pose rig_from_left = td_pose_inverse(&pair->rig->camera[pair->left].camera_from_rig);
    td_pose_transform(p, &rig_from_left, local);
    td_pose_transform(seen, &pair->right_from_left, local);
    *match = (td_match){.refined = true};
    for (int i = 0; i < 4; i++) match->covariance[i] = NAN;
    double ray[3];
    return td_camera_project(match->left, NULL, NULL, &pair->rig->camera[pair->left].camera, local) &&
           td_camera_project(match->right, NULL, NULL, &pair->rig->camera[pair->right].camera, seen) &&
           td_camera_unproject(ray, NULL, NULL, &pair->rig->camera[pair->left].camera, match->left) &&
           td_camera_unproject(ray, NULL, NULL, &pair->rig->camera[pair->right].camera, match->right) &&
           fabs(match->right[0] - 640) < 640 && fabs(match->right[1] - 480) < 480;
}

static void undistort(double out[2], const td_camera *camera, const double pixel[2])
{
    double ray[3];
    assert_true(td_camera_unproject(ray, NULL, NULL, camera, pixel));
    for (int i = 0; i < 2; i++) out[i] = camera->parameter[i] * ray[i] / ray[2] + camera->parameter[2 + i];
}

/* ---- the corrected pair ---- */

/* Squared distances of both pixels from the pair of epipolar lines through left pixel q. */
static double lines_cost(const double f[9], const double epipole[3], const double left[2],
                         const double right[2], const double q[2])
{
    const double line[3] = {epipole[1] - q[1] * epipole[2], q[0] * epipole[2] - epipole[0],
                            epipole[0] * q[1] - epipole[1] * q[0]};
    double other[3];
    for (int i = 0; i < 3; i++) other[i] = f[3 * i] * q[0] + f[3 * i + 1] * q[1] + f[3 * i + 2];
    const double d = (line[0] * left[0] + line[1] * left[1] + line[2]) / hypot(line[0], line[1]);
    const double e = (other[0] * right[0] + other[1] * right[1] + other[2]) / hypot(other[0], other[1]);
    return d * d + e * e;
}

/* The least cost over the pencil: lines through points of a circle of `radius` around the left pixel, which
 * cut every line nearer than it; then around the best ever finer. */
static double searched_cost(const double f[9], const double left[2], const double right[2], double radius)
{
    double epipole[3], ratio, best = INFINITY, at = 0, width = 2 * 3.14159265358979;
    td_error error = {0};
    check_ok(td_null_vector(epipole, &ratio, f, 3, 3, &error), error);
    for (int level = 0; level < 12; level++) {
        const double from = at - width / 2;
        for (int i = 0; i <= 400; i++) {
            const double angle = from + width * i / 400;
            const double q[2] = {left[0] + radius * cos(angle), left[1] + radius * sin(angle)};
            const double cost = lines_cost(f, epipole, left, right, q);
            if (cost < best) {
                best = cost;
                at = angle;
            }
        }
        width /= 50;
    }
    return best;
}

static void test_corrected_pair(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 1);
    double worst = 0;
    for (int m = 0; m < MOTIONS; m++)
        for (int c = 0; c < PAIRS; c++) {
            td_rig *rig = make_rig(lefts[c], rights[c], motions[m]);
            const td_pair pair = pair_of(rig);
            double f[9];
            td_pair_fundamental(f, &pair);
            for (int i = 0; i < 20; i++) {
                double p[3], l[2], r[2], lc[2], rc[2], lo[2], ro[2];
                td_match match;
                if (!draw(p, &match, &pair, &random)) continue;
                const double noise = i % 4 == 0 ? 0 : i % 4 == 3 ? 5 : 0.4;
                undistort(l, &rig->camera[1].camera, match.left);
                undistort(r, &rig->camera[2].camera, match.right);
                for (int k = 0; k < 2; k++) {
                    l[k] += noise * td_random_normal(&random);
                    r[k] += noise * td_random_normal(&random);
                }
                td_hartley_sturm(lc, rc, f, l, r);
                opencv_correct_matches(lo, ro, f, l, r, 1);
                for (int k = 0; k < 2; k++) {
                    if (noise > 1) continue; /* judged by its cost below */
                    worst = fmax(worst, fmax(fabs(lc[k] - lo[k]), fabs(rc[k] - ro[k])));
                    check_near(lc[k], lo[k], 1e-6);
                    check_near(rc[k], ro[k], 1e-6);
                }
                /* OpenCV's solver of polynomials stops early, which shows (1e-5 px) where the least is flat.
                 */
                const double theirs =
                    pow(lo[0] - l[0], 2) + pow(lo[1] - l[1], 2) + pow(ro[0] - r[0], 2) + pow(ro[1] - r[1], 2);
                double line[3];
                for (int k = 0; k < 3; k++) line[k] = f[3 * k] * lc[0] + f[3 * k + 1] * lc[1] + f[3 * k + 2];
                check_near((line[0] * rc[0] + line[1] * rc[1] + line[2]) / hypot(line[0], line[1]), 0, 1e-9);
                const double cost =
                    pow(lc[0] - l[0], 2) + pow(lc[1] - l[1], 2) + pow(rc[0] - r[0], 2) + pow(rc[1] - r[1], 2);
                check_less(cost, theirs + 1e-11);
                check_less(cost, searched_cost(f, l, r, 20) + 1e-9);
            }
            td_rig_free(&rig);
        }
    print_message("corrected pairs: at most %.1e px from OpenCV's\n", worst);
}

/* What the polynomial makes of pairs that are far from any: the best line may be the one at infinity. */
static void test_far_pairs(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int i = 0; i < 2000; i++) {
        double f[9], u[9], left[2], right[2], lc[2], rc[2], ratio, null[3], epipole[3];
        td_error error = {0};
        for (int k = 0; k < 9; k++) u[k] = td_random_normal(&random);
        /* Rank 2: without its part along its null direction, some with an epipole at infinity. */
        for (int k = 0; k < 3; k++) null[k] = td_random_normal(&random);
        if (i % 3 == 0) null[2] = 0;
        const double n = null[0] * null[0] + null[1] * null[1] + null[2] * null[2];
        for (int r = 0; r < 3; r++) {
            const double part = (u[3 * r] * null[0] + u[3 * r + 1] * null[1] + u[3 * r + 2] * null[2]) / n;
            for (int k = 0; k < 3; k++) f[3 * r + k] = u[3 * r + k] - part * null[k];
        }
        for (int k = 0; k < 2; k++) {
            left[k] = 2 * td_random_normal(&random);
            right[k] = 2 * td_random_normal(&random);
        }
        td_hartley_sturm(lc, rc, f, left, right);
        const double cost = pow(lc[0] - left[0], 2) + pow(lc[1] - left[1], 2) + pow(rc[0] - right[0], 2) +
                            pow(rc[1] - right[1], 2);
        check_ok(td_null_vector(epipole, &ratio, f, 3, 3, &error), error);
        check_less(cost, searched_cost(f, left, right, 1e4) + 1e-6);
    }
    /* A point on its own epipole satisfies the constraint with anything. */
    const double f[9] = {0, -1, 0, 1, 0, -5, 0, 0, 0}, at[2] = {5, 0}, other[2] = {3, 4};
    double lc[2], rc[2];
    td_hartley_sturm(lc, rc, f, at, other);
    check_near(lc[0], 5, 0);
    check_near(rc[1], 4, 0);
}

/* ---- the point ---- */

static void projection(double p[12], const td_camera *camera, const td_pose *camera_from_left)
{
    double k[9], r[9], rt[12];
    td_camera_matrix(k, camera);
    td_pose_rotation(r, camera_from_left);
    for (int i = 0; i < 3; i++) {
        memcpy(rt + 4 * i, r + 3 * i, 3 * sizeof *r);
        rt[4 * i + 3] = camera_from_left->t[i];
    }
    td_multiply(p, k, rt, 3, 3, 4);
}

static void test_points(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 1);
    double worst = 0;
    for (int m = 0; m < MOTIONS; m++)
        for (int c = 0; c < PAIRS; c++) {
            td_rig *rig = make_rig(lefts[c], rights[c], motions[m]);
            const td_pair pair = pair_of(rig);
            const td_pose same = td_pose_identity(),
                          rig_from_left = td_pose_inverse(&rig->camera[1].camera_from_rig);
            double f[9], pl[12], pr[12];
            td_pair_fundamental(f, &pair);
            projection(pl, &rig->camera[1].camera, &same);
            projection(pr, &rig->camera[2].camera, &pair.right_from_left);
            for (int i = 0; i < 20; i++) {
                double p[3], l[2], r[2], lo[2], ro[2], local[3], expected[3], residual;
                td_match match;
                td_point3 point;
                if (!draw(p, &match, &pair, &random)) continue;
                assert_true(td_triangulate(&point, &pair, &match));
                for (int k = 0; k < 3; k++) check_near(point.p[k], p[k], 1e-9 * 50); /* far along the ray */
                check_near(point.residual_px, 0, 1e-8);
                for (int k = 0; k < 2; k++) match.right[k] += 0.3 * td_random_normal(&random);
                if (!td_triangulate(&point, &pair, &match)) continue;
                undistort(l, &rig->camera[1].camera, match.left);
                undistort(r, &rig->camera[2].camera, match.right);
                opencv_correct_matches(lo, ro, f, l, r, 1);
                opencv_triangulate(local, pl, pr, lo, ro, 1);
                td_pose_transform(expected, &rig_from_left, local);
                for (int k = 0; k < 3; k++) {
                    worst = fmax(worst, fabs(point.p[k] - expected[k]));
                    check_near(point.p[k], expected[k], 1e-6);
                }
                residual = sqrt(pow(l[0] - lo[0], 2) + pow(l[1] - lo[1], 2) + pow(r[0] - ro[0], 2) +
                                pow(r[1] - ro[1], 2));
                check_near(point.residual_px, residual, 1e-6);
            }
            td_rig_free(&rig);
        }
    print_message("points: at most %.1e m from OpenCV's\n", worst);
}

/* ---- bias ---- */

/* Inhomogeneous linear least squares (Hartley and Zisserman 12.2): depth of the point, left camera's frame.
 */
static double linear_depth(const double pl[12], const double pr[12], const double l[2], const double r[2])
{
    double a[12], b[4], x[3];
    size_t rank;
    td_error error = {0};
    for (int i = 0; i < 4; i++) {
        const double *p = i < 2 ? pl : pr, v = i < 2 ? l[i] : r[i - 2];
        for (int k = 0; k < 3; k++) a[3 * i + k] = v * p[8 + k] - p[4 * (i % 2) + k];
        b[i] = p[4 * (i % 2) + 3] - v * p[11];
    }
    check_ok(td_least_squares_linear(x, &rank, a, b, 4, 3, &error), error);
    return x[2];
}

typedef struct mean {
    double sum, squares;
} mean;

static void add(mean *m, double x)
{
    m->sum += x;
    m->squares += x * x;
}

/* Mean over its own standard deviation. */
static double score(const mean *m, double n)
{
    return m->sum / n / sqrt((m->squares / n - pow(m->sum / n, 2)) / n);
}

/* Baseline 3 cm, 3 m, noise 1.5 px in both images: disparity 8 px, known to a quarter. */
static void test_bias(void **state)
{
    (void)state;
    enum { N = 50000 };
    const double motion[6] = {0, 0, 0, -0.03, 0, 0}, p[3] = {0.3, 0.2, 3};
    td_rig *rig = make_rig(&pinhole, &pinhole, motion);
    td_pair pair = pair_of(rig);
    const td_pose same = td_pose_identity();
    rig->camera[1].camera_from_rig = same; /* so that the rig's frame is the left camera's */
    rig->camera[2].camera_from_rig = td_pose_exp(motion);
    pair = pair_of(rig);
    td_random random = td_random_seed(7, 1);
    double pl[12], pr[12], seen[3], l[2], r[2], dlt[3];
    mean ours = {0}, linear = {0}, homogeneous = {0};
    projection(pl, &pinhole, &same);
    projection(pr, &pinhole, &pair.right_from_left);
    td_pose_transform(seen, &pair.right_from_left, p);
    td_camera_project(l, NULL, NULL, &pinhole, p);
    td_camera_project(r, NULL, NULL, &pinhole, seen);
    for (int i = 0; i < N; i++) {
        td_match match = {0};
        td_point3 point;
        for (int k = 0; k < 2; k++) {
            match.left[k] = l[k] + 1.5 * td_random_normal(&random);
            match.right[k] = r[k] + 1.5 * td_random_normal(&random);
        }
        /* All are kept: those behind the cameras are rare, and leaving them out would be a bias. */
        assert_true(td_triangulate(&point, &pair, &match) || match.left[0] <= match.right[0]);
        if (match.left[0] <= match.right[0]) point.p[2] = 0.03 * 800 / (match.left[0] - match.right[0]);
        add(&ours, 1 / point.p[2] - 1 / p[2]);
        add(&linear, 1 / linear_depth(pl, pr, match.left, match.right) - 1 / p[2]);
        opencv_triangulate(dlt, pl, pr, match.left, match.right, 1);
        add(&homogeneous, 1 / dlt[2] - 1 / p[2]);
    }
    print_message("bias of the inverse depth, in standard deviations of the mean: %.2f; linear %.1f, "
                  "homogeneous linear (OpenCV) %.1f\n",
                  score(&ours, N), score(&linear, N), score(&homogeneous, N));
    check_near(score(&ours, N), 0, 3.29);
    check_less(3.29, score(&linear, N));
    check_less(3.29, score(&homogeneous, N));
    td_rig_free(&rig);
}

/* ---- derivatives ---- */

static void move_parameter(td_rig *rig, size_t index, double step)
{
    for (int c = rig->count - 1; c >= 0; c--) {
        const size_t offset = td_rig_parameter_offset(rig, c);
        if (index < offset) continue;
        td_rig_camera *camera = &rig->camera[c];
        const size_t count = (size_t)td_camera_parameter_count(camera->camera.model);
        double xi[6] = {0};
        if (index - offset < count) {
            camera->camera.parameter[index - offset] += step;
            return;
        }
        xi[index - offset - count] = step;
        camera->camera_from_rig = td_pose_perturb(&camera->camera_from_rig, xi);
        return;
    }
}

/* The point of the rig with its parameters moved by `step` times `direction`. */
static void moved_point(double p[3], const td_rig *rig, const td_match *match, const double *direction,
                        double step)
{
    td_rig *moved = td_rig_copy(rig);
    td_point3 point;
    for (size_t i = 0; i < td_rig_parameter_count(rig); i++)
        if (direction[i] != 0) move_parameter(moved, i, step * direction[i]);
    const td_pair pair = pair_of(moved);
    assert_true(td_triangulate(&point, &pair, match));
    memcpy(p, point.p, sizeof point.p);
    td_rig_free(&moved);
}

/* What a parameter may change by without leaving the linear part far behind. */
static double unit_of(const td_rig *rig, size_t index)
{
    for (int c = rig->count - 1; c >= 0; c--)
        if (index >= td_rig_parameter_offset(rig, c))
            return index - td_rig_parameter_offset(rig, c) < 4 ? 1 : 1e-3;
    return 0;
}

/* A covariance v v^T passes through as (J v)(J v)^T. */
static void check_outer(const double covariance[9], const double plus[3], const double minus[3], double width)
{
    double d[3], largest = 0;
    for (int i = 0; i < 3; i++) {
        d[i] = (plus[i] - minus[i]) / width;
        largest = fmax(largest, fabs(d[i]));
    }
    for (int i = 0; i < 9; i++)
        check_near(covariance[i], d[i / 3] * d[i % 3], 2e-5 * largest * largest + 1e-10 * largest + 1e-20);
}

static void test_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(8, 1);
    for (int c = 0; c < PAIRS; c++)
        for (int m = 0; m < MOTIONS; m++) {
            td_rig *rig = make_rig(lefts[c], rights[c], motions[m]);
            const size_t n = td_rig_parameter_count(rig);
            const td_pair pair = pair_of(rig);
            double p[3], plus[3], minus[3], direction[64] = {0};
            td_match match;
            td_point3 point;
            while (!draw(p, &match, &pair, &random)) {
            }
            /* Far off the epipolar line, where derivatives at the line would be wrong. */
            for (int k = 0; k < 2; k++) match.right[k] += 3 * (td_random_uniform(&random) - 0.5);
            rig->covariance = calloc(n * n, sizeof *rig->covariance);
            for (int k = 0; k < 2; k++) {
                td_match moved = match;
                for (int i = 0; i < 4; i++) match.covariance[i] = i == 3 * k;
                assert_true(td_triangulate(&point, &pair, &match));
                moved.right[k] += 1e-3;
                moved_point(plus, rig, &moved, direction, 0);
                moved.right[k] -= 2e-3;
                moved_point(minus, rig, &moved, direction, 0);
                check_outer(point.matching, plus, minus, 2e-3);
            }
            for (size_t i = td_rig_parameter_offset(rig, 1); i <= n; i++) {
                /* Each by itself; at last all together. */
                memset(direction, 0, sizeof direction);
                for (size_t k = td_rig_parameter_offset(rig, 1); k < n; k++)
                    if (i == n || i == k)
                        direction[k] = unit_of(rig, k) * (i == n ? td_random_normal(&random) : 1);
                for (size_t k = 0; k < n * n; k++) rig->covariance[k] = direction[k / n] * direction[k % n];
                assert_true(td_triangulate(&point, &pair, &match));
                moved_point(plus, rig, &match, direction, 0.01);
                moved_point(minus, rig, &match, direction, -0.01);
                check_outer(point.calibration, plus, minus, 0.02);
            }
            td_rig_free(&rig);
        }
}

/* ---- coverage ---- */

/* Lower triangle of a (n,n) such that a a^T = s. */
static void cholesky(double *a, const double *s, size_t n)
{
    memset(a, 0, n * n * sizeof *a);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            double sum = s[i * n + j];
            for (size_t k = 0; k < j; k++) sum -= a[i * n + k] * a[j * n + k];
            if (i == j)
                a[i * n + i] = sqrt(fmax(sum, 0));
            else
                a[i * n + j] = a[j * n + j] > 0 ? sum / a[j * n + j] : 0;
        }
}

/* e^T s^-1 e over the `rank` largest directions of s (n,n); *beyond: length of e outside them. */
static double chi_squared(double *beyond, const double *e, const double *s, size_t n, size_t rank)
{
    double value[32], vector[32 * 32], sum = 0, rest = 0;
    td_error error = {0};
    check_ok(td_eigen_symmetric(value, vector, s, n, &error), error);
    for (size_t i = 0; i < n; i++) {
        double along = 0;
        for (size_t k = 0; k < n; k++) along += vector[i * n + k] * e[k];
        if (i < n - rank)
            rest += along * along;
        else
            sum += along * along / value[i];
    }
    if (beyond) *beyond = sqrt(rest);
    return sum;
}

static const double match_covariance[4] = {0.04, 0.012, 0.012, 0.09};

static void add_noise(td_match *match, td_random *random)
{
    double a[4];
    cholesky(a, match_covariance, 2);
    const double x = td_random_normal(random), y = td_random_normal(random);
    match->right[0] += a[0] * x;
    match->right[1] += a[2] * x + a[3] * y;
}

static void test_coverage_of_matching(void **state)
{
    (void)state;
    const int points = 20, trials = full() ? 10000 : 500;
    td_rig *rig = make_rig(&brown5, &brown8, motions[0]);
    const td_pair pair = pair_of(rig);
    td_random random = td_random_seed(11, 1);
    double sum = 0, out = 0, within = 0;
    for (int i = 0; i < points;) {
        double p[3], beyond;
        td_match match;
        td_point3 truth, point;
        if (!draw(p, &match, &pair, &random)) continue;
        i++;
        memcpy(match.covariance, match_covariance, sizeof match_covariance);
        assert_true(td_triangulate(&truth, &pair, &match));
        assert_true(isnan(truth.calibration[0]) && isnan(truth.covariance[8])); /* never 0 */
        for (int t = 0; t < trials; t++) {
            td_match noisy = match;
            double e[3];
            add_noise(&noisy, &random);
            assert_true(td_triangulate(&point, &pair, &noisy));
            for (int k = 0; k < 3; k++) e[k] = point.p[k] - p[k];
            sum += chi_squared(&beyond, e, truth.matching, 3, 2);
            out += beyond * beyond;
            within += e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
        }
    }
    const double n = points * (double)trials, ratio = sum / (2 * n);
    print_message("matching: empirical over predicted variance %.3f; beyond the two directions %.1e of it\n",
                  ratio, out / within);
    check_near(ratio, 1, 3.29 / sqrt(n)); /* variance of chi^2_2 / 2 is 1 */
    check_less(out / within, 1e-3);
    td_rig_free(&rig);
}

/* Sigmas of a good calibration, correlated at random. */
static void give_covariance(td_rig *rig, td_random *random)
{
    const size_t n = td_rig_parameter_count(rig);
    double *b = calloc(n * n, sizeof *b), *sigma = calloc(n, sizeof *sigma);
    for (int c = 0; c < rig->count; c++) {
        double *s = sigma + td_rig_parameter_offset(rig, c);
        const int count = td_camera_parameter_count(rig->camera[c].camera.model);
        for (int k = 0; k < count; k++) s[k] = k < 4 ? 0.5 : k == 6 || k == 7 ? 1e-4 : 1e-3;
        for (int k = 0; c > 0 && k < 6; k++) s[count + k] = k < 3 ? 2e-4 : 2e-4;
    }
    for (size_t i = 0; i < n * n; i++) b[i] = td_random_normal(random);
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    td_multiply_transposed(rig->covariance, b, b, n, n, n);
    for (size_t i = 0; i < n * n; i++)
        rig->covariance[i] =
            sigma[i / n] * sigma[i % n] * (0.5 * rig->covariance[i] / (double)n + 0.5 * (i / n == i % n));
    free(b);
    free(sigma);
}

static td_rig *drawn_rig(const td_rig *rig, const double *root, td_random *random)
{
    const size_t n = td_rig_parameter_count(rig);
    td_rig *drawn = td_rig_copy(rig);
    double unit[64];
    for (size_t i = 0; i < n; i++) unit[i] = td_random_normal(random);
    for (size_t i = 0; i < n; i++) {
        double step = 0;
        for (size_t k = 0; k <= i; k++) step += root[i * n + k] * unit[k];
        if (step != 0) move_parameter(drawn, i, step);
    }
    return drawn;
}

/* One rig drawn is one error for all points: four together are judged by their joint covariance, and each
 * draw counts once. With the match's noise, and without. */
static void coverage(const char *name, bool noisy, int draws)
{
    enum { POINTS = 4, SIZE = 3 * POINTS };
    td_rig *rig = make_rig(&brown5, &brown8, motions[0]);
    const td_pair pair = pair_of(rig);
    td_random random = td_random_seed(13, noisy);
    td_error error = {0};
    td_match match[POINTS];
    td_point3 alone;
    double p[SIZE], joint[SIZE * SIZE], sum = 0, first = 0;
    give_covariance(rig, &random);
    const size_t n = td_rig_parameter_count(rig);
    double *root = calloc(n * n, sizeof *root);
    cholesky(root, rig->covariance, n);
    for (int i = 0; i < POINTS; i++) {
        while (!draw(p + 3 * i, &match[i], &pair, &random)) {
        }
        for (int k = 0; k < 4; k++) match[i].covariance[k] = noisy ? match_covariance[k] : 0;
    }
    check_ok(td_triangulate_joint(joint, &pair, match, POINTS, &error), error);
    assert_true(td_triangulate(&alone, &pair, &match[0]));
    for (int i = 0; i < 9; i++)
        check_near(joint[i / 3 * SIZE + i % 3], alone.covariance[i], 1e-12 * joint[0] + 1e-15);
    for (int d = 0; d < draws; d++) {
        td_rig *drawn = drawn_rig(rig, root, &random);
        const td_pair other = pair_of(drawn);
        double e[SIZE];
        for (int i = 0; i < POINTS; i++) {
            td_match taken = match[i];
            td_point3 point;
            if (noisy) add_noise(&taken, &random);
            assert_true(td_triangulate(&point, &other, &taken));
            for (int k = 0; k < 3; k++) e[3 * i + k] = point.p[k] - p[3 * i + k];
        }
        sum += chi_squared(NULL, e, joint, SIZE, SIZE);
        first += chi_squared(NULL, e, alone.covariance, 3, 3);
        td_rig_free(&drawn);
    }
    print_message("%s: empirical over predicted variance %.3f of one point, %.3f of four together, %d rigs\n",
                  name, first / (3. * draws), sum / (SIZE * (double)draws), draws);
    check_near(first / (3. * draws), 1, 3.29 * sqrt(2 / (3. * draws)));
    check_near(sum / (SIZE * (double)draws), 1, 3.29 * sqrt(2 / (SIZE * (double)draws)));
    free(root);
    td_rig_free(&rig);
}

static void test_coverage_of_calibration(void **state)
{
    (void)state;
    coverage("calibration", false, full() ? 20000 : 1000);
    coverage("matching and calibration", true, full() ? 20000 : 1000);
}

/* ---- what has no point ---- */

static void test_refused(void **state)
{
    (void)state;
    td_rig *rig = make_rig(&pinhole, &pinhole, motions[1]);
    const td_pair pair = pair_of(rig);
    td_error error = {0};
    td_point3 point;
    double covariance[36];
    td_match match[2] = {{.left = {640, 480}, .right = {600, 480}, .covariance = {1, 0, 0, 1}},
                         {.left = {640, 480}, .right = {640, 480}, .covariance = {1, 0, 0, 1}}};
    assert_true(td_triangulate(&point, &pair, &match[0]));
    assert_false(td_triangulate(&point, &pair, &match[1])); /* parallel rays */
    match[1].right[0] = 700;
    assert_false(td_triangulate(&point, &pair, &match[1])); /* they meet behind the cameras */
    match[1].right[0] = NAN;
    assert_false(td_triangulate(&point, &pair, &match[1]));
    match[1].right[0] = 700;
    check_fails(td_triangulate_joint(covariance, &pair, match, 2, &error), TD_ERROR_DATA, error,
                "rig has no covariance");
    td_random random = td_random_seed(1, 1);
    give_covariance(rig, &random);
    check_fails(td_triangulate_joint(covariance, &pair, match, 2, &error), TD_ERROR_DATA, error, "match 1");
    match[1] = match[0];
    match[1].covariance[0] = NAN;
    check_fails(td_triangulate_joint(covariance, &pair, match, 2, &error), TD_ERROR_DATA, error, "refine it");
    assert_true(td_triangulate(&point, &pair, &match[1]) && isnan(point.covariance[0]) &&
                isfinite(point.calibration[0]));
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_corrected_pair),
        cmocka_unit_test(test_far_pairs),
        cmocka_unit_test(test_points),
        cmocka_unit_test(test_bias),
        cmocka_unit_test(test_derivatives),
        cmocka_unit_test(test_coverage_of_matching),
        cmocka_unit_test(test_coverage_of_calibration),
        cmocka_unit_test(test_refused),
    };
    td_linalg_single_thread();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
