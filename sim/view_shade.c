/* What rays see: the light that the first surface sends back. */
#include <math.h>
#include <string.h>

#include "sim/stereo_view_internal.h"

/* Light of the sky, and of what no ray can be cast through. */
static const float SKY = 0.8f;
/* At grazing rays the footprint grows no more than this: the pattern rather turns fine than grey. */
static const double LEAST_COSINE = 0.25;

/* Rays of a narrow beam. */
enum { NARROW = 8 };

/* A block on its way: the surfaces' points and how bright they lie. */
typedef struct block {
    const td_surface *surface[TD_SHADE_BLOCK]; /* NULL: done */
    double x[TD_SHADE_BLOCK], y[TD_SHADE_BLOCK], z[TD_SHADE_BLOCK];
    float footprint[TD_SHADE_BLOCK];
} block;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Bilinear, at (x, y) m, in the size of which a texel is no larger than the footprint. */
static float read_picture(const td_scene_picture *picture, const td_picture_sizes *sizes, double x, double y,
                          double footprint)
{
    const double texel = picture->width_m / picture->image->width;
    int level = 0;
    while (level + 1 < sizes->count && texel * (2 << level) <= footprint) level++;
    const td_image *image = sizes->image[level];
    const double scale = 1.0 / (1 << level);
    const double u = x / picture->width_m * picture->image->width * scale - 0.5;
    const double v = y / picture->height_m * picture->image->height * scale - 0.5;
    return (float)(td_image_sample(image, u, v, 0) / 255);
}

/* Lambert: the sun's share by the cosine to it, the rest from everywhere. */
static float lit(const td_scene *scene, const double normal[3])
{
    const double cosine = dot(normal, scene->sun);
    return (float)(scene->ambient + (1 - scene->ambient) * (cosine > 0 ? cosine : 0));
}

static void look(const td_stereo_view *view, const td_beam beam[2], const double origin[3], double spread,
                 double clear, int i, td_shaded *s, block *b)
{
    const double *ray = s->ray[i];
    b->surface[i] = NULL;
    s->light[i] = SKY;
    s->side[i] = 0;
    const td_hit hit = ray[0] == ray[0] ? td_stereo_view_trace(view, beam, origin, ray, clear)
                                        : (td_hit){.distance = INFINITY, .what = TD_SEES_SKY};
    s->what[i] = (uint8_t)hit.what;
    s->distance[i] = (float)hit.distance;
    if (hit.what == TD_SEES_SKY) return;
    double point[3], normal[3], local[3];
    for (int k = 0; k < 3; k++) point[k] = origin[k] + hit.distance * ray[k];
    if (hit.body) {
        const bool moving =
            hit.body >= view->moving.body && hit.body < view->moving.body + view->moving.count;
        const size_t index = (size_t)(hit.body - (moving ? view->moving.body : view->fixed.body));
        const int side = td_body_surface(hit.body, point, normal, local);
        s->side[i] = (uint32_t)(2 + 16 * index + 8 * moving) + (uint32_t)side;
    } else {
        td_ground_rays_normal(&view->ground, point[0], point[1], normal);
        for (int k = 0; k < 3; k++) local[k] = point[k] - (k < 2 ? view->scene->ground->origin[k] : 0);
        s->side[i] = 1;
    }
    double cosine = -dot(normal, ray);
    if (cosine < 0) {
        cosine = -cosine;
        for (int k = 0; k < 3; k++) normal[k] = -normal[k];
    }
    const double footprint = hit.distance * spread / (cosine > LEAST_COSINE ? cosine : LEAST_COSINE);
    s->light[i] = lit(view->scene, normal);
    if (hit.what == TD_SEES_PICTURE) {
        const td_scene_picture *picture = hit.body->of.picture.picture;
        const td_picture_sizes *sizes = view->sizes + (picture - view->scene->picture);
        s->light[i] *= read_picture(picture, sizes, local[0], local[1], footprint);
        return;
    }
    b->surface[i] = hit.body ? hit.body->surface : &view->scene->ground_surface;
    b->x[i] = local[0];
    b->y[i] = local[1];
    b->z[i] = local[2];
    b->footprint[i] = (float)footprint;
}

/* The grain of one surface, for all its points in the block at once. */
static void add_grain(block *b, int first, int count, float *light)
{
    const td_surface *surface = b->surface[first];
    double x[TD_SHADE_BLOCK], y[TD_SHADE_BLOCK], z[TD_SHADE_BLOCK];
    float footprint[TD_SHADE_BLOCK], reflectance[TD_SHADE_BLOCK];
    int index[TD_SHADE_BLOCK], n = 0;
    for (int i = first; i < count; i++) {
        if (b->surface[i] != surface) continue;
        b->surface[i] = NULL;
        x[n] = b->x[i];
        y[n] = b->y[i];
        z[n] = b->z[i];
        footprint[n] = b->footprint[i];
        index[n++] = i;
    }
    td_grain(reflectance, surface, x, y, z, footprint, n);
    for (int k = 0; k < n; k++) light[index[k]] *= reflectance[k];
}

void td_stereo_view_shade(const td_stereo_view *view, const double origin[3], double spread, int count,
                          td_shaded *shaded)
{
    block b;
    double clear = 0, near = 0;
    td_beam beam[2];
    const double(*ray)[3] = (const double(*)[3])shaded->ray;
    if (view->has_ground) near = clear = td_ground_rays_clear(&view->ground, origin, ray, count, 0);
    td_bodies_in_beam(beam, &view->fixed, origin, ray, count);
    td_bodies_in_beam(beam + 1, &view->moving, origin, ray, count);
    for (int i = 0; i < count; i++) {
        /* Far beams first, then narrow ones the rest of the way. */
        if (view->has_ground && i % NARROW == 0)
            near = td_ground_rays_clear(&view->ground, origin, ray + i,
                                        count - i < NARROW ? count - i : NARROW, clear);
        look(view, beam, origin, spread, near, i, shaded, &b);
    }
    for (int i = 0; i < count; i++)
        if (b.surface[i]) add_grain(&b, i, count, shaded->light);
}
