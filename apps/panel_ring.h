/* Hands things from one thread to another without a lock: neither ever waits for the other.
 *
 * One thread puts, one takes. What is put belongs to the ring until it is taken. When the taker falls behind
 * by the ring's size, panel_ring_put drops the oldest for the newest (states), panel_ring_offer refuses the
 * new one (events and orders, which the putter then keeps). */
#ifndef TELEDIMOS_APPS_PANEL_RING_H
#define TELEDIMOS_APPS_PANEL_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct panel_ring {
    size_t size;
    _Atomic(void *) *slot; /* (size) things not taken yet; each begins with its number */
    void (*release)(void *thing);
    _Atomic uint64_t put; /* how many were, so far */
    uint64_t taken;       /* the taker's: the number of the next */
} panel_ring;

/* What every thing begins with; the ring fills it in. */
typedef struct panel_numbered {
    uint64_t number;
} panel_numbered;

/* False: out of memory. `release` frees a thing. */
bool panel_ring_begin(panel_ring *ring, size_t size, void (*release)(void *thing));
/* When both threads are done with it. */
void panel_ring_end(panel_ring *ring);

/* The putter's. Returns whether an older one was dropped. */
bool panel_ring_put(panel_ring *ring, void *thing);
/* The putter's. False: full; the thing is still the caller's. */
bool panel_ring_offer(panel_ring *ring, void *thing);
/* The taker's: the oldest that is left, in the order they were put; NULL: none. */
void *panel_ring_take(panel_ring *ring);

#endif
