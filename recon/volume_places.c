/* Where the ground changed: seeds far above the noise, grown over their slopes, with a margin (hysteresis as
 * in Canny 1986; rules in volume.h). */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "recon/volume_internal.h"

static const double seed_sigmas = 5, grow_sigmas = 2, margin_lengths = 2, least_margin = 4 /* cells */;

typedef struct growth {
    volume_grid *g;
    double shift, sigma_shift;
    uint32_t *stack;
    size_t count;
} growth;

/* -1, 0, 1: how the cell differs, beyond so many sigma. */
static int side(const growth *w, size_t cell, double sigmas)
{
    const double d = w->g->d[cell] - w->shift, sigma = w->g->sigma[cell];
    const double variance = sigma * sigma + w->sigma_shift * w->sigma_shift;
    if (!(d * d > sigmas * sigmas * variance)) return 0;
    return d < 0 ? -1 : 1;
}

static void take(growth *w, size_t cell, int place)
{
    w->g->place[cell] = (signed char)place;
    w->stack[w->count++] = (uint32_t)cell;
}

static void grow(growth *w)
{
    const int columns = w->g->columns, rows = w->g->rows;
    while (w->count) {
        const size_t cell = w->stack[--w->count];
        const int c = (int)(cell % (size_t)columns), r = (int)(cell / (size_t)columns);
        for (int k = 0; k < 9; k++) {
            const int x = c + k % 3 - 1, y = r + k / 3 - 1;
            if (x < 0 || y < 0 || x >= columns || y >= rows) continue;
            const size_t next = (size_t)y * (size_t)columns + (size_t)x;
            if (!w->g->place[next] && side(w, next, grow_sigmas) == w->g->place[cell])
                take(w, next, w->g->place[cell]);
        }
    }
}

/* Whether a neighbour belongs to no place: only from such cells must the margin be drawn. */
static bool on_edge(const signed char *core, const volume_grid *g, int c, int r)
{
    for (int k = 0; k < 9; k++) {
        const int x = c + k % 3 - 1, y = r + k / 3 - 1;
        if (x < 0 || y < 0 || x >= g->columns || y >= g->rows) continue;
        if (!core[(size_t)y * (size_t)g->columns + (size_t)x]) return true;
    }
    return false;
}

/* The cells around one, up to `reach` cells away, that are nearer to it than to what took them before. */
static void draw(volume_grid *g, const signed char *core, float *distance, int c, int r, double reach)
{
    const int n = (int)reach;
    const signed char place = core[(size_t)r * (size_t)g->columns + (size_t)c];
    for (int y = r - n < 0 ? 0 : r - n; y <= r + n && y < g->rows; y++)
        for (int x = c - n < 0 ? 0 : c - n; x <= c + n && x < g->columns; x++) {
            const size_t cell = (size_t)y * (size_t)g->columns + (size_t)x;
            const float away = (float)((x - c) * (x - c) + (y - r) * (y - r));
            if (core[cell] || away > reach * reach || away >= distance[cell]) continue;
            distance[cell] = away;
            g->place[cell] = place;
        }
}

static td_status add_margin(volume_grid *g, double reach, td_error *error)
{
    const size_t n = volume_cells(g);
    signed char *core = malloc(n);
    float *distance = malloc(n * sizeof *distance);
    const bool room = core && distance;
    if (room) {
        memcpy(core, g->place, n);
        for (size_t i = 0; i < n; i++) distance[i] = INFINITY;
        for (int r = 0; r < g->rows; r++)
            for (int c = 0; c < g->columns; c++)
                if (core[(size_t)r * (size_t)g->columns + (size_t)c] && on_edge(core, g, c, r))
                    draw(g, core, distance, c, r, reach);
    }
    free(core);
    free(distance);
    return room ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the places that changed");
}

td_status volume_places(volume_grid *g, double shift, double sigma_shift, double correlation_m,
                        td_error *error)
{
    const size_t n = volume_cells(g);
    growth w = {.g = g, .shift = shift, .sigma_shift = sigma_shift, .stack = malloc(n * sizeof *w.stack)};
    if (!w.stack) return td_fail(error, TD_ERROR_MEMORY, "no memory for the places that changed");
    memset(g->place, 0, n);
    for (size_t i = 0; i < n; i++) {
        const int s = side(&w, i, seed_sigmas);
        if (s && !g->place[i]) {
            take(&w, i, s);
            grow(&w);
        }
    }
    free(w.stack);
    const double margin = fmax(least_margin, margin_lengths * correlation_m / g->cell_m);
    return add_margin(g, fmin(margin, hypot(g->columns, g->rows)), error);
}
