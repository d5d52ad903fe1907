/* Proves that every code has a text of its own, and that messages are filled, prefixed and cut without
 * touching what lies beside them. Reference: the list in the header. Blind to the quality of the sentences.
 */
#include "core/status.h"
#include "tests/check.h"

static void test_every_code_has_its_text(void **state)
{
    (void)state;
    for (int i = 0; i < TD_STATUS_COUNT; i++) {
        const char *text = td_status_text((td_status)i);
        assert_true(strlen(text) > 3);
        assert_string_not_equal(text, "unknown status");
        for (int k = 0; k < i; k++) assert_string_not_equal(text, td_status_text((td_status)k));
    }
    assert_int_equal(TD_OK, 0);
    assert_string_equal(td_status_text(TD_OK), "success");
    const int none[] = {-1, TD_STATUS_COUNT, TD_STATUS_COUNT + 1, 1000000};
    for (int i = 0; i < 4; i++) assert_string_equal(td_status_text((td_status)none[i]), "unknown status");
}

static void test_fail(void **state)
{
    (void)state;
    td_error error = {TD_OK, "old"};
    assert_int_equal(td_fail(&error, TD_ERROR_DATA, "%s: %d views, 100%%", "left", 2), TD_ERROR_DATA);
    assert_int_equal(error.status, TD_ERROR_DATA);
    assert_string_equal(error.message, "left: 2 views, 100%");
    assert_int_equal(td_fail(NULL, TD_ERROR_IO, "%s", "nobody listens"), TD_ERROR_IO);
}

static void test_prefix(void **state)
{
    (void)state;
    td_error error = {0};
    (void)td_fail(&error, TD_ERROR_FORMAT, "fx: is missing");
    assert_int_equal(td_error_prefix(&error, TD_ERROR_FORMAT, "%s: camera %d", "rig.yaml", 3),
                     TD_ERROR_FORMAT);
    assert_int_equal(error.status, TD_ERROR_FORMAT);
    assert_string_equal(error.message, "rig.yaml: camera 3: fx: is missing");
    assert_int_equal(td_error_prefix(NULL, TD_ERROR_IO, "nobody"), TD_ERROR_IO);
}

/* Messages longer than their room are cut and ended; the bytes behind the error stay. */
static void test_long_messages_are_cut(void **state)
{
    (void)state;
    struct {
        td_error error;
        char behind[64];
    } box;
    enum { ROOM = sizeof box.error.message };
    char longer[3 * ROOM];
    memset(longer, 'x', sizeof longer - 1);
    longer[sizeof longer - 1] = 0;
    for (size_t length = ROOM - 40; length < 2 * ROOM; length += 7) {
        memset(&box, '#', sizeof box);
        (void)td_fail(&box.error, TD_ERROR_IO, "%s", longer + sizeof longer - 1 - length);
        assert_int_equal(strlen(box.error.message), length < ROOM ? length : ROOM - 1);
        (void)td_error_prefix(&box.error, TD_ERROR_IO, "where");
        assert_true(strncmp(box.error.message, "where: xxx", 10) == 0);
        assert_int_equal(strlen(box.error.message), length + 7 < ROOM ? length + 7 : ROOM - 1);
        (void)td_error_prefix(&box.error, TD_ERROR_IO, "%s", longer);
        assert_int_equal(strlen(box.error.message), ROOM - 1);
        for (size_t i = 0; i < sizeof box.behind; i++) assert_int_equal(box.behind[i], '#');
    }
}

static td_status tries(td_status first, int *reached)
{
    TD_TRY(first);
    *reached = 1;
    return TD_OK;
}

static void test_try(void **state)
{
    (void)state;
    int reached = 0;
    assert_int_equal(tries(TD_ERROR_CANCELLED, &reached), TD_ERROR_CANCELLED);
    assert_int_equal(reached, 0);
    assert_int_equal(tries(TD_OK, &reached), TD_OK);
    assert_int_equal(reached, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_code_has_its_text),
        cmocka_unit_test(test_fail),
        cmocka_unit_test(test_prefix),
        cmocka_unit_test(test_long_messages_are_cut),
        cmocka_unit_test(test_try),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
