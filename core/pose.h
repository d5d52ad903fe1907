/* Rigid transforms, their tangent space and how covariance passes through them.
 *
 * A pose `a_from_b` takes coordinates in b to coordinates in a: p_a = R p_b + t. Names chain:
 * base_from_camera = base_from_hand * hand_from_camera.
 *
 * Perturbations are on the LEFT, everywhere: a_from_b(xi) = Exp(xi) * a_from_b, xi = [omega; tau] = [rotation
 * (rad); translation (m)], both expressed in frame a, and Exp is the exponential of SE(3). A 6x6 covariance
 * of a pose is that of this xi, row-major, in this order. (Barfoot, State Estimation for Robotics, ch. 7;
 * Sola et al. 2018, "A micro Lie theory", with the blocks in the order rotation, translation.) */
#ifndef TELEDIMOS_CORE_POSE_H
#define TELEDIMOS_CORE_POSE_H

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_pose {
    double q[4]; /* unit quaternion w, x, y, z */
    double t[3]; /* translation, m */
} td_pose;

TD_API td_pose td_pose_identity(void);
/* a_from_c = a_from_b * b_from_c. The quaternion is renormalised. */
TD_API td_pose td_pose_compose(const td_pose *a_from_b, const td_pose *b_from_c);
TD_API td_pose td_pose_inverse(const td_pose *a_from_b);
TD_API void td_pose_transform(double p_a[3], const td_pose *a_from_b, const double p_b[3]);
/* Rotates only: for directions. */
TD_API void td_pose_rotate(double v_a[3], const td_pose *a_from_b, const double v_b[3]);

/* Rotation as a row-major 3x3 matrix; and back (the nearest rotation need not be given: a proper rotation
 * is). */
TD_API void td_pose_rotation(double r[9], const td_pose *pose);
TD_API td_pose td_pose_from_rotation(const double r[9], const double t[3]);
/* Row-major 4x4 homogeneous matrix. */
TD_API void td_pose_matrix(double m[16], const td_pose *pose);

/* SO(3): rotation vector (rad, angle in [0, pi]) to unit quaternion and back; exact at small angles. */
TD_API void td_rotation_exp(double q[4], const double omega[3]);
TD_API void td_rotation_log(double omega[3], const double q[4]);
/* Row-major left Jacobian of SO(3) and its inverse: Exp(w + dw) = Exp(J(w) dw) Exp(w) to first order. */
TD_API void td_rotation_left_jacobian(double j[9], const double omega[3]);
TD_API void td_rotation_left_jacobian_inverse(double j[9], const double omega[3]);

/* SE(3). */
TD_API td_pose td_pose_exp(const double xi[6]);
TD_API void td_pose_log(double xi[6], const td_pose *pose);
/* Exp(xi) * pose. */
TD_API td_pose td_pose_perturb(const td_pose *pose, const double xi[6]);
/* Row-major left Jacobian of SE(3): Exp(xi + d) = Exp(J d) Exp(xi) to first order; and its inverse. */
TD_API void td_pose_left_jacobian(double j[36], const double xi[6]);
TD_API void td_pose_left_jacobian_inverse(double j[36], const double xi[6]);
/* Row-major adjoint: a_from_b Exp(xi_b) = Exp(Ad xi_b) a_from_b. */
TD_API void td_pose_adjoint(double ad[36], const td_pose *a_from_b);

/* Jacobian (3x6, row-major) of p_a = a_from_b p_b by the perturbation of a_from_b: [-[p_a]x, I]. */
TD_API void td_pose_transform_jacobian(double j[18], const double p_a[3]);

/* Covariances of perturbations (6x6, row-major) through a composition of independent poses,
 * S_ac = S_ab + Ad S_bc Ad^T, and through the inverse, S_ba = Ad(b_from_a) S_ab Ad(b_from_a)^T. */
TD_API void td_pose_compose_covariance(double s_ac[36], const td_pose *a_from_b, const double s_ab[36],
                                       const double s_bc[36]);
TD_API void td_pose_inverse_covariance(double s_ba[36], const td_pose *a_from_b, const double s_ab[36]);

/* Angle of the rotation (rad) and length of the translation (m). */
TD_API double td_pose_angle(const td_pose *pose);
TD_API double td_pose_distance(const td_pose *pose);

#ifdef __cplusplus
}
#endif
#endif
