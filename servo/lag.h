/* How strong a sampled loop may be around a machine that follows its commands with a lag.
 *
 * Joint. Every period T the error e is measured and a rate v = K e commanded, held until the next time; the
 * machine's own rate w follows with the lag tau, tau w' = v - w, and takes the error away, e' = -w. With E =
 * exp(-T/tau), s = 1 - E, a = T - tau s and b = tau s - T E, one period is exactly
 *
 *     e+ = (1 - K a) e - tau s w,    w+ = K s e + E w,
 *
 * of trace 1 + E - K a and determinant E + K b. Jury's conditions for both poles within the unit circle are
 * K b < s and K (a - b) < 2 (1 + E); without a lag what is left is K T < 2. The poles are real, and nothing
 * swings, while (1 + E - K a)^2 >= 4 (E + K b): without a lag K T <= 1, sampled quickly K tau <= 1/4.
 *
 * Force. The tool moves at v = (f_wanted - f) / d against a spring k and carries the mass m, which whoever
 * measures behind it takes for force too: f = k x + m w', with w' = (v - w) / tau at the end of a period.
 * Then
 *
 *     z^3 + z^2 (K a + r - 1 - E) + z (E + K b - 2 r) + r = 0,    K = k / d, r = E m / (tau d),
 *
 * within the unit circle (Jury) while r < 1, K (a - b) + 4 r < 2 (1 + E), s (1 + r) - K b + K r a > 0 and
 * 1 + E + K b - r s - 2 r^2 - K r a > 0. With m = 0 these are the joint's. A stiff spring needs d > k b / s
 * (or so), a soft one with a mass d > 2 E m / (tau (1 + E)). */
#ifndef TELEDIMOS_SERVO_LAG_H
#define TELEDIMOS_SERVO_LAG_H

#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Period > 0, lag >= 0, s. K, 1/s: below the first the loop is stable, up to the second it does not swing. */
TD_API double td_lag_stable_gain(double period_s, double lag_s);
TD_API double td_lag_calm_gain(double period_s, double lag_s);
/* d, N s/m, above which the force's loop is stable. */
TD_API double td_lag_least_damping(double stiffness_n_m, double mass_kg, double period_s, double lag_s);

#ifdef __cplusplus
}
#endif
#endif
