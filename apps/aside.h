/* Work aside: in a process of its own, forked, so that what is awaited in real time goes on meanwhile. It
 * sees everything as it was when it began, and gives back bytes. */
#ifndef TELEDIMOS_APPS_ASIDE_H
#define TELEDIMOS_APPS_ASIDE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#include "core/status.h"

typedef struct aside aside;
/* `work` writes into `out` what is to come back; false: it failed. Files and sockets of the caller are closed
 * there. Not while threads run. `behind`: by how much it is nicer to other processes. */
td_status aside_begin(aside **a, bool (*work)(void *user, FILE *out), void *user, int behind,
                      td_error *error);
/* Its process is ended if it goes on. */
void aside_free(aside **a);
int aside_fd(const aside *a); /* readable: aside_poll is worth it; -1: all has come */
/* Takes what has come. True: it has ended. */
bool aside_poll(aside *a);
/* What it gave; NULL: it failed, or has not ended. */
const void *aside_bytes(const aside *a, size_t *size);

#endif
