/* How well interest points repeat (Schmid, Mohr and Bauckhage 2000): of the points that both images can see,
 * the share that is found in both, within 1.5 px of the second image. One point is paired once.
 *
 * Image pairs whose homography is known: graf1 and graf3 of opencv-doc, with its H1to3p.xml; and graf1
 * turned, shrunk, and with another gamma. What is warped gets noise of its own, as a second exposure has. */
#ifndef TELEDIMOS_TESTS_REPEATABILITY_H
#define TELEDIMOS_TESTS_REPEATABILITY_H

#include "core/image.h"
#include "core/random.h"
#include "recon/interest.h"
#include "tests/check.h"
#include "tests/recon/interest_opencv.h"

#define GRAF "/usr/share/doc/opencv-doc/examples/data/"
enum { MOST_POINTS = 4096 };
static const double NEAR_PX = 1.5, EDGE_PX = 5, NOISE_GREY = 2;

typedef struct pair_of_views {
    td_image *first, *second;
    double h[9]; /* second pixel from first, homogeneous */
} pair_of_views;

static inline void views_free(pair_of_views *v)
{
    td_image_free(&v->first);
    td_image_free(&v->second);
}

static inline void map_point(double out[2], const double h[9], const double p[2])
{
    double w = h[6] * p[0] + h[7] * p[1] + h[8], x = (h[0] * p[0] + h[1] * p[1] + h[2]) / w;
    out[1] = (h[3] * p[0] + h[4] * p[1] + h[5]) / w;
    out[0] = x;
}

static inline void invert_homography(double g[9], const double h[9])
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            int r1 = (c + 1) % 3, r2 = (c + 2) % 3, c1 = (r + 1) % 3, c2 = (r + 2) % 3;
            g[3 * r + c] = h[3 * r1 + c1] * h[3 * r2 + c2] - h[3 * r1 + c2] * h[3 * r2 + c1];
        }
}

/* ---- image pairs ---- */

/* Keys' cubic convolution (1981), a = -1/2. */
static inline double sample_cubic(const td_image *image, double x, double y)
{
    int x0 = (int)floor(x), y0 = (int)floor(y);
    double weight[2][4], sum = 0, at[2] = {x - x0, y - y0};
    for (int d = 0; d < 2; d++)
        for (int i = 0; i < 4; i++) {
            double t = fabs(at[d] - (i - 1));
            weight[d][i] = t < 1 ? (1.5 * t - 2.5) * t * t + 1 : ((-0.5 * t + 2.5) * t - 4) * t + 2;
        }
    for (int j = 0; j < 4; j++)
        for (int i = 0; i < 4; i++)
            sum += weight[0][i] * weight[1][j] * td_image_sample(image, x0 - 1 + i, y0 - 1 + j, 0);
    return sum;
}

/* What a camera would see whose pixels are at source_from_second in `source`. A shrunk pixel is the mean over
 * its square in the source, less the source's own pixel: sides of sqrt(s^2 - 1). */
static inline td_image *warp(const td_image *source, const double source_from_second[9], int width,
                             int height, double shrink, td_random *random)
{
    td_image *out = NULL;
    td_error error;
    check_ok(td_image_new(&out, width, height, 1, &error), error);
    int n = shrink > 1 ? 4 : 1;
    double side = sqrt(fmax(0, shrink * shrink - 1));
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            double p[2], grey = 0;
            map_point(p, source_from_second, (double[2]){x, y});
            for (int j = 0; j < n; j++)
                for (int i = 0; i < n; i++)
                    grey += sample_cubic(source, p[0] + ((i + 0.5) / n - 0.5) * side,
                                         p[1] + ((j + 0.5) / n - 0.5) * side);
            grey = grey / (n * n) + NOISE_GREY * td_random_normal(random);
            out->data[(size_t)y * (size_t)width + (size_t)x] = (uint8_t)lrint(fmin(fmax(grey, 0), 255));
        }
    return out;
}

/* The middle square of graf1, and the same turned: at no angle does the turned one see outside graf1. */
static inline pair_of_views views_turned(const td_image *graf, double degrees)
{
    int side = (int)(fmin(graf->width, graf->height) / sqrt(2));
    int left = (graf->width - side) / 2, top = (graf->height - side) / 2;
    double c = cos(degrees * acos(-1) / 180), s = sin(degrees * acos(-1) / 180), m = (side - 1) / 2.0;
    double back[9] = {c, s, m - c * m - s * m + left, -s, c, m + s * m - c * m + top, 0, 0, 1};
    pair_of_views v = {.h = {c, -s, m - c * m + s * m, s, c, m - s * m - c * m, 0, 0, 1}};
    td_random random = td_random_seed(1, (uint64_t)(10 * degrees));
    td_error error;
    check_ok(td_image_new(&v.first, side, side, 1, &error), error);
    for (int y = 0; y < side; y++)
        memcpy(v.first->data + (size_t)y * (size_t)side,
               graf->data + (size_t)(y + top) * (size_t)graf->width + (size_t)left, (size_t)side);
    v.second = warp(graf, back, side, side, 1, &random);
    return v;
}

static inline td_image *copy_image(const td_image *image)
{
    td_image *copy = NULL;
    td_error error;
    check_ok(td_image_new(&copy, image->width, image->height, 1, &error), error);
    memcpy(copy->data, image->data, (size_t)image->width * (size_t)image->height);
    return copy;
}

static inline pair_of_views views_shrunk(const td_image *graf, double s)
{
    double o = (s - 1) / 2; /* centres of pixels */
    pair_of_views v = {.first = copy_image(graf), .h = {1 / s, 0, -o / s, 0, 1 / s, -o / s, 0, 0, 1}};
    td_random random = td_random_seed(2, (uint64_t)(100 * s));
    v.second = warp(graf, (double[9]){s, 0, o, 0, s, o, 0, 0, 1}, (int)(graf->width / s),
                    (int)(graf->height / s), s, &random);
    return v;
}

static inline pair_of_views views_gamma(const td_image *graf, double gamma)
{
    pair_of_views v = {
        .first = copy_image(graf), .second = copy_image(graf), .h = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    td_random random = td_random_seed(3, (uint64_t)(100 * gamma));
    for (size_t i = 0; i < (size_t)graf->width * (size_t)graf->height; i++) {
        double grey = 255 * pow(graf->data[i] / 255.0, gamma) + NOISE_GREY * td_random_normal(&random);
        v.second->data[i] = (uint8_t)lrint(fmin(fmax(grey, 0), 255));
    }
    return v;
}

/* graf1 and graf3. False: opencv-doc is not installed. */
static inline bool views_graf(pair_of_views *v)
{
    td_error error;
    char text[4096] = "";
    *v = (pair_of_views){0};
    FILE *file = fopen(GRAF "H1to3p.xml", "r");
    if (!file) return false;
    size_t length = fread(text, 1, sizeof text - 1, file);
    fclose(file);
    text[length] = 0;
    char *at = strstr(text, "<data>");
    if (!at) return false;
    at += strlen("<data>");
    for (int i = 0; i < 9; i++) v->h[i] = strtod(at, &at);
    if (td_image_read(&v->first, GRAF "graf1.png", 1, &error) == TD_OK &&
        td_image_read(&v->second, GRAF "graf3.png", 1, &error) == TD_OK)
        return true;
    views_free(v);
    return false;
}

/* ---- the figure ---- */

typedef struct found_points {
    size_t count;
    double xy[MOST_POINTS][2];
} found_points;

static inline bool sees(const td_image *image, const double p[2])
{
    return p[0] >= EDGE_PX && p[1] >= EDGE_PX && p[0] <= image->width - 1 - EDGE_PX &&
           p[1] <= image->height - 1 - EDGE_PX;
}

/* Drops what the other image does not see. */
static inline void keep_common(found_points *p, const td_image *own, const td_image *other, const double h[9])
{
    size_t kept = 0;
    for (size_t i = 0; i < p->count; i++) {
        double q[2];
        map_point(q, h, p->xy[i]);
        if (!sees(own, p->xy[i]) || !sees(other, q)) continue;
        memmove(p->xy[kept++], p->xy[i], sizeof q);
    }
    p->count = kept;
}

typedef struct near_pair {
    double distance;
    size_t a, b;
} near_pair;

static inline int nearer_first(const void *p, const void *q)
{
    const near_pair *a = p, *b = q;
    if (a->distance != b->distance) return a->distance < b->distance ? -1 : 1;
    return a->a != b->a ? (a->a > b->a) - (a->a < b->a) : (a->b > b->b) - (a->b < b->b);
}

/* Points a (first image) and b (second) are paired nearest first. */
static inline double repeatability(found_points *a, found_points *b, const pair_of_views *v)
{
    double back[9];
    size_t pairs = 0, count = 0;
    invert_homography(back, v->h);
    keep_common(a, v->first, v->second, v->h);
    keep_common(b, v->second, v->first, back);
    enum { NEIGHBOURS = 16 }; /* that keep a pixel's distance and lie within 1.5 px */
    near_pair *near = malloc((NEIGHBOURS * a->count + 1) * sizeof *near);
    for (size_t i = 0; i < a->count; i++) {
        double p[2];
        map_point(p, v->h, a->xy[i]);
        for (size_t j = 0; j < b->count; j++) {
            if (fabs(p[0] - b->xy[j][0]) > NEAR_PX || fabs(p[1] - b->xy[j][1]) > NEAR_PX) continue;
            const double distance = hypot(p[0] - b->xy[j][0], p[1] - b->xy[j][1]);
            if (distance <= NEAR_PX && count < NEIGHBOURS * a->count)
                near[count++] = (near_pair){distance, i, j};
        }
    }
    qsort(near, count, sizeof *near, nearer_first);
    char *used = calloc(a->count + b->count + 1, 1);
    for (size_t i = 0; i < count; i++) {
        if (used[near[i].a] || used[a->count + near[i].b]) continue;
        used[near[i].a] = used[a->count + near[i].b] = 1;
        pairs++;
    }
    free(used);
    free(near);
    size_t least = a->count < b->count ? a->count : b->count;
    return least ? (double)pairs / (double)least : 0;
}

static inline void find_ours(found_points *p, const td_image *image, const td_interest_options *options)
{
    td_interest_point *list;
    td_error error;
    check_ok(td_interest_points(&list, &p->count, image, options, &error), error);
    assert_true(p->count <= MOST_POINTS);
    for (size_t i = 0; i < p->count; i++) {
        p->xy[i][0] = list[i].x;
        p->xy[i][1] = list[i].y;
    }
    free(list);
}

static inline double repeat_ours(const pair_of_views *v, const td_interest_options *options, size_t count[2])
{
    found_points a, b;
    find_ours(&a, v->first, options);
    find_ours(&b, v->second, options);
    count[0] = a.count;
    count[1] = b.count;
    return repeatability(&a, &b, v);
}

/* ---- curves ---- */

enum { MOST_VIEWS = 40, OPENCV_SETTINGS = 4 };

/* Of one kind of change; peers with as many points as ours in each image, and with whichever of their
 * settings has the best mean over the curve. */
typedef struct curve {
    const char *name, *unit;
    size_t count;
    double at[MOST_VIEWS], ours[MOST_VIEWS], minimum_eigenvalue[MOST_VIEWS], harris[MOST_VIEWS];
} curve;

static inline double curve_mean(const double *value, size_t count)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++) sum += value[i] / (double)count;
    return sum;
}

static inline double repeat_opencv(const pair_of_views *v, const opencv_corners *how, const size_t count[2])
{
    found_points a, b;
    a.count = opencv_find_corners(a.xy[0], count[0], v->first->data, v->first->width, v->first->height, how);
    b.count =
        opencv_find_corners(b.xy[0], count[1], v->second->data, v->second->width, v->second->height, how);
    return repeatability(&a, &b, v);
}

static inline void measure_curve(curve *c, const pair_of_views *views, const td_interest_options *options)
{
    static const int block[OPENCV_SETTINGS] = {3, 3, 4, 5}, sub_pixel[OPENCV_SETTINGS] = {0, 1, 0, 0};
    size_t found[MOST_VIEWS][2];
    double value[MOST_VIEWS];
    for (size_t i = 0; i < c->count; i++) c->ours[i] = repeat_ours(views + i, options, found[i]);
    for (int harris = 0; harris < 2; harris++) {
        double *best = harris ? c->harris : c->minimum_eigenvalue;
        for (int s = 0; s < OPENCV_SETTINGS; s++) {
            const opencv_corners how = {harris, block[s], sub_pixel[s], harris ? 1e-6 : 1e-4,
                                        options->distance_px};
            for (size_t i = 0; i < c->count; i++) value[i] = repeat_opencv(views + i, &how, found[i]);
            if (s == 0 || curve_mean(value, c->count) > curve_mean(best, c->count))
                memcpy(best, value, c->count * sizeof *best);
        }
    }
}

/* One kind of change of graf1: 0 rotation, 1 scale, 2 gamma, in c->at's values. */
static inline void measure_change(curve *c, int kind, const td_image *graf,
                                  const td_interest_options *options)
{
    pair_of_views views[MOST_VIEWS];
    for (size_t i = 0; i < c->count; i++)
        views[i] = kind == 0   ? views_turned(graf, c->at[i])
                   : kind == 1 ? views_shrunk(graf, c->at[i])
                               : views_gamma(graf, c->at[i]);
    measure_curve(c, views, options);
    for (size_t i = 0; i < c->count; i++) views_free(views + i);
}

#endif
