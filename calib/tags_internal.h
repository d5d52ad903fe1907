/* How tags.c finds tags: quadrangles and codes by libapriltag, then what the image says of each. */
#ifndef TELEDIMOS_CALIB_TAGS_INTERNAL_H
#define TELEDIMOS_CALIB_TAGS_INTERNAL_H

#include "tag_dictionary.h"
#include "tag_dictionary_internal.h"
#include "tags.h"

typedef struct tag_list {
    td_tag *tag;
    size_t count, capacity;
} tag_list;

/* Takes a copy; false: no memory. */
bool td_tag_list_add(tag_list *list, const td_tag *tag);
/* Side of a tag of the border, cells. */
int td_tag_side(const tag_codes *codes, int border);

/* tags_search.c: appends the tags of the border (0: of either), corners good to a pixel or two. The search
 * ends when there are `enough`. */
td_status td_tags_search(tag_list *list, const td_image *image, const tag_codes *codes, int border,
                         size_t enough, td_error *error);

/* tags_read.c */
/* Grey levels of a tag. */
typedef struct tag_levels {
    double dark, light;
    int wrong; /* cells, of the border too, that are nearer to the other level */
} tag_levels;
/* Reads the tag where its corners are. False when they are no quadrangle or lie outside the image. */
bool td_tag_read(tag_levels *levels, const td_image *image, const td_tag *tag, const tag_codes *codes);
/* Whether what was read there is this tag, seen well enough. */
bool td_tag_is_read(const tag_levels *levels, const td_tag *tag, const tag_codes *codes);
/* Whether it is this tag with this border rather than the other one: the codes of both lie so nearly on one
 * another that one can be read as the other. */
bool td_tag_is_of_border(const td_image *image, const td_tag *tag, const tag_codes *codes);
/* Measures the corners: positions, sigma (each by its own residuals; 0 where it fails), blur. `outside`:
 * cells to the next thing printed beside the tag; 0: not known. Sums up in inflation[0] of inflation[1]
 * corners by how much correlation raised the variance. */
void td_tag_measure(td_tag *tag, double inflation[2], const td_image *image, const tag_codes *codes,
                    double outside);

/* tags_grid.c: the grid's tags of the list, each at its place, and those found by their neighbours. */
typedef struct tag_grid {
    const td_target *target;
    const td_image *image;
    const tag_codes *codes;
    double outside; /* cells between tags; 0: not known */
    int tags;
    td_tag *tag;         /* (tags) in the order of the target's points, measured */
    bool *seen;          /* (tags) */
    double inflation[2]; /* sum and number, as td_tag_measure has it */
} tag_grid;
/* Place of the tag of number `id`; -1: not on the grid. */
int td_tag_grid_place(const td_target *target, int id);
/* Drops tags that do not lie where the others say they must; number dropped. */
int td_tag_grid_drop(tag_grid *grid);
/* Finds tags beside those that are seen, and corners that could not be measured where they were first put. */
void td_tag_grid_grow(tag_grid *grid);
void td_tag_grid_mend(tag_grid *grid);
/* Writes why the tags are on another grid than the target's, as on one of 5x7 for 7x5; false: they are not.
 */
bool td_tag_grid_is_other(char *why, size_t size, const tag_grid *grid, const tag_list *list);

#endif
