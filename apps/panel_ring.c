#include "apps/panel_ring.h"

#include <stdlib.h>

bool panel_ring_begin(panel_ring *ring, size_t size, void (*release)(void *thing))
{
    *ring = (panel_ring){.size = size, .release = release};
    ring->slot = malloc(size * sizeof *ring->slot);
    for (size_t i = 0; ring->slot && i < size; i++) atomic_init(ring->slot + i, NULL);
    atomic_init(&ring->put, 0);
    return ring->slot != NULL;
}

void panel_ring_end(panel_ring *ring)
{
    for (size_t i = 0; ring->slot && i < ring->size; i++) {
        void *left = atomic_load(ring->slot + i);
        if (left) ring->release(left);
    }
    free(ring->slot);
    *ring = (panel_ring){0};
}

bool panel_ring_put(panel_ring *ring, void *thing)
{
    const uint64_t number = atomic_load_explicit(&ring->put, memory_order_relaxed);
    ((panel_numbered *)thing)->number = number;
    void *older = atomic_exchange_explicit(ring->slot + number % ring->size, thing, memory_order_acq_rel);
    atomic_store_explicit(&ring->put, number + 1, memory_order_release);
    if (older) ring->release(older);
    return older != NULL;
}

bool panel_ring_offer(panel_ring *ring, void *thing)
{
    const uint64_t number = atomic_load_explicit(&ring->put, memory_order_relaxed);
    if (atomic_load_explicit(ring->slot + number % ring->size, memory_order_acquire)) return false;
    panel_ring_put(ring, thing);
    return true;
}

/* The putter may drop what is about to be taken, and leave a newer one in its place: then the newer one is
 * taken, and those in between, whose turn has passed, are left for the putter to drop. */
void *panel_ring_take(panel_ring *ring)
{
    const uint64_t put = atomic_load_explicit(&ring->put, memory_order_acquire);
    if (put > ring->size && ring->taken < put - ring->size) ring->taken = put - ring->size;
    for (; ring->taken < put; ring->taken++) {
        void *thing =
            atomic_exchange_explicit(ring->slot + ring->taken % ring->size, NULL, memory_order_acq_rel);
        if (!thing) continue;
        const uint64_t number = ((panel_numbered *)thing)->number;
        ring->taken = number + 1;
        return thing;
    }
    return NULL;
}
