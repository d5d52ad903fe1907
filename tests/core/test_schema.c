/* Proves that a tree which follows its schema passes and that every single departure from it is refused with
 * its path: each type by each other type, unknown keys, missing keys, nulls, elements. Reference: the rules
 * of core/schema.h, written out by hand for one table. Blind to tables that contradict themselves. */
#include <stdbool.h>

#include "core/document.h"
#include "core/schema.h"
#include "tests/check.h"

static const td_schema_row table[] = {
    {"name", TD_SCHEMA_STRING, true, false, "of the dataset"},
    {"count", TD_SCHEMA_INT, false, false, "views"},
    {"good", TD_SCHEMA_BOOL, false, false, "accepted"},
    {"rms_px", TD_SCHEMA_REAL, false, true, "px"},
    {"size_m", TD_SCHEMA_REAL, false, false, "m"},
    {"words", TD_SCHEMA_STRINGS, false, false, "reasons"},
    {"sigma", TD_SCHEMA_REALS, false, false, "in order"},
    {"loose", TD_SCHEMA_REALS, false, true, "in order, if known"},
    {"matrix", TD_SCHEMA_MATRIX, false, false, "covariance"},
    {"gaps", TD_SCHEMA_MATRIX, false, true, "covariance, if known"},
    {"cameras", TD_SCHEMA_OBJECT, false, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, "one camera"},
    {"cameras.*.rms_px", TD_SCHEMA_REAL, true, false, "of the camera"},
    {"cameras.*.note", TD_SCHEMA_STRING, false, false, "about it"},
    {"cameras.spare", TD_SCHEMA_STRING, false, false, "where it is kept"},
    {"views", TD_SCHEMA_ARRAY, false, false, "one by one"},
    {"views[].name", TD_SCHEMA_STRING, true, false, "of the view"},
    {"views[].per", TD_SCHEMA_OBJECT, false, true, "by camera"},
    {"views[].per.*", TD_SCHEMA_ARRAY, false, false, "of the camera"},
    {"views[].per.*[].x", TD_SCHEMA_REAL, true, false, "px"},
};
enum { ROWS = sizeof table / sizeof *table };

static td_status check(const char *text, td_error *error)
{
    json_error_t why;
    json_t *root = json_loads(text, JSON_DECODE_ANY, &why);
    if (!root) fail_msg("%s: %s", why.text, text);
    td_status status = td_schema_check(root, table, ROWS, error);
    assert_int_equal(td_schema_check(root, table, ROWS, NULL), status);
    json_decref(root);
    return status;
}

static void test_what_passes(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const text[] = {
        "{\"name\": \"a\"}",
        "{\"name\": \"a\", \"count\": 3, \"good\": false, \"rms_px\": null, \"size_m\": 2, \"words\": [], "
        "\"sigma\": [1, 2.5]}",
        "{\"name\": \"a\", \"rms_px\": 0.5, \"words\": [\"x\"], \"loose\": [1, null], \"matrix\": [[1, 2], "
        "[3, 4.5]], \"gaps\": [[null]]}",
        "{\"name\": \"a\", \"loose\": null, \"gaps\": null, \"matrix\": [], \"sigma\": []}",
        "{\"name\": \"a\", \"cameras\": {\"left\": {\"rms_px\": 1}, \"r.[]*\": {\"rms_px\": 2, \"note\": "
        "\"\"}, \"spare\": \"shelf\"}}",
        "{\"name\": \"a\", \"views\": []}",
        "{\"name\": \"a\", \"views\": [{\"name\": \"1\"}, {\"name\": \"2\", \"per\": {\"left\": [{\"x\": 1}, "
        "{\"x\": 2}], \"right\": []}}]}",
        "{\"name\": \"a\", \"views\": [{\"name\": \"1\", \"per\": null}]}"};
    for (size_t i = 0; i < sizeof text / sizeof *text; i++) check_ok(check(text[i], &error), error);
}

static void test_what_is_refused(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const row[][2] = {
        {"{}", "result: name: is missing (of the dataset)"},
        {"[]", "result: must be a mapping"},
        {"null", "result: must be a mapping"},
        {"{\"name\": null}", "result: name: must be a text (of the dataset)"},
        {"{\"name\": \"a\", \"other\": 1}", "result: other: is not in the schema"},
        {"{\"name\": \"a\", \"size_m\": null}", "size_m: must be a number (m)"},
        {"{\"name\": \"a\", \"cameras\": {}}", "result: cameras: is empty"},
        {"{\"name\": \"a\", \"cameras\": {\"left\": {}}}",
         "result: cameras.left.rms_px: is missing (of the camera)"},
        {"{\"name\": \"a\", \"cameras\": {\"left\": {\"rms_px\": \"1\"}}}",
         "cameras.left.rms_px: must be a number"},
        {"{\"name\": \"a\", \"cameras\": {\"left\": {\"rms_px\": 1, \"sharp\": 1}}}",
         "cameras.left.sharp: is not in the schema"},
        {"{\"name\": \"a\", \"cameras\": {\"left\": 1}}", "cameras.left: must be a mapping (one camera)"},
        {"{\"name\": \"a\", \"cameras\": {\"spare\": {\"rms_px\": 1}}}",
         "cameras.spare: must be a text (where it is kept)"},
        {"{\"name\": \"a\", \"cameras.left\": {\"rms_px\": 1}}", "is not in the schema"},
        {"{\"name\": \"a\", \"views\": [1]}", "views: must be a list of mappings"},
        {"{\"name\": \"a\", \"views\": [{\"name\": \"1\"}, {}]}", "result: views[1].name: is missing"},
        {"{\"name\": \"a\", \"views\": [{\"name\": 1}]}", "views[0].name: must be a text"},
        {"{\"name\": \"a\", \"views\": [{\"name\": \"1\", \"x\": 1}]}", "views[0].x: is not in the schema"},
        {"{\"name\": \"a\", \"views\": [{\"name\": \"1\", \"per\": {\"left\": [{\"x\": 1}, {\"x\": "
         "\"\"}]}}]}",
         "views[0].per.left[1].x: must be a number"},
        {"{\"name\": \"a\", \"views\": [{\"name\": \"1\", \"per\": {\"left\": [{}]}}]}",
         "views[0].per.left[0].x: is missing"},
        {"{\"name\": \"a\", \"views\": {\"[0]\": {\"name\": \"1\"}}}", "views: must be a list of mappings"},
        {"{\"name\": \"a\", \"sigma\": [1, null]}", "sigma: must be a list of numbers"},
        {"{\"name\": \"a\", \"loose\": [1, \"2\"]}", "loose: must be a list of numbers or null"},
        {"{\"name\": \"a\", \"matrix\": [[1, 2], [3]]}", "matrix: must be a matrix"},
        {"{\"name\": \"a\", \"matrix\": [[1, null]]}", "matrix: must be a matrix"},
        {"{\"name\": \"a\", \"matrix\": [1]}", "matrix: must be a matrix"},
        {"{\"name\": \"a\", \"gaps\": [[1, true]]}", "gaps: must be a matrix or null"},
        {"{\"name\": \"a\", \"words\": [\"a\", 1]}", "words: must be a list of texts"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        check_fails(check(row[i][0], &error), TD_ERROR_FORMAT, error, row[i][1]);
}

/* Each type accepts exactly those of these values that it should. */
static void test_every_type_by_every_value(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const value[] = {"{}",    "[{}]",    "\"a\"", "[\"a\"]", "1.5",
                                 "[1.5]", "[[1.5]]", "1",     "true",    "null"};
    const char *const accepted[TD_SCHEMA_TYPE_COUNT] = {
        [TD_SCHEMA_OBJECT] = "1000000000", [TD_SCHEMA_ARRAY] = "0100000000",
        [TD_SCHEMA_STRING] = "0010000000", [TD_SCHEMA_STRINGS] = "0001000000",
        [TD_SCHEMA_REAL] = "0000100100",   [TD_SCHEMA_REALS] = "0000010000",
        [TD_SCHEMA_MATRIX] = "0000001000", [TD_SCHEMA_INT] = "0000000100",
        [TD_SCHEMA_BOOL] = "0000000010"};
    for (int type = 0; type < TD_SCHEMA_TYPE_COUNT; type++)
        for (size_t v = 0; v < sizeof value / sizeof *value; v++)
            for (int nullable = 0; nullable < 2; nullable++) {
                const td_schema_row row = {"x", (td_schema_type)type, false, nullable, "x"};
                char text[32];
                snprintf(text, sizeof text, "{\"x\": %s}", value[v]);
                json_t *root = json_loads(text, 0, NULL);
                bool good = accepted[type][v] == '1' || (nullable && !strcmp(value[v], "null"));
                if (good)
                    check_ok(td_schema_check(root, &row, 1, &error), error);
                else
                    check_fails(td_schema_check(root, &row, 1, &error), TD_ERROR_FORMAT, error,
                                "result: x: must be a ");
                json_decref(root);
            }
}

static void test_describe(void **state)
{
    (void)state;
    char *text = td_schema_describe(table, 4);
    assert_string_equal(text, "name    text                      of the dataset\n"
                              "count   whole number, optional    views\n"
                              "good    true or false, optional   accepted\n"
                              "rms_px  number or null, optional  px\n");
    free(text);
    text = td_schema_describe(table, 0);
    assert_string_equal(text, "");
    free(text);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_what_passes),
        cmocka_unit_test(test_what_is_refused),
        cmocka_unit_test(test_every_type_by_every_value),
        cmocka_unit_test(test_describe),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
