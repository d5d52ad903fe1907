/* Proves: the transforms of a message chain to the robot's own forward kinematics; its shapes are where the
 * robot's are; what cannot be said is refused with its field. Reference: core/robot.h; the shapes by hand.
 * The messages' form, and the other kinds, are in tests/apps/test_mcap.py. Tolerance: 12 digits are written.
 */
#include <jansson.h>

#include "core/foxglove.h"
#include "tests/check.h"

static const char URDF[] =
    "<robot name='r'><link name='base'><collision><origin xyz='1 2 3'/><geometry><box size='1 2 "
    "4'/></geometry>"
    "</collision></link><link name='arm'><collision><origin xyz='0 0 1' rpy='0 1.5707963267948966 "
    "0'/><geometry>"
    "<cylinder radius='0.5' length='2'/></geometry></collision><collision><geometry><sphere radius='0.25'/>"
    "</geometry></collision></link><link name='tool'/>"
    "<joint name='turn' type='revolute'><parent link='base'/><child link='arm'/><origin xyz='1 0 2' rpy='0.3 "
    "0 0.2'/>"
    "<axis xyz='0 1 0'/><limit lower='-2' upper='2' effort='1' velocity='1'/></joint>"
    "<joint name='slide' type='prismatic'><parent link='arm'/><child link='tool'/><origin xyz='0 0 3' rpy='0 "
    "0.4 0'/>"
    "<axis xyz='1 0 0'/><limit lower='0' upper='2' effort='1' velocity='1'/></joint></robot>";

static td_robot *robot_of(void)
{
    td_error error = {0};
    td_robot *robot = NULL;
    check_ok(td_robot_parse(&robot, URDF, sizeof URDF - 1, NULL, 0, "r.urdf", &error), error);
    return robot;
}

static json_t *parsed(char *json, size_t size)
{
    json_error_t error;
    json_t *value = json_loadb(json, size, 0, &error);
    if (!value) fail_msg("%s: %s", error.text, json);
    assert_int_equal(json[size], 0);
    free(json);
    return value;
}

static double number(const json_t *object, const char *key)
{
    const json_t *value = json_object_get(object, key);
    assert_true(json_is_number(value));
    return json_number_value(value);
}

static td_pose pose_in(const json_t *t, const json_t *q)
{
    return (td_pose){{number(q, "w"), number(q, "x"), number(q, "y"), number(q, "z")},
                     {number(t, "x"), number(t, "y"), number(t, "z")}};
}

static void check_pose(const td_pose *a, const td_pose *b, double tolerance)
{
    const td_pose inverse = td_pose_inverse(a), apart = td_pose_compose(&inverse, b);
    check_near(td_pose_angle(&apart), 0, tolerance);
    check_near(td_pose_distance(&apart), 0, tolerance);
}

/* site_from_link of every link, by the names in the message alone. */
static void test_transforms(void **state)
{
    const double q[] = {0.7, 1.25}, xi[] = {0.1, -0.2, 0.3, 5, -7, 1};
    td_error error = {0};
    td_robot *robot = robot_of();
    td_pose root_from_link[TD_ROBOT_MAX_LINKS], chained[TD_ROBOT_MAX_LINKS];
    const td_pose site_from_root = td_pose_exp(xi);
    char *json = NULL;
    size_t size;
    (void)state;
    check_ok(td_foxglove_transforms(&json, &size, robot, q, "site", &site_from_root, 1500000001, &error),
             error);
    json_t *message = parsed(json, size), *all = json_object_get(message, "transforms");
    assert_int_equal(json_array_size(all), robot->link_count);
    td_robot_forward(root_from_link, robot, q);
    for (size_t i = 0; i < json_array_size(all); i++) {
        const json_t *one = json_array_get(all, i), *time = json_object_get(one, "timestamp");
        const char *parent = json_string_value(json_object_get(one, "parent_frame_id"));
        const td_pose step = pose_in(json_object_get(one, "translation"), json_object_get(one, "rotation"));
        const int link = td_robot_find_link(robot, json_string_value(json_object_get(one, "child_frame_id")));
        assert_int_equal(link, i); /* parents come first */
        chained[i] = i == 0 ? step : td_pose_compose(&chained[td_robot_find_link(robot, parent)], &step);
        if (i == 0) assert_string_equal(parent, "site");
        const td_pose wanted = td_pose_compose(&site_from_root, &root_from_link[link]);
        check_pose(&chained[i], &wanted, 1e-10);
        assert_int_equal((int)number(time, "sec"), 1);
        assert_int_equal((int)number(time, "nsec"), 500000001);
    }
    json_decref(message);
    check_ok(td_foxglove_transforms(&json, &size, robot, q, NULL, NULL, 0, &error), error);
    message = parsed(json, size);
    assert_int_equal(json_array_size(json_object_get(message, "transforms")), robot->link_count - 1);
    json_decref(message);
    td_robot_free(&robot);
}

/* Centre and size of the shape number `i` of a kind. */
static void check_shape(const json_t *entity, const char *kind, size_t i, const double at[3],
                        const double size[3])
{
    const json_t *one = json_array_get(json_object_get(entity, kind), i),
                 *pose = json_object_get(one, "pose");
    const char *axis[] = {"x", "y", "z"};
    for (int k = 0; k < 3; k++) {
        check_near(number(json_object_get(pose, "position"), axis[k]), at[k], 1e-10);
        check_near(number(json_object_get(one, "size"), axis[k]), size[k], 1e-10);
    }
    check_near(number(json_object_get(one, "color"), "g"), 0.5, 1e-10);
}

static void test_machine(void **state)
{
    const double green[] = {0, 0.5, 0, 1};
    td_error error = {0};
    td_robot *robot = robot_of();
    char *json = NULL;
    size_t size;
    (void)state;
    check_ok(td_foxglove_machine(&json, &size, robot, green, 0, &error), error);
    json_t *message = parsed(json, size), *all = json_object_get(message, "entities");
    assert_int_equal(json_array_size(all), 2); /* the tool has no shape */
    const json_t *base = json_array_get(all, 0), *arm = json_array_get(all, 1);
    assert_string_equal(json_string_value(json_object_get(arm, "frame_id")), "arm");
    check_shape(base, "cubes", 0, (const double[]){1, 2, 3}, (const double[]){1, 2, 4});
    check_shape(arm, "cylinders", 0, (const double[]){0, 0, 1}, (const double[]){1, 1, 2});
    /* The cylinder lies along x: its ends are at x = -1 and 1. */
    check_shape(arm, "spheres", 0, (const double[]){-1, 0, 1}, (const double[]){1, 1, 1});
    check_shape(arm, "spheres", 1, (const double[]){1, 0, 1}, (const double[]){1, 1, 1});
    check_shape(arm, "spheres", 2, (const double[]){0, 0, 0}, (const double[]){0.5, 0.5, 0.5});
    json_decref(message);
    td_robot_free(&robot);
}

static void test_refused(void **state)
{
    td_error error = {0};
    td_robot *robot = robot_of();
    char *json = NULL;
    size_t size;
    const double q[] = {NAN, 0};
    td_pose far = td_pose_identity();
    (void)state;
    far.t[1] = INFINITY;
    check_fails(td_foxglove_transforms(&json, &size, robot, q, NULL, NULL, 0, &error), TD_ERROR_DATA, error,
                "joints");
    check_fails(td_foxglove_pose(&json, &size, &far, "site", 0, &error), TD_ERROR_DATA, error, "pose");
    far.t[1] = 0;
    check_fails(td_foxglove_pose(&json, &size, &far, "\xc3", 0, &error), TD_ERROR_ARGUMENT, error, "frame");
    check_fails(td_foxglove_log(&json, &size, TD_LOG_INFO, "a", "\xff\xfe", 0, &error), TD_ERROR_ARGUMENT,
                error, "text is not UTF-8");
    td_plant_state still = {0};
    still.force[1] = NAN;
    check_fails(td_foxglove_joints(&json, &size, robot, &still, 0, &error), TD_ERROR_DATA, error, "forces");
    const td_elevation large = {.columns = 5000, .rows = 5000, .cell_m = 1};
    check_fails(td_foxglove_grid(&json, &size, &large, 0, &error), TD_ERROR_ARGUMENT, error,
                "25000000 cells");
    const td_cloud many = {.count = TD_FOXGLOVE_MAX_POINTS + 1};
    check_fails(td_foxglove_cloud(&json, &size, &many, "site", 0, &error), TD_ERROR_ARGUMENT, error,
                "points");
    assert_null(json);
    td_robot_free(&robot);
}

/* Every kind has a schema that is JSON and named as its title. */
static void test_schemas(void **state)
{
    (void)state;
    for (int kind = 0; kind < TD_FOXGLOVE_KIND_COUNT; kind++) {
        const td_mcap_channel channel = td_foxglove_channel((td_foxglove_kind)kind, "/topic");
        json_t *schema = json_loadb(channel.schema, channel.schema_size, JSON_REJECT_DUPLICATES, NULL);
        assert_non_null(schema);
        assert_string_equal(json_string_value(json_object_get(schema, "title")), channel.schema_name);
        assert_string_equal(channel.topic, "/topic");
        json_decref(schema);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_transforms),
        cmocka_unit_test(test_machine),
        cmocka_unit_test(test_refused),
        cmocka_unit_test(test_schemas),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
