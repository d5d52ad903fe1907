/* Views of a charuco with known corners: its drawing seen by a distorting camera.
 *
 * A pixel is the mean of the drawing at points around its centre, of offsets as in render_chessboard.h; the
 * drawing is fine enough (CHARUCO_FINE px per square) to stand for the board. */
#ifndef TELEDIMOS_TESTS_CHARUCO_SCENE_H
#define TELEDIMOS_TESTS_CHARUCO_SCENE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/target_drawing.h"
#include "core/camera.h"
#include "core/random.h"

enum { CHARUCO_FINE = 96, CHARUCO_PAIRS = 12 };

typedef struct charuco_scene {
    td_target target;
    td_image *board; /* the drawing */
    double px_from_m[6];
    td_camera camera;
    td_pose camera_from_target;
    double blur, noise, dark, light; /* px; grey levels */
} charuco_scene;

static inline td_target charuco_target(int columns, int rows, const char *dictionary)
{
    td_target t = {.kind = TD_TARGET_CHARUCO, .plane_count = 1, .border = 1, .tag_size_m = 0.0225};
    t.plane[0] = (td_target_plane){columns, rows, 0.03, td_pose_identity()};
    strcpy(t.dictionary, dictionary);
    return t;
}

static inline td_status charuco_draw(charuco_scene *s, td_error *error)
{
    td_target_drawing_options o = td_target_drawing_options_default();
    o.ruler = o.text = false;
    o.dots_per_inch = CHARUCO_FINE / s->target.plane[0].spacing_m * 0.0254;
    td_image_free(&s->board);
    return td_target_render(&s->board, s->px_from_m, &s->target, 0, &o, error);
}

/* A wide camera of 800x600 px that bends lines. */
static inline td_camera charuco_camera(void)
{
    td_camera c = {.model = TD_CAMERA_BROWN5, .width = 800, .height = 600};
    const double p[] = {625, 626, 401, 298, -0.2, 0.08, 1e-3, -5e-4, -0.01};
    memcpy(c.parameter, p, sizeof p);
    return c;
}

/* A pose in which the board's middle lies somewhere in the image, at `distance` m, turned as may be, leant by
 * up to `tilt` (rad). */
static inline td_pose charuco_pose(const charuco_scene *s, double distance, double tilt, td_random *random)
{
    const td_target_plane *p = s->target.plane;
    const double w = p->spacing_m * (p->columns - 1) / 2, h = p->spacing_m * (p->rows - 1) / 2;
    const double about = 6.2831853 * td_random_uniform(random), lean = tilt * td_random_uniform(random);
    const double xi[4][6] = {{0, 0, 0, distance * 1.0 * (td_random_uniform(random) - 0.5),
                              distance * 0.75 * (td_random_uniform(random) - 0.5), distance},
                             {lean * cos(about), lean * sin(about), 0, 0, 0, 0},
                             {0, 0, 6.2831853 * td_random_uniform(random), 0, 0, 0},
                             {0, 0, 0, -w, -h, 0}};
    td_pose pose = td_pose_identity();
    for (int i = 0; i < 4; i++) {
        td_pose next = td_pose_exp(xi[i]);
        pose = td_pose_compose(&pose, &next);
    }
    return pose;
}

/* The drawing's pixel under a pixel of the view; false when the ray misses the board. */
static inline bool charuco_under(double px[2], const charuco_scene *s, const td_pose *target_from_camera,
                                 double x, double y)
{
    const double pixel[2] = {x, y};
    double ray[3], d[3];
    if (!td_camera_unproject(ray, NULL, NULL, &s->camera, pixel)) return false;
    td_pose_rotate(d, target_from_camera, ray);
    const double t = -target_from_camera->t[2] / d[2];
    if (!(t > 0)) return false;
    const double mx = target_from_camera->t[0] + t * d[0], my = target_from_camera->t[1] + t * d[1];
    px[0] = s->px_from_m[0] * mx + s->px_from_m[2];
    px[1] = s->px_from_m[4] * my + s->px_from_m[5];
    return true;
}

/* The drawing's pixels under those of the view and one column and row more, (height+1,width+1,2); NaN beside
 * it. To be freed with free(). */
static inline double *charuco_rays(const charuco_scene *s)
{
    const int w = s->camera.width + 1, h = s->camera.height + 1;
    const td_pose target_from_camera = td_pose_inverse(&s->camera_from_target);
    double *under = malloc(2 * (size_t)w * (size_t)h * sizeof *under);
    for (int i = 0; under && i < w * h; i++)
        if (!charuco_under(under + 2 * i, s, &target_from_camera, i % w, i / w))
            under[2 * i] = under[2 * i + 1] = NAN;
    return under;
}

/* Points of the drawing around a pixel's centre, to be averaged. */
static inline void charuco_offsets(double offset[2 * CHARUCO_PAIRS], double blur)
{
    const double phi = 1.1673039782614187; /* x^5 = x + 1 */
    for (int i = 0; i < CHARUCO_PAIRS; i++) {
        double u[4], step = 1;
        for (int k = 0; k < 4; k++) u[k] = fmod(0.5 + (i + 1) * (step /= phi), 1);
        const double r = blur * sqrt(-2 * log(1 - u[0]));
        offset[2 * i] = r * cos(6.283185307179586 * u[1]) + u[2] - 0.5;
        offset[2 * i + 1] = r * sin(6.283185307179586 * u[1]) + u[3] - 0.5;
    }
}

/* What lies behind the board is grey. Between a pixel's neighbours rays are taken as linear: exact to 1e-4
 * px. */
static inline td_status charuco_photograph(td_image **image, const charuco_scene *s, td_random *random,
                                           td_error *error)
{
    enum { OF = 2 * CHARUCO_PAIRS };
    double offset[OF], *under = charuco_rays(s);
    const int width = s->camera.width;
    if (!under) return td_fail(error, TD_ERROR_MEMORY, "no memory for the rays");
    charuco_offsets(offset, s->blur);
    td_status status = td_image_new(image, width, s->camera.height, 1, error);
    for (int i = 0; status == TD_OK && i < width * s->camera.height; i++) {
        const double *p = under + 2 * (i / width * (width + 1) + i % width), *q = p + 2,
                     *r = p + 2 * (width + 1);
        double sum = 0;
        for (int k = 0; k < OF; k++) {
            const double sign = k % 2 ? -1 : 1, a = sign * offset[k / 2 * 2],
                         b = sign * offset[k / 2 * 2 + 1];
            const double u = p[0] + a * (q[0] - p[0]) + b * (r[0] - p[0]);
            const double v = p[1] + a * (q[1] - p[1]) + b * (r[1] - p[1]);
            const bool inside = u >= 0 && v >= 0 && u < s->board->width - 1 && v < s->board->height - 1;
            sum += inside ? td_image_sample(s->board, u, v, 0) : 160;
        }
        const double grey =
            s->dark + (s->light - s->dark) * sum / (255 * OF) + s->noise * td_random_normal(random);
        (*image)->data[i] = (uint8_t)fmin(fmax(round(grey), 0), 255);
    }
    free(under);
    return status;
}

/* Where corner k is in the view; false when it is outside, or nearer to its border than `margin`. */
static inline bool charuco_truth(double px[2], const charuco_scene *s, size_t k, double margin)
{
    double p[3];
    td_target_point(p, &s->target, k);
    td_pose_transform(p, &s->camera_from_target, p);
    return td_camera_project(px, NULL, NULL, &s->camera, p) && px[0] >= margin && px[1] >= margin &&
           px[0] <= s->camera.width - 1 - margin && px[1] <= s->camera.height - 1 - margin;
}

#endif
