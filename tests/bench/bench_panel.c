/* What watchers cost a session in real time: teledimos panel with fifty clients, five of whom read nothing,
 * beside the same without any. How late its ticks come (one in a hundred), how many are missed, and how many
 * messages a second those get who read. */
#include <arpa/inet.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/bench/bench.h"

enum { WATCHERS = 50, SILENT = 5 };
static const char SECONDS[] = "8";

/* ---- watchers ---- */

static int join_in(int port)
{
    static const char hello[] =
        "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";
    static const char ask[] = "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1,\"channelId\":1},"
                              "{\"id\":2,\"channelId\":2},{\"id\":4,\"channelId\":4}]}";
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    unsigned char frame[8 + sizeof ask] = {0x81, 0x80 | 126, (sizeof ask - 1) >> 8, (sizeof ask - 1) & 255};
    char answer[4096];
    const int s = socket(AF_INET, SOCK_STREAM, 0);
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    memcpy(frame + 8, ask, sizeof ask - 1); /* the mask is 0 */
    if (s < 0 || connect(s, (struct sockaddr *)&at, sizeof at) != 0 ||
        write(s, hello, sizeof hello - 1) != (ssize_t)sizeof hello - 1 ||
        read(s, answer, sizeof answer) <= 0 ||
        write(s, frame, 8 + sizeof ask - 1) != (ssize_t)(8 + sizeof ask - 1)) {
        if (s >= 0) close(s);
        return -1;
    }
    return s;
}

/* Reads and throws away until told to end. No message is asked for whose pings would be due: eight seconds.
 */
static void watch(int port)
{
    struct pollfd all[WATCHERS];
    static char waste[1 << 18];
    for (int i = 0; i < WATCHERS; i++) all[i] = (struct pollfd){.fd = join_in(port), .events = POLLIN};
    for (int i = 0; i < SILENT; i++) all[i].fd = -1 - all[i].fd; /* open, and left alone */
    for (;;) {
        poll(all, WATCHERS, -1);
        for (int i = 0; i < WATCHERS; i++)
            if (all[i].revents && read(all[i].fd, waste, sizeof waste) <= 0) all[i].fd = -1;
    }
}

/* ---- the panel ---- */

typedef struct session {
    double late_us, misses, sent_1_s, ticks;
} session;

/* The program, its output and errors in pipes. */
static pid_t start(const bench *b, const char *scenario, const char *folder, int *output, int *errors)
{
    int out[2], err[2];
    if (pipe(out) != 0 || pipe(err) != 0) return -1;
    const pid_t child = fork();
    if (child == 0) {
        dup2(out[1], STDOUT_FILENO);
        dup2(err[1], STDERR_FILENO);
        for (int i = 0; i < 2; i++) close(out[i]), close(err[i]);
        execl(b->program, b->program, "panel", scenario, "-o", folder, "--port", "0", "--for", SECONDS,
              "--on-miss", "catch-up", "--json", (char *)NULL);
        _exit(127);
    }
    close(out[1]);
    close(err[1]);
    *output = out[0];
    *errors = err[0];
    return child;
}

static int read_port(int errors)
{
    char line[200] = "";
    for (size_t n = 0; n < sizeof line - 1 && read(errors, line + n, 1) == 1 && line[n] != '\n'; n++)
        line[n + 1] = 0;
    const char *colon = strrchr(line, ':');
    return colon ? atoi(colon + 1) : 0;
}

static bool run(session *found, const bench *b, bool watched)
{
    char scenario[1024], folder[] = "/tmp/teledimos-bench-XXXXXX", text[1 << 16];
    int output = -1, errors = -1;
    size_t size = 0;
    ssize_t n;
    snprintf(scenario, sizeof scenario, "%s/datasets/zx200/paper.yaml", b->source);
    if (!mkdtemp(folder)) return false;
    const pid_t panel = start(b, scenario, folder, &output, &errors);
    const int port = panel > 0 ? read_port(errors) : 0;
    const pid_t watchers = watched && port ? fork() : -1;
    if (watchers == 0) watch(port);
    while (size < sizeof text && (n = read(output, text + size, sizeof text - size)) > 0) size += (size_t)n;
    if (watchers > 0) kill(watchers, SIGKILL), waitpid(watchers, NULL, 0);
    int status = -1;
    if (panel > 0) waitpid(panel, &status, 0);
    close(output);
    close(errors);
    char clean[100];
    snprintf(clean, sizeof clean, "rm -rf %s", folder);
    if (system(clean) != 0) return false;
    json_t *root = json_loadb(text, size, 0, NULL), *d = json_object_get(root, "deadlines");
    *found =
        (session){.late_us = 1e6 * json_number_value(json_object_get(d, "late_p99_s")),
                  .misses = json_number_value(json_object_get(d, "misses")),
                  .ticks = json_number_value(json_object_get(d, "ticks")),
                  .sent_1_s = json_number_value(json_object_get(json_object_get(root, "messages"), "sent")) /
                              json_number_value(json_object_get(root, "time_s"))};
    json_decref(root);
    return status == 0 && d;
}

void bench_panel(const bench *b)
{
    session with, without;
    if (!bench_wanted(b, "station")) return;
    const bool done = run(&without, b, false) && run(&with, b, true);
    if (!done) with = without = (session){NAN, NAN, NAN, NAN};
    const bench_row rows[] = {
        {.name = "station, 50 clients: late p99",
         .unit = "us",
         .ours = with.late_us,
         .peer = without.late_us,
         .peer_name = "no clients",
         .error_unit = "missed",
         .error_ours = with.misses,
         .error_peer = without.misses},
        {.name = "station: messages sent",
         .unit = "1/s",
         .ours = with.sent_1_s,
         .peer = NAN,
         .peer_name = "none"},
    };
    for (int i = 0; i < 2; i++) {
        bench_row r = rows[i];
        r.runs = (int)without.ticks;
        if (!done) r.runs = 0, r.remark = "teledimos panel cannot be run";
        bench_print(b, &r);
    }
}
