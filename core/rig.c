#include "core/rig.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/text_internal.h"

enum { POSE_PARAMETERS = 6 };

static const double QUATERNION_TOLERANCE = 1e-12, SYMMETRY_TOLERANCE = 1e-9, LARGEST_TRANSLATION_M = 1e5;

td_rig *td_rig_new(void)
{
    return calloc(1, sizeof(td_rig));
}

td_rig *td_rig_copy(const td_rig *rig)
{
    td_rig *copy = td_rig_new();
    if (!copy) return NULL;
    *copy = *rig;
    const size_t n = td_rig_parameter_count(rig), size = n * n * sizeof(double);
    copy->covariance = rig->covariance ? malloc(size + 1) : NULL;
    copy->provenance = rig->provenance ? json_deep_copy(rig->provenance) : NULL;
    if ((rig->covariance && !copy->covariance) || (rig->provenance && !copy->provenance))
        td_rig_free(&copy);
    else if (rig->covariance)
        memcpy(copy->covariance, rig->covariance, size);
    return copy;
}

void td_rig_free(td_rig **rig)
{
    if (!rig || !*rig) return;
    free((*rig)->covariance);
    json_decref((*rig)->provenance);
    free(*rig);
    *rig = NULL;
}

size_t td_rig_parameter_offset(const td_rig *rig, int index)
{
    size_t offset = 0;
    for (int i = 0; i < index; i++)
        offset += (size_t)td_camera_parameter_count(rig->camera[i].camera.model) + POSE_PARAMETERS;
    return offset;
}

size_t td_rig_parameter_count(const td_rig *rig)
{
    return td_rig_parameter_offset(rig, rig->count);
}

char *td_rig_parameter_name(char text[TD_NAME_SIZE + 8], const td_rig *rig, size_t index)
{
    static const char *const pose[POSE_PARAMETERS] = {"rx", "ry", "rz", "tx", "ty", "tz"};
    text[0] = 0;
    for (int i = 0; i < rig->count; i++) {
        const td_camera_model model = rig->camera[i].camera.model;
        const size_t intern = (size_t)td_camera_parameter_count(model);
        if (index < intern + POSE_PARAMETERS) {
            const char *name =
                index < intern ? td_camera_parameter_name(model, (int)index) : pose[index - intern];
            snprintf(text, TD_NAME_SIZE + 8, "%s.%s", rig->camera[i].name, name);
            return text;
        }
        index -= intern + POSE_PARAMETERS;
    }
    return text;
}

int td_rig_find(const td_rig *rig, const char *name)
{
    for (int i = 0; i < rig->count; i++)
        if (!strcmp(rig->camera[i].name, name)) return i;
    return -1;
}

static td_status check_name(const td_rig *rig, int index, td_error *error)
{
    /* The name may lack its end: it is only known to be good after the first test. */
    char name[TD_NAME_SIZE + 1] = "", shown[TD_SHOWN_SIZE];
    memcpy(name, rig->camera[index].name, TD_NAME_SIZE);
    if (!td_name_is_plain(name))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "cameras[%d].name: '%s' must be 1 to %d letters, digits, - and _", index,
                       td_text_shown(shown, name), TD_NAME_SIZE - 1);
    if (td_rig_find(rig, name) != index)
        return td_fail(error, TD_ERROR_ARGUMENT, "cameras[%d].name: '%s' is given twice", index, name);
    return TD_OK;
}

static td_status check_pose(const td_pose *pose, const char *where, td_error *error)
{
    const double *q = pose->q, *t = pose->t;
    const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(fabs(length - 1) <= QUATERNION_TOLERANCE))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s.q: must be a unit quaternion", where);
    for (int i = 0; i < 3; i++)
        if (!(fabs(t[i]) <= LARGEST_TRANSLATION_M))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s.t_m: must be finite and at most 100 km", where);
    return TD_OK;
}

static td_status check_camera(const td_rig *rig, int index, td_error *error)
{
    const td_rig_camera *camera = rig->camera + index;
    TD_TRY(check_name(rig, index, error));
    td_error why;
    if (td_camera_check(&camera->camera, &why) != TD_OK)
        return td_fail(error, TD_ERROR_ARGUMENT, "cameras.%s: %s", camera->name, why.message);
    char where[TD_NAME_SIZE + 32];
    snprintf(where, sizeof where, "cameras.%s.camera_from_rig", camera->name);
    return check_pose(&camera->camera_from_rig, where, error);
}

static td_status check_first_camera(const td_rig *rig, td_error *error)
{
    const td_pose *pose = &rig->camera[0].camera_from_rig, identity = td_pose_identity();
    for (int i = 0; i < 7; i++) {
        const double seen = i < 4 ? pose->q[i] : pose->t[i - 4],
                     wanted = i < 4 ? identity.q[i] : identity.t[i - 4];
        if (seen != wanted)
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "cameras.%s.camera_from_rig: must be the identity, for the first camera's frame is the rig's",
                rig->camera[0].name);
    }
    return TD_OK;
}

static td_status check_variance(const td_rig *rig, size_t i, td_error *error)
{
    const size_t n = td_rig_parameter_count(rig);
    const size_t pose = (size_t)td_camera_parameter_count(rig->camera[0].camera.model);
    const double *row = rig->covariance + i * n;
    char name[TD_NAME_SIZE + 8], other[TD_NAME_SIZE + 8];
    td_rig_parameter_name(name, rig, i);
    if (!(row[i] >= 0 && isfinite(row[i])))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "covariance: the variance of %s is %g; must be finite and not negative", name, row[i]);
    for (size_t j = 0; j < n; j++) {
        const double twin = rig->covariance[j * n + i],
                     scale = sqrt(row[i]) * sqrt(rig->covariance[j * n + j]);
        if (!isfinite(row[j]))
            return td_fail(error, TD_ERROR_ARGUMENT, "covariance: that of %s and %s is not finite", name,
                           td_rig_parameter_name(other, rig, j));
        if (row[j] != twin && !(fabs(row[j] - twin) <= SYMMETRY_TOLERANCE * scale))
            return td_fail(error, TD_ERROR_ARGUMENT, "covariance: is not symmetric: %g and %g for %s and %s",
                           row[j], twin, name, td_rig_parameter_name(other, rig, j));
        if (i >= pose && i < pose + POSE_PARAMETERS && row[j] != 0)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "covariance: must be zero for %s, for the first camera's frame is the rig's",
                           name);
    }
    return TD_OK;
}

td_status td_rig_check(const td_rig *rig, td_error *error)
{
    if (rig->count < 1 || rig->count > TD_RIG_MAX_CAMERAS)
        return td_fail(error, TD_ERROR_ARGUMENT, "cameras: there are %d, but must be 1 to %d", rig->count,
                       TD_RIG_MAX_CAMERAS);
    for (int i = 0; i < rig->count; i++) TD_TRY(check_camera(rig, i, error));
    TD_TRY(check_first_camera(rig, error));
    if (rig->has_vehicle) TD_TRY(check_pose(&rig->vehicle_from_rig, "vehicle_from_rig", error));
    for (size_t i = 0; rig->covariance && i < td_rig_parameter_count(rig); i++)
        TD_TRY(check_variance(rig, i, error));
    if (rig->provenance && !json_is_object(rig->provenance))
        return td_fail(error, TD_ERROR_ARGUMENT, "provenance: must be a mapping");
    return TD_OK;
}
