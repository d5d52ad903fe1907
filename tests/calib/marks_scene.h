/* Rendered images of marks whose truth is known: exact areas of polygons, a Gaussian blur, uneven light,
 * noise, eight bits. Shares nothing with the detector: the coverage is that of the polygon of the projected
 * rim, summed by signed trapezoids on a grid of subpixels, and the blur is a discrete convolution there. */
#ifndef TELEDIMOS_TESTS_CALIB_MARKS_SCENE_H
#define TELEDIMOS_TESTS_CALIB_MARKS_SCENE_H

#include "calib/marks.h"
#include "core/camera.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/random.h"
#include "core/target.h"
#include "tests/check.h"

static const double PI = 3.14159265358979323846;

enum { SUBPIXELS = 4, MAX_RIM = 400 };

typedef struct scene {
    int width, height;
    double *cover; /* (height,width) 0 to 1 */
    double blur;   /* px */
} scene;

static inline scene scene_new(int width, int height, double blur)
{
    return (scene){width, height, calloc((size_t)width * (size_t)height, sizeof(double)), blur};
}

/* Adds to area (h,w) how much of each cell the part of a polygon's edge from (x0, y0) to (x1, y1) has on its
 * right. */
static inline void add_edge(double *area, int w, int h, double x0, double y0, double x1, double y1)
{
    double sign = 1;
    if (y0 > y1) {
        double t = y0;
        y0 = y1, y1 = t, t = x0, x0 = x1, x1 = t;
        sign = -1;
    }
    for (int y = (int)floor(fmax(y0, 0)); y < h && y < y1; y++) {
        double ya = fmax(y, y0), yb = fmin(y + 1, y1);
        double xa = x0 + (ya - y0) * (x1 - x0) / (y1 - y0), xb = x0 + (yb - y0) * (x1 - x0) / (y1 - y0);
        double left = fmin(xa, xb), right = fmax(xa, xb), height = sign * (yb - ya);
        for (int x = (int)floor(fmax(left, 0)); x < w; x++) {
            /* Mean over the edge of the part of the cell on its right; the edge runs from left to right
             * evenly. */
            double a = fmin(fmax(left, x), x + 1), b = fmin(fmax(right, x), x + 1), span = right - left,
                   share;
            if (span < 1e-12)
                share = fmin(fmax(x + 1 - left, 0), 1);
            else
                share = (fmax(fmin(right, x) - left, 0) + (b - a) * (x + 1 - 0.5 * (a + b))) / span;
            area[(size_t)y * (size_t)w + (size_t)x] += height * share;
            if (x > right) { /* all cells beyond have the edge on their left */
                for (int k = x + 1; k < w; k++) area[(size_t)y * (size_t)w + (size_t)k] += height;
                break;
            }
        }
    }
}

static inline void convolve(double *out, const double *in, int n, int stride, const double *weight, int reach)
{
    for (int i = 0; i < n; i++) {
        double sum = 0;
        for (int k = -reach; k <= reach; k++)
            if (i + k >= 0 && i + k < n) sum += weight[k + reach] * in[(size_t)(i + k) * (size_t)stride];
        out[(size_t)i * (size_t)stride] = sum;
    }
}

/* Adds a polygon (n,2) px to the scene. */
static inline void scene_add_polygon(scene *s, const double *xy, int n)
{
    double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
    for (int i = 0; i < 2 * n; i++) {
        low[i % 2] = fmin(low[i % 2], xy[i]);
        high[i % 2] = fmax(high[i % 2], xy[i]);
    }
    int margin = (int)ceil(5 * s->blur) + 2;
    int x0 = (int)floor(low[0]) - margin, y0 = (int)floor(low[1]) - margin;
    int x1 = (int)ceil(high[0]) + margin, y1 = (int)ceil(high[1]) + margin;
    if (x1 < 0 || y1 < 0 || x0 >= s->width || y0 >= s->height) return;
    int w = (x1 - x0 + 1) * SUBPIXELS, h = (y1 - y0 + 1) * SUBPIXELS;
    double *area = calloc((size_t)w * (size_t)h, sizeof *area),
           *other = calloc((size_t)w * (size_t)h, sizeof *other);
    for (int i = 0; i < n; i++) {
        const double *a = xy + 2 * i, *b = xy + 2 * ((i + 1) % n);
        add_edge(area, w, h, (a[0] + 0.5 - x0) * SUBPIXELS, (a[1] + 0.5 - y0) * SUBPIXELS,
                 (b[0] + 0.5 - x0) * SUBPIXELS, (b[1] + 0.5 - y0) * SUBPIXELS);
    }
    int reach = (int)ceil(5 * s->blur * SUBPIXELS);
    double *weight = calloc((size_t)(2 * reach + 1), sizeof *weight), sum = 0;
    for (int k = -reach; k <= reach; k++) {
        double at = k / (s->blur * SUBPIXELS);
        sum += weight[k + reach] = s->blur > 0 ? exp(-0.5 * at * at) : 1;
    }
    for (int k = 0; k <= 2 * reach; k++) weight[k] /= sum;
    for (int y = 0; y < h; y++)
        convolve(other + (size_t)y * (size_t)w, area + (size_t)y * (size_t)w, w, 1, weight, reach);
    for (int x = 0; x < w; x++) convolve(area + x, other + x, h, w, weight, reach);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int px = x0 + x / SUBPIXELS, py = y0 + y / SUBPIXELS;
            if (px < 0 || py < 0 || px >= s->width || py >= s->height) continue;
            s->cover[(size_t)py * (size_t)s->width + (size_t)px] +=
                fabs(area[(size_t)y * (size_t)w + (size_t)x]) / (SUBPIXELS * SUBPIXELS);
        }
    free(area);
    free(other);
    free(weight);
}

/* The image of a disc's rim as a polygon, and its centre of gravity (may be NULL). */
static inline int rim_of_disc(double *xy, double centroid[2], const td_camera *camera,
                              const td_pose *camera_from_plane, double x, double y, double diameter)
{
    for (int i = 0; i < MAX_RIM; i++) {
        double angle = 2 * PI * i / MAX_RIM;
        double p[3] = {x + diameter / 2 * cos(angle), y + diameter / 2 * sin(angle), 0};
        td_pose_transform(p, camera_from_plane, p);
        if (!td_camera_project(xy + 2 * i, NULL, NULL, camera, p)) return 0;
    }
    double area = 0, m[2] = {0};
    for (int i = 0; i < MAX_RIM; i++) {
        const double *a = xy + 2 * i, *b = xy + 2 * ((i + 1) % MAX_RIM);
        double ax = a[0] - xy[0], ay = a[1] - xy[1], bx = b[0] - xy[0], by = b[1] - xy[1],
               cross = ax * by - ay * bx;
        area += cross / 2;
        m[0] += (ax + bx) * cross / 6;
        m[1] += (ay + by) * cross / 6;
    }
    if (centroid)
        for (int k = 0; k < 2; k++) centroid[k] = xy[k] + m[k] / area;
    return MAX_RIM;
}

/* Adds all marks of a target; `hidden` (points, may be NULL) are left out. */
static inline void scene_add_target(scene *s, const td_camera *camera, const td_pose *camera_from_target,
                                    const td_target *target, const bool *hidden)
{
    double xy[2 * MAX_RIM];
    for (size_t i = 0; i < td_target_point_count(target); i++) {
        size_t first;
        const td_target_plane *p = &target->plane[td_target_plane_of(target, i, &first)];
        if (hidden && hidden[i]) continue;
        td_pose pose = td_pose_compose(camera_from_target, &p->target_from_plane);
        double x = (double)((i - first) % (size_t)p->columns) * p->spacing_m;
        double y = (double)((i - first) / (size_t)p->columns) * p->spacing_m;
        int n = rim_of_disc(xy, NULL, camera, &pose, x, y, target->diameter_m);
        if (n) scene_add_polygon(s, xy, n);
    }
}

static inline void scene_add_ellipse(scene *s, double x, double y, double a, double b, double angle)
{
    double xy[2 * MAX_RIM];
    for (int i = 0; i < MAX_RIM; i++) {
        double t = 2 * PI * i / MAX_RIM, u = a * cos(t), v = b * sin(t);
        xy[2 * i] = x + u * cos(angle) - v * sin(angle);
        xy[2 * i + 1] = y + u * sin(angle) + v * cos(angle);
    }
    scene_add_polygon(s, xy, MAX_RIM);
}

/* How a scene is lit and seen. */
typedef struct light {
    double inside, outside; /* grey levels */
    double vignetting;      /* loss at the corners, 0 to 1 */
    double slope;           /* loss from left to right, 0 to 1 */
    double noise;           /* standard deviation, grey levels */
} light;

/* The image; the scene is freed. */
static inline td_image *scene_image(scene *s, const light *l, td_random *random)
{
    td_image *image = NULL;
    td_error error;
    check_ok(td_image_new(&image, s->width, s->height, 1, &error), error);
    double r2 = 0.25 * (s->width * s->width + s->height * s->height);
    for (int y = 0, i = 0; y < s->height; y++) {
        for (int x = 0; x < s->width; x++, i++) {
            double dx = x - 0.5 * s->width, dy = y - 0.5 * s->height, cover = fmin(s->cover[i], 1);
            double gain = (1 - l->vignetting * (dx * dx + dy * dy) / r2) * (1 - l->slope * x / s->width);
            double grey = gain * (l->outside + (l->inside - l->outside) * cover);
            if (l->noise > 0) grey += l->noise * td_random_normal(random);
            image->data[i] = (uint8_t)fmin(fmax(floor(grey + 0.5), 0), 255);
        }
    }
    free(s->cover);
    s->cover = NULL;
    return image;
}

/* A plane whose point (x, y) is seen at `pixel` at a distance; `tilt` away from facing the camera about an
 * axis at `azimuth`, then turned in itself by `roll` (rad). */
static inline td_pose pose_of_plane(const td_camera *camera, const double pixel[2], double distance,
                                    double tilt, double azimuth, double roll, double x, double y)
{
    double ray[3], q[4], omega[3];
    assert_true(td_camera_unproject(ray, NULL, NULL, camera, pixel));
    td_pose pose = td_pose_identity();
    /* The rotation that takes z to the ray. */
    double angle = acos(ray[2]), length = hypot(ray[0], ray[1]);
    omega[0] = length > 0 ? -ray[1] / length * angle : 0;
    omega[1] = length > 0 ? ray[0] / length * angle : 0;
    omega[2] = 0;
    td_rotation_exp(q, omega);
    memcpy(pose.q, q, sizeof q);
    td_pose turn = td_pose_identity();
    omega[0] = tilt * cos(azimuth), omega[1] = tilt * sin(azimuth), omega[2] = 0;
    td_rotation_exp(turn.q, omega);
    pose = td_pose_compose(&pose, &turn);
    omega[0] = omega[1] = 0, omega[2] = roll;
    td_rotation_exp(turn.q, omega);
    pose = td_pose_compose(&pose, &turn);
    double there[3], point[3] = {x, y, 0};
    td_pose_rotate(there, &pose, point);
    for (int k = 0; k < 3; k++) pose.t[k] = distance * ray[k] - there[k];
    return pose;
}

static inline td_target flat_target(int columns, int rows, td_mark_polarity polarity)
{
    td_target t = {.kind = TD_TARGET_MARKS, .plane_count = 1, .diameter_m = 0.018, .polarity = polarity};
    t.plane[0] = (td_target_plane){columns, rows, 0.03, td_pose_identity()};
    return t;
}

#endif
