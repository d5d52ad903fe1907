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

/* The lower of two opposite neighbours, `stride` cells apart from this one, and the drop to it (0: none; so
 * for NaN: unknown ground is a wall). Equal ones take turns. */
static double lower_of(int *way, const td_soil *s, size_t i, size_t stride, bool has_before, bool has_after,
                       double height)
{
    const double before = has_before ? height - s->surface[i - stride] : 0;
    const double after = has_after ? height - s->surface[i + stride] : 0;
    const bool turn = s->sweep < SOIL_CLASSES;
    *way = before > after || (before == after && turn) || !(after > 0) ? -1 : 1;
    const double drop = *way < 0 ? before : after;
    return drop > 0 ? drop : 0;
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

/* Breaks off half of what stands too high: it is loose then, and flows by itself. */
static bool collapse(td_soil *s, soil_place p, size_t i, const size_t to[2])
{
    const double bank = soil_bank(s, i), most = s->steep_m * (1 + PLAY) + s->stand_m;
    double drop[2];
    for (int k = 0; k < 2; k++) drop[k] = to[k] == i ? 0 : fmax(0, bank - s->surface[to[k]]);
    const double square = drop[0] * drop[0] + drop[1] * drop[1];
    if (!(square > most * most)) return false;
    int64_t mass = (int64_t)ceil((sqrt(square) - most) / 2 / s->bank_m);
    if (mass > s->column_mg - s->cell[i].taken) mass = s->column_mg - s->cell[i].taken;
    soil_change(s, p, mass, mass);
    return mass > 0;
}

/* The two masses (mg) that a cell gives; never more than it has. */
static void masses_of(int64_t mass[2], const td_soil *s, const double drop[2], int64_t loose)
{
    double give[2];
    share(give, drop, s->steep_m);
    const double all = (give[0] + give[1]) / s->loose_m;
    if (all < (double)loose) {
        for (int k = 0; k < 2; k++) mass[k] = (int64_t)(give[k] / s->loose_m);
        return;
    }
    /* The last of it goes whole, or a film of single milligrams would creep on; what rounding leaves goes the
     * steeper way, or it would wander to and fro. */
    const int steeper = give[1] > give[0];
    mass[!steeper] = (int64_t)((double)loose * give[!steeper] / (give[0] + give[1]));
    mass[steeper] = loose - mass[!steeper];
}

/* True: the cell has moved, and must be looked at again. */
static bool relax(td_soil *s, soil_place p)
{
    const size_t i = soil_index(s, p.column, p.row), columns = (size_t)s->map->columns;
    const double height = s->surface[i], limit = s->steep_m * (1 + PLAY);
    int way[2];
    const double drop[2] = {lower_of(way, s, i, 1, p.column > 0, p.column + 1 < s->map->columns, height),
                            lower_of(way + 1, s, i, columns, p.row > 0, p.row + 1 < s->map->rows, height)};
    if (!(drop[0] * drop[0] + drop[1] * drop[1] > limit * limit)) return false;
    const soil_place q[2] = {{p.column + way[0], p.row}, {p.column, p.row + way[1]}};
    const size_t to[2] = {drop[0] > 0 ? (way[0] < 0 ? i - 1 : i + 1) : i,
                          drop[1] > 0 ? (way[1] < 0 ? i - columns : i + columns) : i};
    const bool broke = collapse(s, p, i, to);
    int64_t mass[2], given = 0;
    if (s->cell[i].loose == 0) return broke;
    masses_of(mass, s, drop, s->cell[i].loose);
    if (mass[0] <= 0 && mass[1] <= 0) return broke;
    for (int k = 0; k < 2; k++) {
        if (mass[k] <= 0) continue;
        soil_change(s, q[k], 0, mass[k]);
        given += mass[k];
    }
    soil_change(s, p, 0, -given);
    soil_wake(s, p); /* with its neighbours, so also those that were given to */
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

void soil_flow(td_soil *s)
{
    size_t looked = 0, flowing = soil_flowing(s);
    for (int n = 0; n < s->options.sweeps && flowing > 0; n++) {
        if (n > 0 && looked + flowing > (size_t)s->options.flow_cells) break;
        for (int k = 0; k < SOIL_CLASSES; k++) sweep_class(s, &s->active[(s->sweep + k) % SOIL_CLASSES]);
        s->sweep = (s->sweep + 1) % (2 * SOIL_CLASSES);
        looked += flowing;
        flowing = soil_flowing(s);
    }
}
