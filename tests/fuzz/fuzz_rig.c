/* Any bytes as a rig: no crash; and what is read is a rig that can be written, and comes back to the same
 * text. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/rig.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_rig *rig = NULL, *back = NULL;
    if (td_rig_parse(&rig, (const char *)data, size, "fuzz.yaml", &error) != TD_OK) {
        if (rig || strncmp(error.message, "fuzz.yaml:", 10) != 0) abort();
        return 0;
    }
    char *text = NULL, *again = NULL;
    if (td_rig_to_yaml(&text, rig, &error) != TD_OK) abort();
    if (td_rig_parse(&back, text, strlen(text), "written", &error) != TD_OK) abort();
    if (td_rig_to_yaml(&again, back, &error) != TD_OK || strcmp(text, again) != 0) abort();
    free(text);
    free(again);
    td_rig_free(&rig);
    td_rig_free(&back);
    return 0;
}
