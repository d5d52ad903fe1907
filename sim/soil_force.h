/* What soil does to a blade: the wedge that fails in front of it, and what the ground beneath it bears.
 *
 * rho: rake, the angle between the blade's face and the direction it moves in; phi: the soil's friction;
 * delta: between soil and blade; gamma: density; beta: the angle at which the wedge fails; d, w: depth and
 * width. D = cos(rho + delta) + sin(rho + delta) cot(beta + phi).
 *
 * McKyes, Soil Cutting and Tillage (1985), in Reece's form:
 *   F = w (gamma g d^2 Ngamma + c d Nc + q d Nq + ca d Na),
 *   Ngamma = (cot rho + cot beta) / (2 D),  Nc = (1 + cot beta cot(beta + phi)) / D,
 *   Nq = (cot rho + cot beta) / D,          Na = (1 - cot rho cot(beta + phi)) / D.
 *
 * Luengo, Singh and Cannon, "Modeling and identification of soil-tool interaction in automated excavation"
 * (1998), for ground that slopes by alpha and for what the bucket holds already, Vs (of the bank's density):
 *   F = d^2 w gamma g Nw + c w d Nc + Vs gamma g Nq,
 *   Nw = (cot beta - tan alpha) (cos alpha + sin alpha cot(beta + phi)) / (2 D),
 *   Nq = (cos alpha + sin alpha cot(beta + phi)) / D.
 *
 * F is the blade's force on the soil, at delta to the square on its face, leaning to the edge. */
#ifndef TELEDIMOS_SIM_SOIL_FORCE_H
#define TELEDIMOS_SIM_SOIL_FORCE_H

#include "soil_preset.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_soil_cut {
    double rake_rad;
    double depth_m, width_m;
    double surcharge_pa; /* q, McKyes only */
    double slope_rad;    /* alpha, Luengo only; positive: the ground rises ahead */
    double swept_m3;     /* Vs, Luengo only */
} td_soil_cut;

/* beta that minimises Ngamma, held within 5 and 85 deg and where D > 0. With x = rho + delta + phi,
 *   cot beta = (sqrt(sin(delta + phi) sin(rho + delta) / (sin rho sin phi)) - cos x) / sin x
 * (Ngamma is a quadratic over a line in cot beta). Minimising Luengo's Nw instead runs to 89 deg for shallow
 * blades. Refused by name: a rake outside 1 to 179 deg, x above 170 deg, where no wedge fails. */
TD_API td_status td_soil_failure_angle(double *beta_rad, const td_soil_preset *preset, double rake_rad,
                                       td_error *error);

/* N. Refused by name, besides: numbers that are none or negative; a slope of 85 deg and more, or at which the
 * wedge has no weight (alpha >= 90 deg - beta). */
TD_API td_status td_soil_force_mckyes(double *force_n, const td_soil_preset *preset, const td_soil_cut *cut,
                                      double gravity, td_error *error);
TD_API td_status td_soil_force_luengo(double *force_n, const td_soil_preset *preset, const td_soil_cut *cut,
                                      double gravity, td_error *error);

/* Pressure (Pa) at which the ground gives way under a strip of that width at that depth (Vesic 1973):
 *   q = c Nc + gamma g d Nq + gamma g B Ngamma / 2, Nq = e^(pi tan phi) tan^2(45 deg + phi/2),
 *   Nc = (Nq - 1) cot phi, Ngamma = 2 (Nq + 1) tan phi. */
TD_API double td_soil_bearing_pa(const td_soil_preset *preset, double depth_m, double strip_m,
                                 double gravity);

#ifdef __cplusplus
}
#endif
#endif
