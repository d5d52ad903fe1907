/* The inner loops of dense_paths.c for processors with AVX2: 32 disparities at once, the same bytes. This
 * file alone is compiled for AVX2, and called after the processor was asked. */
#if defined(__x86_64__)

#include <immintrin.h>
#include <string.h>

#include "recon/dense_loops_internal.h"

enum { MAX_VECTORS = DENSE_MAX_LEVELS / DENSE_LANES + 2 };

typedef struct constants {
    __m256i nibble, count, twice, cut, p1;
} constants;

static inline __m256i load(const uint8_t *p)
{
    return _mm256_loadu_si256((const __m256i *)(const void *)p);
}

static inline void store(uint8_t *p, __m256i v)
{
    _mm256_storeu_si256((__m256i *)(void *)p, v);
}

static inline __m256i all(uint8_t value)
{
    return _mm256_set1_epi8((char)value);
}

static inline constants constants_new(void)
{
    const __m128i count = _mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4);
    __m256i bits = _mm256_broadcastsi128_si256(count);
    return (constants){all(15), bits, _mm256_add_epi8(bits, bits), all(DENSE_CUT), all(DENSE_P1)};
}

/* The least of 32 bytes, in all 32. */
static inline __m256i least_of(__m256i v)
{
    __m128i m = _mm_min_epu8(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1));
    m = _mm_min_epu8(m, _mm_srli_epi16(m, 8));
    return _mm256_broadcastb_epi8(_mm_minpos_epu16(m));
}

/* Bytes one disparity lower and one higher; what lies outside comes from the vectors beside. */
static inline __m256i lower(__m256i before, __m256i here)
{
    return _mm256_alignr_epi8(here, _mm256_permute2x128_si256(before, here, 0x21), 15);
}

static inline __m256i higher(__m256i here, __m256i after)
{
    return _mm256_alignr_epi8(_mm256_permute2x128_si256(here, after, 0x21), here, 1);
}

/* Bits of three bytes are counted as one sum and one carry of each place: two counts instead of three. */
static inline __m256i cost_of(const constants *c, const __m256i left[DENSE_PLANES],
                              const uint8_t *const right[DENSE_PLANES], int d)
{
    __m256i a = _mm256_xor_si256(left[0], load(right[0] + d)),
            b = _mm256_xor_si256(left[1], load(right[1] + d));
    __m256i e = _mm256_xor_si256(left[2], load(right[2] + d)), grey = load(right[3] + d);
    __m256i ab = _mm256_xor_si256(a, b), sum = _mm256_xor_si256(ab, e);
    __m256i carry = _mm256_or_si256(_mm256_and_si256(a, b), _mm256_and_si256(e, ab));
    __m256i n0 = _mm256_shuffle_epi8(c->count, _mm256_and_si256(sum, c->nibble));
    __m256i n1 = _mm256_shuffle_epi8(c->count, _mm256_and_si256(_mm256_srli_epi16(sum, 4), c->nibble));
    __m256i n2 = _mm256_shuffle_epi8(c->twice, _mm256_and_si256(carry, c->nibble));
    __m256i n3 = _mm256_shuffle_epi8(c->twice, _mm256_and_si256(_mm256_srli_epi16(carry, 4), c->nibble));
    __m256i off = _mm256_or_si256(_mm256_subs_epu8(left[3], grey), _mm256_subs_epu8(grey, left[3]));
    off = _mm256_min_epu8(off, c->cut);
    return _mm256_add_epi8(_mm256_add_epi8(_mm256_add_epi8(n0, n1), _mm256_add_epi8(n2, n3)), off);
}

static inline __m256i step(__m256i below, __m256i here, __m256i over, __m256i least, __m256i jump, __m256i p1,
                           __m256i cost)
{
    __m256i beside = _mm256_adds_epu8(_mm256_min_epu8(below, over), p1);
    __m256i best = _mm256_min_epu8(_mm256_min_epu8(here, beside), jump);
    return _mm256_adds_epu8(_mm256_sub_epi8(best, least), cost);
}

/* The pixels of a tile, all of `n` vectors. The path's values are in `run` (n vectors), its least returned.
 */
static inline __m256i forward_span(const dense_row *of, int x0, int x1, int first, int n, __m256i *run,
                                   __m256i least)
{
    const dense_row whole = *of, *row = &whole; /* a copy: no byte that is written can be part of it */
    const constants c = constants_new();
    const __m256i far = all(255);
    for (int x = x0; x < x1; x++) {
        size_t at = (size_t)x * (size_t)row->stride + (size_t)first;
        uint8_t *cost = row->cost + at, *sum = row->sum + at, *above = row->above + at;
        const uint8_t *right[DENSE_PLANES], *veil = row->veil + first;
        __m256i left[DENSE_PLANES];
        for (int k = 0; k < DENSE_PLANES; k++) {
            left[k] = all(row->left[k][x]);
            right[k] = row->right[k] + row->width - 1 - x + first;
        }
        __m256i jump = _mm256_adds_epu8(least, all(row->across[x]));
        __m256i up_least = all(row->above_least[x]);
        __m256i up_jump = _mm256_adds_epu8(up_least, all(row->down[x]));
        __m256i new_least = far, new_up = far, before = far, up_below = load(above - 1);
        for (int k = 0; k < n; k++) {
            int d = DENSE_LANES * k;
            __m256i price = cost_of(&c, left, right, d);
            if (k == n - 1)
                price = _mm256_or_si256(price, load(veil + d)); /* the others are asked for whole */
            store(cost + d, price);
            __m256i here = run[k], after = k + 1 < n ? run[k + 1] : far;
            __m256i across = step(lower(before, here), here, higher(here, after), least, jump, c.p1, price);
            before = here;
            run[k] = across;
            new_least = _mm256_min_epu8(new_least, across);
            __m256i up = load(above + d), up_next = load(above + d + DENSE_LANES - 1);
            __m256i down = step(up_below, up, load(above + d + 1), up_least, up_jump, c.p1, price);
            up_below = up_next;
            store(above + d, down);
            new_up = _mm256_min_epu8(new_up, down);
            store(sum + d, _mm256_adds_epu8(across, down));
        }
        least = least_of(new_least);
        row->above_least[x] = (uint8_t)_mm256_extract_epi8(least_of(new_up), 0);
    }
    return least;
}

static inline __m256i backward_span(const dense_row *of, int x0, int x1, int first, int n, __m256i *run,
                                    __m256i least)
{
    const dense_row whole = *of, *row = &whole;
    const __m256i far = all(255), p1 = all(DENSE_P1);
    for (int x = x1 - 1; x >= x0; x--) {
        size_t at = (size_t)x * (size_t)row->stride + (size_t)first;
        const uint8_t *cost = row->cost + at;
        uint8_t *sum = row->sum + at;
        int next = x + 1 < row->width ? x + 1 : x;
        __m256i jump = _mm256_adds_epu8(least, all(row->across[next]));
        __m256i new_least = far, best = far, before = far;
        for (int k = 0; k < n; k++) {
            int d = DENSE_LANES * k;
            __m256i here = run[k], after = k + 1 < n ? run[k + 1] : far;
            __m256i across =
                step(lower(before, here), here, higher(here, after), least, jump, p1, load(cost + d));
            before = here;
            run[k] = across;
            new_least = _mm256_min_epu8(new_least, across);
            __m256i total = _mm256_adds_epu8(load(sum + d), across);
            store(sum + d, total);
            best = _mm256_min_epu8(best, total);
        }
        least = least_of(new_least);
        best = least_of(best);
        unsigned found = 0;
        int k = -1;
        while (!found)
            found = (unsigned)_mm256_movemask_epi8(_mm256_cmpeq_epi8(load(sum + DENSE_LANES * ++k), best));
        int level = DENSE_LANES * k + __builtin_ctz(found);
        row->level[x] = (uint16_t)(first + level);
        row->least[x] = sum[level];
        row->before[x] = level > 0 ? sum[level - 1] : 255;
        row->after[x] = level + 1 < DENSE_LANES * n ? sum[level + 1] : 255;
    }
    return least;
}

/* Loops of known length keep a path's values in registers. */
#define SPAN_OF_KNOWN_LENGTH(span, row, x0, x1, first, n, run, least)                                        \
    ((n) == 1   ? span(row, x0, x1, first, 1, run, least)                                                    \
     : (n) == 2 ? span(row, x0, x1, first, 2, run, least)                                                    \
     : (n) == 3 ? span(row, x0, x1, first, 3, run, least)                                                    \
     : (n) == 4 ? span(row, x0, x1, first, 4, run, least)                                                    \
                : span(row, x0, x1, first, n, run, least))

static bool same_range(dense_range a, dense_range b)
{
    return a.first == b.first && a.end == b.end;
}

/* Tiles of one range in a row are done in one go. */
static int span_end(const dense_row *row, int tile, int step)
{
    int tiles = (row->width + DENSE_TILE - 1) / DENSE_TILE, end = tile + step;
    while (end >= 0 && end < tiles && same_range(row->range[end], row->range[tile])) end += step;
    return end;
}

static void run_out(uint8_t *to, const __m256i *run, int n)
{
    for (int k = 0; k < n; k++) store(to + DENSE_LANES * k, run[k]);
}

static void run_in(__m256i *run, const uint8_t *from, int n)
{
    for (int k = 0; k < n; k++) run[k] = load(from + DENSE_LANES * k);
}

static void forward_avx2(const dense_row *row)
{
    int tiles = (row->width + DENSE_TILE - 1) / DENSE_TILE;
    __m256i run[MAX_VECTORS], least = all(0);
    memset(row->run, 0, (size_t)row->stride - 2 * DENSE_LANES);
    for (int tile = 0, end; tile < tiles; tile = end) {
        dense_range range = row->range[tile];
        int n = (range.end - range.first) / DENSE_LANES;
        end = span_end(row, tile, 1);
        int x0 = tile * DENSE_TILE, x1 = end < tiles ? end * DENSE_TILE : row->width;
        dense_forget(row->run, row->range[tile ? tile - 1 : 0], range);
        run_in(run, row->run + range.first, n);
        least = SPAN_OF_KNOWN_LENGTH(forward_span, row, x0, x1, range.first, n, run, least);
        run_out(row->run + range.first, run, n);
    }
}

static void backward_avx2(const dense_row *row)
{
    int tiles = (row->width + DENSE_TILE - 1) / DENSE_TILE;
    __m256i run[MAX_VECTORS], least = all(0);
    memset(row->run, 0, (size_t)row->stride - 2 * DENSE_LANES);
    for (int tile = tiles - 1, end; tile >= 0; tile = end) {
        dense_range range = row->range[tile];
        int n = (range.end - range.first) / DENSE_LANES;
        end = span_end(row, tile, -1);
        int x0 = (end + 1) * DENSE_TILE, x1 = tile + 1 < tiles ? (tile + 1) * DENSE_TILE : row->width;
        dense_forget(row->run, row->range[tile + 1 < tiles ? tile + 1 : tile], range);
        run_in(run, row->run + range.first, n);
        least = SPAN_OF_KNOWN_LENGTH(backward_span, row, x0, x1, range.first, n, run, least);
        run_out(row->run + range.first, run, n);
    }
}

static const dense_loops loops_avx2 = DENSE_LOOPS;

const dense_kernel dense_kernel_avx2 = {forward_avx2, backward_avx2, &loops_avx2};

#endif
