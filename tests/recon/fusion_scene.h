/* A stereo head over smooth ground, without images: for each pixel of the rectified left image that a rig (as
 * it is believed to be) makes, the true point that the true cameras see there, and where the believed
 * rectification puts its right image: the disparity that a perfect matcher would find. Written from the
 * definitions, nothing of the rooms under test but td_rectify. */
#ifndef TELEDIMOS_TESTS_RECON_FUSION_SCENE_H
#define TELEDIMOS_TESTS_RECON_FUSION_SCENE_H

#include "recon/fusion.h"
#include "tests/calib/rig_draw.h"

/* Two lenses with distortion 0.4 m apart, toed in by 2 degrees, of f = 250 px at 200 x 150 px, and a
 * covariance like a good calibration's: strong correlations between parameters, and everything unknown a
 * little. */
static inline td_rig *scene_rig(double scale)
{
    td_rig *rig = td_rig_new();
    rig->count = 2;
    for (int c = 0; c < 2; c++) {
        td_rig_camera *camera = &rig->camera[c];
        snprintf(camera->name, sizeof camera->name, c ? "right" : "left");
        camera->camera = (td_camera){TD_CAMERA_BROWN5,
                                     200,
                                     150,
                                     {250 + 3 * c, 251 - c, 99 + c, 76 - c, -0.1, 0.02, 1e-3, -5e-4, 0.001}};
        camera->camera_from_rig = td_pose_identity();
    }
    const double xi[6] = {0.004, 0.035, -0.003, -0.4, 0.004, 0.006};
    rig->camera[1].camera_from_rig = td_pose_exp(xi);
    const size_t n = td_rig_parameter_count(rig);
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    const double sigma[15] = {0.2,  0.2,  0.3,  0.3,  1e-3, 2e-3, 1e-4, 1e-4,
                              1e-3, 4e-4, 4e-4, 4e-4, 3e-4, 3e-4, 3e-4};
    td_random random = td_random_seed(77, 0);
    double *mix = calloc(n * n, sizeof *mix);
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) mix[i * n + k] = (i == k ? 1.5 : 0) + 0.3 * td_random_normal(&random);
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) {
            double sum = 0;
            for (size_t j = 0; j < n; j++) sum += mix[i * n + j] * mix[k * n + j] / 3;
            const int pose = (i >= 9 && i < 15) || (k >= 9 && k < 15);
            rig->covariance[i * n + k] = pose ? 0 : scale * scale * sum * sigma[i % 15] * sigma[k % 15];
        }
    free(mix);
    return rig;
}

/* Gentle hills, slopes up to 0.35. */
static inline double scene_height(double x, double y, double slope[2])
{
    slope[0] = 0.1 * cos(0.8 * x + 0.3) * cos(0.5 * y) * 1.2 + 0.06 * cos(1.1 * x + 0.7 * y) + 0.05;
    slope[1] = -0.0625 * 1.2 * sin(0.8 * x + 0.3) * sin(0.5 * y) + 0.6 / 11 * 0.7 * cos(1.1 * x + 0.7 * y);
    return 0.125 * 1.2 * sin(0.8 * x + 0.3) * cos(0.5 * y) + 0.6 / 11 * sin(1.1 * x + 0.7 * y) + 0.05 * x;
}

/* The rig at (x, y, z), looking along `yaw` and down by `pitch`. */
static inline td_pose scene_pose(double x, double y, double z, double yaw, double pitch)
{
    /* Columns: the camera's x to the right, y down, z forward. */
    const double c = cos(yaw), s = sin(yaw), d = cos(pitch), e = sin(pitch);
    const double r[9] = {s, -c * e, c * d, -c, -s * e, s * d, 0, -d, -e}, t[3] = {x, y, z};
    return td_pose_from_rotation(r, t);
}

static inline td_disparity *scene_disparity_new(int width, int height)
{
    const size_t n = (size_t)width * (size_t)height;
    td_disparity *d = calloc(1, sizeof *d);
    d->width = width;
    d->height = height;
    d->value = malloc(n * sizeof *d->value);
    d->sigma = malloc(n * sizeof *d->sigma);
    d->kind = calloc(n, 1);
    for (size_t i = 0; i < n; i++) d->value[i] = d->sigma[i] = NAN;
    return d;
}

static inline void scene_disparity_free(td_disparity **d)
{
    free((*d)->value);
    free((*d)->sigma);
    free((*d)->kind);
    free(*d);
    *d = NULL;
}

/* Where a ray from `from` meets the hills; false: it does not. */
static inline bool scene_meet(double p[3], const double from[3], const double ray[3])
{
    double slope[2], s = ray[2] < -0.05 ? -from[2] / ray[2] : -1;
    if (!(s > 0)) return false;
    for (int i = 0; i < 30; i++) {
        for (int k = 0; k < 3; k++) p[k] = from[k] + s * ray[k];
        const double off = p[2] - scene_height(p[0], p[1], slope);
        const double rate = ray[2] - slope[0] * ray[0] - slope[1] * ray[1];
        if (!(rate < -0.01)) return false;
        s -= off / rate;
        if (fabs(off) < 1e-10) return s > 0;
    }
    return false;
}

typedef bool scene_surface(double p[3], const double from[3], const double ray[3], void *user);
static inline bool scene_hills(double p[3], const double from[3], const double ray[3], void *user)
{
    (void)user;
    return scene_meet(p, from, ray);
}

/* The perfect matcher's disparities, all of sigma `sigma`; the truth is `true_rig` at site_from_rig. */
static inline td_disparity *scene_disparity(const td_depth_camera *camera, const td_rig *believed,
                                            const td_rig *true_rig, const td_pose *site_from_rig, float sigma,
                                            scene_surface *surface, void *user)
{
    const td_rectification *r = td_depth_camera_rectification(camera);
    const double *k = r->camera.parameter;
    td_disparity *d = scene_disparity_new(r->camera.width, r->camera.height);
    float *at = malloc(2 * (size_t)d->width * (size_t)d->height * sizeof *at);
    td_rectify_table(at, r, 0, &believed->camera[0].camera, 1);
    for (size_t i = 0; i < (size_t)d->width * (size_t)d->height; i++) {
        const double left[2] = {(double)at[2 * i], (double)at[2 * i + 1]};
        double ray[3], p[3], seen[3], right[2];
        if (isnan(left[0]) || !td_camera_unproject(ray, NULL, NULL, &true_rig->camera[0].camera, left))
            continue;
        td_pose_rotate(ray, site_from_rig, ray);
        if (!surface(p, site_from_rig->t, ray, user)) continue;
        const td_pose rig_from_site = td_pose_inverse(site_from_rig);
        td_pose_transform(seen, &rig_from_site, p);
        td_pose_transform(seen, &true_rig->camera[1].camera_from_rig, seen);
        if (!td_camera_project(right, NULL, NULL, &true_rig->camera[1].camera, seen) ||
            !td_camera_unproject(ray, NULL, NULL, &believed->camera[1].camera, right))
            continue;
        td_pose_rotate(ray, &r->rectified_from[1], ray);
        const double x = k[0] * ray[0] / ray[2] + k[2];
        if (!(x >= 0 && x <= d->width - 1)) continue;
        d->value[i] = (float)((double)(i % (size_t)d->width) - x);
        d->sigma[i] = sigma;
        d->kind[i] = TD_DENSE_MATCHED;
    }
    free(at);
    return d;
}

/* White noise of each pixel's sigma averaged over `side` x `side` pixels and brought back to that sigma,
 * times `share`. */
static inline void scene_noise(td_disparity *d, int side, double share, td_random *random)
{
    const int w = d->width + side, h = d->height + side;
    double *sum = calloc((size_t)(w + 1) * (size_t)(h + 1), sizeof *sum);
    for (int y = 1; y <= h; y++)
        for (int x = 1; x <= w; x++)
            sum[y * (w + 1) + x] = td_random_normal(random) + sum[(y - 1) * (w + 1) + x] +
                                   sum[y * (w + 1) + x - 1] - sum[(y - 1) * (w + 1) + x - 1];
    for (int y = 0; y < d->height; y++)
        for (int x = 0; x < d->width; x++) {
            const double box = sum[(y + side) * (w + 1) + x + side] - sum[y * (w + 1) + x + side] -
                               sum[(y + side) * (w + 1) + x] + sum[y * (w + 1) + x];
            float *value = &d->value[y * d->width + x];
            *value += (float)(share * box / side) * d->sigma[y * d->width + x];
        }
    free(sum);
}

#endif
