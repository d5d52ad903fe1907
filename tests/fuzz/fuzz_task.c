/* Any bytes as a task: no crash, and what is accepted is written, read and written as the same bytes. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/task.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_task *task = NULL, *again = NULL;
    char *text = NULL, *second = NULL;
    const td_status status = td_task_parse(&task, (const char *)data, size, "task.yaml", &error);
    if ((status == TD_OK) != (task != NULL)) abort();
    if (status != TD_OK && !error.message[0]) abort();
    if (status == TD_OK) {
        if (td_task_text(&text, task, &error) != TD_OK) abort();
        if (td_task_parse(&again, text, strlen(text), "again.yaml", &error) != TD_OK) abort();
        if (td_task_text(&second, again, &error) != TD_OK || strcmp(text, second) != 0) abort();
    }
    td_task_free(&task);
    td_task_free(&again);
    free(text);
    free(second);
    return 0;
}
