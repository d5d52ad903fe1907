/* ViSP itself, called directly: the peer of the visual servo. Twists are ViSP's, [v; omega]. */
#ifndef TELEDIMOS_TESTS_VISUAL_SERVO_VISP_H
#define TELEDIMOS_TESTS_VISUAL_SERVO_VISP_H

#ifdef __cplusplus
extern "C" {
#endif

enum visp_mode {
    VISP_CAMERA,
    VISP_HAND_cVe_eJe,
    VISP_FIXED_cVe_eJe,
    VISP_FIXED_cVf_fVe_eJe,
    VISP_FIXED_cVf_fJe,
    VISP_MODES
};
enum { VISP_CURRENT, VISP_DESIRED, VISP_MEAN }; /* as td_interaction */

typedef struct visp_task {
    int mode, interaction, pose, points, joints;
    double now[64][3], goal[64][3]; /* x, y, Z */
    double goal_from_camera[16];    /* (4,4) row-major */
    double camera_from_hand[16], camera_from_root[16], root_from_hand[16];
    double hand_jacobian[6 * 64]; /* (6,joints), of the hand in its own axes */
    double root_jacobian[6 * 64]; /* of the hand's point at the root's origin, in the root's axes */
    double gain[3];               /* at zero, at infinity, slope at zero */
    /* Avoidance of limits, when avoid: */
    int avoid;
    double q[64], lower[64], upper[64];
} visp_task;

/* rate (joints) and what avoidance adds to it. */
void visp_law(double *rate, double *extra, const visp_task *task);

/* The tutorial's camera: iterations until |e| falls below the tolerance. slope 0: constant gain. */
int visp_tutorial(const double gain[3], double tolerance);

/* For timing: a task that keeps its features. */
typedef struct visp_servo visp_servo;
visp_servo *visp_servo_new(const visp_task *task);
void visp_servo_move(visp_servo *servo, double *rate, const visp_task *task);
void visp_servo_free(visp_servo *servo);

#ifdef __cplusplus
}
#endif
#endif
