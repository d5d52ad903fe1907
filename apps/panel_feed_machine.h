/* What a machine elsewhere tells, as messages. Used by the server's thread. */
#ifndef TELEDIMOS_APPS_PANEL_FEED_MACHINE_H
#define TELEDIMOS_APPS_PANEL_FEED_MACHINE_H

#include "apps/panel_feed.h"

/* As advertised. */
td_mcap_channel panel_feed_machine_about(int channel);
/* Its shapes, and that it was there. */
td_status panel_feed_machine_begin(panel_feed *feed, td_error *error);
void panel_feed_machine_take(panel_feed *feed);

#endif
