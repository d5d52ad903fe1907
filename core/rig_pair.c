/* The rectification that ROS and OpenCV write beside a pair: both cameras turned so that their x axes (y, for
 * cameras one above the other) lie along the baseline, the second's z axis as near as can be to the mean of
 * both, one focal length and one centre for both. */
#include <math.h>
#include <string.h>

#include "core/linalg.h"
#include "core/rig_formats_internal.h"

static const double LEAST_SINE = 0.3; /* between baseline and view: nearer, the images would be torn apart */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static double normalise(double v[3])
{
    const double length = sqrt(dot(v, v));
    for (int i = 0; i < 3; i++) v[i] /= length;
    return length;
}

/* Where the image centre's ray would be seen with focal length f and no offset; 0, 0 where there is none. */
static void centre_ray(double at[2], const td_camera *camera, const double r[9], double f)
{
    const double centre[2] = {(camera->width - 1) / 2., (camera->height - 1) / 2.};
    double ray[3], turned[3];
    at[0] = at[1] = 0;
    if (!td_camera_unproject(ray, NULL, NULL, camera, centre)) return;
    for (int i = 0; i < 3; i++) turned[i] = dot(r + 3 * i, ray);
    if (!(turned[2] > 0.1)) return;
    at[0] = f * turned[0] / turned[2];
    at[1] = f * turned[1] / turned[2];
}

static void choose_camera(td_rig_pair *pair, const td_rig *rig)
{
    const td_camera *a = &rig->camera[0].camera, *b = &rig->camera[1].camera;
    const int along = pair->vertical ? 0 : 1; /* the focal length across the baseline */
    pair->f = (a->parameter[along] + b->parameter[along]) / 2;
    double first[2], second[2];
    centre_ray(first, a, pair->r[0], pair->f);
    centre_ray(second, b, pair->r[1], pair->f);
    pair->c[0] = (a->width - 1) / 2. - (first[0] + second[0]) / 2;
    pair->c[1] = (a->height - 1) / 2. - (first[1] + second[1]) / 2;
}

bool td_rig_rectified(td_rig_pair *pair, const td_rig *rig)
{
    if (rig->count < 2) return false;
    const td_pose *second_from_first = &rig->camera[1].camera_from_rig;
    const td_pose first_from_second = td_pose_inverse(second_from_first);
    double base[3], z[3], side[3], r[9];
    memcpy(base, first_from_second.t, sizeof base);
    if (!(dot(base, base) > 1e-18)) return false;
    const double length = normalise(base);
    pair->vertical = fabs(base[1]) > fabs(base[0]);
    const double sign = base[pair->vertical ? 1 : 0] < 0 ? -1 : 1;
    for (int i = 0; i < 3; i++) base[i] *= sign;
    const double forward[3] = {0, 0, 1};
    td_pose_rotate(z, &first_from_second, forward);
    z[2] += 1;
    if (!(dot(z, z) > 0.5)) return false;
    normalise(z);
    /* x y z are base, z x base, base x side; vertical: base x z, base, side x base. */
    if (pair->vertical)
        cross(side, base, z);
    else
        cross(side, z, base);
    if (!(normalise(side) > LEAST_SINE)) return false;
    memcpy(pair->r[0] + (pair->vertical ? 3 : 0), base, sizeof base);
    memcpy(pair->r[0] + (pair->vertical ? 0 : 3), side, sizeof side);
    cross(pair->r[0] + 6, pair->r[0], pair->r[0] + 3);
    td_pose_rotation(r, second_from_first);
    td_multiply_transposed(pair->r[1], pair->r[0], r, 3, 3, 3);
    pair->t[0] = pair->t[1] = pair->t[2] = 0;
    pair->t[pair->vertical ? 1 : 0] = -sign * length;
    choose_camera(pair, rig);
    return true;
}
