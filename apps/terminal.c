#include "apps/terminal.h"

#include <pthread.h>
#include <signal.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <jansson.h>

static volatile sig_atomic_t interrupted;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static void on_signal(int number)
{
    (void)number;
    interrupted = 1;
}

void terminal_catch_signals(void)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = (int)SA_RESETHAND};
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ,
           SIG_IGN); /* a limit on the size of files (ulimit -f) is then a failed write like any other */
}

bool terminal_interrupted(void)
{
    return interrupted;
}

bool terminal_take_interrupt(void)
{
    if (!interrupted) return false;
    interrupted = 0;
    terminal_catch_signals();
    return true;
}

double terminal_now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void terminal_init(terminal *t, bool quiet, bool verbose)
{
    *t = (terminal){.quiet = quiet, .verbose = verbose, .is_tty = isatty(STDERR_FILENO)};
    t->started_s = terminal_now_s();
}

void terminal_clear(terminal *t)
{
    if (!t->bar_shown) return;
    fputs("\r\033[K", stderr);
    fflush(stderr);
    t->bar_shown = false;
}

static void log_line(td_log_level level, const char *topic, const char *text, void *user)
{
    static const char *const names[] = {"debug", "info", "warning"};
    terminal *t = user;
    pthread_mutex_lock(&lock);
    if (t->log_file) {
        json_t *line = json_pack("{s:f, s:s, s:s, s:s}", "time_s", terminal_now_s() - t->started_s, "level",
                                 names[level], "topic", topic, "text", text);
        if (line) {
            json_dumpf(line, t->log_file, JSON_COMPACT | JSON_PRESERVE_ORDER);
            fputc('\n', t->log_file);
            json_decref(line);
        }
    }
    if ((level == TD_LOG_WARNING && !t->quiet) || t->verbose) {
        terminal_clear(t);
        fprintf(stderr, "%s: %s\n", level == TD_LOG_WARNING ? "warning" : topic, text);
    }
    pthread_mutex_unlock(&lock);
}

td_log terminal_log(terminal *t)
{
    return (td_log){log_line, t};
}

static void draw_bar(terminal *t, const char *stage, size_t done, size_t total, double now)
{
    enum { WIDTH = 30 };
    size_t filled = total ? WIDTH * done / total : 0;
    char bar[WIDTH + 1];
    memset(bar, ' ', WIDTH);
    memset(bar, '=', filled);
    bar[WIDTH] = 0;
    double elapsed = now - t->stage_started_s;
    fprintf(stderr, "\r\033[K%-28s [%s] %zu/%zu", stage, bar, done, total);
    if (done > t->stage_first && done < total && elapsed > 0.5)
        fprintf(stderr, "  %.0f s left",
                elapsed / (double)(done - t->stage_first) * (double)(total - done) + 0.5);
    fflush(stderr);
    t->bar_shown = true;
    t->last_drawn_s = now;
}

static bool report(const char *stage, size_t done, size_t total, void *user)
{
    terminal *t = user;
    pthread_mutex_lock(&lock);
    double now = terminal_now_s();
    if (!t->stage || strcmp(t->stage, stage) != 0) {
        t->stage = stage;
        t->stage_first = done;
        t->stage_started_s = now;
        t->last_drawn_s = now; /* short work shows no bar at all */
    }
    if (!t->quiet && t->is_tty) {
        if (done >= total)
            terminal_clear(t);
        else if (now - t->last_drawn_s > 0.1)
            draw_bar(t, stage, done, total, now);
    }
    pthread_mutex_unlock(&lock);
    return !interrupted;
}

td_progress terminal_progress(terminal *t)
{
    return (td_progress){report, t};
}
