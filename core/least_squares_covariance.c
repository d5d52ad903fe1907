/* Covariance of a solved problem.
 *
 * With the normal matrix N = J^T J split into shared (s) and local (v) parts, and N_vv block-diagonal, since
 * no residual touches two local blocks: S    = N_ss - sum_v N_sv N_vv^-1 N_vs          (Schur complement)
 *     C_ss = S^+                                      (eigenvalues; null directions returned)
 *     C_vs = -N_vv^-1 N_vs C_ss
 *     C_vw = [v = w] N_vv^-1 + N_vv^-1 N_vs C_ss N_sw N_ww^-1
 * A considered block c with covariance C_cc adds K C_cc K^T to the free shared ones, K = -S_xx^+ S_xc.
 * Common errors with gradients g move the parameters by
 *     d_s = -S_xx^+ (g_s - sum_v N_sv N_vv^-1 g_v),  d_v = -N_vv^-1 g_v - N_vv^-1 N_vs d_s
 * and add d d^T. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/least_squares_internal.h"
#include "core/linalg.h"

/* Curvature, each parameter scaled to unit curvature with the local blocks held, below which a direction
 * counts as null. */
#define NULL_CURVATURE 1e-13

typedef struct local_part {
    int size;         /* free components */
    double *inverse;  /* N_vv^-1 (size,size) */
    double *coupling; /* N_vs (size,n), then N_vv^-1 N_vs */
} local_part;

/* Common errors: the shared columns' moves, and the local blocks' moves while the shared ones stay. */
typedef struct common_group {
    size_t count;
    double *shared; /* (n,count) */
    size_t local_count;
    int *block;     /* (local_count) */
    double **local; /* (local_count) (free components,count) */
} common_group;

struct td_covariance {
    size_t block_count;
    td_block *block;
    size_t *offset;                   /* (block_count) first shared column of a shared block */
    local_part *local;                /* (block_count) */
    int (*column)[TD_MAX_BLOCK_SIZE]; /* (block_count) component to free component, -1: held */
    size_t n;                         /* shared columns */
    double *shared;                   /* N_ss, then S, then C_ss (n,n) */
    double *inverse;                  /* S_xx^+ (n,n), 0 for considered columns */
    size_t group_count;
    common_group *group;
    double *scale; /* (n) 1/sqrt of N_ss' diagonal */
    size_t null_count;
    double *null; /* (null_count,n) */
    double chi2;
    size_t rows, parameters;
};

static void free_group(common_group *group)
{
    for (size_t i = 0; group->local && i < group->local_count; i++) free(group->local[i]);
    free(group->shared);
    free(group->block);
    free(group->local);
}

void td_covariance_free(td_covariance **covariance)
{
    if (!covariance || !*covariance) return;
    td_covariance *c = *covariance;
    if (c->local)
        for (size_t i = 0; i < c->block_count; i++) {
            free(c->local[i].inverse);
            free(c->local[i].coupling);
        }
    free(c->block);
    free(c->offset);
    free(c->local);
    free(c->column);
    for (size_t i = 0; i < c->group_count; i++) free_group(&c->group[i]);
    free(c->group);
    free(c->shared);
    free(c->inverse);
    free(c->scale);
    free(c->null);
    free(c);
    *covariance = NULL;
}

/* Numbers the free components; considered blocks count as free here. */
static td_status lay_out(td_covariance *c, const td_problem *problem, const td_consider *consider,
                         size_t consider_count, td_error *error)
{
    c->block_count = problem->block_count;
    size_t count = c->block_count ? c->block_count : 1;
    c->block = malloc(count * sizeof *c->block);
    c->offset = calloc(count, sizeof *c->offset);
    c->local = calloc(count, sizeof *c->local);
    c->column = malloc(count * sizeof *c->column);
    if (!c->block || !c->offset || !c->local || !c->column)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    memcpy(c->block, problem->block, c->block_count * sizeof *c->block);
    for (size_t i = 0; i < consider_count; i++) {
        int b = consider[i].block;
        if (b < 0 || (size_t)b >= c->block_count || c->block[b].local)
            return td_fail(error, TD_ERROR_ARGUMENT, "considered block %d: must be a shared block", b);
        c->block[b].held = false;
        c->block[b].held_components = 0;
    }
    for (size_t i = 0; i < c->block_count; i++) {
        int free_components = 0;
        for (int k = 0; k < c->block[i].tangent; k++)
            c->column[i][k] = td_block_component_free(&c->block[i], k) ? free_components++ : -1;
        c->parameters += (size_t)free_components;
        if (c->block[i].local) {
            c->local[i].size = free_components;
        } else {
            c->offset[i] = c->n;
            c->n += (size_t)free_components;
        }
    }
    c->shared = calloc(c->n * c->n + 1, sizeof *c->shared);
    c->inverse = calloc(c->n * c->n + 1, sizeof *c->inverse);
    c->scale = calloc(c->n + 1, sizeof *c->scale);
    bool enough = c->shared && c->inverse && c->scale;
    for (size_t i = 0; i < c->block_count && enough; i++) {
        if (!c->local[i].size) continue;
        size_t size = (size_t)c->local[i].size;
        c->local[i].inverse = calloc(size * size, sizeof(double));
        c->local[i].coupling = calloc(size * c->n + 1, sizeof(double));
        enough = c->local[i].inverse && c->local[i].coupling;
    }
    return enough ? TD_OK
                  : td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu parameters", c->n);
}

/* Where the product of components of blocks a and b belongs in N; NULL: nowhere (held, or the mirrored half).
 */
static double *normal_element(td_covariance *c, int a, int i, int b, int k)
{
    int row = c->column[a][i], column = c->column[b][k];
    if (row < 0 || column < 0) return NULL;
    if (c->block[a].local)
        return c->block[b].local ? &c->local[a].inverse[row * c->local[a].size + column]
                                 : &c->local[a].coupling[(size_t)row * c->n + c->offset[b] + (size_t)column];
    if (c->block[b].local) return NULL;
    return &c->shared[(c->offset[a] + (size_t)row) * c->n + c->offset[b] + (size_t)column];
}

/* Adds one residual's J^T J. */
static void add_normal(td_covariance *c, const td_residual *r, double *const *jacobian)
{
    for (int a = 0; a < r->block_count; a++)
        for (int b = 0; b < r->block_count; b++) {
            int ta = c->block[r->block[a]].tangent, tb = c->block[r->block[b]].tangent;
            for (int i = 0; i < ta; i++)
                for (int k = 0; k < tb; k++) {
                    double *element = normal_element(c, r->block[a], i, r->block[b], k);
                    if (!element) continue;
                    double sum = 0;
                    for (int row = 0; row < r->rows; row++)
                        sum += jacobian[a][row * ta + i] * jacobian[b][row * tb + k];
                    *element += sum;
                }
        }
}

static td_status accumulate(td_covariance *c, const td_problem *problem, td_error *error)
{
    size_t block_size = (size_t)problem->max_rows * TD_MAX_BLOCK_SIZE;
    double *work =
        malloc((block_size * TD_MAX_RESIDUAL_BLOCKS + (size_t)problem->max_rows + 1) * sizeof *work);
    if (!work)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for Jacobians of %d rows", problem->max_rows);
    double *jacobian[TD_MAX_RESIDUAL_BLOCKS], *out = work + block_size * TD_MAX_RESIDUAL_BLOCKS;
    for (int i = 0; i < TD_MAX_RESIDUAL_BLOCKS; i++) jacobian[i] = work + (size_t)i * block_size;

    td_status status = TD_OK;
    for (size_t i = 0; i < problem->residual_count && status == TD_OK; i++) {
        const td_residual *r = &problem->residual[i];
        const double *value[TD_MAX_RESIDUAL_BLOCKS];
        for (int k = 0; k < r->block_count; k++) value[k] = problem->block[r->block[k]].value;
        if (!td_residual_evaluate(problem, r, out, jacobian, value)) {
            status = td_fail(error, TD_ERROR_DATA, "covariance: residual %zu cannot be evaluated", i);
            break;
        }
        add_normal(c, r, jacobian);
        c->rows += (size_t)r->rows;
        for (int k = 0; k < r->rows; k++) c->chi2 += out[k] * out[k];
    }
    free(work);
    return status;
}

/* Inverts N_vv and subtracts its part from S. */
static td_status eliminate(td_covariance *c, td_error *error)
{
    size_t n = c->n;
    for (size_t i = 0; i < n; i++)
        c->scale[i] = c->shared[i * (n + 1)] > 0 ? 1 / sqrt(c->shared[i * (n + 1)]) : 1;
    for (size_t v = 0; v < c->block_count; v++) {
        local_part *l = &c->local[v];
        if (!l->size) continue;
        size_t size = (size_t)l->size;
        double *solved = malloc((size * n + 1) * sizeof *solved);
        if (!solved) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
        td_status status = td_invert_spd(l->inverse, l->inverse, size, error);
        if (status != TD_OK) {
            free(solved);
            return td_fail(error, TD_ERROR_DATA,
                           "covariance: local block %zu is not determined by its residuals", v);
        }
        if (n) td_multiply(solved, l->inverse, l->coupling, size, size, n);
        for (size_t i = 0; i < size; i++)
            for (size_t a = 0; a < n; a++) {
                double x = l->coupling[i * n + a];
                if (x == 0) continue;
                for (size_t b = 0; b < n; b++) c->shared[a * n + b] -= x * solved[i * n + b];
            }
        free(l->coupling);
        l->coupling = solved;
    }
    return TD_OK;
}

/* out (n,n) = pseudo-inverse of the symmetric s; null directions are appended to c. Works in place. */
static td_status pseudo_inverse(double *out, td_covariance *c, const double *s, size_t n,
                                const size_t *global, td_error *error)
{
    if (!n) return TD_OK;
    double *work = malloc((2 * n * n + 2 * n) * sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu parameters", n);
    double *scaled = work, *vector = work + n * n, *value = vector + n * n, *d = value + n;
    for (size_t i = 0; i < n; i++) d[i] = c->scale[global[i]];
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) scaled[i * n + j] = s[i * n + j] * d[i] * d[j];
    td_status status = td_eigen_symmetric(value, vector, scaled, n, error);
    memset(out, 0, n * n * sizeof *out);
    for (size_t k = 0; k < n && status == TD_OK; k++) {
        const double *v = vector + k * n;
        if (value[k] > NULL_CURVATURE) {
            for (size_t i = 0; i < n; i++)
                for (size_t j = 0; j < n; j++) out[i * n + j] += v[i] * v[j] / value[k] * d[i] * d[j];
            continue;
        }
        double *grown = realloc(c->null, (c->null_count + 1) * c->n * sizeof *grown);
        if (!grown) {
            status = td_fail(error, TD_ERROR_MEMORY, "no memory for null directions");
            break;
        }
        c->null = grown;
        double *direction = grown + c->null_count++ * c->n;
        memset(direction, 0, c->n * sizeof *direction);
        for (size_t i = 0; i < n; i++) direction[global[i]] = v[i] * d[i];
    }
    free(work);
    return status;
}

/* Splits the shared columns into free ones (x) and considered ones (c), inverts S_xx and adds the considered
 * part. */
static td_status invert_shared(td_covariance *c, const td_consider *consider, size_t consider_count,
                               td_error *error)
{
    size_t n = c->n, nx = 0, nc = 0;
    size_t *index = malloc((2 * n + 1) * sizeof *index);
    double *work = calloc(5 * n * n + 1, sizeof *work);
    bool *considered = calloc(n + 1, sizeof *considered);
    td_status status = TD_OK;
    if (!index || !work || !considered) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu parameters", n);
        goto done;
    }
    double *cc = work, *sxx = work + n * n, *k = sxx + n * n, *sxc = k + n * n, *kc = sxc + n * n;
    for (size_t i = 0; i < consider_count; i++) {
        const td_block *b = &c->block[consider[i].block];
        size_t offset = c->offset[consider[i].block];
        const int *column = c->column[consider[i].block];
        for (int p = 0; p < b->tangent; p++)
            for (int q = 0; q < b->tangent; q++)
                if (column[p] >= 0 && column[q] >= 0) {
                    considered[offset + (size_t)column[p]] = true;
                    cc[(offset + (size_t)column[p]) * n + offset + (size_t)column[q]] =
                        consider[i].covariance[p * b->tangent + q];
                }
    }
    for (size_t i = 0; i < n; i++)
        if (!considered[i]) index[nx++] = i;
    for (size_t i = 0; i < n; i++)
        if (considered[i]) index[nx + nc++] = i;
    for (size_t i = 0; i < nx; i++)
        for (size_t j = 0; j < nx; j++) sxx[i * nx + j] = c->shared[index[i] * n + index[j]];
    for (size_t i = 0; i < nx; i++)
        for (size_t j = 0; j < nc; j++) sxc[i * nc + j] = c->shared[index[i] * n + index[nx + j]];
    status = pseudo_inverse(sxx, c, sxx, nx, index, error);
    if (status != TD_OK) goto done;

    memset(c->shared, 0, n * n * sizeof *c->shared);
    for (size_t i = 0; i < nx; i++)
        for (size_t j = 0; j < nx; j++)
            c->shared[index[i] * n + index[j]] = c->inverse[index[i] * n + index[j]] = sxx[i * nx + j];
    if (nc && nx) {
        /* K = -S_xx^+ S_xc; C_xc = K C_cc; C_xx += C_xc K^T */
        td_multiply(k, sxx, sxc, nx, nx, nc);
        double *compact = sxc;
        for (size_t i = 0; i < nx * nc; i++) k[i] = -k[i];
        for (size_t i = 0; i < nc; i++)
            for (size_t j = 0; j < nc; j++) compact[i * nc + j] = cc[index[nx + i] * n + index[nx + j]];
        td_multiply(kc, k, compact, nx, nc, nc);
        td_multiply_transposed(sxx, kc, k, nx, nc, nx);
        for (size_t i = 0; i < nx; i++) {
            for (size_t j = 0; j < nx; j++) c->shared[index[i] * n + index[j]] += sxx[i * nx + j];
            for (size_t j = 0; j < nc; j++)
                c->shared[index[i] * n + index[nx + j]] = c->shared[index[nx + j] * n + index[i]] =
                    kc[i * nc + j];
        }
    }
    for (size_t i = 0; i < nc; i++)
        for (size_t j = 0; j < nc; j++)
            c->shared[index[nx + i] * n + index[nx + j]] = cc[index[nx + i] * n + index[nx + j]];
    c->parameters -= nc;
done:
    free(index);
    free(work);
    free(considered);
    return status;
}

td_status td_problem_covariance(td_covariance **covariance, const td_problem *problem,
                                const td_consider *consider, size_t consider_count, td_error *error)
{
    *covariance = NULL;
    td_covariance *c = calloc(1, sizeof *c);
    if (!c) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    td_status status = lay_out(c, problem, consider, consider_count, error);
    if (status == TD_OK) status = accumulate(c, problem, error);
    if (status == TD_OK) status = eliminate(c, error);
    if (status == TD_OK) status = invert_shared(c, consider, consider_count, error);
    if (status == TD_OK)
        *covariance = c;
    else
        td_covariance_free(&c);
    return status;
}

/* out (free components,count) of a block's gradient (t,count). */
static void take_gradient(double *out, const td_covariance *c, const td_common_error *part, size_t count)
{
    for (int i = 0; i < c->block[part->block].tangent; i++)
        if (c->column[part->block][i] >= 0)
            memcpy(out + (size_t)c->column[part->block][i] * count, part->gradient + (size_t)i * count,
                   count * sizeof *out);
}

/* `right` (n,count) gets -(g_s - sum_v N_sv N_vv^-1 g_v). */
static td_status common_right(common_group *group, double *right, const td_covariance *c,
                              const td_common_error *part, size_t part_count, td_error *error)
{
    size_t n = c->n, count = group->count;
    for (size_t p = 0; p < part_count; p++) {
        int b = part[p].block;
        if (b < 0 || (size_t)b >= c->block_count)
            return td_fail(error, TD_ERROR_ARGUMENT, "common errors: there is no block %d", b);
        if (!c->block[b].local) {
            take_gradient(right + c->offset[b] * count, c, &part[p], count);
            continue;
        }
        size_t size = (size_t)c->local[b].size;
        if (!size) continue;
        double *own = calloc(2 * size * count, sizeof *own);
        if (!own) return td_fail(error, TD_ERROR_MEMORY, "no memory for common errors");
        take_gradient(own + size * count, c, &part[p], count);
        td_multiply(own, c->local[b].inverse, own + size * count, size, size, count);
        group->block[group->local_count] = b;
        group->local[group->local_count++] = own;
    }
    for (size_t i = 0; i < n * count; i++) right[i] = -right[i];
    for (size_t p = 0; p < group->local_count; p++) {
        const local_part *l = &c->local[group->block[p]];
        size_t size = (size_t)l->size;
        /* N_sv N_vv^-1 g_v: the coupling holds N_vv^-1 N_vs, so its transpose times g_v itself. */
        const double *g = group->local[p] + size * count;
        for (size_t i = 0; i < size; i++)
            for (size_t a = 0; a < n; a++) {
                double x = l->coupling[i * n + a];
                for (size_t k = 0; k < count; k++) right[a * count + k] += x * g[i * count + k];
            }
        for (size_t i = 0; i < size * count; i++) group->local[p][i] = -group->local[p][i];
    }
    return TD_OK;
}

td_status td_covariance_add_common(td_covariance *c, size_t count, const td_common_error *part,
                                   size_t part_count, td_error *error)
{
    common_group *grown = realloc(c->group, (c->group_count + 1) * sizeof *grown);
    if (!grown) return td_fail(error, TD_ERROR_MEMORY, "no memory for common errors");
    c->group = grown;
    common_group g = {.count = count};
    double *right = calloc(c->n * count + 1, sizeof *right);
    g.shared = calloc(c->n * count + 1, sizeof *g.shared);
    g.block = calloc(part_count + 1, sizeof *g.block);
    g.local = calloc(part_count + 1, sizeof *g.local);
    td_status status = right && g.shared && g.block && g.local
                           ? common_right(&g, right, c, part, part_count, error)
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu common errors", count);
    if (status == TD_OK && c->n && count) td_multiply(g.shared, c->inverse, right, c->n, c->n, count);
    free(right);
    if (status == TD_OK)
        c->group[c->group_count++] = g;
    else
        free_group(&g);
    return status;
}

/* out (rows,count) += part.jacobian times the block's moves under a group of common errors. */
static void add_moves(double *out, size_t rows, const td_covariance *c, const common_group *g,
                      const td_linear_part *part)
{
    const int *column = c->column[part->block];
    size_t n = c->n, count = g->count, t = (size_t)c->block[part->block].tangent;
    const double *own = NULL;
    for (size_t p = 0; p < g->local_count && !own; p++)
        if (g->block[p] == part->block) own = g->local[p];
    for (size_t r = 0; r < rows; r++)
        for (size_t i = 0; i < t; i++) {
            double j = part->jacobian[r * t + i];
            if (column[i] < 0 || j == 0) continue;
            const double *move = c->block[part->block].local
                                     ? NULL
                                     : g->shared + (c->offset[part->block] + (size_t)column[i]) * count;
            for (size_t k = 0; move && k < count; k++) out[r * count + k] += j * move[k];
            if (move) continue;
            for (size_t k = 0; own && k < count; k++)
                out[r * count + k] += j * own[(size_t)column[i] * count + k];
            const double *follow = c->local[part->block].coupling + (size_t)column[i] * n;
            for (size_t a = 0; a < n; a++)
                for (size_t k = 0; k < count; k++)
                    out[r * count + k] -= j * follow[a] * g->shared[a * count + k];
        }
}

/* out (rows_a,rows_b) += what the common errors add to the covariance of two linear functions. */
static td_status add_common(double *out, size_t rows_a, const td_linear_part *a, size_t count_a,
                            size_t rows_b, const td_linear_part *b, size_t count_b, const td_covariance *c,
                            td_error *error)
{
    for (size_t q = 0; q < c->group_count; q++) {
        const common_group *g = &c->group[q];
        double *work = calloc((rows_a + rows_b) * g->count + rows_a * rows_b + 1, sizeof *work);
        if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for common errors");
        double *of_b = work + rows_a * g->count, *product = of_b + rows_b * g->count;
        for (size_t i = 0; i < count_a; i++) add_moves(work, rows_a, c, g, &a[i]);
        for (size_t i = 0; i < count_b; i++) add_moves(of_b, rows_b, c, g, &b[i]);
        if (g->count) td_multiply_transposed(product, work, of_b, rows_a, g->count, rows_b);
        for (size_t i = 0; i < rows_a * rows_b; i++) out[i] += product[i];
        free(work);
    }
    return TD_OK;
}

/* Element of the covariance of free components i of block a and k of block b. */
static double element(const td_covariance *c, int a, int i, int b, int k)
{
    size_t n = c->n;
    if (!c->block[a].local && !c->block[b].local)
        return c->shared[(c->offset[a] + (size_t)i) * n + c->offset[b] + (size_t)k];
    if (!c->block[a].local) return element(c, b, k, a, i);
    const double *ga = c->local[a].coupling + (size_t)i * n;
    double sum = 0;
    if (!c->block[b].local) {
        for (size_t j = 0; j < n; j++) sum -= ga[j] * c->shared[j * n + c->offset[b] + (size_t)k];
        return sum;
    }
    const double *gb = c->local[b].coupling + (size_t)k * n;
    for (size_t j = 0; j < n; j++) {
        if (ga[j] == 0) continue;
        double along = 0;
        for (size_t l = 0; l < n; l++) along += c->shared[j * n + l] * gb[l];
        sum += ga[j] * along;
    }
    if (a == b) sum += c->local[a].inverse[i * c->local[a].size + k];
    return sum;
}

td_status td_covariance_get(double *out, const td_covariance *c, int a, int b, td_error *error)
{
    if (a < 0 || b < 0 || (size_t)a >= c->block_count || (size_t)b >= c->block_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "covariance of blocks %d and %d: no such block", a, b);
    int ta = c->block[a].tangent, tb = c->block[b].tangent;
    for (int i = 0; i < ta; i++)
        for (int k = 0; k < tb; k++) {
            int ia = c->column[a][i], kb = c->column[b][k];
            out[i * tb + k] = ia < 0 || kb < 0 ? 0 : element(c, a, ia, b, kb);
        }
    if (!c->group_count) return TD_OK;
    double unit[2][TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE] = {{0}};
    for (int i = 0; i < ta; i++) unit[0][i * (ta + 1)] = 1;
    for (int i = 0; i < tb; i++) unit[1][i * (tb + 1)] = 1;
    const td_linear_part of_a = {a, unit[0]}, of_b = {b, unit[1]};
    return add_common(out, (size_t)ta, &of_a, 1, (size_t)tb, &of_b, 1, c, error);
}

/* With y = G_s s + sum_v G_v v and v = -N_vv^-1 N_vs s + e_v, cov e_v = N_vv^-1:
 * y = F s + sum_v G_v e_v, F = G_s - sum_v G_v N_vv^-1 N_vs, so cov y = F C_ss F^T + sum_v G_v N_vv^-1 G_v^T.
 */
static void add_part(double *f, double *out, size_t rows, const td_covariance *c, const td_linear_part *part)
{
    const td_block *block = &c->block[part->block];
    const local_part *l = &c->local[part->block];
    const int *column = c->column[part->block];
    size_t n = c->n, t = (size_t)block->tangent;
    for (size_t r = 0; r < rows; r++)
        for (size_t i = 0; i < t; i++) {
            double g = part->jacobian[r * t + i];
            if (column[i] < 0 || g == 0) continue;
            if (!block->local) {
                f[r * n + c->offset[part->block] + (size_t)column[i]] += g;
                continue;
            }
            const double *row = l->coupling + (size_t)column[i] * n;
            for (size_t k = 0; k < n; k++) f[r * n + k] -= g * row[k];
            for (size_t q = 0; q < rows; q++)
                for (size_t k = 0; k < t; k++)
                    if (column[k] >= 0)
                        out[r * rows + q] +=
                            g * l->inverse[column[i] * l->size + column[k]] * part->jacobian[q * t + k];
        }
}

td_status td_covariance_propagate(double *out, size_t rows, const td_covariance *c,
                                  const td_linear_part *part, size_t count, td_error *error)
{
    double *f = calloc(2 * rows * c->n + rows * rows + 1, sizeof *f);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu rows", rows);
    double *fc = f + rows * c->n, *shared = fc + rows * c->n;
    td_status status = TD_OK;
    memset(out, 0, rows * rows * sizeof *out);
    for (size_t i = 0; i < count && status == TD_OK; i++) {
        if (part[i].block < 0 || (size_t)part[i].block >= c->block_count)
            status = td_fail(error, TD_ERROR_ARGUMENT, "covariance: there is no block %d", part[i].block);
        else
            add_part(f, out, rows, c, &part[i]);
    }
    if (status == TD_OK && c->n) {
        td_multiply(fc, f, c->shared, rows, c->n, c->n);
        td_multiply_transposed(shared, fc, f, rows, c->n, rows);
        for (size_t i = 0; i < rows * rows; i++) out[i] += shared[i];
    }
    if (status == TD_OK) status = add_common(out, rows, part, count, rows, part, count, c, error);
    /* Products of matrices are symmetric only up to rounding. */
    for (size_t i = 0; i < rows; i++)
        for (size_t k = 0; k < i; k++)
            out[i * rows + k] = out[k * rows + i] = (out[i * rows + k] + out[k * rows + i]) / 2;
    free(f);
    return status;
}

size_t td_covariance_null_count(const td_covariance *c)
{
    return c->null_count;
}

double td_covariance_null_direction(const td_covariance *c, size_t index, int block, int component)
{
    if (index >= c->null_count || block < 0 || (size_t)block >= c->block_count || c->block[block].local)
        return 0;
    int column = c->column[block][component];
    return column < 0 ? 0 : c->null[index * c->n + c->offset[block] + (size_t)column];
}

double td_covariance_chi2(const td_covariance *c)
{
    return c->chi2;
}

size_t td_covariance_rows(const td_covariance *c)
{
    return c->rows;
}

size_t td_covariance_free_parameters(const td_covariance *c)
{
    return c->parameters - c->null_count;
}
