/* Proves that tables are split as RFC 4180 says, with the liberties of core/csv.h, and that every refusal
 * names file, line and column. References: the RFC's own examples; for random tables, the cells that they
 * were written from. Blind to tables near the limits of memory. */
#include <stdbool.h>

#include "core/csv.h"
#include "core/random.h"
#include "tests/check.h"
#include "tests/scratch.h"

static td_csv *parse(const char *text)
{
    td_error error = {0};
    td_csv *csv = NULL;
    check_ok(td_csv_parse(&csv, text, strlen(text), "t.csv", &error), error);
    return csv;
}

/* Cells of the header and rows, "|" between, "/" behind each row. */
static void check_cells(const char *text, const char *expected)
{
    td_csv *csv = parse(text);
    char seen[1024] = "";
    for (size_t r = 0; r <= csv->rows; r++)
        for (size_t c = 0; c < csv->columns; c++) {
            strcat(seen, csv->cell[r * csv->columns + c]);
            strcat(seen, c + 1 < csv->columns ? "|" : "/");
        }
    assert_string_equal(seen, expected);
    td_csv_free(&csv);
    assert_null(csv);
}

static void check_refused(const char *text, const char *words)
{
    td_error error = {0};
    td_csv *csv = NULL;
    check_fails(td_csv_parse(&csv, text, strlen(text), "t.csv", &error), TD_ERROR_FORMAT, error, words);
    assert_null(csv);
    assert_int_equal(td_csv_parse(&csv, text, strlen(text), "t.csv", NULL), TD_ERROR_FORMAT);
}

static void test_splitting(void **state)
{
    (void)state;
    check_cells("aaa,bbb,ccc\r\nzzz,yyy,xxx\r\n", "aaa|bbb|ccc/zzz|yyy|xxx/");
    check_cells("aaa,bbb,ccc\nzzz,yyy,xxx", "aaa|bbb|ccc/zzz|yyy|xxx/");
    check_cells("\"aaa\",\"b \r\nbb\",\"ccc\"\r\nzzz,yyy,xxx", "aaa|b \r\nbb|ccc/zzz|yyy|xxx/");
    check_cells("\"aaa\",\"b\"\"bb\",\"c,c\"", "aaa|b\"bb|c,c/");
    check_cells("a,b\r1,2\r3,4\r", "a|b/1|2/3|4/");
    check_cells("\xEF\xBB\xBF"
                "a,b\n,\n\"\",\"\"\n1,\n,2",
                "a|b/|/|/1|/|2/");
    check_cells(" a , b\t\n  1 2  ,\" 3 \" \n", "a|b/1 2| 3 /");
    check_cells("# made by hand\n\na,b\n# one\n1,2\n   \n\r\n#two\n3,#4\n\n", "a|b/1|2/3|#4/");
    check_cells("a\n\"#no comment\"\n\"\"\n", "a/#no comment//");
    check_cells("a,\n1,2\n", "a|/1|2/");
    check_cells("a,,\n1,2,3\n", "a||/1|2|3/");
    check_cells("\"\"\"\"\n", "\"/");
    check_cells("a", "a/");
    check_cells("\"a\"", "a/");
}

static void test_refusals(void **state)
{
    (void)state;
    check_refused("", "t.csv: is empty; a header line");
    check_refused("\xEF\xBB\xBF", "is empty");
    check_refused("# only words\n\n", "is empty");
    check_refused("a,b\n1,2\n\n1\n", "t.csv:4: the row has 1 cells, but the header has 2");
    check_refused("a,b\n1,2,3\n", "t.csv:2: the row has 3 cells, but the header has 2");
    check_refused("a,b\n1,\"2\n\n3", "t.csv:2: a quote (\") is opened and never closed");
    check_refused("a,b\n\"1\" x,2\n", "t.csv:2: text behind a closing quote");
    check_refused("a,b\n\"x\ny\"z,2\n", "t.csv:3: text behind a closing quote");
    check_refused("a,b\n1\"2,3\n", "t.csv:2: a quote (\") inside of a cell");
    check_refused("a,b,a\n", "t.csv:1: the column 'a' is given twice");
    check_refused("a\nb\n\xfc"
                  "ber\n",
                  "t.csv:3: is not UTF-8 text");
    td_error error = {0};
    td_csv *csv = NULL;
    check_fails(td_csv_parse(&csv, "a\0b", 3, "t.csv", &error), TD_ERROR_FORMAT, error,
                "t.csv:1: is not UTF-8 text");
    char *wide = calloc(1, 1025);
    memset(wide, ',', 1024);
    check_refused(wide, "the header has 1025 columns; at most 1024");
    wide[1023] = 0;
    csv = parse(wide);
    assert_int_equal(csv->columns, 1024);
    td_csv_free(&csv);
    free(wide);
    csv = NULL;
    size_t size = (64 << 20) + 1;
    char *large = malloc(size);
    memset(large, '\n', size);
    check_fails(td_csv_parse(&csv, large, size, "t.csv", &error), TD_ERROR_FORMAT, error,
                "t.csv: is larger than");
    check_fails(td_csv_parse(&csv, large, size - 1, "t.csv", &error), TD_ERROR_FORMAT, error,
                "t.csv: is empty");
    for (size_t i = 0; i < size; i += 2) large[i] = 'a';
    check_fails(td_csv_parse(&csv, large, size - 1, "t.csv", &error), TD_ERROR_FORMAT, error,
                "more than 4194304 rows");
    free(large);
    assert_null(csv);
}

static void test_numbers(void **state)
{
    (void)state;
    td_error error = {0};
    td_csv *csv = parse("frame,time_s,n\n# …\na,1.5,7\nb,x,1.5\nc,,\nd,1e9,300\ne,nan,-\n");
    const int t = td_csv_column(csv, "time_s"), n = td_csv_column(csv, "n");
    assert_int_equal(t, 1);
    assert_int_equal(n, 2);
    assert_int_equal(td_csv_column(csv, "time"), -1);
    assert_int_equal(csv->rows, 5);
    assert_string_equal(td_csv_cell(csv, 3, 0), "d");
    double real = -7;
    int integer = -7;
    check_fails(td_csv_real(&real, csv, 1, t, 0, 10, &error), TD_ERROR_FORMAT, error,
                "t.csv:4: column time_s: must be a finite number, but is 'x'");
    check_fails(td_csv_real(&real, csv, 2, t, 0, 10, &error), TD_ERROR_FORMAT, error,
                "t.csv:5: column time_s: must be a finite number, but is empty");
    check_fails(td_csv_real(&real, csv, 3, t, 0, 10, &error), TD_ERROR_FORMAT, error,
                "is 1e9, but must lie between 0.0 and 10.0");
    check_fails(td_csv_real(&real, csv, 4, t, 0, 10, &error), TD_ERROR_FORMAT, error,
                "t.csv:7: column time_s: must be a finite number, but is 'nan'");
    check_fails(td_csv_int(&integer, csv, 1, n, 0, 10, &error), TD_ERROR_FORMAT, error,
                "t.csv:4: column n: must be a whole number, but is '1.5'");
    check_fails(td_csv_int(&integer, csv, 2, n, 0, 10, &error), TD_ERROR_FORMAT, error, "but is empty");
    check_fails(td_csv_int(&integer, csv, 3, n, 0, 10, &error), TD_ERROR_FORMAT, error,
                "is 300, but must lie between 0 and 10");
    check_fails(td_csv_fail(csv, 0, 0, &error, "%d legs", 3), TD_ERROR_FORMAT, error,
                "t.csv:3: column frame: 3 legs");
    assert_true(real == -7 && integer == -7);
    check_ok(td_csv_real(&real, csv, 0, t, 1.5, 1.5, &error), error);
    check_ok(td_csv_int(&integer, csv, 0, n, 7, 7, &error), error);
    assert_true(real == 1.5 && integer == 7);
    td_csv_free(&csv);
    td_csv_free(NULL);
}

static void test_lines(void **state)
{
    (void)state;
    td_csv *csv = parse("# head\r\n\r\na,b\r\n\"1\r\n2\",3\n\"\n\",4\r5,6\n\"\r\",7\n8,9");
    const size_t line[] = {3, 4, 6, 8, 9, 11};
    assert_int_equal(csv->rows, 5);
    for (size_t i = 0; i < 6; i++) assert_int_equal(csv->line[i], line[i]);
    td_csv_free(&csv);
}

/* Random cells, quoted where they must be and sometimes where not, come back. */
static void test_random_tables_come_back(void **state)
{
    (void)state;
    static const char letter[] = "ab 1,\"\n\r\t#'.";
    td_random random = td_random_seed(11, 3);
    for (int round = 0; round < 2000; round++) {
        const size_t columns = 1 + td_random_below(&random, 4), rows = td_random_below(&random, 5);
        char text[2048] = "", cell[64][8];
        size_t used = 0;
        for (size_t i = 0; i < (rows + 1) * columns; i++) {
            size_t length = td_random_below(&random, 7);
            for (size_t k = 0; k < length; k++)
                cell[i][k] = letter[td_random_below(&random, sizeof letter - 1)];
            cell[i][length] = 0;
            if (i < columns) snprintf(cell[i], 8, "c%zu", i);
            bool quoted = i >= columns &&
                          (columns == 1 || td_random_below(&random, 2) || strpbrk(cell[i], ",\"\n\r #\t"));
            if (quoted) text[used++] = '"';
            for (const char *c = cell[i]; *c; c++) {
                if (*c == '"') text[used++] = '"';
                text[used++] = *c;
            }
            if (quoted) text[used++] = '"';
            bool last = i % columns == columns - 1;
            if (last && td_random_below(&random, 2)) text[used++] = '\r';
            text[used++] = last ? '\n' : ',';
        }
        td_csv *csv = parse(text);
        assert_int_equal(csv->rows, rows);
        assert_int_equal(csv->columns, columns);
        for (size_t i = 0; i < (rows + 1) * columns; i++) assert_string_equal(csv->cell[i], cell[i]);
        td_csv_free(&csv);
    }
}

static void test_file(void **state)
{
    td_error error = {0};
    td_csv *csv = NULL;
    char *path = td_path_join(*state, "frames.csv");
    check_fails(td_csv_read(&csv, path, &error), TD_ERROR_IO, error, path);
    check_ok(td_file_write(path, "a,b\n1\n", 6, &error), error);
    check_fails(td_csv_read(&csv, path, &error), TD_ERROR_FORMAT, error, "frames.csv:2: the row has 1 cells");
    check_ok(td_file_write(path, "a,b\n1,2\n", 8, &error), error);
    check_ok(td_csv_read(&csv, path, &error), error);
    assert_int_equal(csv->rows, 1);
    td_csv_free(&csv);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_splitting),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_numbers),
        cmocka_unit_test(test_lines),
        cmocka_unit_test(test_random_tables_come_back),
        cmocka_unit_test_setup_teardown(test_file, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
