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

/* ---- refinement ---- */

static inline __m256 grey_of(__m256i bytes, int shift)
{
    return _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(bytes, shift), _mm256_set1_epi32(255)));
}

static inline __m256 eight_greys(const uint8_t *p)
{
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)p)));
}

static inline __m256 times(__m256 a, __m256 b)
{
    return _mm256_mul_ps(a, b);
}

static inline __m256 plus(__m256 a, __m256 b)
{
    return _mm256_add_ps(a, b);
}

static inline __m256 minus(__m256 a, __m256 b)
{
    return _mm256_sub_ps(a, b);
}

/* Whole eighths, 0 where `with` is. */
static inline void store_eighths(int16_t *to, __m256 grey, __m256 with)
{
    const __m256 most = _mm256_set1_ps(REFINE_MOST), half = _mm256_set1_ps(REFINE_MOST + 0.5f);
    __m256 up = times(grey, _mm256_set1_ps(REFINE_ONE));
    up = _mm256_min_ps(_mm256_max_ps(up, minus(_mm256_setzero_ps(), most)), most);
    __m256i whole = _mm256_sub_epi32(_mm256_cvttps_epi32(plus(up, half)), _mm256_set1_epi32(REFINE_MOST));
    whole = _mm256_and_si256(whole, _mm256_castps_si256(with));
    const __m128i packed = _mm_packs_epi32(_mm256_castsi256_si128(whole), _mm256_extracti128_si256(whole, 1));
    _mm_storeu_si128((__m128i *)(void *)to, packed);
}

/* Eight pixels from x on, as refine_look_span; the four pixels that a look-up needs are one word. */
static inline void look_eight(const dense_look *w, int x)
{
    const __m256 half = _mm256_set1_ps(0.5f), one = _mm256_set1_ps(1), two = _mm256_set1_ps(2),
                 three = _mm256_set1_ps(3), gain = _mm256_set1_ps(w->gain);
    const __m256i place = _mm256_add_epi32(_mm256_set1_epi32(x), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
    const __m256 to = minus(_mm256_cvtepi32_ps(place), _mm256_loadu_ps(w->value + x));
    const __m256i kind = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(w->kind + x)));
    const __m256i matched = _mm256_cmpeq_epi32(kind, _mm256_set1_epi32(TD_DENSE_MATCHED));
    const __m256 last = _mm256_set1_ps((float)(w->width - 2));
    const __m256 inside =
        _mm256_and_ps(_mm256_cmp_ps(to, one, _CMP_GE_OQ), _mm256_cmp_ps(to, last, _CMP_LT_OQ));
    const __m256 with = _mm256_and_ps(_mm256_castsi256_ps(matched), inside);
    const __m256 at = _mm256_blendv_ps(one, to, with);
    const __m256i i = _mm256_cvttps_epi32(at);
    const __m256i four = _mm256_i32gather_epi32((const int *)(const void *)(w->right - 1), i, 1);
    const __m256 t = minus(at, _mm256_cvtepi32_ps(i)), a = grey_of(four, 0), b = grey_of(four, 8),
                 c = grey_of(four, 16), d = grey_of(four, 24), p = minus(c, a);
    const __m256 q =
        minus(plus(minus(times(two, a), times(_mm256_set1_ps(5), b)), times(_mm256_set1_ps(4), c)), d);
    const __m256 s = minus(plus(times(three, minus(b, c)), d), a);
    const __m256 grey = plus(b, times(times(half, t), plus(p, times(t, plus(q, times(t, s))))));
    const __m256 slope = times(half, plus(p, times(t, plus(times(two, q), times(times(three, t), s)))));
    const __m256 beside = times(half, minus(eight_greys(w->left + x + 1), eight_greys(w->left + x - 1)));
    const __m256 down = times(half, minus(eight_greys(w->below + x), eight_greys(w->above + x)));
    const __m256 residual =
        minus(minus(eight_greys(w->left + x), times(gain, grey)), times(_mm256_loadu_ps(w->lift + x), down));
    store_eighths(w->slope + x, times(half, plus(times(gain, slope), beside)), with);
    store_eighths(w->residual + x, residual, with);
    const __m256i taken = _mm256_srli_epi32(_mm256_castps_si256(with), 31);
    _mm_storeu_si128((__m128i *)(void *)(w->with + x),
                     _mm_packs_epi32(_mm256_castsi256_si128(taken), _mm256_extracti128_si256(taken, 1)));
}

static void look_avx2(const dense_look *row)
{
    int x = 1;
    for (; x + 8 < row->width; x += 8) look_eight(row, x);
    refine_look_span(row, x, row->width - 1);
}
#define DENSE_LOOK look_avx2

static const dense_loops loops_avx2 = DENSE_LOOPS;

const dense_kernel dense_kernel_avx2 = {forward_avx2, backward_avx2, &loops_avx2};

#endif
