/* What the soil does to the bucket: forces at the edge and the floor, and the weight of what it holds. */
#include "sim/soil_internal.h"

static const double DEGREE = 0.017453292519943295;
static const double AHEAD_M = 0.5;                         /* over which the ground's slope is taken */
static const double RAKE_LOW_DEG = 10, SUM_HIGH_DEG = 165; /* of the wedge's formula, where it is used */
/* A blade that leans over further carries a wedge of dead soil, which cuts in its place (Hettiaratchi and
 * Reece 1975); the formula itself grows without bound. */
static const double RAKE_HIGH_DEG = 90;
static const double SLOPE_DEG = 30, FAR_FROM_BETA_DEG = 80; /* slopes ahead are held within these */
enum { SAMPLES = 7 };

/* Point n of the edge, moved `by` in plan. */
static void edge_point(double p[3], const soil_blade *blade, int n, const double by[2])
{
    const double part = (n + 0.5) / SAMPLES;
    for (int k = 0; k < 3; k++) p[k] = blade->end[0][k] + part * (blade->end[1][k] - blade->end[0][k]);
    p[0] += by[0];
    p[1] += by[1];
}

void soil_feel(td_soil *s, const soil_blade *blade, const soil_motion *motion)
{
    const double *way = hypot(motion->by[0], motion->by[1]) > 1e-9 ? motion->by : blade->face;
    const double length = hypot(way[0], way[1]), cell = s->map->cell_m;
    const double unit[2] = {length > 1e-6 ? way[0] / length : 0, length > 1e-6 ? way[1] / length : 0};
    const double near[2] = {unit[0] * cell, unit[1] * cell};
    const double far[2] = {unit[0] * (cell + AHEAD_M), unit[1] * (cell + AHEAD_M)};
    double depth = 0, under = 0, rise = 0, p[3];
    int in = 0, known = 0, sloped = 0;
    for (int n = 0; n < SAMPLES; n++) {
        edge_point(p, blade, n, near);
        const double ground = soil_ground(s, p[0], p[1]), z = p[2];
        if (isnan(ground)) continue;
        known++;
        under += ground;
        if (ground > z) {
            in++;
            depth += ground - z;
        }
        edge_point(p, blade, n, far);
        const double further = soil_ground(s, p[0], p[1]);
        if (isnan(further)) continue;
        sloped++;
        rise += further - ground;
    }
    for (int k = 0; k < 3; k++) p[k] = (blade->edge[k] + blade->heel[k]) / 2;
    s->floor_depth = soil_ground(s, p[0], p[1]) - p[2];
    s->contact = (double)in / SAMPLES;
    s->slope_rad = sloped && length > 0 ? atan2(rise / sloped, AHEAD_M) : 0;
    if (known) s->last_ground = under / known;
    s->state.in_soil = in > 0;
    s->state.depth_m = in ? depth / in : 0;
}

/* A force at a point, added to force and torque about the origin. */
static void add_force(td_soil *s, const double force[3], const double at[3], const double origin[3])
{
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        s->state.force[k] += force[k];
        s->state.torque[k] += (at[i] - origin[i]) * force[j] - (at[j] - origin[j]) * force[i];
    }
}

/* The wedge before a face that leads: -F (face cos delta - up sin delta), up along the face. */
static void add_cutting(td_soil *s, const soil_blade *blade, const soil_motion *motion,
                        const double origin[3])
{
    const td_soil_preset *p = &s->preset;
    const double friction = p->tool_friction_rad + p->friction_rad;
    const double high = fmin(RAKE_HIGH_DEG * DEGREE, SUM_HIGH_DEG * DEGREE - friction);
    const double rake = fmin(fmax(motion->rake, RAKE_LOW_DEG * DEGREE), high);
    double beta, size, force[3];
    if (td_soil_failure_angle(&beta, p, rake, NULL) != TD_OK) return;
    const double steepest = fmin(SLOPE_DEG * DEGREE, FAR_FROM_BETA_DEG * DEGREE - beta);
    const td_soil_cut cut = {.rake_rad = rake,
                             .depth_m = s->state.depth_m,
                             .width_m = s->bucket.width_m * s->contact,
                             .slope_rad = fmin(fmax(s->slope_rad, -SLOPE_DEG * DEGREE), steepest),
                             .swept_m3 = (double)s->load * s->loose_m3 / p->swell};
    if (td_soil_force_luengo(&size, p, &cut, s->options.gravity, NULL) != TD_OK) return;
    size *= tanh(motion->speed / s->options.slip_m_s);
    for (int k = 0; k < 3; k++)
        force[k] = -size *
                   (blade->face[k] * cos(p->tool_friction_rad) + blade->point[k] * sin(p->tool_friction_rad));
    s->state.cutting_n = size;
    add_force(s, force, blade->edge, origin);
}

/* Where edge or floor are pushed into the ground, it bears them up to its strength. */
static void add_bearing(td_soil *s, const soil_blade *blade, const soil_motion *motion,
                        const double origin[3])
{
    const td_soil_bucket *b = &s->bucket;
    const double width = b->width_m * s->contact, slip = s->options.slip_m_s;
    const double in = motion->speed * cos(motion->rake), back = -motion->speed * sin(motion->rake);
    double force[3], at[3], floor = 0;
    for (int k = 0; k < 3; k++) {
        at[k] = (blade->edge[k] + blade->heel[k]) / 2;
        floor += (blade->edge[k] - blade->heel[k]) * (blade->edge[k] - blade->heel[k]);
    }
    if (in > 0) {
        const double size = td_soil_bearing_pa(&s->preset, s->state.depth_m, b->edge_m, s->options.gravity) *
                            width * b->edge_m * tanh(in / slip);
        for (int k = 0; k < 3; k++) force[k] = -size * blade->point[k];
        add_force(s, force, blade->edge, origin);
    }
    if (back > 0 && s->floor_depth > 0) {
        const double length = sqrt(floor);
        const double size = td_soil_bearing_pa(&s->preset, s->floor_depth, length, s->options.gravity) *
                            b->width_m * length * tanh(back / slip);
        for (int k = 0; k < 3; k++) force[k] = size * blade->face[k];
        add_force(s, force, at, origin);
    }
}

void soil_wrench(td_soil *s, const soil_blade *blade, const soil_motion *motion, const td_pose *pose)
{
    const double weight[3] = {0, 0, -(double)s->load * 1e-6 * s->options.gravity};
    double centre[3];
    for (int k = 0; k < 3; k++) s->state.force[k] = s->state.torque[k] = 0;
    s->state.cutting_n = 0;
    td_pose_transform(centre, pose, s->bucket.centre);
    add_force(s, weight, centre, pose->t);
    if (!(motion->length > 0)) return;
    if (motion->cuts && s->state.in_soil) add_cutting(s, blade, motion, pose->t);
    add_bearing(s, blade, motion, pose->t);
}
