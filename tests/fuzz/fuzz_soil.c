/* Any bytes as a soil's preset: no crash, and what is taken passes the check. */
#include <stdint.h>
#include <stdlib.h>

#include "sim/soil_preset.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_soil_preset preset;
    const td_status status = td_soil_preset_parse(&preset, (const char *)data, size, "input", &error);
    if (status == TD_OK && td_soil_preset_check(&preset, &error) != TD_OK) abort();
    if (status != TD_OK && !error.message[0]) abort();
    return 0;
}
