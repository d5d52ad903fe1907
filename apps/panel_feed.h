/* What the session tells, as messages: to those who watch, and into the recording, which is written as they
 * come. Used by the server's thread. */
#ifndef TELEDIMOS_APPS_PANEL_FEED_H
#define TELEDIMOS_APPS_PANEL_FEED_H

#include "apps/panel_internal.h"
#include "apps/simulate_task_message.h"

/* Our own channels, after the recording's; the last are of a machine elsewhere. */
enum {
    PANEL_SESSION = TASK_CHANNELS,
    PANEL_DIAGNOSTICS,
    PANEL_ABOUT,
    PANEL_PATH,
    PANEL_MEASURED_TF,
    PANEL_MEASURED_JOINTS,
    PANEL_MEASURED_MACHINE,
    PANEL_FAR,
    PANEL_LEFT,
    PANEL_RIGHT,
    PANEL_CHANNELS
};

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
    int recorded[PANEL_CHANNELS]; /* the recording's numbers; -1: not there */
    bool failed;                  /* it cannot be written: told once */
    double flushed_s;
    panel_sample last;
    double ground_s; /* when the last ground came, */
    double image_s;  /* and the last image; 0: none yet */
    double link_told_s;
    far_machine *machine; /* lent; NULL: none */
    td_robot *ghost;      /* the robot with its frames named measured/… */
    td_log log;
    panel_desk *desk; /* lent: it gets the answers */
    const panel_counts *counts;
} panel_feed;

/* `feed` has link, scenario, log and counts; the desk comes later. */
td_status panel_feed_begin(panel_feed *feed, const char *recording, const char *identity, td_error *error);
void panel_feed_free(panel_feed *feed);
/* To those who watch, and into the recording where the channel has a place there. `json` is taken. */
td_status panel_feed_publish(panel_feed *feed, int channel, uint64_t time_ns, char *json, size_t size,
                             td_error *error);
void panel_feed_publish_json(panel_feed *feed, int channel, json_t *json);
/* The same as a task_sink takes it. */
td_status panel_feed_take_message(void *feed, task_channel channel, uint64_t time_ns, char *json, size_t size,
                                  td_error *error);
/* All that the session has put into its rings. */
void panel_feed_take(panel_feed *feed);
void panel_feed_diagnose(panel_feed *feed);
/* Now and then: what a kill leaves of the recording. */
void panel_feed_flush(panel_feed *feed, double now_s);
/* A further channel of states, which is not recorded: its index in the hub. */
td_status panel_feed_add(panel_feed *feed, int *index, const td_mcap_channel *about, td_error *error);
td_status panel_feed_finish(panel_feed *feed, long period, double time_s, td_error *error);

#endif
