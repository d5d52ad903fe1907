/* The result of --identify: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_internal.h"
#include "core/document.h"

const gate_row identify_gate_defaults[] = {
    {"misfit", 1.2, 3,
     "forces: what the model leaves over what the log's noise explains; above 1.2 something is not modelled, "
     "above 3 the parameters are not the machine's"},
    {"motion_misfit", 1.3, INFINITY,
     "positions and rates against splines: above 1.3 they are rougher than their noise, or do not agree"},
    {"untold_share", 0.5, INFINITY, "parameters that the motion does not tell over all of them"},
    {"far_sigma", 5, INFINITY,
     "largest distance of a parameter from the robot file's, in sigmas: the file is not of this machine"},
};
const size_t identify_gate_count = sizeof identify_gate_defaults / sizeof *identify_gate_defaults;

const td_schema_row identify_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "simulate"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"robot", TD_SCHEMA_STRING, true, false, "its name"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"log", TD_SCHEMA_OBJECT, true, false, "the recorded motion"},
    {"log.path", TD_SCHEMA_STRING, true, false, "as given"},
    {"log.samples", TD_SCHEMA_INT, true, false, "its rows"},
    {"log.duration_s", TD_SCHEMA_REAL, true, false, "its length"},
    {"log.rates", TD_SCHEMA_BOOL, true, false, "rates are in it"},
    {"log.base", TD_SCHEMA_BOOL, true, false, "the base's pose is used; else it stands still"},
    {"identified", TD_SCHEMA_OBJECT, true, false, "base parameters and frictions, by name"},
    {"identified.*", TD_SCHEMA_OBJECT, true, false, "one of them"},
    {"identified.*.value", TD_SCHEMA_REAL, true, false, "in its unit"},
    {"identified.*.sigma", TD_SCHEMA_REAL, true, false, "of the value"},
    {"identified.*.prior", TD_SCHEMA_REAL, true, false, "as the robot's file and the scenario have it"},
    {"identified.*.unit", TD_SCHEMA_STRING, true, false, "of the three"},
    {"identified.*.told", TD_SCHEMA_BOOL, true, false,
     "the motion tells it: sigma is below half of its size"},
    {"identified.*.size", TD_SCHEMA_REAL, true, false, "that one may expect of it"},
    {"identified.*.far_sigma", TD_SCHEMA_REAL, true, false, "value less prior, in sigmas"},
    {"identified.*.sigma_proposed", TD_SCHEMA_REAL, true, true,
     "sigma that the proposed motion would give, from its simulation with the log's noise"},
    {"identified.*.means", TD_SCHEMA_STRING, true, false, "the sum of the links' parameters that it is"},
    {"not_told", TD_SCHEMA_ARRAY, true, false, "what cannot be told"},
    {"not_told[].name", TD_SCHEMA_STRING, true, false, "parameter"},
    {"not_told[].by", TD_SCHEMA_STRING, true, false,
     "this motion, or any motion: it enters no joint's force"},
    {"weak", TD_SCHEMA_ARRAY, true, false,
     "sums of parameters that the motion tells least, the widest first"},
    {"weak[].share", TD_SCHEMA_REAL, true, false, "its sigma, in the parameters' sizes"},
    {"weak[].means", TD_SCHEMA_STRING, true, false, "the sum, each parameter in its size"},
    {"condition", TD_SCHEMA_REAL, true, true, "of the regressor, each parameter in its size; null: infinite"},
    {"misfit", TD_SCHEMA_REAL, true, false, "forces: what the model leaves over what noise explains"},
    {"motion_misfit", TD_SCHEMA_REAL, true, false, "positions and rates: the same of their splines"},
    {"iterations", TD_SCHEMA_INT, true, false, "rounds of the estimate"},
    {"joints", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"joints.*", TD_SCHEMA_OBJECT, true, false,
     "a joint; rad are m for one that slides, N are N m for a motor"},
    {"joints.*.sigma_rad", TD_SCHEMA_REAL, true, false, "noise of its positions, from the log"},
    {"joints.*.sigma_rad_s", TD_SCHEMA_REAL, true, true, "of its rates"},
    {"joints.*.sigma_n", TD_SCHEMA_REAL, true, false, "of its forces"},
    {"joints.*.used", TD_SCHEMA_INT, true, false, "samples in which it moves, and its force counts"},
    {"joints.*.rms_n", TD_SCHEMA_REAL, true, true, "of measured less predicted force in them"},
    {"links", TD_SCHEMA_OBJECT, true, false,
     "bodies nearest to the robot file's that agree with what was identified, by name"},
    {"links.*", TD_SCHEMA_OBJECT, true, false, "a link"},
    {"links.*.mass_kg", TD_SCHEMA_REAL, true, false, "mass"},
    {"links.*.sigma_mass_kg", TD_SCHEMA_REAL, true, false, "of it, the file's taken as known to its size"},
    {"links.*.com_m", TD_SCHEMA_REALS, true, false, "centre of mass in the link's frame"},
    {"links.*.inertia_kg_m2", TD_SCHEMA_REALS, true, false, "about it: xx, xy, xz, yy, yz, zz"},
    {"feasible", TD_SCHEMA_BOOL, true, false, "the links had not to be moved to be those of bodies"},
    {"proposed", TD_SCHEMA_OBJECT, true, false, "a motion that tells more"},
    {"proposed.scenario", TD_SCHEMA_STRING, true, false, "file for teledimos simulate"},
    {"proposed.duration_s", TD_SCHEMA_REAL, true, false, "its length"},
    {"proposed.condition", TD_SCHEMA_REAL, true, true, "as it is expected"},
    {"proposed.told", TD_SCHEMA_INT, true, true,
     "parameters that it would tell; null: it could not be simulated"},
    {"proposed.sigma_ratio", TD_SCHEMA_REAL, true, true, "its sigmas over those of the log, geometric mean"},
    {"proposed.stops", TD_SCHEMA_INT, true, true, "how often a joint meets a stop in it"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t identify_schema_count = sizeof identify_schema / sizeof *identify_schema;

/* ---- figures ---- */

static int told_of(const td_identification *id)
{
    int told = 0;
    for (int a = 0; a < id->count; a++) told += id->parameter[a].told;
    return told;
}

static double far_of(const td_identified *p)
{
    return (p->value - p->prior) / p->sigma;
}

/* Geometric mean of the proposed motion's sigmas over those of the log. */
static double sigma_ratio(const identify_job *j)
{
    double sum = 0;
    if (!j->then) return NAN;
    for (int a = 0; a < j->id->count; a++)
        sum += log(j->then->parameter[a].sigma / j->id->parameter[a].sigma) / j->id->count;
    return exp(sum);
}

static int stops_of(const run_result *run)
{
    int met = 0;
    for (size_t i = 0; i < run->event_count; i++) met += run->event[i].met;
    return met;
}

void identify_judge(identify_job *j, const gate_row *rows)
{
    const td_identification *id = j->id;
    gate_result *g = &j->gate;
    const size_t count = identify_gate_count;
    const int untold = id->count - told_of(id);
    gate_check(
        g, rows, count, "misfit", id->misfit,
        "the forces differ from the model's by %.2f times what their noise explains; the sigmas are widened "
        "by that",
        id->misfit);
    gate_check(g, rows, count, "motion_misfit", id->spline_misfit,
               "positions and rates differ from a smooth motion by %.2f times their noise",
               id->spline_misfit);
    gate_check(g, rows, count, "untold_share", (double)untold / id->count,
               "the motion does not tell %d of %d parameters; record the proposed one", untold, id->count);
    const td_identified *most = id->parameter;
    for (int a = 0; a < id->count; a++)
        if (fabs(far_of(id->parameter + a)) > fabs(far_of(most))) most = id->parameter + a;
    gate_check(g, rows, count, "far_sigma", fabs(far_of(most)),
               "%s is %.4g ± %.2g %s, and %.4g in the robot's file: %.1f sigma apart", most->name,
               most->value, most->sigma, most->unit, most->prior, fabs(far_of(most)));
    if (!j->base && j->scenario->options.base == TD_MACHINE_SUSPENDED)
        gate_add(g, VERDICT_WARNED, "the log has no pose of the base; it is taken to stand still");
    if (j->run.unstable || stops_of(&j->run))
        gate_add(g, VERDICT_WARNED, "the proposed motion %s; change its start or its limits before it is run",
                 j->run.unstable ? "cannot be simulated" : "meets stops");
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *parameters_json(const identify_job *j)
{
    json_t *all = json_object();
    for (int a = 0; a < j->id->count; a++) {
        const td_identified *p = j->id->parameter + a;
        json_t *o = json_object();
        set(o, "value", td_json_real(p->value));
        set(o, "sigma", td_json_real(p->sigma));
        set(o, "prior", td_json_real(p->prior));
        set(o, "unit", json_string(p->unit));
        set(o, "told", json_boolean(p->told));
        set(o, "size", td_json_real(p->size));
        set(o, "far_sigma", td_json_real(far_of(p)));
        set(o, "sigma_proposed", td_json_real(j->then ? j->then->parameter[a].sigma : NAN));
        set(o, "means", json_string(p->means));
        set(all, p->name, o);
    }
    return all;
}

static json_t *not_told_json(const td_identification *id)
{
    json_t *list = json_array();
    for (int a = 0; a < id->count; a++)
        if (!id->parameter[a].told)
            json_array_append_new(
                list, json_pack("{s:s, s:s}", "name", id->parameter[a].name, "by", "this motion"));
    for (int i = 0; i < id->never_count; i++)
        json_array_append_new(list, json_pack("{s:s, s:s}", "name", id->never[i], "by", "any motion"));
    return list;
}

static json_t *joints_json(const identify_job *j)
{
    json_t *all = json_object();
    for (int k = 0; k < j->id->joints; k++) {
        const td_identified_joint *joint = j->id->joint + k;
        json_t *o = json_object();
        set(o, "sigma_rad", td_json_real(joint->sigma_position));
        set(o, "sigma_rad_s", td_json_real(joint->sigma_rate));
        set(o, "sigma_n", td_json_real(joint->sigma_force));
        set(o, "used", json_integer((json_int_t)joint->used));
        set(o, "rms_n", td_json_real(joint->rms_force));
        set(all, j->scenario->robot->joint[k].name, o);
    }
    return all;
}

/* Inertia about the centre of mass: Steiner's theorem backwards. */
static json_t *link_json(const td_identified_link *link)
{
    static const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
    const double *p = link->parameter;
    const double com[3] = {p[1] / p[0], p[2] / p[0], p[3] / p[0]};
    const double square = com[0] * com[0] + com[1] * com[1] + com[2] * com[2];
    double inertia[6];
    for (int i = 0; i < 6; i++)
        inertia[i] = p[4 + i] - p[0] * ((row[i] == column[i] ? square : 0) - com[row[i]] * com[column[i]]);
    json_t *o = json_object();
    set(o, "mass_kg", td_json_real(p[0]));
    set(o, "sigma_mass_kg", td_json_real(link->sigma[0]));
    set(o, "com_m", td_json_reals(com, 3));
    set(o, "inertia_kg_m2", td_json_reals(inertia, 6));
    return o;
}

static json_t *proposed_json(const identify_job *j)
{
    json_t *o = json_object();
    set(o, "scenario", json_string("proposed.yaml"));
    set(o, "duration_s", td_json_real(j->proposed.duration_s));
    set(o, "condition", td_json_real(j->then ? j->then->condition : j->proposed.condition));
    set(o, "told", j->then ? json_integer(told_of(j->then)) : json_null());
    set(o, "sigma_ratio", td_json_real(sigma_ratio(j)));
    set(o, "stops", j->run.count ? json_integer(stops_of(&j->run)) : json_null());
    return o;
}

json_t *identify_result(const identify_job *j)
{
    const td_identification *id = j->id;
    json_t *root = json_object(), *reasons = json_array(), *weak = json_array(), *links = json_object();
    set(root, "job", json_string("simulate"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "scenario", json_string(j->scenario->name));
    set(root, "robot", json_string(j->scenario->robot->name));
    set(root, "verdict", json_string(verdict_name(j->gate.verdict)));
    for (size_t i = 0; i < j->gate.count; i++) json_array_append_new(reasons, json_string(j->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "log",
        json_pack("{s:s, s:I, s:f, s:b, s:b}", "path", j->path, "samples", (json_int_t)j->count, "duration_s",
                  j->time_s[j->count - 1] - j->time_s[0], "rates", j->rate != NULL, "base", j->base != NULL));
    set(root, "identified", parameters_json(j));
    set(root, "not_told", not_told_json(id));
    for (int i = 0; i < id->weak_count; i++)
        json_array_append_new(
            weak, json_pack("{s:f, s:s}", "share", id->weak[i].share, "means", id->weak[i].means));
    set(root, "weak", weak);
    set(root, "condition", td_json_real(id->condition));
    set(root, "misfit", td_json_real(id->misfit));
    set(root, "motion_misfit", td_json_real(id->spline_misfit));
    set(root, "iterations", json_integer(id->iterations));
    set(root, "joints", joints_json(j));
    for (int i = 0; i < id->link_count; i++)
        set(links, j->scenario->robot->link[id->link[i].link].name, link_json(id->link + i));
    set(root, "links", links);
    set(root, "feasible", json_boolean(id->feasible));
    set(root, "proposed", proposed_json(j));
    set(root, "products",
        json_pack("{s:s, s:s, s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "proposed",
                  "proposed.yaml", "proposed_rates", "proposed.csv", "log", "log.jsonl"));
    return root;
}

/* ---- on the terminal ---- */

void identify_table(const void *done)
{
    const identify_job *j = done;
    const td_identification *id = j->id;
    printf("%-24s %12s %12s %12s %9s %12s  %s\n", "parameter", "identified", "sigma", "robot file",
           "far sigma", "proposed", "unit");
    for (int a = 0; a < id->count; a++) {
        const td_identified *p = id->parameter + a;
        if (!p->told) continue;
        printf("%-24s %12.5g %12.3g %12.5g %9.1f %12.3g  %s\n", p->name, p->value, p->sigma, p->prior,
               far_of(p), j->then ? j->then->parameter[a].sigma : NAN, p->unit);
    }
    printf("\ntold: %d of %d parameters; condition %.0f; forces differ by %.2f times their noise\n",
           told_of(id), id->count, id->condition, id->misfit);
    printf("not told by this motion:");
    for (int a = 0; a < id->count; a++)
        if (!id->parameter[a].told) printf(" %s", id->parameter[a].name);
    printf("%s\nnot told by any motion: %d of the links' own parameters (see result.yaml)\n",
           told_of(id) == id->count ? " none" : "", id->never_count);
    if (j->then)
        printf("proposed motion: %g s, would tell %d, sigmas %.2f times these (geometric mean), condition "
               "%.0f\n",
               j->proposed.duration_s, told_of(j->then), sigma_ratio(j), j->then->condition);
    printf("\nverdict: %s\n", verdict_name(j->gate.verdict));
    for (size_t i = 0; i < j->gate.count; i++) printf("  - %s\n", j->gate.reason[i]);
}
