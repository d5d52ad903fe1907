/* Writing MCAP: chunks as they fill, their index at the end. */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <zlib.h>

#include "core/bytes_internal.h"
#include "core/file_internal.h"
#include "core/mcap_internal.h"
#include "core/text_internal.h"

static const size_t MAX_CHUNK = (size_t)64 << 20, MAX_MESSAGE = (size_t)256 << 20;

typedef struct stream {
    uint64_t messages;
    uint32_t sequence;
    td_text index; /* time and place of its messages in this chunk */
} stream;

struct td_mcap_writer {
    td_mcap_options options;
    char *path, *part;
    int fd;
    uint64_t offset; /* bytes written */
    uint32_t sum;    /* of all of them */
    int schema_count, channel_count;
    stream *channel;
    td_text schemas, channels, chunks; /* records of the summary */
    td_text chunk;                     /* records of the one that fills */
    uint64_t chunk_messages, chunk_start_ns, chunk_end_ns;
    uint64_t messages, start_ns, end_ns;
    uint32_t chunk_count;
    td_error failure; /* status TD_OK: none */
};

td_mcap_options td_mcap_options_default(void)
{
    return (td_mcap_options){.chunk_bytes = (size_t)1 << 20};
}

static void put(td_text *to, uint64_t value, int size)
{
    unsigned char bytes[8], *at = bytes;
    td_put(&at, value, size);
    td_text_add(to, (const char *)bytes, (size_t)size);
}

static void put_counted(td_text *to, const void *bytes, size_t size)
{
    put(to, size, 4);
    if (size > 0) td_text_add(to, bytes, size);
}

static void put_prefix(td_text *to, int kind, uint64_t size)
{
    put(to, (uint64_t)kind, 1);
    put(to, size, 8);
}

/* What went wrong first, again. */
static td_status failed(td_mcap_writer *writer, td_error *error)
{
    if (error) *error = writer->failure;
    return writer->failure.status;
}

static td_status no_memory(td_mcap_writer *writer, td_error *error)
{
    td_fail(&writer->failure, TD_ERROR_MEMORY, "%s: no memory to record in", writer->path);
    return failed(writer, error);
}

static td_status add(td_mcap_writer *writer, const void *bytes, size_t size)
{
    TD_TRY(td_file_part_add(writer->fd, writer->path, bytes, size, &writer->failure));
    writer->sum = (uint32_t)crc32_z(writer->sum, bytes, size);
    writer->offset += size;
    return TD_OK;
}

/* Writes a text that was built, and frees it. */
static td_status add_text(td_mcap_writer *writer, td_text *text)
{
    td_status status = TD_OK;
    if (text->failed)
        status = no_memory(writer, NULL);
    else if (text->size > 0)
        status = add(writer, text->data, text->size);
    free(text->data);
    *text = (td_text){0};
    return status;
}

static td_status begin(td_mcap_writer *writer)
{
    static const char library[] = "teledimos";
    td_text head = {0};
    td_text_add(&head, TD_MCAP_MAGIC, TD_MCAP_MAGIC_SIZE);
    put_prefix(&head, TD_MCAP_HEADER, 4 + 4 + sizeof library - 1);
    put_counted(&head, NULL, 0);
    put_counted(&head, library, sizeof library - 1);
    return add_text(writer, &head);
}

td_status td_mcap_writer_open(td_mcap_writer **writer, const char *path, const char *ending,
                              const td_mcap_options *options, td_error *error)
{
    *writer = NULL;
    const size_t length = strlen(path), end = strlen(ending);
    td_mcap_writer *made = calloc(1, sizeof *made);
    if (made) made->part = malloc(length + end + 1);
    if (made) made->path = strdup(path);
    if (!made || !made->part || !made->path) {
        if (made) free(made->part);
        if (made) free(made->path);
        free(made);
        return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to record in", path);
    }
    memcpy(made->part, path, length);
    memcpy(made->part + length, ending, end + 1);
    made->options = options ? *options : td_mcap_options_default();
    made->fd = -1;
    td_status status = TD_OK;
    if (made->options.chunk_bytes < 1 || made->options.chunk_bytes > MAX_CHUNK)
        status = td_fail(&made->failure, TD_ERROR_ARGUMENT, "chunk_bytes must be 1 to %zu, not %zu",
                         MAX_CHUNK, made->options.chunk_bytes);
    if (status == TD_OK) status = td_file_part_begin(&made->fd, made->part, path, &made->failure);
    if (status == TD_OK) status = begin(made);
    if (status != TD_OK) {
        failed(made, error);
        td_mcap_writer_free(&made);
    }
    *writer = made;
    return status;
}

td_status td_mcap_writer_new(td_mcap_writer **writer, const char *path, const td_mcap_options *options,
                             td_error *error)
{
    return td_mcap_writer_open(writer, path, ".part", options, error);
}

static void release(td_mcap_writer **writer)
{
    td_mcap_writer *w = *writer;
    for (int i = 0; i < w->channel_count; i++) free(w->channel[i].index.data);
    free(w->channel);
    free(w->schemas.data);
    free(w->channels.data);
    free(w->chunks.data);
    free(w->chunk.data);
    free(w->path);
    free(w->part);
    free(w);
    *writer = NULL;
}

void td_mcap_writer_free(td_mcap_writer **writer)
{
    if (!writer || !*writer) return;
    if ((*writer)->fd >= 0) {
        unlink((*writer)->part);
        close((*writer)->fd);
    }
    release(writer);
}

/* Number of a schema stored before; 0: none. */
static unsigned find_schema(const td_mcap_writer *writer, const td_text *content)
{
    td_mcap_bytes all = {(const unsigned char *)writer->schemas.data, writer->schemas.size, false}, one;
    while (all.left > 0 && td_mcap_record(&one, &all)) {
        const unsigned id = (unsigned)td_mcap_take(&one, 2);
        if (one.left == content->size && memcmp(one.at, content->data, one.left) == 0) return id;
    }
    return 0;
}

/* A numbered record, to the chunk and to the summary. */
static void put_twice(td_mcap_writer *writer, td_text *summary, int kind, unsigned id, const td_text *content)
{
    td_text *to[] = {&writer->chunk, summary};
    for (int i = 0; i < 2; i++) {
        put_prefix(to[i], kind, 2 + content->size);
        put(to[i], id, 2);
        td_text_add(to[i], content->data, content->size);
    }
}

/* Number of the channel's schema, stored when it is new; 0: it has none. */
static td_status add_schema(td_mcap_writer *writer, unsigned *id, const td_mcap_channel *about)
{
    *id = 0;
    if (!about->schema_name) return TD_OK;
    td_text content = {0};
    put_counted(&content, about->schema_name, strlen(about->schema_name));
    put_counted(&content, about->schema_encoding, strlen(about->schema_encoding));
    put_counted(&content, about->schema, about->schema_size);
    if (!content.failed) *id = find_schema(writer, &content);
    td_status status = content.failed ? no_memory(writer, NULL) : TD_OK;
    if (status == TD_OK && *id == 0) {
        *id = (unsigned)++writer->schema_count;
        put_twice(writer, &writer->schemas, TD_MCAP_SCHEMA, *id, &content);
    }
    free(content.data);
    return status;
}

static bool is_utf8(const char *text)
{
    return !text || td_utf8_check(text, strlen(text)) == strlen(text);
}

static td_status check_channel(const td_mcap_writer *writer, const td_mcap_channel *about, td_error *error)
{
    if (!about->topic || !*about->topic || !about->encoding)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: a channel has no topic or no encoding", writer->path);
    if (about->schema_name && (!about->schema_encoding || (!about->schema && about->schema_size > 0)))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: the schema of channel '%s' has no encoding or no text",
                       writer->path, about->topic);
    if (!is_utf8(about->topic) || !is_utf8(about->encoding) || !is_utf8(about->schema_name) ||
        !is_utf8(about->schema_encoding))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: a channel's topic, encoding or schema is not UTF-8",
                       writer->path);
    if (writer->channel_count == TD_MCAP_MAX_IDS || about->schema_size > MAX_CHUNK)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: channel '%s' is one too many, or its schema too large",
                       writer->path, about->topic);
    return TD_OK;
}

td_status td_mcap_channel_add(td_mcap_writer *writer, int *channel, const td_mcap_channel *about,
                              td_error *error)
{
    unsigned schema;
    if (writer->failure.status != TD_OK) return failed(writer, error);
    TD_TRY(check_channel(writer, about, error));
    stream *larger = realloc(writer->channel, (size_t)(writer->channel_count + 1) * sizeof *larger);
    if (!larger) return no_memory(writer, error);
    writer->channel = larger;
    if (add_schema(writer, &schema, about) != TD_OK) return failed(writer, error);
    td_text content = {0};
    put(&content, schema, 2);
    put_counted(&content, about->topic, strlen(about->topic));
    put_counted(&content, about->encoding, strlen(about->encoding));
    put(&content, 0, 4); /* no metadata */
    if (!content.failed)
        put_twice(writer, &writer->channels, TD_MCAP_CHANNEL, (unsigned)writer->channel_count + 1, &content);
    const bool full = content.failed || writer->chunk.failed || writer->channels.failed;
    free(content.data);
    if (full) return no_memory(writer, error);
    larger[writer->channel_count] = (stream){0};
    *channel = writer->channel_count++;
    return TD_OK;
}

/* The head of the chunk, its records, the places of its messages by channel; and its line of the summary. */
static td_status write_chunk(td_mcap_writer *w)
{
    if (w->chunk.failed) return no_memory(w, NULL);
    if (w->chunk.size == 0) return TD_OK;
    const uint64_t at = w->offset, size = w->chunk.size;
    td_text head = {0}, places = {0}, map = {0};
    put_prefix(&head, TD_MCAP_CHUNK, TD_MCAP_CHUNK_SIZE + size);
    put(&head, w->chunk_start_ns, 8);
    put(&head, w->chunk_end_ns, 8);
    put(&head, size, 8);
    put(&head, crc32_z(0, (const unsigned char *)w->chunk.data, size), 4);
    put_counted(&head, NULL, 0);
    put(&head, size, 8);
    const uint64_t index_at = at + TD_MCAP_PREFIX_SIZE + TD_MCAP_CHUNK_SIZE + size;
    for (int i = 0; i < w->channel_count; i++) {
        td_text *index = &w->channel[i].index;
        if (index->failed) places.failed = true;
        if (index->size == 0) continue;
        put(&map, (uint64_t)i + 1, 2);
        put(&map, index_at + places.size, 8);
        put_prefix(&places, TD_MCAP_MESSAGE_INDEX, 2 + 4 + index->size);
        put(&places, (uint64_t)i + 1, 2);
        put_counted(&places, index->data, index->size);
        index->size = 0;
    }
    put_prefix(&w->chunks, TD_MCAP_CHUNK_INDEX, 4 * 8 + 4 + map.size + 8 + 4 + 2 * 8);
    put(&w->chunks, w->chunk_start_ns, 8);
    put(&w->chunks, w->chunk_end_ns, 8);
    put(&w->chunks, at, 8);
    put(&w->chunks, index_at - at, 8);
    put_counted(&w->chunks, map.data, map.size);
    put(&w->chunks, places.size, 8);
    put_counted(&w->chunks, NULL, 0);
    put(&w->chunks, size, 8);
    put(&w->chunks, size, 8);
    td_status status = map.failed || w->chunks.failed ? no_memory(w, NULL) : add_text(w, &head);
    if (status == TD_OK) status = add(w, w->chunk.data, size);
    if (status == TD_OK) status = add_text(w, &places);
    free(head.data);
    free(places.data);
    free(map.data);
    w->chunk.size = 0;
    w->chunk_count++;
    w->chunk_messages = w->chunk_start_ns = w->chunk_end_ns = 0;
    return status;
}

static void widen(uint64_t *start, uint64_t *end, uint64_t count, uint64_t time)
{
    if (count == 0 || time < *start) *start = time;
    if (count == 0 || time > *end) *end = time;
}

td_status td_mcap_write_message(td_mcap_writer *writer, const td_mcap_message *message, td_error *error)
{
    td_mcap_writer *w = writer;
    if (w->failure.status != TD_OK) return failed(w, error);
    if (message->channel < 0 || message->channel >= w->channel_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: has no channel %d", w->path, message->channel);
    if (message->size > MAX_MESSAGE)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: a message of %zu bytes is larger than the %zu accepted",
                       w->path, message->size, MAX_MESSAGE);
    stream *channel = w->channel + message->channel;
    put(&channel->index, message->log_time_ns, 8);
    put(&channel->index, w->chunk.size, 8);
    put_prefix(&w->chunk, TD_MCAP_MESSAGE, TD_MCAP_MESSAGE_SIZE + message->size);
    put(&w->chunk, (uint64_t)message->channel + 1, 2);
    put(&w->chunk, message->sequence, 4);
    put(&w->chunk, message->log_time_ns, 8);
    put(&w->chunk, message->publish_time_ns, 8);
    if (message->size > 0) td_text_add(&w->chunk, message->data, message->size);
    if (w->chunk.failed || channel->index.failed) return no_memory(w, error);
    widen(&w->chunk_start_ns, &w->chunk_end_ns, w->chunk_messages++, message->log_time_ns);
    widen(&w->start_ns, &w->end_ns, w->messages++, message->log_time_ns);
    channel->messages++;
    if (w->chunk.size >= w->options.chunk_bytes && write_chunk(w) != TD_OK) return failed(w, error);
    return TD_OK;
}

td_status td_mcap_write(td_mcap_writer *writer, int channel, uint64_t time_ns, const void *data, size_t size,
                        td_error *error)
{
    td_mcap_message message = {channel, 0, time_ns, time_ns, data, size};
    if (channel >= 0 && channel < writer->channel_count)
        message.sequence = writer->channel[channel].sequence++;
    return td_mcap_write_message(writer, &message, error);
}

td_status td_mcap_flush(td_mcap_writer *writer, td_error *error)
{
    if (writer->failure.status == TD_OK) write_chunk(writer);
    return writer->failure.status == TD_OK ? TD_OK : failed(writer, error);
}

static td_text statistics(const td_mcap_writer *w)
{
    td_text text = {0};
    const uint32_t map = (uint32_t)w->channel_count * 10;
    put_prefix(&text, TD_MCAP_STATISTICS, 8 + 2 + 4 * 4 + 2 * 8 + 4 + map);
    put(&text, w->messages, 8);
    put(&text, (uint64_t)w->schema_count, 2);
    put(&text, (uint64_t)w->channel_count, 4);
    put(&text, 0, 8); /* attachments, metadata */
    put(&text, w->chunk_count, 4);
    put(&text, w->start_ns, 8);
    put(&text, w->end_ns, 8);
    put(&text, map, 4);
    for (int i = 0; i < w->channel_count; i++) {
        put(&text, (uint64_t)i + 1, 2);
        put(&text, w->channel[i].messages, 8);
    }
    return text;
}

static td_status write_end(td_mcap_writer *w)
{
    td_text end = {0}, counts = statistics(w), offsets = {0};
    put_prefix(&end, TD_MCAP_DATA_END, 4);
    put(&end, w->sum, 4);
    TD_TRY(add_text(w, &end));
    const uint64_t summary = w->offset;
    w->sum = 0;
    const struct {
        int kind;
        td_text *records;
    } group[] = {{TD_MCAP_SCHEMA, &w->schemas},
                 {TD_MCAP_CHANNEL, &w->channels},
                 {TD_MCAP_STATISTICS, &counts},
                 {TD_MCAP_CHUNK_INDEX, &w->chunks}};
    td_status status = TD_OK;
    for (size_t i = 0; i < sizeof group / sizeof *group; i++) {
        const uint64_t start = w->offset;
        if (status == TD_OK) status = add_text(w, group[i].records);
        if (w->offset == start) continue;
        put_prefix(&offsets, TD_MCAP_SUMMARY_OFFSET, 1 + 8 + 8);
        put(&offsets, (uint64_t)group[i].kind, 1);
        put(&offsets, start, 8);
        put(&offsets, w->offset - start, 8);
    }
    free(counts.data);
    const uint64_t offsets_at = w->offset;
    put_prefix(&offsets, TD_MCAP_FOOTER, TD_MCAP_FOOTER_SIZE);
    put(&offsets, summary, 8);
    put(&offsets, offsets_at, 8);
    if (status == TD_OK) status = add_text(w, &offsets);
    free(offsets.data);
    put(&end, w->sum, 4);
    td_text_add(&end, TD_MCAP_MAGIC, TD_MCAP_MAGIC_SIZE);
    if (status == TD_OK) status = add_text(w, &end);
    free(end.data);
    return status;
}

td_status td_mcap_finish(td_mcap_writer **writer, td_error *error)
{
    td_mcap_writer *w = *writer;
    if (w->failure.status == TD_OK) write_chunk(w);
    if (w->failure.status == TD_OK) write_end(w);
    if (w->failure.status == TD_OK) {
        td_file_part_finish(w->fd, w->part, w->path, &w->failure);
        w->fd = -1;
    }
    const td_status status = w->failure.status;
    if (status != TD_OK) failed(w, error);
    if (w->fd >= 0) close(w->fd);
    release(writer);
    return status;
}
