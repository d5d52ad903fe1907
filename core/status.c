#include "core/status.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

const char *td_status_text(td_status status)
{
    switch (status) {
#define TD_STATUS_CASE(code, text)                                                                           \
    case code:                                                                                               \
        return text;
        TD_STATUS_LIST(TD_STATUS_CASE)
#undef TD_STATUS_CASE
    case TD_STATUS_COUNT:
        break;
    }
    return "unknown status";
}

td_status td_fail(td_error *error, td_status status, const char *format, ...)
{
    if (!error) return status;
    error->status = status;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(error->message, sizeof error->message, format, arguments);
    va_end(arguments);
    return status;
}

td_status td_error_prefix(td_error *error, td_status status, const char *format, ...)
{
    if (!error) return status;
    char joined[sizeof error->message];
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(joined, sizeof joined, format, arguments);
    va_end(arguments);
    if (length >= 0 && (size_t)length < sizeof joined)
        snprintf(joined + length, sizeof joined - (size_t)length, ": %s", error->message);
    memcpy(error->message, joined, sizeof joined);
    error->status = status;
    return status;
}
