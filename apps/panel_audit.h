/* The audit log: a line of JSON for everything that was asked for, by whom, and what became of it. It is only
 * ever added to, each line whole and at once, so that a kill leaves it whole. */
#ifndef TELEDIMOS_APPS_PANEL_AUDIT_H
#define TELEDIMOS_APPS_PANEL_AUDIT_H

#include <jansson.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/status.h"

typedef struct panel_audit {
    int file;
    uint64_t lines; /* written, of this run: each carries its number */
    bool torn;      /* the last one is not whole: the disk was full */
    /* Of strangers, who could fill the disk: so many lines a second. */
    double allowed, allowed_at_s;
    uint64_t left_out;
    char path[1100];
} panel_audit;

/* Adds to PATH. */
td_status panel_audit_open(panel_audit *audit, const char *path, td_error *error);
void panel_audit_close(panel_audit *audit);
/* {"line": …, "time": "2026-01-31T12:00:00.000Z", "what": what, and what `fields` has}. Takes `fields` (may
 * be NULL). What cannot be written is not done: false. */
bool panel_audit_write(panel_audit *audit, const char *what, json_t *fields);
/* The same of strangers: at most 10 a second, 50 at once; how many were left out stands in the next. */
void panel_audit_stranger(panel_audit *audit, const char *what, json_t *fields);

#endif
