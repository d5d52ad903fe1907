/* Series drawn as SVG: points, crosses, lines, bars and vectors, in plots and over pictures; and their
 * legends.
 *
 * The size of the file is bounded by the size of the drawing, not by the data:
 *   marks    of a series with more than MANY_MARKS values stand on a raster of the drawing, one to a cell (of
 * several, the longest vector or else the first): only marks that would cover one another go, never a lone
 * outlier; lines    of more than LINE_VALUES are cut into LINE_RUNS runs of consecutive values, each drawn
 * through its least and greatest x and y in their order; bars     of more than BAR_VALUES likewise, each run
 * by its tallest bar. A series is one path for its marks and one for its vectors; a point is a line of no
 * length with a round cap. */
#include <math.h>
#include <stdlib.h>

#include "core/report_internal.h"

enum {
    FEW_MARKS = 30,
    SOME_MARKS = 1500,
    MANY_MARKS = 5000,
    DENSE_LINE = 2000,
    LINE_VALUES = 8000,
    LINE_RUNS = 2000,
    BAR_VALUES = 4000,
    BAR_RUNS = 2000,
    PALETTE = 7
};

/* Beyond, the difference of two values may overflow. */
static const double drawable_limit = 1e300;

bool td_drawable(double value)
{
    return fabs(value) <= drawable_limit; /* false for NaN */
}

double td_series_vector_scale(const td_series *s)
{
    return td_drawable(s->vector_scale) && s->vector_scale != 0 ? s->vector_scale : 1;
}

bool td_series_check(td_report *report, const char *what, const td_series *series, size_t count)
{
    if (count && !series) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "%s of %zu series is given none", what, count);
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        const td_series *s = series + i;
        if (s->shape > TD_SHAPE_BAR) {
            td_report_fail(report, TD_ERROR_ARGUMENT, "series %zu of %s has an unknown shape", i, what);
            return false;
        }
        if ((s->count && (!s->x || !s->y)) || !s->dx != !s->dy) {
            td_report_fail(report, TD_ERROR_ARGUMENT, "series %zu (%s) of %s lacks %s", i,
                           s->label ? s->label : "no label", what,
                           s->count && (!s->x || !s->y) ? "its x or y" : "one of dx and dy");
            return false;
        }
    }
    return true;
}

/* Where a value falls on the drawing; false when it has no place. */
static bool place(double p[2], const td_view *v, double x, double y)
{
    if (!td_drawable(x) || !td_drawable(y)) return false;
    p[0] = v->x_scale * x + v->x_offset;
    p[1] = v->y_scale * y + v->y_offset;
    return td_drawable(p[0]) && td_drawable(p[1]);
}

/* Whether a mark at p shows: the border is wide enough for marks on the edge. */
static bool is_inside(const td_view *v, const double p[2])
{
    double border = 2 * v->unit;
    return p[0] >= v->left - border && p[0] <= v->left + v->width + border && p[1] >= v->top - border &&
           p[1] <= v->top + v->height + border;
}

/* The end of the vector of value i; false when it has no place. */
static bool place_tip(double tip[2], const td_view *v, const td_series *s, size_t i)
{
    double scale = td_series_vector_scale(s);
    return place(tip, v, s->x[i] + scale * s->dx[i], s->y[i] + scale * s->dy[i]);
}

/* Cuts the segment a–b to the view with a border (Liang and Barsky 1984), so that no coordinate in the file
 * is huge; false when nothing is left. *cut tells whether b moved. */
static bool clip(double a[2], double b[2], bool *cut, const td_view *v)
{
    double border = 12 * v->unit, from = 0, to = 1, d[2] = {b[0] - a[0], b[1] - a[1]};
    const double least[2] = {v->left - border, v->top - border};
    const double most[2] = {v->left + v->width + border, v->top + v->height + border};
    for (int k = 0; k < 2; k++) {
        if (d[k] == 0) {
            if (a[k] < least[k] || a[k] > most[k]) return false;
            continue;
        }
        double t0 = (least[k] - a[k]) / d[k], t1 = (most[k] - a[k]) / d[k];
        from = fmax(from, fmin(t0, t1));
        to = fmin(to, fmax(t0, t1));
    }
    if (from > to) return false;
    *cut = to < 1;
    for (int k = 0; k < 2; k++) {
        /* First b, from the end that is near it; clamped, for with far ends the products lose their digits.
         */
        b[k] = to < 1 ? fmin(fmax(a[k] + to * d[k], least[k]), most[k]) : b[k];
        a[k] = from > 0 ? fmin(fmax(a[k] + from * d[k], least[k]), most[k]) : a[k];
    }
    return true;
}

/* --- lines --- */

/* A polyline drawn value by value. */
typedef struct pen {
    td_text *d, *dots;
    const td_view *view;
    double last[2];
    size_t count;  /* values of this stroke so far */
    bool is_there; /* the path ends at `last` */
} pen;

static void pen_to(pen *p, const double q[2])
{
    double a[2] = {p->last[0], p->last[1]}, b[2] = {q[0], q[1]};
    bool cut = true, visible = p->count && clip(a, b, &cut, p->view);
    if (visible && !p->is_there) td_markup_point(p->d, 'M', a);
    if (visible) td_markup_point(p->d, 'L', b);
    p->is_there = visible && !cut;
    p->count++;
    p->last[0] = q[0];
    p->last[1] = q[1];
}

/* Ends the stroke; one of a single value becomes a dot, so that nothing given is lost. */
static void pen_lift(pen *p)
{
    if (p->count == 1 && is_inside(p->view, p->last)) {
        td_markup_point(p->dots, 'M', p->last);
        td_markup_raw(p->dots, "h0");
    }
    p->count = 0;
    p->is_there = false;
}

/* Draws the values begin … end-1 through those with the least and greatest x and y, in their order. */
static void pen_run(pen *p, const td_series *s, size_t begin, size_t end, size_t *missing)
{
    size_t extreme[4] = {end, end, end, end}; /* of least x, greatest x, least y, greatest y */
    double q[2];
    for (size_t i = begin; i < end; i++) {
        if (!place(q, p->view, s->x[i], s->y[i])) {
            ++*missing;
            continue;
        }
        for (int k = 0; k < 4; k++) {
            const double *v = k < 2 ? s->x : s->y;
            if (extreme[k] == end || (k % 2 ? v[i] > v[extreme[k]] : v[i] < v[extreme[k]])) extreme[k] = i;
        }
    }
    for (size_t i = begin; i < end; i++) {
        bool is_extreme = i == extreme[0] || i == extreme[1] || i == extreme[2] || i == extreme[3];
        if (is_extreme && place(q, p->view, s->x[i], s->y[i])) pen_to(p, q);
    }
}

static void draw_line(td_text *d, td_text *dots, td_drawn *drawn, const td_view *v, const td_series *s)
{
    pen p = {.d = d, .dots = dots, .view = v};
    size_t runs = s->count > LINE_VALUES ? LINE_RUNS : s->count;
    if (runs < s->count) drawn->thinned += s->count;
    for (size_t r = 0; r < runs; r++) {
        size_t missing = 0;
        pen_run(&p, s, s->count * r / runs, s->count * (r + 1) / runs, &missing);
        if (missing) pen_lift(&p);
        drawn->missing += missing;
    }
    pen_lift(&p);
}

/* --- bars --- */

static void draw_bar(td_text *d, td_drawn *drawn, const td_view *v, const double top[2])
{
    double border = 2 * v->unit, width = v->bar_width;
    double base = v->y_offset, least = v->top - border, most = v->top + v->height + border;
    if (top[0] + width / 2 < v->left || top[0] - width / 2 > v->left + v->width) {
        drawn->outside++;
        return;
    }
    const double corner[2] = {top[0] - width / 2, fmin(fmax(base, least), most)};
    td_markup_point(d, 'M', corner);
    td_markup_raw(d, "h");
    td_markup_coordinate(d, width);
    td_markup_raw(d, "V");
    td_markup_coordinate(d, fmin(fmax(top[1], least), most));
    td_markup_raw(d, "h");
    td_markup_coordinate(d, -width);
    td_markup_raw(d, "z");
}

/* `shift`: from x to the bar's middle, for bars of several series beside one another. */
static void draw_bars(td_text *d, td_drawn *drawn, const td_view *v, const td_series *s, double shift)
{
    size_t runs = s->count > BAR_VALUES ? BAR_RUNS : s->count;
    if (runs < s->count) drawn->thinned += s->count;
    for (size_t r = 0; r < runs; r++) {
        double tallest[2] = {0, 0}, p[2];
        bool any = false;
        for (size_t i = s->count * r / runs; i < s->count * (r + 1) / runs; i++) {
            if (!place(p, v, s->x[i], s->y[i])) {
                drawn->missing++;
                continue;
            }
            if (any && fabs(p[1] - v->y_offset) <= fabs(tallest[1] - v->y_offset)) continue;
            tallest[0] = p[0] + shift;
            tallest[1] = p[1];
            any = true;
        }
        if (any) draw_bar(d, drawn, v, tallest);
    }
}

/* --- marks and vectors --- */

/* The drawing's cells, each with the value that stands there (its index + 1; 0: none). */
typedef struct raster {
    size_t *owner;
    size_t columns, rows;
    double cell;
} raster;

static size_t *raster_at(const raster *r, const td_view *v, const double p[2])
{
    /* is_inside() leaves a border of less than a cell on each side. */
    size_t column = (size_t)((p[0] - v->left) / r->cell + 1), row = (size_t)((p[1] - v->top) / r->cell + 1);
    return r->owner + row * r->columns + column;
}

static double vector_length(const td_series *s, size_t i)
{
    double length = s->dx ? hypot(s->dx[i], s->dy[i]) : 0;
    return isfinite(length) ? length : 0;
}

/* Gives each cell to one value of the series. False: no memory. */
static bool raster_fill(raster *r, const td_view *v, const td_series *s)
{
    r->cell = (s->dx || s->shape == TD_SHAPE_CROSS ? 4 : 2) * v->unit;
    r->columns = (size_t)(v->width / r->cell) + 3;
    r->rows = (size_t)(v->height / r->cell) + 3;
    r->owner = calloc(r->columns, r->rows * sizeof *r->owner);
    if (!r->owner) return false;
    double p[2];
    for (size_t i = 0; i < s->count; i++) {
        if (!place(p, v, s->x[i], s->y[i]) || !is_inside(v, p)) continue;
        size_t *owner = raster_at(r, v, p);
        if (*owner == 0 || vector_length(s, i) > vector_length(s, *owner - 1)) *owner = i + 1;
    }
    return true;
}

static void draw_mark(td_text *d, const td_view *v, td_shape shape, const double p[2])
{
    if (shape == TD_SHAPE_CROSS) {
        double h = 4 * v->unit;
        td_markup_point(d, 'M', (double[]){p[0] - h, p[1] - h});
        td_markup_point(d, 'l', (double[]){2 * h, 2 * h});
        td_markup_point(d, 'm', (double[]){-2 * h, 0});
        td_markup_point(d, 'l', (double[]){2 * h, -2 * h});
    } else {
        td_markup_point(d, 'M', p);
        td_markup_raw(d, "h0");
    }
}

static void draw_vector(td_text *d, const td_view *v, const double from[2], const double tip[2])
{
    double a[2] = {from[0], from[1]}, b[2] = {tip[0], tip[1]};
    double along[2] = {tip[0] - from[0], tip[1] - from[1]}, length = hypot(along[0], along[1]);
    bool cut;
    if (!(length > 0.1 * v->unit) || !isfinite(length) || !clip(a, b, &cut, v)) return;
    td_markup_point(d, 'M', a);
    td_markup_point(d, 'L', b);
    if (cut) return;
    /* The head: two strokes back from the tip, 25° to either side. */
    double head = fmin(6.5 * v->unit, 0.45 * length) / length, c = -0.906 * head, s = 0.423 * head;
    td_markup_point(d, 'm', (double[]){c * along[0] - s * along[1], s * along[0] + c * along[1]});
    td_markup_point(d, 'L', b);
    td_markup_point(d, 'l', (double[]){c * along[0] + s * along[1], c * along[1] - s * along[0]});
}

static void draw_marks(td_text *marks, td_text *vectors, td_drawn *drawn, const td_view *v,
                       const td_series *s)
{
    raster r = {0};
    bool has_marks = s->shape == TD_SHAPE_POINT || s->shape == TD_SHAPE_CROSS;
    if (s->count > MANY_MARKS) {
        if (!raster_fill(&r, v, s)) marks->failed = true;
        drawn->thinned += has_marks ? s->count : 0;
    }
    for (size_t i = 0; i < s->count && !marks->failed; i++) {
        double p[2], tip[2];
        bool placed = place(p, v, s->x[i], s->y[i]), inside = placed && is_inside(v, p);
        if (has_marks) {
            drawn->missing += !placed;
            drawn->outside += placed && !inside;
        }
        if (!placed || (inside && r.owner && *raster_at(&r, v, p) != i + 1)) continue;
        if (has_marks && inside) draw_mark(marks, v, s->shape, p);
        if (!s->dx) continue;
        if (place_tip(tip, v, s, i))
            draw_vector(vectors, v, p, tip);
        else
            drawn->missing++;
    }
    free(r.owner);
}

/* --- a series, and what is said of it --- */

/* The class of each series' colour: that of its tone, or the palette's next. */
static char series_class(const td_series *series, size_t index)
{
    switch (series[index].tone) {
    case TD_TONE_GOOD:
        return 'g';
    case TD_TONE_WARN:
        return 'w';
    case TD_TONE_BAD:
        return 'b';
    case TD_TONE_PLAIN:
        break;
    }
    size_t turn = 0;
    for (size_t i = 0; i < index; i++) turn += series[i].tone == TD_TONE_PLAIN;
    return (char)('1' + turn % PALETTE);
}

static const char *mark_class(const td_series *s)
{
    if (s->shape == TD_SHAPE_LINE) return s->count > DENSE_LINE ? "dense" : "line";
    if (s->shape == TD_SHAPE_BAR) return "bar";
    if (s->shape == TD_SHAPE_CROSS) return "cross";
    return s->dx || s->count > SOME_MARKS ? "point many" : s->count > FEW_MARKS ? "point" : "point few";
}

/* Takes `d` over. */
static void add_path(td_text *m, const char *class_name, td_text *d)
{
    if (d->failed) m->failed = true;
    if (d->size && !d->failed) {
        td_text_format(m, "<path class=\"%s\" d=\"", class_name);
        td_text_add(m, d->data, d->size);
        td_markup_raw(m, "\"/>");
    }
    free(d->data);
}

void td_series_draw(td_text *m, td_drawn *drawn, const td_view *view, const td_series *series, size_t count)
{
    size_t bars = 0, bar = 0;
    for (size_t i = 0; i < count; i++) bars += series[i].shape == TD_SHAPE_BAR;
    for (size_t i = 0; i < count && !m->failed; i++) {
        const td_series *s = series + i;
        td_text marks = {0}, vectors = {0}, dots = {0};
        if (s->shape == TD_SHAPE_LINE) draw_line(&marks, &dots, drawn, view, s);
        if (s->shape == TD_SHAPE_BAR)
            draw_bars(&marks, drawn, view, s, ((double)bar++ - 0.5 * (double)(bars - 1)) * view->bar_width);
        if (s->dx || s->shape == TD_SHAPE_POINT || s->shape == TD_SHAPE_CROSS)
            draw_marks(&marks, &vectors, drawn, view, s);
        td_text_format(m, "<g class=\"s c%c\">", series_class(series, i));
        add_path(m, "vector", &vectors);
        add_path(m, mark_class(s), &marks);
        add_path(m, "point", &dots);
        td_markup_raw(m, "</g>\n");
    }
}

static void add_key(td_text *m, const td_series *s, char colour)
{
    td_text_format(m, "<svg class=\"s c%c\" viewBox=\"0 0 24 16\" aria-hidden=\"true\">", colour);
    if (s->dx)
        td_markup_raw(m, "<path class=\"vector\" d=\"M4 12.5L20 4M13.6 3.8L20 4L16.5 9.3\"/>");
    else if (s->shape == TD_SHAPE_LINE)
        td_markup_raw(m, "<path class=\"line\" d=\"M2 8h20\"/>");
    else if (s->shape == TD_SHAPE_BAR)
        td_markup_raw(m, "<path class=\"bar\" d=\"M6 2h12v12h-12z\"/>");
    else if (s->shape == TD_SHAPE_CROSS)
        td_markup_raw(m, "<path class=\"cross\" d=\"M8 4l8 8m-8 0l8-8\"/>");
    else
        td_markup_raw(m, "<path class=\"point few\" d=\"M12 8h0\"/>");
    td_markup_raw(m, "</svg>");
}

/* The label, and by how much vectors are longer. */
static void add_label(td_text *m, const td_series *s)
{
    double scale = td_series_vector_scale(s);
    td_markup_text(m, s->label ? s->label : "vectors");
    if (!s->dx || scale == 1) return;
    td_markup_raw(m, " ×");
    td_markup_value(m, scale);
}

/* Vectors that are drawn longer have an entry always: their scale must be known. */
static bool has_entry(const td_series *s)
{
    return s->label || (s->dx && td_series_vector_scale(s) != 1);
}

void td_series_legend(td_text *m, const td_series *series, size_t count)
{
    bool any = false;
    for (size_t i = 0; i < count; i++) any |= has_entry(series + i);
    if (!any) return;
    td_markup_raw(m, "<ul class=\"legend\">");
    for (size_t i = 0; i < count; i++) {
        if (!has_entry(series + i)) continue;
        td_markup_raw(m, "<li>");
        add_key(m, series + i, series_class(series, i));
        td_markup_raw(m, "<span>");
        add_label(m, series + i);
        td_markup_raw(m, "</span></li>");
    }
    td_markup_raw(m, "</ul>\n");
}

void td_series_describe(td_text *m, const td_series *series, size_t count)
{
    static const char *const noun[] = {"points", "crosses", "line", "bars"};
    for (size_t i = 0; i < count; i++) {
        const td_series *s = series + i;
        if (i) td_markup_raw(m, "; ");
        if (has_entry(s)) {
            add_label(m, s);
            td_markup_raw(m, ", ");
        }
        td_markup_raw(m, s->dx ? "vectors" : noun[s->shape]);
        td_markup_raw(m, " (");
        td_markup_count(m, s->count);
        td_markup_raw(m, s->count == 1 ? " value)" : " values)");
    }
    td_markup_raw(m, count ? "." : "nothing.");
}

static void add_count(td_text *m, size_t count, const char *one, const char *several)
{
    if (!count) return;
    td_markup_count(m, count);
    td_markup_raw(m, count == 1 ? one : several);
}

void td_series_note(td_text *m, const td_drawn *drawn)
{
    if (!drawn->missing && !drawn->outside && !drawn->thinned) return;
    td_markup_raw(m, "<p class=\"note\">");
    add_count(m, drawn->missing, " value is not finite and not drawn. ",
              " values are not finite and not drawn. ");
    add_count(m, drawn->outside, " value lies outside this view. ", " values lie outside this view. ");
    if (drawn->thinned) {
        td_markup_raw(m, "Thinned out: of ");
        td_markup_count(m, drawn->thinned);
        td_markup_raw(m, " values, those that would hide one another are drawn once.");
    }
    td_markup_raw(m, "</p>\n");
}
