/* A drive: the machine along a way on its tracks, its arm held as it stands. */
#include "apps/session_internal.h"

#include <math.h>
#include <stdio.h>

/* Ground under the whole way, at the tracks' middles and their ends. */
static bool is_known(const session *x, double hole[2])
{
    enum { POINTS = 400 };
    static const double ENDS[] = {-2, -1, 0, 1, 2};
    double way[POINTS][3];
    const double half = station_half_gauge(x->station);
    const int count = td_track_drive_way(way, POINTS, &x->tracks);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 10; k++) {
            const double ahead = ENDS[k / 2], aside = k % 2 ? half : -half;
            hole[0] = way[i][0] + ahead * cos(way[i][2]) - aside * sin(way[i][2]);
            hole[1] = way[i][1] + ahead * sin(way[i][2]) + aside * cos(way[i][2]);
            if (isnan(station_height(x->station, hole[0], hole[1]))) return false;
        }
    return true;
}

td_status session_begin_drive(session *x, td_error *error)
{
    const td_task *task = x->setup->task;
    td_track_drive_options o = td_track_drive_options_default();
    td_error why = {0};
    char text[300];
    double hole[2];
    o.half_gauge_m = station_half_gauge(x->station);
    o.tolerance_m = fmax(0.02, task->tolerance.position_m);
    o.tolerance_rad = fmax(0.005, 0.017453292519943295 * task->tolerance.angle_deg);
    if (td_track_drive_start(&x->tracks, &task->step[x->step].as.drive, task->frame, &x->base, &o, &why) !=
        TD_OK)
        return session_report(x, TD_EVENT_UNREACHABLE, why.message, error);
    if (is_known(x, hole)) return TD_OK;
    snprintf(text, sizeof text,
             "step %d: the way leads over (%.2f, %.2f) m, where the map has a hole or ends; drive elsewhere, "
             "or give a larger map",
             x->step + 1, hole[0], hole[1]);
    return session_report(x, TD_EVENT_UNREACHABLE, text, error);
}

td_status session_drive_on(session *x, td_error *error)
{
    double left, right;
    char text[200];
    td_track_drive_step(&left, &right, &x->tracks, &x->state.site_from_vehicle, x->s->period_s);
    TD_TRY(station_drive(x->station, left, right, error));
    TD_TRY(session_follow(x, 1, error));
    if (x->tracks.stuck) {
        snprintf(text, sizeof text, "step %d: the machine does not come on: %.2f m and %.1f deg are left",
                 x->step + 1, x->tracks.off_m, 57.29577951308232 * x->tracks.off_rad);
        return session_report(x, TD_EVENT_UNREACHABLE, text, error);
    }
    if (x->tracks.done) session_end_step(x);
    return TD_OK;
}

td_status session_halt(session *x, td_error *error)
{
    return x->station ? station_drive(x->station, 0, 0, error) : TD_OK;
}
