/* Flowing soil: a cellular automaton over the cells that a change has woken. */
#include "sim/soil_internal.h"

#include <stdlib.h>

/* Of the drop at repose: most that goes to a neighbour at once. More would throw tall piles to one side. */
static const double MOST = 1;
/* By this share a slope may stand above repose before it moves, so that soil comes to rest: 0.1 deg. */
static const double PLAY = 0.004;

bool soil_list_add(soil_list *list, soil_place p)
{
    if (list->count == list->capacity) {
        const size_t capacity = list->capacity ? 2 * list->capacity : 256;
        soil_place *grown = realloc(list->place, capacity * sizeof *grown);
        if (!grown) return false;
        list->place = grown;
        list->capacity = capacity;
    }
    list->place[list->count++] = p;
    return true;
}

static void wake_one(td_soil *s, int column, int row)
{
    if (!soil_inside(s, column, row)) return;
    const size_t i = soil_index(s, column, row);
    if (s->awake[i] || isnan(s->map->height[i])) return;
    if (soil_list_add(&s->active[(column + 2 * row) % SOIL_CLASSES], (soil_place){column, row}))
        s->awake[i] = 1;
    else
        s->failed = true;
}

void soil_wake(td_soil *s, soil_place p)
{
    wake_one(s, p.column, p.row);
    wake_one(s, p.column - 1, p.row);
    wake_one(s, p.column + 1, p.row);
    wake_one(s, p.column, p.row - 1);
    wake_one(s, p.column, p.row + 1);
}

/* The lower of two opposite neighbours, and the drop to it (0: none). Equal ones take turns. */
static double lower_of(soil_place *to, const td_soil *s, soil_place p, int dx, int dy, double height)
{
    double drop = 0;
    for (int k = 0; k < 2; k++) {
        const int sign = (k == 0) == (s->sweep < SOIL_CLASSES) ? 1 : -1;
        const soil_place q = {p.column + sign * dx, p.row + sign * dy};
        if (!soil_inside(s, q.column, q.row)) continue;
        const double d = height - soil_surface(s, soil_index(s, q.column, q.row));
        if (d > drop) { /* not for NaN: unknown ground is a wall */
            drop = d;
            *to = q;
        }
    }
    return drop;
}

/* Loose soil (m) to give to each: along the gradient, x = k a and y = k b, so that the steepness comes down
 * to repose, to first order: |(a - 2 x - y, b - x - 2 y)| = steep. */
static void share(double give[2], const double drop[2], double steep)
{
    const double square = drop[0] * drop[0] + drop[1] * drop[1];
    const double k = (1 - steep / sqrt(square)) / (2 + 2 * drop[0] * drop[1] / square);
    const double larger = k * fmax(drop[0], drop[1]), most = MOST * steep;
    for (int n = 0; n < 2; n++) give[n] = k * drop[n] * (larger > most ? most / larger : 1);
}

static void give_loose(td_soil *s, soil_place from, soil_place to, int64_t mass)
{
    s->cell[soil_index(s, from.column, from.row)].loose -= mass;
    s->cell[soil_index(s, to.column, to.row)].loose += mass;
    soil_disturb(s, from);
    soil_disturb(s, to);
    wake_one(s, to.column, to.row);
}

/* Breaks off half of what stands too high: it is loose then, and flows by itself. */
static bool collapse(td_soil *s, soil_place p, const soil_place to[2])
{
    const size_t i = soil_index(s, p.column, p.row);
    double drop[2] = {0, 0};
    for (int k = 0; k < 2; k++)
        if (to[k].column >= 0)
            drop[k] = fmax(0, soil_bank(s, i) - soil_surface(s, soil_index(s, to[k].column, to[k].row)));
    const double excess = hypot(drop[0], drop[1]) - s->steep_m * (1 + PLAY) - s->stand_m;
    if (!(excess > 0)) return false;
    int64_t mass = (int64_t)ceil(excess / 2 / s->bank_m);
    if (mass > s->column_mg - s->cell[i].taken) mass = s->column_mg - s->cell[i].taken;
    s->cell[i].taken += mass;
    s->cell[i].loose += mass;
    soil_disturb(s, p);
    return mass > 0;
}

/* True: the cell has moved, and must be looked at again. */
static bool relax(td_soil *s, soil_place p)
{
    const size_t i = soil_index(s, p.column, p.row);
    const double height = soil_surface(s, i), limit = s->steep_m * (1 + PLAY);
    soil_place to[2] = {{-1, -1}, {-1, -1}};
    const double drop[2] = {lower_of(to, s, p, 1, 0, height), lower_of(to + 1, s, p, 0, 1, height)};
    if (!(drop[0] * drop[0] + drop[1] * drop[1] > limit * limit)) return false;
    const bool broke = collapse(s, p, to);
    const int64_t loose = s->cell[i].loose;
    if (loose == 0) return broke;
    double give[2];
    share(give, drop, s->steep_m);
    const double all = (give[0] + give[1]) / s->loose_m;
    const double part = all > (double)loose ? (double)loose / all : 1;
    int64_t mass[2];
    for (int k = 0; k < 2; k++) mass[k] = (int64_t)(part * give[k] / s->loose_m);
    /* The last of it goes whole, or a film of single milligrams would creep on. */
    if (part < 1) mass[give[1] > give[0]] = loose - mass[give[1] <= give[0]];
    for (int k = 0; k < 2; k++)
        if (mass[k] > 0) give_loose(s, p, to[k], mass[k]);
    if (mass[0] <= 0 && mass[1] <= 0) return broke;
    soil_wake(s, p);
    return true;
}

static void sweep_class(td_soil *s, soil_list *list)
{
    /* What is woken meanwhile is of the other classes, but for the cell itself, which is awake. */
    size_t kept = 0;
    for (size_t k = 0; k < list->count; k++) {
        const soil_place p = list->place[k];
        if (relax(s, p))
            list->place[kept++] = p;
        else
            s->awake[soil_index(s, p.column, p.row)] = 0;
    }
    list->count = kept;
}

size_t soil_flowing(const td_soil *s)
{
    size_t count = 0;
    for (int k = 0; k < SOIL_CLASSES; k++) count += s->active[k].count;
    return count;
}

void soil_flow(td_soil *s, int sweeps)
{
    for (int n = 0; n < sweeps && soil_flowing(s) > 0; n++) {
        for (int k = 0; k < SOIL_CLASSES; k++) sweep_class(s, &s->active[(s->sweep + k) % SOIL_CLASSES]);
        s->sweep = (s->sweep + 1) % (2 * SOIL_CLASSES);
    }
}
