/* Quadrangles and their codes by libapriltag (Wang and Olson 2016), given families of our own making, so that
 * any dictionary and either border can be read.
 *
 * In Kalibr's grids dark squares touch the tags' corners and so join them: the light between the tags falls
 * into pieces and no tag has one outline. A second search in the image whose light parts were widened by a
 * pixel parts them; the corners are moved back by as much.
 *
 * libapriltag's threshold is half way between the darkest and the lightest pixel near by. Where the sky
 * behind a tag in the shade is twice as light as the tag's own rim, that threshold runs through the rim, and
 * the tag is lost, or its outline is wrong by pixels. The search is therefore done in the logarithm of the
 * light, where half way means a ratio. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <apriltag/apriltag.h>

#include "calib/tags_internal.h"

/* Where libapriltag counts pixels from: the centre of the first is at (0.5, 0.5). */
static const double PIXEL_CENTRE = 0.5;

static const double DARK = 16; /* grey levels: below that it is as good as linear, for there noise is large */

enum { LEAST_SIDE = 16, MOST_WIDENED = 2, WRONG_BITS = 1 }; /* px; px; corrected by libapriltag */

bool td_tag_list_add(tag_list *list, const td_tag *tag)
{
    if (list->count == list->capacity) {
        size_t capacity = 2 * list->capacity + 16;
        td_tag *more = realloc(list->tag, capacity * sizeof *more);
        if (!more) return false;
        list->tag = more;
        list->capacity = capacity;
    }
    list->tag[list->count++] = *tag;
    return true;
}

int td_tag_side(const tag_codes *codes, int border)
{
    return codes->side + 2 * border;
}

/* ---- a family ---- */

static void free_family(apriltag_family_t *f)
{
    free(f->codes);
    free(f->bit_x);
    free(f->bit_y);
    *f = (apriltag_family_t){0};
}

/* libapriltag turns a code by a quarter by shifting it: bits stand quarter by quarter, each the former turned
 * clockwise, an odd code's middle last. */
static void order_bits(apriltag_family_t *f, int side, int border)
{
    uint32_t quarter = (uint32_t)(side * side / 4), n = 0;
    for (int y = 0; y < (side + 1) / 2; y++)
        for (int x = y; x < side - 1 - y; x++, n++) {
            int at[2] = {x, y};
            for (uint32_t k = 0; k < 4; k++) {
                f->bit_x[n + k * quarter] = (uint32_t)(at[0] + border);
                f->bit_y[n + k * quarter] = (uint32_t)(at[1] + border);
                int turned = side - 1 - at[1];
                at[1] = at[0];
                at[0] = turned;
            }
        }
    if (side % 2) f->bit_x[4 * quarter] = f->bit_y[4 * quarter] = (uint32_t)(side / 2 + border);
}

static bool make_family(apriltag_family_t *f, const tag_codes *codes, int border, char *name)
{
    const int side = codes->side;
    const uint32_t bits = (uint32_t)(side * side);
    *f = (apriltag_family_t){.ncodes = (uint32_t)codes->count,
                             .width_at_border = td_tag_side(codes, border),
                             .total_width = td_tag_side(codes, border) + 2,
                             .nbits = bits,
                             .name = name};
    f->codes = calloc(f->ncodes, sizeof *f->codes);
    f->bit_x = calloc(bits, sizeof *f->bit_x);
    f->bit_y = calloc(bits, sizeof *f->bit_y);
    if (!f->codes || !f->bit_x || !f->bit_y) return false;
    order_bits(f, side, border);
    for (uint32_t id = 0; id < f->ncodes; id++)
        for (uint32_t i = 0; i < bits; i++) {
            uint32_t at = (f->bit_y[i] - (uint32_t)border) * (uint32_t)side + f->bit_x[i] - (uint32_t)border;
            f->codes[id] = f->codes[id] << 1 | (codes->code[id] >> (bits - 1 - at) & 1);
        }
    return true;
}

/* ---- the image that is searched ---- */

/* log(1 + grey / DARK), 0 to 255. */
static void take_logarithm(uint8_t *out, const uint8_t *in, size_t pixels)
{
    uint8_t of[256];
    for (int i = 0; i < 256; i++) of[i] = (uint8_t)lround(255 * log1p(i / DARK) / log1p(255 / DARK));
    for (size_t i = 0; i < pixels; i++) out[i] = of[in[i]];
}

/* The largest of each pixel and its eight neighbours. */
static void widen(uint8_t *out, const uint8_t *in, int width, int height)
{
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            uint8_t most = 0;
            for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < height; j++)
                for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < width; i++)
                    if (in[(size_t)j * (size_t)width + (size_t)i] > most)
                        most = in[(size_t)j * (size_t)width + (size_t)i];
            out[(size_t)y * (size_t)width + (size_t)x] = most;
        }
}

/* Moves the sides of a clockwise quadrangle outwards, as far as they went inwards when light was widened by
 * `by` px: the farther along a diagonal. */
static void move_sides_out(double corner[8], double by)
{
    double line[4][3], moved[8]; /* normal (outwards), distance */
    for (int i = 0; i < 4; i++) {
        const double *a = corner + 2 * i, *b = corner + 2 * ((i + 1) % 4);
        double x = b[1] - a[1], y = a[0] - b[0], length = hypot(x, y);
        if (!(length > 0)) return;
        x /= length, y /= length;
        line[i][0] = x, line[i][1] = y;
        line[i][2] = x * a[0] + y * a[1] + by * (fabs(x) + fabs(y));
    }
    for (int i = 0; i < 4; i++) { /* corner i lies on sides i - 1 and i */
        const double *p = line[(i + 3) % 4], *q = line[i], det = p[0] * q[1] - p[1] * q[0];
        if (!(fabs(det) > 1e-3)) return;
        moved[2 * i] = (p[2] * q[1] - p[1] * q[2]) / det;
        moved[2 * i + 1] = (p[0] * q[2] - p[2] * q[0]) / det;
    }
    memcpy(corner, moved, sizeof moved);
}

/* ---- the search ---- */

static void centre_of(double centre[2], const double corner[8])
{
    for (int c = 0; c < 2; c++) centre[c] = (corner[c] + corner[2 + c] + corner[4 + c] + corner[6 + c]) / 4;
}

static bool is_known(const tag_list *list, const td_tag *tag)
{
    double here[2], there[2];
    centre_of(here, tag->corner);
    double reach = hypot(here[0] - tag->corner[0], here[1] - tag->corner[1]) / 2;
    for (size_t i = 0; i < list->count; i++) {
        centre_of(there, list->tag[i].corner);
        if (hypot(here[0] - there[0], here[1] - there[1]) < reach) return true;
    }
    return false;
}

static bool detect(tag_list *list, apriltag_detector_t *detector, uint8_t *pixels, const td_image *grey,
                   const tag_codes *codes, int widened)
{
    image_u8_t image = {.width = grey->width, .height = grey->height, .stride = grey->width, .buf = pixels};
    zarray_t *found = apriltag_detector_detect(detector, &image);
    bool enough = true;
    for (int i = 0; found && i < zarray_size(found); i++) {
        apriltag_detection_t *d;
        zarray_get(found, i, &d);
        td_tag tag = {.id = d->id, .border = (d->family->width_at_border - codes->side) / 2};
        for (int k = 0; k < 4; k++) { /* libapriltag begins at the lower left and goes round the other way */
            tag.corner[2 * k] = d->p[3 - k][0] - PIXEL_CENTRE;
            tag.corner[2 * k + 1] = d->p[3 - k][1] - PIXEL_CENTRE;
        }
        if (widened) move_sides_out(tag.corner, widened);
        if (!is_known(list, &tag) && td_tag_is_of_border(grey, &tag, codes)) {
            tag.wrong_bits = d->hamming;
            enough = enough && td_tag_list_add(list, &tag);
        }
    }
    if (found) apriltag_detections_destroy(found);
    return enough;
}

/* `work` has room for two images. */
static bool search(tag_list *list, const td_image *image, const tag_codes *codes,
                   apriltag_detector_t *detector, uint8_t *work, size_t enough)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    uint8_t *now = work, *before = work + pixels;
    take_logarithm(now, image->data, pixels);
    for (int widened = 0; widened <= MOST_WIDENED && list->count < enough; widened++) {
        if (widened) {
            uint8_t *swap = before;
            before = now;
            now = swap;
            widen(now, before, image->width, image->height);
        }
        if (!detect(list, detector, now, image, codes, widened)) return false;
    }
    return true;
}

td_status td_tags_search(tag_list *list, const td_image *image, const tag_codes *codes, int border,
                         size_t enough, td_error *error)
{
    char name[2][8] = {"border1", "border2"};
    apriltag_family_t family[2] = {{0}};
    if (image->width < LEAST_SIDE || image->height < LEAST_SIDE) return TD_OK;
    apriltag_detector_t *detector = apriltag_detector_create();
    uint8_t *work = malloc(2 * (size_t)image->width * (size_t)image->height);
    bool ok = detector && work;
    for (int k = 0; k < 2 && ok; k++) {
        if (border && border != k + 1) continue;
        ok = make_family(&family[k], codes, k + 1, name[k]);
        if (ok) apriltag_detector_add_family_bits(detector, &family[k], codes->side > 4 ? WRONG_BITS : 0);
        ok = ok && family[k].impl;
    }
    if (ok) {
        detector->nthreads = 1;
        detector->quad_decimate = 1;
        ok = search(list, image, codes, detector, work, enough);
    }
    for (int k = 0; k < 2; k++) {
        if (detector && family[k].impl) apriltag_detector_remove_family(detector, &family[k]);
        free_family(&family[k]);
    }
    if (detector) apriltag_detector_destroy(detector);
    free(work);
    return ok ? TD_OK
              : td_fail(error, TD_ERROR_MEMORY, "no memory to look for tags in an image of %dx%d",
                        image->width, image->height);
}
