/* What the files of dense matching share: planes of the two images, the rows that are matched, and the map on
 * its way. Disparities count from the lowest one; in the map they are in 1/32 px. */
#ifndef TELEDIMOS_RECON_DENSE_INTERNAL_H
#define TELEDIMOS_RECON_DENSE_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "recon/dense.h"

#ifdef __cplusplus
#define restrict
extern "C" {
#endif

enum {
    DENSE_LANES = 32,        /* disparities that are handled at once */
    DENSE_ONE = 32,          /* a pixel in the map's unit */
    DENSE_NONE = -1,         /* no disparity */
    DENSE_PLANES = 4,        /* three bytes of census, one of grey */
    DENSE_TILE = 32,         /* px, side of a tile with a range of its own */
    DENSE_MAX_LEVELS = 1008, /* in 1/32 px they fit 16 bits */
    DENSE_MAX_LOWEST = 16384,
    DENSE_CUT = 10, /* grey values that differ by more only say "different" */
    DENSE_P1 = 14,  /* penalty of a step of one disparity from pixel to pixel */
    DENSE_P2 = 72,  /* of a jump, where grey values are even */
    DENSE_FRACTIONS = 64,
    DENSE_MEAN_OF = 9 /* pixels of the last smoothing */
};

/* An image as it is matched. The right one's rows are reversed, so that with rising disparity the address
 * rises, and go on past the border. */
typedef struct dense_planes {
    int height, stride;
    int origin;                   /* element of disparity 0 of the last left pixel */
    uint8_t *plane[DENSE_PLANES]; /* (height,stride) */
} dense_planes;

/* Disparities searched in a tile. */
typedef struct dense_range {
    uint16_t first, end; /* end - first is a multiple of DENSE_LANES */
} dense_range;

/* What is known of each pixel after its disparities were compared. */
typedef struct dense_map {
    int width, height;
    int16_t *disparity; /* (height,width) 1/32 px or DENSE_NONE */
    uint8_t *kind;      /* (height,width) td_dense_kind */
    uint8_t *least;     /* (height,width) summed cost of the winner */
    uint8_t *curvature; /* (height,width) how much the two beside it cost more, together */
} dense_map;

/* A row on its way through the paths. Volumes have `stride` bytes a pixel, disparity d at DENSE_LANES + d. */
typedef struct dense_row {
    int width, stride;
    const uint8_t *left[DENSE_PLANES];
    const uint8_t *right[DENSE_PLANES]; /* at width - 1 - x + d is what the left pixel x meets at d */
    const uint8_t *across, *down;       /* penalty of a jump from x - 1 to x, from the row above */
    const uint8_t *veil;                /* (stride) 255 for disparities that are not asked for */
    const dense_range *range;           /* (tiles) */
    uint8_t *cost, *sum, *above;        /* (width,stride) */
    uint8_t *above_least;               /* (width) */
    uint8_t *run;                       /* (2,stride) */
    uint16_t *level;                    /* (width) results */
    uint8_t *least, *before, *after;
} dense_row;

/* A row that is looked up in the right image, each pixel at its own disparity. */
typedef struct dense_look {
    int width;
    const float *value;           /* (width) px */
    const uint8_t *kind;          /* (width) td_dense_kind */
    const uint8_t *left, *right;  /* (width) */
    const uint8_t *above, *below; /* (width) rows of the left image */
    const float *lift;            /* (width) px, how far the right row is off the left one */
    float gain;                   /* right to left */
    int16_t *slope, *residual;    /* (width) 1/8 grey level a pixel; 1/8 grey level; 0 where */
    int16_t *with;                /* (width) 0: the pixel takes no part */
} dense_look;

/* What is known of a row's pixels, and of the pair, for sigma. */
typedef struct dense_trust {
    const float *variance; /* (width) grey levels^2, of the residuals in the window; negative: no fit */
    const float *weight;   /* (width) 1 / G_gg */
    const float *bend;     /* (width) px^2 */
    const uint8_t *grey;   /* (width) */
    float base, rate;      /* of dense_noise */
    float rows;            /* px^2, mean square of the rows' offset */
} dense_trust;

/* Loops over a row (dense_loops_internal.h, dense_refine_loops_internal.h). */
typedef struct dense_loops {
    void (*census)(uint8_t *restrict code, const uint8_t *centre, const uint8_t *const neighbour[8],
                   int width);
    void (*penalties)(uint8_t *restrict p2, const uint8_t *a, const uint8_t *b, int count);
    void (*places)(uint8_t *restrict place, uint8_t *restrict curvature, const uint8_t *restrict least,
                   const uint8_t *restrict before, const uint8_t *restrict after, int width);
    void (*median)(int16_t *restrict to, const int16_t *restrict up, const int16_t *restrict here,
                   const int16_t *restrict down, int16_t *restrict work, int width);
    void (*neighbours)(int16_t *restrict sum, int16_t *restrict spread, const int16_t *here,
                       const int16_t *const there[4], int count);
    void (*convert)(float *restrict value, float *restrict sigma, const int16_t *restrict disparity,
                    const uint8_t *restrict kind, const uint8_t *restrict curvature,
                    const uint8_t *restrict least, const int16_t *restrict sum,
                    const int16_t *restrict spread, float lowest, int width);
    void (*reverse)(uint8_t *restrict to, const uint8_t *restrict from, int count);
    void (*smooth)(float *restrict out, const float *restrict value, int begin, int end, ptrdiff_t apart,
                   int reach);
    void (*look)(const dense_look *row);
    void (*add)(int32_t *sum, const int16_t *slope, const int16_t *residual, const int16_t *with, int sign,
                int width);
    void (*across)(int32_t *restrict sum, const int32_t *restrict column, int32_t *restrict work, int width);
    void (*step)(float *restrict to, const float *restrict value, const int32_t *restrict sums,
                 const int16_t *restrict with, int width);
    void (*vary)(float *restrict variance, float *restrict weight, const int32_t *restrict sums,
                 const int16_t *restrict with, int width);
    void (*bend)(float *restrict bend, const float *here, const float *const side[8], int begin, int end);
    void (*trust)(float *restrict sigma, const dense_trust *row, int width);
} dense_loops;

/* The inner loops; both kinds give the same bytes. */
typedef struct dense_kernel {
    void (*forward)(const dense_row *row);  /* cost; paths from the left and from above */
    void (*backward)(const dense_row *row); /* path from the right; the winners */
    const dense_loops *loops;
} dense_kernel;

extern const dense_loops dense_loops_portable;
extern const dense_kernel dense_kernel_portable;
extern const dense_kernel dense_kernel_avx2;

/* dense.c: the fastest that this processor can run; and matching with a given one. */
const dense_kernel *dense_kernel_best(void);
td_status dense_match_by(td_disparity **disparity, const td_image *left, const td_image *right,
                         const dense_kernel *kernel, const td_dense_options *options, td_error *error);

/* dense_cost.c */
void dense_planes_free(dense_planes *planes);
td_status dense_planes_left(dense_planes *planes, const dense_loops *loops, const td_image *image,
                            const uint8_t tone[256], int threads);
td_status dense_planes_right(dense_planes *planes, const dense_loops *loops, const td_image *image,
                             int lowest, int depth, const uint8_t tone[256], int threads);

/* Values of a path that came from a tile of range `known` and goes on in one of `range`: what it has not
 * reached is out of reach. */
void dense_forget(uint8_t *values, dense_range known, dense_range range);

/* dense_ranges.c */
td_status dense_ranges_full(dense_range **ranges, int width, int height, int levels);
td_status dense_ranges_about(dense_range **ranges, const dense_map *small, int width, int height, int shift,
                             int levels);

/* dense_tone.c: the line that maps the right image's grey values onto the left's, from matched pixels. */
void dense_tone_fit(uint8_t tone[256], const td_image *left, const td_image *right, const dense_map *map,
                    int lowest);

/* dense_paths.c: every disparity of `ranges` of every pixel; winners that the right image confirms. */
td_status dense_paths(dense_map *map, const td_image *image, const dense_planes *left,
                      const dense_planes *right, const dense_range *ranges, int levels,
                      const dense_kernel *kernel, const td_dense_options *options);

/* dense_opencv.cpp: its SGBM in 3WAY mode, holes as DENSE_NONE. It tells no costs: `least` and `curvature`
 * are those of a fair match, one for all. */
td_status dense_opencv(dense_map *map, const td_image *left, const td_image *right, int block,
                       const td_dense_options *options);

/* dense_paths.c: memory of one row on its way; how many stripes an image has. */
size_t dense_stripe_bytes(int width, int levels);
int dense_stripes(int height);

/* dense_refine.c: matched disparities and their sigma by the grey values themselves. */
td_status dense_refine(td_disparity *result, const td_image *left, const td_image *right,
                       const dense_loops *loops, int threads);
enum { DENSE_REFINE_BYTES = 4 * sizeof(float) + 3 * sizeof(int16_t) }; /* a pixel */

/* dense_winner.c: how far from the middle (1/32 px) the winner lies, by the slopes beside it. */
void dense_winner_fractions(int8_t fraction[2 * DENSE_FRACTIONS + 1]);
void dense_winner_row(const dense_loops *loops, int16_t *disparity, uint8_t *curvature, const dense_row *row,
                      const int8_t fraction[2 * DENSE_FRACTIONS + 1], int lowest, bool left_check,
                      uint32_t *meeting, uint8_t *place);

/* dense_fill.c */
td_status dense_remove_specks(dense_map *map, int smallest);
/* Holes that a map of half the size has matched; `shift` is what a disparity of twice its lowest counts from
 * the lowest here. */
void dense_fill_from_half(dense_map *map, const dense_map *small, int shift);
/* any false: nothing to fill from. */
td_status dense_fill(bool *any, int16_t *disparity, int width, int height);
td_status dense_median(int16_t *to, const int16_t *from, int width, int height, const dense_loops *loops,
                       int threads);

/* dense_sigma.c: what the map holds becomes pixels, with their standard deviations. */
td_status dense_hand_over(td_disparity *result, const dense_map *map, const dense_loops *loops,
                          const td_dense_options *options);

#ifdef __cplusplus
#undef restrict
}
#endif
#endif
