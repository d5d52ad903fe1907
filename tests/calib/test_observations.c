/* Proves: points survive the way to a CSV and back to the last bit, whatever the frames are called; every way
 * in which such a file, or one of clicks, can be wrong is refused with its line and column; a dataset of
 * images on disk gives what the detector finds in each of them, on any number of threads; a view without the
 * target is told from an image that cannot be read, and of several faults the first in the order of the
 * frames is named. Reference: what was written; td_detect on the same images. Blind to: how well targets are
 * detected. */
#include "calib/observations.h"
#include "core/file.h"
#include "core/random.h"
#include "tests/calib/render_chessboard.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const td_target board = {
    .kind = TD_TARGET_CHESSBOARD, .plane_count = 1, .plane = {{5, 4, 0.02, {{1, 0, 0, 0}, {0, 0, 0}}}}};
enum { POINTS = 20 };

static td_observations *make_observations(const char *const *names, size_t views)
{
    td_observations *o = NULL;
    td_error error = {0};
    check_ok(td_observations_new(&o, &board, 2, views, &error), error);
    strcpy(o->camera[0].name, "left");
    strcpy(o->camera[1].name, "right-2");
    for (size_t v = 0; v < views; v++) strcpy(o->view_name[v], names[v]);
    return o;
}

static void test_new(void **state)
{
    (void)state;
    const char *const names[] = {"a", "b"};
    td_observations *o = make_observations(names, 2), *none = NULL;
    for (size_t v = 0; v < 2; v++) {
        assert_true(isnan(o->height_m[v]));
        for (int c = 0; c < 2; c++) {
            const td_detection *d = td_observations_get(o, v, c);
            assert_ptr_equal(d, &o->detection[2 * v + (size_t)c]);
            assert_false(d->found);
            assert_int_equal(d->count, POINTS);
            assert_int_equal(td_observations_seen(o, v, c), 0);
            for (int i = 0; i < 2 * POINTS; i++) assert_true(isnan(d->point[i]));
        }
    }
    td_detection *d = td_observations_get(o, 1, 0);
    d->point[4] = 1, d->point[5] = 2, d->point[6] = 3; /* half a point is none */
    assert_int_equal(td_observations_seen(o, 1, 0), 0);
    d->found = true;
    assert_int_equal(td_observations_seen(o, 1, 0), 1);
    td_observations_free(&o);
    assert_null(o);
    td_observations_free(&none);
    td_observations_free(NULL);
}

static void test_set(void **state)
{
    (void)state;
    const char *const names[] = {"a"};
    td_error error = {0};
    td_detection seen;
    td_observations *o = make_observations(names, 1);
    check_ok(td_detection_init(&seen, POINTS, &error), error);
    for (size_t i = 0; i < 2 * POINTS; i++) seen.point[i] = (double)i + 0.25;
    for (size_t i = 0; i < POINTS; i++) seen.sigma[i] = 0.01 * (double)(i + 1);
    seen.blur_px = 0.7;
    td_observations_set(o, 0, 1, &seen); /* points that are not believed */
    assert_int_equal(td_observations_seen(o, 0, 1), 0);
    assert_true(isnan(td_observations_get(o, 0, 1)->point[0]));
    seen.found = true;
    td_observations_set(o, 0, 1, &seen);
    const td_detection *d = td_observations_get(o, 0, 1);
    assert_int_equal(td_observations_seen(o, 0, 1), POINTS);
    assert_memory_equal(d->point, seen.point, 2 * POINTS * sizeof *d->point);
    assert_memory_equal(d->sigma, seen.sigma, POINTS * sizeof *d->sigma);
    assert_true(d->blur_px == seen.blur_px);
    assert_int_equal(td_observations_seen(o, 0, 0), 0);
    td_detection_free(&seen);
    td_observations_free(&o);
}

/* ---- points ---- */

static const char *const hostile_names[] = {"plain",        "with, comma", "#comment", " blank before",
                                            "blank after ", "quo\"te\"d",  "\"",       "\xC3\xA9",
                                            "1e5"};
enum { HOSTILE = sizeof hostile_names / sizeof *hostile_names };

static td_observations *random_observations(td_random *random)
{
    td_observations *o = make_observations(hostile_names, HOSTILE);
    for (int c = 0; c < 2; c++) {
        o->camera[c].width = 640 + c;
        o->camera[c].height = 480;
    }
    for (size_t v = 0; v < HOSTILE; v++)
        for (int c = 0; c < 2; c++) {
            td_detection *d = td_observations_get(o, v, c);
            d->found = v != 3 || c != 1;
            for (size_t i = 0; i < POINTS; i++) {
                if (v % 2 && i % 3 == 0) continue;
                d->point[2 * i] = 640 * td_random_uniform(random) * (i % 5 ? 1 : 1e-12);
                d->point[2 * i + 1] = i % 7 ? 480 * td_random_uniform(random) : -0.4999;
                d->sigma[i] = i % 4 ? 0.05 * td_random_uniform(random) : 0;
            }
        }
    return o;
}

static void test_round_trip(void **state)
{
    td_random random = td_random_seed(1, 1);
    td_observations *o = random_observations(&random), *back = make_observations(hostile_names, HOSTILE);
    td_error error = {0};
    char *path = td_path_join(*state, "points.csv"), *again = td_path_join(*state, "again.csv"), *text[2];
    size_t size[2];
    check_ok(td_observations_write(o, "of a test,\nin two lines", path, &error), error);
    check_ok(td_points_read(back, path, &error), error);
    for (int c = 0; c < 2; c++) {
        assert_int_equal(back->camera[c].width, o->camera[c].width);
        assert_int_equal(back->camera[c].height, o->camera[c].height);
    }
    size_t compared = 0;
    for (size_t v = 0; v < HOSTILE; v++)
        for (int c = 0; c < 2; c++) {
            const td_detection *a = td_observations_get(o, v, c), *b = td_observations_get(back, v, c);
            assert_int_equal(a->found, b->found);
            assert_string_equal(b->reason, "");
            for (size_t i = 0; i < POINTS; i++) {
                if (!a->found || isnan(a->point[2 * i])) {
                    assert_true(isnan(b->point[2 * i]) && isnan(b->point[2 * i + 1]));
                    continue;
                }
                assert_memory_equal(a->point + 2 * i, b->point + 2 * i, 2 * sizeof(double));
                assert_memory_equal(a->sigma + i, b->sigma + i, sizeof(double));
                compared++;
            }
        }
    assert_true(compared > 250);
    check_ok(td_observations_write(back, "of a test,", again, &error), error);
    check_ok(td_file_read(&text[0], &size[0], path, 1 << 20, &error), error);
    check_ok(td_file_read(&text[1], &size[1], again, 1 << 20, &error), error);
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(text[0], text[1], size[0]);
    assert_int_equal(strncmp(text[0], "# of a test,\nframe,camera,", 26), 0);
    check_ok(td_observations_write(o, NULL, again, &error), error);
    free(text[1]);
    check_ok(td_file_read(&text[1], &size[1], again, 1 << 20, &error), error);
    assert_int_equal(strncmp(text[1], "frame,camera,width_px,height_px,point,x_px,y_px,sigma_px\n", 57), 0);
    check_fails(td_observations_write(o, NULL, "/nowhere/points.csv", &error), TD_ERROR_IO, error,
                "/nowhere/points.csv");
    free(text[0]);
    free(text[1]);
    free(path);
    free(again);
    td_observations_free(&o);
    td_observations_free(&back);
}

#define HEADER "frame,camera,width_px,height_px,point,x_px,y_px,sigma_px\n"

static td_status parse_points(td_observations **o, const char *text, td_error *error)
{
    const char *const names[] = {"01", "02"};
    *o = make_observations(names, 2);
    return td_points_parse(*o, text, strlen(text), "points.csv", error);
}

static void test_points_that_suffice(void **state)
{
    (void)state;
    td_error error = {0};
    td_observations *o;
    /* Other columns, another order, quotes and comments; four points are enough, three are not. */
    check_ok(parse_points(&o,
                          "# anything\nsigma_px,camera,frame,point,x_px,y_px,height_px,width_px,remark\n"
                          "0.1,left,02,3,1,2,480,640,\n0,left,02,19,-3.5,1e2,480,640,x\n"
                          "0,\"left\",02,0,5,6,480,640,\n# between\n0.2,left,02,7,7,8,480,640,\n"
                          "0,left,01,7,7,8,480,640,\n0,left,01,8,7,8,480,640,\n0,left,01,9,7,8,480,640,\n",
                          &error),
             error);
    const td_detection *d = td_observations_get(o, 1, 0), *few = td_observations_get(o, 0, 0);
    assert_true(d->found);
    assert_int_equal(td_observations_seen(o, 1, 0), 4);
    check_near(d->point[2 * 19], -3.5, 0);
    check_near(d->point[2 * 19 + 1], 100, 0);
    check_near(d->sigma[3], 0.1, 0);
    assert_false(few->found);
    assert_non_null(strstr(few->reason, "3 points given, 4 are needed"));
    assert_int_equal(o->camera[0].width, 640);
    assert_int_equal(o->camera[1].width, 0); /* nothing of it was given */
    assert_false(td_observations_get(o, 0, 1)->found);
    td_observations_free(&o);
    check_ok(parse_points(&o, HEADER, &error), error);
    assert_false(td_observations_get(o, 0, 0)->found);
    td_observations_free(&o);
}

static void test_bad_points(void **state)
{
    static const struct {
        const char *text, *words;
    } bad[] = {
        {"", "points.csv: is empty"},
        {"\n# only a comment\n", "points.csv: is empty"},
        {"camera,width_px,height_px,point,x_px,y_px,sigma_px\n", "no column frame"},
        {"frame,width_px,height_px,point,x_px,y_px,sigma_px\n", "no column camera"},
        {"frame,camera,height_px,point,x_px,y_px,sigma_px\n", "no column width_px"},
        {"frame,camera,width_px,point,x_px,y_px,sigma_px\n", "no column height_px"},
        {"frame,camera,width_px,height_px,x_px,y_px,sigma_px\n", "no column point"},
        {"frame,camera,width_px,height_px,point,y_px,sigma_px\n", "no column x_px"},
        {"frame,camera,width_px,height_px,point,x_px,sigma_px\n", "no column y_px"},
        {"frame,camera,width_px,height_px,point,x_px,y_px\n", "no column sigma_px"},
        {"frame,frame,camera,width_px,height_px,point,x_px,y_px,sigma_px\n", "given twice"},
        {HEADER "01,left,640,480,0,1,2\n", "points.csv:2: the row has 7 cells"},
        {HEADER "01,left,640,480,0,1,2,0,0\n", "points.csv:2: the row has 9 cells"},
        {HEADER "03,left,640,480,0,1,2,0\n", "points.csv:2: column frame: frames.csv has no frame '03'"},
        {HEADER ",left,640,480,0,1,2,0\n", "no frame ''"},
        {HEADER "1,left,640,480,0,1,2,0\n", "no frame '1'"},
        {HEADER "01,middle,640,480,0,1,2,0\n",
         "points.csv:2: column camera: the dataset has no camera 'middle'"},
        {HEADER "01,Left,640,480,0,1,2,0\n", "no camera 'Left'"},
        {HEADER "01,left,0,480,0,1,2,0\n", "column width_px: is 0"},
        {HEADER "01,left,70000,480,0,1,2,0\n", "column width_px: is 70000"},
        {HEADER "01,left,640.5,480,0,1,2,0\n", "column width_px: must be a whole number"},
        {HEADER "01,left,640,-480,0,1,2,0\n", "column height_px: is -480"},
        {HEADER "01,left,640,,0,1,2,0\n", "column height_px: must be a whole number, but is empty"},
        {HEADER "01,left,640,480,0,1,2,0\n02,left,480,640,0,1,2,0\n",
         "points.csv:3: column width_px: 480x640 px, but camera left "
         "began with 640x480"},
        {HEADER "01,left,640,480,-1,1,2,0\n", "column point: is -1, but must lie between 0 and 19"},
        {HEADER "01,left,640,480,20,1,2,0\n", "column point: is 20, but must lie between 0 and 19"},
        {HEADER "01,left,640,480,1.5,1,2,0\n", "column point: must be a whole number"},
        {HEADER "01,left,640,480,zero,1,2,0\n", "'zero'"},
        {HEADER "01,left,640,480,99999999999999999999,1,2,0\n", "column point"},
        {HEADER "01,left,640,480,4,1,2,0\n02,left,640,480,4,1,2,0\n01,left,640,480,4,1,3,0\n",
         "points.csv:4: column point: the point is given twice"},
        {HEADER "01,left,640,480,0,nan,2,0\n", "column x_px: must be a finite number, but is 'nan'"},
        {HEADER "01,left,640,480,0,1,inf,0\n", "column y_px: must be a finite number"},
        {HEADER "01,left,640,480,0,,2,0\n", "column x_px: must be a finite number, but is empty"},
        {HEADER "01,left,640,480,0,1e9,2,0\n", "column x_px: is 1e9, but must lie between"},
        {HEADER "01,left,640,480,0,1,-1e300,0\n", "column y_px: is -1e300"},
        {HEADER "01,left,640,480,0,1,1e999,0\n", "column y_px"},
        {HEADER "01,left,640,480,0,1 2,2,0\n", "'1 2'"},
        {HEADER "01,left,640,480,0,\"1,5\",2,0\n", "'1,5'"},
        {HEADER "01,left,640,480,0,1,2,-0.1\n", "column sigma_px: is -0.1"},
        {HEADER "01,left,640,480,0,1,2,20000\n", "column sigma_px: is 20000"},
        {HEADER "01,left,640,480,0,1,2,\n", "column sigma_px: must be a finite number, but is empty"},
        {HEADER "01,left,640,480,0,1,2,\"0\n", "never closed"},
        {HEADER "01,left,640,480,0,1,2,\xFF\n", "UTF-8"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_error error = {0};
        td_observations *o;
        td_status status = parse_points(&o, bad[i].text, &error);
        if (status != TD_ERROR_FORMAT || !strstr(error.message, bad[i].words) ||
            strncmp(error.message, "points.csv:", 11) != 0)
            fail_msg("case %zu: status %d, '%s' lacks '%s'", i, (int)status, error.message, bad[i].words);
        td_observations_free(&o);
        assert_int_equal(parse_points(&o, bad[i].text, NULL), TD_ERROR_FORMAT);
        td_observations_free(&o);
    }
    td_error error = {0};
    const char *const names[] = {"01", "02"};
    td_observations *o = make_observations(names, 2);
    char *missing = td_path_join(*state, "missing.csv");
    check_fails(td_points_read(o, missing, &error), TD_ERROR_IO, error, "missing.csv");
    /* Bytes behind a 0 are not text. */
    static const char zero[] = HEADER "01,left,640,480,0,1,2,0\0garbage\n";
    check_fails(td_points_parse(o, zero, sizeof zero - 1, "points.csv", &error), TD_ERROR_FORMAT, error,
                "points.csv");
    free(missing);
    td_observations_free(&o);
}

/* ---- clicks ---- */

static td_status parse_clicks(td_image_clicks **clicks, size_t *count, const char *text, td_error *error)
{
    *clicks = (td_image_clicks *)(uintptr_t)1;
    *count = 99;
    return td_clicks_parse(clicks, count, text, strlen(text), "clicks.csv", error);
}

static void test_clicks(void **state)
{
    td_error error = {0};
    td_image_clicks *clicks;
    size_t count;
    check_ok(parse_clicks(&clicks, &count,
                          "y_px,image,mark,x_px,by\n2,a.png,0,1,me\n20.5,left/b.png,3,-10,\n4,a.png,11,3,\n"
                          "# of the first again\n6,a.png,7,5e1,\n",
                          &error),
             error);
    assert_int_equal(count, 2);
    assert_string_equal(clicks[0].image, "a.png");
    assert_string_equal(clicks[1].image, "left/b.png");
    assert_int_equal(clicks[0].count, 3);
    assert_int_equal(clicks[1].count, 1);
    const td_click expected[3] = {{0, {1, 2}}, {11, {3, 4}}, {7, {50, 6}}};
    for (int i = 0; i < 3; i++) {
        assert_int_equal(clicks[0].click[i].index, expected[i].index);
        for (int k = 0; k < 2; k++) check_near(clicks[0].click[i].pixel[k], expected[i].pixel[k], 0);
    }
    check_near(clicks[1].click[0].pixel[0], -10, 0);
    free(clicks);
    check_ok(parse_clicks(&clicks, &count, "image,mark,x_px,y_px\n", &error), error);
    assert_int_equal(count, 0);
    free(clicks);

    static const char text[] = "image,mark,x_px,y_px\nc.png,1,2,3\n";
    char *path = td_path_join(*state, "clicks.csv");
    check_ok(td_file_write(path, text, sizeof text - 1, &error), error);
    check_ok(td_clicks_read(&clicks, &count, path, &error), error);
    assert_int_equal(count, 1);
    assert_string_equal(clicks[0].image, "c.png");
    free(clicks);
    free(path);
}

#define CLICKS "image,mark,x_px,y_px\n"

static void test_bad_clicks(void **state)
{
    static const struct {
        const char *text, *words;
    } bad[] = {
        {"", "is empty"},
        {"mark,x_px,y_px\n", "no column image"},
        {"image,x_px,y_px\n", "no column mark"},
        {"image,mark,y_px\n", "no column x_px"},
        {"image,mark,x_px\n", "no column y_px"},
        {CLICKS ",0,1,2\n", "clicks.csv:2: column image: not the name of an image"},
        {CLICKS "a.png,-1,1,2\n", "clicks.csv:2: column mark: is -1"},
        {CLICKS "a.png,1000001,1,2\n", "column mark: is 1000001"},
        {CLICKS "a.png,A,1,2\n", "column mark: must be a whole number"},
        {CLICKS "a.png,0,x,2\n", "column x_px: must be a finite number"},
        {CLICKS "a.png,0,1,nan\n", "column y_px: must be a finite number"},
        {CLICKS "a.png,0,2e6,2\n", "column x_px: is 2e6"},
        {CLICKS "a.png,0,1,-2e6\n", "column y_px: is -2e6"},
        {CLICKS "a.png,0,1\n", "the row has 3 cells"},
        {CLICKS "a.png,4,1,2\nb.png,4,1,2\na.png,4,5,6\n",
         "clicks.csv:4: column mark: mark 4 of a.png is given twice"},
        {CLICKS "a,0,1,2\na,1,1,2\na,2,1,2\na,3,1,2\na,4,1,2\na,5,1,2\na,6,1,2\na,7,1,2\na,8,1,2\na,9,1,2\n",
         "clicks.csv:11: column image: more than 9 clicks on a"},
    };
    td_image_clicks *clicks;
    size_t count;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_error error = {0};
        td_status status = parse_clicks(&clicks, &count, bad[i].text, &error);
        if (status != TD_ERROR_FORMAT || !strstr(error.message, bad[i].words) ||
            strncmp(error.message, "clicks.csv:", 11) != 0)
            fail_msg("case %zu: status %d, '%s' lacks '%s'", i, (int)status, error.message, bad[i].words);
        assert_null(clicks);
        assert_int_equal(count, 0);
    }
    td_error error = {0};
    char text[400] = CLICKS;
    memset(text + strlen(CLICKS), 'n', 256);
    strcpy(text + strlen(CLICKS) + 256, ",0,1,2\n");
    check_fails(parse_clicks(&clicks, &count, text, &error), TD_ERROR_FORMAT, error,
                "not the name of an image");
    text[strlen(CLICKS)] = ' '; /* 255 are accepted */
    check_ok(parse_clicks(&clicks, &count, text, &error), error);
    assert_int_equal(strlen(clicks[0].image), 255);
    free(clicks);
    char *missing = td_path_join(*state, "missing.csv");
    check_fails(td_clicks_read(&clicks, &count, missing, &error), TD_ERROR_IO, error, "missing.csv");
    assert_null(clicks);
    free(missing);
}

/* ---- from images ---- */

static void write_text(const char *folder, const char *name, const char *text)
{
    td_error error = {0};
    char *path = td_path_join(folder, name);
    check_ok(td_file_write(path, text, strlen(text), &error), error);
    free(path);
}

static void write_image(const char *folder, const char *name, int width, int height, const uint8_t *data)
{
    td_error error = {0};
    td_image *image = NULL;
    char *path = td_path_join(folder, name), *parent = td_path_folder(path);
    check_ok(td_folder_make(parent, &error), error);
    check_ok(td_image_new(&image, width, height, 1, &error), error);
    if (data)
        memcpy(image->data, data, (size_t)width * (size_t)height);
    else
        memset(image->data, 128, (size_t)width * (size_t)height);
    check_ok(td_image_write(path, image, &error), error);
    td_image_free(&image);
    free(path);
    free(parent);
}

enum { WIDTH = 176, HEIGHT = 144 };

static void write_board(const char *folder, const char *name, double turn)
{
    uint8_t data[WIDTH * HEIGHT];
    td_random random = td_random_seed(3, 3);
    scene s = {.width = WIDTH,
               .height = HEIGHT,
               .columns = 5,
               .rows = 4,
               .blur = 0.7,
               .dark = 30,
               .light = 220,
               .pairs = 60};
    scene_place(&s, 20, turn, 0.2, 0.5);
    double *grey = scene_render(&s);
    scene_expose(data, grey, &s, 1, &random);
    write_image(folder, name, WIDTH, HEIGHT, data);
    free(grey);
}

static const char description[] = "name: small\n"
                                  "target: {kind: chessboard, columns: 5, rows: 4, spacing_m: 0.02}\n"
                                  "cameras:\n"
                                  "  - {name: left, model: brown5}\n"
                                  "  - {name: right, model: pinhole}\n";

/* Three frames: both see the board; the right one has no image; the left one sees none. */
static td_dataset *make_dataset(const char *folder)
{
    td_error error = {0};
    td_dataset *d = NULL;
    write_text(folder, "dataset.yaml", description);
    write_text(folder, "frames.csv",
               "frame,left,right,height_m\n01,left01.png,right01.png,\n02,left02.pgm,,0.05\n03,left03.png,"
               "right03.png,\n");
    write_board(folder, "left01.png", 0.1);
    write_board(folder, "right01.png", -0.2);
    write_board(folder, "left02.pgm", 0);
    write_image(folder, "left03.png", WIDTH, HEIGHT, NULL);
    write_board(folder, "right03.png", 0.3);
    check_ok(td_dataset_read(&d, folder, &error), error);
    return d;
}

static void test_observe(void **state)
{
    td_error error = {0};
    td_dataset *d = make_dataset(*state);
    td_observations *o = NULL;
    check_ok(td_observe(&o, d, NULL, &error), error);
    assert_int_equal(o->camera_count, 2);
    assert_int_equal(o->view_count, 3);
    assert_string_equal(o->camera[1].name, "right");
    assert_int_equal(o->camera[0].model, TD_CAMERA_BROWN5);
    assert_int_equal(o->camera[1].model, TD_CAMERA_PINHOLE);
    assert_string_equal(o->view_name[2], "03");
    assert_true(isnan(o->height_m[0]));
    check_near(o->height_m[1], 0.05, 0);
    for (int c = 0; c < 2; c++) {
        assert_int_equal(o->camera[c].width, WIDTH);
        assert_int_equal(o->camera[c].height, HEIGHT);
    }
    const bool expected[3][2] = {{true, true}, {true, false}, {false, true}};
    for (size_t v = 0; v < 3; v++)
        for (int c = 0; c < 2; c++) {
            const td_detection *a = td_observations_get(o, v, c);
            assert_int_equal(a->found, expected[v][c]);
            assert_int_equal(td_observations_seen(o, v, c), expected[v][c] ? POINTS : 0);
            if (!d->frame[v].image[c]) {
                assert_string_equal(a->reason, "");
                continue;
            }
            assert_true(a->found || a->reason[0]);
            td_image *image = NULL;
            td_detection b;
            check_ok(td_image_read(&image, d->frame[v].image[c], 1, &error), error);
            check_ok(td_detect(&b, image, &board, &error), error);
            assert_string_equal(a->reason, b.reason);
            assert_memory_equal(a->point, b.point, 2 * POINTS * sizeof(double));
            assert_memory_equal(a->sigma, b.sigma, POINTS * sizeof(double));
            td_detection_free(&b);
            td_image_free(&image);
        }
    td_observations_free(&o);
    td_dataset_free(&d);
}

static void test_observe_on_threads(void **state)
{
    td_error error = {0};
    td_dataset *d = make_dataset(*state);
    td_observations *one = NULL, *more = NULL;
    td_observe_options options = {.threads = 1};
    check_ok(td_observe(&one, d, &options, &error), error);
    for (int threads = 2; threads < 6; threads++) {
        options.threads = threads;
        check_ok(td_observe(&more, d, &options, &error), error);
        for (size_t i = 0; i < 6; i++) {
            assert_int_equal(one->detection[i].found, more->detection[i].found);
            assert_memory_equal(one->detection[i].point, more->detection[i].point,
                                2 * POINTS * sizeof(double));
            assert_memory_equal(one->detection[i].sigma, more->detection[i].sigma, POINTS * sizeof(double));
        }
        td_observations_free(&more);
    }
    td_observations_free(&one);
    td_dataset_free(&d);
}

static void check_observe_fails(const td_dataset *d, td_status status, const char *words, const char *more)
{
    for (int threads = 0; threads < 5; threads++) {
        td_error error = {0};
        td_observe_options options = {.threads = threads};
        td_observations *o = (td_observations *)(uintptr_t)1;
        check_fails(td_observe(&o, d, &options, &error), status, error, words);
        if (!strstr(error.message, more)) fail_msg("'%s' lacks '%s'", error.message, more);
        assert_null(o);
        assert_int_equal(td_observe(&o, d, &options, NULL), status);
    }
}

static void test_observe_fails(void **state)
{
    const char *folder = *state;
    td_dataset *d = make_dataset(folder);
    /* The second size is the fault, whichever is larger; both are named. */
    write_image(folder, "right03.png", HEIGHT, WIDTH, NULL);
    check_observe_fails(d, TD_ERROR_DATA, "right03.png is 144x176 px, but camera right began with 176x144 px",
                        "right01.png");
    /* The first fault in the order of the frames counts, and there that of the cameras. */
    write_text(folder, "left03.png", "no image");
    check_observe_fails(d, TD_ERROR_FORMAT, "left03.png", "left03.png");
    write_image(folder, "left02.pgm", WIDTH + 1, HEIGHT, NULL);
    check_observe_fails(d, TD_ERROR_DATA, "left02.pgm is 177x144 px", "all images of a camera");
    char *gone = td_path_join(folder, "right01.png");
    remove(gone);
    check_observe_fails(d, TD_ERROR_IO, "right01.png", "right01.png");
    write_text(folder, "left01.png", "");
    check_observe_fails(d, TD_ERROR_FORMAT, "left01.png", "empty");
    free(gone);
    for (size_t v = 0; v < 3; v++) {
        free(d->frame[v].image[0]);
        d->frame[v].image[0] = NULL;
    }
    write_board(folder, "right01.png", 0);
    write_board(folder, "right03.png", 0);
    check_observe_fails(d, TD_ERROR_DATA, "camera left has no image", "frames.csv");
    td_dataset_free(&d);
}

/* Points that were found elsewhere take the place of the images, which need not exist. */
static void test_observe_corners(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_dataset *d = make_dataset(folder);
    td_observations *o = NULL, *back = NULL;
    check_ok(td_observe(&o, d, NULL, &error), error);
    char *path = td_path_join(folder, "found.csv"), yaml[600];
    check_ok(td_observations_write(o, NULL, path, &error), error);
    free(path);
    td_dataset_free(&d);
    snprintf(yaml, sizeof yaml, "%scorners: found.csv\n", description);
    write_text(folder, "dataset.yaml", yaml);
    write_text(folder, "frames.csv", "frame,left,right\n01,a.png,b.png\n02,c.png,\n03,d.png,e.png\n");
    check_ok(td_dataset_read(&d, folder, &error), error);
    check_ok(td_observe(&back, d, NULL, &error), error);
    for (size_t i = 0; i < 6; i++) {
        assert_int_equal(back->detection[i].found, o->detection[i].found);
        for (size_t p = 0; p < 2 * POINTS && o->detection[i].found; p++)
            check_near(back->detection[i].point[p], o->detection[i].point[p], 0);
    }
    assert_int_equal(back->camera[0].width, WIDTH);
    td_observations_free(&back);
    write_text(folder, "found.csv", HEADER "04,left,640,480,0,1,2,0\n");
    check_fails(td_observe(&back, d, NULL, &error), TD_ERROR_FORMAT, error, "found.csv:2: column frame");
    assert_null(back);
    td_observations_free(&o);
    td_dataset_free(&d);
}

static bool stop_after_two(const char *stage, size_t done, size_t total, void *user)
{
    assert_string_equal(stage, "finding the target");
    assert_int_equal(total, 6);
    ++*(size_t *)user;
    return done < 2;
}

static void test_cancel(void **state)
{
    td_error error = {0};
    td_dataset *d = make_dataset(*state);
    size_t calls = 0;
    td_progress progress = {stop_after_two, &calls};
    td_observe_options options = {.threads = 1, .progress = &progress};
    td_observations *o = NULL;
    check_fails(td_observe(&o, d, &options, &error), TD_ERROR_CANCELLED, error, "interrupted");
    assert_null(o);
    assert_int_equal(calls, 2);
    td_dataset_free(&d);
}

/* 4x3 dark discs, of which a half turn looks the same. */
static void write_marks(const char *folder, const char *name)
{
    uint8_t data[WIDTH * HEIGHT];
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        double x = i % WIDTH - 40, y = i / WIDTH - 40; /* mark 0 at (40, 40), 30 px apart */
        double dx = x - 30 * fmin(fmax(round(x / 30), 0), 3), dy = y - 30 * fmin(fmax(round(y / 30), 0), 2);
        double edge = fmin(fmax(8.5 - hypot(dx, dy), 0), 1);
        data[i] = (uint8_t)lrint(200 - 150 * edge);
    }
    write_image(folder, name, WIDTH, HEIGHT, data);
}

/* Clicks decide the numbering of the image that they name, in whatever folder it is, and of no other. */
static void test_observe_clicks(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_dataset *d = NULL;
    td_observations *o = NULL;
    write_text(
        folder, "dataset.yaml",
        "name: marks\n"
        "target: {kind: marks, columns: 4, rows: 3, spacing_m: 0.03, diameter_m: 0.016, polarity: dark}\n"
        "cameras: [{name: left, model: pinhole}, {name: right, model: pinhole}]\n");
    write_text(folder, "frames.csv",
               "left,right\nl/01.png,r/01.png\nl/02.png,r/02.png\nl/102.png,r/102.png\n");
    for (int i = 0; i < 6; i++) {
        char name[32];
        snprintf(name, sizeof name, "%s/%s02.png", i % 2 ? "l" : "r", i / 2 == 2 ? "1" : "");
        if (i / 2 == 0) snprintf(name, sizeof name, "%s/01.png", i % 2 ? "l" : "r");
        write_marks(folder, name);
    }
    check_ok(td_dataset_read(&d, folder, &error), error);
    /* Mark 0 at the bottom right, mark 11 at the top left. */
    const td_click turned[4] = {{0, {130, 100}}, {3, {40, 100}}, {8, {130, 40}}, {11, {40, 40}}};
    td_image_clicks clicks[2] = {{.image = "r/01.png", .count = 4}, {.image = "02.png", .count = 4}};
    for (int i = 0; i < 2; i++) memcpy(clicks[i].click, turned, sizeof turned);
    td_observe_options options = {.clicks = clicks, .click_count = 2};
    check_ok(td_observe(&o, d, &options, &error), error);
    const bool turn[3][2] = {{false, true}, {true, true}, {false, false}};
    for (size_t v = 0; v < 3; v++)
        for (int c = 0; c < 2; c++) {
            const td_detection *m = td_observations_get(o, v, c);
            if (!m->found) fail_msg("view %zu, camera %d: %s", v, c, m->reason);
            check_near(m->point[0], turn[v][c] ? 130 : 40, 0.1);
            check_near(m->point[1], turn[v][c] ? 100 : 40, 0.1);
        }
    td_observations_free(&o);
    td_dataset_free(&d);
}

#define ON_DISK(test) cmocka_unit_test_setup_teardown(test, scratch_make, scratch_remove)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_new),       cmocka_unit_test(test_set),
        ON_DISK(test_round_trip),         cmocka_unit_test(test_points_that_suffice),
        ON_DISK(test_bad_points),         ON_DISK(test_clicks),
        ON_DISK(test_bad_clicks),         ON_DISK(test_observe),
        ON_DISK(test_observe_on_threads), ON_DISK(test_observe_fails),
        ON_DISK(test_observe_corners),    ON_DISK(test_cancel),
        ON_DISK(test_observe_clicks)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
