/* Pictures: an image shrunk to the report's size, embedded, with series over it in the image's own pixels. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/report_internal.h"

enum { DEFAULT_WIDTH = 640, QUALITY = 85, PAGE_WIDTH = 1000 };

/* fmin and fmax are calls, for the sake of NaN. */
static double lesser(double a, double b)
{
    return a < b ? a : b;
}

static double greater(double a, double b)
{
    return a > b ? a : b;
}

/* One row of the result, as sums weighted by the share that each pixel of the image has in it. */
static void average_rows(double *sum, const td_image *image, double from, double to)
{
    size_t length = (size_t)image->width * (size_t)image->channels;
    memset(sum, 0, length * sizeof *sum);
    for (int y = (int)from; y < image->height && y < to; y++) {
        double share = (lesser(to, y + 1) - greater(from, y)) / (to - from);
        const uint8_t *row = image->data + (size_t)y * length;
        for (size_t i = 0; i < length; i++) sum[i] += share * row[i];
    }
}

static void average_columns(uint8_t *row, int width, const double *sum, const td_image *image)
{
    double step = (double)image->width / width;
    for (int x = 0; x < width; x++)
        for (int c = 0; c < image->channels; c++) {
            double from = x * step, to = from + step, value = 0;
            for (int k = (int)from; k < image->width && k < to; k++)
                value += (lesser(to, k + 1) - greater(from, k)) * sum[k * image->channels + c];
            row[x * image->channels + c] = (uint8_t)(lesser(greater(value / step, 0), 255) + 0.5);
        }
}

/* Shrinks by averaging over the area of each new pixel, to any width: what is small and bright stays visible,
 * and the picture spans what the image spans. */
static td_status shrink(td_image **small, const td_image *image, int width, td_error *error)
{
    int height = (int)fmax(round((double)image->height * width / image->width), 1);
    size_t length = (size_t)image->width * (size_t)image->channels;
    TD_TRY(td_image_new(small, width, height, image->channels, error));
    double *sum = calloc(length, sizeof *sum);
    if (!sum) {
        td_image_free(small);
        return td_fail(error, TD_ERROR_MEMORY, "out of memory for a row of %zu values", length);
    }
    double step = (double)image->height / height;
    for (int y = 0; y < height; y++) {
        average_rows(sum, image, y * step, (y + 1) * step);
        average_columns((*small)->data + (size_t)y * (size_t)width * (size_t)image->channels, width, sum,
                        image);
    }
    free(sum);
    return TD_OK;
}

static td_status add_jpeg(td_text *m, const td_image *image, int width, td_error *error)
{
    td_image *small = NULL;
    unsigned char *bytes = NULL;
    size_t size = 0;
    if (width < image->width) TD_TRY(shrink(&small, image, width, error));
    td_status status = td_image_encode_jpeg(&bytes, &size, small ? small : image, QUALITY, error);
    td_image_free(&small);
    if (status == TD_OK) td_markup_base64(m, bytes, size);
    free(bytes);
    return status;
}

static bool check_picture(td_report *report, const td_image *image, const td_series *series, size_t count)
{
    if (!td_report_takes_figure(report, "a picture")) return false;
    if (!image || !image->data || image->width < 1 || image->height < 1 ||
        (image->channels != 1 && image->channels != 3)) {
        td_report_fail(report, TD_ERROR_ARGUMENT, "a picture is given no image of 1 or 3 channels");
        return false;
    }
    return td_series_check(report, "a picture", series, count);
}

static void add_overlay(td_text *m, td_drawn *drawn, const td_image *image, double shown,
                        const td_series *series, size_t count)
{
    td_view view = {.x_scale = 1,
                    .y_scale = 1,
                    .left = -0.5,
                    .top = -0.5,
                    .width = image->width,
                    .height = image->height,
                    .unit = image->width / shown,
                    .bar_width = 6 * image->width / shown};
    td_series_draw(m, drawn, &view, series, count);
}

void td_report_picture(td_report *report, const td_image *image, int max_width, const char *caption,
                       const td_series *series, size_t count)
{
    if (!check_picture(report, image, series, count)) return;
    td_text *m = &report->body;
    int width = max_width > 0 ? max_width : DEFAULT_WIDTH;
    if (width > image->width) width = image->width;
    bool in_grid = report->place == TD_PLACE_GRID;
    double shown = in_grid ? PAGE_WIDTH / (double)report->grid_columns : fmin(fmax(width, 320), PAGE_WIDTH);

    td_markup_raw(m, "<figure class=\"picture\">\n<figcaption>");
    if (caption) {
        td_markup_raw(m, "<p class=\"caption\">");
        td_markup_text(m, caption);
        td_markup_raw(m, "</p>\n");
    }
    td_series_legend(m, series, count);
    td_markup_raw(
        m,
        "</figcaption>\n<label class=\"zoom\"><input type=\"checkbox\" aria-label=\"Enlarge the picture\"/>"
        "<svg class=\"drawing\" role=\"img\" viewBox=\"-0.5 -0.5");
    td_text_format(m, " %d %d\"", image->width, image->height);
    if (!in_grid) td_text_format(m, " style=\"max-width:%dpx\"", (int)shown);
    td_markup_raw(m, ">\n<title>");
    td_markup_text(m, caption ? caption : "Picture");
    td_text_format(m, "</title>\n<desc>Image of %d by %d pixels. Drawn over it: ", image->width,
                   image->height);
    td_series_describe(m, series, count);
    td_text_format(
        m,
        "</desc>\n<image x=\"-0.5\" y=\"-0.5\" width=\"%d\" height=\"%d\" preserveAspectRatio=\"none\" "
        "href=\"data:image/jpeg;base64,",
        image->width, image->height);
    td_error error = {0};
    td_status status = add_jpeg(m, image, width, &error);
    if (status != TD_OK)
        td_report_fail(report, status, "a picture (%s): %s", caption ? caption : "no caption", error.message);
    td_markup_raw(m, "\"/>\n");
    td_drawn drawn = {0};
    add_overlay(m, &drawn, image, shown, series, count);
    td_markup_raw(m, "</svg></label>\n");
    td_series_note(m, &drawn);
    td_markup_raw(m, "</figure>\n");
}
