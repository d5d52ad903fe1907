/* The session's side of a machine that stands elsewhere: what of its state and answers are reports to the
 * behaviour, and what of the behaviour's outputs are orders to the machine. Used by the session's thread. */
#ifndef TELEDIMOS_APPS_PANEL_LEAD_H
#define TELEDIMOS_APPS_PANEL_LEAD_H

#include "apps/far_machine.h"
#include "apps/simulate_task.h"

typedef struct panel_lead {
    far_machine *machine; /* lent; NULL: none */
    far_measured now;
    bool reinit, renewed;    /* Reinit was ordered; answered: it is over once the state shows it */
    bool sends, held, begun; /* the task: sent; held; its execution seen */
    char task[TD_HASH_HEX_SIZE];
    double since_s;
    char why[400]; /* the machine refused, or was stopped; "": not */
} panel_lead;

void panel_lead_look(panel_lead *l, td_phase phase, live_seen *seen);
td_status panel_lead_on(panel_lead *l, const live_lead *lead, int joints, td_error *error);

#endif
