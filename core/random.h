/* Seeded random numbers: the same seed gives the same sequence on every machine and thread count. */
#ifndef TELEDIMOS_CORE_RANDOM_H
#define TELEDIMOS_CORE_RANDOM_H

#include <stddef.h>
#include <stdint.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* PCG-XSH-RR 64/32 (O'Neill 2014): 64 bits of state, `stream` selects one of 2^63 sequences, so that parallel
 * work gives each unit a stream of its own. */
typedef struct td_random {
    uint64_t state;
    uint64_t increment;
} td_random;

TD_API td_random td_random_seed(uint64_t seed, uint64_t stream);
TD_API uint32_t td_random_u32(td_random *random);
/* Uniform in [0, 1). */
TD_API double td_random_uniform(td_random *random);
/* Uniform integer in [0, bound), without modulo bias; bound > 0. */
TD_API uint32_t td_random_below(td_random *random, uint32_t bound);
/* Standard normal (polar method of Marsaglia). */
TD_API double td_random_normal(td_random *random);

#ifdef __cplusplus
}
#endif
#endif
