#include <limits.h>
#include <math.h>
#include <string.h>

#include "core/target_internal.h"
#include "core/text_internal.h"

static const double SMALLEST_GAP = 0.01, LARGEST_GAP = 10; /* of the tag's size */

static const char *const polarity_names[] = {"dark", "light", "any", NULL}; /* as td_mark_polarity */
static const char *const order_names[] = {"upward", "downward", NULL};      /* as td_tag_order */

static td_status parse_grid(td_target_plane *plane, const td_field *field, td_error *error)
{
    td_field columns = td_field_get(field, "columns"), rows = td_field_get(field, "rows");
    td_field spacing = td_field_get(field, "spacing_m");
    TD_TRY(td_field_int(&plane->columns, &columns, INT_MIN, INT_MAX, error));
    TD_TRY(td_field_int(&plane->rows, &rows, INT_MIN, INT_MAX, error));
    TD_TRY(td_field_real(&plane->spacing_m, &spacing, -INFINITY, INFINITY, error));
    plane->target_from_plane = td_pose_identity();
    return TD_OK;
}

static td_status parse_planes(td_target *target, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"columns", "rows", "spacing_m", "target_from_plane", NULL};
    size_t count = 0;
    TD_TRY(td_field_count(&count, field, 1, TD_TARGET_MAX_PLANES, error));
    for (size_t i = 0; i < count; i++) {
        char name[TD_FIELD_INDEX_SIZE];
        td_field element = td_field_at(field, i, name);
        TD_TRY(td_field_check_keys(&element, keys, error));
        TD_TRY(parse_grid(target->plane + i, &element, error));
        td_field pose = td_field_get(&element, "target_from_plane");
        TD_TRY(td_field_pose(&target->plane[i].target_from_plane, &pose, error));
    }
    target->plane_count = (int)count;
    return TD_OK;
}

static td_status parse_marks(td_target *target, const td_field *field, td_error *error)
{
    static const char *const one[] = {"kind",       "columns",  "rows",   "spacing_m",
                                      "diameter_m", "polarity", "planes", NULL};
    static const char *const several[] = {"kind", "planes", "diameter_m", "polarity", NULL};
    td_field planes = td_field_get(field, "planes"), diameter = td_field_get(field, "diameter_m");
    td_field polarity = td_field_get(field, "polarity");
    TD_TRY(td_field_check_keys(field, planes.value ? several : one, error));
    TD_TRY(planes.value ? parse_planes(target, &planes, error) : parse_grid(target->plane, field, error));
    TD_TRY(td_field_real(&target->diameter_m, &diameter, -INFINITY, INFINITY, error));
    int choice = TD_MARK_ANY;
    if (polarity.value) TD_TRY(td_field_choice(&choice, &polarity, polarity_names, "dark, light or any", error));
    target->polarity = (td_mark_polarity)choice;
    return TD_OK;
}

/* The keys that aprilgrid, tags and charuco share; all may be left out. */
static td_status parse_tag_fields(td_target *target, const td_field *field, int border, const char *family,
                                  td_error *error)
{
    td_field dictionary = td_field_get(field, "dictionary"), cells = td_field_get(field, "border");
    td_field first = td_field_get(field, "first_id");
    target->border = border;
    if (dictionary.value) TD_TRY(td_field_string(&family, &dictionary, error));
    if (!family || !family[0] || strlen(family) >= TD_DICTIONARY_SIZE)
        return td_field_fail(&dictionary, error, "must name a dictionary, such as tag36h11 or aruco5x5_100");
    strcpy(target->dictionary, family);
    if (cells.value) TD_TRY(td_field_int(&target->border, &cells, INT_MIN, INT_MAX, error));
    if (first.value) TD_TRY(td_field_int(&target->first_id, &first, INT_MIN, INT_MAX, error));
    return TD_OK;
}

/* The spacing of an aprilgrid is given as such, or by the gap between tags as a share of their size, as
 * Kalibr's tagSpacing. */
static td_status parse_aprilgrid(td_target *target, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"kind",      "columns",   "rows",       "tag_size_m",
                                       "spacing_m", "gap_ratio", "dictionary", "border",
                                       "first_id",  "order",     NULL};
    td_field columns = td_field_get(field, "columns"), rows = td_field_get(field, "rows");
    td_field size = td_field_get(field, "tag_size_m"), spacing = td_field_get(field, "spacing_m");
    td_field gap = td_field_get(field, "gap_ratio"), order = td_field_get(field, "order");
    td_target_plane *plane = target->plane;
    int choice = TD_TAGS_UPWARD;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(parse_tag_fields(target, field, TARGET_LARGEST_BORDER, "tag36h11", error));
    TD_TRY(td_field_int(&plane->columns, &columns, INT_MIN, INT_MAX, error));
    TD_TRY(td_field_int(&plane->rows, &rows, INT_MIN, INT_MAX, error));
    TD_TRY(td_field_real(&target->tag_size_m, &size, -INFINITY, INFINITY, error));
    if (order.value) TD_TRY(td_field_choice(&choice, &order, order_names, "upward or downward", error));
    target->order = (td_tag_order)choice;
    plane->target_from_plane = td_pose_identity();
    if (gap.value && spacing.value)
        return td_field_fail(&gap, error, "must not be given beside spacing_m: each says the other");
    if (!gap.value) return td_field_real(&plane->spacing_m, &spacing, -INFINITY, INFINITY, error);
    double ratio = 0;
    TD_TRY(td_field_real(&ratio, &gap, SMALLEST_GAP, LARGEST_GAP, error));
    plane->spacing_m = target->tag_size_m * (1 + ratio);
    return TD_OK;
}

static td_status parse_charuco(td_target *target, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"kind",       "columns",  "rows",   "spacing_m", "tag_size_m",
                                       "dictionary", "first_id", "legacy", NULL};
    td_field size = td_field_get(field, "tag_size_m"), legacy = td_field_get(field, "legacy");
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(parse_tag_fields(target, field, 1, NULL, error));
    TD_TRY(parse_grid(target->plane, field, error));
    TD_TRY(td_field_real(&target->tag_size_m, &size, -INFINITY, INFINITY, error));
    return legacy.value ? td_field_bool(&target->legacy, &legacy, error) : TD_OK;
}

static td_status parse_tags(td_target *target, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"kind", "dictionary", "border", "tags", NULL};
    static const char *const tag_keys[] = {"id", "size_m", "target_from_tag", NULL};
    td_field tags = td_field_get(field, "tags");
    size_t count = 0;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(parse_tag_fields(target, field, 1, "tag36h11", error));
    TD_TRY(td_field_count(&count, &tags, 1, TD_TARGET_MAX_TAGS, error));
    for (size_t i = 0; i < count; i++) {
        char name[TD_FIELD_INDEX_SIZE];
        td_target_tag *tag = target->tag + i;
        td_field element = td_field_at(&tags, i, name);
        TD_TRY(td_field_check_keys(&element, tag_keys, error));
        td_field id = td_field_get(&element, "id"), size = td_field_get(&element, "size_m");
        td_field pose = td_field_get(&element, "target_from_tag");
        TD_TRY(td_field_int(&tag->id, &id, INT_MIN, INT_MAX, error));
        TD_TRY(td_field_real(&tag->size_m, &size, -INFINITY, INFINITY, error));
        tag->target_from_tag = td_pose_identity();
        if (pose.value || count > 1) TD_TRY(td_field_pose(&tag->target_from_tag, &pose, error));
    }
    target->tag_count = (int)count;
    target->plane_count = 0;
    return TD_OK;
}

static td_status parse_chessboard(td_target *target, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"kind", "columns", "rows", "spacing_m", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    return parse_grid(target->plane, field, error);
}

td_status td_target_parse(td_target *target, const td_field *field, td_error *error)
{
    typedef td_status (*parser)(td_target *, const td_field *, td_error *);
    static const parser parse[] = {[TD_TARGET_CHESSBOARD] = parse_chessboard,
                                   [TD_TARGET_MARKS] = parse_marks,
                                   [TD_TARGET_APRILGRID] = parse_aprilgrid,
                                   [TD_TARGET_TAGS] = parse_tags,
                                   [TD_TARGET_CHARUCO] = parse_charuco};
    const char *kinds[TD_TARGET_KIND_COUNT + 1] = {NULL};
    td_target read = {.plane_count = 1, .polarity = TD_MARK_ANY};
    td_field kind = td_field_get(field, "kind");
    int choice = 0;
    for (int i = 0; i < TD_TARGET_KIND_COUNT; i++) kinds[i] = td_target_kind_name((td_target_kind)i);
    if (!json_is_object(field->value)) return td_field_check_keys(field, kinds, error);
    TD_TRY(td_field_choice(&choice, &kind, kinds, TARGET_KINDS, error));
    read.kind = (td_target_kind)choice;
    TD_TRY(parse[choice](&read, field, error));
    td_error why;
    if (td_target_check(&read, &why) != TD_OK) return td_field_fail(field, error, "%s", why.message);
    *target = read;
    return TD_OK;
}
