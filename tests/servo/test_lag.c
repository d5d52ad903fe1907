/* Limits of the sampled loops, servo/lag.
 *
 * Against the loops themselves, run period by period with the machine between two samples solved exactly: 2 %
 * above the least damping (or below the largest gain) a disturbance must die out, 2 % beyond it must grow, at
 * periods from a 50th to 20 times the lag, soft and stiff springs, with and without mass. 2 % is what can be
 * told apart in 20 000 periods. The calm gain: the error never crosses 0 below it, and does above it.
 *
 * Blind to: a machine that is no first-order lag (tests/sim/test_press.c has one). */
#include "tests/check.h"

#include "servo/lag.h"

static const double periods[6] = {0.001, 0.01, 0.02, 0.05, 0.2, 1};
static const double LAG_S = 0.05;

typedef struct plant {
    double x, w, v;
} plant;

/* v held over a period: w goes to it exponentially. */
static void pass(plant *p, double v, double period)
{
    const double rest = exp(-period / LAG_S);
    p->x += v * period + (p->w - v) * LAG_S * (1 - rest);
    p->w = v + (p->w - v) * rest;
    p->v = v;
}

/* Size at the end by that on the way; a millimetre that becomes 1000 km has grown. */
static double growth(double k, double m, double d, double period)
{
    plant p = {.x = 1e-3};
    double early = 0, late = 0;
    for (int i = 0; i < 20000; i++) {
        pass(&p, -(k * p.x + m * (p.v - p.w) / LAG_S) / d, period);
        const double size = fabs(p.x) + fabs(p.w) * LAG_S;
        if (i >= 5000 && i < 6000) early = fmax(early, size);
        if (i >= 19000) late = fmax(late, size);
        if (size > 1e6) return INFINITY;
        if (size < 1e-200) return 0;
    }
    return late / early;
}

static void test_damping(void **unused)
{
    static const double stiff[3] = {1e5, 1e6, 1e8}, masses[3] = {0, 500, 3000};
    (void)unused;
    for (int t = 0; t < 6; t++)
        for (int i = 0; i < 9; i++) {
            const double k = stiff[i / 3], m = masses[i % 3];
            const double d = td_lag_least_damping(k, m, periods[t], LAG_S);
            check_less(growth(k, m, 1.02 * d, periods[t]), 1);
            check_less(1, growth(k, m, 0.98 * d, periods[t]));
        }
}

static void test_gain(void **unused)
{
    (void)unused;
    for (int t = 0; t < 6; t++) {
        const double most = td_lag_stable_gain(periods[t], LAG_S);
        check_less(growth(1, 0, 1.02 / most, periods[t]), 1);
        check_less(1, growth(1, 0, 0.98 / most, periods[t]));
    }
    check_near(td_lag_stable_gain(0.1, 0), 20, 1e-9);
    check_near(td_lag_calm_gain(0.1, 0), 10, 1e-9);
    check_near(td_lag_calm_gain(1e-4, LAG_S), 1 / (4 * LAG_S), 0.01);
    check_near(td_lag_least_damping(1e6, 0, 0.02, LAG_S) * td_lag_stable_gain(0.02, LAG_S), 1e6, 1e-3);
}

static void test_calm(void **unused)
{
    (void)unused;
    for (int t = 0; t < 6; t++)
        for (int above = 0; above < 2; above++) {
            const double gain = (above ? 1.02 : 0.98) * td_lag_calm_gain(periods[t], LAG_S);
            plant p = {.x = 1};
            double lowest = 1;
            for (int i = 0; i < 20000; i++) {
                pass(&p, -gain * p.x, periods[t]);
                lowest = fmin(lowest, p.x);
            }
            assert_true(above ? lowest < -1e-60 : lowest > -1e-300);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_damping),
        cmocka_unit_test(test_gain),
        cmocka_unit_test(test_calm),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
