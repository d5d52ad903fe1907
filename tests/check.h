/* What every unit test needs: cmocka, and assertions that print what they compared. */
#ifndef TELEDIMOS_TESTS_CHECK_H
#define TELEDIMOS_TESTS_CHECK_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* |a - b| <= tolerance; NaN fails. */
#define check_near(a, b, tolerance)                                                                          \
    do {                                                                                                     \
        double a_ = (a), b_ = (b), t_ = (tolerance);                                                         \
        if (!(fabs(a_ - b_) <= t_))                                                                          \
            fail_msg("%s = %.17g, %s = %.17g, apart by %.3g > %.3g", #a, a_, #b, b_, fabs(a_ - b_), t_);     \
    } while (0)

#define check_less(a, b)                                                                                     \
    do {                                                                                                     \
        double a_ = (a), b_ = (b);                                                                           \
        if (!(a_ < b_)) fail_msg("%s = %.17g is not less than %s = %.17g", #a, a_, #b, b_);                  \
    } while (0)

/* Prints the library's sentence when a call fails. */
#define check_ok(call, error)                                                                                \
    do {                                                                                                     \
        td_status s_ = (call);                                                                               \
        if (s_ != TD_OK) fail_msg("%s: %s: %s", #call, td_status_text(s_), (error).message);                 \
    } while (0)

/* The call fails with this status, and its sentence holds `words`. */
#define check_fails(call, expected, error, words)                                                            \
    do {                                                                                                     \
        td_status s_ = (call);                                                                               \
        if (s_ != (expected))                                                                                \
            fail_msg("%s: status '%s' instead of '%s'", #call, td_status_text(s_),                           \
                     td_status_text(expected));                                                              \
        if (!strstr((error).message, words)) fail_msg("'%s' lacks '%s'", (error).message, words);            \
    } while (0)

/* Leaves a test of figures out of the sanitized run: it runs the same lines many times over, and the optimised
 * run judges the figures. */
#ifdef __SANITIZE_ADDRESS__
#define check_statistics() skip()
#else
#define check_statistics() (void)0
#endif

#endif
