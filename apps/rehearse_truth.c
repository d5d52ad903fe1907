/* Machines on soils as they may be: draws around what is believed. */
#include <math.h>
#include <string.h>

#include "apps/rehearse_internal.h"

static void draw_masses(td_robot *robot, double sigma, td_random *random)
{
    for (int i = 0; i < robot->link_count; i++) {
        const double times = fmax(0.3, 1 + sigma * td_random_normal(random));
        robot->link[i].mass_kg *= times;
        for (int k = 0; k < 9; k++) robot->link[i].inertia[k] *= times;
    }
}

static td_status draw_soil(td_soil_preset *soil, const rehearse_truth *t, bool true_one, td_random *random,
                           td_error *error)
{
    double z[3];
    for (int k = 0; k < 3; k++) z[k] = td_random_normal(random);
    const double stiff = fmax(0.05, 1 + t->soil_sigma * z[0]) * (true_one ? t->soil_times : 1);
    const double rough = fmax(0.5, 1 + t->soil_sigma / 4 * z[1]);
    soil->cohesion_pa *= stiff;
    soil->adhesion_pa *= stiff;
    soil->friction_rad *= rough;
    soil->tool_friction_rad *= rough;
    soil->density_kg_m3 *= fmax(0.5, 1 + t->soil_sigma / 4 * z[2]);
    return td_soil_preset_check(soil, error);
}

td_status rehearse_draw_make(rehearse_draw *d, const rehearse *r, uint64_t stream, td_error *error)
{
    const rehearse_truth *t = &r->setup->truth;
    td_random random = td_random_seed(r->seed, stream);
    *d = (rehearse_draw){.ground = r->scenario.ground};
    TD_TRY(td_robot_read(&d->robot, r->scenario.robot_path, error));
    draw_masses(d->robot, t->mass_sigma, &random);
    for (int k = 0; k < d->robot->joint_count; k++)
        d->zero[k] = t->joint_sigma_rad * td_random_normal(&random);
    TD_TRY(draw_soil(&d->ground.soil, t, stream == 0, &random, error));
    d->random = random;
    d->ground.stone_count = 0;
    if (stream) return TD_OK;
    d->ground.stone_count = t->stone_count;
    memcpy(d->ground.stone, t->stone, sizeof t->stone);
    return TD_OK;
}

void rehearse_draw_free(rehearse_draw *d)
{
    td_robot_free(&d->robot);
}
