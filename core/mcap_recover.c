/* What can still be read of an MCAP file that was cut off or damaged, record by record from its start. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "core/mcap_internal.h"

typedef struct recovery {
    FILE *file;
    uint64_t left; /* bytes of the file not yet looked at */
    td_mcap_writer *writer;
    td_mcap_names *names;
    int known; /* channels that the writer has; they have the same order */
    td_mcap_recovered *recovered;
} recovery;

static td_status add_channels(recovery *r, td_error *error)
{
    for (; r->known < r->names->channel_count; r->known++) {
        int channel;
        TD_TRY(td_mcap_channel_add(r->writer, &channel, r->names->channel + r->known, error));
    }
    return TD_OK;
}

/* One record, of a chunk or outside of one. *fine is false where it cannot be what it says. */
static td_status take_record(recovery *r, bool *fine, int kind, td_mcap_bytes content, td_error *error)
{
    td_mcap_message message;
    td_status status = TD_OK;
    *fine = true;
    if (kind == TD_MCAP_SCHEMA) status = td_mcap_names_schema(r->names, content, error);
    if (kind == TD_MCAP_CHANNEL) status = td_mcap_names_channel(r->names, content, error);
    if (status == TD_ERROR_FORMAT) *fine = false;
    if (status != TD_OK) return *fine ? status : TD_OK;
    if (kind == TD_MCAP_CHANNEL) return add_channels(r, error);
    if (kind != TD_MCAP_MESSAGE) return TD_OK;
    *fine = td_mcap_message_open(&message, content) && r->names->channel_of[message.channel];
    if (!*fine) return TD_OK;
    message.channel = r->names->channel_of[message.channel] - 1;
    r->recovered->messages++;
    return td_mcap_write_message(r->writer, &message, error);
}

static td_status take_chunk(recovery *r, td_mcap_bytes content, td_error *error)
{
    td_mcap_chunk chunk;
    bool sum_wrong, fine = true;
    const size_t size = content.left;
    td_status status = td_mcap_chunk_open(&chunk, &sum_wrong, content, error);
    if (status == TD_ERROR_FORMAT) fine = false;
    if (status != TD_OK && fine) return status;
    td_mcap_bytes b = chunk.records;
    while (fine && b.left > 0) {
        const int kind = td_mcap_record(&content, &b);
        if (!kind) fine = false;
        if (kind) TD_TRY(take_record(r, &fine, kind, content, error));
    }
    if (!fine) {
        r->recovered->lost_chunks++;
        r->recovered->lost_bytes += size;
    }
    return TD_OK;
}

/* The next record of the file into *bytes, to be freed; *kind is 0 where the whole ones end. */
static td_status next_record(recovery *r, int *kind, td_mcap_bytes *content, unsigned char **bytes,
                             td_error *error)
{
    unsigned char prefix[TD_MCAP_PREFIX_SIZE];
    td_mcap_bytes b = {prefix, sizeof prefix, false};
    *kind = 0;
    *bytes = NULL;
    if (r->left < sizeof prefix || fread(prefix, 1, sizeof prefix, r->file) != sizeof prefix) return TD_OK;
    const int seen = (int)td_mcap_take(&b, 1);
    const uint64_t size = td_mcap_take(&b, 8);
    if (seen == 0 || size > r->left - sizeof prefix || size > TD_MCAP_DEFAULT_MEMORY) return TD_OK;
    *bytes = malloc((size_t)size + 1);
    if (!*bytes) return td_fail(error, TD_ERROR_MEMORY, "no memory for a record of %zu bytes", (size_t)size);
    if (fread(*bytes, 1, (size_t)size, r->file) != (size_t)size) return TD_OK;
    *content = (td_mcap_bytes){*bytes, (size_t)size, false};
    *kind = seen;
    r->left -= sizeof prefix + size;
    return TD_OK;
}

static td_status take_all(recovery *r, td_error *error)
{
    td_status status = TD_OK;
    for (bool more = true; more && status == TD_OK;) {
        unsigned char *bytes;
        td_mcap_bytes content = {0};
        int kind;
        bool fine;
        status = next_record(r, &kind, &content, &bytes, error);
        if (kind == 0) r->recovered->lost_bytes += r->left;
        more = kind != 0 && kind != TD_MCAP_DATA_END && kind != TD_MCAP_FOOTER;
        if (status == TD_OK && more && kind == TD_MCAP_CHUNK)
            status = take_chunk(r, content, error);
        else if (status == TD_OK && more)
            status = take_record(r, &fine, kind, content, error);
        free(bytes);
    }
    return status;
}

static td_status check_magic(recovery *r, td_error *error)
{
    char magic[TD_MCAP_MAGIC_SIZE];
    off_t size = -1;
    if (fseeko(r->file, 0, SEEK_END) == 0) size = ftello(r->file);
    if (size < 0 || fseeko(r->file, 0, SEEK_SET) != 0)
        return td_fail(error, TD_ERROR_IO, "cannot be read: %s", strerror(errno));
    if (fread(magic, 1, sizeof magic, r->file) != sizeof magic ||
        memcmp(magic, TD_MCAP_MAGIC, sizeof magic) != 0)
        return td_fail(error, TD_ERROR_FORMAT, "is no MCAP file: it begins with other bytes");
    r->left = (uint64_t)size - sizeof magic;
    return TD_OK;
}

td_status td_mcap_recover(td_mcap_recovered *recovered, const char *path, const char *damaged,
                          td_error *error)
{
    *recovered = (td_mcap_recovered){0};
    recovery r = {.recovered = recovered, .names = calloc(1, sizeof *r.names)};
    if (!r.names) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to recover it", damaged);
    td_status status = td_file_stream(&r.file, damaged, error);
    if (status == TD_OK && (status = check_magic(&r, error)) != TD_OK)
        td_error_prefix(error, status, "%s", damaged);
    /* Not under ".part", which may be the name of the damaged one. */
    if (status == TD_OK) status = td_mcap_writer_open(&r.writer, path, ".recovery", NULL, error);
    if (status == TD_OK && (status = take_all(&r, error)) != TD_OK)
        td_error_prefix(error, status, "%s", damaged);
    if (status == TD_OK) status = td_mcap_finish(&r.writer, error);
    td_mcap_writer_free(&r.writer);
    if (r.file) fclose(r.file);
    td_mcap_names_free(r.names);
    free(r.names);
    return status;
}
