/* Focus, brightness, saturation: what a person at the lens turns by.
 *
 * Focus: the root mean square of the discrete Laplacian over the standard deviation of the image, times 100,
 * after smoothing by the 3x3 binomial, which leaves a fiftieth of the sensor's noise in it. The variance of
 * the Laplacian (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", 2000) alone grows with
 * exposure and contrast; the ratio does not change under grey = a grey + b, so that frames can be compared
 * while the light changes. It depends on what is seen: compare frames of one scene. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "apps/capture_internal.h"

enum { SATURATED = 254 };

static int grey_at(const td_image *image, size_t index)
{
    const uint8_t *p = image->data + index * (size_t)image->channels;
    if (image->channels == 1) return p[0];
    return (int)((19595u * p[0] + 38470u * p[1] + 7471u * p[2] + 32768u) >> 16);
}

/* One row smoothed along and across, times 16; the rows above and below are repeated at the border. */
static void smooth_row(int *out, const td_image *image, int y)
{
    const int w = image->width, h = image->height;
    const size_t row[3] = {(size_t)(y > 0 ? y - 1 : 0) * (size_t)w, (size_t)y * (size_t)w,
                           (size_t)(y < h - 1 ? y + 1 : y) * (size_t)w};
    int before = 0, here = 0;
    for (int x = 0; x <= w; x++) {
        const size_t at = (size_t)(x < w ? x : w - 1);
        const int next =
            grey_at(image, row[0] + at) + 2 * grey_at(image, row[1] + at) + grey_at(image, row[2] + at);
        if (x == 0) before = here = next;
        if (x > 0) {
            out[x - 1] = before + 2 * here + next;
            before = here;
            here = next;
        }
    }
}

static double focus_of(const td_image *image)
{
    const int w = image->width, h = image->height;
    if (w < 3 || h < 3) return 0;
    int *room = malloc(3 * (size_t)w * sizeof *room), *row[3];
    if (!room) return 0;
    for (int i = 0; i < 3; i++) row[i] = room + (size_t)i * (size_t)w;
    smooth_row(row[0], image, 0);
    smooth_row(row[1], image, 1);
    double laplacian = 0, sum = 0, squares = 0;
    for (int y = 1; y < h - 1; y++) {
        int *up = row[(y - 1) % 3], *here = row[y % 3], *down = row[(y + 1) % 3];
        smooth_row(down, image, y + 1);
        int64_t l2 = 0, s1 = 0, s2 = 0;
        for (int x = 1; x < w - 1; x++) {
            const int64_t v = here[x];
            const int64_t l = (int64_t)here[x - 1] + here[x + 1] + up[x] + down[x] - 4 * v;
            l2 += l * l;
            s1 += v;
            s2 += v * v;
        }
        laplacian += (double)l2;
        sum += (double)s1;
        squares += (double)s2;
    }
    free(room);
    const double n = (double)(w - 2) * (double)(h - 2);
    const double variance = squares / n - sum / n * (sum / n);
    /* Less than a quarter of a grey level of contrast is quantisation. */
    return variance > 16 ? 100 * sqrt(laplacian / n / variance) : 0;
}

capture_measure capture_measure_image(const td_image *image)
{
    const size_t count = (size_t)image->width * (size_t)image->height;
    size_t saturated = 0;
    uint64_t sum = 0;
    for (size_t i = 0; i < count; i++) {
        const uint8_t *p = image->data + i * (size_t)image->channels;
        int top = p[0];
        for (int c = 1; c < image->channels; c++) top = p[c] > top ? p[c] : top;
        saturated += top >= SATURATED;
        sum += (uint64_t)grey_at(image, i);
    }
    return (capture_measure){.focus = focus_of(image),
                             .brightness_share = (double)sum / (double)count / 255,
                             .saturated_share = (double)saturated / (double)count};
}

bool capture_has_colour(const td_image *image)
{
    const size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++) {
        const uint8_t *p = image->data + 3 * i;
        if (p[0] != p[1] || p[1] != p[2]) return true;
    }
    return false;
}
