/* The record of who did what: a line of JSON for each thing, with its number. It is only ever added to, each
 * line whole and at once, so that a kill leaves it whole. */
#ifndef TELEDIMOS_APPS_AUDIT_H
#define TELEDIMOS_APPS_AUDIT_H

#include <jansson.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/status.h"

typedef struct audit {
    bool kept; /* false: none is */
    int file;
    uint64_t lines; /* written, of this run: each carries its number */
    bool torn;      /* the last one is not whole: the disk was full */
    bool told;      /* that it cannot be written */
    bool unsynced;
    /* Of strangers, who could fill the disk: so many lines a second. */
    double allowed, allowed_at_s;
    uint64_t left_out;
    char path[1200];
} audit;

/* Adds to PATH. */
td_status audit_open(audit *a, const char *path, td_error *error);
void audit_close(audit *a);
/* {"line": …, "time": "2026-01-31T12:00:00.000Z", "clock_s": of the monotonic clock, "what": what, and what
 * `fields` has}. Takes `fields` (may be NULL). False: it cannot be written. */
bool audit_write(audit *a, const char *what, json_t *fields);
/* The same with a "text". Where it cannot be written, a warning on standard error says so, once. */
void audit_line(audit *a, const char *what, json_t *more, const char *format, ...) TD_PRINTF(4, 5);
/* Fields of that text alone. */
json_t *audit_text(const char *format, ...) TD_PRINTF(1, 2);
/* Of somebody who has not shown who he is: 20 a second, 50 at once; how many were left out stands in the
 * next. */
void audit_stranger(audit *a, const char *what, json_t *fields);
/* What was written lies on the disk when it returns, which may take long. */
void audit_sync(audit *a);

#endif
