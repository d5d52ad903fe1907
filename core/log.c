#include "core/log.h"

#include <stdarg.h>
#include <stdio.h>

void td_log_write(const td_log *log, td_log_level level, const char *topic, const char *format, ...)
{
    if (!log || !log->function) return;
    char text[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    log->function(level, topic, text, log->user);
}
