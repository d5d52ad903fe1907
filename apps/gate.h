/* The quality gate: thresholds with defaults, a verdict with reasons. */
#ifndef TELEDIMOS_APPS_GATE_H
#define TELEDIMOS_APPS_GATE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/report.h"
#include "core/status.h"

typedef enum verdict { VERDICT_ACCEPTED, VERDICT_WARNED, VERDICT_REFUSED } verdict;

/* A value above `warn` is a remark, above `refuse` a refusal. */
typedef struct gate_row {
    const char *key;
    double warn, refuse;
    const char *why; /* the reason for the defaults, for --help */
} gate_row;

enum { GATE_MAX_REASONS = 64, GATE_REASON_SIZE = 400 };

typedef struct gate_result {
    verdict verdict;
    size_t count;
    char reason[GATE_MAX_REASONS][GATE_REASON_SIZE];
} gate_result;

const char *verdict_name(verdict v);

/* Applies "key=value" to a table: sets the refusal, and lowers or raises the remark with it. */
td_status gate_set(gate_row *row, size_t count, const char *assignment, td_error *error);

/* Compares a value with its row and adds the sentence when it is above. */
void gate_check(gate_result *result, const gate_row *row, size_t count, const char *key, double value,
                const char *format, ...) TD_PRINTF(6, 7);
/* Adds a reason without a threshold. */
void gate_add(gate_result *result, verdict v, const char *format, ...) TD_PRINTF(3, 4);

#define GATE_HELP "refuse above VALUE; may be repeated. Defaults, and why:"
/* Appends a line a row to the help of --gate: key, defaults, reason. */
void gate_help(char *text, size_t size, const gate_row *row, size_t count);

/* The verdict with its reasons, as a report begins. */
void gate_report(td_report *report, const gate_result *result);
td_tone verdict_tone(verdict v);

#endif
