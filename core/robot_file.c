/* The YAML beside a URDF, laid out as core/robot.h says. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/document.h"
#include "core/robot_internal.h"
#include "core/text_internal.h"

static const char KIND[] = "robot 1";
static const double LARGEST_LENGTH = 1e3, LARGEST = 1e12;

static bool is_given(const td_field *field)
{
    return field->value && !json_is_null(field->value);
}

static td_status check_kind(const td_field *root, td_error *error)
{
    const td_field field = td_field_get(root, "teledimos");
    const char *text = NULL;
    char shown[TD_SHOWN_SIZE];
    if (!field.value)
        return td_field_fail(
            root, error, "is no description of a robot: 'teledimos: %s' is missing at its beginning", KIND);
    TD_TRY(td_field_string(&text, &field, error));
    if (strcmp(text, KIND) == 0) return TD_OK;
    return td_field_fail(&field, error, "is '%s', but must be '%s'", td_text_shown(shown, text), KIND);
}

/* A positive real; absent: infinite. */
static td_status take_limit(double *value, const td_field *parent, const char *key, td_error *error)
{
    const td_field field = td_field_get(parent, key);
    if (!is_given(&field)) {
        *value = INFINITY;
        return TD_OK;
    }
    return td_field_real(value, &field, 1e-12, LARGEST, error);
}

static td_status take_length(double *value, const td_field *parent, const char *key, td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return td_field_real(value, &field, 1e-6, LARGEST_LENGTH, error);
}

static td_status take_point(double point[3], const td_field *parent, const char *key, td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return td_field_reals(point, 3, &field, -LARGEST_LENGTH, LARGEST_LENGTH, error);
}

/* The joint that a string names. */
static td_status take_joint(int *joint, const td_robot *robot, const td_field *field, td_error *error)
{
    const char *name = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_string(&name, field, error));
    *joint = td_robot_find_joint(robot, name);
    if (*joint >= 0) return TD_OK;
    return td_field_fail(field, error, "is '%s', which is no moving joint of the URDF",
                         td_text_shown(shown, name));
}

static td_status parse_joints(td_robot *robot, const td_field *field, td_error *error)
{
    static const char *const turning[] = {"name", "acceleration_rad_s2", NULL};
    static const char *const shifting[] = {"name", "acceleration_m_s2", NULL};
    size_t count = 0;
    bool seen[TD_ROBOT_MAX_JOINTS] = {false};
    if (!is_given(field)) return TD_OK;
    TD_TRY(td_field_count(&count, field, 0, TD_ROBOT_MAX_JOINTS, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field entry = td_field_at(field, i, index);
        const td_field name = td_field_get(&entry, "name");
        int k = 0;
        TD_TRY(take_joint(&k, robot, &name, error));
        const char *const *keys = robot->joint[k].kind == TD_JOINT_PRISMATIC ? shifting : turning;
        TD_TRY(td_field_check_keys(&entry, keys, error));
        if (seen[k]) return td_field_fail(&name, error, "'%s' is given twice", robot->joint[k].name);
        seen[k] = true;
        TD_TRY(take_limit(&robot->joint[k].acceleration, &entry, keys[1], error));
    }
    return TD_OK;
}

static td_status parse_four_bar(td_cylinder *c, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"parent_pivot_m", "child_pivot_m", "parent_bar_m",
                                       "child_bar_m",    "branch",        NULL};
    const td_field branch = td_field_get(field, "branch");
    TD_TRY(td_field_check_keys(field, keys, error));
    c->four_bar = true;
    TD_TRY(take_point(c->parent_pivot, field, keys[0], error));
    TD_TRY(take_point(c->child_pivot, field, keys[1], error));
    TD_TRY(take_length(&c->parent_bar_m, field, keys[2], error));
    TD_TRY(take_length(&c->child_bar_m, field, keys[3], error));
    TD_TRY(td_field_int(&c->branch, &branch, -1, 1, error));
    return c->branch ? TD_OK : td_field_fail(&branch, error, "is 0, but must be 1 or -1");
}

static td_status parse_drive(td_cylinder *c, const td_field *field, td_error *error)
{
    const td_field eye = td_field_get(field, "eye_m"), four_bar = td_field_get(field, "four_bar");
    if (is_given(&eye) == is_given(&four_bar))
        return td_field_fail(field, error, "needs either eye_m (it drives the joint directly) or four_bar");
    if (is_given(&four_bar)) return parse_four_bar(c, &four_bar, error);
    return take_point(c->eye, field, "eye_m", error);
}

static td_status parse_sizes(td_cylinder *c, const td_field *field, td_error *error)
{
    const td_field number = td_field_get(field, "count");
    c->count = 1;
    if (is_given(&number)) TD_TRY(td_field_int(&c->count, &number, 1, 16, error));
    TD_TRY(take_length(&c->bore_m, field, "bore_m", error));
    TD_TRY(take_length(&c->rod_m, field, "rod_m", error));
    TD_TRY(take_length(&c->shortest_m, field, "shortest_m", error));
    TD_TRY(take_length(&c->longest_m, field, "longest_m", error));
    TD_TRY(take_limit(&c->pressure_pa, field, "pressure_pa", error));
    TD_TRY(take_limit(&c->flow_m3_s, field, "flow_m3_s", error));
    if (c->rod_m >= c->bore_m)
        return td_field_fail(field, error, "the rod (%g m) is not thinner than the bore (%g m)", c->rod_m,
                             c->bore_m);
    if (c->shortest_m >= c->longest_m)
        return td_field_fail(field, error, "shortest_m (%g) is not below longest_m (%g)", c->shortest_m,
                             c->longest_m);
    return TD_OK;
}

static td_status parse_cylinder(td_robot *robot, td_field *field, td_error *error)
{
    static const char *const keys[] = {"name",        "joint",     "count",    "bore_m",     "rod_m",
                                       "root_m",      "eye_m",     "four_bar", "shortest_m", "longest_m",
                                       "pressure_pa", "flow_m3_s", NULL};
    td_cylinder *c = robot->cylinder + robot->cylinder_count;
    const td_field name = td_field_get(field, "name"), joint = td_field_get(field, "joint");
    const char *text = NULL;
    char why[TD_CYLINDER_WHY];
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_field_string(&text, &name, error));
    if (!td_name_is_plain(text))
        return td_field_fail(&name, error, "must be 1 to %d letters, digits, - and _", TD_NAME_SIZE - 1);
    strcpy(c->name, text);
    for (int i = 0; i < robot->cylinder_count; i++)
        if (strcmp(robot->cylinder[i].name, c->name) == 0)
            return td_field_fail(&name, error, "'%s' is given twice", c->name);
    field->name = c->name;
    TD_TRY(take_joint(&c->joint, robot, &joint, error));
    TD_TRY(take_point(c->root, field, "root_m", error));
    TD_TRY(parse_drive(c, field, error));
    TD_TRY(parse_sizes(c, field, error));
    if (td_cylinder_is_wrong(why, robot, c)) return td_field_fail(field, error, "%s", why);
    robot->cylinder_count++;
    return TD_OK;
}

static td_status parse_cylinders(td_robot *robot, const td_field *field, td_error *error)
{
    size_t count = 0;
    if (!is_given(field)) return TD_OK;
    TD_TRY(td_field_count(&count, field, 0, TD_ROBOT_MAX_CYLINDERS, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field cylinder = td_field_at(field, i, index);
        TD_TRY(parse_cylinder(robot, &cylinder, error));
    }
    return TD_OK;
}

static td_status parse_suspension(td_robot *robot, const td_field *field, td_error *error)
{
    static const char *const motions[] = {"heave", "pitch", "roll", NULL};
    static const char *const shift[] = {"stiffness_n_m", "damping_ns_m", NULL};
    static const char *const turn[] = {"stiffness_nm_rad", "damping_nms_rad", NULL};
    if (!is_given(field)) return TD_OK;
    TD_TRY(td_field_check_keys(field, motions, error));
    for (int i = 0; i < 3; i++) {
        const td_field motion = td_field_get(field, motions[i]);
        const char *const *keys = i == 0 ? shift : turn;
        if (!is_given(&motion)) continue;
        TD_TRY(td_field_check_keys(&motion, keys, error));
        const td_field stiffness = td_field_get(&motion, keys[0]), damping = td_field_get(&motion, keys[1]);
        TD_TRY(td_field_real(robot->suspension_n_m + i, &stiffness, 0, LARGEST, error));
        TD_TRY(td_field_real(robot->suspension_ns_m + i, &damping, 0, LARGEST, error));
    }
    return TD_OK;
}

static td_status parse_root(td_robot *robot, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"teledimos", "joints", "cylinders", "suspension", NULL};
    const td_field joints = td_field_get(root, "joints"), cylinders = td_field_get(root, "cylinders");
    const td_field suspension = td_field_get(root, "suspension");
    TD_TRY(check_kind(root, error));
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(parse_joints(robot, &joints, error));
    TD_TRY(parse_cylinders(robot, &cylinders, error));
    return parse_suspension(robot, &suspension, error);
}

td_status td_robot_parse_yaml(td_robot *robot, const char *text, size_t size, const char *name,
                              td_error *error)
{
    json_t *document = NULL;
    TD_TRY(td_document_parse(&document, text, size, name, error));
    const td_field root = {NULL, name, document};
    const td_status status = parse_root(robot, &root, error);
    json_decref(document);
    return status;
}
