/* A machine that stands elsewhere (teledimos machine), as the panel and rehearse lead it: its link has a
 * thread of its own, so that the heart beats and orders go out whatever the others do.
 *
 *   session's thread                link's thread                 server's thread
 *   far_machine_say, _beat   ->     td_link: commands      ->     far_machine_shown, _line, _picture
 *   far_machine_state, _hear <-     td_link: images
 *
 * A program that serves nobody (rehearse) takes both outer threads' parts. Nobody waits. A link that is lost
 * is made anew, until it holds. While the machine works under a session that does not beat any more, it is
 * stopped. */
#ifndef TELEDIMOS_APPS_FAR_MACHINE_H
#define TELEDIMOS_APPS_FAR_MACHINE_H

#include "apps/machine_address.h"
#include "apps/panel_ring.h"
#include "core/hash.h"
#include "core/machine_messages.h"

/* What is known of the machine. */
typedef struct far_measured {
    panel_numbered head;
    bool open;      /* linked, and ours to command */
    bool has_state; /* the newest that came, and when */
    td_machine_state_message state;
    double heard_s;
    char why[300]; /* it is not open */
    td_link_measure link;
} far_measured;

typedef struct far_heard {
    panel_numbered head;
    enum {
        FAR_LINKED,
        FAR_UNLINKED,
        FAR_TOLD, /* what was said to it: an order, or a task's hash */
        FAR_ANSWERED,
        FAR_STOPPED
    } kind;
    td_machine_answer answer; /* and its text: of all kinds */
    td_machine_stopped stopped;
} far_heard;

typedef struct far_said {
    panel_numbered head;
    td_machine_kind kind; /* TASK, ORDER, JOINTS, LOOK, PLAN */
    int look;
    td_machine_order order;
    td_plant_command command;
    td_machine_validation validation;
    char *text; /* of the task, or the plan; owned */
} far_said;

typedef struct far_picture {
    panel_numbered head;
    td_machine_image image; /* its bytes lie in: */
    double heard_s;
    uint8_t *bytes; /* owned */
} far_picture;

typedef struct far_machine far_machine;
/* `model`: of the machine that is expected. `silent_s`: a session that does not beat for so long while the
 * machine works has it stopped. Everything is copied; nothing begins. */
td_status far_machine_new(far_machine **machine, const machine_address *address, const char *model,
                          int joints, double silent_s, td_error *error);
/* `wake`: the server, whenever there is something for it. */
td_status far_machine_start(far_machine *machine, void (*wake)(void *user), void *user, td_error *error);
/* What was said goes out first, for a moment; then farewell. */
void far_machine_stop(far_machine *machine);
void far_machine_free(far_machine **machine);

/* The session's thread: */
/* The newest; false: nothing new. */
bool far_machine_state(far_measured *newest, far_machine *machine);
/* The next, to be given back; NULL: none. */
far_heard *far_machine_hear(far_machine *machine);
void far_machine_heard(far_machine *machine, far_heard *heard);
/* `text` is taken. False: it could not be said. */
bool far_machine_say(far_machine *machine, const far_said *said);
void far_machine_beat(far_machine *machine);
void far_machine_model(char model[TD_HASH_HEX_SIZE], const far_machine *machine);

/* The server's thread: each to be given back; NULL: none. */
far_measured *far_machine_shown(far_machine *machine);
void far_machine_was_shown(far_machine *machine, far_measured *shown);
far_heard *far_machine_line(far_machine *machine);
void far_machine_lined(far_machine *machine, far_heard *line);
far_picture *far_machine_picture(far_machine *machine);
void far_machine_pictured(far_machine *machine, far_picture *picture);

#endif
