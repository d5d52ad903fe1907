/* Any bytes as a message (its kind first): refused with a sentence, or decoded within all bounds; and then,
 * sent again, it is the same bytes. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/machine_messages.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(bool fine)
{
    if (!fine) abort();
}

static void check_bounds(const td_machine_message *m)
{
    const td_machine_state_message *s = &m->as.state;
    if (m->kind == TD_MACHINE_JOINTS) must(m->as.joints.joints <= TD_ROBOT_MAX_JOINTS);
    if (m->kind == TD_MACHINE_TASK) must(m->as.task.size <= TD_MACHINE_MAX_TASK);
    if (m->kind != TD_MACHINE_STATE) return;
    must(s->joints <= TD_ROBOT_MAX_JOINTS && memchr(s->phase, 0, sizeof s->phase) &&
         (int)s->mode < TD_MODE_COUNT);
    for (int k = 0; k < s->joints; k++) must(isfinite(s->plant.q[k]) && isfinite(s->plant.force[k]));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static td_machine_message message;
    td_error error = {0};
    uint8_t *again = NULL;
    size_t length = 0;
    if (size == 0) return 0;
    const uint8_t kind = data[0];
    if (td_machine_decode(&message, kind, data + 1, size - 1, &error) != TD_OK) {
        must(error.message[0] != 0);
        return 0;
    }
    check_bounds(&message);
    must(td_machine_encode(&again, &length, &message, &error) == TD_OK);
    must(length == size - 1 && memcmp(again, data + 1, length) == 0);
    free(again);
    return 0;
}
