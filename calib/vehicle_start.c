/* Where the joint problem begins, and the paper's closed way.
 *
 * Points seen by two cameras of the rig are triangulated. With known places, mount_from_rig is their absolute
 * orientation (Kabsch 1976; Horn 1987) against where the arm's kinematics puts them. With unknown
 * coordinates, R y + t = A (places) is linear in R, t and those coordinates; parallel axes leave the row of R
 * along them at zero, and the nearest rotation supplies it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/stereo.h"
#include "calib/vehicle_internal.h"
#include "core/linalg.h"

enum { ROUNDS = 5, MOST_ROWS = 3000, CLOSED_POINTS = 6 };
/* Second largest over largest variance of points: below this they lie on a line. */
#define LINE 1e-5

/* A point found in one pose. */
typedef struct fix {
    size_t pose;
    int point;
    double rig[3], mount[3]; /* seen; and by the kinematics, where the place is known */
    td_pose mount_from_link;
    double weight;
    bool known;
} fix;

typedef struct fixes {
    size_t count;
    fix *fix;
} fixes;

static bool is_known(const td_vehicle_data *data, int p)
{
    const td_vehicle_point *point = &data->point[p];
    const td_vehicle_board *board = point->board ? &data->board[point->board - 1] : NULL;
    if (board) return isfinite(board->sigma_rad) && isfinite(board->sigma_m);
    return isfinite(point->sigma[0]) && isfinite(point->sigma[1]) && isfinite(point->sigma[2]);
}

/* Mean, over the pairs of sights in list[count], of the point they give, in the rig's frame. */
static bool triangulate(double x[3], const td_vehicle_model *model, const size_t *list, int count)
{
    int found = 0;
    double sum[3] = {0};
    for (int a = 0; a < count; a++)
        for (int b = a + 1; b < count; b++) {
            const td_vehicle_sight *s = &model->data->sight[list[a]], *o = &model->data->sight[list[b]];
            const td_rig_camera *first = &model->data->rig->camera[s->camera],
                                *second = &model->data->rig->camera[o->camera];
            double p[3];
            if (s->camera == o->camera) continue;
            td_pose rig_from_first = td_pose_inverse(&first->camera_from_rig),
                    second_from_first = td_pose_compose(&second->camera_from_rig, &rig_from_first);
            if (!td_triangulate_pair(p, &first->camera, &second->camera, &second_from_first, s->pixel,
                                     o->pixel))
                continue;
            td_pose_transform(p, &rig_from_first, p);
            for (int i = 0; i < 3; i++) sum[i] += p[i];
            found++;
        }
    for (int i = 0; i < 3 && found; i++) x[i] = sum[i] / found;
    return found > 0;
}

static void add_fix(fixes *out, const td_vehicle_model *model, size_t pose, int p, const size_t *list,
                    int count)
{
    const td_vehicle_point *point = &model->data->point[p];
    fix f = {.pose = pose, .point = p, .weight = 1, .known = is_known(model->data, p)};
    if (!triangulate(f.rig, model, list, count)) return;
    double q[TD_ROBOT_MAX_JOINTS];
    td_vehicle_joints(q, model, pose);
    f.mount_from_link = td_vehicle_arm(NULL, model->data->robot, model->data->mount, point->link, q, NULL, 0);
    if (f.known) {
        double x[3];
        td_vehicle_place(x, model, p);
        td_pose_transform(f.mount, &f.mount_from_link, x);
    }
    out->fix[out->count++] = f;
}

static td_status find_fixes(fixes *out, const td_vehicle_model *model, td_error *error)
{
    const td_vehicle_data *data = model->data;
    size_t points = (size_t)data->point_count, slots = data->pose_count * points;
    size_t *head = malloc((slots + data->sight_count + 1) * sizeof *head);
    *out = (fixes){.fix = malloc((slots + 1) * sizeof *out->fix)};
    if (!head || !out->fix) {
        free(head);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu sights", data->sight_count);
    }
    size_t *next = head + slots;
    for (size_t i = 0; i < slots; i++) head[i] = SIZE_MAX;
    for (size_t s = data->sight_count; s-- > 0;) {
        size_t slot = data->sight[s].pose * points + (size_t)data->sight[s].point;
        next[s] = head[slot];
        head[slot] = s;
    }
    for (size_t i = 0; i < slots; i++) {
        size_t list[TD_RIG_MAX_CAMERAS];
        int count = 0;
        for (size_t s = head[i]; s != SIZE_MAX && count < TD_RIG_MAX_CAMERAS; s = next[s]) list[count++] = s;
        if (count > 1) add_fix(out, model, i / points, (int)(i % points), list, count);
    }
    free(head);
    return TD_OK;
}

/* ---- absolute orientation ---- */

/* mount_from_rig of the known fixes, weighted. False: fewer than three, or on a line. */
static bool orient(td_pose *mount_from_rig, const fix *f, size_t count)
{
    double sum = 0, m[3] = {0}, r[3] = {0}, h[9] = {0}, scatter[9] = {0}, value[3], rotation[9], t[3];
    size_t known = 0;
    for (size_t i = 0; i < count; i++) {
        if (!f[i].known) continue;
        known++;
        sum += f[i].weight;
        for (int k = 0; k < 3; k++) {
            m[k] += f[i].weight * f[i].mount[k];
            r[k] += f[i].weight * f[i].rig[k];
        }
    }
    if (known < 3 || !(sum > 0)) return false;
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 9 && f[i].known; k++) {
            double a = f[i].mount[k / 3] - m[k / 3] / sum;
            h[k] += f[i].weight * a * (f[i].rig[k % 3] - r[k % 3] / sum);
            scatter[k] += f[i].weight * a * (f[i].mount[k % 3] - m[k % 3] / sum);
        }
    if (td_eigen_symmetric(value, NULL, scatter, 3, NULL) != TD_OK || !(value[1] > LINE * value[2]))
        return false;
    if (td_nearest_rotation(rotation, h, NULL) != TD_OK) return false;
    for (int k = 0; k < 3; k++)
        t[k] =
            (m[k] - rotation[3 * k] * r[0] - rotation[3 * k + 1] * r[1] - rotation[3 * k + 2] * r[2]) / sum;
    *mount_from_rig = td_pose_from_rotation(rotation, t);
    return true;
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Weights by distance: 1 / (1 + (d / 3 median)^2), so that a wrong sight does not spoil the start. */
static bool reweight(fixes *all, const double *distance)
{
    double *sorted = malloc((all->count + 1) * sizeof *sorted);
    size_t n = 0;
    if (!sorted) return false;
    for (size_t i = 0; i < all->count; i++)
        if (distance[i] >= 0) sorted[n++] = distance[i];
    qsort(sorted, n, sizeof *sorted, by_size);
    double scale = n ? fmax(3 * sorted[n / 2], 1e-9) : 1;
    for (size_t i = 0; i < all->count; i++)
        if (distance[i] >= 0) all->fix[i].weight = 1 / (1 + distance[i] * distance[i] / (scale * scale));
    free(sorted);
    return true;
}

static bool start_known(td_vehicle_model *model, fixes *all)
{
    double *distance = malloc((all->count + 1) * sizeof *distance);
    bool ok = distance != NULL;
    for (int round = 0; round < ROUNDS && ok; round++) {
        ok = orient(&model->mount_from_rig, all->fix, all->count);
        for (size_t i = 0; i < all->count && ok; i++) {
            double x[3];
            td_pose_transform(x, &model->mount_from_rig, all->fix[i].rig);
            distance[i] = all->fix[i].known
                              ? hypot(hypot(x[0] - all->fix[i].mount[0], x[1] - all->fix[i].mount[1]),
                                      x[2] - all->fix[i].mount[2])
                              : -1;
        }
        ok = ok && reweight(all, distance);
    }
    free(distance);
    return ok;
}

/* ---- unknown coordinates ---- */

typedef struct linear {
    size_t columns, rows;
    int column[TD_VEHICLE_MAX_POINTS][3]; /* of each unknown coordinate; -1: known, or never triangulated */
    double *a, *b, *x;
} linear;

/* Rows of one fix: R y + t - A_r (unknown) = A_r (known) + A_t; with R given, its terms go to the right. */
static void add_rows(linear *l, const td_vehicle_model *model, const fix *f, const double *rotation)
{
    double r[9], w = sqrt(f->weight);
    td_pose_rotation(r, &f->mount_from_link);
    size_t shift = rotation ? 0 : 9;
    for (int i = 0; i < 3; i++) {
        double *row = l->a + l->rows * l->columns, b = f->mount_from_link.t[i];
        for (int k = 0; k < 3; k++) {
            if (rotation)
                b -= rotation[3 * i + k] * f->rig[k];
            else
                row[3 * i + k] = w * f->rig[k];
            int column = l->column[f->point][k];
            if (column >= 0)
                row[shift + 3 + (size_t)column] = -w * r[3 * i + k];
            else
                b += r[3 * i + k] * model->place[f->point][k];
        }
        row[shift + (size_t)i] = w;
        l->b[l->rows++] = w * b;
    }
}

static td_status solve_rows(linear *l, const td_vehicle_model *model, const fixes *all, size_t unknown,
                            const double *rotation, td_error *error)
{
    size_t step = 1 + 3 * all->count / MOST_ROWS;
    l->columns = (rotation ? 3 : 12) + unknown;
    l->rows = 0;
    memset(l->a, 0, (3 * all->count + l->columns) * (12 + unknown) * sizeof *l->a);
    for (size_t i = 0; i < all->count; i++)
        if (i % step == 0 || all->count < 1000) add_rows(l, model, &all->fix[i], rotation);
    while (l->rows < l->columns) l->b[l->rows++] = 0; /* rows of zeros */
    return td_least_squares_linear(l->x, NULL, l->a, l->b, l->rows, l->columns, error);
}

/* R, then t and the unknown coordinates with that R. */
static td_status one_round(linear *l, td_vehicle_model *model, fixes *all, size_t unknown, double *distance,
                           td_error *error)
{
    double rotation[9], m[9];
    TD_TRY(solve_rows(l, model, all, unknown, NULL, error));
    memcpy(m, l->x, sizeof m);
    TD_TRY(td_nearest_rotation(rotation, m, error));
    TD_TRY(solve_rows(l, model, all, unknown, rotation, error));
    model->mount_from_rig = td_pose_from_rotation(rotation, l->x);
    for (int p = 0; p < model->data->point_count; p++)
        for (int k = 0; k < 3; k++)
            if (l->column[p][k] >= 0) model->place[p][k] = l->x[3 + l->column[p][k]];
    for (size_t i = 0; i < all->count; i++) {
        double x[3], y[3];
        td_pose_transform(x, &model->mount_from_rig, all->fix[i].rig);
        td_pose_transform(y, &all->fix[i].mount_from_link, model->place[all->fix[i].point]);
        distance[i] = hypot(hypot(x[0] - y[0], x[1] - y[1]), x[2] - y[2]);
    }
    return TD_OK;
}

/* The pose of a free board from where its points came out on the link (Kabsch). */
static td_status place_board(td_vehicle_model *model, int b, const bool *found, td_error *error)
{
    const td_vehicle_data *data = model->data;
    double m[3] = {0}, l[3] = {0}, h[9] = {0}, r[9], t[3];
    int n = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int p = 0; p < data->point_count; p++) {
            const double *own = data->point[p].place, *link = model->place[p];
            if (data->point[p].board != b + 1 || !found[p]) continue;
            n += pass == 0;
            for (int k = 0; k < 3 && pass == 0; k++) m[k] += own[k], l[k] += link[k];
            for (int k = 0; k < 9 && pass == 1; k++)
                h[k] += (link[k / 3] - l[k / 3] / n) * (own[k % 3] - m[k % 3] / n);
        }
    if (n < 3)
        return td_fail(error, TD_ERROR_DATA,
                       "board %s: fewer than three of its points are seen by two cameras at once: show it to "
                       "both, or give its pose on the link",
                       data->board[b].name);
    TD_TRY(td_nearest_rotation(r, h, error));
    for (int k = 0; k < 3; k++) {
        t[k] = l[k];
        for (int c = 0; c < 3; c++) t[k] -= r[3 * k + c] * m[c];
        t[k] /= n;
    }
    model->board[b] = td_pose_from_rotation(r, t);
    return TD_OK;
}

/* Boards begin as free points: from those their poses, and the points' own places again. */
static td_status place_boards(td_vehicle_model *model, const bool *found, td_error *error)
{
    const td_vehicle_data *data = model->data;
    for (int b = 0; b < data->board_count; b++) {
        const td_vehicle_board *board = &data->board[b];
        bool seen = false;
        for (int p = 0; p < data->point_count; p++)
            seen = seen || (data->point[p].board == b + 1 && model->seen[p]);
        if (seen && !(isfinite(board->sigma_rad) && isfinite(board->sigma_m)))
            TD_TRY(place_board(model, b, found, error));
    }
    for (int p = 0; p < data->point_count; p++)
        if (data->point[p].board) memcpy(model->place[p], data->point[p].place, sizeof *model->place);
    return TD_OK;
}

static td_status start_unknown(td_vehicle_model *model, fixes *all, td_error *error)
{
    const td_vehicle_data *data = model->data;
    bool found[TD_VEHICLE_MAX_POINTS] = {0};
    linear l = {0};
    size_t unknown = 0;
    for (size_t i = 0; i < all->count; i++) found[all->fix[i].point] = true;
    for (int p = 0; p < data->point_count; p++) td_vehicle_place(model->place[p], model, p);
    for (int p = 0; p < data->point_count; p++)
        for (int k = 0; k < 3; k++) {
            bool is_free = data->point[p].board ? !is_known(data, p) : !isfinite(data->point[p].sigma[k]);
            l.column[p][k] = is_free && found[p] ? (int)unknown++ : -1;
            if (is_free && !found[p] && model->seen[p] && !data->point[p].board)
                return td_fail(
                    error, TD_ERROR_DATA,
                    "point %s: its place is free and no pose shows it to two cameras: give its place, "
                    "or leave it out",
                    data->point[p].name);
        }
    size_t rows = 3 * all->count + 12 + unknown;
    l.a = calloc(rows * (12 + unknown), sizeof *l.a);
    l.b = calloc(rows, sizeof *l.b);
    l.x = calloc(12 + unknown, sizeof *l.x);
    double *distance = calloc(all->count + 1, sizeof *distance);
    td_status status = TD_OK;
    if (!l.a || !l.b || !l.x || !distance) status = td_fail(error, TD_ERROR_MEMORY, "no memory for a start");
    for (int round = 0; round < ROUNDS && status == TD_OK; round++) {
        status = one_round(&l, model, all, unknown, distance, error);
        if (status == TD_OK && !reweight(all, distance))
            status = td_fail(error, TD_ERROR_MEMORY, "no memory for a start");
    }
    if (status == TD_OK) status = place_boards(model, found, error);
    free(l.a);
    free(l.b);
    free(l.x);
    free(distance);
    return status;
}

/* ---- one camera ---- */

/* What one camera says of points of known places: rays (camera's frame) and places (mount's frame). */
typedef struct resection {
    size_t count;
    double (*ray)[3], (*place)[3];
    double centre[3], spread;
} resection;

static int busiest_camera(size_t *sights, const td_vehicle_data *data)
{
    int camera = 0;
    *sights = 0;
    for (int c = 0; c < data->rig->count; c++) {
        size_t count = 0;
        for (size_t s = 0; s < data->sight_count; s++)
            count += data->sight[s].camera == c && is_known(data, data->sight[s].point);
        if (count > *sights) {
            *sights = count;
            camera = c;
        }
    }
    return camera;
}

static void collect(resection *r, const td_vehicle_model *model, int camera, size_t step)
{
    const td_vehicle_data *data = model->data;
    for (size_t s = 0; s < data->sight_count; s += step) {
        const td_vehicle_sight *sight = &data->sight[s];
        const td_vehicle_point *point = &data->point[sight->point];
        const td_camera *c = &data->rig->camera[camera].camera;
        double q[TD_ROBOT_MAX_JOINTS];
        if (sight->camera != camera || !is_known(data, sight->point)) continue;
        if (!td_camera_unproject(r->ray[r->count], NULL, NULL, c, sight->pixel)) continue;
        td_vehicle_joints(q, model, sight->pose);
        td_pose arm = td_vehicle_arm(NULL, data->robot, data->mount, point->link, q, NULL, 0);
        double x[3];
        td_vehicle_place(x, model, sight->point);
        td_pose_transform(r->place[r->count++], &arm, x);
    }
    for (size_t i = 0; i < 3 * r->count; i++) r->centre[i % 3] += r->place[i / 3][i % 3] / (double)r->count;
    for (size_t i = 0; i < 3 * r->count; i++)
        r->spread += pow(r->place[i / 3][i % 3] - r->centre[i % 3], 2) / (double)r->count;
    r->spread = sqrt(r->spread);
}

/* x = [R t] up to scale, of centred and scaled places: the null vector of ray x (R m + t). */
static bool linear_transform(double x[12], const resection *r)
{
    double ratio = 0, *a = calloc(36 * r->count, sizeof *a);
    if (!a) return false;
    for (size_t i = 0; i < r->count; i++) {
        const double *d = r->ray[i], cross[9] = {0, -d[2], d[1], d[2], 0, -d[0], -d[1], d[0], 0};
        for (int k = 0; k < 9; k++) {
            double *at = a + 36 * i + 12 * (k / 3) + 4 * (k % 3);
            for (int c = 0; c < 3; c++) at[c] = cross[k] * (r->place[i][c] - r->centre[c]) / r->spread;
            at[3] = cross[k];
        }
    }
    bool ok = td_null_vector(x, &ratio, a, 3 * r->count, 12, NULL) == TD_OK && ratio > 1e-6;
    free(a);
    return ok;
}

/* camera_from_mount out of x. */
static bool pose_of(td_pose *camera_from_mount, const double x[12], const resection *r)
{
    double h[9], rotation[9], t[3], scale = 0;
    for (int k = 0; k < 9; k++) h[k] = x[4 * (k / 3) + k % 3];
    double det = h[0] * (h[4] * h[8] - h[5] * h[7]) - h[1] * (h[3] * h[8] - h[5] * h[6]) +
                 h[2] * (h[3] * h[7] - h[4] * h[6]);
    for (int k = 0; k < 9 && det < 0; k++) h[k] = -h[k];
    if (td_nearest_rotation(rotation, h, NULL) != TD_OK) return false;
    for (int k = 0; k < 9; k++) scale += rotation[k] * h[k] / 3;
    for (int k = 0; k < 3; k++) {
        t[k] = (det < 0 ? -x[4 * k + 3] : x[4 * k + 3]) / scale * r->spread;
        for (int c = 0; c < 3; c++) t[k] -= rotation[3 * k + c] * r->centre[c];
    }
    *camera_from_mount = td_pose_from_rotation(rotation, t);
    return true;
}

/* Resection by the camera with most sights (direct linear transform). */
static bool start_resection(td_vehicle_model *model)
{
    const td_vehicle_data *data = model->data;
    size_t sights;
    int camera = busiest_camera(&sights, data);
    resection r = {.ray = calloc(sights + 1, sizeof *r.ray), .place = calloc(sights + 1, sizeof *r.place)};
    double x[12];
    td_pose camera_from_mount;
    bool ok = r.ray && r.place;
    if (ok) collect(&r, model, camera, 1 + 3 * sights / MOST_ROWS);
    ok = ok && r.count >= CLOSED_POINTS && r.spread > 0 && linear_transform(x, &r) &&
         pose_of(&camera_from_mount, x, &r);
    if (ok) {
        td_pose mount_from_camera = td_pose_inverse(&camera_from_mount);
        model->mount_from_rig =
            td_pose_compose(&mount_from_camera, &data->rig->camera[camera].camera_from_rig);
    }
    free(r.ray);
    free(r.place);
    return ok;
}

static td_status cannot_start(const td_vehicle_model *model, const fixes *all, td_error *error)
{
    int seen = 0;
    for (int p = 0; p < model->data->point_count; p++) seen += model->seen[p];
    if (all->count >= 3)
        return td_fail(
            error, TD_ERROR_DATA,
            "the %d points lie on a line in every pose: take points off that line, or move the arm "
            "across it",
            seen);
    return td_fail(
        error, TD_ERROR_DATA,
        "%d points, of which %zu sights by two cameras could be triangulated: show at least three "
        "points that are not on a line to a pair of cameras, or six known ones, not in one plane, to "
        "one camera",
        seen, all->count);
}

td_status td_vehicle_start(td_vehicle_model *model, td_error *error)
{
    fixes all;
    bool any_free = false;
    for (int p = 0; p < model->data->point_count; p++)
        any_free = any_free || (model->seen[p] && !is_known(model->data, p));
    td_status status = find_fixes(&all, model, error);
    if (status == TD_OK && !any_free) {
        if (!start_known(model, &all) && (all.count >= 3 || !start_resection(model)))
            status = cannot_start(model, &all, error);
    } else if (status == TD_OK) {
        if (td_vehicle_distinct_poses(model) == 1)
            status =
                td_fail(error, TD_ERROR_DATA,
                        "the arm stands in the same pose in all %zu images and places of points are free: "
                        "move the arm between images, or measure the places",
                        model->data->pose_count);
        else if (all.count < 3)
            status = cannot_start(model, &all, error);
        else
            status = start_unknown(model, &all, error);
    }
    free(all.fix);
    return status;
}

td_status td_vehicle_closed(td_pose *mount_from_rig, size_t *poses, const td_vehicle_model *model,
                            td_error *error)
{
    fixes all;
    double sum[9] = {0}, t[3] = {0}, r[9];
    *poses = 0;
    *mount_from_rig = td_pose_identity();
    td_status status = find_fixes(&all, model, error);
    for (size_t i = 0, end; i < all.count && status == TD_OK; i = end) {
        td_pose one;
        size_t known = 0;
        for (end = i; end < all.count && all.fix[end].pose == all.fix[i].pose; end++)
            known += all.fix[end].known;
        if (known < CLOSED_POINTS || !orient(&one, all.fix + i, end - i)) continue;
        td_pose_rotation(r, &one);
        for (int k = 0; k < 9; k++) sum[k] += r[k];
        for (int k = 0; k < 3; k++) t[k] += one.t[k];
        ++*poses;
    }
    if (status == TD_OK && *poses) {
        status = td_nearest_rotation(r, sum, error);
        for (int k = 0; k < 3; k++) t[k] /= (double)*poses;
        if (status == TD_OK) *mount_from_rig = td_pose_from_rotation(r, t);
    }
    free(all.fix);
    return status;
}
