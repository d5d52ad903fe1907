#include "servo/track_drive.h"

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846, RADIANS = 0.017453292519943295;
static const double LEAST_RADIUS_M = 2;
static const double BEHIND = 2.0943951023931953; /* from here on a goal is driven to backwards */
/* 1/m^2, 1/m, 1/s, 1/s: lateral errors die away over 1.4 m, critically damped. */
static const double K_Y = 0.5, K_THETA = 1.4, K_X = 0.8, K_TURN = 0.8;
/* 1/s, in place: there most of what the tracks do is slip. */
static const double K_PLACE = 2;

td_track_drive_options td_track_drive_options_default(void)
{
    return (td_track_drive_options){.half_gauge_m = 1.1,
                                    .speed_m_s = 0.5,
                                    .acceleration_m_s2 = 0.3,
                                    .limit_m_s = 1.5,
                                    .tolerance_m = 0.05,
                                    .tolerance_rad = RADIANS,
                                    .patience_s = 20};
}

static double wrapped(double angle)
{
    return remainder(angle, 2 * PI);
}

static void place_of(double at[3], const td_pose *site_from_vehicle)
{
    static const double x[3] = {1, 0, 0};
    double ahead[3];
    td_pose_rotate(ahead, site_from_vehicle, x);
    at[0] = site_from_vehicle->t[0];
    at[1] = site_from_vehicle->t[1];
    at[2] = atan2(ahead[1], ahead[0]);
}

/* ---- the way ---- */

static void add_part(td_track_drive *d, double length, double turn)
{
    if (length != 0 || turn != 0) d->way[d->part_count++] = (td_track_part){length, turn};
}

/* From a pose along the arc that is tangent to its heading (backwards: to its opposite) to a point. */
static td_track_part arc_to(const double from[3], const double to[2], int sign)
{
    const double dx = to[0] - from[0], dy = to[1] - from[1], chord = hypot(dx, dy);
    const double half = wrapped(atan2(sign * dy, sign * dx) - from[2]);
    return (td_track_part){sign * chord * (fabs(half) > 1e-9 ? half / sin(half) : 1), 2 * half};
}

static bool is_wide(const td_track_part *p)
{
    return fabs(p->length_m) >= LEAST_RADIUS_M * fabs(p->turn_rad) && fabs(p->turn_rad) < PI / 2;
}

/* Two arcs that touch where both are as long a tangent away from the ends: 2 s^2 (1 - t1 t2) + 2 s v (t1 +
 * t2) = v v, with v from end to end and t1, t2 the directions there (Bolton 1975). */
static bool way_of_arcs(td_track_drive *d, const double goal[3], int sign)
{
    const double t1[2] = {sign * cos(d->from[2]), sign * sin(d->from[2])},
                 t2[2] = {sign * cos(goal[2]), sign * sin(goal[2])},
                 v[2] = {goal[0] - d->from[0], goal[1] - d->from[1]};
    const double open = 2 * (1 - t1[0] * t2[0] - t1[1] * t2[1]), far = v[0] * v[0] + v[1] * v[1],
                 ahead = v[0] * (t1[0] + t2[0]) + v[1] * (t1[1] + t2[1]);
    const double s =
        open > 1e-9 ? (sqrt(ahead * ahead + open * far) - ahead) / open : (ahead > 0 ? far / (2 * ahead) : 0);
    double middle[3];
    if (!(s > 0)) return false;
    for (int i = 0; i < 2; i++) middle[i] = (d->from[i] + goal[i] + s * (t1[i] - t2[i])) / 2;
    const td_track_part first = arc_to(d->from, middle, sign);
    middle[2] = d->from[2] + first.turn_rad;
    const td_track_part second = arc_to(middle, goal, sign);
    if (!is_wide(&first) || !is_wide(&second)) return false;
    add_part(d, first.length_m, first.turn_rad);
    add_part(d, second.length_m, second.turn_rad);
    return true;
}

static void way_to(td_track_drive *d, const td_task_drive *task, td_task_frame frame)
{
    double goal[3] = {task->to_m[0], task->to_m[1], RADIANS * task->yaw_deg};
    if (frame == TD_TASK_VEHICLE) {
        const double c = cos(d->from[2]), s = sin(d->from[2]);
        goal[0] = d->from[0] + c * task->to_m[0] - s * task->to_m[1];
        goal[1] = d->from[1] + s * task->to_m[0] + c * task->to_m[1];
        goal[2] += d->from[2];
    }
    const double dx = goal[0] - d->from[0], dy = goal[1] - d->from[1], far = hypot(dx, dy);
    double turn = 0, length = 0;
    if (far > d->options.tolerance_m && (way_of_arcs(d, goal, 1) || way_of_arcs(d, goal, -1))) return;
    if (far > d->options.tolerance_m) {
        turn = wrapped(atan2(dy, dx) - d->from[2]);
        length = far;
        if (fabs(turn) > BEHIND) turn = wrapped(turn + PI), length = -far;
    }
    add_part(d, 0, turn);
    add_part(d, length, 0);
    add_part(d, 0, wrapped(goal[2] - d->from[2] - turn));
}

/* How far it goes and turns in `share` of a part. */
static void along(double at[3], const double from[3], const td_track_part *p, double share)
{
    const double turn = share * p->turn_rad, half = turn / 2;
    const double chord = share * p->length_m * (fabs(half) > 1e-9 ? sin(half) / half : 1);
    at[0] = from[0] + chord * cos(from[2] + half);
    at[1] = from[1] + chord * sin(from[2] + half);
    at[2] = from[2] + turn;
}

/* What the outer track covers. */
static double reach(const td_track_drive *d, const td_track_part *p)
{
    return fabs(p->length_m) + fabs(p->turn_rad) * d->options.half_gauge_m;
}

/* A trapezoid over `length` at most `speed`: the share gone and its rate, by the time since its begin. */
static double trapezoid(double *share, double *rate, double length, double speed, double acceleration,
                        double t)
{
    const double top = fmin(speed, sqrt(length * acceleration)), ramp = top / acceleration;
    const double total = length / top + ramp;
    const double left = total - t;
    if (t >= total)
        *share = 1, *rate = 0;
    else if (t < ramp)
        *share = acceleration * t * t / 2 / length, *rate = acceleration * t / length;
    else if (left < ramp)
        *share = 1 - acceleration * left * left / 2 / length, *rate = acceleration * left / length;
    else
        *share = (top * t - top * ramp / 2) / length, *rate = top / length;
    return total;
}

td_status td_track_drive_start(td_track_drive *d, const td_task_drive *task, td_task_frame frame,
                               const td_pose *site_from_vehicle, const td_track_drive_options *options,
                               td_error *error)
{
    *d = (td_track_drive){.options = options ? *options : td_track_drive_options_default()};
    d->speed_m_s = task->speed_m_s > 0 ? task->speed_m_s : d->options.speed_m_s;
    const double sum = task->to_m[0] + task->to_m[1] + task->yaw_deg + task->distance_m + task->turn_deg;
    place_of(d->from, site_from_vehicle);
    if (!isfinite(sum) || !isfinite(d->from[0] + d->from[1] + d->from[2]))
        return td_fail(error, TD_ERROR_ARGUMENT, "drive: a goal or the machine's place is no number");
    if (!(d->speed_m_s > 0 && d->speed_m_s <= d->options.limit_m_s) || !(d->options.acceleration_m_s2 > 0) ||
        !(d->options.half_gauge_m > 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "drive: a speed of %g m/s is not above 0 and within the tracks' limit of %g m/s",
                       d->speed_m_s, d->options.limit_m_s);
    if (task->has_to)
        way_to(d, task, frame);
    else
        add_part(d, task->distance_m, RADIANS * task->turn_deg);
    d->done = d->part_count == 0;
    return TD_OK;
}

void td_track_drive_wanted(double at[3], const td_track_drive *d)
{
    double share = 1, rate = 0;
    if (d->part >= d->part_count) {
        memcpy(at, d->from, 3 * sizeof *at);
        return;
    }
    const td_track_part *p = d->way + d->part;
    trapezoid(&share, &rate, reach(d, p), d->speed_m_s, d->options.acceleration_m_s2, d->along_s);
    along(at, d->from, p, share);
}

int td_track_drive_way(double (*at)[3], int most, const td_track_drive *d)
{
    double from[3], whole = 0;
    int count = 0;
    memcpy(from, d->from, sizeof from);
    for (int i = 0; i < d->part_count; i++) whole += reach(d, d->way + i);
    for (int i = 0; i < d->part_count; i++) {
        const int points = (int)fmax(1, floor((most - d->part_count) * reach(d, d->way + i) / whole));
        for (int k = 0; k <= points && count < most; k++)
            along(at[count++], from, d->way + i, (double)k / points);
        double end[3];
        along(end, from, d->way + i, 1);
        memcpy(from, end, sizeof from);
    }
    return count;
}

/* ---- driven ---- */

/* Steering is by the way's speed, which is negative backwards. */
static void steer(double *left, double *right, td_track_drive *d, const double is[3], double v, double w)
{
    double wanted[3];
    td_track_drive_wanted(wanted, d);
    const double c = cos(is[2]), s = sin(is[2]), dx = wanted[0] - is[0], dy = wanted[1] - is[1];
    const double x = c * dx + s * dy, y = -s * dx + c * dy, theta = wrapped(wanted[2] - is[2]);
    const bool turns = d->way[d->part].length_m == 0;
    const double speed = turns ? 0 : v * cos(theta) + K_X * x;
    const double turn = w + v * K_Y * y + fabs(v) * K_THETA * sin(theta) +
                        (turns    ? K_PLACE
                         : v == 0 ? K_TURN
                                  : 0) *
                            sin(theta);
    d->off_m = turns ? 0 : fabs(x);
    d->off_rad = fabs(theta);
    *left = speed - turn * d->options.half_gauge_m;
    *right = speed + turn * d->options.half_gauge_m;
    const double most = fmax(fabs(*left), fabs(*right)) / d->options.limit_m_s;
    if (most > 1) *left /= most, *right /= most;
}

/* The next part begins where the last should have ended, so that errors do not add up. */
static void next_part(td_track_drive *d)
{
    double end[3];
    along(end, d->from, d->way + d->part, 1);
    memcpy(d->from, end, sizeof end);
    d->part++;
    d->along_s = d->late_s = 0;
    d->done = d->part == d->part_count;
}

void td_track_drive_step(double *left, double *right, td_track_drive *d, const td_pose *site_from_vehicle,
                         double period_s)
{
    const td_track_drive_options *o = &d->options;
    double is[3], share, rate;
    *left = *right = 0;
    if (d->done || d->stuck) return;
    const td_track_part *p = d->way + d->part;
    d->along_s += period_s;
    const double total =
        trapezoid(&share, &rate, reach(d, p), d->speed_m_s, o->acceleration_m_s2, d->along_s);
    place_of(is, site_from_vehicle);
    steer(left, right, d, is, rate * p->length_m, rate * p->turn_rad);
    if (d->along_s < total) return;
    d->late_s += period_s;
    if (d->off_m <= o->tolerance_m && d->off_rad <= o->tolerance_rad) {
        *left = *right = 0;
        next_part(d);
    } else if (d->late_s > o->patience_s) {
        *left = *right = 0;
        d->stuck = true;
    }
}
