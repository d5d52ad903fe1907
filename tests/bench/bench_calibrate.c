/* Calibration beside OpenCV and mrcal, on OpenCV's 13 stereo pairs. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "calib/calibrate.h"
#include "tests/bench/bench.h"

typedef struct calibrate_input {
    td_observations *observations;
    td_dataset *dataset;
    td_image **image;
    size_t images, found;
    double rms_px, baseline_m;
} calibrate_input;

/* The joint solve with its covariance, from points: what OpenCV's calibrateCamera twice and stereoCalibrate
 * do. */
static void solve(void *user)
{
    calibrate_input *in = user;
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.plain = true;
    options.leave_one_out = false;
    options.threads = 1;
    if (td_calibrate(&c, in->observations, &options, NULL) == TD_OK) {
        in->rms_px = c->pair[0].rms_px;
        in->baseline_m = c->pair[0].baseline_m;
    }
    td_calibration_free(&c);
}

static void detect(void *user)
{
    calibrate_input *in = user;
    in->found = 0;
    for (size_t i = 0; i < in->images; i++) {
        td_detection d = {0};
        if (td_detect(&d, in->image[i], &in->dataset->target, NULL) == TD_OK) in->found += d.found;
        td_detection_free(&d);
    }
}

static bool load(calibrate_input *in, const bench *b)
{
    char path[1024];
    td_error error = {0};
    snprintf(path, sizeof path, "%s/datasets/opencv-stereo", b->source);
    if (td_dataset_read(&in->dataset, path, &error) != TD_OK ||
        td_observe(&in->observations, in->dataset, NULL, &error) != TD_OK) {
        fprintf(stderr, "teledimos-bench: %s\n", error.message);
        return false;
    }
    in->image = calloc(2 * in->dataset->frame_count, sizeof(td_image *));
    for (size_t v = 0; v < in->dataset->frame_count; v++)
        for (int k = 0; k < 2; k++)
            if (td_image_read(&in->image[in->images], in->dataset->frame[v].image[k], 1, NULL) == TD_OK)
                in->images++;
    return true;
}

static void row_solve(const bench *b, calibrate_input *in)
{
    if (!bench_wanted(b, "calibrate joint solve")) return;
    size_t views = in->observations->view_count, points = 54;
    double *left = malloc(4 * views * points * sizeof *left), *right = left + 2 * views * points;
    for (size_t v = 0; v < views; v++) {
        memcpy(left + 2 * v * points, td_observations_get(in->observations, v, 0)->point,
               2 * points * sizeof *left);
        memcpy(right + 2 * v * points, td_observations_get(in->observations, v, 1)->point,
               2 * points * sizeof *left);
    }
    bench_stereo stereo = {left, right, views, 9, 6, 640, 480, 0.025, NAN, NAN};
    enum { RUNS = 15 };
    bench_row row = {.name = "calibrate joint solve",
                     .unit = "ms",
                     .peer_name = "OpenCV stereoCalibrate",
                     .runs = RUNS,
                     .error_unit = "px RMS"};
    row.ours = 1e3 * bench_time(solve, in, RUNS);
    row.peer = 1e3 * bench_time(bench_opencv_stereo, &stereo, RUNS);
    row.error_ours = in->rms_px;
    row.error_peer = stereo.rms_px;
    bench_print(b, &row);
    free(left);
}

static void row_corners(const bench *b, calibrate_input *in)
{
    if (!bench_wanted(b, "calibrate corners")) return;
    const unsigned char **data = malloc(in->images * sizeof *data);
    for (size_t i = 0; i < in->images; i++) data[i] = in->image[i]->data;
    bench_corners corners = {data, in->images, 640, 480, 9, 6, 0};
    enum { RUNS = 7 };
    bench_row row = {
        .name = "calibrate corners", .unit = "1/s", .peer_name = "OpenCV find + cornerSubPix", .runs = RUNS};
    double ours = bench_time(detect, in, RUNS), peer = bench_time(bench_opencv_corners, &corners, RUNS);
    row.ours = 54 * (double)in->found / ours;
    row.peer = 54 * (double)corners.found / peer;
    bench_print(b, &row);
    free(data);
}

/* mrcal's program is given its corners, ours finds them in the images. */
static void row_job(const bench *b, calibrate_input *in)
{
    if (!bench_wanted(b, "calibrate whole job") && !bench_wanted(b, "calibrate peak memory")) return;
    char folder[] = "/tmp/teledimos-bench-XXXXXX", dataset[1024], out[128], corners[128];
    if (!mkdtemp(folder)) return;
    snprintf(dataset, sizeof dataset, "%s/datasets/opencv-stereo", b->source);
    snprintf(out, sizeof out, "%s/out", folder);
    snprintf(corners, sizeof corners, "%s/corners.vnl", folder);
    FILE *file = fopen(corners, "w");
    fprintf(file, "# filename x y level\n");
    for (int k = 0; k < 2; k++)
        for (size_t v = 0; v < in->observations->view_count; v++)
            for (size_t p = 0; p < 54; p++) {
                const double *x = td_observations_get(in->observations, v, k)->point + 2 * p;
                fprintf(file, "%s%s.jpg %.12g %.12g 0\n", k ? "right" : "left",
                        in->observations->view_name[v], x[0], x[1]);
            }
    fclose(file);
    enum { RUNS = 7 };
    double peak = 0, peer_peak = 0;
    const char *const ours[] = {b->program, "calibrate", dataset, "-o", out, "-q", NULL};
    const char *const peer[] = {"mrcal-calibrate-cameras",
                                "--corners-cache",
                                corners,
                                "--lensmodel",
                                "LENSMODEL_OPENCV5",
                                "--focal",
                                "530",
                                "--imagersize",
                                "640",
                                "480",
                                "--object-spacing",
                                "0.025",
                                "--object-width-n",
                                "9",
                                "--object-height-n",
                                "6",
                                "--outdir",
                                folder,
                                "left*.jpg",
                                "right*.jpg",
                                NULL};
    bench_row row = {
        .name = "calibrate whole job", .unit = "s", .peer_name = "mrcal, corners given", .runs = RUNS};
    row.ours = bench_command(ours, RUNS, &peak);
    row.peer = bench_command(peer, RUNS, &peer_peak);
    if (row.peer < 0) {
        row.peer = peer_peak = NAN;
        row.remark = "mrcal is not installed";
    }
    if (bench_wanted(b, row.name)) bench_print(b, &row);
    row.name = "calibrate peak memory";
    row.unit = "MB";
    row.ours = peak;
    row.peer = peer_peak;
    if (bench_wanted(b, row.name)) bench_print(b, &row);
    const char *const clean[] = {"rm", "-rf", folder, NULL};
    bench_command(clean, 1, NULL);
}

static void row_start(const bench *b)
{
    if (!bench_wanted(b, "calibrate start-up")) return;
    enum { RUNS = 30 };
    const char *const ours[] = {b->program, "--version", NULL};
    const char *const peer[] = {"mrcal-calibrate-cameras", "--help", NULL};
    bench_row row = {
        .name = "calibrate start-up (--version)", .unit = "ms", .peer_name = "mrcal --help", .runs = RUNS};
    row.ours = 1e3 * bench_command(ours, RUNS, NULL);
    row.peer = 1e3 * bench_command(peer, 5, NULL);
    if (row.peer < 0) {
        row.peer = NAN;
        row.remark = "mrcal is not installed";
    }
    bench_print(b, &row);
}

void bench_calibrate(const bench *b)
{
    if (b->filter && !strstr("calibrate joint solve calibrate corners calibrate whole job calibrate peak "
                             "memory calibrate start-up",
                             b->filter))
        return;
    calibrate_input in = {0};
    if (!load(&in, b)) return;
    row_job(b, &in);
    row_solve(b, &in);
    row_corners(b, &in);
    row_start(b);
    for (size_t i = 0; i < in.images; i++) td_image_free(&in.image[i]);
    free(in.image);
    td_observations_free(&in.observations);
    td_dataset_free(&in.dataset);
}
