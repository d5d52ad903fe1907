/* The operator's page, and how it is sent to browsers. */
#ifndef TELEDIMOS_APPS_PANEL_PAGE_H
#define TELEDIMOS_APPS_PANEL_PAGE_H

#include <libwebsockets.h>

#include "apps/panel_files.h"

/* The files of the page as it is installed; /connect: how other programs connect to `url`. `locked`: by a
 * token. */
td_status panel_page_begin(panel_files *files, const char *url, bool locked, td_error *error);

/* A file on its way to a browser. */
typedef struct transfer {
    const unsigned char *data;
    size_t size, given;
} transfer;

/* Begins to send it: what libwebsockets is to be told by its callback. */
int panel_page_send(struct lws *wsi, transfer *t, const panel_file *f);
/* The next piece, by way of `piece`: `room` bytes behind LWS_PRE others. */
int panel_page_send_more(struct lws *wsi, transfer *t, unsigned char *piece, size_t room);

#endif
