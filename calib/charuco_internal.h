/* Markers of a charuco: finding them in an image, and telling which squares they sit on. */
#ifndef TELEDIMOS_CALIB_CHARUCO_INTERNAL_H
#define TELEDIMOS_CALIB_CHARUCO_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/image.h"
#include "core/target.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_marker {
    int id;
    double corner[8]; /* px: upper left, upper right, lower right, lower left as it is read */
    /* Set by td_charuco_place: */
    bool placed;      /* on the board, and in accord with the others */
    double square[2]; /* centre, in squares from the first inner corner */
    double from[9];   /* homography: squares to px, from its four corners alone */
    double scale;     /* px per square about here */
} td_marker;

/* Where the markers of a charuco are. Square (i, j), counted from the upper left one, lies between the inner
 * corners (i - 1, j - 1) and (i, j). */
typedef struct td_charuco_layout {
    int columns, rows; /* inner corners */
    int first_id;
    bool legacy;
    double share; /* of a square's side that its marker takes */
} td_charuco_layout;

static inline td_charuco_layout td_charuco_layout_of(const td_target *target)
{
    const td_target_plane *p = &target->plane[0];
    td_charuco_layout layout = {p->columns, p->rows, target->first_id, target->legacy,
                                target->tag_size_m / p->spacing_m};
    return layout;
}

/* The upper left square is dark, but not with an even number of rows of squares in boards of the old kind. */
static inline bool td_charuco_square_is_dark(const td_charuco_layout *layout, int i, int j)
{
    return ((i + j) % 2 == 0) != (layout->legacy && (layout->rows + 1) % 2 == 0);
}

/* Every marker of the dictionary in the grey image; *markers is to be freed with free(). */
td_status td_markers_find(td_marker **markers, size_t *count, const td_image *image, const char *dictionary,
                          int border, td_error *error);

/* Places the markers whose numbers the layout has and that agree with one another: of the groups of
 * neighbours that predict each other's centres, the largest. Returns how many. */
size_t td_charuco_place(td_marker *marker, size_t count, const td_charuco_layout *layout);

/* Writes what other layout the markers fit better, beginning with ", ", and returns true; false when none. */
bool td_charuco_doubt(char *text, size_t size, const td_marker *marker, size_t count, size_t placed,
                      const td_charuco_layout *layout);

/* The same when the markers found, if any, do not agree: another dictionary, a mirrored board, another board.
 */
td_status td_charuco_look_again(char *text, size_t size, const td_marker *marker, size_t count,
                                const td_image *image, const td_target *target, td_error *error);

/* Behind the wall: by OpenCV's predefined dictionary of this number, `count` markers into *marker (id and
 * corners only), to be freed with free(). */
td_status td_markers_by_opencv(td_marker **marker, size_t *count, const td_image *image, int number,
                               int border, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
