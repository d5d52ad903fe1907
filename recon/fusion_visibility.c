/* What a frame looks through: a cell that stands where rays to points behind it pass.
 *
 * Not ray after ray through the cells, but cell after cell into the image: the point 3 sigma below the cell's
 * height is projected; where that pixel and its eight neighbours are matched and all lie behind it, by more
 * than 3 sigma of their disparity, the ray to what they see passes there. One wrong match cannot do it, nor
 * can an edge. */
#include <math.h>

#include "recon/fusion_internal.h"

static const double SURE = 3; /* sigma, of the height and of the disparity */

/* Pixel and disparity of a point of the site; false: not in the image or out of its depths. */
static bool project(int pixel[2], double *disparity, const td_frame_cells *c, const double p[3])
{
    const td_depth_camera *camera = c->frame->camera;
    const double *from = c->site_from_camera.t, way[3] = {p[0] - from[0], p[1] - from[1], p[2] - from[2]};
    double seen[3];
    for (int i = 0; i < 3; i++)
        seen[i] = c->to_site[i] * way[0] + c->to_site[3 + i] * way[1] + c->to_site[6 + i] * way[2];
    if (!(seen[2] >= camera->near_m && seen[2] <= camera->far_m)) return false;
    const double x = camera->cx + camera->f * seen[0] / seen[2],
                 y = camera->cy + camera->f * seen[1] / seen[2];
    const td_disparity *d = c->frame->disparity;
    if (!(x >= 1 && x <= d->width - 2 && y >= 1 && y <= d->height - 2)) return false;
    pixel[0] = (int)lrint(x);
    pixel[1] = (int)lrint(y);
    *disparity = camera->base_px_m / seen[2];
    return true;
}

static bool lies_behind(const td_disparity *d, const int pixel[2], double disparity)
{
    for (int y = pixel[1] - 1; y <= pixel[1] + 1; y++)
        for (int x = pixel[0] - 1; x <= pixel[0] + 1; x++) {
            const size_t i = (size_t)y * (size_t)d->width + (size_t)x;
            if (d->kind[i] != TD_DENSE_MATCHED) return false;
            if (!((double)d->value[i] + SURE * (double)d->sigma[i] < disparity)) return false;
        }
    return true;
}

static bool passes(const td_frame_cells *c, const td_cell *cell, double base, double x, double y)
{
    static const double up[3] = {0, 0, 1};
    const double height = base + (double)cell->now.height, sigma = td_cell_sigma(cell);
    int pixel[2];
    double p[3] = {x, y, height - SURE * sigma}, disparity;
    if (!project(pixel, &disparity, c, p) || !lies_behind(c->frame->disparity, pixel, disparity))
        return false;
    if (!c->frame->pose_covariance) return true;
    p[2] = height - SURE * sqrt(sigma * sigma + td_frame_pose_variance(c, p, up));
    return project(pixel, &disparity, c, p) && lies_behind(c->frame->disparity, pixel, disparity);
}

size_t td_frame_look_through(td_cell *cell, const td_tile *tile, const td_frame_tile *measured,
                             const td_frame_cells *frame)
{
    const td_fusion_options *o = &frame->fusion->options;
    size_t cleared = 0;
    for (int i = 0; i < TD_TILE_CELLS; i++) {
        if (cell[i].provenance == TD_CELL_UNKNOWN || (measured && measured->slot[i])) continue;
        const double x = (tile->x * TD_TILE_SIDE + i % TD_TILE_SIDE) * o->cell_m;
        const double y = (tile->y * TD_TILE_SIDE + i / TD_TILE_SIDE) * o->cell_m;
        if (passes(frame, &cell[i], tile->base, x, y)) cleared += td_cell_pass(&cell[i], o);
    }
    return cleared;
}
