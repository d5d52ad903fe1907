/* A frame's colours into the mosaic. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/depth_points_internal.h"
#include "recon/mosaic_internal.h"

enum { MOST_BOX = 1 << 20 };
static const float JOINED_PX = 1; /* neighbours' disparities that differ by less are one surface */
static const double AGREES_SIGMA = 3;

/* A pixel on the ground. */
typedef struct spot {
    float u, v;   /* texels from the camera's, edges at whole numbers; u NaN: none */
    float height; /* m */
    float pixel;  /* m, as td_texel's */
} spot;

typedef struct adding {
    td_mosaic *mosaic;
    const td_fusion_frame *frame;
    const td_image *left;
    td_elevation *map; /* around the frame */
    int64_t texel[2];  /* that the camera stands above */
    int64_t cell[2];   /* first of the map */
    spot *spot;        /* (height,width) */
    int32_t box[4];    /* tiles: first and last in x and in y */
    td_texel **tile;   /* (box) NULL: not asked for yet */
    bool failed;       /* out of memory */
} adding;

bool td_mosaic_agrees(double height, const td_elevation *map, size_t cell)
{
    const double sigma = isfinite(map->sigma[cell]) ? (double)map->sigma[cell] : 0;
    return fabs(height - (double)map->height[cell]) <= map->cell_m + AGREES_SIGMA * sigma;
}

static int64_t floor_divide(int64_t a, int64_t b)
{
    return a >= 0 ? a / b : -((b - 1 - a) / b);
}

/* ---- pixels to spots ---- */

static void place_row(adding *a, const td_pose *site_from_camera, const double turn[9], int row,
                      double box[4])
{
    const td_depth_camera *c = a->frame->camera;
    const td_disparity *d = a->frame->disparity;
    const double per_m = a->mosaic->texels / a->mosaic->options.cell_m, half = 0.5 * a->mosaic->texels;
    for (int column = 0; column < d->width; column++) {
        const size_t i = (size_t)row * (size_t)d->width + (size_t)column;
        const double depth = c->base_px_m / (double)d->value[i];
        spot *s = &a->spot[i];
        s->u = NAN;
        if (d->kind[i] != TD_DENSE_MATCHED || !(depth >= c->near_m && depth <= c->far_m)) continue;
        const double ray[3] = {(column - c->cx) / c->f, (row - c->cy) / c->f, 1};
        double way[3];
        for (int k = 0; k < 3; k++)
            way[k] = depth * (turn[3 * k] * ray[0] + turn[3 * k + 1] * ray[1] + turn[3 * k + 2]);
        const double x = site_from_camera->t[0] + way[0], y = site_from_camera->t[1] + way[1];
        const double square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
        s->u = (float)(x * per_m + half - (double)a->texel[0]);
        s->v = (float)(y * per_m + half - (double)a->texel[1]);
        s->height = (float)(site_from_camera->t[2] + way[2]);
        /* depth/f across, 1/sin of the ray's elevation longer along it */
        s->pixel = (float)fmin(depth / c->f * sqrt(square) / fmax(fabs(way[2]), 1e-9), 1e6);
        box[0] = fmin(box[0], x), box[1] = fmax(box[1], x);
        box[2] = fmin(box[2], y), box[3] = fmax(box[3], y);
    }
}

/* False: the frame has no pixel with a depth. */
static bool place(adding *a, double box[4])
{
    const td_pose pose = td_pose_compose(&a->frame->site_from_rig, &a->frame->camera->rig_from_rectified);
    double turn[9];
    td_pose_rotation(turn, &pose);
    for (int k = 0; k < 2; k++) {
        a->texel[k] = (int64_t)floor(pose.t[k] / a->mosaic->options.cell_m) * a->mosaic->texels;
        box[2 * k] = INFINITY;
        box[2 * k + 1] = -INFINITY;
    }
    for (int row = 0; row < a->frame->disparity->height; row++) place_row(a, &pose, turn, row, box);
    return box[0] <= box[1];
}

/* ---- texels under a triangle ---- */

/* The texel's slot, and where its cell is in the map; NULL: no cell, or no memory. */
static td_texel *slot_of(adding *a, int64_t x, int64_t y, size_t *cell)
{
    const int64_t column = floor_divide(x, a->mosaic->texels) - a->cell[0],
                  row = floor_divide(y, a->mosaic->texels) - a->cell[1];
    if (column < 0 || row < 0 || column >= a->map->columns || row >= a->map->rows) return NULL;
    *cell = (size_t)row * (size_t)a->map->columns + (size_t)column;
    if (!isfinite(a->map->height[*cell])) return NULL;
    const int32_t tx = (int32_t)floor_divide(x, TD_MOSAIC_SIDE),
                  ty = (int32_t)floor_divide(y, TD_MOSAIC_SIDE);
    td_texel **tile =
        &a->tile[(size_t)(ty - a->box[2]) * (size_t)(a->box[1] - a->box[0] + 1) + (size_t)(tx - a->box[0])];
    if (!*tile && !(*tile = td_mosaic_tile_at(a->mosaic, tx, ty))) {
        a->failed = true;
        return NULL;
    }
    return *tile + (y - (int64_t)ty * TD_MOSAIC_SIDE) * TD_MOSAIC_SIDE + (x - (int64_t)tx * TD_MOSAIC_SIDE);
}

/* `weight` of three pixels at a texel's centre. */
static void colour(adding *a, int64_t x, int64_t y, const size_t pixel[3], const float weight[3])
{
    float height = 0, size = 0;
    for (int k = 0; k < 3; k++) {
        height += weight[k] * a->spot[pixel[k]].height;
        size += weight[k] * a->spot[pixel[k]].pixel;
    }
    size_t cell;
    td_texel *t = slot_of(a, x, y, &cell);
    if (!t || !td_mosaic_agrees((double)height, a->map, cell)) return;
    if (t->seen && t->pixel <= size && td_mosaic_agrees((double)t->height, a->map, cell)) return;
    *t = (td_texel){.height = height, .pixel = size, .seen = 1};
    const size_t channels = (size_t)a->left->channels;
    for (size_t c = 0; c < 3; c++) {
        float value = 0.5f;
        for (int k = 0; k < 3; k++)
            value += weight[k] * (float)a->left->data[pixel[k] * channels + (channels == 3 ? c : 0)];
        t->rgb[c] = (uint8_t)fminf(fmaxf(value, 0), 255);
    }
}

static int floor_of(float u)
{
    const int whole = (int)u;
    return whole - (u < (float)whole);
}

/* First and last texel whose centre (a whole number and a half) lies between the three. */
static void span(int *first, int *last, float a, float b, float c)
{
    float low = a < b ? a : b, high = a < b ? b : a;
    if (c < low) low = c;
    if (c > high) high = c;
    *first = floor_of(low + 0.5f);
    *last = floor_of(high - 0.5f);
}

static void triangle(adding *a, size_t p, size_t q, size_t r)
{
    const size_t pixel[3] = {p, q, r};
    const spot *s0 = &a->spot[p], *s1 = &a->spot[q], *s2 = &a->spot[r];
    const float *d = a->frame->disparity->value;
    if (isnan(s0->u) || isnan(s1->u) || isnan(s2->u)) return;
    if (fabsf(d[p] - d[q]) >= JOINED_PX || fabsf(d[q] - d[r]) >= JOINED_PX || fabsf(d[r] - d[p]) >= JOINED_PX)
        return;
    int left, right, bottom, top;
    span(&left, &right, s0->u, s1->u, s2->u);
    span(&bottom, &top, s0->v, s1->v, s2->v);
    if (left > right || bottom > top) return;
    const float u1 = s1->u - s0->u, v1 = s1->v - s0->v, u2 = s2->u - s0->u, v2 = s2->v - s0->v;
    const float area = u1 * v2 - u2 * v1, per_area = 1 / area;
    if (area == 0) return;
    for (int y = bottom; y <= top; y++)
        for (int x = left; x <= right; x++) {
            const float u = (float)x + 0.5f - s0->u, v = (float)y + 0.5f - s0->v;
            const float one = (u * v2 - u2 * v) * per_area, two = (u1 * v - u * v1) * per_area;
            const float weight[3] = {1 - one - two, one, two};
            if (weight[0] >= 0 && one >= 0 && two >= 0)
                colour(a, a->texel[0] + x, a->texel[1] + y, pixel, weight);
        }
}

static void paint(adding *a)
{
    const size_t width = (size_t)a->frame->disparity->width;
    for (size_t row = 0; row + 1 < (size_t)a->frame->disparity->height; row++)
        for (size_t column = 0; column + 1 < width; column++) {
            const size_t i = row * width + column;
            triangle(a, i, i + 1, i + width + 1);
            triangle(a, i, i + width + 1, i + width);
        }
}

/* ---- a frame ---- */

/* Tiles that the map's cells may touch. */
static td_status make_box(adding *a, td_error *error)
{
    const int64_t n = a->mosaic->texels;
    const int count[2] = {a->map->columns, a->map->rows};
    double size = 1;
    for (int k = 0; k < 2; k++) {
        a->cell[k] = (int64_t)llround(a->map->origin[k] / a->map->cell_m);
        a->box[2 * k] = (int32_t)floor_divide(a->cell[k] * n, TD_MOSAIC_SIDE);
        a->box[2 * k + 1] = (int32_t)floor_divide((a->cell[k] + count[k]) * n - 1, TD_MOSAIC_SIDE);
        size *= (double)a->box[2 * k + 1] - a->box[2 * k] + 1;
    }
    if (size > MOST_BOX)
        return td_fail(error, TD_ERROR_DATA,
                       "the frame's colours spread over %.0f tiles of %d x %d texels: take fewer texels, a "
                       "region or a nearer far_m",
                       size, TD_MOSAIC_SIDE, TD_MOSAIC_SIDE);
    a->tile = calloc((size_t)size, sizeof(td_texel *));
    return a->tile ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a frame's colours");
}

static td_status check(const td_fusion_frame *frame, const td_image *left, td_error *error)
{
    if (left->width != frame->disparity->width || left->height != frame->disparity->height)
        return td_fail(error, TD_ERROR_DATA,
                       "the left image is %dx%d px, its disparities %dx%d: give the rectified one",
                       left->width, left->height, frame->disparity->width, frame->disparity->height);
    return TD_OK;
}

td_status td_mosaic_add(td_mosaic *mosaic, const td_fusion *fusion, const td_fusion_frame *frame,
                        const td_image *left, td_error *error)
{
    adding a = {.mosaic = mosaic, .frame = frame, .left = left};
    double box[4];
    TD_TRY(check(frame, left, error));
    a.spot = malloc((size_t)left->width * (size_t)left->height * sizeof *a.spot);
    if (!a.spot) return td_fail(error, TD_ERROR_MEMORY, "no memory for a frame's colours");
    td_status status = TD_OK;
    if (place(&a, box)) {
        const double region[4] = {box[0], box[2], box[1], box[3]};
        status = td_fusion_map_of(&a.map, NULL, fusion, region, error);
        if (status == TD_OK) status = make_box(&a, error);
        if (status == TD_OK) paint(&a);
        if (a.failed) status = td_fail(error, TD_ERROR_MEMORY, "no memory for an orthophoto");
    }
    free(a.spot);
    free(a.tile);
    td_elevation_free(&a.map);
    while (status == TD_OK && mosaic->texels > 1 &&
           mosaic->count * TD_MOSAIC_TEXELS * sizeof(td_texel) > mosaic->options.memory_bytes)
        status = td_mosaic_halve(mosaic, error);
    return status;
}
