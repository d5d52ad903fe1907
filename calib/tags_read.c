#include <math.h>

#include "calib/corner_internal.h"
#include "calib/homography.h"
#include "calib/tags_internal.h"

static const double LEAST_CONTRAST = 8;    /* grey levels */
static const double MOST_WRONG = 0.12;     /* of the cells */
static const double PLAIN_RESIDUAL = 0.06; /* of the contrast: a fit that needs no other beside it */
static const double BETTER = 0.8;          /* by how much another fit must leave less */
static const double NARROW_OUTSIDE = 0.5;  /* cells of light where another print is near */
static const double UNKNOWN_OUTSIDE = 1;   /* cells of light around a tag, at least */
static const double SQUARE_OUTSIDE = 1.5;  /* cells of a touching square's side, at least */

/* From cells, counted from the tag's upper left, to pixels. */
static bool tag_homography(double h[9], const td_tag *tag, int side)
{
    const double n = side, cell[8] = {0, 0, n, 0, n, n, 0, n};
    return td_homography(h, cell, tag->corner, 4, NULL) == TD_OK;
}

static void to_pixel(double pixel[2], const double h[9], double x, double y)
{
    double w = h[6] * x + h[7] * y + h[8];
    pixel[0] = (h[0] * x + h[1] * y + h[2]) / w;
    pixel[1] = (h[3] * x + h[4] * y + h[5]) / w;
}

static bool inside(const td_image *image, const double pixel[2])
{
    return pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] <= image->width - 1 && pixel[1] <= image->height - 1;
}

/* Mean of five points of the cell whose middle is (x, y). */
static double cell_grey(const td_image *image, const double h[9], double x, double y)
{
    static const double offset[5][2] = {{0, 0}, {-0.2, -0.2}, {0.2, -0.2}, {0.2, 0.2}, {-0.2, 0.2}};
    double sum = 0, pixel[2];
    for (int i = 0; i < 5; i++) {
        to_pixel(pixel, h, x + offset[i][0], y + offset[i][1]);
        sum += td_image_sample(image, pixel[0], pixel[1], 0);
    }
    return sum / 5;
}

bool td_tag_read(tag_levels *levels, const td_image *image, const td_tag *tag, const tag_codes *codes)
{
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    double grey[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS], h[9], sum[2] = {0}, level[2];
    const int side = td_tag_side(codes, tag->border);
    int n[2] = {0};
    for (int k = 0; k < 4; k++)
        if (!inside(image, tag->corner + 2 * k)) return false;
    if (!tag_homography(h, tag, side)) return false;
    td_tag_code_cells(cell, codes->code[tag->id], codes->side, tag->border);
    for (int i = 0; i < side * side; i++) {
        grey[i] = cell_grey(image, h, i % side + 0.5, i / side + 0.5);
        sum[cell[i]] += grey[i];
        n[cell[i]]++;
    }
    if (!n[1]) return false;
    for (int k = 0; k < 2; k++) level[k] = sum[k] / n[k];
    *levels = (tag_levels){.dark = level[0], .light = level[1]};
    for (int i = 0; i < side * side; i++)
        levels->wrong += (grey[i] > (level[0] + level[1]) / 2) != (cell[i] == 1);
    return true;
}

bool td_tag_is_read(const tag_levels *levels, const td_tag *tag, const tag_codes *codes)
{
    const int side = td_tag_side(codes, tag->border);
    return levels->light - levels->dark > LEAST_CONTRAST && levels->wrong <= MOST_WRONG * side * side;
}

bool td_tag_is_of_border(const td_image *image, const td_tag *tag, const tag_codes *codes)
{
    td_tag other = *tag;
    tag_levels own, others;
    const double cells = td_tag_side(codes, tag->border);
    other.border = 3 - tag->border;
    const double other_cells = td_tag_side(codes, other.border);
    if (!td_tag_read(&own, image, tag, codes) || !td_tag_is_read(&own, tag, codes)) return false;
    if (!td_tag_read(&others, image, &other, codes)) return true;
    return own.wrong / (cells * cells) <= others.wrong / (other_cells * other_cells);
}

/* ---- corners ---- */

/* The frame of corner k: a cell's length along the sides that begin there, by the homography's derivative. */
static void corner_frame(tag_shape *shape, const double h[9], int side, int k)
{
    static const int step[4][2][2] = {
        {{1, 0}, {0, 1}}, {{0, 1}, {-1, 0}}, {{-1, 0}, {0, -1}}, {{0, -1}, {1, 0}}};
    const double x = k == 1 || k == 2 ? side : 0, y = k >= 2 ? side : 0;
    const double w = h[6] * x + h[7] * y + h[8];
    double at[2];
    to_pixel(at, h, x, y);
    for (int i = 0; i < 2; i++)
        for (int c = 0; c < 2; c++)
            shape->along[i][c] =
                ((h[3 * c] - at[c] * h[6]) * step[k][i][0] + (h[3 * c + 1] - at[c] * h[7]) * step[k][i][1]) /
                w;
}

/* Whether a dark square touches the corner from outside. */
static bool is_touched(const td_image *image, const td_tag *tag, const tag_shape *shape, int k,
                       const tag_levels *levels)
{
    const double away = -0.7; /* cells */
    double pixel[2];
    for (int c = 0; c < 2; c++)
        pixel[c] = tag->corner[2 * k + c] + away * (shape->along[0][c] + shape->along[1][c]);
    return td_image_sample(image, pixel[0], pixel[1], 0) < (levels->dark + levels->light) / 2;
}

/* Fits the corner as it seems to be; where that leaves much unexplained, in other ways too, of which the one
 * that leaves least is taken: another print may stand nearer than was thought, or only seem to touch. */
static bool measure_corner(td_corner *best, const td_image *image, const td_tag *tag, tag_shape *shape, int k,
                           const tag_levels *levels, double outside)
{
    const bool wedge = !is_touched(image, tag, shape, k, levels);
    const struct {
        bool wedge;
        double outside; /* cells, where it is not known */
    } way[] = {{wedge, wedge ? UNKNOWN_OUTSIDE : SQUARE_OUTSIDE},
               {!wedge, wedge ? SQUARE_OUTSIDE : UNKNOWN_OUTSIDE},
               {true, NARROW_OUTSIDE}};
    double least = INFINITY; /* of the contrast */
    for (size_t i = 0; i < sizeof way / sizeof *way && least > PLAIN_RESIDUAL; i++) {
        td_corner corner;
        shape->wedge = way[i].wedge;
        shape->outside = outside > 0 ? outside : way[i].outside;
        if (!td_corner_refine_tag(&corner, image, tag->corner + 2 * k, shape)) continue;
        double left = corner.residual / corner.contrast;
        if (!(left < BETTER * least)) continue;
        least = left;
        *best = corner;
    }
    return isfinite(least);
}

static double median_of_four(const double x[4], int n)
{
    double s[4] = {x[0], x[1], x[2], x[3]};
    for (int i = 1; i < n; i++)
        for (int k = i; k > 0 && s[k] < s[k - 1]; k--) {
            double swap = s[k];
            s[k] = s[k - 1];
            s[k - 1] = swap;
        }
    return n ? (s[n / 2] + s[(n - 1) / 2]) / 2 : NAN;
}

void td_tag_measure(td_tag *tag, double inflation[2], const td_image *image, const tag_codes *codes,
                    double outside)
{
    const int side = td_tag_side(codes, tag->border);
    double h[9], blur[4] = {0}, position[8];
    int n = 0;
    tag_levels levels;
    for (int k = 0; k < 4; k++) tag->sigma[k] = 0;
    tag->blur = NAN;
    if (!td_tag_read(&levels, image, tag, codes) || !tag_homography(h, tag, side)) return;
    for (int k = 0; k < 8; k++) position[k] = tag->corner[k];
    for (int k = 0; k < 4; k++) {
        td_corner corner = {0};
        tag_shape shape = {.side = side, .inside = tag->border};
        corner_frame(&shape, h, side, k);
        if (!measure_corner(&corner, image, tag, &shape, k, &levels, outside)) continue;
        for (int c = 0; c < 2; c++) position[2 * k + c] = corner.position[c];
        tag->sigma[k] = corner.white;
        blur[n++] = corner.blur;
        inflation[0] += (corner.sigma / corner.white) * (corner.sigma / corner.white);
        inflation[1]++;
    }
    for (int k = 0; k < 8; k++) tag->corner[k] = position[k];
    tag->blur = median_of_four(blur, n);
}
