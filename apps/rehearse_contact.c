/* Whether what was executed touched the ground where that was not meant: the true machine against the true
 * ground, after it has happened. The bucket where the soil felt it, the other links by their shapes. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"
#include "sim/clearance.h"

static const double FELT_N = 2000;   /* of the soil on the bucket: less is what sticks and trickles */
static const double SURELY_M = 1e-3; /* sigma of ground that is known */
static const double PUSHED_M = 0.03;
static const double DEEPER_M = 0.05; /* contact of links: as wide as a cell of the ground is rough */

static bool is_felt(const task_run *run)
{
    for (size_t i = 0; i < run->count; i++)
        if (run->sample[i].phase == TD_PHASE_EXECUTING && monitor_is_free(run->sample + i) &&
            run->sample[i].contact_n > FELT_N)
            return true;
    return false;
}

/* Samples from `first` on that the ground was the same for; *met: the largest depth of a link in it. */
static td_status check_part(double *met, const rehearse *r, const task_run *run, size_t first, size_t count,
                            const td_elevation *ground, td_error *error)
{
    const td_robot *robot = r->truth.robot;
    const size_t n = (size_t)robot->joint_count;
    double *q = malloc(count * (n + 1) * sizeof *q), *time = q ? q + count * n : NULL;
    td_clearance_map *map = NULL;
    td_clearance found = {0};
    td_clearance_allowed allowed[TD_ROBOT_MAX_LINKS];
    size_t meant = 0;
    if (!q) return td_fail(error, TD_ERROR_MEMORY, "no memory to check what was executed");
    for (size_t i = 0; i < count; i++) {
        const task_sample *a = run->sample + first + i;
        time[i] = a->time_s;
        for (size_t k = 0; k < n; k++) q[i * n + k] = a->state.q[k] - r->truth.zero[k];
    }
    for (int i = station_bucket_link(r->station); i >= 0 && i < robot->link_count; i++)
        allowed[meant++] = (td_clearance_allowed){i, time[0], time[count - 1]};
    const td_clearance_motion whole = {.robot = robot,
                                       .site_from_vehicle = run->sample[first].state.site_from_vehicle,
                                       .count = count,
                                       .time_s = time,
                                       .q = q,
                                       .allowed = allowed,
                                       .allowed_count = meant};
    td_status status = td_clearance_map_new(&map, ground, SURELY_M, error);
    if (status == TD_OK) status = td_clearance_check(&found, map, &whole, NULL, error);
    if (status == TD_OK && found.nearest.link >= 0) *met = fmax(*met, -found.nearest.clearance_m);
    td_clearance_map_free(&map);
    free(q);
    return status;
}

/* A stone that was pushed. */
static bool is_pushed(rehearse *r)
{
    bool pushed = false;
    for (int i = 0; i < r->truth.ground.stone_count; i++) {
        double *was = r->stone_at[i];
        td_pose at;
        if (!station_stone(&at, r->station, i)) continue;
        pushed = pushed || (r->stones_lie && hypot(at.t[0] - was[0], at.t[1] - was[1]) > PUSHED_M);
        for (int k = 0; k < 3; k++) was[k] = at.t[k];
    }
    r->stones_lie = true;
    return pushed;
}

td_status rehearse_touched(rehearse *r, const task_run *run, td_error *error)
{
    double met = 0;
    for (size_t first = 0, ground = 0; first < run->count && run->ground_count;) {
        while (ground + 1 < run->ground_count &&
               run->ground[ground + 1].time_s <= run->sample[first].time_s + 1e-9)
            ground++;
        size_t count = 1;
        while (first + count < run->count &&
               (ground + 1 >= run->ground_count ||
                run->sample[first + count].time_s < run->ground[ground + 1].time_s))
            count++;
        TD_TRY(check_part(&met, r, run, first, count, run->ground[ground].map, error));
        first += count;
    }
    /* What stopped the machine has been told. */
    const bool touched = is_pushed(r) || is_felt(run) || met > DEEPER_M;
    r->unmeant += touched && r->logic.phase == TD_PHASE_MONITORING;
    return TD_OK;
}
