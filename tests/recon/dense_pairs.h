/* Real pairs whose disparities are known, for the test and the benchmark of dense matching: Middlebury's
 * Teddy, Cones (2003), Art (2005) and Motorcycle (2014) under $TELEDIMOS_DATA, Aloe (2006) from Debian's
 * opencv-doc. */
#ifndef TELEDIMOS_TESTS_DENSE_PAIRS_H
#define TELEDIMOS_TESTS_DENSE_PAIRS_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <zip.h>

#include "core/image.h"

#define DENSE_ALOE "/usr/share/doc/opencv-doc/examples/data"

typedef struct dense_pair_kind {
    const char *name, *folder, *left, *right, *truth;
    double unit; /* of the truth's numbers, in pixels; 0: float in an .npz */
    int levels;
} dense_pair_kind;

static const dense_pair_kind DENSE_PAIRS[] = {
    {"Teddy", "middlebury-Teddy", "im2.png", "im6.png", "disp2.png", 1.0 / 4, 64},
    {"Cones", "middlebury-Cones", "im2.png", "im6.png", "disp2.png", 1.0 / 4, 64},
    {"Art", "middlebury-Art", "view1.png", "view5.png", "disp1.png", 1.0 / 3, 80},
    {"Motorcycle", "middlebury-Motorcycle", "motorcycle_left.png", "motorcycle_right.png",
     "motorcycle_disp.npz", 0, 80},
    {"Aloe", NULL, "aloeL.jpg", "aloeR.jpg", "aloeGT.png", 1, 272},
};
enum { DENSE_PAIR_COUNT = sizeof DENSE_PAIRS / sizeof *DENSE_PAIRS };

typedef struct dense_pair {
    td_image *left, *right;
    float *truth;   /* (height,width) px, NaN where unknown */
    uint8_t *shown; /* (height,width) 1: the right camera sees it too */
} dense_pair;

static inline void dense_pair_free(dense_pair *pair)
{
    td_image_free(&pair->left);
    td_image_free(&pair->right);
    free(pair->truth);
    free(pair->shown);
    *pair = (dense_pair){0};
}

/* The array "arr_0" of little-endian floats. */
static inline float *dense_pair_npz(const char *path, size_t count)
{
    enum { HEADER = 10 };
    int cause;
    zip_t *archive = zip_open(path, ZIP_RDONLY, &cause);
    zip_file_t *file = archive ? zip_fopen(archive, "arr_0.npy", 0) : NULL;
    size_t bytes = count * sizeof(float);
    uint8_t head[HEADER] = {0};
    char words[65536];
    float *values = malloc(bytes);
    bool good = file && zip_fread(file, head, HEADER) == HEADER && !memcmp(head, "\x93NUMPY\x01", 7);
    zip_uint64_t length = good ? (zip_uint64_t)head[8] + 256u * head[9] : 0;
    good = good && zip_fread(file, words, length) == (zip_int64_t)length;
    words[length < sizeof words ? length : sizeof words - 1] = 0;
    good = good && strstr(words, "'<f4'") && strstr(words, "'fortran_order': False");
    good = good && values && zip_fread(file, values, bytes) == (zip_int64_t)bytes;
    if (file) zip_fclose(file);
    if (archive) zip_discard(archive);
    if (good) return values;
    free(values);
    return NULL;
}

static inline float *dense_pair_png(const char *path, const td_image *left, double unit)
{
    td_image *image = NULL;
    if (td_image_read(&image, path, 1, NULL) != TD_OK) return NULL;
    size_t count = (size_t)image->width * (size_t)image->height;
    bool fits = image->width == left->width && image->height == left->height;
    float *values = fits ? malloc(count * sizeof *values) : NULL;
    for (size_t i = 0; i < count && values; i++)
        values[i] = image->data[i] ? (float)(unit * image->data[i]) : NAN;
    td_image_free(&image);
    return values;
}

/* A pixel is hidden in the right image when a nearer one meets it there, or when it falls outside. */
static inline void dense_pair_show(dense_pair *pair)
{
    int width = pair->left->width, height = pair->left->height;
    float *front = malloc((size_t)width * sizeof *front);
    pair->shown = calloc((size_t)width * (size_t)height, 1);
    for (int y = 0; y < height && front && pair->shown; y++) {
        const float *truth = pair->truth + (size_t)y * (size_t)width;
        for (int x = 0; x < width; x++) front[x] = -INFINITY;
        for (int pass = 0; pass < 2; pass++)
            for (int x = 0; x < width; x++) {
                int to = isfinite(truth[x]) ? (int)lrintf((float)x - truth[x]) : -1;
                if (to < 0 || to >= width) continue;
                if (!pass)
                    front[to] = fmaxf(front[to], truth[x]);
                else
                    pair->shown[(size_t)y * (size_t)width + (size_t)x] = truth[x] > front[to] - 1;
            }
    }
    free(front);
}

/* False: the pair is not there. */
static inline bool dense_pair_read(dense_pair *pair, const dense_pair_kind *kind)
{
    const char *data = getenv("TELEDIMOS_DATA");
    char folder[1024], path[2048];
    *pair = (dense_pair){0};
    if (kind->folder && !data) return false;
    snprintf(folder, sizeof folder, "%s%s%s", kind->folder ? data : DENSE_ALOE, kind->folder ? "/" : "",
             kind->folder ? kind->folder : "");
    snprintf(path, sizeof path, "%s/%s", folder, kind->left);
    if (td_image_read(&pair->left, path, 1, NULL) != TD_OK) return false;
    snprintf(path, sizeof path, "%s/%s", folder, kind->right);
    if (td_image_read(&pair->right, path, 1, NULL) == TD_OK) {
        snprintf(path, sizeof path, "%s/%s", folder, kind->truth);
        size_t count = (size_t)pair->left->width * (size_t)pair->left->height;
        pair->truth =
            kind->unit > 0 ? dense_pair_png(path, pair->left, kind->unit) : dense_pair_npz(path, count);
        for (size_t i = 0; i < count && pair->truth; i++)
            if (!isfinite(pair->truth[i])) pair->truth[i] = NAN;
    }
    if (pair->truth) dense_pair_show(pair);
    if (pair->shown) return true;
    dense_pair_free(pair);
    return false;
}

/* Shares of all pixels with truth, in percent. */
typedef struct dense_score {
    double bad05, bad1, bad2, density, rms; /* rms: px, of the errors below 3 px */
} dense_score;

static inline dense_score dense_pair_score(const dense_pair *pair, const float *value)
{
    dense_score s = {0, 0, 0, 0, 0};
    double all = 0, near = 0;
    size_t count = (size_t)pair->left->width * (size_t)pair->left->height;
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(pair->truth[i])) continue;
        double error = fabs((double)value[i] - (double)pair->truth[i]);
        all++;
        s.density += isfinite(value[i]);
        s.bad05 += !(error <= 0.5);
        s.bad1 += !(error <= 1);
        s.bad2 += !(error <= 2);
        if (error < 3) near++, s.rms += error * error;
    }
    s.bad05 *= 100 / all, s.bad1 *= 100 / all, s.bad2 *= 100 / all, s.density *= 100 / all;
    s.rms = sqrt(s.rms / near);
    return s;
}

/* The other camera with another exposure: a gain and an offset on its grey values. */
static inline void dense_pair_expose(td_image *image, double gain, double offset)
{
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++) {
        double value = gain * image->data[i] + offset;
        image->data[i] = (uint8_t)(value > 255 ? 255 : value + 0.5);
    }
}

#endif
