/* What comes of an estimate: parameters, what is not told, and how the model fits. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/identification_internal.h"

enum { MOST_WEAK = 12 };

static td_status fill_parameters(td_identification *id, const td_id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const double widen = fmax(1, id->misfit * id->misfit);
    for (int a = 0; a < m->count; a++) {
        td_identified *p = id->parameter + a;
        td_id_name(p->name, m, m->column[a]);
        p->means = td_id_words(m, m->group + a * m->standard, 1e-9);
        if (!p->means) return td_id_no_memory(error);
        p->unit = td_id_unit(m, m->column[a]);
        p->value = j->beta[a];
        p->prior = m->base_prior[a];
        p->size = m->base_size[a];
        for (int b = 0; b < m->count; b++)
            id->covariance[a * m->count + b] =
                widen * j->covariance[a * m->count + b] * m->base_size[a] * m->base_size[b];
        p->sigma = sqrt(id->covariance[a * m->count + a]);
        p->told = p->sigma <= m->o.told * p->size;
    }
    return TD_OK;
}

/* "boom_mass_x + 0.4 arm_mass_x": components above 0.3 of the largest. */
static char *direction_words(const td_identification *id, const double *direction)
{
    char *text = NULL;
    size_t size = 0;
    double largest = 0;
    bool first = true;
    FILE *f = open_memstream(&text, &size);
    if (!f) return NULL;
    for (int c = 0; c < id->count; c++)
        if (fabs(direction[c]) > fabs(largest)) largest = direction[c];
    for (int c = 0; c < id->count; c++) {
        const double share = direction[c] / largest;
        if (fabs(share) < 0.3) continue;
        fprintf(f, "%s", share < 0 ? (first ? "-" : " - ") : first ? "" : " + ");
        if (share < 0.995) fprintf(f, "%.2f ", fabs(share));
        fputs(id->parameter[c].name, f);
        first = false;
    }
    fclose(f);
    return text;
}

static td_status fill_weak(td_identification *id, const td_id_job *j, td_error *error)
{
    const size_t count = (size_t)id->count;
    double *work = calloc(count * count + count, sizeof *work), *value = work + count * count;
    id->weak = calloc(MOST_WEAK, sizeof *id->weak);
    td_status status = work && id->weak ? TD_OK : td_id_no_memory(error);
    if (status == TD_OK) status = td_eigen_symmetric(value, work, j->covariance, count, error);
    for (size_t i = count; status == TD_OK && i-- > 0 && id->weak_count < MOST_WEAK;) {
        const double share = sqrt(fmax(value[i], 0)) * fmax(1, id->misfit);
        if (share <= j->m.o.told) break;
        td_weak_direction *w = id->weak + id->weak_count++;
        w->share = share;
        w->means = direction_words(id, work + i * count);
        if (!w->means) status = td_id_no_memory(error);
    }
    if (status == TD_OK) status = td_eigen_symmetric(value, NULL, j->information, count, error);
    if (status == TD_OK)
        id->condition = value[0] > 1e-13 * value[count - 1] ? sqrt(value[count - 1] / value[0]) : INFINITY;
    free(work);
    return status;
}

static td_status fill_never(td_identification *id, const td_id_model *m, td_error *error)
{
    id->never = calloc((size_t)m->standard, sizeof *id->never);
    if (!id->never) return td_id_no_memory(error);
    for (int c = 0; c < 10 * m->links; c++) {
        bool enters = false;
        for (int a = 0; a < m->count; a++) enters = enters || m->group[a * m->standard + c] != 0;
        if (!enters) td_id_name(id->never[id->never_count++], m, c);
    }
    return TD_OK;
}

static td_status fill_samples(td_identification *id, const td_id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n;
    double *rows = calloc(n * (size_t)m->count, sizeof *rows);
    if (!rows) return td_id_no_memory(error);
    for (size_t k = 0; k < n; k++)
        id->joint[k] = (td_identified_joint){.sigma_position = j->sigma[k],
                                             .sigma_rate = j->log->rate ? j->sigma_rate[k] : NAN,
                                             .sigma_force = j->sigma_force[k]};
    if (j->base_moves) memcpy(id->sigma_base, j->sigma + n, sizeof id->sigma_base);
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        td_id_state s;
        if (j->log->acceleration) {
            td_id_exact_state(&s, j, i);
        } else {
            td_id_values_at(at, j, &j->fine, td_id_basis(weight, &j->fine.spline, j->log->time_s[i]), weight);
            td_id_state_from(&s, m, at[0], at[1], at[2], j->base_moves);
        }
        td_id_rows(rows, m, &s);
        for (size_t k = 0; k < n; k++) {
            const double r =
                td_id_force_residual(j, i, (int)k, rows, id->predicted + i * n + k) * j->sigma_force[k];
            if (!j->used[i * n + k]) continue;
            id->joint[k].rms_force += r * r;
            id->joint[k].used++;
        }
    }
    for (size_t k = 0; k < n; k++)
        id->joint[k].rms_force =
            id->joint[k].used ? sqrt(id->joint[k].rms_force / (double)id->joint[k].used) : NAN;
    memcpy(id->used, j->used, j->log->count * n * sizeof *id->used);
    free(rows);
    return TD_OK;
}

td_status td_id_fill(td_identification *id, const td_id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t count = (size_t)m->count, values = j->log->count * (size_t)m->n;
    id->count = m->count;
    id->parameter = calloc(count, sizeof *id->parameter);
    id->covariance = calloc(count * count, sizeof *id->covariance);
    id->predicted = calloc(values, sizeof *id->predicted);
    id->used = calloc(values, sizeof *id->used);
    if (!id->parameter || !id->covariance || !id->predicted || !id->used) return td_id_no_memory(error);
    id->joints = m->n;
    id->samples = j->log->count;
    id->iterations = j->rounds;
    id->spline_misfit = j->log->acceleration ? 0 : td_id_spline_misfit(j);
    const double spare = (double)j->used_count - (double)m->count;
    id->misfit = spare > 0 ? sqrt(fmax(j->chi2 - j->spline_chi2, 0) / spare) : 0;
    TD_TRY(fill_parameters(id, j, error));
    TD_TRY(fill_weak(id, j, error));
    TD_TRY(fill_never(id, m, error));
    TD_TRY(fill_samples(id, j, error));
    return td_id_links(id, m, id->covariance, error);
}
