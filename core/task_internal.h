/* What readers and writers of tasks share: names as files have them, and defaults. */
#ifndef TELEDIMOS_CORE_TASK_INTERNAL_H
#define TELEDIMOS_CORE_TASK_INTERNAL_H

#include "core/task.h"

enum { TD_TASK_KINDS = 6 };
static const char TD_TASK_IS[] = "task 1";
static const char *const td_task_frames[] = {"vehicle", "site", NULL};
static const char *const td_task_laws[] = {
    "fastest", "cubic", "quintic", "constant-velocity", "constant-acceleration", NULL};

/* A task of no steps with every default. */
void td_task_defaults(td_task *task);
/* Brings a vector or quaternion to length 1, unless rounding alone is amiss. False: it has no length. */
bool td_task_unit(double *value, int count);

#endif
