/* Recordings: messages on named channels with their times, in MCAP files (https://mcap.dev/spec), which
 * Foxglove and others open.
 *
 * Ours are written in chunks without compression, so that the same messages give the same bytes whatever
 * compressor is installed, with all indices and checksums; the order is that of writing. Times are
 * nanoseconds of the recording's own clock: simulation time, so that a run repeated is the same file. */
#ifndef TELEDIMOS_CORE_MCAP_H
#define TELEDIMOS_CORE_MCAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A stream of messages of one kind. Texts are UTF-8. */
typedef struct td_mcap_channel {
    const char *topic;                         /* "/machine/joints" */
    const char *encoding;                      /* of the messages: "json" */
    const char *schema_name, *schema_encoding; /* "foxglove.Log", "jsonschema"; schema_name NULL: no schema */
    const void *schema;
    size_t schema_size;
} td_mcap_channel;

typedef struct td_mcap_message {
    int channel; /* as td_mcap_channel_add gave it; in a reader: index into td_mcap_info.channel */
    uint32_t sequence;
    uint64_t log_time_ns, publish_time_ns;
    const void *data;
    size_t size;
} td_mcap_message;

/* Seconds as nanoseconds, rounded. False for what is negative, not finite or beyond 2^63 ns. */
TD_API bool td_mcap_time(uint64_t *time_ns, double time_s);

/* Writing */

typedef struct td_mcap_options {
    size_t chunk_bytes; /* a chunk is written when it holds this much; 1 MiB */
} td_mcap_options;
TD_API td_mcap_options td_mcap_options_default(void);

typedef struct td_mcap_writer td_mcap_writer;

/* Writes to "PATH.part" until td_mcap_finish puts the whole file in its place. After a crash or kill PATH is
 * as it was, and PATH.part holds all chunks that were full, for td_mcap_recover; the next recording of that
 * name replaces it. Refused while another process writes there. Options NULL: defaults. */
TD_API td_status td_mcap_writer_new(td_mcap_writer **writer, const char *path, const td_mcap_options *options,
                                    td_error *error);
/* Throws the recording away, with its PATH.part. */
TD_API void td_mcap_writer_free(td_mcap_writer **writer);
/* At any time before the channel's first message. All is copied. Schemas of equal name, encoding and text are
 * stored once. */
TD_API td_status td_mcap_channel_add(td_mcap_writer *writer, int *channel, const td_mcap_channel *about,
                                     td_error *error);
/* Times may come in any order. The data are copied. A failure to write is kept: all later calls say it again.
 */
TD_API td_status td_mcap_write(td_mcap_writer *writer, int channel, uint64_t time_ns, const void *data,
                               size_t size, td_error *error);
/* The same with a sequence number and a publishing time of one's own. */
TD_API td_status td_mcap_write_message(td_mcap_writer *writer, const td_mcap_message *message,
                                       td_error *error);
/* Gives what was written so far to the system, so that a kill does not lose it; it ends the chunk. */
TD_API td_status td_mcap_flush(td_mcap_writer *writer, td_error *error);
/* Index, rename, and frees the writer, on failure too: then PATH is as it was, and PATH.part is kept. */
TD_API td_status td_mcap_finish(td_mcap_writer **writer, td_error *error);

/* Reading */

typedef struct td_mcap_info {
    const char *profile, *library; /* what the writer says of itself */
    int channel_count;
    const td_mcap_channel *channel; /* by their numbers in the file */
    uint64_t message_count, start_ns, end_ns;
} td_mcap_info;

typedef struct td_mcap_reader td_mcap_reader;

/* Reads header and index; no message yet. Holds in memory the index and those chunks whose times overlap, at
 * most `memory_bytes` (0: 512 MiB) together. Refused, naming the file: no MCAP, cut off, without index, sums
 * that do not match, parts that contradict each other, compressed chunks. What a damage may change unseen is
 * not used: the index of messages is made anew from the chunks, whose sums are checked. */
TD_API td_status td_mcap_open(td_mcap_reader **reader, const char *path, size_t memory_bytes,
                              td_error *error);
/* The same from memory, which must outlive the reader; `name` is for messages. */
TD_API td_status td_mcap_parse(td_mcap_reader **reader, const void *bytes, size_t size, size_t memory_bytes,
                               const char *name, td_error *error);
TD_API void td_mcap_free(td_mcap_reader **reader);
TD_API const td_mcap_info *td_mcap_about(const td_mcap_reader *reader);
/* -1: none. */
TD_API int td_mcap_find(const td_mcap_reader *reader, const char *topic);
/* Begins again with the first message at or after from_ns. `wanted` (channel_count; NULL: all) says of which
 * channels. */
TD_API void td_mcap_rewind(td_mcap_reader *reader, const bool *wanted, uint64_t from_ns);
/* The next message in the order of log times, equal times in the order of the file. *more is false at the
 * end. message->data is lent until the next call. */
TD_API td_status td_mcap_next(td_mcap_reader *reader, td_mcap_message *message, bool *more, td_error *error);

/* Makes a whole file of what can be read of one that was cut off or damaged (PATH.part of a killed run). */
typedef struct td_mcap_recovered {
    uint64_t messages;
    uint64_t lost_chunks; /* of wrong sums */
    uint64_t lost_bytes;  /* in them, and after the last whole record */
} td_mcap_recovered;
TD_API td_status td_mcap_recover(td_mcap_recovered *recovered, const char *path, const char *damaged,
                                 td_error *error);

#ifdef __cplusplus
}
#endif
#endif
