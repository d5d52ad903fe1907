/* Who is let in: the token, and the origin of a page in a browser. */
#ifndef TELEDIMOS_APPS_PANEL_DOOR_H
#define TELEDIMOS_APPS_PANEL_DOOR_H

#include <stdbool.h>
#include <stddef.h>

#include "core/hash.h"

typedef struct panel_door {
    bool local;                   /* listens to this machine only */
    bool locked;                  /* a token is asked for: */
    char token[TD_HASH_HEX_SIZE]; /* its hash: what is compared takes the same time whatever it is */
    const char *const *origin;    /* allowed besides our own */
    size_t origin_count;
} panel_door;

/* 16 to 128 letters, digits and -._~, in the file's first line. */
td_status panel_door_token(panel_door *door, const char *path, td_error *error);
/* NULL: not given. */
bool panel_door_knows(const panel_door *door, const char *token);
/* "" : none, so no browser. `host`: as the request has it. Our own: local to this machine where only that is
 * listened to, else the page that we serve ourselves. */
bool panel_door_takes_origin(const panel_door *door, const char *origin, const char *host);
/* "127.0.0.1:8765". `host` gets the address; it must be IPv4. */
td_status panel_door_address(char *host, size_t size, int *port, const char *text, td_error *error);
bool panel_door_is_local(const char *host);

#endif
