#include "core/image.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/file.h"
#include "core/image_internal.h"

enum { WRITE_QUALITY = 95 };

/* The largest file worth reading: a PPM of the largest image at 16 bits, and its header. */
#define MAX_FILE_SIZE ((size_t)TD_IMAGE_MAX_PIXELS * 6 + 65536)

td_status td_image_check_size(uint64_t width, uint64_t height, const char *name, td_error *error)
{
    if (width < 1 || height < 1)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is %llu x %llu pixels: it has none", name,
                       (unsigned long long)width, (unsigned long long)height);
    if (width > TD_IMAGE_MAX_SIDE || height > TD_IMAGE_MAX_SIDE || width * height > TD_IMAGE_MAX_PIXELS)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: claims %llu x %llu pixels, more than the limit of %d on a side and %d in all; "
                       "it is damaged, or must be cut into tiles",
                       name, (unsigned long long)width, (unsigned long long)height, TD_IMAGE_MAX_SIDE,
                       TD_IMAGE_MAX_PIXELS);
    return TD_OK;
}

td_status td_image_new(td_image **image, int width, int height, int channels, td_error *error)
{
    *image = NULL;
    if (width < 1 || height < 1 || width > TD_IMAGE_MAX_SIDE || height > TD_IMAGE_MAX_SIDE ||
        (int64_t)width * height > TD_IMAGE_MAX_PIXELS || (channels != 1 && channels != 3))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "an image cannot be %d x %d pixels of %d channels: sides are 1 to %d, at most %d pixels, "
            "channels 1 or 3",
            width, height, channels, TD_IMAGE_MAX_SIDE, TD_IMAGE_MAX_PIXELS);
    td_image *made = malloc(sizeof *made);
    uint8_t *data = calloc((size_t)width * (size_t)height, (size_t)channels);
    if (!made || !data) {
        free(made);
        free(data);
        return td_fail(error, TD_ERROR_MEMORY, "out of memory for an image of %d x %d pixels", width, height);
    }
    *made = (td_image){width, height, channels, data};
    *image = made;
    return TD_OK;
}

void td_image_free(td_image **image)
{
    if (!image || !*image) return;
    free((*image)->data);
    free(*image);
    *image = NULL;
}

/* Grey to colour or back. On failure the image is freed. */
static td_status convert(td_image **image, int channels, td_error *error)
{
    td_image *from = *image, *to;
    size_t count = (size_t)from->width * (size_t)from->height;
    if (from->channels == channels) return TD_OK;
    if (channels == 1) {
        /* ITU-R BT.601 in 16-bit fixed point, in place. */
        for (size_t i = 0; i < count; i++) {
            const uint8_t *p = from->data + 3 * i;
            from->data[i] = (uint8_t)((19595u * p[0] + 38470u * p[1] + 7471u * p[2] + 32768u) >> 16);
        }
        uint8_t *less = realloc(from->data, count);
        if (less) from->data = less;
        from->channels = 1;
        return TD_OK;
    }
    td_status status = td_image_new(&to, from->width, from->height, 3, error);
    if (status == TD_OK)
        for (size_t i = 0; i < count; i++) memset(to->data + 3 * i, from->data[i], 3);
    td_image_free(image);
    *image = to;
    return status;
}

/* ---- PGM and PPM ---- */

typedef struct pnm_header {
    int channels;
    uint64_t width, height, maximum;
    size_t end; /* where the pixels begin */
} pnm_header;

static int is_space(uint8_t c)
{
    return c == ' ' || (c >= '\t' && c <= '\r');
}

/* The next number of the header, behind white space and comments. */
static td_status pnm_number(uint64_t *value, size_t *at, const uint8_t *bytes, size_t size, const char *what,
                            const char *name, td_error *error)
{
    while (*at < size && (is_space(bytes[*at]) || bytes[*at] == '#')) {
        if (bytes[*at] == '#')
            while (*at < size && bytes[*at] != '\n' && bytes[*at] != '\r') ++*at;
        else
            ++*at;
    }
    size_t begin = *at;
    for (*value = 0; *at < size && bytes[*at] >= '0' && bytes[*at] <= '9'; ++*at)
        if (*value < 1000000000) *value = 10 * *value + (uint64_t)(bytes[*at] - '0');
    if (*at == size)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: is truncated: its %zu bytes end within the header; copy it again", name, size);
    if (*at == begin || !is_space(bytes[*at]))
        return td_fail(error, TD_ERROR_FORMAT, "%s: is a damaged PGM or PPM: its %s is not a number", name,
                       what);
    return TD_OK;
}

static td_status pnm_read_header(pnm_header *header, const uint8_t *bytes, size_t size, const char *name,
                                 td_error *error)
{
    size_t at = 2;
    header->channels = bytes[1] == '6' ? 3 : 1;
    TD_TRY(pnm_number(&header->width, &at, bytes, size, "width", name, error));
    TD_TRY(pnm_number(&header->height, &at, bytes, size, "height", name, error));
    TD_TRY(pnm_number(&header->maximum, &at, bytes, size, "largest value", name, error));
    header->end = at + 1;
    if (header->maximum < 1 || header->maximum > 65535)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: is a damaged PGM or PPM: its largest value is not 1 to 65535", name);
    return td_image_check_size(header->width, header->height, name, error);
}

static td_status decode_pnm(td_image **image, const uint8_t *bytes, size_t size, const char *name,
                            td_error *error)
{
    pnm_header header;
    TD_TRY(pnm_read_header(&header, bytes, size, name, error));
    size_t count = (size_t)(header.width * header.height) * (size_t)header.channels;
    size_t need = count * (header.maximum > 255 ? 2 : 1);
    if (size - header.end < need)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: is truncated: %d x %d pixels need %zu bytes, and %zu are there; copy it again",
                       name, (int)header.width, (int)header.height, need, size - header.end);
    TD_TRY(td_image_new(image, (int)header.width, (int)header.height, header.channels, error));
    const uint8_t *from = bytes + header.end;
    const uint32_t maximum = (uint32_t)header.maximum;
    uint32_t largest = 0;
    for (size_t i = 0; i < count; i++) {
        uint32_t value = maximum > 255 ? (uint32_t)from[2 * i] << 8 | from[2 * i + 1] : from[i];
        if (value > largest) largest = value;
        (*image)->data[i] = (uint8_t)((value * 255 + maximum / 2) / maximum);
    }
    if (largest <= maximum) return TD_OK;
    td_image_free(image);
    return td_fail(error, TD_ERROR_FORMAT,
                   "%s: is a damaged PGM or PPM: it holds the value %u, and its header allows %u at most",
                   name, largest, maximum);
}

static td_status encode_pnm(uint8_t **bytes, size_t *size, const td_image *image, td_error *error)
{
    char header[64];
    int length = snprintf(header, sizeof header, "P%d\n%d %d\n255\n", image->channels == 3 ? 6 : 5,
                          image->width, image->height);
    size_t count = (size_t)image->width * (size_t)image->height * (size_t)image->channels;
    *size = (size_t)length + count;
    *bytes = malloc(*size);
    if (!*bytes) return td_fail(error, TD_ERROR_MEMORY, "out of memory for %zu bytes of an image", *size);
    memcpy(*bytes, header, (size_t)length);
    memcpy(*bytes + length, image->data, count);
    return TD_OK;
}

/* ---- Which format ---- */

/* A format that is told apart but not read; both marks must be there. */
typedef struct foreign_format {
    const char *mark;
    size_t length;
    size_t second_at;
    const char *second;
    size_t second_length;
    const char *name;
} foreign_format;

static const foreign_format foreign_formats[] = {
    {"II*\0", 4, 0, "", 0, "TIFF image"},
    {"MM\0*", 4, 0, "", 0, "TIFF image"},
    {"II+\0", 4, 0, "", 0, "TIFF image"},
    {"BM", 2, 6, "\0\0\0\0", 4, "BMP image"},
    {"GIF8", 4, 0, "", 0, "GIF image"},
    {"RIFF", 4, 8, "WEBP", 4, "WebP image"},
    {"%PDF", 4, 0, "", 0, "PDF document"},
    {"\0\0\0\fjP  ", 8, 0, "", 0, "JPEG 2000 image"},
    {"", 0, 4, "ftyp", 4, "HEIF image or MP4 film"},
    {"P1", 2, 0, "", 0, "PBM image"},
    {"P2", 2, 0, "", 0, "PGM image in text form"},
    {"P3", 2, 0, "", 0, "PPM image in text form"},
    {"P4", 2, 0, "", 0, "PBM image"},
    {"P7", 2, 0, "", 0, "PAM image"},
};

static int has_mark(const uint8_t *bytes, size_t size, size_t at, const char *mark, size_t length)
{
    return size >= at + length && memcmp(bytes + at, mark, length) == 0;
}

/* Says what stands there instead of an image. */
static td_status refuse_foreign(const uint8_t *bytes, size_t size, const char *name, td_error *error)
{
    for (size_t i = 0; i < sizeof foreign_formats / sizeof foreign_formats[0]; i++) {
        const foreign_format *f = &foreign_formats[i];
        if (has_mark(bytes, size, 0, f->mark, f->length) &&
            has_mark(bytes, size, f->second_at, f->second, f->second_length))
            return td_fail(error, TD_ERROR_FORMAT, "%s: is a %s; convert it to PNG, JPEG or binary PGM", name,
                           f->name);
    }
    char text[41];
    size_t length = 0;
    while (length < size && length < sizeof text - 1 && bytes[length] >= ' ' && bytes[length] <= '~') {
        text[length] = bytes[length] == '"' ? '\'' : (char)bytes[length];
        length++;
    }
    text[length] = 0;
    if (length >= 4 || length == size)
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: is not an image (starts with text \"%s\"); PNG, JPEG and binary PGM or PPM are read", name,
            text);
    char hex[3 * 8 + 1] = "";
    for (size_t i = 0; i < size && i < 8; i++)
        snprintf(hex + 3 * i, sizeof hex - 3 * i, " %02x", (unsigned)bytes[i]);
    return td_fail(error, TD_ERROR_FORMAT,
                   "%s: is not an image (starts with bytes%s); PNG, JPEG and binary PGM or PPM are read",
                   name, hex);
}

/* True when the bytes, as far as they go, are those of the mark: a file cut within its mark is still told. */
static int begins(const uint8_t *bytes, size_t size, const char *mark, size_t length)
{
    return memcmp(bytes, mark, size < length ? size : length) == 0;
}

td_status td_image_decode(td_image **image, const void *bytes, size_t size, int channels, const char *name,
                          td_error *error)
{
    *image = NULL;
    const uint8_t *b = bytes;
    if (!name) name = "the image";
    if (channels != 1 && channels != 3)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: is asked for with %d channels; an image is read with 1 or 3", name, channels);
    if (size == 0) return td_fail(error, TD_ERROR_FORMAT, "%s: is empty (0 bytes); copy it again", name);
    if (begins(b, size, "\xff\xd8\xff", 3))
        return td_image_decode_jpeg(image, b, size, channels, name, error);
    if (begins(b, size, "\x89PNG", 4))
        TD_TRY(td_image_decode_png(image, b, size, name, error));
    else if (has_mark(b, size, 0, "P5", 2) || has_mark(b, size, 0, "P6", 2))
        TD_TRY(decode_pnm(image, b, size, name, error));
    else
        return refuse_foreign(b, size, name, error);
    return convert(image, channels, error);
}

td_status td_image_read(td_image **image, const char *path, int channels, td_error *error)
{
    char *bytes;
    size_t size;
    *image = NULL;
    TD_TRY(td_file_read(&bytes, &size, path, MAX_FILE_SIZE, error));
    td_status status = td_image_decode(image, bytes, size, channels, path, error);
    free(bytes);
    return status;
}

td_status td_image_write(const char *path, const td_image *image, td_error *error)
{
    const char *dot = strrchr(path, '.');
    uint8_t *bytes = NULL;
    size_t size = 0;
    td_status status;
    if (!dot) dot = "";
    if (strcasecmp(dot, ".png") == 0)
        status = td_image_encode_png(&bytes, &size, image, error);
    else if (strcasecmp(dot, ".jpg") == 0 || strcasecmp(dot, ".jpeg") == 0)
        status = td_image_encode_jpeg(&bytes, &size, image, WRITE_QUALITY, error);
    else if (strcasecmp(dot, image->channels == 3 ? ".ppm" : ".pgm") == 0)
        status = encode_pnm(&bytes, &size, image, error);
    else
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: the name of a %s image must end in .png, .jpg or .%s",
                       path, image->channels == 3 ? "colour" : "grey", image->channels == 3 ? "ppm" : "pgm");
    if (status == TD_OK)
        status = td_file_write(path, bytes, size, error);
    else
        td_error_prefix(error, status, "%s", path);
    free(bytes);
    return status;
}

/* ---- Looking and shrinking ---- */

double td_image_sample(const td_image *image, double x, double y, int c)
{
    /* fmin and fmax give the bound for a NaN too. */
    x = fmin(fmax(x, 0), image->width - 1);
    y = fmin(fmax(y, 0), image->height - 1);
    int x0 = (int)x, y0 = (int)y;
    size_t step = (size_t)image->channels, row = (size_t)image->width * step;
    const uint8_t *p = image->data + (size_t)y0 * row + (size_t)x0 * step + c;
    size_t right = x0 + 1 < image->width ? step : 0, down = y0 + 1 < image->height ? row : 0;
    double u = x - x0, v = y - y0;
    double top = p[0] + u * (p[right] - p[0]), bottom = p[down] + u * (p[down + right] - p[down]);
    return top + v * (bottom - top);
}

/* Averages the blocks whose columns are summed in `sum` (source width, channels) into one row. */
static void average_blocks(uint8_t *row, const uint32_t *sum, int width, int channels, int times)
{
    const int side = 1 << times;
    const uint64_t half = ((uint64_t)1 << (2 * times)) / 2;
    for (int x = 0; x < width; x++)
        for (int c = 0; c < channels; c++) {
            uint64_t total = half;
            const uint32_t *s = sum + (size_t)x * (size_t)(side * channels) + c;
            for (int k = 0; k < side; k++) total += s[k * channels];
            row[x * channels + c] = (uint8_t)(total >> (2 * times));
        }
}

td_status td_image_shrink(td_image **small, const td_image *image, int times, td_error *error)
{
    *small = NULL;
    if (times < 0 || times > 15 || image->width >> times < 1 || image->height >> times < 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "an image of %d x %d pixels cannot be halved %d times",
                       image->width, image->height, times);
    const size_t samples = (size_t)image->width * (size_t)image->channels;
    uint32_t *sum = malloc(samples * sizeof *sum);
    if (!sum) return td_fail(error, TD_ERROR_MEMORY, "out of memory for a row of %d pixels", image->width);
    td_status status =
        td_image_new(small, image->width >> times, image->height >> times, image->channels, error);
    for (int y = 0; status == TD_OK && y < (*small)->height; y++) {
        /* One rounding at the end, so that the mean stays true however often it is halved. */
        memset(sum, 0, samples * sizeof *sum);
        for (int k = 0; k < 1 << times; k++) {
            const uint8_t *from = image->data + ((size_t)y << times) * samples + (size_t)k * samples;
            for (size_t i = 0; i < samples; i++) sum[i] += from[i];
        }
        average_blocks((*small)->data + (size_t)y * (size_t)((*small)->width * (*small)->channels), sum,
                       (*small)->width, image->channels, times);
    }
    free(sum);
    return status;
}
