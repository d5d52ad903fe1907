/* Step three of finding marks: which of them lie together on a plane's lattice.
 *
 * A disc's ellipse tells the local affine map from the plane to the image up to a rotation. In the frame
 * where the ellipse is the unit circle, neighbours lie at one distance (the pitch, known from the target) in
 * four directions at right angles, however strong the tilt; the mean of the two marks' frames takes
 * perspective away to second order. A lattice grows from a mark with its neighbours in place to their
 * neighbours, and so on: distortion, which bends the lattice as a whole, does not matter locally. Marks cut
 * off by a hidden row join by the lattice's homography. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks_internal.h"

static const double PI = 3.14159265358979323846;

enum { MAX_NEAR = 12, REACH = TD_TARGET_MAX_SIDE, SIDE = 2 * REACH + 1, LEAST_MARKS = 4 };

/* In shares of the pitch. A diagonal neighbour is 1.41 away; an expected neighbour may be off by TOLERANCE.
 */
static const double LEAST_STEP = 0.7, MOST_STEP = 1.3, TOLERANCE = 0.25;
/* Lattice units by which a mark that joins over a gap may be off. */
static const double JOIN_TOLERANCE = 0.2;
/* Places beyond the lattice's last at which a mark may join. */
static const int GAP = 3;

/* A mark nearby, and where it is seen from here in the frame where both are circles. */
typedef struct near_mark {
    int mark;
    double u[2], distance;
} near_mark;

typedef enum state { FREE, GROWING, TAKEN } state;

typedef struct node {
    double frame[3]; /* square root of the shape, which takes the ellipse to the unit circle: xx, xy, yy */
    double axes[2];
    near_mark near[MAX_NEAR]; /* the nearest first */
    int near_count;
    double nearest; /* distance of the nearest mark of about its size; INFINITY: none */
    state state;
    int at[2]; /* column and row on the lattice that grows */
} node;

/* A place from which to grow: the direction of its neighbours, modulo a right angle, and how many there are.
 */
typedef struct seed {
    int mark, neighbours;
    double angle;
} seed;

typedef struct graph {
    const td_mark *mark;
    int count;
    double pitch;
    node *node; /* (count) */
    seed *seed; /* (count) */
    int *queue; /* (count) marks of the lattice in the order of their arrival */
    int queued;
    int *owner;   /* (SIDE,SIDE) mark at each place of the lattice, -1 */
    double *pair; /* (4 count) room for a homography's points */
} graph;

/* ---- The graph of neighbours. ---- */

static void init_node(node *n, const td_mark *mark)
{
    const double *s = mark->shape;
    double d = sqrt(s[0] * s[2] - s[1] * s[1]), t = sqrt(s[0] + s[2] + 2 * d);
    *n = (node){.frame = {(s[0] + d) / t, s[1] / t, (s[2] + d) / t}, .nearest = INFINITY};
    td_mark_axes(n->axes, mark);
}

/* Are the ellipses much the same? b's, in a's frame, must be nearly the unit circle; of very small ones the
 * shape is known less well. */
static bool alike(const node *a, const td_mark *mark_b, double minor)
{
    const double *f = a->frame, *s = mark_b->shape;
    double det = f[0] * f[2] - f[1] * f[1], g[3] = {f[2] / det, -f[1] / det, f[0] / det};
    double m[4] = {g[0] * s[0] + g[1] * s[1], g[0] * s[1] + g[1] * s[2], g[1] * s[0] + g[2] * s[1],
                   g[1] * s[1] + g[2] * s[2]};
    double q[3] = {m[0] * g[0] + m[1] * g[1], m[0] * g[1] + m[1] * g[2], m[2] * g[1] + m[3] * g[2]};
    double half = 0.5 * (q[0] + q[2]), root = hypot(0.5 * (q[0] - q[2]), q[1]);
    double most = 1.3 + 0.6 / minor; /* of the ratio of axes; here are their squares */
    return (half + root) < most * most && (half - root) * most * most > 1;
}

static void add_near(node *n, int mark, double x, double y, double distance)
{
    if (n->near_count == MAX_NEAR && n->near[MAX_NEAR - 1].distance <= distance) return;
    int i = n->near_count < MAX_NEAR ? n->near_count++ : MAX_NEAR - 1;
    for (; i > 0 && n->near[i - 1].distance > distance; i--) n->near[i] = n->near[i - 1];
    n->near[i] = (near_mark){mark, {x, y}, distance};
}

typedef struct sorted {
    double x;
    int mark;
} sorted;

static int by_x(const void *a, const void *b)
{
    const sorted *s = a, *t = b;
    if (s->x != t->x) return s->x < t->x ? -1 : 1;
    return s->mark - t->mark;
}

/* Fills the nodes with their neighbours up to `reach` of their radii away. */
static bool find_neighbours(graph *g, double reach)
{
    sorted *s = malloc((size_t)g->count * sizeof *s);
    if (!s) return false;
    double largest = 0;
    for (int i = 0; i < g->count; i++) {
        init_node(&g->node[i], &g->mark[i]);
        largest = fmax(largest, g->node[i].axes[1]);
        s[i] = (sorted){g->mark[i].centre[0], i};
    }
    qsort(s, (size_t)g->count, sizeof *s, by_x);
    for (int i = 0; i < g->count; i++) {
        const int a = s[i].mark;
        node *na = &g->node[a];
        for (int j = i + 1; j < g->count && s[j].x - s[i].x < reach * largest; j++) {
            const int b = s[j].mark;
            node *nb = &g->node[b];
            double dx = s[j].x - s[i].x, dy = g->mark[b].centre[1] - g->mark[a].centre[1];
            double major = fmax(na->axes[1], nb->axes[1]);
            if (dx * dx + dy * dy > reach * reach * major * major) continue;
            double xx = 0.5 * (na->frame[0] + nb->frame[0]), xy = 0.5 * (na->frame[1] + nb->frame[1]);
            double yy = 0.5 * (na->frame[2] + nb->frame[2]), u = xx * dx + xy * dy, v = xy * dx + yy * dy;
            double distance = hypot(u, v);
            if (distance > reach || !alike(na, &g->mark[b], fmin(na->axes[0], nb->axes[0]))) continue;
            na->nearest = fmin(na->nearest, distance);
            nb->nearest = fmin(nb->nearest, distance);
            add_near(na, b, u, v, distance);
            add_near(nb, a, -u, -v, distance);
        }
    }
    free(s);
    return true;
}

/* Median distance to the nearest mark of about the same size. */
static double typical_pitch(const graph *g)
{
    int n = 0;
    for (int i = 0; i < g->count; i++)
        if (isfinite(g->node[i].nearest)) g->pair[n++] = g->node[i].nearest;
    return n ? td_marks_median(g->pair, (size_t)n) : 0;
}

/* u turned back by k right angles. */
static void turn_back(double out[2], const double u[2], int k)
{
    const double x = u[0], y = u[1];
    out[0] = k == 0 ? x : k == 1 ? y : k == 2 ? -x : -y;
    out[1] = k == 0 ? y : k == 1 ? -x : k == 2 ? -y : x;
}

/* The right angle nearest to the direction of u seen from `angle`. */
static int quarter(const double u[2], double angle)
{
    return (int)lround((atan2(u[1], u[0]) - angle) / (PI / 2)) & 3;
}

/* The direction in which most neighbours lie, modulo a right angle. */
static seed seed_at(const graph *g, int mark)
{
    const node *n = &g->node[mark];
    seed best = {mark, 0, 0};
    for (int i = 0; i < n->near_count; i++) {
        if (n->near[i].distance < LEAST_STEP * g->pitch || n->near[i].distance > MOST_STEP * g->pitch)
            continue;
        double angle = atan2(n->near[i].u[1], n->near[i].u[0]), sum[2] = {0};
        int seen = 0;
        for (int j = 0; j < n->near_count; j++) {
            if (n->near[j].distance < LEAST_STEP * g->pitch || n->near[j].distance > MOST_STEP * g->pitch)
                continue;
            int k = quarter(n->near[j].u, angle);
            double u[2], a[2] = {cos(angle), sin(angle)};
            turn_back(u, n->near[j].u, k);
            if (u[0] * a[0] + u[1] * a[1] < cos(PI / 9) * n->near[j].distance) continue;
            sum[0] += u[0];
            sum[1] += u[1];
            seen |= 1 << k;
        }
        int neighbours = (seen & 1) + (seen >> 1 & 1) + (seen >> 2 & 1) + (seen >> 3 & 1);
        if (neighbours > best.neighbours) best = (seed){mark, neighbours, atan2(sum[1], sum[0])};
    }
    return best;
}

static int by_neighbours(const void *a, const void *b)
{
    const seed *s = a, *t = b;
    if (s->neighbours != t->neighbours) return t->neighbours - s->neighbours;
    return s->mark - t->mark;
}

/* ---- Growth. ---- */

static const int STEP[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};

static int *place(const graph *g, int column, int row)
{
    return &g->owner[(row + REACH) * SIDE + column + REACH];
}

static bool settle(graph *g, int mark, int column, int row)
{
    if (abs(column) > REACH || abs(row) > REACH || *place(g, column, row) >= 0) return false;
    *place(g, column, row) = mark;
    g->node[mark].state = GROWING;
    g->node[mark].at[0] = column;
    g->node[mark].at[1] = row;
    g->queue[g->queued++] = mark;
    return true;
}

/* Direction of the columns seen from a mark, by its neighbours on the lattice; `angle` when there are none.
 */
static double direction(const graph *g, int mark, double angle)
{
    const node *n = &g->node[mark];
    double sum[2] = {0};
    for (int i = 0; i < n->near_count; i++) {
        const node *m = &g->node[n->near[i].mark];
        if (m->state != GROWING) continue;
        for (int k = 0; k < 4; k++) {
            if (m->at[0] - n->at[0] != STEP[k][0] || m->at[1] - n->at[1] != STEP[k][1]) continue;
            double u[2];
            turn_back(u, n->near[i].u, k);
            sum[0] += u[0];
            sum[1] += u[1];
        }
    }
    return sum[0] != 0 || sum[1] != 0 ? atan2(sum[1], sum[0]) : angle;
}

/* Takes in the neighbours of the marks in the queue, and theirs. */
static void grow(graph *g, double angle)
{
    for (int head = 0; head < g->queued; head++) {
        const int mark = g->queue[head];
        const node *n = &g->node[mark];
        double a = direction(g, mark, angle);
        for (int k = 0; k < 4; k++) {
            double want[2] = {g->pitch * cos(a + k * PI / 2), g->pitch * sin(a + k * PI / 2)};
            int best = -1;
            double least = TOLERANCE * g->pitch;
            for (int i = 0; i < n->near_count; i++) {
                double off = hypot(n->near[i].u[0] - want[0], n->near[i].u[1] - want[1]);
                if (off >= least || g->node[n->near[i].mark].state != FREE) continue;
                least = off;
                best = n->near[i].mark;
            }
            if (best >= 0) settle(g, best, n->at[0] + STEP[k][0], n->at[1] + STEP[k][1]);
        }
    }
}

/* ---- From growth to lattices. ---- */

/* Keeps the lattices sorted, the largest first. Owns `l.mark` from here on. */
static bool insert(td_lattices *lattices, td_lattice l)
{
    td_lattice *more = realloc(lattices->lattice, (lattices->count + 1) * sizeof *more);
    if (!more) {
        free(l.mark);
        return false;
    }
    lattices->lattice = more;
    size_t i = lattices->count++;
    for (; i > 0 && more[i - 1].count < l.count; i--) more[i] = more[i - 1];
    more[i] = l;
    return true;
}

static bool keep_grown(td_lattices *lattices, const graph *g)
{
    int low[2] = {REACH, REACH}, high[2] = {-REACH, -REACH};
    for (int i = 0; i < g->queued; i++) {
        for (int k = 0; k < 2; k++) {
            int at = g->node[g->queue[i]].at[k];
            if (at < low[k]) low[k] = at;
            if (at > high[k]) high[k] = at;
        }
    }
    td_lattice l = {high[0] - low[0] + 1, high[1] - low[1] + 1, (size_t)g->queued, NULL};
    size_t cells = (size_t)l.columns * l.rows;
    if (!(l.mark = malloc(cells * sizeof *l.mark))) return false;
    for (size_t i = 0; i < cells; i++) l.mark[i] = -1;
    for (int i = 0; i < g->queued; i++) {
        const node *n = &g->node[g->queue[i]];
        l.mark[(size_t)(n->at[1] - low[1]) * l.columns + n->at[0] - low[0]] = g->queue[i];
    }
    return insert(lattices, l);
}

static bool grow_all(td_lattices *lattices, graph *g)
{
    for (int i = 0; i < g->count; i++) g->seed[i] = seed_at(g, i);
    qsort(g->seed, (size_t)g->count, sizeof *g->seed, by_neighbours);
    for (int i = 0; i < g->count && g->seed[i].neighbours > 1; i++) {
        if (g->node[g->seed[i].mark].state != FREE) continue;
        g->queued = 0;
        settle(g, g->seed[i].mark, 0, 0);
        grow(g, g->seed[i].angle);
        bool kept = g->queued >= LEAST_MARKS;
        if (kept && !keep_grown(lattices, g)) return false;
        for (int k = 0; k < g->queued; k++) {
            node *n = &g->node[g->queue[k]];
            *place(g, n->at[0], n->at[1]) = -1;
            n->state = kept ? TAKEN : FREE;
        }
    }
    return true;
}

/* ---- Over gaps: a hidden row cuts a lattice in two. ---- */

/* Has the mark the shape that the homography gives a mark there? One lattice unit is `pitch` radii. */
static bool is_expected(const graph *g, int mark, const double h[9], double column, double row)
{
    double j[4], r2 = 1 / (g->pitch * g->pitch);
    td_homography_jacobian(j, h, column, row);
    double xx = r2 * (j[0] * j[0] + j[1] * j[1]), xy = r2 * (j[0] * j[2] + j[1] * j[3]);
    double yy = r2 * (j[2] * j[2] + j[3] * j[3]), det = xx * yy - xy * xy;
    const td_mark there = {.shape = {yy / det, -xy / det, xx / det}};
    node n;
    init_node(&n, &there);
    return alike(&n, &g->mark[mark], g->node[mark].axes[0]);
}

/* Places of n marks on the lattice by its homography, into their nodes; false unless all lie on free places
 * not far outside and have the right shape. */
static bool places_on(graph *g, const td_lattice *l, const double h[9], const double inverse[9],
                      const int *mark, int n)
{
    for (int i = 0; i < n; i++) {
        double at[2];
        td_homography_map(at, inverse, g->mark[mark[i]].centre[0], g->mark[mark[i]].centre[1]);
        double column = round(at[0]), row = round(at[1]);
        if (!(column > -GAP && row > -GAP && column < l->columns + GAP && row < l->rows + GAP)) return false;
        if (hypot(at[0] - column, at[1] - row) > JOIN_TOLERANCE || !is_expected(g, mark[i], h, column, row))
            return false;
        int c = (int)column, r = (int)row;
        if (c >= 0 && r >= 0 && c < l->columns && r < l->rows && l->mark[(size_t)r * l->columns + c] >= 0)
            return false;
        for (int k = 0; k < i; k++)
            if (g->node[mark[k]].at[0] == c && g->node[mark[k]].at[1] == r) return false;
        g->node[mark[i]].at[0] = c;
        g->node[mark[i]].at[1] = r;
    }
    return true;
}

/* The lattice with n marks more, at the places in their nodes. */
static bool extend(td_lattice *l, const graph *g, const int *mark, int n)
{
    int low[2] = {0, 0}, high[2] = {l->columns - 1, l->rows - 1};
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < 2; k++) {
            int at = g->node[mark[i]].at[k];
            if (at < low[k]) low[k] = at;
            if (at > high[k]) high[k] = at;
        }
    }
    td_lattice m = {high[0] - low[0] + 1, high[1] - low[1] + 1, l->count + (size_t)n, NULL};
    size_t cells = (size_t)m.columns * m.rows;
    if (!(m.mark = malloc(cells * sizeof *m.mark))) return false;
    for (size_t i = 0; i < cells; i++) m.mark[i] = -1;
    for (int r = 0; r < l->rows; r++)
        for (int c = 0; c < l->columns; c++)
            m.mark[(size_t)(r - low[1]) * m.columns + c - low[0]] = l->mark[(size_t)r * l->columns + c];
    for (int i = 0; i < n; i++)
        m.mark[(size_t)(g->node[mark[i]].at[1] - low[1]) * m.columns + g->node[mark[i]].at[0] - low[0]] =
            mark[i];
    free(l->mark);
    *l = m;
    return true;
}

/* One lattice takes in others, and single marks, that lie on its own continuation. */
static bool join(td_lattices *all, size_t index, graph *g)
{
    td_lattice *l = &all->lattice[index];
    double h[9], inverse[9];
    if (l->count < 2 * LEAST_MARKS || !td_lattice_homography(h, l, g->mark) ||
        !td_homography_invert(inverse, h))
        return true;
    for (size_t i = index + 1; i < all->count; i++) {
        td_lattice *other = &all->lattice[i];
        int n = 0;
        for (int k = 0; k < other->columns * other->rows; k++)
            if (other->mark[k] >= 0) g->queue[n++] = other->mark[k];
        if (!places_on(g, l, h, inverse, g->queue, n)) continue;
        bool ok = extend(l, g, g->queue, n);
        free(other->mark);
        all->count--;
        for (size_t k = i; k < all->count; k++) all->lattice[k] = all->lattice[k + 1];
        return ok && join(all, index, g);
    }
    for (int m = 0; m < g->count; m++) {
        if (g->node[m].state != FREE || !places_on(g, l, h, inverse, &m, 1)) continue;
        g->node[m].state = TAKEN;
        return extend(l, g, &m, 1) && join(all, index, g);
    }
    return true;
}

static void free_graph(graph *g)
{
    free(g->node);
    free(g->seed);
    free(g->queue);
    free(g->owner);
    free(g->pair);
}

td_status td_marks_lattices(td_lattices *lattices, const td_mark *mark, size_t count, double pitch,
                            td_error *error)
{
    *lattices = (td_lattices){0};
    if (count < LEAST_MARKS) return TD_OK;
    graph g = {.mark = mark, .count = (int)count, .pitch = pitch};
    g.node = malloc(count * sizeof *g.node);
    g.seed = malloc(count * sizeof *g.seed);
    g.queue = malloc(count * sizeof *g.queue);
    g.owner = malloc((size_t)SIDE * SIDE * sizeof *g.owner);
    g.pair = malloc(4 * count * sizeof *g.pair);
    bool ok = g.node && g.seed && g.queue && g.owner && g.pair;
    for (int i = 0; ok && i < SIDE * SIDE; i++) g.owner[i] = -1;
    /* Marks farther apart than 12 radii are no neighbours in any sensible target. */
    ok = ok && find_neighbours(&g, pitch > 0 ? MOST_STEP * pitch : 12);
    if (ok && !(pitch > 0)) g.pitch = typical_pitch(&g);
    ok = ok && (!(g.pitch > 0) || grow_all(lattices, &g));
    for (size_t i = 0; ok && i < lattices->count; i++) ok = join(lattices, i, &g);
    free_graph(&g);
    if (ok) return TD_OK;
    td_lattices_free(lattices);
    return td_fail(error, TD_ERROR_MEMORY, "no memory to look for a grid among %zu marks", count);
}
