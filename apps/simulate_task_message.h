/* What happens in a session as messages: the same for recording.mcap and for those who watch it live. */
#ifndef TELEDIMOS_APPS_SIMULATE_TASK_MESSAGE_H
#define TELEDIMOS_APPS_SIMULATE_TASK_MESSAGE_H

#include "apps/simulate_task.h"
#include "core/mcap.h"

typedef enum task_channel {
    TASK_TF,
    TASK_JOINTS,
    TASK_WANTED,
    TASK_TOOL,
    TASK_TOOL_WANTED,
    TASK_MACHINE,
    TASK_LOG,
    TASK_TERRAIN, /* only on a ground */
    TASK_INPUTS,  /* orders and reports with their periods: what --replay reads */
    TASK_CHANNELS
} task_channel;
extern const char task_input_topic[];
td_mcap_channel task_channel_about(task_channel channel);

/* Where messages go. `take` gets the text, to be freed with free(). */
typedef struct task_sink {
    td_status (*take)(void *user, task_channel channel, uint64_t time_ns, char *json, size_t size,
                      td_error *error);
    void *user;
    double begun_s, period_s; /* where sessions follow one another: of this one's begin; of their control */
} task_sink;

/* The machine's shapes, and which scenario it is. */
td_status task_message_begin(const task_sink *to, const td_robot *robot, const char *identity,
                             td_error *error);
/* A line of the log that belongs to no session, at its begin. */
td_status task_message_text(const task_sink *to, const char *name, const char *text, td_error *error);
td_status task_message_sample(const task_sink *to, const td_robot *robot, const task_sample *sample,
                              td_error *error);
td_status task_message_note(const task_sink *to, const td_robot *robot, const task_note *note,
                            td_error *error);
td_status task_message_ground(const task_sink *to, const task_ground *ground, td_error *error);
/* Of the kinds "scenario", "parameter" (which is not replayed) … */
td_status task_message_input(const task_sink *to, const td_robot *robot, long period, double time_s,
                             const char *kind, const char *name, int joint, double stick, td_error *error);
td_status task_message_end(const task_sink *to, long period, double time_s, td_error *error);

/* A recording with all of the channels; `on_ground`: with TASK_TERRAIN. */
td_status task_recording_begin(td_mcap_writer **writer, int channel[TASK_CHANNELS], const char *path,
                               bool on_ground, td_error *error);

#endif
