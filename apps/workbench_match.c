/* A pair of images and a rig: what may be the same point, chosen by a person, becomes a point in space. The
 * points, their triangles and the map are those of teledimos match. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/workbench_internal.h"
#include "core/file.h"
#include "core/rig_formats.h"
#include "recon/interest.h"

enum { CURVE_POINTS = 96, INTEREST_POINTS = 400, CHECK_POINTS = 600, LEAST_MATCHES = 30 };

/* The command's gate: above this the cameras have moved since they were calibrated (match_result.c). */
static const double MOST_EPIPOLAR_PX = 0.3, WIDE_BAND_PX = 12;

static const workbench_open_place *open_of(const workbench *w)
{
    return w->open + WORKBENCH_MATCH;
}

static td_status need_pair(const workbench *w, td_error *error)
{
    return w->has_pair ? TD_OK : td_fail(error, TD_ERROR_ARGUMENT, "no pair is open: MatchOpen first");
}

static void forget_click(workbench *w)
{
    free(w->candidate);
    w->candidate = NULL;
    w->candidates = 0;
    w->clicked[0] = w->clicked[1] = NAN;
}

/* What follows from the points. */
static void forget_space(match_job *m)
{
    free(m->index);
    free(m->match);
    free(m->space);
    free(m->triangle);
    m->index = NULL;
    m->match = NULL;
    m->space = NULL;
    m->triangle = NULL;
    m->count = m->triangle_count = 0;
    m->cell_m = 0;
    m->map_remark[0] = 0;
    td_elevation_free(&m->map);
}

void workbench_unpair(workbench *w)
{
    match_job *m = &w->match;
    forget_click(w);
    forget_space(m);
    for (size_t i = 0; i < m->point_count; i++) free(m->point[i].candidate);
    free(m->point);
    for (int k = 0; k < 2; k++) td_image_free(&m->image[k]);
    td_rig_free(&m->rig);
    *m = (match_job){0};
    w->has_pair = false;
    w->named = 0;
}

/* ---- the pair ---- */

static td_status read_rig(workbench *w, const td_field *a, bool *calibrated, td_error *error)
{
    const td_field from = td_field_get(a, "rig");
    const workbench_place *place = open_of(w)->place;
    td_dataset *d = NULL;
    bool has_target;
    if (from.value) {
        const char *name;
        TD_TRY(td_field_string(&name, &from, error));
        place = workbench_find(w, name);
        if (!place) return td_field_fail(&from, error, "there is no bench of that name; Benches lists them");
    }
    TD_TRY(workbench_dataset(&d, &has_target, place, error));
    char *path = workbench_rig(w, place, d, calibrated);
    td_dataset_free(&d);
    if (!path)
        return td_fail(error, TD_ERROR_NOT_FOUND,
                       "%s has no rig: Calibrate it, or name a bench that has one as `rig`", place->name);
    const char *const list = path;
    const td_status status = td_rig_import(&w->match.rig, (const char *const[]){list}, 1, NULL, error);
    free(path);
    return status;
}

/* The dataset's first two cameras, by their names where the rig knows them. */
static td_status pair_up(workbench *w, size_t frame, td_error *error)
{
    match_job *m = &w->match;
    const td_dataset *d = open_of(w)->dataset;
    int camera[2] = {0, 1};
    if (d->camera_count < 2 || m->rig->count < 2)
        return td_fail(error, TD_ERROR_DATA, "%s: one camera makes no pair", open_of(w)->place->name);
    for (int k = 0; k < 2; k++) {
        const int found = td_rig_find(m->rig, d->camera[k].name);
        if (found >= 0) camera[k] = found;
    }
    TD_TRY(td_pair_init(&m->pair, m->rig, camera[0], camera[1], error));
    for (int k = 0; k < 2; k++) {
        const char *path = d->frame[frame].image[k];
        const td_rig_camera *c = &m->rig->camera[camera[k]];
        if (!path)
            return td_fail(error, TD_ERROR_NOT_FOUND, "frame %s has no image of camera %s",
                           d->frame[frame].name, d->camera[k].name);
        TD_TRY(td_image_read(&m->image[k], path, 1, error));
        if (m->image[k]->width != c->camera.width || m->image[k]->height != c->camera.height)
            return td_fail(
                error, TD_ERROR_DATA,
                "frame %s: the image of camera %s is of %d x %d px, the rig's camera of %d x %d px",
                d->frame[frame].name, d->camera[k].name, m->image[k]->width, m->image[k]->height,
                c->camera.width, c->camera.height);
    }
    return TD_OK;
}

static td_status read_depths(match_job *m, const td_field *a, td_error *error)
{
    const td_field near_m = td_field_get(a, "near_m"), far_m = td_field_get(a, "far_m");
    m->options = td_match_options_default();
    m->options.least_zncc = 0.5; /* as the command does it when a person chooses */
    m->options.threads = 1;
    if (near_m.value) TD_TRY(td_field_real(&m->options.near_m, &near_m, 1e-3, 1e5, error));
    if (far_m.value) TD_TRY(td_field_real(&m->options.far_m, &far_m, 1e-3, 1e6, error));
    return td_match_options_check(&m->options, error);
}

static json_t *side_json(const workbench *w, int side)
{
    const td_image *i = w->match.image[side];
    return json_pack("{s:s, s:i, s:i}", "camera", open_of(w)->dataset->camera[side].name, "width", i->width,
                     "height", i->height);
}

td_status workbench_pair(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    size_t frame;
    bool calibrated = false;
    match_job *m = &w->match;
    TD_TRY(workbench_frame(&frame, open_of(w), a, error));
    workbench_unpair(w);
    td_status status = read_depths(m, a, error);
    if (status == TD_OK) status = read_rig(w, a, &calibrated, error);
    if (status == TD_OK) status = pair_up(w, frame, error);
    if (status == TD_OK) {
        m->point = calloc(WORKBENCH_POINTS, sizeof *m->point);
        if (!m->point) status = td_fail(error, TD_ERROR_MEMORY, "no memory for points");
    }
    if (status != TD_OK) {
        workbench_unpair(w);
        return status;
    }
    w->has_pair = true;
    *answer = json_pack(
        "{s:s, s:o, s:o, s:s, s:b, s:s, s:o, s:i}", "frame", open_of(w)->dataset->frame[frame].name, "left",
        side_json(w, 0), "right", side_json(w, 1), "rig", calibrated ? "calibrated" : "own",
        "calibration_known", m->rig->covariance != NULL, "in", m->rig->has_vehicle ? "vehicle" : "rig",
        "baseline_m", td_json_real(m->pair.baseline_m), "window_px", 2 * m->options.half_window + 1);
    return TD_OK;
}

td_status workbench_interest(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    (void)a;
    td_interest_point *point = NULL;
    size_t count = 0;
    td_interest_options o = td_interest_options_default();
    o.count = INTEREST_POINTS;
    o.threads = 1;
    TD_TRY(need_pair(w, error));
    TD_TRY(td_interest_points(&point, &count, w->match.image[0], &o, error));
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(list, json_pack("[f, f]", point[i].x, point[i].y));
    free(point);
    *answer = json_pack("{s:o}", "points", list);
    return TD_OK;
}

/* Cameras that turned far leave the usual band empty: then a wide one is searched. */
static td_status match_by_itself(td_match **match, size_t *count, const match_job *m, td_error *error)
{
    td_match_options o = m->options;
    td_match_tally tally;
    o.least_zncc = td_match_options_default().least_zncc;
    o.interest.count = CHECK_POINTS;
    TD_TRY(td_match_automatic(match, count, &tally, &m->pair, m->image[0], m->image[1], &o, error));
    if (*count >= LEAST_MATCHES && 10 * *count >= tally.left_points) return TD_OK;
    free(*match);
    *match = NULL;
    o.band_px = WIDE_BAND_PX;
    return td_match_automatic(match, count, &tally, &m->pair, m->image[0], m->image[1], &o, error);
}

/* Do the pictures belong to the rig? */
td_status workbench_check(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    (void)a;
    td_match *match = NULL;
    size_t count = 0;
    td_epipolar_gate gate;
    TD_TRY(need_pair(w, error));
    td_status status = match_by_itself(&match, &count, &w->match, error);
    if (status == TD_OK && count < LEAST_MATCHES)
        status =
            td_fail(error, TD_ERROR_DATA,
                    "only %zu points match by themselves: too few to tell whether the pictures belong to "
                    "the rig",
                    count);
    if (status == TD_OK) status = td_epipolar_gate_check(&gate, &w->match.pair, match, count, error);
    free(match);
    if (status != TD_OK) return status;
    *answer = json_pack("{s:b, s:I, s:o, s:o, s:o, s:f}", "belongs", gate.rms_px <= MOST_EPIPOLAR_PX,
                        "matches", (json_int_t)gate.matches, "rms_px", td_json_real(gate.rms_px),
                        "corrected_px", td_json_real(gate.determined ? gate.corrected_px : NAN),
                        "rotation_rad", td_json_reals(gate.rotation, 3), "limit_px", MOST_EPIPOLAR_PX);
    return TD_OK;
}

/* ---- a click, and its candidates ---- */

/* Where in the right image the point can be, from far to near, evenly in inverse depth. */
static json_t *curve_json(const match_job *m, const double left[2])
{
    const double nearest = 1 / m->options.near_m,
                 farthest = isfinite(m->options.far_m) ? 1 / m->options.far_m : 0;
    const td_image *image = m->image[1];
    json_t *list = json_array();
    for (int i = 0; i <= CURVE_POINTS; i++) {
        const double w = farthest + (nearest - farthest) * i / CURVE_POINTS;
        double right[2];
        if (!td_pair_transfer(right, NULL, NULL, &m->pair, left, w > 0 ? 1 / w : INFINITY)) continue;
        if (right[0] < -image->width || right[0] > 2 * image->width || right[1] < -image->height ||
            right[1] > 2 * image->height)
            continue;
        json_array_append_new(list, td_json_reals(right, 2));
    }
    return list;
}

static void put_space(json_t *to, const match_job *m, const td_match *match)
{
    td_point3 p;
    const bool found = td_triangulate(&p, &m->pair, match);
    if (found) match_to_frame(m, &p);
    json_object_set_new(to, "p", found ? td_json_reals(p.p, 3) : json_null());
    json_object_set_new(to, "sigma_m", td_json_real(found ? match_sigma(p.covariance) : NAN));
    json_object_set_new(to, "sigma_matching_m", td_json_real(found ? match_sigma(p.matching) : NAN));
    json_object_set_new(to, "sigma_calibration_m", td_json_real(found ? match_sigma(p.calibration) : NAN));
}

static json_t *candidate_json(const match_job *m, const td_match *c)
{
    const double sigma[2] = {sqrt(c->covariance[0]), sqrt(c->covariance[3])};
    json_t *one =
        json_pack("{s:o, s:o, s:b, s:o}", "right", td_json_reals(c->right, 2), "zncc", td_json_real(c->zncc),
                  "refined", c->refined, "sigma_px", td_json_reals(sigma, 2));
    if (one) put_space(one, m, c);
    return one;
}

td_status workbench_click(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    double left[2];
    match_job *m = &w->match;
    TD_TRY(need_pair(w, error));
    TD_TRY(workbench_pixel(left, a, error));
    forget_click(w);
    TD_TRY(td_match_guided(&w->candidate, &w->candidates, &m->pair, m->image[0], m->image[1], left,
                           &m->options, error));
    memcpy(w->clicked, left, sizeof left);
    json_t *list = json_array();
    for (size_t i = 0; i < w->candidates; i++)
        json_array_append_new(list, candidate_json(m, w->candidate + i));
    *answer = json_pack("{s:o, s:o, s:o}", "left", td_json_reals(left, 2), "curve", curve_json(m, left),
                        "candidates", list);
    return TD_OK;
}

/* ---- points ---- */

static json_t *point_json(const match_job *m, size_t i)
{
    const td_match *c = m->match + i;
    const td_point3 *p = m->space + i;
    json_t *one = candidate_json(m, c);
    if (!one) return NULL;
    json_object_set_new(one, "point", json_string(m->point[m->index[i]].name));
    json_object_set_new(one, "left", td_json_reals(c->left, 2));
    json_object_set_new(one, "covariance", td_json_reals(p->covariance, 9));
    return one;
}

static json_t *points_json(const match_job *m)
{
    json_t *points = json_array(), *triangles = json_array(), *map = json_null();
    for (size_t i = 0; i < m->count; i++) json_array_append_new(points, point_json(m, i));
    for (size_t i = 0; i < m->triangle_count; i++)
        json_array_append_new(triangles,
                              json_pack("[I, I, I]", (json_int_t)m->triangle[i][0],
                                        (json_int_t)m->triangle[i][1], (json_int_t)m->triangle[i][2]));
    if (m->map)
        map = json_pack("{s:i, s:i, s:f}", "columns", m->map->columns, "rows", m->map->rows, "cell_m",
                        m->cell_m);
    return json_pack("{s:s, s:b, s:o, s:o, s:o, s:s}", "in", m->frame, "calibration_known",
                     m->calibration_known, "points", points, "triangles", triangles, "map", map, "remark",
                     m->map_remark);
}

/* Everything that follows from the points, anew: they are few. */
static td_status conclude(json_t **answer, workbench *w, td_error *error)
{
    forget_space(&w->match);
    TD_TRY(match_space(&w->match, error));
    *answer = points_json(&w->match);
    return TD_OK;
}

/* The place in the right image that a person says, to a fraction of a pixel where the windows tell. */
static td_status read_place(td_match *match, const workbench *w, const td_field *a, td_error *error)
{
    const match_job *m = &w->match;
    const td_image *right = m->image[1];
    *match = (td_match){.left = {w->clicked[0], w->clicked[1]},
                        .zncc = NAN,
                        .runner_up = NAN,
                        .covariance = {NAN, NAN, NAN, NAN}};
    TD_TRY(workbench_pixel(match->right, a, error));
    if (!(match->right[0] < right->width - 0.5 && match->right[1] < right->height - 0.5))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "MatchChoose: (%g, %g) is outside the right image of %d x %d px", match->right[0],
                       match->right[1], right->width, right->height);
    match_refine_choice(m, match);
    return TD_OK;
}

static td_status read_choice(td_match *match, const workbench *w, const td_field *a, td_error *error)
{
    const td_field candidate = td_field_get(a, "candidate");
    int k = 0;
    if (!isfinite(w->clicked[0]))
        return td_fail(error, TD_ERROR_ARGUMENT, "nothing is to be chosen: MatchPoint first");
    if (!candidate.value) return read_place(match, w, a, error);
    if (!w->candidates) return td_field_fail(&candidate, error, "the point has no candidates; give x and y");
    TD_TRY(td_field_int(&k, &candidate, 0, (int)w->candidates - 1, error));
    *match = w->candidate[k];
    return TD_OK;
}

td_status workbench_choose(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    match_job *m = &w->match;
    td_match chosen;
    td_point3 space;
    TD_TRY(need_pair(w, error));
    TD_TRY(read_choice(&chosen, w, a, error));
    if (!td_triangulate(&space, &m->pair, &chosen))
        return td_fail(error, TD_ERROR_DATA,
                       "the rays through (%.1f, %.1f) and (%.1f, %.1f) meet nowhere before the cameras",
                       chosen.left[0], chosen.left[1], chosen.right[0], chosen.right[1]);
    if (m->point_count == WORKBENCH_POINTS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%d points are enough here: MatchExport them, and begin anew", WORKBENCH_POINTS);
    match_point *p = m->point + m->point_count;
    *p = (match_point){
        .left = {chosen.left[0], chosen.left[1]}, .count = 1, .candidate = malloc(sizeof chosen)};
    if (!p->candidate) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    *p->candidate = chosen;
    snprintf(p->name, sizeof p->name, "%ld", ++w->named);
    m->point_count++;
    forget_click(w);
    return conclude(answer, w, error);
}

td_status workbench_undo(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    (void)a;
    match_job *m = &w->match;
    TD_TRY(need_pair(w, error));
    if (!m->point_count) return td_fail(error, TD_ERROR_ARGUMENT, "there is no point to take back");
    free(m->point[--m->point_count].candidate);
    return conclude(answer, w, error);
}

/* ---- out ---- */

static td_status write_one(const match_job *m, int k, const char *path, td_error *error)
{
    if (k == 0) return match_matches_write(m, path, error);
    if (k == 1) return match_cloud_write(m, path, error);
    return td_elevation_write(m->map, path, error);
}

td_status workbench_export(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    static const char *const names[] = {"matches.csv", "points.ply", "map.tif"};
    char folder_name[TD_NAME_SIZE + 16], *folder = NULL;
    const match_job *m = &w->match;
    (void)a;
    TD_TRY(need_pair(w, error));
    if (!m->count) return td_fail(error, TD_ERROR_DATA, "there are no points yet");
    snprintf(folder_name, sizeof folder_name, "points/%s", open_of(w)->place->name);
    TD_TRY(workbench_folder(&folder, w->output, folder_name, error));
    td_status status = td_folder_make(folder, error);
    json_t *files = json_array();
    for (int k = 0; k < (m->map ? 3 : 2) && status == TD_OK; k++) {
        char *path = td_path_join(folder, names[k]);
        status =
            path ? write_one(m, k, path, error) : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
        free(path);
        json_array_append_new(files, json_string(names[k]));
    }
    free(folder);
    *answer = json_pack("{s:s, s:o}", "folder", folder_name, "files", files);
    if (status == TD_OK) return TD_OK;
    json_decref(*answer);
    *answer = NULL;
    return status;
}
