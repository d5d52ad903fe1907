/* How a sheet is laid out, from the top: white, the target, white, a ruler, text; another ruler on the left.
 * All is laid out as it is to be measured on paper, then divided by what the printer makes of it. */
#include "calib/target_drawing.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/target_sheet_internal.h"
#include "core/file.h"
#include "core/number.h"

static const double MM = 1000, INCH = 0.0254;
static const double EDGE = 5; /* mm at the paper's edge on which printers do not print */
static const double RULER = 8, TICK = 0.15, TICK_LENGTH[] = {1.5, 2.2, 3}, DIGITS = 2.2; /* mm */
static const double TYPE = 2.6, LINE = 3.8, LEAST_TEXT_WIDTH = 80;                       /* mm */
static const double LARGEST_PAGE_M = 10, LEAST_SCALE = 0.8, MOST_SCALE = 1.25, SLACK = 1e-6;
enum { MOST_LINES = 40, LONGEST_TEXT = 12000 };

td_target_drawing_options td_target_drawing_options_default(void)
{
    return (td_target_drawing_options){
        .dots_per_inch = 600, .printer_scale = {1, 1}, .ruler = true, .text = true};
}

/* ---- Layout ---- */

typedef struct layout {
    const td_target *target;
    int plane;
    td_target_drawing_options options;
    td_pattern_box box;
    double width, height; /* of the page */
    double origin[2];     /* of the plane's frame on the page */
    double ruler[2];      /* lengths of the rulers; 0: none */
    double text_y;        /* top of the text */
    int lines;
    char line[MOST_LINES][TD_SHEET_LINE];
} layout;

/* The longest usual length that the target covers. */
static double ruler_length(double side)
{
    static const double usual[] = {300, 250, 200, 150, 100, 50, 40, 30, 20, 10};
    for (size_t i = 0; i < sizeof usual / sizeof *usual; i++)
        if (usual[i] <= side + SLACK) return usual[i];
    return 10;
}

/* Breaks `text` at blanks into lines as wide as the page; false when they are too many. */
static bool wrap(layout *l, const char *text)
{
    size_t width = (size_t)((l->width - 2 * EDGE) / (TYPE * TD_SHEET_ADVANCE));
    if (width > TD_SHEET_LINE - 1) width = TD_SHEET_LINE - 1;
    for (bool first = true; *text; first = false) {
        const size_t indent = first ? 0 : 2;
        size_t length = strlen(text), next;
        if (l->lines == MOST_LINES || width <= indent + 1) return false;
        if (length > width - indent) {
            for (length = width - indent; length > 0 && text[length] != ' ';) length--;
            if (!length) length = width - indent;
        }
        for (next = length; text[next] == ' ';) next++;
        snprintf(l->line[l->lines++], TD_SHEET_LINE, "%*s%.*s", (int)indent, "", (int)length, text);
        text += next;
    }
    return true;
}

static bool write_lines(layout *l)
{
    char *text = malloc(LONGEST_TEXT), what[256], part[48] = "", x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE];
    if (!text) return false;
    const td_target_drawing_options *o = &l->options;
    l->lines = 0;
    if (l->target->kind != TD_TARGET_TAGS && l->target->plane_count > 1)
        snprintf(part, sizeof part, ", plane %d of %d", l->plane + 1, l->target->plane_count);
    snprintf(text, LONGEST_TEXT, "Teledimos target: %s%s", td_target_describe(what, sizeof what, l->target),
             part);
    bool fits = wrap(l, text) && wrap(l, td_target_dataset_line(text, LONGEST_TEXT, l->target));
    if (l->ruler[0] > 0) {
        if (l->ruler[0] == l->ruler[1])
            snprintf(what, sizeof what, "both show %.0f mm", l->ruler[0]);
        else
            snprintf(what, sizeof what, "%.0f mm across and %.0f mm down", l->ruler[0], l->ruler[1]);
        snprintf(
            text, LONGEST_TEXT,
            "Print at 100 %% (not fitted to the page), then measure the rulers: %s. If they differ, draw "
            "again with --measured READING/%.0f,READING/%.0f.",
            what, l->ruler[0], l->ruler[1]);
    } else {
        snprintf(text, LONGEST_TEXT, "Print at 100 %% (not fitted to the page), then measure the target.");
    }
    fits = fits && wrap(l, text);
    if (o->printer_scale[0] != 1 || o->printer_scale[1] != 1) {
        snprintf(text, LONGEST_TEXT,
                 "Corrected for a printer that makes lengths %s (across), %s (down) times as "
                 "large.",
                 td_number_format(x, o->printer_scale[0], 7), td_number_format(y, o->printer_scale[1], 7));
        fits = fits && wrap(l, text);
    }
    free(text);
    return fits;
}

/* Page needed by the target, its white, rulers and text, for text of the layout's width. */
static void needed(double size[2], const layout *l, double quiet)
{
    const double outer = fmax(quiet, EDGE), beside = l->options.ruler ? quiet + RULER + EDGE : outer;
    const double below = l->lines ? LINE * l->lines + (l->options.ruler ? 0 : 1) : 0;
    size[0] = outer + (l->box.x1 - l->box.x0) + beside;
    size[1] = outer + (l->box.y1 - l->box.y0) +
              (l->options.ruler || l->lines ? quiet + (l->options.ruler ? RULER : 0) + below + EDGE : outer);
}

static td_status check_options(const td_target_drawing_options *o, td_error *error)
{
    const double *page[2] = {&o->page_width_m, &o->page_height_m};
    static const char *const name[2] = {"page_width_m", "page_height_m"};
    for (int i = 0; i < 2; i++) {
        if (!(*page[i] >= 0 && *page[i] <= LARGEST_PAGE_M))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: is %g metres, but must lie between 0 and %g",
                           name[i], *page[i], LARGEST_PAGE_M);
        if (!(o->printer_scale[i] >= LEAST_SCALE && o->printer_scale[i] <= MOST_SCALE))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "printer_scale[%d]: is %g, but must lie between %g and %g: the measured length over "
                "the nominal one",
                i, o->printer_scale[i], LEAST_SCALE, MOST_SCALE);
    }
    if (!(o->margin_m >= 0 && o->margin_m <= LARGEST_PAGE_M))
        return td_fail(error, TD_ERROR_ARGUMENT, "margin_m: is %g metres, but must lie between 0 and %g",
                       o->margin_m, LARGEST_PAGE_M);
    if (!(o->dots_per_inch >= 1 && o->dots_per_inch <= 10000))
        return td_fail(error, TD_ERROR_ARGUMENT, "dots_per_inch: is %g, but must lie between 1 and 10000",
                       o->dots_per_inch);
    return TD_OK;
}

static td_status begin(layout *l, const td_target *target, int plane,
                       const td_target_drawing_options *options, td_error *error)
{
    *l = (layout){.target = target,
                  .plane = plane,
                  .options = options ? *options : td_target_drawing_options_default()};
    TD_TRY(td_target_check(target, error));
    TD_TRY(check_options(&l->options, error));
    const int planes = target->kind == TD_TARGET_TAGS ? target->tag_count : target->plane_count;
    if (plane < 0 || plane >= planes)
        return td_fail(error, TD_ERROR_ARGUMENT, "plane: is %d, but the target's last is %d", plane,
                       planes - 1);
    td_pattern_measure(&l->box, target, plane);
    return TD_OK;
}

/* Least page of the given width (0: any), as it is to measure when printed. */
static td_status measure_page(double size[2], layout *l, td_error *error)
{
    const td_target_drawing_options *o = &l->options;
    const double quiet = fmax(l->box.quiet, o->margin_m * MM);
    needed(size, l, quiet);
    l->width = o->page_width_m > 0 ? o->page_width_m * o->printer_scale[0] * MM : size[0];
    if (o->text && !(o->page_width_m > 0)) l->width = fmax(l->width, LEAST_TEXT_WIDTH);
    l->ruler[0] = o->ruler ? ruler_length(l->box.x1 - l->box.x0) : 0;
    l->ruler[1] = o->ruler ? ruler_length(l->box.y1 - l->box.y0) : 0;
    if (o->text && !write_lines(l))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "the page is too narrow for the target's text; choose a wider one or leave the text out");
    needed(size, l, quiet);
    if (!(o->page_width_m > 0)) size[0] = l->width;
    return TD_OK;
}

td_status td_target_page_needed(double size_m[2], const td_target *target, int plane,
                                const td_target_drawing_options *options, td_error *error)
{
    layout l;
    double size[2];
    TD_TRY(begin(&l, target, plane, options, error));
    TD_TRY(measure_page(size, &l, error));
    for (int i = 0; i < 2; i++) size_m[i] = size[i] / l.options.printer_scale[i] / MM;
    return TD_OK;
}

static td_status lay_out(layout *l, const td_target *target, int plane,
                         const td_target_drawing_options *options, td_error *error)
{
    double size[2];
    char what[256];
    TD_TRY(begin(l, target, plane, options, error));
    TD_TRY(measure_page(size, l, error));
    const td_target_drawing_options *o = &l->options;
    const double page[2] = {o->page_width_m * MM * o->printer_scale[0],
                            o->page_height_m * MM * o->printer_scale[1]};
    if ((page[0] > 0 && size[0] > page[0] + SLACK) || (page[1] > 0 && size[1] > page[1] + SLACK))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s needs %.1f x %.1f mm with its margin%s%s, but the page has %.1f x %.1f mm",
                       td_target_describe(what, sizeof what, target), size[0], size[1],
                       o->ruler ? ", rulers" : "", o->text ? ", text" : "", o->page_width_m * MM,
                       o->page_height_m * MM);
    l->width = page[0] > 0 ? page[0] : size[0];
    l->height = page[1] > 0 ? page[1] : size[1];
    const double quiet = fmax(l->box.quiet, o->margin_m * MM), outer = fmax(quiet, EDGE);
    double least[2];
    needed(least, l, quiet);
    const double left = (o->ruler ? quiet + RULER + EDGE : outer) + (l->width - least[0]) / 2;
    const double top = outer + (l->height - least[1]) / 2;
    l->origin[0] = left - l->box.x0, l->origin[1] = top - l->box.y0;
    l->text_y = l->height - EDGE - LINE * l->lines;
    return TD_OK;
}

/* ---- Drawing ---- */

static void mark(td_sheet *sheet, int group, double x, double y, double width, double height)
{
    td_sheet_add(sheet, (td_shape){TD_SHAPE_RECTANGLE, false, group, x, y, width, height});
}

/* Ticks every millimetre, numbers every centimetre or five; `down`: along y, its ticks to the left of x. */
static void draw_ruler(td_sheet *sheet, double x, double y, double length, bool down)
{
    const int group = td_sheet_group(sheet), last = (int)length, numbers = last > 50 ? 50 : 10;
    char text[16];
    for (int i = 0; i <= last; i++) {
        const double tick = TICK_LENGTH[i % 10 == 0 ? 2 : i % 5 == 0 ? 1 : 0], at = i - TICK / 2;
        if (down)
            mark(sheet, group, x - tick, y + at, tick, TICK);
        else
            mark(sheet, group, x + at, y, TICK, tick);
        if (i % numbers) continue;
        snprintf(text, sizeof text, "%d%s", i, i == last && !down ? " mm" : "");
        if (down)
            td_sheet_write(sheet, x - TICK_LENGTH[2] - 0.5, y + i + 0.35 * DIGITS, DIGITS, TD_ANCHOR_RIGHT,
                           text);
        else
            td_sheet_write(sheet, x + i, y + TICK_LENGTH[2] + DIGITS, DIGITS, TD_ANCHOR_MIDDLE, text);
    }
    if (down)
        mark(sheet, group, x - TICK, y - TICK / 2, TICK, length + TICK);
    else
        mark(sheet, group, x - TICK / 2, y, length + TICK, TICK);
}

/* From the layout's millimetres to those on paper. */
static void shrink(td_sheet *sheet, const double scale[2])
{
    sheet->width /= scale[0], sheet->height /= scale[1];
    for (size_t i = 0; i < sheet->shape_count; i++) {
        td_shape *s = &sheet->shape[i];
        s->x /= scale[0], s->width /= scale[0], s->y /= scale[1], s->height /= scale[1];
    }
    for (size_t i = 0; i < sheet->text_count; i++)
        sheet->text[i].x /= scale[0], sheet->text[i].y /= scale[1], sheet->text[i].size /= scale[0];
}

static td_status fill_sheet(td_sheet *sheet, const layout *l, td_error *error)
{
    const double quiet = fmax(l->box.quiet, l->options.margin_m * MM);
    TD_TRY(td_pattern_draw(sheet, l->target, l->plane, error));
    for (size_t i = 0; i < sheet->shape_count; i++)
        sheet->shape[i].x += l->origin[0], sheet->shape[i].y += l->origin[1];
    if (l->options.ruler) {
        const double x = l->origin[0] + l->box.x0, y = l->origin[1] + l->box.y0;
        draw_ruler(sheet, x, l->origin[1] + l->box.y1 + quiet, l->ruler[0], false);
        draw_ruler(sheet, x - quiet, y, l->ruler[1], true);
    }
    for (int i = 0; i < l->lines; i++)
        td_sheet_write(sheet, EDGE, l->text_y + LINE * (i + 1) - 0.3 * LINE, TYPE, TD_ANCHOR_LEFT,
                       l->line[i]);
    sheet->width = l->width, sheet->height = l->height;
    shrink(sheet, l->options.printer_scale);
    return sheet->failed ? td_fail(error, TD_ERROR_MEMORY, "no memory for the drawing") : TD_OK;
}

/* The sheet, to be freed even on failure, and its layout. */
static td_status make(td_sheet *sheet, layout *l, const td_target *target, int plane,
                      const td_target_drawing_options *options, td_error *error)
{
    *sheet = (td_sheet){0};
    TD_TRY(lay_out(l, target, plane, options, error));
    return fill_sheet(sheet, l, error);
}

static double pixels_per_metre(const layout *l)
{
    return round(l->options.dots_per_inch / INCH);
}

td_status td_target_render(td_image **image, double pixel_from_target[6], const td_target *target, int plane,
                           const td_target_drawing_options *options, td_error *error)
{
    td_sheet sheet;
    layout l;
    *image = NULL;
    td_status status = make(&sheet, &l, target, plane, options, error);
    if (status == TD_OK) {
        const double scale = pixels_per_metre(&l);
        for (int i = 0; i < 2; i++) {
            double *row = pixel_from_target + 3 * i, shrunk = l.options.printer_scale[i];
            row[0] = row[1] = 0;
            row[i] = scale / shrunk;
            row[2] = l.origin[i] / MM * scale / shrunk - 0.5;
        }
        status = td_sheet_to_image(image, &sheet, scale / MM, error);
    }
    td_sheet_free(&sheet);
    return status;
}

/* CRC of a PNG chunk (ISO 3309). */
static uint32_t crc(const uint8_t *bytes, size_t size)
{
    uint32_t c = 0xffffffff;
    for (size_t i = 0; i < size; i++) {
        c ^= bytes[i];
        for (int k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >> 1) : c >> 1;
    }
    return ~c;
}

static void put_32(uint8_t *at, uint32_t value)
{
    for (int i = 0; i < 4; i++) at[i] = (uint8_t)(value >> (24 - 8 * i));
}

/* Puts a chunk with the size of pixels behind the PNG's header, which is 33 bytes long: programs then print
 * it at its true size. */
static td_status add_scale(uint8_t **png, size_t *size, double per_metre, td_error *error)
{
    enum { HEADER = 33, CHUNK = 21 };
    uint8_t *larger = realloc(*png, *size + CHUNK);
    if (!larger) return td_fail(error, TD_ERROR_MEMORY, "no memory for the drawing");
    uint8_t *chunk = larger + HEADER;
    memmove(chunk + CHUNK, chunk, *size - HEADER);
    put_32(chunk, 9);
    memcpy(chunk + 4, "pHYs", 4);
    put_32(chunk + 8, (uint32_t)per_metre);
    put_32(chunk + 12, (uint32_t)per_metre);
    chunk[16] = 1; /* the metre */
    put_32(chunk + 17, crc(chunk + 4, 13));
    *png = larger, *size += CHUNK;
    return TD_OK;
}

static td_status to_png(char **bytes, size_t *size, const td_sheet *sheet, const layout *l, td_error *error)
{
    td_image *image = NULL;
    uint8_t *png = NULL;
    td_status status = td_sheet_to_image(&image, sheet, pixels_per_metre(l) / MM, error);
    if (status == TD_OK) status = td_image_encode_png(&png, size, image, error);
    if (status == TD_OK) status = add_scale(&png, size, pixels_per_metre(l), error);
    td_image_free(&image);
    if (status != TD_OK) free(png);
    *bytes = status == TD_OK ? (char *)png : NULL;
    return status;
}

td_status td_target_draw(const char *path, const td_target *target, int plane,
                         const td_target_drawing_options *options, td_error *error)
{
    static const char *const endings[] = {".svg", ".pdf", ".png"};
    const size_t length = strlen(path);
    size_t kind = 0, size = 0;
    while (kind < 3 && (length < 5 || strcmp(path + length - 4, endings[kind]) != 0)) kind++;
    if (kind == 3)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: a target's file ends in .svg, .pdf or .png", path);
    td_sheet sheet;
    layout l;
    char *bytes = NULL, title[256];
    td_status status = make(&sheet, &l, target, plane, options, error);
    if (status == TD_OK) {
        td_target_describe(title, sizeof title, target);
        status = kind == 0   ? td_sheet_to_svg(&bytes, &size, &sheet, title, error)
                 : kind == 1 ? td_sheet_to_pdf(&bytes, &size, &sheet, title, error)
                             : to_png(&bytes, &size, &sheet, &l, error);
    }
    if (status == TD_OK) status = td_file_write(path, bytes, size, error);
    free(bytes);
    td_sheet_free(&sheet);
    return status;
}
