#include "core/random.h"

#include <math.h>

uint32_t td_random_u32(td_random *random)
{
    uint64_t old = random->state;
    random->state = old * 6364136223846793005ULL + random->increment;
    uint32_t shifted = (uint32_t)(((old >> 18) ^ old) >> 27);
    uint32_t rotation = (uint32_t)(old >> 59);
    return (shifted >> rotation) | (shifted << ((32 - rotation) & 31));
}

td_random td_random_seed(uint64_t seed, uint64_t stream)
{
    td_random random = {0, (stream << 1) | 1};
    td_random_u32(&random);
    random.state += seed;
    td_random_u32(&random);
    return random;
}

double td_random_uniform(td_random *random)
{
    uint64_t high = td_random_u32(random) >> 5, low = td_random_u32(random) >> 6;
    return ((double)high * 67108864.0 + (double)low) / 9007199254740992.0; /* 53 bits */
}

uint32_t td_random_below(td_random *random, uint32_t bound)
{
    uint32_t threshold = (0u - bound) % bound;
    for (;;) {
        uint32_t r = td_random_u32(random);
        if (r >= threshold) return r % bound;
    }
}

double td_random_normal(td_random *random)
{
    /* The pair's second number is thrown away: the state stays two words, and replay needs nothing else. */
    for (;;) {
        double u = 2 * td_random_uniform(random) - 1, v = 2 * td_random_uniform(random) - 1;
        double s = u * u + v * v;
        if (s > 0 && s < 1) return u * sqrt(-2 * log(s) / s);
    }
}
