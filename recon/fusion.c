#include "recon/fusion.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "core/parallel.h"
#include "recon/fusion_internal.h"

enum { MOST_BELIEVE = 255, FARTHEST_CELL = 1 << 30 };
static const double SAME_TURN =
    0.35; /* rad: frames turned by less may be from one place: the ground looks the same */

/* ---- options ---- */

td_fusion_options td_fusion_options_default(void)
{
    return (td_fusion_options){.cell_m = 0.05,
                               .gate_sigma = 3,
                               .believe_frames = 3,
                               .correlation_px = 8,
                               .repeat_share = 0.5,
                               .elsewhere_share = 0.2,
                               .place_m = 0.3,
                               .memory_bytes = (size_t)1 << 30,
                               .frame = "site"};
}

static td_status check_region(const td_fusion_options *o, td_error *error)
{
    const double *r = o->region;
    if (r[0] == 0 && r[1] == 0 && r[2] == 0 && r[3] == 0) return TD_OK;
    for (int i = 0; i < 4; i++)
        if (!(fabs(r[i]) / o->cell_m < FARTHEST_CELL))
            return td_fail(error, TD_ERROR_ARGUMENT, "region: %g m is too far for cells of %g m", r[i],
                           o->cell_m);
    if (!(r[2] > r[0] && r[3] > r[1]))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "region: must be x_min, y_min, x_max, y_max, not %g, %g, %g, %g", r[0], r[1], r[2],
                       r[3]);
    return TD_OK;
}

/* As elevation maps ask of the names of their frames. */
static bool is_name(const char name[TD_NAME_SIZE])
{
    size_t n = 0;
    while (n < TD_NAME_SIZE && (isalnum((unsigned char)name[n]) || name[n] == '-' || name[n] == '_')) n++;
    return n > 0 && n < TD_NAME_SIZE && name[n] == 0;
}

td_status td_fusion_options_check(const td_fusion_options *o, td_error *error)
{
    const size_t tile = TD_TILE_CELLS * sizeof(td_cell);
    const struct {
        const char *name;
        double value, least, most;
    } number[] = {{"cell_m", o->cell_m, 1e-4, 1e4},
                  {"gate_sigma", o->gate_sigma, 0.1, 100},
                  {"believe_frames", o->believe_frames, 1, MOST_BELIEVE},
                  {"correlation_px", o->correlation_px, 1, 1000},
                  {"repeat_share", o->repeat_share, 0, 1},
                  {"elsewhere_share", o->elsewhere_share, 0, o->repeat_share},
                  {"place_m", o->place_m, 0, 1e6}};
    for (size_t i = 0; i < sizeof number / sizeof *number; i++)
        if (!(number[i].value >= number[i].least && number[i].value <= number[i].most))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: must be from %g to %g, not %g", number[i].name,
                           number[i].least, number[i].most, number[i].value);
    if (o->memory_bytes < tile)
        return td_fail(error, TD_ERROR_ARGUMENT, "memory_bytes: one tile takes %zu, not %zu", tile,
                       o->memory_bytes);
    if (!is_name(o->frame))
        return td_fail(error, TD_ERROR_ARGUMENT, "frame: must be a name of 1 to %d letters, digits, - and _",
                       TD_NAME_SIZE - 1);
    return check_region(o, error);
}

/* ---- made and freed ---- */

/* Cells whose centres lie in the region. */
static void set_bounds(int32_t bounds[4], const td_fusion_options *o)
{
    const bool all = o->region[0] == o->region[2];
    for (int i = 0; i < 2; i++) {
        bounds[2 * i] = all ? -FARTHEST_CELL : (int32_t)ceil(o->region[i] / o->cell_m - 1e-6);
        bounds[2 * i + 1] = all ? FARTHEST_CELL : (int32_t)floor(o->region[2 + i] / o->cell_m + 1e-6);
    }
}

td_status td_fusion_new(td_fusion **fusion, const td_fusion_options *options, td_error *error)
{
    const td_fusion_options standard = td_fusion_options_default();
    if (!options) options = &standard;
    *fusion = NULL;
    TD_TRY(td_fusion_options_check(options, error));
    if (options->folder) TD_TRY(td_folder_make(options->folder, error));
    td_fusion *f = calloc(1, sizeof *f);
    if (f) {
        f->options = *options;
        f->options.folder = options->folder ? strdup(options->folder) : NULL;
        f->capacity = options->memory_bytes / (TD_TILE_CELLS * sizeof(td_cell));
        set_bounds(f->bounds, options);
    }
    if (!f || (options->folder && !f->options.folder)) {
        td_fusion_free(&f);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    }
    *fusion = f;
    return TD_OK;
}

void td_fusion_free(td_fusion **fusion)
{
    if (!fusion || !*fusion) return;
    td_tiles_free(*fusion);
    free((void *)(uintptr_t)(*fusion)->options.folder);
    free((*fusion)->crs);
    free(*fusion);
    *fusion = NULL;
}

size_t td_fusion_memory(const td_fusion *fusion)
{
    return fusion->resident * TD_TILE_CELLS * sizeof(td_cell);
}

double td_fusion_memory_of(double width_m, double length_m, double cell_m)
{
    const double side = TD_TILE_SIDE * cell_m;
    return ceil(width_m / side) * ceil(length_m / side) * TD_TILE_CELLS * (double)sizeof(td_cell);
}

/* ---- a frame ---- */

static td_status check_covariance(const double *s, td_error *error)
{
    for (int i = 0; s && i < 36; i++)
        if (!isfinite(s[i]) ||
            fabs(s[i] - s[i % 6 * 6 + i / 6]) > 1e-9 * sqrt(fabs(s[i / 6 * 7] * s[i % 6 * 7])))
            return td_fail(error, TD_ERROR_DATA,
                           "pose_covariance: is not a symmetric matrix of finite numbers");
    for (int i = 0; s && i < 6; i++)
        if (s[7 * i] < 0)
            return td_fail(error, TD_ERROR_DATA, "pose_covariance: variance %d is negative: %g", i, s[7 * i]);
    return TD_OK;
}

static td_status check_frame(const td_fusion *f, const td_fusion_frame *frame, td_error *error)
{
    const td_camera *image = &frame->camera->rectification.camera;
    const td_disparity *d = frame->disparity;
    double norm = 0;
    if (d->width != image->width || d->height != image->height)
        return td_fail(
            error, TD_ERROR_DATA,
            "the disparities are %dx%d px, the rectified image is %dx%d: match the rectified images",
            d->width, d->height, image->width, image->height);
    for (int i = 0; i < 4; i++) norm += frame->site_from_rig.q[i] * frame->site_from_rig.q[i];
    if (!(fabs(norm - 1) < 1e-6))
        return td_fail(error, TD_ERROR_DATA, "site_from_rig: its quaternion has length %g, not 1",
                       sqrt(norm));
    for (int i = 0; i < 3; i++)
        if (!((fabs(frame->site_from_rig.t[i]) + 2 * frame->camera->far_m) / f->options.cell_m <
              FARTHEST_CELL))
            return td_fail(error, TD_ERROR_DATA,
                           "site_from_rig: its position (%g, %g, %g) m is no place for cells of %g m",
                           frame->site_from_rig.t[0], frame->site_from_rig.t[1], frame->site_from_rig.t[2],
                           f->options.cell_m);
    if (isinf(frame->time_s)) return td_fail(error, TD_ERROR_DATA, "time_s: is infinite");
    return check_covariance(frame->pose_covariance, error);
}

/* The number of the place that the frame was taken from: the last one's, or a new one. */
static uint32_t place_of(const td_fusion *f, const td_pose *site_from_camera)
{
    const td_pose back = td_pose_inverse(&f->place_pose), moved = td_pose_compose(&back, site_from_camera);
    const bool same = f->place > 0 && td_pose_distance(&moved) < f->options.place_m &&
                      fabs(td_pose_angle(&moved)) < SAME_TURN;
    return same ? f->place : f->place + 1;
}

static td_frame_cells begin(const td_fusion *f, const td_fusion_frame *frame)
{
    td_frame_cells c = {.fusion = f, .frame = frame, .threads = f->options.threads};
    c.site_from_camera = td_pose_compose(&frame->site_from_rig, &frame->camera->rig_from_rectified);
    const td_pose rig_from_site = td_pose_inverse(&frame->site_from_rig);
    td_pose_rotation(c.to_site, &c.site_from_camera);
    td_pose_rotation(c.rig_from_site, &rig_from_site);
    c.place = place_of(f, &c.site_from_camera);
    return c;
}

/* A tile that the frame concerns. */
typedef struct concern {
    td_tile *tile;
    const td_frame_tile *measured; /* NULL: only looked at */
    td_fusion_tally tally;
} concern;

typedef struct work {
    const td_frame_cells *frame;
    concern *concern; /* (count), a batch after another */
    size_t first;
} work;

/* How far the frame's points lie from the cells they have become part of. */
static void add_residuals(concern *c, const td_frame_cells *frame)
{
    const td_frame_tile *m = c->measured;
    const double up = frame->site_from_camera.t[2] - c->tile->base;
    for (const td_frame_run *run = m->run; run < m->run + m->runs; run++)
        for (const td_frame_point *p = run->point; p < run->point + run->count; p++) {
            const td_cell *cell = &c->tile->cell[p->cell];
            const td_frame_cell *seen = &m->cell[m->slot[p->cell] - 1];
            const td_measure *measured = &m->measure[m->slot[p->cell] - 1];
            if (measured->count == 0 || measured->in_part) continue;
            c->tally.points++;
            if (cell->rival_frames > 0) continue;
            const double off = up + (double)p->z - seen->slope[0] * (double)p->x -
                               seen->slope[1] * (double)p->y - (double)cell->now.height;
            c->tally.believed++;
            c->tally.square_m2 += off * off;
        }
}

static void apply_tile(size_t index, void *user)
{
    const work *w = user;
    concern *c = &w->concern[w->first + index];
    const td_fusion_options *o = &w->frame->fusion->options;
    for (size_t i = 0; c->measured && i < c->measured->cells; i++) {
        td_measure m = c->measured->measure[i];
        if (m.count == 0) continue;
        m.height -= c->tile->base;
        const td_cell_outcome outcome = td_cell_measure(&c->tile->cell[c->measured->cell[i].cell], &m, o);
        if (outcome == TD_CELL_IGNORED) continue;
        c->tally.cells++;
        c->tally.new_cells += outcome == TD_CELL_NEW;
        c->tally.gated += outcome == TD_CELL_GATED;
        c->tally.reset += outcome == TD_CELL_RESET;
    }
    if (c->measured) add_residuals(c, w->frame);
    c->tally.cleared += td_frame_look_through(c->tile->cell, c->tile, c->measured, w->frame);
}

static const td_frame_tile *measured_in(const td_frame_cells *c, int32_t x, int32_t y)
{
    if (!c->at || x < c->box[0] || x > c->box[1] || y < c->box[2] || y > c->box[3]) return NULL;
    const int32_t at =
        c->at[(size_t)(y - c->box[2]) * (size_t)(c->box[1] - c->box[0] + 1) + (size_t)(x - c->box[0])];
    return at < 0 ? NULL : &c->tile[at];
}

static bool in_map(const td_fusion *f, const td_frame_tile *tile)
{
    const int32_t x = tile->x * TD_TILE_SIDE, y = tile->y * TD_TILE_SIDE, *b = f->bounds;
    return x + TD_TILE_SIDE > b[0] && x <= b[1] && y + TD_TILE_SIDE > b[2] && y <= b[3];
}

/* New tiles for what is measured; then all between the camera and the points. */
static td_status gather(concern *list, size_t *count, td_fusion *f, const td_frame_cells *c, td_error *error)
{
    const double side = TD_TILE_SIDE * f->options.cell_m;
    int32_t box[4] = {c->box[0], c->box[1], c->box[2], c->box[3]};
    for (size_t i = 0; i < c->tile_count; i++) {
        td_tile *tile;
        if (!in_map(f, &c->tile[i])) continue;
        const double base = round(c->tile[i].measure[0].height);
        TD_TRY(td_tiles_make(&tile, f, c->tile[i].x, c->tile[i].y, base, error));
    }
    for (int i = 0; i < 2; i++) {
        const int32_t at = (int32_t)floor((c->site_from_camera.t[i] + f->options.cell_m / 2) / side);
        if (at < box[2 * i]) box[2 * i] = at;
        if (at > box[2 * i + 1]) box[2 * i + 1] = at;
    }
    *count = 0;
    for (size_t i = 0; i < f->tile_count; i++) {
        td_tile *t = f->tile[i];
        if (t->x < box[0] || t->x > box[1] || t->y < box[2] || t->y > box[3]) continue;
        list[(*count)++] = (concern){.tile = t, .measured = measured_in(c, t->x, t->y)};
    }
    return TD_OK;
}

/* So many tiles at a time as may be in memory. */
static td_status apply(td_fusion *f, const td_frame_cells *c, concern *list, size_t count, td_error *error)
{
    td_tile **batch = malloc((count + 1) * sizeof(td_tile *));
    if (!batch) return td_fail(error, TD_ERROR_MEMORY, "no memory for a list of %zu tiles", count);
    td_status status = TD_OK;
    for (size_t first = 0; status == TD_OK && first < count; first += f->capacity) {
        const size_t n = count - first < f->capacity ? count - first : f->capacity;
        for (size_t i = 0; i < n; i++) batch[i] = list[first + i].tile;
        status = td_tiles_fetch(f, batch, n, error);
        work w = {c, list, first};
        if (status == TD_OK) td_parallel_for(n, c->threads, apply_tile, &w, NULL, NULL);
    }
    free(batch);
    return status;
}

static td_status add(td_fusion *f, td_frame_cells *c, td_fusion_tally *tally, td_error *error)
{
    size_t fresh = 0, count;
    TD_TRY(td_frame_sort(c, error));
    if (c->point_count) {
        TD_TRY(td_frame_measure(c, error));
        for (size_t i = 0; i < c->tile_count; i++)
            fresh += in_map(f, &c->tile[i]) && !td_tiles_find(f, c->tile[i].x, c->tile[i].y);
        TD_TRY(td_tiles_check_room(f, fresh, error));
        concern *list = malloc((f->tile_count + fresh + 1) * sizeof *list);
        if (!list) return td_fail(error, TD_ERROR_MEMORY, "no memory for a list of tiles");
        td_status status = gather(list, &count, f, c, error);
        if (status == TD_OK) status = apply(f, c, list, count, error);
        for (size_t i = 0; status == TD_OK && i < count; i++) {
            tally->points += list[i].tally.points;
            tally->cells += list[i].tally.cells;
            tally->new_cells += list[i].tally.new_cells;
            tally->gated += list[i].tally.gated;
            tally->reset += list[i].tally.reset;
            tally->cleared += list[i].tally.cleared;
            tally->believed += list[i].tally.believed;
            tally->square_m2 += list[i].tally.square_m2;
        }
        free(list);
        TD_TRY(status);
    }
    if (c->place != f->place) f->place_pose = c->site_from_camera;
    f->place = c->place;
    f->frames++;
    return TD_OK;
}

td_status td_fusion_add(td_fusion *fusion, const td_fusion_frame *frame, td_fusion_tally *tally,
                        td_error *error)
{
    td_fusion_tally counted = {0};
    TD_TRY(check_frame(fusion, frame, error));
    td_frame_cells cells = begin(fusion, frame);
    td_status status = add(fusion, &cells, &counted, error);
    td_frame_free(&cells);
    if (tally) *tally = counted;
    return status;
}
