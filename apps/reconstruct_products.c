/* The colours of the frames, kept as the map grows, and the files that other tools open. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/reconstruct_internal.h"
#include "core/cloud.h"
#include "core/crs.h"
#include "core/file.h"
#include "core/mesh.h"

enum { UNSEEN = 160, MOST_VERTICES = 300000, MOST_TEXTURE = 4096, SPREAD = 6 };

/* ---- the orthophoto as it grows ---- */

static td_mosaic_options photo_options(const reconstruct_job *work)
{
    td_mosaic_options o = td_mosaic_options_default();
    o.cell_m = work->how->fusion.cell_m;
    o.texels = work->how->texels;
    return o;
}

td_status reconstruct_photo_begin(reconstruct_job *work, td_error *error)
{
    const td_mosaic_options o = photo_options(work);
    return work->how->texels ? td_mosaic_new(&work->mosaic, &o, error) : TD_OK;
}

td_status reconstruct_photo_add(reconstruct_job *work, const reconstruct_frame *f,
                                const td_fusion_frame *frame, td_error *error)
{
    td_image *raw = NULL, *left = NULL;
    td_error why = {0};
    double time_s;
    if (!work->mosaic || f->tally.cells == 0) return TD_OK;
    td_status status = reconstruct_image_read(&raw, &time_s, &work->coloured, f->image[0], 3, &why);
    if (status == TD_OK)
        status = td_depth_camera_rectify(&left, NULL, work->depth, raw, NULL, work->how->dense.threads, &why);
    if (status == TD_OK) status = td_mosaic_add(work->mosaic, work->fusion, frame, left, &why);
    td_image_free(&raw);
    td_image_free(&left);
    if (status == TD_ERROR_MEMORY && error) *error = why;
    if (status == TD_OK || status == TD_ERROR_MEMORY) return status;
    /* The map has the frame already: a picture without it is no reason to fail. */
    td_log_write(work->how->log, TD_LOG_WARNING, "reconstruct", "frame %s colours nothing: %s", f->name,
                 why.message);
    return TD_OK;
}

static char *photo_path(const reconstruct_job *work, int slot)
{
    char name[40];
    snprintf(name, sizeof name, "state/photo-%d.bin", slot);
    return td_path_join(work->how->output, name);
}

td_status reconstruct_photo_save(const reconstruct_job *work, int slot, size_t frames, td_error *error)
{
    if (!work->mosaic) return TD_OK;
    char *path = photo_path(work, slot);
    td_status status = path ? td_mosaic_save(work->mosaic, frames, path, error)
                            : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

td_status reconstruct_photo_load(reconstruct_job *work, int slot, size_t frames, td_error *error)
{
    const td_mosaic_options o = photo_options(work);
    if (!work->how->texels) return TD_OK;
    char *path = photo_path(work, slot);
    td_status status = path ? td_mosaic_load(&work->mosaic, &o, frames, path, error)
                            : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

/* ---- where on Earth ---- */

td_status reconstruct_crs(const reconstruct_job *work, const char *prior, td_error *error)
{
    char *asked = NULL, *known = NULL;
    if (!work->how->crs) return TD_OK;
    td_status status = td_crs_wkt(&asked, work->how->crs, error);
    if (status != TD_OK) status = td_error_prefix(error, status, "--crs");
    if (status == TD_OK && prior) status = td_crs_wkt(&known, prior, error);
    if (status == TD_OK && known && strcmp(asked, known) != 0)
        status = td_fail(error, TD_ERROR_DATA,
                         "--crs %s: the prior map is in %.60s: bring it to one system with gdalwarp -t_srs",
                         work->how->crs, prior);
    free(asked);
    free(known);
    return status;
}

static td_status set_crs(reconstruct_job *work, td_error *error)
{
    TD_TRY(reconstruct_crs(work, work->map->crs, error));
    if (!work->how->crs || work->map->crs) return TD_OK;
    work->map->crs = strdup(work->how->crs);
    return work->map->crs ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

/* ---- clouds ---- */

/* Mean colour of what was seen of the cell that is centred on (x, y); grey where nothing was. */
static void colour_of(uint8_t rgb[3], const td_orthophoto *photo, const td_elevation *map, int column,
                      int row)
{
    unsigned sum[3] = {0, 0, 0}, seen = 0;
    memset(rgb, UNSEEN, 3);
    if (!photo) return;
    const int n = (int)lround(map->cell_m / photo->texel_m);
    /* The photo begins at a cell's edge. */
    const int x0 =
        n * column - (int)lround((photo->origin[0] - map->origin[0]) / photo->texel_m + 0.5 * n - 0.5);
    const int y0 =
        n * row - (int)lround((photo->origin[1] - map->origin[1]) / photo->texel_m + 0.5 * n - 0.5);
    if (x0 < 0 || y0 < 0 || x0 + n > photo->columns || y0 + n > photo->rows) return;
    for (int y = y0; y < y0 + n; y++)
        for (int x = x0; x < x0 + n; x++) {
            const uint8_t *t = photo->rgba + 4 * ((size_t)y * (size_t)photo->columns + (size_t)x);
            if (!t[3]) continue;
            for (int k = 0; k < 3; k++) sum[k] += t[k];
            seen++;
        }
    for (int k = 0; seen && k < 3; k++) rgb[k] = (uint8_t)((sum[k] + seen / 2) / seen);
}

/* The cells as points. */
static td_status make_cloud(td_cloud **cloud, const reconstruct_job *work, td_error *error)
{
    const td_elevation *map = work->map;
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    size_t n = 0;
    for (size_t i = 0; i < cells; i++) n += isfinite(map->height[i]);
    TD_TRY(td_cloud_new(cloud, n, 0, error));
    n = 0;
    for (size_t i = 0; i < cells; i++) {
        if (!isfinite(map->height[i])) continue;
        const int column = (int)(i % (size_t)map->columns), row = (int)(i / (size_t)map->columns);
        td_cloud_point *p = &(*cloud)->point[n++];
        p->p[0] = map->origin[0] + column * map->cell_m;
        p->p[1] = map->origin[1] + row * map->cell_m;
        p->p[2] = (double)map->height[i];
        p->sigma = map->sigma[i];
        colour_of(p->rgb, work->photo, map, column, row);
    }
    return TD_OK;
}

static td_status write_clouds(const reconstruct_job *work, job *j)
{
    char *ply = job_path(j, "map.ply"), *las = job_path(j, "map.las"), *wkt = NULL;
    char comment[TD_NAME_SIZE + 40];
    td_cloud *cloud = NULL;
    snprintf(comment, sizeof comment, "frame %s, unit m", work->map->frame);
    td_status status = ply && las ? make_cloud(&cloud, work, &j->error) : TD_ERROR_MEMORY;
    if (status == TD_OK && work->map->crs) status = td_crs_wkt(&wkt, work->map->crs, &j->error);
    if (status == TD_OK) status = td_cloud_write_ply(cloud, ply, comment, &j->error);
    if (status == TD_OK) status = td_cloud_write_las(cloud, las, wkt, &j->error);
    td_cloud_free(&cloud);
    free(ply);
    free(las);
    free(wkt);
    return status;
}

/* ---- mesh ---- */

/* The photo's colours a few texels on over what was not seen, so that small gaps do not show as specks. */
static void spread(td_image *image, uint8_t *seen)
{
    const int w = image->width, h = image->height;
    for (int pass = 1; pass <= SPREAD; pass++)
        for (int y = 0; y < h; y++)
            for (int x = 0; x < w; x++) {
                const size_t at = (size_t)y * (size_t)w + (size_t)x;
                if (seen[at]) continue;
                const size_t near[4] = {at - 1, at + 1, at - (size_t)w, at + (size_t)w};
                const bool inside[4] = {x > 0, x + 1 < w, y > 0, y + 1 < h};
                unsigned sum[3] = {0, 0, 0}, count = 0;
                for (int k = 0; k < 4; k++) {
                    if (!inside[k] || !seen[near[k]] || seen[near[k]] > pass) continue;
                    for (size_t c = 0; c < 3; c++) sum[c] += image->data[3 * near[k] + c];
                    count++;
                }
                for (size_t c = 0; count && c < 3; c++) image->data[3 * at + c] = (uint8_t)(sum[c] / count);
                if (count) seen[at] = (uint8_t)(pass + 1);
            }
}

static td_status make_texture(td_image **image, const td_orthophoto *photo, td_error *error)
{
    if (!photo) {
        TD_TRY(td_image_new(image, 8, 8, 3, error));
        memset((*image)->data, UNSEEN, 8 * 8 * 3);
        return TD_OK;
    }
    const size_t n = (size_t)photo->columns * (size_t)photo->rows;
    uint8_t *seen = calloc(n, 1);
    td_status status = seen ? td_orthophoto_image(image, photo, UNSEEN, error)
                            : td_fail(error, TD_ERROR_MEMORY, "no memory for a texture");
    if (status == TD_OK) {
        for (int y = 0; y < photo->rows; y++)
            for (int x = 0; x < photo->columns; x++)
                seen[(size_t)(photo->rows - 1 - y) * (size_t)photo->columns + (size_t)x] =
                    photo->rgba[4 * ((size_t)y * (size_t)photo->columns + (size_t)x) + 3] > 0;
        spread(*image, seen);
    }
    free(seen);
    return status;
}

/* Halved until graphics cards take it; the sides follow, as an odd last column or row is left out. */
static td_status fit_texture(td_image **image, td_gltf_texture *t, double texel, td_error *error)
{
    while ((*image)->width > MOST_TEXTURE || (*image)->height > MOST_TEXTURE) {
        td_image *small = NULL;
        TD_TRY(td_image_shrink(&small, *image, 1, error));
        td_image_free(image);
        *image = small;
        texel *= 2;
        t->high[0] = t->low[0] + small->width * texel;
        t->low[1] = t->high[1] - small->height * texel;
    }
    t->image = *image;
    return TD_OK;
}

static td_gltf_texture place_texture(const reconstruct_job *work)
{
    const td_orthophoto *p = work->photo;
    td_gltf_texture t = {.frame = work->map->frame, .crs = work->map->crs, .high = {1, 1}};
    const int size[2] = {p ? p->columns : 0, p ? p->rows : 0};
    for (int k = 0; p && k < 2; k++) {
        t.low[k] = p->origin[k] - 0.5 * p->texel_m;
        t.high[k] = t.low[k] + size[k] * p->texel_m;
    }
    return t;
}

static td_status write_mesh(reconstruct_job *work, job *j)
{
    char *path = job_path(j, "map.glb");
    td_cloud *mesh = NULL;
    td_image *image = NULL;
    td_gltf_texture texture = place_texture(work);
    td_error none = {0};
    td_status status =
        path ? td_mesh_from_elevation(&mesh, work->map, MOST_VERTICES, &none) : TD_ERROR_MEMORY;
    if (status == TD_ERROR_DATA) { /* single cells: no surface, no mesh */
        free(path);
        return TD_OK;
    }
    if (status == TD_OK) status = make_texture(&image, work->photo, &j->error);
    if (status == TD_OK)
        status = fit_texture(&image, &texture, work->photo ? work->photo->texel_m : 1, &j->error);
    if (status == TD_OK) status = td_mesh_write_gltf(mesh, &texture, path, &j->error);
    work->has_mesh = status == TD_OK;
    td_image_free(&image);
    td_cloud_free(&mesh);
    free(path);
    return status;
}

/* ---- all ---- */

/* result.yaml comes last and goes first: a folder that has one holds the products that it tells of. */
static td_status forget_result(job *j)
{
    char *result = job_path(j, "result.yaml");
    if (result) unlink(result);
    td_status status = result ? TD_OK : TD_ERROR_MEMORY;
    free(result);
    return status;
}

td_status reconstruct_products(reconstruct_job *work, job *j)
{
    TD_TRY(set_crs(work, &j->error));
    TD_TRY(forget_result(j));
    if (work->mosaic) TD_TRY(td_mosaic_photo(&work->photo, work->mosaic, work->map, &j->error));
    char *map = job_path(j, "map.tif"), *photo = job_path(j, "orthophoto.tif");
    td_status status = map && photo ? td_elevation_write(work->map, map, &j->error) : TD_ERROR_MEMORY;
    if (status == TD_OK && work->photo) status = td_orthophoto_write(work->photo, photo, &j->error);
    if (status == TD_OK) status = write_clouds(work, j);
    if (status == TD_OK) status = write_mesh(work, j);
    free(map);
    free(photo);
    return status;
}

json_t *reconstruct_product_names(const reconstruct_job *work)
{
    json_t *o = json_pack("{s:s, s:s, s:s}", "map", "map.tif", "cloud", "map.ply", "las", "map.las");
    if (work->has_mesh) json_object_set_new(o, "mesh", json_string("map.glb"));
    if (work->photo) json_object_set_new(o, "orthophoto", json_string("orthophoto.tif"));
    json_object_set_new(o, "result", json_string("result.yaml"));
    json_object_set_new(o, "report", json_string("report.html"));
    json_object_set_new(o, "log", json_string("log.jsonl"));
    return o;
}
