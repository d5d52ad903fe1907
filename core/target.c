#include "core/target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/number.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

enum {
    SMALLEST_SIDE = 2,
    SMALLEST_CHESSBOARD_SIDE = 3,
    LENGTH_TEXT_SIZE = 48,
    TAG_CORNERS = 4,
    LARGEST_ID = 1 << 20
};

static const double SMALLEST_SPACING_M = 1e-4, LARGEST_SPACING_M = 10;
/* Points this far from a plane, as a share of the target's size, still lie on it. */
static const double FLATNESS = 1e-9;
static const double QUATERNION_TOLERANCE = 1e-6;

const char *td_target_kind_name(td_target_kind kind)
{
    switch (kind) {
    case TD_TARGET_CHESSBOARD:
        return "chessboard";
    case TD_TARGET_MARKS:
        return "marks";
    case TD_TARGET_APRILGRID:
        return "aprilgrid";
    case TD_TARGET_TAGS:
        return "tags";
    case TD_TARGET_CHARUCO:
        return "charuco";
    case TD_TARGET_KIND_COUNT:
        break;
    }
    return NULL;
}

static size_t plane_points(const td_target *target, int plane)
{
    const td_target_plane *p = target->plane + plane;
    const size_t cells = (size_t)p->columns * (size_t)p->rows;
    return target->kind == TD_TARGET_APRILGRID ? TAG_CORNERS * cells : cells;
}

size_t td_target_point_count(const td_target *target)
{
    size_t count = 0;
    if (target->kind == TD_TARGET_TAGS) return TAG_CORNERS * (size_t)target->tag_count;
    for (int i = 0; i < target->plane_count; i++) count += plane_points(target, i);
    return count;
}

int td_target_plane_of(const td_target *target, size_t index, size_t *first)
{
    size_t begin = 0;
    if (index >= td_target_point_count(target)) return -1;
    if (target->kind == TD_TARGET_TAGS) {
        if (first) *first = index - index % TAG_CORNERS;
        return (int)(index / TAG_CORNERS);
    }
    int plane = 0;
    while (index >= begin + plane_points(target, plane)) begin += plane_points(target, plane++);
    if (first) *first = begin;
    return plane;
}

td_pose td_target_plane_pose(const td_target *target, int plane)
{
    return target->kind == TD_TARGET_TAGS ? target->tag[plane].target_from_tag
                                          : target->plane[plane].target_from_plane;
}

void td_target_point_on_plane(double xy[2], const td_target *target, size_t index)
{
    static const double corner[TAG_CORNERS][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    size_t first = 0;
    int k = td_target_plane_of(target, index, &first);
    if (k < 0) {
        xy[0] = xy[1] = NAN;
        return;
    }
    const double *c = corner[index % TAG_CORNERS];
    if (target->kind == TD_TARGET_TAGS) {
        for (int i = 0; i < 2; i++) xy[i] = (c[i] - 0.5) * target->tag[k].size_m;
        return;
    }
    const td_target_plane *plane = target->plane + k;
    const bool tags = target->kind == TD_TARGET_APRILGRID;
    const size_t columns = (size_t)plane->columns, cell = (index - first) / (tags ? TAG_CORNERS : 1);
    xy[0] = (double)(cell % columns) * plane->spacing_m + (tags ? c[0] * target->tag_size_m : 0);
    xy[1] = (double)(cell / columns) * plane->spacing_m + (tags ? c[1] * target->tag_size_m : 0);
}

void td_target_point(double p[3], const td_target *target, size_t index)
{
    int k = td_target_plane_of(target, index, NULL);
    if (k < 0) {
        p[0] = p[1] = p[2] = NAN;
        return;
    }
    const td_pose pose = td_target_plane_pose(target, k);
    double on_plane[3] = {0, 0, 0};
    td_target_point_on_plane(on_plane, target, index);
    td_pose_transform(p, &pose, on_plane);
}

int td_target_tag_count(const td_target *target)
{
    const td_target_plane *p = target->plane;
    switch (target->kind) {
    case TD_TARGET_APRILGRID:
        return p->columns * p->rows;
    case TD_TARGET_TAGS:
        return target->tag_count;
    case TD_TARGET_CHARUCO: /* in every other square */
        return (p->columns + 1) * (p->rows + 1) / 2;
    case TD_TARGET_CHESSBOARD:
    case TD_TARGET_MARKS:
    case TD_TARGET_KIND_COUNT:
        break;
    }
    return 0;
}

int td_target_tag_id(const td_target *target, size_t index)
{
    if (index >= td_target_point_count(target)) return -1;
    const int tag = (int)(index / TAG_CORNERS), columns = target->plane[0].columns;
    if (target->kind == TD_TARGET_TAGS) return target->tag[tag].id;
    if (target->kind != TD_TARGET_APRILGRID) return -1;
    if (target->order == TD_TAGS_DOWNWARD) return target->first_id + tag;
    return target->first_id + (target->plane[0].rows - 1 - tag / columns) * columns + tag % columns;
}

bool td_target_is_flat(const td_target *target)
{
    const double z[3] = {0, 0, 1};
    double normal[3], origin[3], size = 0, height = 0;
    const td_pose pose = td_target_plane_pose(target, 0);
    td_pose_rotate(normal, &pose, z);
    td_target_point(origin, target, 0);
    for (size_t i = 1; i < td_target_point_count(target); i++) {
        double p[3], along = 0, distance = 0;
        td_target_point(p, target, i);
        for (int k = 0; k < 3; k++) {
            along += normal[k] * (p[k] - origin[k]);
            distance += (p[k] - origin[k]) * (p[k] - origin[k]);
        }
        height = fmax(height, fabs(along));
        size = fmax(size, sqrt(distance));
    }
    return height <= FLATNESS * size;
}

/* "25 mm": at most six digits, none behind the point when they are zeros. */
static const char *millimetres(char text[LENGTH_TEXT_SIZE], double metres)
{
    char number[TD_NUMBER_SIZE];
    size_t length = strlen(td_number_format(number, metres * 1000, 6));
    if (length > 2 && !strcmp(number + length - 2, ".0")) number[length - 2] = 0;
    snprintf(text, LENGTH_TEXT_SIZE, "%s mm", number);
    return text;
}

enum { HINT_SIZE = 64 };

/* "; did you mean 0.025?" for 25: a number that fits when it is taken for millimetres. Else empty. */
static const char *millimetre_hint(char hint[HINT_SIZE], double metres, double low, double high)
{
    char number[TD_NUMBER_SIZE];
    const double meant = metres / 1000;
    hint[0] = 0;
    if (metres >= 1 && meant >= low && meant <= high)
        snprintf(hint, HINT_SIZE, "; did you mean %s?", td_number_format(number, meant, 0));
    return hint;
}

static td_status check_side(const char *where, const char *name, int side, int low, td_error *error)
{
    if (side >= low && side <= TD_TARGET_MAX_SIDE) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "%s%s: is %d, but must lie between %d and %d", where, name, side,
                   low, TD_TARGET_MAX_SIDE);
}

static td_status check_length(const char *where, const char *name, double length, td_error *error)
{
    if (length >= SMALLEST_SPACING_M && length <= LARGEST_SPACING_M) return TD_OK;
    char seen[TD_NUMBER_SIZE], low[TD_NUMBER_SIZE], high[TD_NUMBER_SIZE], hint[HINT_SIZE];
    return td_fail(error, TD_ERROR_ARGUMENT, "%s%s: is %s metres, but must lie between %s and %s%s", where,
                   name, td_number_format(seen, length, 0), td_number_format(low, SMALLEST_SPACING_M, 0),
                   td_number_format(high, LARGEST_SPACING_M, 0),
                   millimetre_hint(hint, length, SMALLEST_SPACING_M, LARGEST_SPACING_M));
}

static td_status check_pose(const char *where, const char *name, const td_pose *pose, td_error *error)
{
    const double *q = pose->q, *t = pose->t;
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(fabs(length - 1) <= QUATERNION_TOLERANCE))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s%s.q: must be a unit quaternion", where, name);
    if (!isfinite(t[0] + t[1] + t[2]))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s%s.t_m: must be finite", where, name);
    return TD_OK;
}

static td_status check_plane(const td_target *target, int index, td_error *error)
{
    const td_target_plane *plane = target->plane + index;
    const int low = target->kind == TD_TARGET_CHESSBOARD ? SMALLEST_CHESSBOARD_SIDE : SMALLEST_SIDE;
    char where[32] = "";
    if (target->plane_count > 1) snprintf(where, sizeof where, "planes[%d].", index);
    TD_TRY(check_side(where, "columns", plane->columns, low, error));
    TD_TRY(check_side(where, "rows", plane->rows, low, error));
    TD_TRY(check_length(where, "spacing_m", plane->spacing_m, error));
    return check_pose(where, "target_from_plane", &plane->target_from_plane, error);
}

static td_status check_marks(const td_target *target, td_error *error)
{
    double spacing = target->plane[0].spacing_m;
    for (int i = 1; i < target->plane_count; i++) spacing = fmin(spacing, target->plane[i].spacing_m);
    if (target->diameter_m > 0 && target->diameter_m < spacing) return TD_OK;
    char seen[TD_NUMBER_SIZE], most[TD_NUMBER_SIZE], hint[HINT_SIZE];
    return td_fail(
        error, TD_ERROR_ARGUMENT,
        "diameter_m: is %s metres, but must be more than 0 and less than the spacing of the marks, %s%s",
        td_number_format(seen, target->diameter_m, 0), td_number_format(most, spacing, 0),
        millimetre_hint(hint, target->diameter_m, 0, spacing));
}

/* What all targets with tags share. */
static td_status check_tag_fields(const td_target *target, td_error *error)
{
    if (!target->dictionary[0] || !memchr(target->dictionary, 0, sizeof target->dictionary))
        return td_fail(error, TD_ERROR_ARGUMENT, "dictionary: must be a name of 1 to %d bytes",
                       TD_DICTIONARY_SIZE - 1);
    if (target->border < 1 || target->border > TARGET_LARGEST_BORDER)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "border: is %d cells, but must be 1 (libapriltag's tags) or 2 (Kalibr's)",
                       target->border);
    if (target->first_id < 0 || target->first_id > LARGEST_ID)
        return td_fail(error, TD_ERROR_ARGUMENT, "first_id: is %d, but must lie between 0 and %d",
                       target->first_id, LARGEST_ID);
    return TD_OK;
}

static td_status check_tag_grid(const td_target *target, td_error *error)
{
    TD_TRY(check_tag_fields(target, error));
    TD_TRY(check_length("", "tag_size_m", target->tag_size_m, error));
    if (target->tag_size_m < target->plane[0].spacing_m) return TD_OK;
    char seen[TD_NUMBER_SIZE], most[TD_NUMBER_SIZE];
    return td_fail(error, TD_ERROR_ARGUMENT, "tag_size_m: is %s metres, but must be less than %s, %s metres",
                   td_number_format(seen, target->tag_size_m, 0),
                   target->kind == TD_TARGET_CHARUCO
                       ? "spacing_m, the side of the squares"
                       : "spacing_m, the distance between the same corners of two tags",
                   td_number_format(most, target->plane[0].spacing_m, 0));
}

static td_status check_tags(const td_target *target, td_error *error)
{
    TD_TRY(check_tag_fields(target, error));
    if (target->tag_count < 1 || target->tag_count > TD_TARGET_MAX_TAGS)
        return td_fail(error, TD_ERROR_ARGUMENT, "tags: a target has %d tags, but must have 1 to %d",
                       target->tag_count, TD_TARGET_MAX_TAGS);
    for (int i = 0; i < target->tag_count; i++) {
        const td_target_tag *tag = target->tag + i;
        char where[32];
        snprintf(where, sizeof where, "tags[%d].", i);
        if (tag->id < 0 || tag->id > LARGEST_ID)
            return td_fail(error, TD_ERROR_ARGUMENT, "%sid: is %d, but must lie between 0 and %d", where,
                           tag->id, LARGEST_ID);
        TD_TRY(check_length(where, "size_m", tag->size_m, error));
        TD_TRY(check_pose(where, "target_from_tag", &tag->target_from_tag, error));
        for (int k = 0; k < i; k++)
            if (target->tag[k].id == tag->id)
                return td_fail(error, TD_ERROR_ARGUMENT,
                               "%sid: is %d, as that of tags[%d]; a target has one tag of a number", where,
                               tag->id, k);
    }
    return TD_OK;
}

td_status td_target_check(const td_target *target, td_error *error)
{
    if (!td_target_kind_name(target->kind))
        return td_fail(error, TD_ERROR_ARGUMENT, "kind: must be " TARGET_KINDS);
    if (target->kind == TD_TARGET_MARKS) {
        if ((unsigned)target->polarity > TD_MARK_ANY)
            return td_fail(error, TD_ERROR_ARGUMENT, "polarity: must be dark, light or any");
    } else if (target->diameter_m != 0) {
        return td_fail(error, TD_ERROR_ARGUMENT, "diameter_m: a target of kind %s has none",
                       td_target_kind_name(target->kind));
    }
    if (target->kind == TD_TARGET_TAGS) return check_tags(target, error);
    const int most = target->kind == TD_TARGET_MARKS ? TD_TARGET_MAX_PLANES : 1;
    if (target->plane_count < 1 || target->plane_count > most)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "planes: a target of %s has %d planes, but must have 1 to %d",
                       td_target_kind_name(target->kind), target->plane_count, most);
    for (int i = 0; i < target->plane_count; i++) TD_TRY(check_plane(target, i, error));
    if (target->kind == TD_TARGET_MARKS) return check_marks(target, error);
    return target->kind == TD_TARGET_CHESSBOARD ? TD_OK : check_tag_grid(target, error);
}

/* "tag36h11 3, 100 mm" or "5 tags of tag36h11, 40 to 100 mm". */
static void describe_tags(td_text *out, const td_target *target)
{
    char low[LENGTH_TEXT_SIZE], high[LENGTH_TEXT_SIZE];
    double least = INFINITY, most = 0;
    for (int i = 0; i < target->tag_count; i++) {
        least = fmin(least, target->tag[i].size_m);
        most = fmax(most, target->tag[i].size_m);
    }
    if (target->tag_count == 1)
        td_text_format(out, "tag %d of %s", target->tag[0].id, target->dictionary);
    else
        td_text_format(out, "%d tags of %s", target->tag_count, target->dictionary);
    if (least < most) td_text_format(out, ", %s to", millimetres(low, least));
    td_text_format(out, "%s %s", least < most ? "" : ",", millimetres(high, most));
    if (target->border != 1) td_text_format(out, ", border of %d", target->border);
}

static void describe_planes(td_text *out, const td_target *target)
{
    char length[LENGTH_TEXT_SIZE];
    const char *kind = td_target_kind_name(target->kind);
    td_text_format(out, "%s", kind ? kind : "unknown target");
    if (target->plane_count > 1) td_text_format(out, " on %d planes:", target->plane_count);
    for (int i = 0; i < target->plane_count; i++) {
        const td_target_plane *p = target->plane + i;
        td_text_format(out, "%s %dx%d, %s", i ? ";" : "", p->columns, p->rows,
                       millimetres(length, p->spacing_m));
    }
    if (target->kind == TD_TARGET_MARKS)
        td_text_format(out, "%s diameter %s", target->plane_count > 1 ? ";" : ",",
                       millimetres(length, target->diameter_m));
    if (target->kind == TD_TARGET_APRILGRID || target->kind == TD_TARGET_CHARUCO)
        td_text_format(out, ", %s of %s", target->dictionary, millimetres(length, target->tag_size_m));
    if (target->kind == TD_TARGET_APRILGRID) td_text_format(out, ", border of %d", target->border);
}

char *td_target_describe(char *text, size_t size, const td_target *target)
{
    td_text out = {0};
    if (target->kind == TD_TARGET_TAGS)
        describe_tags(&out, target);
    else
        describe_planes(&out, target);
    snprintf(text, size, "%s", out.data ? out.data : "");
    free(out.data);
    return text;
}
