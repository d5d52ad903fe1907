/* A session in real time: ticks by sim/clock, keys from the terminal (or from a pipe), a line that says where
 * it is. */
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <termios.h>
#include <unistd.h>

#include "apps/simulate_task.h"

static const double HELD_S = 0.3; /* a key counts as held so long: terminals repeat it sooner */

typedef struct key_live {
    struct live live; /* the first: what the session sees */
    terminal *term;
    double shown_s;
    int joints;
    bool attended, keys, raw;
    struct termios before;
    task_input jog;
    long jog_until; /* period */
    int escapes;
} key_live;

static void open_keys(key_live *l)
{
    l->keys = true;
    l->attended = isatty(STDIN_FILENO) && tcgetpgrp(STDIN_FILENO) == getpgrp();
    if (isatty(STDIN_FILENO) && !l->attended) l->keys = false;
    if (!l->attended || tcgetattr(STDIN_FILENO, &l->before) != 0) return;
    struct termios raw = l->before;
    raw.c_lflag &= ~(tcflag_t)(ICANON | ECHO);
    raw.c_cc[VMIN] = 0;
    raw.c_cc[VTIME] = 0;
    l->raw = tcsetattr(STDIN_FILENO, TCSANOW, &raw) == 0;
}

/* ---- ticks ---- */

void live_pace(struct live *l, const scenario *s, td_log log)
{
    td_clock_options o = td_clock_options_default();
    o.period_ns = llround(1e9 * s->period_s);
    o.tolerance_ns = llround(1e9 * s->task->tolerance_s);
    /* To stop is the behaviour's decision, so that the machine is braked and the log has its end. */
    o.policy = s->task->miss == TD_MISS_SLIP ? TD_MISS_SLIP : TD_MISS_CATCH_UP;
    o.log = log;
    l->period_s = s->period_s;
    l->options = o;
    (void)mlockall(MCL_CURRENT); /* where allowed: pages that are not there cost deadlines */
}

td_status live_start(struct live *l, td_error *error)
{
    td_log_write(&l->options.log, TD_LOG_INFO, "simulate", "real time begins, a tick each %g ms",
                 1e3 * l->period_s);
    return td_clock_start(&l->clock, &l->options, error);
}

void live_again(struct live *l)
{
    const td_clock_counts counts = l->clock.counts;
    (void)td_clock_start(&l->clock, &l->options, NULL);
    l->clock.counts = counts;
}

td_status live_wait(struct live *l, bool *missed, td_error *error)
{
    const uint64_t before = l->clock.counts.misses;
    TD_TRY(td_clock_wait(&l->clock, NULL, error));
    *missed = l->clock.counts.misses > before;
    return TD_OK;
}

/* ---- keys ---- */

static td_event event_of(char key, td_phase phase)
{
    switch (key) {
    case ' ':
        return phase == TD_PHASE_SIMULATION_PAUSED ? TD_EVENT_RESUME : TD_EVENT_PAUSE;
    case 'a':
        return TD_EVENT_ABORT;
    case 'r':
        return TD_EVENT_REINIT;
    case 's':
        return TD_EVENT_START;
    case 'q':
        return TD_EVENT_USER_STOP;
    case 'm':
        return phase == TD_PHASE_MANUAL ? TD_EVENT_AUTOMATIC : TD_EVENT_MANUAL;
    default:
        return TD_EVENT_COUNT;
    }
}

/* Left and right, up and down, u and j, i and k: joints 1 to 4. */
static bool stick_of(task_input *jog, char key, bool arrow)
{
    static const char arrows[] = "DCBA", letters[] = "jukijuki";
    const char *at = key ? strchr(arrow ? arrows : letters, key) : NULL;
    if (!at) return false;
    const int place = (int)(at - (arrow ? arrows : letters)) % 4;
    jog->event = TD_EVENT_JOG;
    jog->joint = (arrow ? 0 : 2) + place / 2;
    jog->stick = place % 2 ? -1 : 1;
    return true;
}

/* Of an arrow's three bytes the last is looked at. */
static bool is_arrow(key_live *l, char key)
{
    if (key == 27 || (l->escapes == 1 && key == '[')) {
        l->escapes = key == 27 ? 1 : 2;
        return false;
    }
    const bool arrow = l->escapes == 2;
    l->escapes = 0;
    return arrow;
}

static td_status take_key(key_live *l, task_inputs *inputs, long period, td_phase phase, char key,
                          td_error *error)
{
    task_input jog = {.joint = -1}, input = {.period = period, .joint = -1};
    const bool within = key == 27 || (l->escapes == 1 && key == '['), arrow = is_arrow(l, key);
    if (within) return TD_OK;
    if (phase == TD_PHASE_MANUAL && stick_of(&jog, key, arrow) && jog.joint < l->joints) {
        l->jog = jog;
        l->jog_until = period + (long)ceil(HELD_S / l->live.period_s);
        return TD_OK;
    }
    input.event = arrow ? TD_EVENT_COUNT : event_of(key, phase);
    return input.event == TD_EVENT_COUNT ? TD_OK : inputs_add(inputs, &input, error);
}

static td_status take_keys(struct live *live, task_inputs *inputs, long period, td_phase phase,
                           td_error *error)
{
    key_live *l = (key_live *)live;
    struct pollfd in = {.fd = STDIN_FILENO, .events = POLLIN};
    while (l->keys && poll(&in, 1, 0) == 1) {
        char key = 0;
        if (read(STDIN_FILENO, &key, 1) != 1) {
            l->keys = false;
            break;
        }
        TD_TRY(take_key(l, inputs, period, phase, key, error));
    }
    if (phase != TD_PHASE_MANUAL || period >= l->jog_until) return TD_OK;
    l->jog.period = period;
    return inputs_add(inputs, &l->jog, error);
}

static td_status show(struct live *live, const live_view *v, td_error *error)
{
    key_live *l = (key_live *)live;
    (void)error;
    if (l->term->quiet || !l->term->is_tty || v->time_s < l->shown_s + 0.1) return TD_OK;
    l->shown_s = v->time_s;
    l->term->bar_shown = true; /* a message takes it away first */
    fprintf(stderr,
            "\r\033[K%8.1f s  %s, step %d of %d, missed %llu  | space pause, a abort, r reinit, s start, "
            "m manual, q stop",
            v->time_s, td_phase_text(v->phase), v->step + 1 > v->steps ? v->steps : v->step + 1, v->steps,
            (unsigned long long)l->live.clock.counts.misses);
    fflush(stderr);
    return TD_OK;
}

/* ---- from the start to the end ---- */

static bool is_attended(const struct live *live)
{
    return ((const key_live *)live)->attended;
}

td_status live_begin(struct live **live, const scenario *s, terminal *term, td_log log, td_error *error)
{
    key_live *l = calloc(1, sizeof *l);
    *live = NULL;
    if (!l) return td_fail(error, TD_ERROR_MEMORY, "no memory for a session");
    l->term = term;
    l->joints = s->robot->joint_count;
    l->live.inputs = take_keys;
    l->live.attended = is_attended;
    l->live.show = show;
    live_pace(&l->live, s, log);
    open_keys(l);
    *live = &l->live;
    return TD_OK;
}

void live_end(struct live **live)
{
    key_live *l = live ? (key_live *)*live : NULL;
    if (!l) return;
    if (l->raw) tcsetattr(STDIN_FILENO, TCSANOW, &l->before);
    terminal_clear(l->term);
    (void)munlockall();
    free(l);
    *live = NULL;
}
