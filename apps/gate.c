#include "apps/gate.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *verdict_name(verdict v)
{
    static const char *const names[] = {"accepted", "warned", "refused"};
    return names[v];
}

td_tone verdict_tone(verdict v)
{
    static const td_tone tones[] = {TD_TONE_GOOD, TD_TONE_WARN, TD_TONE_BAD};
    return tones[v];
}

td_status gate_set(gate_row *row, size_t count, const char *assignment, td_error *error)
{
    const char *equals = strchr(assignment, '=');
    if (!equals) return td_fail(error, TD_ERROR_ARGUMENT, "--gate %s: write it as key=value", assignment);
    size_t length = (size_t)(equals - assignment);
    for (size_t i = 0; i < count; i++) {
        if (strlen(row[i].key) != length || strncmp(row[i].key, assignment, length) != 0) continue;
        char *end;
        double value = strtod(equals + 1, &end);
        if (end == equals + 1 || *end || !(value >= 0))
            return td_fail(error, TD_ERROR_ARGUMENT, "--gate %s: '%s' is not a number >= 0", assignment,
                           equals + 1);
        row[i].warn = value * (row[i].refuse > 0 ? row[i].warn / row[i].refuse : 1);
        row[i].refuse = value;
        return TD_OK;
    }
    char keys[400] = "";
    for (size_t i = 0; i < count; i++)
        snprintf(keys + strlen(keys), sizeof keys - strlen(keys), " %s", row[i].key);
    return td_fail(error, TD_ERROR_ARGUMENT, "--gate %s: there is no such key; the keys are%s", assignment,
                   keys);
}

static void add_reason(gate_result *result, verdict v, const char *format, va_list arguments)
{
    if (v > result->verdict) result->verdict = v;
    if (result->count < GATE_MAX_REASONS)
        vsnprintf(result->reason[result->count++], GATE_REASON_SIZE, format, arguments);
}

void gate_check(gate_result *result, const gate_row *row, size_t count, const char *key, double value,
                const char *format, ...)
{
    for (size_t i = 0; i < count; i++) {
        if (strcmp(row[i].key, key) != 0) continue;
        if (isfinite(value) && value <= row[i].warn) return;
        va_list arguments;
        va_start(arguments, format);
        add_reason(result, isfinite(value) && value <= row[i].refuse ? VERDICT_WARNED : VERDICT_REFUSED,
                   format, arguments);
        va_end(arguments);
        return;
    }
}

void gate_add(gate_result *result, verdict v, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    add_reason(result, v, format, arguments);
    va_end(arguments);
}

void gate_help(char *text, size_t size, const gate_row *row, size_t count)
{
    for (size_t i = 0; i < count; i++)
        snprintf(text + strlen(text), size - strlen(text), "\n%s=%g (remark above %g): %s", row[i].key,
                 row[i].refuse, row[i].warn, row[i].why);
}

void gate_report(td_report *report, const gate_result *result)
{
    const char *sentences[GATE_MAX_REASONS];
    for (size_t i = 0; i < result->count; i++) sentences[i] = result->reason[i];
    td_report_verdict(report, verdict_tone(result->verdict), verdict_name(result->verdict), sentences,
                      result->count);
}
