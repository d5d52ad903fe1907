/* For test_panel_watchers.py: the watchers, and their report as JSON.
 *   watch_panel PORT CLIENTS SILENT SECONDS PERIOD_S PID [TOPIC …] */
#include <stdio.h>
#include <stdlib.h>

#include "tests/watchers.h"

int main(int argc, char **argv)
{
    char why[200];
    if (argc < 7) {
        fprintf(stderr, "usage: watch_panel PORT CLIENTS SILENT SECONDS PERIOD_S PID [TOPIC ...]\n");
        return 2;
    }
    const watchers_options o = {.port = atoi(argv[1]),
                                .clients = atoi(argv[2]),
                                .silent = atoi(argv[3]),
                                .seconds = atof(argv[4]),
                                .period_s = atof(argv[5]),
                                .panel = (pid_t)atol(argv[6]),
                                .topic = (const char *const *)argv + 7,
                                .topics = (size_t)argc - 7};
    json_t *told = watchers_run(&o, why);
    if (!told) {
        fprintf(stderr, "%s\n", why);
        return 1;
    }
    json_dumpf(told, stdout, JSON_COMPACT | JSON_REAL_PRECISION(6));
    putchar('\n');
    json_decref(told);
    return 0;
}
