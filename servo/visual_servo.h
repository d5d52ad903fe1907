/* Visual servoing: an arm, or a camera that moves freely, brought to where the camera shows what it should.
 *
 * Features s are points in the image (normalised, x = X/Z, y = Y/Z; lens and distortion taken out), e = s -
 * s*; or the camera's pose: e = [theta u; t] of goal_from_camera, its rotation times radius_m. Either moves
 * with the camera's twist against the target, V = [omega; v] in the camera's axes, as e' = L V (Chaumette and
 * Hutchinson 2006), and for an arm V = A (J_camera - J_target) dq: one formula for a camera on the hand, for
 * a fixed camera that sees the hand, and for a camera on the cab that sees the bucket. The law is
 *
 *     dq = -lambda J+ e,  J = L A (J_camera - J_target),  lambda(x) = a exp(-b x) + c,  x = |J+ e|_inf,
 *
 * with c the gain at infinity, a + c that at zero, -a b the slope at zero. L is taken at s, at s*, or is the
 * mean of both. An arm's J+ is (J'J + mu^2)^-1 J', mu^2 = damping |e_c|^2 (Sugihara 2011): far from the goal
 * no joint is sent round for little, near it the law is the one above.
 * ViSP's vpServo gives the same numbers and can be asked for. Ours is the rule because vpServo knows no
 * damping, no joints that stand still and no e that is out of reach, and takes 250 libraries and many times
 * as long.
 *
 * An arm of four joints controls four dimensions of e at most: those that J reaches, e_c = J J+ e.
 * Convergence is judged by e_c; what is left, e - e_c, no motion of the arm takes away, and it is told.
 * Joints at their stops that are asked to go on are left out of J, so that the others do what can be done
 * without them.
 *
 * Joint limits. Near a limit the joints also turn by P g_i, scaled to the law's own rate (Marey and Chaumette
 * 2010), with their large projection operator P, which leaves |e| falling as it was and fades to I - J+J as e
 * becomes small. Then everything passes through motion_limits.h.
 *
 * Loss. With too few points seen the arm brakes and holds; it goes on when they are back, and stops for good
 * after loss_s. Once stopped, whatever the reason, it brakes and stays. */
#ifndef TELEDIMOS_SERVO_VISUAL_SERVO_H
#define TELEDIMOS_SERVO_VISUAL_SERVO_H

#include "../core/camera.h"
#include "motion_limits.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_SERVO_MAX_POINTS = 64, TD_SERVO_LEAST_POINTS = 3 };

typedef enum td_servo_kind { TD_SERVO_POINTS, TD_SERVO_POSE } td_servo_kind;
typedef enum td_interaction {
    TD_INTERACTION_CURRENT,
    TD_INTERACTION_DESIRED,
    TD_INTERACTION_MEAN
} td_interaction;
typedef enum td_servo_law {
    TD_SERVO_LAW_OWN,
    TD_SERVO_LAW_VISP /* vpServo's: the same numbers, without damping near singularities; loads ViSP */
} td_servo_law;

typedef struct td_servo_point {
    bool seen;
    double pixel[2]; /* as the camera shows it, distortion and all */
    double depth_m;  /* Z; with TD_INTERACTION_DESIRED needed of the goal only (else 0: unknown) */
    double sigma_px; /* of each coordinate; used by td_visual_servo_sigma only */
} td_servo_point;

/* What the camera shows at one time, or should show. Points are those of a target's, in the same order each
 * time: corners of tags, say. */
typedef struct td_servo_sight {
    td_servo_kind kind;
    int count;
    td_servo_point point[TD_SERVO_MAX_POINTS];
    bool pose_seen;
    td_pose camera_from_target;
    double covariance[36]; /* its left perturbation's; used by td_visual_servo_sigma only */
} td_servo_sight;

/* Who sees, and what moves. Links are of the robot; 0, its root, is at rest. */
typedef struct td_servo_eye {
    td_camera camera;
    const td_robot *robot;        /* borrowed; NULL: the camera moves freely, and the rest is not read */
    int camera_link, target_link; /* hand and 0: eye in hand; 0 and hand: eye to hand */
    td_pose link_from_camera;
} td_servo_eye;

typedef struct td_visual_servo_options {
    td_interaction interaction;                  /* default current */
    td_servo_law law;                            /* default own */
    double gain_zero, gain_infinity, gain_slope; /* lambda(0), 1/s; lambda far away, 1/s; slope at 0 as a
                                                    positive number; default 1.5, 0.4, 5 */
    double radius_m;       /* one radian weighs as much as this many metres; default 1 */
    double singular_share; /* of the largest singular value of J: smaller ones are damped; default 1e-3 */
    double damping;        /* of an arm's J far from the goal: mu^2 = damping |e_c|^2 (Sugihara 2011); default
                              0.01; 0: ViSP's law, which in a singularity throws joints about */
    bool avoid_limits;     /* default true */
    double rho, rho1, tune; /* Marey and Chaumette's, share of the range where avoidance begins, share of
                               that after which it is full, and how much it outweighs; 0.1, 0.3, 0.7 */
    td_motion_limits limits;
    td_command_kind command;                         /* rates (default) or flows */
    double tolerance_px, tolerance_m, tolerance_rad; /* of e_c; 0.3 px, 1 mm, 1 mrad */
    double rest_px, rest_m, rest_rad; /* of e - e_c where a camera of six freedoms has arrived; 3 px, 1 cm,
                                         10 mrad */
    double settle_s;                  /* within the tolerance for so long; default 0.2 */
    double loss_s;                    /* without sight for so long; default 5 */
    double stall_s;                   /* no nearer (by 5 %) for so long; default 5 */
    double limit_s;                   /* in all; default 120 */
    double diverging;                 /* e by what it was at the start; default 3 */
} td_visual_servo_options;
TD_API td_visual_servo_options td_visual_servo_options_default(void);

#define TD_SERVO_PHASE_LIST(X)                                                                               \
    X(TD_SERVO_MOVING, "moving")                                                                             \
    X(TD_SERVO_HOLDING, "holding")         /* the target is out of sight */                                  \
    X(TD_SERVO_CONVERGED, "converged")     /* e is within the tolerance, the rest small */                   \
    X(TD_SERVO_REDUCED, "reduced")         /* e_c is; the arm cannot do more */                              \
    X(TD_SERVO_MINIMUM, "local minimum")   /* e_c is, e is not, though there are six freedoms */             \
    X(TD_SERVO_UNREACHABLE, "unreachable") /* joints at their stops, or a stretched arm */                   \
    X(TD_SERVO_STALLED, "stalled")         /* no nearer, for no reason that can be named */                  \
    X(TD_SERVO_DIVERGED, "diverged")                                                                         \
    X(TD_SERVO_LOST, "lost")                                                                                 \
    X(TD_SERVO_LATE, "late")
typedef enum td_servo_phase {
#define TD_SERVO_PHASE(name, text) name,
    TD_SERVO_PHASE_LIST(TD_SERVO_PHASE)
#undef TD_SERVO_PHASE
        TD_SERVO_PHASES
} td_servo_phase;
TD_API const char *td_servo_phase_name(td_servo_phase phase);

/* The largest of the points' distances, or the pose's. */
typedef struct td_servo_error {
    double px, m, rad;
} td_servo_error;

typedef struct td_servo_report {
    td_servo_phase phase;
    char reason[256];         /* why it holds or stopped */
    td_plant_command command; /* of an arm */
    double twist[6];          /* of a free camera: omega, v in its own axes */
    double gain;
    td_servo_error whole, controlled, rest; /* e, e_c, e - e_c */
    int freedoms;                           /* of the camera against the target, here */
    double share[6]; /* how much of the camera's own rx, ry, rz, tx, ty, tz the arm controls, 0 to 1 */
    bool at_stop[TD_ROBOT_MAX_JOINTS]; /* asked to go on, and left out */
    bool avoids;                       /* a limit */
} td_servo_report;

typedef struct td_visual_servo {
    td_servo_eye eye;
    td_visual_servo_options options;
    td_servo_sight goal;
    double goal_point[TD_SERVO_MAX_POINTS][3]; /* x, y, Z */
    int freedoms;                              /* that the arm has where it is not singular */
    td_servo_phase phase;
    char reason[256];
    double rate[TD_ROBOT_MAX_JOINTS];           /* commanded last */
    double time_s, settled_s, unseen_s, best_s; /* since: the start; within tolerance; seen; nearest */
    double first, best;                         /* e at the start; the least of it */
    bool stopped[TD_ROBOT_MAX_JOINTS];          /* were at their stops since it was nearest */
    void *module;                               /* ViSP, when it is asked for */
} td_visual_servo;

/* At rest. options NULL: defaults; the period is options.limits.period_s. Refused, naming it: a goal of fewer
 * than 3 points, of numbers that are none, behind the camera, without a ray through the lens, without depths;
 * no such link; no joint between the camera and the target; limits as td_motion_limits_check; gains that do
 * not make a stable loop with the machine's lag (lag.h). */
TD_API td_status td_visual_servo_start(td_visual_servo *servo, const td_servo_eye *eye,
                                       const td_servo_sight *goal, const td_visual_servo_options *options,
                                       td_error *error);
/* Another goal of the same features from now on, and where the camera is: for a goal that is seen itself, and
 * moves in the image, and a camera whose own link turns. Let camera_link then be 0 and link_from_camera where
 * the camera stands now: e falls as by the joints' whole motion against the site, for the goal goes with it.
 * Fails as td_visual_servo_start, and changes nothing then. */
TD_API td_status td_visual_servo_retarget(td_visual_servo *servo, const td_servo_sight *goal,
                                          const td_pose *link_from_camera, td_error *error);
/* Gives back what ViSP's law has loaded. */
TD_API void td_visual_servo_end(td_visual_servo *servo);

/* Once a period. state: of an arm (NULL for a free camera). Fails, naming the point, with a command that
 * brakes: another number or kind of features than the goal's, numbers that are none, what lies behind the
 * camera; the next period may go on. */
TD_API td_status td_visual_servo_step(td_servo_report *report, td_visual_servo *servo,
                                      const td_servo_sight *sight, const td_plant_state *state,
                                      td_error *error);

/* How far, in the root's axes (free camera: in the camera's), a point of the tool is from its goal when the
 * servo has converged: covariances (3,3), m^2. */
typedef struct td_servo_sigma {
    double image[9];  /* one image's noise */
    double loop[9];   /* what the loop leaves of it, with a new image each period: image times a factor */
    double common[9]; /* of camera, hand-eye and target on the tool: the same every time */
} td_servo_sigma;

/* Where the arm's q meets the goal. sight: what is seen there, with sigma_px or the pose's covariance. link,
 * point_m: the tool's (free camera: point_m in the camera's frame). common: (n,n), n =
 * td_camera_parameter_count + 12, in the order camera's parameters, left perturbation of link_from_camera,
 * left perturbation of target_link_from_target (free camera: of camera_from_target; link_from_camera's counts
 * for nothing); NULL: exact. It counts where the goal was computed; of a goal that was shown to the camera
 * nothing of it remains. Of a pose the camera's parameters' share is in its own covariance, and not counted
 * again. Not counted: the arm's own errors; depths, to which the law is blind where e = 0. */
TD_API td_status td_visual_servo_sigma(td_servo_sigma *sigma, const td_visual_servo *servo, const double *q,
                                       const td_servo_sight *sight, int link, const double point_m[3],
                                       const double *common, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
