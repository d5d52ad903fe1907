/* Real stereo frames with their poses, fused: how thick do flat surfaces come out? EuRoC's V1_01 (a room;
 * poses of the body by Vicon), under TELEDIMOS_DATA; skipped without it. There is no truth of the room: but
 * floor, boxes and mats are flat, so that what a map's heights scatter about planes through 5 x 5 cells of 5
 * cm is its error. Measured: the median over all such places of one frame's map, and of the fused map at the
 * same places. It must fall; by how much depends on how far the base moved, as frames from one place repeat
 * their errors. Blind to errors that keep planes flat: poses, calibration. */
#include "core/csv.h"
#include "core/dataset.h"
#include "recon/fusion.h"
#include "tests/check.h"

enum { MOST = 48, SIDE = 5, LARGEST = 1 << 21 };

static const double CELL = 0.05, STEEP = 0.3;

typedef struct recording {
    td_dataset *dataset;
    td_rig *rig;
    td_csv *csv;
    td_depth_camera *camera;
    td_dense_options dense;
    td_fusion_options fusion;
} recording;

static td_error error;

static recording open_recording(const char *folder)
{
    recording r = {.dense = td_dense_options_default(), .fusion = td_fusion_options_default()};
    check_ok(td_dataset_read(&r.dataset, folder, &error), error);
    check_ok(td_rig_parse(&r.rig, r.dataset->rig_text, strlen(r.dataset->rig_text), "rig", &error), error);
    check_ok(td_csv_parse(&r.csv, r.dataset->table_text, strlen(r.dataset->table_text), "frames", &error),
             error);
    check_ok(td_depth_camera_new(&r.camera, r.rig, 0, 1, 1, 6, &error), error);
    td_depth_camera_range(&r.dense.lowest, &r.dense.levels, r.camera);
    r.dense.refine = true;
    r.dense.fill = false;
    r.fusion.cell_m = CELL;
    r.fusion.correlation_px = 9;
    r.fusion.repeat_share = 0.8;
    r.fusion.place_m = 1;
    r.fusion.region[0] = -2, r.fusion.region[1] = -4, r.fusion.region[2] = 8, r.fusion.region[3] = 6;
    return r;
}

static void close_recording(recording *r)
{
    td_depth_camera_free(&r->camera);
    td_csv_free(&r->csv);
    td_rig_free(&r->rig);
    td_dataset_free(&r->dataset);
}

static td_pose pose_of(const recording *r, size_t row)
{
    static const char *const name[7] = {"x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"};
    double v[7];
    td_pose body;
    for (int k = 0; k < 7; k++)
        check_ok(td_csv_real(&v[k], r->csv, row, td_csv_column(r->csv, name[k]), -1e3, 1e3, &error), error);
    memcpy(body.t, v, sizeof body.t);
    memcpy(body.q, v + 3, sizeof body.q);
    return td_pose_compose(&body, &r->rig->vehicle_from_rig);
}

static td_disparity *match(const recording *r, size_t frame)
{
    td_image *raw[2], *left, *right;
    td_disparity *d;
    for (int c = 0; c < 2; c++)
        check_ok(td_image_read(&raw[c], r->dataset->frame[frame].image[c], 1, &error), error);
    check_ok(td_depth_camera_rectify(&left, &right, r->camera, raw[0], raw[1], 0, &error), error);
    check_ok(td_dense_match(&d, left, right, &r->dense, &error), error);
    td_image_free(&raw[0]);
    td_image_free(&raw[1]);
    td_image_free(&left);
    td_image_free(&right);
    return d;
}

static void add(td_fusion *fusion, const recording *r, const td_disparity *d, size_t frame)
{
    const td_fusion_frame f = {r->camera, d, pose_of(r, frame), NULL, r->dataset->frame[frame].time_s};
    check_ok(td_fusion_add(fusion, &f, NULL, &error), error);
}

/* RMS about the plane through the window whose lowest cell is (column, row); NaN: not all known, or steep. */
static double thickness(const td_elevation *map, int column, int row)
{
    double sum = 0, x = 0, y = 0, square = 0;
    const double n = SIDE * SIDE, xx = n * (SIDE * SIDE - 1) / 12.0;
    for (int k = 0; k < SIDE * SIDE; k++) {
        const double h = (double)map->height[(row + k / SIDE) * map->columns + column + k % SIDE];
        sum += h;
        x += (k % SIDE - SIDE / 2) * h;
        y += (k / SIDE - SIDE / 2) * h;
        square += h * h;
    }
    if (!(hypot(x, y) / xx < STEEP * map->cell_m)) return NAN;
    return sqrt(fmax(0, square - sum * sum / n - (x * x + y * y) / xx) / (n - 3));
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *value, size_t count)
{
    qsort(value, count, sizeof *value, by_value);
    return value[count / 2];
}

static void test_flat_surfaces(void **state)
{
    (void)state;
    const char *data = getenv("TELEDIMOS_DATA"), *all = getenv("TELEDIMOS_FULL");
    const int step = all && !strcmp(all, "1") ? 1 : 8;
    char folder[2048], file[2100];
    snprintf(folder, sizeof folder, "%s/euroc-V1_01-95", data ? data : "");
    snprintf(file, sizeof file, "%s/mav0/cam0/data.csv", folder);
    FILE *there = data ? fopen(file, "r") : NULL;
    if (!there) {
        print_message("no euroc-V1_01-95 under TELEDIMOS_DATA: skipped\n");
        skip();
    }
    fclose(there);
    recording r = open_recording(folder);
    assert_int_equal(r.dataset->frame_count, 48);
    td_fusion *fused;
    td_elevation *single[MOST], *map;
    int frames = 0;
    check_ok(td_fusion_new(&fused, &r.fusion, &error), error);
    for (size_t i = 0; i < r.dataset->frame_count; i += (size_t)step) {
        td_fusion *alone;
        td_disparity *d = match(&r, i);
        add(fused, &r, d, i);
        check_ok(td_fusion_new(&alone, &r.fusion, &error), error);
        add(alone, &r, d, i);
        check_ok(td_fusion_map(&single[frames++], NULL, alone, &error), error);
        td_fusion_free(&alone);
        td_disparity_free(&d);
    }
    check_ok(td_fusion_map(&map, NULL, fused, &error), error);
    double *one = malloc(LARGEST * sizeof *one), *many = malloc(LARGEST * sizeof *many);
    size_t places = 0;
    for (int f = 0; f < frames; f++)
        for (int i = 0; i < (map->columns - SIDE) * (map->rows - SIDE) && places < LARGEST; i++) {
            const int column = i % (map->columns - SIDE), row = i / (map->columns - SIDE);
            many[places] = thickness(map, column, row);
            one[places] = thickness(single[f], column, row);
            places += !isnan(many[places]) && !isnan(one[places]);
        }
    assert_true(places > 1000);
    const double before = median(one, places), after = median(many, places);
    print_message("%d frames, %zu flat places: %.1f mm thick in one frame's map, %.1f mm in the fused one\n",
                  frames, places, 1e3 * before, 1e3 * after);
    check_less(after, 0.9 * before);
    for (int f = 0; f < frames; f++) td_elevation_free(&single[f]);
    td_elevation_free(&map);
    td_fusion_free(&fused);
    close_recording(&r);
    free(one);
    free(many);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_flat_surfaces)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
