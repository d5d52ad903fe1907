/* The scenario of teledimos servo:
 *
 *   teledimos: scenario 1
 *   name: zx200-servo
 *   scene: ../site-servo                   (scene.yaml: ground, robot, rig and its mount, light, noise)
 *   camera: cab                            (of the rig; missing: the first)
 *   start: {boom: -0.6, arm: 1.35}         (rad or m; missing: as in the scene's first frame)
 *   tags:
 *     dictionary: tag36h11
 *     bucket:                              (on a link; a tag's place is its centre's in the target's plane)
 *       link: bucket
 *       pose: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}          (link_from_target)
 *       tags: [{id: 0, size_m: 0.5, at_m: [0, 0]}]
 *     board:                               (on the site)
 *       pose: {q: …, t_m: …}               (site_from_target: known to the scene only, not to the servo)
 *       tags: …
 *   goal: {q: …, t_m: …}                   (board_from_bucket: of the bucket's target)
 *   tool: bucket_tip                       (link whose origin is the tip)
 *   control: {period_s: 0.1, speed_share: 0.6, gain_zero_1_s: 1.5, gain_infinity_1_s: 0.4, gain_slope: 5,
 *             tolerance_px: 0.3, settle_s: 2, loss_s: 5, stall_s: 5, limit_s: 60}
 *   hide: {from_s: 3, for_s: 1}            (nothing is seen for so long)
 *   starts: {boom: [-0.7, -0.4]}           (ranges that --starts draws from; missing: the start)
 *   spread_rad: 0.05                       (--starts: by which each joint is other where the goal is met: the
 *                                          board stands elsewhere each time) */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "apps/servo_internal.h"
#include "calib/tag_dictionary.h"
#include "core/document.h"
#include "core/file.h"

/* A command is given a period after its image was taken, and the valve follows with this lag, s. */
static const double VALVE_S = 0.05;

void servo_scenario_free(servo_scenario *s)
{
    td_scene_free(&s->scene);
}

static td_status real(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

static td_status read_scene(servo_scenario *s, const td_field *root, const char *folder, td_error *error)
{
    const td_field scene = td_field_get(root, "scene"), camera = td_field_get(root, "camera");
    const char *name = NULL;
    struct stat about;
    TD_TRY(td_field_string(&name, &scene, error));
    char *path = td_path_join(folder, name);
    char *inside = path ? td_path_join(path, "scene.yaml") : NULL;
    if (inside)
        snprintf(s->scene_path, sizeof s->scene_path, "%s",
                 stat(path, &about) == 0 && S_ISDIR(about.st_mode) ? inside : path);
    free(path);
    free(inside);
    if (!s->scene_path[0]) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    TD_TRY(td_scene_read(&s->scene, s->scene_path, error));
    if (!s->scene->scene.robot || !s->scene->scene.ground)
        return td_field_fail(&scene, error, "'%s' has no robot or no ground", s->scene_path);
    if (!camera.value) return TD_OK;
    TD_TRY(td_field_string(&name, &camera, error));
    s->camera = td_rig_find(s->scene->rig, name);
    if (s->camera < 0) return td_field_fail(&camera, error, "the rig has no camera '%s'", name);
    return TD_OK;
}

/* ---- tags ---- */

static td_status read_tag(servo_tag *tag, const servo_scenario *s, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"id", "size_m", "at_m", NULL};
    const td_field id = td_field_get(field, "id"), size = td_field_get(field, "size_m"),
                   at = td_field_get(field, "at_m");
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_field_int(&tag->id, &id, 0, td_tag_count(s->dictionary) - 1, error));
    TD_TRY(td_field_real(&tag->size_m, &size, 0.01, 10, error));
    tag->target_from_tag = td_pose_identity();
    return at.value ? td_field_reals(tag->target_from_tag.t, 2, &at, -10, 10, error) : TD_OK;
}

static td_status read_link(int *link, const td_robot *robot, const td_field *field, td_error *error)
{
    const char *name = NULL;
    TD_TRY(td_field_string(&name, field, error));
    *link = td_robot_find_link(robot, name);
    return *link >= 0 ? TD_OK : td_field_fail(field, error, "robot '%s' has no link '%s'", robot->name, name);
}

static td_status read_target(servo_target *t, const servo_scenario *s, const td_field *field, bool on_link,
                             td_error *error)
{
    static const char *const keys[] = {"pose", "tags", "link", NULL};
    const td_field pose = td_field_get(field, "pose"), tags = td_field_get(field, "tags"),
                   link = td_field_get(field, "link");
    size_t count = 0;
    if (!field->value) return td_field_fail(field, error, "is missing");
    TD_TRY(td_field_check_keys(field, keys, error));
    if (on_link) TD_TRY(read_link(&t->link, s->scene->scene.robot, &link, error));
    if (!on_link && link.value) return td_field_fail(&link, error, "the board stands on the site");
    TD_TRY(td_field_pose(&t->link_from_target, &pose, error));
    TD_TRY(td_field_count(&count, &tags, 1, SERVO_MAX_TAGS, error));
    for (; t->count < (int)count; t->count++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field tag = td_field_at(&tags, (size_t)t->count, index);
        TD_TRY(read_tag(t->tag + t->count, s, &tag, error));
    }
    return TD_OK;
}

static td_status check_ids(const servo_scenario *s, const td_field *tags, td_error *error)
{
    servo_tag all[2 * SERVO_MAX_TAGS];
    const int count = s->bucket.count + s->board.count;
    memcpy(all, s->bucket.tag, sizeof s->bucket.tag);
    memcpy(all + s->bucket.count, s->board.tag, (size_t)s->board.count * sizeof *all);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < i; k++)
            if (all[i].id == all[k].id)
                return td_field_fail(tags, error, "tag %d is there twice; give each its own number",
                                     all[i].id);
    return TD_OK;
}

static td_status read_tags(servo_scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"dictionary", "bucket", "board", NULL};
    const td_field tags = td_field_get(root, "tags"), goal = td_field_get(root, "goal"),
                   tool = td_field_get(root, "tool");
    if (!tags.value) return td_field_fail(&tags, error, "is missing: which tags stand where");
    TD_TRY(td_field_check_keys(&tags, keys, error));
    const td_field dictionary = td_field_get(&tags, "dictionary"), bucket = td_field_get(&tags, "bucket"),
                   board = td_field_get(&tags, "board");
    const char *name = NULL;
    TD_TRY(td_field_string(&name, &dictionary, error));
    if (td_tag_count(name) == 0)
        return td_field_fail(&dictionary, error, "there is no dictionary '%s'", name);
    snprintf(s->dictionary, sizeof s->dictionary, "%s", name);
    s->board.link = -1;
    TD_TRY(read_target(&s->bucket, s, &bucket, true, error));
    TD_TRY(read_target(&s->board, s, &board, false, error));
    TD_TRY(check_ids(s, &tags, error));
    TD_TRY(td_field_pose(&s->board_from_bucket, &goal, error));
    return read_link(&s->tool, s->scene->scene.robot, &tool, error);
}

/* ---- joints ---- */

/* Ranges: [low, high]; else a number, for both. */
static td_status read_joints(double *low, double *high, const servo_scenario *s, const td_field *field,
                             td_error *error)
{
    const td_robot *robot = s->scene->scene.robot;
    const char *keys[TD_ROBOT_MAX_JOINTS + 1] = {NULL};
    if (!field->value) return TD_OK;
    for (int k = 0; k < robot->joint_count; k++) keys[k] = robot->joint[k].name;
    TD_TRY(td_field_check_keys(field, keys, error));
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        const td_field joint = td_field_get(field, j->name);
        double range[2] = {low[k], low[k]};
        if (!joint.value) continue;
        if (high)
            TD_TRY(td_field_reals(range, 2, &joint, fmax(j->lower, -1e3), fmin(j->upper, 1e3), error));
        else
            TD_TRY(td_field_real(range, &joint, fmax(j->lower, -1e3), fmin(j->upper, 1e3), error));
        low[k] = range[0];
        if (high) high[k] = range[1];
        if (high && !(range[1] >= range[0]))
            return td_field_fail(&joint, error, "a range is [lowest, highest]");
    }
    return TD_OK;
}

static td_status read_starts(servo_scenario *s, const td_field *root, td_error *error)
{
    const td_field start = td_field_get(root, "start"), starts = td_field_get(root, "starts");
    memcpy(s->q, s->scene->frame[0].q, sizeof s->q);
    TD_TRY(read_joints(s->q, NULL, s, &start, error));
    memcpy(s->low, s->q, sizeof s->low);
    memcpy(s->high, s->q, sizeof s->high);
    TD_TRY(real(&s->spread, root, "spread_rad", 0, 1, error));
    return read_joints(s->low, s->high, s, &starts, error);
}

/* ---- control ---- */

static td_status read_control(servo_scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {
        "period_s", "speed_share", "gain_zero_1_s", "gain_infinity_1_s", "gain_slope", "tolerance_px",
        "settle_s", "loss_s",      "stall_s",       "limit_s",           NULL};
    const td_field control = td_field_get(root, "control");
    td_visual_servo_options *o = &s->options;
    *o = td_visual_servo_options_default();
    o->limits.period_s = 0.1;
    o->limits.speed_share = 0.6;
    o->command = TD_COMMAND_FLOW;
    o->settle_s = 2;
    o->limit_s = 60;
    if (control.value) {
        TD_TRY(td_field_check_keys(&control, keys, error));
        TD_TRY(real(&o->limits.period_s, &control, "period_s", 0.01, 1, error));
        TD_TRY(real(&o->limits.speed_share, &control, "speed_share", 0.01, 1, error));
        TD_TRY(real(&o->gain_zero, &control, "gain_zero_1_s", 1e-3, 100, error));
        TD_TRY(real(&o->gain_infinity, &control, "gain_infinity_1_s", 1e-3, 100, error));
        TD_TRY(real(&o->gain_slope, &control, "gain_slope", 0, 1e3, error));
        TD_TRY(real(&o->tolerance_px, &control, "tolerance_px", 1e-3, 100, error));
        TD_TRY(real(&o->settle_s, &control, "settle_s", 0, 60, error));
        TD_TRY(real(&o->loss_s, &control, "loss_s", 0, 1e3, error));
        TD_TRY(real(&o->stall_s, &control, "stall_s", 0.1, 1e3, error));
        TD_TRY(real(&o->limit_s, &control, "limit_s", 1, 1e4, error));
    }
    o->limits.lag_s = VALVE_S + o->limits.period_s;
    return TD_OK;
}

static td_status read_hide(servo_scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"from_s", "for_s", NULL};
    const td_field hide = td_field_get(root, "hide");
    if (!hide.value) return TD_OK;
    TD_TRY(td_field_check_keys(&hide, keys, error));
    const td_field from = td_field_get(&hide, "from_s"), span = td_field_get(&hide, "for_s");
    TD_TRY(td_field_real(&s->hide_from_s, &from, 0, 1e4, error));
    return td_field_real(&s->hide_for_s, &span, 0, 1e4, error);
}

static td_status read_all(servo_scenario *s, const td_field *root, const char *folder, td_error *error)
{
    static const char *const keys[] = {"teledimos", "name",   "about",      "scene", "camera",
                                       "start",     "tags",   "goal",       "tool",  "hide",
                                       "control",   "starts", "spread_rad", NULL};
    const td_field version = td_field_get(root, "teledimos"), name = td_field_get(root, "name");
    const char *text = NULL;
    TD_TRY(td_field_string(&text, &version, error));
    if (strcmp(text, "scenario 1") != 0)
        return td_field_fail(&version, error, "'%s' is not 'scenario 1'", text);
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(td_field_string(&text, &name, error));
    snprintf(s->name, sizeof s->name, "%s", text);
    TD_TRY(read_scene(s, root, folder, error));
    TD_TRY(read_tags(s, root, error));
    TD_TRY(read_starts(s, root, error));
    TD_TRY(read_control(s, root, error));
    return read_hide(s, root, error);
}

td_status servo_scenario_read(servo_scenario *s, const char *path, td_error *error)
{
    struct stat about;
    const bool is_folder = stat(path, &about) == 0 && S_ISDIR(about.st_mode);
    char *file = is_folder ? td_path_join(path, "scenario.yaml") : td_path_join(".", path);
    char *folder = file ? td_path_folder(is_folder ? file : path) : NULL;
    json_t *root = NULL;
    if (!file || !folder) {
        free(file);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    }
    snprintf(s->path, sizeof s->path, "%s", is_folder ? file : path);
    td_status status = td_document_read(&root, s->path, error);
    const td_field top = {.parent = NULL, .name = s->path, .value = root};
    if (status == TD_OK) status = read_all(s, &top, folder, error);
    json_decref(root);
    free(file);
    free(folder);
    return status;
}
