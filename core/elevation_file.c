/* Elevation maps as GeoTIFF: what the bands mean. All bands are double, since a TIFF has one type for all and
 * a time in seconds or a count of 32 bits does not fit a float; heights are floats in them, which compress
 * well. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/elevation.h"
#include "core/elevation_internal.h"
#include "core/file.h"
#include "core/file_internal.h"
#include "core/number.h"
#include "core/text_internal.h"

enum band { HEIGHT, SIGMA, COUNT, PROVENANCE, TIME, BANDS };

static const struct {
    const char *name, *unit;
    double low, high; /* what may stand in it */
    bool whole;
} bands[BANDS] = {
    [HEIGHT] = {"height", "m", -1e9, 1e9, false},
    [SIGMA] = {"sigma", "m", 0, 1e9, false},
    [COUNT] = {"count", "", 0, UINT32_MAX, true},
    [PROVENANCE] = {"provenance", "", 0, TD_CELL_SIMULATED, true},
    [TIME] = {"time", "s", -INFINITY, INFINITY, false},
};

static const char *const origin_note[2] = {"TELEDIMOS_ORIGIN_X", "TELEDIMOS_ORIGIN_Y"};

static const double SQUARE = 1e-6; /* cells whose sides differ by a smaller share are square */

/* A cell's value in a band, and back. */
static double get(const td_elevation *map, enum band band, size_t cell)
{
    switch (band) {
    case HEIGHT:
        return (double)map->height[cell];
    case SIGMA:
        return (double)map->sigma[cell];
    case COUNT:
        return map->count[cell];
    case PROVENANCE:
        return map->provenance[cell];
    default:
        return map->time_s[cell];
    }
}

static void set(td_elevation *map, enum band band, size_t cell, double value)
{
    switch (band) {
    case HEIGHT:
        map->height[cell] = (float)value;
        break;
    case SIGMA:
        map->sigma[cell] = (float)value;
        break;
    case COUNT:
        map->count[cell] = isnan(value) ? 0 : (uint32_t)value;
        break;
    case PROVENANCE:
        map->provenance[cell] = isnan(value) ? TD_CELL_UNKNOWN : (uint8_t)value;
        break;
    default:
        map->time_s[cell] = value;
    }
}

/* ---- reading ---- */

typedef struct reading {
    const td_raster_module *module;
    void *raster;
    const char *path;
    td_raster_info info;
    int band[BANDS]; /* of the file; 0: not there */
    bool upward;     /* its first row is the southernmost */
} reading;

static td_status check_grid(const reading *r, td_error *error)
{
    const double *t = r->info.transform;
    if (!r->info.has_transform)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: does not say where its cells lie; give it a place with gdal_translate -a_ullr",
                       r->path);
    for (int i = 0; i < 6; i++)
        if (!isfinite(t[i]))
            return td_fail(error, TD_ERROR_FORMAT, "%s: the place of its cells is not finite", r->path);
    if (t[2] != 0 || t[4] != 0)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: its grid is rotated or sheared; bring it to north up with gdalwarp", r->path);
    if (!(t[1] > 0) || !(fabs(fabs(t[5]) - t[1]) <= SQUARE * t[1]))
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: its cells are %g x %g, but must be square; bring them to one size with gdalwarp -tr",
            r->path, t[1], -t[5]);
    if (r->info.degrees || fabs(r->info.unit_m - 1) > 1e-12)
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: its coordinates are in %s, but must be in metres; bring it to such a system (UTM) "
            "with gdalwarp -t_srs",
            r->path, r->info.degrees ? "degrees" : "another unit");
    if (r->info.columns > TD_ELEVATION_MAX_CELLS / r->info.rows)
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: has %d x %d cells, but at most %d are accepted; cut a part out with gdal_translate", r->path,
            r->info.columns, r->info.rows, TD_ELEVATION_MAX_CELLS);
    return TD_OK;
}

static td_status find_bands(reading *r, td_error *error)
{
    for (int b = 0; b < BANDS; b++) r->band[b] = r->module->find(r->raster, bands[b].name);
    if (r->band[HEIGHT]) return TD_OK;
    memset(r->band, 0, sizeof r->band);
    if (r->info.bands != 1)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: has %d bands, and none is described as 'height'; take the one out with "
                       "gdal_translate -b",
                       r->path, r->info.bands);
    r->band[HEIGHT] = 1;
    return TD_OK;
}

/* The origin to the last bit from our own note, unless the map was cut or moved since. */
static void place(double origin[2], const reading *r)
{
    const double *t = r->info.transform, cell = t[1];
    origin[0] = t[0] + 0.5 * cell;
    origin[1] = r->upward ? t[3] + 0.5 * cell : t[3] - (r->info.rows - 0.5) * cell;
    for (int i = 0; i < 2; i++) {
        const char *note = r->module->note(r->raster, origin_note[i]);
        double noted;
        if (note && td_number_real(&noted, note) && fabs(noted - origin[i]) < 1e-6 * cell) origin[i] = noted;
    }
}

static td_status read_band(td_elevation *map, double *row, const reading *r, enum band band, td_error *error)
{
    char reason[TD_RASTER_REASON_SIZE];
    for (int y = 0; y < map->rows; y++) {
        const size_t first = (size_t)(r->upward ? y : map->rows - 1 - y) * (size_t)map->columns;
        if (!r->module->read_row(row, r->raster, r->band[band], y, reason))
            return td_fail(error, TD_ERROR_FORMAT, "%s: is damaged: band %s, row %d cannot be read: %s",
                           r->path, bands[band].name, y, reason);
        for (int x = 0; x < map->columns; x++) {
            const double v = row[x];
            if (!isnan(v) &&
                (!(v >= bands[band].low && v <= bands[band].high) || (bands[band].whole && v != floor(v))))
                return td_fail(error, TD_ERROR_FORMAT, "%s: band %s, column %d, row %d: %g is none", r->path,
                               bands[band].name, x, y, v);
            set(map, band, first + (size_t)x, v);
        }
    }
    return TD_OK;
}

/* What a cell without a height says besides is nothing; a height without a word on where it comes from was
 * given. */
static void settle(td_elevation *map, const reading *r)
{
    const size_t n = (size_t)map->columns * (size_t)map->rows;
    for (size_t i = 0; i < n; i++) {
        if (isnan(map->height[i])) {
            map->sigma[i] = NAN;
            map->time_s[i] = NAN;
            map->count[i] = 0;
            map->provenance[i] = TD_CELL_UNKNOWN;
        } else if (!r->band[PROVENANCE]) {
            map->provenance[i] = TD_CELL_PRIOR;
        }
    }
}

static td_status read_open(td_elevation **map, reading *r, td_error *error)
{
    double origin[2];
    TD_TRY(check_grid(r, error));
    TD_TRY(find_bands(r, error));
    r->upward = r->info.transform[5] > 0;
    place(origin, r);
    const char *frame = r->module->note(r->raster, "TELEDIMOS_FRAME");
    td_status status = td_elevation_new(map, r->info.columns, r->info.rows, r->info.transform[1], origin,
                                        frame && td_name_is_plain(frame) ? frame
                                        : r->info.crs                    ? "world"
                                                                         : "site",
                                        error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s", r->path);
    double *row = malloc((size_t)r->info.columns * sizeof *row);
    if (r->info.crs) (*map)->crs = strdup(r->info.crs);
    if (!row || (r->info.crs && !(*map)->crs))
        status = td_fail(error, TD_ERROR_MEMORY, "%s: no memory for it", r->path);
    for (int b = 0; status == TD_OK && b < BANDS; b++)
        if (r->band[b]) status = read_band(*map, row, r, (enum band)b, error);
    free(row);
    if (status == TD_OK)
        settle(*map, r);
    else
        td_elevation_free(map);
    return status;
}

static td_status open_file(reading *r, const char *path, td_error *error)
{
    char reason[TD_RASTER_REASON_SIZE];
    int fd = -1;
    *r = (reading){.path = path};
    TD_TRY(td_file_open(&fd, path, error));
    close(fd);
    TD_TRY(td_raster_load(&r->module, path, error));
    if (!r->module->open(&r->raster, &r->info, path, reason))
        return td_fail(error, TD_ERROR_FORMAT, "%s: is not a GeoTIFF that can be read: %s", path, reason);
    return TD_OK;
}

td_status td_elevation_size(int *columns, int *rows, const char *path, td_error *error)
{
    reading r;
    TD_TRY(open_file(&r, path, error));
    *columns = r.info.columns;
    *rows = r.info.rows;
    r.module->close(r.raster);
    return TD_OK;
}

td_status td_elevation_read(td_elevation **map, const char *path, td_error *error)
{
    reading r;
    *map = NULL;
    TD_TRY(open_file(&r, path, error));
    td_status status = read_open(map, &r, error);
    r.module->close(r.raster);
    return status;
}

/* ---- writing ---- */

static bool write_notes(const td_raster_module *module, void *raster, const void *data)
{
    const td_elevation *map = data;
    char x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE];
    bool fine = module->set_note(raster, "TELEDIMOS_FRAME", map->frame) &&
                module->set_note(raster, origin_note[0], td_number_format(x, map->origin[0], 0)) &&
                module->set_note(raster, origin_note[1], td_number_format(y, map->origin[1], 0)) &&
                module->set_note(raster, "TELEDIMOS_PROVENANCE",
                                 "0 unknown, 1 prior, 2 measured, 3 fused, 4 filled, 5 simulated");
    for (int b = 0; fine && b < BANDS; b++)
        fine = module->set_band(raster, b + 1, bands[b].name, bands[b].unit);
    return fine;
}

static void fill_row(double *value, const void *data, int band, int y)
{
    const td_elevation *map = data;
    const size_t first = (size_t)y * (size_t)map->columns;
    for (int x = 0; x < map->columns; x++) value[x] = get(map, (enum band)band, first + (size_t)x);
}

td_status td_elevation_write(const td_elevation *map, const char *path, td_error *error)
{
    td_raster_info info = {.columns = map->columns, .rows = map->rows, .bands = BANDS, .crs = map->crs};
    td_raster_place(info.transform, map->origin, map->cell_m, map->rows);
    return td_raster_write(path, &info, map, write_notes, fill_row, error);
}
