#include "sim/soil_force.h"

#include <math.h>

static const double PI = 3.14159265358979323846, DEGREE = 0.017453292519943295;
static const double BETA_LOW_DEG = 5, BETA_HIGH_DEG = 85, SUM_HIGH_DEG = 170;

static double cot(double x)
{
    return cos(x) / sin(x);
}

td_status td_soil_failure_angle(double *beta_rad, const td_soil_preset *preset, double rake_rad,
                                td_error *error)
{
    const double phi = preset->friction_rad, delta = preset->tool_friction_rad, rho = rake_rad;
    const double x = rho + delta + phi;
    *beta_rad = NAN;
    if (!(rho >= DEGREE && rho <= 179 * DEGREE))
        return td_fail(error, TD_ERROR_ARGUMENT, "rake_rad: must be 1 to 179 deg, not %g deg", rho / DEGREE);
    if (x > SUM_HIGH_DEG * DEGREE)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "rake_rad: %g deg with %g deg of friction: no wedge fails ahead of so steep a blade; "
                       "take at most %g deg",
                       rho / DEGREE, (delta + phi) / DEGREE, SUM_HIGH_DEG - (delta + phi) / DEGREE);
    const double root = sqrt(sin(delta + phi) * sin(rho + delta) / (sin(rho) * sin(phi)));
    const double beta = atan2(sin(x), root - cos(x));
    /* D > 0 where x + beta < 180 deg. */
    const double high = fmin(BETA_HIGH_DEG * DEGREE, PI - x - DEGREE);
    *beta_rad = fmin(fmax(beta, BETA_LOW_DEG * DEGREE), high);
    return TD_OK;
}

static td_status check_cut(const td_soil_cut *cut, double gravity, td_error *error)
{
    const struct {
        const char *name;
        double value;
    } field[] = {{"depth_m", cut->depth_m},
                 {"width_m", cut->width_m},
                 {"surcharge_pa", cut->surcharge_pa},
                 {"swept_m3", cut->swept_m3},
                 {"gravity", gravity}};
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].value >= 0 && isfinite(field[i].value)))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: must be 0 or more, not %g", field[i].name,
                           field[i].value);
    if (!(fabs(cut->slope_rad) < 85 * DEGREE))
        return td_fail(error, TD_ERROR_ARGUMENT, "slope_rad: must be within 85 deg, not %g deg",
                       cut->slope_rad / DEGREE);
    return TD_OK;
}

/* The wedge: beta, cot(beta + phi), D. */
static td_status find_wedge(double wedge[3], const td_soil_preset *preset, const td_soil_cut *cut,
                            double gravity, td_error *error)
{
    const double lean = cut->rake_rad + preset->tool_friction_rad;
    TD_TRY(check_cut(cut, gravity, error));
    TD_TRY(td_soil_failure_angle(wedge, preset, cut->rake_rad, error));
    wedge[1] = cot(wedge[0] + preset->friction_rad);
    wedge[2] = cos(lean) + sin(lean) * wedge[1];
    return TD_OK;
}

td_status td_soil_force_mckyes(double *force_n, const td_soil_preset *preset, const td_soil_cut *cut,
                               double gravity, td_error *error)
{
    double wedge[3];
    *force_n = NAN;
    TD_TRY(find_wedge(wedge, preset, cut, gravity, error));
    const double d = cut->depth_m, rake = cot(cut->rake_rad), beta = cot(wedge[0]), out = wedge[1];
    const double weight = preset->density_kg_m3 * gravity * d * d * (rake + beta) / 2;
    const double cohesion = preset->cohesion_pa * d * (1 + beta * out);
    const double surcharge = cut->surcharge_pa * d * (rake + beta);
    const double adhesion = preset->adhesion_pa * d * (1 - rake * out);
    *force_n = cut->width_m * (weight + cohesion + surcharge + adhesion) / wedge[2];
    return TD_OK;
}

td_status td_soil_force_luengo(double *force_n, const td_soil_preset *preset, const td_soil_cut *cut,
                               double gravity, td_error *error)
{
    double wedge[3];
    *force_n = NAN;
    TD_TRY(find_wedge(wedge, preset, cut, gravity, error));
    const double d = cut->depth_m, beta = cot(wedge[0]), out = wedge[1], rise = tan(cut->slope_rad);
    if (!(beta > rise))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "slope_rad: the ground rises by %g deg, as steep as the wedge fails; take less than "
                       "%g deg",
                       cut->slope_rad / DEGREE, 90 - wedge[0] / DEGREE);
    const double slope = cos(cut->slope_rad) + sin(cut->slope_rad) * out;
    const double gamma = preset->density_kg_m3 * gravity;
    const double weight = d * d * cut->width_m * gamma * (beta - rise) * slope / 2;
    const double cohesion = preset->cohesion_pa * cut->width_m * d * (1 + beta * out);
    const double swept = cut->swept_m3 * gamma * slope;
    *force_n = (weight + cohesion + swept) / wedge[2];
    return TD_OK;
}

double td_soil_bearing_pa(const td_soil_preset *preset, double depth_m, double strip_m, double gravity)
{
    const double phi = preset->friction_rad, gamma = preset->density_kg_m3 * gravity;
    const double lift = tan(PI / 4 + phi / 2), nq = exp(PI * tan(phi)) * lift * lift;
    return preset->cohesion_pa * (nq - 1) * cot(phi) + gamma * depth_m * nq +
           gamma * strip_m * (nq + 1) * tan(phi);
}
