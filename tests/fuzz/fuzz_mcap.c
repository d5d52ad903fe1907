/* Any bytes as an MCAP: no crash, no more memory than granted; messages in the order of time, of channels
 * that are there; or a sentence that names the file. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/mcap.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(bool fine)
{
    if (!fine) abort();
}

/* Reads what is lent, so that a sanitizer sees where it ends. */
static unsigned sum_of(const void *bytes, size_t size)
{
    unsigned sum = 0;
    for (size_t i = 0; i < size; i++) sum += ((const unsigned char *)bytes)[i];
    return sum;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static volatile unsigned seen;
    td_error error = {0};
    td_mcap_reader *reader = NULL;
    if (td_mcap_parse(&reader, data, size, 1 << 20, "fuzz.mcap", &error) != TD_OK) {
        must(!reader && strncmp(error.message, "fuzz.mcap: ", 11) == 0);
        return 0;
    }
    const td_mcap_info *info = td_mcap_about(reader);
    for (int i = 0; i < info->channel_count; i++) {
        const td_mcap_channel *c = info->channel + i;
        seen += (unsigned)(strlen(c->topic) + strlen(c->encoding)) + sum_of(c->schema, c->schema_size);
        if (c->schema_name) seen += (unsigned)(strlen(c->schema_name) + strlen(c->schema_encoding));
    }
    uint64_t last = 0;
    for (bool more = true; more;) {
        td_mcap_message m;
        if (td_mcap_next(reader, &m, &more, &error) != TD_OK) {
            must(strncmp(error.message, "fuzz.mcap: ", 11) == 0);
            break;
        }
        if (!more) break;
        must(m.log_time_ns >= last && m.channel >= 0 && m.channel < info->channel_count && m.size <= size);
        last = m.log_time_ns;
        seen += sum_of(m.data, m.size);
    }
    td_mcap_free(&reader);
    return 0;
}
