/* The report as a document: what is open, what has failed, and the elements around plots and pictures. */
#include "core/report.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "core/report_internal.h"

enum {
    MAX_GRID_COLUMNS = 6,
    CONTENTS_FROM = 4, /* headings: below, a list of contents only stands in the way */
    SORT_FROM = 4,     /* rows */
};

static const char *const tone_class[] = {"plain", "good", "warn", "bad"};

static const char *class_of(td_tone tone)
{
    return tone > TD_TONE_PLAIN && tone <= TD_TONE_BAD ? tone_class[tone] : tone_class[TD_TONE_PLAIN];
}

td_report *td_report_new(const char *title, const char *subtitle)
{
    td_report *report = calloc(1, sizeof *report);
    if (!report) return NULL;
    report->grid_columns = 1;
    td_markup_text(&report->title, title && *title ? title : "Report");
    td_markup_text(&report->subtitle, subtitle);
    if (report->title.failed || report->subtitle.failed) td_report_free(&report);
    return report;
}

void td_report_free(td_report **report)
{
    if (!report || !*report) return;
    free((*report)->title.data);
    free((*report)->subtitle.data);
    free((*report)->contents.data);
    free((*report)->body.data);
    free((*report)->cells.data);
    free(*report);
    *report = NULL;
}

void td_report_fail(td_report *report, td_status status, const char *format, ...)
{
    if (report->first.status != TD_OK) return;
    report->first.status = status;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(report->first.message, sizeof report->first.message, format, arguments);
    va_end(arguments);
}

/* Whether the report still grows; keeps the failure of the memory when that is why not. */
static bool is_growing(td_report *report)
{
    if (report->body.failed || report->cells.failed || report->contents.failed)
        td_report_fail(report, TD_ERROR_MEMORY, "out of memory");
    return report->first.status == TD_OK;
}

static const char *const place_name[] = {"the body", "a row of figures", "a table", "a grid"};
static const char *const place_end[] = {"", "td_report_figures_end", "td_report_table_end",
                                        "td_report_grid_end"};

/* Whether `what` may come now: nothing has failed, and the report is at the one place where it belongs. */
static bool is_at(td_report *report, td_report_place place, const char *what)
{
    if (!report || !is_growing(report)) return false;
    if (report->place == place) return true;
    if (report->place == TD_PLACE_BODY)
        td_report_fail(report, TD_ERROR_ARGUMENT, "%s is given outside %s", what, place_name[place]);
    else
        td_report_fail(report, TD_ERROR_ARGUMENT, "%s is given inside %s; call %s first", what,
                       place_name[report->place], place_end[report->place]);
    return false;
}

bool td_report_takes_figure(td_report *report, const char *what)
{
    bool in_grid = report && report->place == TD_PLACE_GRID;
    return is_at(report, in_grid ? TD_PLACE_GRID : TD_PLACE_BODY, what);
}

/* A text formatted on the heap; NULL, with the failure kept, when that does not work. */
static TD_PRINTF(2, 0) char *format_text(td_report *report, const char *format, va_list arguments)
{
    va_list again;
    va_copy(again, arguments);
    int length = vsnprintf(NULL, 0, format, arguments);
    char *text = length < 0 ? NULL : malloc((size_t)length + 1);
    if (text) vsnprintf(text, (size_t)length + 1, format, again);
    va_end(again);
    if (length < 0)
        td_report_fail(report, TD_ERROR_ARGUMENT, "a text cannot be formatted by '%s'", format);
    else if (!text)
        td_report_fail(report, TD_ERROR_MEMORY, "out of memory");
    return text;
}

void td_report_heading(td_report *report, const char *text)
{
    if (!is_at(report, TD_PLACE_BODY, "a heading")) return;
    report->headings++;
    td_text_format(&report->contents, "<li><a href=\"#s%zu\">", report->headings);
    td_markup_text(&report->contents, text);
    td_markup_raw(&report->contents, "</a></li>");
    td_text_format(&report->body, "<h2 id=\"s%zu\">", report->headings);
    td_markup_text(&report->body, text);
    td_markup_raw(&report->body, "</h2>\n");
}

void td_report_text(td_report *report, const char *format, ...)
{
    if (!is_at(report, TD_PLACE_BODY, "a text")) return;
    va_list arguments;
    va_start(arguments, format);
    char *text = format_text(report, format, arguments);
    va_end(arguments);
    td_markup_raw(&report->body, "<p class=\"text\">");
    td_markup_text(&report->body, text);
    td_markup_raw(&report->body, "</p>\n");
    free(text);
}

void td_report_verdict(td_report *report, td_tone tone, const char *word, const char *const *sentence,
                       size_t count)
{
    if (!is_at(report, TD_PLACE_BODY, "a verdict")) return;
    if (count && !sentence) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "a verdict of %zu sentences is given none", count);
        return;
    }
    td_text *m = &report->body;
    td_text_format(m, "<div class=\"verdict %s\">\n<p class=\"word\">", class_of(tone));
    td_markup_text(m, word);
    td_markup_raw(m, count > 1 ? "</p>\n<ul>" : "</p>\n");
    for (size_t i = 0; i < count; i++) {
        td_markup_raw(m, count > 1 ? "<li>" : "<p>");
        td_markup_text(m, sentence[i]);
        td_markup_raw(m, count > 1 ? "</li>" : "</p>");
    }
    td_markup_raw(m, count > 1 ? "</ul>\n</div>\n" : "</div>\n");
}

static bool is_word_character(char c)
{
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' ||
           c == '.' || (unsigned char)c >= 0x80;
}

/* How a value that is not finite, as printf spells it at `text`, is shown; NULL: there is none. */
static const char *non_finite(const char *text, size_t *length)
{
    static const struct {
        const char *printed, *shown;
    } words[] = {{"nan", "–"}, {"-nan", "–"}, {"inf", "∞"}, {"-inf", "−∞"}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        *length = strlen(words[i].printed);
        if (!strncmp(text, words[i].printed, *length) && !is_word_character(text[*length]))
            return words[i].shown;
    }
    return NULL;
}

/* The text of a cell or figure: as given, but "nan" and "inf" as a reader expects them. */
static void add_value(td_text *m, const char *text)
{
    td_text part = {0};
    for (const char *at = text; at && *at;) {
        size_t length;
        const char *shown = at == text || !is_word_character(at[-1]) ? non_finite(at, &length) : NULL;
        td_text_add(&part, shown ? shown : at, shown ? strlen(shown) : 1);
        at += shown ? length : 1;
    }
    td_markup_text(m, part.data);
    if (part.failed) m->failed = true;
    free(part.data);
}

void td_report_figures_begin(td_report *report)
{
    if (!is_at(report, TD_PLACE_BODY, "a row of figures")) return;
    report->place = TD_PLACE_FIGURES;
    td_markup_raw(&report->body, "<dl class=\"figures\">\n");
}

void td_report_figure(td_report *report, const char *label, td_tone tone, const char *format, ...)
{
    if (!is_at(report, TD_PLACE_FIGURES, "a figure")) return;
    va_list arguments;
    va_start(arguments, format);
    char *text = format_text(report, format, arguments);
    va_end(arguments);
    td_text_format(&report->body, "<div class=\"%s\"><dt>", class_of(tone));
    td_markup_text(&report->body, label);
    td_markup_raw(&report->body, "</dt><dd>");
    add_value(&report->body, text);
    td_markup_raw(&report->body, "</dd></div>\n");
    free(text);
}

void td_report_figures_end(td_report *report)
{
    if (!is_at(report, TD_PLACE_FIGURES, "the end of a row of figures")) return;
    report->place = TD_PLACE_BODY;
    td_markup_raw(&report->body, "</dl>\n");
}

/* A cell is kept until the table ends, for only then is it known which columns hold numbers. */
static void keep_cell(td_report *report, td_tone tone, const char *text)
{
    char mark = (char)('0' + (tone > TD_TONE_PLAIN && tone <= TD_TONE_BAD ? (int)tone : 0));
    td_text_add(&report->cells, &mark, 1);
    if (text) td_text_add(&report->cells, text, strlen(text));
    td_text_add(&report->cells, "", 1);
}

void td_report_table_begin(td_report *report, const char *const *columns, size_t count)
{
    if (!is_at(report, TD_PLACE_BODY, "a table")) return;
    if (!columns || !count) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "a table is given no columns");
        return;
    }
    report->place = TD_PLACE_TABLE;
    report->columns = count;
    report->column = report->rows = report->cells.size = 0;
    for (size_t i = 0; i < count; i++) keep_cell(report, TD_TONE_PLAIN, columns[i]);
}

void td_report_cell(td_report *report, td_tone tone, const char *format, ...)
{
    if (!is_at(report, TD_PLACE_TABLE, "a cell")) return;
    if (report->column == report->columns) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "row %zu of a table has more cells than its %zu columns",
                       report->rows + 1, report->columns);
        return;
    }
    va_list arguments;
    va_start(arguments, format);
    char *text = format_text(report, format, arguments);
    va_end(arguments);
    keep_cell(report, tone, text);
    report->column++;
    free(text);
}

void td_report_row_end(td_report *report)
{
    if (!is_at(report, TD_PLACE_TABLE, "the end of a row")) return;
    if (report->column != report->columns)
        td_report_fail(report, TD_ERROR_ARGUMENT, "row %zu of a table has %zu cells for its %zu columns",
                       report->rows + 1, report->column, report->columns);
    report->column = 0;
    report->rows++;
}

typedef enum cell_kind { CELL_NEUTRAL, CELL_NUMBER, CELL_WORDS } cell_kind;

/* Behind a number: whether more of the same follows ("0.2 ± 0.1", "3/12", "640×480"), where it begins in
 * *rest. */
static bool is_joined(const char **rest)
{
    static const char *const joiner[] = {" ± ", "±", " / ", "/", " × ", "×", " – ", "–"};
    for (size_t i = 0; i < sizeof joiner / sizeof *joiner; i++) {
        size_t length = strlen(joiner[i]);
        if (strncmp(*rest, joiner[i], length) != 0) continue;
        *rest += length;
        return true;
    }
    return false;
}

/* A number, or several joined, with a unit behind a blank at most: "3", "−1.5e-3", "0.21 px", "98 %". Names
 * that begin with a digit ("01.jpg", "3rd view") are words. */
static cell_kind kind_of(const char *text)
{
    static const char *const neutral[] = {"", "-", "–", "—", "nan", "-nan"};
    for (size_t i = 0; i < sizeof neutral / sizeof *neutral; i++)
        if (!strcmp(text, neutral[i])) return CELL_NEUTRAL;
    do {
        static const char *const sign[] = {"−", "±", "-", "+", "<", ">", "~", "≈", "≤", "≥", " "};
        for (size_t i = 0; i < sizeof sign / sizeof *sign; i++)
            while (!strncmp(text, sign[i], strlen(sign[i]))) text += strlen(sign[i]);
        size_t length = !strncmp(text, "inf", 3) ? 3 : strspn(text, "0123456789.");
        if (length == 0 || (length == 1 && *text == '.')) return CELL_WORDS;
        text += length;
        const char *power = text + 1 + (*text && (text[1] == '-' || text[1] == '+'));
        if ((*text == 'e' || *text == 'E') && strspn(power, "0123456789"))
            text = power + strspn(power, "0123456789");
    } while (is_joined(&text));
    if (!strcmp(text, "%") || !strcmp(text, "°") || !*text) return CELL_NUMBER;
    return *text == ' ' && !strchr(text + 1, ' ') && td_markup_length(text) <= 6 ? CELL_NUMBER : CELL_WORDS;
}

/* A column is one of numbers when at least half of its cells that hold anything are numbers. */
static bool *number_columns(const td_report *report)
{
    size_t *numbers = calloc(report->columns, 2 * sizeof *numbers), *words = numbers + report->columns;
    bool *result = calloc(report->columns, sizeof *result);
    if (numbers && result) {
        const char *cell = report->cells.data;
        for (size_t i = 0; i < (report->rows + 1) * report->columns; i++, cell += strlen(cell) + 1) {
            cell_kind kind = i < report->columns ? CELL_NEUTRAL : kind_of(cell + 1);
            numbers[i % report->columns] += kind == CELL_NUMBER;
            words[i % report->columns] += kind == CELL_WORDS;
        }
        for (size_t i = 0; i < report->columns; i++) result[i] = numbers[i] && numbers[i] >= words[i];
    }
    bool failed = !numbers || !result;
    free(numbers);
    if (!failed) return result;
    free(result);
    return NULL;
}

/* The first cell of a row is its head. */
static void add_cell(td_text *m, const char *cell, bool number, bool row_head)
{
    int tone = *cell - '0';
    td_markup_raw(m, row_head ? "<th scope=\"row\"" : "<td");
    const char *shape = number ? "n" : !row_head && strlen(cell + 1) > 32 ? "text-cell" : "";
    if (*shape || tone)
        td_text_format(m, " class=\"%s%s%s\"", shape, *shape && tone ? " " : "",
                       tone ? tone_class[tone] : "");
    td_markup_raw(m, ">");
    add_value(m, cell + 1);
    td_markup_raw(m, row_head ? "</th>" : "</td>");
}

static void add_table(td_report *report, const bool *is_number)
{
    td_text *m = &report->body;
    const char *cell = report->cells.data;
    bool sortable = report->rows >= SORT_FROM;
    td_text_format(m, "<div class=\"scroll\" tabindex=\"0\"><table%s>\n<thead><tr>",
                   sortable ? " class=\"sort\"" : "");
    for (size_t i = 0; i < report->columns; i++, cell += strlen(cell) + 1) {
        td_text_format(m, "<th scope=\"col\"%s>", is_number[i] ? " class=\"n\"" : "");
        td_markup_text(m, cell + 1);
        td_markup_raw(m, "</th>");
    }
    td_markup_raw(m, "</tr></thead>\n<tbody>\n");
    for (size_t row = 0; row < report->rows; row++) {
        td_markup_raw(m, "<tr>");
        for (size_t i = 0; i < report->columns; i++, cell += strlen(cell) + 1)
            add_cell(m, cell, is_number[i], i == 0);
        td_markup_raw(m, "</tr>\n");
    }
    td_markup_raw(m, "</tbody>\n</table></div>\n");
    report->sortable |= sortable;
}

void td_report_table_end(td_report *report)
{
    if (!is_at(report, TD_PLACE_TABLE, "the end of a table")) return;
    if (report->column) {
        td_report_fail(report, TD_ERROR_ARGUMENT,
                       "row %zu of a table is not ended; call td_report_row_end first", report->rows + 1);
        return;
    }
    bool *is_number = number_columns(report);
    if (is_number)
        add_table(report, is_number);
    else
        td_report_fail(report, TD_ERROR_MEMORY, "out of memory");
    free(is_number);
    report->place = TD_PLACE_BODY;
}

void td_report_grid_begin(td_report *report, int columns)
{
    if (!is_at(report, TD_PLACE_BODY, "a grid")) return;
    report->place = TD_PLACE_GRID;
    report->grid_columns = columns < 1 ? 1 : columns > MAX_GRID_COLUMNS ? MAX_GRID_COLUMNS : columns;
    /* Below this width of a column, px, there will be fewer of them. */
    static const int least[MAX_GRID_COLUMNS + 1] = {0, 320, 340, 240, 150, 150, 140};
    td_text_format(&report->body, "<div class=\"grid\" style=\"--columns:%d;--least:%dpx\">\n",
                   report->grid_columns, least[report->grid_columns]);
}

void td_report_grid_end(td_report *report)
{
    if (!is_at(report, TD_PLACE_GRID, "the end of a grid")) return;
    report->place = TD_PLACE_BODY;
    report->grid_columns = 1;
    td_markup_raw(&report->body, "</div>\n");
}

static void add_head(td_text *file, const td_report *report)
{
    /* The policy makes sure of what the file promises: it asks for nothing from anywhere. */
    td_markup_raw(file, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n"
                        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
                        "img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\"/>\n"
                        "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"/>\n"
                        "<meta name=\"color-scheme\" content=\"light dark\"/>\n"
                        "<meta name=\"generator\" content=\"Teledimos\"/>\n<title>");
    td_text_add(file, report->title.data, report->title.size);
    td_markup_raw(file, "</title>\n<style>\n");
    td_markup_raw(file, td_report_style);
    td_markup_raw(file, "\n</style>\n</head>\n<body>\n<main>\n<header>\n<h1>");
    td_text_add(file, report->title.data, report->title.size);
    td_markup_raw(file, "</h1>\n");
    if (report->subtitle.size) {
        td_markup_raw(file, "<p class=\"subtitle\">");
        td_text_add(file, report->subtitle.data, report->subtitle.size);
        td_markup_raw(file, "</p>\n");
    }
    td_markup_raw(file, "</header>\n");
    if (report->headings >= CONTENTS_FROM) {
        td_markup_raw(file, "<nav aria-label=\"Contents\"><ul>");
        td_text_add(file, report->contents.data, report->contents.size);
        td_markup_raw(file, "</ul></nav>\n");
    }
}

td_status td_report_write(td_report *report, const char *path, td_error *error)
{
    if (!path) return td_fail(error, TD_ERROR_ARGUMENT, "a report is to be written, but its path is missing");
    if (!report) return td_fail(error, TD_ERROR_MEMORY, "%s: the report is not written: out of memory", path);
    is_at(report, TD_PLACE_BODY, "the end of the report");
    if (report->first.status != TD_OK)
        return td_fail(error, report->first.status, "%s: the report is not written: %s", path,
                       report->first.message);
    td_text file = {0};
    add_head(&file, report);
    if (report->body.size) td_text_add(&file, report->body.data, report->body.size);
    td_markup_raw(&file, "</main>\n");
    if (report->sortable) {
        td_markup_raw(&file, "<script>");
        td_markup_raw(&file, td_report_script);
        td_markup_raw(&file, "</script>\n");
    }
    td_markup_raw(&file, "</body>\n</html>\n");
    td_status status =
        file.failed ? td_fail(error, TD_ERROR_MEMORY, "%s: the report is not written: out of memory", path)
                    : td_file_write(path, file.data, file.size, error);
    free(file.data);
    return status;
}
