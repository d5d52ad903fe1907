#include "core/task.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/document_internal.h"
#include "core/file.h"
#include "core/task_internal.h"

/* How far from 1 the length of what was written may be. */
static const double ROUNDING = 1e-12, NO_LENGTH = 1e-9;

const char *td_task_kind_name(td_task_kind kind)
{
    static const char *const names[TD_TASK_KINDS] = {"position", "drive", "dig", "dump", "press", "wait"};
    return (unsigned)kind < TD_TASK_KINDS ? names[kind] : "unknown";
}

void td_task_defaults(td_task *task)
{
    memset(task, 0, sizeof *task);
    task->tool.axis[0] = 1;
    task->limits.speed_m_s = task->limits.acceleration_m_s2 = INFINITY;
    task->limits.joint_speed_share = task->limits.pump_share = 1;
    task->tolerance.position_m = 0.05;
    task->tolerance.angle_deg = 2;
    task->tolerance.force_n = 1000;
}

bool td_task_unit(double *value, int count)
{
    double length = 0;
    for (int i = 0; i < count; i++) length += value[i] * value[i];
    length = sqrt(length);
    if (!(length > NO_LENGTH)) return false;
    for (int i = 0; i < count && fabs(length - 1) > ROUNDING; i++) value[i] /= length;
    return true;
}

void td_task_free(td_task **task)
{
    if (!task || !*task) return;
    for (int i = 0; i < (*task)->step_count; i++)
        if ((*task)->step[i].kind == TD_TASK_POSITION) {
            free((*task)->step[i].as.position.via);
            free((*task)->step[i].as.position.joint);
        }
    free((*task)->step);
    free(*task);
    *task = NULL;
}

td_status td_task_read(td_task **task, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    *task = NULL;
    TD_TRY(td_file_read(&text, &size, path, TD_DOCUMENT_SIZE, error));
    const td_status status = td_task_parse(task, text, size, path, error);
    free(text);
    return status;
}

td_status td_task_write(const td_task *task, const char *path, td_error *error)
{
    char *text = NULL;
    TD_TRY(td_task_text(&text, task, error));
    const td_status status = td_file_write(path, text, strlen(text), error);
    free(text);
    return status;
}

td_status td_task_hash(char hex[TD_HASH_HEX_SIZE], const td_task *task, td_error *error)
{
    char *text = NULL;
    TD_TRY(td_task_text(&text, task, error));
    const td_status status = td_hash_bytes(hex, text, strlen(text), error);
    free(text);
    return status;
}
