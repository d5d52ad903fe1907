#include "apps/panel_audit.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const double A_SECOND = 10, AT_ONCE = 50;

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

td_status panel_audit_open(panel_audit *audit, const char *path, td_error *error)
{
    *audit = (panel_audit){.allowed = AT_ONCE, .allowed_at_s = now_s()};
    snprintf(audit->path, sizeof audit->path, "%s", path);
    audit->file = open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0640);
    if (audit->file >= 0) return TD_OK;
    return td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s", path, strerror(errno));
}

void panel_audit_close(panel_audit *audit)
{
    if (audit->file > 0) close(audit->file);
    audit->file = -1;
}

static void stamp(char text[32])
{
    struct timespec now;
    struct tm parts;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &parts);
    const size_t length = strftime(text, 24, "%Y-%m-%dT%H:%M:%S", &parts);
    snprintf(text + length, 32 - length, ".%03ldZ", now.tv_nsec / 1000000);
}

bool panel_audit_write(panel_audit *audit, const char *what, json_t *fields)
{
    char time[32];
    stamp(time);
    json_t *line =
        json_pack("{s:I, s:s, s:s}", "line", (json_int_t)audit->lines + 1, "time", time, "what", what);
    if (line && fields) json_object_update(line, fields);
    json_decref(fields);
    char *text = line ? json_dumps(line, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(12)) : NULL;
    json_decref(line);
    const size_t size = text ? strlen(text) : 0;
    if (text) text[size] = '\n'; /* in place of its 0: one write, whole */
    if (text && audit->torn && write(audit->file, "\n", 1) == 1) audit->torn = false;
    const ssize_t put = text && !audit->torn ? write(audit->file, text, size + 1) : -1;
    const bool written = put == (ssize_t)size + 1;
    if (put > 0 && !written) audit->torn = true;
    free(text);
    audit->lines += written;
    return written;
}

void panel_audit_stranger(panel_audit *audit, const char *what, json_t *fields)
{
    const double now = now_s();
    audit->allowed = fmin(AT_ONCE, audit->allowed + A_SECOND * (now - audit->allowed_at_s));
    audit->allowed_at_s = now;
    if (audit->allowed < 1) {
        audit->left_out++;
        json_decref(fields);
        return;
    }
    audit->allowed--;
    if (audit->left_out)
        json_object_set_new(fields, "left_out_before", json_integer((json_int_t)audit->left_out));
    audit->left_out = 0;
    (void)panel_audit_write(audit, what, fields);
}
