/* Any bytes as clicks: no crash; each image once, each of its marks once and within bounds; or a sentence
 * that names the file, and nothing given. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "calib/observations.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_image(const td_image_clicks *clicks, size_t i)
{
    const td_image_clicks *c = &clicks[i];
    if (!c->image[0] || c->count < 1 || c->count > TD_MAX_CLICKS) abort();
    for (size_t k = 0; k < i; k++)
        if (!strcmp(clicks[k].image, c->image)) abort();
    for (size_t k = 0; k < c->count; k++) {
        const td_click *click = &c->click[k];
        if (click->index > 1000000) abort();
        for (int j = 0; j < 2; j++)
            if (!(fabs(click->pixel[j]) <= 1e6)) abort();
        for (size_t l = 0; l < k; l++)
            if (c->click[l].index == click->index) abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_image_clicks *clicks = NULL;
    size_t count = 0;
    if (td_clicks_parse(&clicks, &count, (const char *)data, size, "clicks.csv", &error) != TD_OK) {
        if (clicks || count || strncmp(error.message, "clicks.csv:", 11) != 0) abort();
        return 0;
    }
    for (size_t i = 0; i < count && i < 1000; i++) check_image(clicks, i);
    free(clicks);
    return 0;
}
