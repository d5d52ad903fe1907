/* Where the joints would have to stand: Gauss and Newton's steps on the places of the target's corners and
 * the tool, damped, joints held within their limits. What is then left tells whether the goal can be reached,
 * before anything moves. */
#include <math.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "core/linalg.h"

enum { MOST_STEPS = 200, POINTS = TD_SERVO_MAX_POINTS + 1, N = TD_ROBOT_MAX_JOINTS };

typedef struct reach {
    const servo_scenario *s;
    const td_robot *robot;
    int count;
    double at[POINTS][3];     /* of the target's link */
    double wanted[POINTS][3]; /* root's frame */
} reach;

/* The points: corners, and the tool, in the link's frame and where they are to be. */
static void gather(reach *r, const td_pose *root_from_goal)
{
    const servo_target *t = &r->s->bucket;
    td_pose at[TD_ROBOT_MAX_LINKS];
    double corner[TD_SERVO_MAX_POINTS][3];
    const int count = servo_corners(corner, t);
    td_robot_forward(at, r->robot, r->s->q);
    const td_pose link_from_root = td_pose_inverse(at + t->link),
                  target_from_link = td_pose_inverse(&t->link_from_target);
    td_pose_transform(r->at[count], &link_from_root, at[r->s->tool].t);
    for (int i = 0; i < count; i++) td_pose_transform(r->at[i], &t->link_from_target, corner[i]);
    r->count = count + 1;
    for (int i = 0; i < r->count; i++) {
        double of_target[3];
        td_pose_transform(of_target, &target_from_link, r->at[i]);
        td_pose_transform(r->wanted[i], root_from_goal, of_target);
    }
}

/* Sum of squares, and the normal equations of a step. */
static double normal_equations(double *a, double *b, const reach *r, const double *q)
{
    const int n = r->robot->joint_count, link = r->s->bucket.link;
    td_pose at[TD_ROBOT_MAX_LINKS];
    double jacobian[6 * N], sum = 0;
    td_robot_forward(at, r->robot, q);
    td_robot_jacobian(jacobian, r->robot, at, link);
    memset(a, 0, (size_t)(n * n) * sizeof *a);
    memset(b, 0, (size_t)n * sizeof *b);
    for (int i = 0; i < r->count; i++) {
        double p[3], by[18], rows[3 * N];
        td_pose_transform(p, at + link, r->at[i]);
        td_pose_transform_jacobian(by, p);
        td_multiply(rows, by, jacobian, 3, 6, (size_t)n);
        for (int c = 0; c < 3; c++) {
            const double d = r->wanted[i][c] - p[c];
            sum += d * d;
            for (int k = 0; k < n; k++) {
                b[k] += rows[c * n + k] * d;
                for (int m = 0; m < n; m++) a[k * n + m] += rows[c * n + k] * rows[c * n + m];
            }
        }
    }
    return sum;
}

/* Joints at a stop that are to go on are left out, and the others go on without them. */
static bool step(double *next, const reach *r, const double *q, const double *a, const double *b,
                 double damping)
{
    const int n = r->robot->joint_count;
    double damped[N * N], way[N];
    memcpy(damped, a, (size_t)(n * n) * sizeof *a);
    double right[N];
    memcpy(right, b, (size_t)n * sizeof *b);
    for (int k = 0; k < n; k++) {
        const td_robot_joint *j = r->robot->joint + k;
        const bool held = (q[k] <= j->lower && b[k] < 0) || (q[k] >= j->upper && b[k] > 0);
        for (int m = 0; m < n && held; m++) damped[k * n + m] = damped[m * n + k] = 0;
        if (held) right[k] = 0;
        damped[k * n + k] += held ? 1 : damping;
    }
    if (td_invert_spd(damped, damped, (size_t)n, NULL) != TD_OK) return false;
    td_multiply(way, damped, right, (size_t)n, (size_t)n, 1);
    for (int k = 0; k < n; k++) {
        const td_robot_joint *j = r->robot->joint + k;
        next[k] = fmax(j->lower, fmin(j->upper, q[k] + way[k]));
    }
    return true;
}

double servo_reach(double *q, const servo_scenario *s, const td_pose *root_from_goal)
{
    reach r = {.s = s, .robot = s->scene->scene.robot};
    const size_t n = (size_t)r.robot->joint_count;
    double a[N * N], b[N], next[N], next_a[N * N], next_b[N], damping = 1e-3;
    gather(&r, root_from_goal);
    double sum = normal_equations(a, b, &r, q);
    for (int i = 0; i < MOST_STEPS && damping < 1e9; i++) {
        if (!step(next, &r, q, a, b, damping)) break;
        const double then = normal_equations(next_a, next_b, &r, next);
        if (!(then < sum)) {
            damping *= 10;
            continue;
        }
        memcpy(q, next, n * sizeof *q);
        memcpy(a, next_a, n * n * sizeof *a);
        memcpy(b, next_b, n * sizeof *b);
        sum = then;
        damping = fmax(damping / 10, 1e-9);
    }
    return sqrt(sum / r.count);
}
