/* Which mark is which: the lattices that were found against the planes of the target.
 *
 * A plane is a window of columns x rows laid on a lattice. It is accepted where it holds most of its marks,
 * where no other place would hold nearly as many (so a hidden outer row is not guessed), and where no further
 * row of marks shows that the grid is larger than the target says. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks_internal.h"

/* By how many marks a place must beat all others; less when it is the whole of what was seen. */
enum { MARGIN = 2, MARGIN_EXACT = 1 };

size_t td_marks_needed(const td_target_plane *plane)
{
    size_t total = (size_t)plane->columns * (size_t)plane->rows, share = (3 * total + 4) / 5;
    return share > 8 ? share : total < 8 ? total : 8;
}

/* A place of a grid on a lattice: the window's first cell and its size there. */
typedef struct window {
    int column, row, columns, rows;
    size_t covered, next; /* marks within; within the best other window */
} window;

static size_t marks_within(const td_lattice *l, const window *w)
{
    size_t n = 0;
    for (int r = w->row; r < w->row + w->rows; r++)
        for (int c = w->column; c < w->column + w->columns; c++)
            n +=
                r >= 0 && c >= 0 && r < l->rows && c < l->columns && l->mark[(size_t)r * l->columns + c] >= 0;
    return n;
}

/* Tries all places of a window of this size. */
static void try_windows(window *best, const td_lattice *l, int columns, int rows)
{
    for (int row = 1 - rows; row < l->rows; row++) {
        for (int column = 1 - columns; column < l->columns; column++) {
            window w = {column, row, columns, rows, 0, 0};
            w.covered = marks_within(l, &w);
            if (w.covered > best->covered) {
                w.next = best->covered;
                *best = w;
            } else if (w.covered > best->next) {
                best->next = w.covered;
            }
        }
    }
}

/* Two marks and more on one line outside the window, a third of its length: a larger grid. */
static bool is_larger(const td_lattice *l, const window *w)
{
    for (int r = 0; r < l->rows; r++) {
        window line = {w->column, r, w->columns, 1, 0, 0};
        bool within = r >= w->row && r < w->row + w->rows;
        size_t n = within ? 0 : marks_within(l, &line);
        if (n >= 2 && 3 * n >= (size_t)w->columns) return true;
    }
    for (int c = 0; c < l->columns; c++) {
        window line = {c, w->row, 1, w->rows, 0, 0};
        bool within = c >= w->column && c < w->column + w->columns;
        size_t n = within ? 0 : marks_within(l, &line);
        if (n >= 2 && 3 * n >= (size_t)w->rows) return true;
    }
    return false;
}

static bool fits(window *w, const td_lattice *l, const td_target_plane *plane)
{
    *w = (window){0};
    try_windows(w, l, plane->columns, plane->rows);
    if (plane->columns != plane->rows) try_windows(w, l, plane->rows, plane->columns);
    bool exact = w->columns == l->columns && w->rows == l->rows;
    size_t margin = exact ? MARGIN_EXACT : MARGIN;
    return w->covered >= td_marks_needed(plane) && w->covered >= w->next + margin && !is_larger(l, w);
}

/* Lattice cell of the plane's point (column, row) after `turn` quarter turns. */
static void cell_of(int cell[2], const window *w, int turn, int column, int row)
{
    const int c[4] = {column, w->columns - 1 - row, w->columns - 1 - column, row};
    const int r[4] = {row, column, w->rows - 1 - row, w->rows - 1 - column};
    cell[0] = w->column + c[turn];
    cell[1] = w->row + r[turn];
}

static int mark_at(const td_lattice *l, const int cell[2])
{
    bool on = cell[0] >= 0 && cell[1] >= 0 && cell[0] < l->columns && cell[1] < l->rows;
    return on ? l->mark[(size_t)cell[1] * l->columns + cell[0]] : -1;
}

/* Turns that are possible: half turns for a rectangle, the other two when the window lies across. */
static bool turn_fits(const window *w, const td_target_plane *plane, int turn)
{
    return turn % 2 ? w->columns == plane->rows && w->rows == plane->columns
                    : w->columns == plane->columns && w->rows == plane->rows;
}

/* How well the columns run to the right and the rows down, 2 at best. */
static double upright(const td_lattice *l, const window *w, const td_mark *mark, int turn)
{
    double h[9], centre[2], along[2], down[2];
    if (!td_lattice_homography(h, l, mark)) return -2;
    double c = w->column + 0.5 * (w->columns - 1), r = w->row + 0.5 * (w->rows - 1);
    const double step[4][2] = {{0.5, 0}, {0, 0.5}, {-0.5, 0}, {0, -0.5}};
    const double *s = step[turn], *t = step[(turn + 1) % 4];
    td_homography_map(centre, h, c, r);
    td_homography_map(along, h, c + s[0], r + s[1]);
    td_homography_map(down, h, c + t[0], r + t[1]);
    double x = along[0] - centre[0], y = down[1] - centre[1];
    return x / hypot(x, along[1] - centre[1]) + y / hypot(down[0] - centre[0], y);
}

/* Do the clicks on this plane agree with the turn? */
static bool agrees(const td_numbering *n, int plane, size_t first, const td_lattice *l, const window *w,
                   int turn, const td_click *click, size_t clicks)
{
    const td_target_plane *p = &n->target->plane[plane];
    size_t count = (size_t)p->columns * (size_t)p->rows;
    for (size_t i = 0; i < clicks; i++) {
        if (click[i].index < first || click[i].index >= first + count) continue;
        int cell[2], index = (int)(click[i].index - first);
        double away;
        cell_of(cell, w, turn, index % p->columns, index / p->columns);
        if (mark_at(l, cell) < 0 || mark_at(l, cell) != td_marks_clicked(&away, n, &click[i])) return false;
    }
    return true;
}

/* ---- Planes that touch along an edge may grow together into one lattice. ---- */

/* Mean squared distance of the marks from the lattice's homography, px^2. */
static double bend(const td_lattice *l, const td_mark *mark)
{
    double h[9], sum = 0;
    if (!td_lattice_homography(h, l, mark)) return INFINITY;
    for (int r = 0, i = 0; r < l->rows; r++) {
        for (int c = 0; c < l->columns; c++, i++) {
            if (l->mark[i] < 0) continue;
            double p[2];
            const double *seen = mark[l->mark[i]].centre;
            td_homography_map(p, h, c, r);
            sum += (p[0] - seen[0]) * (p[0] - seen[0]) + (p[1] - seen[1]) * (p[1] - seen[1]);
        }
    }
    return sum / (double)l->count;
}

/* The part before (first) or behind a cut across the columns (along_x) or rows. */
static bool cut_part(td_lattice *part, const td_lattice *l, bool along_x, int cut, bool first)
{
    size_t cells = (size_t)l->columns * l->rows;
    *part = (td_lattice){l->columns, l->rows, 0, malloc(cells * sizeof *part->mark)};
    if (!part->mark) return false;
    for (int r = 0, i = 0; r < l->rows; r++)
        for (int c = 0; c < l->columns; c++, i++)
            part->mark[i] = ((along_x ? c : r) < cut) == first ? l->mark[i] : -1;
    td_lattice_trim(part);
    return true;
}

static bool fits_any(const td_lattice *l, const td_numbering *n)
{
    window w;
    for (int i = 0; i < n->target->plane_count; i++)
        if (fits(&w, l, &n->target->plane[i])) return true;
    return false;
}

/* Cuts a lattice that is no plane where the parts are planes, or one of them is, and bend least. `part` (2).
 */
static bool best_cut(td_lattice part[2], bool *found, const td_lattice *l, const td_numbering *n)
{
    double least = INFINITY;
    *found = false;
    for (int along_x = 0; along_x < 2; along_x++) {
        for (int cut = 2; cut < (along_x ? l->columns : l->rows) - 1; cut++) {
            td_lattice p[2] = {{0}};
            bool ok = cut_part(&p[0], l, along_x, cut, true) && cut_part(&p[1], l, along_x, cut, false);
            int fitting = ok ? fits_any(&p[0], n) + fits_any(&p[1], n) : 0;
            double b = fitting ? (bend(&p[0], n->mark) + bend(&p[1], n->mark)) / fitting : INFINITY;
            if (ok && b < least) {
                least = b;
                for (int k = 0; k < 2; k++) {
                    td_lattice other = part[k];
                    part[k] = p[k];
                    p[k] = other;
                }
                *found = true;
            }
            free(p[0].mark);
            free(p[1].mark);
            if (!ok) return false;
        }
    }
    return true;
}

static bool cut_lattices(td_lattices *all, const td_numbering *n)
{
    for (size_t i = 0; i < all->count; i++) {
        td_lattice part[2] = {{0}};
        bool found = false, ok = true;
        while (ok && !fits_any(&all->lattice[i], n)) {
            ok = best_cut(part, &found, &all->lattice[i], n);
            if (!ok || !found) break;
            td_lattice *more = realloc(all->lattice, (all->count + 1) * sizeof *more);
            if ((ok = more != NULL)) {
                all->lattice = more;
                free(more[i].mark);
                more[i] = part[0];
                more[all->count++] = part[1];
                part[0].mark = part[1].mark = NULL;
            }
        }
        free(part[0].mark);
        free(part[1].mark);
        if (!ok) return false;
    }
    return true;
}

/* ---- Planes and lattices. ---- */

/* A lattice on which the plane fits. */
typedef struct candidate {
    const td_lattice *lattice;
    window w;
    double x; /* mean image column of its marks, px */
    bool taken;
} candidate;

static double mean_x(const td_lattice *l, const td_mark *mark)
{
    double sum = 0;
    for (int i = 0; i < l->columns * l->rows; i++)
        if (l->mark[i] >= 0) sum += mark[l->mark[i]].centre[0];
    return sum / (double)l->count;
}

static int by_mean_x(const void *a, const void *b)
{
    const candidate *s = a, *t = b;
    return (s->x > t->x) - (s->x < t->x);
}

static size_t clicks_on(const td_target *target, int plane, const td_click *click, size_t clicks)
{
    size_t n = 0;
    for (size_t i = 0; i < clicks; i++) n += td_target_plane_of(target, click[i].index, NULL) == plane;
    return n;
}

/* Numbers the plane by the candidate, in the most upright turn that the clicks allow; false when they allow
 * none. */
static bool assign(td_numbering *n, int plane, size_t first, candidate *c, const td_click *click,
                   size_t clicks)
{
    const td_target_plane *p = &n->target->plane[plane];
    int turn = -1;
    double best = -INFINITY;
    for (int t = 0; t < 4; t++) {
        if (!turn_fits(&c->w, p, t) || !agrees(n, plane, first, c->lattice, &c->w, t, click, clicks))
            continue;
        double up = upright(c->lattice, &c->w, n->mark, t);
        if (up <= best) continue;
        best = up;
        turn = t;
    }
    if (turn < 0) return false;
    for (int r = 0; r < p->rows; r++) {
        for (int k = 0; k < p->columns; k++) {
            int cell[2];
            cell_of(cell, &c->w, turn, k, r);
            n->of_point[first + (size_t)r * p->columns + k] = mark_at(c->lattice, cell);
        }
    }
    n->seen[plane] = c->taken = true;
    return true;
}

/* Planes that cannot be told apart by their grids. */
static bool same_grid(const td_target_plane *a, const td_target_plane *b)
{
    bool along = a->columns == b->columns && a->rows == b->rows;
    bool across = a->columns == b->rows && a->rows == b->columns;
    return (along || across) && a->spacing_m == b->spacing_m;
}

static size_t first_point(const td_target *target, int plane)
{
    size_t first = 0;
    for (int i = 0; i < plane; i++) first += (size_t)target->plane[i].columns * (size_t)target->plane[i].rows;
    return first;
}

/* Planes of the same grid: those with clicks by their clicks, the others from left to right. */
static void number_alike(td_numbering *n, const int *plane, int planes, candidate *c, size_t candidates,
                         const td_click *click, size_t clicks)
{
    const td_target_plane *p = &n->target->plane[plane[0]];
    int open = 0;
    size_t left = candidates;
    qsort(c, candidates, sizeof *c, by_mean_x);
    for (int i = 0; i < planes; i++) {
        if (!clicks_on(n->target, plane[i], click, clicks)) {
            open++;
            continue;
        }
        size_t k = 0;
        while (k < candidates &&
               (c[k].taken || !assign(n, plane[i], first_point(n->target, plane[i]), &c[k], click, clicks)))
            k++;
        if (k < candidates)
            left--;
        else if ((n->refused = candidates > 0))
            snprintf(n->note, sizeof n->note,
                     "the clicks on plane %d do not fit the %dx%d grid that was seen", plane[i] + 1,
                     p->columns, p->rows);
    }
    if (!open || !left) return;
    if (left != (size_t)open) {
        snprintf(n->note, sizeof n->note,
                 "%zu grid%s of %dx%d %s seen where %d %s expected: clicks can tell which", left,
                 left > 1 ? "s" : "", p->columns, p->rows, left > 1 ? "are" : "is", open,
                 open > 1 ? "are" : "is");
        return;
    }
    size_t k = 0;
    for (int i = 0; i < planes; i++) {
        if (n->seen[plane[i]] || clicks_on(n->target, plane[i], click, clicks)) continue;
        while (c[k].taken) k++;
        assign(n, plane[i], first_point(n->target, plane[i]), &c[k], NULL, 0);
    }
}

/* The lattices of free marks at a pitch, planes cut apart, and without what does not lie on them. */
static td_status lattices_at(td_lattices *all, const td_numbering *n, double pitch, td_error *error)
{
    TD_TRY(td_marks_lattices(all, n->mark, n->marks, pitch, error));
    size_t points = td_target_point_count(n->target);
    for (size_t i = 0; i < all->count; i++) {
        td_lattice *l = &all->lattice[i];
        for (int k = 0; k < l->columns * l->rows; k++)
            for (size_t j = 0; j < points; j++)
                if (l->mark[k] >= 0 && n->of_point[j] == l->mark[k]) l->mark[k] = -1;
        td_lattice_trim(l);
    }
    td_status status = TD_OK;
    if (n->target->plane_count > 1 && !cut_lattices(all, n))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu grids of marks", all->count);
    for (size_t i = 0; i < all->count && status == TD_OK; i++) {
        status = td_lattice_discard(&all->lattice[i], n->mark, error);
        td_lattice_trim(&all->lattice[i]);
    }
    if (status != TD_OK) td_lattices_free(all);
    return status;
}

/* Remembers the largest grid for the message, its columns as those that run across the image. */
static void remember_largest(td_numbering *n, const td_lattices *all)
{
    double h[9], a[2], b[2];
    const td_lattice *l = all->lattice;
    if (!all->count || l->count <= n->grid_marks || !td_lattice_homography(h, l, n->mark)) return;
    td_homography_map(a, h, 0, 0);
    td_homography_map(b, h, l->columns - 1, 0);
    bool across = fabs(b[0] - a[0]) >= fabs(b[1] - a[1]);
    n->grid_marks = l->count;
    n->grid_columns = across ? l->columns : l->rows;
    n->grid_rows = across ? l->rows : l->columns;
}

/* All planes not seen yet that are like this one, by the lattices at this pitch. */
static td_status number_class(td_numbering *n, int plane, double pitch, const td_click *click, size_t clicks,
                              td_error *error)
{
    int like[TD_TARGET_MAX_PLANES], planes = 0;
    const td_target *t = n->target;
    for (int i = plane; i < t->plane_count; i++)
        if (!n->seen[i] && same_grid(&t->plane[plane], &t->plane[i])) like[planes++] = i;
    td_lattices all;
    TD_TRY(lattices_at(&all, n, pitch, error));
    candidate *c = malloc((all.count + 1) * sizeof *c);
    size_t candidates = 0;
    for (size_t i = 0; c && i < all.count; i++) {
        candidate k = {.lattice = &all.lattice[i]};
        if (!k.lattice->count || !fits(&k.w, k.lattice, &t->plane[plane])) continue;
        k.x = mean_x(k.lattice, n->mark);
        c[candidates++] = k;
    }
    if (c) number_alike(n, like, planes, c, candidates, click, clicks);
    remember_largest(n, &all);
    td_lattices_free(&all);
    free(c);
    return c ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory to number marks");
}

td_status td_marks_number(td_numbering *n, const td_click *click, size_t clicks, td_error *error)
{
    const td_target *t = n->target;
    /* At the pitch that the target states; then, in case its diameter is wrong, at the pitch that is seen. */
    for (int pass = 0; pass < 2; pass++) {
        bool any = false, done[TD_TARGET_MAX_PLANES] = {false};
        for (int i = 0; i < t->plane_count; i++) {
            double pitch = pass ? 0 : 2 * t->plane[i].spacing_m / t->diameter_m;
            if (!n->seen[i] && !done[i]) {
                TD_TRY(number_class(n, i, pitch, click, clicks, error));
                for (int k = i; k < t->plane_count; k++) done[k] |= same_grid(&t->plane[i], &t->plane[k]);
            }
            any |= n->seen[i];
        }
        if (any) break;
    }
    return TD_OK;
}
