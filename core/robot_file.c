#include "core/robot_internal.h"

td_status td_robot_parse_yaml(td_robot *robot, const char *text, size_t size, const char *name,
                              td_error *error)
{
    (void)robot;
    (void)text;
    (void)size;
    return td_fail(error, TD_ERROR_UNSUPPORTED, "%s: not read yet", name);
}
