/* Proves: a folder that fills gives each image once, whole, in natural order, waits for one that is still
 * being written and names one that never can be read; pairs stay pairs when one of them cannot; a video's
 * frames come with the content and the times they were written with, at the wished rate, and pairs of videos
 * by their times with the true skew; what is no source is refused with what to do. Reference: images whose
 * grey value is their number, and AVI files written here byte by byte, whose times are k scale / rate.
 * Tolerances: PGM is exact; JPEG at quality 95 keeps a flat grey within 2; FFmpeg tells times in
 * microseconds. Blind to real cameras (none is here): of them only listing, finding and refusing are shown,
 * on a folder made to look like /dev. */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "core/source.h"
#include "core/source_internal.h"
#include "tests/check.h"
#include "tests/core/avi.h"
#include "tests/scratch.h"

enum { WIDTH = 32, HEIGHT = 24 };

static td_image *grey(int value)
{
    td_error error = {0};
    td_image *image = NULL;
    check_ok(td_image_new(&image, WIDTH, HEIGHT, 1, &error), error);
    memset(image->data, value, WIDTH * HEIGHT);
    return image;
}

static void put(const char *folder, const char *name, int value)
{
    td_error error = {0};
    td_image *image = grey(value);
    char *path = td_path_join(folder, name);
    check_ok(td_image_write(path, image, &error), error);
    free(path);
    td_image_free(&image);
}

static void put_bytes(const char *folder, const char *name, const char *bytes, size_t size)
{
    char *path = td_path_join(folder, name);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    fwrite(bytes, 1, size, file);
    fclose(file);
    free(path);
}

/* Puts a file's times back, so that it counts as settled. */
static void make_old(const char *folder, const char *name)
{
    char *path = td_path_join(folder, name);
    const struct timespec old[2] = {{1000000000, 0}, {1000000000, 500000000}};
    assert_int_equal(utimensat(AT_FDCWD, path, old, 0), 0);
    free(path);
}

static char *subfolder(const char *folder, const char *name)
{
    char *path = td_path_join(folder, name);
    assert_int_equal(mkdir(path, 0777), 0);
    return path;
}

static td_source *open_source(const char *where, const td_source_options *options)
{
    td_error error = {0};
    td_source *source = NULL;
    check_ok(td_source_open(&source, where, options, &error), error);
    return source;
}

/* The next image's grey value; -1: none came, -2: ended. */
static int next(td_source *source, double wait_s, char name[256])
{
    td_error error = {0};
    td_frame frame;
    bool got, ended;
    check_ok(td_source_next(&frame, &got, &ended, source, wait_s, &error), error);
    if (!got) return ended ? -2 : -1;
    if (name) snprintf(name, 256, "%s", frame.name);
    const int value = frame.image->data[WIDTH * HEIGHT / 2];
    assert_int_equal(frame.image->width, WIDTH);
    td_image_free(&frame.image);
    return value;
}

static void test_natural_order(void **state)
{
    (void)state;
    static const char *const sorted[] = {"a",
                                         "a1",
                                         "a01",
                                         "a2",
                                         "a10.png",
                                         "a10b",
                                         "a10b2",
                                         "a10b10",
                                         "b0",
                                         "b00",
                                         "b1",
                                         "frame-9.png",
                                         "frame-10.png",
                                         "x99999999999999999999998",
                                         "x99999999999999999999999"};
    enum { COUNT = sizeof sorted / sizeof *sorted };
    for (int i = 0; i < COUNT; i++)
        for (int j = 0; j < COUNT; j++) {
            int order = td_natural_compare(sorted[i], sorted[j]);
            /* "a1" and "a01" are of one value: told apart by their bytes. */
            if ((i == 1 && j == 2) || (i == 2 && j == 1)) order = -order;
            if ((i == 8 && j == 9) || (i == 9 && j == 8))
                order = strcmp(sorted[i], sorted[j]) < 0 ? i - j : order;
            if ((order > 0) - (order < 0) != (i > j) - (i < j))
                fail_msg("%s, %s: %d", sorted[i], sorted[j], order);
        }
}

static void test_folder(void **state)
{
    const char *folder = *state;
    char name[256];
    put(folder, "img10.pgm", 10);
    put(folder, "img9.png", 9);
    put(folder, "img100.PGM", 100);
    put(folder, ".hidden.pgm", 1);
    put_bytes(folder, "notes.txt", "text", 4);
    free(subfolder(folder, "sub.png"));
    td_source *source = open_source(folder, NULL);
    assert_int_equal(td_source_kind_of(source), TD_SOURCE_FOLDER);
    assert_int_equal(next(source, 0, name), 9);
    assert_string_equal(name, "img9.png");
    assert_int_equal(next(source, 0, NULL), 10);
    assert_int_equal(next(source, 0, NULL), 100);
    assert_int_equal(next(source, 0, NULL), -1);
    put(folder, "img11.pgm", 11);
    put(folder, "img2.pgm", 2);
    assert_int_equal(next(source, 0, NULL), 2);
    assert_int_equal(next(source, 0, NULL), 11);
    assert_int_equal(next(source, 0.1, NULL), -1);
    td_source_free(&source);
    assert_null(source);
    td_source_free(NULL);
}

static void test_folder_frame(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_frame frame;
    bool got, ended;
    put(folder, "a.pgm", 7);
    make_old(folder, "a.pgm");
    td_source_options options = td_source_options_default();
    options.channels = 3;
    td_source *source = open_source(folder, &options);
    check_ok(td_source_next(&frame, &got, &ended, source, 0, &error), error);
    assert_true(got && !ended && frame.number == 0 && frame.image->channels == 3);
    check_near(frame.time_s, 1000000000.5, 1e-6);
    td_image_free(&frame.image);
    put(folder, "b.pgm", 8);
    check_ok(td_source_next(&frame, &got, &ended, source, 0, &error), error);
    assert_true(got && frame.number == 1);
    td_image_free(&frame.image);
    td_source_free(&source);
}

static void test_pattern(void **state)
{
    const char *folder = *state;
    put(folder, "left1.pgm", 1);
    put(folder, "right1.pgm", 2);
    td_source_options options = td_source_options_default();
    options.pattern = "right*";
    td_source *source = open_source(folder, &options);
    assert_int_equal(next(source, 0, NULL), 2);
    assert_int_equal(next(source, 0, NULL), -1);
    td_source_free(&source);
    char *where = td_path_join(folder, "l*.pgm");
    source = open_source(where, NULL);
    assert_int_equal(next(source, 0, NULL), 1);
    assert_int_equal(next(source, 0, NULL), -1);
    td_source_free(&source);
    free(where);
}

/* The bytes of a PNG file of this value. */
static char *png_of(const char *folder, int value, size_t *size)
{
    td_error error = {0};
    char *bytes = NULL, *path = td_path_join(folder, "whole.png");
    put(folder, "whole.png", value);
    check_ok(td_file_read(&bytes, size, path, 1 << 20, &error), error);
    unlink(path);
    free(path);
    return bytes;
}

static void test_half_written(void **state)
{
    const char *folder = *state;
    size_t size;
    char *bytes = png_of(folder, 5, &size);
    put_bytes(folder, "1.png", bytes, size / 2);
    put(folder, "2.pgm", 6);
    td_source *source = open_source(folder, NULL);
    /* The first is waited for: the second does not overtake it. */
    assert_int_equal(next(source, 0.2, NULL), -1);
    put_bytes(folder, "1.png", bytes, 3 * size / 4);
    assert_int_equal(next(source, 0.1, NULL), -1);
    put_bytes(folder, "1.png", bytes, size);
    assert_int_equal(next(source, 0.1, NULL), 5);
    assert_int_equal(next(source, 0, NULL), 6);
    td_source_free(&source);
    free(bytes);
}

static void test_never_whole(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_frame frame;
    bool got, ended;
    size_t size;
    char *bytes = png_of(folder, 5, &size);
    put_bytes(folder, "1.png", bytes, size / 2);
    put(folder, "2.pgm", 6);
    td_source *source = open_source(folder, NULL);
    const double begun = td_monotonic_s();
    check_fails(td_source_next(&frame, &got, &ended, source, 10, &error), TD_ERROR_FORMAT, error, "1.png");
    check_near(td_monotonic_s() - begun, 2.2, 0.5);
    assert_true(!got && !frame.image);
    assert_int_equal(next(source, 0, NULL), 6);
    assert_int_equal(next(source, 0, NULL), -1);
    /* An old one is not waited for. */
    put_bytes(folder, "3.png", "", 0);
    make_old(folder, "3.png");
    check_fails(td_source_next(&frame, &got, &ended, source, 10, &error), TD_ERROR_FORMAT, error, "3.png");
    check_less(td_monotonic_s() - begun, 3.5);
    td_source_free(&source);
    free(bytes);
}

static void *write_slowly(void *user)
{
    const char *folder = user;
    td_pause_s(0.3);
    put(folder, "late.pgm", 77);
    return NULL;
}

static void test_waiting(void **state)
{
    char *folder = *state;
    td_source *source = open_source(folder, NULL);
    pthread_t thread;
    const double begun = td_monotonic_s();
    assert_int_equal(pthread_create(&thread, NULL, write_slowly, folder), 0);
    assert_int_equal(next(source, 20, NULL), 77);
    check_less(0.25, td_monotonic_s() - begun);
    check_less(td_monotonic_s() - begun, 5);
    pthread_join(thread, NULL);
    td_source_free(&source);
}

static void test_folder_gone(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_frame frame;
    bool got, ended;
    char *path = subfolder(folder, "in");
    td_source *source = open_source(path, NULL);
    assert_int_equal(rmdir(path), 0);
    check_fails(td_source_next(&frame, &got, &ended, source, 1, &error), TD_ERROR_IO, error, path);
    td_source_free(&source);
    free(path);
}

/* The next pair's values; {-1, -1}: none. */
static td_status next_pair(int value[2], td_source *const *source, double wait_s, double *skew_s,
                           td_error *error)
{
    td_frame frame[2];
    bool got, ended;
    value[0] = value[1] = -1;
    TD_TRY(td_source_next_together(frame, &got, &ended, skew_s, source, 2, wait_s, error));
    if (!got) value[0] = value[1] = ended ? -2 : -1;
    for (int i = 0; got && i < 2; i++) {
        value[i] = frame[i].image->data[WIDTH * HEIGHT / 2];
        td_image_free(&frame[i].image);
    }
    return TD_OK;
}

static void test_folder_pairs(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    double skew;
    int value[2];
    char *left = subfolder(folder, "left"), *right = subfolder(folder, "right");
    for (int k = 0; k < 4; k++) {
        char name[16];
        snprintf(name, sizeof name, "%d.pgm", k);
        put(left, name, 10 + k);
        if (k < 3) put(right, name, 20 + k);
    }
    put_bytes(right, "1.pgm", "P5 damaged", 10);
    make_old(right, "1.pgm");
    td_source *source[2] = {open_source(left, NULL), open_source(right, NULL)};
    check_ok(next_pair(value, source, 0, &skew, &error), error);
    assert_true(value[0] == 10 && value[1] == 20 && isnan(skew));
    check_fails(next_pair(value, source, 0, &skew, &error), TD_ERROR_FORMAT, error, "right/1.pgm");
    check_ok(next_pair(value, source, 0, &skew, &error), error);
    assert_true(value[0] == 12 && value[1] == 22);
    check_ok(next_pair(value, source, 0.05, &skew, &error), error);
    assert_int_equal(value[0], -1);
    put(right, "3.pgm", 23);
    check_ok(next_pair(value, source, 0.5, &skew, &error), error);
    assert_true(value[0] == 13 && value[1] == 23);
    /* The same with the damaged one on the left, whose partner comes later. */
    put_bytes(left, "4.pgm", "P5 damaged", 10);
    make_old(left, "4.pgm");
    check_ok(next_pair(value, source, 0, &skew, &error), error);
    assert_int_equal(value[0], -1);
    put(right, "4.pgm", 24);
    check_fails(next_pair(value, source, 0, &skew, &error), TD_ERROR_FORMAT, error, "left/4.pgm");
    put(left, "5.pgm", 15);
    put(right, "5.pgm", 25);
    check_ok(next_pair(value, source, 0.5, &skew, &error), error);
    assert_true(value[0] == 15 && value[1] == 25);
    /* One folder is ahead of the other, and a lower number comes late: numbers decide, not the order. */
    put(left, "6.pgm", 16);
    put(right, "6.pgm", 26);
    put(right, "8.pgm", 28);
    check_ok(next_pair(value, source, 0.5, &skew, &error), error);
    assert_true(value[0] == 16 && value[1] == 26);
    put(left, "7.pgm", 17);
    put(left, "8.pgm", 18);
    put(right, "007.pgm", 27);
    check_ok(next_pair(value, source, 0.5, &skew, &error), error);
    assert_true(value[0] == 17 && value[1] == 27);
    check_ok(next_pair(value, source, 0.5, &skew, &error), error);
    assert_true(value[0] == 18 && value[1] == 28);
    td_source_free(&source[0]);
    td_source_free(&source[1]);
    free(left);
    free(right);
}

/* ---- videos ---- */

/* Frame k is grey of value 10 + 5 k. */
static char *write_video(const char *folder, const char *name, int count, uint32_t rate, uint32_t scale)
{
    td_error error = {0};
    td_image *image[64];
    char *path = td_path_join(folder, name);
    for (int k = 0; k < count; k++) image[k] = grey(10 + 5 * k);
    check_ok(avi_write(path, image, count, rate, scale, &error), error);
    for (int k = 0; k < count; k++) td_image_free(&image[k]);
    return path;
}

static void test_video(void **state)
{
    td_error error = {0};
    char *path = write_video(*state, "a.avi", 12, 25, 2);
    for (int channels = 1; channels <= 3; channels += 2) {
        td_source_options options = td_source_options_default();
        options.channels = channels;
        td_source *source = open_source(path, &options);
        assert_int_equal(td_source_kind_of(source), TD_SOURCE_VIDEO);
        check_near(td_source_period_s(source), 0.08, 1e-6);
        for (int k = 0; k < 12; k++) {
            td_frame frame;
            bool got, ended;
            check_ok(td_source_next(&frame, &got, &ended, source, 0, &error), error);
            assert_true(got && !ended && frame.number == k && frame.image->channels == channels);
            check_near(frame.time_s, 0.08 * k, 1e-5);
            check_near(frame.image->data[40 * channels], 10 + 5 * k, 2);
            td_image_free(&frame.image);
        }
        assert_int_equal(next(source, 0, NULL), -2);
        assert_int_equal(next(source, 0, NULL), -2);
        td_source_free(&source);
    }
    free(path);
}

/* Of 30 a second, 10 are every third; of 25 a second, the nearest to each tenth. */
static void test_video_rate(void **state)
{
    static const struct {
        uint32_t rate;
        int want[5];
    } cases[] = {{30, {0, 3, 6, 9, 12}}, {25, {0, 2, 5, 7, 10}}, {10, {0, 1, 2, 3, 4}}, {5, {0, 1, 2, 3, 4}}};
    for (size_t c = 0; c < sizeof cases / sizeof *cases; c++) {
        char *path = write_video(*state, "r.avi", 14, cases[c].rate, 1);
        td_source_options options = td_source_options_default();
        options.rate_hz = 10;
        td_source *source = open_source(path, &options);
        for (int k = 0; k < 5; k++) check_near(next(source, 0, NULL), 10 + 5 * cases[c].want[k], 2);
        td_source_free(&source);
        free(path);
    }
}

/* 10 and 8 a second: times 0 0.1 0.2 0.4 0.5 against 0 0.125 0.25 0.375 0.5; 0.3 is left out, since 0.375
 * lies more than half of 0.1 behind it. */
static void test_video_pairs(void **state)
{
    static const double skew_want[] = {0, 0.025, 0.05, 0.025, 0};
    static const int left_want[] = {0, 1, 2, 4, 5};
    td_error error = {0};
    char *a = write_video(*state, "a.avi", 8, 10, 1), *b = write_video(*state, "b.avi", 5, 8, 1);
    td_source *source[2] = {open_source(a, NULL), open_source(b, NULL)};
    int value[2];
    double skew;
    for (int k = 0; k < 5; k++) {
        check_ok(next_pair(value, source, 0, &skew, &error), error);
        check_near(value[0], 10 + 5 * left_want[k], 2);
        check_near(value[1], 10 + 5 * k, 2);
        check_near(skew, skew_want[k], 1e-5);
    }
    check_ok(next_pair(value, source, 0, &skew, &error), error);
    assert_int_equal(value[0], -2);
    td_source_free(&source[0]);
    td_source_free(&source[1]);
    source[0] = open_source(a, NULL);
    source[1] = open_source(*state, NULL);
    check_fails(next_pair(value, source, 0, &skew, &error), TD_ERROR_ARGUMENT, error, "different kinds");
    td_source_free(&source[0]);
    td_source_free(&source[1]);
    free(a);
    free(b);
}

/* Runs the refusal with stderr in a file, which must stay empty: FFmpeg and OpenCV keep quiet. */
static void refused_quietly(const char *folder, const char *where, const char *words)
{
    td_error error = {0};
    td_source *source = NULL;
    char *log = td_path_join(folder, "stderr.log");
    fflush(stderr);
    const int kept = dup(2), file = open(log, O_CREAT | O_TRUNC | O_RDWR, 0600);
    dup2(file, 2);
    td_status status = td_source_open(&source, where, NULL, &error);
    td_frame frame;
    bool got, ended;
    if (status == TD_OK) status = td_source_next(&frame, &got, &ended, source, 0, &error);
    fflush(stderr);
    dup2(kept, 2);
    close(kept);
    const off_t written = lseek(file, 0, SEEK_END);
    close(file);
    free(log);
    td_source_free(&source);
    if (status == TD_OK) fail_msg("%s: is accepted", where);
    if (!strstr(error.message, where) || !strstr(error.message, words))
        fail_msg("'%s' lacks '%s' or '%s'", error.message, where, words);
    assert_int_equal(written, 0);
}

static void test_refusals(void **state)
{
    const char *folder = *state;
    td_error error = {0};
    td_source *source = NULL;
    put(folder, "one.pgm", 1);
    put_bytes(folder, "text.mp4", "this is no video at all", 23);
    put_bytes(folder, "empty.avi", "", 0);
    char *video = write_video(folder, "cut.avi", 3, 10, 1);
    assert_int_equal(truncate(video, 250), 0);
    char *path = td_path_join(folder, "text.mp4");
    refused_quietly(folder, path, "is not a video");
    free(path);
    path = td_path_join(folder, "empty.avi");
    refused_quietly(folder, path, "is not a video");
    free(path);
    refused_quietly(folder, video, "video");
    free(video);
    path = td_path_join(folder, "one.pgm");
    refused_quietly(folder, path, "give the folder");
    free(path);
    path = td_path_join(folder, "pipe.mp4");
    assert_int_equal(mkfifo(path, 0600), 0);
    refused_quietly(folder, path, "pipe");
    free(path);
    refused_quietly(folder, "/nowhere/at/all", "there is no such folder");
    refused_quietly(folder, "/dev/null", "no Video4Linux device");
    refused_quietly(folder, "/dev/video987", "no such device");
    check_fails(td_source_open(&source, "camera:987", NULL, &error), TD_ERROR_NOT_FOUND, error,
                "/dev/video987");
    check_fails(td_source_open(&source, "camera:no such name", NULL, &error), TD_ERROR_NOT_FOUND, error,
                "no such name");
    check_fails(td_source_open(&source, "folder:/nowhere", NULL, &error), TD_ERROR_IO, error, "/nowhere");
    check_fails(td_source_open(&source, "", NULL, &error), TD_ERROR_ARGUMENT, error, "empty");
    assert_null(source);
    td_source_options options = td_source_options_default();
    options.channels = 2;
    check_fails(td_source_open(&source, folder, &options, &error), TD_ERROR_ARGUMENT, error, "channels");
    options = td_source_options_default();
    options.width = 640;
    check_fails(td_source_open(&source, folder, &options, &error), TD_ERROR_ARGUMENT, error, "width");
    options = td_source_options_default();
    options.rate_hz = -1;
    check_fails(td_source_open(&source, folder, &options, &error), TD_ERROR_ARGUMENT, error, "rate_hz");
}

static void test_camera_list(void **state)
{
    const char *folder = *state;
    td_camera_device device[4];
    assert_int_equal(td_camera_devices_in(device, 4, "/nowhere/at/all"), 0);
    put_bytes(folder, "video10", "", 0);
    put_bytes(folder, "video2", "", 0);
    put_bytes(folder, "videos", "", 0);
    put_bytes(folder, "video3x", "", 0);
    const size_t count = td_camera_devices_in(device, 4, folder);
    if (strlen(folder) + 9 > sizeof device->path) skip();
    assert_int_equal(count, 2);
    assert_non_null(strstr(device[0].path, "/video2"));
    assert_non_null(strstr(device[1].path, "/video10"));
    assert_true(!device[0].usable && !device[1].usable);
    assert_non_null(strstr(device[0].why, "no Video4Linux device"));
    assert_int_equal(td_camera_devices_in(device, 1, folder), 2);
    td_camera_devices(device, 4);
}

#define IN_FOLDER(test) cmocka_unit_test_setup_teardown(test, scratch_make, scratch_remove)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_natural_order),
        IN_FOLDER(test_folder),
        IN_FOLDER(test_folder_frame),
        IN_FOLDER(test_pattern),
        IN_FOLDER(test_half_written),
        IN_FOLDER(test_never_whole),
        IN_FOLDER(test_waiting),
        IN_FOLDER(test_folder_gone),
        IN_FOLDER(test_folder_pairs),
        IN_FOLDER(test_video),
        IN_FOLDER(test_video_rate),
        IN_FOLDER(test_video_pairs),
        IN_FOLDER(test_refusals),
        IN_FOLDER(test_camera_list),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
