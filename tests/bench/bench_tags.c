/* Tags beside OpenCV's aruco and libapriltag, on rendered views whose corners are known: boards of both
 * borders, single tags; distortion, blur, noise, uneven light. libapriltag reads the border of 2 by a family
 * of altered geometry. A common offset of all its corners is taken off a peer's before its error is counted:
 * a matter of where pixels are counted from. Errors are over the tags that both found. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include "calib/tags.h"
#include "tests/bench/bench.h"
#include "tests/calib/render_tags.h"

enum { VIEWS = 24, FULL_VIEWS = 200 };

static const double INSIDE = 4; /* px from the image's border: tags nearer are not counted */
static const double WILD = 3;   /* px: a corner farther off is not this corner; its tag counts as missed */

/* What a detector saw of each view: (tags,8) px, NaN where nothing. */
typedef struct sighting {
    double *corner; /* (views,tags,8) */
} sighting;

typedef struct tags_input {
    int views, tags, border;
    tag_scene *scene;
    td_image **image;
    sighting ours, opencv, subpixel, apriltag;
} tags_input;

static double *corners_of(const tags_input *in, const sighting *s, int view, int tag)
{
    return s->corner + 8 * ((size_t)view * (size_t)in->tags + (size_t)tag);
}

static void forget(const tags_input *in, sighting *s)
{
    size_t n = 8 * (size_t)in->views * (size_t)in->tags;
    if (!s->corner) s->corner = malloc(n * sizeof *s->corner);
    for (size_t i = 0; i < n; i++) s->corner[i] = NAN;
}

static int tag_of(const tags_input *in, int view, int id)
{
    for (int k = 0; k < in->tags; k++)
        if (td_target_tag_id(&in->scene[view].target, 4 * (size_t)k) == id) return k;
    return -1;
}

static void run_ours(void *user)
{
    tags_input *in = user;
    forget(in, &in->ours);
    for (int v = 0; v < in->views; v++) {
        td_detection d = {0};
        if (td_tags_detect(&d, in->image[v], &in->scene[v].target, NULL) != TD_OK) continue;
        for (int k = 0; k < in->tags; k++)
            memcpy(corners_of(in, &in->ours, v, k), d.point + 8 * k, 8 * sizeof *d.point);
        td_detection_free(&d);
    }
}

static void run_opencv_way(tags_input *in, sighting *s, int refinement)
{
    enum { MOST = 256 };
    int id[MOST];
    double corner[8 * MOST];
    forget(in, s);
    for (int v = 0; v < in->views; v++) {
        bench_tags_view view = {in->image[v]->data, 640, 480, in->border, refinement, id, corner, MOST, 0};
        bench_opencv_tags(&view);
        for (int i = 0; i < view.count; i++) {
            int k = tag_of(in, v, id[i]);
            if (k >= 0) memcpy(corners_of(in, s, v, k), corner + 8 * i, 8 * sizeof *corner);
        }
    }
}

static void run_opencv(void *user)
{
    tags_input *in = user;
    run_opencv_way(in, &in->opencv, 1);
}

static void run_subpixel(void *user)
{
    tags_input *in = user;
    run_opencv_way(in, &in->subpixel, 0);
}

static void run_apriltag(void *user)
{
    tags_input *in = user;
    apriltag_detector_t *detector = apriltag_detector_create();
    apriltag_family_t *family = tag36h11_create();
    for (uint32_t i = 0; i < family->nbits && in->border == 2; i++) family->bit_x[i]++, family->bit_y[i]++;
    family->width_at_border += 2 * (in->border - 1);
    family->total_width += 2 * (in->border - 1);
    apriltag_detector_add_family(detector, family);
    detector->quad_decimate = 1;
    detector->nthreads = 1;
    forget(in, &in->apriltag);
    for (int v = 0; v < in->views; v++) {
        image_u8_t image = {.width = 640, .height = 480, .stride = 640, .buf = in->image[v]->data};
        zarray_t *found = apriltag_detector_detect(detector, &image);
        for (int i = 0; i < zarray_size(found); i++) {
            apriltag_detection_t *d;
            zarray_get(found, i, &d);
            int k = tag_of(in, v, d->id);
            for (int c = 0; c < 8 && k >= 0; c++)
                corners_of(in, &in->apriltag, v, k)[c] = d->p[3 - c / 2][c % 2];
        }
        apriltag_detections_destroy(found);
    }
    apriltag_detector_destroy(detector);
    tag36h11_destroy(family);
}

/* Whether the whole tag is inside the image, and where its corners are. */
static bool truth_of(double truth[8], const tags_input *in, int view, int tag)
{
    for (size_t k = 0; k < 4; k++)
        if (!tag_scene_truth(truth + 2 * k, &in->scene[view], 4 * (size_t)tag + k, INSIDE)) return false;
    return true;
}

static bool is_seen(const double *seen, const double truth[8])
{
    for (int c = 0; c < 8; c++)
        if (!(fabs(seen[c] - truth[c]) < WILD)) return false;
    return true;
}

/* A peer may begin at another corner: turned as it fits best. */
static void turn_corners(tags_input *in, sighting *s)
{
    double truth[8];
    for (int v = 0; v < in->views; v++)
        for (int k = 0; k < in->tags; k++) {
            double *seen = corners_of(in, s, v, k), least = INFINITY, best[8];
            if (!truth_of(truth, in, v, k) || isnan(seen[0])) continue;
            for (int turn = 0; turn < 4; turn++) {
                double off = 0;
                for (int c = 0; c < 8; c++) off += fabs(seen[(c + 2 * turn) % 8] - truth[c]);
                if (!(off < least)) continue;
                least = off;
                for (int c = 0; c < 8; c++) best[c] = seen[(c + 2 * turn) % 8];
            }
            memcpy(seen, best, sizeof best);
        }
}

/* Mean offset of the corners; zero for ours. */
static void offset_of(double offset[2], const tags_input *in, const sighting *s)
{
    double truth[8], n = 0;
    offset[0] = offset[1] = 0;
    for (int v = 0; v < in->views; v++)
        for (int k = 0; k < in->tags; k++) {
            const double *seen = corners_of(in, s, v, k);
            if (!truth_of(truth, in, v, k) || !is_seen(seen, truth)) continue;
            for (int c = 0; c < 8; c++) offset[c % 2] += seen[c] - truth[c];
            n += 4;
        }
    offset[0] /= n, offset[1] /= n;
}

typedef struct score {
    double missed[2], rms[2]; /* ours, the peer's */
} score;

static score compare(const tags_input *in, const sighting *peer)
{
    score result = {{0, 0}, {0, 0}};
    double all = 0, both = 0, offset[2], truth[8];
    offset_of(offset, in, peer);
    for (int v = 0; v < in->views; v++)
        for (int k = 0; k < in->tags; k++) {
            const double *a = corners_of(in, &in->ours, v, k), *b = corners_of(in, peer, v, k);
            if (!truth_of(truth, in, v, k)) continue;
            bool seen[2] = {is_seen(a, truth), is_seen(b, truth)};
            all++;
            for (int i = 0; i < 2; i++) result.missed[i] += !seen[i];
            if (!seen[0] || !seen[1]) continue;
            both++;
            for (int c = 0; c < 8; c++) {
                result.rms[0] += (a[c] - truth[c]) * (a[c] - truth[c]);
                result.rms[1] += pow(b[c] - truth[c] - offset[c % 2], 2);
            }
        }
    for (int i = 0; i < 2; i++) {
        result.missed[i] /= all;
        result.rms[i] = sqrt(result.rms[i] / (4 * both));
    }
    return result;
}

static void print_peer(const bench *b, tags_input *in, const char *what, double ours, bench_function run,
                       sighting *peer, const char *peer_name)
{
    char name[96];
    enum { RUNS = 1 };
    double start = bench_now();
    run(in);
    double time = bench_now() - start;
    turn_corners(in, peer);
    score s = compare(in, peer);
    snprintf(name, sizeof name, "tags corners %s", what);
    bench_row row = {.name = name,
                     .unit = "ms",
                     .ours = 1e3 * ours / in->views,
                     .peer = 1e3 * time / in->views,
                     .peer_name = peer_name,
                     .error_unit = "px RMS",
                     .error_ours = s.rms[0],
                     .error_peer = s.rms[1],
                     .runs = in->views};
    bench_print(b, &row);
    snprintf(name, sizeof name, "tags missed %s", what);
    bench_row missed = {.name = name,
                        .unit = "of 1",
                        .ours = s.missed[0],
                        .peer = s.missed[1],
                        .peer_name = peer_name,
                        .runs = in->views};
    bench_print(b, &missed);
}

static void render(tags_input *in, int kind)
{
    const char *full = getenv("TELEDIMOS_FULL");
    td_random random = td_random_seed(40, (uint64_t)kind);
    *in = (tags_input){.views = full && !strcmp(full, "1") ? FULL_VIEWS : VIEWS, .border = kind == 1 ? 2 : 1};
    in->scene = calloc((size_t)in->views, sizeof *in->scene);
    in->image = calloc((size_t)in->views, sizeof *in->image);
    for (int v = 0; v < in->views; v++) {
        td_target target = kind < 2 ? tag_scene_grid(6, 6, in->border) : tag_scene_singles(&random);
        in->scene[v] = tag_scene_random(&target, kind == 1, 0.95, &random);
        in->image[v] = tag_scene_render(&in->scene[v], &random);
        in->tags = td_target_tag_count(&target);
    }
}

static void discard(tags_input *in)
{
    for (int v = 0; v < in->views; v++) td_image_free(&in->image[v]);
    free(in->scene);
    free(in->image);
    free(in->ours.corner);
    free(in->opencv.corner);
    free(in->subpixel.corner);
    free(in->apriltag.corner);
}

void bench_tags(const bench *b)
{
    static const char *const what[] = {"aprilgrid border 1", "aprilgrid border 2", "single tags"};
    for (int kind = 0; kind < 3; kind++) {
        char name[96];
        snprintf(name, sizeof name, "tags corners tags missed %s", what[kind]);
        if (!bench_wanted(b, name)) continue;
        tags_input in;
        render(&in, kind);
        double start = bench_now();
        run_ours(&in);
        double ours = bench_now() - start;
        print_peer(b, &in, what[kind], ours, run_opencv, &in.opencv, "OpenCV aruco, APRILTAG");
        print_peer(b, &in, what[kind], ours, run_subpixel, &in.subpixel, "OpenCV aruco, SUBPIX");
        print_peer(b, &in, what[kind], ours, run_apriltag, &in.apriltag, "libapriltag");
        discard(&in);
    }
}
