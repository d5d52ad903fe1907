/* The order in which points are inserted into a triangulation: rounds of a biased randomised insertion
 * (Amenta, Choi and Rote 2003), each three times as many points as all before it, and within a round along
 * Hilbert's curve, so that the next point is near the last. The rounds keep points on one curve, such as a
 * contour, from taking quadratic time. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/tin_internal.h"

enum {
    AXIS_BITS = 12, /* of the curve along each axis: 16 million squares */
    SAMPLE = 1024,  /* points by which an axis is shared out */
    ROUND_BITS = 4,
    DIGIT_BITS = 10,
    DIGITS = 3, /* of a key: 2 * 12 + 4 bits are less than 3 * 10 */
    BUCKETS = 1 << DIGIT_BITS
};

typedef struct keyed {
    uint64_t key;
    uint32_t index;
} keyed;

/* Place of cell (x, y) along Hilbert's curve, two bits a step: `turned` and `flipped` say how the curve's
 * part in the present square lies. */
static uint64_t along_curve(uint32_t x, uint32_t y)
{
    uint64_t place = 0;
    for (int bit = AXIS_BITS - 1; bit >= 0; bit--) {
        const uint32_t right = x >> bit & 1, up = y >> bit & 1;
        place = place << 2 | ((3 * right) ^ up);
        /* In the lower half the part is mirrored at a diagonal: without branches, for no one foretells them.
         */
        const uint32_t flip = 0 - (right & (up ^ 1)), swap = (x ^ y) & (0 - (up ^ 1));
        x ^= flip;
        y ^= flip;
        x ^= swap;
        y ^= swap;
    }
    return place;
}

static uint32_t scrambled(uint32_t h)
{
    h = (h ^ h >> 16) * 0x85ebca6bu;
    h = (h ^ h >> 13) * 0xc2b2ae35u;
    return h ^ h >> 16;
}

/* 0 for one point in 4^15, 15 for three in four: by the number of trailing zeros of a scrambled index. */
static uint64_t round_of(uint32_t index)
{
    uint32_t h = scrambled(index + 1);
    uint64_t round = (1 << ROUND_BITS) - 1;
    for (; round > 0 && (h & 3) == 0; h >>= 2) round--;
    return round;
}

static int by_value(const void *a, const void *b)
{
    const double p = *(const double *)a, q = *(const double *)b;
    return (p > q) - (p < q);
}

/* An axis shared out so that each part holds about as many points: neither a point far off nor clusters far
 * from each other leave many in one square of the curve. */
typedef struct axis {
    double knot[SAMPLE], scale[SAMPLE]; /* from a knot on, places of the curve per unit */
} axis;

static void share_out(axis *a, const double (*xyz)[3], const uint32_t *index, size_t n, int k)
{
    const double part = (double)(1 << AXIS_BITS) / SAMPLE;
    for (uint32_t i = 0; i < SAMPLE; i++) a->knot[i] = xyz[index[scrambled(i) % n]][k];
    qsort(a->knot, SAMPLE, sizeof *a->knot, by_value);
    for (int i = 0; i < SAMPLE; i++) {
        const double next = i + 1 < SAMPLE ? a->knot[i + 1] : a->knot[i];
        a->scale[i] = next > a->knot[i] ? part / (next - a->knot[i]) : 0;
    }
}

static uint32_t place_on(const axis *a, double u)
{
    int low = 0;
    for (int step = SAMPLE / 2; step > 0; step /= 2) low += a->knot[low + step] <= u ? step : 0;
    const double beyond = (u - a->knot[low]) * a->scale[low];
    const double part = (double)(1 << AXIS_BITS) / SAMPLE;
    return (uint32_t)(low * part + fmin(fmax(beyond, 0), part - 1));
}

static void make_keys(keyed *key, axis *axes, const double (*xyz)[3], const uint32_t *index, size_t n)
{
    for (int k = 0; k < 2; k++) share_out(&axes[k], xyz, index, n, k);
    for (size_t i = 0; i < n; i++) {
        const double *p = xyz[index[i]];
        key[i].key = round_of((uint32_t)i) << 2 * AXIS_BITS |
                     along_curve(place_on(&axes[0], p[0]), place_on(&axes[1], p[1]));
        key[i].index = index[i];
    }
}

/* A stable sort by the digits of the key, the lowest first; `other` (n) is room. Returns where the result is.
 */
static const keyed *sort_keys(keyed *key, keyed *other, size_t n, size_t (*bucket)[BUCKETS])
{
    memset(bucket, 0, DIGITS * sizeof *bucket);
    for (size_t i = 0; i < n; i++)
        for (int d = 0; d < DIGITS; d++) bucket[d][key[i].key >> d * DIGIT_BITS & (BUCKETS - 1)]++;
    for (int d = 0; d < DIGITS; d++) {
        size_t begin = 0;
        for (int b = 0; b < BUCKETS; b++) {
            const size_t size = bucket[d][b];
            bucket[d][b] = begin;
            begin += size;
        }
        for (size_t i = 0; i < n; i++)
            other[bucket[d][key[i].key >> d * DIGIT_BITS & (BUCKETS - 1)]++] = key[i];
        keyed *swap = key;
        key = other;
        other = swap;
    }
    return key;
}

bool td_tin_order(double (*xy)[2], uint32_t *index, const double (*xyz)[3], size_t n)
{
    keyed *key = malloc(2 * (n + 1) * sizeof *key);
    size_t(*bucket)[BUCKETS] = malloc(DIGITS * sizeof *bucket);
    axis *axes = malloc(2 * sizeof *axes);
    const bool fine = key && bucket && axes && n > 0;
    if (fine) {
        make_keys(key, axes, xyz, index, n);
        const keyed *sorted = sort_keys(key, key + n, n, bucket);
        for (size_t i = 0; i < n; i++) {
            index[i] = sorted[i].index;
            memcpy(xy[i], xyz[sorted[i].index], sizeof xy[i]);
        }
    }
    free(key);
    free(bucket);
    free(axes);
    return fine;
}
