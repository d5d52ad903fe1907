#include "calib/tag_dictionary.h"

#include <stdlib.h>
#include <string.h>

#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>

#include "calib/tag_dictionary_internal.h"

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
static bool family_codes(tag_codes *codes, const dictionary *d)
{
    apriltag_family_t *family = d->create();
    if (!family) return false;
    const int last = d->bits * d->bits - 1;
    for (int id = 0; id < d->count; id++)
        for (uint32_t i = 0; i < family->nbits; i++) {
            int at = ((int)family->bit_y[i] - 1) * d->bits + (int)family->bit_x[i] - 1;
            codes->code[id] |= (family->codes[id] >> (family->nbits - 1 - i) & 1) << (last - at);
        }
    d->destroy(family);
    return true;
}

static bool aruco_codes(tag_codes *codes, const dictionary *d)
{
    uint8_t bit[MOST_BITS * MOST_BITS];
    for (int id = 0; id < d->count; id++) {
        if (!td_aruco_bits(bit, d->bits, d->number, id)) return false;
        for (int i = 0; i < d->bits * d->bits; i++) codes->code[id] = codes->code[id] << 1 | (bit[i] != 0);
    }
    return true;
}

static td_status no_dictionary(const char *name, td_error *error)
{
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "dictionary: there is no '%s'; there are tag36h11, tag25h9, tag16h5, aruco4x4_50 to "
                   "aruco7x7_1000 and aruco_original",
                   name);
}

td_status td_tag_codes(tag_codes *codes, const char *name, td_error *error)
{
    const dictionary *d = find(name);
    if (!d) return no_dictionary(name, error);
    *codes = (tag_codes){d->count, d->bits, calloc((size_t)d->count, sizeof *codes->code)};
    if (codes->code && (d->create ? family_codes(codes, d) : aruco_codes(codes, d))) return TD_OK;
    free(codes->code);
    *codes = (tag_codes){0};
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the dictionary %s", d->name);
}

void td_tag_code_cells(uint8_t *cell, uint64_t code, int bits, int border)
{
    const int side = bits + 2 * border, last = bits * bits - 1;
    memset(cell, 0, (size_t)(side * side));
    for (int i = 0; i <= last; i++)
        cell[(i / bits + border) * side + i % bits + border] = (uint8_t)(code >> (last - i) & 1);
}

td_status td_tag_cells(uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS], int *side, const char *name,
                       int border, int id, td_error *error)
{
    const dictionary *d = find(name);
    tag_codes codes;
    if (!d) return no_dictionary(name, error);
    if (border < 1 || border > MOST_BORDER)
        return td_fail(error, TD_ERROR_ARGUMENT, "border: is %d cells, but must be 1 or 2", border);
    if (id < 0 || id >= d->count)
        return td_fail(error, TD_ERROR_ARGUMENT, "id: is %d, but %s has the tags 0 to %d", id, d->name,
                       d->count - 1);
    TD_TRY(td_tag_codes(&codes, name, error));
    *side = d->bits + 2 * border;
    td_tag_code_cells(cell, codes.code[id], d->bits, border);
    free(codes.code);
    return TD_OK;
}
