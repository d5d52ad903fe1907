#include "core/csv.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "core/number.h"
#include "core/text_internal.h"

enum {
    MAX_SIZE = 64 << 20,
    MAX_COLUMNS = 1024,
    MAX_ROWS = 1 << 22,
    MAX_CELLS = 1 << 24,
    FIRST_CAPACITY = 64
};

/* Cells are unquoted in place: the text only shrinks. `at` never passes the 0 at `end`. */
typedef struct reader {
    td_csv *csv;
    char *at, *end;
    size_t line;                    /* where `at` stands */
    size_t cells, cell_capacity;    /* of csv->cell */
    size_t row_count, row_capacity; /* of csv->line, the header among them */
    td_error *error;
} reader;

static td_status fail_at(const reader *r, size_t line, const char *what)
{
    return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: %s", r->csv->name, line, what);
}

static td_status out_of_memory(const reader *r)
{
    return td_fail(r->error, TD_ERROR_MEMORY, "%s: no memory for its cells", r->csv->name);
}

static bool is_blank(char c)
{
    return c == ' ' || c == '\t';
}

static bool is_line_end(char c)
{
    return c == '\n' || c == '\r';
}

/* Passes over LF, CRLF or CR. */
static void skip_line_end(reader *r)
{
    if (r->at == r->end) return;
    if (r->at[0] == '\r' && r->at[1] == '\n') r->at++;
    r->at++;
    r->line++;
}

/* To the beginning of the next row: over blank lines and comments. */
static void skip_idle_lines(reader *r)
{
    while (r->at < r->end) {
        char *p = r->at;
        if (*p == '#') {
            while (p < r->end && !is_line_end(*p)) p++;
        } else {
            while (is_blank(*p)) p++;
            if (p < r->end && !is_line_end(*p)) return;
        }
        r->at = p;
        skip_line_end(r);
    }
}

/* Doubles an array when it is full; false: out of memory. */
static bool make_room(void **array, size_t count, size_t *capacity, size_t size)
{
    if (count < *capacity) return true;
    size_t wanted = *capacity ? *capacity * 2 : FIRST_CAPACITY;
    void *larger = realloc(*array, wanted * size);
    if (!larger) return false;
    *array = larger;
    *capacity = wanted;
    return true;
}

static td_status add_cell(reader *r, char *cell)
{
    if (r->cells == MAX_CELLS) return fail_at(r, r->line, "the table is too large: more than 16777216 cells");
    void *array = r->csv->cell;
    if (!make_room(&array, r->cells, &r->cell_capacity, sizeof(char *))) return out_of_memory(r);
    r->csv->cell = array;
    r->csv->cell[r->cells++] = cell;
    return TD_OK;
}

static td_status add_row(reader *r)
{
    if (r->row_count > MAX_ROWS) return fail_at(r, r->line, "the table is too large: more than 4194304 rows");
    void *array = r->csv->line;
    if (!make_room(&array, r->row_count, &r->row_capacity, sizeof(size_t))) return out_of_memory(r);
    r->csv->line = array;
    r->csv->line[r->row_count++] = r->line;
    return TD_OK;
}

/* Unquotes a cell whose quote is at `at`; leaves `at` behind it and `stop` behind the text. */
static td_status read_quoted(reader *r, char **stop)
{
    const size_t first = r->line;
    char *out = r->at++;
    for (;;) {
        if (r->at == r->end) return fail_at(r, first, "a quote (\") is opened and never closed");
        char c = *r->at++;
        if (c == '"' && *r->at != '"') break;
        if (c == '"') r->at++;
        if (c == '\n' || (c == '\r' && *r->at != '\n')) r->line++;
        *out++ = c;
    }
    *stop = out;
    while (is_blank(*r->at)) r->at++;
    if (r->at < r->end && *r->at != ',' && !is_line_end(*r->at))
        return fail_at(r, r->line,
                       "text behind a closing quote (\"); a quote inside of a quoted cell is doubled");
    return TD_OK;
}

static td_status read_unquoted(reader *r, char **stop)
{
    char *begin = r->at;
    while (r->at < r->end && *r->at != ',' && !is_line_end(*r->at))
        if (*r->at++ == '"')
            return fail_at(r, r->line, "a quote (\") inside of a cell; put the whole cell in quotes");
    char *out = r->at;
    while (out > begin && is_blank(out[-1])) out--;
    *stop = out;
    return TD_OK;
}

/* Reads the cell at `at` and passes over the comma or line end behind it. *last: the row ends. */
static td_status read_cell(reader *r, bool *last)
{
    while (is_blank(*r->at)) r->at++;
    char *begin = r->at, *stop = NULL;
    TD_TRY(*begin == '"' ? read_quoted(r, &stop) : read_unquoted(r, &stop));
    *last = *r->at != ',';
    if (*last)
        skip_line_end(r);
    else
        r->at++;
    *stop = 0;
    return add_cell(r, begin);
}

static td_status read_row(reader *r)
{
    const size_t before = r->cells, line = r->line;
    TD_TRY(add_row(r));
    for (bool last = false; !last;) TD_TRY(read_cell(r, &last));
    const size_t count = r->cells - before, columns = r->csv->columns;
    char text[128];
    if (columns == 0 && count > MAX_COLUMNS) {
        snprintf(text, sizeof text, "the header has %zu columns; at most %d are accepted", count,
                 MAX_COLUMNS);
        return fail_at(r, line, text);
    }
    if (columns == 0)
        r->csv->columns = count;
    else if (count != columns) {
        snprintf(text, sizeof text, "the row has %zu cells, but the header has %zu", count, columns);
        return fail_at(r, line, text);
    }
    return TD_OK;
}

static td_status check_header(const reader *r)
{
    const td_csv *csv = r->csv;
    for (size_t i = 0; i < csv->columns; i++)
        for (size_t j = 0; j < i; j++) {
            char shown[TD_SHOWN_SIZE];
            if (csv->cell[i][0] == 0 || strcmp(csv->cell[i], csv->cell[j]) != 0) continue;
            return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: the column '%s' is given twice", csv->name,
                           csv->line[0], td_text_shown(shown, csv->cell[i]));
        }
    return TD_OK;
}

static td_status check_text(const reader *r, const char *text, size_t size)
{
    const size_t bad = td_utf8_check(text, size);
    if (bad == size) return TD_OK;
    size_t line = 1;
    for (size_t i = 0; i < bad; i++) line += text[i] == '\n';
    return fail_at(r, line, "is not UTF-8 text; save the table as CSV in UTF-8");
}

static td_status read_table(reader *r)
{
    skip_idle_lines(r);
    if (r->at == r->end)
        return td_fail(r->error, TD_ERROR_FORMAT,
                       "%s: is empty; a header line with the names of the columns is needed", r->csv->name);
    TD_TRY(read_row(r));
    TD_TRY(check_header(r));
    for (skip_idle_lines(r); r->at < r->end; skip_idle_lines(r)) TD_TRY(read_row(r));
    r->csv->rows = r->row_count - 1;
    return TD_OK;
}

td_status td_csv_parse(td_csv **csv, const char *text, size_t size, const char *name, td_error *error)
{
    if (size > MAX_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is larger than the %d bytes that are accepted", name,
                       MAX_SIZE);
    static const char mark[] = "\xEF\xBB\xBF";
    if (size >= 3 && !memcmp(text, mark, 3)) {
        text += 3;
        size -= 3;
    }
    td_csv *made = calloc(1, sizeof *made);
    if (made) made->name = strdup(name);
    if (made) made->text = malloc(size + 1);
    if (!made || !made->name || !made->text) {
        td_csv_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its %zu bytes", name, size);
    }
    if (size > 0) memcpy(made->text, text, size);
    made->text[size] = 0;
    reader r = {.csv = made, .at = made->text, .end = made->text + size, .line = 1, .error = error};
    td_status status = check_text(&r, made->text, size);
    if (status == TD_OK) status = read_table(&r);
    if (status == TD_OK)
        *csv = made;
    else
        td_csv_free(&made);
    return status;
}

td_status td_csv_read(td_csv **csv, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    TD_TRY(td_file_read(&text, &size, path, MAX_SIZE, error));
    td_status status = td_csv_parse(csv, text, size, path, error);
    free(text);
    return status;
}

void td_csv_free(td_csv **csv)
{
    if (!csv || !*csv) return;
    free((*csv)->name);
    free((*csv)->text);
    free((*csv)->cell);
    free((*csv)->line);
    free(*csv);
    *csv = NULL;
}

int td_csv_column(const td_csv *csv, const char *name)
{
    for (size_t i = 0; i < csv->columns; i++)
        if (!strcmp(csv->cell[i], name)) return (int)i;
    return -1;
}

const char *td_csv_cell(const td_csv *csv, size_t row, int column)
{
    return csv->cell[(row + 1) * csv->columns + (size_t)column];
}

td_status td_csv_fail(const td_csv *csv, size_t row, int column, td_error *error, const char *format, ...)
{
    if (!error) return TD_ERROR_FORMAT;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(error->message, sizeof error->message, format, arguments);
    va_end(arguments);
    char shown[TD_SHOWN_SIZE];
    return td_error_prefix(error, TD_ERROR_FORMAT, "%s:%zu: column %s", csv->name, csv->line[row + 1],
                           td_text_shown(shown, csv->cell[column]));
}

/* `needed`: "a number". */
static td_status wrong_cell(const td_csv *csv, size_t row, int column, const char *needed, td_error *error)
{
    char shown[TD_SHOWN_SIZE];
    const char *cell = td_csv_cell(csv, row, column);
    if (!*cell) return td_csv_fail(csv, row, column, error, "must be %s, but is empty", needed);
    return td_csv_fail(csv, row, column, error, "must be %s, but is '%s'", needed,
                       td_text_shown(shown, cell));
}

td_status td_csv_real(double *value, const td_csv *csv, size_t row, int column, double low, double high,
                      td_error *error)
{
    double number = 0;
    const char *cell = td_csv_cell(csv, row, column);
    if (!td_number_real(&number, cell)) return wrong_cell(csv, row, column, "a finite number", error);
    if (!(number >= low && number <= high)) {
        char l[TD_NUMBER_SIZE], h[TD_NUMBER_SIZE], shown[TD_SHOWN_SIZE];
        return td_csv_fail(csv, row, column, error, "is %s, but must lie between %s and %s",
                           td_text_shown(shown, cell), td_number_format(l, low, 0),
                           td_number_format(h, high, 0));
    }
    *value = number;
    return TD_OK;
}

td_status td_csv_int(int *value, const td_csv *csv, size_t row, int column, int low, int high,
                     td_error *error)
{
    long long number = 0;
    const char *cell = td_csv_cell(csv, row, column);
    if (td_number_parse(&number, NULL, cell) != TD_NUMBER_INTEGER)
        return wrong_cell(csv, row, column, "a whole number", error);
    if (number < low || number > high)
        return td_csv_fail(csv, row, column, error, "is %lld, but must lie between %d and %d", number, low,
                           high);
    *value = (int)number;
    return TD_OK;
}
