/* Any bytes as a PLY: no crash, no more memory than the bytes are worth; every corner of a triangle is a
 * point; or a sentence that names the file. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/cloud.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_cloud *cloud = NULL;
    if (td_cloud_parse_ply(&cloud, data, size, "fuzz.ply", &error) != TD_OK) {
        if (cloud || strncmp(error.message, "fuzz.ply:", 9) != 0) abort();
        return 0;
    }
    if (cloud->count > size || cloud->triangle_count > size) abort();
    for (size_t i = 0; i < cloud->triangle_count; i++)
        for (int k = 0; k < 3; k++)
            if (cloud->triangle[i][k] >= cloud->count) abort();
    td_cloud_free(&cloud);
    return 0;
}
