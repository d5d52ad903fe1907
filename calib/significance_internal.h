/* Tails of the distributions by which rigs are judged. */
#ifndef TELEDIMOS_CALIB_SIGNIFICANCE_INTERNAL_H
#define TELEDIMOS_CALIB_SIGNIFICANCE_INTERNAL_H

#include <stddef.h>

#include "core/status.h"

/* Probability that chi-square of k degrees of freedom exceeds x; 1 when k is 0. */
double td_chi2_tail(double x, double k);
/* Probability that Fisher's F of k and m degrees of freedom exceeds x. */
double td_f_tail(double x, double k, double m);
/* The number of standard deviations that a normal variable exceeds, to either side, with probability p; at
 * most 37, where doubles end. */
double td_sigmas_of(double p);

/* Judges an estimate by its gradient. Of a change delta of n parameters the data say -1/2 delta^T A delta -
 * g^T delta (A information, g gradient); before the data, delta had covariance S (NULL: 0). Then g has
 * covariance A + A S A, and on the directions that A sees (rank of them) the sum of its whitened squares is
 * chi-square. What else makes the gradient vary, with
 * covariance B (NULL: 0), adds to it. Written with A = L L^T, z = L^+ g:
 *     chi2 = z^T (1 + L^T S L + L^+ B L^+T)^-1 z. */
typedef struct td_gradient_test {
    size_t n, rank;
    double *l;      /* (n,rank) */
    double *z;      /* (rank) */
    double *weight; /* (rank,rank) that inverse */
    double chi2;
} td_gradient_test;

/* `scale` (n): typical information of each parameter, by which directions too weak to be told from rounding
 * are recognised. */
td_status td_gradient_test_make(td_gradient_test *test, const double *a, const double *g, const double *s,
                                const double *b, const double *scale, size_t n, td_error *error);
void td_gradient_test_free(td_gradient_test *test);
/* Part of chi2 that changes along the `count` directions of `e` (count,n) explain, with their amplitudes and
 * sigmas (count) each. Returns the number of independent directions (0: none is seen). */
size_t td_gradient_test_explain(double *chi2, double *amplitude, double *sigma, const td_gradient_test *test,
                                const double *e, size_t count);

#endif
