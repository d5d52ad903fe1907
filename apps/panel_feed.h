/* What the session tells, as messages: to those who watch, and into the recording, which is written as they
 * come. Used by the server's thread. */
#ifndef TELEDIMOS_APPS_PANEL_FEED_H
#define TELEDIMOS_APPS_PANEL_FEED_H

#include "apps/panel_internal.h"
#include "apps/simulate_task_message.h"

/* Our own channels, after the recording's. */
enum { PANEL_SESSION = TASK_CHANNELS, PANEL_DIAGNOSTICS, PANEL_ABOUT, PANEL_PATH, PANEL_CHANNELS };

typedef struct panel_feed {
    panel_link *link;
    const scenario *scenario;
    const panel_parameter *parameter; /* (parameter_count) */
    int parameter_count;
    panel_hub hub;
    int index[PANEL_CHANNELS]; /* in the hub, one less than the number as advertised; -1: not there */
    td_mcap_channel about[PANEL_MAX_CHANNELS]; /* (about_count) as advertised */
    size_t about_count;
    td_mcap_writer *writer;
    int recorded[TASK_CHANNELS]; /* the recording's numbers */
    bool failed;                 /* it cannot be written: told once */
    double flushed_s;
    panel_sample last;
    td_log log;
    panel_desk *desk; /* lent: it gets the answers */
    const panel_counts *counts;
} panel_feed;

/* `feed` has link, scenario, log and counts; the desk comes later. */
td_status panel_feed_begin(panel_feed *feed, const char *recording, const char *identity, td_error *error);
void panel_feed_free(panel_feed *feed);
/* All that the session has put into its rings. */
void panel_feed_take(panel_feed *feed);
void panel_feed_diagnose(panel_feed *feed);
/* Now and then: what a kill leaves of the recording. */
void panel_feed_flush(panel_feed *feed, double now_s);
/* A further channel of states, which is not recorded: its index in the hub. */
td_status panel_feed_add(panel_feed *feed, int *index, const td_mcap_channel *about, td_error *error);
td_status panel_feed_finish(panel_feed *feed, long period, double time_s, td_error *error);

#endif
