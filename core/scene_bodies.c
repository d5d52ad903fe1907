/* Solids and pictures of a scene. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/cloud.h"
#include "core/random.h"
#include "core/scene_internal.h"
#include "core/text_internal.h"

enum { MAX_SOLIDS = 1000, MAX_PICTURES = 100, ROCK_RINGS = 9, ROCK_SECTORS = 16, ROCK_PLANES = 14 };

static const double FAR_M = 1e5, LARGEST_M = 100;

static td_status no_memory(const td_field *field, td_error *error)
{
    td_field_fail(field, error, "out of memory");
    if (error) error->status = TD_ERROR_MEMORY;
    return TD_ERROR_MEMORY;
}

static td_status take_mesh(td_solid *solid, const td_field *field, size_t corners, size_t triangles,
                           td_error *error)
{
    solid->corner = calloc(corners, sizeof *solid->corner);
    solid->triangle = calloc(triangles, sizeof *solid->triangle);
    if (!solid->corner || !solid->triangle) return no_memory(field, error);
    solid->corner_count = corners;
    solid->triangle_count = triangles;
    return TD_OK;
}

/* A box on z = 0; for a wedge the top's -x edge comes down to the floor's. */
static td_status make_box(td_solid *solid, const td_field *field, const double size[3], bool wedge,
                          td_error *error)
{
    static const uint32_t box[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                                        {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    /* Corners 0 2: floor at -x, 1 3: floor at +x, 5 7: top at +x. */
    static const uint32_t prism[8][3] = {{0, 2, 1}, {1, 2, 3}, {0, 1, 5}, {2, 7, 3},
                                         {0, 5, 7}, {0, 7, 2}, {1, 3, 5}, {3, 7, 5}};
    TD_TRY(take_mesh(solid, field, 8, wedge ? 8 : 12, error));
    for (int k = 0; k < 8; k++) {
        solid->corner[k][0] = (k & 1 ? 0.5 : -0.5) * size[0];
        solid->corner[k][1] = (k & 2 ? 0.5 : -0.5) * size[1];
        solid->corner[k][2] = k & 4 ? size[2] : 0;
    }
    memcpy(solid->triangle, wedge ? prism : box, solid->triangle_count * sizeof *solid->triangle);
    return TD_OK;
}

/* A stone: a ball cut by random planes, stretched; a third of it below z = 0. Its corners lie on the rays of
 * a grid of directions, so its edges are cut a little. */
static td_status make_rock(td_solid *solid, const td_field *field, const double size[3], int seed,
                           td_error *error)
{
    td_random random = td_random_seed((uint64_t)seed, 5);
    double plane[ROCK_PLANES][4];
    for (int k = 0; k < ROCK_PLANES; k++) {
        double length = 0;
        for (int i = 0; i < 3; i++) plane[k][i] = td_random_normal(&random);
        for (int i = 0; i < 3; i++) length += plane[k][i] * plane[k][i];
        for (int i = 0; i < 3; i++) plane[k][i] /= sqrt(length);
        plane[k][3] = 0.62 + 0.3 * td_random_uniform(&random);
    }
    TD_TRY(take_mesh(solid, field, (ROCK_RINGS + 1) * ROCK_SECTORS, 2 * ROCK_RINGS * ROCK_SECTORS, error));
    for (int ring = 0; ring <= ROCK_RINGS; ring++)
        for (int sector = 0; sector < ROCK_SECTORS; sector++) {
            const double a = 3.141592653589793 * ring / ROCK_RINGS,
                         b = 6.283185307179586 * sector / ROCK_SECTORS;
            const double d[3] = {sin(a) * cos(b), sin(a) * sin(b), cos(a)};
            double reach = 1;
            for (int k = 0; k < ROCK_PLANES; k++) {
                const double facing = d[0] * plane[k][0] + d[1] * plane[k][1] + d[2] * plane[k][2];
                if (facing > 0) reach = fmin(reach, plane[k][3] / facing);
            }
            double *corner = solid->corner[ring * ROCK_SECTORS + sector];
            for (int i = 0; i < 3; i++) corner[i] = 0.5 * size[i] * (reach * d[i] + (i == 2 ? 0.33 : 0));
        }
    uint32_t(*t)[3] = solid->triangle;
    for (uint32_t ring = 0; ring < ROCK_RINGS; ring++)
        for (uint32_t sector = 0; sector < ROCK_SECTORS; sector++) {
            const uint32_t next = (sector + 1) % ROCK_SECTORS, here = ring * ROCK_SECTORS,
                           below = here + ROCK_SECTORS;
            memcpy(*t++, (uint32_t[3]){here + sector, below + sector, below + next}, sizeof *t);
            memcpy(*t++, (uint32_t[3]){here + sector, below + next, here + next}, sizeof *t);
        }
    return TD_OK;
}

static td_status read_mesh(td_solid *solid, const td_field *field, const char *folder, td_error *error)
{
    char *path = NULL;
    td_cloud *cloud = NULL;
    TD_TRY(td_scene_path(&path, field, folder, error));
    if (!path) return TD_OK;
    td_status status = td_cloud_read_ply(&cloud, path, error);
    if (status == TD_OK && !cloud->triangle_count)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: has no triangles; a solid needs a mesh", path);
    if (status == TD_OK) status = take_mesh(solid, field, cloud->count, cloud->triangle_count, error);
    if (status == TD_OK) {
        for (size_t i = 0; i < cloud->count; i++)
            memcpy(solid->corner[i], cloud->point[i].p, sizeof *solid->corner);
        memcpy(solid->triangle, cloud->triangle, cloud->triangle_count * sizeof *cloud->triangle);
    }
    td_cloud_free(&cloud);
    free(path);
    return status;
}

/* `pose`, or `at_m` (two numbers: on the ground) and `yaw_deg`. */
static td_status parse_place(td_pose *pose, const td_field *field, const td_scene *scene, td_error *error)
{
    const td_field whole = td_field_get(field, "pose"), at = td_field_get(field, "at_m");
    *pose = td_pose_identity();
    if (!whole.value == !at.value) return td_field_fail(field, error, "either 'pose' or 'at_m' is needed");
    if (whole.value) return td_field_pose(pose, &whole, error);
    double yaw = 0;
    size_t count;
    TD_TRY(td_field_count(&count, &at, 2, 3, error));
    TD_TRY(td_field_reals(pose->t, count, &at, -FAR_M, FAR_M, error));
    TD_TRY(td_scene_real(&yaw, field, "yaw_deg", -360, 360, error));
    const double turn[3] = {0, 0, yaw * 0.017453292519943295};
    td_rotation_exp(pose->q, turn);
    if (count == 3 || !scene->ground) return TD_OK;
    pose->t[2] = td_elevation_at(scene->ground, pose->t[0], pose->t[1], NULL);
    if (isfinite(pose->t[2])) return TD_OK;
    return td_field_fail(&at, error, "(%g, %g) is outside the ground; give z as well", pose->t[0],
                         pose->t[1]);
}

static td_status parse_solid(td_solid *solid, const td_field *field, const td_scene *scene,
                             const char *folder, td_error *error)
{
    static const char *const keys[] = {"name", "box_m",   "wedge_m", "rock_m",  "ply", "seed",
                                       "at_m", "yaw_deg", "pose",    "surface", NULL};
    static const char *const shapes[] = {"box_m", "wedge_m", "rock_m"};
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_scene_name(solid->name, field, error));
    const td_field surface = td_field_get(field, "surface"), ply = td_field_get(field, "ply");
    TD_TRY(td_scene_surface(&solid->surface, &surface, error));
    TD_TRY(parse_place(&solid->site_from_solid, field, scene, error));
    int seed = 1, given = ply.value != NULL;
    TD_TRY(td_scene_int(&seed, field, "seed", 0, 1 << 30, error));
    for (int k = 0; k < 3; k++) given += td_field_get(field, shapes[k]).value != NULL;
    if (given != 1) return td_field_fail(field, error, "one of box_m, wedge_m, rock_m or ply is needed");
    if (ply.value) return read_mesh(solid, &ply, folder, error);
    for (int k = 0; k < 3; k++) {
        const td_field shape = td_field_get(field, shapes[k]);
        double size[3];
        if (!shape.value) continue;
        TD_TRY(td_field_reals(size, 3, &shape, 1e-3, LARGEST_M, error));
        if (k == 2) return make_rock(solid, &shape, size, seed, error);
        return make_box(solid, &shape, size, k == 1, error);
    }
    return TD_OK;
}

td_status td_scene_solids_parse(td_scene *scene, const td_field *field, const char *folder, td_error *error)
{
    size_t count = 0;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_count(&count, field, 0, MAX_SOLIDS, error));
    scene->solid = calloc(count + 1, sizeof *scene->solid);
    if (!scene->solid) return no_memory(field, error);
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field solid = td_field_at(field, i, index);
        scene->solid_count++;
        TD_TRY(parse_solid(scene->solid + i, &solid, scene, folder, error));
    }
    return TD_OK;
}

static td_status parse_link(int *link, const td_field *field, const td_scene *scene, td_error *error)
{
    const char *name = NULL;
    char shown[TD_SHOWN_SIZE];
    *link = -1;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_string(&name, field, error));
    if (!scene->robot) return TD_OK;
    *link = td_robot_find_link(scene->robot, name);
    if (*link >= 0) return TD_OK;
    return td_field_fail(field, error, "the robot has no link '%s'", td_text_shown(shown, name));
}

static td_status parse_picture(td_scene_picture *picture, const td_field *field, const td_scene *scene,
                               const char *folder, td_error *error)
{
    static const char *const keys[] = {"name", "file", "width_m", "link", "at_m", "yaw_deg", "pose", NULL};
    char *path = NULL;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_scene_name(picture->name, field, error));
    const td_field link = td_field_get(field, "link"), width = td_field_get(field, "width_m");
    const td_field file = td_field_get(field, "file");
    TD_TRY(td_field_real(&picture->width_m, &width, 1e-3, LARGEST_M, error));
    TD_TRY(parse_link(&picture->link, &link, scene, error));
    TD_TRY(parse_place(&picture->site_from_picture, field, scene, error));
    TD_TRY(td_scene_path(&path, &file, folder, error));
    if (!path) return TD_OK;
    td_status status = td_image_read(&picture->image, path, 1, error);
    free(path);
    if (status == TD_OK)
        picture->height_m = picture->width_m * picture->image->height / picture->image->width;
    return status;
}

td_status td_scene_pictures_parse(td_scene *scene, const td_field *field, const char *folder, td_error *error)
{
    size_t count = 0;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_count(&count, field, 0, MAX_PICTURES, error));
    scene->picture = calloc(count + 1, sizeof *scene->picture);
    if (!scene->picture) return no_memory(field, error);
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field picture = td_field_at(field, i, index);
        scene->picture_count++;
        TD_TRY(parse_picture(scene->picture + i, &picture, scene, folder, error));
    }
    return TD_OK;
}
