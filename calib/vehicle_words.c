/* What the sights leave open, in the words of the machine.
 *
 * Open directions come as any basis of their space. What they may mean is known beforehand from the machine:
 * a shift along the parallel axes of its joints, a turn of the rig about a joint that the joint's zero
 * undoes, a joint's zero that free places undo. Each such direction that lies in the space (its part over the
 * rig's pose and the zeros) is told in its words; what is left of the space is told by its largest component.
 */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "calib/vehicle_internal.h"
#include "core/linalg.h"

#define DEGREES 57.29577951308232
/* A turn of the machine below this does not count as moved, rad. */
#define MOVED 0.02
/* Relative distance at which a direction is the one suggested. */
#define LIKE 0.05
#define WEAK_MM 20.0
#define WEAK_DEG 0.2

enum { PARTS = 6 + TD_VEHICLE_MAX_CHAIN, MOST_NULL = TD_VEHICLE_MAX_OPEN };

static TD_PRINTF(3, 4) void add_text(char (*list)[320], size_t *count, const char *format, ...)
{
    va_list arguments;
    if (*count == MOST_NULL) return;
    va_start(arguments, format);
    vsnprintf(list[(*count)++], sizeof *list, format, arguments);
    va_end(arguments);
}

/* "y of cab", or the direction's numbers. */
static const char *direction_words(char text[96], const double d[3], const char *link)
{
    double length = hypot(hypot(d[0], d[1]), d[2]);
    for (int i = 0; i < 3; i++)
        if (fabs(d[i]) > 0.98 * length) {
            snprintf(text, 96, "%c of %.60s", "xyz"[i], link);
            return text;
        }
    snprintf(text, 96, "(%.2f, %.2f, %.2f) of %.60s", d[0] / length, d[1] / length, d[2] / length, link);
    return text;
}

static const char *turn_word(const double d[3])
{
    double length = hypot(hypot(d[0], d[1]), d[2]);
    static const char *const word[] = {"roll", "pitch", "yaw"};
    for (int i = 0; i < 3; i++)
        if (fabs(d[i]) > 0.9 * length) return word[i];
    return "turn";
}

/* ---- what the machine suggests ---- */

/* How the chain's joints move what is beyond them, seen from the mount, in the first pose that is used. */
static void screws(double (*screw)[6], const td_vehicle_model *model)
{
    const td_robot *robot = model->data->robot;
    double q[TD_ROBOT_MAX_JOINTS];
    size_t pose = 0;
    for (size_t s = model->data->sight_count; s-- > 0;)
        if (model->used[s]) pose = model->data->sight[s].pose;
    td_vehicle_joints(q, model, pose);
    for (int k = 0; k < model->joints; k++) {
        /* Of child and parent the one that the joint parts from the mount. */
        int child = robot->joint[model->joint[k]].link, link = child, above = model->data->mount;
        while (above >= 0 && above != child) above = robot->link[above].parent;
        if (above == child) link = robot->link[child].parent;
        td_vehicle_arm(screw[k], robot, model->data->mount, link, q, &model->joint[k], 1);
    }
}

/* Members of the largest set of turning joints with parallel axes; their direction. */
static int parallel_joints(bool *member, double direction[3], const td_vehicle_model *model,
                           double (*screw)[6])
{
    int best = 0;
    for (int k = 0; k < model->joints; k++) {
        bool set[TD_VEHICLE_MAX_CHAIN] = {0};
        int count = 0;
        for (int o = 0; o < model->joints; o++) {
            double dot = screw[k][0] * screw[o][0] + screw[k][1] * screw[o][1] + screw[k][2] * screw[o][2];
            set[o] =
                model->data->robot->joint[model->joint[k]].kind != TD_JOINT_PRISMATIC && fabs(dot) > 0.9999;
            count += set[o];
        }
        if (count <= best) continue;
        best = count;
        memcpy(member, set, sizeof set);
        memcpy(direction, screw[k], 3 * sizeof *direction);
    }
    return best;
}

static double range_of(const td_vehicle_model *model, int joint)
{
    size_t n = (size_t)model->data->robot->joint_count;
    double low = INFINITY, high = -INFINITY;
    for (size_t k = 0; k < model->data->pose_count; k++) {
        low = fmin(low, model->data->q[k * n + (size_t)joint]);
        high = fmax(high, model->data->q[k * n + (size_t)joint]);
    }
    return high - low;
}

/* ---- the space ---- */

typedef struct space {
    size_t count; /* null directions, at most MOST_NULL */
    size_t parts; /* 6 + joints */
    double part[MOST_NULL][PARTS];
    size_t told;
    double coefficient[MOST_NULL][MOST_NULL]; /* of those told, orthonormal */
} space;

/* Takes c off what was told; false when nothing is left of it. */
static bool keep_coefficients(space *s, const double *c)
{
    double rest[MOST_NULL], length = 0, before = 0;
    memcpy(rest, c, s->count * sizeof *rest);
    for (size_t i = 0; i < s->count; i++) before += c[i] * c[i];
    for (size_t t = 0; t < s->told; t++) {
        double dot = 0;
        for (size_t i = 0; i < s->count; i++) dot += rest[i] * s->coefficient[t][i];
        for (size_t i = 0; i < s->count; i++) rest[i] -= dot * s->coefficient[t][i];
    }
    for (size_t i = 0; i < s->count; i++) length += rest[i] * rest[i];
    if (s->told == s->count || !(length > 1e-6 * before)) return false;
    for (size_t i = 0; i < s->count; i++) s->coefficient[s->told][i] = rest[i] / sqrt(length);
    s->told++;
    return true;
}

/* Whether `wanted` (parts) lies in the space, and was not told yet. */
static bool accept(space *s, const double *wanted)
{
    double a[PARTS * MOST_NULL], c[MOST_NULL], miss = 0, size = 0;
    if (!s->count) return false;
    for (size_t i = 0; i < s->parts; i++)
        for (size_t k = 0; k < s->count; k++) a[i * s->count + k] = s->part[k][i];
    size_t rows = s->parts;
    if (rows < s->count || td_least_squares_linear(c, NULL, a, wanted, rows, s->count, NULL) != TD_OK)
        return false;
    for (size_t i = 0; i < s->parts; i++) {
        double sum = -wanted[i];
        for (size_t k = 0; k < s->count; k++) sum += c[k] * s->part[k][i];
        miss += sum * sum;
        size += wanted[i] * wanted[i];
    }
    return miss < LIKE * LIKE * size && keep_coefficients(s, c);
}

static void tell_sideways(td_vehicle *result, space *s, const td_vehicle_model *model, double (*screw)[6])
{
    const td_robot *robot = model->data->robot;
    bool member[TD_VEHICLE_MAX_CHAIN] = {0};
    double wanted[PARTS] = {0};
    char axis[96], names[128] = "";
    int still = -1, first = -1;
    if (!parallel_joints(member, wanted + 3, model, screw) || !accept(s, wanted)) return;
    for (int k = 0; k < model->joints; k++) {
        const td_robot_joint *joint = &robot->joint[model->joint[k]];
        if (member[k]) {
            size_t used = strlen(names);
            if (first < 0) first = k;
            snprintf(names + used, sizeof names - used, "%s%.30s", used ? ", " : "", joint->name);
        } else if (joint->kind != TD_JOINT_PRISMATIC && range_of(model, model->joint[k]) < MOVED) {
            still = model->joint[k];
        }
    }
    direction_words(axis, wanted + 3, robot->link[model->data->mount].name);
    if (still >= 0)
        add_text(
            result->null_direction, &result->null_count,
            "sideways along the axis of %.30s (%s): %s turn about parallel axes and %.30s stood still: slew "
            "between images, or measure one point's lateral place",
            robot->joint[model->joint[first]].name, axis, names, robot->joint[still].name);
    else
        add_text(
            result->null_direction, &result->null_count,
            "sideways along the axis of %.30s (%s): the points' lateral places are free and %s turn about "
            "parallel axes: measure one point's lateral place, or look at a fixed board on the ground while "
            "slewing",
            robot->joint[model->joint[first]].name, axis, names);
}

static void tell_zeros(td_vehicle *result, space *s, const td_vehicle_model *model, double (*screw)[6])
{
    const td_robot *robot = model->data->robot;
    for (int k = 0; k < model->joints; k++) {
        const char *name = robot->joint[model->joint[k]].name;
        double wanted[PARTS] = {0};
        char axis[96];
        if (model->data->offset_prior[model->joint[k]] == 0) continue;
        wanted[6 + k] = 1;
        if (accept(s, wanted))
            add_text(
                result->null_direction, &result->null_count,
                "zero of %.40s: the points beyond it are free, and their places undo it: give the zero of "
                "%.40s a tight prior, or measure the points' places on their link",
                name, name);
        memcpy(wanted, screw[k], 6 * sizeof *wanted);
        if (!accept(s, wanted)) continue;
        bool shift = robot->joint[model->joint[k]].kind == TD_JOINT_PRISMATIC;
        direction_words(axis, shift ? screw[k] + 3 : screw[k], robot->link[model->data->mount].name);
        add_text(
            result->null_direction, &result->null_count,
            "%s of the rig about the axis of %.40s (%s) against that joint's zero: give the zero of %.40s a "
            "tight prior, or measure it",
            shift ? "shift" : turn_word(screw[k]), name, axis, name);
    }
}

/* By the largest component, lengths in m and angles in rad alike. */
static void tell_other(td_vehicle *result, const td_vehicle_model *model, const space *s, const double *c)
{
    const td_robot *robot = model->data->robot;
    const td_vehicle_belief *b = result->belief;
    size_t n = (size_t)model->joints, size = b->size, largest = 0;
    double most = 0;
    for (size_t i = 0; i < size; i++) {
        double sum = 0;
        for (size_t k = 0; k < s->count; k++) sum += c[k] * b->open[k * size + i];
        /* The rig's pose comes first in what is told. */
        if (i >= 6) sum *= 0.3;
        if (fabs(sum) > most) most = fabs(sum), largest = i;
    }
    const char *mount = robot->link[model->data->mount].name;
    if (largest < 6)
        add_text(
            result->null_direction, &result->null_count,
            "%s of the rig %s %c of %.40s, with what goes along: move the arm through other poses, show more "
            "points, or measure their places",
            largest < 3 ? "turn" : "shift", largest < 3 ? "about" : "along", "xyz"[largest % 3], mount);
    else if (largest < 6 + n)
        add_text(result->null_direction, &result->null_count,
                 "zero of %.40s: give it a prior, or move that joint between images",
                 robot->joint[model->joint[largest - 6]].name);
    else if (largest >= 6 + n + 3 * (size_t)b->points)
        add_text(result->null_direction, &result->null_count,
                 "pose of board %.40s on %.40s: measure it, or show the board in other poses",
                 model->data->board[(largest - 6 - n - 3 * (size_t)b->points) / 6].name,
                 robot->link[model->data->board[(largest - 6 - n - 3 * (size_t)b->points) / 6].link].name);
    else
        add_text(result->null_direction, &result->null_count,
                 "place of point %.40s along %c of %.40s: measure it, or show the point in other poses",
                 model->data->point[(largest - 6 - n) / 3].name, "xyz"[(largest - 6 - n) % 3],
                 robot -> link[model->data->point[(largest - 6 - n) / 3].link].name);
}

void td_vehicle_null_words(td_vehicle *result, const td_vehicle_model *model)
{
    const td_vehicle_belief *b = result->belief;
    space s = {.count = b->open_count, .parts = 6 + (size_t)model->joints};
    double screw[TD_VEHICLE_MAX_CHAIN][6];
    result->null_count = 0;
    if (!s.count) return;
    for (size_t k = 0; k < s.count; k++) memcpy(s.part[k], b->open + k * b->size, s.parts * sizeof *b->open);
    screws(screw, model);
    tell_sideways(result, &s, model, screw);
    tell_zeros(result, &s, model, screw);
    for (size_t k = 0; k < s.count; k++) {
        double c[MOST_NULL] = {0};
        c[k] = 1;
        if (keep_coefficients(&s, c)) tell_other(result, model, &s, s.coefficient[s.told - 1]);
    }
}

/* ---- weak ---- */

static void weak_half(td_vehicle *result, const td_vehicle_model *model, int half)
{
    double block[9], value[3], vector[9];
    char axis[96];
    for (int i = 0; i < 9; i++) block[i] = result->covariance[(3 * half + i / 3) * 6 + 3 * half + i % 3];
    if (td_eigen_symmetric(value, vector, block, 3, NULL) != TD_OK) return;
    double sigma = sqrt(fmax(value[2], 0)) * (half ? 1e3 : DEGREES);
    if (sigma < (half ? WEAK_MM : WEAK_DEG)) return;
    direction_words(axis, vector + 6, model->data->robot->link[model->data->vehicle].name);
    add_text(result->weak, &result->weak_count,
             "%s %s is known to %.3g %s only: show the points in more and other poses of the arm",
             half ? "shift of the rig along" : "turn of the rig about", axis, sigma, half ? "mm" : "deg");
}

void td_vehicle_weak_words(td_vehicle *result, const td_vehicle_model *model)
{
    const td_vehicle_data *data = model->data;
    size_t distinct = td_vehicle_distinct_poses(model);
    weak_half(result, model, 0);
    weak_half(result, model, 1);
    if (distinct < data->pose_count && model->joints)
        add_text(
            result->weak, &result->weak_count,
            "arm poses repeat: the %zu images show %zu different poses: a pose seen again tells little new",
            data->pose_count, distinct);
    for (int k = 0; k < model->joints; k++) {
        int j = model->joint[k];
        double prior = data->offset_prior[j];
        if (prior > 0 && isfinite(prior) && result->sigma_offset[j] > 0.9 * prior)
            add_text(result->weak, &result->weak_count,
                     "zero of %.60s: the images say no more than its prior of %.3g",
                     data->robot->joint[j].name, prior);
    }
}
