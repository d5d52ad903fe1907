/* The pose of one tag: Levenberg-Marquardt over the whole camera model from both poses at which a small
 * square looks nearly the same (Schweighofer and Pinz 2006). */
#include <float.h>
#include <math.h>
#include <string.h>

#include "calib/homography.h"
#include "calib/tags.h"
#include "core/linalg.h"

enum { MOST_ITERATIONS = 50 };

static const double SAME_POSE = 1e-3; /* rad */

typedef struct problem {
    const td_camera *camera;
    double point[4][3];  /* tag frame, m */
    const double *pixel; /* (4,2) */
    double weight[4];    /* 1 / sigma, 1 / px */
} problem;

/* Sum of squared weighted residuals; normal equations when asked for. */
static bool evaluate(double *cost, double normal[36], double gradient[6], const problem *p,
                     const td_pose *pose)
{
    *cost = 0;
    if (normal) {
        memset(normal, 0, 36 * sizeof *normal);
        memset(gradient, 0, 6 * sizeof *gradient);
    }
    for (int k = 0; k < 4; k++) {
        double x[3], pixel[2], by_x[6], by_pose[18], j[12];
        td_pose_transform(x, pose, p->point[k]);
        if (!td_camera_project(pixel, by_x, NULL, p->camera, x)) return false;
        td_pose_transform_jacobian(by_pose, x);
        td_multiply(j, by_x, by_pose, 2, 3, 6);
        for (int c = 0; c < 2; c++) {
            double r = (pixel[c] - p->pixel[2 * k + c]) * p->weight[k];
            *cost += r * r;
            if (!normal) continue;
            for (int a = 0; a < 6; a++) {
                double ja = j[6 * c + a] * p->weight[k];
                gradient[a] += ja * r;
                for (int b = 0; b < 6; b++) normal[6 * a + b] += ja * j[6 * c + b] * p->weight[k];
            }
        }
    }
    return isfinite(*cost);
}

static bool minimise(td_pose *pose, double *cost, const problem *p)
{
    double damping = 1e-4, normal[36], gradient[6];
    if (!evaluate(cost, normal, gradient, p, pose)) return false;
    for (int i = 0; i < MOST_ITERATIONS && damping < 1e12; i++) {
        double damped[36], inverse[36], step[6], moved;
        memcpy(damped, normal, sizeof damped);
        for (int k = 0; k < 6; k++) damped[7 * k] *= 1 + damping;
        if (td_invert_spd(inverse, damped, 6, NULL) != TD_OK) return false;
        td_multiply(step, inverse, gradient, 6, 6, 1);
        for (int k = 0; k < 6; k++) step[k] = -step[k];
        td_pose trial = td_pose_perturb(pose, step);
        if (!evaluate(&moved, NULL, NULL, p, &trial) || moved > *cost) {
            damping *= 10;
            continue;
        }
        bool done = *cost - moved <= 1e-12 * *cost;
        *pose = trial;
        damping *= 0.1;
        if (!evaluate(cost, normal, gradient, p, pose)) return false;
        if (done) break;
    }
    return pose->t[2] > 0 || p->camera->model == TD_CAMERA_FISHEYE;
}

/* The pose that looks nearly the same: the normal mirrored at the line of sight to the tag. */
static td_pose other_pose(const td_pose *pose)
{
    const double z[3] = {0, 0, 1};
    double normal[3], axis[3], length = td_pose_distance(pose), c = 0, s = 0;
    td_pose turn = td_pose_identity(), turned;
    td_pose_rotate(normal, pose, z);
    for (int i = 0; i < 3; i++) {
        int a = (i + 1) % 3, b = (i + 2) % 3;
        axis[i] = (normal[a] * pose->t[b] - normal[b] * pose->t[a]) / length;
        s += axis[i] * axis[i];
        c += normal[i] * pose->t[i] / length;
    }
    s = sqrt(s);
    if (!(s > 0)) return *pose;
    for (int i = 0; i < 3; i++) axis[i] *= 2 * atan2(s, c) / s;
    td_rotation_exp(turn.q, axis);
    turned = td_pose_compose(&turn, pose);
    memcpy(turned.t, pose->t, sizeof turned.t); /* about the tag's own centre */
    return turned;
}

static bool set_up(problem *p, td_pose *start, const td_tag *tag, double size, const td_camera *camera)
{
    static const double corner[4][2] = {{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};
    double plane[8], ray[3], seen[8], h[9];
    bool measured = true;
    *p = (problem){.camera = camera, .pixel = tag->corner};
    for (int k = 0; k < 4; k++) measured = measured && tag->sigma[k] > 0;
    for (int k = 0; k < 4; k++) {
        p->weight[k] = measured ? 1 / tag->sigma[k] : 1;
        for (int c = 0; c < 2; c++) plane[2 * k + c] = p->point[k][c] = corner[k][c] * size;
        if (!td_camera_unproject(ray, NULL, NULL, camera, tag->corner + 2 * k) || !(ray[2] > 0)) return false;
        seen[2 * k] = ray[0] / ray[2];
        seen[2 * k + 1] = ray[1] / ray[2];
    }
    return td_homography(h, plane, seen, 4, NULL) == TD_OK &&
           td_pose_from_homography(start, h, NULL) == TD_OK;
}

bool td_tag_pose(td_pose *camera_from_tag, double *covariance, double *ratio, const td_tag *tag,
                 double size_m, const td_camera *camera)
{
    problem p;
    td_pose pose[2];
    double cost[2], normal[36], gradient[6], again;
    bool there[2];
    if (!(size_m > 0) || !set_up(&p, &pose[0], tag, size_m, camera)) return false;
    there[0] = minimise(&pose[0], &cost[0], &p);
    pose[1] = other_pose(&pose[0]);
    there[1] = minimise(&pose[1], &cost[1], &p);
    if (!there[0] && !there[1]) return false;
    td_pose inverse = td_pose_inverse(&pose[0]), apart = td_pose_compose(&pose[1], &inverse);
    if (there[0] && there[1] && td_pose_angle(&apart) < SAME_POSE)
        there[1] = false; /* there is one minimum */
    const int best = !there[0] || (there[1] && cost[1] < cost[0]);
    if (covariance && (!evaluate(&again, normal, gradient, &p, &pose[best]) ||
                       td_invert_spd(covariance, normal, 6, NULL) != TD_OK))
        return false;
    *camera_from_tag = pose[best];
    if (ratio)
        *ratio = there[!best] ? sqrt(fmax(cost[!best], DBL_MIN) / fmax(cost[best], DBL_MIN)) : INFINITY;
    return true;
}
