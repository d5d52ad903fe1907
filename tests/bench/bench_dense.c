/* Dense matching beside OpenCV's SGBM in 3WAY mode (block 3 and 5, the one with fewer bad pixels), neither of
 * them refined by grey values (what that takes and gives is a row of its own), one thread, on real pairs with
 * known disparities. Errors are shares of all pixels with truth, holes counted as bad: the peer's raw, and
 * with specks taken out, holes filled and medians taken as ours are. The peer's images are widened to the
 * left by the levels, else it leaves as many columns out; its time is that of the widened images. "exposed":
 * the right image at gain 0.8, offset 10. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "recon/dense.h"
#include "recon/dense_internal.h"
#include "tests/bench/bench.h"
#include "tests/recon/dense_pairs.h"

enum { RUNS = 5 };

typedef struct ours_input {
    const td_image *left, *right;
    td_dense_options options;
    td_disparity *disparity;
} ours_input;

static void run_ours(void *user)
{
    ours_input *in = user;
    td_disparity_free(&in->disparity);
    td_dense_match(&in->disparity, in->left, in->right, &in->options, NULL);
}

static dense_score score_peer(const dense_pair *pair, const bench_dense_pair *peer, bool filled)
{
    size_t n = (size_t)peer->width * (size_t)peer->height;
    int16_t *a = malloc(n * sizeof *a), *b = malloc(n * sizeof *b);
    float *value = malloc(n * sizeof *value);
    bool any = false;
    for (size_t i = 0; i < n; i++) a[i] = (int16_t)(peer->disparity[i] < 0 ? -1 : 2 * peer->disparity[i]);
    if (filled) {
        dense_map map = {.width = peer->width, .height = peer->height, .disparity = a};
        dense_remove_specks(&map, td_dense_options_default().speckle);
        dense_fill(&any, a, peer->width, peer->height);
        dense_median(b, a, peer->width, peer->height, &dense_loops_portable, 1);
        dense_median(a, b, peer->width, peer->height, &dense_loops_portable, 1);
    }
    for (size_t i = 0; i < n; i++) value[i] = a[i] < 0 ? NAN : (float)a[i] / DENSE_ONE;
    dense_score s = dense_pair_score(pair, value);
    free(a);
    free(b);
    free(value);
    return s;
}

static void print_score(const bench *b, const char *name, const char *who, dense_score s)
{
    if (!b->json)
        printf("  %-12s %-20s bad0.5 %5.2f  bad1 %5.2f  bad2 %5.2f  density %5.1f %%\n", name, who, s.bad05,
               s.bad1, s.bad2, s.density);
}

/* The rows of a pair: against the raw peer, and against the filled one. */
static void print_rows(const bench *b, const char *name, double ours, double peer, dense_score mine,
                       const dense_score theirs[2])
{
    char row_name[96];
    for (int filled = 0; filled < 2; filled++) {
        snprintf(row_name, sizeof row_name, "dense %s%s", name, filled ? " filled" : "");
        bench_row row = {.name = row_name,
                         .unit = "ms",
                         .ours = 1e3 * ours,
                         .peer = 1e3 * peer,
                         .peer_name = filled ? "OpenCV 3WAY, filled" : "OpenCV 3WAY",
                         .error_unit = "% bad2",
                         .error_ours = mine.bad2,
                         .error_peer = theirs[filled].bad2,
                         .runs = RUNS};
        bench_print(b, &row);
        print_score(b, name, row.peer_name, theirs[filled]);
    }
    print_score(b, name, "ours", mine);
}

/* Ours and the peer in turns, so that what else the machine does meets both. */
static void time_both(double *ours_s, double *peer_s, ours_input *ours, bench_dense_pair *peer)
{
    double a[RUNS], b[RUNS];
    for (int k = -1; k < RUNS; k++) {
        double start = bench_now();
        run_ours(ours);
        double middle = bench_now();
        bench_opencv_dense(peer);
        if (k >= 0) a[k] = middle - start, b[k] = bench_now() - middle;
    }
    *ours_s = bench_median(a, RUNS);
    *peer_s = bench_median(b, RUNS);
}

static void bench_pair(const bench *b, const dense_pair_kind *kind)
{
    dense_pair pair;
    if (!dense_pair_read(&pair, kind)) {
        printf("dense %s: not there (TELEDIMOS_DATA, opencv-doc)\n", kind->name);
        return;
    }
    int width = pair.left->width, height = pair.left->height;
    ours_input ours = {pair.left, pair.right, td_dense_options_default(), NULL};
    ours.options.levels = kind->levels, ours.options.threads = 1, ours.options.refine = false;
    double ours_s = NAN, peer_s = NAN, block_s[2][2];
    dense_score theirs[2], tried;
    for (int k = 0; k < 2; k++) {
        bench_dense_pair peer = {
            {pair.left->data, pair.right->data}, width, height, kind->levels, k ? 5 : 3, NULL};
        peer.disparity = malloc((size_t)width * (size_t)height * sizeof *peer.disparity);
        time_both(&block_s[k][0], &block_s[k][1], &ours, &peer);
        tried = score_peer(&pair, &peer, true);
        if (k == 0 || tried.bad2 < theirs[1].bad2) {
            ours_s = block_s[k][0], peer_s = block_s[k][1];
            theirs[0] = score_peer(&pair, &peer, false), theirs[1] = tried;
        }
        free(peer.disparity);
    }
    print_rows(b, kind->name, ours_s, peer_s, dense_pair_score(&pair, ours.disparity->value), theirs);
    ours.options.refine = true;
    char refined[96];
    snprintf(refined, sizeof refined, "dense %s refined", kind->name);
    bench_row row = {.name = refined,
                     .unit = "ms",
                     .ours = 1e3 * bench_time(run_ours, &ours, RUNS),
                     .peer = 1e3 * peer_s,
                     .peer_name = "OpenCV 3WAY, filled",
                     .error_unit = "% bad2",
                     .error_peer = theirs[1].bad2,
                     .runs = RUNS};
    const dense_score better = dense_pair_score(&pair, ours.disparity->value);
    row.error_ours = better.bad2;
    bench_print(b, &row);
    print_score(b, kind->name, "ours, refined", better);
    dense_pair_expose(pair.right, 0.8, 10);
    run_ours(&ours);
    print_score(b, kind->name, "ours, exposed", dense_pair_score(&pair, ours.disparity->value));
    td_disparity_free(&ours.disparity);
    dense_pair_free(&pair);
}

/* A site's size of image: frames a second on two threads. Aloe, cut or repeated to 1280x960. */
static void bench_frames(const bench *b)
{
    dense_pair pair;
    enum { WIDTH = 1280, HEIGHT = 960 };
    if (!dense_pair_read(&pair, &DENSE_PAIRS[DENSE_PAIR_COUNT - 1])) return;
    td_image *image[2];
    for (int k = 0; k < 2; k++) {
        const td_image *from = k ? pair.right : pair.left;
        if (td_image_new(&image[k], WIDTH, HEIGHT, 1, NULL) != TD_OK) return;
        for (int y = 0; y < HEIGHT; y++)
            memcpy(image[k]->data + y * WIDTH, from->data + y * from->width, WIDTH);
    }
    ours_input in = {image[0], image[1], td_dense_options_default(), NULL};
    in.options.levels = 200, in.options.threads = 2;
    bench_row row = {.name = "map dense",
                     .unit = "1/s",
                     .ours = 1 / bench_time(run_ours, &in, RUNS),
                     .peer = NAN,
                     .peer_name = "1280x960, 200 levels, refined, 2 threads",
                     .remark = "goal 5",
                     .runs = RUNS};
    bench_print(b, &row);
    td_disparity_free(&in.disparity);
    td_image_free(&image[0]);
    td_image_free(&image[1]);
    dense_pair_free(&pair);
}

void bench_dense(const bench *b)
{
    char name[96];
    for (int k = 0; k < DENSE_PAIR_COUNT; k++) {
        snprintf(name, sizeof name, "dense %s filled", DENSE_PAIRS[k].name);
        if (bench_wanted(b, name)) bench_pair(b, &DENSE_PAIRS[k]);
    }
    if (bench_wanted(b, "map dense")) bench_frames(b);
}
