/* Rows of the benchmark: ours beside a peer on the same input in the same run, accuracy beside speed. */
#ifndef TELEDIMOS_TESTS_BENCH_H
#define TELEDIMOS_TESTS_BENCH_H

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct bench_row {
    const char *name, *unit; /* unit "s", "ms", "ns", "MB", "calls": less is better; "1/s": more is better */
    double ours, peer;       /* medians; NaN: not measured */
    const char *peer_name;
    const char *error_unit;        /* NULL: no accuracy to compare */
    double error_ours, error_peer; /* NaN: unknown */
    int runs;
    const char *remark; /* why a peer is missing; NULL */
} bench_row;

typedef struct bench {
    const char *filter, *program, *source; /* --filter, path of teledimos, source folder */
    bool json;
} bench;

/* Prints a row. */
void bench_print(const bench *b, const bench_row *row);
bool bench_wanted(const bench *b, const char *name);

/* Seconds on the monotonic clock. */
double bench_now(void);
double bench_median(double *x, size_t n);

/* A function timed `runs` times after one warm-up; the median. */
typedef void (*bench_function)(void *user);
double bench_time(bench_function function, void *user, int runs);

/* A command, output thrown away: median wall time of `runs` after one warm-up, largest peak memory (MB; may
 * be NULL). Negative when it cannot be run or fails. */
double bench_command(const char *const *argv, int runs, double *peak_mb);

/* bench_boards.c */
void bench_boards(const bench *b);
/* bench_hand_eye.c */
void bench_hand_eye(const bench *b);
/* bench_charuco.c */
void bench_charuco(const bench *b);

/* bench_calibrate.c */
void bench_calibrate(const bench *b);
/* bench_interest.c */
void bench_interest(const bench *b);
/* bench_loop.c */
void bench_loop(const bench *b);
/* bench_map.c */
void bench_map(const bench *b);
/* bench_next_view.c */
void bench_next_view(const bench *b);
/* bench_render.c */
void bench_render(const bench *b);

/* bench_clearance.c */
void bench_clearance(const bench *b);
/* bench_integrator.c */
void bench_integrator(const bench *b);

/* bench_servo.c */
void bench_servo(const bench *b);

/* bench_soil.c */
void bench_soil(const bench *b);

/* bench_dynamics.c */
void bench_dynamics(const bench *b);
/* bench_clock.c */
void bench_clock(const bench *b);
/* bench_panel.c */
void bench_panel(const bench *b);

/* bench_world.c */
void bench_world(const bench *b);
/* bench_trajectory.c */
void bench_trajectory(const bench *b);
/* bench_clock.c */
void bench_clock(const bench *b);
/* bench_panel.c */
void bench_panel(const bench *b);

/* bench_opencv.cpp: OpenCV on the same points. n views of (points,2) pixels in each image; outputs RMS (px),
 * baseline (m). */
typedef struct bench_stereo {
    const double *left, *right; /* (views,points,2) */
    size_t views;
    int columns, rows, width, height;
    double spacing;
    double rms_px, baseline_m; /* out */
} bench_stereo;
void bench_opencv_stereo(void *stereo);

typedef struct bench_corners {
    const unsigned char *const *image; /* (images) grey */
    size_t images;
    int width, height, columns, rows;
    size_t found; /* out */
} bench_corners;
void bench_opencv_corners(void *corners);

/* bench_vehicle.c */
void bench_vehicle(const bench *b);
/* bench_tin.c */
void bench_tin(const bench *b);

/* bench_tin_cgal.cpp: CGAL alone on the same points. */
typedef struct bench_points {
    const double *xyz; /* (count,3) m */
    size_t count;
    size_t triangles; /* out */
} bench_points;
void bench_cgal_delaunay(void *points);

/* bench_tags.c */
void bench_tags(const bench *b);

/* bench_tags_opencv.cpp: the tags of a view; refinement 1: AprilTag's edges, 0: cornerSubPix. */
typedef struct bench_tags_view {
    const unsigned char *image; /* (height,width) grey */
    int width, height, border, refinement;
    int *id;        /* out (capacity) */
    double *corner; /* out (capacity,4,2) px */
    int capacity, count;
} bench_tags_view;
void bench_opencv_tags(bench_tags_view *view);

/* bench_match.c */
void bench_match(const bench *b);

/* bench_match_opencv.cpp: goodFeaturesToTrack in the left image, matchTemplate along the right one's rows
 * (one row up and down), and back; windows of 2 half_window + 1. */
typedef struct bench_match_pair {
    const unsigned char *left, *right; /* (height,width) grey */
    int width, height, points, half_window, most_disparity;
    double least_zncc;
    double *match; /* out (points,4): left x y, right x y, px */
    int found, matched;
} bench_match_pair;
void bench_opencv_match(void *pair);
/* bench_dense.c */
void bench_dense(const bench *b);

/* bench_dense_opencv.cpp: disparities in 1/16 px, negative where none. */
typedef struct bench_dense_pair {
    const unsigned char *image[2]; /* (height,width) grey: left, right */
    int width, height, levels, block;
    short *disparity; /* (height,width) out */
} bench_dense_pair;
void bench_opencv_dense(void *pair);

#ifdef __cplusplus
}
#endif
#endif
