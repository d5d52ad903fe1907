/* Where images come from, one after another: a folder that fills, a video file, a camera.
 *
 *   "folder:PATH" or a folder's path       images (PNG, JPEG, PGM, PPM) in the order of their names, numbers
 *                                          by their value (img2 before img10); waits for more
 *   "PATH/left*.png"                       only those whose names match (fnmatch)
 *   "PATH.mp4", .avi, .mkv, .mov, .webm    a video's frames
 *   "/dev/video0", "camera:0", "camera:NAME"   a camera
 *
 * Videos and cameras are read through OpenCV's videoio, in a module that is opened when asked for. */
#ifndef TELEDIMOS_CORE_SOURCE_H
#define TELEDIMOS_CORE_SOURCE_H

#include <stdbool.h>
#include <stddef.h>

#include "image.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_source td_source;

typedef enum td_source_kind { TD_SOURCE_FOLDER, TD_SOURCE_VIDEO, TD_SOURCE_CAMERA } td_source_kind;

typedef struct td_source_options {
    int channels;      /* 1 or 3; default 1 */
    int width, height; /* wished of a camera, px; 0: its own */
    double rate_hz; /* camera, video: the pictures nearest to this raster, the others are left out; 0: all */
    const char *pattern; /* folder: only names that match (fnmatch), e.g. "left*.png"; NULL: every image */
} td_source_options;

TD_API td_source_options td_source_options_default(void);

/* One image as it came. */
typedef struct td_frame {
    td_image *image; /* owned by the caller: td_image_free */
    double time_s;   /* folder: of the file's last change; video: from its start; camera: when grabbed, by the
                        monotonic clock */
    long number;     /* from 0, of those given out */
    char name[256];  /* the file's name, or "000123" */
} td_frame;

TD_API td_status td_source_open(td_source **source, const char *where, const td_source_options *options,
                                td_error *error);
TD_API void td_source_free(td_source **source);
TD_API td_source_kind td_source_kind_of(const td_source *source);
/* Between its pictures, s; 0: not known. */
TD_API double td_source_period_s(const td_source *source);

/* The next image, waiting up to wait_s for it. *got false with TD_OK: none came in that time (a folder may
 * still fill), or *ended: no more will (a video's end). A file that is still being written is waited for; one
 * that stays unreadable (no change for 2 s) is an error that names it, once, and then skipped: call again. A
 * camera that stalls may hold the call for 10 s. Pictures that waited in a camera's queue since before the
 * call are left out. After an error call again: what cannot go on (a camera that was unplugged, a folder that
 * is gone) has ended then. */
TD_API td_status td_source_next(td_frame *frame, bool *got, bool *ended, td_source *source, double wait_s,
                                td_error *error);

/* One from each of `count` sources of one kind, taken together: all are grabbed before any is decoded;
 * folders are paired by the last number in their names, or by order where they are not numbered alike (the
 * partner of an unreadable file is skipped with it), videos and cameras by time: one that is more than half
 * its period behind moves on. *skew_s: the largest difference of their times; NaN for folders. frame:
 * (count), all of them or none. */
TD_API td_status td_source_next_together(td_frame *frame, bool *got, bool *ended, double *skew_s,
                                         td_source *const *source, int count, double wait_s, td_error *error);

/* The cameras of this machine. */
typedef struct td_camera_device {
    char path[64];
    char name[64]; /* as the driver calls it */
    bool usable;   /* can be opened and captures */
    char why[128]; /* it is not usable; "": it is */
} td_camera_device;
/* How many there are, of which the first `capacity` are filled in. */
TD_API size_t td_camera_devices(td_camera_device *device, size_t capacity);

#ifdef __cplusplus
}
#endif
#endif
