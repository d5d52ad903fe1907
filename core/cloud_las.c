/* Clouds as LAS 1.4 R15 (ASPRS, 2019): a header, two variable-length records (what the extra dimension is,
 * where on Earth the cloud lies), points of format 7. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/bytes_internal.h"
#include "core/cloud.h"
#include "core/file.h"

enum {
    HEADER_BYTES = 375,
    VLR_HEAD_BYTES = 54,
    EXTRA_BYTES = 192, /* description of one extra dimension */
    POINT_BYTES = 36 + 4,
    POINT_FORMAT = 7,
    WKT_FLAG = 1 << 4, /* of the global encoding: formats 6 and above know WKT only */
    EXTRA_RECORD = 4,
    WKT_RECORD = 2112,
    EXTRA_FLOAT = 9,
    MOST_WKT = 65535
};
static const double FINEST_M = 1e-4;

/* How coordinates become whole numbers: x = offset + scale X. */
typedef struct grid {
    double scale[3], offset[3], low[3], high[3]; /* low, high: as they are read back */
} grid;

static td_status find_grid(grid *g, const td_cloud *cloud, const char *path, td_error *error)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < cloud->count; i++)
        for (int k = 0; k < 3; k++) {
            const double v = cloud->point[i].p[k];
            if (!isfinite(v))
                return td_fail(error, TD_ERROR_ARGUMENT,
                               "%s: point %zu is not finite, and LAS holds finite points only: leave it out",
                               path, i);
            low[k] = fmin(low[k], v);
            high[k] = fmax(high[k], v);
        }
    for (int k = 0; k < 3; k++) {
        const double half = cloud->count ? (high[k] - low[k]) / 2 : 0;
        g->offset[k] = cloud->count ? round(low[k] + half) : 0;
        /* A metre more for the rounded offset. */
        for (g->scale[k] = FINEST_M; half + 1 > g->scale[k] * INT32_MAX;) g->scale[k] *= 10;
    }
    return TD_OK;
}

static int32_t step_of(const grid *g, const td_cloud_point *p, int k)
{
    return (int32_t)lround((p->p[k] - g->offset[k]) / g->scale[k]);
}

static void find_bounds(grid *g, const td_cloud *cloud)
{
    for (int k = 0; k < 3; k++) {
        int32_t low = INT32_MAX, high = INT32_MIN;
        for (size_t i = 0; i < cloud->count; i++) {
            const int32_t v = step_of(g, &cloud->point[i], k);
            if (v < low) low = v;
            if (v > high) high = v;
        }
        g->low[k] = cloud->count ? g->offset[k] + g->scale[k] * low : 0;
        g->high[k] = cloud->count ? g->offset[k] + g->scale[k] * high : 0;
    }
}

/* `text` in a field of `size` bytes, zeros behind it. */
static void put_text(unsigned char **at, const char *text, size_t size)
{
    memset(*at, 0, size);
    memcpy(*at, text, strlen(text));
    *at += size;
}

static void put_header(unsigned char **at, const td_cloud *cloud, const grid *g, size_t body, int records)
{
    put_text(at, "LASF", 4);
    td_put(at, 0, 2); /* file source */
    td_put(at, WKT_FLAG, 2);
    put_text(at, "", 16); /* project */
    td_put(at, 1, 1);     /* version 1.4 */
    td_put(at, 4, 1);
    put_text(at, "Teledimos", 32); /* system */
    put_text(at, "Teledimos", 32); /* software */
    td_put(at, 0, 4);              /* day and year: not told */
    td_put(at, HEADER_BYTES, 2);
    td_put(at, body, 4);
    td_put(at, (uint64_t)records, 4);
    td_put(at, POINT_FORMAT, 1);
    td_put(at, POINT_BYTES, 2);
    put_text(at, "", 4 + 5 * 4); /* counts of old versions */
    for (int k = 0; k < 3; k++) td_put_double(at, g->scale[k]);
    for (int k = 0; k < 3; k++) td_put_double(at, g->offset[k]);
    for (int k = 0; k < 3; k++) {
        td_put_double(at, g->high[k]);
        td_put_double(at, g->low[k]);
    }
    put_text(at, "", 8 + 8 + 4); /* no waveforms, no extended records */
    td_put(at, cloud->count, 8);
    td_put(at, cloud->count, 8); /* all are first returns */
    put_text(at, "", 14 * 8);
}

static void put_record_head(unsigned char **at, const char *user, int record, size_t size, const char *text)
{
    td_put(at, 0, 2);
    put_text(at, user, 16);
    td_put(at, (uint64_t)record, 2);
    td_put(at, size, 2);
    put_text(at, text, 32);
}

static void put_extra(unsigned char **at)
{
    put_record_head(at, "LASF_Spec", EXTRA_RECORD, EXTRA_BYTES, "sigma of each point");
    td_put(at, 0, 2);
    td_put(at, EXTRA_FLOAT, 1);
    td_put(at, 0, 1); /* no nodata, bounds, scale or offset */
    put_text(at, "sigma", 32);
    put_text(at, "", 4 + 5 * 24);
    put_text(at, "standard deviation, m", 32);
}

static void put_point(unsigned char **at, const td_cloud_point *p, const grid *g)
{
    for (int k = 0; k < 3; k++) td_put(at, (uint32_t)step_of(g, p, k), 4);
    td_put(at, 0, 2);                                            /* intensity */
    td_put(at, 0x11, 1);                                         /* return 1 of 1 */
    put_text(at, "", 1 + 1 + 1 + 2 + 2 + 8);                     /* flags, class, user, angle, source, time */
    for (int k = 0; k < 3; k++) td_put(at, 257u * p->rgb[k], 2); /* 255 is 65535 */
    td_put_float(at, p->sigma);
}

td_status td_cloud_write_las(const td_cloud *cloud, const char *path, const char *wkt, td_error *error)
{
    grid g;
    const size_t text = wkt ? strlen(wkt) + 1 : 0;
    if (text > MOST_WKT)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: its coordinate reference system takes %zu bytes, LAS holds %d: name it by a code",
                       path, text, MOST_WKT);
    TD_TRY(find_grid(&g, cloud, path, error));
    find_bounds(&g, cloud);
    const size_t body = HEADER_BYTES + VLR_HEAD_BYTES + EXTRA_BYTES + (wkt ? VLR_HEAD_BYTES + text : 0);
    const size_t size = body + cloud->count * POINT_BYTES;
    unsigned char *bytes = malloc(size), *at = bytes;
    if (!bytes) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its %zu bytes", path, size);
    put_header(&at, cloud, &g, body, wkt ? 2 : 1);
    put_extra(&at);
    if (wkt) {
        put_record_head(&at, "LASF_Projection", WKT_RECORD, text, "OGC WKT");
        put_text(&at, wkt, text);
    }
    for (size_t i = 0; i < cloud->count; i++) put_point(&at, &cloud->point[i], &g);
    td_status status = td_file_write(path, bytes, size, error);
    free(bytes);
    return status;
}
