/* A machine at the other end of a link as a plant (plant.h): whatever drives a plant drives it, joint by
 * joint.
 *
 * Its step waits until the machine says that so much of its time has passed, and tells it the command again
 * in each of its periods: a machine that hears nothing for three periods stands still by itself. It cannot be
 * reset. */
#ifndef TELEDIMOS_CORE_REMOTE_PLANT_H
#define TELEDIMOS_CORE_REMOTE_PLANT_H

#include "link.h"
#include "plant.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Connects, and asks for the joints (Manual). Refused: no machine within handshake_s; one that another
 * operator commands, that is failed or at work; joints other than the robot's, which is lent. */
TD_API td_status td_remote_plant_new(td_plant *plant, const td_robot *robot, const char *address,
                                     const td_link_options *options, td_error *error);
/* Gives the joints back, and says farewell. */
TD_API void td_remote_plant_free(td_plant *plant);
TD_API td_link_measure td_remote_plant_measure(const td_plant *plant);

#ifdef __cplusplus
}
#endif
#endif
