/* What the errors of the board do to a covariance: the estimate stays plain least squares, its covariance
 * becomes that under correlated errors. */
#include <stdlib.h>
#include <string.h>

#include "calib/board_error_internal.h"
#include "core/linalg.h"

enum { Q = TD_BOARD_COLUMNS };

/* ---- on a problem's covariance ---- */

/* Gradients of the displacements, in units of their sigmas: rows of the rig, the warp, then each pose's 6. */
typedef struct gradients {
    size_t n, points, poses;
    double *print; /* (n + 2 + 6 poses, 3 points) */
    double *bend;  /* (poses, n + 2 + 6, Q) */
} gradients;

/* Adds w j^T u to a row of each column's gradient. */
static void add_product(double *out, double j, const double *u, size_t count)
{
    for (size_t i = 0; i < count; i++) out[i] += j * u[i];
}

static void add_gradients(gradients *g, const td_board_error *board, const td_drift_row *row, size_t pose,
                          size_t point, const double *shape)
{
    double u[2][Q], w = 1 / row->variance;
    size_t wide = 3 * g->points, own = g->n + 2, k = row->count + 8;
    double *bend = g->bend + pose * (own + 6) * Q;
    td_board_columns(u, row, shape);
    for (int e = 0; e < 2; e++) {
        double print[3];
        for (int i = 0; i < 3; i++) print[i] = row->point[e][i] * td_board_sigma(board, TD_BOARD_PRINT);
        for (size_t i = 0; i < Q; i++) u[e][i] *= td_board_sigma(board, td_board_part(i));
        for (size_t i = 0; i < k; i++) {
            bool rig = i < row->count, warp = !rig && i < row->count + 2;
            size_t at = i - row->count;
            double j = w * (rig ? row->own[e][i] : warp ? row->warp[e][at] : row->view[e][at - 2]);
            size_t to = rig ? row->first + i : warp ? g->n + at : own + at - 2;
            add_product(g->print + (rig || warp ? to : to + 6 * pose) * wide + 3 * point, j, print, 3);
            add_product(bend + to * Q, j, u[e], Q);
        }
    }
}

/* Parts on all shared blocks of `gradient`, whose rows are the rig's and the warp's. */
static size_t shared_parts(td_common_error *part, const double *gradient, size_t width, const td_bundle *b,
                           const td_bundle_blocks *blocks)
{
    size_t count = 0;
    for (int c = 0; c < b->rig->count; c++) {
        size_t first = td_rig_parameter_offset(b->rig, c);
        size_t own = (size_t)td_camera_parameter_count(b->rig->camera[c].camera.model);
        part[count++] = (td_common_error){blocks->camera[c], gradient + first * width};
        if (blocks->pose[c] >= 0)
            part[count++] = (td_common_error){blocks->pose[c], gradient + (first + own) * width};
    }
    if (blocks->warp >= 0)
        part[count++] = (td_common_error){blocks->warp, gradient + td_rig_parameter_count(b->rig) * width};
    return count;
}

static td_status add_groups(td_covariance *covariance, const gradients *g, const td_bundle *b,
                            const td_bundle_blocks *blocks, td_error *error)
{
    size_t shared = g->n + 2, wide = 3 * g->points;
    td_common_error *part = malloc((2 * TD_RIG_MAX_CAMERAS + 1 + g->poses) * sizeof *part);
    if (!part) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", g->poses);
    size_t count = shared_parts(part, g->print, wide, b, blocks);
    for (size_t i = 0; i < g->poses; i++)
        part[count++] = (td_common_error){blocks->view[i], g->print + (shared + 6 * i) * wide};
    td_status status = td_covariance_add_common(covariance, wide, part, count, error);
    for (size_t i = 0; i < g->poses && status == TD_OK; i++) {
        const double *bend = g->bend + i * (shared + 6) * Q;
        count = shared_parts(part, bend, Q, b, blocks);
        part[count++] = (td_common_error){blocks->view[i], bend + shared * Q};
        status = td_covariance_add_common(covariance, Q, part, count, error);
    }
    free(part);
    return status;
}

td_status td_board_error_add(td_covariance *covariance, const td_board_error *board, const td_bundle *b,
                             const td_bundle_blocks *blocks, td_error *error)
{
    const td_observations *o = b->observations;
    gradients g = {td_rig_parameter_count(b->rig), td_target_point_count(&o->target), b->pose_count, NULL,
                   NULL};
    td_drift_row row;
    double *shapes = NULL;
    if (!board->significant) return TD_OK;
    TD_TRY(td_board_shapes(&shapes, &o->target, error));
    g.print = calloc((g.n + 2 + 6 * g.poses) * 3 * g.points + 1, sizeof *g.print);
    g.bend = calloc(g.poses * (g.n + 8) * Q + 1, sizeof *g.bend);
    td_status status =
        g.print && g.bend ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", g.poses);
    for (size_t v = 0; v < o->view_count && status == TD_OK; v++)
        for (int c = 0; c < b->rig->count; c++)
            for (size_t p = 0; p < g.points; p++)
                if (td_drift_row_make(&row, b, v, c, p))
                    add_gradients(&g, board, &row, b->pose_of_view[v], p, shapes + p * TD_BOARD_SHAPES);
    if (status == TD_OK) status = add_groups(covariance, &g, b, blocks, error);
    free(g.print);
    free(g.bend);
    free(shapes);
    return status;
}

/* ---- on the gradient of a drift check ---- */

/* out (n,n) += g g^T, g (n,count) */
static void add_square(double *out, double *work, const double *g, size_t n, size_t count)
{
    td_multiply_transposed(work, g, g, n, count, n);
    for (size_t i = 0; i < n * n; i++) out[i] += work[i];
}

td_status td_board_error_gradient(double *out, const td_board_error *board, const td_bundle *b,
                                  const td_drift_normal *normal, unsigned cameras, td_error *error)
{
    const td_observations *o = b->observations;
    size_t n = normal->n, points = td_target_point_count(&o->target), wide = 3 * points;
    double *shapes = NULL, u[2][Q];
    td_drift_row row;
    memset(out, 0, n * n * sizeof *out);
    if (!board->significant) return TD_OK;
    TD_TRY(td_board_shapes(&shapes, &o->target, error));
    double *print = calloc(n * (wide + Q + n + 2) + 1, sizeof *print);
    if (!print) {
        free(shapes);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the errors of %zu points", points);
    }
    double *bend = print + n * wide, *work = bend + n * Q, *j = work + n * n;
    for (size_t i = 0; i < b->pose_count; i++) {
        memset(bend, 0, n * Q * sizeof *bend);
        for (size_t s = 0; s < o->view_count * (size_t)b->rig->count * points && normal->seen[i]; s++) {
            size_t v = s / points / (size_t)b->rig->count, p = s % points;
            int c = (int)(s / points % (size_t)b->rig->count);
            if (b->pose_of_view[v] != i || !(cameras >> c & 1) || !td_drift_row_make(&row, b, v, c, p))
                continue;
            td_drift_row_follow(j, &row, normal, i);
            td_board_columns(u, &row, shapes + p * TD_BOARD_SHAPES);
            for (int e = 0; e < 2; e++) {
                double own[3];
                for (int a = 0; a < 3; a++) own[a] = row.point[e][a] * td_board_sigma(board, TD_BOARD_PRINT);
                for (size_t q = 0; q < Q; q++) u[e][q] *= td_board_sigma(board, td_board_part(q));
                for (size_t k = 0; k < n; k++) {
                    double x = j[(size_t)e * n + k] / row.variance;
                    add_product(print + k * wide + 3 * p, x, own, 3);
                    add_product(bend + k * Q, x, u[e], Q);
                }
            }
        }
        add_square(out, work, bend, n, Q);
    }
    add_square(out, work, print, n, wide);
    free(print);
    free(shapes);
    return TD_OK;
}
