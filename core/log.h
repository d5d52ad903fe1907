/* One door for everything the library has to say: it never prints by itself. */
#ifndef TELEDIMOS_CORE_LOG_H
#define TELEDIMOS_CORE_LOG_H

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_log_level { TD_LOG_DEBUG, TD_LOG_INFO, TD_LOG_WARNING } td_log_level;

/* Receives each message. `topic` is the room that speaks ("calibrate"); `text` has no newline. May be called
 * from several threads at once. */
typedef void (*td_log_function)(td_log_level level, const char *topic, const char *text, void *user);

/* A place to log to; a zeroed one swallows everything. Handed down inside the options, so there is no global.
 */
typedef struct td_log {
    td_log_function function; /* NULL: silent */
    void *user;
} td_log;

TD_API void td_log_write(const td_log *log, td_log_level level, const char *topic, const char *format, ...)
    TD_PRINTF(4, 5);

#ifdef __cplusplus
}
#endif
#endif
