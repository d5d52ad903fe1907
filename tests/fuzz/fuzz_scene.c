/* Any bytes as a scene: no crash. The bytes up to the first 0 are scene.yaml, those behind it frames.csv. No
 * file is opened, no ground made. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/scene.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const uint8_t *end = size ? memchr(data, 0, size) : NULL;
    const char *yaml = (const char *)data, *csv = end ? (const char *)end + 1 : "";
    const size_t yaml_size = end ? (size_t)(end - data) : size, csv_size = end ? size - yaml_size - 1 : 0;
    td_error error = {0};
    td_scene_file *scene = NULL;
    td_status status = td_scene_parse(&scene, yaml, yaml_size, csv, csv_size, NULL, &error);
    if ((status == TD_OK) != (scene != NULL)) abort();
    if (status != TD_OK && !error.message[0]) abort();
    if (status == TD_OK && scene->frame_count == 0) abort();
    td_scene_free(&scene);
    return 0;
}
