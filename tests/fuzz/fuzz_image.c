/* Any bytes as an image file: refused with a sentence or decoded, in both numbers of channels, and shrunk. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/image.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    for (int channels = 1; channels <= 3; channels += 2) {
        td_image *image = NULL, *small = NULL;
        td_error error = {TD_OK, ""};
        td_status status = td_image_decode(&image, data, size, channels, "input", &error);
        if ((status == TD_OK) != (image != NULL)) abort();
        if (status != TD_OK && strncmp(error.message, "input: ", 7) != 0) abort();
        if (image && image->channels != channels) abort();
        if (image && td_image_shrink(&small, image, 1, NULL) == TD_OK)
            (void)td_image_sample(small, data[size - 1], data[0], channels - 1);
        td_image_free(&small);
        td_image_free(&image);
    }
    return 0;
}
