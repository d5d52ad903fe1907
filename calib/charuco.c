/* Markers say where the inner corners are; each is then refined as a chessboard's, in a window that keeps
 * clear of the markers. Corners beyond the markers that were read are predicted from corners already found.
 */
#include "calib/charuco.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/charuco_internal.h"
#include "calib/corner.h"
#include "calib/homography.h"

static const double BESIDE = 0.75;      /* squares from a corner to the centre of a marker beside it */
static const double ABOUT = 2.3;        /* squares, within which markers or corners predict a corner */
static const double MOST_SHIFT = 0.25;  /* squares from where a corner was predicted */
static const double WINDOW_SHARE = 0.6; /* of the shorter step: radius of td_corner_refine's window */
static const double LEAST_WINDOW = 3.1, CLEARANCE = 0.5; /* px: radius; from its rim to a marker's corner */
enum { NEAREST = 4, MOST_POINTS = 64, LEAST_CORNERS = 4, LEAST_MARKERS = 2 };

typedef struct board {
    const td_image *image;
    td_charuco_layout layout;
    td_corner *corner; /* (rows,columns) */
    bool *seen;        /* (rows,columns) */
} board;

static int corner_count(const board *b)
{
    return b->layout.columns * b->layout.rows;
}

static void apply(double out[2], const double h[9], double x, double y)
{
    const double w = h[6] * x + h[7] * y + h[8];
    for (int k = 0; k < 2; k++) out[k] = (h[3 * k] * x + h[3 * k + 1] * y + h[3 * k + 2]) / w;
}

/* The scale that steps must have for the window to keep clear of the markers, whose corners come nearest. */
static double window_scale(const board *b, const double along_column[2], const double along_row[2])
{
    const double *u = along_column, *v = along_row, gap = (1 - b->layout.share) / 2;
    const double to_marker = gap * fmin(hypot(u[0] + v[0], u[1] + v[1]), hypot(u[0] - v[0], u[1] - v[1]));
    const double longer = fmax(hypot(u[0], u[1]), hypot(v[0], v[1]));
    const double next_edge = fabs(u[0] * v[1] - u[1] * v[0]) / longer;
    const double radius = fmax(to_marker - CLEARANCE, LEAST_WINDOW);
    return fmin(radius / (WINDOW_SHARE * next_edge), 1);
}

/* Refines corner i from the place that `h` (squares to px) says. */
static bool refine(board *b, int i, const double h[9])
{
    const int column = i % b->layout.columns, row = i / b->layout.columns;
    double at[2], left[2], right[2], up[2], down[2], u[2], v[2];
    apply(at, h, column, row);
    apply(left, h, column - 0.5, row), apply(right, h, column + 0.5, row);
    apply(up, h, column, row - 0.5), apply(down, h, column, row + 0.5);
    for (int k = 0; k < 2; k++) u[k] = right[k] - left[k], v[k] = down[k] - up[k];
    const double scale = window_scale(b, u, v), side = fmin(hypot(u[0], u[1]), hypot(v[0], v[1]));
    for (int k = 0; k < 2; k++) u[k] *= scale, v[k] *= scale;
    td_corner *c = &b->corner[i];
    const bool dark = td_charuco_square_is_dark(&b->layout, column + 1, row + 1);
    return td_corner_refine(c, b->image, at, u, v) && (c->contrast < 0) == dark &&
           hypot(c->position[0] - at[0], c->position[1] - at[1]) < MOST_SHIFT * side;
}

/* Homography about corner (column, row) from the nearest markers, of which one at least is beside it. */
static bool from_markers(double h[9], const td_marker *marker, size_t count, double share, int column,
                         int row)
{
    static const double sign[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
    double on_board[8 * NEAREST], px[8 * NEAREST], distance[NEAREST];
    const td_marker *nearest[NEAREST];
    int n = 0;
    for (size_t i = 0; i < count; i++) {
        const double d = hypot(marker[i].square[0] - column, marker[i].square[1] - row);
        if (!marker[i].placed || d > ABOUT) continue;
        int at = n;
        while (at > 0 && distance[at - 1] > d) at--;
        if (at == NEAREST) continue;
        if (n < NEAREST) n++;
        for (int k = n - 1; k > at; k--) nearest[k] = nearest[k - 1], distance[k] = distance[k - 1];
        nearest[at] = &marker[i], distance[at] = d;
    }
    if (n == 0 || distance[0] > BESIDE) return false;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 2; c++) {
                on_board[8 * i + 2 * k + c] = nearest[i]->square[c] + sign[k][c] * share / 2;
                px[8 * i + 2 * k + c] = nearest[i]->corner[2 * k + c];
            }
    return td_homography(h, on_board, px, 4 * (size_t)n, NULL) == TD_OK;
}

/* The same from the corners found within reach. */
static bool from_corners(double h[9], const board *b, int column, int row)
{
    double on_board[2 * MOST_POINTS], px[2 * MOST_POINTS];
    const int reach = (int)ABOUT;
    size_t n = 0;
    for (int r = row - reach; r <= row + reach; r++)
        for (int c = column - reach; c <= column + reach; c++) {
            const int i = r * b->layout.columns + c;
            if (r < 0 || c < 0 || r >= b->layout.rows || c >= b->layout.columns || !b->seen[i]) continue;
            on_board[2 * n] = c, on_board[2 * n + 1] = r;
            memcpy(px + 2 * n++, b->corner[i].position, 2 * sizeof *px);
        }
    return n >= LEAST_CORNERS && td_homography(h, on_board, px, n, NULL) == TD_OK;
}

/* Refines every corner that can be predicted; returns how many are seen. */
static int refine_all(board *b, const td_marker *marker, size_t count)
{
    double h[9];
    int seen = 0;
    for (int i = 0; i < corner_count(b); i++) {
        const int column = i % b->layout.columns, row = i / b->layout.columns;
        b->seen[i] = from_markers(h, marker, count, b->layout.share, column, row) && refine(b, i, h);
        seen += b->seen[i];
    }
    for (int before = -1; before < seen;) {
        before = seen;
        for (int i = 0; i < corner_count(b); i++) {
            if (b->seen[i] || !from_corners(h, b, i % b->layout.columns, i / b->layout.columns)) continue;
            b->seen[i] = refine(b, i, h);
            seen += b->seen[i];
        }
    }
    return seen;
}

static bool in_line(const board *b)
{
    int first = -1, second = -1;
    for (int i = 0; i < corner_count(b); i++) {
        const int n = b->layout.columns;
        if (!b->seen[i]) continue;
        if (first < 0)
            first = i;
        else if (second < 0)
            second = i;
        else if ((second % n - first % n) * (i / n - first / n) !=
                 (i % n - first % n) * (second / n - first / n))
            return false;
    }
    return true;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static td_status fill(td_detection *detection, const board *b, int seen, td_error *error)
{
    double *blur = malloc((size_t)seen * sizeof *blur), inflation = 0;
    int n = 0;
    if (!blur) return td_fail(error, TD_ERROR_MEMORY, "no memory for %d corners", seen);
    for (int i = 0; i < corner_count(b); i++) {
        if (!b->seen[i]) continue;
        blur[n++] = b->corner[i].blur;
        inflation +=
            pow(b->corner[i].sigma / b->corner[i].white, 2) / seen; /* corner.h: steadier over many */
    }
    qsort(blur, (size_t)n, sizeof *blur, by_value);
    detection->blur_px = n % 2 ? blur[n / 2] : (blur[n / 2 - 1] + blur[n / 2]) / 2;
    free(blur);
    for (int i = 0; i < corner_count(b); i++) {
        if (!b->seen[i]) continue;
        memcpy(detection->point + 2 * i, b->corner[i].position, 2 * sizeof *detection->point);
        detection->sigma[i] = b->corner[i].white * sqrt(inflation);
    }
    detection->found = true;
    return TD_OK;
}

static void tell(td_detection *detection, const td_target *target, const char *why)
{
    snprintf(detection->reason, sizeof detection->reason,
             "looked for a charuco of %dx%d inner corners with %s%s", target->plane[0].columns,
             target->plane[0].rows, target->dictionary, why);
}

/* Refines the corners that the markers tell, how many in *seen; why they may be too few in `why`. */
static td_status measure(board *b, int *seen, char *why, size_t size, const td_target *target,
                         td_error *error)
{
    td_marker *marker = NULL;
    size_t count = 0;
    TD_TRY(td_markers_find(&marker, &count, b->image, target->dictionary, target->border, error));
    const size_t placed = td_charuco_place(marker, count, &b->layout);
    td_status status = TD_OK;
    *seen = 0;
    if (!td_charuco_doubt(why, size, marker, count, placed, &b->layout)) {
        if (placed >= LEAST_MARKERS) *seen = refine_all(b, marker, count);
        if (placed < LEAST_MARKERS)
            status = td_charuco_look_again(why, size, marker, count, b->image, target, error);
        else
            snprintf(why, size,
                     ", saw %zu of its markers, but only %d corners%s can be measured: blur, glare, or too "
                     "little in view",
                     placed, *seen, *seen >= LEAST_CORNERS ? ", all in line," : "");
    }
    free(marker);
    return status;
}

static td_status detect(td_detection *detection, board *b, const td_target *target, td_error *error)
{
    int seen = 0;
    char why[160] = "";
    TD_TRY(measure(b, &seen, why, sizeof why, target, error));
    if (seen >= LEAST_CORNERS && !in_line(b)) return fill(detection, b, seen, error);
    tell(detection, target, why);
    return TD_OK;
}

td_status td_charuco_detect(td_detection *detection, const td_image *image, const td_target *target,
                            td_error *error)
{
    if (target->kind != TD_TARGET_CHARUCO || image->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "a charuco is looked for in a grey image");
    TD_TRY(td_target_check(target, error));
    TD_TRY(td_detection_init(detection, td_target_point_count(target), error));
    board b = {.image = image, .layout = td_charuco_layout_of(target)};
    const size_t n = (size_t)corner_count(&b);
    b.corner = calloc(n, sizeof *b.corner);
    b.seen = calloc(n, sizeof *b.seen);
    td_status status = b.corner && b.seen ? detect(detection, &b, target, error)
                                          : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu corners", n);
    free(b.corner);
    free(b.seen);
    if (status != TD_OK) td_detection_free(detection);
    return status;
}
