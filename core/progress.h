/* Progress out, cancellation in: what long work shows while it runs. */
#ifndef TELEDIMOS_CORE_PROGRESS_H
#define TELEDIMOS_CORE_PROGRESS_H

#include <stdbool.h>
#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Called after each unit of work with the stage's name ("detecting the board"), `done` of `total` units.
 * Returns false to cancel the work. May be called from several threads, one at a time. */
typedef bool (*td_progress_function)(const char *stage, size_t done, size_t total, void *user);

/* A zeroed one shows nothing and never cancels. */
typedef struct td_progress {
    td_progress_function function;
    void *user;
} td_progress;

/* Reports; false when the work is to stop. `progress` may be NULL. */
TD_API bool td_progress_report(const td_progress *progress, const char *stage, size_t done, size_t total);

#ifdef __cplusplus
}
#endif
#endif
