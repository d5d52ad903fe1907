/* Proves that the generator is PCG-XSH-RR 64/32 and that its distributions are what they are called.
 *
 * References: the first outputs of O'Neill's pcg32 demonstration (seed 42, stream 54); moments and
 * distribution functions of theory. Each statistic is held within 4 standard errors of its theory at a
 * million draws; seeds are fixed, so that a pass stays a pass. Blind to correlations between streams beyond
 * the first order. */
#include "core/random.h"
#include "tests/check.h"

enum { DRAWS = 1000000 };

static void test_published_sequence(void **state)
{
    (void)state;
    static const uint32_t published[] = {0xa15c02b7, 0x7b47f409, 0xba1d3330,
                                         0x83d2f293, 0xbfa4784b, 0xcbed606e};
    td_random random = td_random_seed(42, 54);
    for (int i = 0; i < 6; i++) assert_int_equal(td_random_u32(&random), published[i]);
}

static void test_replay(void **state)
{
    (void)state;
    td_random a = td_random_seed(7, 3);
    for (int i = 0; i < 1000; i++) (void)td_random_normal(&a);
    td_random b = a, other_stream = td_random_seed(7, 4), other_seed = td_random_seed(8, 3);
    int equal[2] = {0, 0};
    for (int i = 0; i < 1000; i++) {
        double drawn = td_random_normal(&a);
        assert_true(drawn == td_random_normal(&b));
        equal[0] += drawn == td_random_normal(&other_stream);
        equal[1] += drawn == td_random_normal(&other_seed);
    }
    assert_int_equal(equal[0] + equal[1], 0);
}

/* Neighbouring streams of one seed, as parallel units get them, do not follow one another. */
static void test_streams_are_uncorrelated(void **state)
{
    (void)state;
    for (uint64_t stream = 0; stream < 8; stream++) {
        td_random a = td_random_seed(1, stream), b = td_random_seed(1, stream + 1);
        double sum = 0;
        for (int i = 0; i < DRAWS / 10; i++) sum += td_random_normal(&a) * td_random_normal(&b);
        check_near(sum / (DRAWS / 10), 0, 4 / sqrt(DRAWS / 10));
    }
}

static void test_uniform(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 1);
    double sum = 0, sum2 = 0, lowest = 1, highest = 0;
    uint64_t bits = 0;
    int bin[100] = {0};
    for (int i = 0; i < DRAWS; i++) {
        double u = td_random_uniform(&random);
        assert_true(u >= 0 && u < 1);
        sum += u - 0.5;
        sum2 += (u - 0.5) * (u - 0.5);
        bin[(int)(u * 100)]++;
        bits |= (uint64_t)(u * 9007199254740992.0);
        lowest = fmin(lowest, u);
        highest = fmax(highest, u);
    }
    check_near(sum / DRAWS, 0, 4 * sqrt(1. / 12 / DRAWS));
    check_near(sum2 / DRAWS, 1. / 12, 4 * sqrt(1. / 180 / DRAWS));
    double chi2 = 0;
    for (int i = 0; i < 100; i++) chi2 += (bin[i] - DRAWS / 100.) * (bin[i] - DRAWS / 100.) / (DRAWS / 100.);
    check_near(chi2, 99, 4 * sqrt(2 * 99));
    check_less(lowest, 1e-5);
    check_less(1 - 1e-5, highest);
    assert_true(bits == 0x1fffffffffffff); /* all 53 are used */
}

static void test_below(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 2);
    for (int i = 0; i < 100; i++) assert_int_equal(td_random_below(&random, 1), 0);
    int bin[7] = {0};
    for (int i = 0; i < DRAWS; i++) {
        uint32_t drawn = td_random_below(&random, 7);
        assert_in_range(drawn, 0, 6);
        bin[drawn]++;
    }
    for (int i = 0; i < 7; i++) check_near(bin[i], DRAWS / 7., 4 * sqrt(DRAWS * 6. / 49));
    /* Three quarters of 2^32: a plain remainder would give the lowest third twice as often as the others. */
    const uint32_t bound = 0xc0000000;
    int low = 0;
    for (int i = 0; i < DRAWS; i++) {
        uint32_t drawn = td_random_below(&random, bound);
        assert_true(drawn < bound);
        low += drawn < bound / 3;
    }
    check_near(low, DRAWS / 3., 4 * sqrt(DRAWS * 2. / 9));
}

static int compare_doubles(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void test_normal(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 3);
    double *drawn = malloc(DRAWS * sizeof *drawn), moment[5] = {0}, lag = 0, distance = 0;
    for (int i = 0; i < DRAWS; i++) {
        drawn[i] = td_random_normal(&random);
        double power = 1;
        for (int k = 1; k <= 4; k++) moment[k] += (power *= drawn[i]) / DRAWS;
        if (i > 0) lag += drawn[i] * drawn[i - 1] / DRAWS;
    }
    /* Moments of a standard normal, and the variances of their estimates times the count: 1, 2, 15, 96. */
    check_near(moment[1], 0, 4 * sqrt(1. / DRAWS));
    check_near(moment[2], 1, 4 * sqrt(2. / DRAWS));
    check_near(moment[3], 0, 4 * sqrt(15. / DRAWS));
    check_near(moment[4], 3, 4 * sqrt(96. / DRAWS));
    check_near(lag, 0, 4 * sqrt(1. / DRAWS));
    /* Kolmogorov-Smirnov: 1.95/sqrt(n) is passed by one sequence in a thousand. */
    qsort(drawn, DRAWS, sizeof *drawn, compare_doubles);
    for (int i = 0; i < DRAWS; i++)
        distance = fmax(distance, fabs(0.5 * erfc(-drawn[i] / sqrt(2)) - (i + 0.5) / DRAWS));
    check_less(distance, 1.95 / sqrt(DRAWS));
    check_less(4, drawn[DRAWS - 1]);
    check_less(drawn[0], -4);
    free(drawn);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_published_sequence),
        cmocka_unit_test(test_replay),
        cmocka_unit_test(test_streams_are_uncorrelated),
        cmocka_unit_test(test_uniform),
        cmocka_unit_test(test_below),
        cmocka_unit_test(test_normal),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
