/* The cameras of this machine, by Video4Linux: listing, finding and telling what is wrong with one. */
#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <linux/videodev2.h>

#include "core/source_internal.h"

static const char DEVICES[] = "/dev", NO_PERMISSION[] = "no permission: add yourself to the group video "
                                                        "(sudo usermod -aG video $USER) and log in again";

enum { MAX_DEVICES = 64, LIST_SIZE = 600 };

/* The driver's answer to VIDIOC_QUERYCAP. A camera has several devices: pictures come from one, the others
 * hold only data about them. */
static void query(td_camera_device *device)
{
    struct v4l2_capability seen = {0};
    const int fd = open(device->path, O_RDWR | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) {
        snprintf(device->why, sizeof device->why, "%s",
                 errno == EACCES || errno == EPERM ? NO_PERMISSION
                 : errno == EBUSY                  ? "another program is using it"
                                                   : strerror(errno));
        return;
    }
    int answer;
    do answer = ioctl(fd, VIDIOC_QUERYCAP, &seen);
    while (answer < 0 && errno == EINTR);
    close(fd);
    if (answer < 0) {
        snprintf(device->why, sizeof device->why, "is no Video4Linux device");
        return;
    }
    snprintf(device->name, sizeof device->name, "%.*s", (int)sizeof seen.card, (const char *)seen.card);
    const unsigned can = seen.capabilities & V4L2_CAP_DEVICE_CAPS ? seen.device_caps : seen.capabilities;
    if (!(can & (V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE)))
        snprintf(device->why, sizeof device->why, "gives no pictures, only data about them");
    else if (!(can & V4L2_CAP_STREAMING))
        snprintf(device->why, sizeof device->why, "cannot stream");
    else
        device->usable = true;
}

static int by_path(const void *a, const void *b)
{
    const td_camera_device *x = a, *y = b;
    return td_natural_compare(x->path, y->path);
}

static bool is_device_name(const char *name)
{
    if (strncmp(name, "video", 5) != 0 || !name[5] || strlen(name) > 12) return false;
    for (name += 5; *name; name++)
        if (!isdigit((unsigned char)*name)) return false;
    return true;
}

size_t td_camera_devices_in(td_camera_device *device, size_t capacity, const char *folder)
{
    td_camera_device all[MAX_DEVICES];
    size_t count = 0;
    DIR *stream = opendir(folder);
    for (struct dirent *entry; stream && count < MAX_DEVICES && (entry = readdir(stream));) {
        if (!is_device_name(entry->d_name)) continue;
        td_camera_device *d = all + count;
        *d = (td_camera_device){0};
        const int length = snprintf(d->path, sizeof d->path, "%s/%s", folder, entry->d_name);
        if (length > 0 && length < (int)sizeof d->path) count++;
    }
    if (stream) closedir(stream);
    qsort(all, count, sizeof *all, by_path);
    for (size_t i = 0; i < count; i++) query(all + i);
    for (size_t i = 0; i < count && i < capacity; i++) device[i] = all[i];
    return count;
}

size_t td_camera_devices(td_camera_device *device, size_t capacity)
{
    return td_camera_devices_in(device, capacity, DEVICES);
}

/* "; this machine has no camera" or "; the cameras are /dev/video0 (Name), …". */
static void list_cameras(char list[LIST_SIZE])
{
    td_camera_device device[MAX_DEVICES];
    size_t count = td_camera_devices(device, MAX_DEVICES), used = 0;
    list[0] = 0;
    for (size_t i = 0; i < count && i < MAX_DEVICES && used < LIST_SIZE; i++) {
        if (!device[i].usable) continue;
        used += (size_t)snprintf(list + used, LIST_SIZE - used, "%s%s (%s)",
                                 used ? ", " : "this machine's cameras are ", device[i].path, device[i].name);
    }
    if (!used) snprintf(list, LIST_SIZE, "this machine has no camera that can be used; is it plugged in?");
}

static bool contains(const char *text, const char *part)
{
    const size_t length = strlen(part);
    for (; *text; text++) {
        size_t n = 0;
        while (n < length && tolower((unsigned char)text[n]) == tolower((unsigned char)part[n])) n++;
        if (n == length) return true;
    }
    return false;
}

td_status td_camera_find(char path[64], const char *name, td_error *error)
{
    td_camera_device device[MAX_DEVICES];
    char list[LIST_SIZE];
    size_t digits = strspn(name, "0123456789"), found = 0;
    if (!*name) return td_fail(error, TD_ERROR_ARGUMENT, "camera: needs a number or a name, as camera:0");
    if (digits == strlen(name) && digits < 6) {
        snprintf(path, 64, "/dev/video%s", name);
        return TD_OK;
    }
    if (name[0] == '/') {
        if (snprintf(path, 64, "%s", name) < 64) return TD_OK;
        return td_fail(error, TD_ERROR_NOT_FOUND, "%s: is no camera: the path is too long", name);
    }
    size_t count = td_camera_devices(device, MAX_DEVICES);
    for (size_t i = 0; i < count && i < MAX_DEVICES; i++) {
        if (!device[i].usable || !contains(device[i].name, name)) continue;
        if (found++ == 0) snprintf(path, 64, "%s", device[i].path);
    }
    list_cameras(list);
    if (found == 0) return td_fail(error, TD_ERROR_NOT_FOUND, "camera:%s: there is none; %s", name, list);
    if (found > 1)
        return td_fail(error, TD_ERROR_NOT_FOUND,
                       "camera:%s: %zu cameras have this in their name; give the path: %s", name, found,
                       list);
    return TD_OK;
}

td_status td_camera_device_check(const char *path, td_error *error)
{
    td_camera_device device = {0};
    struct stat seen;
    if (stat(path, &seen) != 0) {
        char list[LIST_SIZE];
        const int cause = errno;
        list_cameras(list);
        return td_fail(error, cause == ENOENT ? TD_ERROR_NOT_FOUND : TD_ERROR_IO, "%s: %s; %s", path,
                       cause == ENOENT ? "there is no such device" : strerror(cause), list);
    }
    snprintf(device.path, sizeof device.path, "%s", path);
    query(&device);
    if (device.usable) return TD_OK;
    return td_fail(error, TD_ERROR_IO, "%s: cannot be used as a camera: %s", path, device.why);
}
