#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/clearance_internal.h"

typedef struct selection {
    const clearance_integral *in;
    double *correlation; /* by whole cells along one axis */
    int reach;
    double *score;   /* (count): bound on P(this one < 0, no chosen one < 0); negative: chosen */
    double *closest; /* (count): the highest correlation with a chosen one */
} selection;

static double upper_tail(double x)
{
    return 0.5 * erfc(x * 0.7071067811865476);
}

/* x with upper_tail(x) = p, 0 < p < 1: Newton with Halley's term on the logarithm from a rational first value
 * (Abramowitz and Stegun 26.2.23). */
static double from_upper_tail(double p)
{
    const double q = p < 0.5 ? p : 1 - p;
    if (q < DBL_MIN) return p < 0.5 ? 38 : -38;
    const double t = sqrt(-2 * log(q));
    double x =
        t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1 + t * (1.432788 + t * (0.189269 + t * 0.001308)));
    const double density = 0.3989422804014327 * exp(-0.5 * x * x);
    const double step = density > 0 ? (upper_tail(x) - q) / density : 0;
    x += step / (1 - 0.5 * x * step);
    return p < 0.5 ? x : -x;
}

static double along(const selection *c, int cells)
{
    const int apart = abs(cells);
    return apart < c->reach ? c->correlation[apart] : 0;
}

static double ground_covariance(const selection *c, const clearance_margin *a, const clearance_margin *b)
{
    const int dx = b->column - a->column, dy = b->row - a->row;
    double sum = 0;
    if (abs(dx) > c->reach || abs(dy) > c->reach) return 0;
    for (int i = 0; i < 4; i++) {
        if (a->ground[i] == 0) continue;
        for (int j = 0; j < 4; j++) {
            if (b->ground[j] == 0) continue;
            sum += a->ground[i] * b->ground[j] * along(c, dx + (j & 1) - (i & 1)) *
                   along(c, dy + (j >> 1) - (i >> 1));
        }
    }
    return sum;
}

static double covariance(const selection *c, const clearance_margin *a, const clearance_margin *b)
{
    double sum = a->up * b->up * ground_covariance(c, a, b), reading = 0, share = 0;
    for (int k = 0; k < c->in->common_count; k++) sum += a->common[k] * b->common[k];
    if (c->in->joints == 0) return sum;
    if (a->knot == b->knot)
        share = (1 - a->part) * (1 - b->part) + a->part * b->part;
    else if (a->knot + 1 == b->knot)
        share = a->part * (1 - b->part);
    else if (b->knot + 1 == a->knot)
        share = b->part * (1 - a->part);
    if (share == 0) return sum;
    for (int k = 0; k < c->in->joints; k++) reading += a->reading[k] * b->reading[k];
    return sum + share * reading;
}

static double z_of(const selection *c, size_t i)
{
    return c->in->margin[i].mean / sqrt(c->in->margin[i].variance);
}

/* P(x < 0, y > 0) of two margins with means a and b over their sigma, correlation rho > 0: over y - b = t,
 * phi(t) Phi(-(a + rho t) / sqrt(1 - rho^2)), Gauss and Legendre's six points. */
static double misses(double a, double b, double rho)
{
    static const double node[3] = {0.2386191860831969, 0.6612093864662645, 0.9324695142031521};
    static const double weight[3] = {0.4679139345726910, 0.3607615730481386, 0.1713244923791704};
    const double rest = sqrt(fmax(1 - rho * rho, 1e-12));
    const double low = fmax(-b, -6), high = fmin(6, (5 * rest - a) / rho);
    const double half = 0.5 * (high - low), middle = 0.5 * (high + low);
    double sum = 0;
    if (!(high > low)) return 0;
    for (int k = 0; k < 6; k++) {
        const double t = middle + (k & 1 ? half : -half) * node[k / 2];
        sum += weight[k / 2] * exp(-0.5 * t * t) * upper_tail((a + rho * t) / rest);
    }
    return 0.3989422804014327 * half * sum;
}

/* Margin `at` is chosen: what it says of the others. */
static void take(selection *c, size_t at)
{
    const double z = z_of(c, at);
    c->score[at] = -1;
    for (size_t i = 0; i < c->in->count; i++) {
        if (c->score[i] < 0) continue;
        const clearance_margin *a = c->in->margin + i, *b = c->in->margin + at;
        const double both = covariance(c, a, b), rho = both / sqrt(a->variance * b->variance);
        if (!(rho > 0.5 && rho > c->closest[i])) continue;
        c->closest[i] = rho;
        c->score[i] = fmin(c->score[i], misses(z_of(c, i), z, rho));
    }
}

/* One after the other the margin that most probably is negative when none of those before is. */
static int choose(size_t *chosen, double *left_out, selection *c)
{
    for (size_t i = 0; i < c->in->count; i++) {
        c->score[i] = upper_tail(z_of(c, i));
        c->closest[i] = 0;
    }
    for (int k = 0;; k++) {
        size_t best = c->in->count;
        double most = -1;
        *left_out = 0;
        for (size_t i = 0; i < c->in->count; i++) {
            if (c->score[i] < 0) continue;
            *left_out += c->score[i];
            if (c->score[i] > most) {
                most = c->score[i];
                best = i;
            }
        }
        if (best == c->in->count || *left_out < 1e-4 || k == c->in->points) return k;
        chosen[k] = best;
        take(c, best);
    }
}

static td_status make_correlation(selection *c, td_error *error)
{
    const double length = c->in->correlation_cells;
    c->reach = (int)fmin(ceil(5 * length), 1 << 20) + 1;
    c->correlation = malloc((size_t)c->reach * sizeof *c->correlation);
    if (!c->correlation) return td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact");
    for (int k = 0; k < c->reach; k++) c->correlation[k] = k ? exp(-(double)k * k / (length * length)) : 1;
    return TD_OK;
}

td_status clearance_choose(size_t *chosen, int *points, double *left_out, const clearance_integral *in,
                           td_error *error)
{
    selection c = {.in = in};
    *points = 0;
    *left_out = 0;
    if (in->count == 0) return TD_OK;
    td_status status = make_correlation(&c, error);
    c.score = malloc(2 * in->count * sizeof *c.score);
    if (status == TD_OK && !c.score)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact of %zu points",
                         in->count);
    if (status == TD_OK) {
        c.closest = c.score + in->count;
        *points = choose(chosen, left_out, &c);
    }
    free(c.correlation);
    free(c.score);
    return status;
}

/* ---- the integral ---- */

typedef struct integrand {
    const clearance_integral *in;
    const clearance_contact *contact; /* (points) */
    const size_t *chosen;
    int points;
    double *factor; /* (points, points): of the ground's rise at the contacts */
    double *gap;    /* (points) */
    double *y;      /* (points) */
    double *noise;  /* (knots, joints) */
    double mirror[CLEARANCE_COMMON], spread;
} integrand;

/* Cholesky's factor of the rises' covariance. A rise that others determine keeps a millionth of its own. */
static void factorise(integrand *f, const selection *c)
{
    for (int i = 0; i < f->points; i++) {
        double *row = f->factor + (size_t)i * (size_t)f->points;
        const clearance_margin *at = f->in->margin + f->chosen[i];
        const double variance = ground_covariance(c, at, at);
        double spare = variance;
        for (int j = 0; j < i; j++) {
            const double *other = f->factor + (size_t)j * (size_t)f->points;
            double sum = ground_covariance(c, at, f->in->margin + f->chosen[j]);
            for (int k = 0; k < j; k++) sum -= row[k] * other[k];
            row[j] = sum / other[j];
            spare -= row[j] * row[j];
        }
        row[i] = sqrt(fmax(spare, 1e-6 * variance + 1e-20));
    }
}

/* P(no contact) for common errors z (their first along the direction that matters most): gaps between shapes
 * and ground for these, then the ground's rise, one contact after the other given those before. */
static double free_at(integrand *f, double *z, const double *u)
{
    const int common = f->in->common_count;
    double along_mirror = 0, product = 1;
    int last = 0;
    for (int k = 0; k < common; k++) along_mirror += z[k] * f->mirror[k];
    for (int k = 0; k < common; k++) z[k] -= 2 * along_mirror * f->mirror[k];
    for (int i = 0; i < f->points; i++) {
        const double *g = f->in->margin[f->chosen[i]].ground;
        const double most = 6 * (fabs(g[0]) + fabs(g[1]) + fabs(g[2]) + fabs(g[3]));
        f->gap[i] = clearance_gap(f->contact + i, z, common, f->noise, f->in->joints);
        if (f->gap[i] < -most) return 0;
        if (f->gap[i] < most) last = i + 1;
    }
    for (int k = 0; k < last; k++) {
        const double *row = f->factor + (size_t)k * (size_t)f->points;
        double mean = f->gap[k];
        for (int j = 0; j < k; j++) mean += row[j] * f->y[j];
        const double tail = upper_tail(-mean / row[k]);
        product *= tail;
        if (product < 1e-9) return 0;
        f->y[k] = from_upper_tail(u[k] * tail);
    }
    return product;
}

static void roots_of_primes(double *root, int count)
{
    int found = 0;
    for (int n = 2; found < count; n++) {
        bool prime = true;
        for (int d = 2; d * d <= n && prime; d++) prime = n % d != 0;
        if (prime) root[found++] = sqrt(n);
    }
}

/* Turns the first axis into the direction by which the common errors change the most probable margin: it is
 * sampled twice as wide, with weights, so that rare contact is seen. */
static void set_mirror(integrand *f)
{
    const double *row = f->in->margin[f->chosen[0]].common;
    double length = 0, square = 0;
    for (int k = 0; k < f->in->common_count; k++) length += row[k] * row[k];
    length = sqrt(length);
    f->spread = length > 0 ? 2 : 1;
    for (int k = 0; k < f->in->common_count; k++) {
        f->mirror[k] = length > 0 ? row[k] / length - (k == 0) : 0;
        square += f->mirror[k] * f->mirror[k];
    }
    for (int k = 0; k < f->in->common_count; k++) f->mirror[k] *= square > 1e-24 ? 1 / sqrt(square) : 0;
}

/* Evenly along the first axis, along the others Richtmyer's lattice of square roots of primes, folded; under
 * eight random shifts. */
static void integrate(double *probability, double *sigma, integrand *f, double *work, int knots)
{
    enum { SHIFTS = 8 };
    const int common = f->in->common_count, dimensions = common + f->points;
    double *root = work, *shift = root + dimensions, *u = shift + dimensions;
    const int draws = (f->in->draws + SHIFTS - 1) / SHIFTS;
    double sum = 0, square = 0;
    td_random random = td_random_seed(f->in->seed, 0);
    roots_of_primes(root, dimensions);
    root[0] = 1.0 / draws;
    for (int s = 0; s < SHIFTS; s++) {
        double meets = 0, weights = 0;
        for (int k = 0; k < dimensions; k++) shift[k] = td_random_uniform(&random);
        for (int i = 1; i <= draws; i++) {
            double z[CLEARANCE_COMMON];
            for (int k = 0; k < dimensions; k++) {
                const double x = i * root[k] + shift[k];
                u[k] = k ? fabs(2 * (x - floor(x)) - 1) : x - floor(x);
            }
            for (int k = 0; k < common; k++) z[k] = from_upper_tail(u[k]);
            z[0] *= f->spread;
            const double weight = exp(-0.5 * z[0] * z[0] * (1 - 1 / (f->spread * f->spread)));
            for (int k = 0; k < knots * f->in->joints; k++) f->noise[k] = td_random_normal(&random);
            weights += weight;
            meets += weight * (1 - free_at(f, z, u + common));
        }
        sum += meets / weights;
        square += meets / weights * (meets / weights);
    }
    *probability = fmin(fmax(sum / SHIFTS, 0), 1);
    *sigma = sqrt(fmax(square - sum * sum / SHIFTS, 0) / (SHIFTS * (SHIFTS - 1)));
}

td_status clearance_integrate(double *probability, double *sigma, const clearance_integral *in,
                              const clearance_contact *contact, const size_t *chosen, int points, int knots,
                              td_error *error)
{
    const size_t n = (size_t)points, noise = (size_t)knots * (size_t)in->joints;
    selection c = {.in = in};
    *probability = *sigma = 0;
    if (points == 0) return TD_OK;
    td_status status = make_correlation(&c, error);
    double *room = malloc((n * n + 2 * n + noise + 3 * (n + CLEARANCE_COMMON)) * sizeof *room);
    if (status == TD_OK && !room)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact");
    if (status == TD_OK) {
        integrand f = {.in = in,
                       .contact = contact,
                       .chosen = chosen,
                       .points = points,
                       .factor = room,
                       .gap = room + n * n,
                       .y = room + n * n + n,
                       .noise = room + n * n + 2 * n};
        factorise(&f, &c);
        set_mirror(&f);
        integrate(probability, sigma, &f, f.noise + noise, knots);
    }
    free(c.correlation);
    free(room);
    return status;
}

double clearance_gap(const clearance_contact *contact, const double *common, int common_count,
                     const double *noise, int joints)
{
    const double *p = contact->p;
    double u[3] = {0};
    for (int k = 0; k < common_count; k++)
        for (int a = 0; a < 3; a++) u[a] += contact->move[k][a] * common[k];
    for (int k = 0; k < joints; k++) {
        const double error = (1 - contact->part) * noise[contact->knot[0] * joints + k] +
                             contact->part * noise[contact->knot[1] * joints + k];
        for (int a = 0; a < 3; a++) u[a] += contact->shake[k][a] * error;
    }
    if (!contact->patch) return clearance_underside(&contact->shape, p[0] - u[0], p[1] - u[1]) - p[2] + u[2];
    const double surface = clearance_surface(contact->ground, p[0] + u[0], p[1] + u[1]);
    return isnan(surface) ? INFINITY : p[2] + u[2] - surface;
}
