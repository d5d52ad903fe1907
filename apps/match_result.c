/* The result of teledimos match: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/match_internal.h"
#include "core/document.h"

#define DEGREES 57.29577951308232

const gate_row match_gate_defaults[] = {
    {"epipolar_px", 0.2, 0.3,
     "robust RMS distance of automatic matches from their epipolar curves: sub-pixel matches of a rig in "
     "order "
     "stay below 0.2 px; above 0.3 px the cameras have moved since they were calibrated, and depths with "
     "them"},
    {"sigma_m", 0.02, 0.1, "median standard deviation of the points, worst direction"},
};
const size_t match_gate_count = sizeof match_gate_defaults / sizeof *match_gate_defaults;

const td_schema_row match_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "match"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"mode", TD_SCHEMA_STRING, true, false, "automatic, guided or chosen"},
    {"left", TD_SCHEMA_STRING, true, false, "image"},
    {"right", TD_SCHEMA_STRING, true, false, "image"},
    {"cameras", TD_SCHEMA_STRINGS, true, false, "of the rig: left, right"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"epipolar", TD_SCHEMA_OBJECT, false, false, "do the images belong to the rig? From automatic matches"},
    {"epipolar.matches", TD_SCHEMA_INT, true, false, "automatic matches"},
    {"epipolar.inliers", TD_SCHEMA_INT, true, false, "of them used"},
    {"epipolar.median_px", TD_SCHEMA_REAL, true, false, "signed distance from the epipolar curve, median"},
    {"epipolar.rms_px", TD_SCHEMA_REAL, true, false, "distance, robust RMS"},
    {"epipolar.corrected_px", TD_SCHEMA_REAL, true, true, "the same after the rotation below"},
    {"epipolar.rotation_deg", TD_SCHEMA_REALS, true, true,
     "turn of the right camera that removes it: rotation vector, in the camera's frame"},
    {"epipolar.sigma_deg", TD_SCHEMA_REALS, true, true, "its standard deviations"},
    {"epipolar.applied", TD_SCHEMA_BOOL, true, false, "whether the points below are with the turned camera"},
    {"tally", TD_SCHEMA_OBJECT, false, false, "what became of the interest points (automatic)"},
    {"tally.left_points", TD_SCHEMA_INT, true, false, "interest points of the left image"},
    {"tally.unseen", TD_SCHEMA_INT, true, false, "no place in the band looks alike"},
    {"tally.ambiguous", TD_SCHEMA_INT, true, false, "two places look alike"},
    {"tally.one_sided", TD_SCHEMA_INT, true, false, "the way back leads elsewhere"},
    {"tally.unrefined", TD_SCHEMA_INT, true, false, "no sub-pixel solution"},
    {"tally.unsure", TD_SCHEMA_INT, true, false, "a sigma above --sigma"},
    {"points", TD_SCHEMA_INT, true, false, "left points: given, or matched"},
    {"matched", TD_SCHEMA_INT, true, false, "of them with a match that is a point in space"},
    {"ambiguous", TD_SCHEMA_INT, true, false, "guided: points that another place fits nearly as well"},
    {"frame", TD_SCHEMA_STRING, true, false,
     "of the points and the map: vehicle, or rig (first camera; x forward, y left, z up)"},
    {"sigma_m", TD_SCHEMA_OBJECT, false, false, "standard deviation of the points, worst direction"},
    {"sigma_m.median", TD_SCHEMA_REAL, true, true,
     "all together; null: the rig's calibration sigma is unknown"},
    {"sigma_m.worst", TD_SCHEMA_REAL, true, true, "the same, worst point"},
    {"sigma_m.matching_median", TD_SCHEMA_REAL, true, true, "matching alone"},
    {"sigma_m.calibration_median", TD_SCHEMA_REAL, true, true, "calibration alone; null: unknown"},
    {"depth_m", TD_SCHEMA_REALS, false, false, "nearest and farthest point from the left camera"},
    {"map", TD_SCHEMA_OBJECT, false, false, "coarse elevation map"},
    {"map.columns", TD_SCHEMA_INT, true, false, "cells along x"},
    {"map.rows", TD_SCHEMA_INT, true, false, "cells along y"},
    {"map.cell_m", TD_SCHEMA_REAL, true, false, "side of a cell"},
    {"map.cells", TD_SCHEMA_INT, true, false, "with a height"},
    {"map.triangles", TD_SCHEMA_INT, true, false, "of the surface over the points"},
    {"map.sigma_median_m", TD_SCHEMA_REAL, true, true, "standard deviation of the heights"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t match_schema_count = sizeof match_schema / sizeof *match_schema;

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median and largest of what is finite; NaN of nothing. */
static double median(double *value, size_t count, double *largest)
{
    size_t n = 0;
    for (size_t i = 0; i < count; i++)
        if (isfinite(value[i])) value[n++] = value[i];
    qsort(value, n, sizeof *value, by_value);
    if (largest) *largest = n ? value[n - 1] : NAN;
    return n ? value[n / 2] : NAN;
}

typedef enum sigma_part { SIGMA_ALL, SIGMA_MATCHING, SIGMA_CALIBRATION } sigma_part;

static double sigma_median(const match_job *m, sigma_part part, double *worst)
{
    double *s = malloc((m->count + 1) * sizeof *s);
    if (!s) return NAN;
    for (size_t i = 0; i < m->count; i++) {
        const td_point3 *p = &m->space[i];
        s[i] = match_sigma(part == SIGMA_ALL        ? p->covariance
                           : part == SIGMA_MATCHING ? p->matching
                                                    : p->calibration);
    }
    double value = median(s, m->count, worst);
    free(s);
    return value;
}

/* A turn that explains most of the distance speaks against the rig; else the matches may be to blame. */
static const char *epipolar_meaning(const match_job *m, double px, const gate_row *rows)
{
    const td_epipolar_gate *e = &m->epipolar;
    if (px <= rows[0].refuse) return "more than a rig in order has";
    if (e->determined && e->corrected_px < 0.7 * e->rms_px)
        return "the rig is not what these images were taken with";
    return "the rig is not what these images were taken with, or many of the matches are wrong, as on a "
           "texture that repeats";
}

static void judge_epipolar(match_job *m, const gate_row *rows)
{
    gate_result *g = &m->gate;
    const td_epipolar_gate *e = &m->epipolar;
    if (!m->has_gate) {
        gate_add(
            g, VERDICT_WARNED,
            "too few automatic matches to see whether the images belong to the rig: take images with more "
            "texture, or check the rig with `teledimos check`");
        return;
    }
    double px = m->corrected ? e->corrected_px : e->rms_px;
    char offer[200] = "";
    if (m->offer && !m->corrected)
        snprintf(offer, sizeof offer,
                 "; turning the right camera by %.3f, %.3f, %.3f degrees brings them to %.3f px: "
                 "rig-corrected.yaml has it, --correct uses it",
                 DEGREES * e->rotation[0], DEGREES * e->rotation[1], DEGREES * e->rotation[2],
                 e->corrected_px);
    gate_check(g, rows, match_gate_count, "epipolar_px", px,
               "%zu automatic matches lie %.3f px from their epipolar curves%s: %s%s", e->matches, px,
               m->corrected ? ", the right camera turned" : "", epipolar_meaning(m, px, rows), offer);
}

/* Points of a person that another place fits nearly as well, as on a texture that repeats. */
static size_t ambiguous_points(const match_job *m)
{
    size_t count = 0;
    for (size_t i = 0; m->mode == MATCH_GUIDED && i < m->point_count; i++) {
        const match_point *p = &m->point[i];
        count += p->count && p->candidate[0].runner_up > m->options.uniqueness * p->candidate[0].zncc;
    }
    return count;
}

static void judge_points(match_job *m)
{
    size_t unrefined = 0, ambiguous = ambiguous_points(m);
    for (size_t i = 0; i < m->count; i++) unrefined += !m->match[i].refined;
    if (ambiguous)
        gate_add(&m->gate, VERDICT_WARNED,
                 "%zu of %zu points fit another place nearly as well (ZNCC above %g times the best): look at "
                 "their candidates and use --choose",
                 ambiguous, m->point_count, m->options.uniqueness);
    if (unrefined)
        gate_add(&m->gate, VERDICT_WARNED,
                 "%zu of %zu matches are without sigma: their windows could not be refined, for too little "
                 "texture or an edge of depth in them",
                 unrefined, m->count);
}

void match_judge(match_job *m, const gate_row *rows)
{
    gate_result *g = &m->gate;
    *g = (gate_result){0};
    judge_epipolar(m, rows);
    if (!m->count)
        gate_add(g, VERDICT_REFUSED, "no point was matched: see what became of them below");
    else if (m->count < m->point_count)
        gate_add(g, VERDICT_WARNED, "%zu of %zu points have no %s", m->point_count - m->count, m->point_count,
                 m->mode == MATCH_GUIDED ? "candidate that is a point in space"
                                         : "place in space: their rays do not meet before the cameras");
    judge_points(m);
    if (!m->calibration_known)
        gate_add(g, VERDICT_WARNED,
                 "calibration sigma unknown: %s has no covariance, so the points' sigma is that of matching "
                 "alone; "
                 "`teledimos calibrate` gives a rig with one",
                 m->rig_path);
    double value = sigma_median(m, m->calibration_known ? SIGMA_ALL : SIGMA_MATCHING, NULL);
    if (isfinite(value))
        gate_check(g, rows, match_gate_count, "sigma_m", value, "the points' median sigma is %.1f mm",
                   1e3 * value);
    if (m->count && m->map_remark[0]) gate_add(g, VERDICT_WARNED, "no map: %s", m->map_remark);
}

static json_t *degrees(const double *value, double scale)
{
    double out[3];
    for (int k = 0; k < 3; k++) out[k] = scale * value[k];
    return td_json_reals(out, 3);
}

static json_t *epipolar_json(const match_job *m)
{
    const td_epipolar_gate *e = &m->epipolar;
    double sigma[3];
    for (int k = 0; k < 3; k++) sigma[k] = sqrt(e->covariance[4 * k]);
    json_t *o = json_object();
    set(o, "matches", json_integer((json_int_t)e->matches));
    set(o, "inliers", json_integer((json_int_t)e->inliers));
    set(o, "median_px", td_json_real(e->median_px));
    set(o, "rms_px", td_json_real(e->rms_px));
    set(o, "corrected_px", e->determined ? td_json_real(e->corrected_px) : json_null());
    set(o, "rotation_deg", e->determined ? degrees(e->rotation, DEGREES) : json_null());
    set(o, "sigma_deg", e->determined ? degrees(sigma, DEGREES) : json_null());
    set(o, "applied", json_boolean(m->corrected));
    return o;
}

static json_t *tally_json(const td_match_tally *t)
{
    json_t *o = json_object();
    set(o, "left_points", json_integer((json_int_t)t->left_points));
    set(o, "unseen", json_integer((json_int_t)t->unseen));
    set(o, "ambiguous", json_integer((json_int_t)t->ambiguous));
    set(o, "one_sided", json_integer((json_int_t)t->one_sided));
    set(o, "unrefined", json_integer((json_int_t)t->unrefined));
    set(o, "unsure", json_integer((json_int_t)t->unsure));
    return o;
}

static json_t *sigma_json(const match_job *m)
{
    json_t *o = json_object();
    double worst = NAN, all = sigma_median(m, SIGMA_ALL, &worst);
    set(o, "median", td_json_real(all));
    set(o, "worst", td_json_real(worst));
    set(o, "matching_median", td_json_real(sigma_median(m, SIGMA_MATCHING, NULL)));
    set(o, "calibration_median", td_json_real(sigma_median(m, SIGMA_CALIBRATION, NULL)));
    return o;
}

static json_t *depth_json(const match_job *m)
{
    double range[2] = {INFINITY, 0};
    for (size_t i = 0; i < m->count; i++) {
        td_point3 p;
        double at[3];
        if (!td_triangulate(&p, &m->pair, &m->match[i])) continue;
        td_pose_transform(at, &m->rig->camera[m->pair.left].camera_from_rig, p.p);
        range[0] = fmin(range[0], at[2]);
        range[1] = fmax(range[1], at[2]);
    }
    return td_json_reals(range, 2);
}

static json_t *map_json(const match_job *m)
{
    const td_elevation *map = m->map;
    size_t cells = (size_t)map->columns * (size_t)map->rows, known = 0, n = 0;
    double *sigma = malloc((cells + 1) * sizeof *sigma);
    for (size_t i = 0; i < cells; i++) {
        if (!isfinite(map->height[i])) continue;
        known++;
        if (sigma) sigma[n++] = map->sigma[i];
    }
    json_t *o = json_object();
    set(o, "columns", json_integer(map->columns));
    set(o, "rows", json_integer(map->rows));
    set(o, "cell_m", td_json_real(map->cell_m));
    set(o, "cells", json_integer((json_int_t)known));
    set(o, "triangles", json_integer((json_int_t)m->triangle_count));
    set(o, "sigma_median_m", td_json_real(sigma ? median(sigma, n, NULL) : NAN));
    free(sigma);
    return o;
}

static json_t *products_json(const match_job *m)
{
    json_t *o =
        json_pack("{s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log", "log.jsonl");
    if (m->mode == MATCH_GUIDED) set(o, "candidates", json_string("candidates.csv"));
    if (m->count) set(o, "matches", json_string("matches.csv"));
    if (m->count) set(o, "cloud", json_string("points.ply"));
    if (m->map) set(o, "map", json_string("map.tif"));
    if (m->offer) set(o, "rig", json_string("rig-corrected.yaml"));
    return o;
}

json_t *match_result(const match_job *m)
{
    static const char *const modes[] = {"automatic", "guided", "chosen"};
    json_t *root = json_object(), *reasons = json_array();
    set(root, "job", json_string("match"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "mode", json_string(modes[m->mode]));
    set(root, "left", json_string(m->image_path[0]));
    set(root, "right", json_string(m->image_path[1]));
    set(root, "cameras",
        json_pack("[s, s]", m->rig->camera[m->pair.left].name, m->rig->camera[m->pair.right].name));
    set(root, "verdict", json_string(verdict_name(m->gate.verdict)));
    for (size_t i = 0; i < m->gate.count; i++) json_array_append_new(reasons, json_string(m->gate.reason[i]));
    set(root, "reasons", reasons);
    if (m->has_gate) set(root, "epipolar", epipolar_json(m));
    set(root, "tally", tally_json(&m->tally));
    set(root, "points", json_integer((json_int_t)m->point_count));
    set(root, "matched", json_integer((json_int_t)m->count));
    set(root, "ambiguous", json_integer((json_int_t)ambiguous_points(m)));
    set(root, "frame", json_string(m->frame));
    if (m->count) set(root, "sigma_m", sigma_json(m));
    if (m->count) set(root, "depth_m", depth_json(m));
    if (m->map) set(root, "map", map_json(m));
    set(root, "products", products_json(m));
    return root;
}

static void print_points(const match_job *m)
{
    size_t shown = m->count < 20 ? m->count : 20;
    printf("\n%-8s %9s %9s %9s %9s %7s %9s %9s %9s %8s\n", "point", "left x", "left y", "right x", "right y",
           "zncc", "x m", "y m", "z m", "sigma mm");
    for (size_t i = 0; i < shown; i++) {
        const td_match *a = &m->match[i];
        const td_point3 *p = &m->space[i];
        double sigma = match_sigma(m->calibration_known ? p->covariance : p->matching);
        char mm[32] = "-";
        if (isfinite(sigma)) snprintf(mm, sizeof mm, "%.2f", 1e3 * sigma);
        printf("%-8s %9.3f %9.3f %9.3f %9.3f %7.3f %9.4f %9.4f %9.4f %8s\n", m->point[m->index[i]].name,
               a->left[0], a->left[1], a->right[0], a->right[1], a->zncc, p->p[0], p->p[1], p->p[2], mm);
    }
    if (shown < m->count) printf("… and %zu more: matches.csv\n", m->count - shown);
}

void match_table(const void *found)
{
    const match_job *m = found;
    if (m->count) print_points(m);
    printf("\n%zu of %zu points matched, frame %s", m->count, m->point_count, m->frame);
    if (m->has_gate)
        printf("; %zu automatic matches %.3f px from their epipolar curves", m->epipolar.matches,
               m->corrected ? m->epipolar.corrected_px : m->epipolar.rms_px);
    putchar('\n');
    if (m->mode == MATCH_AUTOMATIC)
        printf("of %zu interest points: %zu unseen on the right, %zu ambiguous, %zu one-sided, %zu not "
               "refined, %zu unsure\n",
               m->tally.left_points, m->tally.unseen, m->tally.ambiguous, m->tally.one_sided,
               m->tally.unrefined, m->tally.unsure);
    if (m->mode == MATCH_GUIDED)
        printf("candidates.csv: leave 1 in `chosen` of the right ones, and give it to --choose\n");
    if (m->map)
        printf("map: %d x %d cells of %g m over %zu triangles\n", m->map->columns, m->map->rows,
               m->map->cell_m, m->triangle_count);
    printf("\nverdict: %s\n", verdict_name(m->gate.verdict));
    for (size_t i = 0; i < m->gate.count; i++) printf("  - %s\n", m->gate.reason[i]);
}
