/* A run as a whole: the memory it will need, by how much the picture moves between the two cameras' times,
 * and what it came to. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "apps/reconstruct_team.h"
#include "core/cloud.h"

/* ---- memory ---- */

/* Rectangle of tiles, x_min, y_min, x_max, y_max, in tiles; min above max: nothing. */
typedef struct tile_box {
    long low[2], high[2];
} tile_box;

enum { TILE_SIDE = 128, MOST_COUNTED = 1 << 24 };
static const double MODULES = 64e6; /* GDAL, loaded when the map is written */

/* Bytes that Linux tells in a line "KEY: 1234 kB" of such a file; NaN: it does not. */
static double told_by(const char *path, const char *key)
{
    char line[200];
    double bytes = NAN;
    FILE *file = fopen(path, "r");
    while (file && !isfinite(bytes) && fgets(line, sizeof line, file))
        if (strncmp(line, key, strlen(key)) == 0) bytes = 1024 * strtod(line + strlen(key), NULL);
    if (file) fclose(file);
    return bytes;
}

/* Everything that the left camera may see from near_m to far_m lies between the eight corners of its view. */
static tile_box seen_by(const reconstruct_job *work, const reconstruct_frame *f)
{
    const td_camera *c = &td_depth_camera_rectification(work->depth)->camera;
    const td_pose rig_from_camera = td_depth_camera_pose(work->depth);
    const td_pose site_from_camera = td_pose_compose(&f->site_from_rig, &rig_from_camera);
    const double side = TILE_SIDE * work->how->fusion.cell_m, *region = work->how->fusion.region;
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int corner = 0; corner < 8; corner++) {
        const double depth = corner & 4 ? work->how->far_m : work->how->near_m;
        const double x = (corner & 1 ? c->width : 0) - c->parameter[2];
        const double y = (corner & 2 ? c->height : 0) - c->parameter[3];
        const double seen[3] = {x / c->parameter[0] * depth, y / c->parameter[1] * depth, depth};
        double p[3];
        td_pose_transform(p, &site_from_camera, seen);
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], p[k]);
            high[k] = fmax(high[k], p[k]);
        }
    }
    tile_box box;
    const bool whole = region[0] == region[2];
    for (int k = 0; k < 2; k++) {
        if (!whole) low[k] = fmax(low[k], region[k]);
        if (!whole) high[k] = fmin(high[k], region[2 + k]);
        box.low[k] = (long)floor(fmax(low[k] / side, -1e9));
        box.high[k] = (long)floor(fmin(high[k] / side, 1e9));
    }
    return box;
}

static double tiles_in(const tile_box *b)
{
    if (b->low[0] > b->high[0] || b->low[1] > b->high[1]) return 0;
    return (double)(b->high[0] - b->low[0] + 1) * (double)(b->high[1] - b->low[1] + 1);
}

static double mark(uint8_t *seen, const tile_box *all, const tile_box *b)
{
    double fresh = 0;
    const long columns = all->high[0] - all->low[0] + 1;
    for (long y = b->low[1]; y <= b->high[1]; y++)
        for (long x = b->low[0]; x <= b->high[0]; x++) {
            uint8_t *at = &seen[(y - all->low[1]) * columns + (x - all->low[0])];
            fresh += !*at;
            *at = 1;
        }
    return fresh;
}

/* Tiles that the frames may make, and those of the rectangle around them. A site too large to be counted tile
 * by tile: as if no two frames saw the same. */
static double count_tiles(double *around, const reconstruct_job *work)
{
    tile_box all = {{INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN}};
    double sum = 0, fresh = 0;
    for (size_t i = 0; i < work->count; i++) {
        if (work->frame[i].failed) continue;
        const tile_box b = seen_by(work, &work->frame[i]);
        if (tiles_in(&b) == 0) continue;
        sum += tiles_in(&b);
        for (int k = 0; k < 2; k++) {
            if (b.low[k] < all.low[k]) all.low[k] = b.low[k];
            if (b.high[k] > all.high[k]) all.high[k] = b.high[k];
        }
    }
    *around = tiles_in(&all);
    uint8_t *seen = *around > 0 && *around <= MOST_COUNTED ? calloc((size_t)*around, 1) : NULL;
    if (!seen) return fmin(sum, *around);
    for (size_t i = 0; i < work->count; i++) {
        if (work->frame[i].failed) continue;
        const tile_box b = seen_by(work, &work->frame[i]);
        if (tiles_in(&b) > 0) fresh += mark(seen, &all, &b);
    }
    free(seen);
    return fresh;
}

void reconstruct_memory_foresee(reconstruct_job *work)
{
    reconstruct_memory *m = &work->memory;
    const td_camera *c = &td_depth_camera_rectification(work->depth)->camera;
    const double pixels = (double)c->width * c->height, cells = (double)TILE_SIDE * TILE_SIDE;
    const double per_cell = 2 * sizeof(float) + sizeof(uint32_t) + 1 + sizeof(double);
    double around;
    /* Both images raw and rectified, the tables that rectify them, the mask; the points of the fusion. */
    const double images = pixels * (4 + 16 + 1);
    m->frame = images + fmax((double)td_dense_memory(c->width, c->height, &work->how->dense),
                             (double)td_fusion_frame_memory(c->width, c->height));
    const double tiles = count_tiles(&around, work);
    m->tiles = tiles * td_fusion_memory_of(TILE_SIDE, TILE_SIDE, 1);
    m->resident = fmin(m->tiles, (double)work->how->fusion.memory_bytes);
    m->products = MODULES + cells * (around * per_cell + tiles * (double)sizeof(td_cloud_point));
    m->program = told_by("/proc/self/status", "VmRSS:");
    const double available = told_by("/proc/meminfo", "MemAvailable:");
    const double all = m->program + m->frame + m->resident + m->products;
    td_log_write(
        work->how->log, TD_LOG_INFO, "reconstruct",
        "memory: at most %.0f MB: the program %.0f, a frame %.0f, the map %.0f of %.0f (the others in "
        "the folder), its products %.0f; each further process of a team: %.0f",
        all / 1e6, m->program / 1e6, m->frame / 1e6, m->resident / 1e6, m->tiles / 1e6, m->products / 1e6,
        (m->program + m->frame) / 1e6);
    if (all > available + m->program)
        td_log_write(
            work->how->log, TD_LOG_WARNING, "reconstruct",
            "memory: up to %.0f MB may be needed, %.0f MB are free: larger cells (--cell), a --region "
            "or a smaller --far need less",
            (all - m->program) / 1e6, available / 1e6);
    if (cells * around > TD_ELEVATION_MAX_CELLS)
        td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct",
                     "the map may come to %.0f million cells, a file holds %d million: take larger cells "
                     "(--cell), a --region or a smaller --far",
                     cells * around / 1e6, TD_ELEVATION_MAX_CELLS / 1000000);
}

/* ---- skew ---- */

/* Speed (m/s) and rate of turning (rad/s) between two frames; false: their times or poses do not tell. */
static bool motion(double *speed, double *rate, const reconstruct_frame *a, const reconstruct_frame *b)
{
    const double seconds = fabs(b->time_s - a->time_s);
    if (!(seconds > 0) || !*a->sha256 || !*b->sha256) return false;
    const td_pose back = td_pose_inverse(&a->site_from_rig);
    const td_pose moved = td_pose_compose(&back, &b->site_from_rig);
    *speed = td_pose_distance(&moved) / seconds;
    *rate = fabs(td_pose_angle(&moved)) / seconds;
    return true;
}

/* A picture taken later shows what is near_m away moved by f (v / near + w) times the delay: as an error of
 * disparity along the rows, as a fault of the epipolar lines across them. */
void reconstruct_skew(reconstruct_job *work)
{
    const double f = td_depth_camera_rectification(work->depth)->camera.parameter[0];
    for (size_t i = 0; i < work->count; i++) {
        reconstruct_frame *frame = &work->frame[i];
        double speed, rate;
        frame->skew_px = NAN;
        for (int k = 0; k < 2; k++) {
            if (k ? i + 1 == work->count : i == 0) continue;
            if (!motion(&speed, &rate, frame, &work->frame[k ? i + 1 : i - 1])) continue;
            const double moved = f * (speed / work->how->near_m + rate) * fabs(frame->skew_s);
            frame->skew_px = isnan(frame->skew_px) ? moved : fmax(frame->skew_px, moved);
        }
    }
}

/* ---- in the end ---- */

void reconstruct_summary(const reconstruct_job *work)
{
    const reconstruct_memory *m = &work->memory;
    size_t failed = 0;
    for (size_t i = 0; i < work->count; i++) failed += work->frame[i].failed;
    const size_t done = work->count - work->resumed;
    printf("\nframes: %zu in the map, %zu left out", work->count - failed, failed);
    if (work->resumed) printf("; %zu were taken over from an earlier run", work->resumed);
    printf("\ntime: %.1f s", work->seconds);
    if (done) printf(", %.2f s a frame", work->seconds / (double)done);
    if (team_size() > 1) printf(", by %d processes", team_size());
    printf("\nmemory: at most %.0f MB were foreseen, %.0f MB were used\n",
           (m->program + m->frame + m->resident + m->products) / 1e6,
           told_by("/proc/self/status", "VmHWM:") / 1e6);
}
