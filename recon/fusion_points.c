/* A frame's disparities as points, and which of them lie in which tile: runs of points that follow one
 * another, listed by tile in the order of the pixels, which is the same at any thread count. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/fusion_internal.h"

enum { MOST_BOX = 1 << 20 };
/* Half a window: nearer than that to the image's border a window is cut off. */
enum { BORDER = 4 };
/* px. Ground beyond the farthest disparity is given that one or a little more, for there is nothing smaller.
 */
static const double FAR_END = 1;
/* Of its sigma, which a disparity keeps where those around lie closer to a plane than it says. */
static const double CALM = 0.85;
static const double MOST_RELIEF = 1; /* px: larger steps are fusion_edge.c's */

typedef struct placed_run {
    int32_t x, y; /* its tile */
    size_t first, count;
} placed_run;

typedef struct strip {
    td_frame_point *point; /* one a pixel at most */
    size_t count;
    placed_run *run;
    size_t runs, room;
    int32_t box[4]; /* tiles */
    size_t *next;   /* (box of all) where its next run of a tile goes */
    bool failed;
} strip;

typedef struct sorter {
    td_frame_cells *cells;
    strip strip[TD_FRAME_STRIPS];
} sorter;

static int32_t tile_of(int32_t cell)
{
    return cell >= 0 ? cell / TD_TILE_SIDE : -((TD_TILE_SIDE - 1 - cell) / TD_TILE_SIDE);
}

/* The largest and the smallest of two numbers, without a call. */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

static double smaller(double a, double b)
{
    return a < b ? a : b;
}

static int32_t floor_of(double u)
{
    const int32_t whole = (int32_t)u;
    return whole - (u < whole);
}

static void rows_of(int *first, int *end, int index, int height)
{
    *first = (int)((long)height * index / TD_FRAME_STRIPS);
    *end = (int)((long)height * (index + 1) / TD_FRAME_STRIPS);
}

static void widen(int32_t box[4], int32_t x, int32_t y)
{
    if (x < box[0]) box[0] = x;
    if (x > box[1]) box[1] = x;
    if (y < box[2]) box[2] = y;
    if (y > box[3]) box[3] = y;
}

/* What of the frame does not change from pixel to pixel. */
typedef struct optics {
    double cell_m, per_cell, base, near_d, far_d; /* disparities of the nearest and farthest depth */
    const double *origin;                         /* m, of the camera */
    double right[3];                              /* of the ray by a pixel to the right */
    int32_t bounds[4];                            /* of the map, and a cell more to each side */
} optics;

static optics optics_of(const td_frame_cells *c)
{
    const int32_t *b = c->fusion->bounds;
    const td_depth_camera *camera = c->frame->camera;
    optics o = {.cell_m = c->fusion->options.cell_m,
                .per_cell = 1 / c->fusion->options.cell_m,
                .base = camera->base_px_m,
                .near_d = camera->base_px_m / camera->near_m,
                .far_d = camera->base_px_m / camera->far_m + FAR_END,
                .origin = c->site_from_camera.t,
                .bounds = {b[0] - 1, b[1] + 1, b[2] - 1, b[3] + 1}};
    for (int i = 0; i < 3; i++) o.right[i] = c->to_site[3 * i] / camera->f;
    return o;
}

/* The strip's points go on in the tile (x, y). */
static bool begin_run(strip *part, int32_t x, int32_t y)
{
    if (part->runs == part->room) {
        const size_t room = part->room ? 2 * part->room : 256;
        placed_run *more = realloc(part->run, room * sizeof *more);
        if (!more) return false;
        part->run = more;
        part->room = room;
    }
    part->run[part->runs++] = (placed_run){x, y, part->count, 0};
    widen(part->box, x, y);
    return true;
}

static bool place_row(strip *part, const td_frame_cells *c, const optics *o, int row)
{
    const td_depth_camera *camera = c->frame->camera;
    const td_disparity *disparity = c->frame->disparity;
    const size_t width = (size_t)disparity->width, first = (size_t)row * width;
    const double start[2] = {-camera->cx / camera->f, (row - camera->cy) / camera->f};
    const float *relief =
        c->relief + (size_t)(row / TD_RELIEF_BLOCK) * ((width + TD_RELIEF_BLOCK - 1) / TD_RELIEF_BLOCK);
    int32_t tile[2] = {INT32_MAX, INT32_MAX}; /* first cell of the run's */
    double ray[3];
    for (int i = 0; i < 3; i++)
        ray[i] = c->to_site[3 * i] * start[0] + c->to_site[3 * i + 1] * start[1] + c->to_site[3 * i + 2];
    if (row < BORDER || row >= disparity->height - BORDER || disparity->width <= 2 * BORDER) return true;
    for (size_t column = BORDER; column < width - BORDER; column++) {
        const double d = (double)disparity->value[first + column];
        const double told = (double)disparity->sigma[first + column];
        if (disparity->kind[first + column] != TD_DENSE_MATCHED || !(d >= o->far_d && d <= o->near_d) ||
            !(told > 0))
            continue;
        const double depth = o->base / d, u = (double)column;
        const double x = o->origin[0] + depth * (ray[0] + u * o->right[0]);
        const double y = o->origin[1] + depth * (ray[1] + u * o->right[1]);
        const int32_t cx = floor_of(x * o->per_cell + 0.5), cy = floor_of(y * o->per_cell + 0.5);
        if (cx < o->bounds[0] || cx > o->bounds[1] || cy < o->bounds[2] || cy > o->bounds[3]) continue;
        if (tile[0] > cx || cx - tile[0] >= TD_TILE_SIDE || tile[1] > cy || cy - tile[1] >= TD_TILE_SIDE) {
            const int32_t tx = tile_of(cx), ty = tile_of(cy);
            if (!begin_run(part, tx, ty)) return false;
            tile[0] = tx * TD_TILE_SIDE;
            tile[1] = ty * TD_TILE_SIDE;
        }
        const double around = (double)relief[column / TD_RELIEF_BLOCK], held = smaller(around, MOST_RELIEF);
        const double sigma = smaller(told, larger(around, CALM * told));
        const double precision = d / (depth * sigma); /* 1 / standard deviation of the depth */
        const double by_edge = (double)c->edge[first + column];
        const double edge = by_edge * by_edge + larger(0, held * held - told * told), px = depth / d;
        part->point[part->count++] =
            (td_frame_point){(float)(x - cx * o->cell_m),
                             (float)(y - cy * o->cell_m),
                             (float)(depth * (ray[2] + u * o->right[2])),
                             (float)(precision * precision),
                             (float)(edge * px * px),
                             (uint32_t)((cy - tile[1]) * TD_TILE_SIDE + cx - tile[0])};
        part->run[part->runs - 1].count++;
    }
    return true;
}

static void place_strip(size_t index, void *user)
{
    sorter *s = user;
    strip *part = &s->strip[index];
    const optics o = optics_of(s->cells);
    int first, end;
    rows_of(&first, &end, (int)index, s->cells->frame->disparity->height);
    for (int row = first; row < end && !part->failed; row++)
        part->failed = !place_row(part, s->cells, &o, row);
}

static size_t box_index(const int32_t box[4], int32_t x, int32_t y)
{
    return (size_t)(y - box[2]) * (size_t)(box[1] - box[0] + 1) + (size_t)(x - box[0]);
}

/* Tiles in the box's order, and where each strip's runs of each begin. */
static bool lay_out(sorter *s, size_t box_size)
{
    td_frame_cells *c = s->cells;
    const size_t columns = (size_t)(c->box[1] - c->box[0] + 1);
    size_t tiles = 0, sum = 0;
    for (size_t i = 0; i < box_size; i++) {
        bool any = false;
        for (int k = 0; k < TD_FRAME_STRIPS; k++) any |= s->strip[k].next[i] > 0;
        c->at[i] = any ? (int32_t)tiles++ : -1;
    }
    c->tile = calloc(tiles, sizeof *c->tile);
    if (!c->tile) return false;
    c->tile_count = tiles;
    for (size_t i = 0; i < box_size; i++) {
        if (c->at[i] < 0) continue;
        td_frame_tile *tile = &c->tile[c->at[i]];
        tile->x = c->box[0] + (int32_t)(i % columns);
        tile->y = c->box[2] + (int32_t)(i / columns);
        tile->run = c->run + sum;
        for (int k = 0; k < TD_FRAME_STRIPS; k++) {
            const size_t here = s->strip[k].next[i];
            s->strip[k].next[i] = sum;
            sum += here;
        }
        tile->runs = (size_t)(c->run + sum - tile->run);
    }
    return true;
}

static void list_runs(sorter *s)
{
    td_frame_cells *c = s->cells;
    for (int k = 0; k < TD_FRAME_STRIPS; k++) {
        strip *part = &s->strip[k];
        for (size_t i = 0; i < part->runs; i++) {
            const placed_run *r = &part->run[i];
            const size_t at = box_index(c->box, r->x, r->y);
            c->run[part->next[at]++] = (td_frame_run){part->point + r->first, r->count};
            c->tile[c->at[at]].points += r->count;
        }
    }
}

static td_status place(sorter *s, td_error *error)
{
    td_frame_cells *c = s->cells;
    const td_disparity *d = c->frame->disparity;
    bool fine = true;
    for (int k = 0; k < TD_FRAME_STRIPS; k++) {
        strip *part = &s->strip[k];
        int first, end;
        rows_of(&first, &end, k, d->height);
        memcpy(part->box, (int32_t[4]){INT32_MAX, INT32_MIN, INT32_MAX, INT32_MIN}, sizeof part->box);
        c->point[k] = part->point =
            malloc(((size_t)(end - first) * (size_t)d->width + 1) * sizeof *part->point);
        fine &= part->point != NULL;
    }
    if (fine) td_parallel_for(TD_FRAME_STRIPS, c->threads, place_strip, s, NULL, NULL);
    for (int k = 0; k < TD_FRAME_STRIPS; k++) fine &= !s->strip[k].failed;
    return fine ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the points of a frame");
}

static td_status sort(sorter *s, td_error *error)
{
    td_frame_cells *c = s->cells;
    size_t runs = 0;
    TD_TRY(place(s, error));
    memcpy(c->box, s->strip[0].box, sizeof c->box);
    for (int k = 0; k < TD_FRAME_STRIPS; k++) {
        c->point_count += s->strip[k].count;
        runs += s->strip[k].runs;
        if (!s->strip[k].count) continue;
        widen(c->box, s->strip[k].box[0], s->strip[k].box[2]);
        widen(c->box, s->strip[k].box[1], s->strip[k].box[3]);
    }
    if (!c->point_count) return TD_OK;
    const double size = ((double)c->box[1] - c->box[0] + 1) * ((double)c->box[3] - c->box[2] + 1);
    if (size > MOST_BOX)
        return td_fail(
            error, TD_ERROR_DATA,
            "the frame's points spread over %.0f tiles of %d x %d cells: take larger cells, a region "
            "or a nearer far_m",
            size, TD_TILE_SIDE, TD_TILE_SIDE);
    const size_t n = (size_t)size;
    c->at = malloc(n * sizeof *c->at);
    c->run = malloc(runs * sizeof *c->run);
    bool fine = c->at && c->run;
    for (int k = 0; k < TD_FRAME_STRIPS; k++) {
        strip *part = &s->strip[k];
        fine &= (part->next = calloc(n, sizeof *part->next)) != NULL;
        for (size_t i = 0; fine && i < part->runs; i++)
            part->next[box_index(c->box, part->run[i].x, part->run[i].y)]++;
    }
    fine = fine && lay_out(s, n);
    if (!fine)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the %zu points of a frame", c->point_count);
    list_runs(s);
    return TD_OK;
}

td_status td_frame_sort(td_frame_cells *cells, td_error *error)
{
    sorter s = {.cells = cells};
    td_status status = td_frame_edges(&cells->edge, cells->frame->disparity, cells->threads, error);
    if (status == TD_OK)
        status = td_frame_relief(&cells->relief, cells->frame->disparity, cells->threads, error);
    if (status == TD_OK) status = sort(&s, error);
    for (int k = 0; k < TD_FRAME_STRIPS; k++) {
        free(s.strip[k].run);
        free(s.strip[k].next);
    }
    free(cells->edge);
    free(cells->relief);
    cells->edge = cells->relief = NULL;
    return status;
}

size_t td_fusion_frame_memory(int width, int height)
{
    /* A pixel may be a run, and a cell, of its own; edges and relief are gone when cells are made. */
    const size_t sorting = 2 * sizeof(placed_run) + 2 * sizeof(float);
    const size_t cells = sizeof(td_frame_cell) + sizeof(td_measure);
    const size_t most = sorting > cells ? sorting : cells;
    return (size_t)width * (size_t)height * (sizeof(td_frame_point) + sizeof(td_frame_run) + most);
}

void td_frame_free(td_frame_cells *c)
{
    for (size_t i = 0; i < c->tile_count; i++) {
        free(c->tile[i].cell);
        free(c->tile[i].slot);
        free(c->tile[i].measure);
    }
    free(c->tile);
    for (int k = 0; k < TD_FRAME_STRIPS; k++) free(c->point[k]);
    free(c->at);
    free(c->run);
}
