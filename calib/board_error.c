#include "calib/board_error_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/random.h"

/* Twice the log of the likelihood ratio against no error of the board, below which there is none: exceeded by
 * fewer than one in a thousand clean sets (tests/calib/test_board_error.c counts them). */
#define SIGNIFICANT 16.0
/* Curvature, each fitted parameter scaled to 1, that keeps what the views leave open finite. */
#define RIDGE 1e-10
#define SETTLED 0.05 /* change of twice the log likelihood at which the fixed point counts as found */
#define NOTHING 1e-3 /* effective degrees of freedom below which a component has died out */
enum { FEWEST_POSES = 3, MOST_POSES = 40, MOST_POINTS = 30, MOST_ROUNDS = 50 };
enum { POSE = 6, OWN = POSE + TD_BOARD_COLUMNS, Q = TD_BOARD_COLUMNS };

/* ---- the shapes ---- */

static double legendre(int degree, double x)
{
    const double p[4] = {1, x, (3 * x * x - 1) / 2, (5 * x * x - 3) * x / 2};
    return p[degree];
}

td_status td_board_shapes(double **shapes, const td_target *target, td_error *error)
{
    size_t points = td_target_point_count(target);
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, p[3];
    double *s = *shapes = calloc(points * TD_BOARD_SHAPES + 1, sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", points);
    for (size_t i = 0; i < points; i++) {
        td_target_point(p, target, i);
        for (int e = 0; e < 2; e++) {
            low[e] = fmin(low[e], p[e]);
            high[e] = fmax(high[e], p[e]);
        }
    }
    double square[TD_BOARD_SHAPES] = {0};
    for (size_t i = 0; i < points; i++) {
        double at[2];
        size_t k = 0;
        td_target_point(p, target, i);
        for (int e = 0; e < 2; e++)
            at[e] = high[e] > low[e] ? (2 * p[e] - low[e] - high[e]) / (high[e] - low[e]) : 0;
        for (int degree = 1; degree <= 3; degree++)
            for (int x = 0; x <= degree; x++, k++) {
                double f = legendre(x, at[0]) * legendre(degree - x, at[1]);
                s[i * TD_BOARD_SHAPES + k] = f;
                square[k] += f * f / (double)points;
            }
    }
    for (size_t i = 0; i < points * TD_BOARD_SHAPES; i++)
        if (square[i % TD_BOARD_SHAPES] > 1e-6) s[i] /= sqrt(square[i % TD_BOARD_SHAPES]);
    return TD_OK;
}

void td_board_columns(double u[2][TD_BOARD_COLUMNS], const td_drift_row *row, const double *shape)
{
    enum { LINEAR = 2 };
    for (int e = 0; e < 2; e++) {
        size_t k = 0;
        for (int i = LINEAR; i < TD_BOARD_SHAPES; i++) u[e][k++] = row->point[e][2] * shape[i];
        for (int axis = 0; axis < 2; axis++)
            for (int i = 0; i < LINEAR; i++) u[e][k++] = row->point[e][axis] * shape[i];
        for (int axis = 0; axis < 2; axis++)
            for (int i = LINEAR; i < TD_BOARD_SHAPES; i++) u[e][k++] = row->point[e][axis] * shape[i];
    }
}

int td_board_part(size_t column)
{
    return column < 7 ? TD_BOARD_BEND : column < 11 ? TD_BOARD_STRETCH : TD_BOARD_RIPPLE;
}

/* Shapes of one component along one axis, over which its mean square is spread. */
static double shapes_of(int part)
{
    return part == TD_BOARD_PRINT ? 1 : part == TD_BOARD_STRETCH ? 2 : 7;
}

double td_board_sigma(const td_board_error *board, int part)
{
    const double rms[TD_BOARD_PARTS] = {board->print_m, board->bend_m, board->stretch_m, board->ripple_m};
    return rms[part] / sqrt(shapes_of(part));
}

/* ---- the mixed-model equations ---- */

/* Weighted products of the residuals' derivatives. Columns of all poses (m): fitted parameters of the rig and
 * the warp (n), then 3 for each point taken; the pose itself is eliminated. */
typedef struct equations {
    size_t n, points, m, poses, rows, fitted;
    double *shared, *right;      /* (m,m), (m) */
    double *own, *by, *by_right; /* (poses,Q,Q), (poses,m,Q), (poses,Q) */
    double square;               /* of the residuals, what poses explain taken off */
    double *scale;               /* (n) 1/sqrt of the curvature with poses held */
} equations;

static void free_equations(equations *q)
{
    free(q->shared);
    free(q->own);
}

static td_status new_equations(equations *q, size_t n, size_t points, size_t poses, td_error *error)
{
    size_t m = n + 3 * points;
    *q = (equations){.n = n, .points = points, .m = m};
    q->shared = calloc(m * m + m + n + 1, sizeof *q->shared);
    q->own = calloc(poses * (Q * Q + m * Q + Q) + 1, sizeof *q->own);
    if (!q->shared || !q->own) {
        free_equations(q);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the errors of %zu points", points);
    }
    q->right = q->shared + m * m;
    q->scale = q->right + m;
    q->by = q->own + poses * Q * Q;
    q->by_right = q->by + poses * m * Q;
    return TD_OK;
}

/* Sums over one pose, before it is eliminated. */
typedef struct pose_equations {
    double own[OWN * OWN], right[OWN];
    double *by; /* (m,OWN) */
    size_t rows;
} pose_equations;

/* What is fitted of the rig, by column: held parameters too, whose values may be wrong; the warp's two
 * follow. */
static void mark_fitted(bool *fitted, const td_bundle *b)
{
    size_t n = td_rig_parameter_count(b->rig);
    for (int c = 0; c < b->rig->count; c++) {
        size_t first = td_rig_parameter_offset(b->rig, c);
        size_t count = (size_t)td_camera_parameter_count(b->rig->camera[c].camera.model);
        for (size_t k = 0; k < count + (c > 0 ? 6 : 0); k++) fitted[first + k] = true;
    }
    fitted[n] = fitted[n + 1] = b->use_warp;
}

static void add_row(equations *q, pose_equations *pose, const td_drift_row *row, const bool *fitted,
                    size_t point, const double *shape)
{
    size_t column[TD_DRIFT_OWN + 5], k = 0, m = q->m;
    double j[2][TD_DRIFT_OWN + 5], own[2][OWN], u[2][Q], w = 1 / row->variance;
    td_board_columns(u, row, shape);
    for (int e = 0; e < 2; e++) {
        memcpy(own[e], row->view[e], sizeof row->view[e]);
        memcpy(own[e] + POSE, u[e], sizeof u[e]);
    }
    for (size_t i = 0; i < row->count + 5; i++) {
        bool rig = i < row->count, warp = !rig && i < row->count + 2;
        size_t to = rig    ? row->first + i
                    : warp ? q->n - 2 + i - row->count
                           : q->n + 3 * point + i - row->count - 2;
        if (to < q->n && !fitted[to]) continue;
        for (int e = 0; e < 2; e++)
            j[e][k] = rig    ? row->own[e][i]
                      : warp ? row->warp[e][i - row->count]
                             : row->point[e][i - row->count - 2];
        column[k++] = to;
    }
    for (int e = 0; e < 2; e++) {
        double r = w * row->r[e];
        for (size_t a = 0; a < k; a++) {
            double x = w * j[e][a], *to = q->shared + column[a] * m, *by = pose->by + column[a] * OWN;
            q->right[column[a]] += j[e][a] * r;
            if (column[a] < q->n) q->scale[column[a]] += x * j[e][a];
            for (size_t b = 0; b < k; b++) to[column[b]] += x * j[e][b];
            for (size_t b = 0; b < OWN; b++) by[b] += x * own[e][b];
        }
        for (size_t a = 0; a < OWN; a++) {
            pose->right[a] += own[e][a] * r;
            for (size_t b = 0; b < OWN; b++) pose->own[a * OWN + b] += w * own[e][a] * own[e][b];
        }
        q->square += row->r[e] * r;
    }
    pose->rows += 2;
}

/* The pose follows, and what is left goes to place q->poses. */
static td_status eliminate_pose(equations *q, const pose_equations *pose, td_error *error)
{
    size_t m = q->m;
    double inverse[POSE * POSE], across[POSE * OWN], start[POSE];
    for (size_t i = 0; i < POSE; i++)
        for (size_t k = 0; k < POSE; k++) inverse[i * POSE + k] = pose->own[i * OWN + k];
    if (td_invert_spd(inverse, inverse, POSE, NULL) != TD_OK) return TD_OK; /* its points say nothing */
    double *work = malloc((2 * m * POSE + m * m) * sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for the errors of %zu points", q->points);
    double *by = work, *follow = by + m * POSE, *product = follow + m * POSE;
    td_multiply(across, inverse, pose->own, POSE, POSE, OWN);
    td_multiply(start, inverse, pose->right, POSE, POSE, 1);
    for (size_t i = 0; i < m; i++) memcpy(by + i * POSE, pose->by + i * OWN, POSE * sizeof *by);
    td_multiply(follow, by, inverse, m, POSE, POSE);
    td_multiply_transposed(product, follow, by, m, POSE, m);
    for (size_t i = 0; i < m * m; i++) q->shared[i] -= product[i];

    double *own = q->own + q->poses * Q * Q, *out = q->by + q->poses * m * Q,
           *right = q->by_right + q->poses * Q;
    for (size_t i = 0; i < m; i++) {
        for (size_t k = 0; k < POSE; k++) q->right[i] -= by[i * POSE + k] * start[k];
        for (size_t k = 0; k < Q; k++) {
            out[i * Q + k] = pose->by[i * OWN + POSE + k];
            for (size_t l = 0; l < POSE; l++) out[i * Q + k] -= by[i * POSE + l] * across[l * OWN + POSE + k];
        }
    }
    for (size_t i = 0; i < Q; i++) {
        right[i] = pose->right[POSE + i];
        for (size_t l = 0; l < POSE; l++) right[i] -= pose->own[(POSE + i) * OWN + l] * start[l];
        for (size_t k = 0; k < Q; k++) {
            own[i * Q + k] = pose->own[(POSE + i) * OWN + POSE + k];
            for (size_t l = 0; l < POSE; l++)
                own[i * Q + k] -= pose->own[(POSE + i) * OWN + l] * across[l * OWN + POSE + k];
        }
    }
    for (size_t i = 0; i < POSE; i++) q->square -= pose->right[i] * start[i];
    q->rows += pose->rows;
    q->poses++;
    q->fitted += POSE;
    free(work);
    return TD_OK;
}

/* Points drawn at random: of hundreds some tens tell as much of variances. */
static size_t choose_points(size_t chosen[MOST_POINTS], size_t points)
{
    td_random random = td_random_seed(1, 47);
    size_t count = 0;
    for (size_t i = 0; i < points && count < MOST_POINTS; i++) {
        size_t wanted = (points < MOST_POINTS ? points : MOST_POINTS) - count;
        if (td_random_below(&random, (uint32_t)(points - i)) < wanted) chosen[count++] = i;
    }
    return count;
}

static td_status sum_equations(equations *q, const td_bundle *b, td_error *error)
{
    size_t chosen[MOST_POINTS], n = td_rig_parameter_count(b->rig) + 2;
    size_t points = choose_points(chosen, td_target_point_count(&b->observations->target));
    size_t step = (b->pose_count + MOST_POSES - 1) / MOST_POSES;
    double *shapes = NULL;
    bool *fitted = calloc(n, sizeof *fitted);
    pose_equations *pose = calloc(1, sizeof *pose);
    td_drift_row row;
    TD_TRY(new_equations(q, n, points, b->pose_count / (step ? step : 1) + 1, error));
    double *by = calloc(q->m * OWN, sizeof *by);
    td_status status = fitted && pose && by
                           ? td_board_shapes(&shapes, &b->observations->target, error)
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for the board's errors");
    if (status == TD_OK) mark_fitted(fitted, b);
    for (size_t i = 0; i < b->pose_count && status == TD_OK; i += step) {
        *pose = (pose_equations){.by = by};
        memset(by, 0, q->m * OWN * sizeof *by);
        for (size_t v = 0; v < b->observations->view_count; v++)
            for (int c = 0; c < b->rig->count && b->pose_of_view[v] == i; c++)
                for (size_t p = 0; p < points; p++)
                    if (td_drift_row_make(&row, b, v, c, chosen[p]))
                        add_row(q, pose, &row, fitted, p, shapes + chosen[p] * TD_BOARD_SHAPES);
        if (pose->rows > POSE) status = eliminate_pose(q, pose, error);
    }
    for (size_t i = 0; i < n; i++) {
        q->fitted += q->scale[i] > 0;
        q->scale[i] = q->scale[i] > 0 ? 1 / sqrt(q->scale[i]) : 0;
    }
    free(fitted);
    free(pose);
    free(by);
    free(shapes);
    if (status != TD_OK) free_equations(q);
    return status;
}

/* ---- variances ---- */

/* The equations solved at given variances, each displacement in units of its sigma. */
typedef struct solution {
    double noise;                     /* variance of the weighted residuals' own noise */
    double log_det;                   /* of the equations' matrix */
    double square[TD_BOARD_PARTS];    /* of the displacements, summed */
    double effective[TD_BOARD_PARTS]; /* displacements that the data, not their prior, determine */
} solution;

/* log det of a symmetric positive definite matrix, which is overwritten (Cholesky). */
static double log_determinant(double *a, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k <= i; k++) {
            double x = a[i * n + k];
            for (size_t l = 0; l < k; l++) x -= a[i * n + l] * a[k * n + l];
            if (k < i)
                a[i * n + k] = x / a[k * (n + 1)];
            else
                sum += 2 * log(a[i * (n + 1)] = sqrt(fmax(x, RIDGE * RIDGE)));
        }
    return sum;
}

/* Scaled parts of one pose: by (m,Q), right (Q), inverse (Q,Q) of the scaled own plus 1, follow = by inverse.
 */
static td_status scale_pose(double *by, double right[Q], double *inverse, double *follow, double *log_det,
                            const equations *q, size_t pose, const double *unit, const double root[Q],
                            td_error *error)
{
    const double *own = q->own + pose * Q * Q, *from = q->by + pose * q->m * Q;
    double copy[Q * Q];
    for (size_t i = 0; i < q->m; i++)
        for (size_t k = 0; k < Q; k++) by[i * Q + k] = unit[i] * root[k] * from[i * Q + k];
    for (size_t i = 0; i < Q; i++) {
        right[i] = root[i] * q->by_right[pose * Q + i];
        for (size_t k = 0; k < Q; k++) inverse[i * Q + k] = root[i] * root[k] * own[i * Q + k] + (i == k);
    }
    memcpy(copy, inverse, sizeof copy);
    *log_det += log_determinant(copy, Q);
    TD_TRY(td_invert_spd(inverse, inverse, Q, error));
    td_multiply(follow, by, inverse, q->m, Q, Q);
    return TD_OK;
}

/* `sigma`: of each component's coefficients, over the noise's. */
static td_status solve_equations(solution *s, const equations *q, const double sigma[TD_BOARD_PARTS],
                                 td_error *error)
{
    size_t m = q->m, block = 2 * m * Q + Q * Q + Q;
    double root[Q];
    *s = (solution){0};
    double *work = malloc((2 * m * m + 4 * m + m * Q + q->poses * block) * sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for the errors of %zu points", q->points);
    double *k = work, *product = k + m * m, *unit = product + m * m, *full = unit + m, *right = full + m,
           *x = right + m, *solved = x + m, *poses = solved + m * Q;
    for (size_t i = 0; i < Q; i++) root[i] = sigma[td_board_part(i)];
    for (size_t i = 0; i < m; i++) {
        unit[i] = i < q->n ? q->scale[i] : sigma[TD_BOARD_PRINT];
        full[i] = right[i] = unit[i] * q->right[i];
    }
    for (size_t i = 0; i < m; i++)
        for (size_t l = 0; l < m; l++) k[i * m + l] = unit[i] * unit[l] * q->shared[i * m + l];
    for (size_t i = 0; i < m; i++) k[i * (m + 1)] += i >= q->n || unit[i] == 0 ? 1 : RIDGE;
    td_status status = TD_OK;
    for (size_t p = 0; p < q->poses && status == TD_OK; p++) {
        double *by = poses + p * block, *follow = by + m * Q, *inverse = follow + m * Q,
               *own = inverse + Q * Q;
        status = scale_pose(by, own, inverse, follow, &s->log_det, q, p, unit, root, error);
        td_multiply_transposed(product, follow, by, m, Q, m);
        for (size_t i = 0; i < m * m; i++) k[i] -= product[i];
        for (size_t i = 0; i < m; i++)
            for (size_t l = 0; l < Q; l++) right[i] -= follow[i * Q + l] * own[l];
    }
    memcpy(product, k, m * m * sizeof *k);
    if (status == TD_OK) s->log_det += log_determinant(product, m);
    if (status == TD_OK) status = td_invert_spd(k, k, m, error);
    if (status == TD_OK) {
        double square = q->square;
        td_multiply(x, k, right, m, m, 1);
        for (size_t i = 0; i < m; i++) square -= full[i] * x[i];
        for (size_t i = q->n; i < m; i++) {
            s->square[TD_BOARD_PRINT] += x[i] * x[i];
            s->effective[TD_BOARD_PRINT] += 1 - k[i * (m + 1)];
        }
        for (size_t p = 0; p < q->poses; p++) {
            const double *by = poses + p * block, *follow = by + m * Q, *inverse = follow + m * Q,
                         *own = inverse + Q * Q;
            td_multiply(solved, k, follow, m, m, Q);
            for (size_t i = 0; i < Q; i++) {
                double u = 0, variance = inverse[i * (Q + 1)];
                for (size_t l = 0; l < Q; l++) u += inverse[i * Q + l] * own[l];
                for (size_t l = 0; l < m; l++) {
                    u -= follow[l * Q + i] * x[l];
                    variance += follow[l * Q + i] * solved[l * Q + i];
                }
                square -= own[i] * u;
                s->square[td_board_part(i)] += u * u;
                s->effective[td_board_part(i)] += 1 - variance;
            }
        }
        s->noise = square / ((double)q->rows - (double)q->fitted);
    }
    free(work);
    return status;
}

/* Where each displacement's variance equals that of its estimate. */
static void first_sigmas(double sigma[TD_BOARD_PARTS], const equations *q)
{
    double information[TD_BOARD_PARTS] = {0}, count[TD_BOARD_PARTS] = {0};
    for (size_t i = q->n; i < q->m; i++, count[TD_BOARD_PRINT]++)
        information[TD_BOARD_PRINT] += q->shared[i * (q->m + 1)];
    for (size_t p = 0; p < q->poses; p++)
        for (size_t i = 0; i < Q; i++) {
            information[td_board_part(i)] += q->own[p * Q * Q + i * (Q + 1)];
            count[td_board_part(i)]++;
        }
    for (int k = 0; k < TD_BOARD_PARTS; k++)
        sigma[k] = information[k] > 0 ? sqrt(count[k] / information[k]) : 0;
}

/* Minus twice the log of the restricted likelihood, up to a constant. */
static double deviance(const solution *s, const equations *q)
{
    return ((double)q->rows - (double)q->fitted) * log(s->noise) + s->log_det;
}

/* MacKay's fixed point: a component's variance is the sum of its squares over its effective number. Steps of
 * twice that length, while they go down, halve their number. Stops early when what it has gained since `none`
 * can no longer become significant. */
static td_status find_sigmas(double sigma[TD_BOARD_PARTS], solution *s, const equations *q, double none,
                             td_error *error)
{
    double before = INFINITY, power = 1;
    first_sigmas(sigma, q);
    for (int round = 0; round < MOST_ROUNDS; round++) {
        TD_TRY(solve_equations(s, q, sigma, error));
        double now = deviance(s, q), step = before - now;
        if (fabs(step) < SETTLED || (step < 1 && none - now < SIGNIFICANT / 2)) break;
        if (step < 0) power = 0.5;
        before = now;
        for (int k = 0; k < TD_BOARD_PARTS; k++) {
            double factor = s->effective[k] > NOTHING ? s->square[k] / (s->noise * s->effective[k]) : 0;
            sigma[k] *= pow(factor, power);
        }
    }
    return TD_OK;
}

td_status td_board_error_estimate(td_board_error *board, const td_bundle *bundle, td_error *error)
{
    equations q;
    solution none, found;
    double sigma[TD_BOARD_PARTS] = {0};
    *board = (td_board_error){.noise_share = 1};
    if (!td_target_is_flat(&bundle->observations->target)) return TD_OK;
    TD_TRY(sum_equations(&q, bundle, error));
    td_status status = TD_OK;
    if (q.poses >= FEWEST_POSES && q.rows > q.fitted) {
        status = solve_equations(&none, &q, sigma, error);
        if (status == TD_OK) status = find_sigmas(sigma, &found, &q, deviance(&none, &q), error);
        double dof = (double)q.rows - (double)q.fitted;
        double gain =
            status == TD_OK ? dof * log(none.noise / found.noise) + none.log_det - found.log_det : 0;
        board->gain = gain;
        if (gain > SIGNIFICANT) {
            double rms[TD_BOARD_PARTS];
            for (int k = 0; k < TD_BOARD_PARTS; k++) rms[k] = sigma[k] * sqrt(found.noise * shapes_of(k));
            *board = (td_board_error){true, rms[0], rms[1], rms[2], rms[3], found.noise, gain};
        }
    }
    free_equations(&q);
    return status;
}
