/* DART's dynamics of the zx200 on a free base. */
#ifndef TELEDIMOS_TESTS_BENCH_DYNAMICS_DART_H
#define TELEDIMOS_TESTS_BENCH_DYNAMICS_DART_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dart_dynamics dart_dynamics;

/* NULL: not readable. Gravity (0, 0, -9.81). */
dart_dynamics *dart_dynamics_read(const char *urdf);
void dart_dynamics_free(dart_dynamics *dynamics);
/* `rotation` (3,3) row-major, site_from_base; nu, acceleration and force (6+n): of the base angular before
 * linear in its own axes; acceleration is nu' (not the acceleration of the base's origin). */
void dart_dynamics_inverse(double *force, dart_dynamics *dynamics, const double *rotation, const double *q,
                           const double *nu, const double *acceleration);
void dart_dynamics_forward(double *acceleration, dart_dynamics *dynamics, const double *rotation,
                           const double *q, const double *nu, const double *force);

#ifdef __cplusplus
}
#endif
#endif
