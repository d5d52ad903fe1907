/* An excavator on maps of ground, and its plan of a trench replayed through the soil. */
#ifndef TELEDIMOS_TESTS_SERVO_DIG_SCENE_H
#define TELEDIMOS_TESTS_SERVO_DIG_SCENE_H

#include "core/random.h"
#include "servo/dig_plan.h"
#include "sim/soil.h"
#include "sim/soil_preset.h"
#include "tests/check.h"
#include "tests/servo/servo_robots.h"

static td_error error;
static const double DEG = 0.017453292519943295;

typedef struct scene {
    td_robot *robot;
    td_elevation *map;
    td_pose site_from_vehicle;
    double q[4];
    td_tool tool;
    td_dig_bucket bucket;
    td_soil_bucket soil_bucket;
    td_soil_preset soil;
    td_task_dig dig;
    td_task_point dump;
    td_dig_request request;
} scene;

/* Ground at z = slope_x x + slope_y y + bumps, 18 m by 18 m around the machine. */
static void make_map(scene *s, double slope_x, double slope_y, double bump_m)
{
    const int size = 361;
    const double cell = 0.05, origin[2] = {-9, -9};
    check_ok(td_elevation_new(&s->map, size, size, cell, origin, "site", &error), error);
    for (int r = 0; r < size; r++)
        for (int c = 0; c < size; c++) {
            const double x = origin[0] + c * cell, y = origin[1] + r * cell;
            const double bump =
                sin(2.9 * x + 1.3 * y) + 0.7 * sin(5.3 * y - 3.7 * x + 1) + 0.4 * sin(11 * x + 7 * y);
            s->map->height[r * size + c] = (float)(slope_x * x + slope_y * y + bump_m * bump / 2.1);
            s->map->provenance[r * size + c] = TD_CELL_MEASURED;
        }
}

/* Stands on a slope of the ground, turned by yaw about its normal. */
static td_pose standing(double slope_x, double slope_y, double yaw)
{
    const double n = sqrt(1 + slope_x * slope_x + slope_y * slope_y);
    const double normal[3] = {-slope_x / n, -slope_y / n, 1 / n};
    const double lean = acos(normal[2]), flat = hypot(normal[0], normal[1]);
    double tilt[3] = {0, 0, 0}, about_z[3] = {0, 0, yaw};
    if (flat > 0) tilt[0] = -normal[1] / flat * lean, tilt[1] = normal[0] / flat * lean;
    td_pose a = td_pose_identity(), b = td_pose_identity();
    td_rotation_exp(a.q, tilt);
    td_rotation_exp(b.q, about_z);
    return td_pose_compose(&a, &b);
}

static td_dig_bucket dig_bucket(const td_robot *robot, const td_soil_bucket *b)
{
    td_dig_bucket d = {.link = td_robot_find_link(robot, "bucket"),
                       .width_m = b->width_m,
                       .struck_m3 = b->struck_m3,
                       .heaped_m3 = b->heaped_m3,
                       .body_m = 0.72};
    memcpy(d.edge, b->edge, sizeof d.edge);
    memcpy(d.heel, b->heel, sizeof d.heel);
    memcpy(d.opening, b->opening, sizeof d.opening);
    return d;
}

static void set_soil(scene *s, const char *name)
{
    char path[1024];
    snprintf(path, sizeof path, "%s/datasets/soils/%s.yaml", TD_SOURCE_DIR, name);
    check_ok(td_soil_preset_read(&s->soil, path, &error), error);
}

/* A trench 1.1 m wide, 2.4 m long, 0.5 m deep, 7 m before the machine; dumped to its left. */
static scene make_scene(double slope_x, double slope_y, double bump_m, double yaw)
{
    scene s = {.robot = excavator(), .q = {0.3, -0.8, 1.9, 1.0}};
    make_map(&s, slope_x, slope_y, bump_m);
    s.site_from_vehicle = standing(slope_x, slope_y, yaw);
    s.tool = tool_of(s.robot, "bucket_tip", 4, 0);
    s.soil_bucket = td_soil_bucket_zx200();
    s.bucket = dig_bucket(s.robot, &s.soil_bucket);
    set_soil(&s, "dirt_1");
    s.dig = (td_task_dig){
        .from = {.at_m = {7, 0, 7 * slope_x}}, .length_m = 2.4, .depth_m = 0.5, .force_n = INFINITY};
    s.dump = (td_task_point){.at_m = {0.5, 6, 6 * slope_y}};
    return s;
}

static const td_dig_request *request_of(scene *s)
{
    s->request = (td_dig_request){.map = s->map,
                                  .robot = s->robot,
                                  .site_from_vehicle = &s->site_from_vehicle,
                                  .q = s->q,
                                  .tool = &s->tool,
                                  .frame = TD_TASK_SITE,
                                  .dig = &s->dig,
                                  .dump = &s->dump,
                                  .bucket = &s->bucket};
    return &s->request;
}

static void free_scene(scene *s)
{
    td_robot_free(&s->robot);
    td_elevation_free(&s->map);
}

static int joint_named(const scene *s, const char *name)
{
    const int k = td_robot_find_joint(s->robot, name);
    assert_true(k >= 0);
    return k;
}

/* A move as the generator plans it: from q, which becomes where it ends. */
static td_trajectory *motion_of(const scene *s, const td_dig_move *m, double *q)
{
    td_trajectory *t = NULL;
    td_trajectory_options o = td_trajectory_options_default();
    td_via via = {.stop = true, .tolerance_m = 0.05, .tolerance_rad = 0.03};
    o.share = 0.8;
    if (m->position.joint_count) {
        memcpy(via.value, q, 4 * sizeof *q);
        for (int i = 0; i < m->position.joint_count; i++)
            via.value[joint_named(s, m->position.joint[i].name)] = m->position.joint[i].value * DEG;
        check_ok(td_trajectory_plan(&t, NULL, s->robot, NULL, q, &via, 1, &o, &error), error);
    } else {
        const td_pose back = td_pose_inverse(&s->site_from_vehicle);
        const double *p = m->position.to.at_m, pitch = m->position.to.pitch_deg * DEG;
        const double *base = s->site_from_vehicle.t, ahead = atan2(p[1] - base[1], p[0] - base[0]);
        const double axis[3] = {cos(pitch) * cos(ahead), cos(pitch) * sin(ahead), -sin(pitch)};
        double x[3];
        td_pose_transform(via.value, &back, p);
        td_pose_rotate(x, &back, axis);
        const double there = atan2(via.value[1], via.value[0]);
        via.value[3] = atan2(-x[2], x[0] * cos(there) + x[1] * sin(there));
        check_ok(td_trajectory_plan(&t, NULL, s->robot, &s->tool, q, &via, 1, &o, &error), error);
    }
    td_trajectory_at(q, NULL, NULL, t, td_trajectory_duration(t));
    return t;
}

typedef struct replayed {
    double dug_m3;                          /* of the bank */
    double dumped_m3, spilt_m3, fullest_m3; /* loose; the fullest bucket */
    double touched_m;                       /* deepest that the edge was in the ground where none is meant */
    double heel_m;                          /* least height of the bucket's heel over the ground in drags */
    double cutting_n[3];                    /* going in, dragged, lifted: most */
    double time_s;
    td_elevation *map; /* after it */
} replayed;

/* A sample of a motion: within the robot's limits, 0.02 inside once the plan has begun. */
static td_pose step_along(const scene *s, const td_trajectory *t, double time, bool begun)
{
    double q[4];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_trajectory_at(q, NULL, NULL, t, time);
    for (int k = 0; k < 4; k++) {
        const double spare = begun ? 0.02 : 0;
        if (!(q[k] >= s->robot->joint[k].lower + spare && q[k] <= s->robot->joint[k].upper - spare))
            fail_msg("joint %d at %g", k, q[k]);
    }
    td_robot_forward(at, s->robot, q);
    return td_pose_compose(&s->site_from_vehicle, at + s->bucket.link);
}

static void look(replayed *r, const scene *s, const td_dig_move *m, const td_soil *soil,
                 const td_pose *bucket)
{
    td_soil_state now;
    double heel[3];
    td_soil_get(&now, soil);
    r->fullest_m3 = fmax(r->fullest_m3, (double)now.bucket_mg * 1e-6 / s->soil.density_kg_m3 * s->soil.swell);
    double *cutting = r->cutting_n + (m->phase == TD_DIG_LIFT ? 2 : m->cut_m3 > 0 ? 1 : 0);
    *cutting = fmax(*cutting, now.cutting_n);
    if (!m->contact && m->phase != TD_DIG_LIFT && now.in_soil) r->touched_m = fmax(r->touched_m, now.depth_m);
    if (m->cut_m3 > 0) {
        td_pose_transform(heel, bucket, s->bucket.heel);
        r->heel_m = fmin(r->heel_m, heel[2] - td_soil_height_at(soil, heel[0], heel[1]));
    }
}

/* Each move's end is where the plan says, by joints and in the site. */
static void ends_as_planned(const scene *s, const td_dig_move *m, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    for (int k = 0; k < 4; k++) check_near(q[k], m->q[k], 1e-3);
    if (m->position.joint_count) return;
    td_robot_forward(at, s->robot, q);
    const td_pose tool = td_pose_compose(&s->site_from_vehicle, at + s->tool.link);
    for (int k = 0; k < 3; k++) check_near(tool.t[k], m->position.to.at_m[k], 1e-3);
}

/* The motions of the first passes of a plan, 20 ms apart, through the soil of a map. */
static replayed replay(const scene *s, const td_elevation *map, const td_dig_plan *plan, int passes)
{
    replayed r = {.heel_m = INFINITY};
    td_soil *soil = NULL;
    td_soil_state now;
    double q[4];
    const double mg_m3 = 1e-6 / s->soil.density_kg_m3;
    check_ok(td_soil_new(&soil, map, &s->soil, &s->soil_bucket, NULL, &error), error);
    const int64_t total = td_soil_balance_of(soil).total_mg;
    memcpy(q, s->q, sizeof q);
    for (int i = 0; i < plan->move_count && plan->move[i].pass < passes; i++) {
        const td_dig_move *m = plan->move + i;
        td_soil_get(&now, soil);
        const int64_t before = now.bucket_mg;
        td_trajectory *t = motion_of(s, m, q);
        const double duration = td_trajectory_duration(t);
        for (double time = 0.02; time < duration + 0.02; time += 0.02) {
            const td_pose bucket = step_along(s, t, fmin(time, duration), i > 0);
            check_ok(td_soil_step(soil, &bucket, 0.02, &error), error);
            look(&r, s, m, soil, &bucket);
        }
        ends_as_planned(s, m, q);
        r.time_s += duration;
        td_trajectory_free(&t);
        td_soil_get(&now, soil);
        const double gained = (double)(now.bucket_mg - before) * mg_m3;
        if (m->phase == TD_DIG_CUT)
            r.dug_m3 += gained;
        else if (m->phase == TD_DIG_DUMP)
            r.dumped_m3 -= gained * s->soil.swell;
        else
            r.spilt_m3 -= gained * s->soil.swell;
    }
    check_ok(td_soil_settle(soil, &error), error);
    if (td_soil_balance_of(soil).total_mg != total) fail_msg("soil was lost or made");
    check_ok(td_soil_map(&r.map, soil, &error), error);
    td_soil_free(&soil);
    return r;
}

/* Place of a cell in the trench. */
static bool in_trench(double *floor, const td_dig_floor *f, const td_elevation *m, int column, int row,
                      double rim)
{
    const double x = m->origin[0] + column * m->cell_m - f->start[0],
                 y = m->origin[1] + row * m->cell_m - f->start[1];
    const double a = x * cos(f->heading_rad) + y * sin(f->heading_rad);
    const double t = y * cos(f->heading_rad) - x * sin(f->heading_rad);
    *floor = f->start[2] + a * f->along + t * f->across;
    return a >= rim && a <= f->length_m - rim && fabs(t) <= f->width_m / 2 - rim;
}

/* By how much a map is above or below the floor inside the trench, `rim` from its walls: RMS, m; and what
 * stands above it, m^3. */
static double floor_off(double *above_m3, const td_dig_floor *f, const td_elevation *m, double rim)
{
    double n = 0, sum = 0, volume = 0, floor;
    for (int r = 0; r < m->rows; r++)
        for (int c = 0; c < m->columns; c++) {
            if (!in_trench(&floor, f, m, c, r, rim)) continue;
            const double d = (double)m->height[r * m->columns + c] - floor;
            n++, sum += d * d, volume += fmax(0, d);
        }
    *above_m3 = volume * m->cell_m * m->cell_m;
    return sqrt(sum / n);
}

#endif
