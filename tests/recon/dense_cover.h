/* How many errors lie within their sigma: all, and in three equal parts by sigma, so that small ones are
 * judged beside small ones. */
#ifndef TELEDIMOS_TESTS_RECON_DENSE_COVER_H
#define TELEDIMOS_TESTS_RECON_DENSE_COVER_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tests/check.h"

typedef struct dense_cover {
    float *error, *sigma; /* (count) px */
    size_t count;
} dense_cover;

static inline void dense_cover_add(dense_cover *c, float error, float sigma)
{
    c->error[c->count] = error;
    c->sigma[c->count++] = sigma;
}

static inline int dense_by_value(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* 68 +- 5 % of all, and of each third; frees the lists. */
static inline void dense_cover_check(dense_cover *c, const char *name)
{
    float *sorted = malloc((c->count + 1) * sizeof *sorted);
    double inside[4] = {0}, all[4] = {0};
    memcpy(sorted, c->sigma, c->count * sizeof *sorted);
    qsort(sorted, c->count, sizeof *sorted, dense_by_value);
    const float limit[2] = {sorted[c->count / 3], sorted[2 * c->count / 3]};
    for (size_t i = 0; i < c->count; i++) {
        const bool within = fabsf(c->error[i]) <= c->sigma[i]; /* false for NaN */
        const int third = (c->sigma[i] > limit[0]) + (c->sigma[i] > limit[1]);
        inside[third] += within, all[third]++;
        inside[3] += within, all[3]++;
    }
    print_message("%s: %.1f %% of %.0f errors within 1 sigma; below %.3f px %.1f %%, to %.3f px %.1f %%, "
                  "above %.1f %%\n",
                  name, 100 * inside[3] / all[3], all[3], (double)limit[0], 100 * inside[0] / all[0],
                  (double)limit[1], 100 * inside[1] / all[1], 100 * inside[2] / all[2]);
    for (int k = 0; k < 4; k++) check_near(inside[k] / all[k], 0.68, 0.05);
    free(sorted);
    free(c->error);
    free(c->sigma);
}

#endif
