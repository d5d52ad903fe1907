#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/charuco_internal.h"
#include "calib/homography.h"
#include "calib/tags.h"

static const double NEAR = 3.2;            /* squares between markers that are compared */
static const double TOLERANCE = 0.25;      /* error of a predicted centre over its distance */
static const double LARGEST_IMAGE = 1.5e6; /* px, in which other dictionaries are looked for */
enum { ENOUGH = 4 };                       /* markers that make a suspicion */

/* OpenCV's numbers of the dictionaries; -1: not by OpenCV. Small tags are in any image: too short of bits to
 * be looked for. */
static const struct {
    const char *name;
    int number;
    const char *whole; /* of the same markers the largest dictionary; NULL: this is it */
} known[] = {
    {"aruco4x4_50", 0, "aruco4x4_1000"},   {"aruco4x4_100", 1, "aruco4x4_1000"},
    {"aruco4x4_250", 2, "aruco4x4_1000"},  {"aruco4x4_1000", 3, NULL},
    {"aruco5x5_50", 4, "aruco5x5_1000"},   {"aruco5x5_100", 5, "aruco5x5_1000"},
    {"aruco5x5_250", 6, "aruco5x5_1000"},  {"aruco5x5_1000", 7, NULL},
    {"aruco6x6_50", 8, "aruco6x6_1000"},   {"aruco6x6_100", 9, "aruco6x6_1000"},
    {"aruco6x6_250", 10, "aruco6x6_1000"}, {"aruco6x6_1000", 11, NULL},
    {"aruco7x7_50", 12, "aruco7x7_1000"},  {"aruco7x7_100", 13, "aruco7x7_1000"},
    {"aruco7x7_250", 14, "aruco7x7_1000"}, {"aruco7x7_1000", 15, NULL},
    {"aruco_original", 16, NULL},          {"tag36h11", -1, NULL},
};
enum { KNOWN = sizeof known / sizeof *known };

static td_status from_tags(td_marker **markers, size_t *count, const td_image *image, const char *dictionary,
                           int border, td_error *error)
{
    td_tag *tag = NULL;
    *markers = NULL;
    TD_TRY(td_tags_find(&tag, count, image, dictionary, border, 0, error));
    *markers = calloc(*count + 1, sizeof **markers);
    for (size_t i = 0; *markers && i < *count; i++) {
        (*markers)[i].id = tag[i].id;
        memcpy((*markers)[i].corner, tag[i].corner, sizeof tag[i].corner);
    }
    free(tag);
    return *markers ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu markers", *count);
}

td_status td_markers_find(td_marker **markers, size_t *count, const td_image *image, const char *dictionary,
                          int border, td_error *error)
{
    if (strncmp(dictionary, "tag", 3) == 0)
        return from_tags(markers, count, image, dictionary, border, error);
    for (int i = 0; i < KNOWN; i++)
        if (strcmp(known[i].name, dictionary) == 0)
            return td_markers_by_opencv(markers, count, image, known[i].number, border, error);
    *markers = NULL, *count = 0;
    return td_fail(error, TD_ERROR_ARGUMENT, "dictionary: there is no '%.40s'", dictionary);
}

/* ---- Which square a marker sits on ---- */

static int marker_count(const td_charuco_layout *layout)
{
    return (layout->columns + 1) * (layout->rows + 1) / 2;
}

/* Markers are numbered row by row over the light squares. */
static bool square_of(double square[2], int id, const td_charuco_layout *layout)
{
    int k = id - layout->first_id;
    if (k < 0) return false;
    for (int j = 0; j <= layout->rows; j++) {
        const int first = td_charuco_square_is_dark(layout, 0, j) ? 1 : 0;
        const int in_row = (layout->columns + 2 - first) / 2;
        if (k < in_row) {
            square[0] = first + 2 * k - 0.5;
            square[1] = j - 0.5;
            return true;
        }
        k -= in_row;
    }
    return false;
}

static void apply(double out[2], const double h[9], const double in[2])
{
    const double w = h[6] * in[0] + h[7] * in[1] + h[8];
    for (int k = 0; k < 2; k++) out[k] = (h[3 * k] * in[0] + h[3 * k + 1] * in[1] + h[3 * k + 2]) / w;
}

/* Square, homography and scale of a marker; false when the layout has none of this number. */
static bool locate(td_marker *m, const td_charuco_layout *layout)
{
    static const double sign[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
    double on_board[8], area = 0;
    const double *p = m->corner;
    m->placed = false;
    if (!square_of(m->square, m->id, layout)) return false;
    for (int k = 0; k < 4; k++) {
        const int next = (k + 1) % 4;
        area += (p[2 * k] * p[2 * next + 1] - p[2 * k + 1] * p[2 * next]) / 2;
        for (int c = 0; c < 2; c++) on_board[2 * k + c] = m->square[c] + sign[k][c] * layout->share / 2;
    }
    m->scale = sqrt(fabs(area)) / layout->share;
    return area > 0 && td_homography(m->from, on_board, p, 4, NULL) == TD_OK;
}

/* Whether `a` tells where the centre of `b` is. */
static bool predicts(const td_marker *a, const td_marker *b, double distance)
{
    double expected[2], seen[2];
    apply(expected, a->from, b->square);
    apply(seen, b->from, b->square);
    return hypot(expected[0] - seen[0], expected[1] - seen[1]) < TOLERANCE * distance * b->scale;
}

static bool agree(const td_marker *a, const td_marker *b)
{
    const double distance = hypot(a->square[0] - b->square[0], a->square[1] - b->square[1]);
    return distance > 0.5 && distance < NEAR && predicts(a, b, distance) && predicts(b, a, distance);
}

/* Numbers of groups: every marker that can be reached by agreement gets the number of the first. */
static void spread(int *group, const td_marker *marker, size_t count, size_t from)
{
    for (bool more = true; more;) {
        more = false;
        for (size_t a = from; a < count; a++)
            for (size_t b = from; group[a] == (int)from + 1 && b < count; b++)
                if (group[b] == 0 && agree(&marker[a], &marker[b])) group[b] = (int)from + 1, more = true;
    }
}

size_t td_charuco_place(td_marker *marker, size_t count, const td_charuco_layout *layout)
{
    int *group = calloc(count + 1, sizeof *group), best = 0;
    size_t most = 0;
    if (!group) return 0;
    for (size_t i = 0; i < count; i++) group[i] = locate(&marker[i], layout) ? 0 : -1;
    for (size_t i = 0; i < count; i++) {
        size_t size = 0;
        if (group[i] != 0) continue;
        group[i] = (int)i + 1;
        spread(group, marker, count, i);
        for (size_t k = i; k < count; k++) size += group[k] == (int)i + 1;
        if (size > most) most = size, best = (int)i + 1;
    }
    for (size_t i = 0; i < count; i++) marker[i].placed = best && group[i] == best;
    free(group);
    return most;
}

/* ---- What may be wrong ---- */

/* How many markers another layout would place. */
static size_t try_layout(const td_marker *marker, size_t count, const td_charuco_layout *layout)
{
    td_marker *copy = malloc((count + 1) * sizeof *copy);
    if (!copy || layout->columns < 2 || layout->rows < 2) {
        free(copy);
        return 0;
    }
    memcpy(copy, marker, count * sizeof *copy);
    const size_t placed = td_charuco_place(copy, count, layout);
    free(copy);
    return placed;
}

/* Another layout, and what it would mean. */
typedef struct guess {
    td_charuco_layout layout;
    const char *meaning;
} guess;

enum { SIZES = 5, GUESSES = 9 }; /* the first by which sizes are guessed */

static void make_guesses(guess g[GUESSES], const td_charuco_layout *layout)
{
    static const double share[] = {0.35, 0.5, 0.7, 0.95};
    for (int i = 0; i < GUESSES; i++)
        g[i] = (guess){*layout,
                       "markers and squares have another ratio of sizes: measure tag_size_m and spacing_m"};
    g[0].layout.legacy = g[2].layout.legacy = !layout->legacy;
    g[0].meaning = "the board was drawn by the other kind of OpenCV: change legacy";
    g[1].layout.columns = g[2].layout.columns = layout->rows;
    g[1].layout.rows = g[2].layout.rows = layout->columns;
    g[1].meaning = g[2].meaning = "columns and rows are exchanged";
    g[3].layout.columns--, g[3].layout.rows--;
    g[3].meaning = "squares were counted instead of inner corners";
    g[4].layout.columns++, g[4].layout.rows++;
    g[4].meaning = "it is one larger: columns and rows count inner corners";
    for (int i = SIZES; i < GUESSES; i++) g[i].layout.share = share[i - SIZES];
}

bool td_charuco_doubt(char *text, size_t size, const td_marker *marker, size_t count, size_t placed,
                      const td_charuco_layout *layout)
{
    guess g[GUESSES];
    const guess *best = NULL;
    size_t most = ENOUGH - 1;
    if (count < ENOUGH || placed == count) return false;
    make_guesses(g, layout);
    for (size_t i = 0; i < GUESSES; i++) {
        /* Squares of the other colour or a larger board may place nearly as many, a column aside. */
        const size_t better = i < SIZES ? placed + 1 : placed + placed / 2;
        const size_t fits = try_layout(marker, count, &g[i].layout);
        if (fits > better && fits > most) most = fits, best = &g[i];
    }
    if (best) snprintf(text, size, ", but by its markers %s", best->meaning);
    return best;
}

static void mirror(td_image *image)
{
    for (int y = 0; y < image->height; y++) {
        uint8_t *row = image->data + (size_t)y * (size_t)image->width;
        for (int a = 0, b = image->width - 1; a < b; a++, b--) {
            const uint8_t kept = row[a];
            row[a] = row[b], row[b] = kept;
        }
    }
}

/* The other dictionary, with its border, of which more than `most` markers are seen. */
static td_status seek_other(char *text, size_t size, size_t most, const td_image *image,
                            const td_target *target, td_error *error)
{
    for (int i = 0; i < KNOWN; i++) {
        td_marker *marker = NULL;
        size_t count = 0;
        int high = 0;
        if (known[i].whole) continue;
        TD_TRY(td_markers_find(&marker, &count, image, known[i].name, target->border, error));
        for (size_t k = 0; k < count; k++)
            if (marker[k].id > high) high = marker[k].id;
        free(marker);
        if (count <= most) continue;
        most = count;
        snprintf(text, size, ", but saw %zu markers of %s, with numbers up to %d: set dictionary", count,
                 known[i].name, high);
    }
    return TD_OK;
}

static void tell_numbers(char *text, size_t size, const td_marker *marker, size_t count,
                         const td_charuco_layout *layout)
{
    int low = marker[0].id, high = marker[0].id;
    for (size_t i = 1; i < count; i++) {
        if (marker[i].id < low) low = marker[i].id;
        if (marker[i].id > high) high = marker[i].id;
    }
    snprintf(text, size,
             ", markers %d to %d, but saw %zu with numbers from %d to %d that do not fit: another board, or "
             "another "
             "first_id or size",
             layout->first_id, layout->first_id + marker_count(layout) - 1, count, low, high);
}

td_status td_charuco_look_again(char *text, size_t size, const td_marker *marker, size_t count,
                                const td_image *image, const td_target *target, td_error *error)
{
    const td_charuco_layout layout = td_charuco_layout_of(target);
    int times = 0;
    td_image *small = NULL;
    td_marker *other = NULL;
    size_t others = 0;
    while ((double)(image->width >> times) * (image->height >> times) > LARGEST_IMAGE) times++;
    if (count)
        tell_numbers(text, size, marker, count, &layout);
    else
        snprintf(text, size, ", but saw no marker: not in view, blurred, or its markers smaller than 9 px");
    TD_TRY(td_image_shrink(&small, image, times, error));
    td_status status = seek_other(text, size, count < ENOUGH ? ENOUGH - 1 : count, small, target, error);
    mirror(small);
    if (status == TD_OK)
        status = td_markers_find(&other, &others, small, target->dictionary, target->border, error);
    if (status == TD_OK && td_charuco_place(other, others, &layout) >= ENOUGH)
        snprintf(text, size, ", but saw it mirrored: turn off the camera's mirroring");
    free(other);
    td_image_free(&small);
    return status;
}
