#include "calib/view_information_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/projected_internal.h"
#include "core/linalg.h"

/* Of the prior on the distortion's coefficients, as the joint problem has it. */
#define DISTORTION_SPREAD 50.0

td_shared_layout td_shared_layout_of(const td_bundle *bundle)
{
    td_shared_layout l = {0};
    for (int c = 0; c < bundle->rig->count; c++) {
        unsigned hold = bundle->hold[c];
        l.count[c] = td_camera_parameter_count(bundle->rig->camera[c].camera.model);
        for (int i = 0; i < l.count[c]; i++)
            l.column[c][i] = hold & (i < 4 ? TD_HOLD_INTRINSICS : TD_HOLD_DISTORTION) ? -1 : (int)l.n++;
        for (int i = l.count[c]; i < l.count[c] + 6; i++)
            l.column[c][i] = c == 0 || (hold & TD_HOLD_POSE) ? -1 : (int)l.n++;
    }
    for (int c = 0; c < bundle->rig->count; c++)
        for (int i = 0; i < 2; i++) l.column[c][l.count[c] + 6 + i] = bundle->use_warp ? (int)l.n + i : -1;
    l.n += bundle->use_warp ? 2 : 0;
    return l;
}

td_status td_information_init(td_information *information, size_t n, td_error *error)
{
    *information = (td_information){.n = n};
    information->shared = calloc(n * n + 1, sizeof *information->shared);
    information->coupling = calloc(6 * n + 1, sizeof *information->coupling);
    if (information->shared && information->coupling) return TD_OK;
    td_information_free(information);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
}

void td_information_copy(td_information *copy, const td_information *from)
{
    memcpy(copy->shared, from->shared, from->n * from->n * sizeof *copy->shared);
    memcpy(copy->coupling, from->coupling, 6 * from->n * sizeof *copy->coupling);
    memcpy(copy->board, from->board, sizeof copy->board);
    copy->boards = from->boards;
}

void td_information_free(td_information *information)
{
    free(information->shared);
    free(information->coupling);
    *information = (td_information){0};
}

td_status td_board_information_init(td_board_information *board, size_t n, td_error *error)
{
    *board = (td_board_information){.n = n};
    board->shared = calloc(n * n + 1, sizeof *board->shared);
    board->coupling = calloc(6 * n + 1, sizeof *board->coupling);
    if (board->shared && board->coupling) return TD_OK;
    td_board_information_free(board);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
}

void td_board_information_clear(td_board_information *board)
{
    memset(board->shared, 0, board->n * board->n * sizeof *board->shared);
    memset(board->coupling, 0, 6 * board->n * sizeof *board->coupling);
    memset(board->board, 0, sizeof board->board);
}

void td_board_information_free(td_board_information *board)
{
    free(board->shared);
    free(board->coupling);
    *board = (td_board_information){0};
}

/* out (2,6) into rows of `width` = a (2,3) [-[x]x, I] */
static void by_motion(double *out, size_t width, const double a[6], const double x[3])
{
    for (size_t i = 0; i < 2; i++, out += width, a += 3) {
        out[0] = a[2] * x[1] - a[1] * x[2];
        out[1] = a[0] * x[2] - a[2] * x[0];
        out[2] = a[1] * x[0] - a[0] * x[1];
        for (size_t k = 0; k < 3; k++) out[3 + k] = a[k];
    }
}

/* Derivatives of a point's image by the camera's own columns (2,TD_OWN_COLUMNS) and the board's pose (2,6).
 */
static bool point_jacobian(double own[2 * TD_OWN_COLUMNS], double pose[12], int parameters,
                           const td_rig_camera *camera, const td_pose *rig_from_target, const double point[3],
                           const double shape[2])
{
    double x_rig[3], x[3], pixel[2], by_point[6], by_parameter[2 * TD_CAMERA_MAX_PARAMETERS], r[9], by_rig[6];
    size_t k = (size_t)parameters;
    td_pose_transform(x_rig, rig_from_target, point);
    td_pose_transform(x, &camera->camera_from_rig, x_rig);
    if (!td_camera_project(pixel, by_point, by_parameter, &camera->camera, x)) return false;
    td_pose_rotation(r, &camera->camera_from_rig);
    for (int i = 0; i < 6; i++)
        by_rig[i] = by_point[i / 3 * 3] * r[i % 3] + by_point[i / 3 * 3 + 1] * r[3 + i % 3] +
                    by_point[i / 3 * 3 + 2] * r[6 + i % 3];
    for (size_t i = 0; i < 2; i++) memcpy(own + i * TD_OWN_COLUMNS, by_parameter + i * k, k * sizeof *own);
    by_motion(own + k, TD_OWN_COLUMNS, by_point, x);
    by_motion(pose, 6, by_rig, x_rig);
    const double into_board[3] = {0, 0, 1};
    double normal[3] = {0};
    if (shape) td_pose_rotate(normal, rig_from_target, into_board);
    for (size_t i = 0; i < 2; i++) {
        double by_z =
            by_rig[3 * i] * normal[0] + by_rig[3 * i + 1] * normal[1] + by_rig[3 * i + 2] * normal[2];
        for (size_t j = 0; j < 2; j++) own[i * TD_OWN_COLUMNS + k + 6 + j] = shape ? by_z * shape[j] : 0;
    }
    return true;
}

bool td_board_information_add(td_board_information *board, const td_shared_layout *layout, const td_rig *rig,
                              int camera, const td_pose *rig_from_target, const double point[3],
                              const double shape[2], double weight)
{
    double own[2 * TD_OWN_COLUMNS], pose[12];
    size_t columns = (size_t)layout->count[camera] + 8, n = board->n;
    const int *to = layout->column[camera];
    if (!point_jacobian(own, pose, layout->count[camera], &rig->camera[camera], rig_from_target, point,
                        shape))
        return false;
    for (size_t row = 0; row < 2; row++) {
        const double *a = own + row * TD_OWN_COLUMNS, *b = pose + 6 * row;
        for (size_t i = 0; i < columns; i++) {
            if (to[i] < 0) continue;
            double w = weight * a[i];
            double *out = board->shared + (size_t)to[i] * n;
            for (size_t k = 0; k <= i; k++)
                if (to[k] >= 0) out[to[k]] += w * a[k];
            for (size_t k = 0; k < 6; k++) board->coupling[k * n + (size_t)to[i]] += w * b[k];
        }
        for (size_t i = 0; i < 6; i++)
            for (size_t k = 0; k < 6; k++) board->board[6 * i + k] += weight * b[i] * b[k];
    }
    return true;
}

bool td_information_add(td_information *information, const td_board_information *board)
{
    size_t n = information->n;
    double inverse[36];
    if (td_invert_spd(inverse, board->board, 6, NULL) != TD_OK) return false;
    double *solved = malloc((6 * n + 1) * sizeof *solved);
    if (!solved) return false;
    if (n) td_multiply(solved, inverse, board->coupling, 6, 6, n);
    /* Only the lower triangle of the board's is filled: columns grow with their number within each camera. */
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k <= i; k++) {
            double x = board->shared[i * n + k];
            for (size_t j = 0; j < 6; j++) x -= board->coupling[j * n + i] * solved[j * n + k];
            information->shared[i * n + k] += x;
            if (k < i) information->shared[k * n + i] += x;
        }
    for (size_t i = 0; i < 6 * n; i++) information->coupling[i] += solved[i];
    for (size_t i = 0; i < 36; i++) information->board[i] += inverse[i];
    information->boards++;
    free(solved);
    return true;
}

/* Adds one view's used points to its board. */
static td_status add_view(td_board_information *board, const td_shared_layout *layout,
                          const td_bundle *bundle, size_t view, td_error *error)
{
    const td_observations *o = bundle->observations;
    size_t points = td_target_point_count(&o->target);
    for (int c = 0; c < bundle->rig->count; c++)
        for (size_t p = 0; p < points; p++) {
            if (!bundle->used[td_bundle_index(bundle, view, c, p)]) continue;
            double x[3], shape[2], s = bundle->own_sigma ? td_observations_get(o, view, c)->sigma[p] : 0;
            td_bundle_target_point(x, bundle, view, p);
            if (bundle->use_warp) td_bundle_warp_shape(shape, &o->target, p);
            if (!td_board_information_add(
                    board, layout, bundle->rig, c, &bundle->rig_from_target[bundle->pose_of_view[view]], x,
                    bundle->use_warp ? shape : NULL, 1 / (s * s + bundle->noise[c] * bundle->noise[c])))
                return td_fail(error, TD_ERROR_DATA, "view %s: a point lies behind the camera",
                               o->view_name[view]);
        }
    return TD_OK;
}

static void add_priors(td_information *information, const td_shared_layout *layout, const td_rig *rig)
{
    for (int c = 0; c < rig->count; c++)
        for (int i = 4; i < layout->count[c]; i++) {
            int column = layout->column[c][i];
            if (column >= 0 && td_camera_parameter_name(rig->camera[c].camera.model, i)[0] == 'k')
                information->shared[(size_t)column * (layout->n + 1)] +=
                    1 / (DISTORTION_SPREAD * DISTORTION_SPREAD);
        }
}

td_status td_information_of_bundle(td_information *information, const td_shared_layout *layout,
                                   const td_bundle *bundle, td_error *error)
{
    td_board_information board;
    td_status status = TD_OK;
    TD_TRY(td_information_init(information, layout->n, error));
    add_priors(information, layout, bundle->rig);
    status = td_board_information_init(&board, layout->n, error);
    for (size_t i = 0; i < bundle->pose_count && status == TD_OK; i++) {
        bool any = false;
        td_board_information_clear(&board);
        for (size_t v = 0; v < bundle->observations->view_count && status == TD_OK; v++) {
            if (bundle->pose_of_view[v] != i) continue;
            for (int c = 0; c < bundle->rig->count; c++) any |= td_bundle_used(bundle, v, c) > 0;
            status = add_view(&board, layout, bundle, v, error);
        }
        if (status == TD_OK && any && !td_information_add(information, &board))
            status = td_fail(error, TD_ERROR_DATA, "board %zu: its points do not determine its pose", i);
    }
    td_board_information_free(&board);
    if (status != TD_OK) td_information_free(information);
    return status;
}

td_status td_information_covariance(double *covariance, const td_information *information, td_error *error)
{
    size_t n = information->n, m = n + 6;
    double boards = (double)(information->boards ? information->boards : 1);
    double *work = malloc((n * n + 12 * n + 36 + 1) * sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu parameters", m);
    double *c = work, *follow = c + n * n, *across = follow + 6 * n, *own = across + 6 * n;
    td_status status = n ? td_invert_spd(c, information->shared, n, error) : TD_OK;
    if (status == TD_OK) {
        for (size_t i = 0; i < 6 * n; i++) follow[i] = -information->coupling[i] / boards;
        memset(own, 0, 36 * sizeof *own);
        if (n) td_multiply(across, follow, c, 6, n, n);
        if (n) td_multiply_transposed(own, across, follow, 6, n, 6);
        for (size_t i = 0; i < n; i++) memcpy(covariance + i * m, c + i * n, n * sizeof *c);
        for (size_t i = 0; i < 6; i++) {
            for (size_t k = 0; k < n; k++)
                covariance[(n + i) * m + k] = covariance[k * m + n + i] = across[i * n + k];
            for (size_t k = 0; k < 6; k++)
                covariance[(n + i) * m + n + k] =
                    own[6 * i + k] + information->board[6 * i + k] / (boards * boards);
        }
    }
    free(work);
    return status;
}

bool td_information_gradient(double *gradient, const td_shared_layout *layout, const td_rig *rig, int camera,
                             const double pixel[2], double distance_m)
{
    double g[2 * TD_PROJECTED_MOST];
    size_t count, m = layout->n + 6, own = (size_t)layout->count[camera] + 6;
    if (!td_projected_gradient(g, &count, rig, camera, pixel, distance_m)) return false;
    memset(gradient, 0, 2 * m * sizeof *gradient);
    for (size_t row = 0; row < 2; row++) {
        for (size_t i = 0; i < own; i++)
            if (layout->column[camera][i] >= 0)
                gradient[row * m + (size_t)layout->column[camera][i]] = g[row * count + i];
        for (size_t i = 0; i < 6; i++) gradient[row * m + layout->n + i] = g[row * count + own + i];
    }
    return true;
}
