/* Small dense linear algebra over LAPACK. All matrices are row-major. */
#ifndef TELEDIMOS_CORE_LINALG_H
#define TELEDIMOS_CORE_LINALG_H

#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* OpenBLAS on one thread, for the whole process: the same bytes at any thread count, and no pool for matrices
 * of a few hundred rows. Programs call it once at their start. */
TD_API void td_linalg_single_thread(void);

/* Eigenvalues (n), ascending, and eigenvectors as the rows of `vector` (n,n; may be NULL) of the symmetric a
 * (n,n). */
TD_API td_status td_eigen_symmetric(double *value, double *vector, const double *a, size_t n,
                                    td_error *error);

/* Unit x (n) that minimises |a x|, a (m,n): the right singular vector of the smallest singular value. `ratio`
 * (may be NULL) = second smallest / largest singular value: near 0, x is not unique. */
TD_API td_status td_null_vector(double *x, double *ratio, const double *a, size_t m, size_t n,
                                td_error *error);

/* x (n) that minimises |a x - b|, a (m,n), b (m), m >= n; of minimal length where a is rank-deficient. `rank`
 * may be NULL. */
TD_API td_status td_least_squares_linear(double *x, size_t *rank, const double *a, const double *b, size_t m,
                                         size_t n, td_error *error);

/* inverse (n,n) of a symmetric positive definite a (n,n); TD_ERROR_DATA when it is not. May be in place. */
TD_API td_status td_invert_spd(double *inverse, const double *a, size_t n, td_error *error);

/* The rotation nearest to m (3,3) in the Frobenius norm: U diag(1, 1, det(U V^T)) V^T (Kabsch). */
TD_API td_status td_nearest_rotation(double r[9], const double m[9], td_error *error);

/* c (m,n) = a (m,k) b (k,n), or a b^T with b (n,k). c is neither a nor b. */
TD_API void td_multiply(double *c, const double *a, const double *b, size_t m, size_t k, size_t n);
TD_API void td_multiply_transposed(double *c, const double *a, const double *b, size_t m, size_t k, size_t n);

/* s (m,m) = j (m,n) a (n,n) j^T: how a covariance passes through a Jacobian. */
TD_API td_status td_sandwich(double *s, const double *j, const double *a, size_t m, size_t n,
                             td_error *error);

#ifdef __cplusplus
}
#endif
#endif
