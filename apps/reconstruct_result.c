/* The result of a reconstruction: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "core/document.h"

const gate_row reconstruct_gate_defaults[] = {
    {"epipolar_px", 0.2, 0.3,
     "robust RMS distance of matches from their epipolar curves, worst frame looked at: above 0.3 px the "
     "cameras have "
     "moved since they were calibrated, and heights with them"},
    {"failed_share", 0, 0,
     "frames that could not be used, over frames: a map without them may lack a part of the site"},
    {"skew_px", 0.1, 0.5,
     "pixels that what is nearest moves between the two cameras' times, by the motion of the base from frame "
     "to frame, worst frame: as much is wrong in disparity"},
    {"skew_s", 0.001, 0.005,
     "the same where times or poses do not tell the motion: difference of the times; at 0.5 m/s, 5 ms are "
     "2.5 mm"},
    {"sigma_m", 0.05, 0.2, "median standard deviation of the heights"},
};
const size_t reconstruct_gate_count = sizeof reconstruct_gate_defaults / sizeof *reconstruct_gate_defaults;

const td_schema_row reconstruct_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "reconstruct"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"dataset", TD_SCHEMA_STRING, true, false, "name"},
    {"cameras", TD_SCHEMA_STRINGS, true, false, "of the rig: left, right"},
    {"frame", TD_SCHEMA_STRING, true, false, "of the map: site, vehicle or rig"},
    {"crs", TD_SCHEMA_STRING, true, true, "coordinate reference system of the products; null: none"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"map", TD_SCHEMA_OBJECT, true, false, "elevation map"},
    {"map.columns", TD_SCHEMA_INT, true, false, "cells along x"},
    {"map.rows", TD_SCHEMA_INT, true, false, "cells along y"},
    {"map.cell_m", TD_SCHEMA_REAL, true, false, "side of a cell"},
    {"map.cells", TD_SCHEMA_INT, true, false, "with a height"},
    {"map.share_measured", TD_SCHEMA_REAL, true, true, "of them that images measured; null: there is none"},
    {"map.rms_m", TD_SCHEMA_REAL, true, true,
     "RMS of the points' heights above the cells that they became part of, slope taken off, when they were "
     "fused; null: no point"},
    {"map.sigma_median_m", TD_SCHEMA_REAL, true, true, "median of them"},
    {"map.height_m", TD_SCHEMA_REALS, true, true, "lowest and highest"},
    {"frames", TD_SCHEMA_OBJECT, true, false, "what went in"},
    {"frames.total", TD_SCHEMA_INT, true, false, "in the dataset"},
    {"frames.used", TD_SCHEMA_INT, true, false, "in the map"},
    {"frames.resumed", TD_SCHEMA_INT, true, false, "of them taken over from an earlier run"},
    {"frames.failed", TD_SCHEMA_ARRAY, true, false, "left out"},
    {"frames.failed[].name", TD_SCHEMA_STRING, true, false, "frame"},
    {"frames.failed[].reason", TD_SCHEMA_STRING, true, false, "why"},
    {"frames.located", TD_SCHEMA_ARRAY, true, false,
     "whose place the table does not give, and that were found"},
    {"frames.located[].name", TD_SCHEMA_STRING, true, false, "frame"},
    {"frames.located[].method", TD_SCHEMA_STRING, true, false, "tags (on the site) or map (the ground seen)"},
    {"frames.located[].t_m", TD_SCHEMA_REALS, true, false, "site_from_rig: place of the rig"},
    {"frames.located[].q", TD_SCHEMA_REALS, true, false, "site_from_rig: quaternion w, x, y, z"},
    {"frames.located[].sigma_m", TD_SCHEMA_REALS, true, false, "of the rig's x, y, z"},
    {"frames.located[].sigma_deg", TD_SCHEMA_REALS, true, false,
     "of turns about the site's x, y, z axes through the rig"},
    {"points", TD_SCHEMA_INT, true, false, "points in space that went into the map"},
    {"gated", TD_SCHEMA_INT, true, false, "measurements that contradicted a cell and were not believed"},
    {"reset", TD_SCHEMA_INT, true, false, "cells that began anew: the ground has changed"},
    {"cleared", TD_SCHEMA_INT, true, false, "cells that were looked through"},
    {"epipolar_px", TD_SCHEMA_REAL, true, true, "worst frame looked at; null: too few matches"},
    {"seconds", TD_SCHEMA_REAL, true, false, "wall-clock time of this run"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.map", TD_SCHEMA_STRING, true, false,
     "GeoTIFF, cloud-optimised: height, sigma, count, provenance, time"},
    {"products.orthophoto", TD_SCHEMA_STRING, false, false, "GeoTIFF, cloud-optimised: RGBA"},
    {"products.cloud", TD_SCHEMA_STRING, true, false, "PLY: the cells as points, colour, sigma"},
    {"products.las", TD_SCHEMA_STRING, true, false, "LAS 1.4: the same, sigma as an extra dimension"},
    {"products.mesh", TD_SCHEMA_STRING, false, false, "binary glTF: the surface with the orthophoto on it"},
    {"products.result", TD_SCHEMA_STRING, true, false, "this"},
    {"products.report", TD_SCHEMA_STRING, true, false, "for people"},
    {"products.log", TD_SCHEMA_STRING, true, false, "messages, a JSON object a line"},
};
const size_t reconstruct_schema_count = sizeof reconstruct_schema / sizeof *reconstruct_schema;

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

typedef struct map_figures {
    size_t cells, measured;
    double median_sigma, low, high;
} map_figures;

static map_figures measure(const td_elevation *map)
{
    size_t all = (size_t)map->columns * (size_t)map->rows, n = 0;
    map_figures m = {.median_sigma = NAN, .low = INFINITY, .high = -INFINITY};
    double *sigma = malloc((all + 1) * sizeof *sigma);
    for (size_t i = 0; i < all; i++) {
        if (!isfinite(map->height[i])) continue;
        m.cells++;
        m.measured += map->provenance[i] == TD_CELL_MEASURED || map->provenance[i] == TD_CELL_FUSED;
        m.low = fmin(m.low, map->height[i]);
        m.high = fmax(m.high, map->height[i]);
        if (!sigma || !isfinite(map->sigma[i])) continue;
        sigma[n++] = map->sigma[i];
    }
    if (n) {
        qsort(sigma, n, sizeof *sigma, by_value);
        m.median_sigma = sigma[n / 2];
    }
    free(sigma);
    return m;
}

double reconstruct_rms(const reconstruct_job *work)
{
    double square = 0, points = 0;
    for (size_t i = 0; i < work->count; i++) {
        square += work->frame[i].tally.square_m2;
        points += (double)work->frame[i].tally.believed;
    }
    return points > 0 ? sqrt(square / points) : NAN;
}

static size_t count_failed(const reconstruct_job *work)
{
    size_t failed = 0;
    for (size_t i = 0; i < work->count; i++) failed += work->frame[i].failed;
    return failed;
}

static void judge_frames(reconstruct_job *work, const gate_row *rows)
{
    gate_result *g = &work->gate;
    size_t failed = count_failed(work);
    double skew_s = 0, skew_px = 0;
    const reconstruct_frame *first = NULL;
    for (size_t i = 0; i < work->count; i++) {
        const reconstruct_frame *f = &work->frame[i];
        if (isnan(f->skew_px))
            skew_s = fmax(skew_s, fabs(f->skew_s));
        else
            skew_px = fmax(skew_px, f->skew_px);
        if (f->failed && !first) first = f;
    }
    if (failed)
        gate_check(g, rows, reconstruct_gate_count, "failed_share", (double)failed / (double)work->count,
                   "%zu of %zu frames could not be used; the first, %s: %s", failed, work->count, first->name,
                   first->reason);
    if (skew_px > 0)
        gate_check(g, rows, reconstruct_gate_count, "skew_px", skew_px,
                   "the two cameras' times differ so much that the nearest ground moves by up to %.2f px in "
                   "between: trigger both together, or stand still",
                   skew_px);
    if (skew_s > 0)
        gate_check(g, rows, reconstruct_gate_count, "skew_s", skew_s,
                   "the two cameras' times differ by up to %.1f ms: what moved in between is wrong in depth",
                   1e3 * skew_s);
}

void reconstruct_judge(reconstruct_job *work, const gate_row *rows)
{
    gate_result *g = &work->gate;
    map_figures m = measure(work->map);
    *g = (gate_result){0};
    if (isfinite(work->rms_epipolar_px))
        gate_check(g, rows, reconstruct_gate_count, "epipolar_px", work->rms_epipolar_px,
                   "matches lie %.3f px from their epipolar curves: the rig is not what these images were "
                   "taken with "
                   "(`teledimos match` on a pair tells by how much a camera has turned)",
                   work->rms_epipolar_px);
    judge_frames(work, rows);
    if (!m.cells) gate_add(g, VERDICT_REFUSED, "no cell of the map was measured");
    if (isfinite(m.median_sigma))
        gate_check(g, rows, reconstruct_gate_count, "sigma_m", m.median_sigma,
                   "the heights' median sigma is %.1f mm", 1e3 * m.median_sigma);
    if (!work->rig->covariance)
        gate_add(g, VERDICT_WARNED,
                 "calibration sigma unknown: the rig has no covariance, so the map's sigma is that of "
                 "matching alone");
    if (!work->has_poses)
        gate_add(g, VERDICT_WARNED, "no poses of the base: the map is in the frame of the %s",
                 work->rig->has_vehicle ? "vehicle" : "rig");
}

static json_t *map_json(const reconstruct_job *work)
{
    map_figures m = measure(work->map);
    double range[2] = {m.low, m.high};
    json_t *o = json_object();
    set(o, "columns", json_integer(work->map->columns));
    set(o, "rows", json_integer(work->map->rows));
    set(o, "cell_m", td_json_real(work->map->cell_m));
    set(o, "cells", json_integer((json_int_t)m.cells));
    set(o, "share_measured", td_json_real(m.cells ? (double)m.measured / (double)m.cells : NAN));
    set(o, "rms_m", td_json_real(reconstruct_rms(work)));
    set(o, "sigma_median_m", td_json_real(m.median_sigma));
    set(o, "height_m", m.cells ? td_json_reals(range, 2) : json_null());
    return o;
}

static json_t *located_json(const reconstruct_job *work)
{
    json_t *list = json_array();
    for (size_t i = 0; i < work->count; i++) {
        const reconstruct_frame *f = &work->frame[i];
        if (f->failed || (f->place != PLACE_TAGS && f->place != PLACE_MAP)) continue;
        double deg[3];
        for (int k = 0; k < 3; k++) deg[k] = f->pose_sigma[k] * 57.29577951308232;
        json_array_append_new(
            list, json_pack("{s:s, s:s, s:o, s:o, s:o, s:o}", "name", f->name, "method",
                            reconstruct_place_name[f->place], "t_m", td_json_reals(f->site_from_rig.t, 3),
                            "q", td_json_reals(f->site_from_rig.q, 4), "sigma_m",
                            td_json_reals(f->pose_sigma + 3, 3), "sigma_deg", td_json_reals(deg, 3)));
    }
    return list;
}

static json_t *frames_json(const reconstruct_job *work)
{
    json_t *o = json_object(), *failed = json_array();
    for (size_t i = 0; i < work->count; i++)
        if (work->frame[i].failed)
            json_array_append_new(failed, json_pack("{s:s, s:s}", "name", work->frame[i].name, "reason",
                                                    work->frame[i].reason));
    set(o, "total", json_integer((json_int_t)work->count));
    set(o, "used", json_integer((json_int_t)(work->count - count_failed(work))));
    set(o, "resumed", json_integer((json_int_t)work->resumed));
    set(o, "failed", failed);
    set(o, "located", located_json(work));
    return o;
}

json_t *reconstruct_result(const reconstruct_job *work)
{
    json_t *root = json_object(), *reasons = json_array();
    td_fusion_tally t = {0};
    for (size_t i = 0; i < work->count; i++) {
        t.points += work->frame[i].tally.points;
        t.gated += work->frame[i].tally.gated;
        t.reset += work->frame[i].tally.reset;
        t.cleared += work->frame[i].tally.cleared;
    }
    set(root, "job", json_string("reconstruct"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "dataset", json_string(work->dataset->name));
    set(root, "cameras",
        json_pack("[s, s]", work->rig->camera[work->pair.left].name,
                  work->rig->camera[work->pair.right].name));
    set(root, "frame", json_string(work->map->frame));
    set(root, "crs", work->map->crs ? json_string(work->map->crs) : json_null());
    set(root, "verdict", json_string(verdict_name(work->gate.verdict)));
    for (size_t i = 0; i < work->gate.count; i++)
        json_array_append_new(reasons, json_string(work->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "map", map_json(work));
    set(root, "frames", frames_json(work));
    set(root, "points", json_integer((json_int_t)t.points));
    set(root, "gated", json_integer((json_int_t)t.gated));
    set(root, "reset", json_integer((json_int_t)t.reset));
    set(root, "cleared", json_integer((json_int_t)t.cleared));
    set(root, "epipolar_px", td_json_real(work->rms_epipolar_px));
    set(root, "seconds", td_json_real(work->seconds));
    set(root, "products", reconstruct_product_names(work));
    return root;
}

void reconstruct_table(const void *found)
{
    const reconstruct_job *work = found;
    map_figures m = measure(work->map);
    printf("\n%-10s %8s %8s %8s %9s %8s %8s %8s %7s\n", "frame", "matched", "masked", "cells", "new cells",
           "gated", "reset", "cleared", "s");
    for (size_t i = 0; i < work->count; i++) {
        const reconstruct_frame *f = &work->frame[i];
        if (f->failed)
            printf("%-10s left out: %s\n", f->name, f->reason);
        else if (work->count <= 30 || i < 15 || i + 15 >= work->count)
            printf("%-10s %7.1f%% %7.1f%% %8zu %9zu %8zu %8zu %8zu %7.2f\n", f->name, 100 * f->matched,
                   100 * f->masked, f->tally.cells, f->tally.new_cells, f->tally.gated, f->tally.reset,
                   f->tally.cleared, f->seconds);
        else if (i == 15)
            printf("…\n");
    }
    printf("\nmap: %d x %d cells of %g m, %zu with a height", work->map->columns, work->map->rows,
           work->map->cell_m, m.cells);
    if (m.cells) printf(" from %.3f to %.3f m", m.low, m.high);
    if (isfinite(m.median_sigma)) printf(", median sigma %.1f mm", 1e3 * m.median_sigma);
    if (isfinite(reconstruct_rms(work)))
        printf(";\npoints lie %.1f mm (RMS) from it", 1e3 * reconstruct_rms(work));
    reconstruct_summary(work);
    printf("\nverdict: %s\n", verdict_name(work->gate.verdict));
    for (size_t i = 0; i < work->gate.count; i++) printf("  - %s\n", work->gate.reason[i]);
}
