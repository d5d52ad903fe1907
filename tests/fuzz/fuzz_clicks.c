/* Clicks as CSV: whatever the bytes, either clicks within their bounds or a sentence. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "calib/observations.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_image_clicks *clicks = NULL;
    size_t count = 0;
    if (td_clicks_parse(&clicks, &count, (const char *)data, size, "clicks.csv", &error) == TD_OK) {
        for (size_t i = 0; i < count; i++)
            for (size_t k = 0; k < clicks[i].count; k++)
                if (clicks[i].count > TD_MAX_CLICKS || !isfinite(clicks[i].click[k].pixel[0])) abort();
    } else if (!error.message[0]) {
        abort();
    }
    free(clicks);
    return 0;
}
