/* The pipeline: exposures compared, ranges from half the size where that pays, paths, cleaning, result. */
#include "recon/dense.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum {
    TONE_WIDTH = 100, /* px of the side by which exposures are compared, at least */
    OPENCV_BLOCK = 3, /* px */
    MANY_LEVELS = 96  /* from here on the images of half the size pay */
};

td_dense_options td_dense_options_default(void)
{
    return (td_dense_options){.levels = 128,
                              .fill = true,
                              .left_check = true,
                              .coarse_to_fine = true,
                              .refine = true,
                              .speckle = 50};
}

td_status td_dense_options_check(const td_dense_options *options, td_error *error)
{
    if (options->method != TD_DENSE_OURS && options->method != TD_DENSE_OPENCV)
        return td_fail(error, TD_ERROR_ARGUMENT, "method: %d is none of dense matching",
                       (int)options->method);
    if (options->levels < 1 || options->levels > DENSE_MAX_LEVELS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "levels: %d disparities; give 1 to %d, or match a smaller image", options->levels,
                       DENSE_MAX_LEVELS);
    if (abs(options->lowest) > DENSE_MAX_LOWEST)
        return td_fail(error, TD_ERROR_ARGUMENT, "lowest: a smallest disparity of %d px is beyond +-%d px",
                       options->lowest, DENSE_MAX_LOWEST);
    if (options->speckle < 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "speckle: %d pixels; give 0 or more", options->speckle);
    if (options->threads < 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "threads: %d; give 0 (one per processor) or more",
                       options->threads);
    return TD_OK;
}

static td_status check_images(const td_image *left, const td_image *right, td_error *error)
{
    if (!left || !right)
        return td_fail(error, TD_ERROR_ARGUMENT, "the %s image of the pair is missing",
                       left ? "right" : "left");
    if (left->width != right->width || left->height != right->height)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the left image has %dx%d px, the right one %dx%d; rectify the pair to one size first",
                       left->width, left->height, right->width, right->height);
    if (left->channels != 1 || right->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "the %s image has %d channels; read it as grey (1 channel)",
                       left->channels != 1 ? "left" : "right",
                       left->channels != 1 ? left->channels : right->channels);
    if (left->width < 1 || left->height < 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "the images have no pixels");
    return TD_OK;
}

void td_disparity_free(td_disparity **disparity)
{
    if (!disparity || !*disparity) return;
    free((*disparity)->value);
    free((*disparity)->sigma);
    free((*disparity)->kind);
    free(*disparity);
    *disparity = NULL;
}

static td_disparity *disparity_new(int width, int height)
{
    size_t n = (size_t)width * (size_t)height;
    td_disparity *d = calloc(1, sizeof *d);
    if (!d) return NULL;
    *d = (td_disparity){width, height, malloc(n * sizeof *d->value), malloc(n * sizeof *d->sigma),
                        calloc(n, 1)};
    if (!d->value || !d->sigma || !d->kind) td_disparity_free(&d);
    return d;
}

static void map_free(dense_map *map)
{
    free(map->disparity);
    free(map->kind);
    free(map->least);
    free(map->curvature);
}

static bool map_new(dense_map *map, int width, int height)
{
    size_t n = (size_t)width * (size_t)height;
    *map = (dense_map){width, height, malloc(n * sizeof *map->disparity), malloc(n), malloc(n), malloc(n)};
    if (map->disparity && map->kind && map->least && map->curvature) return true;
    map_free(map);
    return false;
}

/* Grey values as they are compared. */
typedef struct tones {
    uint8_t left[256], right[256];
} tones;

static td_status match_planes(dense_map *map, const td_image *left, const td_image *right,
                              const dense_range *ranges, const tones *tone, const dense_kernel *kernel,
                              const td_dense_options *options)
{
    dense_planes planes[2] = {{0}, {0}};
    int depth = (options->levels + 2 * DENSE_LANES) / DENSE_LANES * DENSE_LANES;
    td_status status = dense_planes_left(&planes[0], kernel->loops, left, tone->left, options->threads);
    if (status == TD_OK)
        status = dense_planes_right(&planes[1], kernel->loops, right, options->lowest, depth, tone->right,
                                    options->threads);
    if (status == TD_OK)
        status = dense_paths(map, left, &planes[0], &planes[1], ranges, options->levels, kernel, options);
    dense_planes_free(&planes[0]);
    dense_planes_free(&planes[1]);
    return status;
}

/* Options for a pair shrunk so many times: a disparity d becomes d / 2^times. */
static td_dense_options smaller(const td_dense_options *options, int times)
{
    td_dense_options fewer = *options;
    int unit = 1 << times, highest = options->lowest + options->levels - 1;
    fewer.lowest = (int)floor((double)options->lowest / unit);
    fewer.levels = (int)ceil((double)highest / unit) - fewer.lowest + 1;
    return fewer;
}

/* Specks out, holes filled, medians. `small` is the map of half the size; empty: there is none. */
static td_status clean(dense_map *map, const dense_map *small, const dense_loops *loops,
                       const td_dense_options *options)
{
    size_t n = (size_t)map->width * (size_t)map->height;
    bool any = false;
    td_status status = options->speckle ? dense_remove_specks(map, options->speckle) : TD_OK;
    for (size_t i = 0; i < n; i++) map->kind[i] = map->disparity[i] >= 0 ? TD_DENSE_MATCHED : TD_DENSE_NONE;
    if (small->kind) dense_fill_from_half(map, small, 2 * smaller(options, 1).lowest - options->lowest);
    if (status == TD_OK) status = dense_fill(&any, map->disparity, map->width, map->height);
    if (status != TD_OK || !any) return status;
    for (size_t i = 0; i < n; i++)
        if (map->kind[i] == TD_DENSE_NONE) map->kind[i] = TD_DENSE_FILLED;
    int16_t *other = malloc(n * sizeof *other);
    if (!other) return TD_ERROR_MEMORY;
    status = dense_median(other, map->disparity, map->width, map->height, loops, options->threads);
    if (status == TD_OK)
        status = dense_median(map->disparity, other, map->width, map->height, loops, options->threads);
    free(other);
    return status;
}

static td_status match_level(dense_map *map, const td_image *left, const td_image *right, const tones *tone,
                             const dense_kernel *kernel, const td_dense_options *options);

static td_status ranges_from_half(dense_range **ranges, dense_map *small, const td_image *left,
                                  const td_image *right, const tones *tone, const dense_kernel *kernel,
                                  const td_dense_options *options)
{
    td_image *half[2] = {NULL, NULL};
    td_dense_options fewer = smaller(options, 1);
    td_status status = td_image_shrink(&half[0], left, 1, NULL);
    if (status == TD_OK) status = td_image_shrink(&half[1], right, 1, NULL);
    if (status == TD_OK && !map_new(small, half[0]->width, half[0]->height)) status = TD_ERROR_MEMORY;
    if (status == TD_OK) status = match_level(small, half[0], half[1], tone, kernel, &fewer);
    if (status == TD_OK && small->kind[0] != TD_DENSE_NONE)
        status = dense_ranges_about(ranges, small, left->width, left->height,
                                    2 * fewer.lowest - options->lowest, options->levels);
    td_image_free(&half[0]);
    td_image_free(&half[1]);
    return status;
}

static td_status match_level(dense_map *map, const td_image *left, const td_image *right, const tones *tone,
                             const dense_kernel *kernel, const td_dense_options *options)
{
    dense_range *ranges = NULL;
    dense_map small = {0};
    td_status status = TD_OK;
    if (options->coarse_to_fine && options->levels >= MANY_LEVELS && left->width >= 2 * DENSE_TILE &&
        left->height >= 2 * DENSE_TILE)
        status = ranges_from_half(&ranges, &small, left, right, tone, kernel, options);
    if (status == TD_OK && !ranges)
        status = dense_ranges_full(&ranges, left->width, left->height, options->levels);
    if (status == TD_OK) status = match_planes(map, left, right, ranges, tone, kernel, options);
    if (status == TD_OK) status = clean(map, &small, kernel->loops, options);
    map_free(&small);
    free(ranges);
    return status;
}

/* Both tones are dark while they are being measured: census alone counts. */
static td_status measure_tones(tones *tone, const td_image *left, const td_image *right,
                               const dense_kernel *kernel, const td_dense_options *options)
{
    int times = 0;
    while (left->width >> times >= 2 * TONE_WIDTH && left->height >> times >= TONE_WIDTH) times++;
    td_image *small[2] = {NULL, NULL};
    dense_map map = {0};
    td_dense_options fewer = smaller(options, times);
    fewer.coarse_to_fine = false, fewer.progress = NULL;
    memset(tone, 0, sizeof *tone);
    td_status status = td_image_shrink(&small[0], left, times, NULL);
    if (status == TD_OK) status = td_image_shrink(&small[1], right, times, NULL);
    if (status == TD_OK && !map_new(&map, small[0]->width, small[0]->height)) status = TD_ERROR_MEMORY;
    dense_range *ranges = NULL;
    if (status == TD_OK) status = dense_ranges_full(&ranges, map.width, map.height, fewer.levels);
    if (status == TD_OK) status = match_planes(&map, small[0], small[1], ranges, tone, kernel, &fewer);
    for (int value = 0; value < 256; value++) tone->left[value] = (uint8_t)value;
    if (status == TD_OK) dense_tone_fit(tone->right, small[0], small[1], &map, fewer.lowest);
    free(ranges);
    map_free(&map);
    td_image_free(&small[0]);
    td_image_free(&small[1]);
    return status;
}

static td_status match_by_paths(dense_map *map, const td_image *left, const td_image *right,
                                const dense_kernel *kernel, const td_dense_options *options)
{
    tones tone;
    TD_TRY(measure_tones(&tone, left, right, kernel, options));
    return match_level(map, left, right, &tone, kernel, options);
}

static td_status match_by_opencv(dense_map *map, const td_image *left, const td_image *right,
                                 const dense_kernel *kernel, const td_dense_options *options)
{
    const dense_map none = {0};
    TD_TRY(dense_opencv(map, left, right, OPENCV_BLOCK, options));
    return clean(map, &none, kernel->loops, options);
}

const dense_kernel *dense_kernel_best(void)
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) return &dense_kernel_avx2;
#endif
    return &dense_kernel_portable;
}

td_status dense_match_by(td_disparity **disparity, const td_image *left, const td_image *right,
                         const dense_kernel *kernel, const td_dense_options *options, td_error *error)
{
    *disparity = NULL;
    TD_TRY(td_dense_options_check(options, error));
    TD_TRY(check_images(left, right, error));
    dense_map map = {0};
    td_disparity *result = disparity_new(left->width, left->height);
    td_status status = result && map_new(&map, left->width, left->height) ? TD_OK : TD_ERROR_MEMORY;
    if (status == TD_OK && options->method == TD_DENSE_OPENCV)
        status = match_by_opencv(&map, left, right, kernel, options);
    else if (status == TD_OK)
        status = match_by_paths(&map, left, right, kernel, options);
    if (status == TD_OK) status = dense_hand_over(result, &map, kernel->loops, options);
    if (status == TD_OK && options->refine)
        status = dense_refine(result, left, right, kernel->loops, options->threads);
    map_free(&map);
    if (status != TD_OK) {
        td_disparity_free(&result);
        return td_fail(error, status, "dense matching: %s", td_status_text(status));
    }
    *disparity = result;
    return TD_OK;
}

td_status td_dense_match(td_disparity **disparity, const td_image *left, const td_image *right,
                         const td_dense_options *options, td_error *error)
{
    td_dense_options defaults = td_dense_options_default();
    if (!options) options = &defaults;
    return dense_match_by(disparity, left, right, dense_kernel_best(), options, error);
}

/* The result, the map, the planes of both images, what cleaning needs, and the rows under way; a third more
 * for the images of half the size. */
size_t td_dense_memory(int width, int height, const td_dense_options *options)
{
    td_dense_options defaults = td_dense_options_default();
    if (!options) options = &defaults;
    if (width < 1 || height < 1 || td_dense_options_check(options, NULL) != TD_OK) return 0;
    size_t n = (size_t)width * (size_t)height, stripes = (size_t)dense_stripes(height);
    size_t beyond = (size_t)(abs(options->lowest) + options->levels + 2 * DENSE_LANES) * (size_t)height;
    size_t result = n * (2 * sizeof(float) + 1 + (options->refine ? DENSE_REFINE_BYTES : 0)),
           map = n * (sizeof(int16_t) + 3);
    size_t planes = DENSE_PLANES * (2 * n + beyond), cleaning = n * (4 * sizeof(uint32_t) + sizeof(int16_t));
    if (options->threads && (size_t)options->threads < stripes) stripes = (size_t)options->threads;
    size_t rows = stripes * dense_stripe_bytes(width, options->levels + DENSE_LANES);
    return result + (map + planes + cleaning + rows + 2 * n) * 4 / 3 + ((size_t)1 << 16);
}
