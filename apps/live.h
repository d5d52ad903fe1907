/* The live picture beside a terminal: a local page in the browser, and a picture made of characters for those
 * who come over ssh. */
#ifndef TELEDIMOS_APPS_LIVE_H
#define TELEDIMOS_APPS_LIVE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/image.h"
#include "core/status.h"

typedef struct live live;

/* Serves http://127.0.0.1:PORT/ (port 0: any free one) on a thread of its own, to this machine only; pages of
 * other sites in its browser are refused. */
td_status live_open(live **page, int port, td_error *error);
void live_close(live **page);
const char *live_url(const live *page);

/* Line drawings over a picture. */
typedef struct live_mark {
    enum {
        LIVE_POINT,
        LIVE_LINE,
        LIVE_WISH
    } kind;             /* a found corner; a line; a line of where the board
                           should go */
    float x, y, x2, y2; /* px; a point has no x2, y2 */
} live_mark;

/* What is shown: `count` pictures side by side with their marks, a headline and a line for each fact. Copied;
 * the newest wins; browsers are told at once and show a picture at most 15 times a second. */
typedef struct live_view {
    int count;
    const td_image *image[2]; /* NULL: none yet */
    const live_mark *mark[2];
    size_t mark_count[2];
    const char *label[2];
    const char *headline; /* what to do now */
    const char *facts;    /* lines "name: value", or "name: left\tright"; ": left\tright" is a head; a line
                             without ": " is plain text */
    double done;          /* 0 to 1: the bar; NaN: none */
    bool frozen;          /* the picture stands still because it was asked to */
    const char *buttons;  /* those shown, as "freeze store done"; NULL: all */
} live_view;
td_status live_show(live *page, const live_view *view, td_error *error);
/* What was pressed on the page since the last call: "freeze", "store", "done", "skip"; NULL: nothing. Presses
 * are kept in their order, one for each call. */
const char *live_pressed(live *page);

/* The picture as text of at most `columns` by `rows` characters, as large as its shape allows (two pixels to
 * a character, by half blocks; colour: 24-bit; else grey by ASCII characters), marks drawn in. Lines end in
 * "\n". To be freed with free(). NULL: out of memory. */
char *live_text(const td_image *image, const live_mark *mark, size_t mark_count, int columns, int rows,
                bool colour);

#endif
