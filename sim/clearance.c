#include "sim/clearance.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim/clearance_internal.h"

td_clearance_options td_clearance_options_default(void)
{
    return (td_clearance_options){
        .unseen_top_m = NAN, .highest_probability = 0.01, .points = 96, .draws = 256, .seed = 1};
}

static td_status check_options(const td_clearance_options *o, td_error *error)
{
    const double length[2] = {o->correlation_m, o->step_m};
    static const char *const name[2] = {"correlation_m", "step_m"};
    for (int k = 0; k < 2; k++)
        if (!(length[k] >= 0) || !isfinite(length[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: must be 0 (by itself) or a length in m, not %g",
                           name[k], length[k]);
    if (!(o->highest_probability >= 0 && o->highest_probability <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "highest_probability: must be from 0 to 1, not %g",
                       o->highest_probability);
    if (o->points < 1 || o->points > 256)
        return td_fail(error, TD_ERROR_ARGUMENT, "points: must be from 1 to 256, not %d", o->points);
    if (o->draws < 8 || o->draws > 1000000)
        return td_fail(error, TD_ERROR_ARGUMENT, "draws: must be from 8 to 1000000, not %d", o->draws);
    return TD_OK;
}

/* ---- points kept for the probability: of each shape and cell, the one of least margin ---- */

typedef struct point_table {
    size_t capacity, count; /* capacity: a power of 2 */
    clearance_point *point; /* shape -1: free */
    bool full;              /* memory */
} point_table;

typedef struct search {
    clearance_visit visit; /* first: the visitor is found by it */
    const td_clearance_map *map;
    const clearance_path *path;
    point_table table;
    bool keep, by_knot;
    int shape, link;
    uint32_t state;
    double seed;  /* a distance that is known to be met later */
    double least; /* distance so far, */
    clearance_point nearest;
    bool found;
} search;

static bool same_place(const search *s, const clearance_point *a, const clearance_point *b)
{
    return a->cell == b->cell && a->shape == b->shape && a->patch == b->patch &&
           (!s->by_knot || s->path->state[a->state].knot == s->path->state[b->state].knot);
}

static size_t slot_of(const search *s, const point_table *table, const clearance_point *point)
{
    uint64_t hash = (uint64_t)(uint32_t)point->cell * 2 + point->patch;
    hash = (hash * 4096 + (uint64_t)point->shape) * 0x9E3779B97F4A7C15u;
    if (s->by_knot) hash = (hash ^ s->path->state[point->state].knot) * 0xBF58476D1CE4E5B9u;
    size_t at = (size_t)(hash >> 32) & (table->capacity - 1);
    while (table->point[at].shape >= 0 && !same_place(s, table->point + at, point))
        at = (at + 1) & (table->capacity - 1);
    return at;
}

static bool enlarge(search *s)
{
    point_table larger = {.capacity = s->table.capacity ? 2 * s->table.capacity : 1024,
                          .count = s->table.count};
    larger.point = malloc(larger.capacity * sizeof *larger.point);
    if (!larger.point) return false;
    for (size_t i = 0; i < larger.capacity; i++) larger.point[i].shape = -1;
    for (size_t i = 0; i < s->table.capacity; i++)
        if (s->table.point[i].shape >= 0)
            larger.point[slot_of(s, &larger, s->table.point + i)] = s->table.point[i];
    free(s->table.point);
    s->table = larger;
    return true;
}

static void keep_point(search *s, const clearance_point *point)
{
    if (2 * s->table.count >= s->table.capacity && !enlarge(s)) {
        s->table.full = true;
        return;
    }
    clearance_point *slot = s->table.point + slot_of(s, &s->table, point);
    if (slot->shape < 0) s->table.count++;
    if (slot->shape < 0 || point->margin < slot->margin) *slot = *point;
}

static void see_point(clearance_visit *visit, const clearance_point *seen)
{
    search *s = (search *)visit;
    clearance_point point = *seen;
    point.shape = s->shape;
    point.state = s->state;
    if (point.distance < s->least) {
        s->least = point.distance;
        s->nearest = point;
        s->found = true;
        visit->limit = fmin(s->least, s->seed);
    }
    if (!s->keep) return;
    const double sigma = clearance_cell_sigma(s->map, (size_t)point.cell);
    if (point.margin - CLEARANCE_SIGMAS * sigma <= visit->reach) keep_point(s, &point);
}

static void look(search *s, int shape, const td_pose *site_from_link, const clearance_shape *placed)
{
    s->shape = shape;
    s->link = placed->link;
    s->visit.reach =
        s->keep ? CLEARANCE_SIGMAS * clearance_motion_sigma(s->path, placed, site_from_link) : -INFINITY;
    s->visit.limit = fmin(s->least, s->seed);
    clearance_near(&s->visit, s->map, placed);
}

/* ---- results ---- */

static td_clearance_place place_of(const search *s, clearance_state state)
{
    td_clearance_place place = {.link = -1, .clearance_m = INFINITY, .time_s = NAN, .at = {NAN, NAN, NAN}};
    if (!s->found) return place;
    place.link = s->path->link[s->nearest.shape];
    place.clearance_m = s->least;
    place.time_s = clearance_time(s->path, state);
    memcpy(place.at, s->nearest.p, sizeof place.at);
    return place;
}

/* One shape at one time, as given. */
static td_clearance_place place_at(const search *s, int shape, clearance_state state)
{
    search one = {
        .visit = {.point = see_point}, .map = s->map, .path = s->path, .seed = INFINITY, .least = INFINITY};
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    if (!clearance_is_allowed(s->path, s->path->link[shape], clearance_time(s->path, state))) {
        clearance_links(site_from_link, s->path, state);
        const clearance_shape placed = clearance_shape_of(s->path, shape, site_from_link);
        look(&one, shape, site_from_link, &placed);
    }
    return place_of(&one, state);
}

/* Between two samples next to each other. */
static clearance_state between(const clearance_path *path, size_t i, double part)
{
    clearance_state a = path->state[i];
    const clearance_state b = path->state[i + 1];
    a.part += part * ((b.knot == a.knot ? b.part : 1) - a.part);
    return a;
}

/* The samples are a cell apart: the nearest place among them is looked at more finely. */
static void refine_nearest(td_clearance_place *nearest, const search *s)
{
    enum { FINE = 8 };
    const size_t at = s->nearest.state, first = at > 0 ? at - 1 : 0;
    if (!s->found) return;
    for (size_t i = first; i <= at && i + 1 < s->path->count; i++)
        for (int k = 1; k < FINE; k++) {
            const td_clearance_place place =
                place_at(s, s->nearest.shape, between(s->path, i, (double)k / FINE));
            if (place.clearance_m < nearest->clearance_m) *nearest = place;
        }
}

/* The shape touches at sample `at`, and did not at the one before: when in between? */
static td_clearance_place first_contact(const search *s, int shape, size_t at)
{
    td_clearance_place place = place_at(s, shape, s->path->state[at]);
    double clear = 0, touches = 1;
    if (at == 0 ||
        clearance_is_allowed(s->path, s->path->link[shape], clearance_time(s->path, s->path->state[at - 1])))
        return place;
    for (int k = 0; k < 12; k++) {
        const double middle = 0.5 * (clear + touches);
        const td_clearance_place there = place_at(s, shape, between(s->path, at - 1, middle));
        if (there.clearance_m <= 0) {
            touches = middle;
            place = there;
        } else {
            clear = middle;
        }
    }
    return place;
}

static void see_unseen(td_clearance *out, const search *s, const clearance_shape *placed, double time_s,
                       double top)
{
    double at[3];
    if (out->unseen || !clearance_unseen(at, s->map, placed, top)) return;
    out->unseen = true;
    out->unseen_at = (td_clearance_place){.link = placed->link, .clearance_m = NAN, .time_s = time_s};
    memcpy(out->unseen_at.at, at, sizeof at);
}

/* The least distance at every sixteenth sample: with it the others need not look far. Never below 0, so that
 * the first contact is found. */
static double seed_of(const search *s)
{
    search few = {
        .visit = {.point = see_point}, .map = s->map, .path = s->path, .seed = INFINITY, .least = INFINITY};
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    for (size_t i = 0; i < s->path->count; i += 16) {
        const double time = clearance_time(s->path, s->path->state[i]);
        clearance_links(site_from_link, s->path, s->path->state[i]);
        for (int shape = 0; shape < s->path->shape_count; shape++) {
            if (clearance_is_allowed(s->path, s->path->link[shape], time)) continue;
            const clearance_shape placed = clearance_shape_of(s->path, shape, site_from_link);
            look(&few, shape, site_from_link, &placed);
        }
    }
    return fmax(few.least, 0) + 1e-6;
}

static void follow(td_clearance *out, search *s, const td_clearance_options *options)
{
    const td_clearance_map *map = s->map;
    const double top = isnan(options->unseen_top_m) ? map->top[map->levels - 1][0] : options->unseen_top_m;
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    s->seed = seed_of(s);
    for (size_t i = 0; i < s->path->count; i++) {
        const double time = clearance_time(s->path, s->path->state[i]);
        td_clearance_place first = {.time_s = INFINITY};
        s->state = (uint32_t)i;
        clearance_links(site_from_link, s->path, s->path->state[i]);
        for (int shape = 0; shape < s->path->shape_count; shape++) {
            const double before = s->least;
            if (clearance_is_allowed(s->path, s->path->link[shape], time)) continue;
            const clearance_shape placed = clearance_shape_of(s->path, shape, site_from_link);
            see_unseen(out, s, &placed, time, top);
            look(s, shape, site_from_link, &placed);
            if (out->contact || !(s->least <= 0 && s->least < before)) continue;
            const td_clearance_place place = first_contact(s, shape, i);
            if (place.time_s < first.time_s) first = place;
        }
        if (!out->contact && first.time_s < INFINITY) {
            out->contact = true;
            out->first = first;
        }
    }
    out->nearest = place_of(s, s->path->state[s->found ? s->nearest.state : 0]);
    refine_nearest(&out->nearest, s);
    if (!out->contact) out->first = (td_clearance_place){.link = -1, .clearance_m = INFINITY, .time_s = NAN};
}

/* ---- the probability ---- */

typedef struct ranked {
    double z;
    size_t index;
} ranked;

typedef struct margins {
    size_t count; /* within five sigma */
    clearance_margin *margin;
    double *rows; /* (points, common + joints) */
    ranked *rank; /* ascending */
    int common, joints;
    double correlation_cells;
} margins;

static int by_state(const void *a, const void *b)
{
    const clearance_point *x = a, *y = b;
    if (x->state != y->state) return x->state < y->state ? -1 : 1;
    if (x->shape != y->shape) return x->shape - y->shape;
    return x->cell != y->cell ? (x->cell < y->cell ? -1 : 1) : x->patch - y->patch;
}

static int by_z(const void *a, const void *b)
{
    const ranked *x = a, *y = b;
    return x->z != y->z ? (x->z < y->z ? -1 : 1) : x->index < y->index ? -1 : x->index > y->index;
}

/* Of the rise of a cell, or of a point between four whose neighbours' correlation is rho. */
static double ground_variance(const double ground[4], double rho)
{
    double sum = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            const int apart = ((i ^ j) & 1) + ((i ^ j) >> 1);
            sum += ground[i] * ground[j] * (apart == 0 ? 1 : apart == 1 ? rho : rho * rho);
        }
    return sum;
}

/* Everything by which the margin changes with the errors. */
static void linearise(clearance_margin *m, double *row, const margins *all, const search *s,
                      const clearance_point *point, const td_pose *site_from_link)
{
    const td_clearance_motion *motion = s->path->motion;
    const clearance_state state = s->path->state[point->state];
    const double *p = point->p, *n = point->n;
    const double wrench[6] = {
        p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0], n[0], n[1], n[2]};
    const int columns = s->map->elevation->columns;
    const double knot = (1 - state.part) * (1 - state.part) + state.part * state.part;
    const double cells = all->correlation_cells, rho = cells > 0 ? exp(-1 / (cells * cells)) : 0;
    double rate[TD_ROBOT_MAX_JOINTS], variance = 0;
    clearance_joint_rates(rate, motion->robot, site_from_link, s->path->link[point->shape], p, n);
    for (int k = 0; k < all->common; k++) {
        row[k] = k < 6 || !motion->sigma_zero ? 0 : rate[k - 6] * motion->sigma_zero[k - 6];
        for (int a = 0; a < 6 && k < 6; a++) row[k] += wrench[a] * s->path->common[6 * a + k];
        variance += row[k] * row[k];
    }
    for (int k = 0; k < all->joints; k++) {
        row[all->common + k] = rate[k] * motion->sigma_reading[k];
        variance += knot * row[all->common + k] * row[all->common + k];
    }
    *m = (clearance_margin){.mean = point->margin,
                            .common = row,
                            .reading = row + all->common,
                            .knot = state.knot,
                            .part = state.part,
                            .column = point->cell % columns,
                            .row = point->cell / columns};
    for (int k = 0; k < 4; k++)
        if (point->weight[k] != 0)
            m->ground[k] = -point->weight[k] *
                           clearance_cell_sigma(s->map, (size_t)(point->cell + (k & 1) + (k >> 1) * columns));
    m->up = n[2];
    m->variance = variance + n[2] * n[2] * ground_variance(m->ground, rho);
}

static size_t compact(search *s)
{
    size_t count = 0;
    for (size_t i = 0; i < s->table.capacity; i++)
        if (s->table.point[i].shape >= 0) s->table.point[count++] = s->table.point[i];
    if (count) qsort(s->table.point, count, sizeof *s->table.point, by_state);
    return count;
}

/* Margins of all points kept, and the order of their mean over their sigma. */
static void rank(margins *all, const search *s, size_t points)
{
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    const size_t width = (size_t)(all->common + all->joints);
    for (size_t i = 0; i < points; i++) {
        const clearance_point *point = s->table.point + i;
        if (i == 0 || point->state != point[-1].state)
            clearance_links(site_from_link, s->path, s->path->state[point->state]);
        linearise(all->margin + i, all->rows + i * width, all, s, point, site_from_link);
        const clearance_margin *m = all->margin + i;
        const double z = m->variance > 0 ? m->mean / sqrt(m->variance) : m->mean < 0 ? -INFINITY : INFINITY;
        if (z <= CLEARANCE_SIGMAS) all->rank[all->count++] = (ranked){z, i};
    }
    if (all->count) qsort(all->rank, all->count, sizeof *all->rank, by_z);
}

static void set_likely(td_clearance *out, const search *s, const margins *all)
{
    const size_t index = all->rank[0].index;
    const clearance_point *point = s->table.point + index;
    out->likely = (td_clearance_place){.link = s->path->link[point->shape],
                                       .clearance_m = point->margin,
                                       .time_s = clearance_time(s->path, s->path->state[point->state])};
    memcpy(out->likely.at, point->p, sizeof point->p);
    out->likely_sigma_m = sqrt(all->margin[index].variance);
}

/* How shape and ground are displaced against each other at the point, by everything that is not the ground's
 * own noise. */
static void set_contact(clearance_contact *contact, const margins *all, const search *s, size_t index)
{
    const clearance_point *point = s->table.point + index;
    const td_clearance_motion *motion = s->path->motion;
    const clearance_state state = s->path->state[point->state];
    const double *p = contact->p, *root = s->path->common;
    const int link = s->path->link[point->shape];
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    clearance_links(site_from_link, s->path, state);
    *contact = (clearance_contact){.ground = s->map->elevation,
                                   .shape = clearance_shape_of(s->path, point->shape, site_from_link),
                                   .patch = point->patch,
                                   .p = {point->p[0], point->p[1], point->p[2]},
                                   .part = state.part};
    if (point->patch) contact->p[2] += point->margin / point->n[2];
    for (int k = 0; k < 6; k++) {
        const double w[3] = {root[k], root[6 + k], root[12 + k]};
        contact->move[k][0] = w[1] * p[2] - w[2] * p[1] + root[18 + k];
        contact->move[k][1] = w[2] * p[0] - w[0] * p[2] + root[24 + k];
        contact->move[k][2] = w[0] * p[1] - w[1] * p[0] + root[30 + k];
    }
    for (int a = 0; a < 3; a++) {
        const double axis[3] = {a == 0, a == 1, a == 2};
        double rate[TD_ROBOT_MAX_JOINTS];
        clearance_joint_rates(rate, motion->robot, site_from_link, link, p, axis);
        for (int k = 6; k < all->common; k++)
            contact->move[k][a] = motion->sigma_zero ? rate[k - 6] * motion->sigma_zero[k - 6] : 0;
        for (int k = 0; k < all->joints; k++) contact->shake[k][a] = rate[k] * motion->sigma_reading[k];
    }
}

/* Numbers the readings that the contacts lie between, so that each has one noise. */
static int number_knots(clearance_contact *contact, const clearance_margin *margin, const size_t *chosen,
                        int points)
{
    int knots = 0;
    for (int i = 0; i < points; i++)
        for (int side = 0; side < 2; side++) {
            const uint32_t knot = margin[chosen[i]].knot + (uint32_t)side;
            contact[i].knot[side] = knots;
            for (int j = 0; j < 2 * i + side; j++)
                if (margin[chosen[j / 2]].knot + (uint32_t)(j % 2) == knot)
                    contact[i].knot[side] = contact[j / 2].knot[j % 2];
            if (contact[i].knot[side] == knots) knots++;
        }
    return knots;
}

/* Of the points, those that are the least sigma off, four times as many as may be used. */
static td_status integrate(td_clearance *out, const search *s, const margins *all,
                           const td_clearance_options *options, td_error *error)
{
    const size_t most = 4 * (size_t)options->points, count = all->count < most ? all->count : most;
    clearance_margin *margin = malloc((count ? count : 1) * sizeof *margin);
    clearance_contact *contact = malloc((size_t)options->points * sizeof *contact);
    size_t *chosen = malloc((size_t)options->points * sizeof *chosen);
    td_status status = TD_OK;
    int points = 0;
    if (count && all->rank[0].z < -2 * CLEARANCE_SIGMAS) {
        out->probability = 1;
        goto done;
    }
    if (!margin || !contact || !chosen)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact");
    for (size_t i = 0; status == TD_OK && i < count; i++) margin[i] = all->margin[all->rank[i].index];
    const clearance_integral integral = {.count = count,
                                         .margin = margin,
                                         .common_count = all->common,
                                         .joints = all->joints,
                                         .correlation_cells = all->correlation_cells,
                                         .points = options->points,
                                         .draws = options->draws,
                                         .seed = options->seed};
    if (status == TD_OK) status = clearance_choose(chosen, &points, &out->left_out, &integral, error);
    for (int i = 0; status == TD_OK && i < points; i++)
        set_contact(contact + i, all, s, all->rank[chosen[i]].index);
    if (status == TD_OK)
        status = clearance_integrate(&out->probability, &out->sigma_probability, &integral, contact, chosen,
                                     points, number_knots(contact, margin, chosen, points), error);
done:
    free(margin);
    free(contact);
    free(chosen);
    return status;
}

static td_status weigh(td_clearance *out, search *s, const td_clearance_options *options, td_error *error)
{
    const int joints = s->path->motion->robot->joint_count;
    const double cell = s->map->elevation->cell_m;
    const size_t points = compact(s);
    margins all = {.common = 6 + joints,
                   .joints = s->by_knot ? joints : 0,
                   .correlation_cells = options->correlation_m > 0 ? options->correlation_m / cell : 2};
    td_status status = TD_OK;
    all.margin = malloc((points + 1) * sizeof *all.margin);
    all.rows = malloc((points + 1) * (size_t)(all.common + all.joints) * sizeof *all.rows);
    all.rank = malloc((points + 1) * sizeof *all.rank);
    if (!all.margin || !all.rows || !all.rank || s->table.full) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points of near contact", points);
    } else {
        rank(&all, s, points);
        out->points = all.count;
        if (all.count) set_likely(out, s, &all);
        status = integrate(out, s, &all, options, error);
    }
    free(all.margin);
    free(all.rows);
    free(all.rank);
    return status;
}

td_status td_clearance_check(td_clearance *clearance, const td_clearance_map *map,
                             const td_clearance_motion *motion, const td_clearance_options *options,
                             td_error *error)
{
    const td_clearance_options defaults = td_clearance_options_default();
    const td_clearance_options *o = options ? options : &defaults;
    clearance_path path;
    *clearance = (td_clearance){.nearest = {.link = -1, .clearance_m = INFINITY},
                                .likely = {.link = -1, .clearance_m = INFINITY},
                                .unseen_at = {.link = -1}};
    TD_TRY(check_options(o, error));
    TD_TRY(clearance_path_new(&path, motion, o->step_m > 0 ? o->step_m : map->elevation->cell_m, error));
    search s = {.visit = {.point = see_point},
                .map = map,
                .path = &path,
                .keep = true,
                .by_knot = motion->sigma_reading != NULL,
                .least = INFINITY};
    follow(clearance, &s, o);
    clearance->samples = path.count;
    const td_status status = weigh(clearance, &s, o, error);
    free(s.table.point);
    clearance_path_free(&path);
    return status;
}

/* ---- the verdict ---- */

static const char *name_of(const td_robot *robot, const td_clearance_place *place)
{
    return place->link >= 0 ? robot->link[place->link].name : "no link";
}

bool td_clearance_verdict(char *words, size_t size, const td_clearance *c, const td_robot *robot,
                          const td_clearance_options *options)
{
    const td_clearance_options defaults = td_clearance_options_default();
    const double highest = (options ? options : &defaults)->highest_probability;
    const td_clearance_place *n = &c->nearest, *f = c->contact ? &c->first : &c->likely, *u = &c->unseen_at;
    const bool risky = c->contact || c->probability > highest;
    char none[1];
    if (!words) {
        words = none;
        size = 0;
    }
    if (risky && f->link >= 0) {
        const td_clearance_place *deepest = c->contact && n->link == f->link ? n : f;
        snprintf(words, size,
                 "%s meets the ground at %.2f s with probability %.2g (clearance %.3f m at %.2f, %.2f)",
                 name_of(robot, f), f->time_s, c->probability, deepest->clearance_m, deepest->at[0],
                 deepest->at[1]);
    } else if (c->unseen)
        snprintf(words, size, "%s comes within reach of ground that is not known at %.2f s (at %.2f, %.2f)",
                 name_of(robot, u), u->time_s, u->at[0], u->at[1]);
    else if (n->link >= 0)
        snprintf(
            words, size,
            "clear of the ground: %s comes nearest at %.2f s (clearance %.3f m at %.2f, %.2f; probability "
            "of contact %.2g)",
            name_of(robot, n), n->time_s, n->clearance_m, n->at[0], n->at[1], c->probability);
    else
        snprintf(words, size, "no link that moves is over known ground");
    return !risky && !c->unseen;
}
