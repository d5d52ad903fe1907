/* The panel's machine, which stands elsewhere: its link has a thread of its own, so that the heart beats and
 * orders go out whatever the session and the server do.
 *
 *   session's thread                  link's thread                server's thread
 *   panel_machine_say, _beat   ->     td_link: commands      ->    panel_machine_shown, _line, _picture
 *   panel_machine_state, _hear <-     td_link: images
 *
 * Nobody waits. A link that is lost is made anew, until it holds. While the machine works under a session
 * that does not beat any more, it is stopped. */
#ifndef TELEDIMOS_APPS_PANEL_MACHINE_H
#define TELEDIMOS_APPS_PANEL_MACHINE_H

#include "apps/machine_address.h"
#include "apps/panel_ring.h"
#include "core/hash.h"
#include "core/machine_messages.h"

/* What is known of the machine. */
typedef struct panel_measured {
    panel_numbered head;
    bool open;      /* linked, and ours to command */
    bool has_state; /* the newest that came, and when */
    td_machine_state_message state;
    double heard_s;
    char why[300]; /* it is not open */
    td_link_measure link;
} panel_measured;

typedef struct panel_heard {
    panel_numbered head;
    enum {
        PANEL_LINKED,
        PANEL_UNLINKED,
        PANEL_TOLD, /* what was said to it: an order, or a task's hash */
        PANEL_ANSWERED,
        PANEL_STOPPED
    } kind;
    td_machine_answer answer; /* and its text: of all kinds */
    td_machine_stopped stopped;
} panel_heard;

typedef struct panel_said {
    panel_numbered head;
    td_machine_kind kind; /* TASK, ORDER, JOINTS, LOOK, PLAN */
    int look;
    td_machine_order order;
    td_plant_command command;
    td_machine_validation validation;
    char *text; /* of the task, or the plan; owned */
} panel_said;

typedef struct panel_picture {
    panel_numbered head;
    td_machine_image image; /* its bytes lie in: */
    double heard_s;
    uint8_t *bytes; /* owned */
} panel_picture;

typedef struct panel_machine panel_machine;
/* `model`: of the machine that is expected. `silent_s`: a session that does not beat for so long while the
 * machine works has it stopped. Everything is copied; nothing begins. */
td_status panel_machine_new(panel_machine **machine, const machine_address *address, const char *model,
                            int joints, double silent_s, td_error *error);
/* `wake`: the server, whenever there is something for it. */
td_status panel_machine_start(panel_machine *machine, void (*wake)(void *user), void *user, td_error *error);
/* What was said goes out first, for a moment; then farewell. */
void panel_machine_stop(panel_machine *machine);
void panel_machine_free(panel_machine **machine);

/* The session's thread: */
/* The newest; false: nothing new. */
bool panel_machine_state(panel_measured *newest, panel_machine *machine);
/* The next, to be given back; NULL: none. */
panel_heard *panel_machine_hear(panel_machine *machine);
void panel_machine_heard(panel_machine *machine, panel_heard *heard);
/* `text` is taken. False: it could not be said. */
bool panel_machine_say(panel_machine *machine, const panel_said *said);
void panel_machine_beat(panel_machine *machine);
void panel_machine_model(char model[TD_HASH_HEX_SIZE], const panel_machine *machine);

/* The server's thread: each to be given back; NULL: none. */
panel_measured *panel_machine_shown(panel_machine *machine);
void panel_machine_was_shown(panel_machine *machine, panel_measured *shown);
panel_heard *panel_machine_line(panel_machine *machine);
void panel_machine_lined(panel_machine *machine, panel_heard *line);
panel_picture *panel_machine_picture(panel_machine *machine);
void panel_machine_pictured(panel_machine *machine, panel_picture *picture);

#endif
