/* A Motion JPEG video in AVI (RIFF) as a test's own: frames are JPEG files, their times exactly k scale /
 * rate. */
#ifndef TELEDIMOS_TESTS_AVI_H
#define TELEDIMOS_TESTS_AVI_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "core/image.h"

typedef struct avi {
    uint8_t *data;
    size_t size;
} avi;

static inline void avi_bytes(avi *a, const void *bytes, size_t size)
{
    a->data = realloc(a->data, a->size + size + 1);
    memcpy(a->data + a->size, bytes, size);
    a->size += size;
}

static inline void avi_u32(avi *a, uint32_t value)
{
    const uint8_t b[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16),
                          (uint8_t)(value >> 24)};
    avi_bytes(a, b, 4);
}

/* Opens a chunk; returns where its size stands. */
static inline size_t avi_begin(avi *a, const char *name, const char *kind)
{
    avi_bytes(a, name, 4);
    const size_t at = a->size;
    avi_u32(a, 0);
    if (kind) avi_bytes(a, kind, 4);
    return at;
}

static inline void avi_end(avi *a, size_t at)
{
    const size_t size = a->size - at - 4;
    for (int i = 0; i < 4; i++) a->data[at + (size_t)i] = (uint8_t)(size >> (8 * i));
    if (size % 2) avi_bytes(a, "", 1);
}

static inline void avi_header(avi *a, int width, int height, int count, uint32_t rate, uint32_t scale)
{
    const uint32_t w = (uint32_t)width, h = (uint32_t)height, n = (uint32_t)count;
    const uint32_t main_header[14] = {(uint32_t)(1e6 * scale / rate), 0, 0, 0x10, n, 0, 1, 1 << 20, w, h};
    const uint32_t stream[12] = {0, 0, 0, scale, rate, 0, n, 1 << 20, 0xFFFFFFFF, 0, 0, w | h << 16};
    const size_t list = avi_begin(a, "LIST", "hdrl");
    size_t chunk = avi_begin(a, "avih", NULL);
    for (int i = 0; i < 14; i++) avi_u32(a, main_header[i]);
    avi_end(a, chunk);
    const size_t inner = avi_begin(a, "LIST", "strl");
    chunk = avi_begin(a, "strh", "vids");
    avi_bytes(a, "MJPG", 4);
    for (int i = 0; i < 12; i++) avi_u32(a, stream[i]);
    avi_end(a, chunk);
    chunk = avi_begin(a, "strf", NULL);
    const uint32_t format[10] = {40, w, h, 1 | 24 << 16, 0x47504A4D, w * h * 3};
    for (int i = 0; i < 10; i++) avi_u32(a, format[i]);
    avi_end(a, chunk);
    avi_end(a, inner);
    avi_end(a, list);
}

/* Writes the images as frames at `rate` / `scale` a second; a status of the library. */
static inline td_status avi_write(const char *path, td_image *const *image, int count, uint32_t rate,
                                  uint32_t scale, td_error *error)
{
    avi a = {0}, index = {0};
    const size_t file = avi_begin(&a, "RIFF", "AVI ");
    avi_header(&a, image[0]->width, image[0]->height, count, rate, scale);
    const size_t movie = avi_begin(&a, "LIST", "movi"), base = a.size - 4;
    td_status status = TD_OK;
    for (int k = 0; k < count && status == TD_OK; k++) {
        uint8_t *bytes = NULL;
        size_t size = 0;
        status = td_image_encode_jpeg(&bytes, &size, image[k], 95, error);
        if (status != TD_OK) break;
        avi_bytes(&index, "00dc", 4);
        avi_u32(&index, 0x10);
        avi_u32(&index, (uint32_t)(a.size - base));
        avi_u32(&index, (uint32_t)size);
        const size_t chunk = avi_begin(&a, "00dc", NULL);
        avi_bytes(&a, bytes, size);
        avi_end(&a, chunk);
        free(bytes);
    }
    avi_end(&a, movie);
    const size_t chunk = avi_begin(&a, "idx1", NULL);
    avi_bytes(&a, index.data, index.size);
    avi_end(&a, chunk);
    avi_end(&a, file);
    if (status == TD_OK) status = td_file_write(path, a.data, a.size, error);
    free(a.data);
    free(index.data);
    return status;
}

#endif
