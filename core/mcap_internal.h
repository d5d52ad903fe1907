/* What the writer, the reader and the recovery of MCAP files share. */
#ifndef TELEDIMOS_CORE_MCAP_INTERNAL_H
#define TELEDIMOS_CORE_MCAP_INTERNAL_H

#include <stdio.h>

#include "core/mcap.h"

#define TD_MCAP_MAGIC "\x89MCAP0\r\n"

enum {
    TD_MCAP_HEADER = 1,
    TD_MCAP_FOOTER,
    TD_MCAP_SCHEMA,
    TD_MCAP_CHANNEL,
    TD_MCAP_MESSAGE,
    TD_MCAP_CHUNK,
    TD_MCAP_MESSAGE_INDEX,
    TD_MCAP_CHUNK_INDEX,
    TD_MCAP_STATISTICS = 11,
    TD_MCAP_SUMMARY_OFFSET = 14,
    TD_MCAP_DATA_END = 15
};
enum {
    TD_MCAP_MAGIC_SIZE = 8,
    TD_MCAP_PREFIX_SIZE = 9, /* of a record: what it is, and its length */
    TD_MCAP_FOOTER_SIZE = 20,
    TD_MCAP_MESSAGE_SIZE = 22, /* without its data */
    TD_MCAP_CHUNK_SIZE = 40,   /* without the name of its compression and its records */
    TD_MCAP_MAX_IDS = 65535
};
#define TD_MCAP_DEFAULT_MEMORY ((size_t)512 << 20)

/* Bytes being taken apart: `failed` once more was asked for than there is. */
typedef struct td_mcap_bytes {
    const unsigned char *at;
    size_t left;
    bool failed;
} td_mcap_bytes;

static inline uint64_t td_mcap_take(td_mcap_bytes *b, int size)
{
    uint64_t value = 0;
    if (b->failed || b->left < (size_t)size) {
        b->failed = true;
        return 0;
    }
    for (int i = 0; i < size; i++) value |= (uint64_t)b->at[i] << (8 * i);
    b->at += size;
    b->left -= (size_t)size;
    return value;
}

/* The next `size` bytes, apart. */
static inline td_mcap_bytes td_mcap_part(td_mcap_bytes *b, uint64_t size)
{
    td_mcap_bytes part = {0};
    if (b->failed || b->left < size) {
        b->failed = true;
        return part;
    }
    part = (td_mcap_bytes){b->at, (size_t)size, false};
    b->at += size;
    b->left -= (size_t)size;
    return part;
}

/* Bytes with their length before them in 32 bits: strings, arrays, maps. */
static inline td_mcap_bytes td_mcap_counted(td_mcap_bytes *b)
{
    return td_mcap_part(b, td_mcap_take(b, 4));
}

/* A record: what it is (0: none whole) and its content. */
static inline int td_mcap_record(td_mcap_bytes *content, td_mcap_bytes *b)
{
    const int kind = (int)td_mcap_take(b, 1);
    *content = td_mcap_part(b, td_mcap_take(b, 8));
    return b->failed ? 0 : kind;
}

/* Schemas and channels as they are met in a file. Large: on the heap. */
typedef struct td_mcap_schema {
    char *name, *encoding;
    void *data;
    size_t size;
} td_mcap_schema;

typedef struct td_mcap_names {
    int schema_count, channel_count;
    td_mcap_schema *schema;
    td_mcap_channel *channel; /* topic and encoding are owned, the schema's texts lent */
    int schema_of[TD_MCAP_MAX_IDS + 1], channel_of[TD_MCAP_MAX_IDS + 1]; /* index + 1 of a number; 0: none */
} td_mcap_names;

void td_mcap_names_free(td_mcap_names *names);
/* A number met before is left as it is. The sentence does not name the file. */
td_status td_mcap_names_schema(td_mcap_names *names, td_mcap_bytes content, td_error *error);
td_status td_mcap_names_channel(td_mcap_names *names, td_mcap_bytes content, td_error *error);
/* Text of bytes, refused when not UTF-8; free(). */
td_status td_mcap_text(char **text, td_mcap_bytes bytes, td_error *error);

typedef struct td_mcap_chunk {
    uint64_t start_ns, end_ns;
    td_mcap_bytes records;
} td_mcap_chunk;
/* Takes a chunk record apart and checks its sum; *sum_wrong tells that apart from what else is refused. The
 * sentence does not name the file. */
td_status td_mcap_chunk_open(td_mcap_chunk *chunk, bool *sum_wrong, td_mcap_bytes content, td_error *error);
/* Channel (its number, not its index), times and data of a message record. */
bool td_mcap_message_open(td_mcap_message *message, td_mcap_bytes content);

/* As td_mcap_writer_new, with the ending of the name it has until it is whole. */
td_status td_mcap_writer_open(td_mcap_writer **writer, const char *path, const char *ending,
                              const td_mcap_options *options, td_error *error);

#endif
