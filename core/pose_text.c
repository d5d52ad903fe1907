/* Poses in the words of URDF and ROS. */
#include <math.h>
#include <stdlib.h>

#include "core/rig_formats_internal.h"

#include "core/number.h"

static void add_numbers(td_text *out, const double *value, int count)
{
    char number[TD_NUMBER_SIZE];
    for (int i = 0; i < count; i++)
        td_text_format(out, "%s%s", i ? " " : "", td_number_format(number, value[i] + 0.0 /* no -0 */, 0));
}

static char *text_of(td_text *out)
{
    if (!out->failed) return out->data;
    free(out->data);
    return NULL;
}

/* R = Rz(yaw) Ry(pitch) Rx(roll). Roll is taken from what is left once yaw is undone, so that both together
 * are right where pitch is a right angle and neither is determined by itself. */
static void roll_pitch_yaw(double rpy[3], const td_pose *pose)
{
    double r[9];
    td_pose_rotation(r, pose);
    const double yaw = atan2(r[3], r[0]), c = cos(yaw), s = sin(yaw);
    rpy[0] = atan2(s * r[2] - c * r[5], c * r[4] - s * r[1]);
    rpy[1] = atan2(-r[6], hypot(r[0], r[3]));
    rpy[2] = yaw;
}

char *td_pose_to_urdf(const td_pose *a_from_b)
{
    double rpy[3];
    td_text out = {0};
    roll_pitch_yaw(rpy, a_from_b);
    td_text_format(&out, "<origin xyz=\"");
    add_numbers(&out, a_from_b->t, 3);
    td_text_format(&out, "\" rpy=\"");
    add_numbers(&out, rpy, 3);
    td_text_format(&out, "\"/>");
    return text_of(&out);
}

char *td_pose_to_ros(const td_pose *a_from_b, const char *a, const char *b)
{
    const double *q = a_from_b->q, xyzw[4] = {q[1], q[2], q[3], q[0]};
    td_text out = {0};
    add_numbers(&out, a_from_b->t, 3);
    td_text_format(&out, " ");
    add_numbers(&out, xyzw, 4);
    td_text_format(&out, " %s %s", a, b);
    return text_of(&out);
}
