/* Boards of tags with known corners, rendered through a camera's whole model without anything of the
 * library's corner model.
 *
 * Each pixel's corners are sent back through the lens (td_camera_unproject); a pixel whose four corners see
 * one colour of one cell has it, another is the mean over SCENE_SAMPLES^2 points, whose rays are interpolated
 * between the corners'. Then a Gaussian blur, noise, and rounding. Sampling, blur and noise are even about
 * each pixel's centre, and so move no edge. */
#ifndef TELEDIMOS_TESTS_RENDER_TAGS_H
#define TELEDIMOS_TESTS_RENDER_TAGS_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "calib/tag_dictionary.h"
#include "core/camera.h"
#include "core/image.h"
#include "core/random.h"
#include "core/target.h"

enum { SCENE_SAMPLES = 10, SCENE_MOST_TAGS = 128 };

typedef struct tag_scene {
    td_camera camera;
    td_pose camera_from_target;
    td_target target;   /* aprilgrid or tags, in the plane z = 0 of the target for an aprilgrid */
    bool squares;       /* Kalibr's, at the corners of an aprilgrid's tags */
    double dark, light; /* grey levels */
    double fall;        /* of the light from left to right of the image, as a share */
    double blur, noise; /* px; grey levels */
    /* Filled by tag_scene_prepare: */
    int side, tags;
    uint8_t cell[SCENE_MOST_TAGS][TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    td_pose tag_from_camera[SCENE_MOST_TAGS]; /* tags; of an aprilgrid the target's only */
} tag_scene;

static inline bool tag_scene_prepare(tag_scene *s)
{
    s->tags = td_target_tag_count(&s->target);
    for (int i = 0; i < s->tags; i++) {
        int id = td_target_tag_id(&s->target, 4 * (size_t)i);
        if (td_tag_cells(s->cell[i], &s->side, s->target.dictionary, s->target.border, id, NULL) != TD_OK)
            return false;
    }
    const bool grid = s->target.kind == TD_TARGET_APRILGRID;
    for (int i = 0; i < (grid ? 1 : s->tags); i++) {
        td_pose plane = grid ? td_pose_identity() : s->target.tag[i].target_from_tag;
        td_pose pose = td_pose_compose(&s->camera_from_target, &plane);
        s->tag_from_camera[i] = td_pose_inverse(&pose);
    }
    return true;
}

/* Where the ray meets plane z = 0; false behind the camera. */
static inline bool tag_scene_meet(double xy[2], const td_pose *plane_from_camera, const double ray[3])
{
    double d[3];
    td_pose_rotate(d, plane_from_camera, ray);
    double along = -plane_from_camera->t[2] / d[2];
    xy[0] = plane_from_camera->t[0] + along * d[0];
    xy[1] = plane_from_camera->t[1] + along * d[1];
    return along > 0;
}

/* A number for each patch of one colour, its lowest bit the colour (1 light); x, y in a tag's sides from its
 * upper left. */
static inline int tag_scene_patch(const tag_scene *s, int tag, double x, double y)
{
    int i = (int)(y * s->side), j = (int)(x * s->side);
    if (i > s->side - 1) i = s->side - 1;
    if (j > s->side - 1) j = s->side - 1;
    return 1000 * tag + 2 * (s->side * i + j) + 1000000 + s->cell[tag][s->side * i + j];
}

/* White paper is 1; the wall behind it 3 (light too, so that nothing but the target is seen). */
static inline int tag_scene_look(const tag_scene *s, const double ray[3])
{
    double xy[2];
    const td_target *t = &s->target;
    if (t->kind == TD_TARGET_TAGS) {
        for (int k = 0; k < s->tags; k++) {
            if (!tag_scene_meet(xy, &s->tag_from_camera[k], ray)) continue;
            double x = xy[0] / t->tag[k].size_m + 0.5, y = xy[1] / t->tag[k].size_m + 0.5;
            if (x >= 0 && y >= 0 && x < 1 && y < 1) return tag_scene_patch(s, k, x, y);
        }
        return 1;
    }
    if (!tag_scene_meet(xy, &s->tag_from_camera[0], ray)) return 3;
    const double spacing = t->plane[0].spacing_m, size = t->tag_size_m, gap = spacing - size;
    const int columns = t->plane[0].columns, rows = t->plane[0].rows;
    if (xy[0] < -gap || xy[1] < -gap || xy[0] >= columns * spacing || xy[1] >= rows * spacing) return 1;
    const int j = (int)floor(xy[0] / spacing), i = (int)floor(xy[1] / spacing);
    const double x = xy[0] - j * spacing, y = xy[1] - i * spacing;
    if (j >= 0 && i >= 0 && x < size && y < size)
        return tag_scene_patch(s, columns * i + j, x / size, y / size);
    return s->squares && x >= size && y >= size ? 2000000 + 2 * (300 * (i + 1) + j + 1) : 1;
}

/* Light of every pixel, 0 to 1. */
static inline void tag_scene_expose(float *light, const tag_scene *s)
{
    const int w = s->camera.width, h = s->camera.height;
    double *ray = malloc(sizeof *ray * 3 * (size_t)(w + 1) * (size_t)(h + 1));
    int *patch = malloc(sizeof *patch * (size_t)(w + 1) * (size_t)(h + 1));
    for (int y = 0; y <= h; y++)
        for (int x = 0; x <= w; x++) {
            const double pixel[2] = {x - 0.5, y - 0.5};
            double *r = ray + 3 * ((size_t)y * (size_t)(w + 1) + (size_t)x);
            if (!td_camera_unproject(r, NULL, NULL, &s->camera, pixel)) r[0] = r[1] = 0, r[2] = -1;
            patch[(size_t)y * (size_t)(w + 1) + (size_t)x] = tag_scene_look(s, r);
        }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const size_t at = (size_t)y * (size_t)(w + 1) + (size_t)x, below = at + (size_t)w + 1;
            float *out = light + (size_t)y * (size_t)w + (size_t)x;
            *out = (float)(patch[at] & 1);
            if (patch[at] == patch[at + 1] && patch[at] == patch[below] && patch[at] == patch[below + 1])
                continue;
            int sum = 0;
            for (int k = 0; k < SCENE_SAMPLES * SCENE_SAMPLES; k++) {
                double u = (k % SCENE_SAMPLES + 0.5) / SCENE_SAMPLES,
                       v = (k / SCENE_SAMPLES + 0.5) / SCENE_SAMPLES;
                double r[3];
                for (int c = 0; c < 3; c++)
                    r[c] = (1 - v) * ((1 - u) * ray[3 * at + (size_t)c] + u * ray[3 * at + 3 + (size_t)c]) +
                           v * ((1 - u) * ray[3 * below + (size_t)c] + u * ray[3 * below + 3 + (size_t)c]);
                sum += tag_scene_look(s, r) & 1;
            }
            *out = (float)sum / (SCENE_SAMPLES * SCENE_SAMPLES);
        }
    free(ray);
    free(patch);
}

/* Rows of `in` filtered into the columns of `out`. */
static inline void tag_scene_filter(float *out, const float *in, int w, int h, const float *kernel, int reach)
{
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float sum = 0;
            for (int k = -reach; k <= reach; k++) {
                int at = x + k < 0 ? 0 : x + k >= w ? w - 1 : x + k;
                sum += kernel[k + reach] * in[(size_t)y * (size_t)w + (size_t)at];
            }
            out[(size_t)x * (size_t)h + (size_t)y] = sum;
        }
}

static inline void tag_scene_blur(float *light, int w, int h, double blur)
{
    float kernel[41], sum = 0, *turned = malloc(sizeof *turned * (size_t)w * (size_t)h);
    const int reach = (int)fmin(20, ceil(4 * blur));
    for (int k = -reach; k <= reach; k++) {
        const double scale = sqrt(0.5) / blur; /* of a pixel's width, too */
        sum += kernel[k + reach] = (float)(erf((k + 0.5) * scale) - erf((k - 0.5) * scale));
    }
    for (int k = 0; k <= 2 * reach; k++) kernel[k] /= sum;
    tag_scene_filter(turned, light, w, h, kernel, reach);
    tag_scene_filter(light, turned, h, w, kernel, reach);
    free(turned);
}

/* The blurred light of every pixel (h,w), to be freed with free(); NULL: a tag that there is not. */
static inline float *tag_scene_light(tag_scene *s)
{
    const int w = s->camera.width, h = s->camera.height;
    if (!tag_scene_prepare(s)) return NULL;
    float *light = malloc(sizeof *light * (size_t)w * (size_t)h);
    tag_scene_expose(light, s);
    if (s->blur > 0) tag_scene_blur(light, w, h, s->blur);
    return light;
}

/* One exposure of the light. */
static inline td_image *tag_scene_shoot(const tag_scene *s, const float *light, td_random *random)
{
    td_image *image = NULL;
    const int w = s->camera.width, h = s->camera.height;
    if (!light || td_image_new(&image, w, h, 1, NULL) != TD_OK) return NULL;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const size_t at = (size_t)y * (size_t)w + (size_t)x;
            double grey = s->dark + (s->light - s->dark) * (double)light[at];
            grey = grey * (1 - s->fall * x / w) + s->noise * td_random_normal(random);
            image->data[at] = (uint8_t)fmin(255, fmax(0, floor(grey + 0.5)));
        }
    return image;
}

static inline td_image *tag_scene_render(tag_scene *s, td_random *random)
{
    float *light = tag_scene_light(s);
    td_image *image = tag_scene_shoot(s, light, random);
    free(light);
    return image;
}

/* Where point `index` is seen, px; false when it is outside the image by less than `margin` from its edge. */
static inline bool tag_scene_truth(double pixel[2], const tag_scene *s, size_t index, double margin)
{
    double p[3];
    td_target_point(p, &s->target, index);
    td_pose_transform(p, &s->camera_from_target, p);
    return td_camera_project(pixel, NULL, NULL, &s->camera, p) && pixel[0] > margin && pixel[1] > margin &&
           pixel[0] < s->camera.width - 1 - margin && pixel[1] < s->camera.height - 1 - margin;
}

/* ---- random views ---- */

static inline double tag_scene_between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

static inline td_target tag_scene_grid(int columns, int rows, int border)
{
    td_target t = {.kind = TD_TARGET_APRILGRID, .plane_count = 1, .polarity = TD_MARK_ANY, .border = border};
    t.plane[0] = (td_target_plane){columns, rows, 0.1144, td_pose_identity()};
    t.tag_size_m = 0.088;
    strcpy(t.dictionary, "tag36h11");
    return t;
}

/* Nine tags in a loose array, turned by some angles in their plane and leant by a little. */
static inline td_target tag_scene_singles(td_random *random)
{
    td_target t = {.kind = TD_TARGET_TAGS, .polarity = TD_MARK_ANY, .border = 1, .tag_count = 9};
    strcpy(t.dictionary, "tag36h11");
    for (int i = 0; i < t.tag_count; i++) {
        const double lean[3] = {tag_scene_between(random, -0.3, 0.3), tag_scene_between(random, -0.3, 0.3),
                                tag_scene_between(random, -3.1, 3.1)};
        td_target_tag *tag = &t.tag[i];
        *tag = (td_target_tag){37 * i + (int)td_random_below(random, 37),
                               tag_scene_between(random, 0.05, 0.12),
                               {{1, 0, 0, 0}, {0.2 * (i % 3), 0.2 * (i / 3), 0}}};
        td_rotation_exp(tag->target_from_tag.q, lean);
    }
    return t;
}

/* A wide or a normal lens with distortion, 640x480; a board leant by up to 45 degrees, turned by any angle,
 * `share` of the image's height large; blur, light and noise as cameras have them. */
static inline tag_scene tag_scene_random(const td_target *target, bool squares, double share,
                                         td_random *random)
{
    tag_scene s = {.target = *target, .squares = squares};
    const double focal = tag_scene_between(random, 380, 700);
    const double bend = -0.2 * (700 - focal) / 320;
    s.camera = (td_camera){TD_CAMERA_BROWN5,
                           640,
                           480,
                           {focal, focal * 1.002, 321.3, 238.4, bend, 0.2 * -bend, 0.0004, -0.0006, 0}};
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (size_t i = 0; i < td_target_point_count(target); i++) {
        double p[3];
        td_target_point(p, target, i);
        for (int c = 0; c < 2; c++) low[c] = fmin(low[c], p[c]), high[c] = fmax(high[c], p[c]);
    }
    const double size = fmax(high[0] - low[0], high[1] - low[1]), away = focal * size / (480 * share);
    const double lean = tag_scene_between(random, 0, 0.78), way = tag_scene_between(random, 0, 6.283);
    const double omega[3] = {lean * cos(way), lean * sin(way), 0},
                 spin[3] = {0, 0, tag_scene_between(random, -3.14, 3.14)};
    td_pose a = td_pose_identity(), b = td_pose_identity(), c = td_pose_identity();
    td_rotation_exp(a.q, omega);
    td_rotation_exp(b.q, spin);
    for (int k = 0; k < 2; k++) c.t[k] = -(low[k] + high[k]) / 2;
    a = td_pose_compose(&a, &b);
    s.camera_from_target = td_pose_compose(&a, &c);
    s.camera_from_target.t[0] += away * tag_scene_between(random, -0.15, 0.15);
    s.camera_from_target.t[1] += away * tag_scene_between(random, -0.1, 0.1);
    s.camera_from_target.t[2] += away * tag_scene_between(random, 1, 1.6);
    s.dark = tag_scene_between(random, 15, 50);
    s.light = tag_scene_between(random, 150, 235);
    s.fall = tag_scene_between(random, 0, 0.3);
    s.blur = tag_scene_between(random, 0.4, 1.3);
    s.noise = tag_scene_between(random, 1, 5);
    return s;
}

#endif
