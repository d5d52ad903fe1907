#include "servo/dig_plan.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double PI = 3.14159265358979323846, DEGREE = 0.017453292519943295;
static const double ASKEW_RAD = 30 * 0.017453292519943295;
static const double CLIPPED_M = 0.15; /* shorter than asked by less: what is left is a slope of the wall's */
enum { MAX_PASSES = 1000, MAX_LANES = 100, RAISES = 12 };

const char *td_dig_phase_name(td_dig_phase phase)
{
    static const char *const name[] = {"return", "approach", "cut", "lift", "carry", "dump"};
    return name[phase];
}

const char *td_dig_reason_name(td_dig_reason reason)
{
    static const char *const name[] = {"out of reach", "too deep", "the arm would touch the ground"};
    return name[reason];
}

td_dig_options td_dig_options_default(void)
{
    return (td_dig_options){.swell = 1.28,
                            .repose_rad = 40 * DEGREE,
                            .fill_share = 0.95,
                            .clear_m = 0.5,
                            .margin = 0.03,
                            .rake_least_deg = 20,
                            .rake_most_deg = 100,
                            .tilt_deg = 38,
                            .worth_m3 = 0.02};
}

/* ---- what is asked ---- */

static td_status check_numbers(const td_dig_request *r, const td_dig_options *o, td_error *error)
{
    const td_dig_bucket *b = r->bucket;
    const struct {
        const char *name;
        double value, low, high;
    } field[] = {{"options: swell", o->swell, 1, 3},
                 {"options: repose_rad", o->repose_rad, 0.1, 1.2},
                 {"options: fill_share", o->fill_share, 0.05, b->heaped_m3 / b->struck_m3},
                 {"options: clear_m", o->clear_m, 0, 10},
                 {"options: margin", o->margin, 0, 0.5},
                 {"options: rake_least_deg", o->rake_least_deg, 0, 90},
                 {"options: rake_most_deg", o->rake_most_deg, o->rake_least_deg, 150},
                 {"options: tilt_deg", o->tilt_deg, 0, 90},
                 {"options: worth_m3", o->worth_m3, 1e-4, 10},
                 {"bucket: width_m", b->width_m, 0.01, 20},
                 {"bucket: struck_m3", b->struck_m3, 1e-4, 100},
                 {"bucket: heaped_m3", b->heaped_m3, b->struck_m3, 200},
                 {"bucket: body_m", b->body_m, 0, 10},
                 {"dump: x_m", r->dump->at_m[0], -1e7, 1e7},
                 {"dump: y_m", r->dump->at_m[1], -1e7, 1e7},
                 {"dump: z_m", r->dump->at_m[2], -1e5, 1e5}};
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].value >= field[i].low && field[i].value <= field[i].high))
            return td_fail(error, TD_ERROR_ARGUMENT, "dig: %s: must be %g to %g, not %g", field[i].name,
                           field[i].low, field[i].high, field[i].value);
    return TD_OK;
}

static td_status check_request(const td_dig_request *r, const td_dig_options *o, td_error *error)
{
    if (!r->map || !r->robot || !r->site_from_vehicle || !r->q || !r->tool || !r->dump || !r->bucket)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: a plan needs a map, a robot, where both stand, a tool, a bucket and a dump");
    if (!r->dig && !r->floor)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: there is neither a dig nor the floor of an earlier plan");
    if (r->tool->link < 0 || r->tool->link >= r->robot->link_count || r->bucket->link < 0 ||
        r->bucket->link >= r->robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "dig: tool or bucket: robot '%s' has no such link",
                       r->robot->name);
    TD_TRY(check_numbers(r, o, error));
    int joint;
    if (!td_robot_within_limits(r->robot, r->q, &joint))
        return td_fail(error, TD_ERROR_ARGUMENT, "dig: joint '%s' stands beyond its limits",
                       r->robot->joint[joint].name);
    return TD_OK;
}

/* Where the trench lies in plan, from the dig; its heights follow from the map. */
static td_status lay_trench(dig_job *job, td_error *error)
{
    const td_dig_request *r = job->request;
    const td_task_dig *dig = r->dig;
    const bool in_vehicle = r->frame == TD_TASK_VEHICLE;
    double from[3], axis[3];
    memcpy(from, dig->from.at_m, sizeof from);
    if (in_vehicle) td_pose_transform(from, r->site_from_vehicle, dig->from.at_m);
    const double foot[3] = {job->axis[0], job->axis[1], 0};
    td_pose_transform(axis, r->site_from_vehicle, foot);
    double heading = atan2(axis[1] - from[1], axis[0] - from[0]);
    if (dig->has_heading) {
        const double turned = dig->heading_deg * DEGREE, ahead[3] = {cos(turned), sin(turned), 0};
        double way[3] = {ahead[0], ahead[1], 0};
        if (in_vehicle) td_pose_rotate(way, r->site_from_vehicle, ahead);
        heading = atan2(way[1], way[0]);
    }
    job->floor = (td_dig_floor){.start = {from[0], from[1], from[2]},
                                .heading_rad = heading,
                                .length_m = dig->length_m,
                                .width_m = dig->width_m > 0 ? dig->width_m : r->bucket->width_m};
    if (!(dig->depth_m > 0 && dig->depth_m <= 20))
        return td_fail(error, TD_ERROR_ARGUMENT, "dig: depth_m: must be above 0 and at most 20, not %g",
                       dig->depth_m);
    return TD_OK;
}

static td_status check_floor(const dig_job *job, td_error *error)
{
    const td_dig_floor *f = &job->floor;
    const double width = job->request->bucket->width_m;
    if (!(fabs(f->start[0]) + fabs(f->start[1]) + fabs(f->start[2]) < 1e7) || !isfinite(f->heading_rad) ||
        !(fabs(f->along) < 1 && fabs(f->across) < 1))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: where the trench lies is no place, or its floor is steeper than 45 deg");
    if (!(f->length_m >= DIG_LEAST_M && f->length_m <= 50))
        return td_fail(error, TD_ERROR_ARGUMENT, "dig: length_m: must be %g to 50, not %g", DIG_LEAST_M,
                       f->length_m);
    if (!(f->width_m >= width - 1e-6 && f->width_m <= 50))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "dig: width_m: must be %g, as wide as the bucket, to 50, not %g; take a narrower bucket "
            "or a wider trench",
            width, f->width_m);
    return TD_OK;
}

static td_status check_heading(const dig_job *job, td_error *error)
{
    double middle[3];
    dig_place(middle, job, job->floor.length_m / 2, 0, 0);
    const double askew = dig_askew(job, middle);
    if (askew <= ASKEW_RAD) return TD_OK;
    return td_fail(
        error, TD_ERROR_DATA,
        "dig: heading_deg: the trench's heading is %.0f deg off the way to the machine, at most %.0f "
        "can be dragged; turn it, or drive elsewhere",
        askew / DEGREE, ASKEW_RAD / DEGREE);
}

/* How far a place is from the trench's rectangle, m. */
static double from_trench(const dig_job *job, const double at[2])
{
    const td_dig_floor *f = &job->floor;
    const double x = at[0] - f->start[0], y = at[1] - f->start[1];
    const double a = x * job->heading[0] + y * job->heading[1];
    const double t = y * job->heading[0] - x * job->heading[1];
    return hypot(fmax(0, fmax(-a, a - f->length_m)), fmax(0, fabs(t) - f->width_m / 2));
}

static td_status set_dump(dig_job *job, double trench_m3, td_error *error)
{
    const td_dig_request *r = job->request;
    memcpy(job->dump, r->dump->at_m, sizeof job->dump);
    if (r->frame == TD_TASK_VEHICLE) td_pose_transform(job->dump, r->site_from_vehicle, r->dump->at_m);
    job->dump_ground = dig_below(job, job->dump);
    if (isinf(job->dump_ground))
        return td_fail(error, TD_ERROR_DATA,
                       "dump: the ground at (%.2f, %.2f) m is unknown; dump elsewhere, or map it",
                       job->dump[0], job->dump[1]);
    const double slope = tan(job->o.repose_rad);
    const double radius = cbrt(3 * trench_m3 * job->o.swell / (PI * slope));
    if (from_trench(job, job->dump) >= radius) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "dump: the heap of %.2f m^3 will be %.2f m wide and reach the trench, %.2f m away; dump "
                   "further from it",
                   trench_m3 * job->o.swell, 2 * radius, from_trench(job, job->dump));
}

/* ---- lanes ---- */

static double askew_at(const dig_job *job, double a, double t)
{
    double at[3];
    dig_place(at, job, a, t, 0);
    return dig_askew(job, at);
}

/* A trench that is a little wider than its lanes cover is left with ledges no wider than two cells, or a
 * twentieth of the edge. */
static int lanes_of(double *width, const dig_job *job)
{
    const td_dig_floor *f = &job->floor;
    double askew = 0;
    for (int corner = 0; corner < 4; corner++)
        askew = fmax(askew,
                     askew_at(job, corner & 1 ? f->length_m : 0, (corner & 2 ? 0.25 : -0.25) * f->width_m));
    *width = job->request->bucket->width_m * cos(askew);
    const double ledge = fmax(2 * job->map->cell_m, job->request->bucket->width_m / 20);
    return (int)fmax(1, ceil((f->width_m - ledge) / *width));
}

static td_status lay_lanes(dig_lane *lane, const dig_job *job, int count, double width, td_error *error)
{
    const td_dig_floor *f = &job->floor;
    const double half = job->request->bucket->width_m / 2;
    for (int i = 0; i < count; i++) {
        const double room = fmax(0, f->width_m - width);
        lane[i].t = count == 1 ? 0 : room * ((double)i / (count - 1) - 0.5);
        lane[i].from = lane[i].first = -half * sin(askew_at(job, 0, lane[i].t));
        lane[i].to = lane[i].last = f->length_m + half * sin(askew_at(job, f->length_m, lane[i].t));
        TD_TRY(dig_sweep_lane(lane + i, job, error));
    }
    return TD_OK;
}

/* ---- what of a lane is reached ---- */

/* The map with the lanes dug out, for the arm reaches down where nothing is any more. */
static td_status dug_out(td_elevation **map, const dig_job *job, const dig_lane *lane, int count,
                         td_error *error)
{
    TD_TRY(td_elevation_copy(map, job->map, error));
    for (int i = 0; i < count; i++)
        for (size_t k = 0; k < lane[i].count; k++) {
            const dig_cell *c = lane[i].cell + k;
            (*map)->height[c->index] = fminf((*map)->height[c->index], (float)c->floor);
        }
    return TD_OK;
}

static void reach_floor(dig_lane *lane, const dig_job *job)
{
    dig_drag d = {.from = lane->first, .to = lane->last, .g = 0};
    double high = 0;
    memcpy(d.q_above, job->request->q, (size_t)job->robot->joint_count * sizeof *d.q_above);
    const dig_drag fresh = d;
    if (dig_drag_make(&d, job, lane, &lane->reason)) {
        lane->from = d.from, lane->to = d.to;
        return;
    }
    for (size_t k = 0; k < lane->count; k++)
        high = fmax(high, (double)job->request->map->height[lane->cell[k].index] - lane->cell[k].floor);
    d = fresh;
    d.g = high;
    td_dig_reason other = lane->reason;
    lane->done = !dig_drag_make(&d, job, lane, &other);
    if (lane->done) {
        lane->from = lane->to = lane->first;
        return;
    }
    if (lane->reason == TD_DIG_TOO_FAR) lane->reason = TD_DIG_TOO_DEEP;
    dig_drag best = d;
    for (double low = 0; high - low > 0.02;) {
        d = fresh;
        d.g = (low + high) / 2;
        if (dig_drag_make(&d, job, lane, &other))
            best = d, high = d.g;
        else
            low = d.g;
    }
    lane->from = best.from, lane->to = best.to, lane->g = best.g;
}

/* ---- what is left out ---- */

static bool is_whole(const dig_lane *lane)
{
    return lane->g == 0 && lane->from <= lane->first + CLIPPED_M && lane->to >= lane->last - CLIPPED_M;
}

/* How far the trench must be shifted along its heading to be reached; NAN: nowhere. */
static double shift_of(const dig_job *job, const dig_lane *lane)
{
    enum { STEPS = 60 };
    for (int i = 1; i <= 2 * STEPS; i++) {
        const double shift = 0.1 * (i / 2) * (i & 1 ? 1 : -1);
        dig_drag d = {.from = lane->first + shift, .to = lane->last + shift, .g = 0};
        td_dig_reason reason;
        double fails;
        memcpy(d.q_above, job->request->q, (size_t)job->robot->joint_count * sizeof *d.q_above);
        if (dig_drag_whole(&d, job, lane, &reason, &fails)) return shift;
    }
    return NAN;
}

static td_status refuse_far(const dig_job *job, const dig_lane *lane, td_error *error)
{
    const double shift = shift_of(job, lane);
    double at[3];
    dig_place(at, job, isnan(shift) ? 0 : shift, 0, 0);
    if (isnan(shift))
        return td_fail(
            error, TD_ERROR_DATA,
            "dig: no place along the heading of a trench %.2f m long is within reach; drive nearer",
            job->floor.length_m);
    return td_fail(
        error, TD_ERROR_DATA,
        "dig: the trench is out of reach; the nearest of its kind that is not begins at (%.2f, %.2f) "
        "m, %.1f m %s; drive, or dig there",
        at[0], at[1], fabs(shift), shift > 0 ? "nearer" : "further away");
}

static td_status refuse_part(const dig_job *job, const dig_lane *lane, td_error *error)
{
    if (lane->done) return refuse_far(job, lane, error);
    if (lane->g > 0)
        return td_fail(
            error, TD_ERROR_DATA,
            "dig: depth_m: the floor is too deep%s: only down to %.2f m above it can be dug, from %.2f to "
            "%.2f m along; dig less deep, drive, or let it be dug partly",
            lane->reason == TD_DIG_BLOCKED ? ", the arm would touch the ground" : "", lane->g,
            fmax(lane->from, 0), fmin(lane->to, job->floor.length_m));
    return td_fail(
        error, TD_ERROR_DATA,
        "dig: of the trench's length, 0 to %.2f m, only %.2f to %.2f m can be dug (%s at its %s end); "
        "shorten it, drive, or let it be dug partly",
        job->floor.length_m, fmax(lane->from, 0), fmin(lane->to, job->floor.length_m),
        td_dig_reason_name(lane->reason), lane->from > lane->first + CLIPPED_M ? "far" : "near");
}

static void add_left(td_dig_plan *plan, const dig_job *job, const dig_lane *lane, double from, double to)
{
    dig_lane part = *lane;
    part.from = from, part.to = to, part.g = 0;
    td_dig_left *left = plan->left + plan->left_count;
    *left =
        (td_dig_left){.reason = lane->reason, .from_m = fmax(from, 0), .to_m = fmin(to, job->floor.length_m)};
    left->volume_m3 = dig_above(job, &part, 0);
    snprintf(left->text, sizeof left->text, "%.2f m^3 from %.2f to %.2f m along, %+.2f m to the left: %s",
             left->volume_m3, left->from_m, left->to_m, lane->t, td_dig_reason_name(lane->reason));
    plan->left_count++;
}

static td_status list_left(td_dig_plan *plan, const dig_job *job, const dig_lane *lane, int count,
                           td_error *error)
{
    plan->left_m3 = dig_trench_volume(job, NULL);
    plan->left = calloc((size_t)count * 3, sizeof *plan->left);
    if (!plan->left) return td_fail(error, TD_ERROR_MEMORY, "no memory for the plan of a trench");
    for (int i = 0; i < count; i++) {
        if (lane[i].from > lane[i].first + CLIPPED_M)
            add_left(plan, job, lane + i, lane[i].first, lane[i].from);
        if (lane[i].g > 0) add_left(plan, job, lane + i, lane[i].from, lane[i].to);
        if (lane[i].to < lane[i].last - CLIPPED_M) add_left(plan, job, lane + i, lane[i].to, lane[i].last);
    }
    return TD_OK;
}

/* ---- passes ---- */

/* The next drag of a lane: of what is left in it, an equal part for each pass that is still to come. False:
 * nothing that is worth one. */
static bool next_drag(dig_drag *drag, dig_job *job, const dig_lane *lane)
{
    const double fill = job->o.fill_share * job->request->bucket->struck_m3 / job->o.swell;
    const double volume = dig_above(job, lane, lane->g);
    if (lane->done || volume < job->o.worth_m3) return false;
    *drag = (dig_drag){.g = dig_plane_of(job, lane, volume / ceil(volume / fill))};
    if (!dig_extent(&drag->from, &drag->to, job, lane, drag->g)) return false;
    const double short_by = DIG_LEAST_M + CLIPPED_M - (drag->to - drag->from);
    if (short_by > 0) {
        drag->to = fmin(drag->to + short_by, lane->to);
        drag->from = fmax(drag->to - DIG_LEAST_M - CLIPPED_M, lane->from);
    }
    return true;
}

static td_status make_pass(td_dig_plan *plan, dig_job *job, dig_lane *lane, int index, double *q,
                           td_error *error)
{
    dig_drag drag;
    dig_pass pass = {.pass = plan->pass_count, .lane = index};
    if (!next_drag(&drag, job, lane)) {
        lane->done = true;
        return TD_OK;
    }
    const double from = drag.from, to = drag.to;
    memcpy(drag.q_above, q, (size_t)job->robot->joint_count * sizeof *q);
    td_dig_reason reason = TD_DIG_TOO_FAR;
    const bool reached = dig_drag_make(&drag, job, lane, &reason);
    if (!reached || drag.from > from + CLIPPED_M || drag.to < to - CLIPPED_M) {
        lane->reason = reason;
        if (!job->o.partly)
            return td_fail(
                error, TD_ERROR_DATA,
                "dig: pass %d, %.2f to %.2f m along and %.2f m above the floor, cannot be made (%s); "
                "drive, or let it be dug partly",
                plan->pass_count + 1, from, to, drag.g, td_dig_reason_name(reason));
        lane->from = reached ? drag.from : lane->to, lane->to = reached ? drag.to : lane->to;
        lane->done = !reached;
        return TD_OK;
    }
    pass.cut_m3 = dig_cut(job, lane, drag.from, drag.to, drag.g, &pass.depth_m);
    TD_TRY(dig_moves_add(plan, job, &drag, &pass, q, error));
    plan->pass_count++;
    plan->cut_m3 += pass.cut_m3;
    plan->loose_m3 += pass.cut_m3 * job->o.swell;
    return TD_OK;
}

static td_status make_passes(td_dig_plan *plan, dig_job *job, dig_lane *lane, int count, td_error *error)
{
    double q[TD_ROBOT_MAX_JOINTS] = {0};
    memcpy(q, job->request->q, (size_t)job->robot->joint_count * sizeof *q);
    for (bool more = true; more;) {
        more = false;
        for (int i = 0; i < count; i++) {
            if (lane[i].done) continue;
            TD_TRY(make_pass(plan, job, lane + i, i, q, error));
            more = true;
            if (plan->pass_count > MAX_PASSES)
                return td_fail(error, TD_ERROR_DATA,
                               "dig: the trench takes more than %d passes; dig it in parts", MAX_PASSES);
        }
    }
    return TD_OK;
}

/* ---- the plan ---- */

static td_status plan_lanes(td_dig_plan *plan, dig_job *job, dig_lane *lane, int count, double width,
                            td_error *error)
{
    td_elevation *now = job->map, *out = NULL;
    int none = 0;
    TD_TRY(lay_lanes(lane, job, count, width, error));
    TD_TRY(dug_out(&out, job, lane, count, error));
    job->map = out;
    for (int i = 0; i < count; i++) reach_floor(lane + i, job);
    job->map = now;
    td_elevation_free(&out);
    for (int i = 0; i < count; i++) none += lane[i].done;
    for (int i = 0; i < count; i++)
        if (none == count || (!job->o.partly && !is_whole(lane + i)))
            return refuse_part(job, lane + i, error);
    TD_TRY(make_passes(plan, job, lane, count, error));
    return list_left(plan, job, lane, count, error);
}

static td_status plan_trench(td_dig_plan *plan, dig_job *job, td_error *error)
{
    double width;
    TD_TRY(check_floor(job, error));
    job->heading[0] = cos(job->floor.heading_rad), job->heading[1] = sin(job->floor.heading_rad);
    TD_TRY(check_heading(job, error));
    TD_TRY(job->request->floor ? dig_check_trench(job, error)
                               : dig_fit_floor(job, job->request->dig->depth_m, error));
    plan->floor = job->floor;
    plan->trench_m3 = dig_trench_volume(job, &plan->depth_m);
    TD_TRY(set_dump(job, plan->trench_m3, error));
    const int count = lanes_of(&width, job);
    if (count > MAX_LANES)
        return td_fail(error, TD_ERROR_DATA, "dig: the trench takes %d lanes, at most %d are planned", count,
                       MAX_LANES);
    plan->lane_count = count;
    dig_lane *lane = calloc((size_t)count, sizeof *lane);
    if (!lane) return td_fail(error, TD_ERROR_MEMORY, "no memory for the plan of a trench");
    const td_status status = plan_lanes(plan, job, lane, count, width, error);
    for (int i = 0; i < count; i++) free(lane[i].cell);
    free(lane);
    return status;
}

td_status td_dig_plan_make(td_dig_plan **plan, const td_dig_request *request, const td_dig_options *options,
                           td_error *error)
{
    dig_job job = {.request = request, .o = options ? *options : td_dig_options_default()};
    *plan = NULL;
    TD_TRY(check_request(request, &job.o, error));
    td_dig_plan *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for the plan of a trench");
    job.vehicle_from_site = td_pose_inverse(request->site_from_vehicle);
    td_status status = td_elevation_copy(&made->expected, request->map, error);
    job.map = made->expected;
    if (status == TD_OK) status = dig_machine(&job, error);
    if (status == TD_OK && request->floor) job.floor = *request->floor;
    if (status == TD_OK && !request->floor) status = lay_trench(&job, error);
    if (status == TD_OK) status = plan_trench(made, &job, error);
    free(job.robot);
    if (status != TD_OK) td_dig_plan_free(&made);
    *plan = made;
    return status;
}

void td_dig_plan_free(td_dig_plan **plan)
{
    if (!plan || !*plan) return;
    for (int i = 0; i < (*plan)->move_count; i++) free((*plan)->move[i].position.joint);
    free((*plan)->move);
    free((*plan)->left);
    td_elevation_free(&(*plan)->expected);
    free(*plan);
    *plan = NULL;
}
