/* The result of a rehearsal: its document, its schema, the verdict, the table, the products. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/rehearse_internal.h"
#include "core/document.h"
#include "core/file.h"

const gate_row rehearse_gate_defaults[] = {
    {"left_share", 0.05, 0.3,
     "what still stands above the trench's floor, of what was to be dug: where it is a third the trench is "
     "none"},
    {"map_outside_share", 0.5, 0.65,
     "of the map's cells near the machine, those further off the truth than their sigma (normal: 0.32): "
     "where "
     "two thirds are, its sigma are not to be believed, as with a calibration that is ten sigma off"},
    {"volume_sigma", 3, 6,
     "measured less true volume dug, over its sigma: beyond six the map is not to be believed"},
    {"tip_sigma", 3, 6, "true less predicted place of the tool above the ground, rms, over its sigma"},
    {"monitor_sigma", 4, 6,
     "largest deviation of the monitor, over its sigma; from 6 on it stops the machine"},
};
const size_t rehearse_gate_count = sizeof rehearse_gate_defaults / sizeof *rehearse_gate_defaults;

const td_schema_row rehearse_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "rehearse"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"rehearsal", TD_SCHEMA_STRING, true, false, "its name"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"seed", TD_SCHEMA_INT, true, false, "of what is true"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"phase", TD_SCHEMA_STRING, true, false, "of the session, at its end"},
    {"stopped", TD_SCHEMA_STRING, true, true, "why the loop was stopped, safely; null: it came to its end"},
    {"looks", TD_SCHEMA_INT, true, false, "pairs taken"},
    {"epipolar_px", TD_SCHEMA_REAL, true, true, "largest rms of matches off their epipolar lines, of a pair"},
    {"sigma_epipolar_px", TD_SCHEMA_REAL, true, true, "of it, by the rig's covariance"},
    {"matched_share_min", TD_SCHEMA_REAL, true, true, "least share of pixels with a match, of a pair"},
    {"map_rms_m", TD_SCHEMA_REAL, true, true,
     "heights of the last map less the truth, rms, near the machine"},
    {"map_share_within_sigma", TD_SCHEMA_REAL, true, true, "of these, within their own sigma (normal: 0.68)"},
    {"tip_error_m", TD_SCHEMA_REAL, true, true,
     "true less predicted place of the tool, rms over the motions above the ground"},
    {"tip_error_max_m", TD_SCHEMA_REAL, true, true, "the largest"},
    {"sigma_tip_m", TD_SCHEMA_REAL, true, true, "of the same, by machines and soils drawn as they may be"},
    {"tip_above_error_m", TD_SCHEMA_REAL, true, true,
     "of the tool's height above ground that nobody dug, the same: over the map as it was seen"},
    {"sigma_tip_above_m", TD_SCHEMA_REAL, true, true, "of the same, with the map's sigma"},
    {"planned_volume_m3", TD_SCHEMA_REAL, true, false, "of the trench, in the ground"},
    {"left_volume_m3", TD_SCHEMA_REAL, true, false,
     "of it above the floor in the last map that was planned on"},
    {"predicted_volume_m3", TD_SCHEMA_REAL, true, false, "cut around the trench, as simulated ahead"},
    {"dug_volume_m3", TD_SCHEMA_REAL, true, true, "cut there in truth; null: of a machine elsewhere"},
    {"dug_seen_m3", TD_SCHEMA_REAL, true, true, "of it, where the last map has seen the ground since"},
    {"measured_volume_m3", TD_SCHEMA_REAL, true, true,
     "cut there between the first map and the last: measured where it is seen, predicted where not"},
    {"sigma_volume_m3", TD_SCHEMA_REAL, true, true, "of that, unseen ground as sure as its prediction was"},
    {"measured_seen_m3", TD_SCHEMA_REAL, true, true, "of it, where it is seen"},
    {"sigma_seen_m3", TD_SCHEMA_REAL, true, true, "of that"},
    {"seen_share", TD_SCHEMA_REAL, true, true, "of the area around the trench, seen since it was dug"},
    {"unseen_m2", TD_SCHEMA_REAL, true, true, "the rest of it: taken as predicted"},
    {"predicted_unseen_m3", TD_SCHEMA_REAL, true, true, "cut there, as simulated ahead"},
    {"prediction_scatter_m", TD_SCHEMA_REAL, true, false,
     "ground as predicted less as then seen, where soil was moved: 68 % are less"},
    {"mass_error_kg", TD_SCHEMA_REAL, true, true, "all soil at the end less all soil at first: 0"},
    {"clearance_min_m", TD_SCHEMA_REAL, true, true,
     "least of the motions checked, contact that is meant apart"},
    {"collision_probability_max", TD_SCHEMA_REAL, true, false, "of contact that is not meant, of one motion"},
    {"unmeant_contacts", TD_SCHEMA_INT, true, true,
     "executed tasks in which the true machine touched the true ground where that was not meant: 0"},
    {"rig_sigmas", TD_SCHEMA_REAL, true, true,
     "by how many of its own sigma the images show the rig to be off: about 1; null: not checked"},
    {"loop_hz", TD_SCHEMA_REAL, true, true, "looks a second of computing: matching and fusing"},
    {"real_time_factor", TD_SCHEMA_REAL, true, true, "simulated ahead over computing time, the least"},
    {"deadline_misses", TD_SCHEMA_INT, true, false,
     "control periods of the tasks simulated ahead that took longer to compute than they last"},
    {"replans", TD_SCHEMA_INT, true, false, "rounds executed after the first"},
    {"rounds", TD_SCHEMA_ARRAY, true, false, "one after the other"},
    {"rounds[].executed", TD_SCHEMA_BOOL, true, false, "or only planned"},
    {"rounds[].passes", TD_SCHEMA_INT, true, false, "planned"},
    {"rounds[].planned_m3", TD_SCHEMA_REAL, true, false, "above the floor, before it"},
    {"rounds[].ahead_s", TD_SCHEMA_REAL, true, false, "simulated time ahead"},
    {"rounds[].done_s", TD_SCHEMA_REAL, true, false, "time of the execution"},
    {"rounds[].tip_error_m", TD_SCHEMA_REAL, true, true, "as above"},
    {"rounds[].sigma_tip_m", TD_SCHEMA_REAL, true, true, "as above"},
    {"rounds[].peak_ahead_n", TD_SCHEMA_REAL, true, false, "largest cutting force as simulated ahead"},
    {"rounds[].peak_done_n", TD_SCHEMA_REAL, true, false, "and as felt"},
    {"rounds[].stalls", TD_SCHEMA_INT, true, false, "cuts that stood still, of the execution"},
    {"rounds[].joint_sigmas", TD_SCHEMA_REAL, true, false, "largest deviation of a joint's angle, in sigma"},
    {"rounds[].force_sigmas", TD_SCHEMA_REAL, true, false, "of a joint's force"},
    {"rounds[].tool_sigmas", TD_SCHEMA_REAL, true, false, "of the tool's place"},
    {"rounds[].late_share", TD_SCHEMA_REAL, true, false,
     "longest of a motion's time over the prediction + 10 s"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t rehearse_schema_count = sizeof rehearse_schema / sizeof *rehearse_schema;

/* ---- figures ---- */

static double largest(const rehearse_round *round, int first, int count)
{
    double most = 0;
    for (int k = first; k < first + count; k++) most = fmax(most, round->monitor.ratio[k]);
    return most;
}

static int executed(const rehearse *r)
{
    int count = 0;
    for (int i = 0; i < r->round_count; i++) count += r->round[i].executed;
    return count;
}

rehearse_tip rehearse_tips(const rehearse *r)
{
    rehearse_tip t = {0};
    double sigma_square = 0, above = 0, sigma_above = 0;
    size_t count = 0, above_count = 0;
    for (int i = 0; i < r->round_count; i++) {
        const rehearse_round *o = r->round + i;
        if (!o->tip_count) continue;
        t.rms_m += o->tip_square;
        sigma_square += (double)o->tip_count * o->monitor.sigma_tip_m * o->monitor.sigma_tip_m;
        count += o->tip_count;
        t.most_m = fmax(t.most_m, o->tip_most_m);
        above += o->above_square;
        sigma_above += o->sigma_above_square;
        above_count += o->above_count;
    }
    t.rms_m = count ? sqrt(t.rms_m / (double)count) : NAN;
    t.sigma_m = count ? sqrt(sigma_square / (double)count) : NAN;
    t.above_m = above_count ? sqrt(above / (double)above_count) : NAN;
    t.sigma_above_m = above_count ? sqrt(sigma_above / (double)above_count) : NAN;
    if (!count) t.most_m = NAN;
    return t;
}

void rehearse_judge(rehearse *r, const gate_row *rows)
{
    gate_result *g = &r->gate;
    const rehearse_tip tip = rehearse_tips(r);
    double deviation = 0;
    if (r->unmeant)
        gate_add(g, VERDICT_REFUSED, "the machine touched the ground in %d motions that were not to",
                 r->unmeant);
    if (r->stopped) gate_add(g, VERDICT_REFUSED, "%s", r->why);
    if (!executed(r) || r->stopped) return;
    for (int i = 0; i < r->round_count; i++)
        deviation = fmax(deviation, largest(r->round + i, 0, 2 * r->scenario.robot->joint_count + 3));
    gate_check(g, rows, rehearse_gate_count, "left_share", r->left_m3 / r->planned_m3,
               "%.2f of %.2f m3 still stand above the floor of the trench", r->left_m3, r->planned_m3);
    gate_check(g, rows, rehearse_gate_count, "monitor_sigma", deviation,
               "actual and predicted motion differ by up to %.1f sigma", deviation);
    if (r->far) return; /* nothing is known of the truth */
    gate_check(
        g, rows, rehearse_gate_count, "map_outside_share", 1 - r->map_share,
        "%.0f %% of the map's cells are further off the truth than their sigma: the rig is not as well "
        "known as its covariance says",
        100 * (1 - r->map_share));
    const double off = fabs(r->measured_m3 - r->dug_m3), off_seen = fabs(r->volume.cut_m3 - r->dug_seen_m3);
    gate_check(
        g, rows, rehearse_gate_count, "volume_sigma",
        fmax(off / r->sigma_measured_m3, off_seen / r->sigma_volume_m3),
        "the measured volume is %.3f m3 off the true one, its sigma is %.3f m3; where it is seen, %.3f "
        "and %.3f",
        off, r->sigma_measured_m3, off_seen, r->sigma_volume_m3);
    gate_check(g, rows, rehearse_gate_count, "tip_sigma", tip.rms_m / tip.sigma_m,
               "the tool is %.3f m off its prediction, its sigma is %.3f m", tip.rms_m, tip.sigma_m);
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *round_json(const rehearse_round *round, int joints)
{
    json_t *o = json_object();
    set(o, "executed", json_boolean(round->executed));
    set(o, "passes", json_integer(round->plan ? round->plan->pass_count : 0));
    set(o, "planned_m3", td_json_real(round->plan ? round->plan->trench_m3 : 0));
    set(o, "ahead_s", td_json_real(round->ahead.time_s));
    set(o, "done_s", td_json_real(round->done.time_s));
    set(o, "tip_error_m",
        td_json_real(round->tip_count ? sqrt(round->tip_square / (double)round->tip_count) : NAN));
    set(o, "sigma_tip_m", td_json_real(round->executed ? round->monitor.sigma_tip_m : NAN));
    set(o, "peak_ahead_n", td_json_real(round->ahead.dug.peak_n));
    set(o, "peak_done_n", td_json_real(round->done.dug.peak_n));
    set(o, "stalls", json_integer(round->done.dug.stalls));
    set(o, "joint_sigmas", td_json_real(largest(round, 0, joints)));
    set(o, "force_sigmas", td_json_real(largest(round, joints, joints)));
    set(o, "tool_sigmas", td_json_real(largest(round, 2 * joints, 3)));
    set(o, "late_share", td_json_real(round->monitor.late));
    return o;
}

static json_t *products_json(const rehearse *r)
{
    json_t *o =
        json_pack("{s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log", "log.jsonl");
    if (r->map_before) set(o, "before", json_string("before.tif"));
    if (r->map_before && r->map) set(o, "after", json_string("after.tif"));
    if (r->true_after) set(o, "truth", json_string("truth.tif"));
    if (r->part_count) set(o, "recording", json_string("recording.mcap"));
    for (int i = 0; i < r->round_count; i++) {
        char key[40], path[60];
        snprintf(key, sizeof key, "ahead_%d", i + 1);
        snprintf(path, sizeof path, "round-%d/ahead/recording.mcap", i + 1);
        if (r->round[i].ahead.count) set(o, key, json_string(path));
        snprintf(key, sizeof key, "done_%d", i + 1);
        snprintf(path, sizeof path, "round-%d/done/recording.mcap", i + 1);
        if (r->round[i].executed) set(o, key, json_string(path));
    }
    return o;
}

static void set_motion(json_t *root, const rehearse *r)
{
    const rehearse_tip tip = rehearse_tips(r);
    set(root, "tip_error_m", td_json_real(tip.rms_m));
    set(root, "tip_error_max_m", td_json_real(tip.most_m));
    set(root, "sigma_tip_m", td_json_real(tip.sigma_m));
    set(root, "tip_above_error_m", td_json_real(tip.above_m));
    set(root, "sigma_tip_above_m", td_json_real(tip.sigma_above_m));
    set(root, "planned_volume_m3", td_json_real(r->planned_m3));
    set(root, "left_volume_m3", td_json_real(r->left_m3));
    set(root, "predicted_volume_m3", td_json_real(r->predicted_m3));
    set(root, "dug_volume_m3", td_json_real(r->dug_m3));
    set(root, "measured_volume_m3", td_json_real(r->planned_m3 > 0 ? r->measured_m3 : NAN));
    set(root, "sigma_volume_m3", td_json_real(r->planned_m3 > 0 ? r->sigma_measured_m3 : NAN));
    set(root, "measured_seen_m3", td_json_real(r->planned_m3 > 0 ? r->volume.cut_m3 : NAN));
    set(root, "sigma_seen_m3", td_json_real(r->planned_m3 > 0 ? r->sigma_volume_m3 : NAN));
    set(root, "dug_seen_m3", td_json_real(r->dug_seen_m3));
    set(root, "seen_share", td_json_real(r->seen_share));
    set(root, "unseen_m2", td_json_real(r->unseen_m2));
    set(root, "predicted_unseen_m3", td_json_real(r->predicted_unseen_m3));
    set(root, "prediction_scatter_m", td_json_real(r->scatter_m));
    set(root, "mass_error_kg", td_json_real(r->far ? NAN : r->mass_error_kg));
    set(root, "clearance_min_m", td_json_real(r->clearance_m));
    set(root, "collision_probability_max", td_json_real(r->probability));
    set(root, "unmeant_contacts", r->far ? json_null() : json_integer(r->unmeant));
    set(root, "rig_sigmas", td_json_real(r->rig_sigmas));
    set(root, "loop_hz", td_json_real(r->look_s > 0 ? r->looks / r->look_s : NAN));
    set(root, "real_time_factor", td_json_real(r->real_time));
    set(root, "deadline_misses", json_integer(r->deadline_misses));
    set(root, "replans", json_integer(executed(r) > 1 ? executed(r) - 1 : 0));
}

json_t *rehearse_result(const rehearse *r)
{
    json_t *root = json_object(), *reasons = json_array(), *rounds = json_array();
    set(root, "job", json_string("rehearse"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "rehearsal", json_string(r->setup->name));
    set(root, "scenario", json_string(r->scenario.name));
    set(root, "seed", json_integer((json_int_t)r->seed));
    set(root, "verdict", json_string(verdict_name(r->gate.verdict)));
    for (size_t i = 0; i < r->gate.count; i++) json_array_append_new(reasons, json_string(r->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "phase", json_string(td_phase_text(r->logic.phase)));
    set(root, "stopped", r->stopped ? json_string(r->why) : json_null());
    set(root, "looks", json_integer(r->looks));
    set(root, "epipolar_px", td_json_real(r->epipolar_px));
    set(root, "sigma_epipolar_px", td_json_real(r->sigma_epipolar_px));
    set(root, "matched_share_min", td_json_real(r->matched_least));
    set(root, "map_rms_m", td_json_real(r->true_after ? r->map_rms_m : NAN));
    set(root, "map_share_within_sigma", td_json_real(r->true_after ? r->map_share : NAN));
    set_motion(root, r);
    for (int i = 0; i < r->round_count; i++)
        json_array_append_new(rounds, round_json(r->round + i, r->scenario.robot->joint_count));
    set(root, "rounds", rounds);
    set(root, "products", products_json(r));
    return root;
}

/* ---- on the terminal ---- */

static void motion_table(const rehearse *r)
{
    const rehearse_tip tip = rehearse_tips(r);
    printf("trench of %.3f m3: %.3f predicted, %.3f dug; %.3f left\n", r->planned_m3, r->predicted_m3,
           r->dug_m3, r->left_m3);
    if (isfinite(r->seen_share))
        printf("measured: %.3f +- %.3f m3; where it is seen (%.0f %%): %.3f +- %.3f m3 measured, %.3f dug; "
               "unseen: %.3f m3 predicted, %.3f "
               "dug\n",
               r->measured_m3, r->sigma_measured_m3, 100 * r->seen_share, r->volume.cut_m3,
               r->sigma_volume_m3, r->dug_seen_m3, r->predicted_unseen_m3, r->dug_m3 - r->dug_seen_m3);
    printf("tool %.3f m off its prediction (%.3f at most), sigma %.3f m; its height above the ground %.3f m "
           "off, "
           "sigma %.3f m; clearance %.2f m, contact %.2g; mass off by %g kg\n",
           tip.rms_m, tip.most_m, tip.sigma_m, tip.above_m, tip.sigma_above_m, r->clearance_m, r->probability,
           r->mass_error_kg);
}

void rehearse_table(const void *done)
{
    const rehearse *r = done;
    printf("%-6s %7s %10s %9s %9s %8s %8s %8s\n", "round", "passes", "above m3", "ahead s", "done s",
           "joint/s", "force/s", "tool/s");
    for (int i = 0; i < r->round_count; i++) {
        const rehearse_round *o = r->round + i;
        const int joints = r->scenario.robot->joint_count;
        printf("%-6d %7d %10.3f %9.1f %9.1f %8.2f %8.2f %8.2f\n", i + 1, o->plan ? o->plan->pass_count : 0,
               o->plan ? o->plan->trench_m3 : 0, o->ahead.time_s, o->done.time_s, largest(o, 0, joints),
               largest(o, joints, joints), largest(o, 2 * joints, 3));
    }
    printf(
        "\n%d looks: matches %.3f px off their lines (sigma %.3f), %.0f %% of the pixels matched at least; "
        "map off by %.3f m rms, %.0f %% within sigma\n",
        r->looks, r->epipolar_px, r->sigma_epipolar_px, 100 * r->matched_least, r->map_rms_m,
        100 * r->map_share);
    if (executed(r)) motion_table(r);
    printf("\nverdict: %s\n", verdict_name(r->gate.verdict));
    for (size_t i = 0; i < r->gate.count; i++) printf("  - %s\n", r->gate.reason[i]);
}

/* ---- products ---- */

static td_status write_map(const td_elevation *map, const char *folder, const char *name, td_error *error)
{
    if (!map) return TD_OK;
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const td_status status = td_elevation_write(map, path, error);
    free(path);
    return status;
}

/* What a session leaves, without its maps. */
static td_status write_run(const task_run *run, const rehearse *r, const char *folder, int round,
                           const char *which, td_error *error)
{
    char name[40];
    task_run without = *run;
    without.after = NULL;
    if (!run->count) return TD_OK;
    snprintf(name, sizeof name, "round-%d", round + 1);
    char *path = td_path_join(folder, name), *whole = path ? td_path_join(path, which) : NULL;
    td_status status = whole ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (status == TD_OK) status = td_folder_make(path, error);
    if (status == TD_OK) status = task_write(&without, &r->scenario, whole, error);
    free(path);
    free(whole);
    return status;
}

td_status rehearse_write(const rehearse *r, const char *folder, td_error *error)
{
    TD_TRY(write_map(r->map_before, folder, "before.tif", error));
    if (r->map_before) TD_TRY(write_map(r->map, folder, "after.tif", error));
    TD_TRY(write_map(r->true_after, folder, "truth.tif", error));
    if (r->part_count) TD_TRY(rehearse_record(r, folder, error));
    for (int i = 0; i < r->round_count; i++) {
        TD_TRY(write_run(&r->round[i].ahead, r, folder, i, "ahead", error));
        if (r->round[i].executed) TD_TRY(write_run(&r->round[i].done, r, folder, i, "done", error));
    }
    return TD_OK;
}
