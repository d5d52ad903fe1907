/* Reading MCAP: by the index at the end, chunk by chunk, in the order of time. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "core/file.h"
#include "core/mcap_internal.h"

static const uint64_t MAX_HEADER = 65536;

typedef struct place {
    uint64_t start_ns, end_ns, offset, length;
    td_mcap_bytes map; /* channels and where their messages are listed; in the summary's bytes */
} place;

typedef struct entry {
    uint64_t time_ns, at; /* of a message record in the chunk's records */
} entry;

/* A chunk in memory. */
typedef struct loaded {
    uint64_t offset; /* in the file: the order of what is of the same time */
    unsigned char *bytes;
    td_mcap_bytes records;
    entry *entry;
    size_t count, next, memory;
} loaded;

struct td_mcap_reader {
    FILE *file;
    char *name;
    uint64_t size;
    size_t memory, memory_limit;
    char *profile, *library;
    unsigned char *summary;
    td_mcap_names names;
    td_mcap_info info;
    place *place; /* (place_count) by start */
    size_t place_count, place_room, place_next;
    loaded *heap; /* (heap_count), the earliest next message first */
    size_t heap_count, heap_room;
    bool *wanted; /* (channel_count) */
    uint64_t from_ns;
    uint64_t chunks_told; /* by the statistics */
    bool lent;            /* the message last given lies in heap[0] */
};

static td_status take_memory(td_mcap_reader *r, void **memory, uint64_t size, td_error *error)
{
    *memory = NULL;
    if (size > r->memory_limit - r->memory)
        return td_fail(error, TD_ERROR_MEMORY,
                       "its index and the chunks that overlap in time need more than the %zu MiB granted",
                       r->memory_limit >> 20);
    *memory = malloc((size_t)size + 1);
    if (!*memory) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu bytes", (size_t)size);
    r->memory += (size_t)size;
    return TD_OK;
}

static td_status read_at(td_mcap_reader *r, void *bytes, uint64_t offset, size_t size, td_error *error)
{
    if (fseeko(r->file, (off_t)offset, SEEK_SET) == 0 && fread(bytes, 1, size, r->file) == size) return TD_OK;
    if (ferror(r->file)) return td_fail(error, TD_ERROR_IO, "cannot be read: %s", strerror(errno));
    return td_fail(error, TD_ERROR_IO, "became shorter while it was read");
}

/* Opening */

static td_status read_header(td_mcap_reader *r, td_error *error)
{
    unsigned char prefix[TD_MCAP_PREFIX_SIZE];
    TD_TRY(read_at(r, prefix, TD_MCAP_MAGIC_SIZE, sizeof prefix, error));
    td_mcap_bytes b = {prefix, sizeof prefix, false};
    const int kind = (int)td_mcap_take(&b, 1);
    const uint64_t size = td_mcap_take(&b, 8);
    if (kind != TD_MCAP_HEADER || size > MAX_HEADER || size > r->size)
        return td_fail(error, TD_ERROR_FORMAT, "its header is damaged");
    void *bytes;
    TD_TRY(take_memory(r, &bytes, size, error));
    td_status status = read_at(r, bytes, TD_MCAP_MAGIC_SIZE + sizeof prefix, (size_t)size, error);
    b = (td_mcap_bytes){bytes, (size_t)size, false};
    td_mcap_bytes profile = td_mcap_counted(&b), library = td_mcap_counted(&b);
    profile.failed = library.failed = b.failed;
    if (status == TD_OK) status = td_mcap_text(&r->profile, profile, error);
    if (status == TD_OK) status = td_mcap_text(&r->library, library, error);
    free(bytes);
    r->memory -= (size_t)size;
    return status;
}

static td_status add_place(td_mcap_reader *r, td_mcap_bytes content, uint64_t data_end, td_error *error)
{
    place p;
    p.start_ns = td_mcap_take(&content, 8);
    p.end_ns = td_mcap_take(&content, 8);
    p.offset = td_mcap_take(&content, 8);
    p.length = td_mcap_take(&content, 8);
    p.map = td_mcap_counted(&content);
    if (content.failed || p.end_ns < p.start_ns || p.offset < TD_MCAP_MAGIC_SIZE || p.offset > data_end ||
        p.length > data_end - p.offset || p.length < TD_MCAP_PREFIX_SIZE + TD_MCAP_CHUNK_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "its index points to what cannot be a chunk");
    if (r->place_count == r->place_room) {
        const size_t room = r->place_room ? 2 * r->place_room : 64;
        place *larger = realloc(r->place, room * sizeof *larger);
        if (!larger) return td_fail(error, TD_ERROR_MEMORY, "no memory for the index of %zu chunks", room);
        r->place = larger;
        r->place_room = room;
    }
    r->place[r->place_count++] = p;
    return TD_OK;
}

static td_status read_summary(td_mcap_reader *r, td_mcap_bytes b, uint64_t data_end, td_error *error)
{
    r->chunks_told = UINT64_MAX;
    while (b.left > 0) {
        td_mcap_bytes content;
        const int kind = td_mcap_record(&content, &b);
        if (!kind) return td_fail(error, TD_ERROR_FORMAT, "a record of its index is cut short");
        if (kind == TD_MCAP_SCHEMA) TD_TRY(td_mcap_names_schema(&r->names, content, error));
        if (kind == TD_MCAP_CHANNEL) TD_TRY(td_mcap_names_channel(&r->names, content, error));
        if (kind == TD_MCAP_CHUNK_INDEX) TD_TRY(add_place(r, content, data_end, error));
        if (kind == TD_MCAP_STATISTICS) {
            r->info.message_count = td_mcap_take(&content, 8);
            td_mcap_part(&content, 2 + 3 * 4);
            r->chunks_told = td_mcap_take(&content, 4);
        }
    }
    if (r->chunks_told != UINT64_MAX && r->chunks_told != r->place_count)
        return td_fail(error, TD_ERROR_FORMAT, "it has %llu chunks, but an index of %zu",
                       (unsigned long long)r->chunks_told, r->place_count);
    if (r->info.message_count > 0 && r->place_count == 0)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "its messages are not in chunks, so they have no index; recover it");
    return TD_OK;
}

static int compare_places(const void *a, const void *b)
{
    const place *x = a, *y = b;
    if (x->start_ns != y->start_ns) return x->start_ns < y->start_ns ? -1 : 1;
    return (x->offset > y->offset) - (x->offset < y->offset);
}

/* The file's end: footer, and what it says of the index. */
static td_status read_end(td_mcap_reader *r, td_error *error)
{
    enum { END = TD_MCAP_PREFIX_SIZE + TD_MCAP_FOOTER_SIZE + TD_MCAP_MAGIC_SIZE };
    unsigned char end[END], magic[TD_MCAP_MAGIC_SIZE];
    if (r->size < TD_MCAP_MAGIC_SIZE) return td_fail(error, TD_ERROR_FORMAT, "is no MCAP file: too short");
    TD_TRY(read_at(r, magic, 0, sizeof magic, error));
    if (memcmp(magic, TD_MCAP_MAGIC, TD_MCAP_MAGIC_SIZE) != 0)
        return td_fail(error, TD_ERROR_FORMAT, "is no MCAP file: it begins with other bytes");
    if (r->size < TD_MCAP_MAGIC_SIZE + TD_MCAP_PREFIX_SIZE + END)
        return td_fail(error, TD_ERROR_FORMAT, "is cut off: its end is missing; recover it");
    TD_TRY(read_at(r, end, r->size - END, END, error));
    td_mcap_bytes b = {end, END, false};
    const int kind = (int)td_mcap_take(&b, 1);
    const uint64_t size = td_mcap_take(&b, 8), summary = td_mcap_take(&b, 8), offsets = td_mcap_take(&b, 8);
    const uint32_t sum = (uint32_t)td_mcap_take(&b, 4);
    if (memcmp(b.at, TD_MCAP_MAGIC, TD_MCAP_MAGIC_SIZE) != 0 || kind != TD_MCAP_FOOTER ||
        size != TD_MCAP_FOOTER_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "is cut off: its end is missing; recover it");
    if (summary == 0) return td_fail(error, TD_ERROR_UNSUPPORTED, "has no index; recover it");
    const uint64_t footer = r->size - END, until = offsets ? offsets : footer;
    if (summary < TD_MCAP_MAGIC_SIZE || summary > until || until > footer)
        return td_fail(error, TD_ERROR_FORMAT, "its footer is damaged; recover it");
    void *bytes;
    TD_TRY(take_memory(r, &bytes, footer - summary, error));
    r->summary = bytes;
    TD_TRY(read_at(r, bytes, summary, (size_t)(footer - summary), error));
    unsigned long own = crc32_z(0, bytes, (size_t)(footer - summary));
    own = crc32_z(own, end, TD_MCAP_PREFIX_SIZE + TD_MCAP_FOOTER_SIZE - 4);
    if (sum && sum != (uint32_t)own)
        return td_fail(error, TD_ERROR_FORMAT, "the sum of its index is wrong: it is damaged; recover it");
    TD_TRY(read_summary(r, (td_mcap_bytes){bytes, (size_t)(until - summary), false}, summary, error));
    if (r->place_count > 0) qsort(r->place, r->place_count, sizeof *r->place, compare_places);
    return TD_OK;
}

static void describe(td_mcap_reader *r)
{
    td_mcap_info *info = &r->info;
    bool any = false;
    info->profile = r->profile;
    info->library = r->library;
    info->channel_count = r->names.channel_count;
    info->channel = r->names.channel;
    for (size_t i = 0; i < r->place_count; i++) {
        const place *p = r->place + i;
        if (p->start_ns == 0 && p->end_ns == 0 && p->map.left == 0)
            continue; /* of a chunk without messages */
        if (!any || p->start_ns < info->start_ns) info->start_ns = p->start_ns;
        if (!any || p->end_ns > info->end_ns) info->end_ns = p->end_ns;
        any = true;
    }
}

/* Takes the file. */
static td_status open_file(td_mcap_reader **reader, FILE *file, size_t memory_bytes, const char *name,
                           td_error *error)
{
    *reader = NULL;
    td_mcap_reader *made = calloc(1, sizeof *made);
    if (made) made->name = strdup(name);
    if (!made || !made->name) {
        free(made);
        fclose(file);
        return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to read it", name);
    }
    made->file = file;
    made->memory_limit = memory_bytes ? memory_bytes : TD_MCAP_DEFAULT_MEMORY;
    td_status status = TD_OK;
    off_t size = -1;
    if (fseeko(file, 0, SEEK_END) == 0) size = ftello(file);
    made->size = size < 0 ? 0 : (uint64_t)size;
    if (size < 0) status = td_fail(error, TD_ERROR_IO, "cannot be read: %s", strerror(errno));
    if (status == TD_OK) status = read_end(made, error);
    if (status == TD_OK) status = read_header(made, error);
    if (status == TD_OK) made->wanted = calloc((size_t)made->names.channel_count + 1, sizeof *made->wanted);
    if (status == TD_OK && !made->wanted) status = td_fail(error, TD_ERROR_MEMORY, "no memory to read it");
    if (status == TD_OK) {
        describe(made);
        td_mcap_rewind(made, NULL, 0);
        *reader = made;
        return TD_OK;
    }
    td_mcap_free(&made);
    return td_error_prefix(error, status, "%s", name);
}

td_status td_mcap_open(td_mcap_reader **reader, const char *path, size_t memory_bytes, td_error *error)
{
    FILE *file = NULL;
    *reader = NULL;
    TD_TRY(td_file_stream(&file, path, error));
    return open_file(reader, file, memory_bytes, path, error);
}

td_status td_mcap_parse(td_mcap_reader **reader, const void *bytes, size_t size, size_t memory_bytes,
                        const char *name, td_error *error)
{
    *reader = NULL;
    if (size == 0) return td_fail(error, TD_ERROR_FORMAT, "%s: is no MCAP file: it is empty", name);
    FILE *file = fmemopen((void *)(uintptr_t)bytes, size, "rb");
    if (!file) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to read it", name);
    return open_file(reader, file, memory_bytes, name, error);
}

static void unload(td_mcap_reader *r, loaded *chunk)
{
    r->memory -= chunk->memory;
    free(chunk->bytes);
    free(chunk->entry);
    *chunk = (loaded){0};
}

void td_mcap_free(td_mcap_reader **reader)
{
    if (!reader || !*reader) return;
    td_mcap_reader *r = *reader;
    for (size_t i = 0; i < r->heap_count; i++) unload(r, r->heap + i);
    fclose(r->file);
    td_mcap_names_free(&r->names);
    free(r->name);
    free(r->profile);
    free(r->library);
    free(r->summary);
    free(r->place);
    free(r->heap);
    free(r->wanted);
    free(r);
    *reader = NULL;
}

const td_mcap_info *td_mcap_about(const td_mcap_reader *reader)
{
    return &reader->info;
}

int td_mcap_find(const td_mcap_reader *reader, const char *topic)
{
    for (int i = 0; i < reader->info.channel_count; i++)
        if (strcmp(reader->info.channel[i].topic, topic) == 0) return i;
    return -1;
}

/* Messages */

void td_mcap_rewind(td_mcap_reader *reader, const bool *wanted, uint64_t from_ns)
{
    for (size_t i = 0; i < reader->heap_count; i++) unload(reader, reader->heap + i);
    reader->heap_count = reader->place_next = 0;
    reader->lent = false;
    reader->from_ns = from_ns;
    for (int i = 0; i < reader->info.channel_count; i++) reader->wanted[i] = !wanted || wanted[i];
}

/* Order of the next messages of two chunks. */
static bool before(const loaded *a, const loaded *b)
{
    const uint64_t x = a->entry[a->next].time_ns, y = b->entry[b->next].time_ns;
    return x != y ? x < y : a->offset < b->offset;
}

static void exchange(loaded *a, loaded *b)
{
    const loaded kept = *a;
    *a = *b;
    *b = kept;
}

static void sink(td_mcap_reader *r, size_t i)
{
    for (;;) {
        size_t least = i;
        for (size_t child = 2 * i + 1; child <= 2 * i + 2 && child < r->heap_count; child++)
            if (before(r->heap + child, r->heap + least)) least = child;
        if (least == i) return;
        exchange(r->heap + i, r->heap + least);
        i = least;
    }
}

static void rise(td_mcap_reader *r, size_t i)
{
    for (; i > 0 && before(r->heap + i, r->heap + (i - 1) / 2); i = (i - 1) / 2)
        exchange(r->heap + i, r->heap + (i - 1) / 2);
}

/* Goes on past the message that was lent. */
static void advance(td_mcap_reader *r)
{
    if (!r->lent) return;
    r->lent = false;
    if (++r->heap[0].next == r->heap[0].count) {
        unload(r, r->heap);
        r->heap[0] = r->heap[--r->heap_count];
    }
    if (r->heap_count > 0) sink(r, 0);
}

static int compare_entries(const void *a, const void *b)
{
    const entry *x = a, *y = b;
    if (x->time_ns != y->time_ns) return x->time_ns < y->time_ns ? -1 : 1;
    return (x->at > y->at) - (x->at < y->at);
}

/* Counts the wanted messages of a chunk, and lists them where `list` is not NULL. */
static td_status list_messages(size_t *count, entry *list, const td_mcap_reader *r,
                               const td_mcap_chunk *chunk, td_error *error)
{
    td_mcap_bytes b = chunk->records, content;
    *count = 0;
    while (b.left > 0) {
        const uint64_t at = chunk->records.left - b.left;
        const int kind = td_mcap_record(&content, &b);
        td_mcap_message message;
        if (!kind) return td_fail(error, TD_ERROR_FORMAT, "a record of a chunk is cut short");
        if (kind != TD_MCAP_MESSAGE) continue;
        if (!td_mcap_message_open(&message, content) || !r->names.channel_of[message.channel])
            return td_fail(error, TD_ERROR_FORMAT, "a message is cut short, or of a channel without a name");
        if (message.log_time_ns < chunk->start_ns || message.log_time_ns > chunk->end_ns)
            return td_fail(error, TD_ERROR_FORMAT, "a message lies outside the times of its chunk");
        if (!r->wanted[r->names.channel_of[message.channel] - 1] || message.log_time_ns < r->from_ns)
            continue;
        if (list) list[*count] = (entry){message.log_time_ns, at};
        ++*count;
    }
    return TD_OK;
}

static td_status fill(td_mcap_reader *r, loaded *into, const place *where, td_error *error)
{
    void *memory;
    bool sum_wrong;
    td_mcap_chunk chunk;
    td_mcap_bytes content;
    TD_TRY(take_memory(r, &memory, where->length, error));
    into->bytes = memory;
    into->memory = (size_t)where->length;
    into->offset = where->offset;
    TD_TRY(read_at(r, memory, where->offset, (size_t)where->length, error));
    td_mcap_bytes b = {memory, (size_t)where->length, false};
    if (td_mcap_record(&content, &b) != TD_MCAP_CHUNK || b.left > 0)
        return td_fail(error, TD_ERROR_FORMAT, "there is no chunk where its index says; recover it");
    TD_TRY(td_mcap_chunk_open(&chunk, &sum_wrong, content, error));
    if (chunk.start_ns != where->start_ns || chunk.end_ns != where->end_ns)
        return td_fail(error, TD_ERROR_FORMAT, "a chunk's times are not those of the index; recover it");
    TD_TRY(list_messages(&into->count, NULL, r, &chunk, error));
    into->records = chunk.records;
    if (into->count == 0) return TD_OK;
    TD_TRY(take_memory(r, &memory, (uint64_t)into->count * sizeof(entry), error));
    into->entry = memory;
    into->memory += into->count * sizeof(entry);
    TD_TRY(list_messages(&into->count, into->entry, r, &chunk, error));
    qsort(into->entry, into->count, sizeof *into->entry, compare_entries);
    return TD_OK;
}

/* False where the index tells that no wanted message is in the chunk. */
static bool is_needed(const td_mcap_reader *r, const place *where)
{
    td_mcap_bytes map = where->map;
    bool needed = map.left == 0;
    while (map.left > 0 && !needed) {
        const int channel = r->names.channel_of[td_mcap_take(&map, 2)];
        td_mcap_take(&map, 8);
        needed = map.failed || !channel || r->wanted[channel - 1];
    }
    return needed && where->end_ns >= r->from_ns;
}

static td_status load(td_mcap_reader *r, const place *where, td_error *error)
{
    if (!is_needed(r, where)) return TD_OK;
    if (r->heap_count == r->heap_room) {
        const size_t room = r->heap_room ? 2 * r->heap_room : 8;
        loaded *larger = realloc(r->heap, room * sizeof *larger);
        if (!larger) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu chunks", room);
        r->heap = larger;
        r->heap_room = room;
    }
    loaded chunk = {0};
    td_status status = fill(r, &chunk, where, error);
    if (status != TD_OK || chunk.count == 0) {
        unload(r, &chunk);
        return status;
    }
    r->heap[r->heap_count] = chunk;
    rise(r, r->heap_count++);
    return TD_OK;
}

td_status td_mcap_next(td_mcap_reader *reader, td_mcap_message *message, bool *more, td_error *error)
{
    td_mcap_reader *r = reader;
    *more = false;
    advance(r);
    while (r->place_next < r->place_count &&
           (r->heap_count == 0 ||
            r->place[r->place_next].start_ns <= r->heap[0].entry[r->heap[0].next].time_ns)) {
        td_status status = load(r, r->place + r->place_next, error);
        if (status != TD_OK) return td_error_prefix(error, status, "%s", r->name);
        r->place_next++;
    }
    if (r->heap_count == 0) return TD_OK;
    const loaded *first = r->heap;
    td_mcap_bytes content, b = first->records;
    td_mcap_part(&b, first->entry[first->next].at);
    td_mcap_record(&content, &b);
    td_mcap_message_open(message, content);
    message->channel = r->names.channel_of[message->channel] - 1;
    *more = r->lent = true;
    return TD_OK;
}
