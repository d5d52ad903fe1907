#include "calib/tags.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/tags_internal.h"

enum { LISTED = 8 }; /* numbers in a sentence, at most */

static const char *const families[] = {"tag36h11", "tag25h9", "tag16h5"};
/* How many tags say that a family is there: 16 bits are soon found in anything. */
static const size_t needed[] = {1, 1, 4};
enum { FAMILIES = sizeof families / sizeof *families };

static const char *border_name(int border)
{
    return border == 1 ? "a border of 1 cell (libapriltag's)" : "a border of 2 cells (Kalibr's)";
}

/* ---- single tags ---- */

static int by_id_and_place(const void *a, const void *b)
{
    const td_tag *s = a, *t = b;
    if (s->id != t->id) return s->id < t->id ? -1 : 1;
    for (int i = 1; i >= 0; i--)
        if (s->corner[i] != t->corner[i]) return s->corner[i] < t->corner[i] ? -1 : 1;
    return 0;
}

/* Raises the sigma of all corners by the common correlation of the residuals: one corner's own figure is good
 * to a third only. */
static void inflate(td_tag *tag, size_t count, const double inflation[2])
{
    const double factor = inflation[1] > 0 ? sqrt(inflation[0] / inflation[1]) : 1;
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 4; k++) tag[i].sigma[k] *= factor;
}

static td_status check_image(const td_image *image, td_error *error)
{
    if (image->channels == 1) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "tags are found in grey images; this one has %d channels",
                   image->channels);
}

td_status td_tags_find(td_tag **tags, size_t *count, const td_image *image, const char *dictionary,
                       int border, size_t enough, td_error *error)
{
    tag_codes codes;
    tag_list list = {0};
    double inflation[2] = {0};
    *tags = NULL;
    *count = 0;
    TD_TRY(check_image(image, error));
    if (border < 0 || border > 2)
        return td_fail(error, TD_ERROR_ARGUMENT, "border: is %d, but must be 1, 2 or 0 for either", border);
    TD_TRY(td_tag_codes(&codes, dictionary, error));
    td_status status = td_tags_search(&list, image, &codes, border, enough ? enough : SIZE_MAX, error);
    if (status == TD_OK) {
        for (size_t i = 0; i < list.count; i++) td_tag_measure(&list.tag[i], inflation, image, &codes, 0);
        inflate(list.tag, list.count, inflation);
        if (list.count) qsort(list.tag, list.count, sizeof *list.tag, by_id_and_place);
        *tags = list.tag;
        *count = list.count;
    } else {
        free(list.tag);
    }
    free(codes.code);
    return status;
}

/* ---- what was seen instead ---- */

static td_status look(tag_list *list, const td_image *image, const char *dictionary, td_error *error)
{
    tag_codes codes;
    TD_TRY(td_tag_codes(&codes, dictionary, error));
    td_status status = td_tags_search(list, image, &codes, 0, SIZE_MAX, error);
    free(codes.code);
    return status;
}

static size_t of_border(const tag_list *list, int border)
{
    size_t n = 0;
    for (size_t i = 0; i < list->count; i++) n += list->tag[i].border == border;
    return n;
}

static td_status mirrored(td_image **mirror, const td_image *image, td_error *error)
{
    TD_TRY(td_image_new(mirror, image->width, image->height, 1, error));
    const size_t width = (size_t)image->width;
    for (size_t y = 0; y < (size_t)image->height; y++)
        for (size_t x = 0; x < width; x++)
            (*mirror)->data[y * width + x] = image->data[y * width + width - 1 - x];
    return TD_OK;
}

static const char *plural(size_t n)
{
    return n == 1 ? "" : "s";
}

static td_status say_other_border(td_detection *d, const td_image *image, const td_target *target,
                                  td_error *error)
{
    tag_list list = {0};
    td_status status = look(&list, image, target->dictionary, error);
    const int border = of_border(&list, 1) ? 1 : 2;
    const size_t n = of_border(&list, border);
    if (status == TD_OK && n && border != target->border)
        snprintf(d->reason, sizeof d->reason, "looked for %s with %s, saw %zu tag%s with %s: set border: %d",
                 target->dictionary, border_name(target->border), n, plural(n), border_name(border), border);
    free(list.tag);
    return status;
}

static td_status say_mirrored(td_detection *d, const td_image *image, const td_target *target,
                              td_error *error)
{
    tag_list list = {0};
    td_image *mirror = NULL;
    TD_TRY(mirrored(&mirror, image, error));
    td_status status = look(&list, mirror, target->dictionary, error);
    if (status == TD_OK && list.count)
        snprintf(d->reason, sizeof d->reason,
                 "the image is mirrored: flipped left to right, it shows %zu tag%s of %s; switch the "
                 "mirroring off where it is recorded",
                 list.count, plural(list.count), target->dictionary);
    td_image_free(&mirror);
    free(list.tag);
    return status;
}

static td_status say_other_family(td_detection *d, const td_image *image, const td_target *target, int family,
                                  td_error *error)
{
    tag_list list = {0};
    if (!strcmp(families[family], target->dictionary)) return TD_OK;
    td_status status = look(&list, image, families[family], error);
    if (status == TD_OK && list.count >= needed[family])
        snprintf(d->reason, sizeof d->reason, "looked for %s, saw %zu tag%s of %s: set dictionary: %s%s",
                 target->dictionary, list.count, plural(list.count), families[family], families[family],
                 of_border(&list, target->border) ? ""
                 : of_border(&list, 1)            ? " and border: 1"
                                                  : " and border: 2");
    free(list.tag);
    return status;
}

/* No tag of the target's dictionary and border was read: says what there is. */
static td_status say_instead(td_detection *d, const td_image *image, const td_target *target, td_error *error)
{
    TD_TRY(say_other_border(d, image, target, error));
    if (!d->reason[0]) TD_TRY(say_mirrored(d, image, target, error));
    for (int i = 0; i < FAMILIES && !d->reason[0]; i++) TD_TRY(say_other_family(d, image, target, i, error));
    if (!d->reason[0])
        snprintf(d->reason, sizeof d->reason,
                 "looked for %s with %s, saw no tag; each must lie in the image as a whole, sharp, 3 px or "
                 "more to a cell, with light around it",
                 target->dictionary, border_name(target->border));
    return TD_OK;
}

/* "4, 7, 9": the numbers that are not on the target, each once. */
static int list_strangers(char *text, size_t size, const tag_list *list, const bool *stranger)
{
    int n = 0;
    size_t length = 0;
    text[0] = 0;
    for (size_t i = 0; i < list->count; i++) {
        bool before = false;
        for (size_t k = 0; k < i; k++) before = before || (stranger[k] && list->tag[k].id == list->tag[i].id);
        if (!stranger[i] || before) continue;
        if (n++ == LISTED) snprintf(text + length, size - length, ", …");
        if (n > LISTED) continue;
        length += (size_t)snprintf(text + length, size - length, "%s%d", n > 1 ? ", " : "", list->tag[i].id);
    }
    return n;
}

static void describe_numbers(char *text, size_t size, const td_target *target)
{
    size_t length = 0;
    text[0] = 0;
    if (target->kind == TD_TARGET_APRILGRID) {
        snprintf(text, size, "%d to %d", target->first_id,
                 target->first_id + td_target_tag_count(target) - 1);
        return;
    }
    for (int i = 0; i < target->tag_count && i < LISTED; i++)
        length += (size_t)snprintf(text + length, size - length, "%s%d", i ? ", " : "", target->tag[i].id);
    if (target->tag_count > LISTED) snprintf(text + length, size - length, ", …");
}

/* ---- a target ---- */

static int place_of(const td_target *target, int id)
{
    if (target->kind == TD_TARGET_APRILGRID) return td_tag_grid_place(target, id);
    for (int i = 0; i < target->tag_count; i++)
        if (target->tag[i].id == id) return i;
    return -1;
}

/* Puts each tag of the list at its place; of two of one number the one with fewer wrong bits. */
static void sort_in(tag_grid *g, bool *stranger, const tag_list *list)
{
    for (size_t i = 0; i < list->count; i++) {
        int k = place_of(g->target, list->tag[i].id);
        stranger[i] = k < 0;
        if (k < 0 || (g->seen[k] && g->tag[k].wrong_bits <= list->tag[i].wrong_bits)) continue;
        g->tag[k] = list->tag[i];
        g->seen[k] = true;
    }
}

static void say_strangers(td_detection *d, const tag_grid *g, const tag_list *list, const bool *stranger)
{
    char numbers[96], own[96];
    int n = list_strangers(numbers, sizeof numbers, list, stranger);
    if (!n) return;
    describe_numbers(own, sizeof own, g->target);
    snprintf(d->reason, sizeof d->reason, "saw tag%s %s of %s, but the target has %s%s", n == 1 ? "" : "s",
             numbers, g->target->dictionary, own,
             g->target->kind == TD_TARGET_APRILGRID ? ": see first_id, columns and rows" : "");
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Writes down the corners of the tags that are seen. */
static td_status fill(td_detection *d, tag_grid *g, td_error *error)
{
    double *blur = malloc((size_t)g->tags * sizeof *blur);
    size_t n = 0;
    if (!blur) return td_fail(error, TD_ERROR_MEMORY, "no memory for %d tags", g->tags);
    for (int i = 0; i < g->tags; i++)
        if (g->seen[i] && !isnan(g->tag[i].blur)) blur[n++] = g->tag[i].blur;
    inflate(g->tag, (size_t)g->tags, g->inflation);
    int whole = 0;
    for (int i = 0; i < g->tags; i++) {
        int measured = 0;
        for (size_t k = 0; k < 4 && g->seen[i]; k++) {
            size_t at = 4 * (size_t)i + k;
            if (!(g->tag[i].sigma[k] > 0)) continue;
            d->point[2 * at] = g->tag[i].corner[2 * k];
            d->point[2 * at + 1] = g->tag[i].corner[2 * k + 1];
            d->sigma[at] = g->tag[i].sigma[k];
            measured++;
        }
        whole += measured == 4;
    }
    d->found = whole > 0;
    if (!d->found)
        snprintf(d->reason, sizeof d->reason,
                 "tags of %s are read, but none has four corners that can be measured; come nearer, or focus",
                 g->target->dictionary);
    if (n) {
        qsort(blur, n, sizeof *blur, compare_doubles);
        d->blur_px = (blur[n / 2] + blur[(n - 1) / 2]) / 2;
    }
    free(blur);
    return TD_OK;
}

/* From the tags that were read to the points of the target. */
static td_status assemble(td_detection *d, tag_grid *g, tag_list *list, bool *stranger, td_error *error)
{
    const bool grid = g->target->kind == TD_TARGET_APRILGRID;
    int seen = 0, dropped = 0;
    for (size_t i = 0; i < list->count; i++)
        td_tag_measure(&list->tag[i], g->inflation, g->image, g->codes, g->outside);
    if (grid && td_tag_grid_is_other(d->reason, sizeof d->reason, g, list)) return TD_OK;
    sort_in(g, stranger, list);
    say_strangers(d, g, list, stranger);
    if (grid) {
        dropped = td_tag_grid_drop(g);
        td_tag_grid_grow(g);
        td_tag_grid_mend(g);
    }
    for (int i = 0; i < g->tags; i++) seen += g->seen[i];
    if (dropped)
        snprintf(
            d->reason, sizeof d->reason,
            "%d tag%s lie%s where the grid has none of that number, and %s left out; is another board in "
            "the image?",
            dropped, dropped == 1 ? "" : "s", dropped == 1 ? "s" : "", dropped == 1 ? "was" : "were");
    return seen ? fill(d, g, error) : TD_OK;
}

static td_status check_numbers(const td_target *target, td_error *error)
{
    const int count = td_tag_count(target->dictionary), tags = td_target_tag_count(target);
    if (target->kind == TD_TARGET_APRILGRID && count && target->first_id + tags > count)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the target needs the tags %d to %d, but %s has the tags 0 to %d", target->first_id,
                       target->first_id + tags - 1, target->dictionary, count - 1);
    for (int i = 0; target->kind == TD_TARGET_TAGS && count && i < tags; i++)
        if (target->tag[i].id >= count)
            return td_fail(error, TD_ERROR_ARGUMENT, "tags[%d].id: is %d, but %s has the tags 0 to %d", i,
                           target->tag[i].id, target->dictionary, count - 1);
    return TD_OK;
}

static td_status detect(td_detection *d, const td_image *image, const td_target *target,
                        const tag_codes *codes, td_error *error)
{
    const int tags = td_target_tag_count(target);
    tag_list list = {0};
    tag_grid g = {.target = target, .image = image, .codes = codes, .tags = tags};
    if (target->kind == TD_TARGET_APRILGRID)
        g.outside =
            (target->plane[0].spacing_m / target->tag_size_m - 1) * td_tag_side(codes, target->border);
    /* A grid grows from a few tags. */
    const size_t enough = (size_t)(target->kind == TD_TARGET_APRILGRID ? (tags + 3) / 4 : tags);
    td_status status = td_tags_search(&list, image, codes, target->border, enough, error);
    if (status == TD_OK && !list.count) status = say_instead(d, image, target, error);
    if (status == TD_OK && list.count) {
        bool *stranger = calloc(list.count, sizeof *stranger);
        g.tag = calloc((size_t)tags, sizeof *g.tag);
        g.seen = calloc((size_t)tags, sizeof *g.seen);
        status = stranger && g.tag && g.seen ? assemble(d, &g, &list, stranger, error)
                                             : td_fail(error, TD_ERROR_MEMORY, "no memory for %d tags", tags);
        free(stranger);
        free(g.tag);
        free(g.seen);
    }
    free(list.tag);
    return status;
}

td_status td_tags_detect(td_detection *detection, const td_image *image, const td_target *target,
                         td_error *error)
{
    tag_codes codes;
    *detection = (td_detection){0};
    TD_TRY(td_target_check(target, error));
    if (target->kind != TD_TARGET_APRILGRID && target->kind != TD_TARGET_TAGS)
        return td_fail(error, TD_ERROR_ARGUMENT, "the detector of tags was given a target of %s",
                       td_target_kind_name(target->kind));
    TD_TRY(check_image(image, error));
    TD_TRY(check_numbers(target, error));
    TD_TRY(td_tag_codes(&codes, target->dictionary, error));
    td_status status = td_detection_init(detection, td_target_point_count(target), error);
    if (status == TD_OK) status = detect(detection, image, target, &codes, error);
    if (status != TD_OK) td_detection_free(detection);
    free(codes.code);
    return status;
}
