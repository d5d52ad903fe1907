/* A report for people: one HTML file with its pictures and plots inside, readable without a network,
 * printable.
 *
 * Built from top to bottom; the first failure is kept and returned by td_report_write, so that a builder
 * needs no checks of its own: every function but td_report_write does nothing on NULL, and nothing more after
 * a failure. What is begun must be ended; in a row of figures, a table or a grid nothing else may be given.
 * All text given is escaped, and what is not UTF-8 in it made harmless. The same calls give the same bytes.
 */
#ifndef TELEDIMOS_CORE_REPORT_H
#define TELEDIMOS_CORE_REPORT_H

#include <stddef.h>

#include "image.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_report td_report;

typedef enum td_tone { TD_TONE_PLAIN, TD_TONE_GOOD, TD_TONE_WARN, TD_TONE_BAD } td_tone;

/* NULL: out of memory. */
TD_API td_report *td_report_new(const char *title, const char *subtitle);
TD_API void td_report_free(td_report **report);

TD_API void td_report_heading(td_report *report, const char *text);
TD_API void td_report_text(td_report *report, const char *format, ...) TD_PRINTF(2, 3);
/* The verdict's box: a word in its tone, and sentences below it; several become a list. */
TD_API void td_report_verdict(td_report *report, td_tone tone, const char *word, const char *const *sentence,
                              size_t count);

/* A row of figures: large value, small label. "nan" and "inf" are shown as – and ∞, as in cells. */
TD_API void td_report_figures_begin(td_report *report);
TD_API void td_report_figure(td_report *report, const char *label, td_tone tone, const char *format, ...)
    TD_PRINTF(4, 5);
TD_API void td_report_figures_end(td_report *report);

/* A table: cells of a row are given one by one, the first is the row's head. Columns of numbers (with units,
 * "0.2 ± 0.1", "3 / 12") are right-aligned. `columns` has `count` heads. Readers can sort a table of four
 * rows or more. */
TD_API void td_report_table_begin(td_report *report, const char *const *columns, size_t count);
TD_API void td_report_cell(td_report *report, td_tone tone, const char *format, ...) TD_PRINTF(3, 4);
TD_API void td_report_row_end(td_report *report);
TD_API void td_report_table_end(td_report *report);

/* What is drawn over an image or in a plot. Values that are not finite, and marks outside the view, are left
 * out, and a note below says how many. Of series of thousands of values, those that would hide one another
 * are drawn once (a note says so too): the file stays small, and nothing that stands alone is lost. */
typedef enum td_shape { TD_SHAPE_POINT, TD_SHAPE_CROSS, TD_SHAPE_LINE, TD_SHAPE_BAR } td_shape;
typedef struct td_series {
    const char *label; /* for the legend; NULL: none */
    td_shape shape;    /* POINT, CROSS: at x, y. LINE: joins them. BAR: from 0 to y at x */
    td_tone tone;      /* PLAIN series get the palette's colours in turn */
    size_t count;
    const double *x, *y;   /* (count) */
    const double *dx, *dy; /* (count) vectors drawn from x, y, in addition to the shape; NULL: none */
    double vector_scale;   /* by which dx, dy are drawn longer (the legend says "×50"); 0: 1 */
} td_series;

/* A field under the series, in colour, its scale beside it. It fills the axes' range, which must be given. */
typedef struct td_heat {
    int columns, rows;   /* values stand evenly from edge to edge; at least 2 of each */
    const double *value; /* (rows,columns), the first row at y_min; not finite: left grey */
    double low, high;    /* where the colours begin and end; low = high: from the values */
    const char *label;   /* with the unit: "sigma (px)" */
} td_heat;

typedef struct td_axes {
    const char *title, *x_label, *y_label;
    double x_min, x_max, y_min, y_max; /* min = max: from the data */
    int equal;                         /* one unit is as long in x as in y */
    int y_down;                        /* as in images */
    const char *const *x_names;        /* names at x = 0, 1, …; NULL: numbers */
    size_t x_name_count;
    const td_heat *heat; /* NULL: none */
} td_axes;

/* A plot as SVG; `axes` NULL: all from the data. Labels hold the unit: "time (s)". */
TD_API void td_report_plot(td_report *report, const td_axes *axes, const td_series *series, size_t count);
/* An image (embedded as JPEG, shrunk to at most `max_width` px wide; 0: 640) with series over it in its
 * pixels, (0, 0) being the centre of the first. A click enlarges it. */
TD_API void td_report_picture(td_report *report, const td_image *image, int max_width, const char *caption,
                              const td_series *series, size_t count);
/* Plots and pictures given in between stand side by side, in 1–6 columns, fewer on a narrow screen. */
TD_API void td_report_grid_begin(td_report *report, int columns);
TD_API void td_report_grid_end(td_report *report);

/* Ends the file and writes it, whole or not at all. The report stays as it is, and may be written elsewhere
 * again. */
TD_API td_status td_report_write(td_report *report, const char *path, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
