/* A picture made of characters. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/live.h"

enum { CELL_SIZE = 48 }; /* bytes that a character may take, its colours included */

typedef struct colour {
    unsigned char r, g, b;
} colour;

/* The small picture that the characters show: each holds `per_row` pixels, one above the other. */
typedef struct raster {
    int width, height, per_row;
    colour *pixel; /* (height,width) */
    char *mark;    /* (height,width) 0, or the mark's character */
} raster;

static const colour mark_colour[] = {
    [LIVE_POINT] = {46, 196, 154}, [LIVE_LINE] = {86, 180, 233}, [LIVE_WISH] = {240, 182, 74}};
static const char mark_character[] = {[LIVE_POINT] = 'o', [LIVE_LINE] = '-', [LIVE_WISH] = '+'};

/* The mean over the image's pixels that fall into one of the raster's. */
static colour mean_of(const td_image *image, int x0, int x1, int y0, int y1)
{
    unsigned long sum[3] = {0}, count = (unsigned long)(x1 - x0) * (unsigned long)(y1 - y0);
    const int channels = image->channels;
    for (int y = y0; y < y1; y++) {
        const uint8_t *p = image->data + ((size_t)y * (size_t)image->width + (size_t)x0) * (size_t)channels;
        for (int x = x0; x < x1; x++, p += channels)
            for (int c = 0; c < channels; c++) sum[c] += p[c];
    }
    for (int c = channels; c < 3; c++) sum[c] = sum[0];
    return (colour){(unsigned char)(sum[0] / count), (unsigned char)(sum[1] / count),
                    (unsigned char)(sum[2] / count)};
}

/* Where pixel `i` of `count` begins among `size`; at least one pixel for each. */
static int edge(int i, int count, int size)
{
    return (int)((long)i * size / count);
}

static void fill(raster *r, const td_image *image)
{
    for (int y = 0; y < r->height; y++) {
        const int y0 = edge(y, r->height, image->height), y1 = edge(y + 1, r->height, image->height);
        for (int x = 0; x < r->width; x++) {
            const int x0 = edge(x, r->width, image->width), x1 = edge(x + 1, r->width, image->width);
            r->pixel[y * r->width + x] = mean_of(image, x0, x1 > x0 ? x1 : x0 + 1, y0, y1 > y0 ? y1 : y0 + 1);
        }
    }
}

static void put(raster *r, double x, double y, int kind)
{
    if (!(x >= 0 && y >= 0 && x < r->width && y < r->height)) return;
    const int at = (int)y * r->width + (int)x;
    r->pixel[at] = mark_colour[kind];
    r->mark[at] = mark_character[kind];
}

static void draw(raster *r, const td_image *image, const live_mark *m)
{
    const double sx = (double)r->width / image->width, sy = (double)r->height / image->height;
    const double x = ((double)m->x + 0.5) * sx, y = ((double)m->y + 0.5) * sy;
    if ((unsigned)m->kind > LIVE_WISH || !isfinite(x + y)) return;
    if (m->kind == LIVE_POINT) {
        put(r, x, y, m->kind);
        return;
    }
    const double dx = ((double)m->x2 + 0.5) * sx - x, dy = ((double)m->y2 + 0.5) * sy - y;
    const double longest = fmax(fabs(dx), fabs(dy));
    if (!(longest < 1e5)) return;
    const int steps = (int)ceil(longest) + 1;
    for (int i = 0; i <= steps; i++) {
        const double t = (double)i / steps;
        put(r, x + t * dx, y + t * dy, m->kind);
    }
}

/* As large as fits, the picture's shape kept: a character is twice as high as wide. */
static void choose_size(raster *r, const td_image *image, int columns, int rows, bool in_colour)
{
    const double ratio = (double)image->height / image->width;
    const double across = fmin(columns, 2.0 * rows / ratio);
    r->per_row = in_colour ? 2 : 1;
    r->width = (int)fmin(fmax(1, floor(across + 1e-9)), image->width);
    int height_rows = (int)fmin(fmax(1, round(r->width * ratio / 2)), rows);
    r->height = height_rows * r->per_row;
}

static size_t write_blocks(char *out, const raster *r, int row)
{
    size_t used = 0;
    const colour *up = r->pixel + 2 * row * r->width, *down = up + r->width;
    for (int x = 0; x < r->width; x++) {
        if (x == 0 || memcmp(&up[x], &up[x - 1], sizeof *up) != 0)
            used += (size_t)sprintf(out + used, "\033[38;2;%d;%d;%dm", up[x].r, up[x].g, up[x].b);
        if (x == 0 || memcmp(&down[x], &down[x - 1], sizeof *down) != 0)
            used += (size_t)sprintf(out + used, "\033[48;2;%d;%d;%dm", down[x].r, down[x].g, down[x].b);
        used += (size_t)sprintf(out + used, "▀");
    }
    return used + (size_t)sprintf(out + used, "\033[0m\n");
}

static size_t write_grey(char *out, const raster *r, int row)
{
    static const char ramp[] = " .:-=+*#%@";
    enum { STEPS = sizeof ramp - 1 };
    const colour *p = r->pixel + row * r->width;
    const char *mark = r->mark + row * r->width;
    for (int x = 0; x < r->width; x++) {
        const int luma = (299 * p[x].r + 587 * p[x].g + 114 * p[x].b) / 1000;
        out[x] = mark[x] ? mark[x] : ramp[luma * STEPS / 256];
    }
    out[r->width] = '\n';
    return (size_t)r->width + 1;
}

char *live_text(const td_image *image, const live_mark *mark, size_t mark_count, int columns, int rows,
                bool in_colour)
{
    raster r;
    choose_size(&r, image, columns < 1 ? 1 : columns, rows < 1 ? 1 : rows, in_colour);
    const size_t count = (size_t)r.width * (size_t)r.height;
    r.pixel = malloc(count * sizeof *r.pixel);
    r.mark = calloc(count, 1);
    const size_t lines = (size_t)(r.height / r.per_row);
    char *text = malloc(lines * ((size_t)r.width * (in_colour ? CELL_SIZE : 1) + 8) + 1);
    size_t used = 0;
    if (r.pixel && r.mark && text) {
        fill(&r, image);
        for (size_t i = 0; i < mark_count; i++) draw(&r, image, mark + i);
        for (int row = 0; row < (int)lines; row++)
            used += in_colour ? write_blocks(text + used, &r, row) : write_grey(text + used, &r, row);
        text[used] = 0;
    } else {
        free(text);
        text = NULL;
    }
    free(r.pixel);
    free(r.mark);
    return text;
}
