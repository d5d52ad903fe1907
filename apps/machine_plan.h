/* How a trench is dug, as a text: the plan that was simulated is the one that is done, wherever. */
#ifndef TELEDIMOS_APPS_MACHINE_PLAN_H
#define TELEDIMOS_APPS_MACHINE_PLAN_H

#include "core/task.h"
#include "servo/dig_plan.h"

/* `task`: that the trench is of. To be freed with free(). */
td_status machine_plan_text(char **text, const td_dig_plan *plan, const td_task *task, td_error *error);
/* Its moves, floor and volumes; no map. What is no plan is refused. */
td_status machine_plan_parse(td_dig_plan **plan, const char *text, size_t size, td_error *error);

#endif
