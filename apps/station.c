#include "apps/station.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Twice the soil's own rate: like friction its force turns with the motion. */
static const double SOIL_PERIOD_S = 0.01;
static const double ARM_KG = 1500; /* of arm and bucket at the edge, on the safe side */

struct station {
    const td_robot *robot;
    td_machine_options machine;
    station_ground ground;
    td_plant_state start; /* settled */
    td_elevation *first, *now;
    td_elevation *believed; /* NULL: what is seen is what is */
    double sigma_zero[TD_ROBOT_MAX_JOINTS];
    td_world *world;
    td_soil *soil;               /* NULL: none */
    td_clearance_map *clearance; /* of what is seen; NULL: to be made */
    bool changed;                /* the soil moved since `now` was taken */
    int bucket_link;
    td_soil_state felt; /* at the soil's last update */
    double edge[3];     /* a step of the world ago */
    double peak_n;
    int64_t total_mg;
    td_status failed; /* of the soil, within a step of the world */
    td_error why;
};

/* ---- the soil under the bucket ---- */

static td_pose bucket_pose(const station *s)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_world_links(at, s->world);
    return at[s->bucket_link];
}

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* A torque as two forces, one metre apart across it: f = T x a. */
static td_status push_torque(td_world *world, int link, const double torque[3], const double at[3],
                             td_error *error)
{
    const int flat = fabs(torque[0]) < fabs(torque[1])   ? (fabs(torque[0]) < fabs(torque[2]) ? 0 : 2)
                     : fabs(torque[1]) < fabs(torque[2]) ? 1
                                                         : 2;
    const double t = length(torque);
    double across[3] = {0}, arm[3], force[3], back[3], point[3];
    if (!(t > 0)) return TD_OK;
    across[flat] = 1;
    for (int c = 0; c < 3; c++) {
        const int i = (c + 1) % 3, k = (c + 2) % 3;
        arm[c] = torque[i] * across[k] - torque[k] * across[i];
    }
    const double size = length(arm);
    for (int c = 0; c < 3; c++) arm[c] /= size;
    for (int c = 0; c < 3; c++) {
        const int i = (c + 1) % 3, k = (c + 2) % 3;
        force[c] = torque[i] * arm[k] - torque[k] * arm[i];
        back[c] = -force[c];
        point[c] = at[c] + arm[c];
    }
    TD_TRY(td_world_push(world, link, force, point, error));
    return td_world_push(world, link, back, at, error);
}

/* Of what resists, F, no more than stops the edge within a step of the world: it is held from one update of
 * the soil to the next, and would throw back what it has stopped (the floor on hard ground: 1 MN). */
static double share_of(const station *s, const double resists[3], const double edge[3], double dt)
{
    const double size = length(resists);
    double against = 0;
    if (!(size > 0)) return 0;
    for (int c = 0; c < 3; c++) against -= resists[c] / size * (edge[c] - s->edge[c]) / dt;
    return fmax(0, fmin(1, against * ARM_KG / (size * dt)));
}

static void feel(void *user, td_world *world)
{
    station *s = user;
    const double dt = td_world_options_default(s->robot).step_s;
    const td_pose at = bucket_pose(s);
    const td_soil_bucket bucket = station_bucket(s);
    double edge[3], centre[3], force[3], torque[3], resists[3];
    if (s->failed != TD_OK) return;
    s->failed = td_soil_step(s->soil, &at, dt, &s->why);
    if (s->failed != TD_OK) return;
    td_soil_get(&s->felt, s->soil);
    s->changed = true;
    td_pose_transform(edge, &at, bucket.edge);
    td_pose_rotate(centre, &at, bucket.centre);
    const double weight[3] = {0, 0, -1e-6 * (double)s->felt.bucket_mg * td_soil_options_default().gravity};
    for (int c = 0; c < 3; c++) resists[c] = s->felt.force[c] - weight[c];
    const double share = share_of(s, resists, edge, dt);
    s->felt.cutting_n *= share;
    s->peak_n = fmax(s->peak_n, s->felt.cutting_n);
    for (int c = 0; c < 3; c++) {
        const int i = (c + 1) % 3, k = (c + 2) % 3;
        const double of_weight = centre[i] * weight[k] - centre[k] * weight[i];
        force[c] = share * resists[c] + weight[c];
        torque[c] = share * (s->felt.torque[c] - of_weight) + of_weight;
    }
    memcpy(s->edge, edge, sizeof s->edge);
    s->failed = td_world_push(world, s->bucket_link, force, at.t, &s->why);
    if (s->failed == TD_OK) s->failed = push_torque(world, s->bucket_link, torque, at.t, &s->why);
}

static double soil_height(void *user, double x, double y)
{
    return td_soil_height_at(((const station *)user)->soil, x, y);
}

/* ---- made ---- */

static td_status add_stones(station *s, td_error *error)
{
    for (int i = 0; i < s->ground.stone_count; i++)
        TD_TRY(td_world_add_stone(s->world, NULL, s->ground.stone + i, error));
    return TD_OK;
}

static td_status make_soil(station *s, const td_elevation *map, td_error *error)
{
    const td_soil_bucket bucket = station_bucket(s);
    td_soil_options o = td_soil_options_default();
    o.period_s = SOIL_PERIOD_S;
    td_soil_free(&s->soil);
    s->felt = (td_soil_state){0};
    if (!s->ground.has_soil) return TD_OK;
    TD_TRY(td_soil_new(&s->soil, map, &s->ground.soil, &bucket, &o, error));
    s->total_mg = td_soil_balance_of(s->soil).total_mg;
    return TD_OK;
}

static td_status make_world(station *s, td_error *error)
{
    td_world_options o = td_world_options_default(s->robot);
    o.machine = s->machine;
    if (s->soil) {
        o.height = soil_height;
        o.height_user = s;
        o.before_step = feel;
        o.before_step_user = s;
    }
    td_world_free(&s->world);
    return td_world_new(&s->world, s->robot, s->first, &o, error);
}

/* Along the middle of each track: the world looks at a few points of them only. */
static td_status check_standing(const station *s, const td_plant_state *start, td_error *error)
{
    static const double HALF_LENGTH_M = 2, STEP_M = 0.05;
    const double half = station_half_gauge(s);
    if (s->machine.base != TD_MACHINE_SUSPENDED) return TD_OK;
    for (int side = -1; side <= 1; side += 2)
        for (double x = -HALF_LENGTH_M; x <= HALF_LENGTH_M; x += STEP_M) {
            const double at[3] = {x, side * half, 0};
            double p[3];
            td_pose_transform(p, &start->site_from_vehicle, at);
            if (isnan(td_elevation_at(s->first, p[0], p[1], NULL)))
                return td_fail(
                    error, TD_ERROR_DATA,
                    "the machine cannot stand at (%.2f, %.2f) m: under its %s track, at (%.2f, %.2f) "
                    "m, the map has a hole or ends; start elsewhere, look again, or fill the map",
                    start->site_from_vehicle.t[0], start->site_from_vehicle.t[1], side < 0 ? "right" : "left",
                    p[0], p[1]);
        }
    return TD_OK;
}

/* The machine settles before the soil is there, whose first step places the bucket. */
static td_status begin(station *s, const td_plant_state *start, td_error *error)
{
    s->failed = TD_OK;
    s->peak_n = 0;
    td_clearance_map_free(&s->clearance);
    td_elevation_free(&s->now);
    TD_TRY(check_standing(s, start, error));
    TD_TRY(make_soil(s, s->first, error));
    TD_TRY(make_world(s, error));
    TD_TRY(td_world_reset(s->world, start, error));
    TD_TRY(td_world_settle(s->world, error));
    TD_TRY(s->failed == TD_OK ? TD_OK : td_fail(error, s->failed, "%s", s->why.message));
    TD_TRY(add_stones(s, error));
    td_world_state(s->world, &s->start);
    return TD_OK;
}

static td_status take(station *s, const td_plant_state *start, const td_elevation *map, td_error *error)
{
    s->bucket_link = -1;
    for (int i = 0; i < s->robot->link_count; i++)
        if (strcmp(s->robot->link[i].name, "bucket") == 0) s->bucket_link = i;
    if (s->ground.has_soil && s->bucket_link < 0)
        return td_fail(error, TD_ERROR_DATA, "robot '%s' has no link 'bucket' to dig with; leave soil out",
                       s->robot->name);
    TD_TRY(td_elevation_copy(&s->first, map, error));
    return begin(s, start, error);
}

td_status station_new(station **out, const td_robot *robot, const td_machine_options *machine,
                      const td_plant_state *start, const td_elevation *map, const station_ground *ground,
                      td_error *error)
{
    station *s = *out = calloc(1, sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory for a station");
    s->robot = robot;
    s->machine = *machine;
    s->ground = *ground;
    const td_status status = take(s, start, map, error);
    if (status != TD_OK) station_free(out);
    return status;
}

void station_free(station **s)
{
    if (!s || !*s) return;
    td_world_free(&(*s)->world);
    td_soil_free(&(*s)->soil);
    td_clearance_map_free(&(*s)->clearance);
    td_elevation_free(&(*s)->first);
    td_elevation_free(&(*s)->now);
    td_elevation_free(&(*s)->believed);
    free(*s);
    *s = NULL;
}

td_status station_restart(station *s, double time_s, td_error *error)
{
    td_plant_state again = s->start;
    again.time_s = time_s;
    return begin(s, &again, error);
}

td_status station_stand(station *s, const td_plant_state *start, bool stays, td_error *error)
{
    const td_elevation *now = NULL;
    td_elevation *copy = NULL;
    if (stays) {
        TD_TRY(station_map(&now, s, error));
        TD_TRY(td_elevation_copy(&copy, now, error));
        td_elevation_free(&s->first);
        s->first = copy;
    }
    return begin(s, start, error);
}

td_status station_believe(station *s, const td_elevation *map, const double *sigma_zero, td_error *error)
{
    td_elevation *copy = NULL;
    if (map) TD_TRY(td_elevation_copy(&copy, map, error));
    td_clearance_map_free(&s->clearance);
    td_elevation_free(&s->believed);
    s->believed = copy;
    for (int k = 0; k < s->robot->joint_count; k++) s->sigma_zero[k] = sigma_zero ? sigma_zero[k] : 0;
    return TD_OK;
}

/* ---- the plant ---- */

static td_status plant_command(void *self, const td_plant_command *command, td_error *error)
{
    return td_world_command(((station *)self)->world, command, error);
}

static td_status plant_step(void *self, double dt_s, td_error *error)
{
    station *s = self;
    TD_TRY(td_world_step(s->world, dt_s, error));
    return s->failed == TD_OK ? TD_OK : td_fail(error, s->failed, "%s", s->why.message);
}

static td_status plant_state(void *self, td_plant_state *state, td_error *error)
{
    (void)error;
    td_world_state(((station *)self)->world, state);
    return TD_OK;
}

static td_status plant_reset(void *self, const td_plant_state *state, td_error *error)
{
    return td_world_reset(((station *)self)->world, state, error);
}

static void plant_free(void *self)
{
    (void)self;
}

td_plant station_plant(station *s)
{
    return (td_plant){.self = s,
                      .robot = s->robot,
                      .command = plant_command,
                      .step = plant_step,
                      .state = plant_state,
                      .reset = plant_reset,
                      .free = plant_free};
}

td_status station_drive(station *s, double left_m_s, double right_m_s, td_error *error)
{
    if (s->machine.base != TD_MACHINE_SUSPENDED && left_m_s == 0 && right_m_s == 0) return TD_OK;
    return td_world_drive(s->world, left_m_s, right_m_s, error);
}

double station_half_gauge(const station *s)
{
    return td_world_options_default(s->robot).tracks.half_gauge_m;
}

double station_height(const station *s, double x, double y)
{
    return td_world_height_at(s->world, x, y);
}

bool station_stone(td_pose *site_from_stone, const station *s, int index)
{
    return td_world_stone_at(site_from_stone, NULL, s->world, index);
}

/* ---- what it holds ---- */

td_status station_map(const td_elevation **map, station *s, td_error *error)
{
    *map = s->first;
    if (!s->soil) return TD_OK;
    if (s->now && !s->changed) {
        *map = s->now;
        return TD_OK;
    }
    td_elevation *now = NULL;
    TD_TRY(td_soil_map(&now, s->soil, error));
    if (!s->believed) td_clearance_map_free(&s->clearance);
    td_elevation_free(&s->now);
    *map = s->now = now;
    s->changed = false;
    return TD_OK;
}

td_status station_seen(const td_elevation **map, station *s, td_error *error)
{
    *map = s->believed;
    return *map ? TD_OK : station_map(map, s, error);
}

const td_elevation *station_first_map(const station *s)
{
    return s->first;
}

bool station_has_soil(const station *s)
{
    return s->soil != NULL;
}

/* The one bucket that has figures. */
td_soil_bucket station_bucket(const station *s)
{
    (void)s;
    return td_soil_bucket_zx200();
}

int station_bucket_link(const station *s)
{
    return s->bucket_link;
}

td_soil_state station_soil(const station *s)
{
    return s->felt;
}

double station_cutting_peak(const station *s)
{
    return s->peak_n;
}

double station_mass_error(const station *s)
{
    return s->soil ? 1e-6 * (double)(td_soil_balance_of(s->soil).total_mg - s->total_mg) : 0;
}

/* ---- a motion against the map ---- */

td_status station_check(bool *accepted, td_clearance *clearance, char *words, size_t size, station *s,
                        const double *time_s, const double *q, size_t samples, bool bucket_may_touch,
                        td_error *error)
{
    const td_elevation *map = NULL;
    td_clearance_allowed allowed[TD_ROBOT_MAX_LINKS];
    td_clearance_options o = td_clearance_options_default();
    td_plant_state state;
    size_t count = 0;
    TD_TRY(station_seen(&map, s, error));
    if (!s->clearance) TD_TRY(td_clearance_map_new(&s->clearance, map, s->ground.sigma_m, error));
    td_world_state(s->world, &state);
    for (int i = s->bucket_link; i >= 0 && i < s->robot->link_count && bucket_may_touch; i++)
        allowed[count++] = (td_clearance_allowed){i, time_s[0], time_s[samples - 1]};
    const td_clearance_motion motion = {.robot = s->robot,
                                        .site_from_vehicle = state.site_from_vehicle,
                                        .sigma_zero = s->sigma_zero,
                                        .count = samples,
                                        .time_s = time_s,
                                        .q = q,
                                        .allowed = allowed,
                                        .allowed_count = count};
    o.unseen_top_m = s->ground.unseen_top_m;
    TD_TRY(td_clearance_check(clearance, s->clearance, &motion, &o, error));
    *accepted = td_clearance_verdict(words, size, clearance, s->robot, &o);
    return TD_OK;
}
