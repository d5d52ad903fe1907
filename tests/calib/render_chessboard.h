/* Chessboards with known corners, rendered without anything of the library's corner model.
 *
 * A pixel is the mean of the board's colours at points around its centre: offsets drawn from the pixel's
 * square plus a Gaussian blur, by a low-discrepancy sequence (Roberts' generalised golden ratio). Every
 * offset comes with its opposite, so that a straight edge stays exactly where it is, whatever its direction.
 */
#ifndef TELEDIMOS_TESTS_RENDER_CHESSBOARD_H
#define TELEDIMOS_TESTS_RENDER_CHESSBOARD_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/random.h"

static const double SCENE_PI = 3.14159265358979323846;

typedef struct scene {
    int width, height;          /* px */
    int columns, rows;          /* inner corners, at (0, 0) to (columns - 1, rows - 1) of the board */
    bool light_first;           /* the square before corner (0, 0) is light */
    double image_from_board[9]; /* homography: squares to px */
    double board_from_image[9];
    double blur;        /* px */
    double dark, light; /* grey levels */
    int pairs;          /* of offsets */
} scene;

static inline void scene_apply(double out[2], const double h[9], double x, double y)
{
    double w = 1 / (h[6] * x + h[7] * y + h[8]);
    out[0] = (h[0] * x + h[1] * y + h[2]) * w;
    out[1] = (h[3] * x + h[4] * y + h[5]) * w;
}

static inline void scene_invert(double inverse[9], const double h[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            inverse[3 * i + j] = h[3 * a + c] * h[3 * b + d] - h[3 * a + d] * h[3 * b + c];
        }
}

/* The board's middle at the image's middle, squares of `square` px there, turned by `turn` in the image and
 * leant back by `tilt` about an axis at `axis` (rad). */
static inline void scene_place(scene *s, double square, double turn, double tilt, double axis)
{
    const double focal = 8; /* in squares: strong perspective */
    double ct = cos(turn), st = sin(turn), ca = cos(axis), sa = sin(axis), c = cos(tilt), z = sin(tilt);
    double mx = (s->columns - 1) / 2.0, my = (s->rows - 1) / 2.0;
    double size = fmax(s->columns, s->rows);
    for (int k = 0; k < 3; k++) {
        double bx = k == 0 ? 1 : k == 2 ? -mx : 0, by = k == 1 ? 1 : k == 2 ? -my : 0;
        double u = ct * bx - st * by, v = st * bx + ct * by;
        double along = ca * u + sa * v, across = -sa * u + ca * v;
        double x = ca * along - sa * c * across, y = sa * along + ca * c * across;
        double w = z * across / (focal * size / 8) + (k == 2 ? 1 : 0);
        s->image_from_board[k] = square * x + (s->width - 1) / 2.0 * w;
        s->image_from_board[3 + k] = square * y + (s->height - 1) / 2.0 * w;
        s->image_from_board[6 + k] = w;
    }
    scene_invert(s->board_from_image, s->image_from_board);
}

/* floor, quicker, for |v| < 10000. */
static inline int scene_floor(double v)
{
    return (int)(v + 10000) - 10000;
}

static inline double scene_colour(const scene *s, double x, double y)
{
    double p[2];
    scene_apply(p, s->board_from_image, x, y);
    if (p[0] < -1 || p[1] < -1 || p[0] >= s->columns || p[1] >= s->rows) return s->light;
    bool odd = (scene_floor(p[0]) + scene_floor(p[1])) & 1;
    return odd == s->light_first ? s->dark : s->light;
}

/* Whether no edge comes within `reach` of a pixel: the squares met in eight directions are those at the
 * centre. */
static inline bool scene_flat(const scene *s, double x, double y, double reach)
{
    double p[2], q[2];
    scene_apply(p, s->board_from_image, x, y);
    for (int i = 0; i < 8; i++) {
        double a = i * SCENE_PI / 4;
        scene_apply(q, s->board_from_image, x + 1.1 * reach * cos(a), y + 1.1 * reach * sin(a));
        if (scene_floor(q[0]) != scene_floor(p[0]) || scene_floor(q[1]) != scene_floor(p[1])) return false;
    }
    return true;
}

/* (pairs,2) offsets, px. */
static inline double *scene_offsets(const scene *s)
{
    double *offset = malloc(2 * (size_t)s->pairs * sizeof *offset),
           phi = 1.1673039782614187; /* x^5 = x + 1 */
    for (int i = 0; i < s->pairs; i++) {
        double u[4], step = 1;
        for (int k = 0; k < 4; k++) {
            step /= phi;
            u[k] = fmod(0.5 + (i + 1) * step, 1);
        }
        double r = s->blur * sqrt(-2 * log(1 - u[0]));
        offset[2 * i] = r * cos(2 * SCENE_PI * u[1]) + u[2] - 0.5;
        offset[2 * i + 1] = r * sin(2 * SCENE_PI * u[1]) + u[3] - 0.5;
    }
    return offset;
}

/* Grey levels (height,width), neither rounded nor noisy. To be freed with free(). */
static inline double *scene_render(const scene *s)
{
    double *grey = malloc((size_t)s->width * (size_t)s->height * sizeof *grey), *offset = scene_offsets(s);
    for (int y = 0; y < s->height; y++)
        for (int x = 0; x < s->width; x++) {
            double *g = &grey[y * s->width + x];
            *g = scene_colour(s, x, y);
            if (scene_flat(s, x, y, 4 * s->blur + 0.8)) continue;
            double sum = 0;
            for (int i = 0; i < s->pairs; i++) {
                const double *o = offset + 2 * i;
                sum += scene_colour(s, x + o[0], y + o[1]) + scene_colour(s, x - o[0], y - o[1]);
            }
            *g = sum / (2 * s->pairs);
        }
    free(offset);
    return grey;
}

/* Adds white noise and rounds to 8 bits. */
static inline void scene_expose(uint8_t *image, const double *grey, const scene *s, double noise,
                                td_random *random)
{
    for (int i = 0; i < s->width * s->height; i++) {
        double g = grey[i] + (noise > 0 ? noise * td_random_normal(random) : 0);
        image[i] = (uint8_t)fmin(fmax(round(g), 0), 255);
    }
}

static inline void scene_corner(double p[2], const scene *s, int column, int row)
{
    scene_apply(p, s->image_from_board, column, row);
}

#endif
