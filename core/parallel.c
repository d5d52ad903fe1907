#include "core/parallel.h"

#include <pthread.h>
#include <unistd.h>

enum { MAX_THREADS = 256 };

typedef struct loop {
    pthread_mutex_t lock;
    size_t next, done, count;
    bool cancelled;
    td_parallel_function function;
    void *user;
    const td_progress *progress;
    const char *stage;
} loop;

static void *work(void *argument)
{
    loop *l = argument;
    pthread_mutex_lock(&l->lock);
    while (!l->cancelled && l->next < l->count) {
        size_t index = l->next++;
        pthread_mutex_unlock(&l->lock);
        l->function(index, l->user);
        pthread_mutex_lock(&l->lock);
        l->done++;
        if (!td_progress_report(l->progress, l->stage, l->done, l->count)) l->cancelled = true;
    }
    pthread_mutex_unlock(&l->lock);
    return NULL;
}

td_status td_parallel_for(size_t count, int threads, td_parallel_function function, void *user,
                          const td_progress *progress, const char *stage)
{
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    size_t wanted = threads > 0 ? (size_t)threads : processors > 0 ? (size_t)processors : 1;
    if (wanted > count) wanted = count;
    if (wanted > MAX_THREADS) wanted = MAX_THREADS;

    loop l = {.count = count, .function = function, .user = user, .progress = progress, .stage = stage};
    pthread_mutex_init(&l.lock, NULL);
    pthread_t helpers[MAX_THREADS];
    size_t started = 0;
    /* The calling thread works too; a helper that cannot be started only makes it slower. */
    while (started + 1 < wanted && pthread_create(&helpers[started], NULL, work, &l) == 0) started++;
    work(&l);
    for (size_t i = 0; i < started; i++) pthread_join(helpers[i], NULL);
    pthread_mutex_destroy(&l.lock);
    return l.cancelled ? TD_ERROR_CANCELLED : TD_OK;
}
