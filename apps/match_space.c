/* From matches to points in the map's frame, triangles over them and a coarse elevation map. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/match_internal.h"
#include "core/linalg.h"
#include "recon/tin.h"
#include "recon/zncc.h"

/* Along which the joint covariance of so many points is still small work. */
enum { MOST_JOINT = 400 };

double match_sigma(const double covariance[9])
{
    double value[3];
    for (int k = 0; k < 9; k++)
        if (!isfinite(covariance[k])) return NAN;
    if (td_eigen_symmetric(value, NULL, covariance, 3, NULL) != TD_OK) return NAN;
    return sqrt(fmax(value[2], 0));
}

void match_refine_choice(const match_job *m, td_match *c)
{
    const int k = m->options.half_window;
    c->zncc = td_zncc(m->image[0], (int)lround(c->left[0]), (int)lround(c->left[1]), m->image[1],
                      (int)lround(c->right[0]), (int)lround(c->right[1]), k);
    td_match refined = *c;
    if (td_match_refine(&refined, m->image[0], m->image[1], k) &&
        hypot(refined.right[0] - c->right[0], refined.right[1] - c->right[1]) < k)
        *c = refined;
}

/* Frame of the map: the vehicle's when the rig knows it; else the first camera's with its axes as a vehicle
 * has them, x forward, y left, z up. */
static td_pose map_from_rig(const td_rig *rig)
{
    static const double turned[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, zero[3] = {0};
    return rig->has_vehicle ? rig->vehicle_from_rig : td_pose_from_rotation(turned, zero);
}

static void turn(double c[9], const double r[9])
{
    double half[9], out[9];
    td_multiply(half, r, c, 3, 3, 3);
    td_multiply_transposed(out, half, r, 3, 3, 3);
    memcpy(c, out, sizeof out);
}

void match_to_frame(const match_job *m, td_point3 *p)
{
    td_pose map = map_from_rig(m->rig);
    double r[9], at[3];
    td_pose_rotation(r, &map);
    td_pose_transform(at, &map, p->p);
    memcpy(p->p, at, sizeof at);
    turn(p->covariance, r);
    turn(p->matching, r);
    turn(p->calibration, r);
}

static td_status triangulate(match_job *m, td_error *error)
{
    size_t n = m->point_count + 1;
    m->index = malloc(n * sizeof *m->index);
    m->match = malloc(n * sizeof *m->match);
    m->space = malloc(n * sizeof *m->space);
    if (!m->index || !m->match || !m->space) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    m->calibration_known = m->rig->covariance != NULL;
    for (size_t i = 0; i < m->point_count; i++) {
        const match_point *p = &m->point[i];
        if (p->chosen < 0 || !td_triangulate(&m->space[m->count], &m->pair, &p->candidate[p->chosen]))
            continue;
        match_to_frame(m, &m->space[m->count]);
        m->index[m->count] = i;
        m->match[m->count++] = p->candidate[p->chosen];
    }
    return TD_OK;
}

/* 1, 2 or 5 times a power of ten, at most `length`. */
static double round_length(double length)
{
    double power = pow(10, floor(log10(length))), times = length / power;
    return power * (times >= 5 ? 5 : times >= 2 ? 2 : 1);
}

/* A grid over the points: cells of a fifth of the points' typical spacing. */
static td_status make_grid(match_job *m, td_error *error)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (size_t i = 0; i < m->count; i++)
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], m->space[i].p[k]);
            high[k] = fmax(high[k], m->space[i].p[k]);
        }
    double area = (high[0] - low[0]) * (high[1] - low[1]);
    double cell = m->cell_m > 0 ? m->cell_m : round_length(fmax(sqrt(area / (double)m->count) / 5, 1e-3));
    double columns = ceil(high[0] / cell) - floor(low[0] / cell) + 1,
           rows = ceil(high[1] / cell) - floor(low[1] / cell) + 1;
    if (!(columns * rows <= TD_ELEVATION_MAX_CELLS / 16))
        return td_fail(
            error, TD_ERROR_DATA,
            "the map would have %.0f x %.0f cells of %g m: give a larger --cell, or a nearer --far", columns,
            rows, cell);
    const double origin[2] = {cell * floor(low[0] / cell), cell * floor(low[1] / cell)};
    m->cell_m = cell;
    return td_elevation_new(&m->map, (int)columns, (int)rows, cell, origin, m->frame, error);
}

/* The joint covariance in the map's frame; NULL when it is not known or too large. */
static double *joint_covariance(const match_job *m)
{
    size_t n = 3 * m->count;
    if (!m->calibration_known || m->count > MOST_JOINT) return NULL;
    double *c = malloc(n * n * sizeof *c), r[9];
    td_pose map = map_from_rig(m->rig);
    td_pose_rotation(r, &map);
    if (!c || td_triangulate_joint(c, &m->pair, m->match, m->count, NULL) != TD_OK) {
        free(c);
        return NULL;
    }
    for (size_t i = 0; i < m->count; i++)
        for (size_t k = 0; k < m->count; k++) {
            double block[9];
            for (size_t a = 0; a < 3; a++)
                for (size_t b = 0; b < 3; b++) block[3 * a + b] = c[(3 * i + a) * n + 3 * k + b];
            turn(block, r);
            for (size_t a = 0; a < 3; a++)
                for (size_t b = 0; b < 3; b++) c[(3 * i + a) * n + 3 * k + b] = block[3 * a + b];
        }
    return c;
}

static td_status make_map(match_job *m, td_error *error)
{
    double(*xyz)[3] = malloc((m->count + 1) * sizeof *xyz), *sigma = malloc((m->count + 1) * sizeof *sigma);
    double *joint = joint_covariance(m);
    td_status status = xyz && sigma ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < m->count && status == TD_OK; i++) {
        memcpy(xyz[i], m->space[i].p, sizeof xyz[i]);
        sigma[i] = sqrt(m->calibration_known ? m->space[i].covariance[8] : m->space[i].matching[8]);
    }
    if (status == TD_OK)
        status =
            td_tin_triangulate(&m->triangle, &m->triangle_count, (const double(*)[3])xyz, m->count, error);
    if (status == TD_OK) status = make_grid(m, error);
    if (status == TD_OK)
        status = td_tin_grid(m->map, (const double(*)[3])xyz, m->count, (const uint32_t(*)[3])m->triangle,
                             m->triangle_count, joint, sigma, m->longest_m, error);
    free(xyz);
    free(sigma);
    free(joint);
    return status;
}

td_status match_space(match_job *m, td_error *error)
{
    snprintf(m->frame, sizeof m->frame, "%s", m->rig->has_vehicle ? "vehicle" : "rig");
    TD_TRY(triangulate(m, error));
    if (m->count < 3) {
        snprintf(m->map_remark, sizeof m->map_remark, "%zu points are too few for a map", m->count);
        return TD_OK;
    }
    td_status status = make_map(m, error);
    if (status != TD_ERROR_DATA) return status;
    snprintf(m->map_remark, sizeof m->map_remark, "%s", error ? error->message : "no map");
    td_elevation_free(&m->map);
    return TD_OK;
}

/* The mean grey of the pixel that a point was seen at. */
static uint8_t grey_at(const match_job *m, size_t i)
{
    double g = td_image_sample(m->image[0], m->match[i].left[0], m->match[i].left[1], 0);
    return (uint8_t)lround(fmin(fmax(g, 0), 255));
}

td_status match_cloud_write(const match_job *m, const char *path, td_error *error)
{
    td_cloud *cloud = NULL;
    char comment[TD_NAME_SIZE + 40];
    TD_TRY(td_cloud_new(&cloud, m->count, m->triangle_count, error));
    for (size_t i = 0; i < m->count; i++) {
        const td_point3 *p = &m->space[i];
        td_cloud_point *c = &cloud->point[i];
        memcpy(c->p, p->p, sizeof c->p);
        c->sigma = (float)match_sigma(p->covariance);
        c->rgb[0] = c->rgb[1] = c->rgb[2] = grey_at(m, i);
    }
    if (m->triangle_count) memcpy(cloud->triangle, m->triangle, m->triangle_count * sizeof *cloud->triangle);
    snprintf(comment, sizeof comment, "frame %s, unit m", m->frame);
    td_status status = td_cloud_write_ply(cloud, path, comment, error);
    td_cloud_free(&cloud);
    return status;
}
