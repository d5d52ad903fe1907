/* A folder that fills: looked at again and again, each file once. */
#include <dirent.h>
#include <errno.h>
#include <fnmatch.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

#include "core/file.h"
#include "core/source_internal.h"

/* A file that cannot be decoded may still be growing; after so long without a change it is not. */
static const double SETTLE_S = 2, LOOK_S = 0.02;

enum { NAME_SIZE = 256 };

/* What was seen of the file at the head of the queue. */
typedef struct waiting {
    bool begun;
    off_t size;
    struct timespec changed;
    double since_s; /* by the monotonic clock: unchanged since */
} waiting;

typedef struct folder {
    char *path, *pattern; /* pattern NULL: every image */
    int channels;
    char **name;            /* (count) all names ever taken up, in the order they are given out … */
    size_t count, capacity; /* … from `next` on they are still to come */
    size_t next;
    char **known; /* (count) the same, sorted by strcmp */
    waiting head;
    bool numbered;    /* of a pair's first folder: partners were found by their numbers */
    double waiting_s; /* of the same: since when no numbers agree; 0: they do */
    td_image *image;  /* grabbed */
    char taken[NAME_SIZE];
} folder;

static td_status out_of_memory(const folder *f, td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its list of files", f->path);
}

static int by_bytes(const void *a, const void *b)
{
    return strcmp(*(char *const *)a, *(char *const *)b);
}

static int by_nature(const void *a, const void *b)
{
    return td_natural_compare(*(char *const *)a, *(char *const *)b);
}

static bool is_wanted(const folder *f, const char *name, size_t known)
{
    if (name[0] == '.' || strlen(name) >= NAME_SIZE || !td_is_image_name(name)) return false;
    if (f->pattern && fnmatch(f->pattern, name, 0) != 0) return false;
    return known == 0 || !bsearch(&name, f->known, known, sizeof *f->known, by_bytes);
}

static bool reserve(folder *f)
{
    if (f->count < f->capacity) return true;
    const size_t capacity = f->capacity ? 2 * f->capacity : 64;
    char **name = realloc(f->name, capacity * sizeof *name);
    if (name) f->name = name;
    char **known = realloc(f->known, capacity * sizeof *known);
    if (known) f->known = known;
    if (!name || !known) return false;
    f->capacity = capacity;
    return true;
}

/* Puts all new names into the queue, in natural order. */
static td_status look(folder *f, td_error *error)
{
    DIR *stream = opendir(f->path);
    if (!stream)
        return td_fail(error, TD_ERROR_IO, "%s: the folder can no longer be read: %s", f->path,
                       strerror(errno));
    const size_t known = f->count;
    td_status status = TD_OK;
    for (struct dirent *entry; status == TD_OK && (entry = readdir(stream));) {
        if (!is_wanted(f, entry->d_name, known)) continue;
        char *name = reserve(f) ? strdup(entry->d_name) : NULL;
        if (name) f->name[f->count++] = name;
        if (!name) status = out_of_memory(f, error);
    }
    closedir(stream);
    if (f->count > known) {
        qsort(f->name + known, f->count - known, sizeof *f->name, by_nature);
        memcpy(f->known + known, f->name + known, (f->count - known) * sizeof *f->known);
        qsort(f->known, f->count, sizeof *f->known, by_bytes);
    }
    return status;
}

static bool same_time(struct timespec a, struct timespec b)
{
    return a.tv_sec == b.tv_sec && a.tv_nsec == b.tv_nsec;
}

/* Notes what the head looks like. True when it changed since the last look. */
static bool note_change(waiting *w, const struct stat *seen)
{
    if (w->begun && w->size == seen->st_size && same_time(w->changed, seen->st_mtim)) return false;
    *w = (waiting){true, seen->st_size, seen->st_mtim, td_monotonic_s()};
    return true;
}

static double seconds_of(struct timespec t)
{
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static bool is_settled(const waiting *w)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return seconds_of(now) - seconds_of(w->changed) > SETTLE_S || td_monotonic_s() - w->since_s > SETTLE_S;
}

static void pass_head(folder *f)
{
    f->next++;
    f->head = (waiting){0};
}

/* Tries the file at the head. *got: it is decoded. Passes over what is no file any more; an error passes over
 * the file that it names. */
static td_status try_head(bool *got, double *time_s, folder *f, td_error *error)
{
    const char *name = f->name[f->next];
    char *path = td_path_join(f->path, name);
    if (!path) return out_of_memory(f, error);
    struct stat seen;
    td_status status = TD_OK;
    if (stat(path, &seen) != 0 || S_ISDIR(seen.st_mode)) {
        pass_head(f);
    } else {
        const bool changed = note_change(&f->head, &seen), settled = is_settled(&f->head);
        if (changed || settled) {
            status = td_image_read(&f->image, path, f->channels, error);
            *got = status == TD_OK;
            if (*got) {
                *time_s = seconds_of(seen.st_mtim);
                strcpy(f->taken, name);
            }
            if (*got || settled) pass_head(f);
            if (!settled) status = TD_OK;
        }
    }
    free(path);
    return status;
}

static td_status folder_grab(bool *got, bool *ended, double *time_s, void *state, double wait_s,
                             td_error *error)
{
    folder *f = state;
    const double until_s = td_monotonic_s() + wait_s;
    *got = *ended = false;
    td_image_free(&f->image);
    for (;;) {
        if (f->next == f->count) {
            td_status status = look(f, error);
            *ended = status != TD_OK;
            TD_TRY(status);
        }
        const size_t before = f->next;
        if (f->next < f->count) TD_TRY(try_head(got, time_s, f, error));
        if (*got) return TD_OK;
        if (f->next != before) continue;
        const double left_s = until_s - td_monotonic_s();
        if (left_s <= 0) return TD_OK;
        td_pause_s(left_s < LOOK_S ? left_s : LOOK_S);
    }
}

static td_status folder_retrieve(td_image **image, char name[256], void *state, td_error *error)
{
    folder *f = state;
    (void)error;
    *image = f->image;
    f->image = NULL;
    strcpy(name, f->taken);
    return TD_OK;
}

static void folder_free(void *state)
{
    folder *f = state;
    for (size_t i = 0; i < f->count; i++) free(f->name[i]);
    free(f->name);
    free(f->known);
    free(f->path);
    free(f->pattern);
    td_image_free(&f->image);
    free(f);
}

static const td_source_driver folder_driver = {folder_grab, folder_retrieve, folder_free};

/* The last number in a name without its leading zeros; 0: there is none. */
static size_t number_in(const char **digits, const char *name)
{
    size_t end = strlen(name);
    while (end > 0 && !(name[end - 1] >= '0' && name[end - 1] <= '9')) end--;
    size_t begin = end;
    while (begin > 0 && name[begin - 1] >= '0' && name[begin - 1] <= '9') begin--;
    while (begin + 1 < end && name[begin] == '0') begin++;
    *digits = name + begin;
    return end - begin;
}

/* Place in the queue of the file with the same number as `name`; count: none. */
static size_t partner_of(const folder *f, const char *name)
{
    const char *a, *b;
    const size_t length = number_in(&a, name);
    for (size_t i = f->next; length && i < f->count; i++)
        if (number_in(&b, f->name[i]) == length && memcmp(a, b, length) == 0) return i;
    return f->count;
}

/* Puts file `at` of the queue at its head; the others keep their order. */
static void bring_forward(folder *f, size_t at)
{
    char *name = f->name[at];
    if (at == f->next) return;
    memmove(f->name + f->next + 1, f->name + f->next, (at - f->next) * sizeof *f->name);
    f->name[f->next] = name;
    f->head = (waiting){0};
}

static bool bring_partners_forward(td_source *const *source, int count)
{
    folder *first = source[0]->state;
    for (size_t k = first->next; k < first->count; k++) {
        int found = 1;
        while (found < count) {
            const folder *f = source[found]->state;
            if (partner_of(f, first->name[k]) == f->count) break;
            found++;
        }
        if (found < count) continue;
        for (int i = 1; i < count; i++)
            bring_forward(source[i]->state, partner_of(source[i]->state, first->name[k]));
        bring_forward(first, k);
        return true;
    }
    return false;
}

td_status td_folders_align(bool *aligned, td_source *const *source, int count, td_error *error)
{
    folder *first = source[0]->state;
    bool all = true;
    *aligned = false;
    for (int i = 0; i < count; i++) {
        folder *f = source[i]->state;
        const char *head = f->next < f->count ? f->name[f->next] : NULL;
        TD_TRY(look(f, error));
        qsort(f->name + f->next, f->count - f->next, sizeof *f->name, by_nature);
        if (head && f->name[f->next] != head) f->head = (waiting){0};
        all &= f->next < f->count;
    }
    if (!all) return TD_OK;
    if (bring_partners_forward(source, count)) {
        first->numbered = *aligned = true;
        first->waiting_s = 0;
        return TD_OK;
    }
    const double now = td_monotonic_s();
    if (first->waiting_s == 0) first->waiting_s = now;
    *aligned = !first->numbered && now - first->waiting_s > SETTLE_S;
    return TD_OK;
}

td_status td_folder_open(td_source *source, const char *path, const char *pattern, int channels,
                         td_error *error)
{
    DIR *stream = opendir(path);
    if (!stream) {
        if (errno == ENOENT)
            return td_fail(error, TD_ERROR_IO, "%s: there is no such folder; make it before it fills", path);
        return td_fail(error, TD_ERROR_IO, "%s: the folder cannot be read: %s", path, strerror(errno));
    }
    closedir(stream);
    folder *f = calloc(1, sizeof *f);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its list of files", path);
    source->kind = TD_SOURCE_FOLDER;
    source->driver = &folder_driver;
    source->state = f;
    f->channels = channels;
    f->path = strdup(path);
    if (pattern) f->pattern = strdup(pattern);
    if (!f->path || (pattern && !f->pattern))
        return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its name", path);
    return TD_OK;
}
