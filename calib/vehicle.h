/* Where the cameras sit on a machine, from what they see of its arm: camera to vehicle.
 *
 * Points on a link of the arm (or a target fixed to it) are seen in many poses of the arm. One least-squares
 * problem over all poses and cameras: vehicle_from_rig, the places of the points on the link (known, with
 * priors, or free), the noise of the joint angles (each pose's angles are measurements), joint zero offsets
 * when asked for, fixed boards on the ground. What an excavator's parallel axes leave open is refused in the
 * machine's words. */
#ifndef TELEDIMOS_CALIB_VEHICLE_H
#define TELEDIMOS_CALIB_VEHICLE_H

#include "../core/log.h"
#include "../core/progress.h"
#include "../core/rig.h"
#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_VEHICLE_MAX_POINTS = 64, TD_VEHICLE_MAX_BOARDS = 8 };

/* A point on a link, or on the ground (link = the robot's root). */
typedef struct td_vehicle_point {
    char name[TD_NAME_SIZE];
    int link;
    double place[3]; /* m, in the link's frame; NaN where nothing is known */
    double sigma[3]; /* m: prior of each coordinate; 0: exact; INFINITY: free */
    int board;       /* 0: none; else its number from 1: place is then exact, in the board's frame */
} td_vehicle_point;

/* A rigid group of points (a target) on a link, or on the ground: points keep their places in it. */
typedef struct td_vehicle_board {
    char name[TD_NAME_SIZE];
    int link;
    td_pose link_from_board;
    double sigma_rad, sigma_m; /* prior of its rotation and of its origin's place, each axis; 0: exact;
                                  INFINITY: free */
} td_vehicle_board;

/* One point seen by one camera in one pose. */
typedef struct td_vehicle_sight {
    size_t pose;
    int camera, point;
    double pixel[2], sigma_px;
} td_vehicle_sight;

typedef struct td_vehicle_data {
    const td_robot *robot;
    const td_rig *rig; /* cameras; its covariance is passed on */
    int mount;         /* link that carries the rig: the cab (upper structure) or the undercarriage */
    int vehicle; /* link whose frame is the vehicle's; where it is not `mount`, vehicle_from_rig is told with
                    the joints between the two at zero */
    size_t pose_count;
    const char *const *pose_name; /* (poses) for messages; NULL: their numbers */
    double *q;                    /* (poses, joints) as the sensors said */
    double *sigma_q;              /* (joints) rad or m, of one reading */
    double *offset_prior;         /* (joints) sigma of a joint's zero; 0: held, INFINITY: free */
    int point_count;
    td_vehicle_point *point;
    int board_count;
    td_vehicle_board *board;
    size_t sight_count;
    td_vehicle_sight *sight;
} td_vehicle_data;

typedef struct td_vehicle_options {
    int tip;              /* link whose origin is the bucket's tip; -1: the last link */
    bool closed_only;     /* the paper's closed way alone */
    double outlier_sigma; /* default 5; 0: none left out */
    const td_progress *progress;
    const td_log *log;
} td_vehicle_options;
TD_API td_vehicle_options td_vehicle_options_default(void);

typedef struct td_vehicle {
    td_pose vehicle_from_rig, mount_from_rig;
    double covariance[36];         /* of vehicle_from_rig */
    double sigma_mm, sigma_deg;    /* worst axis */
    td_pose closed;                /* the paper's way: points triangulated in one pose after the other, their
                                      frame found, the arm's kinematics, the mean over the poses */
    size_t closed_poses;           /* that the mean is over, each with six known points or more; 0: none */
    double *offset, *sigma_offset; /* (joints) */
    double (*place)[3], (*sigma_place)[3]; /* (points) m, in the link's frame, of boards' points too */
    td_pose *link_from_board;              /* (boards) */
    double (*sigma_board)[2];              /* (boards) rad of the rotation, m of the origin, worst axis */
    double rms_px, chi2_per_dof;           /* NaN: no redundancy */
    bool *left_out;                        /* (sights) */
    double (*residual)[2]; /* (sights) px: predicted less seen, each pose with its own noise; NaN: behind */
    double *noise;         /* (poses, joints) what is added to the readings besides the offsets */
    size_t outliers;       /* how many of them */
    double sigma_tip_worst_mm, sigma_tip_median_mm; /* over the working space: see td_vehicle_tip_sigma */
    size_t null_count;
    char null_direction[8][320]; /* refused: in the machine's words, with what to do */
    size_t weak_count;
    char weak[8][320];
    struct td_vehicle_belief *belief; /* joint covariance, for td_vehicle_tip_sigma and td_vehicle_advise */
} td_vehicle;

/* TD_OK with null_count > 0: not determined; the transform is then not to be used. Refused, with the pose,
 * joint or point named: readings outside the joints' limits, points on a line, free points whose arm never
 * moves or that no pair of cameras sees, fewer than six known points in every pose (closed_only). */
TD_API td_status td_vehicle_solve(td_vehicle **result, const td_vehicle_data *data,
                                  const td_vehicle_options *options, td_error *error);
TD_API void td_vehicle_free(td_vehicle **result);

/* Standard deviation, m, of where a point at the bucket's tip is told to be when the arm stands at `q`, as
 * the cameras see it against as the kinematics say: covariance (3,3) in the vehicle's frame, from
 * vehicle_from_rig, offsets and one reading of the joints. */
TD_API td_status td_vehicle_tip_sigma(double covariance[9], const td_vehicle *result,
                                      const td_vehicle_data *data, int tip, const double *q, td_error *error);

/* The arm pose (q: joints), of a grid over the joints' limits, that would make the tip's sigma over the
 * working space smallest if the same points were seen in it. */
TD_API td_status td_vehicle_advise(double *q, char text[320], const td_vehicle *result,
                                   const td_vehicle_data *data, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
