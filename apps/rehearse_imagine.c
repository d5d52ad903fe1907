/* The imagined machine is brought to where the true one is measured to stand, so that the prediction begins
 * without a deviation: the map under its tracks keeps its relief, as it was seen before the machine came, and
 * is laid such that the machine settles in the measured pose, which it knows by standing there. On a plane it
 * would stand on the whole length of its tracks, and rock otherwise than it does. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"
#include "core/linalg.h"

static const double HALF_LENGTH_M = 2.6, HALF_WIDTH_M = 1.7; /* of what the tracks cover */
enum { SETTLED = 2 };                                        /* times that the ground is laid */

/* The ground under the machine: cell by cell what it is above its own plane. */
typedef struct footing {
    size_t count;
    size_t *cell; /* (count) of the map */
    double *relief, *sigma;
} footing;

static void footing_free(footing *f)
{
    free(f->cell);
    free(f->relief);
    free(f->sigma);
    *f = (footing){0};
}

static void place_of(double at[2], const td_elevation *map, size_t cell)
{
    at[0] = map->origin[0] + (double)(cell % (size_t)map->columns) * map->cell_m;
    at[1] = map->origin[1] + (double)(cell / (size_t)map->columns) * map->cell_m;
}

static td_status footing_make(footing *f, const td_elevation *map, const td_pose *base, td_error *error)
{
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    const td_pose back = td_pose_inverse(base);
    *f = (footing){.cell = malloc(cells * sizeof *f->cell),
                   .relief = calloc(cells, sizeof *f->relief),
                   .sigma = calloc(cells, sizeof *f->sigma)};
    if (!f->cell || !f->relief || !f->sigma) return td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    for (size_t i = 0; i < cells; i++) {
        double site[3] = {0, 0, base->t[2]}, at[3];
        place_of(site, map, i);
        td_pose_transform(at, &back, site);
        if (fabs(at[0]) <= HALF_LENGTH_M && fabs(at[1]) <= HALF_WIDTH_M) f->cell[f->count++] = i;
    }
    return TD_OK;
}

/* Heights above their least-squares plane, where they are known; elsewhere 0. */
static void find_relief(footing *f, const td_elevation *map, const td_pose *base)
{
    double square[9] = {0}, right[3] = {0}, inverse[9], plane[3] = {0};
    size_t known = 0;
    for (size_t i = 0; i < f->count; i++) {
        double at[2];
        const double z = (double)map->height[f->cell[i]];
        if (isnan(z)) continue;
        place_of(at, map, f->cell[i]);
        const double row[3] = {1, at[0] - base->t[0], at[1] - base->t[1]};
        for (int a = 0; a < 3; a++) {
            right[a] += row[a] * z;
            for (int b = 0; b < 3; b++) square[3 * a + b] += row[a] * row[b];
        }
        known++;
    }
    if (known < f->count / 4 || td_invert_spd(inverse, square, 3, NULL) != TD_OK) return;
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) plane[a] += inverse[3 * a + b] * right[b];
    for (size_t i = 0; i < f->count; i++) {
        double at[2];
        const double z = (double)map->height[f->cell[i]], sigma = (double)map->sigma[f->cell[i]];
        if (isnan(z)) continue;
        place_of(at, map, f->cell[i]);
        f->relief[i] = z - plane[0] - plane[1] * (at[0] - base->t[0]) - plane[2] * (at[1] - base->t[1]);
        f->sigma[i] = isfinite(sigma) ? sigma : 0;
    }
}

/* How the relief may be: neighbours three cells wide are off together. */
static void draw_relief(footing *f, const td_elevation *map, td_random *random)
{
    enum { WIDE = 3 };
    const size_t across = (size_t)map->columns / WIDE + 1, down = (size_t)map->rows / WIDE + 1;
    double *z = malloc(across * down * sizeof *z);
    if (!z) return;
    for (size_t i = 0; i < across * down; i++) z[i] = td_random_normal(random);
    for (size_t i = 0; i < f->count; i++) {
        const size_t column = f->cell[i] % (size_t)map->columns, row = f->cell[i] / (size_t)map->columns;
        f->relief[i] += f->sigma[i] * z[row / WIDE * across + column / WIDE];
    }
    free(z);
}

/* So much of the relief on the plane z = 0 of `plane`. */
static void lay(td_elevation *map, const footing *f, double share, const td_pose *plane)
{
    static const double up[3] = {0, 0, 1};
    double normal[3];
    td_pose_rotate(normal, plane, up);
    for (size_t i = 0; i < f->count; i++) {
        double at[2];
        place_of(at, map, f->cell[i]);
        const double fall = normal[0] * (at[0] - plane->t[0]) + normal[1] * (at[1] - plane->t[1]);
        map->height[f->cell[i]] = (float)(plane->t[2] - fall / normal[2] + share * f->relief[i]);
        if (isnan(map->sigma[f->cell[i]])) map->sigma[f->cell[i]] = 0.05F;
    }
}

static td_status stand(station **made, const rehearse *r, const rehearse_draw *draw, const td_elevation *map,
                       const td_plant_state *start, td_error *error)
{
    station_ground ground = draw ? draw->ground : r->scenario.ground;
    ground.stone_count = 0;
    return station_new(made, draw ? draw->robot : r->scenario.robot, &r->scenario.options, start, map,
                       &ground, error);
}

static td_status settle(station **made, const rehearse *r, const rehearse_draw *draw, td_elevation *map,
                        const footing *f, double share, const td_plant_state *start, td_error *error)
{
    const td_pose *base = &r->state.site_from_vehicle;
    td_pose plane = *base;
    for (int i = 0; i < SETTLED; i++) {
        td_plant_state rests;
        station_free(made);
        lay(map, f, share, &plane);
        TD_TRY(stand(made, r, draw, map, start, error));
        const td_plant plant = station_plant(*made);
        TD_TRY(plant.state(plant.self, &rests, error));
        const td_pose back = td_pose_inverse(&rests.site_from_vehicle);
        const td_pose off = td_pose_compose(base, &back);
        plane = td_pose_compose(&off, &plane);
    }
    return station_believe(*made, NULL, r->sigma_q, error);
}

/* On few points of a relief that is not quite that of the ground it may never come to rest: then on less. */
static td_status settle_somehow(station **made, const rehearse *r, const rehearse_draw *draw,
                                td_elevation *map, const footing *f, const td_plant_state *start,
                                td_error *error)
{
    static const double shares[] = {1, 0.5, 0};
    td_status status = TD_OK;
    for (size_t i = 0; i < sizeof shares / sizeof *shares; i++) {
        status = settle(made, r, draw, map, f, shares[i], start, error);
        if (status != TD_ERROR_CONVERGENCE) return status;
    }
    return status;
}

td_status rehearse_imagine(station **made, const rehearse *r, const rehearse_draw *draw,
                           const td_elevation *map, td_error *error)
{
    const td_robot *robot = r->scenario.robot;
    const td_pose *base = &r->state.site_from_vehicle;
    td_plant_state start = {.site_from_vehicle = *base};
    td_elevation *copy = NULL;
    footing f = {0};
    *made = NULL;
    for (int k = 0; k < robot->joint_count; k++)
        start.q[k] = fmax(robot->joint[k].lower,
                          fmin(robot->joint[k].upper, r->state.q[k] - (draw ? draw->zero[k] : 0)));
    TD_TRY(td_elevation_copy(&copy, map, error));
    td_status status = footing_make(&f, copy, base, error);
    if (status == TD_OK) find_relief(&f, copy, base);
    if (status == TD_OK && draw) {
        td_random random = draw->random;
        draw_relief(&f, copy, &random);
    }
    if (status == TD_OK) status = settle_somehow(made, r, draw, copy, &f, &start, error);
    footing_free(&f);
    td_elevation_free(&copy);
    if (status != TD_OK) station_free(made);
    return status;
}
