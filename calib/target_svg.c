/* A sheet as SVG, 1 user unit to the mm: plain rectangles, ellipses and text, which cutters and editors take
 * as they are. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/target_sheet_internal.h"
#include "core/number.h"

typedef struct writer {
    char *data;
    size_t size, capacity;
    bool failed;
} writer;

static void put(writer *w, const char *format, ...) TD_PRINTF(2, 3);
static void put(writer *w, const char *format, ...)
{
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    const size_t length = (size_t)vsnprintf(NULL, 0, format, arguments);
    if (w->size + length + 1 > w->capacity) {
        size_t wanted = 2 * (w->size + length + 1);
        char *larger = realloc(w->data, wanted);
        if (larger) w->data = larger, w->capacity = wanted;
        w->failed = w->failed || !larger;
    }
    if (!w->failed) w->size += (size_t)vsnprintf(w->data + w->size, w->capacity - w->size, format, again);
    va_end(again);
    va_end(arguments);
}

/* mm to a nanometre, without zeros behind the point. */
static const char *number(char text[TD_NUMBER_SIZE], double mm)
{
    td_number_format(text, round(mm * 1e6) / 1e6 + 0.0, 12);
    size_t length = strlen(text);
    if (length > 2 && !strcmp(text + length - 2, ".0")) text[length - 2] = 0;
    return text;
}

static void put_escaped(writer *w, const char *text)
{
    for (; *text; text++) switch (*text) {
        case '<':
            put(w, "&lt;");
            break;
        case '&':
            put(w, "&amp;");
            break;
        default:
            put(w, "%c", *text);
        }
}

static void put_ellipse(writer *w, const td_shape *s)
{
    char x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE], rx[TD_NUMBER_SIZE], ry[TD_NUMBER_SIZE];
    put(w, "<ellipse cx=\"%s\" cy=\"%s\" rx=\"%s\" ry=\"%s\"", number(x, s->x + s->width / 2),
        number(y, s->y + s->height / 2), number(rx, s->width / 2), number(ry, s->height / 2));
}

static void put_rectangle(writer *w, const td_shape *s)
{
    char x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE], width[TD_NUMBER_SIZE], height[TD_NUMBER_SIZE];
    put(w, "<rect x=\"%s\" y=\"%s\" width=\"%s\" height=\"%s\"", number(x, s->x), number(y, s->y),
        number(width, s->width), number(height, s->height));
}

/* Several rectangles as one path. */
static void put_path(writer *w, const td_shape *s, size_t count)
{
    char x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE], right[TD_NUMBER_SIZE], low[TD_NUMBER_SIZE];
    put(w, "<path d=\"");
    for (size_t i = 0; i < count; i++)
        put(w, "%sM%s %sH%sV%sH%sZ", i ? " " : "", number(x, s[i].x), number(y, s[i].y),
            number(right, s[i].x + s[i].width), number(low, s[i].y + s[i].height), x);
    put(w, "\"");
}

static void put_shapes(writer *w, const td_sheet *sheet)
{
    for (size_t i = 0, count; i < sheet->shape_count; i += count) {
        const td_shape *s = sheet->shape + i;
        for (count = 1; i + count < sheet->shape_count && s[count].group == s->group;) count++;
        if (count > 1)
            put_path(w, s, count);
        else if (s->kind == TD_SHAPE_ELLIPSE)
            put_ellipse(w, s);
        else
            put_rectangle(w, s);
        put(w, "%s/>\n", s->light ? " fill=\"white\"" : "");
    }
}

static void put_text(writer *w, const td_sheet_text *t)
{
    static const char *const anchor[] = {"start", "middle", "end"};
    char x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE], size[TD_NUMBER_SIZE];
    put(w, "<text x=\"%s\" y=\"%s\" font-size=\"%s\" text-anchor=\"%s\">", number(x, t->x), number(y, t->y),
        number(size, t->size), anchor[t->anchor]);
    put_escaped(w, t->text);
    put(w, "</text>\n");
}

td_status td_sheet_to_svg(char **bytes, size_t *size, const td_sheet *sheet, const char *title,
                          td_error *error)
{
    writer w = {0};
    char width[TD_NUMBER_SIZE], height[TD_NUMBER_SIZE];
    number(width, sheet->width), number(height, sheet->height);
    put(&w,
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" "
        "width=\"%smm\" height=\"%smm\" viewBox=\"0 0 %s %s\">\n<title>",
        width, height, width, height);
    put_escaped(&w, title);
    put(&w, "</title>\n<rect width=\"%s\" height=\"%s\" fill=\"white\"/>\n<g fill=\"black\">\n", width,
        height);
    put_shapes(&w, sheet);
    put(&w, "</g>\n<g fill=\"black\" font-family=\"'DejaVu Sans Mono', monospace\">\n");
    for (size_t i = 0; i < sheet->text_count; i++) put_text(&w, sheet->text + i);
    put(&w, "</g>\n</svg>\n");
    *bytes = NULL, *size = 0;
    if (w.failed) {
        free(w.data);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the drawing");
    }
    *bytes = w.data, *size = w.size;
    return TD_OK;
}
