/* A second look at the places of a numbered plane where no mark was found. Dirt or a shadow that touches a
 * mark spoils the blob of step one, but the lattice tells where the mark lies and how it is shaped: enough
 * for step two, which leaves out what does not belong. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks_internal.h"

td_lattice td_numbered_plane(const td_numbering *n, int plane, size_t *first)
{
    *first = 0;
    for (int i = 0; i < plane; i++)
        *first += (size_t)n->target->plane[i].columns * (size_t)n->target->plane[i].rows;
    const td_target_plane *p = &n->target->plane[plane];
    td_lattice l = {p->columns, p->rows, 0, n->of_point + *first};
    for (int i = 0; i < l.columns * l.rows; i++) l.count += l.mark[i] >= 0;
    return l;
}

td_status td_numbered_diameter(double *diameter, const td_numbering *n, int plane, td_error *error)
{
    size_t first, count = 0;
    td_lattice l = td_numbered_plane(n, plane, &first);
    double h[9], *value = malloc((l.count + 1) * sizeof *value);
    if (!value) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", l.count);
    bool ok = td_lattice_homography(h, &l, n->mark);
    for (int i = 0; ok && i < l.columns * l.rows; i++) {
        if (l.mark[i] < 0) continue;
        double j[4], axes[2];
        td_homography_jacobian(j, h, i % l.columns, i / l.columns);
        td_mark_axes(axes, &n->mark[l.mark[i]]);
        value[count++] = 2 * sqrt(axes[0] * axes[1] / fabs(j[0] * j[3] - j[1] * j[2]));
    }
    *diameter = td_marks_median(value, count);
    free(value);
    return TD_OK;
}

/* What the blob of the mark at an empty place would be. */
static bool expect(td_blob *blob, const td_lattice *l, const td_numbering *n, const double h[9],
                   const double inverse[9], int cell, double diameter)
{
    double at[3], j[4], r2 = 0.25 * diameter * diameter;
    if (!td_lattice_predict(at, l, n->mark, inverse, cell % l->columns, cell / l->columns)) return false;
    td_homography_jacobian(j, h, at[0], at[1]);
    /* The ellipse is J u, |u| = r; a uniform ellipse's covariance is a quarter of B^2 = r^2 J J^T. */
    *blob =
        (td_blob){.covariance = {r2 / 4 * (j[0] * j[0] + j[1] * j[1]), r2 / 4 * (j[0] * j[2] + j[1] * j[3]),
                                 r2 / 4 * (j[2] * j[2] + j[3] * j[3])},
                  .area = 3.14159265358979323846 * r2 * fabs(j[0] * j[3] - j[1] * j[2])};
    td_homography_map(blob->centroid, h, at[0], at[1]);
    for (int i = 0; i < l->columns * l->rows; i++) {
        if (l->mark[i] < 0) continue;
        blob->light = n->mark[l->mark[i]].inside > n->mark[l->mark[i]].outside;
        return true;
    }
    return false;
}

/* Fits at the empty places of one plane; mark has room for them. */
static td_status recover_plane(td_numbering *n, td_mark *mark, int plane, td_mark_fit *fit,
                               const td_image *image, td_error *error)
{
    size_t first;
    double h[9], inverse[9], diameter;
    td_lattice l = td_numbered_plane(n, plane, &first);
    TD_TRY(td_numbered_diameter(&diameter, n, plane, error));
    if (!td_lattice_homography(h, &l, mark) || !td_homography_invert(inverse, h)) return TD_OK;
    for (int i = 0; i < l.columns * l.rows; i++) {
        td_blob blob;
        bool ok;
        if (l.mark[i] >= 0 || !expect(&blob, &l, n, h, inverse, i, diameter)) continue;
        TD_TRY(td_mark_fit_blob(&mark[n->marks], &ok, fit, image, &blob, 1, 0, error));
        if (!ok) continue;
        l.mark[i] = (int)n->marks++;
        l.count++;
    }
    return td_lattice_discard(&l, mark, error);
}

td_status td_marks_recover(td_numbering *n, td_mark **mark, const td_image *image, td_error *error)
{
    size_t missing = 0, first;
    for (int i = 0; i < n->target->plane_count; i++) {
        td_lattice l = td_numbered_plane(n, i, &first);
        if (n->seen[i]) missing += (size_t)l.columns * l.rows - l.count;
    }
    if (!missing) return TD_OK;
    td_mark *more = malloc((n->marks + missing) * sizeof *more);
    td_mark_fit *fit = calloc(1, sizeof *fit);
    if (!more || !fit) {
        free(more);
        free(fit);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", n->marks + missing);
    }
    memcpy(more, n->mark, n->marks * sizeof *more);
    free(*mark);
    n->mark = *mark = more;
    td_mark_fit_init(fit, image);
    td_status status = TD_OK;
    for (int i = 0; i < n->target->plane_count && status == TD_OK; i++)
        if (n->seen[i]) status = recover_plane(n, more, i, fit, image, error);
    td_mark_fit_free(fit);
    free(fit);
    return status;
}
