/* What the tests of clearance share: an arm over rough ground, and the truth by brute force with formulas of
 * the tests' own: rays and pyramids, points chosen and derivatives are none of its business. */
#ifndef TELEDIMOS_TESTS_CLEARANCE_SCENE_H
#define TELEDIMOS_TESTS_CLEARANCE_SCENE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/clearance.h"
#include "tests/check.h"

static const char arm_urdf[] =
    "<robot name='arm'><link name='base'/>"
    "<link name='boom'><collision><origin xyz='1 0 0' rpy='0 1.5707963267949 0'/>"
    "<geometry><cylinder radius='0.08' length='2'/></geometry></collision></link>"
    "<link name='stick'><collision><origin xyz='0.75 0 0' rpy='0 1.5707963267949 0'/>"
    "<geometry><cylinder radius='0.06' length='1.5'/></geometry></collision></link>"
    "<link name='bucket'><collision><origin xyz='0.2 0 0.1'/><geometry><box size='0.4 0.5 0.3'/></geometry>"
    "</collision><collision><origin xyz='0.45 0 0'/><geometry><sphere radius='0.07'/></geometry></collision>"
    "</link><link name='swinging'/>"
    "<joint name='swing' type='continuous'><origin xyz='0 0 0.3'/><parent link='base'/>"
    "<child link='swinging'/><axis xyz='0 0 1'/></joint>"
    "<joint name='lift' type='continuous'><origin xyz='0.1 0 0.2'/><parent link='swinging'/>"
    "<child link='boom'/><axis xyz='0 1 0'/></joint>"
    "<joint name='elbow' type='continuous'><origin xyz='2 0 0'/><parent link='boom'/><child link='stick'/>"
    "<axis xyz='0 1 0'/></joint>"
    "<joint name='curl' type='continuous'><origin xyz='1.5 0 0'/><parent link='stick'/>"
    "<child link='bucket'/><axis xyz='0 1 0'/></joint></robot>";
enum { ARM_JOINTS = 4 };

static td_error scene_error;

static inline td_robot *make_robot(const char *urdf)
{
    td_robot *robot = NULL;
    check_ok(td_robot_parse(&robot, urdf, strlen(urdf), NULL, 0, "test.urdf", &scene_error), scene_error);
    return robot;
}

static inline td_elevation *make_ground(int columns, int rows, double cell, double x, double y, double sigma)
{
    td_elevation *map = NULL;
    const double origin[2] = {x, y};
    check_ok(td_elevation_new(&map, columns, rows, cell, origin, "site", &scene_error), scene_error);
    for (int i = 0; i < columns * rows; i++) {
        map->height[i] = 0;
        map->sigma[i] = (float)sigma;
    }
    return map;
}

/* Hills, ripples, small bumps at random, a few stones. */
static inline void roughen(td_elevation *map, uint64_t seed)
{
    td_random random = td_random_seed(seed, 7);
    const double phase = 6 * td_random_uniform(&random), turn = 6 * td_random_uniform(&random);
    for (int r = 0; r < map->rows; r++)
        for (int c = 0; c < map->columns; c++) {
            const double x = map->origin[0] + c * map->cell_m, y = map->origin[1] + r * map->cell_m;
            map->height[r * map->columns + c] =
                (float)(0.15 * sin(1.1 * x + phase) * cos(0.9 * y + turn) + 0.03 * sin(5 * x + 3 * y + turn) +
                        0.005 * td_random_normal(&random));
        }
    for (int k = 0; k < 8; k++) {
        const double size = 0.1 + 0.15 * td_random_uniform(&random);
        const double x = map->origin[0] + map->columns * map->cell_m * td_random_uniform(&random);
        const double y = map->origin[1] + map->rows * map->cell_m * td_random_uniform(&random);
        for (int r = 0; r < map->rows; r++)
            for (int c = 0; c < map->columns; c++) {
                const double dx = map->origin[0] + c * map->cell_m - x;
                const double dy = map->origin[1] + r * map->cell_m - y;
                const double left = 1 - (dx * dx + dy * dy) / (size * size);
                if (left > 0) map->height[r * map->columns + c] += (float)(0.8 * size * sqrt(left));
            }
    }
}

/* Distance of p to a primitive, p in its frame, negative inside. */
static inline double truth_distance(const td_primitive *s, const double p[3])
{
    if (s->kind == TD_PRIMITIVE_BOX) {
        const double a = fabs(p[0]) - 0.5 * s->size[0], b = fabs(p[1]) - 0.5 * s->size[1],
                     c = fabs(p[2]) - 0.5 * s->size[2];
        const double inner = fmax(a, fmax(b, c));
        if (inner <= 0) return inner;
        return sqrt(pow(fmax(a, 0), 2) + pow(fmax(b, 0), 2) + pow(fmax(c, 0), 2));
    }
    const double half = s->kind == TD_PRIMITIVE_CAPSULE ? 0.5 * s->size[1] : 0;
    const double z = p[2] - fmax(-half, fmin(half, p[2]));
    return sqrt(p[0] * p[0] + p[1] * p[1] + z * z) - s->size[0];
}

/* The least distance of a primitive to the bilinear surface, sampled `fine` times in a cell along each axis;
 * cells that cannot be nearer than `limit` are passed over. Stops below `enough`. */
static inline double truth_to_ground(const td_elevation *map, const td_primitive *s, const td_pose *site_from,
                                     int fine, double limit, double enough)
{
    const td_pose shape_from = td_pose_inverse(site_from);
    double m[16], least = limit, ball = s->size[0];
    if (s->kind == TD_PRIMITIVE_CAPSULE) ball += 0.5 * s->size[1];
    if (s->kind == TD_PRIMITIVE_BOX)
        ball = 0.5 * sqrt(s->size[0] * s->size[0] + s->size[1] * s->size[1] + s->size[2] * s->size[2]);
    td_pose_matrix(m, &shape_from);
    const int reach = (int)((ball + limit) / map->cell_m) + 2;
    const int ci = (int)floor((site_from->t[0] - map->origin[0]) / map->cell_m);
    const int cj = (int)floor((site_from->t[1] - map->origin[1]) / map->cell_m);
    for (int j = cj - reach < 0 ? 0 : cj - reach; j <= cj + reach && j + 1 < map->rows; j++)
        for (int i = ci - reach < 0 ? 0 : ci - reach; i <= ci + reach && i + 1 < map->columns; i++) {
            const float *low = map->height + j * map->columns + i, *high = low + map->columns;
            const double h00 = low[0], h10 = low[1], h01 = high[0], h11 = high[1];
            const double bottom = fmin(fmin(h00, h10), fmin(h01, h11));
            const double top = fmax(fmax(h00, h10), fmax(h01, h11));
            if (top < site_from->t[2] - ball - least) continue;
            const double x0 = map->origin[0] + i * map->cell_m, y0 = map->origin[1] + j * map->cell_m;
            const double half = 0.5 * map->cell_m, rise = 0.5 * (top - bottom);
            double p[3];
            for (int step = -1; step < fine * fine; step++) {
                const double u = step < 0 ? 0.5 : (double)(step % fine) / fine;
                const double v = step < 0 ? 0.5 : (double)(step / fine) / fine;
                const double x = x0 + u * map->cell_m, y = y0 + v * map->cell_m;
                const double z = step < 0
                                     ? bottom + rise
                                     : (1 - v) * ((1 - u) * h00 + u * h10) + v * ((1 - u) * h01 + u * h11);
                for (int a = 0; a < 3; a++)
                    p[a] = m[4 * a] * x + m[4 * a + 1] * y + m[4 * a + 2] * z + m[4 * a + 3];
                const double d = truth_distance(s, p);
                if (step < 0 && d - sqrt(2 * half * half + rise * rise) > least) break;
                if (step >= 0 && d < least) least = d;
                if (least < enough) return least;
            }
        }
    return least;
}

#endif
