/* Where the images of a frame come from: files of their own, or the pictures of two videos. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/reconstruct_internal.h"
#include "core/source.h"

/* "left.mp4#120": length of the video's path and the picture's number, from 0. False: an ordinary file. */
static bool is_picture(size_t *length, long *number, const char *path)
{
    const char *mark = strrchr(path, '#');
    if (!mark || !mark[1] || strspn(mark + 1, "0123456789") != strlen(mark + 1) || strlen(mark + 1) > 9)
        return false;
    *length = (size_t)(mark - path);
    *number = strtol(mark + 1, NULL, 10);
    return access(path, F_OK) != 0;
}

void reconstruct_video_free(reconstruct_video *video)
{
    td_source_free(&video->source);
    free(video->path);
    free(video->hashed);
    *video = (reconstruct_video){0};
}

static bool is_open(const reconstruct_video *v, const char *path, size_t length)
{
    return v->source && strlen(v->path) == length && memcmp(v->path, path, length) == 0;
}

/* Videos can only be read from their beginning: one that is past the picture is opened anew. */
static td_status open_before(reconstruct_video *v, const char *path, size_t length, long number,
                             td_error *error)
{
    if (is_open(v, path, length) && v->next <= number) return TD_OK;
    td_source_free(&v->source);
    free(v->path);
    v->next = 0;
    v->path = strndup(path, length);
    if (!v->path) return td_fail(error, TD_ERROR_MEMORY, "no memory for the name of a video");
    return td_source_open(&v->source, v->path, NULL, error);
}

static td_status read_picture(td_image **image, double *time_s, reconstruct_video *v, const char *path,
                              size_t length, long number, int channels, td_error *error)
{
    TD_TRY(open_before(v, path, length, number, error));
    while (v->next <= number) {
        td_frame frame = {0};
        bool got = false, ended = false;
        TD_TRY(td_source_next(&frame, &got, &ended, v->source, channels, error));
        if (!got)
            return td_fail(error, TD_ERROR_DATA,
                           "%s has %ld pictures, so none of number %ld (they begin at 0)", v->path, v->next,
                           number);
        if (v->next++ < number)
            td_image_free(&frame.image);
        else
            *image = frame.image, *time_s = frame.time_s;
    }
    return TD_OK;
}

td_status reconstruct_image_read(td_image **image, double *time_s, reconstruct_video *video, const char *path,
                                 int channels, td_error *error)
{
    size_t length;
    long number;
    *image = NULL;
    *time_s = NAN;
    if (!is_picture(&length, &number, path)) return td_image_read(image, path, channels, error);
    td_status status = read_picture(image, time_s, video, path, length, number, channels, error);
    if (status != TD_OK) td_source_free(&video->source); /* so that the next frame begins anew */
    return status;
}

/* A video is read once for its hash, not once for each of its pictures. */
static td_status hash_video(reconstruct_video *v, const char *path, size_t length, td_error *error)
{
    if (v->hashed && strlen(v->hashed) == length && memcmp(v->hashed, path, length) == 0) return TD_OK;
    free(v->hashed);
    v->hashed = strndup(path, length);
    if (!v->hashed) return td_fail(error, TD_ERROR_MEMORY, "no memory for the name of a video");
    td_status status = td_hash_file(v->sha256, v->hashed, error);
    if (status == TD_OK) return TD_OK;
    free(v->hashed);
    v->hashed = NULL;
    return status;
}

td_status reconstruct_image_hash(char sha256[TD_HASH_HEX_SIZE], reconstruct_video *video, const char *path,
                                 td_error *error)
{
    size_t length;
    long number;
    char both[TD_HASH_HEX_SIZE + 16];
    if (!is_picture(&length, &number, path)) return td_hash_file(sha256, path, error);
    TD_TRY(hash_video(video, path, length, error));
    const int size = snprintf(both, sizeof both, "%s#%ld", video->sha256, number);
    return td_hash_bytes(sha256, both, (size_t)size, error);
}

td_status reconstruct_frame_hash(char sha256[TD_HASH_HEX_SIZE], reconstruct_job *work,
                                 const reconstruct_frame *frame, td_error *error)
{
    char sha[2][TD_HASH_HEX_SIZE];
    memset(sha, 0, sizeof sha);
    for (int side = 0; side < 2; side++)
        if (frame->image[side] &&
            reconstruct_image_hash(sha[side], &work->video[side], frame->image[side], NULL) != TD_OK)
            memset(sha[side], 0, sizeof sha[side]); /* it is missing: reading it says why */
    return td_hash_bytes(sha256, sha, sizeof sha, error);
}
