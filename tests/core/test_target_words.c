/* Proves: what a person types is the target that dataset.yaml would say; what cannot be understood is named.
 * Reference: the target written out field by field. */
#include "core/target_words.h"
#include "tests/check.h"

static void check_words(const char *words, int columns, int rows, double spacing)
{
    td_target t;
    td_error error;
    json_t *mapping = NULL;
    check_ok(td_target_from_words(&t, &mapping, words, &error), error);
    assert_int_equal(t.plane[0].columns, columns);
    assert_int_equal(t.plane[0].rows, rows);
    assert_true(t.plane[0].spacing_m == spacing);
    assert_string_equal(json_string_value(json_object_get(mapping, "kind")), td_target_kind_name(t.kind));
    json_decref(mapping);
}

static void chessboards_are_understood(void **state)
{
    (void)state;
    check_words("chessboard 9x6 25mm", 9, 6, 0.025);
    check_words("Chessboard, 9X6, 25 mm", 9, 6, 0.025);
    check_words("chessboard 2.5cm 9x6", 9, 6, 0.025);
    check_words("chessboard 0.1m 9x6", 9, 6, 0.1);
    check_words("chessboard 1in 9x6", 9, 6, 0.0254);
    check_words("{kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}", 9, 6, 0.025);
    check_words("  { \"kind\": \"chessboard\", \"columns\": 9, \"rows\": 6, \"spacing_m\": 0.025 }", 9, 6,
                0.025);
}

static void marks_are_understood(void **state)
{
    (void)state;
    td_target t;
    td_error error;
    check_words("marks 6x6 34mm diameter 18mm", 6, 6, 0.034);
    check_ok(td_target_from_words(&t, NULL, "marks 6x6 34mm diameter 18mm light", &error), error);
    assert_true(t.diameter_m == 0.018);
    assert_int_equal(t.polarity, TD_MARK_LIGHT);
}

static void what_is_not_understood_is_named(void **state)
{
    (void)state;
    static const struct {
        const char *words, *named;
    } bad[] = {{"", "nothing is given"},
               {"   ", "nothing is given"},
               {"board 9x6 25mm", "'board' is not a kind"},
               {"chessboard", "columns"},
               {"chessboard 9x6", "spacing_m"},
               {"chessboard 9x6 25", "'25' is not understood"},
               {"chessboard 9by6 25mm", "'9by6' is not understood"},
               {"chessboard 9x6 25mm diameter 3mm", "diameter_m"},
               {"marks 6x6 34mm diameter", "'' is not a mark's diameter"},
               {"marks 6x6 34mm diameter wide", "'wide' is not a mark's diameter"},
               {"chessboard 2x6 25mm", "columns"},
               {"chessboard 9x6 25mm kalibr", "'kalibr' is not understood"},
               {"chessboard 9999999x6 25mm", "'9999999x6' is not understood"},
               {"{kind: chessboard", "target"},
               {"{kind: chessboard, columns: 9}", "rows"},
               {"chessboard \x01\x02 9x6", "is not understood"}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_target t;
        td_error error = {0};
        json_t *mapping = NULL;
        check_fails(td_target_from_words(&t, &mapping, bad[i].words, &error), error.status, error,
                    bad[i].named);
        assert_true(error.status != TD_OK);
        assert_null(mapping);
    }
    char many[4096] = "tags";
    while (strlen(many) < 4000) strcat(many, " 7");
    td_target t;
    td_error error;
    check_fails(td_target_from_words(&t, NULL, many, &error), TD_ERROR_ARGUMENT, error, "too long");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(chessboards_are_understood),
        cmocka_unit_test(marks_are_understood),
        cmocka_unit_test(what_is_not_understood_is_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
