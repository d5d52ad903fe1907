/* The report: well-formed, escaped, deterministic, self-contained, bounded, and true to the data.
 *
 * The files are read back by code of this test's own: a reader of tags that demands well-formed XML (stricter
 * than HTML), a reader of the numbers of paths, and a reader of base64. Positions are compared with the plain
 * formula of an axis, to 0.01 px, which is the rounding of the file. Blind to: what a browser makes of the
 * styles (looked at by eye, in light and dark, on a phone's width and in print), and the correctness of the
 * JPEG codec. */
#include "tests/check.h"

#include <float.h>
#include <locale.h>

#include "core/file.h"
#include "core/random.h"
#include "core/report.h"
#include "core/text_internal.h"
#include "tests/scratch.h"

enum { FILE_LIMIT = 64 << 20, MAX_DEPTH = 64 };

/* Writes and frees the report; returns the file's text. */
static char *finish(td_report **report, const char *folder)
{
    td_error error = {0};
    char *path = td_path_join(folder, "report.html"), *text;
    size_t size;
    check_ok(td_report_write(*report, path, &error), error);
    td_report_free(report);
    assert_null(*report);
    check_ok(td_file_read(&text, &size, path, FILE_LIMIT, &error), error);
    assert_int_equal(size, strlen(text));
    free(path);
    return text;
}

/* --- reading what was written --- */

static const char *skip_entity(const char *at)
{
    static const char *const known[] = {"&amp;", "&lt;", "&gt;", "&quot;", "&#39;"};
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (!strncmp(at, known[i], strlen(known[i]))) return at + strlen(known[i]);
    fail_msg("a bare & at '%.40s'", at);
    return NULL;
}

/* Reads the attributes of a tag up to its > or />; returns what is behind, *closed: it was />. */
static const char *skip_attributes(const char *at, int *closed)
{
    for (;;) {
        size_t blanks = strspn(at, " \n");
        at += blanks;
        *closed = at[0] == '/';
        if (*at == '>') return at + 1;
        if (*closed) {
            if (at[1] != '>') fail_msg("a stray / at '%.40s'", at);
            return at + 2;
        }
        size_t name = strcspn(at, "= \n<>/\"'");
        if (!blanks || !name || at[name] != '=' || at[name + 1] != '"')
            fail_msg("no attribute at '%.40s'", at);
        for (at += name + 2; *at != '"';) {
            if (!*at || *at == '<') fail_msg("an attribute has no end at '%.40s'", at);
            at = *at == '&' ? skip_entity(at) : at + 1;
        }
        at++;
    }
}

/* Every element is closed by its own tag, every attribute is quoted, no < or & stands bare, all is UTF-8
 * text. */
static void check_well_formed(const char *text)
{
    char open[MAX_DEPTH][16];
    size_t depth = 0, elements = 0;
    assert_int_equal(td_utf8_check(text, strlen(text)), strlen(text));
    for (const char *c = text; *c; c++)
        if ((unsigned char)*c < 32 && *c != '\n' && *c != '\t') fail_msg("a control character %d", *c);
    const char *at = text;
    assert_int_equal(strncmp(at, "<!DOCTYPE html>\n", 16), 0);
    for (at += 16; *at;) {
        if (*at == '&') {
            at = skip_entity(at);
            continue;
        }
        if (*at != '<') {
            at++;
            continue;
        }
        int closes = at[1] == '/', closed = 0;
        at += 1 + closes;
        size_t length = strspn(at, "abcdefghijklmnopqrstuvwxyz0123456789");
        if (!length || length > 15) fail_msg("no tag at '%.40s'", at - 1);
        if (closes) {
            if (!depth || strncmp(open[depth - 1], at, length) != 0 || open[depth - 1][length] ||
                at[length] != '>')
                fail_msg("</%.*s> closes <%s>", (int)length, at, depth ? open[depth - 1] : "");
            depth--;
            at += length + 1;
            continue;
        }
        assert_true(depth < MAX_DEPTH);
        snprintf(open[depth], sizeof open[depth], "%.*s", (int)length, at);
        at = skip_attributes(at + length, &closed);
        depth += !closed;
        elements++;
    }
    if (depth) fail_msg("<%s> is not closed", open[depth - 1]);
    assert_true(elements > 10);
}

static size_t count_of(const char *text, const char *words)
{
    size_t count = 0;
    for (const char *at = text; (at = strstr(at, words)); at += strlen(words)) count++;
    return count;
}

static const char *find(const char *text, const char *words)
{
    const char *at = text ? strstr(text, words) : NULL;
    if (!at) {
        fail_msg("'%s' is not in the report", words);
        abort(); /* not reached: the compiler does not know that fail_msg leaves */
    }
    return at;
}

/* What follows `words` up to a quotation mark; to be freed. */
static char *after(const char *text, const char *words)
{
    const char *begin = find(text, words) + strlen(words);
    size_t length = strcspn(begin, "\"<");
    char *value = malloc(length + 1);
    assert_non_null(value);
    memcpy(value, begin, length);
    value[length] = 0;
    return value;
}

static double number_after(const char *text, const char *words)
{
    char *value = after(text, words), *end;
    double number = strtod(value, &end);
    assert_true(end > value);
    free(value);
    return number;
}

/* All numbers within the body's tags are finite and, in drawings, of a screen's size. */
static void check_numbers(const char *text)
{
    const char *body = find(text, "<main>");
    assert_null(strstr(body, "nan"));
    assert_null(strstr(body, "inf"));
    size_t numbers = 0;
    for (const char *d = body; (d = strstr(d, " d=\""));) {
        for (d += 4; *d != '"';) {
            char *end;
            double value = strtod(d, &end);
            if (end == d) {
                if (!strchr("MLlmhvHVz ", *d)) fail_msg("no path at '%.30s'", d);
                d++;
                continue;
            }
            if (!(fabs(value) < 3000)) fail_msg("the coordinate %g", value);
            d = end;
            numbers++;
        }
    }
    assert_true(numbers > 20);
}

/* The box of the data of the first plot in `text`, px. */
typedef struct box {
    const char *inside; /* the drawing of the data */
    double width, height;
} box;

static box data_box(const char *text)
{
    box b = {.inside = find(text, "viewBox=\"-3 -3 ")};
    b.width = number_after(b.inside, "viewBox=\"-3 -3 ") - 6;
    const char *height = strchr(b.inside + strlen("viewBox=\"-3 -3 "), ' ');
    b.height = strtod(height, NULL) - 6;
    assert_true(b.width > 50 && b.height > 50);
    return b;
}

/* The numbers of the first path of a class behind `text`; returns how many. */
static size_t path_numbers(double *value, size_t limit, const char *text, const char *class_name)
{
    char words[64];
    snprintf(words, sizeof words, "<path class=\"%s\" d=\"", class_name);
    char *d = after(text, words);
    size_t count = 0;
    for (char *at = d; *at;) {
        char *end;
        double v = strtod(at, &end);
        if (end > at && count < limit) value[count++] = v;
        at = end > at ? end : at + 1;
    }
    free(d);
    return count;
}

/* --- a report with everything --- */

static void add_table(td_report *report)
{
    static const char *const columns[] = {"view", "RMS", "remark"};
    td_report_table_begin(report, columns, 3);
    for (int i = 0; i < 5; i++) {
        td_report_cell(report, TD_TONE_PLAIN, "view%02d.png", i);
        td_report_cell(report, i == 3 ? TD_TONE_BAD : TD_TONE_PLAIN, "%.3f px", 0.1 * i);
        td_report_cell(report, TD_TONE_GOOD, "%s", i % 2 ? "" : "fine");
        td_report_row_end(report);
    }
    td_report_table_end(report);
}

static void add_picture(td_report *report, int width, int height, int channels, int max_width)
{
    td_image *image;
    td_error error;
    check_ok(td_image_new(&image, width, height, channels, &error), error);
    for (int i = 0; i < width * height * channels; i++)
        image->data[i] = (uint8_t)(200 * (i / channels % width) / width);
    static const double x[] = {0, 12.25, 30}, y[] = {0, 7.5, 3}, dx[] = {1, 0, 0}, dy[] = {0, 0.5, 0};
    td_series series[] = {{.label = "corners", .shape = TD_SHAPE_POINT, .count = 3, .x = x, .y = y},
                          {.label = "residuals",
                           .shape = TD_SHAPE_CROSS,
                           .count = 3,
                           .x = x,
                           .y = y,
                           .dx = dx,
                           .dy = dy,
                           .vector_scale = 10}};
    td_report_picture(report, image, max_width, "a picture", series, 2);
    td_image_free(&image);
}

static td_report *everything(void)
{
    td_report *report = td_report_new("Title", "Subtitle");
    assert_non_null(report);
    static const char *const sentences[] = {"One.", "Two."};
    td_report_verdict(report, TD_TONE_WARN, "Accepted", sentences, 2);
    td_report_verdict(report, TD_TONE_GOOD, "Accepted", sentences, 1);
    td_report_verdict(report, TD_TONE_BAD, "Refused", NULL, 0);
    for (int i = 0; i < 5; i++) td_report_heading(report, "Heading");
    td_report_text(report, "A text of %d words.", 5);
    td_report_figures_begin(report);
    td_report_figure(report, "RMS", TD_TONE_GOOD, "%.2f px", 0.21);
    td_report_figure(report, "sigma", TD_TONE_PLAIN, "%g", NAN);
    td_report_figures_end(report);
    add_table(report);
    static const double x[] = {0, 1, 2, 3}, y[] = {0.5, 0.7, 0.1, 0.9};
    static const char *const names[] = {"a", "b", "c", "d"};
    td_series line = {.label = "line", .shape = TD_SHAPE_LINE, .count = 4, .x = x, .y = y};
    td_series bars = {
        .label = "bars", .shape = TD_SHAPE_BAR, .tone = TD_TONE_BAD, .count = 4, .x = x, .y = y};
    td_axes named = {.title = "bars", .y_label = "RMS (px)", .x_names = names, .x_name_count = 4};
    td_report_plot(report, &named, &bars, 1);
    td_report_grid_begin(report, 3);
    td_report_plot(report, &(td_axes){.title = "line", .x_label = "time (s)", .equal = 1}, &line, 1);
    add_picture(report, 60, 40, 1, 30);
    add_picture(report, 60, 40, 3, 0);
    td_report_grid_end(report);
    add_picture(report, 60, 40, 3, 0);
    td_report_plot(report, NULL, &line, 1);
    return report;
}

static void test_well_formed_and_deterministic(void **state)
{
    td_report *report = everything();
    char *text = finish(&report, *state);
    check_well_formed(text);
    assert_int_equal(count_of(text, "<h1>"), 1);
    assert_int_equal(count_of(text, "<h2 id="), 5);
    assert_int_equal(count_of(text, "<figure"), 6);
    assert_int_equal(count_of(text, "<figcaption>"), 6);
    assert_int_equal(count_of(text, "role=\"img\""), 6);
    assert_int_equal(count_of(text, "<desc>"), 6);
    assert_int_equal(count_of(text, "<th scope=\"col\""), 3);
    assert_int_equal(count_of(text, "<th scope=\"row\""), 5);
    assert_int_equal(count_of(text, "<figure class=\"plot full\">"), 2); /* before and behind the grid */
    assert_int_equal(count_of(text, "<figure class=\"plot third\">"), 1);
    assert_int_equal(count_of(text, "<table class=\"sort\">"), 1);
    assert_int_equal(count_of(text, "<script>"), 1);

    report = everything();
    char *again = finish(&report, *state);
    assert_string_equal(text, again);
    free(again);
    free(text);
}

/* Nothing is asked for from outside: no address, no source but data. */
static void test_self_contained(void **state)
{
    td_report *report = everything();
    char *text = finish(&report, *state);
    static const char *const asks[] = {"http:", "https:", "src=", "url(", "@import", "<link", "//"};
    for (size_t i = 0; i < sizeof asks / sizeof *asks; i++) {
        const char *at = text;
        while ((at = strstr(at, asks[i]))) {
            /* The two slashes may stand within base64. */
            const char *data = at;
            while (data > text && *data != '"') data--;
            if (strncmp(data, "\"data:image/jpeg;base64,", 24) != 0) fail_msg("'%s' at '%.40s'", asks[i], at);
            at++;
        }
    }
    assert_int_equal(count_of(text, " href=\"data:image/jpeg;base64,/9j/"), 3);
    assert_int_equal(count_of(text, " href=\""), 3 + 5); /* and the contents' own */
    free(text);
}

/* Numbers that the report writes itself do not follow the program's locale. */
static void test_locale(void **state)
{
    td_report *report = everything();
    char *text = finish(&report, *state);
    static const char *const locales[] = {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "de_DE"};
    bool found = false;
    for (size_t i = 0; i < sizeof locales / sizeof *locales && !found; i++)
        found = setlocale(LC_NUMERIC, locales[i]) && *localeconv()->decimal_point == ',';
    if (!found) {
        free(text);
        print_message("no locale with a decimal comma is installed\n");
        skip();
    }
    report = everything();
    setlocale(LC_NUMERIC, "C");
    char *local = finish(&report, *state);
    find(local, "0,21 px"); /* the caller's own numbers follow the locale */
    assert_string_equal(find(text, "<figure"), find(local, "<figure"));
    free(local);
    free(text);
}

/* --- text --- */

#define HOSTILE "</p><script>alert(\"1\")</script>'&\x01\xff\xc0\xaf\xed\xa0\x80 onload=\"x"
#define HARMLESS                                                                                             \
    "&lt;/p&gt;&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&#39;&amp;"                                  \
    "\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD onload=&quot;x"

static void test_escaping(void **state)
{
    static const double one[] = {1};
    static const char *const hostile[] = {HOSTILE, HOSTILE};
    td_report *report = td_report_new(HOSTILE, HOSTILE);
    td_report_verdict(report, TD_TONE_PLAIN, HOSTILE, hostile, 2);
    for (int i = 0; i < 4; i++) td_report_heading(report, HOSTILE);
    td_report_text(report, "%s", HOSTILE);
    td_report_figures_begin(report);
    td_report_figure(report, HOSTILE, TD_TONE_PLAIN, "%s", HOSTILE);
    td_report_figures_end(report);
    td_report_table_begin(report, hostile, 2);
    for (int i = 0; i < 2; i++) td_report_cell(report, TD_TONE_PLAIN, "%s", HOSTILE);
    td_report_row_end(report);
    td_report_table_end(report);
    td_series series = {.label = HOSTILE, .count = 1, .x = one, .y = one};
    td_axes axes = {.title = HOSTILE, .x_label = HOSTILE, .y_label = HOSTILE};
    td_report_plot(report, &axes, &series, 1);
    td_image image = {1, 1, 1, (uint8_t[]){7}};
    td_report_picture(report, &image, 10, HOSTILE, &series, 1);
    static const char *const names[] = {"<a>\"&'\xff", "b"};
    td_report_plot(report, &(td_axes){.x_names = names, .x_name_count = 2}, &series, 1);
    char *text = finish(&report, *state);
    check_well_formed(text);
    assert_null(strstr(text, "<script"));
    /* title twice, subtitle, verdict 3, headings and contents 8, text, figure 2, table 4, plot: title 2,
     * legend, desc 3 and label x; picture: caption 2, legend, desc; the last plot: legend, desc. The y label
     * may be cut. */
    assert_in_range(count_of(text, HARMLESS), 33, 35);
    find(text, ">&lt;a&gt;&quot;&amp;&#39;\xEF\xBF\xBD<");
    free(text);
}

/* Bytes that are not UTF-8 (RFC 3629), one U+FFFD each, and what is, unchanged. */
static void test_utf8(void **state)
{
    td_report *report = td_report_new("é €\xf0\x9f\x93\xb7", NULL);
    td_report_text(report, "%s", "[\xe2\x82]");         /* cut short */
    td_report_text(report, "%s", "[\xf4\x90\x80\x80]"); /* beyond U+10FFFF */
    td_report_text(report, "%s", "[\x7f\xc2\x85]");     /* DEL, NEL */
    td_report_text(report, "%s", "end\xe2");
    char *text = finish(&report, *state);
    check_well_formed(text);
    find(text, "<h1>é €\xf0\x9f\x93\xb7</h1>");
    find(text, ">[\xEF\xBF\xBD\xEF\xBF\xBD]<");
    find(text, ">[\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD]<");
    find(text, ">end\xEF\xBF\xBD<");
    free(text);
}

/* --- tables and figures --- */

static void test_numbers_in_tables(void **state)
{
    static const char *const columns[] = {"name", "number", "with unit", "mixed"};
    static const char *const cells[][4] = {{"01.jpg", "3", "0.21 px", "no"},
                                           {"02.jpg", "-1.5e-3", "0.2 ± 0.1 px", "1"},
                                           {"3rd view", "nan", "98 %", "12 of 13"}};
    td_report *report = td_report_new("t", NULL);
    td_report_table_begin(report, columns, 4);
    for (int row = 0; row < 3; row++) {
        for (int i = 0; i < 4; i++) td_report_cell(report, TD_TONE_PLAIN, "%s", cells[row][i]);
        td_report_row_end(report);
    }
    td_report_table_end(report);
    td_report_figures_begin(report);
    td_report_figure(report, "a", TD_TONE_PLAIN, "%.2f ± %.2f px", 0.5, NAN);
    td_report_figure(report, "b", TD_TONE_PLAIN, "%g", -INFINITY);
    td_report_figure(report, "c", TD_TONE_PLAIN, "inf.png nano");
    td_report_figures_end(report);
    char *text = finish(&report, *state);
    find(text, "<th scope=\"col\">name</th><th scope=\"col\" class=\"n\">number</th>"
               "<th scope=\"col\" class=\"n\">with unit</th><th scope=\"col\">mixed</th>");
    find(text, "<td class=\"n\">–</td><td class=\"n\">98 %</td><td>12 of 13</td>");
    find(text, "<dd>0.50 ± – px</dd>");
    find(text, "<dd>−∞</dd>");
    find(text, "<dd>inf.png nano</dd>");
    assert_null(strstr(text, "<script")); /* three rows need no sorting */
    free(text);
}

/* --- plots --- */

/* Where values fall, by the formula of an axis. */
static void test_positions(void **state)
{
    static const double x[] = {10, 20, 12.5}, y[] = {-1, 3, 0};
    td_series series = {.shape = TD_SHAPE_POINT, .count = 3, .x = x, .y = y};
    for (int down = 0; down < 2; down++)
        for (int columns = 1; columns <= 3; columns++) {
            td_axes axes = {.x_min = 10, .x_max = 20, .y_min = -1, .y_max = 3, .y_down = down};
            td_report *report = td_report_new("t", NULL);
            td_report_grid_begin(report, columns);
            td_report_plot(report, &axes, &series, 1);
            td_report_grid_end(report);
            char *text = finish(&report, *state);
            box b = data_box(text);
            double v[9]; /* x y of the move, 0 of the line */
            assert_int_equal(path_numbers(v, 9, b.inside, "point few"), 9);
            for (int i = 0; i < 3; i++) {
                double share = (y[i] + 1) / 4;
                check_near(v[3 * i], b.width * (x[i] - 10) / 10, 0.011);
                check_near(v[3 * i + 1], b.height * (down ? share : 1 - share), 0.011);
            }
            free(text);
        }
}

static void test_equal_axes(void **state)
{
    static const double x[] = {0, 640}, y[] = {0, 480};
    td_series series = {.shape = TD_SHAPE_CROSS, .count = 2, .x = x, .y = y};
    static const double size[][2] = {{640, 480}, {100, 1000}, {1000, 1}};
    for (size_t i = 0; i < 3; i++) {
        td_axes axes = {.x_max = size[i][0], .y_max = size[i][1], .equal = 1};
        td_report *report = td_report_new("t", NULL);
        td_report_plot(report, &axes, &series, 1);
        char *text = finish(&report, *state);
        box b = data_box(text);
        /* The axes' ends are in the description, for the shorter one may have been widened. */
        double x_span = number_after(text, " to ") - number_after(text, "x axis: from ");
        const char *y_axis = find(text, "y axis: from ");
        double y_span = number_after(y_axis, " to ") - number_after(y_axis, "from ");
        check_near(b.width / x_span / (b.height / y_span), 1, 2e-3); /* the description has four digits */
        assert_true(x_span >= size[i][0] && y_span >= size[i][1]);
        assert_true(b.width < 860 && b.height <= 560.01);
        free(text);
    }
}

/* The tick labels of x: at least two, all steps the same, the step 1, 2 or 5 times a power of ten, in the
 * axes. */
static void check_ticks(const char *text, double min, double max)
{
    const char *label = find(text, "<g class=\"mid\">"), *end = find(label, "</g>");
    double previous = NAN, step = NAN, factor = 1;
    const char *power = strstr(find(text, "class=\"mid name\""), "10");
    if (power && strstr(text, " · 10")) {
        static const char *const digit[] = {"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
        int exponent = 0, sign = 1;
        const char *at = find(text, " · 10") + strlen(" · 10");
        if (!strncmp(at, "⁻", strlen("⁻"))) {
            sign = -1;
            at += strlen("⁻");
        }
        for (int d = 0; d < 10; d++)
            if (!strncmp(at, digit[d], strlen(digit[d]))) {
                exponent = 10 * exponent + d;
                at += strlen(digit[d]);
                d = -1;
            }
        factor = pow(10, sign * exponent);
    }
    int count = 0;
    while ((label = strstr(label, "dy=\".9em\">")) && label < end) {
        label += strlen("dy=\".9em\">");
        double sign = 1;
        if (!strncmp(label, "−", strlen("−"))) {
            sign = -1;
            label += strlen("−");
        }
        double value = sign * strtod(label, NULL) * factor;
        assert_true(value >= min - 1e-6 * (max - min) && value <= max + 1e-6 * (max - min));
        if (count == 1) step = value - previous;
        if (count > 1) check_near(value - previous, step, 1e-6 * step);
        previous = value;
        count++;
    }
    if (count < 2 || count > 16) fail_msg("%d ticks from %g to %g", count, min, max);
    double mantissa = step / pow(10, floor(log10(step) + 1e-6));
    if (!(fabs(mantissa - 1) < 1e-4 || fabs(mantissa - 2) < 1e-4 || fabs(mantissa - 5) < 1e-4))
        fail_msg("a step of %g from %g to %g", step, min, max);
}

static void test_ticks(void **state)
{
    static const double ranges[][2] = {
        {0, 1},         {-0.5, 639.5}, {0, 7},       {-3, 3},          {0.2, 0.21},
        {1e6, 2e6},     {0, 9.99e9},   {0, 3e-9},    {1e-300, 3e-299}, {-1e299, 1e300},
        {1e6, 1e6 + 1}, {-1e-5, 0},    {0, 9999999}, {99999, 100001},  {12345678, 12345679}};
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++)
        for (int columns = 1; columns <= 3; columns++) {
            td_report *report = td_report_new("t", NULL);
            td_report_grid_begin(report, columns);
            td_report_plot(report, &(td_axes){.x_label = "x", .x_min = ranges[i][0], .x_max = ranges[i][1]},
                           NULL, 0);
            td_report_grid_end(report);
            char *text = finish(&report, *state);
            check_well_formed(text);
            /* 1e-300 … is narrower than doubles can tick: that axis is drawn as if it held one value. */
            if (ranges[i][1] > 1e-290) check_ticks(text, ranges[i][0], ranges[i][1]);
            free(text);
        }
}

/* Values that doubles cannot tell apart on an axis are drawn as one; small numbers count in a power of a
 * thousand. */
static void test_narrow_ranges(void **state)
{
    static const double x[] = {1, 1 + 2 * DBL_EPSILON}, y[] = {0, 3e-9};
    td_series series = {.count = 2, .x = x, .y = y};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_label = "x"}, &series, 1);
    td_report_plot(report, &(td_axes){.x_label = "y (m)"}, &(td_series){.count = 2, .x = y, .y = x}, 1);
    char *text = finish(&report, *state);
    char *second = strstr(find(text, "<figure") + 1, "<figure");
    find(second, ">y (m) · 10⁻⁹</text>");
    check_ticks(second, 0, 3.2e-9);
    *second = 0;
    check_numbers(text);
    /* Only the y axis of the first counts in powers. */
    find(text, ">10⁻⁹</text>");
    find(text, "x axis: x, from 0.9 to 1.1.");
    free(text);
}

/* No data, one value, values all the same, far apart, too large, not finite: a plot all the same, and no wild
 * number. */
static void test_odd_data(void **state)
{
    const double odd[] = {0,     1,      -1,     NAN,    INFINITY, -INFINITY,  DBL_MAX, -DBL_MAX,
                          1e300, -1e300, 5e-324, 1e-310, 1e9,      1e9 + 1e-6, 1e-12,   640};
    enum { ODD = sizeof odd / sizeof *odd };
    td_random random = td_random_seed(7, 1);
    for (int trial = 0; trial < 400; trial++) {
        double x[8], y[8], dx[8], dy[8];
        size_t count = td_random_below(&random, 9);
        for (size_t i = 0; i < 8; i++) {
            x[i] = odd[td_random_below(&random, ODD)];
            y[i] = odd[td_random_below(&random, ODD)];
            dx[i] = odd[td_random_below(&random, ODD)];
            dy[i] = odd[td_random_below(&random, ODD)];
        }
        static const char *const names[] = {"a", "b"};
        bool vectors = td_random_below(&random, 2), fixed = td_random_below(&random, 2);
        td_series series[2];
        for (int i = 0; i < 2; i++)
            series[i] = (td_series){.label = "s",
                                    .shape = (td_shape)td_random_below(&random, 4),
                                    .count = count,
                                    .x = x,
                                    .y = y,
                                    .dx = vectors ? dx : NULL,
                                    .dy = vectors ? dy : NULL,
                                    .vector_scale = odd[td_random_below(&random, ODD)]};
        td_axes axes = {.equal = (int)td_random_below(&random, 2),
                        .y_down = (int)td_random_below(&random, 2),
                        .x_names = td_random_below(&random, 4) ? NULL : names,
                        .x_name_count = 2};
        if (fixed) {
            axes.x_min = odd[td_random_below(&random, ODD)];
            axes.x_max = odd[td_random_below(&random, ODD)];
            axes.y_min = odd[td_random_below(&random, ODD)];
            axes.y_max = odd[td_random_below(&random, ODD)];
        }
        td_report *report = td_report_new("t", NULL);
        td_report_plot(report, &axes, series, td_random_below(&random, 3));
        td_report_plot(report, NULL, NULL, 0);
        char *text = finish(&report, *state);
        check_well_formed(text);
        check_numbers(text);
        free(text);
    }
}

static void test_missing_values_are_said(void **state)
{
    static const double x[] = {0, 1, 2, 3, 4, 50}, y[] = {0, 1, NAN, 3, INFINITY, 5};
    td_series line = {.shape = TD_SHAPE_LINE, .count = 5, .x = x, .y = y};
    td_series points = {.shape = TD_SHAPE_POINT, .count = 6, .x = x, .y = y};
    td_report *report = td_report_new("t", NULL);
    td_axes axes = {.x_max = 4, .y_max = 4};
    td_report_plot(report, &axes, &line, 1);
    td_report_plot(report, &axes, &points, 1);
    char *text = finish(&report, *state);
    box b = data_box(text);
    /* 0–1 is a stroke; the gap is not bridged; 3 stands alone, as a dot. */
    double v[9];
    assert_int_equal(path_numbers(v, 9, b.inside, "line"), 4);
    assert_int_equal(path_numbers(v, 9, b.inside, "point"), 3);
    check_near(v[0], b.width * 3 / 4, 0.011);
    find(text, ">2 values are not finite and not drawn. </p>");
    find(text, ">2 values are not finite and not drawn. 1 value lies outside this view. </p>");
    free(text);
}

/* A line through the view between ends far outside keeps its course. */
static void test_clipped_line(void **state)
{
    static const double x[] = {-1e6, 1e6 + 1, 0.5}, y[] = {-1e6, 1e6 + 1, 1e250};
    td_series series = {.shape = TD_SHAPE_LINE, .count = 3, .x = x, .y = y};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_max = 1, .y_max = 1}, &series, 1);
    char *text = finish(&report, *state);
    check_numbers(text);
    box b = data_box(text);
    double v[8];
    assert_true(path_numbers(v, 8, b.inside, "line") >= 4);
    for (int i = 0; i < 2; i++) check_near(v[2 * i] / b.width + v[2 * i + 1] / b.height, 1, 1e-3);
    assert_true(v[0] <= 0 && v[2] >= b.width);
    free(text);

    /* One that leaves the view and comes back elsewhere begins anew there. */
    static const double u[] = {0.2, 0.5, 0.8}, w[] = {0.5, 50, 0.5};
    series = (td_series){.shape = TD_SHAPE_LINE, .count = 3, .x = u, .y = w};
    report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_max = 1, .y_max = 1}, &series, 1);
    text = finish(&report, *state);
    b = data_box(text);
    assert_int_equal(path_numbers(v, 8, b.inside, "line"), 8);
    assert_true(v[2] > 0.2 * b.width && v[2] < 0.21 * b.width);
    assert_true(v[4] < 0.8 * b.width && v[4] > 0.79 * b.width);
    char *d = after(b.inside, "<path class=\"line\" d=\"");
    assert_int_equal(count_of(d, "M"), 2);
    free(d);
    free(text);
}

static void test_vectors(void **state)
{
    static const double x[] = {10, 50}, y[] = {10, 20}, dx[] = {1, 0}, dy[] = {0, NAN};
    td_series series = {.label = "residuals",
                        .shape = TD_SHAPE_POINT,
                        .count = 2,
                        .x = x,
                        .y = y,
                        .dx = dx,
                        .dy = dy,
                        .vector_scale = 50};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_max = 100, .y_max = 100, .y_down = 1}, &series, 1);
    char *text = finish(&report, *state);
    box b = data_box(text);
    double v[16];
    assert_int_equal(path_numbers(v, 16, b.inside, "vector"), 10);
    check_near(v[0], 0.1 * b.width, 0.011);
    check_near(v[1], 0.1 * b.height, 0.011);
    check_near(v[2], 0.6 * b.width, 0.011); /* 10 + 50·1 */
    check_near(v[3], 0.1 * b.height, 0.011);
    /* The head's strokes go back from the tip, one to each side. */
    assert_true(v[4] < -2 && v[8] < -2 && v[5] * v[9] < 0);
    check_near(v[5], -v[9], 0.011);
    find(text, "<span>residuals ×50</span>");
    find(text, ">1 value is not finite and not drawn. </p>");
    free(text);
}

static void test_bars(void **state)
{
    static const double x[] = {0, 1, 2}, a[] = {1, 2, -1}, c[] = {2, 1, 0};
    td_series series[] = {{.shape = TD_SHAPE_BAR, .count = 3, .x = x, .y = a},
                          {.shape = TD_SHAPE_BAR, .count = 3, .x = x, .y = c}};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.y_min = -2, .y_max = 2}, series, 2);
    char *text = finish(&report, *state);
    box b = data_box(text);
    double v[15], w[15]; /* for each bar: x, base, width, top, -width */
    assert_int_equal(path_numbers(v, 15, b.inside, "bar"), 15);
    assert_int_equal(path_numbers(w, 15, find(b.inside, "c2"), "bar"), 15);
    for (int i = 0; i < 3; i++) {
        check_near(v[5 * i + 1], b.height / 2, 0.011);
        check_near(v[5 * i + 3], b.height * (2 - a[i]) / 4, 0.011);
        check_near(v[5 * i] + v[5 * i + 2], w[5 * i], 0.021); /* side by side */
        /* The pair's middle is at x; bars of distance 1 span from -0.5 to 2.5. */
        check_near(w[5 * i], b.width * (x[i] + 0.5) / 3, 0.021);
    }
    free(text);

    /* Bars stand on 0, however high they are. */
    static const double high[] = {10, 10.5, 11};
    report = td_report_new("t", NULL);
    td_report_plot(report, NULL, &(td_series){.shape = TD_SHAPE_BAR, .count = 3, .x = x, .y = high}, 1);
    text = finish(&report, *state);
    find(text, "y axis: from 0 to 11");
    free(text);
}

static void test_names(void **state)
{
    enum { MANY = 300 };
    static char store[MANY][40];
    const char *names[MANY];
    for (int i = 0; i < MANY; i++) {
        snprintf(store[i], sizeof store[i], "a_long_folder_name_%03d", i);
        names[i] = store[i];
    }
    static const double x[] = {0, 1}, y[] = {1, 2};
    td_series series = {.shape = TD_SHAPE_BAR, .count = 2, .x = x, .y = y};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_names = (const char *const[]){"left", "right"}, .x_name_count = 2},
                   &series, 1);
    /* Axes that reach beyond the names show those that there are. */
    td_axes beyond = {.x_names = (const char *const[]){"left", "right", "ghost"},
                      .x_name_count = 2,
                      .x_min = -3,
                      .x_max = 4};
    td_report_plot(report, &beyond, &series, 1);
    td_report_heading(report, "many");
    td_report_plot(report, &(td_axes){.x_names = names, .x_name_count = MANY}, &series, 1);
    char *text = finish(&report, *state);
    check_well_formed(text);
    const char *many = find(text, "<h2");
    assert_int_equal(count_of(text, ">left</text>"), 2);
    assert_int_equal(count_of(text, ">right</text>"), 2);
    assert_null(strstr(text, "ghost"));
    assert_true(strstr(text, "rotate(-45)") > many); /* two have room, 300 do not */
    size_t shown = count_of(many, "rotate(-45)");
    if (shown < 10 || shown > 60) fail_msg("%zu names of %d", shown, MANY);
    /* The end, where names differ, is kept. */
    find(many, ">a_long_fo…r_name_000</text>");
    free(text);
}

/* 100 000 values cost no more than the drawing has room for, and what stands alone is drawn. */
static void test_many_values(void **state)
{
    enum { N = 100000 };
    double *x = malloc(N * sizeof *x), *y = malloc(N * sizeof *y), *t = malloc(N * sizeof *t);
    assert_true(x && y && t);
    td_random random = td_random_seed(3, 1);
    for (int i = 0; i < N; i++) {
        x[i] = td_random_uniform(&random);
        y[i] = td_random_uniform(&random);
        t[i] = i;
    }
    x[N / 2 + 7] = 2;
    y[N / 2 + 7] = 3;
    td_axes axes = {.x_max = 4, .y_max = 4}, time = {.x_max = N, .y_max = 4};
    static const td_shape shapes[] = {TD_SHAPE_POINT, TD_SHAPE_CROSS, TD_SHAPE_LINE, TD_SHAPE_BAR};
    static const char *const class_name[] = {"point many", "cross", "dense", "bar"};
    for (int k = 0; k < 4; k++) {
        bool marks = k < 2;
        td_series series = {.shape = shapes[k], .count = N, .x = marks ? x : t, .y = y};
        td_report *report = td_report_new("t", NULL);
        td_report_plot(report, marks ? &axes : &time, &series, 1);
        char *text = finish(&report, *state);
        if (strlen(text) > 400000) fail_msg("%s: %zu bytes", class_name[k], strlen(text));
        find(text, "of 100\xE2\x80\xAF"
                   "000 values");
        check_numbers(text);
        box b = data_box(text);
        double *v = malloc(N * sizeof *v);
        assert_non_null(v);
        size_t count = path_numbers(v, N, b.inside, class_name[k]);
        double least = INFINITY; /* the ordinate nearest to the outlier's */
        for (size_t i = 0; i < count; i++) least = fmin(least, fabs(v[i] - b.height * 0.25));
        assert_true(count > 1000);
        if (k != 1) check_near(least, 0, 0.011); /* a cross is drawn around its place */
        free(v);
        free(text);
    }
    /* A line's extremes in x are kept as well. */
    td_series upright = {.shape = TD_SHAPE_LINE, .count = N, .x = y, .y = t};
    td_report *report = td_report_new("t", NULL);
    td_report_plot(report, &(td_axes){.x_max = 4, .y_max = N}, &upright, 1);
    char *text = finish(&report, *state);
    box b = data_box(text);
    double *v = calloc(N, sizeof *v), most = 0;
    assert_non_null(v);
    size_t count = path_numbers(v, N, b.inside, "dense");
    for (size_t i = 0; i < count; i += 2) most = fmax(most, v[i]);
    check_near(most, 0.75 * b.width, 0.011);
    free(v);
    free(text);
    free(x);
    free(y);
    free(t);
}

/* --- pictures --- */

static uint8_t *decode_base64(const char *text, size_t *size)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    uint8_t *bytes = malloc(strlen(text));
    uint32_t bits = 0;
    assert_non_null(bytes);
    assert_int_equal(strlen(text) % 4, 0);
    *size = 0;
    for (size_t i = 0; text[i] && text[i] != '='; i++) {
        const char *at = strchr(digit, text[i]);
        assert_non_null(at);
        bits = bits << 6 | (uint32_t)(at - digit);
        if (i % 4) bytes[(*size)++] = (uint8_t)(bits >> (6 - 2 * (i % 4)));
    }
    return bytes;
}

/* The embedded image is the image, shrunk as asked, and spans the same. Ramps of known value at each place
 * tell a shift of a pixel; JPEG changes a smooth ramp by a few levels. */
/* A field: its picture and its scale stand in the file, the colours' range is the caller's or the values'; a
 * field without a range of axes, or of one row, is refused. */
static void test_heat(void **state)
{
    const double value[6] = {0.1, 0.2, NAN, 0.4, 0.5, 0.6};
    td_heat heat = {.columns = 3, .rows = 2, .value = value, .label = "sigma (px)"};
    td_axes axes = {.x_max = 639, .y_max = 479, .equal = 1, .y_down = 1, .heat = &heat};
    td_report *r = td_report_new("Heat", NULL);
    td_report_plot(r, &axes, NULL, 0);
    char *text = finish(&r, *state);
    check_well_formed(text);
    const char *first = strstr(text, "<image preserveAspectRatio"),
               *second = first ? strstr(first + 1, "<image") : NULL;
    assert_non_null(second);
    assert_non_null(strstr(second, "sigma (px)"));
    assert_null(strstr(text, "no data"));
    assert_non_null(strstr(second, ">0.50<")); /* a tick of the values' own range */
    assert_null(strstr(second, ">5<"));
    free(text);
    heat.high = 10;
    r = td_report_new("Heat", NULL);
    td_report_plot(r, &axes, NULL, 0);
    text = finish(&r, *state);
    second = strstr(strstr(text, "<image") + 1, "<image");
    assert_non_null(strstr(second, ">5<"));
    free(text);
    for (int i = 0; i < 2; i++) {
        td_error error;
        td_axes bad = axes;
        td_heat flat = heat;
        bad.heat = &flat;
        if (i == 0) bad.x_max = 0;
        if (i == 1) flat.rows = 1;
        r = td_report_new("Heat", NULL);
        td_report_plot(r, &bad, NULL, 0);
        check_fails(td_report_write(r, "/nowhere/report.html", &error), TD_ERROR_ARGUMENT, error, "2x2");
        td_report_free(&r);
    }
}

static void test_picture(void **state)
{
    enum { WIDTH = 333, HEIGHT = 201, SMALL = 100 };
    td_error error;
    td_image *image, *small;
    check_ok(td_image_new(&image, WIDTH, HEIGHT, 1, &error), error);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) image->data[y * WIDTH + x] = (uint8_t)(x / 2 + y / 4);
    static const double x[] = {0, 332, NAN, 400}, y[] = {0, 200, 3, 3};
    td_series series = {.label = "corners", .shape = TD_SHAPE_POINT, .count = 4, .x = x, .y = y};
    td_report *report = td_report_new("t", NULL);
    td_report_picture(report, image, SMALL, "caption", &series, 1);
    char *text = finish(&report, *state);
    check_well_formed(text);
    find(text, "viewBox=\"-0.5 -0.5 333 201\"");
    find(text, "<image x=\"-0.5\" y=\"-0.5\" width=\"333\" height=\"201\" preserveAspectRatio=\"none\"");
    find(text, "d=\"M0 0h0M332 200h0\""); /* in the image's own pixels */
    find(text, ">1 value is not finite and not drawn. 1 value lies outside this view. </p>");
    char *base64 = after(text, "data:image/jpeg;base64,");
    size_t size;
    uint8_t *bytes = decode_base64(base64, &size);
    check_ok(td_image_decode(&small, bytes, size, 1, "embedded", &error), error);
    assert_int_equal(small->width, SMALL);
    assert_int_equal(small->height, 60);
    double sum = 0;
    for (int v = 0; v < small->height; v++)
        for (int u = 0; u < SMALL; u++) {
            double at_x = (u + 0.5) * WIDTH / SMALL - 0.5, at_y = (v + 0.5) * HEIGHT / 60 - 0.5;
            double expected =
                at_x / 2 + at_y / 4 - 0.25 - 0.375; /* less the mean of what the divisions cut off */
            check_near(small->data[v * SMALL + u], expected, 4);
            sum += small->data[v * SMALL + u] - expected;
        }
    check_near(sum / (SMALL * 60), 0, 0.3); /* half a pixel of the image would be 0.25 + 0.125 */
    td_image_free(&small);
    free(bytes);
    free(base64);
    free(text);

    /* Never larger than it is. */
    report = td_report_new("t", NULL);
    td_report_picture(report, image, 5000, "caption", NULL, 0);
    text = finish(&report, *state);
    find(text, "max-width:333px");
    base64 = after(text, "data:image/jpeg;base64,");
    bytes = decode_base64(base64, &size);
    check_ok(td_image_decode(&small, bytes, size, 1, "embedded", &error), error);
    assert_int_equal(small->width, WIDTH);
    td_image_free(&small);
    td_image_free(&image);
    free(bytes);
    free(base64);
    free(text);
}

/* Every byte of the JPEG is in the file, whatever their number leaves when divided by three. */
static void test_embedding(void **state)
{
    bool seen[3] = {false};
    for (int width = 20; width < 40; width++) {
        td_report *report = td_report_new("t", NULL);
        add_picture(report, 60, 40, 3, width);
        char *text = finish(&report, *state), *base64 = after(text, "data:image/jpeg;base64,");
        size_t size;
        uint8_t *bytes = decode_base64(base64, &size);
        assert_true(size > 100 && bytes[size - 2] == 0xFF && bytes[size - 1] == 0xD9); /* the end of a JPEG */
        assert_int_equal(strlen(base64), (size + 2) / 3 * 4);
        seen[size % 3] = true;
        free(bytes);
        free(base64);
        free(text);
    }
    assert_true(seen[0] && seen[1] && seen[2]);
}

/* --- failures --- */

static void test_first_failure_is_kept(void **state)
{
    char *path = td_path_join(*state, "none.html");
    static const char *const columns[] = {"a", "b"};
    static const double one[] = {1};
    for (int k = 0; k < 15; k++) {
        static const char *const words[] = {"has 1 cells for its 2 columns",
                                            "more cells than its 2 columns",
                                            "call td_report_table_end first",
                                            "call td_report_figures_end first",
                                            "a cell is given outside a table",
                                            "outside a grid",
                                            "a picture is given no image",
                                            "lacks its x or y",
                                            "lacks one of dx and dy",
                                            "no columns",
                                            "call td_report_grid_end first",
                                            "is not ended",
                                            "unknown shape",
                                            "is given none",
                                            "of 1 or 3 channels"};
        td_error error = {0};
        td_report *report = td_report_new("t", NULL);
        bool in_table = k < 3 || k == 11;
        if (in_table) td_report_table_begin(report, columns, 2);
        if (in_table && k < 2) td_report_cell(report, TD_TONE_PLAIN, "1");
        if (k == 0) td_report_row_end(report);
        if (k == 1) td_report_cell(report, TD_TONE_PLAIN, "2"), td_report_cell(report, TD_TONE_PLAIN, "3");
        if (k == 2) td_report_text(report, "text");
        if (k == 3) td_report_figures_begin(report), td_report_heading(report, "heading");
        if (k == 4) td_report_cell(report, TD_TONE_PLAIN, "1");
        if (k == 5) td_report_grid_end(report);
        if (k == 6) td_report_picture(report, NULL, 10, "p", NULL, 0);
        if (k == 7) td_report_plot(report, NULL, &(td_series){.label = "s", .count = 1, .x = one}, 1);
        if (k == 8) td_report_plot(report, NULL, &(td_series){.count = 1, .x = one, .y = one, .dx = one}, 1);
        if (k == 9) td_report_table_begin(report, NULL, 0);
        if (k == 10) td_report_grid_begin(report, 2);
        if (k == 11) td_report_cell(report, TD_TONE_PLAIN, "1"), td_report_table_end(report);
        if (k == 12) td_report_plot(report, NULL, &(td_series){.shape = (td_shape)9}, 1);
        if (k == 13) td_report_plot(report, NULL, NULL, 1);
        if (k == 14) td_report_picture(report, &(td_image){1, 1, 2, (uint8_t[]){1, 2}}, 10, "p", NULL, 0);
        /* Later failures do not replace the first, and good calls do not heal it. */
        if (k != 10) td_report_row_end(report), td_report_figure(report, "a", TD_TONE_PLAIN, "1");
        check_fails(td_report_write(report, path, &error), TD_ERROR_ARGUMENT, error, words[k]);
        check_fails(td_report_write(report, path, &error), TD_ERROR_ARGUMENT, error, path);
        td_report_free(&report);
    }
    assert_null(fopen(path, "rb"));
    free(path);
}

static void test_unwritable(void **state)
{
    td_error error = {0};
    td_report *report = everything();
    char *path = td_path_join(*state, "no/such/report.html");
    check_fails(td_report_write(report, path, &error), TD_ERROR_IO, error, "no/such/report.html");
    check_fails(td_report_write(report, *state, &error), TD_ERROR_IO, error, *state);
    check_fails(td_report_write(report, NULL, &error), TD_ERROR_ARGUMENT, error, "path");
    DIR *folder = opendir(*state);
    assert_non_null(folder);
    for (struct dirent *entry; (entry = readdir(folder));)
        assert_true(entry->d_name[0] == '.' && !strstr(entry->d_name, "tmp"));
    closedir(folder);
    /* After that the report can still be written where it is possible. */
    char *text = finish(&report, *state);
    check_well_formed(text);
    free(text);
    free(path);
}

/* A report that could not be made is written by nobody, and harms nobody. */
static void test_null(void **state)
{
    td_error error = {0};
    td_report *report = NULL;
    char *path = td_path_join(*state, "null.html");
    td_report_heading(report, "a");
    td_report_text(report, "a");
    td_report_verdict(report, TD_TONE_PLAIN, "a", NULL, 0);
    td_report_figures_begin(report);
    td_report_figure(report, "a", TD_TONE_PLAIN, "a");
    td_report_figures_end(report);
    td_report_table_begin(report, &(const char *){"a"}, 1);
    td_report_cell(report, TD_TONE_PLAIN, "a");
    td_report_row_end(report);
    td_report_table_end(report);
    td_report_grid_begin(report, 2);
    td_report_plot(report, NULL, NULL, 0);
    td_report_picture(report, NULL, 1, "a", NULL, 0);
    td_report_grid_end(report);
    check_fails(td_report_write(report, path, &error), TD_ERROR_MEMORY, error, "null.html");
    td_report_free(&report);
    td_report_free(NULL);
    free(path);

    report = td_report_new(NULL, NULL);
    td_report_heading(report, NULL);
    td_report_verdict(report, (td_tone)77, NULL, NULL, 0);
    td_report_plot(report, NULL, NULL, 0);
    char *text = finish(&report, *state);
    check_well_formed(text);
    find(text, "<title>Report</title>");
    find(text, "no data</text>");
    free(text);
}

#define TEST(function) cmocka_unit_test_setup_teardown(function, scratch_make, scratch_remove)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(test_well_formed_and_deterministic),
        TEST(test_self_contained),
        TEST(test_locale),
        TEST(test_escaping),
        TEST(test_utf8),
        TEST(test_numbers_in_tables),
        TEST(test_positions),
        TEST(test_equal_axes),
        TEST(test_ticks),
        TEST(test_narrow_ranges),
        TEST(test_odd_data),
        TEST(test_missing_values_are_said),
        TEST(test_clipped_line),
        TEST(test_vectors),
        TEST(test_bars),
        TEST(test_names),
        TEST(test_many_values),
        TEST(test_heat),
        TEST(test_picture),
        TEST(test_embedding),
        TEST(test_first_failure_is_kept),
        TEST(test_unwritable),
        TEST(test_null),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
