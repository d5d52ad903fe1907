/* A program that works for the panel, spoken to by lines: requests on its standard input, whatever it says on
 * its standard output. Nothing here ever waits for it. */
#ifndef TELEDIMOS_APPS_PANEL_CHILD_H
#define TELEDIMOS_APPS_PANEL_CHILD_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

#include "core/status.h"

enum { PANEL_CHILD_REQUEST = 4096, PANEL_CHILD_LINE = 8 << 20 };

typedef struct panel_child {
    pid_t pid; /* 0: there is none */
    int in, out;
    char *line; /* of what has come, not whole yet */
    size_t size, room;
} panel_child;

/* A program that stands beside this one. It runs in time with nothing, whatever this thread does. */
td_status panel_child_start(panel_child *child, const char *name, const char *const *argv, td_error *error);
/* A line of at most PANEL_CHILD_REQUEST bytes, its end included, whole or not at all: false where it takes no
 * more. */
bool panel_child_tell(const panel_child *child, const char *line, size_t size);
/* Gives each whole line that has come, without its end (a 0 instead). False: no more will come, or a line was
 * too long. `take` returns false to end it. */
bool panel_child_read(panel_child *child, bool (*take)(void *user, char *line), void *user);
/* Ends it, with all it has begun; its status as waitpid has it. `out` stays open: it may be another's. */
int panel_child_end(panel_child *child);

#endif
