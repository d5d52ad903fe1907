/* Initial value problems that integrators are judged by (Hairer and Wanner 1996; the test set of Mazzia and
 * Magherini, 2008), each with its Jacobian. */
#ifndef TELEDIMOS_TESTS_SIM_PROBLEMS_H
#define TELEDIMOS_TESTS_SIM_PROBLEMS_H

#include <string.h>

#include "sim/integrator.h"

typedef struct problem {
    const char *name;
    td_ode ode;
    double y0[8], t_end;
    double absolute; /* tolerance for each state, as a share of the relative one */
    double parameter;
} problem;

static inline bool van_der_pol_rate(double *d, double t, const double *y, void *user)
{
    double mu = *(const double *)user;
    (void)t;
    d[0] = y[1];
    d[1] = mu * (1 - y[0] * y[0]) * y[1] - y[0];
    return true;
}
static inline bool van_der_pol_jacobian(double *j, double t, const double *y, const double *dy, void *user)
{
    double mu = *(const double *)user;
    (void)t, (void)dy;
    j[0] = 0, j[1] = 1;
    j[2] = -2 * mu * y[0] * y[1] - 1, j[3] = mu * (1 - y[0] * y[0]);
    return true;
}

static inline bool robertson_rate(double *d, double t, const double *y, void *user)
{
    (void)t, (void)user;
    d[0] = -0.04 * y[0] + 1e4 * y[1] * y[2];
    d[2] = 3e7 * y[1] * y[1];
    d[1] = -d[0] - d[2];
    return true;
}
static inline bool robertson_jacobian(double *j, double t, const double *y, const double *dy, void *user)
{
    (void)t, (void)dy, (void)user;
    j[0] = -0.04, j[1] = 1e4 * y[2], j[2] = 1e4 * y[1];
    j[6] = 0, j[7] = 6e7 * y[1], j[8] = 0;
    for (int k = 0; k < 3; k++) j[3 + k] = -j[k] - j[6 + k];
    return true;
}

static inline bool hires_rate(double *d, double t, const double *y, void *user)
{
    (void)t, (void)user;
    d[0] = -1.71 * y[0] + 0.43 * y[1] + 8.32 * y[2] + 0.0007;
    d[1] = 1.71 * y[0] - 8.75 * y[1];
    d[2] = -10.03 * y[2] + 0.43 * y[3] + 0.035 * y[4];
    d[3] = 8.32 * y[1] + 1.71 * y[2] - 1.12 * y[3];
    d[4] = -1.745 * y[4] + 0.43 * y[5] + 0.43 * y[6];
    d[5] = -280 * y[5] * y[7] + 0.69 * y[3] + 1.71 * y[4] - 0.43 * y[5] + 0.69 * y[6];
    d[6] = 280 * y[5] * y[7] - 1.81 * y[6];
    d[7] = -d[6];
    return true;
}
static inline bool hires_jacobian(double *j, double t, const double *y, const double *dy, void *user)
{
    (void)t, (void)dy, (void)user;
    const double fixed[64] = {-1.71,  0.43, 8.32,  0, 0, 0, 0, 0,    1.71, -8.75, 0,    0, 0, 0, 0, 0, 0, 0,
                              -10.03, 0.43, 0.035, 0, 0, 0, 0, 8.32, 1.71, -1.12, 0,    0, 0, 0, 0, 0, 0, 0,
                              -1.745, 0.43, 0.43,  0, 0, 0, 0, 0.69, 1.71, -0.43, 0.69, 0, 0, 0, 0, 0, 0, 0,
                              -1.81,  0,    0,     0, 0, 0, 0, 0,    1.81, 0};
    memcpy(j, fixed, sizeof fixed);
    j[45] -= 280 * y[7], j[47] -= 280 * y[5];
    j[53] += 280 * y[7], j[55] += 280 * y[5];
    j[61] -= 280 * y[7], j[63] -= 280 * y[5];
    return true;
}

static inline bool oregonator_rate(double *d, double t, const double *y, void *user)
{
    (void)t, (void)user;
    d[0] = 77.27 * (y[1] + y[0] * (1 - 8.375e-6 * y[0] - y[1]));
    d[1] = (y[2] - (1 + y[0]) * y[1]) / 77.27;
    d[2] = 0.161 * (y[0] - y[2]);
    return true;
}
static inline bool oregonator_jacobian(double *j, double t, const double *y, const double *dy, void *user)
{
    (void)t, (void)dy, (void)user;
    j[0] = 77.27 * (1 - 2 * 8.375e-6 * y[0] - y[1]), j[1] = 77.27 * (1 - y[0]), j[2] = 0;
    j[3] = -y[1] / 77.27, j[4] = -(1 + y[0]) / 77.27, j[5] = 1 / 77.27;
    j[6] = 0.161, j[7] = 0, j[8] = -0.161;
    return true;
}

/* `p->ode.user` points into *p: it must stay where it is. */
static inline void van_der_pol(problem *p, double mu)
{
    *p = (problem){.name = "van der Pol",
                   .ode = {.size = 2, .rate = van_der_pol_rate, .jacobian = van_der_pol_jacobian},
                   .y0 = {2, 0},
                   .t_end = mu < 10 ? 20 : 2 * mu,
                   .absolute = 1,
                   .parameter = mu};
    p->ode.user = &p->parameter;
}
static inline void robertson(problem *p)
{
    *p = (problem){.name = "Robertson",
                   .ode = {.size = 3, .rate = robertson_rate, .jacobian = robertson_jacobian},
                   .y0 = {1, 0, 0},
                   .t_end = 4e5,
                   .absolute = 1e-6};
}
static inline void hires(problem *p)
{
    *p = (problem){.name = "HIRES",
                   .ode = {.size = 8, .rate = hires_rate, .jacobian = hires_jacobian},
                   .y0 = {1, 0, 0, 0, 0, 0, 0, 0.0057},
                   .t_end = 321.8122,
                   .absolute = 1e-4};
}
static inline void oregonator(problem *p)
{
    *p = (problem){.name = "Oregonator",
                   .ode = {.size = 3, .rate = oregonator_rate, .jacobian = oregonator_jacobian},
                   .y0 = {1, 2, 3},
                   .t_end = 360,
                   .absolute = 1e-2};
}

#endif
