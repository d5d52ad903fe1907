/* Interest points of a 1280 x 960 image beside OpenCV's two ways to corners, on one thread and as many
 * points. The error is what does not repeat from graf1 to graf3 at 1.5 px; OpenCV with its default block
 * of 3. */
#include "core/image.h"
#include "tests/bench/bench.h"
#include "tests/recon/repeatability.h"

enum { POINTS = 2000, WIDTH = 1280, HEIGHT = 960, RUNS = 15 };

typedef struct interest_input {
    td_image *image;
    td_interest_options options;
    opencv_corners how;
    size_t ours, peer;
    double xy[2 * POINTS];
} interest_input;

static void run_ours(void *user)
{
    interest_input *in = user;
    td_interest_point *points;
    if (td_interest_points(&points, &in->ours, in->image, &in->options, NULL) == TD_OK) free(points);
}

static void run_peer(void *user)
{
    interest_input *in = user;
    in->peer =
        opencv_find_corners(in->xy, in->ours, in->image->data, in->image->width, in->image->height, &in->how);
}

static td_image *enlarge(const td_image *image)
{
    td_image *out = NULL;
    if (td_image_new(&out, WIDTH, HEIGHT, 1, NULL) != TD_OK) return NULL;
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            out->data[y * WIDTH + x] = (uint8_t)lrint(td_image_sample(
                image, x * (image->width - 1.0) / (WIDTH - 1), y * (image->height - 1.0) / (HEIGHT - 1), 0));
    return out;
}

static void print_rows(const bench *b, interest_input *in, const pair_of_views *graf)
{
    static const char *const peer[] = {"OpenCV goodFeaturesToTrack", "OpenCV cornerHarris"};
    size_t found[2];
    const double ours = bench_time(run_ours, in, RUNS);
    const double repeat = repeat_ours(graf, &in->options, found);
    for (int harris = 0; harris < 2; harris++) {
        in->how = (opencv_corners){harris, 3, 0, harris ? 1e-6 : 1e-4, in->options.distance_px};
        const double time = bench_time(run_peer, in, RUNS);
        bench_row row = {.name = harris ? "interest Harris 1280x960" : "interest points 1280x960",
                         .unit = "ms",
                         .ours = 1e3 * ours,
                         .peer = 1e3 * time,
                         .peer_name = peer[harris],
                         .error_unit = "of 1 not repeated",
                         .error_ours = 1 - repeat,
                         .error_peer = 1 - repeat_opencv(graf, &in->how, found),
                         .runs = RUNS};
        bench_print(b, &row);
        row.name = harris ? "interest Harris rate" : "interest points rate";
        row.unit = "1/s";
        row.ours = (double)in->ours / ours;
        row.peer = (double)in->peer / time;
        row.error_unit = NULL;
        bench_print(b, &row);
    }
}

void bench_interest(const bench *b)
{
    pair_of_views graf;
    if (!bench_wanted(b, "interest points Harris rate 1280x960")) return;
    if (!views_graf(&graf)) {
        bench_row row = {.name = "interest points 1280x960",
                         .unit = "ms",
                         .ours = NAN,
                         .peer = NAN,
                         .peer_name = "OpenCV",
                         .remark = "no image: Debian's opencv-doc is not installed"};
        bench_print(b, &row);
        return;
    }
    interest_input in = {.image = enlarge(graf.first), .options = td_interest_options_default()};
    in.options.count = POINTS;
    in.options.threads = 1;
    if (in.image) print_rows(b, &in, &graf);
    td_image_free(&in.image);
    views_free(&graf);
}
