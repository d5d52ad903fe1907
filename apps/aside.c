#include "apps/aside.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MOST_BYTES = 32 << 20, MOST_FILES = 1024 };

struct aside {
    pid_t child;
    int fd;
    bool fine;
    char *bytes;
    size_t size, room;
};

static void work_there(int to, bool (*work)(void *user, FILE *out), void *user, int behind)
{
    signal(SIGINT, SIG_IGN); /* the parent decides */
    signal(SIGTERM, SIG_DFL);
    const struct sched_param others = {0};
    (void)sched_setscheduler(0, SCHED_OTHER, &others); /* what is aside is not in time, whoever began it */
    if (behind) (void)setpriority(PRIO_PROCESS, 0, getpriority(PRIO_PROCESS, 0) + behind);
    for (int fd = 3; fd < MOST_FILES; fd++)
        if (fd != to) close(fd);
    FILE *out = fdopen(to, "wb");
    const bool fine = out && work(user, out) && fclose(out) == 0;
    _exit(fine ? 0 : 1);
}

td_status aside_begin(aside **made, bool (*work)(void *user, FILE *out), void *user, int behind,
                      td_error *error)
{
    int ends[2];
    aside *a = *made = calloc(1, sizeof *a);
    if (!a) return td_fail(error, TD_ERROR_MEMORY, "no memory for a process");
    a->fd = -1;
    if (pipe(ends) != 0) {
        aside_free(made);
        return td_fail(error, TD_ERROR_IO, "a pipe: %s", strerror(errno));
    }
    fflush(NULL);
    a->child = fork();
    if (a->child == 0) work_there(ends[1], work, user, behind);
    close(ends[1]);
    a->fd = ends[0];
    if (a->child > 0 && fcntl(a->fd, F_SETFL, O_NONBLOCK) == 0) return TD_OK;
    const int failed = errno;
    aside_free(made);
    return td_fail(error, TD_ERROR_IO, "a process: %s", strerror(failed));
}

static void close_pipe(aside *a)
{
    if (a->fd >= 0) close(a->fd);
    a->fd = -1;
}

/* Whether the process is gone. One that has said all may still be long in ending, where others are busy: it
 * is not waited for. */
static bool is_gone(aside *a, int how)
{
    int status = -1;
    pid_t gone = 0;
    if (a->child <= 0) return true;
    while ((gone = waitpid(a->child, &status, how)) < 0 && errno == EINTR) continue;
    if (gone == 0) return false;
    a->child = 0;
    a->fine = gone > 0 && WIFEXITED(status) && WEXITSTATUS(status) == 0;
    return true;
}

void aside_free(aside **a)
{
    if (!a || !*a) return;
    if ((*a)->child > 0) kill((*a)->child, SIGKILL);
    close_pipe(*a);
    (void)is_gone(*a, 0);
    free((*a)->bytes);
    free(*a);
    *a = NULL;
}

int aside_fd(const aside *a)
{
    return a->fd;
}

/* False: no more can be taken. */
static bool make_room(aside *a)
{
    if (a->size < a->room) return true;
    const size_t room = 2 * a->room + 65536;
    char *more = room <= MOST_BYTES ? realloc(a->bytes, room) : NULL;
    if (!more) return false;
    a->bytes = more;
    a->room = room;
    return true;
}

bool aside_poll(aside *a)
{
    while (a->fd >= 0) {
        if (!make_room(a)) kill(a->child, SIGKILL), close_pipe(a);
        if (a->fd < 0) break;
        const ssize_t n = read(a->fd, a->bytes + a->size, a->room - a->size);
        if (n > 0) a->size += (size_t)n;
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return false;
        if (n <= 0) close_pipe(a);
    }
    return is_gone(a, WNOHANG);
}

const void *aside_bytes(const aside *a, size_t *size)
{
    *size = a->size;
    return a->child == 0 && a->fine ? a->bytes : NULL;
}
