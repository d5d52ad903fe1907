/* The image of a disc: its centre of gravity against the image of the disc's centre.
 *
 * By Green's theorem area and centre of gravity are integrals along the image of the rim alone, the same
 * numbers as the integral over the disc of the image position weighted by the projection's area Jacobian:
 *
 *   area = 1/2 int (x dy - y dx),   centroid = 1/(3 area) int (x, y) (x dy - y dx)
 *
 * The integrands are smooth and periodic in the angle, so the trapezoidal rule converges geometrically; 48
 * nodes leave less than 1e-6 px for any disc that spans up to a third of its distance. (Under a pinhole alone
 * the image is an ellipse, and its centre has a closed form; with distortion it has none. Heikkila 2000.) */
#include <math.h>

#include "calib/marks.h"

enum { NODES = 48 };

/* Two unit vectors that span the plane, with the normal a right-handed frame. */
static bool plane_axes(double u[3], double v[3], const double n[3])
{
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (!(length > 0)) return false;
    int least = fabs(n[0]) < fabs(n[1]) ? 0 : 1;
    if (fabs(n[2]) < fabs(n[least])) least = 2;
    int a = (least + 1) % 3, b = (least + 2) % 3;
    double across = hypot(n[a], n[b]);
    u[least] = 0;
    u[a] = n[b] / across;
    u[b] = -n[a] / across;
    v[0] = (n[1] * u[2] - n[2] * u[1]) / length;
    v[1] = (n[2] * u[0] - n[0] * u[2]) / length;
    v[2] = (n[0] * u[1] - n[1] * u[0]) / length;
    return true;
}

/* Image of centre + a u + b v relative to `origin`, and its derivatives by a and b as the columns of `d`. */
static bool project(double pixel[2], double d[4], const td_camera *camera, const double centre[3],
                    const double u[3], const double v[3], double a, double b, const double origin[2])
{
    double p[3], d_point[6];
    for (int i = 0; i < 3; i++) p[i] = centre[i] + a * u[i] + b * v[i];
    if (!td_camera_project(pixel, d_point, NULL, camera, p)) return false;
    for (int i = 0; i < 2; i++) {
        pixel[i] -= origin[i];
        d[2 * i] = d_point[3 * i] * u[0] + d_point[3 * i + 1] * u[1] + d_point[3 * i + 2] * u[2];
        d[2 * i + 1] = d_point[3 * i] * v[0] + d_point[3 * i + 1] * v[1] + d_point[3 * i + 2] * v[2];
    }
    return true;
}

bool td_mark_bias(double bias[2], const td_camera *camera, const td_pose *camera_from_target,
                  const double centre[3], const double normal[3], double diameter_m)
{
    const double zero[2] = {0};
    double c[3], n[3], u[3], v[3], origin[2], d[4];
    td_pose_transform(c, camera_from_target, centre);
    td_pose_rotate(n, camera_from_target, normal);
    if (!plane_axes(u, v, n) || !project(origin, d, camera, c, u, v, 0, 0, zero)) return false;
    const double radius = 0.5 * diameter_m, side = d[0] * d[3] - d[1] * d[2];
    if (side == 0 || !isfinite(side)) return false;

    double area = 0, moment[2] = {0};
    for (int i = 0; i < NODES; i++) {
        double angle = 2 * 3.14159265358979323846 * i / NODES, cs = cos(angle), sn = sin(angle), q[2];
        if (!project(q, d, camera, c, u, v, radius * cs, radius * sn, origin)) return false;
        /* A model that folds within the disc has no image of it. */
        if (!((d[0] * d[3] - d[1] * d[2]) * side > 0)) return false;
        double dx = cs * d[1] - sn * d[0], dy = cs * d[3] - sn * d[2];
        double sweep = q[0] * dy - q[1] * dx;
        area += sweep / 2;
        moment[0] += sweep * q[0] / 3;
        moment[1] += sweep * q[1] / 3;
    }
    if (area == 0) return false;
    bias[0] = moment[0] / area;
    bias[1] = moment[1] / area;
    return true;
}
