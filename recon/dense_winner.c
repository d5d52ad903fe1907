/* The winner of each pixel: checked from the right image and refined to a fraction of a pixel. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/dense_internal.h"

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

/* The two lines of equal slope through the three least costs meet off the middle by half the ratio of the
 * slopes' difference to the steeper one (Shimizu & Okutomi 2001): costs that grow with the distance make a V,
 * which a parabola would pull to whole pixels. What is left of the pull is periodic in the true fraction; its
 * first harmonic, an even 1/20 px on pairs with known disparities, is taken off. */
void dense_winner_fractions(int8_t fraction[2 * DENSE_FRACTIONS + 1])
{
    const double PI = 3.14159265358979, pull = 0.05;
    for (int k = -DENSE_FRACTIONS; k <= DENSE_FRACTIONS; k++) {
        double off = 0.5 * k / DENSE_FRACTIONS;
        fraction[DENSE_FRACTIONS + k] = (int8_t)lrint(DENSE_ONE * (off + pull * sin(2 * PI * off)));
    }
}

/* Disparities of the right image, read off the winners: of those that meet in a right pixel, the cheapest.
 * meeting (width + stride): cost and level at x - level + stride. */
static void project(uint32_t *meeting, const dense_row *row)
{
    memset(meeting, 255, (size_t)(row->width + row->stride) * sizeof *meeting);
    for (int x = 0; x < row->width; x++) {
        uint32_t *to = meeting + row->stride + x - row->level[x];
        uint32_t mine = (uint32_t)row->least[x] << 16 | row->level[x];
        *to = MIN(*to, mine);
    }
}

void dense_winner_row(const dense_loops *loops, int16_t *disparity, uint8_t *curvature, const dense_row *row,
                      const int8_t fraction[2 * DENSE_FRACTIONS + 1], int lowest, bool left_check,
                      uint32_t *meeting, uint8_t *place)
{
    loops->places(place, curvature, row->least, row->before, row->after, row->width);
    if (left_check) project(meeting, row);
    for (int x = 0; x < row->width; x++) {
        int level = row->level[x], to = x - lowest - level;
        int at = MAX(level * DENSE_ONE + fraction[place[x]], 0);
        bool seen = to >= 0 && to < row->width;
        if (left_check) seen &= abs((int)(meeting[row->stride + x - level] & 0xffff) - level) <= 1;
        disparity[x] = (int16_t)(seen ? at : DENSE_NONE);
    }
}
