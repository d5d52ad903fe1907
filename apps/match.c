/* teledimos match: points of a stereo pair, guided or automatic, as points in space with their error. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/match_internal.h"
#include "core/file.h"
#include "core/rig_formats.h"

#define WIDE_BAND_PX 12.0

static const char *argument[2], *rig_path, *points_path, *choose_path, *camera_names;
static cli_common common;
static cli_list gates;
static bool accept, automatic, correct;
static int count = 2000, half_window = 7, candidates = 8;
static double near_m = 0.5, far_m = 0, band_px = 0, zncc = 0, sigma_px = 0.1, cell_m = 0, longest_m = 0;

static cli_option options[] = {
    {CLI_STRING, "rig", 0, &rig_path, "FILE",
     "calibration of the cameras, as rig.yaml or a file of OpenCV, ROS, Kalibr, ViSP or mrcal (needed)", 0, 0,
     NULL},
    {CLI_STRING, "cameras", 0, &camera_names, "LEFT,RIGHT", "which two of the rig's; default: the first two",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "What is matched"},
    {CLI_FLAG, "auto", 0, &automatic, NULL, "interest points of both images (default)", 0, 0, NULL},
    {CLI_STRING, "points", 0, &points_path, "FILE",
     "guided: CSV of left points (x_px, y_px, optional point); writes candidates.csv, best first", 0, 0,
     NULL},
    {CLI_STRING, "choose", 0, &choose_path, "FILE",
     "a candidates.csv with 1 in `chosen` of the right ones, or any CSV of left_x_px, left_y_px, right_x_px, "
     "right_y_px",
     0, 0, NULL},
    {CLI_INT, "count", 0, &count, "N", "interest points of each image; default 2000", 10, 100000, NULL},
    {CLI_INT, "candidates", 0, &candidates, "N", "guided: at most so many for a point; default 8", 1, 100,
     NULL},
    {CLI_INT, "window", 0, &half_window, "K", "windows of 2K+1 pixels; default 7", 2, 50, NULL},
    {CLI_REAL, "near", 0, &near_m, "M", "nearest depth looked for; default 0.5", 1e-3, 1e5, NULL},
    {CLI_REAL, "far", 0, &far_m, "M", "farthest depth; default 0: any", 0, 1e6, NULL},
    {CLI_REAL, "band", 0, &band_px, "PX",
     "half width of the band around the epipolar curve; default 0: 3 sigma of the rig's, at least 1 px", 0,
     100, NULL},
    {CLI_REAL, "zncc", 0, &zncc, "Z", "least correlation; default 0.7, guided 0.5", -1, 1, NULL},
    {CLI_REAL, "sigma", 0, &sigma_px, "PX",
     "automatic: leave out matches less sure than this; default 0.1; 0: none", 0, 10, NULL},
    {.type = CLI_HEADING, .name = "The map"},
    {CLI_REAL, "cell", 0, &cell_m, "M", "side of its cells; default 0: a fifth of the points' spacing", 0,
     1e3, NULL},
    {CLI_REAL, "longest", 0, &longest_m, "M", "leave out triangles with a longer side; default 0: none", 0,
     1e6, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_FLAG, "correct", 0, &correct, NULL,
     "go on with the right camera turned so that the matches fit (see epipolar.rotation_deg)", 0, 0, NULL},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common,
                       "folder for the products: matches.csv, points.ply, map.tif, result.yaml, report.html, "
                       "log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "match",
    .summary = "points of a stereo pair in metres, guided or automatic",
    .usage = "LEFT RIGHT --rig RIG -o DIR [options]",
    .text =
        "Finds in the image RIGHT the points of the image LEFT along their epipolar curves, to a fraction of "
        "a "
        "pixel, and "
        "where they are in space, with a standard deviation of matching and calibration; from three points "
        "on, "
        "a coarse elevation map over them.\n\n"
        "Guided, a person says which left points are meant and picks among the ranked candidates: --points, "
        "then --choose. Images that do not belong to the rig are found out by their epipolar residual, "
        "and the turn of the right camera that explains it is offered. Exit status: 0 done, 1 failed, 2 "
        "wrong "
        "usage, 3 the gate refuses the result (--accept).",
    .examples = "  teledimos render datasets/site-polyhedra -o site\n"
                "  teledimos match site/left/01.png site/right/01.png --rig site/rig.yaml -o points\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 2,
    .positional = argument,
};

static td_status find_cameras(match_job *m, int camera[2], td_error *error)
{
    char name[2][TD_NAME_SIZE];
    camera[0] = 0, camera[1] = 1;
    if (!camera_names) return TD_OK;
    if (sscanf(camera_names, "%63[^,],%63[^,]", name[0], name[1]) != 2)
        return td_fail(error, TD_ERROR_ARGUMENT, "--cameras %s: write two names with a comma between",
                       camera_names);
    for (int k = 0; k < 2; k++) {
        camera[k] = td_rig_find(m->rig, name[k]);
        if (camera[k] < 0) return td_fail(error, TD_ERROR_DATA, "%s has no camera %s", rig_path, name[k]);
    }
    return TD_OK;
}

static td_status read_image(match_job *m, int side, int camera, td_error *error)
{
    TD_TRY(td_image_read(&m->image[side], argument[side], 1, error));
    const td_rig_camera *c = &m->rig->camera[camera];
    const td_image *i = m->image[side];
    if (i->width == c->camera.width && i->height == c->camera.height) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "%s is of %d x %d px, camera %s of %s of %d x %d: it is not its image", argument[side],
                   i->width, i->height, c->name, rig_path, c->camera.width, c->camera.height);
}

static td_status prepare(match_job *m, td_error *error)
{
    int camera[2];
    if (points_path && choose_path)
        return td_fail(error, TD_ERROR_ARGUMENT, "--points and --choose: give one of them");
    if (automatic && (points_path || choose_path))
        return td_fail(error, TD_ERROR_ARGUMENT, "--auto goes without --points and --choose");
    m->mode = points_path ? MATCH_GUIDED : choose_path ? MATCH_CHOSEN : MATCH_AUTOMATIC;
    m->points_path = points_path ? points_path : choose_path;
    TD_TRY(td_rig_import(&m->rig, &rig_path, 1, NULL, error));
    if (m->rig->count < 2)
        return td_fail(error, TD_ERROR_DATA, "%s: a rig of one camera has no pair", rig_path);
    TD_TRY(find_cameras(m, camera, error));
    TD_TRY(td_pair_init(&m->pair, m->rig, camera[0], camera[1], error));
    for (int side = 0; side < 2; side++) TD_TRY(read_image(m, side, camera[side], error));
    if (m->mode == MATCH_GUIDED) TD_TRY(match_points_read(m, error));
    if (m->mode == MATCH_CHOSEN) TD_TRY(match_choices_read(m, error));
    return td_match_options_check(&m->options, error);
}

static bool are_few(size_t n, const td_match_tally *tally)
{
    return n < 30 || 10 * n < tally->left_points;
}

/* Matches that only fit the other way round: the images were given in the wrong order. */
static bool look_swapped(const match_job *m)
{
    td_match *match = NULL;
    size_t n = 0;
    td_match_tally tally;
    const td_image *a = m->image[0], *b = m->image[1];
    td_match_options quiet = m->options;
    quiet.log = NULL;
    if (a->width != b->width || a->height != b->height) return false;
    td_status status = td_match_automatic(&match, &n, &tally, &m->pair, b, a, &quiet, NULL);
    free(match);
    return status == TD_OK && n >= 30 && 5 * n >= tally.left_points;
}

/* Cameras that turned far leave the band empty: what lies in a wide one says by how much. */
static td_status match_wide(match_job *m, td_match **match, size_t *n, td_error *error)
{
    td_match_options wide = m->options;
    td_match *more = NULL;
    td_match_tally tally;
    size_t found = 0;
    wide.band_px = WIDE_BAND_PX;
    TD_TRY(td_match_automatic(&more, &found, &tally, &m->pair, m->image[0], m->image[1], &wide, error));
    if (!are_few(found, &tally)) {
        free(*match);
        *match = more;
        *n = found;
        m->tally = tally;
        return TD_OK;
    }
    free(more);
    return TD_OK;
}

/* Do the images belong to the rig? From automatic matches, whatever the mode. */
static td_status check_pair(match_job *m, td_match **match, size_t *n, td_error *error)
{
    TD_TRY(td_match_automatic(match, n, &m->tally, &m->pair, m->image[0], m->image[1], &m->options, error));
    const bool few = are_few(*n, &m->tally);
    if (few && m->tally.left_points >= 30 && look_swapped(m))
        return td_fail(error, TD_ERROR_DATA,
                       "%s and %s match only the other way round: give the image of camera %s first",
                       argument[0], argument[1], m->rig->camera[m->pair.left].name);
    if (few && m->options.band_px == 0 && m->tally.left_points >= 30) TD_TRY(match_wide(m, match, n, error));
    if (*n < 8) return TD_OK;
    TD_TRY(td_epipolar_gate_check(&m->epipolar, &m->pair, *match, *n, error));
    m->has_gate = true;
    return TD_OK;
}

/* The turned rig: offered where the gate would refuse, taken where --correct says so. */
static td_status consider_turn(match_job *m, double limit_px, td_error *error)
{
    const td_epipolar_gate *e = &m->epipolar;
    if (!m->has_gate || !e->determined || !(correct || e->rms_px > limit_px)) return TD_OK;
    if (!(e->corrected_px < e->rms_px)) return TD_OK;
    TD_TRY(td_epipolar_gate_correct(&m->offer, e, &m->pair, error));
    if (!correct) return TD_OK;
    td_rig *rig = td_rig_copy(m->offer);
    if (!rig) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_rig_free(&m->rig);
    m->rig = rig;
    m->corrected = true;
    return td_pair_init(&m->pair, m->rig, m->pair.left, m->pair.right, error);
}

static td_status take_automatic(match_job *m, const td_match *match, size_t n, td_error *error)
{
    m->point = calloc(n + 1, sizeof *m->point);
    if (!m->point) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < n; i++) {
        match_point *p = &m->point[i];
        p->candidate = malloc(sizeof *p->candidate);
        if (!p->candidate) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
        snprintf(p->name, sizeof p->name, "%zu", i + 1);
        memcpy(p->left, match[i].left, sizeof p->left);
        *p->candidate = match[i];
        p->count = 1;
        m->point_count = i + 1;
    }
    return TD_OK;
}

static td_status guide(match_job *m, td_error *error)
{
    for (size_t i = 0; i < m->point_count; i++) {
        match_point *p = &m->point[i];
        td_status status = td_match_guided(&p->candidate, &p->count, &m->pair, m->image[0], m->image[1],
                                           p->left, &m->options, error);
        if (status != TD_OK) return td_error_prefix(error, status, "%s: point %s", m->points_path, p->name);
        p->chosen = p->count ? 0 : -1;
        if (!td_progress_report(m->options.progress, "ranking candidates", i + 1, m->point_count))
            return td_fail(error, TD_ERROR_CANCELLED, "interrupted after %zu of %zu points", i + 1,
                           m->point_count);
    }
    return TD_OK;
}

static void refine_choices(match_job *m)
{
    for (size_t i = 0; i < m->point_count; i++) match_refine_choice(m, m->point[i].candidate);
}

/* With the turned camera the band lies elsewhere: other matches, and what the turn really brought. */
static td_status match_again(match_job *m, td_match **match, size_t *n, td_error *error)
{
    td_epipolar_gate gate;
    free(*match);
    *match = NULL;
    TD_TRY(td_match_automatic(match, n, &m->tally, &m->pair, m->image[0], m->image[1], &m->options, error));
    if (*n < 8)
        return td_fail(error, TD_ERROR_DATA, "with the right camera turned only %zu points match", *n);
    TD_TRY(td_epipolar_gate_check(&gate, &m->pair, *match, *n, error));
    m->epipolar.corrected_px = gate.rms_px;
    return TD_OK;
}

static td_status find_points(match_job *m, double limit_px, td_error *error)
{
    td_match *match = NULL;
    size_t n = 0;
    td_status status = check_pair(m, &match, &n, error);
    if (status == TD_OK) status = consider_turn(m, limit_px, error);
    if (status == TD_OK && m->corrected) status = match_again(m, &match, &n, error);
    if (status == TD_OK && m->mode == MATCH_AUTOMATIC) status = take_automatic(m, match, n, error);
    if (status == TD_OK && m->mode == MATCH_GUIDED) status = guide(m, error);
    if (status == TD_OK && m->mode == MATCH_CHOSEN) refine_choices(m);
    free(match);
    return status;
}

static td_status write_file(const match_job *m, int k, const char *path, td_error *error)
{
    switch (k) {
    case 0:
        return m->map ? td_elevation_write(m->map, path, error) : TD_OK;
    case 1:
        return m->mode == MATCH_GUIDED ? match_candidates_write(m, path, error) : TD_OK;
    case 2:
        return m->count ? match_matches_write(m, path, error) : TD_OK;
    case 3:
        return m->count ? match_cloud_write(m, path, error) : TD_OK;
    default:
        return m->offer ? td_rig_write(m->offer, path, error) : TD_OK;
    }
}

/* The map first: it needs a module that may be missing, and then nothing is left behind. */
static td_status write_files(match_job *m, job *j)
{
    static const char *const names[] = {"map.tif", "candidates.csv", "matches.csv", "points.ply",
                                        "rig-corrected.yaml"};
    TD_TRY(td_folder_make(common.output, &j->error));
    for (int k = 0; k < 5; k++) {
        char *path = job_path(j, names[k]);
        td_status status = path ? write_file(m, k, path, &j->error) : TD_ERROR_MEMORY;
        free(path);
        TD_TRY(status);
    }
    return TD_OK;
}

static td_status run(match_job *m, job *j)
{
    gate_row rows[4];
    memcpy(rows, match_gate_defaults, match_gate_count * sizeof *rows);
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, match_gate_count, gates.value[i], &j->error));
    TD_TRY(prepare(m, &j->error));
    TD_TRY(find_points(m, rows[0].refuse, &j->error));
    TD_TRY(match_space(m, &j->error));
    match_judge(m, rows);
    if (terminal_interrupted()) return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    TD_TRY(write_files(m, j));
    const job_output output = {match_report, match_table, m};
    return job_finish(j, match_result(m), &output);
}

static void release(match_job *m)
{
    for (size_t i = 0; i < m->point_count; i++) free(m->point[i].candidate);
    free(m->point);
    free(m->index);
    free(m->match);
    free(m->space);
    free(m->triangle);
    td_elevation_free(&m->map);
    td_image_free(&m->image[0]);
    td_image_free(&m->image[1]);
    td_rig_free(&m->rig);
    td_rig_free(&m->offer);
}

int main(int argc, char **argv)
{
    job j;
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, match_gate_defaults, match_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int code = job_begin(&j, &command, &common, match_schema, match_schema_count, true, argc, argv);
    if (code >= 0) return code;
    match_job m = {.image_path = {argument[0], argument[1]},
                   .rig_path = rig_path,
                   .cell_m = cell_m,
                   .longest_m = longest_m,
                   .options = td_match_options_default()};
    m.options.half_window = half_window;
    m.options.near_m = near_m;
    m.options.far_m = far_m > 0 ? far_m : INFINITY;
    m.options.band_px = band_px;
    m.options.least_zncc = zncc != 0 ? zncc : points_path ? 0.5 : 0.7;
    m.options.most_sigma_px = sigma_px;
    m.options.candidates = (size_t)candidates;
    m.options.interest.count = (size_t)count;
    m.options.threads = common.threads;
    m.options.progress = &j.progress;
    m.options.log = &j.log;
    td_status status;
    if (!argument[0] || !argument[1] || !rig_path)
        status = td_fail(&j.error, TD_ERROR_ARGUMENT, "%s is missing (usage: teledimos %s %s)",
                         !argument[0]   ? "LEFT"
                         : !argument[1] ? "RIGHT"
                                        : "--rig RIG",
                         command.name, command.usage);
    else
        status = run(&m, &j);
    code = job_end(&j, status, m.gate.verdict == VERDICT_REFUSED && !accept);
    release(&m);
    return code;
}
