/* The search for a motion that tells much. */
#include "sim/excitation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/random.h"
#include "sim/identification_internal.h"
#include "sim/machine.h"

/* Samples of the motion that limits and information are looked at; random shapes before the search; numbers
 * a joint has: sines, cosines but the last, place in its range, size. */
enum { LOOKS = 160, SKIP = 2, DRAWN = 60, HARMONICS = TD_EXCITATION_HARMONICS, GENES = 2 * HARMONICS + 1 };
static const double PI = 3.14159265358979323846;
/* Of a joint without such a limit. */
static const double FREE_ROOM = 1.5, FREE_SPEED = 1, FREE_ACCELERATION = 2;
/* Nats that a metre below the lowest height costs: more than any motion gains. */
static const double SINKING = 1e3;

td_excitation_options td_excitation_options_default(const td_robot *robot)
{
    td_excitation_options o = {
        .duration_s = 20, .share = 0.7, .margin = 0.05, .steps = 600, .lowest_m = -INFINITY};
    if (robot->suspension_n_m[0] > 0) o.lowest_m = 0.5;
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        o.sigma_force[k] = isfinite(j->effort) && j->effort > 0 ? 0.01 * j->effort : 100;
        for (int i = 0; i < robot->cylinder_count; i++) {
            const td_cylinder *c = robot->cylinder + i;
            if (c->joint == k && isfinite(c->pressure_pa))
                o.sigma_force[k] = 0.01 * c->pressure_pa * c->count * PI / 4 * c->bore_m * c->bore_m;
        }
    }
    return o;
}

static td_status check_options(const td_excitation_options *o, const td_robot *robot, td_error *error)
{
    if (!(o->duration_s >= 1 && o->duration_s <= 1e4))
        return td_fail(error, TD_ERROR_ARGUMENT, "excitation: a duration of %g s is outside 1 to 10000",
                       o->duration_s);
    if (!(o->share > 0 && o->share <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "excitation: a share of %g is outside 0 to 1", o->share);
    if (!(o->margin >= 0 && o->margin < 0.5))
        return td_fail(error, TD_ERROR_ARGUMENT, "excitation: a margin of %g is outside 0 to 0.5", o->margin);
    if (o->steps < 1 || isnan(o->lowest_m))
        return td_fail(error, TD_ERROR_ARGUMENT, "excitation: steps and lowest_m must be numbers above 0");
    for (int k = 0; k < robot->joint_count; k++)
        if (!(o->sigma_force[k] > 0) || !isfinite(o->sigma_force[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "excitation: sigma_force of joint '%s' must be positive",
                           robot->joint[k].name);
    return TD_OK;
}

void td_excitation_at(double *position, double *rate, double *acceleration, const td_excitation *e, double t)
{
    for (int k = 0; k < e->joints; k++) {
        double p = e->start[k], v = 0, a = 0;
        for (int h = 0; h < HARMONICS; h++) {
            const double w = 2 * PI * (h + 1) / e->duration_s, s = sin(w * t), c = cos(w * t);
            p += (e->sine[k][h] * (1 - c) + e->cosine[k][h] * s) / w;
            v += e->sine[k][h] * s + e->cosine[k][h] * c;
            a += w * (e->sine[k][h] * c - e->cosine[k][h] * s);
        }
        if (position) position[k] = p;
        if (rate) rate[k] = v;
        if (acceleration) acceleration[k] = a;
    }
}

/* ---- from numbers to a motion within its limits ---- */

static double finite_or(double value, double otherwise)
{
    return isfinite(value) && value > 0 ? value : otherwise;
}

/* Sizes one joint's series to its limits, and places it in its range. */
static void fit_joint(td_excitation *e, int k, const td_robot *robot, const td_excitation_options *o,
                      const double *gene)
{
    const td_robot_joint *j = robot->joint + k;
    const bool bounded = isfinite(j->lower) && isfinite(j->upper);
    const double edge = bounded ? o->margin * (j->upper - j->lower) : 0,
                 low = bounded ? j->lower + edge : -FREE_ROOM, high = bounded ? j->upper - edge : FREE_ROOM;
    td_excitation one = {.duration_s = e->duration_s, .joints = 1};
    double last = 0, least = 0, most = 0, fast = 0, hard = 0;
    for (int h = 0; h < HARMONICS; h++) {
        one.sine[0][h] = gene[h];
        one.cosine[0][h] = h + 1 < HARMONICS ? gene[HARMONICS + h] : -last;
        last += one.cosine[0][h];
    }
    for (int i = 0; i < LOOKS; i++) {
        double p = 0, v = 0, a = 0;
        td_excitation_at(&p, &v, &a, &one, e->duration_s * i / LOOKS);
        least = fmin(least, p), most = fmax(most, p);
        fast = fmax(fast, fabs(v)), hard = fmax(hard, fabs(a));
    }
    const double scale =
        fmin((high - low) / (most - least + 1e-300),
             o->share * fmin(finite_or(j->speed, FREE_SPEED) / (fast + 1e-300),
                             finite_or(j->acceleration, FREE_ACCELERATION) / (hard + 1e-300)));
    const double place = 0.5 + atan(gene[GENES - 2]) / PI,
                 size = 1 - 0.8 * (0.5 + atan(gene[GENES - 1]) / PI);
    for (int h = 0; h < HARMONICS; h++) {
        e->sine[k][h] = size * scale * one.sine[0][h];
        e->cosine[k][h] = size * scale * one.cosine[0][h];
    }
    e->start[k] = low - size * scale * least + place * (high - low - size * scale * (most - least));
}

/* Flow that the cylinders take together, over the pumps'. */
static double flow_share(const td_robot *robot, const double *q, const double *rate, double pump)
{
    double flow = 0;
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *c = robot->cylinder + i;
        double lever = 0;
        if (!td_cylinder_length(NULL, &lever, robot, c, q[c->joint])) continue;
        const double speed = lever * rate[c->joint], rod = speed < 0 ? c->rod_m : 0;
        flow += fabs(speed) * c->count * PI / 4 * (c->bore_m * c->bore_m - rod * rod);
    }
    return isfinite(pump) && pump > 0 ? flow / pump : 0;
}

static void make_motion(td_excitation *e, const td_robot *robot, const td_excitation_options *o, double pump,
                        const double *gene)
{
    double most = 0;
    e->joints = robot->joint_count;
    e->duration_s = o->duration_s;
    for (int k = 0; k < e->joints; k++) fit_joint(e, k, robot, o, gene + k * GENES);
    for (int i = 0; i < LOOKS; i++) {
        double q[TD_ROBOT_MAX_JOINTS], rate[TD_ROBOT_MAX_JOINTS];
        td_excitation_at(q, rate, NULL, e, e->duration_s * i / LOOKS);
        most = fmax(most, flow_share(robot, q, rate, pump));
    }
    if (!(most > o->share)) return;
    for (int k = 0; k < e->joints; k++)
        for (int h = 0; h < HARMONICS; h++) {
            e->sine[k][h] *= o->share / most;
            e->cosine[k][h] *= o->share / most;
        }
}

/* ---- what it tells ---- */

typedef struct search {
    const td_robot *robot;
    const td_excitation_options *o;
    td_id_model m;
    double pump;
    td_pose *place;                     /* (links) */
    double *prior, *information, *rows; /* (count,count) twice; (n,count) */
    double *gene, *best, *value;
} search;

static double height_missing(search *s, const double *q)
{
    double missing = 0;
    if (!isfinite(s->o->lowest_m)) return 0;
    td_robot_forward(s->place, s->robot, q);
    for (int i = 1; i < s->robot->link_count; i++) missing = fmax(missing, s->o->lowest_m - s->place[i].t[2]);
    return missing;
}

/* A joint's force tells of the parameters only while it moves. */
static void add_information(search *s, const td_excitation *e, double t, double weight)
{
    const td_id_model *m = &s->m;
    double q[TD_DYNAMICS_MAX], rate[TD_DYNAMICS_MAX], second[TD_DYNAMICS_MAX];
    td_id_state state;
    td_excitation_at(q, rate, second, e, t);
    td_id_state_from(&state, m, q, rate, second, false);
    td_id_rows(s->rows, m, &state);
    for (int k = 0; k < m->n; k++) {
        double lever = 1;
        for (int i = 0; i < s->robot->cylinder_count; i++)
            if (s->robot->cylinder[i].joint == k)
                td_cylinder_length(NULL, &lever, s->robot, s->robot->cylinder + i, q[k]);
        if (fabs(rate[k]) < 4 * m->o.slip || lever == 0) continue;
        const double by = weight / (lever * lever * s->o->sigma_force[k] * s->o->sigma_force[k]);
        const double *row = s->rows + k * m->count;
        for (int a = 0; a < m->count; a++)
            for (int b = 0; b <= a; b++)
                s->information[a * m->count + b] += by * row[a] * row[b] * m->base_size[a] * m->base_size[b];
    }
}

/* log det(information + prior) of 50 forces a second, less what is lacking in height. */
static td_status score_of(double *score, search *s, td_excitation *e, const double *gene, td_error *error)
{
    const size_t count = (size_t)s->m.count;
    double missing = 0;
    make_motion(e, s->robot, s->o, s->pump, gene);
    memset(s->information, 0, count * count * sizeof *s->information);
    for (int i = 0; i < LOOKS; i++) {
        double q[TD_ROBOT_MAX_JOINTS];
        td_excitation_at(q, NULL, NULL, e, e->duration_s * i / LOOKS);
        missing = fmax(missing, height_missing(s, q));
        if (i % SKIP == 0)
            add_information(s, e, e->duration_s * i / LOOKS, 50 * e->duration_s * SKIP / LOOKS);
    }
    for (size_t a = 0; a < count; a++)
        for (size_t b = 0; b < a; b++) s->information[b * count + a] = s->information[a * count + b];
    TD_TRY(td_eigen_symmetric(s->value, NULL, s->information, count, error));
    e->condition =
        s->value[0] > 1e-13 * s->value[count - 1] ? sqrt(s->value[count - 1] / s->value[0]) : INFINITY;
    for (size_t i = 0; i < count * count; i++) s->information[i] += s->prior[i];
    TD_TRY(td_eigen_symmetric(s->value, NULL, s->information, count, error));
    *score = -SINKING * missing;
    for (size_t i = 0; i < count; i++) *score += log(fmax(s->value[i], 1e-300));
    return TD_OK;
}

/* Random shapes, then steps from the best one, shorter after a failure and longer after a success (the rule
 * of a fifth). */
static td_status climb(td_excitation *best, search *s, const td_progress *progress, td_error *error)
{
    const int genes = GENES * s->robot->joint_count;
    td_random random = td_random_seed(s->o->seed, 17);
    double top = -INFINITY, stride = 0.5;
    for (int i = 0; i < DRAWN + s->o->steps; i++) {
        double score = 0;
        td_excitation e = {0};
        for (int g = 0; g < genes; g++) {
            const double step = td_random_normal(&random);
            s->gene[g] = i < DRAWN ? step : s->best[g] + stride * step;
        }
        TD_TRY(score_of(&score, s, &e, s->gene, error));
        const bool better = score > top;
        if (i >= DRAWN) stride = fmax(0.02, fmin(1, stride * (better ? 1.5 : 0.9)));
        if (better) {
            top = score;
            *best = e;
            memcpy(s->best, s->gene, (size_t)genes * sizeof *s->best);
        }
        if (!td_progress_report(progress, "searching a motion", (size_t)i + 1, (size_t)(DRAWN + s->o->steps)))
            return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
    return TD_OK;
}

static td_status check_height(search *s, const td_excitation *e, td_error *error)
{
    for (int i = 0; i < LOOKS; i++) {
        double q[TD_ROBOT_MAX_JOINTS];
        td_excitation_at(q, NULL, NULL, e, e->duration_s * i / LOOKS);
        if (height_missing(s, q) > 0)
            return td_fail(
                error, TD_ERROR_DATA,
                "no motion was found that keeps all links %.3g m above the root; lower lowest_m, or "
                "search longer",
                s->o->lowest_m);
    }
    return TD_OK;
}

static td_status begin(search *s, td_error *error)
{
    const size_t count = (size_t)s->m.count, genes = GENES * (size_t)s->robot->joint_count;
    s->place = calloc((size_t)s->robot->link_count, sizeof *s->place);
    s->prior = calloc(2 * count * count + (size_t)s->m.n * count + count, sizeof *s->prior);
    s->gene = calloc(2 * genes, sizeof *s->gene);
    if (!s->place || !s->prior || !s->gene)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the search");
    s->information = s->prior + count * count;
    s->rows = s->information + count * count;
    s->value = s->rows + (size_t)s->m.n * count;
    s->best = s->gene + genes;
    td_id_prior(s->prior, &s->m, 1);
    for (size_t a = 0; a < count; a++)
        for (size_t b = 0; b < count; b++) s->prior[a * count + b] /= s->m.base_size[a] * s->m.base_size[b];
    return td_invert_spd(s->prior, s->prior, count, error);
}

td_status td_excitation_propose(td_excitation *excitation, const td_robot *robot,
                                const td_identification_options *model, const td_excitation_options *options,
                                const td_progress *progress, td_error *error)
{
    const td_excitation_options o = options ? *options : td_excitation_options_default(robot);
    const td_identification_options with = model ? *model : td_identification_options_default(robot);
    search s = {.robot = robot, .o = &o, .pump = td_machine_options_default(robot).pump_m3_s};
    TD_TRY(check_options(&o, robot, error));
    td_status status = td_id_model_make(&s.m, robot, &with, false, error);
    if (status == TD_OK) status = begin(&s, error);
    if (status == TD_OK) status = climb(excitation, &s, progress, error);
    if (status == TD_OK) status = check_height(&s, excitation, error);
    free(s.place);
    free(s.prior);
    free(s.gene);
    td_id_model_free(&s.m);
    return status;
}
