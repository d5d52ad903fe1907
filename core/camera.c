/* Every model is taken apart in the same way: a point p of the camera's frame is brought to a plane (a, b),
 * there distorted to (u, v), and scaled to the pixel (fx u + cx, fy v + cy). The plane is
 *
 *   pinhole, Brown   perspective:  (a, b) = (x, y) / z
 *   fisheye          equidistant:  (a, b) = (x, y) theta / rho,  rho = |(x, y)|, theta = atan2(rho, z)
 *
 * and on both planes the distortion is, with w = a^2 + b^2,
 *
 *   (u, v) = (a, b) N(w) / D(w) + (2 p1 ab + p2 (w + 2 a^2), p1 (w + 2 b^2) + 2 p2 ab),
 *
 * for Kannala and Brandt's theta_d = theta N(theta^2) is a radial distortion of the equidistant plane. Its
 * Jacobian by (a, b) is symmetric, and the identity at the centre: the near side of the fold is where it
 * stays positive definite on the way out from the centre. */
#include "core/camera.h"

#include <math.h>
#include <string.h>

enum {
    FOLD_SAMPLES = 64, /* on the way from the centre, where a bound does not settle it */
    CONTINUATION_STEPS = 64,
    NEWTON_STEPS = 30,
};

#define PIXEL_TOLERANCE 1e-9
#define PI 3.14159265358979323846

/* ---- Models by name ---- */

static const struct {
    const char *name;
    int count;
} models[TD_CAMERA_MODEL_COUNT] = {{"pinhole", 4}, {"brown5", 9}, {"brown8", 12}, {"fisheye", 8}};

static bool is_model(td_camera_model model)
{
    return (int)model >= 0 && model < TD_CAMERA_MODEL_COUNT;
}

const char *td_camera_model_name(td_camera_model model)
{
    return is_model(model) ? models[model].name : NULL;
}

td_camera_model td_camera_model_from_name(const char *name)
{
    int model = 0;
    while (name && model < TD_CAMERA_MODEL_COUNT && strcmp(name, models[model].name) != 0) model++;
    return name ? (td_camera_model)model : TD_CAMERA_MODEL_COUNT;
}

int td_camera_parameter_count(td_camera_model model)
{
    return is_model(model) ? models[model].count : 0;
}

const char *td_camera_parameter_name(td_camera_model model, int index)
{
    static const char *const brown[] = {"fx", "fy", "cx", "cy", "k1", "k2",
                                        "p1", "p2", "k3", "k4", "k5", "k6"};
    static const char *const fisheye[] = {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"};
    if (index < 0 || index >= td_camera_parameter_count(model)) return NULL;
    return model == TD_CAMERA_FISHEYE ? fisheye[index] : brown[index];
}

static td_status check_range(double value, double low, double high, const char *field, const char *why,
                             td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "%s: must be %g to %g%s, not %g", field, low, high, why, value);
}

td_status td_camera_check(const td_camera *camera, td_error *error)
{
    const double *p = camera->parameter;
    if (!is_model(camera->model))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "model: %d is none; there are pinhole, brown5, brown8 and fisheye",
                       (int)camera->model);
    TD_TRY(check_range(camera->width, 1, 65535, "width", " px", error));
    TD_TRY(check_range(camera->height, 1, 65535, "height", " px", error));
    TD_TRY(check_range(p[0], 1, 1e7, "fx", " px", error));
    TD_TRY(check_range(p[1], 1, 1e7, "fy", " px", error));
    TD_TRY(check_range(p[2], -4. * camera->width, 5. * camera->width, "cx",
                       " px (four image widths outside the image)", error));
    TD_TRY(check_range(p[3], -4. * camera->height, 5. * camera->height, "cy",
                       " px (four image heights outside the image)", error));
    int count = td_camera_parameter_count(camera->model);
    for (int i = 4; i < count; i++)
        TD_TRY(check_range(p[i], -1e4, 1e4, td_camera_parameter_name(camera->model, i), "", error));
    for (int i = count; i < TD_CAMERA_MAX_PARAMETERS; i++)
        if (!(p[i] == 0))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "parameter %d: %s has only %d, the others must be 0, not %g", i + 1,
                           td_camera_model_name(camera->model), count, p[i]);
    return TD_OK;
}

void td_camera_matrix(double k[9], const td_camera *camera)
{
    const double *p = camera->parameter;
    const double matrix[9] = {p[0], 0, p[2], 0, p[1], p[3], 0, 0, 1};
    memcpy(k, matrix, sizeof matrix);
}

/* ---- The distortion ---- */

/* N = 1 + n[0] w + … + n[3] w^4, D = 1 + d[0] w + … + d[2] w^3. */
typedef struct distortion {
    double n[4], d[3], p1, p2;
} distortion;

static distortion distortion_of(const td_camera *camera)
{
    const double *k = camera->parameter + 4;
    switch (camera->model) {
    case TD_CAMERA_BROWN5:
        return (distortion){{k[0], k[1], k[4], 0}, {0, 0, 0}, k[2], k[3]};
    case TD_CAMERA_BROWN8:
        return (distortion){{k[0], k[1], k[4], 0}, {k[5], k[6], k[7]}, k[2], k[3]};
    case TD_CAMERA_FISHEYE:
        return (distortion){{k[0], k[1], k[2], k[3]}, {0, 0, 0}, 0, 0};
    default:
        return (distortion){{0, 0, 0, 0}, {0, 0, 0}, 0, 0};
    }
}

/* A point of the plane, distorted. */
typedef struct distorted {
    double w, denominator, radial; /* D(w), N(w) / D(w) */
    double u, v;
    double ua, ub, vb; /* du/da, du/db = dv/da, dv/db */
} distorted;

static inline distorted distort(const distortion *l, double a, double b)
{
    const double *n = l->n, *d = l->d;
    double w = a * a + b * b;
    double top = 1 + w * (n[0] + w * (n[1] + w * (n[2] + w * n[3])));
    double top_w = n[0] + w * (2 * n[1] + w * (3 * n[2] + w * 4 * n[3]));
    double bottom = 1 + w * (d[0] + w * (d[1] + w * d[2]));
    double bottom_w = d[0] + w * (2 * d[1] + w * 3 * d[2]);
    double inverse = 1 / bottom, r = top * inverse, r_w = (top_w - r * bottom_w) * inverse;
    double ab2 = 2 * a * b;
    return (distorted){w,
                       bottom,
                       r,
                       a * r + l->p1 * ab2 + l->p2 * (w + 2 * a * a),
                       b * r + l->p1 * (w + 2 * b * b) + l->p2 * ab2,
                       r + 2 * a * a * r_w + 2 * l->p1 * b + 6 * l->p2 * a,
                       ab2 * r_w + 2 * l->p1 * a + 2 * l->p2 * b,
                       r + 2 * b * b * r_w + 6 * l->p1 * b + 2 * l->p2 * a};
}

/* Derivatives of u and v by the distortion parameters, in the order of the model. */
static inline void distortion_derivatives(double *du, double *dv, td_camera_model model, const distorted *s,
                                          double a, double b)
{
    const double w = s->w;
    if (model == TD_CAMERA_PINHOLE) return;
    if (model == TD_CAMERA_FISHEYE) {
        double power = 1;
        for (int i = 0; i < 4; i++) {
            power *= w;
            du[i] = a * power;
            dv[i] = b * power;
        }
        return;
    }
    const double f1 = w / s->denominator, f2 = f1 * w, f3 = f2 * w;
    du[0] = a * f1;
    dv[0] = b * f1;
    du[1] = a * f2;
    dv[1] = b * f2;
    du[2] = dv[3] = 2 * a * b;
    dv[2] = w + 2 * b * b;
    du[3] = w + 2 * a * a;
    du[4] = a * f3;
    dv[4] = b * f3;
    if (model == TD_CAMERA_BROWN5) return;
    const double r = -s->radial, powers[3] = {r * f1, r * f2, r * f3};
    for (int i = 0; i < 3; i++) {
        du[5 + i] = a * powers[i];
        dv[5 + i] = b * powers[i];
    }
}

/* ---- From the point to the plane, and back ---- */

/* (a, b) of the point and its Jacobian (2,3); false where the model has no image of it. */
static inline bool to_plane(double plane[2], double jacobian[6], td_camera_model model, const double p[3])
{
    const double x = p[0], y = p[1], z = p[2];
    if (model != TD_CAMERA_FISHEYE) {
        if (!(z > 0)) return false;
        const double s = 1 / z, a = x * s, b = y * s;
        const double j[6] = {s, 0, -a * s, 0, s, -b * s};
        plane[0] = a;
        plane[1] = b;
        memcpy(jacobian, j, sizeof j);
        return true;
    }
    /* h = theta/rho, g = (dh/drho)/rho. Near the axis both are series in t^2 = (rho/z)^2: the closed form of
     * g loses digits by cancellation, and is 0/0 on it. What is left out changes the Jacobian by
     * less than 1e-15. */
    const double rho2 = x * x + y * y, n2 = rho2 + z * z;
    double h, g;
    if (z > 0 && rho2 < 2.5e-3 * z * z) {
        const double t = rho2 / (z * z);
        h = (1 - t * (1. / 3 - t * (1. / 5 - t * (1. / 7 - t * (1. / 9 - t / 11))))) / z;
        g = -(2. / 3 - t * (4. / 5 - t * (6. / 7 - t * (8. / 9 - t * 10 / 11)))) / (z * z * z);
    } else {
        const double rho = sqrt(rho2);
        if (!(rho > 0)) return false;
        h = atan2(rho, z) / rho;
        g = (z / n2 - h) / rho2;
    }
    const double j[6] = {h + x * x * g, x * y * g, -x / n2, x * y * g, h + y * y * g, -y / n2};
    plane[0] = x * h;
    plane[1] = y * h;
    memcpy(jacobian, j, sizeof j);
    return isfinite(n2);
}

/* The unit direction of a point of the plane and its Jacobian (3,2). */
static void from_plane(double ray[3], double jacobian[6], td_camera_model model, double a, double b)
{
    const double w = a * a + b * b;
    if (model != TD_CAMERA_FISHEYE) {
        const double s = 1 / sqrt(1 + w), s3 = s * s * s;
        const double r[3] = {a * s, b * s, s};
        const double j[6] = {(1 + b * b) * s3, -a * b * s3, -a * b * s3, (1 + a * a) * s3, -a * s3, -b * s3};
        memcpy(ray, r, sizeof r);
        memcpy(jacobian, j, sizeof j);
        return;
    }
    /* s = sin(theta)/theta, q = (ds/dtheta)/theta; near the axis, where q loses digits, their series. */
    double s, q;
    const double theta = sqrt(w);
    if (w < 0.01) {
        s = 1 - w * (1. / 6 - w * (1. / 120 - w * (1. / 5040 - w / 362880)));
        q = -1. / 3 + w * (1. / 30 - w * (1. / 840 - w / 45360));
    } else {
        s = sin(theta) / theta;
        q = (cos(theta) - s) / w;
    }
    const double r[3] = {a * s, b * s, cos(theta)};
    const double j[6] = {s + a * a * q, a * b * q, a * b * q, s + b * b * q, -a * s, -b * s};
    memcpy(ray, r, sizeof r);
    memcpy(jacobian, j, sizeof j);
}

/* ---- Projection ---- */

bool td_camera_project(double pixel[2], double *d_point, double *d_parameter, const td_camera *camera,
                       const double p[3])
{
    const double fx = camera->parameter[0], fy = camera->parameter[1];
    double plane[2], lift[6];
    if (!is_model(camera->model) || !to_plane(plane, lift, camera->model, p)) return false;
    const distortion l = distortion_of(camera);
    const distorted s = distort(&l, plane[0], plane[1]);
    const double x = fx * s.u + camera->parameter[2], y = fy * s.v + camera->parameter[3];
    if (!isfinite(x) || !isfinite(y)) return false;
    if (pixel) {
        pixel[0] = x;
        pixel[1] = y;
    }
    if (d_point)
        for (int i = 0; i < 3; i++) {
            d_point[i] = fx * (s.ua * lift[i] + s.ub * lift[3 + i]);
            d_point[3 + i] = fy * (s.ub * lift[i] + s.vb * lift[3 + i]);
        }
    if (d_parameter) {
        const int count = models[camera->model].count;
        double *dx = d_parameter, *dy = d_parameter + count;
        dx[0] = s.u;
        dy[1] = s.v;
        dx[2] = dy[3] = 1;
        dx[1] = dx[3] = dy[0] = dy[2] = 0;
        distortion_derivatives(dx + 4, dy + 4, camera->model, &s, plane[0], plane[1]);
        for (int i = 4; i < count; i++) {
            dx[i] *= fx;
            dy[i] *= fy;
        }
    }
    return true;
}

/* ---- Un-projection ---- */

static bool is_positive_definite(const distorted *s)
{
    return s->denominator > 0 && s->ua > 0 && s->ua * s->vb - s->ub * s->ub > 0;
}

/* The point of the plane that is distorted to (u, v), by Newton's method from where `plane` stands. Steps
 * stay on the near side of a fold or give up. */
static bool newton(double plane[2], const distortion *l, double u, double v)
{
    double a = plane[0], b = plane[1];
    for (int i = 0; i < NEWTON_STEPS; i++) {
        const distorted s = distort(l, a, b);
        if (!is_positive_definite(&s)) return false;
        const double ru = s.u - u, rv = s.v - v, scale = 1 / (s.ua * s.vb - s.ub * s.ub);
        const double da = scale * (s.vb * ru - s.ub * rv), db = scale * (s.ua * rv - s.ub * ru);
        a -= da;
        b -= db;
        /* Convergence is quadratic: after a step of 1e-10 only rounding is left. */
        if (da * da + db * db <= 1e-20 * (1 + a * a + b * b)) {
            plane[0] = a;
            plane[1] = b;
            return true;
        }
    }
    return false;
}

/* A lower bound of the polynomial 1 + c[1] w + … + c[degree] w^degree on [0, w]. */
static double lower_bound(const double *c, int degree, double w)
{
    double bound = 1, power = 1;
    for (int i = 1; i <= degree; i++) {
        power *= w;
        if (c[i] < 0) bound += c[i] * power;
    }
    return bound;
}

/* True when the distortion surely has no fold within radius sqrt(w). The radial part's Jacobian has the
 * eigenvalues f'(r) and f(r)/r >= min f', where f(r) = r N/D and f' = [sum over i, j of (1 + 2i - 2j) n_i d_j
 * w^(i+j)] / D^2; the tangential part's are not below -6 |p| r. */
static bool surely_unfolded(const distortion *l, double w)
{
    const double n[5] = {1, l->n[0], l->n[1], l->n[2], l->n[3]}, d[4] = {1, l->d[0], l->d[1], l->d[2]};
    double slope[8] = {0}, largest = 1, power = 1;
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 4; j++) slope[i + j] += (1 + 2 * i - 2 * j) * n[i] * d[j];
    for (int j = 1; j < 4; j++) {
        power *= w;
        if (d[j] > 0) largest += d[j] * power;
    }
    const double tangential = 6 * sqrt((l->p1 * l->p1 + l->p2 * l->p2) * w);
    return lower_bound(d, 3, w) > 0 && lower_bound(slope, 7, w) > tangential * largest * largest;
}

/* True when the Jacobian is positive definite all the way from the centre, as far as samples tell. */
static bool is_unfolded(const distortion *l, const double plane[2])
{
    if (surely_unfolded(l, plane[0] * plane[0] + plane[1] * plane[1])) return true;
    for (int i = 1; i <= FOLD_SAMPLES; i++) {
        const distorted s = distort(l, plane[0] * i / FOLD_SAMPLES, plane[1] * i / FOLD_SAMPLES);
        if (!is_positive_definite(&s)) return false;
    }
    return true;
}

/* Straight to the solution, or, where that fails, from the centre outwards in small steps. */
static bool undistort(double plane[2], const distortion *l, double u, double v)
{
    plane[0] = u;
    plane[1] = v;
    if (newton(plane, l, u, v) && is_unfolded(l, plane)) return true;
    plane[0] = plane[1] = 0;
    for (int i = 1; i <= CONTINUATION_STEPS; i++)
        if (!newton(plane, l, u * i / CONTINUATION_STEPS, v * i / CONTINUATION_STEPS)) return false;
    return is_unfolded(l, plane);
}

/* Column of the ray's Jacobian for a change (du, dv) of the undistorted image: ray' J^-1 (du, dv). */
static void set_column(double *to, int stride, const double ray_plane[6], const double inverse[3], double du,
                       double dv)
{
    const double da = inverse[0] * du + inverse[1] * dv, db = inverse[1] * du + inverse[2] * dv;
    for (int i = 0; i < 3; i++) to[i * stride] = ray_plane[2 * i] * da + ray_plane[2 * i + 1] * db;
}

/* distort(plane, k) = ((x - cx)/fx, (y - cy)/fy) holds identically, so d plane = J^-1 (d right side - d
 * distort). */
static void unproject_derivatives(double *d_pixel, double *d_parameter, const td_camera *camera,
                                  const distorted *s, const double plane[2], const double ray_plane[6])
{
    const double fx = camera->parameter[0], fy = camera->parameter[1];
    const double scale = 1 / (s->ua * s->vb - s->ub * s->ub);
    const double inverse[3] = {scale * s->vb, -scale * s->ub, scale * s->ua};
    if (d_pixel) {
        set_column(d_pixel, 2, ray_plane, inverse, 1 / fx, 0);
        set_column(d_pixel + 1, 2, ray_plane, inverse, 0, 1 / fy);
    }
    if (d_parameter) {
        const int count = models[camera->model].count;
        double du[8], dv[8];
        distortion_derivatives(du, dv, camera->model, s, plane[0], plane[1]);
        set_column(d_parameter, count, ray_plane, inverse, -s->u / fx, 0);
        set_column(d_parameter + 1, count, ray_plane, inverse, 0, -s->v / fy);
        set_column(d_parameter + 2, count, ray_plane, inverse, -1 / fx, 0);
        set_column(d_parameter + 3, count, ray_plane, inverse, 0, -1 / fy);
        for (int i = 4; i < count; i++)
            set_column(d_parameter + i, count, ray_plane, inverse, -du[i - 4], -dv[i - 4]);
    }
}

bool td_camera_unproject(double ray[3], double *d_pixel, double *d_parameter, const td_camera *camera,
                         const double pixel[2])
{
    const double *p = camera->parameter;
    if (!is_model(camera->model)) return false;
    const distortion l = distortion_of(camera);
    const double u = (pixel[0] - p[2]) / p[0], v = (pixel[1] - p[3]) / p[1];
    double plane[2], direction[3], ray_plane[6];
    if (!undistort(plane, &l, u, v)) return false;
    const distorted s = distort(&l, plane[0], plane[1]);
    if (!(fabs(p[0] * (s.u - u)) <= PIXEL_TOLERANCE && fabs(p[1] * (s.v - v)) <= PIXEL_TOLERANCE))
        return false;
    if (camera->model == TD_CAMERA_FISHEYE && !(s.w < PI * PI)) return false;
    from_plane(direction, ray_plane, camera->model, plane[0], plane[1]);
    if (ray) memcpy(ray, direction, sizeof direction);
    unproject_derivatives(d_pixel, d_parameter, camera, &s, plane, ray_plane);
    return true;
}
