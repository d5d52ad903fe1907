/* PNG and JPEG, through libpng and libjpeg. Both report an error by a jump: setjmp stands in a function of
 * its own whose caller owns everything, so that nothing is lost and no variable is left in doubt. */
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>
#include <png.h>

#include <jerror.h>

#include "core/image_internal.h"

enum {
    DEFLATE_RATIO = 1032,  /* zlib cannot pack tighter */
    MAX_JPEG_SCANS = 500,  /* a progressive JPEG has about ten; each costs a pass over the whole image */
    MAX_JPEG_PADDING = 16, /* bytes that some cameras leave behind a scan */
};

static td_status refuse_truncated(const char *name, const char *format, size_t size, td_error *error)
{
    return td_fail(error, TD_ERROR_FORMAT,
                   "%s: is a truncated %s: its %zu bytes end too early; copy it again", name, format, size);
}

static td_status refuse_damaged(const char *name, const char *format, const char *why, td_error *error)
{
    return td_fail(error, TD_ERROR_FORMAT, "%s: is a damaged %s (%s); copy it again", name, format, why);
}

/* A short file that claims a vast image is refused before the image is allocated. */
static td_status refuse_too_short(const char *name, const char *format, size_t size, unsigned width,
                                  unsigned height, td_error *error)
{
    return td_fail(
        error, TD_ERROR_FORMAT,
        "%s: is a truncated or damaged %s: its %zu bytes cannot hold the %u x %u pixels it claims; "
        "copy it again",
        name, format, size, width, height);
}

/* ---- Bytes being written ---- */

typedef struct growing {
    uint8_t *bytes;
    size_t size, capacity;
} growing;

static int reserve(growing *g, size_t more)
{
    if (g->capacity - g->size >= more) return 1;
    size_t capacity = 2 * (g->size + more);
    uint8_t *bytes = realloc(g->bytes, capacity);
    if (!bytes) return 0;
    g->bytes = bytes;
    g->capacity = capacity;
    return 1;
}

/* ---- PNG ---- */

typedef struct png_job {
    png_structp png;
    png_infop info;
    const uint8_t *bytes; /* reading */
    size_t size, at;
    const char *name;
    td_image *image;      /* read */
    const td_image *from; /* to be written */
    growing out;
    td_status status;
    td_error *error;
} png_job;

static void png_on_error(png_structp png, png_const_charp text)
{
    png_job *job = png_get_error_ptr(png);
    if (job->status == TD_OK) job->status = refuse_damaged(job->name, "PNG", text, job->error);
    png_longjmp(png, 1);
}

static void png_on_warning(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text;
}

static void png_on_read(png_structp png, png_bytep to, size_t count)
{
    png_job *job = png_get_io_ptr(png);
    if (count > job->size - job->at) {
        job->status = refuse_truncated(job->name, "PNG", job->size, job->error);
        png_error(png, "truncated");
    }
    memcpy(to, job->bytes + job->at, count);
    job->at += count;
}

static td_status png_check_header(const png_job *job)
{
    png_uint_32 width = png_get_image_width(job->png, job->info),
                height = png_get_image_height(job->png, job->info);
    TD_TRY(td_image_check_size(width, height, job->name, job->error));
    uint64_t unpacked = (uint64_t)png_get_rowbytes(job->png, job->info) * height;
    if (unpacked / DEFLATE_RATIO > job->size)
        return refuse_too_short(job->name, "PNG", job->size, width, height, job->error);
    return TD_OK;
}

/* Reads the pixels as 8-bit grey or RGB; png_on_error jumps out. */
static void png_read_pixels(png_job *job)
{
    png_structp png = job->png;
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX); /* png_check_header has the say */
    png_set_read_fn(png, job, png_on_read);
    png_read_info(png, job->info);
    if ((job->status = png_check_header(job)) != TD_OK) return;
    png_set_expand(png);
    png_set_scale_16(png);
    png_set_strip_alpha(png);
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, job->info);

    int width = (int)png_get_image_width(png, job->info), height = (int)png_get_image_height(png, job->info);
    int channels = png_get_channels(png, job->info);
    job->status = td_image_new(&job->image, width, height, channels, job->error);
    if (job->status != TD_OK) return;
    size_t stride = (size_t)width * (size_t)channels;
    if (png_get_rowbytes(png, job->info) != stride) png_error(png, "rows of unexpected length");
    for (int pass = 0; pass < passes; pass++)
        for (int y = 0; y < height; y++) png_read_row(png, job->image->data + (size_t)y * stride, NULL);
    png_read_end(png, NULL);
}

static void png_read_guarded(png_job *job)
{
    if (!setjmp(png_jmpbuf(job->png))) png_read_pixels(job);
}

td_status td_image_decode_png(td_image **image, const uint8_t *bytes, size_t size, const char *name,
                              td_error *error)
{
    png_job job = {.bytes = bytes, .size = size, .name = name, .error = error};
    *image = NULL;
    job.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &job, png_on_error, png_on_warning);
    if (job.png) job.info = png_create_info_struct(job.png);
    if (job.info)
        png_read_guarded(&job);
    else
        job.status = td_fail(error, TD_ERROR_MEMORY, "out of memory reading %s", name);
    png_destroy_read_struct(&job.png, &job.info, NULL);
    if (job.status == TD_OK)
        *image = job.image;
    else
        td_image_free(&job.image);
    return job.status;
}

static void png_on_write(png_structp png, png_bytep from, size_t count)
{
    png_job *job = png_get_io_ptr(png);
    if (!reserve(&job->out, count)) png_error(png, "out of memory");
    memcpy(job->out.bytes + job->out.size, from, count);
    job->out.size += count;
}

static void png_on_write_error(png_structp png, png_const_charp text)
{
    png_job *job = png_get_error_ptr(png);
    job->status = td_fail(job->error, TD_ERROR_MEMORY, "an image cannot be encoded as PNG (%s)", text);
    png_longjmp(png, 1);
}

static void png_write_guarded(png_job *job)
{
    if (setjmp(png_jmpbuf(job->png))) return;
    const td_image *from = job->from;
    png_set_write_fn(job->png, job, png_on_write, NULL);
    png_set_IHDR(job->png, job->info, (png_uint_32)from->width, (png_uint_32)from->height, 8,
                 from->channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_compression_level(job->png, 1);
    png_set_filter(job->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_write_info(job->png, job->info);
    size_t stride = (size_t)from->width * (size_t)from->channels;
    for (int y = 0; y < from->height; y++) png_write_row(job->png, from->data + (size_t)y * stride);
    png_write_end(job->png, NULL);
}

td_status td_image_encode_png(uint8_t **bytes, size_t *size, const td_image *image, td_error *error)
{
    png_job job = {.from = image, .error = error};
    *bytes = NULL;
    *size = 0;
    job.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &job, png_on_write_error, png_on_warning);
    if (job.png) job.info = png_create_info_struct(job.png);
    if (job.info)
        png_write_guarded(&job);
    else
        job.status = td_fail(error, TD_ERROR_MEMORY, "out of memory writing a PNG");
    png_destroy_write_struct(&job.png, &job.info);
    if (job.status != TD_OK) {
        free(job.out.bytes);
        return job.status;
    }
    *bytes = job.out.bytes;
    *size = job.out.size;
    return TD_OK;
}

/* ---- JPEG ---- */

typedef struct jpeg_job {
    struct jpeg_error_mgr manager;
    jmp_buf jump;
    struct jpeg_source_mgr source;
    struct jpeg_progress_mgr progress;
    struct jpeg_destination_mgr destination;
    struct jpeg_decompress_struct in;
    struct jpeg_compress_struct out;
    const uint8_t *bytes; /* reading */
    size_t size;
    int channels;
    const char *name;
    td_image *image;      /* read */
    const td_image *from; /* to be written */
    int quality;
    growing written;
    td_status status;
    td_error *error;
} jpeg_job;

static void jpeg_on_error(j_common_ptr common)
{
    jpeg_job *job = common->client_data;
    if (job->status == TD_OK) {
        char why[JMSG_LENGTH_MAX];
        common->err->format_message(common, why);
        if (job->from)
            job->status =
                td_fail(job->error, TD_ERROR_ARGUMENT, "an image cannot be encoded as JPEG (%s)", why);
        else
            job->status = refuse_damaged(job->name, "JPEG", why, job->error);
    }
    longjmp(job->jump, 1);
}

/* libjpeg only warns of what it has made up; here that is an error. Oddities that change no pixel pass. */
static void jpeg_on_message(j_common_ptr common, int level)
{
    if (level >= 0) return;
    switch (common->err->msg_code) {
    case JWRN_HIT_MARKER: {
        jpeg_job *job = common->client_data;
        job->status = refuse_damaged(job->name, "JPEG", "its image data end before the last row", job->error);
        jpeg_on_error(common);
        break;
    }
    case JWRN_EXTRANEOUS_DATA:
        if (common->err->msg_parm.i[0] > MAX_JPEG_PADDING) jpeg_on_error(common);
        break;
    case JWRN_ADOBE_XFORM:
    case JWRN_JFIF_MAJOR:
    case JWRN_TOO_MUCH_DATA:
    case JWRN_BOGUS_ICC:
        break;
    default:
        jpeg_on_error(common);
    }
}

static void jpeg_on_output(j_common_ptr common)
{
    (void)common;
}

static void jpeg_set_manager(jpeg_job *job)
{
    jpeg_std_error(&job->manager);
    job->manager.error_exit = jpeg_on_error;
    job->manager.emit_message = jpeg_on_message;
    job->manager.output_message = jpeg_on_output;
}

static void jpeg_on_source(j_decompress_ptr in)
{
    (void)in;
}

static boolean jpeg_on_end_of_source(j_decompress_ptr in)
{
    jpeg_job *job = in->client_data;
    job->status = refuse_truncated(job->name, "JPEG", job->size, job->error);
    jpeg_on_error((j_common_ptr)in);
    return FALSE;
}

static void jpeg_on_skip(j_decompress_ptr in, long count)
{
    if (count <= 0) return;
    if ((size_t)count > in->src->bytes_in_buffer) jpeg_on_end_of_source(in);
    in->src->next_input_byte += count;
    in->src->bytes_in_buffer -= (size_t)count;
}

static void jpeg_on_progress(j_common_ptr common)
{
    const struct jpeg_decompress_struct *in = (j_decompress_ptr)common;
    jpeg_job *job = common->client_data;
    if (in->input_scan_number <= MAX_JPEG_SCANS) return;
    job->status = refuse_damaged(job->name, "JPEG", "more scans than any image has", job->error);
    jpeg_on_error(common);
}

static td_status jpeg_check_header(const jpeg_job *job)
{
    const struct jpeg_decompress_struct *in = &job->in;
    TD_TRY(td_image_check_size(in->image_width, in->image_height, job->name, job->error));
    if (in->jpeg_color_space == JCS_CMYK || in->jpeg_color_space == JCS_YCCK)
        return td_fail(job->error, TD_ERROR_FORMAT,
                       "%s: is a JPEG in the inks of a printer (CMYK); convert it to grey or RGB", job->name);
    if (in->arith_code)
        return td_fail(job->error, TD_ERROR_FORMAT,
                       "%s: is a JPEG with arithmetic coding; convert it to a usual JPEG or PNG", job->name);
    /* Huffman codes have a bit at least: one for the DC of each block and, unless progressive, one for its
     * end. */
    uint64_t bits = 0;
    for (int i = 0; i < in->num_components; i++)
        bits += (uint64_t)in->comp_info[i].width_in_blocks * in->comp_info[i].height_in_blocks;
    if (!in->progressive_mode) bits *= 2;
    if (bits / 8 > job->size)
        return refuse_too_short(job->name, "JPEG", job->size, in->image_width, in->image_height, job->error);
    return TD_OK;
}

static void jpeg_read_guarded(jpeg_job *job)
{
    struct jpeg_decompress_struct *in = &job->in;
    if (setjmp(job->jump)) return;
    jpeg_create_decompress(in);
    in->src = &job->source;
    in->progress = &job->progress;
    jpeg_read_header(in, TRUE);
    if ((job->status = jpeg_check_header(job)) != TD_OK) return;
    in->out_color_space = job->channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    job->status =
        td_image_new(&job->image, (int)in->image_width, (int)in->image_height, job->channels, job->error);
    if (job->status != TD_OK) return;
    jpeg_start_decompress(in);
    size_t stride = (size_t)job->image->width * (size_t)job->channels;
    while (in->output_scanline < in->output_height) {
        JSAMPROW row = job->image->data + in->output_scanline * stride;
        jpeg_read_scanlines(in, &row, 1);
    }
    jpeg_finish_decompress(in);
}

td_status td_image_decode_jpeg(td_image **image, const uint8_t *bytes, size_t size, int channels,
                               const char *name, td_error *error)
{
    jpeg_job job = {.bytes = bytes, .size = size, .channels = channels, .name = name, .error = error};
    *image = NULL;
    jpeg_set_manager(&job);
    job.source = (struct jpeg_source_mgr){
        bytes,         size, jpeg_on_source, jpeg_on_end_of_source, jpeg_on_skip, jpeg_resync_to_restart,
        jpeg_on_source};
    job.progress.progress_monitor = jpeg_on_progress;
    job.in.err = &job.manager;
    job.in.client_data = &job;
    jpeg_read_guarded(&job);
    jpeg_destroy_decompress(&job.in);
    if (job.status == TD_OK)
        *image = job.image;
    else
        td_image_free(&job.image);
    return job.status;
}

/* Gives libjpeg the free room behind what is written. */
static boolean jpeg_on_full(j_compress_ptr out)
{
    jpeg_job *job = out->client_data;
    job->written.size = job->written.capacity;
    if (!reserve(&job->written, 65536)) {
        job->status = td_fail(job->error, TD_ERROR_MEMORY, "out of memory writing a JPEG");
        jpeg_on_error((j_common_ptr)out);
    }
    out->dest->next_output_byte = job->written.bytes + job->written.size;
    out->dest->free_in_buffer = job->written.capacity - job->written.size;
    return TRUE;
}

static void jpeg_on_begin(j_compress_ptr out)
{
    jpeg_on_full(out);
}

static void jpeg_on_finish(j_compress_ptr out)
{
    jpeg_job *job = out->client_data;
    job->written.size = job->written.capacity - out->dest->free_in_buffer;
}

static void jpeg_write_guarded(jpeg_job *job)
{
    struct jpeg_compress_struct *out = &job->out;
    const td_image *from = job->from;
    if (setjmp(job->jump)) return;
    jpeg_create_compress(out);
    out->dest = &job->destination;
    out->image_width = (JDIMENSION)from->width;
    out->image_height = (JDIMENSION)from->height;
    out->input_components = from->channels;
    out->in_color_space = from->channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
    jpeg_set_defaults(out);
    jpeg_set_quality(out, job->quality, TRUE);
    jpeg_start_compress(out, TRUE);
    size_t stride = (size_t)from->width * (size_t)from->channels;
    while (out->next_scanline < out->image_height) {
        JSAMPROW row = from->data + out->next_scanline * stride;
        jpeg_write_scanlines(out, &row, 1);
    }
    jpeg_finish_compress(out);
}

td_status td_image_encode_jpeg(uint8_t **bytes, size_t *size, const td_image *image, int quality,
                               td_error *error)
{
    jpeg_job job = {.from = image, .quality = quality, .error = error};
    *bytes = NULL;
    *size = 0;
    if (quality < 1 || quality > 100)
        return td_fail(error, TD_ERROR_ARGUMENT, "quality: a JPEG is written with 1 to 100, not %d", quality);
    jpeg_set_manager(&job);
    job.destination = (struct jpeg_destination_mgr){NULL, 0, jpeg_on_begin, jpeg_on_full, jpeg_on_finish};
    job.out.err = &job.manager;
    job.out.client_data = &job;
    jpeg_write_guarded(&job);
    jpeg_destroy_compress(&job.out);
    if (job.status != TD_OK) {
        free(job.written.bytes);
        return job.status;
    }
    *bytes = job.written.bytes;
    *size = job.written.size;
    return TD_OK;
}
