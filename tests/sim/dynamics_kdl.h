/* KDL's dynamics of the zx200 with its free base emulated by six joints: x, y, z, then turns about z, y, x.
 */
#ifndef TELEDIMOS_TESTS_DYNAMICS_KDL_H
#define TELEDIMOS_TESTS_DYNAMICS_KDL_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct kdl_dynamics kdl_dynamics;

/* NULL: not readable. Gravity (0, 0, -9.81). */
kdl_dynamics *kdl_dynamics_read(const char *urdf);
void kdl_dynamics_free(kdl_dynamics *dynamics);
/* All of 6 + n; 0: failed. */
int kdl_dynamics_inverse(double *force, kdl_dynamics *dynamics, const double *q, const double *dq,
                         const double *ddq);
int kdl_dynamics_forward(double *ddq, kdl_dynamics *dynamics, const double *q, const double *dq,
                         const double *force);
int kdl_dynamics_mass(double *mass, kdl_dynamics *dynamics, const double *q);

#ifdef __cplusplus
}
#endif
#endif
