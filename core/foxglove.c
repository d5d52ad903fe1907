#include "core/foxglove.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/bytes_internal.h"
#include "core/report_internal.h"
#include "core/text_internal.h"

/* Foxglove's codes of number types. */
enum { UINT8 = 1, FLOAT32 = 7 };
enum { DIGITS = 12 };

/* Parts. Each is NULL when it fails; what is packed of a NULL is NULL. */

static json_t *time_of(uint64_t ns)
{
    return json_pack("{s:I,s:I}", "sec", (json_int_t)(ns / 1000000000), "nsec",
                     (json_int_t)(ns % 1000000000));
}

static json_t *vector(const double v[3])
{
    return json_pack("{s:f,s:f,s:f}", "x", v[0], "y", v[1], "z", v[2]);
}

static json_t *quaternion(const double q[4])
{
    return json_pack("{s:f,s:f,s:f,s:f}", "x", q[1], "y", q[2], "z", q[3], "w", q[0]);
}

static json_t *pose_of(const td_pose *pose)
{
    return json_pack("{s:o,s:o}", "position", vector(pose->t), "orientation", quaternion(pose->q));
}

static json_t *color_of(const double rgba[4])
{
    return json_pack("{s:f,s:f,s:f,s:f}", "r", rgba[0], "g", rgba[1], "b", rgba[2], "a", rgba[3]);
}

static json_t *packed_field(const char *name, int offset, int type)
{
    return json_pack("{s:s,s:i,s:i}", "name", name, "offset", offset, "type", type);
}

static json_t *base64(const unsigned char *bytes, size_t size)
{
    td_text text = {0};
    td_markup_base64(&text, bytes, size);
    json_t *string = text.failed ? NULL : json_stringn_nocheck(text.data ? text.data : "", text.size);
    free(text.data);
    return string;
}

/* Appends, and puts NULL in the place of an array that cannot have it. */
static void append(json_t **array, json_t *item)
{
    if (*array && json_array_append_new(*array, item) == 0) return;
    if (!*array) json_decref(item);
    json_decref(*array);
    *array = NULL;
}

/* The text of a message, which is freed. NULL: it could not be built. */
static td_status give(char **json, size_t *size, json_t *message, td_error *error)
{
    char *text = message ? json_dumps(message, JSON_COMPACT | JSON_REAL_PRECISION(DIGITS)) : NULL;
    json_decref(message);
    *json = text;
    *size = text ? strlen(text) : 0;
    return text ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a message");
}

/* What json_pack cannot take, told beforehand: then its failures are those of memory. */
static td_status check_text(const char *text, const char *field, td_error *error)
{
    if (text && td_utf8_check(text, strlen(text)) == strlen(text)) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "a message's %s is not UTF-8; name it in plain text", field);
}

static td_status check_numbers(const double *x, int count, const char *field, td_error *error)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return td_fail(error, TD_ERROR_DATA, "a message's %s holds a number that is not finite", field);
    return TD_OK;
}

static td_status check_pose(const td_pose *pose, const char *field, td_error *error)
{
    TD_TRY(check_numbers(pose->q, 4, field, error));
    return check_numbers(pose->t, 3, field, error);
}

/* Messages */

static json_t *transform(const char *parent, const char *child, const td_pose *parent_from_child,
                         uint64_t time_ns)
{
    return json_pack("{s:o,s:s,s:s,s:o,s:o}", "timestamp", time_of(time_ns), "parent_frame_id", parent,
                     "child_frame_id", child, "translation", vector(parent_from_child->t), "rotation",
                     quaternion(parent_from_child->q));
}

td_status td_foxglove_transforms(char **json, size_t *size, const td_robot *robot, const double *q,
                                 const char *ground, const td_pose *site_from_vehicle, uint64_t time_ns,
                                 td_error *error)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    *json = NULL;
    TD_TRY(check_numbers(q, robot->joint_count, "joints", error));
    if (site_from_vehicle) {
        TD_TRY(check_pose(site_from_vehicle, "site_from_vehicle", error));
        TD_TRY(check_text(ground, "ground frame", error));
    }
    td_robot_forward(root_from_link, robot, q);
    json_t *all = json_array();
    if (site_from_vehicle) append(&all, transform(ground, robot->link[0].name, site_from_vehicle, time_ns));
    for (int i = 1; i < robot->link_count; i++) {
        const int parent = robot->link[i].parent;
        const td_pose parent_from_root = td_pose_inverse(&root_from_link[parent]);
        const td_pose parent_from_link = td_pose_compose(&parent_from_root, &root_from_link[i]);
        append(&all, transform(robot->link[parent].name, robot->link[i].name, &parent_from_link, time_ns));
    }
    return give(json, size, json_pack("{s:o}", "transforms", all), error);
}

td_status td_foxglove_pose(char **json, size_t *size, const td_pose *frame_from_object, const char *frame,
                           uint64_t time_ns, td_error *error)
{
    *json = NULL;
    TD_TRY(check_text(frame, "frame", error));
    TD_TRY(check_pose(frame_from_object, "pose", error));
    return give(json, size,
                json_pack("{s:o,s:s,s:o}", "timestamp", time_of(time_ns), "frame_id", frame, "pose",
                          pose_of(frame_from_object)),
                error);
}

/* A box, a sphere, a cylinder of full lengths. */
static json_t *solid(const td_pose *pose, double x, double y, double z, const double rgba[4])
{
    return json_pack("{s:o,s:o,s:o}", "pose", pose_of(pose), "size", vector((const double[]){x, y, z}),
                     "color", color_of(rgba));
}

static json_t *cylinder(const td_pose *pose, double radius, double length, const double rgba[4])
{
    json_t *made = solid(pose, 2 * radius, 2 * radius, length, rgba), *one = json_real(1),
           *other = json_real(1);
    const int failed =
        json_object_set_new(made, "bottom_scale", one) | json_object_set_new(made, "top_scale", other);
    if (!failed) return made;
    json_decref(made);
    return NULL;
}

typedef struct shapes {
    json_t *cubes, *spheres, *cylinders;
} shapes;

static void add_shape(shapes *to, const td_primitive *p, const double rgba[4])
{
    const double *s = p->size;
    if (p->kind == TD_PRIMITIVE_BOX) append(&to->cubes, solid(&p->link_from_shape, s[0], s[1], s[2], rgba));
    if (p->kind == TD_PRIMITIVE_SPHERE)
        append(&to->spheres, solid(&p->link_from_shape, 2 * s[0], 2 * s[0], 2 * s[0], rgba));
    if (p->kind != TD_PRIMITIVE_CAPSULE) return;
    append(&to->cylinders, cylinder(&p->link_from_shape, s[0], s[1], rgba));
    for (int end = -1; end <= 1; end += 2) {
        td_pose ball = p->link_from_shape;
        td_pose_transform(ball.t, &p->link_from_shape, (const double[]){0, 0, end * s[1] / 2});
        append(&to->spheres, solid(&ball, 2 * s[0], 2 * s[0], 2 * s[0], rgba));
    }
}

static json_t *entity(const td_robot_link *link, const double rgba[4], uint64_t time_ns)
{
    shapes all = {json_array(), json_array(), json_array()};
    for (int i = 0; i < link->shape_count; i++) add_shape(&all, link->shape + i, rgba);
    return json_pack("{s:o,s:s,s:s,s:{s:i,s:i},s:b,s:[],s:[],s:o,s:o,s:o,s:[],s:[],s:[],s:[]}", "timestamp",
                     time_of(time_ns), "frame_id", link->name, "id", link->name, "lifetime", "sec", 0, "nsec",
                     0, "frame_locked", 1, "metadata", "arrows", "cubes", all.cubes, "spheres", all.spheres,
                     "cylinders", all.cylinders, "lines", "triangles", "texts", "models");
}

td_status td_foxglove_machine(char **json, size_t *size, const td_robot *robot, const double rgba[4],
                              uint64_t time_ns, td_error *error)
{
    *json = NULL;
    TD_TRY(check_numbers(rgba, 4, "colour", error));
    json_t *all = json_array();
    for (int i = 0; i < robot->link_count; i++)
        if (robot->link[i].shape_count > 0) append(&all, entity(robot->link + i, rgba, time_ns));
    return give(json, size, json_pack("{s:[],s:o}", "deletions", "entities", all), error);
}

td_status td_foxglove_grid(char **json, size_t *size, const td_elevation *map, uint64_t time_ns,
                           td_error *error)
{
    enum { STRIDE = 9 };
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    *json = NULL;
    TD_TRY(check_text(map->frame, "frame", error));
    TD_TRY(check_numbers(map->origin, 2, "origin", error));
    if (cells > TD_FOXGLOVE_MAX_CELLS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "a map of %zu cells is too large for a message of at most %d", cells,
                       (int)TD_FOXGLOVE_MAX_CELLS);
    unsigned char *bytes = malloc(cells * STRIDE + 1), *at = bytes;
    for (size_t i = 0; bytes && i < cells; i++) {
        td_put_float(&at, map->height[i]);
        td_put_float(&at, map->sigma[i]);
        td_put(&at, map->provenance[i], 1);
    }
    /* The message's pose is the corner of the first cell, the map's origin its centre. */
    const double half = map->cell_m / 2;
    td_pose corner = td_pose_identity();
    for (int i = 0; i < 2; i++) corner.t[i] = map->origin[i] - half;
    json_t *data = bytes ? base64(bytes, cells * STRIDE) : NULL;
    free(bytes);
    return give(json, size,
                json_pack("{s:o,s:s,s:o,s:i,s:{s:f,s:f},s:I,s:i,s:[o,o,o],s:o}", "timestamp",
                          time_of(time_ns), "frame_id", map->frame, "pose", pose_of(&corner), "column_count",
                          map->columns, "cell_size", "x", map->cell_m, "y", map->cell_m, "row_stride",
                          (json_int_t)map->columns * STRIDE, "cell_stride", (int)STRIDE, "fields",
                          packed_field("height", 0, FLOAT32), packed_field("sigma", 4, FLOAT32),
                          packed_field("provenance", 8, UINT8), "data", data),
                error);
}

td_status td_foxglove_log(char **json, size_t *size, td_log_level level, const char *topic, const char *text,
                          uint64_t time_ns, td_error *error)
{
    *json = NULL;
    TD_TRY(check_text(topic, "topic", error));
    TD_TRY(check_text(text, "text", error));
    /* Foxglove's levels begin with 1, debug. */
    return give(json, size,
                json_pack("{s:o,s:i,s:s,s:s,s:s,s:i}", "timestamp", time_of(time_ns), "level", (int)level + 1,
                          "message", text, "name", topic, "file", "", "line", 0),
                error);
}

td_status td_foxglove_image(char **json, size_t *size, const void *bytes, size_t byte_count,
                            const char *format, const char *frame, uint64_t time_ns, td_error *error)
{
    *json = NULL;
    TD_TRY(check_text(frame, "frame", error));
    TD_TRY(check_text(format, "format", error));
    return give(json, size,
                json_pack("{s:o,s:s,s:o,s:s}", "timestamp", time_of(time_ns), "frame_id", frame, "data",
                          base64(bytes, byte_count), "format", format),
                error);
}

td_status td_foxglove_cloud(char **json, size_t *size, const td_cloud *cloud, const char *frame,
                            uint64_t time_ns, td_error *error)
{
    static const char *const name[] = {"x", "y", "z", "sigma", "red", "green", "blue", "alpha"};
    enum { STRIDE = 20, FIELDS = sizeof name / sizeof *name };
    *json = NULL;
    TD_TRY(check_text(frame, "frame", error));
    if (cloud->count > TD_FOXGLOVE_MAX_POINTS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "a cloud of %zu points is too large for a message of at most %d", cloud->count,
                       (int)TD_FOXGLOVE_MAX_POINTS);
    td_pose first = td_pose_identity();
    if (cloud->count > 0) memcpy(first.t, cloud->point[0].p, sizeof first.t);
    TD_TRY(check_pose(&first, "first point", error));
    unsigned char *bytes = malloc(cloud->count * STRIDE + 1), *at = bytes;
    for (size_t i = 0; bytes && i < cloud->count; i++) {
        const td_cloud_point *p = cloud->point + i;
        for (int k = 0; k < 3; k++) td_put_float(&at, (float)(p->p[k] - first.t[k]));
        td_put_float(&at, p->sigma);
        for (int k = 0; k < 3; k++) td_put(&at, p->rgb[k], 1);
        td_put(&at, 255, 1);
    }
    json_t *fields = json_array();
    for (int i = 0; i < FIELDS; i++)
        append(&fields, packed_field(name[i], i < 4 ? 4 * i : 12 + i, i < 4 ? FLOAT32 : UINT8));
    json_t *data = bytes ? base64(bytes, cloud->count * STRIDE) : NULL;
    free(bytes);
    return give(json, size,
                json_pack("{s:o,s:s,s:o,s:i,s:o,s:o}", "timestamp", time_of(time_ns), "frame_id", frame,
                          "pose", pose_of(&first), "point_stride", (int)STRIDE, "fields", fields, "data",
                          data),
                error);
}

td_status td_foxglove_joints(char **json, size_t *size, const td_robot *robot, const td_plant_state *state,
                             uint64_t time_ns, td_error *error)
{
    *json = NULL;
    TD_TRY(check_numbers(state->q, robot->joint_count, "joints", error));
    TD_TRY(check_numbers(state->dq, robot->joint_count, "rates", error));
    TD_TRY(check_numbers(state->force, robot->joint_count, "forces", error));
    json_t *all = json_array();
    for (int i = 0; i < robot->joint_count; i++)
        append(&all, json_pack("{s:s,s:f,s:f,s:f}", "name", robot->joint[i].name, "position", state->q[i],
                               "rate", state->dq[i], "force", state->force[i]));
    return give(json, size, json_pack("{s:o,s:o}", "timestamp", time_of(time_ns), "joints", all), error);
}
