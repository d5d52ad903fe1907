/* What own_body.c and own_body_mask.c share. */
#ifndef TELEDIMOS_RECON_OWN_BODY_INTERNAL_H
#define TELEDIMOS_RECON_OWN_BODY_INTERNAL_H

#include "own_body.h"

/* Both checks at once, for the functions that can fail. */
td_status td_own_body_check(const td_robot *robot, const double *q, const td_own_body_options *options,
                            td_error *error);

#endif
