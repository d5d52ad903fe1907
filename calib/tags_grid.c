#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/homography.h"
#include "calib/tags_internal.h"

enum { MOST_NEAR = 6, NEAR_REACH = 3, LEAST_MEASURED = 3, MOST_COLUMNS = 40, ENOUGH_TAGS = 3 };

/* Of the spacing: how far corners lie off the homography of the right and of a wrong layout. A strong lens
 * bends a board by a tenth; the next tag is a whole spacing away. */
static const double RIGHT_LAYOUT = 0.12, WRONG_LAYOUT = 0.25, STRAY = 0.5;

int td_tag_grid_place(const td_target *target, int id)
{
    const int columns = target->plane[0].columns, rows = target->plane[0].rows, k = id - target->first_id;
    if (k < 0 || k >= columns * rows) return -1;
    return target->order == TD_TAGS_DOWNWARD ? k : (rows - 1 - k / columns) * columns + k % columns;
}

static void apply(double out[2], const double h[9], const double xy[2])
{
    double w = h[6] * xy[0] + h[7] * xy[1] + h[8];
    out[0] = (h[0] * xy[0] + h[1] * xy[1] + h[2]) / w;
    out[1] = (h[3] * xy[0] + h[4] * xy[1] + h[5]) / w;
}

/* The corners of the tag in column x of row y, in spacings. */
static void layout_corners(double xy[8], const td_target *target, int x, int y)
{
    const double size = target->tag_size_m / target->plane[0].spacing_m;
    const double corner[8] = {x, y, x + size, y, x + size, y + size, x, y + size};
    memcpy(xy, corner, sizeof corner);
}

/* Largest distance of a tag's measured corners from where the homography has them, in spacings at that place.
 */
static double misfit(const double h[9], const double xy[8], const td_tag *tag)
{
    double worst = 0, at[4][2], next[2];
    for (int k = 0; k < 4; k++) {
        apply(at[k], h, xy + 2 * k);
        if (!(tag->sigma[k] > 0)) continue;
        worst = fmax(worst, hypot(at[k][0] - tag->corner[2 * k], at[k][1] - tag->corner[2 * k + 1]));
    }
    const double aside[2] = {xy[0] + 1, xy[1]};
    apply(next, h, aside);
    double result = worst / hypot(next[0] - at[0][0], next[1] - at[0][1]);
    return isfinite(result) ? result : INFINITY;
}

/* ---- growing ---- */

/* Homography from the plane (spacings) by the measured corners of the tags nearest to a place, its own tag
 * among them if `own`; false when there are none near. */
static bool near_homography(double h[9], const tag_grid *g, int place, bool own)
{
    const int columns = g->target->plane[0].columns, column = place % columns, row = place / columns;
    double plane[8 * MOST_NEAR], image[8 * MOST_NEAR], xy[8];
    size_t n = 0;
    int tags = 0;
    for (int reach = own ? 0 : 1; reach <= NEAR_REACH && tags < MOST_NEAR; reach++)
        for (int k = 0; k < g->tags && tags < MOST_NEAR; k++) {
            int away = abs(k % columns - column), down = abs(k / columns - row);
            if (!g->seen[k] || (away > down ? away : down) != reach) continue;
            layout_corners(xy, g->target, k % columns, k / columns);
            for (int c = 0; c < 4; c++) {
                if (!(g->tag[k].sigma[c] > 0)) continue;
                memcpy(plane + 2 * n, xy + 2 * c, 2 * sizeof *plane);
                memcpy(image + 2 * n++, g->tag[k].corner + 2 * c, 2 * sizeof *image);
            }
            tags++;
        }
    return n >= 4 && td_homography(h, plane, image, n, NULL) == TD_OK;
}

static int measured_corners(const td_tag *tag)
{
    int n = 0;
    for (int k = 0; k < 4; k++) n += tag->sigma[k] > 0;
    return n;
}

static bool try_place(tag_grid *g, int place)
{
    double h[9], xy[8], inflation[2] = {0};
    tag_levels levels;
    const int columns = g->target->plane[0].columns;
    if (!near_homography(h, g, place, false)) return false;
    td_tag tag = {.id = td_target_tag_id(g->target, 4 * (size_t)place), .border = g->target->border};
    layout_corners(xy, g->target, place % columns, place / columns);
    for (int k = 0; k < 4; k++) apply(tag.corner + 2 * k, h, xy + 2 * k);
    td_tag_measure(&tag, inflation, g->image, g->codes, g->outside);
    if (measured_corners(&tag) < LEAST_MEASURED || !td_tag_read(&levels, g->image, &tag, g->codes) ||
        !td_tag_is_read(&levels, &tag, g->codes))
        return false;
    tag.wrong_bits = levels.wrong;
    g->tag[place] = tag;
    for (int i = 0; i < 2; i++) g->inflation[i] += inflation[i];
    return true;
}

void td_tag_grid_grow(tag_grid *g)
{
    for (bool more = true; more;) {
        more = false;
        for (int k = 0; k < g->tags; k++)
            if (!g->seen[k] && try_place(g, k)) g->seen[k] = more = true;
    }
}

void td_tag_grid_mend(tag_grid *g)
{
    const int columns = g->target->plane[0].columns;
    for (int k = 0; k < g->tags; k++) {
        double h[9], xy[8], inflation[2] = {0};
        if (!g->seen[k] || measured_corners(&g->tag[k]) == 4 || !near_homography(h, g, k, true)) continue;
        td_tag tag = g->tag[k];
        layout_corners(xy, g->target, k % columns, k / columns);
        for (int c = 0; c < 4; c++)
            if (!(tag.sigma[c] > 0)) apply(tag.corner + 2 * c, h, xy + 2 * c);
        td_tag_measure(&tag, inflation, g->image, g->codes, g->outside);
        if (measured_corners(&tag) > measured_corners(&g->tag[k])) g->tag[k] = tag;
    }
}

/* ---- strays ---- */

int td_tag_grid_drop(tag_grid *g)
{
    const int columns = g->target->plane[0].columns;
    int dropped = 0;
    for (;;) {
        int worst = -1;
        double most = STRAY, h[9], xy[8];
        for (int k = 0; k < g->tags; k++) {
            if (!g->seen[k]) continue;
            bool others;
            g->seen[k] = false; /* judged by the others */
            others = near_homography(h, g, k, false);
            g->seen[k] = true;
            layout_corners(xy, g->target, k % columns, k / columns);
            double off = others ? misfit(h, xy, &g->tag[k]) : 0;
            if (off > most) {
                most = off;
                worst = k;
            }
        }
        if (worst < 0) return dropped;
        g->seen[worst] = false;
        dropped++;
    }
}

/* ---- layouts ---- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median misfit of the tags when they stand in `columns` columns; `work` has room for 17 numbers a tag. */
static double layout_misfit(const td_target *target, const tag_list *list, int columns, td_tag_order order,
                            double *work)
{
    double *plane = work, *image = work + 8 * list->count, *off = image + 8 * list->count, h[9];
    for (size_t i = 0; i < list->count; i++) {
        int k = list->tag[i].id - target->first_id, y = k / columns;
        layout_corners(plane + 8 * i, target, k % columns, order == TD_TAGS_DOWNWARD ? y : -y);
        memcpy(image + 8 * i, list->tag[i].corner, 8 * sizeof *image);
    }
    if (td_homography(h, plane, image, 4 * list->count, NULL) != TD_OK) return INFINITY;
    for (size_t i = 0; i < list->count; i++) off[i] = misfit(h, plane + 8 * i, &list->tag[i]);
    qsort(off, list->count, sizeof *off, compare_doubles);
    return off[list->count / 2];
}

bool td_tag_grid_is_other(char *why, size_t size, const tag_grid *g, const tag_list *list)
{
    const td_target *t = g->target;
    const int columns = t->plane[0].columns, rows = t->plane[0].rows;
    double *work = malloc(17 * list->count * sizeof *work), best = RIGHT_LAYOUT;
    int best_columns = 0;
    td_tag_order order = t->order;
    if (list->count < ENOUGH_TAGS || !work ||
        layout_misfit(t, list, columns, t->order, work) < WRONG_LAYOUT) {
        free(work);
        return false;
    }
    for (int c = 1; c <= MOST_COLUMNS; c++)
        for (int o = TD_TAGS_UPWARD; o <= TD_TAGS_DOWNWARD; o++) {
            double off = layout_misfit(t, list, c, (td_tag_order)o, work);
            if (!(off < best)) continue;
            best = off;
            best_columns = c;
            order = (td_tag_order)o;
        }
    free(work);
    if (!best_columns) return false;
    const char *numbered = order == t->order ? ""
                           : order == TD_TAGS_DOWNWARD
                               ? "; they are numbered from the uppermost row, set order: downward"
                               : "; they are numbered from the lowest row, set order: upward";
    if (best_columns == columns)
        snprintf(why, size, "the tags are numbered in the other direction%s", numbered);
    else if (columns * rows % best_columns)
        snprintf(why, size, "the tags lie as on a grid of %d columns, not %d: set columns: %d%s",
                 best_columns, columns, best_columns, numbered);
    else
        snprintf(why, size, "the tags lie as on a grid of %dx%d, not %dx%d: set columns: %d and rows: %d%s",
                 best_columns, columns * rows / best_columns, columns, rows, best_columns,
                 columns * rows / best_columns, numbered);
    return true;
}
