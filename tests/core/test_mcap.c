/* Proves: what is written to an MCAP is read back, whole and in the order of time, with little memory; the
 * same messages are the same bytes; no damaged byte and no cut changes a message unseen; of a killed or
 * damaged recording all whole chunks come back. Reference: the messages themselves; other readers are in
 * tests/apps/test_mcap.py. Blind to: power cuts (fsync). */
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/bytes_internal.h"
#include "core/file.h"
#include "core/mcap_internal.h"
#include "core/random.h"
#include "tests/check.h"
#include "tests/scratch.h"

enum { CHANNELS = 3, MESSAGES = 600, MOST_SIZE = 90 };

static const td_mcap_channel about[CHANNELS] = {
    {"/a", "json", "one", "jsonschema", "{}", 2},
    {"/b", "json", "one", "jsonschema", "{}", 2},
    {"/c", "x-raw", NULL, NULL, NULL, 0},
};

typedef struct item {
    int channel;
    uint32_t sequence;
    uint64_t time_ns;
    size_t size;
    unsigned char data[MOST_SIZE];
} item;

/* Times rise, but up to `disorder` ns early; some are equal. */
static void make_items(item *to, int count, uint64_t disorder)
{
    td_random random = td_random_seed(7, 0);
    uint32_t sequence[CHANNELS] = {0};
    for (int i = 0; i < count; i++) {
        to[i].channel = (int)td_random_below(&random, CHANNELS);
        to[i].sequence = sequence[to[i].channel]++;
        to[i].time_ns = 1000000 + 100 * (uint64_t)(i / 2);
        if (disorder) to[i].time_ns -= td_random_below(&random, (uint32_t)disorder) / 50 * 50;
        to[i].size = td_random_below(&random, MOST_SIZE);
        for (size_t k = 0; k < to[i].size; k++) to[i].data[k] = (unsigned char)td_random_below(&random, 256);
    }
}

static void add_channels(td_mcap_writer *writer)
{
    td_error error = {0};
    for (int i = 0; i < CHANNELS; i++) {
        int channel = -1;
        check_ok(td_mcap_channel_add(writer, &channel, about + i, &error), error);
        assert_int_equal(channel, i);
    }
}

static void add_items(td_mcap_writer *writer, const item *from, int count)
{
    td_error error = {0};
    for (int i = 0; i < count; i++)
        check_ok(td_mcap_write(writer, from[i].channel, from[i].time_ns, from[i].data, from[i].size, &error),
                 error);
}

static void write_file(const char *path, const item *from, int count, size_t chunk_bytes)
{
    td_error error = {0};
    td_mcap_writer *writer = NULL;
    const td_mcap_options options = {chunk_bytes};
    check_ok(td_mcap_writer_new(&writer, path, &options, &error), error);
    add_channels(writer);
    add_items(writer, from, count);
    check_ok(td_mcap_finish(&writer, &error), error);
    assert_null(writer);
}

/* Indices in the order of time, equal times in that of writing. */
static void order_of(int *order, const item *from, int count)
{
    for (int i = 0; i < count; i++) {
        int k = i;
        for (; k > 0 && from[order[k - 1]].time_ns > from[i].time_ns; k--) order[k] = order[k - 1];
        order[k] = i;
    }
}

static bool same(const td_mcap_message *m, const item *wanted)
{
    return m->channel == wanted->channel && m->sequence == wanted->sequence &&
           m->log_time_ns == wanted->time_ns && m->publish_time_ns == wanted->time_ns &&
           m->size == wanted->size && memcmp(m->data, wanted->data, m->size) == 0;
}

/* All messages of the wanted channels from a time on, and none else. */
static void check_messages(td_mcap_reader *reader, const item *from, int count, const bool *wanted,
                           uint64_t from_ns)
{
    static int order[MESSAGES];
    td_error error = {0};
    td_mcap_message m;
    bool more = true;
    order_of(order, from, count);
    td_mcap_rewind(reader, wanted, from_ns);
    for (int i = 0; i < count; i++) {
        const item *next = from + order[i];
        if ((wanted && !wanted[next->channel]) || next->time_ns < from_ns) continue;
        check_ok(td_mcap_next(reader, &m, &more, &error), error);
        assert_true(more);
        if (!same(&m, next)) fail_msg("message %d of %d differs", i, count);
    }
    check_ok(td_mcap_next(reader, &m, &more, &error), error);
    assert_false(more);
}

static void test_back(void **state)
{
    static item items[MESSAGES];
    td_error error = {0};
    char *path = td_path_join(*state, "a.mcap");
    const size_t chunk_bytes[] = {1, 300, 5000, 1 << 20};
    for (int k = 0; k < 8; k++) {
        make_items(items, MESSAGES, k & 1 ? 20000 : 0);
        write_file(path, items, MESSAGES, chunk_bytes[k / 2]);
        td_mcap_reader *reader = NULL;
        check_ok(td_mcap_open(&reader, path, 0, &error), error);
        const td_mcap_info *info = td_mcap_about(reader);
        assert_int_equal(info->message_count, MESSAGES);
        assert_int_equal(info->channel_count, CHANNELS);
        assert_string_equal(info->library, "teledimos");
        for (int i = 0; i < CHANNELS; i++) {
            assert_int_equal(td_mcap_find(reader, about[i].topic), i);
            assert_string_equal(info->channel[i].encoding, about[i].encoding);
            assert_true(!info->channel[i].schema_name == !about[i].schema_name);
            assert_int_equal(info->channel[i].schema_size, about[i].schema_size);
        }
        assert_string_equal(info->channel[1].schema_name, "one");
        assert_memory_equal(info->channel[1].schema, "{}", 2);
        check_messages(reader, items, MESSAGES, NULL, 0);
        check_messages(reader, items, MESSAGES, (const bool[]){true, false, true}, 0);
        check_messages(reader, items, MESSAGES, (const bool[]){false, true, false},
                       items[MESSAGES / 2].time_ns);
        check_messages(reader, items, MESSAGES, NULL, items[MESSAGES - 1].time_ns + 1000000);
        td_mcap_free(&reader);
    }
    free(path);
}

/* Nothing, and channels without messages, are recordings too. */
static void test_nothing(void **state)
{
    td_error error = {0};
    char *path = td_path_join(*state, "none.mcap");
    for (int channels = 0; channels < 2; channels++) {
        td_mcap_writer *writer = NULL;
        td_mcap_reader *reader = NULL;
        check_ok(td_mcap_writer_new(&writer, path, NULL, &error), error);
        if (channels) add_channels(writer);
        check_ok(td_mcap_finish(&writer, &error), error);
        check_ok(td_mcap_open(&reader, path, 0, &error), error);
        assert_int_equal(td_mcap_about(reader)->channel_count, channels ? CHANNELS : 0);
        check_messages(reader, NULL, 0, NULL, 0);
        td_mcap_free(&reader);
    }
    free(path);
}

static void test_same_bytes(void **state)
{
    static item items[MESSAGES];
    td_error error = {0};
    char *bytes[2], *path[2] = {td_path_join(*state, "1.mcap"), td_path_join(*state, "2.mcap")};
    size_t size[2];
    make_items(items, MESSAGES, 20000);
    for (int i = 0; i < 2; i++) {
        write_file(path[i], items, MESSAGES, 5000);
        check_ok(td_file_read(&bytes[i], &size[i], path[i], 1 << 20, &error), error);
        free(path[i]);
    }
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    free(bytes[0]);
    free(bytes[1]);
}

/* Refused with its name, or every message as it was. */
static bool refused_or_same(const char *bytes, size_t size, const item *items, int count)
{
    td_error error = {0};
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    td_status status = td_mcap_parse(&reader, bytes, size, 0, "x.mcap", &error);
    for (int i = 0; status == TD_OK && more; i++) {
        status = td_mcap_next(reader, &m, &more, &error);
        if (status == TD_OK && more && (i >= count || !same(&m, items + i)))
            fail_msg("message %d differs", i);
        if (status == TD_OK && !more && i != count) fail_msg("%d messages of %d", i, count);
    }
    td_mcap_free(&reader);
    if (status != TD_OK && strncmp(error.message, "x.mcap: ", 8) != 0)
        fail_msg("'%s' does not name the file", error.message);
    return status != TD_OK;
}

static void test_damage(void **state)
{
    enum { FEW = 12 };
    static item items[FEW];
    td_error error = {0};
    char *path = td_path_join(*state, "d.mcap"), *bytes = NULL;
    size_t size, refused = 0;
    make_items(items, FEW, 0);
    write_file(path, items, FEW, 200);
    check_ok(td_file_read(&bytes, &size, path, 1 << 20, &error), error);
    assert_false(refused_or_same(bytes, size, items, FEW));
    for (size_t i = 0; i < size; i++) {
        for (int bit = 0; bit < 8; bit++) {
            bytes[i] ^= (char)(1 << bit);
            refused += refused_or_same(bytes, size, items, FEW);
            bytes[i] ^= (char)(1 << bit);
        }
        assert_true(refused_or_same(bytes, i, items, FEW)); /* cut off here */
    }
    /* What is read past unseen: the names of the writer, lists of messages. */
    print_message("%zu of %zu single bits refused\n", refused, 8 * size);
    check_less(0.7 * 8 * (double)size, (double)refused);
    free(bytes);
    free(path);
}

/* A process that is killed while it records, or that fails. */
static void record_in_child(const char *path, const item *items, int count, bool leave)
{
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        td_mcap_writer *writer = NULL;
        const td_mcap_options options = {2000};
        if (td_mcap_writer_new(&writer, path, &options, NULL) != TD_OK) _exit(2);
        add_channels(writer);
        add_items(writer, items, count);
        if (leave) td_mcap_writer_free(&writer);
        if (!leave) kill(getpid(), SIGKILL);
        _exit(0);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(leave ? WIFEXITED(status) && WEXITSTATUS(status) == 0 : WIFSIGNALED(status));
}

static int count_same(const char *path, const item *items)
{
    td_error error = {0};
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    int count = 0;
    check_ok(td_mcap_open(&reader, path, 0, &error), error);
    for (;; count++) {
        check_ok(td_mcap_next(reader, &m, &more, &error), error);
        if (!more) break;
        assert_true(same(&m, items + count));
    }
    td_mcap_free(&reader);
    return count;
}

static void test_killed(void **state)
{
    static item items[MESSAGES];
    td_error error = {0};
    td_mcap_recovered recovered;
    char *path = td_path_join(*state, "k.mcap"), *part = td_path_join(*state, "k.mcap.part");
    make_items(items, MESSAGES, 0);
    write_file(path, items, 5, 2000);
    record_in_child(path, items, MESSAGES, false);
    assert_int_equal(count_same(path, items), 5); /* as it was */
    td_mcap_reader *reader = NULL;
    check_fails(td_mcap_open(&reader, part, 0, &error), TD_ERROR_FORMAT, error, "k.mcap.part: is cut off");
    check_ok(td_mcap_recover(&recovered, path, part, &error), error);
    /* All but the chunk that was filling: 2000 bytes and one message. */
    const int got = count_same(path, items);
    assert_int_equal(recovered.messages, got);
    assert_int_equal(recovered.lost_chunks, 0);
    assert_true(got < MESSAGES && got > MESSAGES - 2200 / (TD_MCAP_PREFIX_SIZE + TD_MCAP_MESSAGE_SIZE));
    /* The next recording begins anew; one that is given up leaves nothing. */
    record_in_child(path, items, MESSAGES, true);
    assert_int_equal(access(part, F_OK), -1);
    assert_int_equal(count_same(path, items), got);
    free(path);
    free(part);
}

static void test_recover_damage(void **state)
{
    enum { COUNT = 60 };
    static item items[COUNT];
    td_error error = {0};
    td_mcap_recovered recovered;
    char *path = td_path_join(*state, "r.mcap"), *to = td_path_join(*state, "to.mcap"), *bytes = NULL;
    size_t size;
    make_items(items, COUNT, 0);
    write_file(path, items, COUNT, 1000);
    check_ok(td_file_read(&bytes, &size, path, 1 << 20, &error), error);
    check_ok(td_mcap_recover(&recovered, to, path, &error), error);
    assert_int_equal(count_same(to, items), COUNT);
    assert_int_equal(recovered.lost_bytes, 0);
    bytes[size / 3] ^= 1; /* in the data of some chunk but the first */
    check_ok(td_file_write(path, bytes, size, &error), error);
    check_ok(td_mcap_recover(&recovered, to, path, &error), error);
    assert_int_equal(recovered.lost_chunks, 1);
    assert_true(recovered.messages < COUNT && recovered.messages > COUNT - 1200 / TD_MCAP_MESSAGE_SIZE);
    assert_true(recovered.lost_bytes > 900 && recovered.lost_bytes < 1300);
    check_fails(td_mcap_recover(&recovered, to, TD_SOURCE_DIR "/LICENSE", &error), TD_ERROR_FORMAT, error,
                "LICENSE: is no MCAP");
    free(bytes);
    free(path);
    free(to);
}

/* Chunks one after another need the memory of one; those that overlap are refused where it does not suffice.
 */
static void test_memory(void **state)
{
    static item items[MESSAGES];
    td_error error = {0};
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    td_status status = TD_OK;
    char *path = td_path_join(*state, "m.mcap");
    for (int disorder = 0; disorder < 2; disorder++) {
        make_items(items, MESSAGES, disorder ? 999000 : 0);
        write_file(path, items, MESSAGES, 2000);
        check_ok(td_mcap_open(&reader, path, 12000, &error), error);
        if (!disorder) check_messages(reader, items, MESSAGES, NULL, 0);
        while (disorder && status == TD_OK && more) status = td_mcap_next(reader, &m, &more, &error);
        if (disorder) check_fails(status, TD_ERROR_MEMORY, error, "m.mcap: its index and the chunks");
        td_mcap_free(&reader);
    }
    free(path);
}

static void test_refused(void **state)
{
    td_error error = {0};
    td_mcap_writer *writer = NULL;
    int channel;
    char *path = td_path_join(*state, "f.mcap");
    check_fails(td_mcap_writer_new(&writer, "/no/such/f.mcap", NULL, &error), TD_ERROR_IO, error,
                "/no/such/f.mcap");
    check_fails(td_mcap_writer_new(&writer, *state, NULL, &error), TD_ERROR_IO, error, "is a folder");
    check_fails(td_mcap_writer_new(&writer, path, &(td_mcap_options){0}, &error), TD_ERROR_ARGUMENT, error,
                "chunk_bytes");
    assert_null(writer);
    check_ok(td_mcap_writer_new(&writer, path, NULL, &error), error);
    check_fails(
        td_mcap_channel_add(writer, &channel, &(td_mcap_channel){.topic = "", .encoding = "json"}, &error),
        TD_ERROR_ARGUMENT, error, "topic");
    check_fails(td_mcap_channel_add(writer, &channel, &(td_mcap_channel){.topic = "\xff", .encoding = "json"},
                                    &error),
                TD_ERROR_ARGUMENT, error, "UTF-8");
    check_fails(td_mcap_write(writer, 0, 0, "", 0, &error), TD_ERROR_ARGUMENT, error, "no channel 0");
    /* Two processes do not write one file. */
    pid_t child = fork();
    if (child == 0) {
        td_mcap_writer *second = NULL;
        const bool fine = td_mcap_writer_new(&second, path, NULL, &error) == TD_ERROR_IO &&
                          strstr(error.message, "another process");
        _exit(fine ? 0 : 1);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    td_mcap_writer_free(&writer);
    td_mcap_reader *reader = NULL;
    check_fails(td_mcap_open(&reader, path, 0, &error), TD_ERROR_IO, error, "f.mcap");
    check_fails(td_mcap_parse(&reader, "", 0, 0, "e.mcap", &error), TD_ERROR_FORMAT, error, "e.mcap: is no");
    free(path);
}

/* What a recording on a full disk says; 0: all as it should be. */
static int record_on_full_disk(const char *path, const item *items)
{
    td_error error = {0}, again = {0};
    td_mcap_writer *writer = NULL;
    const td_mcap_options options = {500};
    td_status status = td_mcap_writer_new(&writer, path, &options, &error);
    if (status != TD_OK) return 1;
    add_channels(writer);
    signal(SIGXFSZ, SIG_IGN);
    if (setrlimit(RLIMIT_FSIZE, &(struct rlimit){5000, 5000}) != 0) return 2;
    for (int i = 0; i < MESSAGES && status == TD_OK; i++)
        status =
            td_mcap_write(writer, items[i].channel, items[i].time_ns, items[i].data, items[i].size, &error);
    if (status != TD_ERROR_IO || !strstr(error.message, "full.mcap: cannot be written")) return 3;
    if (td_mcap_flush(writer, &again) != TD_ERROR_IO || strcmp(again.message, error.message) != 0) return 4;
    if (td_mcap_finish(&writer, &again) != TD_ERROR_IO || strcmp(again.message, error.message) != 0) return 5;
    return writer || access(path, F_OK) == 0 ? 6 : 0;
}

/* A disk that is full is said again by every later call; the recording so far is kept. */
static void test_full_disk(void **state)
{
    static item items[MESSAGES];
    td_error error = {0};
    td_mcap_recovered recovered;
    char *path = td_path_join(*state, "full.mcap"), *part = td_path_join(*state, "full.mcap.part");
    make_items(items, MESSAGES, 0);
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) _exit(record_on_full_disk(path, items));
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    assert_int_equal(WEXITSTATUS(status), 0);
    check_ok(td_mcap_recover(&recovered, path, part, &error), error);
    assert_int_equal(count_same(path, items), recovered.messages);
    check_less(20, (double)recovered.messages);
    assert_true(recovered.lost_bytes > 0);
    free(path);
    free(part);
}

/* Files of others: compressed, and without an index. */
static size_t foreign(unsigned char *bytes, const char *compression, bool indexed)
{
    unsigned char *at = bytes;
    const uint64_t name = strlen(compression);
    memcpy(at, TD_MCAP_MAGIC, 8);
    at += 8;
    td_put(&at, TD_MCAP_HEADER, 1);
    td_put(&at, 8, 8);
    td_put(&at, 0, 8);
    const uint64_t chunk = (uint64_t)(at - bytes);
    td_put(&at, TD_MCAP_CHUNK, 1);
    td_put(&at, TD_MCAP_CHUNK_SIZE + name, 8);
    for (int i = 0; i < 3; i++) td_put(&at, 0, 8);
    td_put(&at, 0, 4);
    td_put(&at, name, 4);
    memcpy(at, compression, name);
    at += name;
    td_put(&at, 0, 8);
    const uint64_t summary = (uint64_t)(at - bytes);
    if (indexed) {
        td_put(&at, TD_MCAP_CHUNK_INDEX, 1);
        td_put(&at, 4 * 8 + 4 + 8 + 4 + name + 16, 8);
        td_put(&at, 0, 8);
        td_put(&at, 0, 8);
        td_put(&at, chunk, 8);
        td_put(&at, summary - chunk, 8);
        td_put(&at, 0, 4);
        td_put(&at, 0, 8);
        td_put(&at, name, 4);
        memcpy(at, compression, name);
        at += name;
        td_put(&at, 0, 8);
        td_put(&at, 0, 8);
    }
    td_put(&at, TD_MCAP_FOOTER, 1);
    td_put(&at, TD_MCAP_FOOTER_SIZE, 8);
    td_put(&at, indexed ? summary : 0, 8);
    td_put(&at, 0, 8);
    td_put(&at, 0, 4);
    memcpy(at, TD_MCAP_MAGIC, 8);
    return (size_t)(at + 8 - bytes);
}

static void test_foreign(void **state)
{
    unsigned char bytes[400];
    td_error error = {0};
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    (void)state;
    size_t size = foreign(bytes, "", true);
    check_ok(td_mcap_parse(&reader, bytes, size, 0, "o.mcap", &error), error);
    check_ok(td_mcap_next(reader, &m, &more, &error), error);
    assert_false(more);
    td_mcap_free(&reader);
    size = foreign(bytes, "zstd", true);
    check_ok(td_mcap_parse(&reader, bytes, size, 0, "o.mcap", &error), error);
    check_fails(td_mcap_next(reader, &m, &more, &error), TD_ERROR_UNSUPPORTED, error, "compressed ('zstd')");
    td_mcap_free(&reader);
    size = foreign(bytes, "", false);
    check_fails(td_mcap_parse(&reader, bytes, size, 0, "o.mcap", &error), TD_ERROR_UNSUPPORTED, error,
                "o.mcap: has no index");
}

static void test_time(void **state)
{
    uint64_t ns = 1;
    (void)state;
    assert_true(td_mcap_time(&ns, 0) && ns == 0);
    assert_true(td_mcap_time(&ns, 1.05) && ns == 1050000000);
    assert_true(td_mcap_time(&ns, 86400.001) && ns == 86400001000000);
    assert_false(td_mcap_time(&ns, -1e-3));
    assert_false(td_mcap_time(&ns, NAN));
    assert_false(td_mcap_time(&ns, 1e10));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_back, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_nothing, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_same_bytes, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_damage, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_killed, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_recover_damage, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_memory, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_refused, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_full_disk, scratch_make, scratch_remove),
        cmocka_unit_test(test_foreign),
        cmocka_unit_test(test_time),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
