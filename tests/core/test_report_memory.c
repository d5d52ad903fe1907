/* The report when memory runs out, at each of its allocations in turn: nothing crashes or leaks (the
 * sanitizers look), td_report_write says so, no file appears, and with one allocation more than were ever
 * needed the file is written.
 *
 * The sources are compiled into this test with allocators that fail on command. Blind to: allocations inside
 * the JPEG encoder and the writing of files, which have tests of their own. */
#include "tests/check.h"

#include <stdbool.h>

#include "tests/scratch.h"

static long allocations_left;

static bool may_allocate(void)
{
    return allocations_left > 0 && allocations_left-- > 0;
}

static void *scarce_malloc(size_t size)
{
    return may_allocate() ? malloc(size) : NULL;
}

static void *scarce_calloc(size_t count, size_t size)
{
    return may_allocate() ? calloc(count, size) : NULL;
}

static void *scarce_realloc(void *old, size_t size)
{
    return may_allocate() ? realloc(old, size) : NULL;
}

#define malloc scarce_malloc
#define calloc scarce_calloc
#define realloc scarce_realloc
/* clang-format off */
#include "core/text.c"
#include "core/report.c"
#include "core/report_markup.c"
#include "core/report_style.c"
#include "core/report_series.c"
#include "core/report_plot.c"
#include "core/report_picture.c"
/* clang-format on */
#undef malloc
#undef calloc
#undef realloc

enum { MANY = 6000 };

static td_report *build(const td_image *image, const double *value)
{
    static const char *const columns[] = {"view", "RMS"};
    td_report *report = td_report_new("A title", "A subtitle");
    td_report_heading(report, "Heading");
    td_report_verdict(report, TD_TONE_GOOD, "Accepted", columns, 2);
    td_report_text(report, "A text of %d words.", 5);
    td_report_figures_begin(report);
    td_report_figure(report, "RMS", TD_TONE_GOOD, "%.2f px", 0.21);
    td_report_figures_end(report);
    td_report_table_begin(report, columns, 2);
    for (int i = 0; i < 200; i++) {
        td_report_cell(report, TD_TONE_PLAIN, "view %d", i);
        td_report_cell(report, TD_TONE_PLAIN, "%d", i);
        td_report_row_end(report);
    }
    td_report_table_end(report);
    td_series series[] = {{.shape = TD_SHAPE_LINE, .count = 50, .x = value, .y = value},
                          {.shape = TD_SHAPE_BAR, .count = 50, .x = value, .y = value},
                          {.count = MANY, .x = value, .y = value, .dx = value, .dy = value}};
    td_report_grid_begin(report, 2);
    td_report_plot(report, &(td_axes){.title = "plot", .x_label = "x"}, series, 3);
    td_report_picture(report, image, 20, "picture", series, 3);
    td_report_grid_end(report);
    return report;
}

static void test_every_allocation(void **state)
{
    td_error error = {0};
    td_image *image;
    double *value = calloc(MANY, sizeof *value);
    char *path = td_path_join(*state, "report.html");
    assert_true(value && path);
    for (int i = 0; i < MANY; i++) value[i] = i;
    check_ok(td_image_new(&image, 50, 40, 3, &error), error);
    long needed = 0;
    bool written = false;
    while (!written) {
        error = (td_error){0};
        allocations_left = needed;
        td_report *report = build(image, value);
        td_status status = td_report_write(report, path, &error);
        td_report_free(&report);
        assert_null(report);
        FILE *file = fopen(path, "rb");
        written = file != NULL;
        if (file) fclose(file);
        if (status != (written ? TD_OK : TD_ERROR_MEMORY))
            fail_msg("with %ld allocations: %s: %s", needed, td_status_text(status), error.message);
        if (!written && !strstr(error.message, "memory"))
            fail_msg("'%s' does not speak of memory", error.message);
        assert_true(++needed < 100000);
    }
    print_message("%ld allocations\n", needed - 1);
    assert_true(needed > 400); /* two cells a row at least: all that was asked for was tried */
    td_image_free(&image);
    free(value);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_every_allocation, scratch_make, scratch_remove)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
