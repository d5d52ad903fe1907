/* Numbers as bytes, the least first, whatever the machine's order; `at` moves on. */
#ifndef TELEDIMOS_CORE_BYTES_INTERNAL_H
#define TELEDIMOS_CORE_BYTES_INTERNAL_H

#include <stdint.h>
#include <string.h>

/* The lowest `size` bytes of `bits`. */
static inline void td_put(unsigned char **at, uint64_t bits, int size)
{
    for (int i = 0; i < size; i++) *(*at)++ = (unsigned char)(bits >> (8 * i));
}

static inline void td_put_double(unsigned char **at, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    td_put(at, bits, 8);
}

static inline void td_put_float(unsigned char **at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    td_put(at, bits, 4);
}

#endif
