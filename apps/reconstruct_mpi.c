/* A team of MPI's ranks. Each measures its frames in their order and sends what they say, two at most on
 * their way; rank 0 fetches the frames in order. Nobody waits in MPI itself, which would keep a processor
 * busy and hear of no interruption. A rank that dies takes the others with it, as MPI does; run again, the
 * work goes on. */
#include <mpi.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "apps/reconstruct_team.h"

enum { TAG_FRAME, TAG_VALUE, TAG_SIGMA, TAG_KIND, TAG_LEFT, TAG_STOP, PARTS = 5, UNDER_WAY = 2 };

/* What is told of a frame; in the end one of no frame. */
typedef struct letter {
    uint64_t frame;
    int32_t status, end; /* td_status */
    int32_t width, height;
    bool failed;
    char reason[FRAME_REASON_SIZE], sha256[TD_HASH_HEX_SIZE];
    double matched, masked, epipolar_px, seconds, time_s, skew_s;
} letter;

/* What must be alike in all ranks, and what has gone wrong in one. */
typedef struct greeting {
    int32_t status;
    char key[TD_HASH_HEX_SIZE], message[sizeof(((td_error *)NULL)->message)], machine[MPI_MAX_PROCESSOR_NAME];
} greeting;

/* A frame that is being sent. */
typedef struct parcel {
    letter letter;
    reconstruct_view view;
    MPI_Request part[PARTS];
    int parts;
} parcel;

static int rank, size, neighbours;
static parcel sending[UNDER_WAY];

/* The rank that measures a frame. Fusing takes a tenth of the time that measuring takes: from four ranks on
 * all goes faster when rank 0 does nothing else. */
static int owner_of(size_t index)
{
    const size_t many = (size_t)size;
    return (int)(many < 4 ? index % many : 1 + index % (many - 1));
}

static void wait_a_moment(void)
{
    const struct timespec moment = {0, 500000};
    nanosleep(&moment, NULL);
}

bool team_start(td_error *error)
{
    int given;
    MPI_Comm here;
    const char *tasks = getenv("SLURM_STEP_NUM_TASKS");
    if (MPI_Init_thread(NULL, NULL, MPI_THREAD_SERIALIZED, &given) != MPI_SUCCESS) return false;
    MPI_Comm_rank(MPI_COMM_WORLD, &rank);
    MPI_Comm_size(MPI_COMM_WORLD, &size);
    MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &here);
    MPI_Comm_size(here, &neighbours);
    MPI_Comm_free(&here);
    if (size == 1 && tasks && atoi(tasks) > 1) {
        td_fail(
            error, TD_ERROR_ARGUMENT,
            "Slurm has started %s processes that do not know of each other: use srun --mpi=pmix, or mpirun",
            tasks);
        MPI_Finalize();
        return false;
    }
    /* What rank 0 says is said once. */
    return rank == 0 || (freopen("/dev/null", "w", stdout) && freopen("/dev/null", "w", stderr));
}

int team_end(int status)
{
    MPI_Finalize();
    return rank == 0 ? status : 0;
}

int team_rank(void)
{
    return rank;
}

int team_size(void)
{
    return size;
}

int team_neighbours(void)
{
    return neighbours;
}

td_status team_agree(td_status status, const char key[TD_HASH_HEX_SIZE], size_t *first, td_error *error)
{
    greeting mine = {.status = (int32_t)status}, *all = calloc((size_t)size, sizeof *all);
    uint64_t from = *first;
    int length;
    memcpy(mine.key, key, sizeof mine.key);
    snprintf(mine.message, sizeof mine.message, "%s", error->message);
    MPI_Get_processor_name(mine.machine, &length);
    if (!all) MPI_Abort(MPI_COMM_WORLD, EXIT_FAILED);
    MPI_Allgather(&mine, sizeof mine, MPI_BYTE, all, sizeof mine, MPI_BYTE, MPI_COMM_WORLD);
    MPI_Bcast(&from, 1, MPI_UINT64_T, 0, MPI_COMM_WORLD);
    *first = (size_t)from;
    for (int i = 0; i < size && status == TD_OK; i++) {
        if (all[i].status != TD_OK)
            status =
                td_fail(error, (td_status)all[i].status, "on %s: %.300s", all[i].machine, all[i].message);
        else if (strcmp(all[i].key, all[0].key) != 0)
            status = td_fail(error, TD_ERROR_DATA,
                             "%s sees another dataset, rig or robot than %s: let all machines see the same "
                             "files and run the same version",
                             all[i].machine, all[0].machine);
    }
    free(all);
    return status;
}

/* ---- rank 0 ---- */

/* False: interrupted meanwhile. */
static bool wait_for(int tag, int from, const td_progress *progress, size_t done, size_t total)
{
    int here = 0;
    for (;;) {
        MPI_Iprobe(from, tag, MPI_COMM_WORLD, &here, MPI_STATUS_IGNORE);
        if (here) return true;
        if (progress && !td_progress_report(progress, "reconstructing", done, total)) return false;
        wait_a_moment();
    }
}

static void receive(void *data, size_t count, MPI_Datatype type, int tag, int from)
{
    MPI_Recv(data, (int)count, type, from, tag, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
}

static td_status receive_view(reconstruct_view *view, const letter *l, int from, td_error *error)
{
    const size_t n = (size_t)l->width * (size_t)l->height;
    td_disparity *d = calloc(1, sizeof *d);
    if (d)
        *d = (td_disparity){l->width, l->height, malloc(n * sizeof *d->value), malloc(n * sizeof *d->sigma),
                            malloc(n)};
    view->disparity = d;
    TD_TRY(td_image_new(&view->left, l->width, l->height, 1, error));
    if (!d || !d->value || !d->sigma || !d->kind)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for disparities of %d x %d px", l->width,
                       l->height);
    receive(d->value, n, MPI_FLOAT, TAG_VALUE, from);
    receive(d->sigma, n, MPI_FLOAT, TAG_SIGMA, from);
    receive(d->kind, n, MPI_BYTE, TAG_KIND, from);
    receive(view->left->data, n, MPI_BYTE, TAG_LEFT, from);
    return TD_OK;
}

td_status team_measure(reconstruct_view *view, reconstruct_job *work, size_t index, td_error *error)
{
    const int from = owner_of(index);
    reconstruct_frame *f = &work->frame[index];
    letter l;
    if (from == 0) return reconstruct_measure(view, work, index, error);
    if (!wait_for(TAG_FRAME, from, work->how->progress, index, work->count))
        return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    receive(&l, sizeof l, MPI_BYTE, TAG_FRAME, from);
    if (l.width > 0) TD_TRY(receive_view(view, &l, from, error));
    if (l.status != TD_OK) return td_fail(error, (td_status)l.status, "%s", l.reason);
    f->failed = l.failed;
    memcpy(f->reason, l.reason, sizeof f->reason);
    memcpy(f->sha256, l.sha256, sizeof f->sha256);
    f->matched = l.matched;
    f->masked = l.masked;
    f->epipolar_px = l.epipolar_px;
    f->seconds = l.seconds;
    f->time_s = l.time_s;
    f->skew_s = l.skew_s;
    return TD_OK;
}

/* What is under way is taken and thrown away, until the rank has said that it ends. */
static void drain(int from)
{
    letter l = {0};
    while (!l.end) {
        reconstruct_view view = {0};
        td_error ignored = {0};
        wait_for(TAG_FRAME, from, NULL, 0, 0);
        receive(&l, sizeof l, MPI_BYTE, TAG_FRAME, from);
        if (l.width > 0 && receive_view(&view, &l, from, &ignored) != TD_OK)
            MPI_Abort(MPI_COMM_WORLD, EXIT_FAILED);
        reconstruct_view_free(&view);
    }
}

void team_dismiss(void)
{
    for (int i = 1; i < size; i++) MPI_Send(NULL, 0, MPI_BYTE, i, TAG_STOP, MPI_COMM_WORLD);
    for (int i = 1; i < size; i++) drain(i);
}

/* ---- the others ---- */

static bool is_sent(parcel *p)
{
    int done = 1;
    if (p->parts) MPI_Testall(p->parts, p->part, &done, MPI_STATUSES_IGNORE);
    if (!done) return false;
    p->parts = 0;
    reconstruct_view_free(&p->view);
    return true;
}

static void add_part(parcel *p, const void *data, size_t count, MPI_Datatype type, int tag)
{
    MPI_Isend(data, (int)count, type, 0, tag, MPI_COMM_WORLD, &p->part[p->parts++]);
}

/* Called while a frame is matched: MPI moves what is under way only when it is called. */
static bool keep_moving(const char *stage, size_t done, size_t total, void *user)
{
    (void)stage, (void)done, (void)total, (void)user;
    for (int i = 0; i < UNDER_WAY; i++) is_sent(&sending[i]);
    return true;
}

static parcel *next_parcel(void)
{
    for (;;) {
        for (int i = 0; i < UNDER_WAY; i++)
            if (is_sent(&sending[i])) return &sending[i];
        wait_a_moment();
    }
}

static void send_frame(const reconstruct_frame *f, size_t index, reconstruct_view *view, td_status status,
                       const td_error *error)
{
    parcel *p = next_parcel();
    const td_disparity *d = view->disparity;
    memset(&p->letter, 0, sizeof p->letter);
    p->letter = (letter){.frame = index,
                         .status = (int32_t)status,
                         .width = d ? d->width : 0,
                         .height = d ? d->height : 0,
                         .failed = f->failed,
                         .matched = f->matched,
                         .masked = f->masked,
                         .epipolar_px = f->epipolar_px,
                         .seconds = f->seconds,
                         .time_s = f->time_s,
                         .skew_s = f->skew_s};
    snprintf(p->letter.reason, sizeof p->letter.reason, "%s", status == TD_OK ? f->reason : error->message);
    memcpy(p->letter.sha256, f->sha256, sizeof f->sha256);
    p->view = *view;
    *view = (reconstruct_view){0};
    add_part(p, &p->letter, sizeof p->letter, MPI_BYTE, TAG_FRAME);
    if (!d) return;
    const size_t n = (size_t)d->width * (size_t)d->height;
    add_part(p, d->value, n, MPI_FLOAT, TAG_VALUE);
    add_part(p, d->sigma, n, MPI_FLOAT, TAG_SIGMA);
    add_part(p, d->kind, n, MPI_BYTE, TAG_KIND);
    add_part(p, p->view.left->data, n, MPI_BYTE, TAG_LEFT);
}

static bool is_dismissed(void)
{
    int here = 0;
    MPI_Iprobe(0, TAG_STOP, MPI_COMM_WORLD, &here, MPI_STATUS_IGNORE);
    return here;
}

static void say_farewell(void)
{
    parcel *p = next_parcel();
    p->letter = (letter){.end = true};
    add_part(p, &p->letter, sizeof p->letter, MPI_BYTE, TAG_FRAME);
    for (int i = 0; i < UNDER_WAY; i++)
        while (!is_sent(&sending[i])) wait_a_moment();
    wait_for(TAG_STOP, 0, NULL, 0, 0);
    receive(NULL, 0, MPI_BYTE, TAG_STOP, 0);
}

td_status team_serve(reconstruct_job *work, size_t first, td_error *error)
{
    const td_progress moving = {keep_moving, NULL};
    td_status status = TD_OK;
    work->how->dense.progress = &moving;
    for (size_t i = first; i < work->count && status == TD_OK && !is_dismissed(); i++) {
        if (owner_of(i) != rank) continue;
        reconstruct_view view = {0};
        status = reconstruct_measure(&view, work, i, error);
        send_frame(&work->frame[i], i, &view, status, error);
    }
    say_farewell();
    return TD_OK;
}
