/* MCAP records taken apart: strings, schemas, channels, chunks, messages. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "core/mcap_internal.h"
#include "core/text_internal.h"

bool td_mcap_time(uint64_t *time_ns, double time_s)
{
    const double ns = time_s * 1e9;
    if (!(ns >= -0.5 && ns < 9223372036854775807.0)) return false;
    *time_ns = (uint64_t)llround(ns);
    return true;
}

td_status td_mcap_text(char **text, td_mcap_bytes bytes, td_error *error)
{
    if (bytes.failed) return td_fail(error, TD_ERROR_FORMAT, "a record is cut short");
    if (td_utf8_check((const char *)bytes.at, bytes.left) != bytes.left)
        return td_fail(error, TD_ERROR_FORMAT, "a name is not UTF-8");
    char *copy = malloc(bytes.left + 1);
    if (!copy) return td_fail(error, TD_ERROR_MEMORY, "no memory for a name of %zu bytes", bytes.left);
    if (bytes.left > 0) memcpy(copy, bytes.at, bytes.left);
    copy[bytes.left] = 0;
    *text = copy;
    return TD_OK;
}

static void schema_free(td_mcap_schema *schema)
{
    free(schema->name);
    free(schema->encoding);
    free(schema->data);
}

static void channel_free(td_mcap_channel *channel)
{
    free((char *)(uintptr_t)channel->topic);
    free((char *)(uintptr_t)channel->encoding);
}

void td_mcap_names_free(td_mcap_names *names)
{
    for (int i = 0; i < names->schema_count; i++) schema_free(names->schema + i);
    for (int i = 0; i < names->channel_count; i++) channel_free(names->channel + i);
    free(names->schema);
    free(names->channel);
}

/* Room for one more, doubling at powers of two. */
static bool grow(void **array, int count, size_t size)
{
    if (count & (count - 1)) return true;
    void *larger = realloc(*array, (size_t)(count ? 2 * count : 1) * size);
    if (larger) *array = larger;
    return larger != NULL;
}

td_status td_mcap_names_schema(td_mcap_names *names, td_mcap_bytes content, td_error *error)
{
    const unsigned id = (unsigned)td_mcap_take(&content, 2);
    const td_mcap_bytes name = td_mcap_counted(&content), encoding = td_mcap_counted(&content),
                        data = td_mcap_counted(&content);
    if (content.failed) return td_fail(error, TD_ERROR_FORMAT, "a schema is cut short");
    if (id == 0 || names->schema_of[id]) return TD_OK;
    td_mcap_schema schema = {.data = malloc(data.left + 1), .size = data.left};
    td_status status = td_mcap_text(&schema.name, name, error);
    if (status == TD_OK) status = td_mcap_text(&schema.encoding, encoding, error);
    if (status == TD_OK &&
        (!schema.data || !grow((void **)&names->schema, names->schema_count, sizeof schema)))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for schema %u", id);
    if (status != TD_OK) {
        schema_free(&schema);
        return status;
    }
    memcpy(schema.data, data.at, data.left);
    names->schema[names->schema_count++] = schema;
    names->schema_of[id] = names->schema_count;
    return TD_OK;
}

td_status td_mcap_names_channel(td_mcap_names *names, td_mcap_bytes content, td_error *error)
{
    const unsigned id = (unsigned)td_mcap_take(&content, 2), schema_id = (unsigned)td_mcap_take(&content, 2);
    const td_mcap_bytes topic = td_mcap_counted(&content), encoding = td_mcap_counted(&content);
    char *text[2] = {NULL, NULL};
    if (content.failed) return td_fail(error, TD_ERROR_FORMAT, "a channel is cut short");
    if (names->channel_of[id]) return TD_OK;
    if (schema_id && !names->schema_of[schema_id])
        return td_fail(error, TD_ERROR_FORMAT, "channel %u has schema %u, which is not there", id, schema_id);
    td_status status = td_mcap_text(&text[0], topic, error);
    if (status == TD_OK) status = td_mcap_text(&text[1], encoding, error);
    if (status == TD_OK && !grow((void **)&names->channel, names->channel_count, sizeof *names->channel))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for channel %u", id);
    if (status != TD_OK) {
        free(text[0]);
        free(text[1]);
        return status;
    }
    td_mcap_channel *channel = names->channel + names->channel_count++;
    *channel = (td_mcap_channel){.topic = text[0], .encoding = text[1]};
    if (schema_id) {
        const td_mcap_schema *schema = names->schema + names->schema_of[schema_id] - 1;
        channel->schema_name = schema->name;
        channel->schema_encoding = schema->encoding;
        channel->schema = schema->data;
        channel->schema_size = schema->size;
    }
    names->channel_of[id] = names->channel_count;
    return TD_OK;
}

td_status td_mcap_chunk_open(td_mcap_chunk *chunk, bool *sum_wrong, td_mcap_bytes content, td_error *error)
{
    *sum_wrong = false;
    chunk->start_ns = td_mcap_take(&content, 8);
    chunk->end_ns = td_mcap_take(&content, 8);
    const uint64_t size = td_mcap_take(&content, 8);
    const uint32_t sum = (uint32_t)td_mcap_take(&content, 4);
    const td_mcap_bytes compression = td_mcap_counted(&content);
    chunk->records = td_mcap_part(&content, td_mcap_take(&content, 8));
    if (content.failed) return td_fail(error, TD_ERROR_FORMAT, "a chunk is cut short");
    if (compression.left > 0) {
        char text[64] = "", shown[TD_SHOWN_SIZE];
        memcpy(text, compression.at, compression.left < sizeof text ? compression.left : sizeof text - 1);
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "its chunks are compressed ('%s'); write it without compression (mcap compress "
                       "--compression none)",
                       td_text_shown(shown, text));
    }
    if (size != chunk->records.left || chunk->end_ns < chunk->start_ns)
        return td_fail(error, TD_ERROR_FORMAT, "a chunk's head contradicts itself");
    if (sum && sum != (uint32_t)crc32_z(0, chunk->records.at, chunk->records.left)) {
        *sum_wrong = true;
        return td_fail(error, TD_ERROR_FORMAT, "the sum of a chunk is wrong: the file is damaged");
    }
    return TD_OK;
}

bool td_mcap_message_open(td_mcap_message *message, td_mcap_bytes content)
{
    message->channel = (int)td_mcap_take(&content, 2);
    message->sequence = (uint32_t)td_mcap_take(&content, 4);
    message->log_time_ns = td_mcap_take(&content, 8);
    message->publish_time_ns = td_mcap_take(&content, 8);
    message->data = content.at;
    message->size = content.left;
    return !content.failed;
}
