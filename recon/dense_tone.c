/* Exposure and black level of the two cameras may differ; the difference of grey values is worth nothing
 * then. So a small version of the pair is matched by census alone, which does not see exposure, and a line is
 * fitted through the grey values of what met. */
#include <math.h>

#include "recon/dense_internal.h"

enum {
    ROUNDS = 3,
    FEWEST = 200, /* matched pixels, else exposures are taken to be the same */
    DARK = 3,
    BRIGHT = 252 /* beyond these a camera cuts off */
};

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

typedef struct line {
    double gain, offset, spread; /* left = gain right + offset */
} line;

/* Least squares over the pairs that lie within 2 standard deviations of the line so far. */
static line fit_once(line so_far, const td_image *left, const td_image *right, const dense_map *map,
                     int lowest)
{
    double n = 0, a = 0, b = 0, ab = 0, bb = 0, aa = 0;
    for (int y = 0; y < map->height; y++)
        for (int x = 0; x < map->width; x++) {
            size_t at = (size_t)y * (size_t)map->width;
            int d = map->disparity[at + (size_t)x];
            int to = x - lowest - (d + DENSE_ONE / 2) / DENSE_ONE;
            if (d < 0 || to < 0 || to >= map->width) continue;
            double p = left->data[at + (size_t)x], q = right->data[at + (size_t)to];
            if (MIN(p, q) < DARK || MAX(p, q) > BRIGHT) continue;
            if (fabs(p - so_far.gain * q - so_far.offset) > 2 * so_far.spread) continue;
            n++, a += p, b += q, aa += p * p, ab += p * q, bb += q * q;
        }
    if (n < FEWEST) return so_far;
    double sab = ab - a * b / n, sbb = bb - b * b / n, saa = aa - a * a / n;
    line l = {.gain = sbb > n ? sab / sbb : 1};
    l.offset = (a - l.gain * b) / n;
    l.spread = sqrt(fmax(saa - l.gain * sab, 0) / n) + 0.5;
    return l;
}

void dense_tone_fit(uint8_t tone[256], const td_image *left, const td_image *right, const dense_map *map,
                    int lowest)
{
    line l = {.gain = 1, .spread = INFINITY};
    for (int k = 0; k < ROUNDS; k++) l = fit_once(l, left, right, map, lowest);
    for (int value = 0; value < 256; value++) {
        double mapped = l.gain * value + l.offset;
        tone[value] = (uint8_t)(mapped < 0 ? 0 : mapped > 255 ? 255 : mapped + 0.5);
    }
}
