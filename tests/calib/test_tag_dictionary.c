/* Proves that a tag's cells stand as they are printed. References: the first codes of the families as Olson's
 * AprilTags list them, most significant bit at the upper left, row by row; OpenCV's marker 0 of DICT_4X4_50,
 * read off its own drawing. Exact. Blind to the other codes: they are libapriltag's and OpenCV's own. */
#include "calib/tag_dictionary.h"
#include "tests/check.h"

/* The code of a tag of border `border`, after checking that the border is dark. */
static uint64_t code(const char *dictionary, int border, int id)
{
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    td_error error = {0};
    int side = 0;
    uint64_t bits = 0;
    memset(cell, 7, sizeof cell);
    check_ok(td_tag_cells(cell, &side, dictionary, border, id, &error), error);
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            int c = cell[y * side + x];
            bool inside = x >= border && x < side - border && y >= border && y < side - border;
            assert_in_range(c, 0, inside);
            if (inside) bits = bits << 1 | (uint64_t)c;
        }
    return bits;
}

static void test_codes(void **state)
{
    (void)state;
    assert_true(code("tag36h11", 1, 0) == 0xd5d628584);
    assert_true(code("tag36h11", 2, 0) == 0xd5d628584);
    assert_true(code("tag36h11", 2, 1) == 0xd97f18b49);
    assert_true(code("tag25h9", 1, 0) == 0x155cbf1);
    assert_true(code("tag25h9", 1, 34) == 0xb991ce);
    assert_true(code("tag16h5", 1, 0) == 0x231b);
    assert_true(code("tag16h5", 1, 29) == 0xaf2e);
    assert_true(code("aruco4x4_50", 1, 0) == 0xb532);
}

static void test_all(void **state)
{
    (void)state;
    int count = 0;
    for (; td_tag_dictionary_name(count); count++) {
        const char *name = td_tag_dictionary_name(count);
        int tags = td_tag_count(name);
        assert_true(tags >= 30);
        assert_true(code(name, 1, tags - 1) != code(name, 1, 0));
    }
    assert_int_equal(count, 20);
    assert_int_equal(td_tag_count("tag36h11"), 587);
    assert_int_equal(td_tag_count("aruco_original"), 1024);
    assert_int_equal(td_tag_count("tag36h12"), 0);
    assert_null(td_tag_dictionary_name(-1));
}

static void test_refuses(void **state)
{
    (void)state;
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    td_error error = {0};
    int side = 0;
    check_fails(td_tag_cells(cell, &side, "tag36h12", 1, 0, &error), TD_ERROR_ARGUMENT, error,
                "dictionary: there is no 'tag36h12'; there are tag36h11");
    check_fails(td_tag_cells(cell, &side, "tag36h11", 3, 0, &error), TD_ERROR_ARGUMENT, error,
                "border: is 3 cells");
    check_fails(td_tag_cells(cell, &side, "tag36h11", 1, 587, &error), TD_ERROR_ARGUMENT, error,
                "id: is 587, but tag36h11 has the tags 0 to 586");
    check_fails(td_tag_cells(cell, &side, "aruco7x7_50", 1, -1, &error), TD_ERROR_ARGUMENT, error,
                "id: is -1");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_codes),
        cmocka_unit_test(test_all),
        cmocka_unit_test(test_refuses),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
