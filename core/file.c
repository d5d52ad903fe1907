#include "core/file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/file_internal.h"

/* Temporary names are tried one after another until one is free. */
enum { TEMPORARY_TRIES = 10000, TEMPORARY_NAME_SIZE = 64, FIRST_CAPACITY = 65536 };

static const char *kind_of(mode_t mode)
{
    if (S_ISDIR(mode)) return "a folder";
    if (S_ISFIFO(mode)) return "a pipe";
    if (S_ISSOCK(mode)) return "a socket";
    if (S_ISREG(mode)) return "a file";
    return "a device";
}

td_status td_file_open(int *fd, const char *path, td_error *error)
{
    /* O_NONBLOCK: a pipe that nobody writes to would hold open() for ever. On a regular file it means
     * nothing. */
    int opened;
    do opened = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY);
    while (opened < 0 && errno == EINTR);
    if (opened < 0 && errno == ENXIO)
        return td_fail(error, TD_ERROR_IO, "%s: is a socket or device, not a file", path);
    if (opened < 0) return td_fail(error, TD_ERROR_IO, "%s: cannot be opened: %s", path, strerror(errno));
    struct stat status;
    if (fstat(opened, &status) != 0) {
        int cause = errno;
        close(opened);
        return td_fail(error, TD_ERROR_IO, "%s: cannot be examined: %s", path, strerror(cause));
    }
    if (!S_ISREG(status.st_mode)) {
        close(opened);
        return td_fail(error, TD_ERROR_IO, "%s: is %s, not a file", path, kind_of(status.st_mode));
    }
    *fd = opened;
    return TD_OK;
}

/* read() that is not disturbed by signals. */
static ssize_t read_some(int fd, void *bytes, size_t size)
{
    ssize_t got;
    do got = read(fd, bytes, size);
    while (got < 0 && errno == EINTR);
    return got;
}

static td_status read_all(char **bytes, size_t *size, int fd, const char *path, size_t limit, td_error *error)
{
    /* The size on the disk is not trusted: files grow, and those of /proc say 0. One byte beyond the limit
     * tells that there is more. */
    size_t capacity = 0, used = 0;
    char *data = NULL;
    for (;;) {
        if (used == capacity) {
            size_t wanted = capacity ? capacity * 2 : FIRST_CAPACITY;
            if (wanted > limit + 1) wanted = limit + 1;
            char *larger = realloc(data, wanted + 1);
            if (!larger) {
                free(data);
                return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its %zu bytes", path, wanted);
            }
            data = larger;
            capacity = wanted;
        }
        ssize_t got = read_some(fd, data + used, capacity - used);
        if (got < 0) {
            int cause = errno;
            free(data);
            return td_fail(error, TD_ERROR_IO, "%s: cannot be read: %s", path, strerror(cause));
        }
        if (got == 0) break;
        used += (size_t)got;
        if (used > limit) {
            free(data);
            return td_fail(error, TD_ERROR_IO, "%s: is larger than the %zu bytes that are accepted", path,
                           limit);
        }
    }
    data[used] = 0;
    *bytes = data;
    *size = used;
    return TD_OK;
}

td_status td_file_read(char **bytes, size_t *size, const char *path, size_t limit, td_error *error)
{
    int fd = -1;
    if (limit > SIZE_MAX - 2) limit = SIZE_MAX - 2;
    if (td_archive_has(path)) return td_archive_read(bytes, size, path, limit, error);
    TD_TRY(td_file_open(&fd, path, error));
    td_status status = read_all(bytes, size, fd, path, limit, error);
    close(fd);
    return status;
}

/* Creates a new, empty file of a name that nobody else has in the folder; its path in *path, free(). Not
 * mkstemp: the mode must be that of an ordinary new file (0644 less the umask, which only the kernel applies
 * without a race). */
static int create_temporary(char **path, const char *folder)
{
    for (int i = 0; i < TEMPORARY_TRIES; i++) {
        char name[TEMPORARY_NAME_SIZE];
        snprintf(name, sizeof name, ".teledimos-%ld-%d.tmp", (long)getpid(), i);
        *path = td_path_join(folder, name);
        if (!*path) {
            errno = ENOMEM;
            return -1;
        }
        int fd = open(*path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
        if (fd >= 0) return fd;
        free(*path);
        *path = NULL;
        if (errno != EEXIST && errno != EINTR) return -1;
    }
    return -1;
}

static bool write_bytes(int fd, const char *bytes, size_t size)
{
    size_t done = 0;
    while (done < size) {
        ssize_t wrote = write(fd, bytes + done, size - done);
        if (wrote < 0 && errno == EINTR) continue;
        if (wrote < 0) break;
        done += (size_t)wrote;
    }
    return done == size;
}

/* Makes the rename itself last. Some file systems cannot sync a folder and say EINVAL: nothing more can be
 * done there. */
static bool sync_folder(const char *folder)
{
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return errno == EACCES; /* a folder that one may write to but not list */
    bool fine = fsync(fd) == 0 || errno == EINVAL || errno == ENOTSUP;
    int cause = errno;
    close(fd);
    errno = cause;
    return fine;
}

static td_status write_failed(const char *path, int cause, td_error *error)
{
    const char *advice = "";
    if (cause == ENOSPC || cause == EDQUOT) advice = "; free some space and run again";
    if (cause == ENOENT) advice = "; its folder must exist";
    return td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s%s", path, strerror(cause), advice);
}

/* Writes all parts, syncs and closes. */
static td_status fill(int fd, const char *path, td_file_part part, void *user, td_error *error)
{
    const void *bytes = NULL;
    size_t size = 0;
    int cause = 0;
    td_status status = TD_OK;
    while (!cause && (status = part(&bytes, &size, user, error)) == TD_OK && size > 0)
        if (!write_bytes(fd, bytes, size)) cause = errno;
    if (status == TD_OK && !cause && fsync(fd) != 0) cause = errno;
    /* close() reports what a network file system could not store; after EINTR the descriptor is closed all
     * the same. */
    if (close(fd) != 0 && errno != EINTR && !cause) cause = errno;
    return status == TD_OK && cause ? write_failed(path, cause, error) : status;
}

/* rename() would put a plain file in the place of a device. */
static td_status check_place(const char *path, td_error *error)
{
    struct stat status;
    if (stat(path, &status) == 0 && !S_ISREG(status.st_mode))
        return td_fail(error, TD_ERROR_IO, "%s: is %s, so no file can be written there", path,
                       kind_of(status.st_mode));
    return TD_OK;
}

td_status td_file_write_parts(const char *path, td_file_part part, void *user, td_error *error)
{
    TD_TRY(check_place(path, error));
    char *folder = td_path_folder(path), *temporary = NULL;
    if (!folder) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its name", path);
    int fd = create_temporary(&temporary, folder);
    td_status result = fd < 0 ? write_failed(path, errno, error) : fill(fd, path, part, user, error);
    if (result == TD_OK && rename(temporary, path) != 0) result = write_failed(path, errno, error);
    if (result != TD_OK && temporary) unlink(temporary);
    if (result == TD_OK && !sync_folder(folder)) result = write_failed(path, errno, error);
    free(temporary);
    free(folder);
    return result;
}

typedef struct whole {
    const void *bytes;
    size_t size;
} whole;

static td_status whole_part(const void **bytes, size_t *size, void *user, td_error *error)
{
    whole *w = user;
    (void)error;
    *bytes = w->bytes;
    *size = w->size;
    w->size = 0;
    return TD_OK;
}

td_status td_file_write(const char *path, const void *bytes, size_t size, td_error *error)
{
    whole w = {bytes, size};
    return td_file_write_parts(path, whole_part, &w, error);
}

td_status td_file_part_begin(int *fd, const char *part, const char *path, td_error *error)
{
    struct flock all = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
    TD_TRY(check_place(path, error));
    TD_TRY(check_place(part, error));
    int opened;
    do opened = open(part, O_WRONLY | O_CREAT | O_CLOEXEC | O_NOCTTY, 0644);
    while (opened < 0 && errno == EINTR);
    if (opened < 0) return write_failed(part, errno, error);
    /* Emptied only once it is ours. A file system without locks says ENOLCK or EINVAL: nothing can be done.
     */
    int cause = 0;
    if (fcntl(opened, F_SETLK, &all) != 0 && (errno == EACCES || errno == EAGAIN)) cause = errno;
    if (cause) {
        close(opened);
        return td_fail(error, TD_ERROR_IO,
                       "%s: is being written by another process; wait for its end, or choose "
                       "another name",
                       path);
    }
    if (ftruncate(opened, 0) != 0) {
        cause = errno;
        close(opened);
        return write_failed(part, cause, error);
    }
    *fd = opened;
    return TD_OK;
}

td_status td_file_part_add(int fd, const char *path, const void *bytes, size_t size, td_error *error)
{
    return write_bytes(fd, bytes, size) ? TD_OK : write_failed(path, errno, error);
}

td_status td_file_part_finish(int fd, const char *part, const char *path, td_error *error)
{
    char *folder = td_path_folder(path);
    int cause = folder ? 0 : ENOMEM;
    /* Renamed while it is open: closing gives up the lock. */
    if (!cause && fsync(fd) != 0) cause = errno;
    if (!cause && rename(part, path) != 0) cause = errno;
    if (close(fd) != 0 && errno != EINTR && !cause) cause = errno;
    if (!cause && !sync_folder(folder)) cause = errno;
    free(folder);
    return cause ? write_failed(path, cause, error) : TD_OK;
}

td_status td_file_stream(FILE **file, const char *path, td_error *error)
{
    int fd = -1;
    *file = NULL;
    TD_TRY(td_file_open(&fd, path, error));
    *file = fdopen(fd, "rb");
    if (*file) return TD_OK;
    int cause = errno;
    close(fd);
    return td_fail(error, TD_ERROR_IO, "%s: cannot be opened: %s", path, strerror(cause));
}

static td_status make_one(const char *path, td_error *error)
{
    if (mkdir(path, 0777) == 0) return TD_OK;
    int cause = errno;
    struct stat status;
    if (stat(path, &status) == 0) {
        if (S_ISDIR(status.st_mode)) return TD_OK;
        return td_fail(error, TD_ERROR_IO, "%s: is %s, so no folder can be made there", path,
                       kind_of(status.st_mode));
    }
    return td_fail(error, TD_ERROR_IO, "%s: the folder cannot be made: %s", path, strerror(cause));
}

td_status td_folder_make(const char *path, td_error *error)
{
    if (!*path) return td_fail(error, TD_ERROR_ARGUMENT, "the name of a folder is empty");
    char *part = strdup(path);
    if (!part) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its name", path);
    td_status status = TD_OK;
    for (char *end = part + 1; status == TD_OK && *end; end++) {
        if (*end != '/') continue;
        *end = 0;
        status = make_one(part, error);
        *end = '/';
    }
    if (status == TD_OK) status = make_one(path, error);
    free(part);
    return status;
}

char *td_path_join(const char *folder, const char *name)
{
    size_t length = strlen(folder), name_size = strlen(name) + 1;
    if (name[0] == '/' || length == 0) length = 0;
    bool slash = length > 0 && folder[length - 1] != '/';
    char *path = malloc(length + slash + name_size);
    if (!path) return NULL;
    memcpy(path, folder, length);
    if (slash) path[length] = '/';
    memcpy(path + length + slash, name, name_size);
    return path;
}

char *td_path_folder(const char *path)
{
    const char *slash = strrchr(path, '/');
    size_t length = slash ? (size_t)(slash - path) : 0;
    while (length > 0 && path[length - 1] == '/') length--;
    const char *folder = slash ? (length ? path : "/") : ".";
    if (length == 0) length = 1;
    char *copy = malloc(length + 1);
    if (!copy) return NULL;
    memcpy(copy, folder, length);
    copy[length] = 0;
    return copy;
}
