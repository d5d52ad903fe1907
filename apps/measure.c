/* teledimos measure: cut and fill between two maps, heights along a line, slopes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/measure_internal.h"
#include "core/file.h"

static const char *argument[3], *polygon_path, *from_text, *to_text;
static cli_common common;
static cli_list gates;
static bool accept, level;
static double correlation_m = 0, common_m = 0, step_m = 0;

static cli_option options[] = {
    {.type = CLI_HEADING, .name = "Volume"},
    {CLI_STRING, "polygon", 0, &polygon_path, "FILE",
     "only what lies in it: CSV of its corners (x_m, y_m); default: all cells known in both maps", 0, 0,
     NULL},
    {CLI_FLAG, "level", 0, &level, NULL,
     "find the shift of one whole map against the other where nothing changed (outside the polygon), and "
     "take "
     "it off",
     0, 0, NULL},
    {CLI_REAL, "common", 0, &common_m, "M",
     "standard deviation of that shift, when it is not looked for; default 0", 0, 1e3, NULL},
    {CLI_REAL, "correlation", 0, &correlation_m, "M",
     "distance over which neighbouring cells share their noise (1/e); default 0: found where nothing changed",
     0, 1e6, NULL},
    {.type = CLI_HEADING, .name = "Profile"},
    {CLI_STRING, "from", 0, &from_text, "X,Y", "where the line begins, m in the map's frame", 0, 0, NULL},
    {CLI_STRING, "to", 0, &to_text, "X,Y", "where it ends", 0, 0, NULL},
    {CLI_REAL, "step", 0, &step_m, "M", "between its points; default 0: the side of a cell", 0, 1e6, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common,
                       "folder for the products: difference.tif, profile.csv or slope.tif, result.yaml, "
                       "report.html, log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "measure",
    .summary = "cut and fill between two maps with their error, profiles, slopes",
    .usage = "volume BEFORE AFTER | profile MAP | slope MAP, -o DIR [options]",
    .text =
        "volume: what was cut and filled between two elevation maps (GeoTIFF), and the difference map. The "
        "standard deviations know that neighbouring cells share their errors. Cut and fill are summed over "
        "places that changed (a cell by 5 sigma, its surroundings by 2, and a margin), so that noise is "
        "neither; what lies elsewhere is the rest.\n\n"
        "profile: heights along a line, with their sigma. slope: the steepest slope of each cell, rad in "
        "slope.tif, degrees in the report.\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (--accept).",
    .examples =
        "  teledimos render datasets/site-trench -o site --frames 1..1\n"
        "  teledimos measure volume site/truth/ground-before.tif site/truth/ground-after.tif -o volume\n"
        "  teledimos measure profile site/truth/ground-after.tif --from 4,-0.1 --to 11,-0.1 -o profile\n"
        "  teledimos measure slope site/truth/ground-after.tif -o slope\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 3,
    .positional = argument,
};

static td_status misfit(td_error *error, const char *option, const char *kind)
{
    return td_fail(error, TD_ERROR_ARGUMENT, "--%s goes with %s only", option, kind);
}

/* Which measurement, of what, with only its own options. */
static td_status understand(measure_job *m, td_error *error)
{
    int kind = 0;
    while (measure_kinds[kind] && (!argument[0] || strcmp(argument[0], measure_kinds[kind]) != 0)) kind++;
    if (!measure_kinds[kind])
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s%s: say volume, profile or slope first (usage: teledimos %s %s)",
                       argument[0] ? "cannot measure " : "nothing to measure", argument[0] ? argument[0] : "",
                       command.name, command.usage);
    m->kind = (measure_kind)kind;
    const size_t maps = m->kind == MEASURE_VOLUME ? 2 : 1;
    if (command.positional_count != 1 + maps)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s wants %s, not %zu", argument[0],
                       maps == 2 ? "two maps, BEFORE and AFTER" : "one MAP", command.positional_count - 1);
    for (size_t k = 0; k < maps; k++) m->path[k] = argument[1 + k];
    if (m->kind != MEASURE_VOLUME) {
        if (polygon_path) return misfit(error, "polygon", "volume");
        if (level) return misfit(error, "level", "volume");
        if (common_m > 0) return misfit(error, "common", "volume");
        if (correlation_m > 0) return misfit(error, "correlation", "volume");
    } else if (level && common_m > 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "--level finds the sigma of the shift: leave out --common");
    if (m->kind != MEASURE_PROFILE) {
        if (from_text || to_text) return misfit(error, from_text ? "from" : "to", "profile");
        if (step_m > 0) return misfit(error, "step", "profile");
        return TD_OK;
    }
    if (!from_text || !to_text)
        return td_fail(error, TD_ERROR_ARGUMENT, "--%s X,Y is missing", from_text ? "to" : "from");
    TD_TRY(measure_point_parse(m->from, "from", from_text, error));
    return measure_point_parse(m->to, "to", to_text, error);
}

static bool knows_sigma(const td_elevation *map)
{
    for (size_t i = 0, n = (size_t)map->columns * (size_t)map->rows; i < n; i++)
        if (isfinite(map->sigma[i])) return true;
    return false;
}

static td_status read_input(measure_job *m, td_error *error)
{
    m->has_sigma = true;
    for (int k = 0; k < 2; k++) {
        if (!m->path[k]) continue;
        TD_TRY(td_elevation_read(&m->map[k], m->path[k], error));
        m->has_sigma &= knows_sigma(m->map[k]);
    }
    return polygon_path ? measure_polygon_read(m, polygon_path, error) : TD_OK;
}

static td_status find_volume(measure_job *m, td_error *error)
{
    m->options = td_volume_options_default();
    m->options.polygon = (const double(*)[2])m->polygon;
    m->options.polygon_count = m->polygon_count;
    m->options.correlation_m = correlation_m;
    m->options.common_m = level ? NAN : common_m;
    td_status status = td_volume_between(&m->volume, &m->product, m->map[0], m->map[1], &m->options, error);
    if (status == TD_OK) return status;
    return td_error_prefix(error, status, "%s and %s%s%s", m->path[0], m->path[1], polygon_path ? " in " : "",
                           polygon_path ? polygon_path : "");
}

static td_status find_profile(measure_job *m, td_error *error)
{
    m->step_m = step_m > 0 ? step_m : m->map[0]->cell_m;
    td_status status =
        td_elevation_profile(&m->profile, &m->count, m->map[0], m->from, m->to, m->step_m, error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s", m->path[0]);
    for (size_t i = 0; i < m->count; i++) m->known += isfinite(m->profile[i].height_m);
    return TD_OK;
}

static int by_value(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static td_status find_slope(measure_job *m, td_error *error)
{
    td_status status = td_elevation_slope(&m->product, m->map[0], error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s", m->path[0]);
    const size_t n = (size_t)m->product->columns * (size_t)m->product->rows;
    float *value = malloc(n * sizeof *value);
    if (!value) return td_fail(error, TD_ERROR_MEMORY, "no memory for the slopes");
    for (size_t i = 0; i < n; i++)
        if (isfinite(m->product->height[i])) value[m->slope_cells++] = m->product->height[i];
    qsort(value, m->slope_cells, sizeof *value, by_value);
    m->slope_rad[0] = value[m->slope_cells / 2];
    m->slope_rad[1] = value[m->slope_cells * 19 / 20];
    m->slope_rad[2] = value[m->slope_cells - 1];
    free(value);
    return TD_OK;
}

static td_status write_files(measure_job *m, job *j)
{
    static const char *const names[] = {"difference.tif", "profile.csv", "slope.tif"};
    TD_TRY(td_folder_make(common.output, &j->error));
    char *path = job_path(j, names[m->kind]);
    if (!path) return TD_ERROR_MEMORY;
    td_status status = m->product ? td_elevation_write(m->product, path, &j->error)
                                  : measure_profile_write(m, path, &j->error);
    free(path);
    return status;
}

static td_status run(measure_job *m, job *j)
{
    gate_row rows[4];
    memcpy(rows, measure_gate_defaults, measure_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, measure_gate_count, gates.value[i], &j->error));
    TD_TRY(understand(m, &j->error));
    TD_TRY(read_input(m, &j->error));
    static td_status (*const find[])(measure_job *, td_error *) = {find_volume, find_profile, find_slope};
    TD_TRY(find[m->kind](m, &j->error));
    measure_judge(m, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(write_files(m, j));
    const job_output output = {measure_report, measure_table, m};
    return job_finish(j, measure_result(m), &output);
}

int main(int argc, char **argv)
{
    job j;
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, measure_gate_defaults, measure_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int code = job_begin(&j, &command, &common, measure_schema, measure_schema_count, true, argc, argv);
    if (code >= 0) return code;
    measure_job m = {0};
    td_status status = run(&m, &j);
    code = job_end(&j, status, m.gate.verdict == VERDICT_REFUSED && !accept);
    free(m.polygon);
    free(m.profile);
    td_elevation_free(&m.map[0]);
    td_elevation_free(&m.map[1]);
    td_elevation_free(&m.product);
    return code;
}
