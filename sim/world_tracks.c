/* The tracks on their ground: forces of springs, dampers and friction at points that are looked up in the
 * map. */
#include <math.h>
#include <string.h>

#include "sim/world_internal.h"

static const double STANDS_M = 0.5;   /* how far a point may start above or below its ground */
static const double ROLLS_M_S = 0.02; /* belt's speed at which rolling resistance is nearly whole */

/* ---- ground ---- */

double td_world_height_at(const td_world *w, double x, double y)
{
    if (w->options.height) return w->options.height(w->options.height_user, x, y);
    return w->ground ? td_elevation_at(w->ground, x, y, NULL) : NAN;
}

/* Difference quotient over the neighbours that are there. */
static double slope_of(double here, double behind, double ahead, double width)
{
    if (isnan(behind)) return isnan(ahead) ? 0 : (ahead - here) / width;
    return isnan(ahead) ? (here - behind) / width : (ahead - behind) / (2 * width);
}

bool td_world_normal(double normal[3], double *height, const td_world *w, double x, double y)
{
    const double wide = w->ground ? w->ground->cell_m / 2 : 0.05, here = td_world_height_at(w, x, y);
    *height = here;
    if (isnan(here)) return false;
    const double dx = slope_of(here, td_world_height_at(w, x - wide, y), td_world_height_at(w, x + wide, y),
                               wide),
                 dy = slope_of(here, td_world_height_at(w, x, y - wide), td_world_height_at(w, x, y + wide),
                               wide);
    const double length = sqrt(1 + dx * dx + dy * dy);
    normal[0] = -dx / length, normal[1] = -dy / length, normal[2] = 1 / length;
    return true;
}

/* ---- points ---- */

/* Evenly along each track, weights that sum up to 1 over both: the ends' e, the others' i, so that
 * sum weight = 1 and sum weight x^2 = (pitch stiffness) / (heave stiffness). */
void td_world_build_tracks(td_world *w)
{
    const td_world_tracks *t = &w->options.tracks;
    const double *k = w->machine->robot.suspension_n_m;
    const double ends = t->half_length_m * t->half_length_m;
    double inner = 0; /* mean x^2 of a track's inner points */
    for (int i = 1; i + 1 < t->points; i++) {
        const double x = t->half_length_m * (2.0 * i / (t->points - 1) - 1);
        inner += x * x / (t->points - 2);
    }
    double share = t->points > 2 ? (ends - k[1] / k[0]) / (ends - inner) : 0; /* what the inner ones carry */
    share = fmax(0, fmin(1, share));
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < t->points; i++) {
            const bool end = i == 0 || i == t->points - 1;
            td_world_point *p = w->point + w->point_count++;
            *p = (td_world_point){.right = side == 1};
            p->at[0] = t->half_length_m * (2.0 * i / (t->points - 1) - 1);
            p->at[1] = side ? -t->half_gauge_m : t->half_gauge_m;
            p->weight = end ? (1 - share) / 4 : share / (2.0 * (t->points - 2));
        }
}

td_status td_world_check_tracks(const td_world *w, td_error *error)
{
    const char *name = w->machine->robot.name;
    for (int i = 0; i < w->point_count; i++) {
        double at[3];
        td_pose_transform(at, &w->body[0].pose, w->point[i].at);
        const double height = td_world_height_at(w, at[0], at[1]), over = at[2] - height;
        const char *side = w->point[i].right ? "right" : "left";
        if (isnan(height))
            return td_fail(
                error, TD_ERROR_DATA,
                "world: the %s track of machine '%s' starts at (%.3f, %.3f) m, where the map has a "
                "hole or ends; start elsewhere, or fill the map",
                side, name, at[0], at[1]);
        if (over > STANDS_M)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "world: machine '%s' starts over an edge: the ground at (%.3f, %.3f) m is %.2f m "
                           "below its %s track; start it where it can stand",
                           name, at[0], at[1], over, side);
        if (over < -STANDS_M)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "world: machine '%s' starts with its %s track %.2f m under the ground at (%.3f, "
                           "%.3f) m; start it higher",
                           name, side, -over, at[0], at[1]);
    }
    return TD_OK;
}

/* ---- forces ---- */

/* What of the vehicle's forward direction is along the ground. */
static void forwards(double way[3], const double turn[9], const double normal[3])
{
    const double out = turn[0] * normal[0] + turn[3] * normal[1] + turn[6] * normal[2];
    const double length = sqrt(fmax(1e-12, 1 - out * out));
    for (int c = 0; c < 3; c++) way[c] = (turn[3 * c] - out * normal[c]) / length;
}

/* Shear's force, its e moved on by a step; limited to friction times `pressed`. */
static void shear(double force[3], td_world_point *p, const td_world *w, const double normal[3],
                  const double sliding[3], double belt, double pressed)
{
    const td_world_tracks *t = &w->options.tracks;
    const double h = w->options.step_s, fresh = fmin(1, h * fabs(belt) / t->relax_m),
                 k = p->weight * t->shear_n_m, c = p->weight * t->shear_ns_m;
    double out = 0, square = 0;
    for (int i = 0; i < 3; i++) {
        const double change = h * sliding[i] - fresh * p->shear[i];
        p->shear[i] += change;
        force[i] = -k * p->shear[i] - c * change / h;
        out += p->shear[i] * normal[i];
        square += force[i] * force[i];
    }
    for (int i = 0; i < 3; i++) p->shear[i] -= out * normal[i];
    const double most = t->friction * pressed, size = sqrt(square);
    if (size <= most) return;
    for (int i = 0; i < 3; i++) {
        force[i] *= most / size;
        p->shear[i] = -force[i] / k;
    }
}

static void push_point(td_world *w, td_world_point *p, const double turn[9], const double at[3],
                       const double normal[3], double depth)
{
    const double *k = w->machine->robot.suspension_n_m, *c = w->machine->robot.suspension_ns_m;
    const double belt = w->belt[p->right], factor = w->options.machine.suspension;
    double v[3], way[3], sliding[3], force[3];
    td_world_base_velocity(v, w, at);
    const double leaving = v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2];
    const double pressed = fmax(0, p->weight * (k[0] * depth - factor * c[0] * leaving));
    forwards(way, turn, normal);
    for (int i = 0; i < 3; i++) sliding[i] = v[i] - leaving * normal[i] - belt * way[i];
    shear(force, p, w, normal, sliding, belt, pressed);
    const double rolling = w->options.tracks.rolling * pressed * (belt == 0 ? 0 : tanh(belt / ROLLS_M_S));
    for (int i = 0; i < 3; i++) {
        force[i] += pressed * normal[i] - rolling * way[i];
        w->track_force[p->right][i] += force[i];
    }
    w->touching[p->right]++;
    dBodyAddForceAtPos(w->body[0].ode, force[0], force[1], force[2], at[0], at[1], at[2]);
}

td_status td_world_tracks_push(td_world *w, td_error *error)
{
    for (int side = 0; side < 2; side++) w->belt[side] += w->belt_gain * (w->wanted[side] - w->belt[side]);
    double turn[9];
    td_pose_rotation(turn, &w->body[0].pose);
    memset(w->track_force, 0, sizeof w->track_force);
    memset(w->touching, 0, sizeof w->touching);
    for (int i = 0; i < w->point_count; i++) {
        td_world_point *p = w->point + i;
        const double *r = p->at, *t = w->body[0].pose.t;
        double at[3], normal[3], height;
        for (int c = 0; c < 3; c++)
            at[c] = turn[3 * c] * r[0] + turn[3 * c + 1] * r[1] + turn[3 * c + 2] * r[2] + t[c];
        if (!td_world_normal(normal, &height, w, at[0], at[1]))
            return td_fail(
                error, TD_ERROR_DATA,
                "world: at %.3f s the %s track of machine '%s' comes to (%.3f, %.3f) m, where the map "
                "has a hole or ends; drive elsewhere, or give a larger map",
                td_world_time(w), p->right ? "right" : "left", w->machine->robot.name, at[0], at[1]);
        const double depth = (height - at[2]) * normal[2];
        if (depth > 0)
            push_point(w, p, turn, at, normal, depth);
        else
            memset(p->shear, 0, sizeof p->shear);
    }
    return TD_OK;
}

/* ---- standing ---- */

/* The plane through the ground at the points: height under the middle, rise forwards and to the left. */
static td_status fit_ground(double plane[3], const td_world *w, const td_pose *pose, td_error *error)
{
    double sum[3] = {0}, square[2] = {0};
    for (int i = 0; i < w->point_count; i++) {
        const td_world_point *p = w->point + i;
        double at[3];
        td_pose_transform(at, pose, p->at);
        const double height = td_world_height_at(w, at[0], at[1]);
        if (isnan(height))
            return td_fail(
                error, TD_ERROR_DATA,
                "world: machine '%s' cannot stand at (%.3f, %.3f) m, where the map has a hole or ends; "
                "start elsewhere, or fill the map",
                w->machine->robot.name, at[0], at[1]);
        sum[0] += p->weight * height;
        for (int c = 0; c < 2; c++) {
            sum[1 + c] += p->weight * height * p->at[c];
            square[c] += p->weight * p->at[c] * p->at[c];
        }
    }
    plane[0] = sum[0];
    for (int c = 0; c < 2; c++) plane[1 + c] = sum[1 + c] / square[c];
    return TD_OK;
}

td_status td_world_stand(td_world *w, td_error *error)
{
    enum { ROUNDS = 5 };
    static const double x[3] = {1, 0, 0};
    td_pose *pose = &w->body[0].pose;
    double mass = 0, gravity = 0, ahead[3], plane[3] = {0};
    for (int i = 0; i < w->body_count; i++) mass += w->body[i].mass;
    for (int c = 0; c < 3; c++) gravity += w->options.machine.gravity[c] * w->options.machine.gravity[c];
    td_pose_rotate(ahead, pose, x);
    const double yaw = atan2(ahead[1], ahead[0]);
    td_pose level = {.q = {cos(yaw / 2), 0, 0, sin(yaw / 2)}};
    memcpy(level.t, pose->t, sizeof level.t);
    td_pose now = level;
    for (int round = 0; round < ROUNDS; round++) {
        TD_TRY(fit_ground(plane, w, &now, error));
        /* Heights were met at the tilted points: their rise is along the slope, sin of its angle. */
        const double pitch = -asin(fmax(-0.9, fmin(0.9, plane[1] * (round ? 1 : cos(atan(plane[1]))))));
        const double roll =
            asin(fmax(-0.9, fmin(0.9, plane[2] * (round ? 1 : cos(atan(plane[2]))) / cos(pitch))));
        const td_pose up = {.q = {cos(pitch / 2), 0, sin(pitch / 2), 0}},
                      aside = {.q = {cos(roll / 2), sin(roll / 2), 0, 0}};
        now = td_pose_compose(&level, &up);
        now = td_pose_compose(&now, &aside);
        now.t[2] = plane[0] - mass * sqrt(gravity) / w->machine->robot.suspension_n_m[0];
    }
    *pose = now;
    td_world_place(w);
    return TD_OK;
}
