/* Robot, rig, readings, points and sights of a camera-to-vehicle job. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/rig_formats.h"

#define RADIANS 0.017453292519943295

/* Of corners found on a board when the detector gives no sigma, px. */
static const double CORNER_PX = 0.1;

void vehicle_free(vehicle_job *job)
{
    td_vehicle_free(&job->result);
    free(job->data.q);
    free(job->data.sigma_q);
    free(job->data.offset_prior);
    free(job->data.point);
    free(job->data.board);
    free(job->data.sight);
    free(job->pose_name);
    free(job->names);
    td_csv_free(&job->joints);
    td_rig_free(&job->rig);
    td_robot_free(&job->robot);
}

static void list_links(char *list, size_t size, const td_robot *robot)
{
    size_t used = 0;
    for (int i = 0; i < robot->link_count && used + TD_NAME_SIZE + 3 < size; i++)
        used += (size_t)snprintf(list + used, size - used, "%s%s", i ? ", " : "", robot->link[i].name);
}

td_status vehicle_find_link(int *link, const vehicle_job *job, const char *what, const char *name,
                            td_error *error)
{
    char links[300] = "";
    *link = td_robot_find_link(job->robot, name);
    if (*link >= 0) return TD_OK;
    list_links(links, sizeof links, job->robot);
    return td_fail(error, TD_ERROR_DATA, "%s: %s has no link '%s'; its links are %s", what, job->robot_path,
                   name, links);
}

/* ---- robot ---- */

static td_status set_sigmas(double *sigma, const vehicle_job *job, const td_dataset_sigma *from, bool shift,
                            td_error *error)
{
    const td_robot *robot = job->robot;
    for (int j = 0; j < robot->joint_count; j++)
        if ((robot->joint[j].kind == TD_JOINT_PRISMATIC) == shift) sigma[j] = from->all;
    for (int i = 0; i < from->count; i++) {
        int j = td_robot_find_joint(robot, from->joint[i]);
        if (j < 0)
            return td_fail(error, TD_ERROR_DATA, "%s/dataset.yaml: robot.sigma_%s: %s has no joint '%s'",
                           job->dataset->folder, shift ? "mm" : "deg", job->robot_path, from->joint[i]);
        if ((robot->joint[j].kind == TD_JOINT_PRISMATIC) != shift)
            return td_fail(error, TD_ERROR_DATA, "%s/dataset.yaml: robot.sigma_%s: joint '%s' %s: give %s",
                           job->dataset->folder, shift ? "mm" : "deg", from->joint[i],
                           shift ? "turns" : "slides", shift ? "sigma_deg" : "sigma_mm");
        sigma[j] = from->sigma[i];
    }
    return TD_OK;
}

/* JOINT=SIGMA: degrees, or mm of a joint that slides; or JOINT=free. */
static td_status set_offset(double *prior, const td_robot *robot, const char *text, td_error *error)
{
    const char *equals = strchr(text, '=');
    char name[TD_NAME_SIZE], *end;
    if (!equals || equals == text || (size_t)(equals - text) >= sizeof name)
        return td_fail(error, TD_ERROR_ARGUMENT, "--offsets %.80s: write it as JOINT=SIGMA_DEG or JOINT=free",
                       text);
    memcpy(name, text, (size_t)(equals - text));
    name[equals - text] = '\0';
    int j = td_robot_find_joint(robot, name);
    if (j < 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "--offsets %.80s: there is no joint '%s'", text, name);
    if (!strcmp(equals + 1, "free")) {
        prior[j] = INFINITY;
        return TD_OK;
    }
    double value = strtod(equals + 1, &end);
    if (end == equals + 1 || *end || !(value >= 0) || !isfinite(value))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--offsets %.80s: '%.40s' is not a number >= 0 (degrees, or mm of a joint that "
                       "slides), nor free",
                       text, equals + 1);
    prior[j] = value * (robot->joint[j].kind == TD_JOINT_PRISMATIC ? 1e-3 : RADIANS);
    return TD_OK;
}

static td_status find_mount(vehicle_job *job, td_error *error)
{
    const td_dataset_arm *arm = job->dataset->arm;
    char links[300] = "";
    const char *mount = job->how->mount ? job->how->mount : arm->mount;
    list_links(links, sizeof links, job->robot);
    if (!*mount)
        return td_fail(error, job->how->mount ? TD_ERROR_ARGUMENT : TD_ERROR_DATA,
                       "which link carries the rig is not said: robot: {mount: LINK} in dataset.yaml, or "
                       "--mount LINK; the links are %s",
                       links);
    TD_TRY(vehicle_find_link(&job->data.mount, job, "mount", mount, error));
    job->data.vehicle = job->data.mount;
    if (*arm->vehicle) TD_TRY(vehicle_find_link(&job->data.vehicle, job, "vehicle", arm->vehicle, error));
    job->tip = job->robot->link_count - 1;
    return *arm->tip ? vehicle_find_link(&job->tip, job, "tip", arm->tip, error) : TD_OK;
}

td_status vehicle_read_robot(vehicle_job *job, td_error *error)
{
    const td_dataset *d = job->dataset;
    if (!d->arm)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: dataset.yaml names no arm; add robot: {urdf: FILE, joints: FILE, mount: LINK} "
                       "(--init writes an example)",
                       d->folder);
    job->robot_path = job->how->robot ? job->how->robot : d->arm->urdf;
    if (!job->robot_path)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: the robot's file is missing: robot: {urdf: FILE} in dataset.yaml, or --robot FILE",
            d->folder);
    TD_TRY(td_robot_read(&job->robot, job->robot_path, error));
    size_t n = (size_t)job->robot->joint_count + 1;
    job->data.robot = job->robot;
    job->data.sigma_q = calloc(n, sizeof *job->data.sigma_q);
    job->data.offset_prior = calloc(n, sizeof *job->data.offset_prior);
    if (!job->data.sigma_q || !job->data.offset_prior)
        return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    TD_TRY(set_sigmas(job->data.sigma_q, job, &d->arm->angle, false, error));
    TD_TRY(set_sigmas(job->data.sigma_q, job, &d->arm->slide, true, error));
    for (size_t i = 0; i < job->how->offsets->count; i++)
        TD_TRY(set_offset(job->data.offset_prior, job->robot, job->how->offsets->value[i], error));
    return find_mount(job, error);
}

/* ---- points ---- */

static td_status add_point(vehicle_job *job, const td_vehicle_point *point, td_error *error)
{
    if (job->data.point_count == TD_VEHICLE_MAX_POINTS)
        return td_fail(error, TD_ERROR_DATA, "%s: points and boards hold more than %d points: leave some out",
                       job->dataset->folder, TD_VEHICLE_MAX_POINTS);
    job->data.point[job->data.point_count++] = *point;
    return TD_OK;
}

static td_status read_points(vehicle_job *job, td_error *error)
{
    const td_dataset_arm *arm = job->dataset->arm;
    job->data.point = calloc(TD_VEHICLE_MAX_POINTS, sizeof *job->data.point);
    job->data.board = calloc(TD_VEHICLE_MAX_BOARDS, sizeof *job->data.board);
    if (!job->data.point || !job->data.board) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (int i = 0; i < arm->point_count; i++) {
        const td_dataset_point *from = &arm->point[i];
        td_vehicle_point point = {0};
        char what[TD_NAME_SIZE + 8];
        snprintf(point.name, sizeof point.name, "%s", from->name);
        snprintf(what, sizeof what, "point %s", from->name);
        TD_TRY(vehicle_find_link(&point.link, job, what, from->link, error));
        memcpy(point.place, from->place_m, sizeof point.place);
        memcpy(point.sigma, from->sigma_m, sizeof point.sigma);
        TD_TRY(add_point(job, &point, error));
    }
    return TD_OK;
}

/* ---- sights ---- */

static td_status add_sight(vehicle_job *job, const td_vehicle_sight *sight, td_error *error)
{
    size_t n = job->data.sight_count;
    if ((n & (n - 1)) == 0) {
        td_vehicle_sight *more = realloc(job->data.sight, (n ? 2 * n : 64) * sizeof *more);
        if (!more) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
        job->data.sight = more;
    }
    job->data.sight[job->data.sight_count++] = *sight;
    return TD_OK;
}

static int find_point(const vehicle_job *job, const char *name)
{
    for (int p = 0; p < job->data.point_count; p++)
        if (!strcmp(job->data.point[p].name, name)) return p;
    return -1;
}

typedef struct sight_columns {
    int pose, camera, point, x, y, sigma;
} sight_columns;

static td_status read_sight(vehicle_job *job, const td_csv *csv, size_t row, const sight_columns *at,
                            td_error *error)
{
    td_vehicle_sight sight = {.sigma_px = job->dataset->arm->sigma_px};
    long pose = vehicle_find_pose(job, td_csv_cell(csv, row, at->pose));
    if (pose < 0)
        return td_csv_fail(csv, row, at->pose, error, "'%.60s' is no frame of %s",
                           td_csv_cell(csv, row, at->pose), job->joints->name);
    sight.pose = (size_t)pose;
    sight.camera = td_rig_find(job->rig, td_csv_cell(csv, row, at->camera));
    if (sight.camera < 0)
        return td_csv_fail(csv, row, at->camera, error, "'%.60s' is no camera of %s",
                           td_csv_cell(csv, row, at->camera), job->rig_path);
    sight.point = find_point(job, td_csv_cell(csv, row, at->point));
    if (sight.point < 0)
        return td_csv_fail(csv, row, at->point, error, "'%.60s' is none of dataset.yaml's points",
                           td_csv_cell(csv, row, at->point));
    TD_TRY(td_csv_real(&sight.pixel[0], csv, row, at->x, -1e6, 1e6, error));
    TD_TRY(td_csv_real(&sight.pixel[1], csv, row, at->y, -1e6, 1e6, error));
    if (at->sigma >= 0 && *td_csv_cell(csv, row, at->sigma))
        TD_TRY(td_csv_real(&sight.sigma_px, csv, row, at->sigma, 1e-3, 1e3, error));
    return add_sight(job, &sight, error);
}

/* The same point twice in one image would count twice. */
static td_status check_once(const vehicle_job *job, const td_csv *csv, td_error *error)
{
    size_t cameras = (size_t)job->rig->count, points = (size_t)job->data.point_count;
    size_t *line = calloc(job->data.pose_count * cameras * points + 1, sizeof *line);
    td_status status = line ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t s = 0; s < job->data.sight_count && status == TD_OK; s++) {
        const td_vehicle_sight *sight = &job->data.sight[s];
        size_t *seen = &line[(sight->pose * cameras + (size_t)sight->camera) * points + (size_t)sight->point];
        if (*seen)
            status = td_fail(error, TD_ERROR_FORMAT,
                             "%s:%zu: frame %s, camera %s, point %s is already on line %zu", csv->name,
                             csv->line[s + 1], job->pose_name[sight->pose],
                             job->rig->camera[sight->camera].name, job->data.point[sight->point].name, *seen);
        *seen = csv->line[s + 1];
    }
    free(line);
    return status;
}

static td_status parse_sights(vehicle_job *job, const td_csv *csv, td_error *error)
{
    sight_columns at = {td_csv_column(csv, "frame"), td_csv_column(csv, "camera"),
                        td_csv_column(csv, "point"), td_csv_column(csv, "x_px"),
                        td_csv_column(csv, "y_px"),  td_csv_column(csv, "sigma_px")};
    if (at.pose < 0 || at.camera < 0 || at.point < 0 || at.x < 0 || at.y < 0)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: the columns frame, camera, point, x_px and y_px are needed (and sigma_px may be "
                       "there)",
                       csv->name);
    for (size_t row = 0; row < csv->rows; row++) TD_TRY(read_sight(job, csv, row, &at, error));
    return check_once(job, csv, error);
}

static td_status read_sights(vehicle_job *job, td_error *error)
{
    const td_dataset_arm *arm = job->dataset->arm;
    td_csv *csv = NULL;
    if (!arm->sights) return TD_OK;
    TD_TRY(td_csv_read(&csv, arm->sights, error));
    td_status status = parse_sights(job, csv, error);
    td_csv_free(&csv);
    return status;
}

/* ---- boards ---- */

/* Most corners of a board that are used: evenly chosen, so that all its area counts. */
static size_t board_share(const vehicle_job *job)
{
    size_t boards = (size_t)job->dataset->arm->board_count, points = (size_t)job->data.point_count;
    return boards ? (TD_VEHICLE_MAX_POINTS - points) / boards : 0;
}

static td_status board_points(vehicle_job *job, const td_dataset_board *board, size_t share, size_t *corner,
                              size_t *count, td_error *error)
{
    size_t all = td_target_point_count(&board->target);
    char what[TD_NAME_SIZE + 8];
    int link;
    *count = all < share ? all : share;
    snprintf(what, sizeof what, "board %s", board->name);
    TD_TRY(vehicle_find_link(&link, job, what, board->link, error));
    if (*count < 4)
        return td_fail(error, TD_ERROR_DATA,
                       "board %s: dataset.yaml's points leave no room: %d points are the most, boards' "
                       "corners among them",
                       board->name, TD_VEHICLE_MAX_POINTS);
    for (size_t i = 0; i < *count; i++) {
        td_vehicle_point point = {.link = link, .board = job->data.board_count + 1};
        corner[i] = i * all / *count;
        snprintf(point.name, sizeof point.name, "%.50s:%zu", board->name, corner[i]);
        td_target_point(point.place, &board->target, corner[i]);
        TD_TRY(add_point(job, &point, error));
    }
    td_vehicle_board *made = &job->data.board[job->data.board_count++];
    *made = (td_vehicle_board){.link = link,
                               .link_from_board = board->link_from_target,
                               .sigma_rad = board->placed ? board->sigma_rad : INFINITY,
                               .sigma_m = board->placed ? board->sigma_m : INFINITY};
    snprintf(made->name, sizeof made->name, "%s", board->name);
    return TD_OK;
}

/* Where the frames of the images stand among the readings. */
static td_status frame_pose(long *pose, const vehicle_job *job, size_t frame, td_error *error)
{
    *pose = vehicle_find_pose(job, job->dataset->frame[frame].name);
    if (*pose < 0)
        return td_fail(error, TD_ERROR_DATA,
                       "frame %s of the images has no line in %s: each needs the joints' readings",
                       job->dataset->frame[frame].name, job->joints->name);
    return TD_OK;
}

static td_status board_sights(vehicle_job *job, const td_observations *o, const td_dataset_board *board,
                              int first, const size_t *corner, size_t count, td_error *error)
{
    size_t seen = 0;
    const char *why = "";
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < o->camera_count; c++) {
            const td_detection *d = td_observations_get(o, v, c);
            long pose;
            int camera = td_rig_find(job->rig, o->camera[c].name);
            if (camera < 0)
                return td_fail(error, TD_ERROR_DATA, "camera %s of dataset.yaml is not in %s",
                               o->camera[c].name, job->rig_path);
            if (!d->found && *d->reason && !*why) why = d->reason;
            if (!d->found) continue;
            TD_TRY(frame_pose(&pose, job, v, error));
            for (size_t i = 0; i < count; i++) {
                const double *pixel = &d->point[2 * corner[i]];
                if (!isfinite(pixel[0])) continue;
                double sigma = d->sigma[corner[i]];
                td_vehicle_sight sight = {.pose = (size_t)pose,
                                          .camera = camera,
                                          .point = first + (int)i,
                                          .pixel = {pixel[0], pixel[1]},
                                          .sigma_px = sigma > 0 ? sigma : CORNER_PX};
                TD_TRY(add_sight(job, &sight, error));
                seen++;
            }
        }
    if (!seen)
        return td_fail(error, TD_ERROR_DATA, "board %s is in none of the images: %s", board->name, why);
    return TD_OK;
}

static td_status read_board(vehicle_job *job, const td_dataset_board *board, size_t share, td_error *error)
{
    size_t corner[TD_VEHICLE_MAX_POINTS], count;
    int first = job->data.point_count;
    td_observations *o = NULL;
    td_dataset one = *job->dataset;
    td_observe_options how = {
        .threads = job->how->threads, .progress = job->how->progress, .log = job->how->log};
    one.target = board->target;
    TD_TRY(board_points(job, board, share, corner, &count, error));
    TD_TRY(td_observe(&o, &one, &how, error));
    td_status status = board_sights(job, o, board, first, corner, count, error);
    td_observations_free(&o);
    return status;
}

/* ---- all of it ---- */

static void hash_file(td_hash *hash, const char *path)
{
    char part[TD_HASH_HEX_SIZE] = "";
    if (path && td_hash_file(part, path, NULL) != TD_OK) part[0] = '\0';
    td_hash_add(hash, part, strlen(part) + 1);
}

/* SHA-256 over what the result depends on: description, robot, rig, tables and images by their bytes. */
static td_status hash_inputs(vehicle_job *job, td_error *error)
{
    const td_dataset *d = job->dataset;
    td_hash *hash;
    TD_TRY(td_hash_new(&hash, error));
    char *path = td_path_join(d->folder, "dataset.yaml");
    hash_file(hash, path);
    hash_file(hash, job->robot_path);
    hash_file(hash, job->rig_path);
    hash_file(hash, d->arm->joints);
    hash_file(hash, d->arm->sights);
    for (size_t v = 0; v < d->frame_count; v++)
        for (int c = 0; c < d->camera_count; c++) hash_file(hash, d->frame[v].image[c]);
    free(path);
    return td_hash_finish(job->hash, &hash, error);
}

static td_status read_rig(vehicle_job *job, td_error *error)
{
    const td_rig_import_options how = {.format = TD_RIG_FORMAT_COUNT};
    job->rig_path = job->how->rig ? job->how->rig : job->dataset->rig;
    if (!job->rig_path)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: the rig is missing: rig: FILE in dataset.yaml, or --rig FILE (teledimos calibrate "
            "writes one)",
            job->dataset->folder);
    TD_TRY(td_rig_import(&job->rig, &job->rig_path, 1, &how, error));
    job->data.rig = job->rig;
    return TD_OK;
}

td_status vehicle_read(vehicle_job *job, td_error *error)
{
    const td_dataset_arm *arm = job->dataset->arm;
    int link[TD_VEHICLE_MAX_POINTS + TD_DATASET_MAX_BOARDS];
    size_t links = 0;
    TD_TRY(read_rig(job, error));
    if (!arm->sights && !arm->board_count)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: dataset.yaml names nothing that is seen: add points and sights: FILE, or boards",
                       job->dataset->folder);
    TD_TRY(read_points(job, error));
    for (int p = 0; p < job->data.point_count; p++) link[links++] = job->data.point[p].link;
    for (int b = 0; b < arm->board_count; b++) {
        link[links] = td_robot_find_link(job->robot, arm->board[b].link);
        if (link[links] >= 0) links++; /* others are named when the board is read */
    }
    TD_TRY(vehicle_read_joints(job, link, links, error));
    TD_TRY(read_sights(job, error));
    size_t share = board_share(job);
    for (int b = 0; b < arm->board_count; b++) TD_TRY(read_board(job, &arm->board[b], share, error));
    return hash_inputs(job, error);
}
