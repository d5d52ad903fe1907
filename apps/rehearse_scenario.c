/* What a rehearsal says. All but the first line, name, scenario and rig may be missing:
 *
 *   teledimos: rehearsal 1
 *   name: trench
 *   scenario: dig.yaml            (as teledimos simulate takes it, with one dig and a ground from a site: the
 *                                 machine, its start, the soil and the task as they are believed; the site's
 *                                 scene is the world as it truly is)
 *   rig: rig.yaml                 (the stereo head as it is believed, with its covariance, and
 *                                 vehicle_from_rig in the frame of the scene's mount)
 *   truth:                        (drawn by --seed)
 *     mass_sigma: 0.05            (relative, of each link)
 *     soil_sigma: 0.2             (relative, of cohesion; of friction and density a quarter)
 *     soil_times: 1               (cohesion so many times what is believed)
 *     rig_covariance: 1           (the rig's covariance times that: as it is believed, and as the truth is
 *                                 drawn from; 0: known exactly)
 *     rig_sigma: 1                (the truth so many sigma off, whatever is believed: a wrong rig)
 *     joint_sigma_deg: 0.05       (of the joints' zeros)
 *     dark_look: 0                (from that look on, counted from 1, the cameras are dark; 0: never)
 *     stones: [{at_m: …}]         (as a scenario's ground has them; in no map but what the cameras see
 *                                 of them where they stand out of the ground)
 *   look:
 *     before: 1..5                (frames of the scene: where the machine looked from as it came)
 *     frames: 3                   (pairs in each pose, after digging)
 *     poses: [{swing: 0.4, boom: -1.1, arm: 0.7, bucket: 0.3}]
 *   draws: 3                      (machines on soils as they may be, simulated for the monitor's sigma)
 *   rounds: 3                     (the most that are executed) */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"
#include "core/document.h"
#include "core/file.h"

#define RADIANS 0.017453292519943295

static td_status real(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

static td_status integer(int *value, const td_field *parent, const char *key, int low, int high,
                         td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_int(value, &field, low, high, error) : TD_OK;
}

static td_status read_stone(td_world_stone *stone, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"at_m", "radius_m", "density_kg_m3", "friction", NULL};
    const td_field at = td_field_get(field, "at_m"), radius = td_field_get(field, "radius_m");
    TD_TRY(td_field_check_keys(field, keys, error));
    *stone = (td_world_stone){.shape = {.kind = TD_PRIMITIVE_SPHERE, .link_from_shape = td_pose_identity()},
                              .density = 2600,
                              .friction = 0.6};
    TD_TRY(td_field_reals(stone->shape.link_from_shape.t, 3, &at, -1e5, 1e5, error));
    TD_TRY(td_field_real(stone->shape.size, &radius, 0.01, 5, error));
    TD_TRY(real(&stone->density, field, "density_kg_m3", 0, 1e4, error));
    return real(&stone->friction, field, "friction", 0, 10, error);
}

static td_status read_truth(rehearse_truth *t, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"mass_sigma", "soil_sigma",     "soil_times",
                                       "rig_sigma",  "rig_covariance", "joint_sigma_deg",
                                       "dark_look",  "stones",         NULL};
    const td_field field = td_field_get(root, "truth"), stones = td_field_get(&field, "stones");
    double degrees = 0.05;
    size_t count = 0;
    *t = (rehearse_truth){
        .mass_sigma = 0.05, .soil_sigma = 0.2, .soil_times = 1, .rig_sigma = 1, .rig_covariance = 1};
    t->joint_sigma_rad = RADIANS * degrees;
    if (!field.value) return TD_OK;
    TD_TRY(td_field_check_keys(&field, keys, error));
    TD_TRY(real(&t->mass_sigma, &field, "mass_sigma", 0, 0.2, error));
    TD_TRY(real(&t->soil_sigma, &field, "soil_sigma", 0, 0.5, error));
    TD_TRY(real(&t->soil_times, &field, "soil_times", 0.01, 100, error));
    TD_TRY(real(&t->rig_sigma, &field, "rig_sigma", 0, 100, error));
    TD_TRY(real(&t->rig_covariance, &field, "rig_covariance", 0, 1e4, error));
    TD_TRY(real(&degrees, &field, "joint_sigma_deg", 0, 5, error));
    TD_TRY(integer(&t->dark_look, &field, "dark_look", 0, 10000, error));
    t->joint_sigma_rad = RADIANS * degrees;
    if (!stones.value) return TD_OK;
    TD_TRY(td_field_count(&count, &stones, 0, STATION_MAX_STONES, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field stone = td_field_at(&stones, i, index);
        TD_TRY(read_stone(t->stone + t->stone_count++, &stone, error));
    }
    return TD_OK;
}

static td_status read_pose(double q[TD_ROBOT_MAX_JOINTS], const scenario *s, const td_field *field,
                           td_error *error)
{
    const char *keys[TD_ROBOT_MAX_JOINTS + 1] = {NULL};
    memcpy(q, s->start.q, TD_ROBOT_MAX_JOINTS * sizeof *q);
    for (int k = 0; k < s->robot->joint_count; k++) keys[k] = s->robot->joint[k].name;
    TD_TRY(td_field_check_keys(field, keys, error));
    for (int k = 0; k < s->robot->joint_count; k++) {
        const td_robot_joint *j = s->robot->joint + k;
        TD_TRY(real(q + k, field, keys[k], fmax(j->lower, -1e3), fmin(j->upper, 1e3), error));
    }
    return TD_OK;
}

static td_status read_look(rehearse_setup *p, const scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"before", "frames", "poses", NULL};
    const td_field field = td_field_get(root, "look"), poses = td_field_get(&field, "poses"),
                   before = td_field_get(&field, "before");
    const char *range = NULL;
    size_t count = 0;
    p->frames = 3;
    p->first = 0, p->last = -1;
    if (!field.value) return TD_OK;
    TD_TRY(td_field_check_keys(&field, keys, error));
    TD_TRY(integer(&p->frames, &field, "frames", 1, 100, error));
    if (before.value) {
        TD_TRY(td_field_string(&range, &before, error));
        if (sscanf(range, "%d..%d", &p->first, &p->last) != 2 || p->first < 1 || p->last < p->first)
            return td_field_fail(&before, error, "'%s' is no range such as 1..5", range);
        p->first--, p->last--;
    }
    if (!poses.value) return TD_OK;
    TD_TRY(td_field_count(&count, &poses, 0, REHEARSE_MAX_POSES, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field pose = td_field_at(&poses, i, index);
        TD_TRY(read_pose(p->pose[p->pose_count++], s, &pose, error));
    }
    return TD_OK;
}

static td_status path_at(char *path, size_t size, const td_field *root, const char *key, const char *folder,
                         td_error *error)
{
    const td_field field = td_field_get(root, key);
    const char *name = NULL;
    TD_TRY(td_field_string(&name, &field, error));
    char *joined = td_path_join(folder, name);
    if (!joined) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const int length = snprintf(path, size, "%s", joined);
    free(joined);
    return length < (int)size ? TD_OK : td_field_fail(&field, error, "the path is too long");
}

/* What the loop asks of its scenario. */
static td_status check_scenario(const rehearse_setup *p, const scenario *s, td_error *error)
{
    int digs = 0, others = 0;
    if (!s->task || !s->has_ground || !s->ground.site[0] || !s->ground.has_soil || !s->ground.has_region)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: a rehearsal looks at a site and digs there: give the scenario a task, and ground: "
            "{site: SCENE, soil: FILE, region_m: […]}",
            p->scenario_path);
    for (int i = 0; i < s->task->task->step_count; i++) {
        digs += s->task->task->step[i].kind == TD_TASK_DIG;
        others += s->task->task->step[i].kind == TD_TASK_DRIVE;
    }
    if (digs != 1 || others)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: a rehearsal is of one trench dug from one place: the task has %d dig and %d drive "
            "steps",
            p->scenario_path, digs, others);
    return TD_OK;
}

static td_status read_all(rehearse_setup *p, scenario *s, const td_field *root, const char *folder,
                          td_error *error)
{
    static const char *const keys[] = {"teledimos", "name", "about", "scenario", "rig",
                                       "truth",     "look", "draws", "rounds",   NULL};
    const td_field version = td_field_get(root, "teledimos"), name = td_field_get(root, "name");
    const char *text = NULL;
    TD_TRY(td_field_string(&text, &version, error));
    if (strcmp(text, "rehearsal 1") != 0)
        return td_field_fail(&version, error, "'%s' is not 'rehearsal 1'", text);
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(td_field_string(&text, &name, error));
    snprintf(p->name, sizeof p->name, "%s", text);
    TD_TRY(path_at(p->scenario_path, sizeof p->scenario_path, root, "scenario", folder, error));
    TD_TRY(path_at(p->rig_path, sizeof p->rig_path, root, "rig", folder, error));
    TD_TRY(read_truth(&p->truth, root, error));
    p->draws = p->rounds = 3;
    TD_TRY(integer(&p->draws, root, "draws", 2, REHEARSE_MAX_DRAWS, error));
    TD_TRY(integer(&p->rounds, root, "rounds", 1, REHEARSE_MAX_ROUNDS, error));
    TD_TRY(scenario_read(s, p->scenario_path, error));
    TD_TRY(check_scenario(p, s, error));
    return read_look(p, s, root, error);
}

td_status rehearse_read(rehearse_setup *p, scenario *s, const char *path, td_error *error)
{
    char *folder = td_path_folder(path);
    json_t *root = NULL;
    if (!folder) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    snprintf(p->path, sizeof p->path, "%s", path);
    td_status status = td_document_read(&root, path, error);
    const td_field top = {.parent = NULL, .name = p->path, .value = root};
    if (status == TD_OK) status = read_all(p, s, &top, folder, error);
    json_decref(root);
    free(folder);
    return status;
}
