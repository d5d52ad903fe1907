/* Numbering from a person's clicks: the marks clicked on give a first homography from the plane to the image,
 * it predicts all other marks, the marks found there refine it and the local predictions, and so on until no
 * further mark is found. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "calib/homography.h"
#include "calib/marks_internal.h"

enum { MAX_ROUNDS = 50 };

/* Lattice units by which a mark may be off the homography's prediction, and off its neighbours'. */
static const double NEAR_PLANE = 0.3, NEAR_NEIGHBOURS = 0.2, AREA_FACTOR = 0.7;

int td_marks_clicked(double *away, const td_numbering *n, const td_click *click)
{
    int best = -1;
    *away = INFINITY;
    for (size_t i = 0; i < n->marks; i++) {
        double d = hypot(n->mark[i].centre[0] - click->pixel[0], n->mark[i].centre[1] - click->pixel[1]);
        if (d >= *away) continue;
        *away = d;
        best = (int)i;
    }
    if (best < 0) return -1;
    double axes[2];
    td_mark_axes(axes, &n->mark[best]);
    return *away <= 1.5 * axes[1] + 4 ? best : -1;
}

/* A plane's clicks: the marks they are on. */
typedef struct clicked {
    size_t count;
    size_t number[TD_MAX_CLICKS]; /* of the click among all, from 1 */
    int cell[TD_MAX_CLICKS], mark[TD_MAX_CLICKS];
} clicked;

/* False, with a note, when a click is on no mark or two are on one. */
static bool find_clicked(clicked *c, td_numbering *n, int plane, const td_click *click, size_t clicks)
{
    *c = (clicked){0};
    for (size_t i = 0; i < clicks; i++) {
        size_t first, k = c->count;
        double away;
        if (td_target_plane_of(n->target, click[i].index, &first) != plane) continue;
        c->number[k] = i + 1;
        c->cell[k] = (int)(click[i].index - first);
        c->mark[k] = td_marks_clicked(&away, n, &click[i]);
        if (c->mark[k] < 0) {
            snprintf(n->note, sizeof n->note,
                     "click %zu (mark %zu at %.0f, %.0f) is %.0f px away from the nearest mark", i + 1,
                     click[i].index, click[i].pixel[0], click[i].pixel[1], away);
            return false;
        }
        for (size_t j = 0; j < k; j++) {
            if (c->mark[j] != c->mark[k]) continue;
            snprintf(n->note, sizeof n->note, "clicks %zu and %zu are on the same mark at %.0f, %.0f",
                     c->number[j], i + 1, click[i].pixel[0], click[i].pixel[1]);
            return false;
        }
        c->count++;
    }
    return true;
}

static double turn_of(const double a[2], const double b[2], const double c[2])
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* Every three marks that turn from x to y on the plane turn the other way in the image. */
static bool is_mirrored(const clicked *c, const td_numbering *n, int columns)
{
    for (size_t i = 0; i < c->count; i++) {
        for (size_t j = 0; j < i; j++) {
            for (size_t k = 0; k < j; k++) {
                const size_t at[3] = {i, j, k};
                double plane[3][2];
                for (int m = 0; m < 3; m++) {
                    plane[m][0] = c->cell[at[m]] % columns;
                    plane[m][1] = c->cell[at[m]] / columns;
                }
                double image = turn_of(n->mark[c->mark[i]].centre, n->mark[c->mark[j]].centre,
                                       n->mark[c->mark[k]].centre);
                if (turn_of(plane[0], plane[1], plane[2]) * image > 0) return false;
            }
        }
    }
    return true;
}

/* One round: every empty place takes the nearest free mark that is near enough. Returns how many did. */
static size_t fill(td_lattice *l, bool *used, const td_numbering *n, const double lattice_from_image[9])
{
    size_t added = 0;
    for (int r = 0, i = 0; r < l->rows; r++) {
        for (int c = 0; c < l->columns; c++, i++) {
            if (l->mark[i] >= 0) continue;
            double want[3] = {c, r, NAN}, least = NEAR_PLANE;
            if (td_lattice_predict(want, l, n->mark, lattice_from_image, c, r)) least = NEAR_NEIGHBOURS;
            int best = -1;
            for (size_t m = 0; m < n->marks; m++) {
                double at[2];
                if (used[m]) continue;
                td_homography_map(at, lattice_from_image, n->mark[m].centre[0], n->mark[m].centre[1]);
                double off = hypot(at[0] - want[0], at[1] - want[1]);
                double axes[2];
                td_mark_axes(axes, &n->mark[m]);
                if (!(off < least) || fabs(log(axes[0] * axes[1]) - want[2]) > AREA_FACTOR) continue;
                least = off;
                best = (int)m;
            }
            if (best < 0) continue;
            l->mark[i] = best;
            l->count++;
            used[best] = true;
            added++;
        }
    }
    return added;
}

/* The plane's grid from its clicks, without click `skip`. */
static td_status grow_from_clicks(td_lattice *l, const clicked *c, size_t skip, const td_numbering *n,
                                  td_error *error)
{
    bool *used = calloc(n->marks + 1, sizeof *used);
    if (!used) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", n->marks);
    for (int i = 0; i < l->columns * l->rows; i++) l->mark[i] = -1;
    l->count = 0;
    for (size_t i = 0; i < td_target_point_count(n->target); i++)
        if (n->of_point[i] >= 0) used[n->of_point[i]] = true;
    for (size_t i = 0; i < c->count; i++) {
        if (i == skip) continue;
        l->mark[c->cell[i]] = c->mark[i];
        l->count++;
        used[c->mark[i]] = true;
    }
    for (int round = 0; round < MAX_ROUNDS; round++) {
        double h[9], inverse[9];
        if (!td_lattice_homography(h, l, n->mark) || !td_homography_invert(inverse, h)) break;
        if (!fill(l, used, n, inverse)) break;
    }
    free(used);
    return td_lattice_discard(l, n->mark, error);
}

/* Are all clicks but `skip` on the marks that the grid has at their places? */
static bool keeps(const td_lattice *l, const clicked *c, size_t skip)
{
    for (size_t i = 0; i < c->count; i++)
        if (i != skip && l->mark[c->cell[i]] != c->mark[i]) return false;
    return true;
}

/* The number of the click without which the others agree, and agree best; 0 when there is none. */
static td_status culprit(size_t *number, td_lattice *l, const clicked *c, const td_numbering *n,
                         size_t needed, td_error *error)
{
    size_t most = 0;
    *number = 0;
    for (size_t i = 0; i < c->count && c->count > 4; i++) {
        TD_TRY(grow_from_clicks(l, c, i, n, error));
        if (l->count < needed || l->count < most || !keeps(l, c, i)) continue;
        *number = l->count > most ? c->number[i] : 0; /* of two equal ones neither is known to be wrong */
        most = l->count;
    }
    return TD_OK;
}

static td_status number_plane(td_numbering *n, td_lattice *l, int plane, size_t first, const clicked *c,
                              td_error *error)
{
    const td_target_plane *p = &n->target->plane[plane];
    const size_t needed = td_marks_needed(p), cells = (size_t)p->columns * (size_t)p->rows;
    const bool mirrored = is_mirrored(c, n, p->columns);
    TD_TRY(grow_from_clicks(l, c, SIZE_MAX, n, error));
    if (keeps(l, c, SIZE_MAX) && !mirrored && l->count >= needed) {
        for (size_t i = 0; i < cells; i++) n->of_point[first + i] = l->mark[i];
        n->seen[plane] = true;
        return TD_OK;
    }
    n->refused = true;
    size_t count = l->count, alone;
    TD_TRY(culprit(&alone, l, c, n, needed, error));
    if (mirrored)
        snprintf(n->note, sizeof n->note,
                 "the clicks number the marks as in a mirror: columns and rows are exchanged");
    else if (alone)
        snprintf(n->note, sizeof n->note, "click %zu contradicts the others", alone);
    else
        snprintf(n->note, sizeof n->note,
                 "with these clicks only %zu of %zu marks are where they should be: are their numbers right?",
                 count, cells);
    return TD_OK;
}

td_status td_marks_number_clicked(td_numbering *n, const td_click *click, size_t clicks, td_error *error)
{
    size_t first = 0;
    for (int i = 0; i < n->target->plane_count && !n->note[0]; i++) {
        const td_target_plane *p = &n->target->plane[i];
        const size_t cells = (size_t)p->columns * (size_t)p->rows;
        clicked c;
        n->refused = !find_clicked(&c, n, i, click, clicks);
        if (n->refused) return TD_OK;
        if (c.count >= 4) {
            td_lattice l = {p->columns, p->rows, 0, malloc(cells * sizeof *l.mark)};
            if (!l.mark) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", cells);
            td_status status = number_plane(n, &l, i, first, &c, error);
            free(l.mark);
            TD_TRY(status);
        }
        first += cells;
    }
    return TD_OK;
}
