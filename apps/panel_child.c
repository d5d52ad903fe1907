#include "apps/panel_child.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

enum { PIECE = 1 << 16 };

/* Not fork(): the copies of pages that it leaves behind would be paid for by the session's thread. Signals,
 * priority and group are its own. */
static int spawn(pid_t *pid, const char *program, char *const *argv, int in, int out)
{
    posix_spawn_file_actions_t files;
    posix_spawnattr_t how;
    sigset_t none, all;
    const struct sched_param usual = {0};
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawn_file_actions_init(&files);
    posix_spawnattr_init(&how);
    posix_spawn_file_actions_adddup2(&files, in, STDIN_FILENO);
    posix_spawn_file_actions_adddup2(&files, out, STDOUT_FILENO);
    posix_spawnattr_setsigmask(&how, &none);
    posix_spawnattr_setsigdefault(&how, &all);
    posix_spawnattr_setpgroup(&how, 0);
    posix_spawnattr_setschedpolicy(&how, SCHED_OTHER);
    posix_spawnattr_setschedparam(&how, &usual);
    posix_spawnattr_setflags(&how, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP |
                                       POSIX_SPAWN_SETSCHEDULER);
    const int failed = posix_spawn(pid, program, &files, &how, argv, environ);
    posix_spawn_file_actions_destroy(&files);
    posix_spawnattr_destroy(&how);
    return failed;
}

static bool find_beside(char *path, size_t size, const char *name)
{
    char self[1024];
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) return false;
    self[length] = 0;
    char *slash = strrchr(self, '/');
    if (slash) *slash = 0;
    return slash && snprintf(path, size, "%s/%s", self, name) < (int)size;
}

static void close_both(const int ends[2])
{
    close(ends[0]);
    close(ends[1]);
}

static bool open_pipes(int in[2], int out[2])
{
    if (pipe(in) != 0) return false;
    if (pipe(out) != 0) {
        close_both(in);
        return false;
    }
    for (int k = 0; k < 2; k++) {
        (void)fcntl(in[k], F_SETFD, FD_CLOEXEC);
        (void)fcntl(out[k], F_SETFD, FD_CLOEXEC);
    }
    (void)fcntl(in[1], F_SETFL, O_NONBLOCK);
    (void)fcntl(out[0], F_SETFL, O_NONBLOCK);
    return true;
}

td_status panel_child_start(panel_child *child, const char *name, const char *const *argv, td_error *error)
{
    char path[1200];
    int in[2], out[2];
    *child = (panel_child){.in = -1, .out = -1};
    if (!find_beside(path, sizeof path, name))
        return td_fail(error, TD_ERROR_EXTERNAL, "the place of the programs cannot be found");
    if (!open_pipes(in, out)) return td_fail(error, TD_ERROR_IO, "a pipe: %s", strerror(errno));
    const int failed = spawn(&child->pid, path, (char *const *)argv, in[0], out[1]);
    close(in[0]);
    close(out[1]);
    if (failed) {
        close(in[1]);
        close(out[0]);
        child->pid = 0;
        return td_fail(error, TD_ERROR_EXTERNAL, "%s cannot be run: %s", path, strerror(failed));
    }
    child->in = in[1];
    child->out = out[0];
    return TD_OK;
}

/* What is no longer than PIPE_BUF goes in whole or not at all. */
bool panel_child_tell(const panel_child *child, const char *line, size_t size)
{
    return child->in >= 0 && size <= PANEL_CHILD_REQUEST && write(child->in, line, size) == (ssize_t)size;
}

static bool make_room(panel_child *child)
{
    if (child->room - child->size >= PIECE) return true;
    const size_t room = 2 * child->room + 2 * PIECE;
    char *more = child->size < PANEL_CHILD_LINE ? realloc(child->line, room) : NULL;
    if (!more) return false;
    child->line = more;
    child->room = room;
    return true;
}

/* The whole lines of what has come; `from`: where the new begins. */
static bool give_lines(panel_child *child, size_t from, bool (*take)(void *user, char *line), void *user)
{
    size_t begin = 0;
    for (char *end; (end = memchr(child->line + from, '\n', child->size - from));) {
        *end = 0;
        if (!take(user, child->line + begin)) return false;
        begin = from = (size_t)(end - child->line) + 1;
    }
    child->size -= begin;
    memmove(child->line, child->line + begin, child->size);
    return true;
}

bool panel_child_read(panel_child *child, bool (*take)(void *user, char *line), void *user)
{
    if (!make_room(child)) return false;
    const ssize_t n = read(child->out, child->line + child->size, PIECE);
    if (n < 0) return errno == EAGAIN || errno == EINTR;
    if (n == 0) return false;
    const size_t from = child->size;
    child->size += (size_t)n;
    return give_lines(child, from, take, user);
}

int panel_child_end(panel_child *child)
{
    int status = 0;
    if (child->in >= 0) close(child->in);
    child->in = -1;
    if (child->pid > 0) {
        (void)kill(-child->pid, SIGKILL); /* one that ended by itself keeps its own status */
        while (waitpid(child->pid, &status, 0) < 0 && errno == EINTR) continue;
    }
    child->pid = 0;
    free(child->line);
    child->line = NULL;
    child->size = child->room = 0;
    return status;
}
