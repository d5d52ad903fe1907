/* Proves that each mistake of convention, put into simulated views with noise, is named first and named
 * alone, and that none is ever named of correct views. References: the mistake that was put in. The noise is
 * that of real robots and ten times more. Blind to two mistakes at once, and to motions that hide a mistake
 * (a robot that only turns on the spot hides its unit of length). */
#include "calib/hand_eye_mistakes.h"
#include "tests/calib/hand_eye_data.h"
#include "tests/calib/hand_eye_motions.h"

enum { VIEWS = 14, MOST_VIEWS = 40 };

static const double degrees = 57.29577951308232;

typedef void spoiler(td_hand_eye_view *view, size_t *count, td_random *random);

static void invert(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0; i < *count; i++) view[i].base_from_hand = td_pose_inverse(&view[i].base_from_hand);
}

static void invert_target(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0; i < *count; i++) view[i].rig_from_target = td_pose_inverse(&view[i].rig_from_target);
}

static void millimetres(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0; i < *count; i++)
        for (int k = 0; k < 3; k++) view[i].base_from_hand.t[k] *= 1000;
}

static void target_millimetres(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0; i < *count; i++)
        for (int k = 0; k < 3; k++) view[i].rig_from_target.t[k] *= 1000;
}

static void scale_turns(td_hand_eye_view *view, size_t count, double factor)
{
    for (size_t i = 0; i < count; i++) {
        double w[3];
        td_rotation_log(w, view[i].base_from_hand.q);
        for (int k = 0; k < 3; k++) w[k] *= factor;
        td_rotation_exp(view[i].base_from_hand.q, w);
    }
}

static void degrees_as_radians(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    scale_turns(view, *count, degrees);
}

static void radians_as_degrees(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    scale_turns(view, *count, 1 / degrees);
}

static void permute(td_hand_eye_view *view, size_t count, int first)
{
    for (size_t i = 0; i < count; i++) {
        double q[4];
        memcpy(q, view[i].base_from_hand.q, sizeof q);
        for (int k = 0; k < 4; k++) view[i].base_from_hand.q[k] = q[(k + first) % 4];
    }
}

static void xyzw_as_wxyz(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    permute(view, *count, 1); /* w is read where x stands */
}

static void wxyz_as_xyzw(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    permute(view, *count, 3);
}

/* Mirrored in z: S R S, S t. */
static void mirror(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0; i < *count; i++) {
        double r[9], t[3];
        td_pose_rotation(r, &view[i].base_from_hand);
        memcpy(t, view[i].base_from_hand.t, sizeof t);
        r[2] = -r[2], r[5] = -r[5], r[6] = -r[6], r[7] = -r[7], t[2] = -t[2];
        view[i].base_from_hand = td_pose_from_rotation(r, t);
    }
}

static void reverse(td_hand_eye_view *view, size_t *count, td_random *random)
{
    (void)random;
    for (size_t i = 0, j = *count - 1; i < j; i++, j--) {
        td_pose p = view[i].base_from_hand;
        view[i].base_from_hand = view[j].base_from_hand;
        view[j].base_from_hand = p;
    }
}

static void exchange(td_hand_eye_view *view, size_t *count, td_random *random)
{
    size_t i = td_random_below(random, (uint32_t)*count),
           j = (i + 1 + td_random_below(random, (uint32_t)*count - 1)) % *count;
    td_pose p = view[i].base_from_hand;
    view[i].base_from_hand = view[j].base_from_hand;
    view[j].base_from_hand = p;
}

/* The robot's list lacks one. */
static void lose_pose(td_hand_eye_view *view, size_t *count, td_random *random)
{
    size_t from = td_random_below(random, (uint32_t)*count - 5);
    for (size_t i = from; i + 1 < *count; i++) view[i].base_from_hand = view[i + 1].base_from_hand;
    --*count;
}

static void lose_image(td_hand_eye_view *view, size_t *count, td_random *random)
{
    size_t from = td_random_below(random, (uint32_t)*count - 5);
    for (size_t i = from; i + 1 < *count; i++) view[i].rig_from_target = view[i + 1].rig_from_target;
    --*count;
}

static const struct {
    const char *name;
    spoiler *spoil;
    const char *words;
} mistakes[] = {
    {"inverted", invert, "robot's poses look inverted"},
    {"target inverted", invert_target, "or the target's are (target_from_rig)"},
    {"robot in mm", millimetres, "robot's lengths look like millimetres"},
    {"target in mm", target_millimetres, "target's size looks like millimetres"},
    {"degrees as radians", degrees_as_radians, "look like degrees taken for radians"},
    {"radians as degrees", radians_as_degrees, "look like radians taken for degrees"},
    {"xyzw as wxyz", xyzw_as_wxyz, "look like x y z w read as w x y z"},
    {"wxyz as xyzw", wxyz_as_xyzw, "look like w x y z read as x y z w"},
    {"mirrored", mirror, "look mirrored"},
    {"reversed", reverse, "reverse order"},
    {"exchanged", exchange, "look exchanged"},
    {"pose lost", lose_pose, "a robot pose is missing"},
    {"image lost", lose_image, "an image is missing"},
};
enum { MISTAKES = sizeof mistakes / sizeof *mistakes };

static void test_named(void **state)
{
    (void)state;
    enum { TRIALS = 12 };
    int unnamed = 0, others = 0;
    for (int m = 0; m < MISTAKES; m++) {
        double least = INFINITY;
        for (int trial = 0; trial < TRIALS; trial++) {
            td_random random = td_random_seed(21, (uint64_t)(100 * m + trial));
            hand_eye_truth truth = random_truth(&random, (td_hand_eye_setup)(trial % 3));
            td_hand_eye_view view[VIEWS];
            size_t count = VIEWS;
            simulate_views(view, count, &truth, &random, 0.6, trial < 6 ? 0.002 : 0.01,
                           trial < 6 ? 0.001 : 0.005);
            mistakes[m].spoil(view, &count, &random);
            td_hand_eye_mistake found[TD_MAX_MISTAKES];
            size_t n = td_hand_eye_mistakes(found, truth.setup, view, count);
            if (!n || !strstr(found[0].text, mistakes[m].words)) {
                print_message("%s, trial %d: %s\n", mistakes[m].name, trial, n ? found[0].text : "nothing");
                unnamed++;
            } else {
                least = fmin(least, found[0].better);
            }
            if (n > 1) {
                print_message("%s, trial %d: also %s\n", mistakes[m].name, trial, found[1].text);
                others++;
            }
        }
        print_message("%-20s residual falls by a factor of at least %.1f\n", mistakes[m].name, least);
    }
    assert_int_equal(unnamed, 0);
    assert_int_equal(others, 0);
}

/* The other setup is the same as inverted poses, and is said so. */
static void test_other_setup(void **state)
{
    (void)state;
    for (int said = 0; said < 2; said++) {
        td_random random = td_random_seed(31, (uint64_t)said);
        hand_eye_truth truth = random_truth(&random, said ? TD_EYE_IN_HAND : TD_EYE_TO_HAND);
        td_hand_eye_view view[VIEWS];
        simulate_views(view, VIEWS, &truth, &random, 0.6, 0.005, 0.002);
        td_hand_eye_mistake found[TD_MAX_MISTAKES];
        size_t n = td_hand_eye_mistakes(found, said ? TD_EYE_TO_HAND : TD_EYE_IN_HAND, view, VIEWS);
        assert_int_equal(n, 1);
        print_message("%s\n", found[0].text);
        assert_non_null(strstr(found[0].text, said ? "the camera is in the hand" : "(eye-to-hand)"));
        assert_true(found[0].better > 10);
    }
}

/* Correct views: with little noise and much, few and many, none and an outlier, small turns and large. */
static void test_no_false_alarm(void **state)
{
    (void)state;
    check_statistics();
    const char *full = getenv("TELEDIMOS_FULL");
    int trials = full && !strcmp(full, "1") ? 5000 : 300, alarms = 0;
    for (int trial = 0; trial < trials; trial++) {
        td_random random = td_random_seed(41, (uint64_t)trial);
        static const double noise[] = {0, 1e-4, 0.002, 0.01, 0.05};
        static const size_t counts[] = {5, 6, 8, 14, 20, 40};
        hand_eye_truth truth = random_truth(&random, (td_hand_eye_setup)(trial % 3));
        td_hand_eye_view view[MOST_VIEWS];
        size_t count = counts[td_random_below(&random, trial % 10 ? 5 : 6)];
        double n = noise[td_random_below(&random, 5)], turn = 0.2 + td_random_uniform(&random);
        simulate_views(view, count, &truth, &random, turn, n, n / 2);
        if (trial % 4 == 3)
            view[td_random_below(&random, (uint32_t)count)].rig_from_target = random_pose(&random, 2, 0.5);
        if (trial % 8 == 5) view[count - 1].base_from_hand = view[count - 2].base_from_hand;
        td_hand_eye_mistake found[TD_MAX_MISTAKES];
        if (!td_hand_eye_mistakes(found, truth.setup, view, count)) continue;
        print_message("trial %d, %zu views, noise %g, turn %g: %s (%.1f)\n", trial, count, n, turn,
                      found[0].text, found[0].better);
        alarms++;
    }
    print_message("%d alarms in %d correct sets\n", alarms, trials);
    assert_int_equal(alarms, 0);
}

static void test_nothing_to_judge(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 1);
    hand_eye_truth truth = random_truth(&random, TD_EYE_IN_HAND);
    td_hand_eye_view view[VIEWS];
    td_hand_eye_mistake found[TD_MAX_MISTAKES];
    simulate_views(view, VIEWS, &truth, &random, 0.6, 0, 0);
    assert_int_equal(td_hand_eye_mistakes(found, TD_EYE_IN_HAND, view, 0), 0);
    assert_int_equal(td_hand_eye_mistakes(found, TD_EYE_TO_HAND, view, 4), 0);
    assert_int_equal(td_hand_eye_mistakes(found, TD_HAND_EYE_SETUP_COUNT, view, VIEWS), 0);
    for (size_t i = 1; i < VIEWS; i++) view[i] = view[0];
    assert_int_equal(td_hand_eye_mistakes(found, TD_EYE_IN_HAND, view, VIEWS), 0);
    view[3].base_from_hand.t[1] = NAN;
    assert_int_equal(td_hand_eye_mistakes(found, TD_EYE_IN_HAND, view, VIEWS), 0);
    for (size_t i = 0; i < VIEWS; i++) { /* motions that have nothing to do with one another */
        view[i].base_from_hand = random_pose(&random, 2, 1);
        view[i].rig_from_target = random_pose(&random, 2, 1);
    }
    assert_int_equal(td_hand_eye_mistakes(found, TD_EYE_IN_HAND, view, VIEWS), 0);
}

/* Real robots: right as they are, and each mistake named. */
static void test_real(void **state)
{
    (void)state;
    static const real_set *const sets[] = {&franka_in_hand_true, &franka_to_hand};
    for (int s = 0; s < 2; s++) {
        td_hand_eye_setup setup = s ? TD_EYE_TO_HAND : TD_EYE_IN_HAND;
        td_hand_eye_view view[REAL_VIEWS_MAX], spoiled[REAL_VIEWS_MAX];
        size_t count = read_real_set(view, sets[s]);
        td_hand_eye_mistake found[TD_MAX_MISTAKES];
        if (!count) skip();
        if (td_hand_eye_mistakes(found, setup, view, count)) fail_msg("%s", found[0].text);
        for (int m = 0; m < MISTAKES; m++) {
            td_random random = td_random_seed(51, (uint64_t)m);
            size_t left = count;
            memcpy(spoiled, view, sizeof spoiled);
            mistakes[m].spoil(spoiled, &left, &random);
            size_t n = td_hand_eye_mistakes(found, setup, spoiled, left);
            print_message("%-20s %s\n", mistakes[m].name, n ? found[0].text : "nothing");
            assert_true(n > 0 && strstr(found[0].text, mistakes[m].words));
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_named),          cmocka_unit_test(test_other_setup),
        cmocka_unit_test(test_no_false_alarm), cmocka_unit_test(test_nothing_to_judge),
        cmocka_unit_test(test_real),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
