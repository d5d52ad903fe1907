/* Proves that the camera models give the pixels that OpenCV gives, that every derivative is the derivative of
 * what is computed, and that un-projection inverts projection on the near side of the fold and refuses the
 * rest.
 *
 * References: pixels from OpenCV 4.6 (other code, same formulas), agreeing to 1e-9 px, some thousand
 * roundings of a pixel; folds solved by hand for one coefficient at a time; fisheye beyond 90 degrees from
 * the angle itself, as OpenCV cannot go there. Derivatives against fourth-order central differences with
 * steps of 1e-3 to 1e-4, whose truncation and rounding are under 1e-9: 1e-8 of the scale is asked for; the
 * series near the fisheye's axis against closed forms in 40 digits, to 1e-15. Blind to a fold that is
 * narrower than 1/64 of the way to the pixel, and to what a lens really does. */
#include "core/camera.h"
#include "core/random.h"
#include "tests/check.h"

#define PI 3.14159265358979323846

static const double POISON = -12345.678;

static void poison(double *values, int count)
{
    for (int i = 0; i < count; i++) values[i] = POISON;
}

static void check_poisoned(const double *values, int count)
{
    for (int i = 0; i < count; i++) assert_true(values[i] == POISON);
}

/* ---- Against OpenCV ---- */

typedef struct reference {
    double point[3], pixel[2];
} reference;

/* cv2.projectPoints and cv2.fisheye.projectPoints of python3-opencv 4.6.0 with zero rotation and translation,
 * the parameters of reference_cameras below. */
static const td_camera reference_cameras[TD_CAMERA_MODEL_COUNT] = {
    {TD_CAMERA_PINHOLE, 1280, 960, {812.5, 809.75, 641.25, 483.5}},
    {TD_CAMERA_BROWN5,
     1280,
     960,
     {812.5, 809.75, 641.25, 483.5, -0.2875, 0.0925, 0.00125, -0.0005, -0.01375}},
    {TD_CAMERA_BROWN8,
     1280,
     960,
     {812.5, 809.75, 641.25, 483.5, 0.4125, 0.0875, 0.00125, -0.0005, 0.0105, 0.7025, 0.2025, 0.0305}},
    {TD_CAMERA_FISHEYE, 1280, 960, {812.5, 809.75, 641.25, 483.5, -0.0215, 0.0105, -0.00325, 0.0005}},
};

static const reference references[TD_CAMERA_MODEL_COUNT][10] = {
    {
        {{0, 0, 1.5}, {641.25, 483.5}},
        {{1e-05, -2e-05, 1.25}, {641.2565, 483.487044}},
        {{-0.0985, -0.1429, 1.3067}, {580.0031568072243, 394.94618121986684}},
        {{0.3575, -0.5209, 2.0067}, {785.9994642946131, 273.3047665321174}},
        {{0.7648, -0.2542, 2.8001}, {863.1706456912253, 409.98889325381236}},
        {{0.0616, 0.4915, 1.093}, {687.0413998170173, 847.6282021957913}},
        {{0.0018, -0.3439, 1.9515}, {641.999423520369, 340.80308736869074}},
        {{-0.6847, -0.0575, 2.4509}, {414.26450487575994, 464.50264188665386}},
        {{-0.3705, 0.5174, 2.2718}, {508.74218681221936, 667.9196892332071}},
        {{-0.0002, -0.5701, 1.8291}, {641.1611584932481, 231.1144141927724}},
    },
    {
        {{0, 0, 1.5}, {641.25, 483.5}},
        {{1e-05, -2e-05, 1.25}, {641.2564999995574, 483.487044000947}},
        {{-0.0985, -0.1429, 1.3067}, {580.317003305968, 395.4281756509766}},
        {{0.3575, -0.5209, 2.0067}, {781.8441358144211, 279.3807038002368}},
        {{0.7648, -0.2542, 2.8001}, {857.8795827489214, 411.814259886575}},
        {{0.0616, 0.4915, 1.093}, {684.4761425253108, 828.1009456565679}},
        {{0.0018, -0.3439, 1.9515}, {641.9798516934183, 342.15891288821}},
        {{-0.6847, -0.0575, 2.4509}, {419.18334704642314, 464.99654661864537}},
        {{-0.3705, 0.5174, 2.2718}, {511.52793732599093, 664.077637802703}},
        {{-0.0002, -0.5701, 1.8291}, {641.1241668113025, 238.24127065162122}},
    },
    {
        {{0, 0, 1.5}, {641.25, 483.5}},
        {{1e-05, -2e-05, 1.25}, {641.2564999995574, 483.487044000947}},
        {{-0.0985, -0.1429, 1.3067}, {580.3197797876306, 395.4321900301867}},
        {{0.3575, -0.5209, 2.0067}, {781.801609034563, 279.44245827003385}},
        {{0.7648, -0.2542, 2.8001}, {857.8267037500009, 411.8317760294384}},
        {{0.0616, 0.4915, 1.093}, {684.4419877082764, 827.8293502877268}},
        {{0.0018, -0.3439, 1.9515}, {641.9797905644797, 342.17055238252846}},
        {{-0.6847, -0.0575, 2.4509}, {419.23426419676935, 465.00080808627223}},
        {{-0.3705, 0.5174, 2.2718}, {511.5576054176173, 664.0363468017706}},
        {{-0.0002, -0.5701, 1.8291}, {641.1241922989561, 238.31367730741525}},
    },
    {
        {{0, 0, 1.5}, {641.25, 483.5}},
        {{1e-05, -2e-05, 1.25}, {641.2564999999993, 483.48704400000145}},
        {{-0.2955, -0.4287, 1.3067}, {466.9053531069736, 231.4235914632014}},
        {{1.0725, -1.5627, 2.0067}, {985.9488526260869, -17.0480065638352}},
        {{2.2944, -0.7626, 2.8001}, {1185.7044342284125, 303.1497315139952}},
        {{0.1848, 1.4745, 1.093}, {734.6879200139587, 1226.508118719989}},
        {{0.0054, -1.0317, 1.9515}, {643.3087756726676, 91.49077650313149}},
        {{-2.0541, -0.1725, 2.4509}, {79.81143656051995, 436.51087656519877}},
        {{-1.1115, 1.5522, 2.2718}, {313.41551625116887, 939.76844303294}},
        {{-0.0006, -1.7103, 1.8291}, {641.037695978755, -119.62433602425597}},
    },
};

static void test_projection_is_opencvs(void **state)
{
    (void)state;
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int i = 0; i < 10; i++) {
            double pixel[2];
            assert_true(td_camera_project(pixel, NULL, NULL, &reference_cameras[m], references[m][i].point));
            check_near(pixel[0], references[m][i].pixel[0], 1e-9);
            check_near(pixel[1], references[m][i].pixel[1], 1e-9);
        }
}

/* Beyond 90 degrees too, the radius is f (t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9). */
static void test_fisheye_beyond_90_degrees(void **state)
{
    (void)state;
    const td_camera *c = &reference_cameras[TD_CAMERA_FISHEYE];
    const double *k = c->parameter;
    for (double t = 0.1; t < 3.1; t += 0.1) {
        double phi = 5 * t,
               radius = t + k[4] * pow(t, 3) + k[5] * pow(t, 5) + k[6] * pow(t, 7) + k[7] * pow(t, 9);
        double p[3] = {3 * sin(t) * cos(phi), 3 * sin(t) * sin(phi), 3 * cos(t)}, pixel[2];
        assert_true(td_camera_project(pixel, NULL, NULL, c, p));
        check_near(pixel[0], k[0] * radius * cos(phi) + k[2], 1e-9);
        check_near(pixel[1], k[1] * radius * sin(phi) + k[3], 1e-9);
    }
}

/* The Jacobians of the undistorted fisheye on both sides of where the series end, from mpmath with 40 digits:
 * at (2 t, 0, 2) the derivatives du/dx = z/n^2, dv/dy = theta/rho, du/dz = -rho/n^2; at the pixel (t, 0)
 * those of the ray, cos t, sin t / t, -sin t. */
static void test_fisheye_near_the_axis(void **state)
{
    (void)state;
    static const double projected[][4] = {
        {0.001, 0.4999995000005, 0.49999983333343333, -0.00049999950000050001},
        {0.03, 0.49955040463582776, 0.49985008094796499, -0.014986512139074832},
        {0.0499, 0.49875808737485574, 0.4995856172476993, -0.024888028560005301},
        {0.0501, 0.49874813718817631, 0.49958229388768917, -0.024987281673127632},
        {0.3, 0.45871559633027523, 0.48576132412977849, -0.13761467889908256},
    };
    static const double unprojected[][4] = {
        {0.001, 0.99999950000004167, 0.99999983333334167, -0.00099999983333334169},
        {0.03, 0.99955003374898752, 0.99985000674985536, -0.02999550020249566},
        {0.0999, 0.99501414364465299, 0.99833749480779881, -0.099733915731299104},
        {0.1001, 0.9949941769613569, 0.99833083480542496, -0.099932916564023033},
        {0.7, 0.76484218728448845, 0.92031098176813009, -0.64421768723769102},
    };
    const td_camera c = {TD_CAMERA_FISHEYE, 10, 10, {1, 1, 0, 0}};
    for (int i = 0; i < 5; i++) {
        const double p[3] = {2 * projected[i][0], 0, 2}, pixel[2] = {unprojected[i][0], 0};
        double j[6], ray[3];
        assert_true(td_camera_project(NULL, j, NULL, &c, p));
        check_near(j[0], projected[i][1], 1e-15);
        check_near(j[4], projected[i][2], 1e-15);
        check_near(j[2], projected[i][3], 1e-15);
        assert_true(td_camera_unproject(ray, j, NULL, &c, pixel));
        check_near(j[0], unprojected[i][1], 1e-15);
        check_near(j[3], unprojected[i][2], 1e-15);
        check_near(j[4], unprojected[i][3], 1e-15);
    }
}

/* ---- Random cameras and points ---- */

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

/* Distortions of real lenses, strong ones too, without a fold as far as random_point goes. */
static td_camera random_camera(td_random *random, td_camera_model model)
{
    td_camera c = {.model = model, .width = 1280, .height = 960};
    double *p = c.parameter;
    p[0] = between(random, 300, 3000);
    p[1] = p[0] * between(random, 0.9, 1.1);
    p[2] = between(random, 500, 800);
    p[3] = between(random, 400, 600);
    if (model == TD_CAMERA_FISHEYE) {
        for (int i = 4; i < 8; i++) p[i] = between(random, -1, 1) * pow(10, 2 - i);
    } else if (model != TD_CAMERA_PINHOLE) {
        p[4] = between(random, -0.25, 0.4);
        p[5] = between(random, -0.1, 0.2);
        p[6] = between(random, -0.01, 0.01);
        p[7] = between(random, -0.01, 0.01);
        p[8] = between(random, -0.02, 0.1);
    }
    if (model == TD_CAMERA_BROWN8) {
        p[9] = p[4] + between(random, -0.1, 0.2);
        p[10] = p[5] + between(random, -0.05, 0.1);
        p[11] = p[8] + between(random, -0.02, 0.05);
    }
    return c;
}

/* From straight ahead, over a hair's breadth beside the axis, to as wide as the model goes; from 0.1 to 100
 * m. */
static void random_point(double p[3], td_random *random, td_camera_model model, int index)
{
    const double widest = model == TD_CAMERA_FISHEYE ? 2.6 : 0.7;
    double theta = between(random, 0, widest), phi = between(random, -PI, PI),
           d = pow(10, between(random, -1, 2));
    if (index % 4 == 1) theta = pow(10, between(random, -12, -1));
    if (index % 16 == 2) theta = atan(0.05) * (1 + between(random, -1e-3, 1e-3));
    if (index % 16 == 6) theta = 0;
    p[0] = d * sin(theta) * cos(phi);
    p[1] = d * sin(theta) * sin(phi);
    p[2] = d * cos(theta);
}

/* f'(x) from values at x - 2h, x - h, x + h, x + 2h. */
static double difference(const double f[4], double h)
{
    return (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
}

static const double STENCIL[4] = {-2, -1, 1, 2};

/* Compares a column of a Jacobian; counts bits that differ, so that a test of a function with itself is seen.
 */
static void compare_column(const double *column, int stride, int rows, const double values[4][3], double h,
                           double scale, long *different)
{
    for (int r = 0; r < rows; r++) {
        double f[4];
        for (int s = 0; s < 4; s++) f[s] = values[s][r];
        double d = difference(f, h);
        check_near(column[r * stride] / scale, d / scale, 1e-8);
        *different += column[r * stride] != d;
    }
}

static double largest_of(const double *values, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++) largest = fmax(largest, fabs(values[i]));
    return largest;
}

/* A step of a parameter: focal lengths and centre by a thousandth of f, coefficients by 1e-3. */
static double parameter_step(const td_camera *c, int index)
{
    return 1e-3 * (index < 4 ? c->parameter[0] : 1);
}

static void test_projection_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(11, 1);
    long different = 0;
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int i = 0; i < 2000; i++) {
            const td_camera c = random_camera(&random, (td_camera_model)m);
            const int count = td_camera_parameter_count(c.model);
            double p[3], pixel[2], alone[2], d_point[6], d_parameter[24], values[4][3];
            random_point(p, &random, c.model, i);
            poison(d_parameter, 24);
            assert_true(td_camera_project(pixel, d_point, d_parameter, &c, p));
            assert_true(td_camera_project(alone, NULL, NULL, &c, p));
            assert_memory_equal(pixel, alone, sizeof pixel);
            check_poisoned(d_parameter + 2 * count, 24 - 2 * count);
            assert_true(largest_of(d_point, 6) > 0);
            const double distance = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
            /* Beyond 90 degrees the scale of change is the distance from the axis behind. */
            const double reach = p[2] > 0 ? distance : hypot(p[0], p[1]);
            for (int k = 0; k < 3; k++) {
                const double h = 1e-3 * reach;
                for (int s = 0; s < 4; s++) {
                    double q[3] = {p[0], p[1], p[2]};
                    q[k] += STENCIL[s] * h;
                    assert_true(td_camera_project(values[s], NULL, NULL, &c, q));
                }
                compare_column(d_point + k, 3, 2, values, h,
                               fmax(largest_of(d_point, 6), c.parameter[0] / reach), &different);
            }
            for (int k = 0; k < count; k++) {
                const double h = parameter_step(&c, k);
                for (int s = 0; s < 4; s++) {
                    td_camera moved = c;
                    moved.parameter[k] += STENCIL[s] * h;
                    assert_true(td_camera_project(values[s], NULL, NULL, &moved, p));
                }
                compare_column(d_parameter + k, count, 2, values, h, k < 4 ? 1 : c.parameter[0], &different);
                /* Off the axis, every parameter counts for something. */
                if (i % 4 == 0) assert_true(fabs(d_parameter[k]) + fabs(d_parameter[count + k]) > 0);
            }
        }
    assert_true(different > 10000);
}

static void test_unprojection_inverts(void **state)
{
    (void)state;
    td_random random = td_random_seed(12, 1);
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int i = 0; i < 20000; i++) {
            const td_camera c = random_camera(&random, (td_camera_model)m);
            double p[3], pixel[2], ray[3], again[2];
            random_point(p, &random, c.model, i);
            assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
            assert_true(td_camera_unproject(ray, NULL, NULL, &c, pixel));
            assert_true(td_camera_project(again, NULL, NULL, &c, ray));
            const double distance = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
            for (int k = 0; k < 3; k++) check_near(ray[k], p[k] / distance, 1e-12);
            for (int k = 0; k < 2; k++) check_near(again[k], pixel[k], 1e-9);
            check_near(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2], 1, 1e-15);
        }
}

static void test_unprojection_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(13, 1);
    long different = 0;
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int i = 0; i < 1000; i++) {
            const td_camera c = random_camera(&random, (td_camera_model)m);
            const int count = td_camera_parameter_count(c.model);
            double p[3], pixel[2], ray[3], alone[3], d_pixel[6], d_parameter[36], values[4][3];
            random_point(p, &random, c.model, i);
            assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
            poison(d_parameter, 36);
            assert_true(td_camera_unproject(ray, d_pixel, d_parameter, &c, pixel));
            assert_true(td_camera_unproject(alone, NULL, NULL, &c, pixel));
            assert_memory_equal(ray, alone, sizeof ray);
            check_poisoned(d_parameter + 3 * count, 36 - 3 * count);
            assert_true(largest_of(d_pixel, 6) > 0);
            for (int k = 0; k < 2; k++) {
                const double h = 1e-4 * c.parameter[0];
                for (int s = 0; s < 4; s++) {
                    double moved[2] = {pixel[0], pixel[1]};
                    moved[k] += STENCIL[s] * h;
                    assert_true(td_camera_unproject(values[s], NULL, NULL, &c, moved));
                }
                compare_column(d_pixel + k, 2, 3, values, h, largest_of(d_pixel, 6), &different);
            }
            for (int k = 0; k < count; k++) {
                double column[3] = {d_parameter[k], d_parameter[count + k], d_parameter[2 * count + k]};
                /* By what moves the ray 1e-4: near a fold, and for the ninth power at 150 degrees, it curves.
                 */
                const double h = fmin(parameter_step(&c, k), 1e-4 / largest_of(column, 3));
                for (int s = 0; s < 4; s++) {
                    td_camera moved = c;
                    moved.parameter[k] += STENCIL[s] * h;
                    assert_true(td_camera_unproject(values[s], NULL, NULL, &moved, pixel));
                }
                compare_column(column, 1, 3, values, h,
                               fmax(largest_of(column, 3), k < 4 ? 1 / c.parameter[0] : 1), &different);
                if (i % 4 == 0) assert_true(largest_of(column, 3) > 0);
            }
        }
    assert_true(different > 10000);
}

/* ---- Folds ---- */

static td_camera folding_camera(td_camera_model model)
{
    return (td_camera){model, 1280, 960, {500, 500, 640, 480}};
}

static void check_refused(const td_camera *c, double u, double v)
{
    double ray[3], d_pixel[6], d_parameter[36];
    const double pixel[2] = {500 * u + 640, 500 * v + 480};
    poison(ray, 3);
    poison(d_pixel, 6);
    poison(d_parameter, 36);
    assert_false(td_camera_unproject(ray, d_pixel, d_parameter, c, pixel));
    check_poisoned(ray, 3);
    check_poisoned(d_pixel, 6);
    check_poisoned(d_parameter, 36);
}

/* The image of (u, v) is seen in the direction (x, y, z). */
static void check_direction(const td_camera *c, double u, double v, double x, double y, double z,
                            double tolerance)
{
    double ray[3], n = sqrt(x * x + y * y + z * z);
    const double pixel[2] = {500 * u + 640, 500 * v + 480};
    assert_true(td_camera_unproject(ray, NULL, NULL, c, pixel));
    check_near(ray[0], x / n, tolerance);
    check_near(ray[1], y / n, tolerance);
    check_near(ray[2], z / n, tolerance);
}

/* f(r) = r - 0.3 r^3 turns at r^2 = 1/0.9, where it is r/1.5. */
static void test_fold_of_a_barrel(void **state)
{
    (void)state;
    td_camera c = folding_camera(TD_CAMERA_BROWN5);
    c.parameter[4] = -0.3;
    const double fold = sqrt(1 / 0.9), highest = fold / 1.5;
    for (double r = 0; r < 0.9995; r += 0.001) {
        double x = r * fold, u = x - 0.3 * x * x * x;
        check_direction(&c, u, 0, x, 0, 1, 1e-12);
        check_direction(&c, -0.6 * u, 0.8 * u, -0.6 * x, 0.8 * x, 1, 1e-12);
    }
    for (double e = 1e-6; e < 1e6; e *= 3) {
        check_refused(&c, highest + e, 0);
        check_refused(&c, 0, -highest - e);
    }
    /* Beyond the fold the model has a pixel, and the pixel is that of another point, nearer to the axis:
     * f(1.4) = 0.5768 = f(0.6607…), by the quadratic that is left when 1.4 is divided out. */
    double p[3] = {1.4, 0, 1}, pixel[2], near_one = (-1.4 + sqrt(1.4 * 1.4 - 4 * (1.4 * 1.4 - 1 / 0.3))) / 2;
    assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
    check_near(pixel[0], 640 + 500 * 0.5768, 1e-9);
    check_direction(&c, 0.5768, 0, near_one, 0, 1, 1e-12);
}

/* 1 - 1.8 w + 0.6 w^2 is negative between w = 0.736 and 2.264 and positive beyond: a far side that must not
 * be found. */
static void test_far_side_of_two_folds(void **state)
{
    (void)state;
    td_camera c = folding_camera(TD_CAMERA_BROWN5);
    c.parameter[4] = -0.6;
    c.parameter[5] = 0.12;
    for (double r = 1.6; r < 8; r += 0.01) {
        double p[3] = {0.6 * r, -0.8 * r, 1}, pixel[2], ray[3], again[2];
        assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
        double u = r * (1 - 0.6 * r * r + 0.12 * pow(r, 4));
        if (fabs(u) > 0.536) {
            check_refused(&c, 0.6 * u, -0.8 * u);
        } else if (fabs(u) < 0.535) { /* the pixel has a near one as well */
            assert_true(td_camera_unproject(ray, NULL, NULL, &c, pixel));
            assert_true(hypot(ray[0], ray[1]) / ray[2] < 0.8580);
            assert_true(td_camera_project(again, NULL, NULL, &c, ray));
            check_near(again[0], pixel[0], 1e-9);
        }
    }
}

/* Beyond the pole of 1/(1 - w/2) everything is upside down; short of it, every pixel has its ray. */
static void test_pole(void **state)
{
    (void)state;
    td_camera c = folding_camera(TD_CAMERA_BROWN8);
    c.parameter[9] = -0.5;
    for (double r = 0; r < 1.4; r += 0.01) {
        double u = r / (1 - r * r / 2);
        check_direction(&c, u, 0, r, 0, 1, 1e-12);
    }
    /* r / (1 - r^2/2) = -2 at r = 2, beyond the pole, and at r = -1. */
    double p[3] = {2, 0, 1}, pixel[2];
    assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
    check_near(pixel[0], 640 - 1000, 1e-9);
    check_direction(&c, -2, 0, -1, 0, 1, 1e-12);
    /* A zero that all but cancels the pole: beyond both, nothing looks odd but the sign of the denominator.
     */
    c.parameter[4] = -1.00001;
    c.parameter[9] = -1;
    check_direction(&c, 0.5 * (1 - 0.25 * 1.00001) / 0.75, 0, 0.5, 0, 1, 1e-12);
    check_refused(&c, 2 * (1 - 4 * 1.00001) / -3, 0);
}

/* v = b + 0.6 b^2 along the vertical: turns at b = -1/1.2, where it is -1/2.4. */
static void test_fold_of_the_tangential_part(void **state)
{
    (void)state;
    td_camera c = folding_camera(TD_CAMERA_BROWN5);
    c.parameter[6] = 0.2;
    for (double v = -0.416; v < 2; v += 0.01)
        check_direction(&c, 0, v, 0, (-1 + sqrt(1 + 2.4 * v)) / 1.2, 1, 1e-12);
    for (double v = -0.4167; v > -100; v *= 1.1) check_refused(&c, 0, v);
}

/* Where v falls, rises a little and falls again along the negative vertical, a pixel past the rise has a far
 * ray only, at which the Jacobian is positive definite again. The first lens needs the tangential part in the
 * bound that spares most pixels a search, the second the denominator. */
static void test_fold_between_two_parts(void **state)
{
    (void)state;
    td_camera lens[2] = {folding_camera(TD_CAMERA_BROWN5), folding_camera(TD_CAMERA_BROWN8)};
    const double near_end[2] = {-0.83, -1.25}, far_end[2] = {-3, -4.36};
    lens[0].parameter[6] = 0.2;
    lens[0].parameter[8] = 0.005;
    lens[1].parameter[4] = 1. / 3;
    lens[1].parameter[6] = 0.038;
    lens[1].parameter[8] = 0.002;
    lens[1].parameter[9] = 1;
    for (int i = 0; i < 2; i++) {
        int rises = 0;
        double last = 480, pixel[2], ray[3];
        for (double b = 0; b >= far_end[i]; b -= 0.01) {
            const double p[3] = {0, b, 1};
            assert_true(td_camera_project(pixel, NULL, NULL, &lens[i], p));
            rises += pixel[1] > last;
            if (b > near_end[i]) {
                assert_true(td_camera_unproject(ray, NULL, NULL, &lens[i], pixel));
                check_near(ray[1] / ray[2], b, 1e-6);
            }
            last = pixel[1];
        }
        assert_true(rises > 5);
        check_refused(&lens[i], 0, (last - 480) / 500);
    }
}

static void test_fold_of_a_fisheye(void **state)
{
    (void)state;
    td_camera c = folding_camera(TD_CAMERA_FISHEYE);
    /* Without distortion: as far as the point straight behind, which is a circle of pixels and no direction.
     */
    for (double t = 0; t < 3.14; t += 0.01)
        check_direction(&c, 0.6 * t, 0.8 * t, 0.6 * sin(t), 0.8 * sin(t), cos(t), 1e-12);
    check_refused(&c, PI + 1e-6, 0);
    check_refused(&c, 0, -7);
    /* t - 0.1 t^3 turns at t^2 = 1/0.3, beyond 90 degrees. */
    c.parameter[4] = -0.1;
    const double fold = sqrt(1 / 0.3);
    for (double t = 0.01; t < 0.9995 * fold; t += 0.01)
        check_direction(&c, 0, t - 0.1 * t * t * t, 0, sin(t), cos(t), 1e-12);
    for (double e = 1e-6; e < 1e3; e *= 3) check_refused(&c, fold / 1.5 + e, 0);
}

/* ---- What has no image, and outputs ---- */

static void test_points_without_an_image(void **state)
{
    (void)state;
    const double none[][3] = {{0, 0, 0},   {0, 0, -1},  {0.1, 0.2, -1},     {0.1, 0.2, 0},
                              {0, 0, NAN}, {NAN, 0, 1}, {1e300, 0, 1e-300}, {INFINITY, 0, 1}};
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
            double pixel[2], d_point[6], d_parameter[24];
            poison(pixel, 2);
            poison(d_point, 6);
            poison(d_parameter, 24);
            bool seen = td_camera_project(pixel, d_point, d_parameter, &reference_cameras[m], none[i]);
            /* A fisheye sees to the side and behind. */
            bool expected = m == TD_CAMERA_FISHEYE && (i == 2 || i == 3);
            assert_int_equal(seen, expected);
            if (!seen) {
                check_poisoned(pixel, 2);
                check_poisoned(d_point, 6);
                check_poisoned(d_parameter, 24);
            }
        }
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        check_refused(&reference_cameras[m], NAN, 0);
        check_refused(&reference_cameras[m], 0, INFINITY);
    }
}

static void test_outputs_may_be_null(void **state)
{
    (void)state;
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        const td_camera *c = &reference_cameras[m];
        const double p[3] = {0.1, -0.2, 1};
        double pixel[2], d_point[6], d_parameter[36], alone[36], ray[3];
        assert_true(td_camera_project(pixel, d_point, d_parameter, c, p));
        assert_true(td_camera_project(NULL, NULL, alone, c, p));
        assert_memory_equal(alone, d_parameter,
                            2 * (size_t)td_camera_parameter_count(c->model) * sizeof(double));
        assert_true(td_camera_project(NULL, alone, NULL, c, p));
        assert_memory_equal(alone, d_point, sizeof d_point);
        assert_true(td_camera_unproject(ray, d_point, d_parameter, c, pixel));
        assert_true(td_camera_unproject(NULL, alone, NULL, c, pixel));
        assert_memory_equal(alone, d_point, sizeof d_point);
        assert_true(td_camera_unproject(NULL, NULL, alone, c, pixel));
        assert_memory_equal(alone, d_parameter,
                            3 * (size_t)td_camera_parameter_count(c->model) * sizeof(double));
    }
}

/* ---- Names and checks ---- */

static void test_names(void **state)
{
    (void)state;
    const char *names[] = {"pinhole", "brown5", "brown8", "fisheye"};
    const int counts[] = {4, 9, 12, 8};
    const char *last[] = {"cy", "k3", "k6", "k4"};
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        const td_camera_model model = (td_camera_model)m;
        assert_string_equal(td_camera_model_name(model), names[m]);
        assert_int_equal(td_camera_model_from_name(names[m]), model);
        assert_int_equal(td_camera_parameter_count(model), counts[m]);
        assert_string_equal(td_camera_parameter_name(model, 0), "fx");
        assert_string_equal(td_camera_parameter_name(model, counts[m] - 1), last[m]);
        assert_null(td_camera_parameter_name(model, counts[m]));
        assert_null(td_camera_parameter_name(model, -1));
    }
    assert_string_equal(td_camera_parameter_name(TD_CAMERA_BROWN5, 6), "p1");
    assert_string_equal(td_camera_parameter_name(TD_CAMERA_FISHEYE, 6), "k3");
    for (int bad = -1; bad <= TD_CAMERA_MODEL_COUNT; bad += TD_CAMERA_MODEL_COUNT + 1) {
        assert_null(td_camera_model_name((td_camera_model)bad));
        assert_null(td_camera_parameter_name((td_camera_model)bad, 0));
        assert_int_equal(td_camera_parameter_count((td_camera_model)bad), 0);
        td_camera c = reference_cameras[0];
        double pixel[2] = {POISON, POISON}, p[3] = {0, 0, 1};
        c.model = (td_camera_model)bad;
        assert_false(td_camera_project(pixel, NULL, NULL, &c, p));
        check_poisoned(pixel, 2);
        assert_false(td_camera_unproject(NULL, NULL, NULL, &c, p));
    }
    assert_int_equal(td_camera_model_from_name("brown"), TD_CAMERA_MODEL_COUNT);
    assert_int_equal(td_camera_model_from_name("Pinhole"), TD_CAMERA_MODEL_COUNT);
    assert_int_equal(td_camera_model_from_name(""), TD_CAMERA_MODEL_COUNT);
    assert_int_equal(td_camera_model_from_name(NULL), TD_CAMERA_MODEL_COUNT);
}

static void test_matrix(void **state)
{
    (void)state;
    double k[9];
    td_camera_matrix(k, &reference_cameras[1]);
    const double expected[9] = {812.5, 0, 641.25, 0, 809.75, 483.5, 0, 0, 1};
    assert_memory_equal(k, expected, sizeof k);
}

static void check_bad_parameter(td_camera_model model, int index, double value, const char *field)
{
    td_error error = {0};
    td_camera c = reference_cameras[model];
    c.parameter[index] = value;
    check_fails(td_camera_check(&c, &error), TD_ERROR_ARGUMENT, error, field);
    assert_true(strncmp(error.message, field, strlen(field)) == 0);
}

static void test_check(void **state)
{
    (void)state;
    td_error error = {0};
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        check_ok(td_camera_check(&reference_cameras[m], &error), error);
        for (int i = 0; i < td_camera_parameter_count((td_camera_model)m); i++) {
            char field[8];
            snprintf(field, sizeof field, "%s: ", td_camera_parameter_name((td_camera_model)m, i));
            const double bad[] = {NAN, INFINITY, -INFINITY, 1e8, -1e8};
            for (int b = 0; b < 5; b++) check_bad_parameter((td_camera_model)m, i, bad[b], field);
        }
        for (int i = td_camera_parameter_count((td_camera_model)m); i < TD_CAMERA_MAX_PARAMETERS; i++)
            check_bad_parameter((td_camera_model)m, i, 1e-3, "parameter ");
    }
    check_bad_parameter(TD_CAMERA_PINHOLE, 0, 0, "fx: ");
    check_bad_parameter(TD_CAMERA_PINHOLE, 1, 0.99, "fy: ");
    check_bad_parameter(TD_CAMERA_PINHOLE, 2, -4 * 1280 - 1, "cx: ");
    check_bad_parameter(TD_CAMERA_PINHOLE, 3, 5 * 960 + 1, "cy: ");
    check_bad_parameter(TD_CAMERA_BROWN8, 11, -10001, "k6: ");
    const int sizes[] = {0, -5, 65536};
    for (int i = 0; i < 3; i++) {
        td_camera c = reference_cameras[0];
        c.width = sizes[i];
        check_fails(td_camera_check(&c, &error), TD_ERROR_ARGUMENT, error, "width: ");
        c = reference_cameras[0];
        c.height = sizes[i];
        check_fails(td_camera_check(&c, &error), TD_ERROR_ARGUMENT, error, "height: ");
    }
    td_camera c = reference_cameras[0];
    c.model = TD_CAMERA_MODEL_COUNT;
    check_fails(td_camera_check(&c, &error), TD_ERROR_ARGUMENT, error, "model: ");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_projection_is_opencvs),
        cmocka_unit_test(test_fisheye_beyond_90_degrees),
        cmocka_unit_test(test_fisheye_near_the_axis),
        cmocka_unit_test(test_projection_derivatives),
        cmocka_unit_test(test_unprojection_inverts),
        cmocka_unit_test(test_unprojection_derivatives),
        cmocka_unit_test(test_fold_of_a_barrel),
        cmocka_unit_test(test_far_side_of_two_folds),
        cmocka_unit_test(test_pole),
        cmocka_unit_test(test_fold_of_the_tangential_part),
        cmocka_unit_test(test_fold_between_two_parts),
        cmocka_unit_test(test_fold_of_a_fisheye),
        cmocka_unit_test(test_points_without_an_image),
        cmocka_unit_test(test_outputs_may_be_null),
        cmocka_unit_test(test_names),
        cmocka_unit_test(test_matrix),
        cmocka_unit_test(test_check),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
