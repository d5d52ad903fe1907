/* The result of teledimos servo: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "core/document.h"

const gate_row servo_gate_defaults[] = {
    {"steady_error_px", 0.3, 1,
     "largest error in the image while it settled, in what the arm controls: corners are found to a tenth of "
     "a pixel or better"},
    {"tip_error_sigmas", 3, 10,
     "the tip's error against its sigma: 3 is met by 97 of 100 where sigma is right, beyond 10 something "
     "else "
     "is wrong"},
    {"limit_violations", 0, 0, "periods in which a joint was beyond a limit of place, speed or acceleration"},
    {"failed_share", 0, 0.05, "--starts: share of the starts that did not come to the goal"},
};
const size_t servo_gate_count = sizeof servo_gate_defaults / sizeof *servo_gate_defaults;

#define RUN_ROWS(path)                                                                                       \
    {path "outcome", TD_SCHEMA_STRING, true, false, "converged, or why not: reduced, unreachable, lost …"},  \
        {path "reason", TD_SCHEMA_STRING, true, false, "the same in a sentence"},                            \
        {path "time_s", TD_SCHEMA_REAL, true, false, "until it was over"},                                   \
        {path "iterations", TD_SCHEMA_INT, true, false, "control periods until then"},                       \
        {path "freedoms", TD_SCHEMA_INT, true, false, "of the camera against the bucket"},                   \
        {path "steady_error_px", TD_SCHEMA_REAL, true, true,                                                 \
         "largest distance of a corner from its goal while it settled, in what the arm controls"},           \
        {path "tip_error_m", TD_SCHEMA_REAL, true, false,                                                    \
         "of the tip at rest from where the board says, in truth"},                                          \
        {path "sigma_tip_m", TD_SCHEMA_REALS, true, true, "of that; x, y, z of the vehicle"},                \
        {path "tip_error_sigmas", TD_SCHEMA_REAL, true, true, "sqrt(e' S^-1 e)"},                            \
        {path "corner_sigma_px", TD_SCHEMA_REAL, true, true,                                                 \
         "sigma of the corners, by the targets' residuals"},                                                 \
        {path "lost_s", TD_SCHEMA_REAL, true, false, "without sight of the bucket's tags"},                  \
        {path "least_height_m", TD_SCHEMA_REAL, true, true, "of the tip over the ground"},                   \
    {                                                                                                        \
        path "limit_violations", TD_SCHEMA_INT, true, false,                                                 \
            "joints beyond a limit, summed over the periods"                                                 \
    }

const td_schema_row servo_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "servo"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"robot", TD_SCHEMA_STRING, true, false, "its name"},
    {"camera", TD_SCHEMA_STRING, true, false, "its name in the rig"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"period_s", TD_SCHEMA_REAL, true, false, "of control"},
    {"loop_hz", TD_SCHEMA_REAL, true, false,
     "how often tags could be found and rates computed, by this computer's clock"},
    RUN_ROWS(""),
    {"joints", TD_SCHEMA_OBJECT, true, false, "by name; rad are m for one that slides"},
    {"joints.*", TD_SCHEMA_OBJECT, true, false, "a joint"},
    {"joints.*.start_rad", TD_SCHEMA_REAL, true, false, "at first"},
    {"joints.*.end_rad", TD_SCHEMA_REAL, true, false, "at the end"},
    {"joints.*.rate_max_rad_s", TD_SCHEMA_REAL, true, false, "fastest"},
    {"starts", TD_SCHEMA_OBJECT, false, false, "--starts"},
    {"starts.count", TD_SCHEMA_INT, true, false, "drawn"},
    {"starts.converged", TD_SCHEMA_INT, true, false, "of them"},
    {"starts.converged_share", TD_SCHEMA_REAL, true, false, "of all"},
    {"starts.within_3_sigma_share", TD_SCHEMA_REAL, true, true, "tip errors of those that converged"},
    {"starts.sigma_ratio", TD_SCHEMA_REAL, true, true,
     "root mean square of the tip's errors over their sigma: 1 where sigma is right"},
    {"starts.steady_error_px", TD_SCHEMA_REALS, true, true, "of those that converged: median, 90 %, largest"},
    {"starts.tip_error_m", TD_SCHEMA_REALS, true, true, "the same of the tip"},
    {"starts.tip_error_sigmas", TD_SCHEMA_REALS, true, true, "the same, by sigma"},
    {"starts.runs", TD_SCHEMA_ARRAY, true, false, "each"},
    {"starts.runs[].start_rad", TD_SCHEMA_REALS, true, false, "joints in the robot's order"},
    RUN_ROWS("starts.runs[]."),
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t servo_schema_count = sizeof servo_schema / sizeof *servo_schema;

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* ---- the verdict ---- */

static void judge_run(gate_result *g, const gate_row *rows, const servo_run *run)
{
    const char *outcome = td_servo_phase_name(run->phase);
    if (run->phase == TD_SERVO_REDUCED)
        gate_add(g, VERDICT_WARNED, "%s: %s", outcome, run->reason);
    else if (!servo_met(run))
        gate_add(g, VERDICT_REFUSED, "%s: %s", outcome, run->reason);
    if (servo_met(run))
        gate_check(g, rows, servo_gate_count, "steady_error_px", run->steady_px,
                   "the image error was up to %.2f px while it settled", run->steady_px);
    if (!isnan(run->sigmas))
        gate_check(g, rows, servo_gate_count, "tip_error_sigmas", run->sigmas,
                   "the tip is %.1f mm off, %.1f sigma", 1e3 * length(run->tip_error), run->sigmas);
    gate_check(g, rows, servo_gate_count, "limit_violations", run->limit_violations,
               "joints were beyond their limits in %d periods", run->limit_violations);
}

void servo_judge(servo_job *j, const gate_row *rows)
{
    const servo_starts *s = &j->starts;
    judge_run(&j->gate, rows, &j->run);
    if (s->count == 0) return;
    int violations = 0;
    for (size_t i = 0; i < s->count; i++) violations += s->run[i].limit_violations;
    gate_check(&j->gate, rows, servo_gate_count, "failed_share", 1 - (double)s->met / (double)s->count,
               "%d of %zu starts came to the goal", s->met, s->count);
    gate_check(&j->gate, rows, servo_gate_count, "limit_violations", violations,
               "over the starts, joints were beyond their limits in %d periods", violations);
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static void set_run(json_t *o, const servo_run *run)
{
    set(o, "outcome", json_string(td_servo_phase_name(run->phase)));
    set(o, "reason", json_string(run->reason));
    set(o, "time_s", td_json_real(run->time_s));
    set(o, "iterations", json_integer(run->iterations));
    set(o, "freedoms", json_integer(run->freedoms));
    set(o, "steady_error_px", td_json_real(run->steady_px));
    set(o, "tip_error_m", td_json_real(length(run->tip_error)));
    set(o, "sigma_tip_m", td_json_reals(run->sigma_tip, 3));
    set(o, "tip_error_sigmas", td_json_real(run->sigmas));
    set(o, "corner_sigma_px", td_json_real(run->corner_px));
    set(o, "lost_s", td_json_real(run->lost_s));
    set(o, "least_height_m", td_json_real(run->clearance_m));
    set(o, "limit_violations", json_integer(run->limit_violations));
}

static json_t *joints_json(const servo_job *j)
{
    const td_robot *robot = j->scenario.scene->scene.robot;
    json_t *all = json_object();
    for (int k = 0; k < robot->joint_count; k++) {
        double fastest = 0, end = j->run.start[k];
        for (size_t i = 0; i < j->run.count; i++) {
            fastest = fmax(fastest, fabs(j->run.sample[i].dq[k]));
            end = j->run.sample[i].q[k];
        }
        json_t *o = json_object();
        set(o, "start_rad", td_json_real(j->run.start[k]));
        set(o, "end_rad", td_json_real(end));
        set(o, "rate_max_rad_s", td_json_real(fastest));
        set(all, robot->joint[k].name, o);
    }
    return all;
}

static json_t *starts_json(const servo_job *j)
{
    const servo_starts *s = &j->starts;
    const size_t n = (size_t)j->scenario.scene->scene.robot->joint_count;
    json_t *o = json_object(), *runs = json_array();
    for (size_t i = 0; i < s->count; i++) {
        const servo_run *run = s->run + i;
        json_t *one = json_object();
        set(one, "start_rad", td_json_reals(run->start, n));
        set_run(one, run);
        json_array_append_new(runs, one);
    }
    set(o, "count", json_integer((json_int_t)s->count));
    set(o, "converged", json_integer(s->met));
    set(o, "converged_share", td_json_real((double)s->met / (double)s->count));
    set(o, "within_3_sigma_share", td_json_real(s->judged ? (double)s->covered / s->judged : NAN));
    set(o, "sigma_ratio", td_json_real(s->rms_sigmas));
    set(o, "steady_error_px", td_json_reals(s->steady_px, 3));
    set(o, "tip_error_m", td_json_reals(s->tip_m, 3));
    set(o, "tip_error_sigmas", td_json_reals(s->sigmas, 3));
    set(o, "runs", runs);
    return o;
}

json_t *servo_result(const servo_job *j)
{
    const servo_scenario *s = &j->scenario;
    json_t *o = json_object(), *reasons = json_array(), *products = json_object();
    for (size_t i = 0; i < j->gate.count; i++) json_array_append_new(reasons, json_string(j->gate.reason[i]));
    set(o, "job", json_string("servo"));
    set(o, "version", json_string(TD_VERSION));
    set(o, "scenario", json_string(s->name));
    set(o, "robot", json_string(s->scene->scene.robot->name));
    set(o, "camera", json_string(s->scene->rig->camera[s->camera].name));
    set(o, "verdict", json_string(verdict_name(j->gate.verdict)));
    set(o, "reasons", reasons);
    set(o, "period_s", td_json_real(s->options.limits.period_s));
    set(o, "loop_hz", td_json_real(j->run.loop_hz));
    set_run(o, &j->run);
    set(o, "joints", joints_json(j));
    if (j->starts.count) set(o, "starts", starts_json(j));
    set(products, "motion", json_string("motion.csv"));
    set(products, "report", json_string("report.html"));
    set(products, "log", json_string("log.jsonl"));
    set(o, "products", products);
    return o;
}

/* ---- on the terminal ---- */

static void starts_table(const servo_starts *s)
{
    int ended[TD_SERVO_PHASES] = {0};
    for (size_t i = 0; i < s->count; i++) ended[s->run[i].phase]++;
    printf("\nstarts           %d of %zu converged", s->met, s->count);
    for (int p = TD_SERVO_CONVERGED + 1; p < TD_SERVO_PHASES; p++)
        if (ended[p]) printf(", %d %s", ended[p], td_servo_phase_name((td_servo_phase)p));
    if (s->judged)
        printf("\nwithin 3 sigma   %d of %d; errors over sigma %.2f (1: right)"
               "\nsteady error     %.3f px median, %.3f px in 9 of 10, %.3f px largest"
               "\ntip              %.2f mm median, %.2f mm in 9 of 10, %.2f mm largest",
               s->covered, s->judged, s->rms_sigmas, s->steady_px[0], s->steady_px[1], s->steady_px[2],
               1e3 * s->tip_m[0], 1e3 * s->tip_m[1], 1e3 * s->tip_m[2]);
    printf("\n\n%5s  %-12s %7s %10s %9s %7s\n", "start", "outcome", "time s", "steady px", "tip mm",
           "sigmas");
    for (size_t i = 0; i < s->count; i++) {
        const servo_run *r = s->run + i;
        printf("%5zu  %-12s %7.1f ", i + 1, td_servo_phase_name(r->phase), r->time_s);
        if (servo_met(r))
            printf("%10.3f %9.2f %7.2f\n", r->steady_px, 1e3 * length(r->tip_error), r->sigmas);
        else
            printf("%s\n", r->reason);
    }
}

void servo_table(const void *done)
{
    const servo_job *j = done;
    const servo_run *r = &j->run;
    printf("%s: %s\n", j->scenario.name, verdict_name(j->gate.verdict));
    for (size_t i = 0; i < j->gate.count; i++) printf("  %s\n", j->gate.reason[i]);
    printf("\noutcome          %s: %s\n", td_servo_phase_name(r->phase), r->reason);
    printf("time             %.1f s, %d periods of %.0f ms; could run at %.0f Hz here\n", r->time_s,
           r->iterations, 1e3 * j->scenario.options.limits.period_s, r->loop_hz);
    if (r->lost_s > 0) printf("out of sight     %.1f s\n", r->lost_s);
    if (servo_met(r)) printf("steady error     %.3f px in %d dimensions\n", r->steady_px, r->freedoms);
    printf("tip              %.2f mm off", 1e3 * length(r->tip_error));
    if (!isnan(r->sigmas))
        printf(", sigma %.2f, %.2f, %.2f mm in x, y, z: %.1f sigma", 1e3 * r->sigma_tip[0],
               1e3 * r->sigma_tip[1], 1e3 * r->sigma_tip[2], r->sigmas);
    printf("\n");
    if (j->starts.count) starts_table(&j->starts);
}
