/* Two cameras' figures on new views: distance from epipolar lines, triangulated size, and what noise and the
 * rig's covariance let expect.
 *
 * Of a point triangulated at y by least squares, four residuals r (two in each image) stay, J = du/dy (4,3).
 * The unit vector v that J leaves out, v^T J = 0, holds all of them: a change du of the projections or of the
 * pixels changes v^T r and, by Gauss and Newton, y by -(J^T J)^-1 J^T du. Divided by the length of v's half
 * of the second image, v^T r is the distance there from the epipolar line if the first image is taken as
 * exact. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/drift_internal.h"
#include "core/stereo.h"
#include "core/linalg.h"

/* A point that both cameras saw. */
typedef struct shared_point {
    double y[3];        /* triangulated, in the rig's frame, m */
    double distance;    /* px, signed: positive below the line, or right of a steep one */
    double normal[4];   /* v, scaled to unit length in the second image */
    double solve[12];   /* (J^T J)^-1 J^T, (3,4) */
    double weight[3];   /* of y in the mean scale */
    double variance[2]; /* of each coordinate in the first and the second image */
} shared_point;

typedef struct shared {
    size_t count, views;
    shared_point *point;
} shared;

/* (J^T J)^-1 J^T and the unit vector that it leaves out, by the three-fold cross product of J's columns. */
static bool invert(shared_point *s, const double j[12])
{
    double normal[9] = {0};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            for (int k = 0; k < 4; k++) normal[3 * a + b] += j[3 * k + a] * j[3 * k + b];
    if (td_invert_spd(normal, normal, 3, NULL) != TD_OK) return false;
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < 4; k++)
            s->solve[4 * a + k] = normal[3 * a] * j[3 * k] + normal[3 * a + 1] * j[3 * k + 1] +
                                  normal[3 * a + 2] * j[3 * k + 2];
    for (int k = 0; k < 4; k++) {
        const double *r[3];
        for (int i = 0, n = 0; i < 4; i++)
            if (i != k) r[n++] = j + 3 * i;
        double minor = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1]) -
                       r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0]) +
                       r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
        s->normal[k] = k % 2 ? -minor : minor;
    }
    double length = hypot(s->normal[2], s->normal[3]);
    double sign = s->normal[fabs(s->normal[3]) > fabs(s->normal[2]) ? 3 : 2] > 0 ? 1 : -1;
    for (int k = 0; k < 4; k++) s->normal[k] *= sign / length;
    return length > 0;
}

/* Triangulates a point of a view, the first camera's frame being the rig's. */
static bool make_point(shared_point *s, const td_bundle *b, size_t view, int second, size_t p)
{
    double pixel[4], u[4], j[12], y2[3], rotation[9], by_camera[6];
    td_drift_row row;
    const td_rig_camera *cameras[2] = {&b->rig->camera[0], &b->rig->camera[second]};
    for (int k = 0; k < 2; k++) {
        int c = k ? second : 0;
        size_t i = td_bundle_index(b, view, c, p);
        if (!td_drift_row_make(&row, b, view, c, p)) return false;
        s->variance[k] = row.variance;
        for (size_t e = 0; e < 2; e++)
            pixel[2 * k + (int)e] = td_observations_get(b->observations, view, c)->point[2 * p + e] -
                                    (b->shift ? b->shift[2 * i + e] : 0);
    }
    if (!td_triangulate_pair(s->y, &cameras[0]->camera, &cameras[1]->camera, &cameras[1]->camera_from_rig,
                             pixel, pixel + 2))
        return false;
    td_pose_transform(y2, &cameras[1]->camera_from_rig, s->y);
    if (!td_camera_project(u, j, NULL, &cameras[0]->camera, s->y) ||
        !td_camera_project(u + 2, by_camera, NULL, &cameras[1]->camera, y2))
        return false;
    td_pose_rotation(rotation, &cameras[1]->camera_from_rig);
    td_multiply(j + 6, by_camera, rotation, 2, 3, 3);
    if (!invert(s, j)) return false;
    s->distance = 0;
    for (int k = 0; k < 4; k++) s->distance += s->normal[k] * (pixel[k] - u[k]);
    return true;
}

/* The points of a view, each weighted so that sum weight . y is 1 + the relative error of the target's size:
 * the scale of the triangulated points against the target for the view's rotation (Umeyama 1991), whose own
 * error counts in second order only. */
static void add_view(shared *s, const td_bundle *b, size_t view, int second)
{
    size_t points = td_target_point_count(&b->observations->target), first = s->count;
    double mean[3] = {0}, square = 0;
    for (size_t p = 0; p < points; p++) {
        shared_point *q = &s->point[s->count];
        if (!make_point(q, b, view, second, p)) continue;
        td_bundle_target_point(q->weight, b, view, p);
        s->count++;
    }
    size_t n = s->count - first;
    if (n < 4) {
        s->count = first;
        return;
    }
    for (size_t i = first; i < s->count; i++)
        for (int k = 0; k < 3; k++) mean[k] += s->point[i].weight[k] / (double)n;
    for (size_t i = first; i < s->count; i++)
        for (int k = 0; k < 3; k++) {
            s->point[i].weight[k] -= mean[k];
            square += s->point[i].weight[k] * s->point[i].weight[k];
        }
    for (size_t i = first; i < s->count; i++) {
        double *w = s->point[i].weight;
        for (int k = 0; k < 3; k++) w[k] /= square;
        td_pose_rotate(w, &b->rig_from_target[b->pose_of_view[view]], w);
    }
    s->views++;
}

/* Derivative (4,n) of a triangulated point's projections by the rig's parameters, y held. */
static bool by_rig(double *out, const shared_point *s, const td_rig *rig, int second)
{
    size_t n = td_rig_parameter_count(rig);
    memset(out, 0, 4 * n * sizeof *out);
    for (int side = 0; side < 2; side++) {
        const td_rig_camera *c = &rig->camera[side ? second : 0];
        size_t first = td_rig_parameter_offset(rig, side ? second : 0),
               count = (size_t)td_camera_parameter_count(c->camera.model);
        double x[3], u[2], d_point[6], d_parameter[2 * TD_CAMERA_MAX_PARAMETERS], move[18], by_pose[12];
        td_pose_transform(x, &c->camera_from_rig, s->y);
        if (!td_camera_project(u, d_point, d_parameter, &c->camera, x)) return false;
        td_pose_transform_jacobian(move, x);
        td_multiply(by_pose, d_point, move, 2, 3, 6);
        for (size_t e = 0; e < 2; e++) {
            double *row = out + (2 * (size_t)side + e) * n + first;
            memcpy(row, d_parameter + e * count, count * sizeof *row);
            if (side) memcpy(row + count, by_pose + 6 * e, 6 * sizeof *row);
        }
    }
    return true;
}

static double quadratic(const double *j, const double *s, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n && j[i] != 0; k++) sum += j[i] * s[i * n + k] * j[k];
    return sum;
}

/* What a change of the four projections does to a point's part of the scale. */
static void scale_by_projection(double out[4], const shared_point *s)
{
    for (int k = 0; k < 4; k++)
        out[k] =
            -(s->weight[0] * s->solve[k] + s->weight[1] * s->solve[4 + k] + s->weight[2] * s->solve[8 + k]);
}

/* Figures and what is expected of them; `work` (7,n). */
static void summarise(td_drift_pair *pair, const shared *s, const td_rig *rig, double *work)
{
    size_t n = td_rig_parameter_count(rig);
    double *j = work, *distance = j + 4 * n, *mean = distance + n, *scale = mean + n;
    double count = (double)s->count, views = (double)s->views, square = 0, expected = 0, noise[2] = {0},
           sum = 0;
    const double *covariance = rig->covariance;
    pair->scale_error = -1;
    for (size_t i = 0; i < s->count; i++) {
        const shared_point *p = &s->point[i];
        double by[4], variance = 0;
        scale_by_projection(by, p);
        square += p->distance * p->distance;
        sum += p->distance;
        for (int k = 0; k < 3; k++) pair->scale_error += p->weight[k] * p->y[k] / views;
        for (int k = 0; k < 4; k++) {
            variance += p->normal[k] * p->normal[k] * p->variance[k / 2];
            noise[1] += by[k] * by[k] * p->variance[k / 2] / (views * views);
        }
        noise[0] += variance / (count * count);
        expected += variance;
        if (!covariance || !by_rig(j, p, rig, pair->second)) continue;
        for (size_t k = 0; k < n; k++) {
            distance[k] = 0;
            for (size_t e = 0; e < 4; e++) {
                distance[k] += p->normal[e] * j[e * n + k];
                scale[k] += by[e] * j[e * n + k] / views;
            }
            mean[k] += distance[k] / count;
        }
        expected += quadratic(distance, covariance, n);
    }
    pair->epipolar_px = sqrt(square / count);
    pair->vertical_px = sum / count;
    if (!covariance) return;
    pair->predicted_epipolar_px = sqrt(expected / count);
    pair->sigma_vertical_px = sqrt(noise[0] + quadratic(mean, covariance, n));
    pair->sigma_scale_error = sqrt(noise[1] + quadratic(scale, covariance, n));
}

td_status td_drift_pair_measure(td_drift_pair *pair, const td_drift_views *views, const td_rig *rig,
                                int second, td_error *error)
{
    const td_bundle *b = &views->bundle;
    size_t n = td_rig_parameter_count(rig), most = 0;
    *pair = (td_drift_pair){.second = second,
                            .epipolar_px = NAN,
                            .predicted_epipolar_px = NAN,
                            .vertical_px = NAN,
                            .sigma_vertical_px = NAN,
                            .scale_error = NAN,
                            .sigma_scale_error = NAN,
                            .p_value = NAN};
    for (size_t v = 0; v < b->observations->view_count; v++) most += td_bundle_used(b, v, second);
    shared s = {.point = calloc(most + 1, sizeof *s.point)};
    double *work = calloc(7 * n, sizeof *work);
    td_status status =
        s.point && work ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", most);
    for (size_t v = 0; v < b->observations->view_count && status == TD_OK; v++)
        if (td_bundle_used(b, v, 0)) add_view(&s, b, v, second);
    if (status == TD_OK && s.count) {
        pair->views = s.views;
        pair->points = s.count;
        summarise(pair, &s, rig, work);
    }
    free(s.point);
    free(work);
    return status;
}
