#include "core/cloud.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/bytes_internal.h"
#include "core/file.h"
#include "core/text_internal.h"

enum { GREY = 128, VERTEX_BYTES = 3 * 8 + 3 + 4, FACE_BYTES = 1 + 3 * 4 };

td_status td_cloud_new(td_cloud **cloud, size_t count, size_t triangle_count, td_error *error)
{
    *cloud = NULL;
    if (count > UINT32_MAX || triangle_count > UINT32_MAX)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "a cloud of %zu points and %zu triangles: at most %u of each", count, triangle_count,
                       UINT32_MAX);
    td_cloud *made = calloc(1, sizeof *made);
    if (made) {
        made->count = count;
        made->triangle_count = triangle_count;
        made->point = calloc(count + 1, sizeof *made->point);
        made->triangle = calloc(triangle_count + 1, sizeof *made->triangle);
    }
    if (!made || !made->point || !made->triangle) {
        td_cloud_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a cloud of %zu points and %zu triangles", count,
                       triangle_count);
    }
    for (size_t i = 0; i < count; i++) {
        made->point[i].sigma = NAN;
        memset(made->point[i].rgb, GREY, sizeof made->point[i].rgb);
    }
    *cloud = made;
    return TD_OK;
}

void td_cloud_free(td_cloud **cloud)
{
    if (!cloud || !*cloud) return;
    free((*cloud)->point);
    free((*cloud)->triangle);
    free(*cloud);
    *cloud = NULL;
}

/* ---- writing ---- */

/* Each line of the comment on a line of its own, controls as '?': a header is read by lines. */
static void add_comment(td_text *header, const char *comment)
{
    while (comment && *comment) {
        const size_t length = strcspn(comment, "\n");
        td_text_format(header, "comment ");
        for (size_t i = 0; i < length; i++)
            td_text_add(header, (unsigned char)comment[i] < ' ' ? "?" : comment + i, 1);
        td_text_format(header, "\n");
        comment += length + (comment[length] == '\n');
    }
}

static void add_header(td_text *header, const td_cloud *cloud, const char *comment)
{
    td_text_format(header, "ply\nformat binary_little_endian 1.0\n");
    add_comment(header, comment);
    td_text_format(header,
                   "element vertex %zu\nproperty double x\nproperty double y\nproperty double z\n"
                   "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float sigma\n",
                   cloud->count);
    if (cloud->triangle_count)
        td_text_format(header, "element face %zu\nproperty list uchar uint vertex_indices\n",
                       cloud->triangle_count);
    td_text_format(header, "end_header\n");
}

td_status td_cloud_write_ply(const td_cloud *cloud, const char *path, const char *comment, td_error *error)
{
    td_text header = {0};
    add_header(&header, cloud, comment);
    const size_t size = header.size + cloud->count * VERTEX_BYTES + cloud->triangle_count * FACE_BYTES;
    unsigned char *bytes = header.failed ? NULL : malloc(size), *at = bytes;
    td_status status;
    if (bytes) {
        memcpy(at, header.data, header.size);
        at += header.size;
        for (size_t i = 0; i < cloud->count; i++) {
            const td_cloud_point *p = &cloud->point[i];
            for (int k = 0; k < 3; k++) td_put_double(&at, p->p[k]);
            for (int k = 0; k < 3; k++) td_put(&at, p->rgb[k], 1);
            td_put_float(&at, p->sigma);
        }
        for (size_t i = 0; i < cloud->triangle_count; i++) {
            td_put(&at, 3, 1);
            for (int k = 0; k < 3; k++) td_put(&at, cloud->triangle[i][k], 4);
        }
        status = td_file_write(path, bytes, size, error);
    } else {
        status = td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its %zu bytes", path, size);
    }
    free(bytes);
    free(header.data);
    return status;
}
