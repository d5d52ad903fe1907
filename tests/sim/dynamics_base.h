/* A free base and its emulation by joints x, y, z and turns about z, y, x: one state in both forms. */
#ifndef TELEDIMOS_TESTS_DYNAMICS_BASE_H
#define TELEDIMOS_TESTS_DYNAMICS_BASE_H

#include <math.h>
#include <string.h>

typedef struct base_state {
    double position[6], rate[6], change[6]; /* of the six joints */
    double nu[6], acceleration[6];          /* of the base, in its axes */
    double rotation[9];                     /* world_from_base */
    double axis[3][3];                      /* of the three turns, in the base's axes */
} base_state;

static inline void base_turn_back(double y[3], const double r[9], const double x[3])
{
    for (int i = 0; i < 3; i++) y[i] = r[i] * x[0] + r[3 + i] * x[1] + r[6 + i] * x[2];
}

/* R = Rz(a) Ry(b) Rx(c); omega = a' z + b' y + c' x with the axes as they stand, and its derivative. */
static inline void base_complete(base_state *s)
{
    const double a = s->position[3], b = s->position[4], c = s->position[5];
    const double sa = sin(a), ca = cos(a), sb = sin(b), cb = cos(b), sc = sin(c), cc = cos(c);
    const double *v = s->rate + 3, *w = s->change + 3;
    const double r[9] = {ca * cb,
                         ca * sb * sc - sa * cc,
                         ca * sb * cc + sa * sc,
                         sa * cb,
                         sa * sb * sc + ca * cc,
                         sa * sb * cc - ca * sc,
                         -sb,
                         cb * sc,
                         cb * cc};
    const double axis[3][3] = {{-sb, cb * sc, cb * cc}, {0, cc, -sc}, {1, 0, 0}};
    const double axis_rate[3][3] = {
        {-cb * v[1], -sb * v[1] * sc + cb * cc * v[2], -sb * v[1] * cc - cb * sc * v[2]},
        {0, -sc * v[2], -cc * v[2]},
        {0, 0, 0}};
    memcpy(s->rotation, r, sizeof r);
    memcpy(s->axis, axis, sizeof axis);
    for (int i = 0; i < 3; i++) {
        s->nu[i] = s->acceleration[i] = 0;
        for (int k = 0; k < 3; k++) {
            s->nu[i] += axis[k][i] * v[k];
            s->acceleration[i] += axis[k][i] * w[k] + axis_rate[k][i] * v[k];
        }
    }
    base_turn_back(s->nu + 3, r, s->rate);
    base_turn_back(s->acceleration + 3, r, s->change);
}

/* The force on the base as the forces at the six joints. */
static inline void base_force(double joint[6], const base_state *s, const double force[6])
{
    for (int i = 0; i < 3; i++) {
        const double *row = s->rotation + 3 * i;
        joint[i] = row[0] * force[3] + row[1] * force[4] + row[2] * force[5];
        joint[3 + i] = s->axis[i][0] * force[0] + s->axis[i][1] * force[1] + s->axis[i][2] * force[2];
    }
}

#endif
