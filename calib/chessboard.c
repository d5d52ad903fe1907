/* Coarse corners come from OpenCV, at first from an image shrunk to about a megapixel; each is refined by
 * corner.c; the squares' colours must alternate, and they decide on the numbering. */
#include "calib/chessboard.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/chessboard_internal.h"
#include "calib/corner.h"

static const double COARSE_PIXELS = 1.2e6; /* an image is halved until it has fewer */
static const double UNSEEN_SHARE = 0.2;    /* of the corners, at most, in a board that counts as found */
static const double BLURRED = 3;           /* px, standard deviation of the edges */
enum { LEAST_SIDE = 60 };                  /* px, of an image in which a board is looked for */

/* A board in the image, in any order. */
typedef struct board {
    int columns, rows;
    double *start;     /* (rows,columns,2) coarse positions, px */
    td_corner *corner; /* (rows,columns) */
    bool *seen;        /* (rows,columns) the corner could be refined */
    bool part;         /* of a larger board */
} board;

static void board_free(board *b)
{
    free(b->start);
    free(b->corner);
    free(b->seen);
    *b = (board){0};
}

static td_status board_new(board *b, int columns, int rows, td_error *error)
{
    size_t n = (size_t)columns * (size_t)rows;
    *b = (board){columns,
                 rows,
                 malloc(2 * n * sizeof *b->start),
                 calloc(n, sizeof *b->corner),
                 calloc(n, sizeof *b->seen),
                 false};
    if (b->start && b->corner && b->seen) return TD_OK;
    board_free(b);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a chessboard of %dx%d corners", columns, rows);
}

static int board_count(const board *b)
{
    return b->columns * b->rows;
}

/* ---- Coarse search ---- */

static double spread_of(const td_image *image)
{
    size_t n = (size_t)image->width * (size_t)image->height;
    uint64_t sum = 0, square = 0;
    for (size_t i = 0; i < n; i++) {
        sum += image->data[i];
        square += (uint64_t)image->data[i] * image->data[i];
    }
    double mean = (double)sum / (double)n;
    return sqrt(fmax((double)square / (double)n - mean * mean, 0));
}

/* By quadrangles in an image of usual size. The first threshold suits most images, the second small squares
 * and noise, the third dark corners. */
static td_status search_usual(board *b, bool *found, const td_image *image, td_error *error)
{
    const int side = image->width < image->height ? image->width : image->height;
    const double spread = spread_of(image);
    const td_chessboard_threshold threshold[3] = {{(side / 10) | 1, 0.14 * spread, 0},
                                                  {(side / 20) | 1, 0.14 * spread, 3},
                                                  {(side / 7) | 1, 0.03 * spread, 5}};
    *found = false;
    for (int i = 0; i < 3 && !*found; i++)
        TD_TRY(
            td_chessboard_by_quadrangles(b->start, found, image, b->columns, b->rows, &threshold[i], error));
    return TD_OK;
}

/* The same for boards that are too small in the shrunk image. */
static td_status search_small(board *b, bool *found, const td_image *image, td_error *error)
{
    const double offset = 0.14 * spread_of(image);
    const td_chessboard_threshold threshold[2] = {{41, offset, 0}, {25, offset, 3}};
    *found = false;
    for (int i = 0; i < 2 && !*found; i++)
        TD_TRY(
            td_chessboard_by_quadrangles(b->start, found, image, b->columns, b->rows, &threshold[i], error));
    return TD_OK;
}

static td_status search_sectors(board *b, bool *found, const td_image *image, td_error *error)
{
    int columns = b->columns, rows = b->rows;
    return td_chessboard_by_sectors(b->start, (size_t)board_count(b), found, &columns, &rows, false, image,
                                    error);
}

static int halvings(const td_image *image)
{
    int times = 0;
    while ((double)(image->width >> times) * (image->height >> times) > COARSE_PIXELS) times++;
    return times;
}

/* From the image halved `times` times to the image itself: pixel (0, 0) is the centre of the first pixel. */
static void enlarge(board *b, int times)
{
    double factor = (double)(1 << times);
    for (int i = 0; i < 2 * board_count(b); i++) b->start[i] = (b->start[i] + 0.5) * factor - 0.5;
}

/* A way to look for a board in the image halved `times` times. */
typedef td_status (*search_function)(board *b, bool *found, const td_image *image, td_error *error);

static td_status search_shrunk(board *b, bool *found, const td_image *image, int times, search_function look,
                               td_error *error)
{
    if (image->width < LEAST_SIDE || image->height < LEAST_SIDE) return TD_OK;
    td_image *small = NULL;
    if (times > 0) TD_TRY(td_image_shrink(&small, image, times, error));
    td_status status = look(b, found, small ? small : image, error);
    td_image_free(&small);
    if (status == TD_OK && *found) enlarge(b, times);
    return status;
}

static td_status search(board *b, bool *found, const td_image *image, td_error *error)
{
    *found = false;
    const int most = halvings(image);
    TD_TRY(search_shrunk(b, found, image, most, search_usual, error));
    if (!*found) TD_TRY(search_shrunk(b, found, image, most, search_sectors, error));
    for (int times = most - 1; times >= 0 && !*found; times--)
        TD_TRY(search_shrunk(b, found, image, times, search_small, error));
    return TD_OK;
}

/* ---- Refinement ---- */

static const double *start_at(const board *b, int column, int row)
{
    return b->start + 2 * (row * b->columns + column);
}

/* Steps to the neighbours: half the way between those on both sides, or to the only one. */
static void steps_at(double along_column[2], double along_row[2], const board *b, int column, int row)
{
    int left = column > 0 ? column - 1 : column, right = column + 1 < b->columns ? column + 1 : column;
    int up = row > 0 ? row - 1 : row, down = row + 1 < b->rows ? row + 1 : row;
    for (int k = 0; k < 2; k++) {
        along_column[k] = (start_at(b, right, row)[k] - start_at(b, left, row)[k]) / (right - left);
        along_row[k] = (start_at(b, column, down)[k] - start_at(b, column, up)[k]) / (down - up);
    }
}

/* Reverses every row when columns to the right and rows downwards would show the board's back. */
static void face_front(board *b)
{
    double turn = 0, x[2], y[2];
    for (int i = 0; i < board_count(b); i++) {
        steps_at(x, y, b, i % b->columns, i / b->columns);
        turn += x[0] * y[1] - x[1] * y[0];
    }
    if (turn > 0) return;
    for (int r = 0; r < b->rows; r++) {
        double *row = b->start + 2 * r * b->columns;
        for (int i = 0, j = b->columns - 1; i < j; i++, j--)
            for (int k = 0; k < 2; k++) {
                double kept = row[2 * i + k];
                row[2 * i + k] = row[2 * j + k];
                row[2 * j + k] = kept;
            }
    }
}

/* Sign of the contrast at corner (0, 0), by the majority of corners: it alternates over the board. */
static int first_sign(const board *b)
{
    int votes = 0;
    for (int i = 0; i < board_count(b); i++) {
        if (!b->seen[i]) continue;
        int sign = b->corner[i].contrast > 0 ? 1 : -1;
        votes += (i / b->columns + i % b->columns) % 2 ? -sign : sign;
    }
    return votes > 0 ? 1 : -1;
}

/* Refines corner i from `start`; its colours must suit those of corner (0, 0), when they are known (0: not
 * yet). */
static void refine_one(board *b, const td_image *image, int i, const double start[2], int first)
{
    double x[2], y[2];
    int column = i % b->columns, row = i / b->columns, sign = (column + row) % 2 ? -first : first;
    steps_at(x, y, b, column, row);
    b->seen[i] = td_corner_refine(&b->corner[i], image, start, x, y) && b->corner[i].contrast * sign >= 0;
}

/* The middle between seen neighbours on both sides, in the row, the column or both. */
static bool between_neighbours(double middle[2], const board *b, int i)
{
    const int column = i % b->columns, row = i / b->columns, n = b->columns;
    int used = 0;
    middle[0] = middle[1] = 0;
    for (int way = 0; way < 2; way++) {
        int step = way ? n : 1, at = way ? row : column, last = way ? b->rows - 1 : n - 1;
        if (at == 0 || at == last || !b->seen[i - step] || !b->seen[i + step]) continue;
        for (int k = 0; k < 2; k++)
            middle[k] += (b->corner[i - step].position[k] + b->corner[i + step].position[k]) / 2;
        used++;
    }
    for (int k = 0; k < 2; k++) middle[k] /= used ? used : 1;
    return used > 0;
}

/* Refines all corners, those that fail once more from between their neighbours; returns how many are seen. */
static int refine(board *b, const td_image *image)
{
    face_front(b);
    for (int i = 0; i < board_count(b); i++) refine_one(b, image, i, b->start + 2 * i, 0);
    int first = first_sign(b), seen = 0;
    for (int i = 0; i < board_count(b); i++) {
        int sign = (i / b->columns + i % b->columns) % 2 ? -first : first;
        b->seen[i] = b->seen[i] && b->corner[i].contrast * sign > 0;
    }
    for (int i = 0; i < board_count(b); i++) {
        double middle[2];
        if (!b->seen[i] && between_neighbours(middle, b, i)) refine_one(b, image, i, middle, first);
        seen += b->seen[i];
    }
    return seen;
}

/* Whether a corner lies one step beyond corner i of the board's edge, in line with i, j and k. */
static bool goes_on_at(const board *b, const td_image *image, int i, int j, int k)
{
    double next[2], x[2], y[2];
    for (int c = 0; c < 2; c++)
        next[c] = 3 * b->corner[i].position[c] - 3 * b->corner[j].position[c] + b->corner[k].position[c];
    steps_at(x, y, b, i % b->columns, i / b->columns);
    td_corner beyond;
    const td_corner *edge = &b->corner[i];
    return td_corner_refine(&beyond, image, next, x, y) && beyond.contrast * edge->contrast < 0 &&
           fabs(beyond.contrast) > 0.5 * fabs(edge->contrast) && beyond.residual < 2 * edge->residual;
}

/* At two places of the side whose corners are first, first + step, …, from its middle outwards; `inwards`
 * leads to a corner's neighbour inside. */
static bool side_goes_on(const board *b, const td_image *image, int first, int step, int count, int inwards)
{
    int hits = 0;
    for (int n = 0; n <= count && hits < 2; n++) {
        int at = count / 2 + (n % 2 ? (n + 1) / 2 : -n / 2);
        int i = first + at * step, j = i + inwards, k = j + inwards;
        if (at < 0 || at >= count || !b->seen[i] || !b->seen[j] || !b->seen[k]) continue;
        if (!goes_on_at(b, image, i, j, k)) return false;
        hits++;
    }
    return hits == 2;
}

/* A part of a larger board is no board: points would be numbered from wherever the part begins. */
static bool goes_on(const board *b, const td_image *image)
{
    const int n = b->columns, m = b->rows, last = (m - 1) * n;
    return side_goes_on(b, image, 0, 1, n, n) || side_goes_on(b, image, last, 1, n, -n) ||
           side_goes_on(b, image, 0, n, m, 1) || side_goes_on(b, image, n - 1, n, m, -1);
}

static bool enough(const board *b, int seen)
{
    return seen >= (1 - UNSEEN_SHARE) * board_count(b);
}

/* ---- Order ---- */

/* Which corner of the board is (column, row) after `turns` quarter turns. */
static int turned(const board *b, int turns, int column, int row)
{
    const int right = b->columns - 1, bottom = b->rows - 1;
    const int at[4][2] = {
        {column, row}, {right - row, column}, {right - column, bottom - row}, {row, bottom - column}};
    return at[turns][1] * b->columns + at[turns][0];
}

/* Quarter turns to the order that chessboard.h promises. */
static int best_turns(const board *b)
{
    const int first = first_sign(b), step = b->columns == b->rows ? 1 : 2;
    int best = 0;
    bool best_dark = false;
    double best_place = INFINITY;
    for (int turns = 0; turns < 4; turns += step) {
        int i = turned(b, turns, 0, 0);
        /* The sign of a corner's contrast changes from corner to corner and with every quarter turn. */
        int sign = (i / b->columns + i % b->columns + turns) % 2 ? -first : first;
        bool dark = sign < 0;
        double place = b->start[2 * i] + b->start[2 * i + 1];
        if (dark < best_dark || (dark == best_dark && place >= best_place)) continue;
        best = turns, best_dark = dark, best_place = place;
    }
    return best;
}

/* ---- The detection ---- */

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static td_status median_blur(double *median, const board *b, int seen, td_error *error)
{
    double *blur = malloc((size_t)seen * sizeof *blur);
    if (!blur) return td_fail(error, TD_ERROR_MEMORY, "no memory for %d corners", seen);
    int n = 0;
    for (int i = 0; i < board_count(b); i++)
        if (b->seen[i]) blur[n++] = b->corner[i].blur;
    qsort(blur, (size_t)n, sizeof *blur, by_value);
    *median = n % 2 ? blur[n / 2] : (blur[n / 2 - 1] + blur[n / 2]) / 2;
    free(blur);
    return TD_OK;
}

/* By how much the residuals' correlation raises the variance, over all corners of the image: one corner's own
 * figure is good to a third only. */
static double common_inflation(const board *b, int seen)
{
    double sum = 0;
    for (int i = 0; i < board_count(b); i++)
        if (b->seen[i]) sum += pow(b->corner[i].sigma / b->corner[i].white, 2);
    return sum / seen;
}

static td_status fill(td_detection *detection, const board *b, int seen, td_error *error)
{
    TD_TRY(median_blur(&detection->blur_px, b, seen, error));
    const double inflation = sqrt(common_inflation(b, seen));
    const int turns = best_turns(b), n = b->columns;
    for (int k = 0; k < board_count(b); k++) {
        int i = turned(b, turns, k % n, k / n);
        if (!b->seen[i]) continue;
        memcpy(detection->point + 2 * k, b->corner[i].position, 2 * sizeof *detection->point);
        detection->sigma[k] = b->corner[i].white * inflation;
    }
    detection->found = true;
    if (seen < board_count(b))
        snprintf(detection->reason, sizeof detection->reason, "%d of %d corners cannot be measured",
                 board_count(b) - seen, board_count(b));
    return TD_OK;
}

/* ---- What was seen instead ---- */

/* Blur of the sharpest edges, px: an edge of rise R blurred by w has slope R / (w sqrt(2 pi)). Along rows;
 * the edges are the half percent of steepest places. NaN: none. */
static double edge_blur(const td_image *image)
{
    enum { BINS = 100, PER_PX = 10 };
    size_t count[256] = {0}, total = 0, steep = 0, bin[BINS] = {0}, edges = 0;
    const int w = image->width;
    for (int y = 0; y < image->height; y++) {
        const uint8_t *g = image->data + (size_t)y * (size_t)w;
        for (int x = 1; x + 1 < w; x++, total++) count[abs(g[x + 1] - g[x - 1])]++;
    }
    int threshold = 256;
    while (threshold > 8 && steep <= total / 200) steep += count[--threshold];
    for (int y = 0; y < image->height; y++) {
        const uint8_t *g = image->data + (size_t)y * (size_t)w;
        for (int x = 2; x + 2 < w; x++) {
            int rise = g[x + 1] - g[x - 1], sign = rise > 0 ? 1 : -1, from = x, to = x;
            if (rise * sign < threshold || (g[x] - g[x - 2]) * sign > rise * sign ||
                (g[x + 2] - g[x]) * sign > rise * sign)
                continue;
            while (from > 0 && (g[from] - g[from - 1]) * sign > 0) from--;
            while (to + 1 < w && (g[to + 1] - g[to]) * sign > 0) to++;
            double blur = (g[to] - g[from]) * sign / (0.5 * rise * sign * 2.5066);
            bin[(int)fmin(blur * PER_PX, BINS - 1)]++;
            edges++;
        }
    }
    if (edges == 0) return NAN;
    size_t below = 0;
    int i = 0;
    while ((below += bin[i]) < (edges + 1) / 2) i++;
    return (i + 0.5) / PER_PX;
}

/* The blur, px, of an image of which no edge is sharp; 0 for others. Looks at shrunk images, where noise does
 * not break up the slopes; there, edges that are sharp measure less than 1 px. */
static double blur_of_all(const td_image *image)
{
    for (int times = 2; times > 0; times--) {
        td_image *small = NULL;
        double blur = 0;
        if (td_image_shrink(&small, image, times, NULL) == TD_OK) blur = edge_blur(small);
        td_image_free(&small);
        if (blur > BLURRED / 2) return blur * (1 << times);
    }
    return 0;
}

/* ": the image is blurred …" when it is, else "". */
static const char *blur_remark(char remark[96], const td_image *image)
{
    double blur = blur_of_all(image);
    remark[0] = 0;
    if (blur > 0)
        snprintf(remark, 96, ": the image is blurred, its edges spread over %.1f px: focus, or hold still",
                 blur);
    return remark;
}

static td_status search_larger(board *b, bool *found, const td_image *image, td_error *error)
{
    const size_t capacity = (size_t)board_count(b);
    b->columns = b->rows = 3;
    return td_chessboard_by_sectors(b->start, capacity, found, &b->columns, &b->rows, true, image, error);
}

/* The largest board of any size in the shrunk image, refined. */
static td_status search_any_size(board *b, bool *found, const td_image *image, td_error *error)
{
    enum { MOST_SIDE = 100 };
    *found = false;
    TD_TRY(board_new(b, MOST_SIDE, MOST_SIDE, error));
    TD_TRY(search_shrunk(b, found, image, halvings(image), search_larger, error));
    if (!*found) return TD_OK;
    *found = enough(b, refine(b, image));
    b->part = *found && goes_on(b, image);
    return TD_OK;
}

/* Exchanges columns and rows. */
static td_status transpose(board *b, td_error *error)
{
    board t;
    TD_TRY(board_new(&t, b->rows, b->columns, error));
    for (int i = 0; i < board_count(b); i++)
        memcpy(t.start + 2 * (i % b->columns * t.columns + i / b->columns), b->start + 2 * i,
               2 * sizeof *t.start);
    t.part = b->part;
    board_free(b);
    *b = t;
    return TD_OK;
}

static int difference(const board *b, int columns, int rows)
{
    return abs(b->columns - columns) + abs(b->rows - rows);
}

/* A board of any size, with columns and rows nearest to the wanted ones. */
static td_status search_like(board *other, bool *found, const board *wanted, const td_image *image,
                             td_error *error)
{
    TD_TRY(search_any_size(other, found, image, error));
    if (*found &&
        difference(wanted, other->rows, other->columns) < difference(wanted, other->columns, other->rows))
        return transpose(other, error);
    return TD_OK;
}

/* Says what is there instead of the wanted board, of which `seen` corners could be measured. `other`: NULL,
 * or the largest board. */
static void tell(td_detection *detection, const board *wanted, int seen, const board *other,
                 const td_image *image)
{
    const int columns = wanted->columns, rows = wanted->rows, count = board_count(wanted);
    const bool there = 2 * seen >= count && !(other && board_count(other) > count);
    const bool whole = other && !other->part;
    char remark[96], saw[160];
    blur_remark(remark, image); /* of a blurred board, parts are found */
    if (wanted->part && !other)
        snprintf(saw, sizeof saw, "but the one in the image has more");
    else if (there && !wanted->part)
        snprintf(saw, sizeof saw, "saw it, but only %d of %d can be measured%s", seen, count,
                 *remark ? remark : ": noise, glare, shadow or something before it");
    else if (!other || (*remark && (!whole || board_count(other) < count)))
        snprintf(saw, sizeof saw, "saw none%s", remark);
    else if (other->columns == columns - 1 && other->rows == rows - 1 && whole)
        snprintf(saw, sizeof saw,
                 "one of %dx%d seems to be in the image: were squares counted instead of corners?",
                 other->columns, other->rows);
    else
        snprintf(saw, sizeof saw, "one of %s%dx%d seems to be in the image: is it another board%s?",
                 whole ? "" : "more than ", other->columns, other->rows,
                 other->columns < columns || other->rows < rows ? ", or not wholly in view" : "");
    snprintf(detection->reason, sizeof detection->reason,
             "looked for a chessboard of %dx%d inner corners, %s", columns, rows, saw);
}

/* Looks for a board of any size when of the wanted one too few corners can be measured, or it is a part of a
 * larger one. A board of the wanted size is taken; of another the detection's reason tells. */
static td_status look_again(td_detection *detection, board *b, int *seen, const td_image *image,
                            td_error *error)
{
    board other = {0};
    bool any = false;
    td_status status = search_like(&other, &any, b, image, error);
    if (status == TD_OK && any && !other.part && difference(b, other.columns, other.rows) == 0) {
        memcpy(b->start, other.start, 2 * (size_t)board_count(b) * sizeof *b->start);
        b->part = false;
        *seen = refine(b, image);
    }
    if (status == TD_OK && (b->part || !enough(b, *seen)))
        tell(detection, b, *seen, any ? &other : NULL, image);
    board_free(&other);
    return status;
}

static td_status detect(td_detection *detection, board *b, const td_image *image, td_error *error)
{
    bool found = false;
    TD_TRY(search(b, &found, image, error));
    int seen = found ? refine(b, image) : 0;
    b->part = enough(b, seen) && goes_on(b, image);
    if (b->part || !enough(b, seen)) TD_TRY(look_again(detection, b, &seen, image, error));
    return b->part || !enough(b, seen) ? TD_OK : fill(detection, b, seen, error);
}

td_status td_chessboard_detect(td_detection *detection, const td_image *image, const td_target *target,
                               td_error *error)
{
    *detection = (td_detection){0};
    TD_TRY(td_target_check(target, error));
    if (target->kind != TD_TARGET_CHESSBOARD)
        return td_fail(error, TD_ERROR_ARGUMENT, "the target is not a chessboard");
    if (image->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "a chessboard is looked for in grey images, not in %d channels", image->channels);
    board b;
    TD_TRY(td_detection_init(detection, td_target_point_count(target), error));
    td_status status = board_new(&b, target->plane[0].columns, target->plane[0].rows, error);
    if (status == TD_OK) status = detect(detection, &b, image, error);
    board_free(&b);
    if (status != TD_OK) td_detection_free(detection);
    return status;
}
