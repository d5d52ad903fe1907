/* Many clients of a panel at once, in one cheap thread: the test of what they cost and its benchmark share
 * them.
 *
 * Each joins by WebSocket (RFC 6455, subprotocol foxglove.sdk.v1) and subscribes. Readers take all that comes
 * and answer pings. The silent ones read nothing, ever, through a small receive buffer, but ask for all
 * parameters each second. The panel puts such out 10 s after its socket's buffer is full, which takes some
 * seconds; each joins anew 20 s after it did, so that most of them are there all the while. */
#ifndef TELEDIMOS_TESTS_WATCHERS_H
#define TELEDIMOS_TESTS_WATCHERS_H

#include <jansson.h>
#include <stddef.h>
#include <sys/types.h>

typedef struct watchers_options {
    int port, clients, silent; /* silent: of the clients */
    double seconds;
    double period_s;          /* of /tf */
    pid_t panel;              /* whose memory and processor time are told; 0: nobody's */
    const char *const *topic; /* (topics) to be watched; none: all that there are */
    size_t topics;
} watchers_options;

/* Ends when the time is up or the panel has closed all readers. The report, NULL: *why.
 *
 *   readers, closed            how many read; of those, whom the panel closed
 *   silent_joins               how often a silent one joined
 *   seconds, messages_1_s, mb_1_s
 *   messages                   {topic: of all readers}
 *   tf_share                   [least, median, most]: of the periods from a reader's first /tf to its last
 *   silence_s                  [median, longest]: in which nothing came to a reader
 *   memory_kib                 [begin, peak of the first third, peak of the rest] of the panel
 *   panel_cpu, own_cpu         of one processor */
json_t *watchers_run(const watchers_options *options, char why[200]);

#endif
