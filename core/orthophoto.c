#include "core/orthophoto.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/elevation_internal.h"
#include "core/text_internal.h"

enum { CHANNELS = 4 };

td_status td_orthophoto_new(td_orthophoto **photo, int columns, int rows, double texel_m,
                            const double origin[2], const char *frame, const char *crs, td_error *error)
{
    *photo = NULL;
    if (columns < 1 || rows < 1 || columns > TD_ORTHOPHOTO_MAX_TEXELS / rows)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "an orthophoto of %d x %d texels: must have 1 to %d; take larger texels or a smaller "
                       "area",
                       columns, rows, TD_ORTHOPHOTO_MAX_TEXELS);
    if (!(texel_m > 0 && isfinite(texel_m) && isfinite(origin[0]) && isfinite(origin[1])))
        return td_fail(error, TD_ERROR_ARGUMENT, "texels of %g m from (%g, %g): must be finite", texel_m,
                       origin[0], origin[1]);
    if (!td_name_is_plain(frame))
        return td_fail(error, TD_ERROR_ARGUMENT, "frame: must be a name of 1 to %d letters, digits, - and _",
                       TD_NAME_SIZE - 1);
    td_orthophoto *made = calloc(1, sizeof *made);
    if (made) {
        made->rgba = calloc((size_t)columns * (size_t)rows, CHANNELS);
        made->crs = crs ? strdup(crs) : NULL;
    }
    if (!made || !made->rgba || (crs && !made->crs)) {
        td_orthophoto_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for an orthophoto of %d x %d texels", columns,
                       rows);
    }
    made->columns = columns;
    made->rows = rows;
    made->texel_m = texel_m;
    memcpy(made->origin, origin, sizeof made->origin);
    strcpy(made->frame, frame);
    *photo = made;
    return TD_OK;
}

void td_orthophoto_free(td_orthophoto **photo)
{
    if (!photo || !*photo) return;
    free((*photo)->rgba);
    free((*photo)->crs);
    free(*photo);
    *photo = NULL;
}

static bool write_notes(const td_raster_module *module, void *raster, const void *photo)
{
    return module->set_note(raster, "TELEDIMOS_FRAME", ((const td_orthophoto *)photo)->frame);
}

static void fill_row(double *value, const void *data, int band, int y)
{
    const td_orthophoto *photo = data;
    const uint8_t *from = photo->rgba + (size_t)y * (size_t)photo->columns * CHANNELS + band;
    for (int x = 0; x < photo->columns; x++) value[x] = from[x * CHANNELS];
}

td_status td_orthophoto_write(const td_orthophoto *photo, const char *path, td_error *error)
{
    td_raster_info info = {
        .columns = photo->columns, .rows = photo->rows, .bands = CHANNELS, .rgba = true, .crs = photo->crs};
    td_raster_place(info.transform, photo->origin, photo->texel_m, photo->rows);
    return td_raster_write(path, &info, photo, write_notes, fill_row, error);
}

td_status td_orthophoto_image(td_image **image, const td_orthophoto *photo, uint8_t unseen, td_error *error)
{
    TD_TRY(td_image_new(image, photo->columns, photo->rows, 3, error));
    uint8_t *to = (*image)->data;
    for (int y = 0; y < photo->rows; y++) {
        const uint8_t *from = photo->rgba + (size_t)(photo->rows - 1 - y) * (size_t)photo->columns * CHANNELS;
        for (int x = 0; x < photo->columns; x++, from += CHANNELS, to += 3)
            for (int k = 0; k < 3; k++) to[k] = from[3] ? from[k] : unseen;
    }
    return TD_OK;
}
