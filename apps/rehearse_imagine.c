/* The imagined machine is brought to where the true one is measured to stand, so that the prediction begins
 * without a deviation: the map under its tracks, which it knows by standing there and sees badly, is laid
 * such that the machine settles in the measured pose. */
#include <math.h>
#include <string.h>

#include "apps/rehearse_internal.h"

static const double HALF_LENGTH_M = 2.6, HALF_WIDTH_M = 1.7; /* of what the tracks cover */

/* The plane z = 0 of `plane` under the machine at `base`. */
static void lay(td_elevation *map, const td_pose *base, const td_pose *plane)
{
    static const double up[3] = {0, 0, 1};
    double normal[3];
    const td_pose back = td_pose_inverse(base);
    td_pose_rotate(normal, plane, up);
    for (int row = 0; row < map->rows; row++)
        for (int c = 0; c < map->columns; c++) {
            const double x = map->origin[0] + c * map->cell_m, y = map->origin[1] + row * map->cell_m;
            const double z =
                plane->t[2] - (normal[0] * (x - plane->t[0]) + normal[1] * (y - plane->t[1])) / normal[2];
            const double site[3] = {x, y, z};
            const size_t i = (size_t)row * (size_t)map->columns + (size_t)c;
            double at[3];
            td_pose_transform(at, &back, site);
            if (fabs(at[0]) > HALF_LENGTH_M || fabs(at[1]) > HALF_WIDTH_M) continue;
            map->height[i] = (float)z;
            if (isnan(map->sigma[i])) map->sigma[i] = 0.05F;
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
                        const td_plant_state *start, td_error *error)
{
    const td_pose *base = &r->state.site_from_vehicle;
    td_plant_state rests;
    lay(map, base, base);
    TD_TRY(stand(made, r, draw, map, start, error));
    const td_plant plant = station_plant(*made);
    TD_TRY(plant.state(plant.self, &rests, error));
    const td_pose back = td_pose_inverse(&rests.site_from_vehicle);
    const td_pose off = td_pose_compose(base, &back);
    const td_pose plane = td_pose_compose(&off, base);
    station_free(made);
    lay(map, base, &plane);
    TD_TRY(stand(made, r, draw, map, start, error));
    return station_believe(*made, NULL, r->sigma_q, error);
}

td_status rehearse_imagine(station **made, const rehearse *r, const rehearse_draw *draw,
                           const td_elevation *map, td_error *error)
{
    const td_robot *robot = r->scenario.robot;
    td_plant_state start = {.site_from_vehicle = r->state.site_from_vehicle};
    td_elevation *copy = NULL;
    for (int k = 0; k < robot->joint_count; k++)
        start.q[k] = fmax(robot->joint[k].lower,
                          fmin(robot->joint[k].upper, r->state.q[k] - (draw ? draw->zero[k] : 0)));
    TD_TRY(td_elevation_copy(&copy, map, error));
    const td_status status = settle(made, r, draw, copy, &start, error);
    td_elevation_free(&copy);
    if (status != TD_OK) station_free(made);
    return status;
}
