#include "calib/tag_dictionary.h"

#include <string.h>

#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>

#include "calib/tag_dictionary_internal.h"
#include "core/text_internal.h"

enum { MOST_BORDER = 2, MOST_BITS = 8 };

typedef struct dictionary {
    const char *name;
    int count, bits; /* tags; bits along a side */
    apriltag_family_t *(*create)(void);
    void (*destroy)(apriltag_family_t *);
    int number; /* of OpenCV's predefined dictionary, where there is no family */
} dictionary;

static const dictionary all[] = {
    {"tag36h11", 587, 6, tag36h11_create, tag36h11_destroy, -1},
    {"tag25h9", 35, 5, tag25h9_create, tag25h9_destroy, -1},
    {"tag16h5", 30, 4, tag16h5_create, tag16h5_destroy, -1},
    {"aruco4x4_50", 50, 4, NULL, NULL, 0},
    {"aruco4x4_100", 100, 4, NULL, NULL, 1},
    {"aruco4x4_250", 250, 4, NULL, NULL, 2},
    {"aruco4x4_1000", 1000, 4, NULL, NULL, 3},
    {"aruco5x5_50", 50, 5, NULL, NULL, 4},
    {"aruco5x5_100", 100, 5, NULL, NULL, 5},
    {"aruco5x5_250", 250, 5, NULL, NULL, 6},
    {"aruco5x5_1000", 1000, 5, NULL, NULL, 7},
    {"aruco6x6_50", 50, 6, NULL, NULL, 8},
    {"aruco6x6_100", 100, 6, NULL, NULL, 9},
    {"aruco6x6_250", 250, 6, NULL, NULL, 10},
    {"aruco6x6_1000", 1000, 6, NULL, NULL, 11},
    {"aruco7x7_50", 50, 7, NULL, NULL, 12},
    {"aruco7x7_100", 100, 7, NULL, NULL, 13},
    {"aruco7x7_250", 250, 7, NULL, NULL, 14},
    {"aruco7x7_1000", 1000, 7, NULL, NULL, 15},
    {"aruco_original", 1024, 5, NULL, NULL, 16},
};

static const dictionary *find(const char *name)
{
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (!strcmp(all[i].name, name)) return all + i;
    return NULL;
}

int td_tag_count(const char *name)
{
    const dictionary *d = find(name);
    return d ? d->count : 0;
}

const char *td_tag_dictionary_name(int index)
{
    return index >= 0 && index < (int)(sizeof all / sizeof *all) ? all[index].name : NULL;
}

/* A family's bits stand in any order; where each is, counted from the black square's upper left, it says
 * itself. Its border is 1. */
static bool family_bits(uint8_t *bit, const dictionary *d, int id)
{
    apriltag_family_t *family = d->create();
    if (!family) return false;
    for (uint32_t i = 0; i < family->nbits; i++)
        bit[((int)family->bit_y[i] - 1) * d->bits + (int)family->bit_x[i] - 1] =
            (family->codes[id] >> (family->nbits - 1 - i)) & 1;
    d->destroy(family);
    return true;
}

td_status td_tag_cells(uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS], int *side, const char *name,
                       int border, int id, td_error *error)
{
    const dictionary *d = find(name);
    char shown[TD_SHOWN_SIZE];
    if (!d)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dictionary: there is no '%s'; there are tag36h11, tag25h9, tag16h5, aruco4x4_50 to "
                       "aruco7x7_1000 and aruco_original",
                       td_text_shown(shown, name));
    if (border < 1 || border > MOST_BORDER)
        return td_fail(error, TD_ERROR_ARGUMENT, "border: is %d cells, but must be 1 or 2", border);
    if (id < 0 || id >= d->count)
        return td_fail(error, TD_ERROR_ARGUMENT, "id: is %d, but %s has the tags 0 to %d", id, d->name,
                       d->count - 1);
    uint8_t bit[MOST_BITS * MOST_BITS] = {0};
    bool read = d->create ? family_bits(bit, d, id) : td_aruco_bits(bit, d->bits, d->number, id);
    if (!read) return td_fail(error, TD_ERROR_MEMORY, "no memory for the dictionary %s", d->name);
    *side = d->bits + 2 * border;
    memset(cell, 0, (size_t)(*side * *side));
    for (int y = 0; y < d->bits; y++)
        for (int x = 0; x < d->bits; x++)
            cell[(y + border) * *side + x + border] = bit[y * d->bits + x] ? 1 : 0;
    return TD_OK;
}
