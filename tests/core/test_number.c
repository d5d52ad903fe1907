/* Proves that numbers survive being written and read, bit for bit, over the whole range of doubles, that the
 * text is the shortest, and that what is no number by YAML's core schema is not taken for one. References:
 * the bits themselves; for what is a number, the table of YAML 1.2.2 section 10.3.2. No tolerances. The
 * locale test needs a locale with a decimal comma and is skipped where none is installed. Blind to platforms
 * whose strtod does not round correctly. */
#include <float.h>
#include <locale.h>

#include "core/number.h"
#include "core/random.h"
#include "tests/check.h"

static void check_round_trip(double value)
{
    char text[TD_NUMBER_SIZE];
    double back = -1;
    td_number_format(text, value, 0);
    assert_true(strchr(text, '.'));
    assert_int_equal(td_number_parse(NULL, &back, text), TD_NUMBER_REAL);
    if (memcmp(&back, &value, sizeof back) != 0) fail_msg("%a became %s, which is %a", value, text, back);
}

static void test_every_bit_survives(void **state)
{
    (void)state;
    const double special[] = {0.0,
                              -0.0,
                              1,
                              -1,
                              0.1,
                              1e22,
                              1e23,
                              DBL_MAX,
                              -DBL_MAX,
                              DBL_MIN,
                              5e-324,
                              -5e-324,
                              DBL_EPSILON,
                              1.0 / 3,
                              640.0,
                              1e15,
                              123456789012345678.0};
    for (size_t i = 0; i < sizeof special / sizeof *special; i++) check_round_trip(special[i]);
    td_random random = td_random_seed(20, 1);
    for (int i = 0; i < 200000; i++) {
        uint64_t bits = (uint64_t)td_random_u32(&random) << 32 | td_random_u32(&random);
        double value;
        memcpy(&value, &bits, sizeof value);
        if (isfinite(value)) check_round_trip(value);
        check_round_trip(td_random_normal(&random));
    }
}

static void test_text_is_short_and_has_a_point(void **state)
{
    (void)state;
    const struct {
        double value;
        int digits;
        const char *text;
    } row[] = {{0.1, 0, "0.1"},
               {0.3, 0, "0.3"},
               {1, 0, "1.0"},
               {-12, 0, "-12.0"},
               {-0.0, 0, "-0.0"},
               {1e-5, 0, "1.0e-05"},
               {1e22, 0, "1.0e+22"},
               {5e-324, 0, "5.0e-324"},
               {0.1 + 0.2, 0, "0.30000000000000004"},
               {1.0 / 3, 3, "0.333"},
               {1234567, 3, "1.23e+06"},
               {2, 5, "2.0"},
               {640, 1, "6.0e+02"},
               {NAN, 0, ".nan"},
               {INFINITY, 4, ".inf"},
               {-INFINITY, 0, "-.inf"},
               {DBL_MAX, 3, "1.7976931348623157e+308"},
               {0.1, 17, "0.10000000000000001"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char text[TD_NUMBER_SIZE];
        assert_string_equal(td_number_format(text, row[i].value, row[i].digits), row[i].text);
    }
}

static void test_what_is_a_number(void **state)
{
    (void)state;
    const char *const none[] = {"",      ".",     "-",   "+",   "e5",    "1e",   "1e+",
                                "1_000", "1,5",   " 1",  "1 ",  "0x",    "0o",   "0o8",
                                "0xg",   "-0x1F", "0b1", "nan", "inf",   ".inf", ".nan",
                                "1.2.3", "1e5.0", "--1", "1f",  "0x1p3", "1:30", "infinity"};
    for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
        double value = 7;
        if (td_number_parse(NULL, NULL, none[i]) != TD_NUMBER_NONE)
            fail_msg("'%s' was taken for a number", none[i]);
        assert_false(td_number_real(&value, none[i]));
        assert_true(value == 7);
    }
    const struct {
        const char *text;
        long long value;
    } integer[] = {{"0", 0},
                   {"-0", 0},
                   {"+12", 12},
                   {"012", 12},
                   {"0o14", 12},
                   {"0x1F", 31},
                   {"0xaB", 171},
                   {"9223372036854775807", INT64_MAX},
                   {"-9223372036854775808", INT64_MIN}};
    for (size_t i = 0; i < sizeof integer / sizeof *integer; i++) {
        long long value = -99;
        double real = -99;
        assert_int_equal(td_number_parse(&value, &real, integer[i].text), TD_NUMBER_INTEGER);
        assert_true(value == integer[i].value && real == -99);
        assert_true(td_number_real(&real, integer[i].text) && real == (double)value);
    }
    const struct {
        const char *text;
        double value;
    } real[] = {{"1.", 1},       {".5", 0.5},   {"-.5e1", -5},       {"1e3", 1000},
                {"+1E-2", 0.01}, {"1e-999", 0}, {"4.9e-324", 5e-324}};
    for (size_t i = 0; i < sizeof real / sizeof *real; i++) {
        double value = -99;
        assert_int_equal(td_number_parse(NULL, &value, real[i].text), TD_NUMBER_REAL);
        assert_true(value == real[i].value);
    }
    const char *const large[] = {"9223372036854775808", "-9223372036854775809", "0xFFFFFFFFFFFFFFFFF",
                                 "1e309", "-1e999"};
    for (size_t i = 0; i < sizeof large / sizeof *large; i++)
        assert_int_equal(td_number_parse(NULL, NULL, large[i]), TD_NUMBER_TOO_LARGE);
}

static void test_locale_does_not_matter(void **state)
{
    (void)state;
    const char *const comma[] = {"de_DE.UTF-8", "de_DE.utf8",  "fr_FR.UTF-8",
                                 "fr_FR.utf8",  "it_IT.UTF-8", "es_ES.UTF-8"};
    bool found = false;
    for (size_t i = 0; i < sizeof comma / sizeof *comma && !found; i++)
        found = setlocale(LC_ALL, comma[i]) != NULL;
    if (!found) {
        print_message("no locale with a decimal comma is installed\n");
        skip();
    }
    char text[TD_NUMBER_SIZE], own[TD_NUMBER_SIZE];
    double value = 0;
    td_number_format(text, 1.5, 0);
    assert_int_equal(td_number_parse(NULL, &value, "2.25"), TD_NUMBER_REAL);
    snprintf(own, sizeof own, "%.1f", 1.5);
    setlocale(LC_ALL, "C");
    assert_string_equal(own, "1,5"); /* the locale was in force, and is so again after each call */
    assert_string_equal(text, "1.5");
    assert_true(value == 2.25);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_bit_survives),
        cmocka_unit_test(test_text_is_short_and_has_a_point),
        cmocka_unit_test(test_what_is_a_number),
        cmocka_unit_test(test_locale_does_not_matter),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
