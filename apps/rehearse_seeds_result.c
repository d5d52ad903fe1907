/* Many rehearsals: the document, its schema, the verdict, the tables. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/rehearse_seeds.h"
#include "core/document.h"
#include "core/file.h"
#include "core/number.h"
#include "core/report.h"

const gate_row seeds_gate_defaults[] = {
    {"volume_misses", 0, 0.1,
     "share of seeds whose measured volume is more than 5 % off the true one, or more than 2 sigma, or that "
     "were stopped: of twenty two may be"},
    {"tip_median_m", 0.02, 0.03, "median over the seeds of the tool's distance from its prediction"},
    {"mass_kg", 0, 1e-6, "largest error of the soil's balance"},
    {"unmeant_contacts", 0, 0, "contact of the true machine with the true ground that was not told"},
};
const size_t seeds_gate_count = sizeof seeds_gate_defaults / sizeof *seeds_gate_defaults;

const td_schema_row seeds_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "rehearse-seeds"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"rehearsal", TD_SCHEMA_STRING, true, false, "its name"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused: of the first covariance"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"covariances", TD_SCHEMA_ARRAY, true, false, "what the rig's covariance was multiplied by, one a row"},
    {"covariances[].times", TD_SCHEMA_REAL, true, false, "of what is believed and of what is true"},
    {"covariances[].seeds", TD_SCHEMA_INT, true, false, "rehearsals"},
    {"covariances[].ended", TD_SCHEMA_INT, true, false, "of them: came to their end"},
    {"covariances[].volume_within_5_percent", TD_SCHEMA_INT, true, false,
     "of the true one, both of the whole and of what is seen"},
    {"covariances[].volume_within_2_sigma", TD_SCHEMA_INT, true, false, "the same"},
    {"covariances[].volume_error_median", TD_SCHEMA_REAL, true, true, "of the true volume, absolute"},
    {"covariances[].tip_error_median_m", TD_SCHEMA_REAL, true, true, "of the seeds' rms"},
    {"covariances[].sigma_tip_median_m", TD_SCHEMA_REAL, true, true, "as predicted"},
    {"covariances[].tip_above_error_median_m", TD_SCHEMA_REAL, true, true, "of its height above the ground"},
    {"covariances[].sigma_tip_above_median_m", TD_SCHEMA_REAL, true, true, "as predicted"},
    {"covariances[].mass_error_max_kg", TD_SCHEMA_REAL, true, false, "0"},
    {"covariances[].unmeant_contacts", TD_SCHEMA_INT, true, false, "0"},
    {"seeds", TD_SCHEMA_ARRAY, true, false, "one rehearsal a row"},
    {"seeds[].seed", TD_SCHEMA_INT, true, false, "of what is true"},
    {"seeds[].times", TD_SCHEMA_REAL, true, false, "the rig's covariance"},
    {"seeds[].verdict", TD_SCHEMA_STRING, true, false, "of the rehearsal"},
    {"seeds[].stopped", TD_SCHEMA_STRING, true, true, "why; null: it came to its end"},
    {"seeds[].rounds", TD_SCHEMA_INT, true, false, "executed"},
    {"seeds[].measured_volume_m3", TD_SCHEMA_REAL, true, true, "where it is seen, and predicted elsewhere"},
    {"seeds[].sigma_volume_m3", TD_SCHEMA_REAL, true, true, "of it"},
    {"seeds[].dug_volume_m3", TD_SCHEMA_REAL, true, false, "in truth"},
    {"seeds[].measured_seen_m3", TD_SCHEMA_REAL, true, true, "where it is seen"},
    {"seeds[].sigma_seen_m3", TD_SCHEMA_REAL, true, true, "of it"},
    {"seeds[].dug_seen_m3", TD_SCHEMA_REAL, true, true, "in truth, there"},
    {"seeds[].seen_share", TD_SCHEMA_REAL, true, true, "of the area around the trench"},
    {"seeds[].tip_error_m", TD_SCHEMA_REAL, true, true, "rms"},
    {"seeds[].sigma_tip_m", TD_SCHEMA_REAL, true, true, "as predicted"},
    {"seeds[].tip_above_error_m", TD_SCHEMA_REAL, true, true, "of its height above the ground, rms"},
    {"seeds[].sigma_tip_above_m", TD_SCHEMA_REAL, true, true, "as predicted"},
    {"seeds[].rig_sigmas", TD_SCHEMA_REAL, true, true, "by which the images show the rig to be off"},
    {"seeds[].collision_probability_max", TD_SCHEMA_REAL, true, false, "of one motion"},
    {"seeds[].mass_error_kg", TD_SCHEMA_REAL, true, false, "0"},
    {"seeds[].unmeant_contacts", TD_SCHEMA_INT, true, false, "0"},
    {"seeds[].cpu_s", TD_SCHEMA_REAL, true, false, "of computing"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t seeds_schema_count = sizeof seeds_schema / sizeof *seeds_schema;

void seeds_judge(seeds *s, const gate_row *rows)
{
    gate_result *g = &s->gate;
    const seeds_sum *sum = s->sum;
    const int right = sum->within_5 < sum->within_2_sigma ? sum->within_5 : sum->within_2_sigma;
    const int missed = sum->seeds - right;
    gate_check(
        g, rows, seeds_gate_count, "volume_misses", (double)missed / sum->seeds,
        "of %d seeds %d came to their end, the measured volume is within 5 %% of the true one in %d and "
        "within 2 sigma in %d",
        sum->seeds, sum->ended, sum->within_5, sum->within_2_sigma);
    if (sum->ended)
        gate_check(g, rows, seeds_gate_count, "tip_median_m", sum->tip_median_m,
                   "the tool is %.3f m off its prediction, in the median", sum->tip_median_m);
    gate_check(g, rows, seeds_gate_count, "mass_kg", sum->mass_most_kg, "%g kg of soil came or went",
               sum->mass_most_kg);
    gate_check(g, rows, seeds_gate_count, "unmeant_contacts", sum->unmeant,
               "%d tasks were executed with contact that was not meant", sum->unmeant);
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *sum_json(const seeds_sum *u)
{
    json_t *o = json_object();
    set(o, "times", td_json_real(u->covariance));
    set(o, "seeds", json_integer(u->seeds));
    set(o, "ended", json_integer(u->ended));
    set(o, "volume_within_5_percent", json_integer(u->within_5));
    set(o, "volume_within_2_sigma", json_integer(u->within_2_sigma));
    set(o, "volume_error_median", td_json_real(u->volume_median));
    set(o, "tip_error_median_m", td_json_real(u->tip_median_m));
    set(o, "sigma_tip_median_m", td_json_real(u->sigma_tip_median_m));
    set(o, "tip_above_error_median_m", td_json_real(u->above_median_m));
    set(o, "sigma_tip_above_median_m", td_json_real(u->sigma_above_median_m));
    set(o, "mass_error_max_kg", td_json_real(u->mass_most_kg));
    set(o, "unmeant_contacts", json_integer(u->unmeant));
    return o;
}

static json_t *row_json(const seeds_row *w)
{
    json_t *o = json_object();
    set(o, "seed", json_integer((json_int_t)w->seed));
    set(o, "times", td_json_real(w->covariance));
    set(o, "verdict", json_string(verdict_name(w->verdict)));
    set(o, "stopped", w->ended ? json_null() : json_string(w->why));
    set(o, "rounds", json_integer(w->rounds));
    set(o, "measured_volume_m3", td_json_real(w->measured_m3));
    set(o, "sigma_volume_m3", td_json_real(w->sigma_m3));
    set(o, "dug_volume_m3", td_json_real(w->dug_m3));
    set(o, "measured_seen_m3", td_json_real(w->measured_seen_m3));
    set(o, "sigma_seen_m3", td_json_real(w->sigma_seen_m3));
    set(o, "dug_seen_m3", td_json_real(w->dug_seen_m3));
    set(o, "seen_share", td_json_real(w->seen_share));
    set(o, "tip_error_m", td_json_real(w->tip.rms_m));
    set(o, "sigma_tip_m", td_json_real(w->tip.sigma_m));
    set(o, "tip_above_error_m", td_json_real(w->tip.above_m));
    set(o, "sigma_tip_above_m", td_json_real(w->tip.sigma_above_m));
    set(o, "rig_sigmas", td_json_real(w->rig_sigmas));
    set(o, "collision_probability_max", td_json_real(w->probability));
    set(o, "mass_error_kg", td_json_real(w->mass_error_kg));
    set(o, "unmeant_contacts", json_integer(w->unmeant));
    set(o, "cpu_s", td_json_real(w->cpu_s));
    return o;
}

json_t *seeds_result(const seeds *s)
{
    json_t *root = json_object(), *reasons = json_array(), *sums = json_array(), *rows = json_array();
    set(root, "job", json_string("rehearse-seeds"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "rehearsal", json_string(s->name));
    set(root, "scenario", json_string(s->scenario));
    set(root, "verdict", json_string(verdict_name(s->gate.verdict)));
    for (size_t i = 0; i < s->gate.count; i++) json_array_append_new(reasons, json_string(s->gate.reason[i]));
    set(root, "reasons", reasons);
    for (size_t i = 0; i < s->sum_count; i++) json_array_append_new(sums, sum_json(s->sum + i));
    set(root, "covariances", sums);
    for (size_t i = 0; i < s->count; i++) json_array_append_new(rows, row_json(s->row + i));
    set(root, "seeds", rows);
    set(root, "products",
        json_pack("{s:s, s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log",
                  "log.jsonl", "seeds", "seeds.csv"));
    return root;
}

/* ---- on the terminal ---- */

void seeds_table(const void *done)
{
    const seeds *s = done;
    printf("%4s %6s %9s %7s %8s %7s %7s %7s %7s %8s %9s %7s  %s\n", "seed", "rig x", "measured", "sigma",
           "dug", "tool m", "sigma", "above", "sigma", "rig/s", "mass kg", "contact", "stopped");
    for (size_t i = 0; i < s->count; i++) {
        const seeds_row *w = s->row + i;
        printf("%4llu %6g %9.3f %7.3f %8.3f %7.3f %7.3f %7.3f %7.3f %8.2f %9.1g %7d  %s\n",
               (unsigned long long)w->seed, w->covariance, w->measured_m3, w->sigma_m3, w->dug_m3,
               w->tip.rms_m, w->tip.sigma_m, w->tip.above_m, w->tip.sigma_above_m, w->rig_sigmas,
               w->mass_error_kg, w->unmeant, w->why);
    }
    printf("\n%6s %6s %6s %6s %8s %9s %8s %8s %8s %8s\n", "rig x", "seeds", "ended", "in 5%", "in 2 sig",
           "volume %", "tool m", "sigma", "above", "sigma");
    for (size_t i = 0; i < s->sum_count; i++) {
        const seeds_sum *u = s->sum + i;
        printf("%6g %6d %6d %6d %8d %9.2f %8.4f %8.4f %8.4f %8.4f\n", u->covariance, u->seeds, u->ended,
               u->within_5, u->within_2_sigma, 100 * u->volume_median, u->tip_median_m, u->sigma_tip_median_m,
               u->above_median_m, u->sigma_above_median_m);
    }
    printf("\nverdict: %s\n", verdict_name(s->gate.verdict));
    for (size_t i = 0; i < s->gate.count; i++) printf("  - %s\n", s->gate.reason[i]);
}

/* ---- products ---- */

static void put(FILE *f, double value)
{
    char text[TD_NUMBER_SIZE];
    fprintf(f, ",%s", isfinite(value) ? td_number_format(text, value, 10) : "");
}

td_status seeds_write(const seeds *s, const char *folder, td_error *error)
{
    char *text = NULL, *path = td_path_join(folder, "seeds.csv");
    size_t size = 0;
    FILE *f = path ? open_memstream(&text, &size) : NULL;
    if (!f) {
        free(path);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a table");
    }
    fputs("seed,rig_covariance_times,ended,rounds,measured_m3,sigma_m3,dug_m3,measured_seen_m3,sigma_seen_m3,"
          "dug_seen_m3,seen_share,tip_m,"
          "sigma_tip_m,tip_above_m,sigma_tip_above_m,rig_sigmas,mass_error_kg,unmeant_contacts\n",
          f);
    for (size_t i = 0; i < s->count; i++) {
        const seeds_row *w = s->row + i;
        const double value[] = {
            w->measured_m3,       w->sigma_m3,   w->dug_m3,       w->measured_seen_m3, w->sigma_seen_m3,
            w->dug_seen_m3,       w->seen_share, w->tip.rms_m,    w->tip.sigma_m,      w->tip.above_m,
            w->tip.sigma_above_m, w->rig_sigmas, w->mass_error_kg};
        fprintf(f, "%llu,%g,%d,%d", (unsigned long long)w->seed, w->covariance, w->ended, w->rounds);
        for (size_t k = 0; k < sizeof value / sizeof *value; k++) put(f, value[k]);
        fprintf(f, ",%d\n", w->unmeant);
    }
    const td_status status = fclose(f) != 0
                                 ? td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a table", path)
                                 : td_file_write(path, text, size, error);
    free(text);
    free(path);
    return status;
}

/* ---- the report ---- */

static void report_sums(td_report *r, const seeds *s)
{
    static const char *const columns[] = {"rig ×",  "seeds",   "ended",   "in 5 %",  "in 2 sigma",
                                          "tool m", "sigma m", "above m", "sigma m", "contacts"};
    td_report_table_begin(r, columns, sizeof columns / sizeof *columns);
    for (size_t i = 0; i < s->sum_count; i++) {
        const seeds_sum *u = s->sum + i;
        td_report_cell(r, TD_TONE_PLAIN, "%g", u->covariance);
        td_report_cell(r, TD_TONE_PLAIN, "%d", u->seeds);
        td_report_cell(r, TD_TONE_PLAIN, "%d", u->ended);
        td_report_cell(r, TD_TONE_PLAIN, "%d", u->within_5);
        td_report_cell(r, TD_TONE_PLAIN, "%d", u->within_2_sigma);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", u->tip_median_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", u->sigma_tip_median_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", u->above_median_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", u->sigma_above_median_m);
        td_report_cell(r, u->unmeant ? TD_TONE_BAD : TD_TONE_PLAIN, "%d", u->unmeant);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void report_rows(td_report *r, const seeds *s)
{
    static const char *const columns[] = {"seed",    "rig ×",   "measured m³", "dug m³",     "tool m",
                                          "sigma m", "above m", "sigma m",     "rig, sigma", "stopped"};
    td_report_table_begin(r, columns, sizeof columns / sizeof *columns);
    for (size_t i = 0; i < s->count; i++) {
        const seeds_row *w = s->row + i;
        td_report_cell(r, TD_TONE_PLAIN, "%llu", (unsigned long long)w->seed);
        td_report_cell(r, TD_TONE_PLAIN, "%g", w->covariance);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f ± %.3f", w->measured_m3, w->sigma_m3);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", w->dug_m3);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", w->tip.rms_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", w->tip.sigma_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", w->tip.above_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", w->tip.sigma_above_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.2f", w->rig_sigmas);
        td_report_cell(r, w->ended ? TD_TONE_PLAIN : TD_TONE_BAD, "%s", w->ended ? "" : w->why);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

td_status seeds_report(const void *done, const char *path, td_error *error)
{
    const seeds *s = done;
    td_report *r = td_report_new(s->name, "the same rehearsal with many truths");
    gate_report(r, &s->gate);
    td_report_heading(r, "By the rig's covariance");
    td_report_text(
        r,
        "Medians over the seeds. The rig's covariance is multiplied in what is believed and in what is true "
        "alike: errors and their predicted sigma should grow together, and shrink to what matching and the "
        "machine leave where the rig is known exactly. in 5 %%, in 2 sigma: the measured volume, of the true "
        "one where the ground is seen. tool: its true place less the predicted; above: its height above the "
        "ground, likewise.");
    report_sums(r, s);
    td_report_heading(r, "Each");
    report_rows(r, s);
    return td_report_write(r, path, error);
}
