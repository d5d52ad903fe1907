/* What the files of core/report.h share: the markup under construction, the report's state, and the drawing
 * of series. */
#ifndef TELEDIMOS_CORE_REPORT_INTERNAL_H
#define TELEDIMOS_CORE_REPORT_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/report.h"
#include "core/text_internal.h"

/* --- markup (report_markup.c): text that grows, see core/text_internal.h --- */

/* Markup as it is. */
void td_markup_raw(td_text *m, const char *markup);
/* Text, escaped for content and for attributes; bytes that are not UTF-8, and control characters, become
 * U+FFFD. NULL: nothing. */
void td_markup_text(td_text *m, const char *text);
/* The same in `limit` characters at most (2 or more): of a longer text the head and the tail, for names often
 * differ at their end. */
void td_markup_text_cut(td_text *m, const char *text, size_t limit);
/* Characters of a text (not bytes). */
size_t td_markup_length(const char *text);
/* A coordinate with at most two decimals, the same in every locale. `value` is finite and within 1e15. */
void td_markup_coordinate(td_text *m, double value);
/* "x y", with a command of an SVG path before it unless that is 0. */
void td_markup_point(td_text *m, char command, const double p[2]);
/* 12 345 */
void td_markup_count(td_text *m, size_t value);
/* A finite value with four digits, the same in every locale. */
void td_markup_value(td_text *m, double value);
void td_markup_base64(td_text *m, const unsigned char *bytes, size_t size);

/* --- the report (report.c) --- */

typedef enum td_report_place {
    TD_PLACE_BODY,
    TD_PLACE_FIGURES,
    TD_PLACE_TABLE,
    TD_PLACE_GRID
} td_report_place;

struct td_report {
    td_text title, subtitle; /* escaped */
    td_text contents, body;
    td_text cells;    /* of the open table, heads first: for each the tone's number, the text, a 0 */
    size_t columns;   /* of the open table */
    size_t column;    /* cells given of the open row */
    size_t rows;      /* ended rows of the open table */
    size_t headings;  /* so far */
    int grid_columns; /* of the open grid; else 1 */
    bool sortable;    /* a table can be sorted: the file needs the script */
    td_report_place place;
    td_error first; /* the first failure; TD_OK: none */
};

extern const char td_report_style[], td_report_script[];

/* Whether a plot or picture may be added: the report is there, has not failed, and is in the body or a grid.
 */
bool td_report_takes_figure(td_report *report, const char *what);
/* Keeps a failure unless there is one already. */
void td_report_fail(td_report *report, td_status status, const char *format, ...) TD_PRINTF(3, 4);

/* --- series (report_series.c) --- */

/* Where values fall on the drawing: x_scale·x + x_offset, y_scale·y + y_offset. */
typedef struct td_view {
    double x_scale, x_offset, y_scale, y_offset;
    double left, top, width, height; /* the visible box, drawing units */
    double unit;                     /* drawing units to a pixel of the screen: size of marks */
    double bar_width;                /* of one bar, drawing units */
} td_view;

/* What became of the values of a series. */
typedef struct td_drawn {
    size_t missing; /* not finite: not drawn */
    size_t outside; /* marks outside the view: not drawn */
    size_t thinned; /* values of series that were thinned out */
} td_drawn;

/* Whether a value can be drawn: finite, and so far from overflow that differences are finite too. */
bool td_drawable(double value);
/* The factor of a series' vectors: 1 when it was left at 0 or is not finite. */
double td_series_vector_scale(const td_series *s);
/* Refuses series without coordinates or of no known shape. */
bool td_series_check(td_report *report, const char *what, const td_series *series, size_t count);
/* One group of SVG for each series. */
void td_series_draw(td_text *m, td_drawn *drawn, const td_view *view, const td_series *series, size_t count);
/* The legend as an HTML list; nothing when no series has an entry. */
void td_series_legend(td_text *m, const td_series *series, size_t count);
/* "detected, crosses (54 values); …" for the description of a drawing. */
void td_series_describe(td_text *m, const td_series *series, size_t count);
/* What a reader must know of values that are not drawn. */
void td_series_note(td_text *m, const td_drawn *drawn);

/* --- fields (report_heat.c) --- */

/* What the colours span: as asked for, or from the values; low < high. */
void td_heat_range(double *low, double *high, const td_heat *heat);
/* The field as an image of SVG in the box left, top, width, height; the first row at the top, or at the
 * bottom with `y_up`. Keeps a failure in the report. */
void td_heat_draw(td_report *report, const td_heat *heat, const double box[4], bool y_up);
/* A strip of the colours, the highest at the top. */
void td_heat_scale(td_report *report, const double box[4]);

#endif
