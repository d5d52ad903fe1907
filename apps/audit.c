#include "apps/audit.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const double A_SECOND = 20, AT_ONCE = 50;

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

td_status audit_open(audit *a, const char *path, td_error *error)
{
    *a = (audit){.allowed = AT_ONCE, .allowed_at_s = now_s()};
    snprintf(a->path, sizeof a->path, "%s", path);
    a->file = open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0640);
    a->kept = a->file >= 0;
    if (a->kept) return TD_OK;
    return td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s", path, strerror(errno));
}

void audit_close(audit *a)
{
    if (a->kept) close(a->file);
    a->kept = false;
}

/* ---- a line ---- */

static void stamp(char text[40])
{
    struct timespec now;
    struct tm parts;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &parts);
    const size_t length = strftime(text, 24, "%Y-%m-%dT%H:%M:%S", &parts);
    snprintf(text + length, 40 - length, ".%03ldZ", now.tv_nsec / 1000000);
}

/* One write, so that it is whole. After one that was not, a line of its own begins. */
static bool put(audit *a, const char *text, size_t size)
{
    if (a->torn && write(a->file, "\n", 1) == 1) a->torn = false;
    if (a->torn) return false;
    const ssize_t written = write(a->file, text, size);
    if (written == (ssize_t)size) return true;
    a->torn = written > 0;
    return false;
}

bool audit_write(audit *a, const char *what, json_t *fields)
{
    char time[40];
    stamp(time);
    json_t *line = a->kept ? json_pack("{s:I, s:s, s:f, s:s}", "line", (json_int_t)a->lines + 1, "time", time,
                                       "clock_s", now_s(), "what", what)
                           : NULL;
    if (line && fields) json_object_update(line, fields);
    json_decref(fields);
    char *text = line ? json_dumps(line, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(line);
    const size_t size = text ? strlen(text) : 0;
    if (text) text[size] = '\n'; /* in place of its 0 */
    const bool written = text && put(a, text, size + 1);
    free(text);
    a->lines += written;
    a->unsynced = a->unsynced || written;
    return written || !a->kept;
}

void audit_sync(audit *a)
{
    if (a->kept && a->unsynced) (void)fdatasync(a->file);
    a->unsynced = false;
}

/* ---- with a text ---- */

static json_t *text_of(const char *format, va_list list)
{
    char text[1200];
    vsnprintf(text, sizeof text, format, list);
    json_t *fields = json_pack("{s:s}", "text", text);
    if (fields) return fields;
    for (char *c = text; *c; c++) /* no UTF-8 */
        if ((unsigned char)*c >= 0x7F || (unsigned char)*c < ' ') *c = '?';
    return json_pack("{s:s}", "text", text);
}

json_t *audit_text(const char *format, ...)
{
    va_list list;
    va_start(list, format);
    json_t *fields = text_of(format, list);
    va_end(list);
    return fields;
}

void audit_line(audit *a, const char *what, json_t *more, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    json_t *fields = text_of(format, list);
    va_end(list);
    if (fields && more) json_object_update(fields, more);
    json_decref(more);
    const bool written = audit_write(a, what, fields);
    if (!written && !a->told)
        fprintf(stderr, "warning: %s: the record cannot be written any more: %s\n", a->path, strerror(errno));
    a->told = !written;
}

/* ---- of strangers ---- */

void audit_stranger(audit *a, const char *what, json_t *fields)
{
    const double now = now_s();
    a->allowed = fmin(AT_ONCE, a->allowed + A_SECOND * (now - a->allowed_at_s));
    a->allowed_at_s = now;
    if (a->allowed < 1) {
        a->left_out++;
        json_decref(fields);
        return;
    }
    a->allowed--;
    if (a->left_out && fields)
        json_object_set_new(fields, "left_out_before", json_integer((json_int_t)a->left_out));
    a->left_out = 0;
    (void)audit_write(a, what, fields);
}
