/* Chessboards and grids of marks beside OpenCV's, on 24 random views (200 with TELEDIMOS_FULL=1) of the drawn
 * target, wholly in the image, with lens distortion, blur and noise, and known points. A numbering that
 * differs by a half turn (of marks a quarter turn too) counts as right. Of marks the centre of gravity of the
 * disc's image is what both look for. */
#include "tests/bench/bench_boards.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks.h"
#include "tests/bench/bench.h"
#include "tests/calib/charuco_scene.h"

enum { VIEWS = 200, FEW = 24 };

/* All with TELEDIMOS_FULL=1. */
static int view_count(void)
{
    const char *full = getenv("TELEDIMOS_FULL");
    return full && strcmp(full, "1") == 0 ? VIEWS : FEW;
}

typedef struct views {
    charuco_scene scene;
    td_image *image[VIEWS];
    double *truth, *point; /* (VIEWS,points,2) */
    int points;
} views;

static void ours(void *user)
{
    views *v = user;
    for (int i = 0; i < view_count(); i++) {
        td_detection d = {0};
        double *out = v->point + 2 * (size_t)(v->points * i);
        bool found = td_detect(&d, v->image[i], &v->scene.target, NULL) == TD_OK && d.found;
        for (int k = 0; k < 2 * v->points; k++) out[k] = found ? d.point[k] : NAN;
        td_detection_free(&d);
    }
}

/* True points of the present pose; false when one is within 12 px of the image's border. */
static bool find_truth(double *truth, const charuco_scene *s)
{
    const double z[3] = {0, 0, 1};
    double p[3], bias[2] = {0, 0};
    for (size_t k = 0; k < td_target_point_count(&s->target); k++) {
        td_target_point(p, &s->target, k);
        if (s->target.kind == TD_TARGET_MARKS &&
            !td_mark_bias(bias, &s->camera, &s->camera_from_target, p, z, s->target.diameter_m))
            return false;
        td_pose_transform(p, &s->camera_from_target, p);
        if (!td_camera_project(truth + 2 * k, NULL, NULL, &s->camera, p)) return false;
        for (int c = 0; c < 2; c++) {
            truth[2 * k + c] += bias[c];
            double far = (c ? s->camera.height : s->camera.width) - 1 - 30;
            if (!(truth[2 * k + c] > 30 && truth[2 * k + c] < far)) return false;
        }
    }
    return true;
}

static bool make_views(views *v, const td_target *target)
{
    td_random random = td_random_seed(11, 3);
    td_error error = {0};
    *v = (views){
        .scene = {.target = *target, .camera = charuco_camera(), .noise = 3, .dark = 30, .light = 210}};
    v->points = (int)td_target_point_count(target);
    v->truth = malloc(2 * VIEWS * (size_t)v->points * sizeof *v->truth);
    v->point = malloc(2 * VIEWS * (size_t)v->points * sizeof *v->point);
    bool made = v->truth && v->point && charuco_draw(&v->scene, &error) == TD_OK;
    for (int i = 0; made && i < view_count(); i++) {
        do
            v->scene.camera_from_target =
                charuco_pose(&v->scene, 0.3 + 0.7 * td_random_uniform(&random), 0.9, &random);
        while (!find_truth(v->truth + 2 * (size_t)(v->points * i), &v->scene));
        v->scene.blur = 0.4 + 1.1 * td_random_uniform(&random);
        made = charuco_photograph(&v->image[i], &v->scene, &random, &error) == TD_OK;
    }
    if (!made) fprintf(stderr, "teledimos-bench: %s\n", error.message);
    return made;
}

typedef struct judged {
    double rms_px, recall;
    int wrong; /* boards of which no numbering fits */
} judged;

/* Sum of squares over a view under the best of the turns that a grid of these sides has. */
static double view_square(const views *v, const double *p, const double *truth)
{
    const int c = v->scene.target.plane[0].columns, r = v->scene.target.plane[0].rows;
    double best = INFINITY;
    for (int turn = 0; turn < 2; turn++) {
        double sum = 0;
        for (int k = 0; k < v->points; k++) {
            int at = turn ? c * r - 1 - k : k;
            double x = p[2 * k] - truth[2 * at], y = p[2 * k + 1] - truth[2 * at + 1];
            if (isfinite(x)) sum += x * x + y * y;
        }
        best = fmin(best, sum);
    }
    return best;
}

static judged judge(const views *v, const double *point)
{
    judged j = {0};
    double sum = 0;
    int n = 0, boards = 0;
    for (int i = 0; i < view_count(); i++) {
        const double *p = point + 2 * (size_t)(v->points * i);
        int seen = 0;
        for (int k = 0; k < v->points; k++) seen += isfinite(p[2 * k]);
        if (!seen) continue;
        double square = view_square(v, p, v->truth + 2 * (size_t)(v->points * i));
        if (square > 9.0 * seen) {
            j.wrong++;
            continue;
        }
        boards++;
        sum += square;
        n += seen;
    }
    j.rms_px = sqrt(sum / n);
    j.recall = (double)boards / view_count();
    return j;
}

static void row(const bench *b, const char *name, const td_target *target)
{
    views v;
    const unsigned char *data[VIEWS];
    if (!bench_wanted(b, name)) return;
    double *peer = NULL;
    if (make_views(&v, target)) peer = malloc(2 * VIEWS * (size_t)v.points * sizeof *peer);
    if (peer) {
        for (int i = 0; i < view_count(); i++) data[i] = v.image[i]->data;
        const td_target_plane *p = target->plane;
        bench_board_input in = {data,
                                view_count(),
                                v.scene.camera.width,
                                v.scene.camera.height,
                                p->columns,
                                p->rows,
                                target->kind == TD_TARGET_MARKS,
                                peer};
        bench_row r = {
            .name = name, .unit = "ms", .peer_name = "OpenCV", .error_unit = "px", .runs = view_count()};
        char remark[160];
        double began = bench_now();
        ours(&v);
        double between = bench_now();
        bench_opencv_boards(&in);
        r.ours = (between - began) / view_count() * 1e3;
        r.peer = (bench_now() - between) / view_count() * 1e3;
        judged mine = judge(&v, v.point), theirs = judge(&v, peer);
        r.error_ours = mine.rms_px;
        r.error_peer = theirs.rms_px;
        snprintf(remark, sizeof remark, "boards found %.1f %%, %d wrong; OpenCV %.1f %%, %d wrong",
                 100 * mine.recall, mine.wrong, 100 * theirs.recall, theirs.wrong);
        r.remark = remark;
        bench_print(b, &r);
        if (!b->json) printf("    %s\n", remark);
    }
    for (int i = 0; i < view_count(); i++) td_image_free(&v.image[i]);
    td_image_free(&v.scene.board);
    free(v.truth);
    free(v.point);
    free(peer);
}

void bench_boards(const bench *b)
{
    td_target chessboard = {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1};
    td_target marks = {
        .kind = TD_TARGET_MARKS, .plane_count = 1, .diameter_m = 0.015, .polarity = TD_MARK_DARK};
    chessboard.plane[0] = (td_target_plane){9, 6, 0.03, td_pose_identity()};
    marks.plane[0] = (td_target_plane){8, 6, 0.03, td_pose_identity()};
    row(b, "chessboard", &chessboard);
    row(b, "marks", &marks);
}
