/* The world's step of 1 ms: seconds of the machine's time in one of the processor's, its arm moving on a
 * slope of 10 degrees. Beside it the same links and joints in plain ODE, with velocity motors, whose tracks
 * are boxes on ODE's own heightfield of the same map, each contact a joint: what a world is made of from
 * ODE's manual. Accuracy: how far each moves in 10 s with its arm at rest. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <ode/ode.h>

#include "sim/soil.h"
#include "sim/world.h"
#include "tests/bench/bench.h"

enum { RUNS = 5, CELLS = 161, BODIES = 5 };
static const double CELL_M = 0.25, STEP_S = 1e-3, MOVES_S = 2, RESTS_S = 10;

static double spent(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double rise(void)
{
    return tan(10 * 3.14159265358979323846 / 180);
}

/* ---- ours ---- */

static bool ours(double *factor, double *drift, const td_robot *robot, const td_elevation *map)
{
    td_world *w = NULL;
    td_plant_state s = {.site_from_vehicle = td_pose_identity(), .q = {0.4, -0.6, 1.6, 0.5}}, later;
    double time[RUNS];
    const double angle = atan(rise());
    s.site_from_vehicle.q[0] = cos(angle / 2);
    s.site_from_vehicle.q[2] = -sin(angle / 2);
    bool ok = td_world_new(&w, robot, map, NULL, NULL) == TD_OK && td_world_reset(w, &s, NULL) == TD_OK &&
              td_world_settle(w, NULL) == TD_OK;
    if (ok) td_world_state(w, &s);
    ok = ok && td_world_step(w, RESTS_S, NULL) == TD_OK;
    if (ok) td_world_state(w, &later);
    for (int i = 0; i < RUNS && ok; i++) {
        const double begun = spent(), sign = i % 2 ? -1 : 1;
        const td_plant_command c = {TD_COMMAND_RATE, {0.3 * sign, -0.1 * sign, 0.1 * sign, 0.2 * sign}};
        ok = td_world_command(w, &c, NULL) == TD_OK && td_world_step(w, MOVES_S, NULL) == TD_OK;
        time[i] = spent() - begun;
    }
    if (ok) {
        *factor = MOVES_S / bench_median(time, RUNS);
        *drift = 0;
        for (int c = 0; c < 3; c++)
            *drift = fmax(*drift, 1e3 * fabs(later.site_from_vehicle.t[c] - s.site_from_vehicle.t[c]));
    }
    td_world_free(&w);
    return ok;
}

/* ---- ours, digging: soil at 50 Hz on cells of 5 cm, the bucket drawn through it ---- */

typedef struct dig {
    td_soil *soil;
    int bucket;
    size_t dug; /* steps in the soil */
} dig;

static double soil_height(void *user, double x, double y)
{
    return td_soil_height_at(((dig *)user)->soil, x, y);
}

static void feel(void *user, td_world *w)
{
    dig *d = user;
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_soil_state felt;
    td_world_links(at, w);
    if (td_soil_step(d->soil, &at[d->bucket], STEP_S, NULL) != TD_OK) return;
    td_soil_get(&felt, d->soil);
    d->dug += felt.in_soil;
    td_world_push(w, d->bucket, felt.force, at[d->bucket].t, NULL);
}

static bool digging(double *factor, double *share, const td_robot *robot, const char *source)
{
    enum { SIDE = 500 };
    const double origin[2] = {-12.5, -12.5};
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    td_elevation *map = NULL;
    td_world *w = NULL;
    td_soil_preset preset;
    dig d = {.bucket = td_robot_find_link(robot, "bucket")};
    td_world_options o = td_world_options_default(robot);
    td_plant_state s = {.site_from_vehicle = td_pose_identity(), .q = {0, -0.42, 1.5, 0.9}};
    double time[RUNS];
    char path[4096];
    td_error error = {0};
    snprintf(path, sizeof path, "%s/datasets/soils/loam.yaml", source);
    bool ok = td_soil_preset_read(&preset, path, &error) == TD_OK &&
              td_elevation_new(&map, SIDE, SIDE, 0.05, origin, "site", &error) == TD_OK;
    for (int i = 0; ok && i < SIDE * SIDE; i++) map->height[i] = 0, map->sigma[i] = 0.01f;
    ok = ok && td_soil_new(&d.soil, map, &preset, &bucket, NULL, &error) == TD_OK;
    o.height = soil_height;
    o.height_user = &d;
    o.before_step = feel;
    o.before_step_user = &d;
    ok = ok && td_world_new(&w, robot, map, &o, &error) == TD_OK && td_world_reset(w, &s, &error) == TD_OK &&
         td_world_settle(w, &error) == TD_OK;
    for (int i = 0; i < RUNS && ok; i++) {
        const td_plant_command c = {TD_COMMAND_RATE, {0, i ? 0 : 0.05, i % 2 ? -0.1 : 0.2, 0}};
        const double begun = spent();
        ok = td_world_command(w, &c, &error) == TD_OK && td_world_step(w, MOVES_S, &error) == TD_OK;
        time[i] = spent() - begun;
    }
    if (!ok) fprintf(stderr, "teledimos-bench: %s\n", error.message);
    if (ok) *factor = MOVES_S / bench_median(time, RUNS);
    *share = (double)d.dug / (RUNS * MOVES_S / STEP_S);
    td_world_free(&w);
    td_soil_free(&d.soil);
    td_elevation_free(&map);
    return ok;
}

/* ---- plain ODE ---- */

typedef struct plain {
    dWorldID world;
    dSpaceID space;
    dJointGroupID contacts;
    dHeightfieldDataID field;
    dBodyID body[BODIES];
    dJointID joint[BODIES];
} plain;

/* The heightfield's x and z are ours turned: its y is up. */
static dReal height_of(void *map, int x, int z)
{
    const td_elevation *m = map;
    return m->height[(m->rows - 1 - z) * m->columns + x];
}

static void touch(void *user, dGeomID a, dGeomID b)
{
    plain *p = user;
    dContact contact[16];
    const int count = dCollide(a, b, 16, &contact[0].geom, sizeof *contact);
    for (int i = 0; i < count; i++) {
        /* 4 Hz of 20 t over some four contacts of each track. */
        const double k = 1.3e7 / 8, c = 1.5e5 / 8;
        contact[i].surface = (dSurfaceParameters){.mode = dContactApprox1 | dContactSoftERP | dContactSoftCFM,
                                                  .mu = 0.7,
                                                  .soft_erp = STEP_S * k / (STEP_S * k + c),
                                                  .soft_cfm = 1 / (STEP_S * k + c)};
        dJointAttach(dJointCreateContact(p->world, p->contacts, contact + i), dGeomGetBody(a),
                     dGeomGetBody(b));
    }
}

static void add_track(plain *p, double side)
{
    const dGeomID box = dCreateBox(p->space, 4.2, 0.6, 0.9);
    dGeomSetBody(box, p->body[0]);
    dGeomSetOffsetPosition(box, 0, side * 1.095, -0.05); /* the undercarriage's centre of mass is 0.5 m up */
}

static void add_links(plain *p, const td_robot *r, const td_pose *stand)
{
    static const double q[4] = {0.4, -0.6, 1.6, 0.5};
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, r, q);
    for (int i = 0; i < BODIES; i++) {
        const td_robot_link *l = r->link + i;
        const double *m = l->inertia;
        const td_pose pose = td_pose_compose(stand, at + i);
        double c[3], way[3];
        dMass mass;
        td_pose_transform(c, &pose, l->com_m);
        p->body[i] = dBodyCreate(p->world);
        dMassSetParameters(&mass, l->mass_kg, 0, 0, 0, m[0], m[4], m[8], m[1], m[2], m[5]);
        dBodySetMass(p->body[i], &mass);
        dBodySetPosition(p->body[i], c[0], c[1], c[2]);
        dBodySetQuaternion(p->body[i], pose.q);
        if (i == 0) continue;
        td_pose_rotate(way, &pose, r->joint[l->joint].axis);
        p->joint[i] = dJointCreateHinge(p->world, NULL);
        dJointAttach(p->joint[i], p->body[i], p->body[i - 1]);
        dJointSetHingeAnchor(p->joint[i], pose.t[0], pose.t[1], pose.t[2]);
        dJointSetHingeAxis(p->joint[i], way[0], way[1], way[2]);
        dJointSetHingeParam(p->joint[i], dParamFMax, r->joint[l->joint].effort);
    }
}

static void plain_make(plain *p, const td_robot *r, td_elevation *map)
{
    static const dMatrix3 y_up = {1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0};
    const double angle = atan(rise()), size = (CELLS - 1) * CELL_M;
    const td_pose stand = {.q = {cos(angle / 2), 0, -sin(angle / 2), 0}};
    dInitODE2(0);
    p->world = dWorldCreate();
    p->space = dSimpleSpaceCreate(NULL);
    p->contacts = dJointGroupCreate(0);
    p->field = dGeomHeightfieldDataCreate();
    dWorldSetGravity(p->world, 0, 0, -9.80665);
    dWorldSetCFM(p->world, 1e-12);
    dGeomHeightfieldDataBuildCallback(p->field, map, height_of, size, size, CELLS, CELLS, 1, 0, 5, 0);
    dGeomHeightfieldDataSetBounds(p->field, -10, 10);
    dGeomSetRotation(dCreateHeightfield(p->space, p->field, 1), y_up);
    add_links(p, r, &stand);
    add_track(p, 1);
    add_track(p, -1);
}

static void plain_steps(plain *p, double seconds, double speed)
{
    static const double share[BODIES] = {0, 0.3, -0.1, 0.1, 0.2};
    for (int i = 1; i < BODIES; i++) dJointSetHingeParam(p->joint[i], dParamVel, speed * share[i]);
    for (int i = 0; i < (int)(seconds / STEP_S + 0.5); i++) {
        dSpaceCollide(p->space, p, touch);
        dWorldStep(p->world, STEP_S);
        dJointGroupEmpty(p->contacts);
    }
}

static void plain_free(plain *p)
{
    dJointGroupDestroy(p->contacts);
    dSpaceDestroy(p->space);
    dGeomHeightfieldDataDestroy(p->field);
    dWorldDestroy(p->world);
}

static void theirs(double *factor, double *drift, const td_robot *r, td_elevation *map)
{
    plain p;
    double time[RUNS], begun[3];
    plain_make(&p, r, map);
    plain_steps(&p, 3, 0);
    for (int c = 0; c < 3; c++) begun[c] = dBodyGetPosition(p.body[0])[c];
    plain_steps(&p, RESTS_S, 0);
    *drift = 0;
    for (int c = 0; c < 3; c++) *drift = fmax(*drift, 1e3 * fabs(dBodyGetPosition(p.body[0])[c] - begun[c]));
    for (int i = 0; i < RUNS; i++) {
        const double from = spent();
        plain_steps(&p, MOVES_S, i % 2 ? -1 : 1);
        time[i] = spent() - from;
    }
    *factor = MOVES_S / bench_median(time, RUNS);
    plain_free(&p);
}

void bench_world(const bench *b)
{
    char path[4096];
    const double origin[2] = {-(CELLS - 1) * CELL_M / 2, -(CELLS - 1) * CELL_M / 2};
    td_robot *robot = NULL;
    td_elevation *map = NULL;
    td_error error = {0};
    bench_row row = {.name = "world step of 1 ms",
                     .unit = "1/s",
                     .ours = NAN,
                     .peer = NAN,
                     .peer_name = "ODE's heightfield",
                     .error_unit = "mm in 10 s",
                     .error_ours = NAN,
                     .error_peer = NAN,
                     .runs = RUNS,
                     .remark = "seconds of the world in a second"};
    if (!bench_wanted(b, row.name)) return;
    snprintf(path, sizeof path, "%s/datasets/zx200/zx200.urdf", b->source);
    if (td_robot_read(&robot, path, &error) != TD_OK ||
        td_elevation_new(&map, CELLS, CELLS, CELL_M, origin, "site", &error) != TD_OK) {
        fprintf(stderr, "teledimos-bench: %s\n", error.message);
        td_robot_free(&robot);
        return;
    }
    for (int i = 0; i < CELLS * CELLS; i++)
        map->height[i] = (float)(rise() * (origin[0] + CELL_M * (i % CELLS)));
    if (!ours(&row.ours, &row.error_ours, robot, map)) row.remark = "ours failed";
    theirs(&row.peer, &row.error_peer, robot, map);
    bench_print(b, &row);
    double share = 0;
    char remark[80];
    row = (bench_row){.name = "world step of 1 ms, digging",
                      .unit = "1/s",
                      .ours = NAN,
                      .peer = NAN,
                      .peer_name = "none",
                      .error_ours = NAN,
                      .error_peer = NAN,
                      .runs = RUNS,
                      .remark = "failed"};
    if (digging(&row.ours, &share, robot, b->source)) {
        snprintf(remark, sizeof remark,
                 "soil at 50 Hz on cells of 5 cm, the bucket in it %.0f %% of the time", 100 * share);
        row.remark = remark;
    }
    bench_print(b, &row);
    td_elevation_free(&map);
    td_robot_free(&robot);
}
