/* Fields in colour: viridis (van der Walt and Smith 2015), which orders values for the colour-blind and in
 * grey too. */
#include <math.h>
#include <stdlib.h>

#include "core/report_internal.h"

/* Pixels from one value to the next: enough that a browser need not smooth. */
enum { STEP = 12, MOST_PIXELS = 640, STRIP = 128 };

static void colour(uint8_t rgb[3], double share)
{
    static const double anchor[][3] = {{68, 1, 84},    {71, 44, 122},  {59, 81, 139},
                                       {44, 113, 142}, {33, 144, 141}, {39, 173, 129},
                                       {92, 200, 99},  {170, 220, 50}, {253, 231, 37}};
    const int last = (int)(sizeof anchor / sizeof *anchor) - 1;
    double at = fmin(fmax(share, 0), 1) * last;
    int i = at < last ? (int)at : last - 1;
    for (int c = 0; c < 3; c++)
        rgb[c] = (uint8_t)(anchor[i][c] + (at - i) * (anchor[i + 1][c] - anchor[i][c]) + 0.5);
}

void td_heat_range(double *low, double *high, const td_heat *heat)
{
    *low = heat->low;
    *high = heat->high;
    if (td_drawable(*low) && td_drawable(*high) && *low < *high) return;
    *low = INFINITY;
    *high = -INFINITY;
    for (long i = 0; i < (long)heat->columns * heat->rows; i++) {
        if (!td_drawable(heat->value[i])) continue;
        *low = fmin(*low, heat->value[i]);
        *high = fmax(*high, heat->value[i]);
    }
    if (!(*low <= *high)) *low = 0, *high = 1;
    double least = fmax(1e-9 * fmax(fabs(*low), fabs(*high)), 1e-280);
    if (*high - *low < least) *high = *low + fmax(least, 1e-3 * fabs(*low));
}

static double interpolate(const td_heat *heat, double x, double y)
{
    int i = (int)x, k = (int)y;
    if (i > heat->columns - 2) i = heat->columns - 2;
    if (k > heat->rows - 2) k = heat->rows - 2;
    const double *v = heat->value + (long)k * heat->columns + i, *w = v + heat->columns;
    double a = x - i, b = y - k;
    return (1 - b) * ((1 - a) * v[0] + a * v[1]) + b * ((1 - a) * w[0] + a * w[1]);
}

static void add_image(td_report *report, td_image *image, const double box[4])
{
    td_text *m = &report->body;
    uint8_t *bytes = NULL;
    size_t size;
    td_error error;
    if (td_image_encode_png(&bytes, &size, image, &error) != TD_OK)
        td_report_fail(report, error.status, "%s", error.message);
    static const char *const name[] = {" x=\"", " y=\"", " width=\"", " height=\""};
    td_markup_raw(m, "<image preserveAspectRatio=\"none\"");
    for (int i = 0; i < 4; i++) {
        td_markup_raw(m, name[i]);
        td_markup_coordinate(m, box[i]);
        td_markup_raw(m, "\"");
    }
    td_markup_raw(m, " href=\"data:image/png;base64,");
    if (bytes) td_markup_base64(m, bytes, size);
    td_markup_raw(m, "\"/>\n");
    free(bytes);
    td_image_free(&image);
}

void td_heat_draw(td_report *report, const td_heat *heat, const double box[4], bool y_up)
{
    double low, high;
    td_image *image;
    td_error error;
    td_heat_range(&low, &high, heat);
    int width = STEP * (heat->columns - 1), height = STEP * (heat->rows - 1);
    if (width > MOST_PIXELS) width = MOST_PIXELS;
    if (height > MOST_PIXELS) height = MOST_PIXELS;
    if (td_image_new(&image, width, height, 3, &error) != TD_OK) {
        td_report_fail(report, error.status, "%s", error.message);
        return;
    }
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            uint8_t *pixel = image->data + 3 * ((size_t)y * (size_t)width + (size_t)x);
            double row = (y + 0.5) / height * (heat->rows - 1);
            double value =
                interpolate(heat, (x + 0.5) / width * (heat->columns - 1), y_up ? heat->rows - 1 - row : row);
            if (td_drawable(value))
                colour(pixel, (value - low) / (high - low));
            else
                pixel[0] = pixel[1] = pixel[2] = 150;
        }
    add_image(report, image, box);
}

void td_heat_scale(td_report *report, const double box[4])
{
    td_image *image;
    td_error error;
    if (td_image_new(&image, 1, STRIP, 3, &error) != TD_OK) {
        td_report_fail(report, error.status, "%s", error.message);
        return;
    }
    for (int y = 0; y < STRIP; y++) colour(image->data + (size_t)3 * (size_t)y, 1 - (y + 0.5) / STRIP);
    add_image(report, image, box);
}
