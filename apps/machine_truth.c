/* What is true of the machine and its ground, and nobody is told: masses and joint zeros by the options, or
 * all that a rehearsal draws, its head with them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"
#include "core/file.h"
#include "core/random.h"
#include "core/rig_draw.h"

static td_status draw_rehearsal(machine *m, td_error *error)
{
    rehearse *r = m->rehearsal;
    td_scene_file *scene = NULL;
    r->setup = m->setup;
    r->scenario = *m->s; /* lent */
    r->seed = (uint64_t)m->o->common->seed;
    TD_TRY(rehearse_draw_make(&r->truth, r, 0, error));
    m->robot_true = r->truth.robot;
    memcpy(m->zero, r->truth.zero, sizeof m->zero);
    TD_TRY(td_scene_read(&scene, m->s->ground.site, error));
    const td_status status = scene->scene.ground
                                 ? td_elevation_copy(&m->ground, scene->scene.ground, error)
                                 : td_fail(error, TD_ERROR_DATA, "%s: it has no ground", m->s->ground.site);
    td_scene_free(&scene);
    return status;
}

td_status machine_truth_draw(machine *m, td_error *error)
{
    td_random random = td_random_seed((uint64_t)m->o->common->seed, 0);
    if (m->rehearsal) return draw_rehearsal(m, error);
    TD_TRY(td_robot_read(&m->robot_true, m->s->robot_path, error));
    for (int i = 0; i < m->robot_true->link_count; i++) {
        const double times = fmax(0.3, 1 + m->o->mass_sigma * td_random_normal(&random));
        m->robot_true->link[i].mass_kg *= times;
        for (int k = 0; k < 9; k++) m->robot_true->link[i].inertia[k] *= times;
    }
    for (int k = 0; k < m->robot_true->joint_count; k++)
        m->zero[k] = m->o->zero_sigma_deg * 0.017453292519943295 * td_random_normal(&random);
    return TD_OK;
}

td_status machine_truth_rig(td_rig **rig, const machine *m, td_error *error)
{
    td_rig *believed = NULL;
    td_random random = td_random_seed((uint64_t)m->o->common->seed, 1000);
    TD_TRY(td_rig_read(&believed, m->setup->rig_path, error));
    const size_t n = td_rig_parameter_count(believed);
    for (size_t i = 0; believed->covariance && i < n * n; i++)
        believed->covariance[i] *= m->setup->truth.rig_covariance;
    const td_status status = td_rig_draw(rig, believed, m->setup->truth.rig_sigma, &random, error);
    td_rig_free(&believed);
    return status;
}

td_status machine_truth_keep(machine *m, const char *name, td_error *error)
{
    const td_elevation *map = NULL;
    if (!m->rehearsal || !m->station || !m->o->common->output) return TD_OK;
    TD_TRY(station_map(&map, m->station, error));
    char *path = td_path_join(m->o->common->output, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const td_status status = td_elevation_write(map, path, error);
    free(path);
    return status;
}

void machine_truth_free(machine *m)
{
    td_robot_free(&m->robot_true);
    td_elevation_free(&m->ground);
    free(m->rehearsal);
    free(m->setup);
    m->rehearsal = NULL;
    m->setup = NULL;
}
