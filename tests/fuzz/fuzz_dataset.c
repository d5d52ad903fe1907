/* Any bytes as a dataset: no crash. The bytes up to the first 0 are dataset.yaml, those behind it frames.csv.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/dataset.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const uint8_t *end = size ? memchr(data, 0, size) : NULL;
    const char *yaml = (const char *)data, *csv = end ? (const char *)end + 1 : "";
    const size_t yaml_size = end ? (size_t)(end - data) : size, csv_size = end ? size - yaml_size - 1 : 0;
    td_error error = {0};
    td_dataset *dataset = NULL;
    td_status status = td_dataset_parse(&dataset, yaml, yaml_size, csv, csv_size, "fuzz", &error);
    if ((status == TD_OK) != (dataset != NULL)) abort();
    if (status != TD_OK && !error.message[0]) abort();
    bool images = status == TD_OK && !dataset->target_poses.path && !dataset->arm;
    bool has_target = images && (!dataset->rig || dataset->target.plane_count > 0);
    if (images && dataset->frame_count == 0) abort();
    if (has_target && td_target_check(&dataset->target, &error) != TD_OK) abort();
    for (int i = 0; status == TD_OK && dataset->arm && i < dataset->arm->board_count; i++)
        if (td_target_check(&dataset->arm->board[i].target, &error) != TD_OK) abort();
    td_dataset_free(&dataset);
    return 0;
}
