#include "apps/audit.h"

#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "apps/terminal.h"
#include "core/machine_messages.h"

enum { STRANGERS_A_SECOND = 20 };

td_status audit_open(audit *a, const char *path, td_error *error)
{
    *a = (audit){.path = path};
    const int fd = open(path, O_WRONLY | O_CREAT | O_APPEND, 0640);
    a->file = fd >= 0 ? fdopen(fd, "a") : NULL;
    if (a->file) return TD_OK;
    if (fd >= 0) close(fd);
    return td_fail(error, TD_ERROR_IO, "%s: cannot be added to: %s", path, strerror(errno));
}

void audit_close(audit *a)
{
    if (a->file) fclose(a->file);
    a->file = NULL;
}

static json_t *pack(const char *when, const char *what, const char *text)
{
    return json_pack("{s:s, s:f, s:s, s:s}", "time", when, "clock_s", td_machine_now_s(), "what", what,
                     "text", text);
}

static void write_line(audit *a, const char *what, json_t *more, const char *format, va_list list)
{
    char text[1200], when[40];
    struct timespec now;
    struct tm utc;
    vsnprintf(text, sizeof text, format, list);
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &utc);
    const size_t length = strftime(when, sizeof when, "%Y-%m-%dT%H:%M:%S", &utc);
    snprintf(when + length, sizeof when - length, ".%03ldZ", now.tv_nsec / 1000000);
    json_t *line = pack(when, what, text);
    if (!line) { /* no UTF-8 */
        for (char *c = text; *c; c++)
            if ((unsigned char)*c >= 0x7F || (unsigned char)*c < ' ') *c = '?';
        line = pack(when, what, text);
    }
    if (line && more) json_object_update(line, more);
    if (line && a->file) {
        json_dumpf(line, a->file, JSON_COMPACT | JSON_PRESERVE_ORDER);
        fputc('\n', a->file);
        if (fflush(a->file) != 0) {
            fprintf(stderr, "warning: %s: the record cannot be written any more: %s\n", a->path,
                    strerror(errno));
            audit_close(a);
        }
    }
    json_decref(line);
    json_decref(more);
}

void audit_line(audit *a, const char *what, json_t *more, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    write_line(a, what, more, format, list);
    va_end(list);
}

void audit_stranger(audit *a, const char *what, const char *format, ...)
{
    const double now = td_machine_now_s();
    va_list list;
    if (now > a->window_s + 1) {
        if (a->left_out) audit_line(a, "refused", NULL, "%ld more like these", a->left_out);
        a->left_out = 0;
        a->strangers = 0;
        a->window_s = now;
    }
    if (++a->strangers > STRANGERS_A_SECOND) {
        a->left_out++;
        return;
    }
    va_start(list, format);
    write_line(a, what, NULL, format, list);
    va_end(list);
}
