/* A lattice of marks once it is found: its homography, and what does not lie on its plane. */
#include <math.h>
#include <stdlib.h>

#include "calib/homography.h"
#include "calib/marks_internal.h"
#include "core/linalg.h"

enum { LINEAR = 3, QUADRATIC = 6, SUSPECTS = 5 };

/* How far a mark may lie from where its neighbours say, in lattice units: six times the median of the
 * lattice, which grows with distortion, but no less than LEAST_OFF and no more than MOST_OFF. A mark half
 * hidden, or dirt at a lattice point, is farther off. A plane through few neighbours predicts less well than
 * a quadratic. */
static const double OFF_MEDIANS = 6, LEAST_OFF = 0.02, MOST_OFF = 0.1, LINEAR_FACTOR = 2.5;
/* The same for the logarithm of the area, which is known less well when the blur is not small against the
 * mark. */
static const double OFF_AREA = 0.15, OFF_AREA_BLUR = 0.5;

static int by_value(const void *a, const void *b)
{
    double d = *(const double *)a - *(const double *)b;
    return (d > 0) - (d < 0);
}

double td_marks_median(double *value, size_t n)
{
    if (!n) return NAN;
    qsort(value, n, sizeof *value, by_value);
    return n % 2 ? value[n / 2] : 0.5 * (value[n / 2 - 1] + value[n / 2]);
}

void td_mark_axes(double axes[2], const td_mark *mark)
{
    const double *s = mark->shape;
    double half = 0.5 * (s[0] + s[2]), root = hypot(0.5 * (s[0] - s[2]), s[1]);
    axes[0] = 1 / sqrt(half + root);
    axes[1] = 1 / sqrt(half - root);
}

void td_homography_map(double out[2], const double h[9], double x, double y)
{
    double w = h[6] * x + h[7] * y + h[8];
    out[0] = (h[0] * x + h[1] * y + h[2]) / w;
    out[1] = (h[3] * x + h[4] * y + h[5]) / w;
}

void td_homography_jacobian(double j[4], const double h[9], double x, double y)
{
    double w = h[6] * x + h[7] * y + h[8], q[2];
    td_homography_map(q, h, x, y);
    for (int i = 0; i < 4; i++) j[i] = (h[3 * (i / 2) + i % 2] - q[i / 2] * h[6 + i % 2]) / w;
}

bool td_homography_invert(double inverse[9], const double h[9])
{
    const double a[9] = {h[4] * h[8] - h[5] * h[7], h[2] * h[7] - h[1] * h[8], h[1] * h[5] - h[2] * h[4],
                         h[5] * h[6] - h[3] * h[8], h[0] * h[8] - h[2] * h[6], h[2] * h[3] - h[0] * h[5],
                         h[3] * h[7] - h[4] * h[6], h[1] * h[6] - h[0] * h[7], h[0] * h[4] - h[1] * h[3]};
    double det = h[0] * a[0] + h[1] * a[3] + h[2] * a[6];
    if (det == 0 || !isfinite(det)) return false;
    for (int i = 0; i < 9; i++) inverse[i] = a[i] / det;
    return true;
}

void td_lattices_free(td_lattices *lattices)
{
    for (size_t i = 0; i < lattices->count; i++) free(lattices->lattice[i].mark);
    free(lattices->lattice);
    *lattices = (td_lattices){0};
}

void td_lattice_trim(td_lattice *lattice)
{
    int low[2] = {lattice->columns, lattice->rows}, high[2] = {-1, -1};
    size_t count = 0;
    for (int r = 0, i = 0; r < lattice->rows; r++) {
        for (int c = 0; c < lattice->columns; c++, i++) {
            if (lattice->mark[i] < 0) continue;
            count++;
            if (c < low[0]) low[0] = c;
            if (c > high[0]) high[0] = c;
            if (r < low[1]) low[1] = r;
            if (r > high[1]) high[1] = r;
        }
    }
    int columns = high[0] - low[0] + 1, rows = high[1] - low[1] + 1;
    if (columns < 1) columns = rows = 0;
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++)
            lattice->mark[r * columns + c] =
                lattice->mark[(size_t)(r + low[1]) * lattice->columns + c + low[0]];
    lattice->columns = columns;
    lattice->rows = rows;
    lattice->count = count;
}

bool td_lattice_homography(double image_from_lattice[9], const td_lattice *lattice, const td_mark *mark)
{
    size_t cells = (size_t)lattice->columns * lattice->rows;
    double *plane = malloc((4 * cells + 1) * sizeof *plane), *image = plane + 2 * cells;
    if (!plane) return false;
    size_t n = 0;
    for (int r = 0, i = 0; r < lattice->rows; r++) {
        for (int c = 0; c < lattice->columns; c++, i++) {
            if (lattice->mark[i] < 0) continue;
            plane[2 * n] = c;
            plane[2 * n + 1] = r;
            image[2 * n] = mark[lattice->mark[i]].centre[0];
            image[2 * n + 1] = mark[lattice->mark[i]].centre[1];
            n++;
        }
    }
    bool ok = td_homography(image_from_lattice, plane, image, n, NULL) == TD_OK;
    free(plane);
    return ok;
}

static void measured(double value[3], const td_mark *mark, const double lattice_from_image[9])
{
    const double *s = mark->shape;
    td_homography_map(value, lattice_from_image, mark->centre[0], mark->centre[1]);
    value[2] = -0.5 * log(s[0] * s[2] - s[1] * s[1]);
}

/* The value at the origin of the polynomial of `terms` terms through the neighbours up to two places away. */
static bool fit_neighbours(double value[3], const td_lattice *lattice, const td_mark *mark,
                           const double lattice_from_image[9], int column, int row, int terms)
{
    double h[QUADRATIC * QUADRATIC] = {0}, g[3][QUADRATIC] = {{0}};
    int n = 0;
    for (int dr = -2; dr <= 2; dr++) {
        for (int dc = -2; dc <= 2; dc++) {
            int c = column + dc, r = row + dr;
            if ((!dr && !dc) || c < 0 || r < 0 || c >= lattice->columns || r >= lattice->rows) continue;
            int m = lattice->mark[(size_t)r * lattice->columns + c];
            if (m < 0) continue;
            double seen[3], x = dc, y = dr, basis[QUADRATIC] = {1, x, y, x * x, x * y, y * y};
            measured(seen, &mark[m], lattice_from_image);
            for (int i = 0; i < terms; i++) {
                for (int j = 0; j < terms; j++) h[i * terms + j] += basis[i] * basis[j];
                for (int k = 0; k < 3; k++) g[k][i] += basis[i] * seen[k];
            }
            n++;
        }
    }
    if (n < terms + (terms == QUADRATIC ? 2 : 1)) return false;
    /* Neighbours that do not determine the polynomial leave no positive diagonal to invert, or a huge one. */
    if (td_invert_spd(h, h, (size_t)terms, NULL) != TD_OK || !(h[0] < 10)) return false;
    for (int k = 0; k < 3; k++) {
        value[k] = 0;
        for (int i = 0; i < terms; i++) value[k] += h[i] * g[k][i];
    }
    return true;
}

/* How far what is measured lies from what is predicted, lattice units; *area: share of what is allowed. */
static double distance_off(double *area, const td_lattice *lattice, const td_mark *mark,
                           const double lattice_from_image[9], int column, int row)
{
    double value[3], seen[3], axes[2], factor = 1;
    const td_mark *m = &mark[lattice->mark[(size_t)row * lattice->columns + column]];
    *area = 0;
    if (!fit_neighbours(value, lattice, mark, lattice_from_image, column, row, QUADRATIC)) {
        factor = LINEAR_FACTOR;
        if (!fit_neighbours(value, lattice, mark, lattice_from_image, column, row, LINEAR)) return 0;
    }
    measured(seen, m, lattice_from_image);
    td_mark_axes(axes, m);
    *area = fabs(seen[2] - value[2]) / (OFF_AREA + OFF_AREA_BLUR * m->blur / axes[0]);
    return hypot(seen[0] - value[0], seen[1] - value[1]) / factor;
}

/* `off` (rows,columns) = the share of what is allowed, 0 where no mark is; `room` of that size. Returns the
 * sum of what is too much. */
static double shares_off(double *off, double *room, const td_lattice *lattice, const td_mark *mark)
{
    double h[9], inverse[9], sum = 0;
    size_t n = 0;
    if (!td_lattice_homography(h, lattice, mark) || !td_homography_invert(inverse, h)) return 0;
    for (int r = 0, i = 0; r < lattice->rows; r++) {
        for (int c = 0; c < lattice->columns; c++, i++) {
            off[i] = 0;
            if (lattice->mark[i] < 0) continue;
            double area;
            off[i] = room[n++] = distance_off(&area, lattice, mark, inverse, c, r);
            if (area > 1) off[i] = fmax(off[i], MOST_OFF * area);
        }
    }
    double allowed = fmin(fmax(OFF_MEDIANS * td_marks_median(room, n), LEAST_OFF), MOST_OFF);
    for (int i = 0; i < lattice->rows * lattice->columns; i++) {
        off[i] /= allowed;
        sum += fmax(off[i] - 1, 0);
    }
    return sum;
}

bool td_lattice_predict(double value[3], const td_lattice *lattice, const td_mark *mark,
                        const double lattice_from_image[9], int column, int row)
{
    return fit_neighbours(value, lattice, mark, lattice_from_image, column, row, QUADRATIC) ||
           fit_neighbours(value, lattice, mark, lattice_from_image, column, row, LINEAR);
}

/* The mark that is farthest off among those not tried yet, -1: none. Its `off` is cleared. */
static int take_worst(double *off, const td_lattice *lattice)
{
    int worst = -1;
    for (int i = 0; i < lattice->columns * lattice->rows; i++)
        if (off[i] > 1 && (worst < 0 || off[i] > off[worst])) worst = i;
    if (worst >= 0) off[worst] = 0;
    return worst;
}

td_status td_lattice_discard(td_lattice *lattice, const td_mark *mark, td_error *error)
{
    size_t cells = (size_t)lattice->columns * lattice->rows;
    double *off = malloc((3 * cells + 1) * sizeof *off), *other = off + cells, *room = other + cells;
    if (!off) return td_fail(error, TD_ERROR_MEMORY, "no memory for a grid of %zu marks", cells);
    while (shares_off(off, room, lattice, mark) > 0) {
        /* A wrong mark spoils its neighbours' predictions: of the worst, the one without which the rest
         * agrees best. */
        int culprit = -1;
        double least = INFINITY;
        for (int k = 0; k < SUSPECTS; k++) {
            int i = take_worst(off, lattice);
            if (i < 0) break;
            int m = lattice->mark[i];
            lattice->mark[i] = -1;
            double without = shares_off(other, room, lattice, mark);
            lattice->mark[i] = m;
            if (without >= least) continue;
            least = without;
            culprit = i;
        }
        lattice->mark[culprit] = -1;
        lattice->count--;
    }
    free(off);
    return TD_OK;
}
