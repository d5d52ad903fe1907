/* The result of teledimos measure: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>

#include "apps/measure_internal.h"
#include "core/document.h"

#define DEGREES 57.29577951308232

const char *const measure_kinds[] = {"volume", "profile", "slope", NULL};

const gate_row measure_gate_defaults[] = {
    {"rest_sigmas", 3, 6,
     "volume that lies in no place that changed, over its sigma: more says that one map is shifted against "
     "the "
     "other, or that something changed widely by less than 5 sigma"},
    {"scatter", 1.5, 3,
     "spread of the difference where nothing changed, over the maps' sigma: above 1 their sigma, and the "
     "volumes' with it, is too small"},
    {"missing_share", 0.05, 0.5, "share of the polygon's cells that are not known in both maps"},
};
const size_t measure_gate_count = sizeof measure_gate_defaults / sizeof *measure_gate_defaults;

const td_schema_row measure_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "measure"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"kind", TD_SCHEMA_STRING, true, false, "volume, profile or slope"},
    {"maps", TD_SCHEMA_STRINGS, true, false, "before and after; or the map"},
    {"frame", TD_SCHEMA_STRING, true, false, "of the maps"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"volume", TD_SCHEMA_OBJECT, false, false, "between the maps"},
    {"volume.cut_m3", TD_SCHEMA_REAL, true, false, "taken away, over the places that changed"},
    {"volume.sigma_cut_m3", TD_SCHEMA_REAL, true, false, "its standard deviation"},
    {"volume.fill_m3", TD_SCHEMA_REAL, true, false, "added, over the places that changed"},
    {"volume.sigma_fill_m3", TD_SCHEMA_REAL, true, false, "its standard deviation"},
    {"volume.net_m3", TD_SCHEMA_REAL, true, false, "of all cells: fill - cut + rest"},
    {"volume.sigma_net_m3", TD_SCHEMA_REAL, true, false, "its standard deviation"},
    {"volume.rest_m3", TD_SCHEMA_REAL, true, false, "signed, of the cells of no place that changed"},
    {"volume.sigma_rest_m3", TD_SCHEMA_REAL, true, false, "its standard deviation"},
    {"volume.area_m2", TD_SCHEMA_REAL, true, false, "compared"},
    {"volume.changed_m2", TD_SCHEMA_REAL, true, false, "differing by more than 3 sigma"},
    {"volume.cells", TD_SCHEMA_INT, true, false, "compared"},
    {"volume.missing", TD_SCHEMA_INT, true, false, "cells of the region that are not known in both maps"},
    {"volume.noise_m", TD_SCHEMA_REAL, true, false, "median sigma of a cell's difference"},
    {"volume.scatter", TD_SCHEMA_REAL, true, true,
     "spread where nothing changed over that sigma; null: the maps have no sigma, or nothing is unchanged"},
    {"volume.correlation_m", TD_SCHEMA_REAL, true, false, "of the noise: 1/e at this distance"},
    {"volume.shift_m", TD_SCHEMA_REAL, true, false, "of the map after, found and taken off (--level)"},
    {"volume.sigma_shift_m", TD_SCHEMA_REAL, true, false, "its standard deviation, found or given"},
    {"profile", TD_SCHEMA_OBJECT, false, false, "heights along the line"},
    {"profile.from_m", TD_SCHEMA_REALS, true, false, "x, y"},
    {"profile.to_m", TD_SCHEMA_REALS, true, false, "x, y"},
    {"profile.length_m", TD_SCHEMA_REAL, true, false, "in plan"},
    {"profile.points", TD_SCHEMA_INT, true, false, "on the line"},
    {"profile.known", TD_SCHEMA_INT, true, false, "of them with a height"},
    {"profile.lowest_m", TD_SCHEMA_REAL, true, false, "height"},
    {"profile.highest_m", TD_SCHEMA_REAL, true, false, "height"},
    {"slope", TD_SCHEMA_OBJECT, false, false, "of the cells"},
    {"slope.cells", TD_SCHEMA_INT, true, false, "with a slope"},
    {"slope.median_deg", TD_SCHEMA_REAL, true, false, "half of the cells are steeper"},
    {"slope.steep_deg", TD_SCHEMA_REAL, true, false, "one cell of twenty is steeper"},
    {"slope.steepest_deg", TD_SCHEMA_REAL, true, false, "the steepest cell"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t measure_schema_count = sizeof measure_schema / sizeof *measure_schema;

static double in_sigmas(double value, double sigma)
{
    return value == 0 || sigma == 0 ? 0 : fabs(value) / sigma;
}

static void judge_volume(measure_job *m, const gate_row *rows)
{
    gate_result *g = &m->gate;
    const td_volume *v = &m->volume;
    const double rest = in_sigmas(v->rest_m3, v->sigma_rest_m3);
    gate_check(
        g, rows, measure_gate_count, "rest_sigmas", rest,
        "%+.3g m3 (%.1f sigma) lie in no place that changed: one map is shifted against the other (--level "
        "takes that off, --common says how sure it is) or something changed widely by less than 5 sigma",
        v->rest_m3, rest);
    if (isfinite(v->scatter))
        gate_check(
            g, rows, measure_gate_count, "scatter", v->scatter,
            "where nothing changed, the difference scatters %.2f times as much as the maps' sigma says: the "
            "sigma of the volumes is too small by as much",
            v->scatter);
    if (m->polygon) {
        const double share = (double)v->missing / (double)(v->missing + v->cells);
        gate_check(g, rows, measure_gate_count, "missing_share", share,
                   "%zu of the polygon's %zu cells are not known in both maps: their volume is left out",
                   v->missing, v->missing + v->cells);
    }
    if (!m->has_sigma)
        gate_add(g, VERDICT_WARNED,
                 "a map has no sigma: the volumes' sigma is from the scatter of the difference where nothing "
                 "changed");
}

void measure_judge(measure_job *m, const gate_row *rows)
{
    m->gate = (gate_result){0};
    if (m->kind == MEASURE_VOLUME) judge_volume(m, rows);
    if (m->kind == MEASURE_PROFILE && m->known < m->count)
        gate_add(&m->gate, VERDICT_WARNED, "%zu of the line's %zu points are not known", m->count - m->known,
                 m->count);
    if (m->kind != MEASURE_VOLUME && !m->has_sigma)
        gate_add(&m->gate, VERDICT_WARNED, "the map has no sigma");
}

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *volume_json(const td_volume *v)
{
    const struct {
        const char *key;
        double value;
    } reals[] = {{"cut_m3", v->cut_m3},
                 {"sigma_cut_m3", v->sigma_cut_m3},
                 {"fill_m3", v->fill_m3},
                 {"sigma_fill_m3", v->sigma_fill_m3},
                 {"net_m3", v->net_m3},
                 {"sigma_net_m3", v->sigma_net_m3},
                 {"rest_m3", v->rest_m3},
                 {"sigma_rest_m3", v->sigma_rest_m3},
                 {"area_m2", v->area_m2},
                 {"changed_m2", v->changed_m2},
                 {"noise_m", v->noise_m},
                 {"scatter", v->scatter},
                 {"correlation_m", v->correlation_m},
                 {"shift_m", v->shift_m},
                 {"sigma_shift_m", v->sigma_shift_m}};
    json_t *o = json_object();
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        set(o, reals[i].key, td_json_real(reals[i].value));
    set(o, "cells", json_integer((json_int_t)v->cells));
    set(o, "missing", json_integer((json_int_t)v->missing));
    return o;
}

static void height_range(double range[2], const measure_job *m)
{
    range[0] = INFINITY;
    range[1] = -INFINITY;
    for (size_t i = 0; i < m->count; i++) {
        if (!isfinite(m->profile[i].height_m)) continue;
        range[0] = fmin(range[0], m->profile[i].height_m);
        range[1] = fmax(range[1], m->profile[i].height_m);
    }
}

static json_t *profile_json(const measure_job *m)
{
    double range[2];
    json_t *o = json_object();
    height_range(range, m);
    set(o, "from_m", td_json_reals(m->from, 2));
    set(o, "to_m", td_json_reals(m->to, 2));
    set(o, "length_m", td_json_real(m->profile[m->count - 1].distance_m));
    set(o, "points", json_integer((json_int_t)m->count));
    set(o, "known", json_integer((json_int_t)m->known));
    set(o, "lowest_m", td_json_real(range[0]));
    set(o, "highest_m", td_json_real(range[1]));
    return o;
}

static json_t *slope_json(const measure_job *m)
{
    json_t *o = json_object();
    set(o, "cells", json_integer((json_int_t)m->slope_cells));
    set(o, "median_deg", td_json_real(DEGREES * m->slope_rad[0]));
    set(o, "steep_deg", td_json_real(DEGREES * m->slope_rad[1]));
    set(o, "steepest_deg", td_json_real(DEGREES * m->slope_rad[2]));
    return o;
}

json_t *measure_result(const measure_job *m)
{
    static const char *const products[][2] = {
        {"difference", "difference.tif"}, {"profile", "profile.csv"}, {"slope", "slope.tif"}};
    json_t *root = json_object(), *reasons = json_array(), *maps = json_array();
    set(root, "job", json_string("measure"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "kind", json_string(measure_kinds[m->kind]));
    for (int k = 0; k < 2; k++)
        if (m->path[k]) json_array_append_new(maps, json_string(m->path[k]));
    set(root, "maps", maps);
    set(root, "frame", json_string(m->map[0]->frame));
    set(root, "verdict", json_string(verdict_name(m->gate.verdict)));
    for (size_t i = 0; i < m->gate.count; i++) json_array_append_new(reasons, json_string(m->gate.reason[i]));
    set(root, "reasons", reasons);
    if (m->kind == MEASURE_VOLUME) set(root, "volume", volume_json(&m->volume));
    if (m->kind == MEASURE_PROFILE) set(root, "profile", profile_json(m));
    if (m->kind == MEASURE_SLOPE) set(root, "slope", slope_json(m));
    set(root, "products",
        json_pack("{s:s, s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log",
                  "log.jsonl", products[m->kind][0], products[m->kind][1]));
    return root;
}

static void volume_table(const measure_job *m)
{
    const td_volume *v = &m->volume;
    const struct {
        const char *name;
        double value, sigma;
    } rows[] = {{"cut", v->cut_m3, v->sigma_cut_m3},
                {"fill", v->fill_m3, v->sigma_fill_m3},
                {"rest", v->rest_m3, v->sigma_rest_m3},
                {"net", v->net_m3, v->sigma_net_m3}};
    printf("%-6s %14s %12s\n", "", "m3", "sigma m3");
    for (int i = 0; i < 4; i++) printf("%-6s %14.4f %12.4f\n", rows[i].name, rows[i].value, rows[i].sigma);
    printf("\n%.2f m2 compared, %.2f m2 changed; %zu cells not known in both maps\n", v->area_m2,
           v->changed_m2, v->missing);
    printf("noise %.1f mm a cell, correlated over %.3f m; shift %+.1f mm, sigma %.1f mm\n", 1e3 * v->noise_m,
           v->correlation_m, 1e3 * v->shift_m, 1e3 * v->sigma_shift_m);
}

void measure_table(const void *found)
{
    const measure_job *m = found;
    double range[2];
    if (m->kind == MEASURE_VOLUME) volume_table(m);
    if (m->kind == MEASURE_PROFILE) {
        height_range(range, m);
        printf("%zu points over %.2f m, %zu known; heights from %.3f to %.3f m\n", m->count,
               m->profile[m->count - 1].distance_m, m->known, range[0], range[1]);
    }
    if (m->kind == MEASURE_SLOPE)
        printf("%zu cells; slope: median %.1f degrees, a twentieth above %.1f, steepest %.1f\n",
               m->slope_cells, DEGREES * m->slope_rad[0], DEGREES * m->slope_rad[1],
               DEGREES * m->slope_rad[2]);
    printf("\nverdict: %s\n", verdict_name(m->gate.verdict));
    for (size_t i = 0; i < m->gate.count; i++) printf("  - %s\n", m->gate.reason[i]);
}
