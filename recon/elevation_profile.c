/* Heights of a map along a line. */
#include <math.h>
#include <stdlib.h>

#include "recon/volume.h"

enum { MOST_POINTS = 10000000 };

static td_status check_line(const double from[2], const double to[2], double step_m, td_error *error)
{
    for (int k = 0; k < 2; k++)
        if (!isfinite(from[k]) || !isfinite(to[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "profile: %s must be finite, not (%g, %g)",
                           isfinite(from[k]) ? "to" : "from", isfinite(from[k]) ? to[0] : from[0],
                           isfinite(from[k]) ? to[1] : from[1]);
    if (!(step_m > 0 && isfinite(step_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "profile: step_m must be above 0, not %g", step_m);
    const double length = hypot(to[0] - from[0], to[1] - from[1]);
    if (!(length > 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "profile: from and to are the same place (%g, %g)", from[0],
                       from[1]);
    if (length / step_m > MOST_POINTS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "profile: %g m in steps of %g m are more than %d points; take longer steps", length,
                       step_m, MOST_POINTS);
    return TD_OK;
}

td_status td_elevation_profile(td_profile_point **profile, size_t *count, const td_elevation *map,
                               const double from[2], const double to[2], double step_m, td_error *error)
{
    *profile = NULL;
    *count = 0;
    TD_TRY(check_line(from, to, step_m, error));
    const double length = hypot(to[0] - from[0], to[1] - from[1]);
    /* A last step shorter than a millionth is rounding, not a point of its own. */
    const size_t steps = (size_t)ceil(length / step_m - 1e-6), n = steps ? steps : 1;
    td_profile_point *made = malloc((n + 1) * sizeof *made);
    bool known = false;
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for a profile of %zu points", n + 1);
    for (size_t i = 0; i <= n; i++) {
        td_profile_point *p = &made[i];
        p->distance_m = i < n ? (double)i * step_m : length;
        const double part = i < n ? p->distance_m / length : 1;
        p->height_m = td_elevation_at(map, (1 - part) * from[0] + part * to[0],
                                      (1 - part) * from[1] + part * to[1], &p->sigma_m);
        known |= isfinite(p->height_m);
    }
    if (!known) {
        free(made);
        return td_fail(error, TD_ERROR_DATA,
                       "profile: the map knows no height between (%g, %g) and (%g, %g); its cells go from "
                       "(%g, %g) to (%g, %g)",
                       from[0], from[1], to[0], to[1], map->origin[0], map->origin[1],
                       map->origin[0] + (map->columns - 1) * map->cell_m,
                       map->origin[1] + (map->rows - 1) * map->cell_m);
    }
    *profile = made;
    *count = n + 1;
    return TD_OK;
}
