/* Video files and cameras: the module behind OpenCV's videoio, opened when asked for. */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file_internal.h"
#include "core/source_internal.h"

#include <unistd.h>

/* A camera's pictures older than this when they are asked for waited in its driver's queue, of at most
 * QUEUE. */
static const double STALE_S = 0.1;
enum { QUEUE = 8 };

typedef struct video {
    const td_video_module *module;
    void *handle;
    char *path;
    bool camera;
    int channels;
    long grabbed; /* so far */
    double period_s, last_s;
} video;

static td_status load(const td_video_module **module, const char *path, td_error *error)
{
    void *library = dlopen(TD_VIDEO_MODULE, RTLD_NOW | RTLD_LOCAL);
    if (!library)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "%s: the module for videos and cameras cannot be loaded: %s", path, dlerror());
    td_video_module_get_function *get;
    *(void **)&get = dlsym(library, TD_VIDEO_FUNCTION);
    if (!get)
        return td_fail(error, TD_ERROR_UNSUPPORTED, "%s: %s has no %s", path, TD_VIDEO_MODULE,
                       TD_VIDEO_FUNCTION);
    *module = get();
    return TD_OK;
}

/* When the picture was taken. A file that tells no times, or the same twice, is counted by its rate; a
 * camera's driver tells the monotonic clock's time, or something else that is not to be trusted. */
static double time_of(video *v, double told_s)
{
    double time_s;
    if (v->camera) {
        const double now = td_monotonic_s();
        time_s = told_s <= now && told_s > now - 10 ? told_s : now;
    } else {
        const bool fine = v->grabbed == 0 ? isfinite(told_s) : told_s > v->last_s;
        time_s = fine ? told_s : v->grabbed == 0 ? 0 : v->last_s + (v->period_s > 0 ? v->period_s : 0.04);
    }
    v->last_s = time_s;
    v->grabbed++;
    return time_s;
}

static td_status video_grab(bool *got, bool *ended, double *time_s, void *state, double wait_s,
                            td_error *error)
{
    video *v = state;
    const double asked_s = td_monotonic_s();
    (void)wait_s;
    *ended = false;
    for (int i = 0; i < QUEUE; i++) {
        double told_s = NAN;
        *got = v->module->grab(v->handle, &told_s);
        if (!*got) break;
        *time_s = time_of(v, told_s);
        if (!v->camera || *time_s > asked_s - STALE_S) return TD_OK;
    }
    if (*got) return TD_OK;
    *ended = true;
    if (v->camera)
        return td_fail(error, TD_ERROR_IO, "%s: the camera gives no more pictures; is it still plugged in?",
                       v->path);
    if (v->grabbed == 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: the video has no picture that can be read", v->path);
    return TD_OK;
}

static td_status video_retrieve(td_image **image, char name[256], void *state, td_error *error)
{
    video *v = state;
    const unsigned char *data = NULL;
    size_t step = 0;
    int width = 0, height = 0;
    char reason[TD_VIDEO_REASON_SIZE] = "";
    *image = NULL;
    name[0] = 0;
    if (!v->module->retrieve(&data, &step, &width, &height, v->handle, v->channels, reason))
        return td_fail(error, TD_ERROR_FORMAT, "%s: picture %ld cannot be decoded%s%s", v->path,
                       v->grabbed - 1, *reason ? ": " : "", reason);
    TD_TRY(td_image_new(image, width, height, v->channels, error));
    const size_t row = (size_t)width * (size_t)v->channels;
    for (int y = 0; y < height; y++) memcpy((*image)->data + (size_t)y * row, data + (size_t)y * step, row);
    return TD_OK;
}

static void video_free(void *state)
{
    video *v = state;
    if (v->handle) v->module->close(v->handle);
    free(v->path);
    free(v);
}

static const td_source_driver video_driver = {video_grab, video_retrieve, video_free};

static td_status open_module(td_source *source, const char *path, bool camera, const td_source_options *o,
                             td_error *error)
{
    video *v = calloc(1, sizeof *v);
    if (!v) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a video", path);
    source->kind = camera ? TD_SOURCE_CAMERA : TD_SOURCE_VIDEO;
    source->driver = &video_driver;
    source->state = v;
    v->camera = camera;
    v->channels = o->channels;
    v->path = strdup(path);
    if (!v->path) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its name", path);
    TD_TRY(load(&v->module, path, error));
    char reason[TD_VIDEO_REASON_SIZE] = "";
    if (!v->module->open(&v->handle, &v->period_s, path, camera, o->width, o->height, reason)) {
        if (camera)
            return td_fail(error, TD_ERROR_IO,
                           "%s: cannot be opened as a camera; is another program using it?", path);
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: is not a video that can be read (mp4, avi, mkv, mov, webm)%s%s", path,
                       *reason ? ": " : "", reason);
    }
    source->period_s = v->period_s;
    return TD_OK;
}

td_status td_video_open(td_source *source, const char *path, const td_source_options *o, td_error *error)
{
    int fd = -1;
    TD_TRY(td_file_open(&fd, path, error));
    close(fd);
    return open_module(source, path, false, o, error);
}

td_status td_camera_open(td_source *source, const char *device, const td_source_options *o, td_error *error)
{
    TD_TRY(td_camera_device_check(device, error));
    return open_module(source, device, true, o, error);
}
