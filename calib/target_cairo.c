/* A sheet as PDF or in pixels, by cairo. */
#include <cairo-pdf.h>
#include <cairo.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/target_sheet_internal.h"

static const double POINTS = 72 / 25.4; /* in a mm */
enum { MOST_SIDE = 32000 };             /* px, of cairo's images */
static const double MOST_PIXELS = 6e8;
static const double PI = 3.14159265358979323846;

static void add_to_path(cairo_t *cr, const td_shape *s)
{
    if (s->kind == TD_SHAPE_RECTANGLE) {
        cairo_rectangle(cr, s->x, s->y, s->width, s->height);
        return;
    }
    cairo_save(cr);
    cairo_translate(cr, s->x + s->width / 2, s->y + s->height / 2);
    cairo_scale(cr, s->width / 2, s->height / 2);
    cairo_new_sub_path(cr);
    cairo_arc(cr, 0, 0, 1, 0, 2 * PI);
    cairo_restore(cr);
}

/* In an image of alpha alone, ink is opaque and white takes it away. */
static void set_ink(cairo_t *cr, bool light, bool alpha)
{
    cairo_set_operator(cr, light && alpha ? CAIRO_OPERATOR_DEST_OUT : CAIRO_OPERATOR_OVER);
    double grey = light && !alpha ? 1 : 0;
    cairo_set_source_rgb(cr, grey, grey, grey);
}

static void draw_text(cairo_t *cr, const td_sheet_text *t)
{
    cairo_text_extents_t extents;
    cairo_set_font_size(cr, t->size);
    cairo_text_extents(cr, t->text, &extents);
    double shift = t->anchor == TD_ANCHOR_LEFT ? 0 : t->anchor == TD_ANCHOR_MIDDLE ? 0.5 : 1;
    cairo_move_to(cr, t->x - shift * extents.x_advance, t->y);
    cairo_show_text(cr, t->text);
}

static void draw(cairo_t *cr, const td_sheet *sheet, bool alpha)
{
    for (size_t i = 0; i < sheet->shape_count; i++) {
        const td_shape *s = sheet->shape + i;
        add_to_path(cr, s);
        if (i + 1 < sheet->shape_count && s[1].group == s->group) continue;
        set_ink(cr, s->light, alpha);
        cairo_fill(cr);
    }
    set_ink(cr, false, alpha);
    if (!sheet->text_count) return;
    cairo_font_options_t *options = cairo_font_options_create();
    cairo_font_options_set_hint_metrics(options, CAIRO_HINT_METRICS_OFF);
    cairo_font_options_set_hint_style(options, CAIRO_HINT_STYLE_NONE);
    cairo_set_font_options(cr, options);
    cairo_font_options_destroy(options);
    cairo_select_font_face(cr, "monospace", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
    for (size_t i = 0; i < sheet->text_count; i++) draw_text(cr, sheet->text + i);
}

/* cairo's own states last: they hold what went wrong before them. */
static td_status end(cairo_t *cr, cairo_surface_t *surface, td_error *error)
{
    cairo_status_t status = cairo_status(cr);
    cairo_destroy(cr);
    cairo_surface_finish(surface);
    if (status == CAIRO_STATUS_SUCCESS) status = cairo_surface_status(surface);
    if (status == CAIRO_STATUS_SUCCESS) return TD_OK;
    return td_fail(error, status == CAIRO_STATUS_NO_MEMORY ? TD_ERROR_MEMORY : TD_ERROR_EXTERNAL,
                   "the target cannot be drawn: %s", cairo_status_to_string(status));
}

typedef struct stream {
    char *data;
    size_t size, capacity;
} stream;

static cairo_status_t append(void *user, const unsigned char *bytes, unsigned count)
{
    stream *s = user;
    if (s->size + count > s->capacity) {
        size_t wanted = 2 * (s->size + count);
        char *larger = realloc(s->data, wanted);
        if (!larger) return CAIRO_STATUS_NO_MEMORY;
        s->data = larger, s->capacity = wanted;
    }
    memcpy(s->data + s->size, bytes, count);
    s->size += count;
    return CAIRO_STATUS_SUCCESS;
}

td_status td_sheet_to_pdf(char **bytes, size_t *size, const td_sheet *sheet, const char *title,
                          td_error *error)
{
    stream out = {0};
    cairo_surface_t *surface =
        cairo_pdf_surface_create_for_stream(append, &out, sheet->width * POINTS, sheet->height * POINTS);
    cairo_pdf_surface_set_metadata(surface, CAIRO_PDF_METADATA_TITLE, title);
    cairo_pdf_surface_set_metadata(surface, CAIRO_PDF_METADATA_CREATE_DATE, "");
    cairo_t *cr = cairo_create(surface);
    cairo_scale(cr, POINTS, POINTS);
    draw(cr, sheet, false);
    cairo_show_page(cr);
    td_status status = end(cr, surface, error);
    cairo_surface_destroy(surface);
    *bytes = NULL, *size = 0;
    if (status == TD_OK)
        *bytes = out.data, *size = out.size;
    else
        free(out.data);
    return status;
}

/* Ink becomes black. */
static td_status to_grey(td_image **image, cairo_surface_t *surface, td_error *error)
{
    const int width = cairo_image_surface_get_width(surface);
    const int height = cairo_image_surface_get_height(surface);
    const size_t stride = (size_t)cairo_image_surface_get_stride(surface);
    const unsigned char *ink = cairo_image_surface_get_data(surface);
    TD_TRY(td_image_new(image, width, height, 1, error));
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            (*image)->data[(size_t)y * (size_t)width + (size_t)x] =
                (uint8_t)(255 - ink[(size_t)y * stride + (size_t)x]);
    return TD_OK;
}

td_status td_sheet_to_image(td_image **image, const td_sheet *sheet, double scale, td_error *error)
{
    const double width = ceil(sheet->width * scale - 1e-6), height = ceil(sheet->height * scale - 1e-6);
    if (!(width <= MOST_SIDE && height <= MOST_SIDE && width * height <= MOST_PIXELS))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dots_per_inch: the image would have %.0fx%.0f px; choose fewer, or write a PDF",
                       width, height);
    cairo_surface_t *surface = cairo_image_surface_create(CAIRO_FORMAT_A8, (int)width, (int)height);
    cairo_t *cr = cairo_create(surface);
    cairo_set_antialias(cr, CAIRO_ANTIALIAS_BEST);
    cairo_scale(cr, scale, scale);
    draw(cr, sheet, true);
    cairo_surface_flush(surface);
    td_status status = TD_OK;
    if (cairo_status(cr) == CAIRO_STATUS_SUCCESS) status = to_grey(image, surface, error);
    td_status last = end(cr, surface, status == TD_OK ? error : NULL);
    cairo_surface_destroy(surface);
    return status == TD_OK ? last : status;
}
