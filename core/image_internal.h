/* What image.c and image_codecs.c share. */
#ifndef TELEDIMOS_CORE_IMAGE_INTERNAL_H
#define TELEDIMOS_CORE_IMAGE_INTERNAL_H

#include <stdint.h>

#include "core/image.h"

enum { TD_IMAGE_MAX_SIDE = 65535, TD_IMAGE_MAX_PIXELS = 400000000 };

/* Refuses an image without pixels or too large to be one, before anything is allocated for it. */
td_status td_image_check_size(uint64_t width, uint64_t height, const char *name, td_error *error);

/* Decodes to grey or colour, as the file holds it (1 or 3 channels). */
td_status td_image_decode_png(td_image **image, const uint8_t *bytes, size_t size, const char *name,
                              td_error *error);
/* Decodes to grey (channels 1) or colour (3): the format holds the luma apart. */
td_status td_image_decode_jpeg(td_image **image, const uint8_t *bytes, size_t size, int channels,
                               const char *name, td_error *error);

#endif
