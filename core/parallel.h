/* One parallel loop. Units write only to their own slots, so the result does not depend on the thread count.
 */
#ifndef TELEDIMOS_CORE_PARALLEL_H
#define TELEDIMOS_CORE_PARALLEL_H

#include <stddef.h>

#include "progress.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Does unit `index`. */
typedef void (*td_parallel_function)(size_t index, void *user);

/* Runs function(0 … count-1) on `threads` threads (0: one per processor) and waits for all. Units are handed
 * out in order. `progress` (may be NULL) is told of each finished unit under the name `stage`; when it
 * cancels, units not yet begun are left out and TD_ERROR_CANCELLED is returned. */
TD_API td_status td_parallel_for(size_t count, int threads, td_parallel_function function, void *user,
                                 const td_progress *progress, const char *stage);

#ifdef __cplusplus
}
#endif
#endif
