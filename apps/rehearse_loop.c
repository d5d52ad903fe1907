/* The closed loop: look, plan, simulate ahead, validate, execute, look again, until nothing worth a pass is
 * left. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"
#include "core/rig_draw.h"

static const double WORTH_SHARE = 0.05; /* of the trench: another round is made for it, */
static const double LESS = 0.8;         /* if the last one left no more than that of what it found */

void rehearse_free(rehearse *r)
{
    for (int i = 0; i < r->round_count; i++) {
        task_run_free(&r->round[i].ahead);
        task_run_free(&r->round[i].done);
        td_dig_plan_free(&r->round[i].plan);
        monitor_free(&r->round[i].monitor);
    }
    for (size_t i = 0; i < r->part_count; i++) task_run_free(&r->part[i].own);
    for (int i = 0; i < r->film_count; i++) td_image_free(r->film + i);
    rehearse_far_free(r);
    look_free(&r->look);
    station_free(&r->station);
    rehearse_draw_free(&r->truth);
    td_elevation_free(&r->map);
    td_elevation_free(&r->map_before);
    td_elevation_free(&r->true_before);
    td_elevation_free(&r->true_after);
    td_rig_free(&r->rig);
    td_rig_free(&r->rig_true);
    td_scene_free(&r->scene);
    scenario_free(&r->scenario);
}

/* ---- the world ---- */

static td_status read_world(rehearse *r, td_error *error)
{
    td_random random = td_random_seed(r->seed, 1000);
    TD_TRY(td_scene_read(&r->scene, r->scenario.ground.site, error));
    if (!r->scene->scene.ground || !r->scene->scene.robot || r->scene->mount_link < 0)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: a rehearsal's scene has a ground, a robot, and a mount on one of its links",
                       r->scenario.ground.site);
    if (r->scene->scene.robot->joint_count != r->scenario.robot->joint_count ||
        r->scene->scene.robot->link_count != r->scenario.robot->link_count)
        return td_fail(error, TD_ERROR_DATA, "%s: its robot is not that of %s", r->scenario.ground.site,
                       r->scenario.path);
    TD_TRY(td_rig_read(&r->rig, r->setup->rig_path, error));
    if (!r->far) {
        TD_TRY(rehearse_draw_make(&r->truth, r, 0, error));
        TD_TRY(td_elevation_copy(&r->true_before, r->scene->scene.ground, error));
        rehearse_show_stones(r);
    }
    const size_t n = td_rig_parameter_count(r->rig);
    for (size_t i = 0; r->rig->covariance && i < n * n; i++)
        r->rig->covariance[i] *= r->setup->truth.rig_covariance;
    if (r->far) { /* nothing is rendered by it */
        r->rig_true = td_rig_copy(r->rig);
        return r->rig_true ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a rig");
    }
    const td_status status = td_rig_draw(&r->rig_true, r->rig, r->setup->truth.rig_sigma, &random, error);
    return status == TD_OK ? status : td_error_prefix(error, TD_ERROR_DATA, "%s", r->setup->rig_path);
}

/* The machine arrives where the scenario begins. */
static td_status arrive(rehearse *r, td_error *error)
{
    const scenario *s = &r->scenario;
    td_plant_state start = s->start;
    for (int k = 0; k < s->robot->joint_count; k++) start.q[k] -= r->truth.zero[k];
    TD_TRY(station_new(&r->station, r->truth.robot, &s->options, &start, r->true_before, &r->truth.ground,
                       error));
    const td_plant plant = station_plant(r->station);
    TD_TRY(plant.state(plant.self, &r->state, error));
    for (int k = 0; k < s->robot->joint_count; k++) r->state.q[k] += r->truth.zero[k];
    return TD_OK;
}

/* ---- the rounds ---- */

/* Whether there is something to be done. */
static bool is_worth(rehearse *r, const rehearse_round *round)
{
    if (r->stopped || !round->plan) return false;
    if (r->round_count == 1) {
        r->floor = round->plan->floor;
        r->planned_m3 = round->plan->trench_m3;
    }
    const double before = r->left_m3;
    r->left_m3 = round->plan->trench_m3;
    return r->round_count == 1 ||
           (round->plan->cut_m3 > WORTH_SHARE * r->planned_m3 && r->left_m3 < LESS * before);
}

static td_status go_round(bool *again, rehearse *r, td_error *error)
{
    rehearse_round *round = r->round + r->round_count++;
    *again = false;
    TD_TRY(rehearse_ahead(r, round, error));
    if (!is_worth(r, round) || r->round_count > r->setup->rounds) return TD_OK;
    TD_TRY(rehearse_execute(r, round, error));
    if (round->executed)
        rehearse_keep(r, &round->done, false, "round %d: %d passes, %.3f m3 above the floor", r->round_count,
                      round->plan->pass_count, round->plan->trench_m3);
    *again = !r->stopped;
    return *again ? rehearse_look_again(r, error) : TD_OK;
}

td_status rehearse_run(rehearse *r, td_error *error)
{
    bool again = true;
    const td_elevation *now = NULL;
    td_behaviour_options o = td_behaviour_options_default();
    o.has_machine = 1;
    o.singularity = r->scenario.task->singularity;
    td_behaviour_begin(&r->logic, &o);
    r->clearance_m = r->real_time = r->matched_least = INFINITY;
    r->epipolar_px = r->sigma_epipolar_px = r->rig_sigmas = NAN;
    TD_TRY(read_world(r, error));
    TD_TRY(rehearse_look_first(r, error));
    if (r->stopped) return TD_OK;
    TD_TRY(td_elevation_copy(&r->map_before, r->map, error));
    if (!r->far) TD_TRY(arrive(r, error));
    while (again && !r->stopped) TD_TRY(go_round(&again, r, error));
    rehearse_keep(r, NULL, false, "%s%s", r->stopped ? "stopped: " : "at its end", r->stopped ? r->why : "");
    if (!r->far) {
        TD_TRY(station_map(&now, r->station, error));
        TD_TRY(td_elevation_copy(&r->true_after, now, error));
        r->mass_error_kg = station_mass_error(r->station);
    }
    return rehearse_compare(r, error);
}
