/* What a person at the terminal sees while a job runs: messages and a progress bar, on stderr. */
#ifndef TELEDIMOS_APPS_TERMINAL_H
#define TELEDIMOS_APPS_TERMINAL_H

#include <stdbool.h>
#include <stdio.h>

#include "core/log.h"
#include "core/progress.h"

typedef struct terminal {
    bool quiet, verbose, is_tty, bar_shown;
    FILE *log_file; /* log.jsonl; NULL: none yet */
    const char *stage;
    size_t stage_first; /* units that were done when it began: work that is taken up again */
    double stage_started_s, last_drawn_s, started_s;
} terminal;

void terminal_init(terminal *t, bool quiet, bool verbose);
/* Takes the progress bar away. */
void terminal_clear(terminal *t);
td_log terminal_log(terminal *t);
td_progress terminal_progress(terminal *t);
/* SIGINT and SIGTERM ask for an orderly end: progress then cancels the work. */
void terminal_catch_signals(void);
bool terminal_interrupted(void);
/* For what ends in no other way: the end was orderly, and the rest is done as if nobody had asked. */
bool terminal_take_interrupt(void);
double terminal_now_s(void);

#endif
