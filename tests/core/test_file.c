/* Proves that files are read whole and written whole or not at all: content, mode, limits, every kind of
 * thing that is not a file, failure in the middle of a write, and that no temporary is left behind.
 * Reference: what was written, byte for byte, and the kernel's own stat(). Blind to power failure: that fsync
 * is called where it must be is not observable from here; and to a truly full disk, for which a file size
 * limit stands in (the same path through write()). */
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static int count_entries(const char *folder)
{
    DIR *stream = opendir(folder);
    assert_non_null(stream);
    int count = -2; /* . and .. */
    while (readdir(stream)) count++;
    closedir(stream);
    return count;
}

static void test_round_trip(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *path = td_path_join(home, "a.bin");
    const size_t sizes[] = {0, 1, 4096, 65535, 65536, 65537, 300000};
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
        size_t size = sizes[s], got = 12345;
        char *bytes = malloc(size + 1), *back = NULL;
        for (size_t i = 0; i < size; i++) bytes[i] = (char)(i * 7 + i / 256);
        check_ok(td_file_write(path, bytes, size, &error), error);
        check_ok(td_file_read(&back, &got, path, 300000, &error), error);
        assert_int_equal(got, size);
        assert_memory_equal(back, bytes, size);
        assert_int_equal(back[size], 0);
        free(back);
        free(bytes);
    }
    assert_int_equal(count_entries(home), 1);
    free(path);
}

static void test_mode_follows_the_umask(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *path = td_path_join(home, "mode");
    struct stat status;
    mode_t old = umask(022);
    check_ok(td_file_write(path, "x", 1, &error), error);
    assert_int_equal(stat(path, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0644);
    umask(077);
    check_ok(td_file_write(path, "x", 1, &error), error);
    assert_int_equal(stat(path, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0600);
    umask(old);
    free(path);
}

static void test_limit(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *path = td_path_join(home, "limit"), *bytes = NULL;
    size_t size = 0;
    check_ok(td_file_write(path, "0123456789", 10, &error), error);
    check_ok(td_file_read(&bytes, &size, path, 10, &error), error);
    free(bytes);
    bytes = NULL;
    check_fails(td_file_read(&bytes, &size, path, 9, &error), TD_ERROR_IO, error, "larger than the 9 bytes");
    assert_non_null(strstr(error.message, path));
    assert_null(bytes);
    check_fails(td_file_read(&bytes, &size, path, 0, &error), TD_ERROR_IO, error, "larger");
    check_ok(td_file_read(&bytes, &size, path, SIZE_MAX, &error), error);
    assert_int_equal(size, 10);
    free(bytes);
    free(path);
}

/* A file whose size the kernel gives as 0. */
static void test_file_of_unknown_size(void **state)
{
    (void)state;
    td_error error = {0};
    char *bytes = NULL;
    size_t size = 0;
    if (access("/proc/self/status", R_OK) != 0) skip();
    check_ok(td_file_read(&bytes, &size, "/proc/self/status", 1 << 20, &error), error);
    assert_true(size > 100);
    free(bytes);
}

static void test_not_a_file(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *bytes = NULL, *path = td_path_join(home, "pipe");
    size_t size = 0;
    alarm(20); /* a reader that waits for the pipe is killed */
    assert_int_equal(mkfifo(path, 0600), 0);
    check_fails(td_file_read(&bytes, &size, path, 100, &error), TD_ERROR_IO, error, "is a pipe, not a file");
    check_fails(td_file_read(&bytes, &size, home, 100, &error), TD_ERROR_IO, error,
                "is a folder, not a file");
    check_fails(td_file_read(&bytes, &size, "/dev/null", 100, &error), TD_ERROR_IO, error,
                "is a device, not a file");
    check_fails(td_file_read(&bytes, &size, "/dev/zero", 100, &error), TD_ERROR_IO, error,
                "is a device, not a file");
    check_fails(td_file_read(&bytes, &size, "", 100, &error), TD_ERROR_IO, error, "cannot be opened");
    alarm(0);
    free(path);
    path = td_path_join(home, "nothing");
    check_fails(td_file_read(&bytes, &size, path, 100, &error), TD_ERROR_IO, error, "No such file");
    assert_non_null(strstr(error.message, path));
    assert_int_equal(td_file_read(&bytes, &size, path, 100, NULL), TD_ERROR_IO);
    assert_null(bytes);
    free(path);
}

static void test_write_refuses_special_files(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *path = td_path_join(home, "pipe");
    assert_int_equal(mkfifo(path, 0600), 0);
    check_fails(td_file_write(path, "x", 1, &error), TD_ERROR_IO, error, "is a pipe");
    check_fails(td_file_write(home, "x", 1, &error), TD_ERROR_IO, error, "is a folder");
    check_fails(td_file_write("/dev/null", "x", 1, &error), TD_ERROR_IO, error, "is a device");
    assert_int_equal(count_entries(home), 1);
    free(path);
    path = td_path_join(home, "no/such/folder");
    check_fails(td_file_write(path, "x", 1, &error), TD_ERROR_IO, error, "its folder must exist");
    free(path);
}

/* The second write dies in the middle: the first content is still there, and nothing else. */
static void test_failed_write_leaves_the_old_file(void **state)
{
    const char *home = *state;
    td_error error = {0};
    char *path = td_path_join(home, "kept"), *large = calloc(1, 1 << 20), *back = NULL;
    size_t size = 0;
    check_ok(td_file_write(path, "old", 3, &error), error);
    struct rlimit old, small;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    small = old;
    small.rlim_cur = 100000;
    void (*handler)(int) = signal(SIGXFSZ, SIG_IGN);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    td_status status = td_file_write(path, large, 1 << 20, &error);
    setrlimit(RLIMIT_FSIZE, &old);
    signal(SIGXFSZ, handler);
    assert_int_equal(status, TD_ERROR_IO);
    assert_non_null(strstr(error.message, path));
    assert_non_null(strstr(error.message, strerror(EFBIG)));
    assert_int_equal(count_entries(home), 1);
    check_ok(td_file_read(&back, &size, path, 100, &error), error);
    assert_string_equal(back, "old");
    free(back);
    free(large);
    free(path);
}

/* Two processes write the same path again and again while this one reads: never a mixture, never a part. */
static void test_readers_see_whole_files(void **state)
{
    const char *home = *state;
    td_error error = {0};
    enum { SIZE = 200000, ROUNDS = 40 };
    char *path = td_path_join(home, "shared"), *content = malloc(SIZE);
    memset(content, 'a', SIZE);
    check_ok(td_file_write(path, content, SIZE, &error), error);
    pid_t child[2];
    for (int c = 0; c < 2; c++) {
        child[c] = fork();
        assert_true(child[c] >= 0);
        if (child[c] == 0) {
            memset(content, 'b' + c, SIZE);
            int failed = 0;
            for (int i = 0; i < ROUNDS; i++) failed |= td_file_write(path, content, SIZE, NULL) != TD_OK;
            _exit(failed);
        }
    }
    int running = 2;
    while (running > 0) {
        char *back = NULL;
        size_t size = 0;
        check_ok(td_file_read(&back, &size, path, SIZE, &error), error);
        assert_int_equal(size, SIZE);
        for (size_t i = 0; i < SIZE; i += 997) assert_int_equal(back[i], back[0]);
        free(back);
        int status;
        if (waitpid(-1, &status, WNOHANG) > 0) {
            assert_int_equal(status, 0);
            running--;
        }
    }
    assert_int_equal(count_entries(home), 1);
    free(content);
    free(path);
}

static void test_folder_make(void **state)
{
    const char *home = *state;
    td_error error = {0};
    struct stat status;
    char *path = td_path_join(home, "a//b/c/"), *file = td_path_join(home, "file");
    check_ok(td_folder_make(path, &error), error);
    check_ok(td_folder_make(path, &error), error);
    assert_int_equal(stat(path, &status), 0);
    assert_true(S_ISDIR(status.st_mode));
    check_ok(td_folder_make("/", &error), error);
    check_ok(td_folder_make(".", &error), error);
    check_ok(td_file_write(file, "x", 1, &error), error);
    check_fails(td_folder_make(file, &error), TD_ERROR_IO, error, "is a file");
    char *below = td_path_join(file, "below");
    check_fails(td_folder_make(below, &error), TD_ERROR_IO, error, "is a file");
    check_fails(td_folder_make("", &error), TD_ERROR_ARGUMENT, error, "empty");
    free(below);
    free(file);
    free(path);
}

static void test_paths(void **state)
{
    (void)state;
    const char *const join[][3] = {{"a", "b", "a/b"},        {"a/", "b", "a/b"}, {"a", "/b", "/b"},
                                   {"", "b", "b"},           {"/", "b", "/b"},   {".", "b", "./b"},
                                   {"a/b", "c/d", "a/b/c/d"}};
    for (size_t i = 0; i < sizeof join / sizeof *join; i++) {
        char *path = td_path_join(join[i][0], join[i][1]);
        assert_string_equal(path, join[i][2]);
        free(path);
    }
    const char *const folder[][2] = {{"b", "."}, {"a/b", "a"},    {"/b", "/"}, {"//b", "/"},  {"a//b", "a"},
                                     {"", "."},  {"a/b/", "a/b"}, {"/", "/"},  {"/a/b", "/a"}};
    for (size_t i = 0; i < sizeof folder / sizeof *folder; i++) {
        char *path = td_path_folder(folder[i][0]);
        assert_string_equal(path, folder[i][1]);
        free(path);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_round_trip, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_mode_follows_the_umask, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_limit, scratch_make, scratch_remove),
        cmocka_unit_test(test_file_of_unknown_size),
        cmocka_unit_test_setup_teardown(test_not_a_file, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_write_refuses_special_files, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_failed_write_leaves_the_old_file, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_readers_see_whole_files, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_folder_make, scratch_make, scratch_remove),
        cmocka_unit_test(test_paths),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
