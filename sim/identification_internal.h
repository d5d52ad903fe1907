/* What the files of the identification share. */
#ifndef TELEDIMOS_SIM_IDENTIFICATION_INTERNAL_H
#define TELEDIMOS_SIM_IDENTIFICATION_INTERNAL_H

#include "sim/dynamics.h"
#include "sim/identification.h"

enum { ID_SPLINE = 6, ID_MOST_SAMPLES = 100000 }; /* coefficients that a value of a spline depends on */

/* Inertial and friction parameters of a robot, and the sums of them that enter the joints' forces. */
typedef struct td_id_model {
    const td_robot *robot;
    td_dynamics *dynamics;
    td_identification_options o;
    int n;                          /* joints */
    int links;                      /* with a mass */
    int link[TD_ROBOT_MAX_LINKS];   /* (links) */
    int standard;                   /* 10 links, then viscous and coulomb of each joint */
    double *prior, *size;           /* (standard) */
    int count;                      /* base parameters */
    int *column;                    /* (count) the standard parameter that each begins with */
    double *group;                  /* (count,standard): base = group standard */
    double *base_prior, *base_size; /* (count) */
    double *full;                   /* (6+n, 10 link_count) for the regressor */
} td_id_model;

td_status td_id_model_make(td_id_model *m, const td_robot *robot, const td_identification_options *o,
                           bool base_moves, td_error *error);
void td_id_model_free(td_id_model *m);
/* Standard parameters of a robot in the model's order, (standard). */
td_status td_id_standard(double *value, const td_id_model *m, const td_robot *robot, const double *viscous,
                         const double *coulomb, td_error *error);
/* Prior covariance (count,count), of sigmas `width` times the sizes. */
void td_id_prior(double *covariance, const td_id_model *m, double width);
/* Names and words of base parameter `index`; words to be freed. */
void td_id_name(char name[2 * TD_NAME_SIZE], const td_id_model *m, int standard);
const char *td_id_unit(const td_id_model *m, int standard);
char *td_id_words(const td_id_model *m, const double *weight, double least);

/* A state of the machine. */
typedef struct td_id_state {
    double q[TD_ROBOT_MAX_JOINTS], nu[TD_DYNAMICS_MAX], acceleration[TD_DYNAMICS_MAX], gravity[3];
    double turn[9], back[9]; /* acceleration's [alpha; a] by the second derivatives of rpy and x, y, z */
} td_id_state;
/* From values and derivatives of n joints and, with six more, x y z roll pitch yaw. */
void td_id_state_from(td_id_state *s, const td_id_model *m, const double *value, const double *rate,
                      const double *second, bool base_moves);
/* rows (n,count) of the regressor. */
void td_id_rows(double *rows, const td_id_model *m, const td_id_state *s);
/* unit (n,channels,count): derivatives of the rows by the channels' second derivatives; channels: joints,
 * then six of a base that moves. */
void td_id_units(double *unit, const td_id_model *m, const td_id_state *s, bool base_moves);

/* Uniform B-splines of degree 5 over [first, last]. */
typedef struct td_id_spline {
    double first, step;
    size_t intervals; /* intervals + 5 coefficients */
} td_id_spline;
/* Index of the first coefficient at t, and weights of six for value, rate and second derivative. */
size_t td_id_basis(double weight[3][ID_SPLINE], const td_id_spline *spline, double t);

/* Normal equations of many unknowns of a band, and a few that all rows touch. */
typedef struct td_arrow {
    size_t unknowns, band; /* band: of a row, and one more than the matrix' half bandwidth */
    int border;
    double *matrix;         /* LAPACK's lower band (unknowns, band) */
    double *side;           /* (unknowns, border+1): coupling, and last the right-hand side */
    double *turned;         /* the same by columns, when solved */
    double *corner, *right; /* (border,border), (border) */
} td_arrow;
td_status td_arrow_make(td_arrow *a, size_t unknowns, size_t band, int border, td_error *error);
void td_arrow_free(td_arrow *a);
void td_arrow_clear(td_arrow *a);
/* A row of the Jacobian: weights of unknowns first … first+length-1 and of the border (NULL: none), and its
 * residual. */
void td_arrow_add(td_arrow *a, size_t first, const double *weight, size_t length, const double *border,
                  double residual);
/* Takes the band's unknowns out: corner and right-hand side of the border when they follow (in place). */
td_status td_arrow_reduce(td_arrow *a, td_error *error);
/* After that: the band's unknowns (unknowns) for a step of the border. */
td_status td_arrow_follow(double *step, const td_arrow *a, const double *border_step, td_error *error);

/* Standard deviation of white noise over a smooth signal, by differences of order 5. `stride` between
 * values. */
double td_id_noise(const double *value, size_t stride, size_t count, double *work);

/* identification_log.c */
td_status td_id_check_options(const td_identification_options *o, int n, td_error *error);
td_status td_id_check_log(const td_motion_log *log, const td_robot *robot, td_error *error);
const char *td_id_log_name(const td_motion_log *log);

/* identification.c */
/* Splines of all channels. */
typedef struct td_id_motion {
    td_id_spline spline;
    size_t unknowns;
    double *coefficient; /* (intervals+5,channels) */
} td_id_motion;

typedef struct td_id_job {
    td_id_model m;
    const td_motion_log *log;
    bool base_moves;
    int channels;  /* joints, and 6 of the base */
    double *value; /* (count,channels), turns unwrapped */
    double sigma[TD_DYNAMICS_MAX], sigma_rate[TD_ROBOT_MAX_JOINTS], sigma_force[TD_ROBOT_MAX_JOINTS];
    td_id_motion fine, coarse; /* as the record has it, and its slow part */
    double *lever;             /* (count,n) */
    bool *used;                /* (count,n) */
    size_t used_count;
    double spline_chi2, chi2;
    double *beta, *information, *covariance; /* (count), in sizes (count,count) */
    int rounds;
} td_id_job;

td_status td_id_no_memory(td_error *error);
/* Values, rates and second derivatives (3,channels) of the splines. */
void td_id_values_at(double out[3][TD_DYNAMICS_MAX], const td_id_job *j, const td_id_motion *motion,
                     size_t first, double weight[3][ID_SPLINE]);
/* Sample i of a log with exact accelerations. */
void td_id_exact_state(td_id_state *s, const td_id_job *j, size_t i);
/* Measured less predicted force of joint k, over its noise; predicted in *force (may be NULL). */
double td_id_force_residual(const td_id_job *j, size_t i, int k, const double *rows, double *force);
/* Of the splines against positions, poses and rates: rms over what noise explains. */
double td_id_spline_misfit(const td_id_job *j);

/* identification_result.c */
td_status td_id_fill(td_identification *id, const td_id_job *j, td_error *error);
/* identification_links.c */
td_status td_id_links(td_identification *id, const td_id_model *m, const double *covariance, td_error *error);

#endif
