/* The record of who did what: a line of JSON for each thing, only ever added to, and on its way to the disk
 * before the next thing happens. */
#ifndef TELEDIMOS_APPS_AUDIT_H
#define TELEDIMOS_APPS_AUDIT_H

#include <jansson.h>
#include <stdio.h>

#include "core/status.h"

typedef struct audit {
    FILE *file; /* NULL: none is kept */
    const char *path;
    double window_s; /* lines that strangers cause are counted in it, */
    int strangers;   /* so that they do not fill the disk */
    long left_out;
} audit;

td_status audit_open(audit *a, const char *path, td_error *error);
void audit_close(audit *a);
/* {"time": UTC, "clock_s": of the monotonic clock, "what": …, "text": …}, and `more` (may be NULL), which is
 * taken. */
void audit_line(audit *a, const char *what, json_t *more, const char *format, ...) TD_PRINTF(4, 5);
/* Of somebody who has not shown the token: at most 20 a second, the others are counted. */
void audit_stranger(audit *a, const char *what, const char *format, ...) TD_PRINTF(3, 4);

#endif
