/* What source.c, its kinds of sources and the module behind OpenCV's videoio share. */
#ifndef TELEDIMOS_CORE_SOURCE_INTERNAL_H
#define TELEDIMOS_CORE_SOURCE_INTERNAL_H

#include "core/source.h"

/* One kind of source. A picture is first grabbed, which fixes its time, and then retrieved, which may take
 * time: so two cameras can be grabbed together. */
typedef struct td_source_driver {
    /* Waits up to wait_s. *got false: none came; *ended: none will. *time_s as in td_frame. Called again
     * without a retrieve, the grabbed picture is dropped. */
    td_status (*grab)(bool *got, bool *ended, double *time_s, void *state, double wait_s, td_error *error);
    /* The image of the last grab, and the file's name ("": none). */
    td_status (*retrieve)(td_image **image, char name[256], void *state, td_error *error);
    void (*free)(void *state);
} td_source_driver;

struct td_source {
    td_source_kind kind;
    const td_source_driver *driver;
    void *state;
    char *where;
    double rate_hz;  /* 0: every picture */
    double period_s; /* between its pictures; 0: not known */
    double due_s;    /* pictures before this time are left out; NaN: the first has not come yet */
    bool grabbed;    /* a picture is held for the next call */
    bool ended;
    double time_s; /* of the held picture */
    long number;   /* of the next */
    long owed;     /* pictures to drop: their partners could not be read */
};

/* Natural order: as strcmp, but runs of digits by their value ("img2" before "img10"); equal values by the
 * whole text. */
int td_natural_compare(const char *a, const char *b);
/* Seconds of the clock that only goes forward, and a pause that a signal may cut short. */
double td_monotonic_s(void);
void td_pause_s(double seconds);
/* True when the name ends as an image's does. */
bool td_is_image_name(const char *name);

/* Fill driver, state and kind. */
td_status td_folder_open(td_source *source, const char *folder, const char *pattern, int channels,
                         td_error *error);
/* Puts files that belong together at the heads of their folders' queues: those whose last numbers are equal;
 * where names are not numbered alike, by order, once that has been so for 2 s. *aligned false: their partners
 * have not come yet. */
td_status td_folders_align(bool *aligned, td_source *const *source, int count, td_error *error);
td_status td_video_open(td_source *source, const char *path, const td_source_options *options,
                        td_error *error);
td_status td_camera_open(td_source *source, const char *device, const td_source_options *options,
                         td_error *error);
/* The device behind what stands after "camera:": a number, a path or a name. */
td_status td_camera_find(char path[64], const char *name, td_error *error);
/* Fails with what is wrong with the device, and what to do. */
td_status td_camera_device_check(const char *path, td_error *error);
/* td_camera_devices, for another folder than /dev. */
size_t td_camera_devices_in(td_camera_device *device, size_t capacity, const char *folder);

/* The module: what it needs of OpenCV's videoio, whose 200 libraries take 0.2 s to load. It is opened when
 * asked for and stays, since GStreamer and others cannot be unloaded. Reasons are texts of the module. */
#define TD_VIDEO_MODULE "libteledimos_core_video.so"
#define TD_VIDEO_FUNCTION "td_video_module_get"

enum { TD_VIDEO_REASON_SIZE = 256 };

typedef struct td_video_module {
    /* width, height 0: its own. *period_s 0: not known. */
    bool (*open)(void **video, double *period_s, const char *path, bool camera, int width, int height,
                 char reason[TD_VIDEO_REASON_SIZE]);
    /* False: there is none (end of the file, a camera that stalls). *time_s: of the picture by the file or
     * the driver; NaN: not told. */
    bool (*grab)(void *video, double *time_s);
    /* Lent until the next call: `channels` bytes a pixel, rows `step` bytes apart, red first. */
    bool (*retrieve)(const unsigned char **data, size_t *step, int *width, int *height, void *video,
                     int channels, char reason[TD_VIDEO_REASON_SIZE]);
    void (*close)(void *video);
} td_video_module;

typedef const td_video_module *td_video_module_get_function(void);

#endif
