/* Grain of a surface: octaves of gradient noise (Perlin 1985, with the fade 6t^5 - 15t^4 + 10t^3 of 2002)
 * over the point's three coordinates. An octave whose grain nears the pixel's footprint fades out, so that
 * the pattern holds nothing that the pixels could not, and looks the same to both cameras.
 *
 * The loops run over a block of points at a time, without branches, so that the compiler makes vectors of
 * them. */
#include <math.h>
#include <string.h>

#include "sim/stereo_view_internal.h"

/* Each octave's amplitude against the one before. */
static const double PERSISTENCE = 0.8;
/* Grains of a noise whose cells are this many footprints wide are left out, or whole. */
static const float OUT = 1.5f, WHOLE = 3.0f;
/* Standard deviation of the noise below over all positions: sqrt(24 A^2 B), A and B the integrals of w^2 and
 * w^2 t^2 over [0, 1], w = 1 - fade(t). */
static const double DEVIATION = 0.330724;

/* Keeps the cells' numbers positive, where truncation is rounding down: half of 2^31 cells. */
static const double FAR = 1073741824.0, END = 2147483000.0;

static const uint32_t STRIDE_X = 0x9E3779B1u, STRIDE_Y = 0x85EBCA77u, STRIDE_Z = 0xC2B2AE3Du;

typedef struct lattice {
    uint32_t h[3][2][TD_GRAIN_BLOCK]; /* numbers of the cell and the next, along each axis */
    float x[TD_GRAIN_BLOCK], y[TD_GRAIN_BLOCK], z[TD_GRAIN_BLOCK], weight[TD_GRAIN_BLOCK];
} lattice;

/* `value` with the sign of a number's highest bit turned over. */
static inline float flip(float value, uint32_t bits)
{
    uint32_t word;
    memcpy(&word, &value, sizeof word);
    word ^= bits & 0x80000000u;
    memcpy(&value, &word, sizeof word);
    return value;
}

/* Product of a corner's gradient (+-1, +-1, +-1), drawn from its number, and the way to it. */
static inline float gradient(uint32_t h, float x, float y, float z)
{
    h ^= h >> 15;
    h *= 0x2C1B3C6Du;
    h ^= h >> 12;
    h += h << 7;
    return flip(x, h) + flip(y, h << 5) + flip(z, h << 11);
}

static inline float fade(float t)
{
    return t * t * t * (t * (t * 6 - 15) + 10);
}

static inline float mix(float a, float b, float t)
{
    return a + t * (b - a);
}

/* Cell and place in it along one axis. */
static void split(uint32_t cell[2][TD_GRAIN_BLOCK], float *rest, const double *value, double scale,
                  double shift, uint32_t seed, uint32_t stride, int count)
{
    int32_t whole[TD_GRAIN_BLOCK];
    for (int i = 0; i < count; i++) {
        const double v = value[i] * scale + shift, w = v > 0 ? v : 0;
        whole[i] = (int32_t)(w < END ? w : END);
    }
    for (int i = 0; i < count; i++) rest[i] = (float)(value[i] * scale + shift - whole[i]);
    for (int i = 0; i < count; i++) {
        const uint32_t h = (uint32_t)whole[i] * stride + seed;
        cell[0][i] = h;
        cell[1][i] = h + stride;
    }
}

static void add_octave(float *sum, const lattice *l, int count)
{
    for (int i = 0; i < count; i++) {
        const float x = l->x[i], y = l->y[i], z = l->z[i], u = fade(x), v = fade(y), w = fade(z);
        const uint32_t x0 = l->h[0][0][i], x1 = l->h[0][1][i], y0 = l->h[1][0][i], y1 = l->h[1][1][i];
        const uint32_t z0 = l->h[2][0][i], z1 = l->h[2][1][i];
        const uint32_t n00 = y0 ^ z0, n10 = y1 ^ z0, n01 = y0 ^ z1, n11 = y1 ^ z1;
        const float a = mix(gradient(x0 + n00, x, y, z), gradient(x1 + n00, x - 1, y, z), u);
        const float b = mix(gradient(x0 + n10, x, y - 1, z), gradient(x1 + n10, x - 1, y - 1, z), u);
        const float c = mix(gradient(x0 + n01, x, y, z - 1), gradient(x1 + n01, x - 1, y, z - 1), u);
        const float d = mix(gradient(x0 + n11, x, y - 1, z - 1), gradient(x1 + n11, x - 1, y - 1, z - 1), u);
        sum[i] += l->weight[i] * mix(mix(a, b, v), mix(c, d, v), w);
    }
}

/* False when the octave has faded at every point. */
static bool weigh(float *weight, const float *footprint, float cell_m, float amplitude, int count)
{
    bool any = false;
    for (int i = 0; i < count; i++) {
        const float size = cell_m / footprint[i];
        float t = (size - OUT) / (WHOLE - OUT);
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        weight[i] = amplitude * t * t * (3 - 2 * t);
        any |= weight[i] > 0;
    }
    return any;
}

void td_grain(float *reflectance, const td_surface *surface, const double *x, const double *y,
              const double *z, const float *footprint, int count)
{
    lattice l;
    float sum[TD_GRAIN_BLOCK] = {0};
    double amplitude = 1, power = 0, cell_m = surface->grain_m;
    for (int o = 0; o < surface->octaves; o++, amplitude *= PERSISTENCE) power += amplitude * amplitude;
    amplitude = power > 0 ? 1 / (sqrt(power) * DEVIATION) : 0;
    for (int o = 0; o < surface->octaves; o++, amplitude *= PERSISTENCE, cell_m *= 0.5) {
        if (!weigh(l.weight, footprint, (float)cell_m, (float)amplitude, count)) break;
        /* Shifted, so that the zeros at the corners of the cells do not fall together. */
        const double scale = 1 / cell_m, shift = 0.381966 * o;
        const uint32_t seed =
            (uint32_t)(surface->seed * 0x9E3779B97F4A7C15u >> 32) + (uint32_t)o * 0x27D4EB2Fu;
        split(l.h[0], l.x, x, scale, FAR + 0.17 + shift, seed, STRIDE_X, count);
        split(l.h[1], l.y, y, scale, FAR + 0.41 + 1.3 * shift, seed >> 7, STRIDE_Y, count);
        split(l.h[2], l.z, z, scale, FAR + 0.73 + 1.7 * shift, seed << 9, STRIDE_Z, count);
        add_octave(sum, &l, count);
    }
    const float mean = (float)surface->albedo, contrast = (float)surface->contrast;
    for (int i = 0; i < count; i++) {
        const float r = mean * (1 + contrast * sum[i]);
        reflectance[i] = r < 0.01f ? 0.01f : r > 1 ? 1 : r;
    }
}
