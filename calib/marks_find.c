/* Steps one and two together: all marks of an image, each once. */
#include <math.h>
#include <stdlib.h>

#include "calib/marks_internal.h"

static const double PI = 3.14159265358979323846;

/* A window that is smaller than a mark and one that is larger both find it. */
static bool same(const double *centre, double area, const td_blob *blob, double distance, double ratio)
{
    double dx = centre[0] - blob->centroid[0], dy = centre[1] - blob->centroid[1];
    return hypot(dx, dy) < distance && area < ratio * blob->area && blob->area < ratio * area;
}

static double mark_area(const td_mark *mark)
{
    return PI / sqrt(mark->shape[0] * mark->shape[2] - mark->shape[1] * mark->shape[1]);
}

static bool already_seen(const td_blob *blob, size_t self, const td_mark *mark, size_t marks,
                         const size_t *failed, size_t fails)
{
    const td_blob *b = &blob[self];
    for (size_t i = 0; i < marks; i++)
        if (same(mark[i].centre, mark_area(&mark[i]), b, 1 + 0.25 * sqrt(b->area), 3)) return true;
    for (size_t i = 0; i < fails; i++)
        if (same(blob[failed[i]].centroid, blob[failed[i]].area, b, 0.3, 1.05)) return true;
    return false;
}

/* Is the last mark one of those before it, found again from another blob? */
static bool is_double(const td_mark *mark, size_t last)
{
    for (size_t i = 0; i < last; i++) {
        double dx = mark[i].centre[0] - mark[last].centre[0], dy = mark[i].centre[1] - mark[last].centre[1];
        if (hypot(dx, dy) < 1 + 0.1 * sqrt(mark_area(&mark[last]))) return true;
    }
    return false;
}

/* Fits all blobs; mark and failed have room for all. */
static td_status fit_all(td_mark *mark, size_t *found, size_t *failed, td_mark_fit *fit,
                         const td_image *image, const td_blob *blob, size_t blobs, td_error *error)
{
    size_t fails = 0;
    td_mark_fit_init(fit, image);
    for (size_t i = 0; i < blobs; i++) {
        bool ok;
        if (already_seen(blob, i, mark, *found, failed, fails)) continue;
        TD_TRY(td_mark_fit_blob(&mark[*found], &ok, fit, image, blob, blobs, i, error));
        if (!ok)
            failed[fails++] = i;
        else if (!is_double(mark, *found))
            ++*found;
    }
    return TD_OK;
}

td_status td_marks_find(td_mark **marks, size_t *count, const td_image *image, td_mark_polarity polarity,
                        td_error *error)
{
    td_blob *blob = NULL;
    size_t blobs = 0;
    *marks = NULL;
    *count = 0;
    if (!image || !image->data || image->width < 1 || image->height < 1 || image->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "marks are looked for in a grey image of at least one pixel");
    TD_TRY(td_marks_blobs(&blob, &blobs, image, polarity, error));
    td_mark *mark = malloc((blobs + 1) * sizeof *mark);
    size_t *failed = malloc((blobs + 1) * sizeof *failed);
    td_mark_fit *fit = calloc(1, sizeof *fit);
    td_status status = TD_ERROR_MEMORY;
    if (mark && failed && fit)
        status = fit_all(mark, count, failed, fit, image, blob, blobs, error);
    else
        td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", blobs);
    if (fit) td_mark_fit_free(fit);
    free(fit);
    free(failed);
    free(blob);
    if (status == TD_OK)
        *marks = mark;
    else
        free(mark);
    return status;
}
