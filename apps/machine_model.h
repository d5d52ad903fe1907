/* Which machine a scenario's is. */
#ifndef TELEDIMOS_APPS_MACHINE_MODEL_H
#define TELEDIMOS_APPS_MACHINE_MODEL_H

#include "apps/simulate_internal.h"
#include "core/hash.h"

/* SHA-256 of the robot's files and of how it is controlled: two that agree simulate the same machine. */
td_status machine_model(char hex[TD_HASH_HEX_SIZE], const scenario *s, td_error *error);

#endif
