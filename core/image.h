/* Images in memory, and to and from files. */
#ifndef TELEDIMOS_CORE_IMAGE_H
#define TELEDIMOS_CORE_IMAGE_H

#include <stddef.h>
#include <stdint.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_image {
    int width, height; /* px */
    int channels;      /* 1: grey; 3: red, green, blue */
    uint8_t *data;     /* (height,width,channels), rows without padding; (0,0) = centre of first pixel */
} td_image;

/* A black image. Free with td_image_free. */
TD_API td_status td_image_new(td_image **image, int width, int height, int channels, td_error *error);
TD_API void td_image_free(td_image **image);

/* Reads PNG, JPEG, PGM or PPM (binary, 8 or 16 bits; 16 are scaled to 8), told by content and not by name, as
 * grey (channels 1: ITU-R BT.601 luma) or colour (3). An empty, truncated, damaged, too large or foreign file
 * is refused with a sentence that names it and says what was seen; a truncated image is never returned. An
 * orientation noted in EXIF is not applied: pixels stay where the sensor has them, as a camera's calibration
 * needs. */
TD_API td_status td_image_read(td_image **image, const char *path, int channels, td_error *error);
/* The same from memory; `name` is for messages. */
TD_API td_status td_image_decode(td_image **image, const void *bytes, size_t size, int channels,
                                 const char *name, td_error *error);

/* Encodes as PNG (compression for speed) or JPEG (quality 1–100). *bytes is to be freed with free(). */
TD_API td_status td_image_encode_png(uint8_t **bytes, size_t *size, const td_image *image, td_error *error);
TD_API td_status td_image_encode_jpeg(uint8_t **bytes, size_t *size, const td_image *image, int quality,
                                      td_error *error);
/* Writes whole or not at all; the format by the name's ending: .png, .jpg or .jpeg, .pgm (grey),
 * .ppm (colour). */
TD_API td_status td_image_write(const char *path, const td_image *image, td_error *error);

/* Value by bilinear interpolation, channel `c`; the border is repeated outside. */
TD_API double td_image_sample(const td_image *image, double x, double y, int c);

/* Halves width and height `times` times by averaging 2x2 blocks, rounding once; an odd last column or row is
 * left out. */
TD_API td_status td_image_shrink(td_image **small, const td_image *image, int times, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
