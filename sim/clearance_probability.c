#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/clearance_internal.h"

/* The margins are X = mean + L y, y of sigma 1, for those that are chosen. */
typedef struct conditioning {
    const clearance_integral *in;
    double *correlation; /* by whole cells along one axis */
    int reach;
    double *covariance; /* (count, points): of each margin with the chosen ones */
    double *factor;     /* (points, points): L, rows in the order of choice */
    double *score;      /* (count): bound on P(this one < 0, no chosen one < 0); negative: chosen */
    double *closest;    /* (count): the highest correlation with a chosen one */
    size_t *chosen;     /* (points) */
    int points;
    double left_out;
} conditioning;

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

static double along(const conditioning *c, int cells)
{
    const int apart = abs(cells);
    return apart < c->reach ? c->correlation[apart] : 0;
}

static double ground_covariance(const conditioning *c, const clearance_margin *a, const clearance_margin *b)
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

static double covariance(const conditioning *c, const clearance_margin *a, const clearance_margin *b)
{
    double sum = ground_covariance(c, a, b), reading = 0, share = 0;
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

static double z_of(const conditioning *c, size_t i)
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

/* Margin `at` becomes the k-th chosen: what it says of the others. */
static void take(conditioning *c, size_t at, int k)
{
    const double z = z_of(c, at);
    c->chosen[k] = at;
    c->score[at] = -1;
    for (size_t i = 0; i < c->in->count; i++) {
        if (c->score[i] < 0) continue;
        const clearance_margin *a = c->in->margin + i, *b = c->in->margin + at;
        const double both = covariance(c, a, b), rho = both / sqrt(a->variance * b->variance);
        c->covariance[i * (size_t)c->in->points + (size_t)k] = both;
        if (!(rho > 0.5 && rho > c->closest[i])) continue;
        c->closest[i] = rho;
        c->score[i] = fmin(c->score[i], misses(z_of(c, i), z, rho));
    }
}

/* One after the other the margin that most probably is negative when none of those before is. */
static void choose(conditioning *c)
{
    for (size_t i = 0; i < c->in->count; i++) {
        c->score[i] = upper_tail(z_of(c, i));
        c->closest[i] = 0;
    }
    for (c->points = 0;; c->points++) {
        size_t best = c->in->count;
        double most = -1;
        c->left_out = 0;
        for (size_t i = 0; i < c->in->count; i++) {
            if (c->score[i] < 0) continue;
            c->left_out += c->score[i];
            if (c->score[i] > most) {
                most = c->score[i];
                best = i;
            }
        }
        if (best == c->in->count || c->left_out < 1e-4 || c->points == c->in->points) return;
        take(c, best, c->points);
    }
}

/* Cholesky's factor. A margin that the others determine keeps a millionth of its variance. */
static void factorise(conditioning *c)
{
    const size_t columns = (size_t)c->in->points;
    for (int i = 0; i < c->points; i++) {
        double *row = c->factor + (size_t)i * columns;
        const double variance = c->in->margin[c->chosen[i]].variance;
        double spare = variance;
        for (int j = 0; j < i; j++) {
            const double *other = c->factor + (size_t)j * columns;
            double sum = c->covariance[c->chosen[i] * columns + (size_t)j];
            for (int k = 0; k < j; k++) sum -= row[k] * other[k];
            row[j] = sum / other[j];
            spare -= row[j] * row[j];
        }
        row[i] = sqrt(fmax(spare, 1e-6 * variance));
    }
}

/* P(all chosen margins > 0) at one point u in [0, 1)^points. */
static double conditioned(const conditioning *c, const double *u, double *y)
{
    double product = 1;
    for (int k = 0; k < c->points; k++) {
        const double *row = c->factor + (size_t)k * (size_t)c->in->points;
        double mean = c->in->margin[c->chosen[k]].mean;
        for (int j = 0; j < k; j++) mean += row[j] * y[j];
        const double tail = upper_tail(-mean / row[k]);
        product *= tail;
        if (product < 1e-12) return 0;
        y[k] = from_upper_tail(u[k] * tail);
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

/* Richtmyer's lattice of square roots of primes, folded, under eight random shifts. */
static void integrate(double *probability, double *sigma, const conditioning *c, double *work)
{
    enum { SHIFTS = 8 };
    double *root = work, *shift = root + c->points, *u = shift + c->points, *y = u + c->points;
    const int draws = (c->in->draws + SHIFTS - 1) / SHIFTS;
    double sum = 0, square = 0;
    td_random random = td_random_seed(c->in->seed, 0);
    roots_of_primes(root, c->points);
    for (int s = 0; s < SHIFTS; s++) {
        double free_of = 0;
        for (int k = 0; k < c->points; k++) shift[k] = td_random_uniform(&random);
        for (int i = 1; i <= draws; i++) {
            for (int k = 0; k < c->points; k++) {
                const double x = i * root[k] + shift[k];
                u[k] = fabs(2 * (x - floor(x)) - 1);
            }
            free_of += conditioned(c, u, y);
        }
        const double p = 1 - free_of / draws;
        sum += p;
        square += p * p;
    }
    *probability = fmin(fmax(sum / SHIFTS, 0), 1);
    *sigma = sqrt(fmax(square - sum * sum / SHIFTS, 0) / (SHIFTS * (SHIFTS - 1)));
}

static td_status make_correlation(conditioning *c, td_error *error)
{
    const double length = c->in->correlation_cells;
    c->reach = (int)fmin(ceil(5 * length), 1 << 20) + 1;
    c->correlation = malloc((size_t)c->reach * sizeof *c->correlation);
    if (!c->correlation) return td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact");
    for (int k = 0; k < c->reach; k++) c->correlation[k] = k ? exp(-(double)k * k / (length * length)) : 1;
    return TD_OK;
}

td_status clearance_probability(double *probability, double *sigma, double *left_out,
                                const clearance_integral *integral, td_error *error)
{
    const size_t n = integral->count, columns = (size_t)integral->points;
    conditioning c = {.in = integral};
    *probability = *sigma = *left_out = 0;
    if (n == 0) return TD_OK;
    td_status status = make_correlation(&c, error);
    double *room = malloc((n * (columns + 2) + columns * (columns + 4)) * sizeof *room);
    c.chosen = malloc(columns * sizeof *c.chosen);
    if (status == TD_OK && room && c.chosen) {
        c.covariance = room;
        c.score = c.covariance + n * columns;
        c.closest = c.score + n;
        c.factor = c.closest + n;
        choose(&c);
        factorise(&c);
        *left_out = c.left_out;
        integrate(probability, sigma, &c, c.factor + columns * columns);
    } else if (status == TD_OK) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the probability of contact of %zu points", n);
    }
    free(c.correlation);
    free(c.chosen);
    free(room);
    return status;
}
