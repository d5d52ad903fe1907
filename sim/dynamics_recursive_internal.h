/* Where each link is against its parent, for the evaluation without a compiler. */
#ifndef TELEDIMOS_SIM_DYNAMICS_RECURSIVE_INTERNAL_H
#define TELEDIMOS_SIM_DYNAMICS_RECURSIVE_INTERNAL_H

#include "sim/dynamics_internal.h"

/* parent_from_link at q; the root's is the identity: its own axes are the base's. */
typedef struct td_link_place {
    double r[9], t[3];
} td_link_place;

void td_recursive_place(td_link_place *place, const td_robot *robot, const double *q);

#endif
