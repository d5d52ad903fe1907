/* Plots: ranges, ticks at 1, 2 and 5 times a power of ten, axes with names or numbers, and the series between
 * them.
 *
 * A drawing is laid out in pixels of a desktop screen and shrinks with its column. On a phone its text is set
 * larger instead (core/report_style.c), so the layout leaves each character the room that it needs there. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/report_internal.h"

enum { NAME_CHARACTERS = 20, LABEL_TRIES = 4, SCALE_WIDTH = 14 };

/* Room for marks on the edge of the axes, px. */
static const double spill = 3;
/* A range narrower than this share of its values is one value: doubles would not fill it. */
static const double least_share = 1e-9;

/* How a plot is drawn for the width of its column. */
typedef struct plot_format {
    const char *class_name;
    double width, height, tall; /* px: whole width; height of the axes, and at most with equal units */
    double line;                /* px: the height of a line */
    double glyph, name_glyph;   /* px: the width of a character, and of one of a name */
} plot_format;

static const plot_format formats[] = {{"full", 860, 340, 560, 24, 13, 10.5},
                                      {"half", 500, 320, 440, 19, 9, 8},
                                      {"third", 350, 260, 320, 17, 8.3, 8}};

typedef struct axis {
    double min, max;
    double length; /* px */
    int mantissa;  /* ticks at k · mantissa · 10^exponent, first ≤ k ≤ last */
    int exponent;
    long long first, last;
    int factor;               /* labels count in 10^factor */
    const char *const *names; /* NULL: numbers */
    size_t name_count;
    bool rotated; /* names are */
} axis;

typedef struct layout {
    const plot_format *format;
    axis x, y;
    double left, top, width, height; /* of the axes, px */
    double total_width, total_height;
    double y_label; /* px: where the y axis' label stands */
    double bar_gap; /* between bars, in x; 0: there are none */
    bool empty;     /* nothing can be drawn */
    axis heat;      /* of the scale beside a field; length 0: there is none */
    double heat_x;  /* px: where the scale stands */
} layout;

/* --- ranges --- */

/* The least distance of consecutive bars: so wide, all series together, can bars be. 0: there are no bars. */
static double bar_gap(const td_axes *axes, const td_series *series, size_t count)
{
    double gap = 0;
    for (size_t i = 0; i < count; i++) {
        const td_series *s = series + i;
        if (s->shape != TD_SHAPE_BAR) continue;
        for (size_t k = 1; k < s->count; k++) {
            double step = fabs(s->x[k] - s->x[k - 1]);
            if (td_drawable(s->x[k]) && td_drawable(s->x[k - 1]) && step > 0 && (gap == 0 || step < gap))
                gap = step;
        }
        if (axes->x_names || (gap == 0 && s->count)) gap = 1;
        if (axes->x_names) break;
    }
    return gap;
}

static void widen(double range[2], double value)
{
    if (!td_drawable(value)) return;
    range[0] = fmin(range[0], value);
    range[1] = fmax(range[1], value);
}

/* The range of what can be drawn; range[0] > range[1] when there is nothing. */
static void data_range(double x[2], double y[2], const td_series *series, size_t count, double gap)
{
    x[0] = y[0] = INFINITY;
    x[1] = y[1] = -INFINITY;
    for (size_t i = 0; i < count; i++) {
        const td_series *s = series + i;
        double scale = td_series_vector_scale(s), half = s->shape == TD_SHAPE_BAR ? gap / 2 : 0;
        for (size_t k = 0; k < s->count; k++) {
            if (!td_drawable(s->x[k]) || !td_drawable(s->y[k])) continue;
            widen(x, s->x[k] - half);
            widen(x, s->x[k] + half);
            widen(y, s->y[k]);
            if (s->shape == TD_SHAPE_BAR) widen(y, 0);
            if (!s->dx) continue;
            double tip[2] = {s->x[k] + scale * s->dx[k], s->y[k] + scale * s->dy[k]};
            if (!td_drawable(tip[0]) || !td_drawable(tip[1])) continue;
            widen(x, tip[0]);
            widen(y, tip[1]);
        }
    }
}

static bool is_range(double min, double max)
{
    double size = fmax(fabs(min), fabs(max));
    return td_drawable(min) && td_drawable(max) && max - min > size * least_share && max - min > 1e-290;
}

/* The axis' range: the caller's, or the data's with a margin. */
static void settle_range(axis *a, const double data[2], double min, double max, double margin)
{
    a->min = min;
    a->max = max;
    if (is_range(min, max)) return;
    a->min = data[0];
    a->max = data[1];
    if (data[0] > data[1]) {
        a->min = 0;
        a->max = 1;
    } else if (is_range(data[0], data[1])) {
        double more = margin * (data[1] - data[0]);
        /* An axis of values of one sign does not cross 0 for the margin's sake. */
        a->min = data[0] >= 0 ? fmax(0, data[0] - more) : data[0] - more;
        a->max = data[1] <= 0 ? fmin(0, data[1] + more) : data[1] + more;
    } else {
        double middle = data[0] / 2 + data[1] / 2, half = fabs(middle) > 1e-280 ? 0.1 * fabs(middle) : 1;
        a->min = middle - half;
        a->max = middle + half;
    }
}

/* --- ticks --- */

/* The finest step of 1, 2 or 5 times a power of ten whose ticks stand at least `spacing` px apart. */
static void plan_ticks(axis *a, double spacing)
{
    double target = (a->max - a->min) * fmin(1, spacing / a->length);
    a->exponent = (int)floor(log10(target));
    double power = pow(10, a->exponent);
    a->mantissa = target <= power * (1 + 1e-9) ? 1 : target <= 2 * power ? 2 : target <= 5 * power ? 5 : 10;
    if (a->mantissa == 10) {
        a->mantissa = 1;
        a->exponent++;
    }
    double step = a->mantissa * pow(10, a->exponent);
    a->first = llround(ceil(a->min / step - 1e-6));
    a->last = llround(floor(a->max / step + 1e-6));
    int largest = (int)floor(log10(fmax(fabs(a->min), fabs(a->max))));
    bool plain = largest >= -4 && largest <= 5 && a->exponent >= -6;
    a->factor = plain ? 0 : 3 * (int)floor(largest / 3.);
}

static double tick_value(const axis *a, long long k)
{
    double n = (double)(k * a->mantissa);
    return a->exponent < 0 ? n / pow(10, -a->exponent) : n * pow(10, a->exponent);
}

/* Exact, by integers: the tick is k · mantissa · 10^(exponent - factor). */
static void tick_label(char text[48], const axis *a, long long k)
{
    long long n = llabs(k * a->mantissa);
    int decimals = a->factor - a->exponent;
    const char *sign = k < 0 ? "−" : "";
    if (n == 0) decimals = decimals < 0 ? 0 : decimals;
    for (; decimals < 0; decimals++) n *= 10;
    long long unit = 1;
    for (int i = 0; i < decimals; i++) unit *= 10;
    if (decimals == 0)
        snprintf(text, 48, "%s%lld", sign, n);
    else
        snprintf(text, 48, "%s%lld.%0*lld", sign, n / unit, decimals, n % unit);
}

static size_t longest_label(const axis *a)
{
    size_t longest = 0;
    for (long long k = a->first; k <= a->last; k++) {
        char text[48];
        tick_label(text, a, k);
        size_t length = td_markup_length(text);
        if (length > longest) longest = length;
    }
    return longest;
}

/* Names stand at the whole numbers: every one, or as many as have room. */
static double plan_names(axis *a, const plot_format *f)
{
    double slot = a->length / (a->max - a->min);
    size_t longest = 0;
    a->first = llround(fmin(fmax(ceil(a->min), 0), (double)a->name_count));
    a->last = llround(fmin(fmax(floor(a->max), -1), (double)a->name_count - 1));
    for (long long k = a->first; k <= a->last; k++) {
        size_t length = td_markup_length(a->names[k]);
        if (length > longest) longest = length;
    }
    if (longest > NAME_CHARACTERS) longest = NAME_CHARACTERS;
    a->rotated = (double)(longest + 1) * f->name_glyph > slot;
    a->mantissa = 1;
    /* Slanted at 45°, names lie √2 of a line's height apart. */
    static const int every[] = {1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000};
    for (size_t i = 0; i < sizeof every / sizeof *every && a->mantissa * slot < 1.1 * f->line; i++)
        a->mantissa = every[i];
    return (double)longest * f->name_glyph;
}

/* Numbers along x; their number shrinks until the labels stand apart. */
static void plan_numbers(axis *a, const plot_format *f)
{
    double spacing = 5 * f->glyph;
    for (int i = 0; i < LABEL_TRIES; i++) {
        plan_ticks(a, spacing);
        double needed = (double)(longest_label(a) + 2) * f->glyph;
        if (needed <= spacing) break;
        spacing = needed;
    }
}

/* --- layout --- */

/* Widens the shorter axis until the box is neither a thread nor a tower. */
static void limit_shape(axis *x, axis *y)
{
    double x_span = x->max - x->min, y_span = y->max - y->min;
    axis *narrow = x_span < 0.5 * y_span ? x : x_span > 4 * y_span ? y : NULL;
    if (!narrow) return;
    double more = ((narrow == x ? 0.5 * y_span : x_span / 4) - (narrow->max - narrow->min)) / 2;
    narrow->min -= more;
    narrow->max += more;
}

/* The room left of the axes: the label and the longest number. */
static double left_margin(const layout *l, const td_axes *axes)
{
    const plot_format *f = l->format;
    return (axes->y_label || l->y.factor ? f->line + 4 : 4) + (double)longest_label(&l->y) * f->glyph + 8;
}

/* Plans names along x; returns the room that they take below the axes. */
static double place_names(layout *l)
{
    double longest = 0.71 * plan_names(&l->x, l->format), slot = l->width / (l->x.max - l->x.min);
    if (!l->x.rotated) return l->format->line + 8;
    /* The first name reaches out to the left. */
    double overhang = longest - l->left - slot * ((double)l->x.first - l->x.min);
    if (overhang > 0) {
        l->left += overhang;
        l->width = l->x.length = fmax(l->width - overhang, 60);
    }
    return longest + 0.8 * l->format->line + 6;
}

/* The scale beside a field; returns the room that it takes. Its labels' width does not depend on its height
 * by more than a character, so any will do here. */
static double plan_heat(layout *l, const td_axes *axes, double height)
{
    if (!axes->heat) return 0;
    const plot_format *f = l->format;
    td_heat_range(&l->heat.min, &l->heat.max, axes->heat);
    l->heat.length = height;
    plan_ticks(&l->heat, 1.9 * f->line);
    double label = axes->heat->label || l->heat.factor ? f->line + 4 : 0;
    return 2 * SCALE_WIDTH + (double)(longest_label(&l->heat) + 1) * f->glyph + label;
}

static void plan_layout(layout *l, const td_axes *axes, const td_series *series, size_t count,
                        const plot_format *f)
{
    *l = (layout){.format = f, .top = 10, .bar_gap = bar_gap(axes, series, count)};
    double x[2], y[2], right = 2.5 * f->glyph;
    data_range(x, y, series, count, l->bar_gap);
    l->empty = x[0] > x[1];
    l->x.names = axes->x_names;
    l->x.name_count = axes->x_names ? axes->x_name_count : 0;
    if (l->x.name_count) {
        widen(x, -0.5);
        widen(x, (double)l->x.name_count - 0.5);
    }
    settle_range(&l->x, x, axes->x_min, axes->x_max, l->bar_gap > 0 || l->x.name_count ? 0 : 0.04);
    settle_range(&l->y, y, axes->y_min, axes->y_max, 0.06);
    if (axes->equal) limit_shape(&l->x, &l->y);

    /* With equal units the height follows from the width, and that from the labels of the highest plot. */
    l->height = f->height;
    l->y.length = axes->equal ? f->tall : f->height;
    plan_ticks(&l->y, 1.9 * f->line);
    l->left = left_margin(l, axes);
    double scale_room = plan_heat(l, axes, l->y.length);
    l->width = f->width - l->left - right - scale_room;
    if (axes->equal) {
        double scale = fmin(l->width / (l->x.max - l->x.min), f->tall / (l->y.max - l->y.min));
        l->width = scale * (l->x.max - l->x.min);
        l->y.length = l->height = scale * (l->y.max - l->y.min);
        plan_ticks(&l->y, 1.9 * f->line);
    }
    l->x.length = l->width;
    double below = f->line + 8, label = l->left - 0.75 * f->line;
    if (l->x.name_count)
        below = place_names(l);
    else
        plan_numbers(&l->x, f);
    l->y_label = l->left - label;
    l->heat_x = l->left + l->width + SCALE_WIDTH;
    if (axes->heat) plan_heat(l, axes, l->height);
    l->total_width = l->left + l->width + right + scale_room;
    l->total_height = l->top + l->height + below + (axes->x_label || l->x.factor ? f->line : 0) + 2;
}

/* --- drawing --- */

static double at(const axis *a, double value, bool reversed)
{
    double share = (value - a->min) / (a->max - a->min);
    return a->length * (reversed ? 1 - share : share);
}

static void add_line(td_text *m, const double from[2], char command, double length)
{
    td_markup_point(m, 'M', from);
    td_text_add(m, &command, 1);
    td_markup_coordinate(m, length);
}

/* Whether a line of 0 is worth drawing: inside, and clear of the frame. */
static bool is_within(double position, double length)
{
    return position > 8 && position < length - 8;
}

static void add_grid(td_text *m, const layout *l, bool y_up)
{
    td_markup_raw(m, "<path class=\"lines\" d=\"");
    for (long long k = l->y.first; k <= l->y.last; k++) {
        double from[2] = {l->left, l->top + at(&l->y, tick_value(&l->y, k), y_up)};
        add_line(m, from, 'h', l->width);
    }
    for (long long k = l->x.first; k <= l->x.last && !l->x.name_count; k++) {
        double from[2] = {l->left + at(&l->x, tick_value(&l->x, k), false), l->top};
        add_line(m, from, 'v', l->height);
    }
    td_markup_raw(m, "\"/><path class=\"frame\" d=\"");
    td_markup_point(m, 'M', (double[]){l->left, l->top});
    td_markup_raw(m, "h");
    td_markup_coordinate(m, l->width);
    td_markup_raw(m, "v");
    td_markup_coordinate(m, l->height);
    td_markup_raw(m, "h");
    td_markup_coordinate(m, -l->width);
    td_markup_raw(m, "z\"/><path class=\"zero\" d=\"");
    double zero[2] = {l->x.name_count ? 0 : at(&l->x, 0, false), at(&l->y, 0, y_up)};
    if (is_within(zero[1], l->height)) add_line(m, (double[]){l->left, l->top + zero[1]}, 'h', l->width);
    if (is_within(zero[0], l->width)) add_line(m, (double[]){l->left + zero[0], l->top}, 'v', l->height);
    td_markup_raw(m, "\"/>\n");
}

/* `end`: the text's attributes behind its place. */
static void begin_text(td_text *m, double x, double y, const char *end)
{
    td_markup_raw(m, "<text x=\"");
    td_markup_coordinate(m, x);
    td_markup_raw(m, "\" y=\"");
    td_markup_coordinate(m, y);
    td_text_format(m, "\"%s>", end);
}

static void add_number_labels(td_text *m, const layout *l, bool y_up)
{
    char text[48];
    td_markup_raw(m, "<g class=\"end\">");
    for (long long k = l->y.first; k <= l->y.last; k++) {
        tick_label(text, &l->y, k);
        begin_text(m, l->left - 8, l->top + at(&l->y, tick_value(&l->y, k), y_up), " dy=\".35em\"");
        td_markup_raw(m, text);
        td_markup_raw(m, "</text>");
    }
    td_markup_raw(m, "</g>\n<g class=\"mid\">");
    for (long long k = l->x.first; k <= l->x.last && !l->x.name_count; k++) {
        tick_label(text, &l->x, k);
        begin_text(m, l->left + at(&l->x, tick_value(&l->x, k), false), l->top + l->height + 7,
                   " dy=\".9em\"");
        td_markup_raw(m, text);
        td_markup_raw(m, "</text>");
    }
    td_markup_raw(m, "</g>\n");
}

static void add_names(td_text *m, const layout *l)
{
    if (!l->x.name_count) return;
    td_text_format(m, "<g class=\"names %s\">", l->x.rotated ? "end" : "mid");
    for (long long k = l->x.first; k <= l->x.last; k += l->x.mantissa) {
        double x = l->left + at(&l->x, (double)k, false), y = l->top + l->height + 7;
        if (l->x.rotated) {
            td_markup_raw(m, "<text transform=\"translate(");
            td_markup_point(m, 0, (double[]){x, y});
            td_markup_raw(m, ") rotate(-45)\" dy=\".6em\">");
        } else {
            begin_text(m, x, y, " dy=\".9em\"");
        }
        td_markup_text_cut(m, l->x.names[k], NAME_CHARACTERS);
        td_markup_raw(m, "</text>");
    }
    td_markup_raw(m, "</g>\n");
}

/* An axis' label, and the power of ten in which its numbers count. */
static void add_axis_label(td_text *m, const char *label, int factor, double room, const plot_format *f)
{
    td_markup_text_cut(m, label, (size_t)fmax(room / (0.8 * f->glyph), 8));
    if (!factor) return;
    static const char *const superscript[] = {"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
    char digits[16];
    snprintf(digits, sizeof digits, "%d", abs(factor));
    td_markup_raw(m, label ? " · 10" : "10");
    td_markup_raw(m, factor < 0 ? "⁻" : "");
    for (const char *d = digits; *d; d++) td_markup_raw(m, superscript[*d - '0']);
}

static void add_axis_labels(td_text *m, const layout *l, const td_axes *axes)
{
    if (axes->x_label || l->x.factor) {
        begin_text(m, l->left + l->width / 2, l->total_height - 0.3 * l->format->line, " class=\"mid name\"");
        add_axis_label(m, axes->x_label, l->x.factor, l->total_width, l->format);
        td_markup_raw(m, "</text>\n");
    }
    if (axes->y_label || l->y.factor) {
        td_markup_raw(m, "<text class=\"mid name\" transform=\"translate(");
        td_markup_point(m, 0, (double[]){l->y_label, l->top + l->height / 2});
        td_markup_raw(m, ") rotate(-90)\">");
        add_axis_label(m, axes->y_label, l->y.factor, l->height + 40, l->format);
        td_markup_raw(m, "</text>\n");
    }
}

/* The field over the grid and under the series, and its scale. */
static void add_heat(td_report *report, const layout *l, const td_axes *axes)
{
    td_text *m = &report->body;
    char text[48];
    const plot_format *f = l->format;
    td_heat_draw(report, axes->heat, (double[]){l->left, l->top, l->width, l->height}, !axes->y_down);
    td_heat_scale(report, (double[]){l->heat_x, l->top, SCALE_WIDTH, l->height});
    td_markup_raw(m, "<g class=\"start\">");
    for (long long k = l->heat.first; k <= l->heat.last; k++) {
        tick_label(text, &l->heat, k);
        begin_text(m, l->heat_x + SCALE_WIDTH + 5, l->top + at(&l->heat, tick_value(&l->heat, k), true),
                   " dy=\".35em\"");
        td_markup_raw(m, text);
        td_markup_raw(m, "</text>");
    }
    td_markup_raw(m, "</g>\n");
    if (!axes->heat->label && !l->heat.factor) return;
    td_markup_raw(m, "<text class=\"mid name\" transform=\"translate(");
    td_markup_point(m, 0, (double[]){l->total_width - 0.5 * f->line, l->top + l->height / 2});
    td_markup_raw(m, ") rotate(-90)\">");
    add_axis_label(m, axes->heat->label, l->heat.factor, l->height + 40, f);
    td_markup_raw(m, "</text>\n");
}

static void add_data(td_text *m, td_drawn *drawn, const layout *l, bool y_up, const td_series *series,
                     size_t count)
{
    double x_scale = l->width / (l->x.max - l->x.min), y_scale = l->height / (l->y.max - l->y.min);
    size_t bars = 0;
    for (size_t i = 0; i < count; i++) bars += series[i].shape == TD_SHAPE_BAR;
    td_view view = {.x_scale = x_scale,
                    .x_offset = -l->x.min * x_scale,
                    .y_scale = y_up ? -y_scale : y_scale,
                    .y_offset = y_up ? l->y.max * y_scale : -l->y.min * y_scale,
                    .width = l->width,
                    .height = l->height,
                    .unit = 1,
                    .bar_width = bars ? fmin(fmax(0.8 * l->bar_gap * x_scale / (double)bars, 0.75), 48) : 0};
    td_markup_raw(m, "<svg x=\"");
    td_markup_coordinate(m, l->left - spill);
    td_markup_raw(m, "\" y=\"");
    td_markup_coordinate(m, l->top - spill);
    td_markup_raw(m, "\" width=\"");
    td_markup_coordinate(m, l->width + 2 * spill);
    td_markup_raw(m, "\" height=\"");
    td_markup_coordinate(m, l->height + 2 * spill);
    td_markup_raw(m, "\" viewBox=\"");
    td_markup_point(m, 0, (double[]){-spill, -spill});
    td_markup_point(m, ' ', (double[]){l->width + 2 * spill, l->height + 2 * spill});
    td_markup_raw(m, "\">\n");
    td_series_draw(m, drawn, &view, series, count);
    td_markup_raw(m, "</svg>\n");
    if (!l->empty || l->heat.length > 0) return;
    begin_text(m, l->left + l->width / 2, l->top + l->height / 2, " class=\"mid\"");
    td_markup_raw(m, "no data</text>\n");
}

static void describe_axis(td_text *m, char name, const char *label, const axis *a)
{
    td_text_format(m, "%c axis: ", name);
    td_markup_text(m, label);
    if (a->name_count) {
        td_text_format(m, "%s%zu names. ", label ? ", " : "", a->name_count);
        return;
    }
    td_markup_raw(m, label ? ", from " : "from ");
    td_markup_value(m, a->min);
    td_markup_raw(m, " to ");
    td_markup_value(m, a->max);
    td_markup_raw(m, ". ");
}

static void begin_figure(td_text *m, const layout *l, const td_axes *axes, const td_series *series,
                         size_t count)
{
    td_text_format(m, "<figure class=\"plot %s\">\n<figcaption>", l->format->class_name);
    if (axes->title) {
        td_markup_raw(m, "<p class=\"caption\">");
        td_markup_text(m, axes->title);
        td_markup_raw(m, "</p>\n");
    }
    td_series_legend(m, series, count);
    td_markup_raw(m, "</figcaption>\n<svg class=\"drawing\" role=\"img\" viewBox=\"0 0");
    td_markup_point(m, ' ', (double[]){l->total_width, l->total_height});
    /* A little larger than laid out at most: beyond, the text would shout. */
    td_markup_raw(m, "\" style=\"max-width:");
    td_markup_coordinate(m, 1.2 * l->total_width);
    td_markup_raw(m, "px\">\n<title>");
    td_markup_text(m, axes->title ? axes->title : "Plot");
    td_markup_raw(m, "</title>\n<desc>");
    describe_axis(m, 'x', axes->x_label, &l->x);
    describe_axis(m, 'y', axes->y_label, &l->y);
    td_markup_raw(m, "Drawn: ");
    td_series_describe(m, series, count);
    td_markup_raw(m, "</desc>\n");
}

void td_report_plot(td_report *report, const td_axes *axes, const td_series *series, size_t count)
{
    if (!td_report_takes_figure(report, "a plot")) return;
    if (!td_series_check(report, "a plot", series, count)) return;
    const td_axes none = {0};
    if (!axes) axes = &none;
    const td_heat *heat = axes->heat;
    if (heat && (heat->columns < 2 || heat->rows < 2 || !heat->value || !is_range(axes->x_min, axes->x_max) ||
                 !is_range(axes->y_min, axes->y_max))) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "a plot: a field needs 2x2 values and the axes' range");
        return;
    }
    bool y_up = !axes->y_down;
    const plot_format *f = formats + (report->grid_columns > 2 ? 2 : report->grid_columns - 1);
    layout l;
    plan_layout(&l, axes, series, count, f);

    td_text *m = &report->body;
    td_drawn drawn = {0};
    begin_figure(m, &l, axes, series, count);
    add_grid(m, &l, y_up);
    if (axes->heat) add_heat(report, &l, axes);
    add_number_labels(m, &l, y_up);
    add_names(m, &l);
    add_axis_labels(m, &l, axes);
    add_data(m, &drawn, &l, y_up, series, count);
    td_markup_raw(m, "</svg>\n");
    td_series_note(m, &drawn);
    td_markup_raw(m, "</figure>\n");
}
