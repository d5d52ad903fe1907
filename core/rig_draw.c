#include "core/rig_draw.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/pose.h"

void td_rig_move(td_rig *rig, const double *step)
{
    for (int c = 0; c < rig->count; c++) {
        td_rig_camera *camera = &rig->camera[c];
        const double *own = step + td_rig_parameter_offset(rig, c);
        const int count = td_camera_parameter_count(camera->camera.model);
        for (int k = 0; k < count; k++) camera->camera.parameter[k] += own[k];
        if (c) camera->camera_from_rig = td_pose_perturb(&camera->camera_from_rig, own + count);
    }
}

/* In place, l (n,n) with s = l l^T below the diagonal; a row whose variance is none, or is that of the rows
 * before it to rounding, becomes zero. */
static void factor(double *l, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k <= i; k++) {
            double sum = l[i * n + k];
            for (size_t j = 0; j < k; j++) sum -= l[i * n + j] * l[k * n + j];
            if (i == k)
                l[i * n + i] = sum > 1e-13 * l[i * n + i] ? sqrt(sum) : 0;
            else
                l[i * n + k] = l[k * n + k] > 0 ? sum / l[k * n + k] : 0;
        }
}

td_status td_rig_draw(td_rig **drawn, const td_rig *rig, double times, td_random *random, td_error *error)
{
    const size_t n = td_rig_parameter_count(rig);
    *drawn = NULL;
    if (!rig->covariance) return td_fail(error, TD_ERROR_DATA, "the rig has no covariance to be drawn from");
    double *l = malloc((n * n + 2 * n) * sizeof *l), *z = l ? l + n * n : NULL, *step = l ? z + n : NULL;
    td_rig *made = td_rig_copy(rig);
    if (!l || !made) {
        free(l);
        td_rig_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory to draw a rig");
    }
    memcpy(l, rig->covariance, n * n * sizeof *l);
    factor(l, n);
    for (size_t i = 0; i < n; i++) z[i] = td_random_normal(random);
    for (size_t i = 0; i < n; i++) {
        step[i] = 0;
        for (size_t k = 0; k <= i; k++) step[i] += times * l[i * n + k] * z[k];
    }
    td_rig_move(made, step);
    free(l);
    td_status status = td_rig_check(made, error);
    if (status != TD_OK)
        td_rig_free(&made);
    else
        *drawn = made;
    return status;
}
