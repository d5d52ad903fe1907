/* Robot, points and boards of a dataset of camera-to-vehicle calibration. */
#include "core/dataset_arm.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/dataset_internal.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

static const double RADIANS = 0.017453292519943295, LARGEST_M = 1e3;
/* What a joint's sensor of a machine is good for. */
static const double USUAL_DEG = 0.05, USUAL_MM = 1, USUAL_PX = 0.5;

void td_dataset_arm_free(td_dataset_arm **arm)
{
    if (!*arm) return;
    free((*arm)->urdf);
    free((*arm)->joints);
    free((*arm)->sights);
    free(*arm);
    *arm = NULL;
}

static td_status parse_text(char text[TD_NAME_SIZE], const td_field *field, td_error *error)
{
    const char *given = NULL;
    TD_TRY(td_field_string(&given, field, error));
    if (!*given || strlen(given) >= TD_NAME_SIZE)
        return td_field_fail(field, error, "must be a name of 1 to %d bytes", TD_NAME_SIZE - 1);
    strcpy(text, given);
    return TD_OK;
}

/* A number for all joints, or a mapping of some. */
static td_status parse_sigma(td_dataset_sigma *sigma, const td_field *field, double usual, double unit,
                             td_error *error)
{
    const char *key;
    json_t *value;
    sigma->all = usual * unit;
    if (!field->value) return TD_OK;
    if (!json_is_object(field->value)) {
        TD_TRY(td_field_real(&sigma->all, field, 0, LARGEST_M, error));
        sigma->all *= unit;
        return TD_OK;
    }
    json_object_foreach((json_t *)(uintptr_t)field->value, key, value)
    {
        td_field one = td_field_get(field, key);
        if (strlen(key) >= TD_NAME_SIZE || sigma->count == TD_ROBOT_MAX_JOINTS)
            return td_field_fail(&one, error,
                                 "no robot has such a joint: at most %d, of names below %d bytes",
                                 TD_ROBOT_MAX_JOINTS, TD_NAME_SIZE);
        TD_TRY(td_field_real(&sigma->sigma[sigma->count], &one, 0, LARGEST_M, error));
        sigma->sigma[sigma->count] *= unit;
        strcpy(sigma->joint[sigma->count++], key);
    }
    return TD_OK;
}

static td_status parse_robot(td_dataset_arm *arm, const td_field *robot, const char *folder, const char *root,
                             td_error *error)
{
    static const char *const keys[] = {"urdf", "joints",    "mount",    "vehicle", "tip",
                                       "link", "sigma_deg", "sigma_mm", NULL};
    const struct {
        const char *key;
        char *text;
    } links[] = {{"mount", arm->mount}, {"vehicle", arm->vehicle}, {"tip", arm->tip}, {"link", arm->link}};
    TD_TRY(td_field_check_keys(robot, keys, error));
    td_field urdf = td_field_get(robot, "urdf"), joints = td_field_get(robot, "joints");
    td_field deg = td_field_get(robot, "sigma_deg"), mm = td_field_get(robot, "sigma_mm");
    if (urdf.value) TD_TRY(td_dataset_parse_near(&arm->urdf, &urdf, folder, root, error));
    TD_TRY(td_dataset_parse_near(&arm->joints, &joints, folder, root, error));
    for (size_t i = 0; i < sizeof links / sizeof *links; i++) {
        td_field link = td_field_get(robot, links[i].key);
        if (link.value) TD_TRY(parse_text(links[i].text, &link, error));
    }
    TD_TRY(parse_sigma(&arm->angle, &deg, USUAL_DEG, RADIANS, error));
    return parse_sigma(&arm->slide, &mm, USUAL_MM, 1e-3, error);
}

/* One sigma for all coordinates, or three; those of unknown coordinates do not count. */
static td_status parse_place_sigma(double sigma[3], const td_field *field, td_error *error)
{
    if (!field->value) return TD_OK;
    if (json_is_array(field->value)) return td_field_reals(sigma, 3, field, 0, LARGEST_M, error);
    TD_TRY(td_field_real(&sigma[0], field, 0, LARGEST_M, error));
    sigma[1] = sigma[2] = sigma[0];
    return TD_OK;
}

static td_status parse_point(td_dataset_arm *arm, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"name", "link", "place_m", "sigma_m", NULL};
    td_dataset_point *point = &arm->point[arm->point_count];
    size_t count = 0;
    char index[TD_FIELD_INDEX_SIZE];
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field name = td_field_get(field, "name"), link = td_field_get(field, "link");
    td_field place = td_field_get(field, "place_m"), sigma = td_field_get(field, "sigma_m");
    TD_TRY(parse_text(point->name, &name, error));
    TD_TRY(parse_text(point->link, &link, error));
    for (int i = 0; i < arm->point_count; i++)
        if (!strcmp(arm->point[i].name, point->name))
            return td_field_fail(&name, error, "'%s' is given twice", point->name);
    TD_TRY(parse_place_sigma(point->sigma_m, &sigma, error));
    if (place.value) TD_TRY(td_field_count(&count, &place, 3, 3, error));
    for (size_t i = 0; i < 3; i++) {
        td_field one = count ? td_field_at(&place, i, index) : place;
        if (!one.value || json_is_null(one.value)) {
            point->place_m[i] = NAN;
            point->sigma_m[i] = INFINITY;
        } else {
            TD_TRY(td_field_real(&point->place_m[i], &one, -LARGEST_M, LARGEST_M, error));
        }
    }
    arm->point_count++;
    return TD_OK;
}

static td_status parse_board(td_dataset_arm *arm, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"name",     "link",      "target", "link_from_target",
                                       "sigma_mm", "sigma_deg", NULL};
    td_dataset_board *board = &arm->board[arm->board_count];
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field name = td_field_get(field, "name"), link = td_field_get(field, "link");
    td_field target = td_field_get(field, "target"), pose = td_field_get(field, "link_from_target");
    td_field mm = td_field_get(field, "sigma_mm"), deg = td_field_get(field, "sigma_deg");
    TD_TRY(parse_text(board->name, &name, error));
    TD_TRY(parse_text(board->link, &link, error));
    for (int i = 0; i < arm->board_count; i++)
        if (!strcmp(arm->board[i].name, board->name))
            return td_field_fail(&name, error, "'%s' is given twice", board->name);
    TD_TRY(td_target_parse(&board->target, &target, error));
    board->placed = pose.value != NULL;
    board->link_from_target = td_pose_identity();
    if (board->placed) TD_TRY(td_field_pose(&board->link_from_target, &pose, error));
    if (mm.value) TD_TRY(td_field_real(&board->sigma_m, &mm, 0, 1e3 * LARGEST_M, error));
    if (deg.value) TD_TRY(td_field_real(&board->sigma_rad, &deg, 0, 180, error));
    board->sigma_m *= 1e-3;
    board->sigma_rad *= RADIANS;
    arm->board_count++;
    return TD_OK;
}

typedef td_status (*parse_one)(td_dataset_arm *arm, const td_field *field, td_error *error);

static td_status parse_list(td_dataset_arm *arm, const td_field *field, size_t most, parse_one parse,
                            td_error *error)
{
    size_t count = 0;
    char index[TD_FIELD_INDEX_SIZE];
    if (!field->value) return TD_OK;
    TD_TRY(td_field_count(&count, field, 1, most, error));
    for (size_t i = 0; i < count; i++) {
        td_field one = td_field_at(field, i, index);
        TD_TRY(parse(arm, &one, error));
    }
    return TD_OK;
}

td_status td_dataset_parse_arm(td_dataset_arm **arm, const td_field *top, const char *folder,
                               const char *root, td_error *error)
{
    static const char *const mine[] = {"points", "boards", "sights", "sigma_px"};
    td_field robot = td_field_get(top, "robot"), field[4];
    for (int i = 0; i < 4; i++) field[i] = td_field_get(top, mine[i]);
    if (!td_field_get(&robot, "joints").value && !td_field_get(&robot, "urdf").value) {
        for (int i = 0; i < 4; i++)
            if (field[i].value)
                return td_field_fail(&field[i], error,
                                     "belongs to an arm whose joints are read: add robot: {urdf: FILE, "
                                     "joints: FILE, mount: LINK}");
        return TD_OK;
    }
    td_dataset_arm *a = *arm = calloc(1, sizeof *a);
    if (!a) return td_fail(error, TD_ERROR_MEMORY, "no memory for a dataset");
    TD_TRY(parse_robot(a, &robot, folder, root, error));
    TD_TRY(parse_list(a, &field[0], TD_DATASET_MAX_POINTS, parse_point, error));
    TD_TRY(parse_list(a, &field[1], TD_DATASET_MAX_BOARDS, parse_board, error));
    if (field[2].value) TD_TRY(td_dataset_parse_near(&a->sights, &field[2], folder, root, error));
    a->sigma_px = USUAL_PX;
    return field[3].value ? td_field_real(&a->sigma_px, &field[3], 1e-3, 1e3, error) : TD_OK;
}
