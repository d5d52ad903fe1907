/* What watchers cost a session in real time: teledimos panel with two hundred clients, twenty of whom read
 * nothing (tests/watchers.h), for a minute, beside the same without any. How late its ticks come (one in a
 * hundred), how many are missed, how many messages a second those get who read, and what that takes. */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/watchers.h"

enum { CLIENTS = 200, SILENT = 20, SECONDS = 60 };

typedef struct session {
    double late_us, misses, ticks;
    double read_1_s, grown_mib, cpu_ms; /* cpu: in a second */
} session;

/* The program, its output and errors in pipes. */
static pid_t start(const bench *b, const char *scenario, const char *folder, int *output, int *errors)
{
    int out[2], err[2];
    char seconds[16];
    snprintf(seconds, sizeof seconds, "%d", SECONDS);
    if (pipe(out) != 0 || pipe(err) != 0) return -1;
    const pid_t child = fork();
    if (child == 0) {
        dup2(out[1], STDOUT_FILENO);
        dup2(err[1], STDERR_FILENO);
        for (int i = 0; i < 2; i++) close(out[i]), close(err[i]);
        execl(b->program, b->program, "panel", scenario, "-o", folder, "--port", "0", "--for", seconds,
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

/* All but the last seconds, in which the panel ends. */
static json_t *watch(int port, pid_t panel)
{
    const watchers_options o = {.port = port,
                                .clients = CLIENTS,
                                .silent = SILENT,
                                .seconds = SECONDS - 4,
                                .period_s = 0.05,
                                .panel = panel};
    char why[200];
    json_t *told = watchers_run(&o, why);
    if (!told) fprintf(stderr, "station: %s\n", why);
    return told;
}

static json_t *read_result(int output)
{
    static char text[1 << 16];
    size_t size = 0;
    for (ssize_t n; size < sizeof text && (n = read(output, text + size, sizeof text - size)) > 0;)
        size += (size_t)n;
    return json_loadb(text, size, 0, NULL);
}

static double number(const json_t *object, const char *name)
{
    return json_number_value(json_object_get(object, name));
}

static bool run(session *found, const bench *b, bool watched)
{
    char scenario[1024], folder[] = "/tmp/teledimos-bench-XXXXXX", clean[100];
    int output = -1, errors = -1, status = -1;
    snprintf(scenario, sizeof scenario, "%s/datasets/zx200/paper.yaml", b->source);
    if (!mkdtemp(folder)) return false;
    const pid_t panel = start(b, scenario, folder, &output, &errors);
    const int port = panel > 0 ? read_port(errors) : 0;
    json_t *told = watched && port ? watch(port, panel) : NULL;
    json_t *root = panel > 0 ? read_result(output) : NULL, *d = json_object_get(root, "deadlines"),
           *memory = json_object_get(told, "memory_kib");
    if (panel > 0) waitpid(panel, &status, 0);
    close(output);
    close(errors);
    *found = (session){.late_us = 1e6 * number(d, "late_p99_s"),
                       .misses = number(d, "misses"),
                       .ticks = number(d, "ticks"),
                       .read_1_s = number(told, "messages_1_s"),
                       .grown_mib = (json_number_value(json_array_get(memory, 2)) -
                                     json_number_value(json_array_get(memory, 1))) /
                                    1024,
                       .cpu_ms = 1e3 * number(told, "panel_cpu")};
    const bool done = status == 0 && d && (told || !watched);
    json_decref(told);
    json_decref(root);
    snprintf(clean, sizeof clean, "rm -rf %s", folder);
    return system(clean) == 0 && done;
}

void bench_panel(const bench *b)
{
    session with, without;
    if (!bench_wanted(b, "station")) return;
    const bool done = run(&without, b, false) && run(&with, b, true);
    if (!done) with = without = (session){NAN, NAN, NAN, NAN, NAN, NAN};
    const bench_row rows[] = {
        {.name = "station, 200 clients: late p99",
         .unit = "us",
         .ours = with.late_us,
         .peer = without.late_us,
         .peer_name = "no clients",
         .error_unit = "missed",
         .error_ours = with.misses,
         .error_peer = without.misses},
        {.name = "station: messages read", .unit = "1/s", .ours = with.read_1_s},
        {.name = "station: processor, of 1 s", .unit = "ms", .ours = with.cpu_ms},
        {.name = "station: memory grown", .unit = "MiB", .ours = with.grown_mib},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        bench_row r = rows[i];
        r.runs = (int)without.ticks;
        if (i > 0) r.peer = NAN, r.peer_name = "none";
        if (!done) r.runs = 0, r.remark = "teledimos panel cannot be run";
        bench_print(b, &r);
    }
}
