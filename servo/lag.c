#include "servo/lag.h"

#include <math.h>

/* E, a and b of the header. */
static void sample(double *rest, double *a, double *b, double period, double lag)
{
    const double s = lag > 0 ? -expm1(-period / lag) : 1;
    *rest = 1 - s;
    *a = period - lag * s;
    *b = lag * s - *rest * period;
}

/* The smallest x > 0 where c + b x + a x^2, c > 0, is 0. */
static double first_root(double a, double b, double c)
{
    const double square = b * b - 4 * a * c;
    if (square < 0) return INFINITY;
    const double root = sqrt(square), q = b < 0 ? (-b + root) / 2 : -(b + root) / 2;
    /* The roots are q / a and c / q. */
    double least = INFINITY;
    if (q != 0 && c / q > 0) least = c / q;
    if (a != 0 && q / a > 0) least = fmin(least, q / a);
    return least;
}

double td_lag_least_damping(double stiffness_n_m, double mass_kg, double period_s, double lag_s)
{
    double rest, a, b;
    sample(&rest, &a, &b, period_s, lag_s);
    const double k = stiffness_n_m, s = 1 - rest, r = lag_s > 0 ? rest * mass_kg / lag_s : 0; /* times 1/d */
    double most = first_root(0, -r, 1);                                                       /* of 1/d */
    most = fmin(most, first_root(0, -k * (a - b) - 4 * r, 2 * (1 + rest)));
    most = fmin(most, first_root(k * r * a, s * r - k * b, s));
    most = fmin(most, first_root(-2 * r * r - k * r * a, k * b - r * s, 1 + rest));
    return 1 / most;
}

double td_lag_stable_gain(double period_s, double lag_s)
{
    return 1 / td_lag_least_damping(1, 0, period_s, lag_s);
}

/* The smaller root of a^2 K^2 - 2 (a (1 + E) + 2 b) K + s^2 = 0. */
double td_lag_calm_gain(double period_s, double lag_s)
{
    double rest, a, b;
    sample(&rest, &a, &b, period_s, lag_s);
    const double s = 1 - rest, half = a * (1 + rest) + 2 * b,
                 root = sqrt(fmax(half * half - a * a * s * s, 0));
    return s * s / (half + root);
}
