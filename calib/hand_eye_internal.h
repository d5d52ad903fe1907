/* Parts of the hand-eye estimator.
 *
 * Inside, every setup is one: base_from_hand near sight = far, with `near` fixed to the hand, `far` fixed to
 * the base and `sight` = near_from_far measured. In the hand: near = X, far = Z; to the hand: near = Z,
 * far = X, and the sight is target_from_rig. Parameters, in order: perturbation of near (6), of far (6), and,
 * where it is free, the relative scale of the sights' translations. */
#ifndef TELEDIMOS_CALIB_HAND_EYE_INTERNAL_H
#define TELEDIMOS_CALIB_HAND_EYE_INTERNAL_H

#include "calib/hand_eye.h"

enum { TD_HE_MAX_PARAMETERS = 13, TD_HE_MAX_VARIANCES = 5, TD_HE_FIELD_MOST_VIEWS = 200 };

/* Standard deviations below these are none. */
#define TD_HE_LEAST_SIGMA 1e-8

typedef struct td_he_view {
    td_pose hand;   /* base_from_hand, said */
    td_pose sight;  /* near_from_far, seen */
    double cov[36]; /* of the sight's perturbation */
    size_t index;   /* among the caller's views */
} td_he_view;

typedef struct td_he_state {
    td_pose near, far;
    double scale;
} td_he_state;

/* The views' residuals, linearised: what the robot would have to be wrong by, at the hand, in the base's
 * axes (3 rad, 3 m). */
typedef struct td_he_linear {
    size_t n;
    int p;      /* 12 or 13 parameters */
    double *g;  /* (n,6) */
    double *j;  /* (n,6,p) */
    double *s;  /* (n,6,6) covariance that the sight's gives */
    double *at; /* (n,3) the hand's position */
} td_he_linear;

/* Logarithms of: sigma of rotation, of translation (robot); of rotation, of translation (field); length. */
typedef struct td_he_variance {
    int count; /* 0: exact robot; 2: independent noise; 5: and the field */
    double log[TD_HE_MAX_VARIANCES];
} td_he_variance;

/* Generalised least squares at given variances, and the restricted likelihood with its derivatives. */
typedef struct td_he_gls {
    size_t n;
    int p;
    double minus_two_log; /* of the restricted likelihood, without its constant */
    double beta[TD_HE_MAX_PARAMETERS];
    double cov[TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS];
    double gradient[TD_HE_MAX_VARIANCES];                     /* of minus_two_log */
    double fisher[TD_HE_MAX_VARIANCES * TD_HE_MAX_VARIANCES]; /* expected information of the logarithms */
    double *pg;      /* (n,6) P g, P = C^-1 - C^-1 J (J^T C^-1 J)^-1 J^T C^-1 */
    double *block;   /* (n,6,6) diagonal blocks of P */
    double *cj;      /* (n,6,p) C^-1 J */
    double *inverse; /* (n,6,6) C^-1 of independent views; unused with the field */
    double *dense;   /* (6n,6n) P, components first: row c n + i; NULL without the field */
    double *work;    /* of the field */
} td_he_gls;

typedef struct td_he_fit {
    td_he_state state;
    td_he_variance variance;
    td_he_linear linear;
    td_he_gls gls;
} td_he_fit;

/* hand_eye_model.c */
void td_he_canonical(td_he_view *out, const td_hand_eye_view *view, size_t count, td_hand_eye_setup setup);
/* base_from_hand as the sight implies it, relative to what the robot said: log(said^-1 implied). */
void td_he_residual(double d[6], const td_he_view *view, const td_he_state *state);
/* Residual in the base's axes, its Jacobian (6,p) and what the sight's covariance gives (6,6). */
void td_he_linearise_view(double g[6], double *j, double s[36], const td_he_view *view,
                          const td_he_state *state, int p);
td_status td_he_linear_new(td_he_linear *linear, size_t n, int p, td_error *error);
void td_he_linear_free(td_he_linear *linear);
void td_he_linearise(td_he_linear *linear, const td_he_view *view, const td_he_state *state);
void td_he_move(td_he_state *state, const double *beta, int p);

/* hand_eye_restricted.c */
/* Inverse and log-determinant of a symmetric positive definite a (n,n), n <= 13; false when it is not. */
bool td_he_invert(double *inverse, double *log_det, const double *a, int n);
td_status td_he_gls_new(td_he_gls *gls, size_t n, int p, bool field, td_error *error);
void td_he_gls_free(td_he_gls *gls);
/* False when the covariance or the normal equations are singular. */
bool td_he_evaluate(td_he_gls *gls, const td_he_linear *linear, const td_he_variance *variance);
bool td_he_finish(td_he_gls *gls, const td_he_linear *linear, double log_det, const double *normal,
                  const double *right, double square);
/* Minimises minus_two_log over the variances by Fisher scoring. */
bool td_he_maximise(td_he_gls *gls, const td_he_linear *linear, td_he_variance *variance);
/* Standard deviation of sigma = exp(log[k]). */
double td_he_sigma_of(const td_he_gls *gls, const td_he_variance *variance, int k);

/* hand_eye_field.c */
bool td_he_evaluate_field(td_he_gls *gls, const td_he_linear *linear, const td_he_variance *variance);
double td_he_matern(double distance, double length);

/* hand_eye_fit.c */
/* Gauss-Newton over the poses, the variances maximised anew at each linearisation. `count` variances from
 * where they begin. `fit` is to be freed even when it fails. */
td_status td_he_fit_run(td_he_fit *fit, const td_he_view *view, size_t n, const td_he_state *start,
                        const td_he_variance *variance, bool free_scale, td_error *error);
void td_he_fit_free(td_he_fit *fit);
/* Independent noise of the size of the residuals' medians. */
td_he_variance td_he_first_variance(const td_he_view *view, size_t n, const td_he_state *state);
/* Residual r (6, base's axes) of a used view i against the others, and its covariance (6,6). */
bool td_he_held_out(double r[6], double cov[36], const td_he_fit *fit, size_t i);
/* The same of a view that is not in the fit. */
void td_he_predict_new(double r[6], double cov[36], const td_he_fit *fit, const td_he_view *view);
/* Squared length of r by its covariance; infinite when that is singular. */
double td_he_distance(const double r[6], const double cov[36]);
/* The normal deviate as rare as a squared distance of 6 components over variances known from `freedom`
 * residuals (0: known exactly). */
double td_he_deviate(double square, double freedom);

/* hand_eye_start.c */
td_status td_he_start(td_he_state *state, const td_he_view *view, size_t n, td_error *error);

/* hand_eye_motion.c */
td_status td_he_check_motion(const td_he_view *view, size_t n, td_hand_eye_setup setup, td_error *error);
void td_he_find_weak(td_hand_eye *result);
/* Covariance (12,12) of X's rotation and origin, then Z's: of what is told, not of the perturbation. */
void td_he_origin_covariance(double out[144], const td_hand_eye *result);

/* hand_eye_outliers.c */
/* Residuals that a variance over this many views rests on. */
double td_he_freedom(size_t used);
/* Sorts the views: those used first (fit is theirs), in their order; `used` tells how many. */
td_status td_he_choose_views(td_he_fit *fit, td_he_view *view, size_t n, size_t *used,
                             const td_he_state *start, double outlier_sigma, td_error *error);
/* Leaves out the worst of the used views, as long as it lies outside by a fit without it. */
void td_he_drop_views(td_he_fit *fit, td_he_view *view, size_t *used, size_t least, double outlier_sigma);
#endif
