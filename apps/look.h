/* The closed loop's look at a scene: renders the pair where the machine truly stands, and puts what it sees
 * into a map by what is believed. No files. */
#ifndef TELEDIMOS_APPS_LOOK_H
#define TELEDIMOS_APPS_LOOK_H

#include "apps/look_pair.h"
#include "core/scene.h"
#include "recon/fusion.h"
#include "recon/rig_belief.h"
#include "sim/stereo_view.h"

typedef struct look_options {
    int camera[2]; /* of the rig: left, right; default 0, 1 */
    double near_m, far_m;
    const double *sigma_q; /* (joints) rad or m; NULL: 0 */
    td_view_options view;
    td_dense_options dense;
    td_fusion_options fusion;
} look_options;
look_options look_options_default(void);

typedef struct look_result {
    look_shares shares;
    td_fusion_tally tally;
    double grey[2]; /* means of the images: a camera that went dark shows it */
    double render_s, match_s, fuse_s;
} look_result;

typedef struct look look;
/* `scene` is the truth, with its robot, and lent: after its ground has changed, look_ground_changed; where it
 * moves, nothing. Both rigs carry vehicle_from_rig in the frame of link `mount`, and are lent. */
td_status look_new(look **l, const td_scene *scene, const td_rig *truth, const td_rig *believed, int mount,
                   const look_options *options, td_error *error);
void look_free(look **l);
void look_ground_changed(look *l, int column, int row, int columns, int rows);
/* One more pair, numbered `frame` (its noise), into the map: the scene as it stands, the machine believed at
 * site_from_vehicle (covariance (6,6) of site_from_rig, or NULL) with joints q. */
td_status look_now(look_result *result, look *l, const td_pose *site_from_vehicle, const double *q,
                   const double *pose_covariance, uint64_t frame, double time_s, td_error *error);
/* The same with a pair that somebody else took: raw images, as the cameras give them; taken over. */
td_status look_given(look_result *result, look *l, td_image *pair[2], const td_pose *site_from_vehicle,
                     const double *q, double time_s, td_error *error);
/* The map so far, or since look_anew. */
td_status look_map(td_elevation **map, const look *l, td_error *error);
/* From the next pair on the map holds what is seen since: ground that has gone stands in no map then, as it
 * would where a wall hides what is there instead. */
td_status look_anew(look *l, td_error *error);
/* A rig that is not believed rightly shows itself. Refused: no pair yet; too few matches. */
typedef struct look_rig {
    double rms_px;   /* of robust matches of the last pair off their curves (recon/epipolar_gate.h) */
    double sigma_px; /* what the believed rig's covariance allows; NaN: it has none */
    td_rig_belief_result belief; /* of the pairs checked since look_anew, together (recon/rig_belief.h) */
} look_rig;
td_status look_check(look_rig *rig, look *l, td_error *error);
/* How images are formed from the next pair on; lent, may be changed. */
td_view_options *look_view(look *l);
/* The last pair's rectified left image; lent until the next. NULL: none yet. */
const td_image *look_left(const look *l);
/* For what stands before the first look. */
td_status look_prior(look *l, const td_elevation *prior, double sigma_m, td_error *error);

#endif
