/* A texture known everywhere: waves of random direction, length and phase, their spectrum falling as a lens
 * makes it fall; each pixel's value is the integral over the pixel, exactly (a wave's mean over a pixel is
 * the wave times two sinc). */
#ifndef TELEDIMOS_TESTS_RECON_TEXTURE_H
#define TELEDIMOS_TESTS_RECON_TEXTURE_H

#include <math.h>

#include "core/image.h"
#include "core/random.h"

enum { TEXTURE_WAVES = 32 };

typedef struct texture {
    double k[TEXTURE_WAVES][2], amplitude[TEXTURE_WAVES], phase[TEXTURE_WAVES]; /* rad/px, grey levels */
} texture;

static inline texture texture_draw(td_random *random, double contrast)
{
    texture t;
    for (int i = 0; i < TEXTURE_WAVES; i++) {
        const double cycles = 0.01 + 0.3 * td_random_uniform(random), turn = 6.283185307179586;
        const double direction = turn * td_random_uniform(random);
        t.k[i][0] = turn * cycles * cos(direction);
        t.k[i][1] = turn * cycles * sin(direction);
        t.phase[i] = turn * td_random_uniform(random);
        t.amplitude[i] = contrast * sqrt(2. / TEXTURE_WAVES);
    }
    return t;
}

static inline double texture_sinc(double x)
{
    return fabs(x) < 1e-9 ? 1 : sin(x) / x;
}

/* Renders the texture seen through pixel = a place + c, a (2,2), blurred in the image by a Gaussian of 0.5
 * px: each wave gets the other length and direction, and what blur and the pixel's area leave of it. */
static inline void texture_render(td_image *image, const texture *t, const double a[4], const double c[2],
                                  double gain, double offset, double noise, td_random *random)
{
    const double det = a[0] * a[3] - a[1] * a[2];
    double k[TEXTURE_WAVES][2], amplitude[TEXTURE_WAVES];
    for (int i = 0; i < TEXTURE_WAVES; i++) {
        const double kx = (a[3] * t->k[i][0] - a[2] * t->k[i][1]) / det;
        const double ky = (-a[1] * t->k[i][0] + a[0] * t->k[i][1]) / det;
        k[i][0] = kx;
        k[i][1] = ky;
        amplitude[i] = gain * t->amplitude[i] * exp(-0.125 * (kx * kx + ky * ky)) * texture_sinc(kx / 2) *
                       texture_sinc(ky / 2);
    }
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++) {
            double v = offset + noise * td_random_normal(random);
            for (int i = 0; i < TEXTURE_WAVES; i++)
                v += amplitude[i] * cos(k[i][0] * (x - c[0]) + k[i][1] * (y - c[1]) + t->phase[i]);
            image->data[(size_t)y * (size_t)image->width + (size_t)x] = (uint8_t)lrint(fmin(fmax(v, 0), 255));
        }
}

#endif
