#include "core/target.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/number.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

enum { SMALLEST_SIDE = 2, SMALLEST_CHESSBOARD_SIDE = 3, LENGTH_TEXT_SIZE = 48 };

static const double SMALLEST_SPACING_M = 1e-4, LARGEST_SPACING_M = 10;
/* Points this far from a plane, as a share of the target's size, still lie on it. */
static const double FLATNESS = 1e-9;
static const double QUATERNION_TOLERANCE = 1e-6;

static const char *const polarity_names[] = {"dark", "light", "any", NULL};

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

static size_t plane_points(const td_target_plane *plane)
{
    return (size_t)plane->columns * (size_t)plane->rows;
}

size_t td_target_point_count(const td_target *target)
{
    size_t count = 0;
    for (int i = 0; i < target->plane_count; i++) count += plane_points(target->plane + i);
    return count;
}

int td_target_plane_of(const td_target *target, size_t index, size_t *first)
{
    size_t begin = 0;
    for (int i = 0; i < target->plane_count; i++) {
        size_t count = plane_points(target->plane + i);
        if (index < begin + count) {
            if (first) *first = begin;
            return i;
        }
        begin += count;
    }
    return -1;
}

void td_target_point(double p[3], const td_target *target, size_t index)
{
    size_t first = 0;
    int k = td_target_plane_of(target, index, &first);
    if (k < 0) {
        p[0] = p[1] = p[2] = NAN;
        return;
    }
    const td_target_plane *plane = target->plane + k;
    const size_t columns = (size_t)plane->columns, i = index - first;
    const double on_plane[3] = {(double)(i % columns) * plane->spacing_m,
                                (double)(i / columns) * plane->spacing_m, 0};
    td_pose_transform(p, &plane->target_from_plane, on_plane);
}

bool td_target_is_flat(const td_target *target)
{
    const double z[3] = {0, 0, 1};
    double normal[3], origin[3], size = 0, height = 0;
    td_pose_rotate(normal, &target->plane[0].target_from_plane, z);
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

static td_status check_spacing(const char *where, double spacing, td_error *error)
{
    if (spacing >= SMALLEST_SPACING_M && spacing <= LARGEST_SPACING_M) return TD_OK;
    char seen[TD_NUMBER_SIZE], low[TD_NUMBER_SIZE], high[TD_NUMBER_SIZE], hint[HINT_SIZE];
    return td_fail(error, TD_ERROR_ARGUMENT, "%sspacing_m: is %s metres, but must lie between %s and %s%s",
                   where, td_number_format(seen, spacing, 0), td_number_format(low, SMALLEST_SPACING_M, 0),
                   td_number_format(high, LARGEST_SPACING_M, 0),
                   millimetre_hint(hint, spacing, SMALLEST_SPACING_M, LARGEST_SPACING_M));
}

static td_status check_plane(const td_target *target, int index, td_error *error)
{
    const td_target_plane *plane = target->plane + index;
    const int low = target->kind == TD_TARGET_CHESSBOARD ? SMALLEST_CHESSBOARD_SIDE : SMALLEST_SIDE;
    char where[32] = "";
    if (target->plane_count > 1) snprintf(where, sizeof where, "planes[%d].", index);
    TD_TRY(check_side(where, "columns", plane->columns, low, error));
    TD_TRY(check_side(where, "rows", plane->rows, low, error));
    TD_TRY(check_spacing(where, plane->spacing_m, error));
    const double *q = plane->target_from_plane.q, *t = plane->target_from_plane.t;
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(fabs(length - 1) <= QUATERNION_TOLERANCE))
        return td_fail(error, TD_ERROR_ARGUMENT, "%starget_from_plane.q: must be a unit quaternion", where);
    if (!isfinite(t[0] + t[1] + t[2]))
        return td_fail(error, TD_ERROR_ARGUMENT, "%starget_from_plane.t_m: must be finite", where);
    return TD_OK;
}

static td_status check_marks(const td_target *target, td_error *error)
{
    if ((unsigned)target->polarity > TD_MARK_ANY)
        return td_fail(error, TD_ERROR_ARGUMENT, "polarity: must be dark, light or any");
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

td_status td_target_check(const td_target *target, td_error *error)
{
    if (!td_target_kind_name(target->kind))
        return td_fail(error, TD_ERROR_ARGUMENT, "kind: must be chessboard or marks");
    const int most = target->kind == TD_TARGET_CHESSBOARD ? 1 : TD_TARGET_MAX_PLANES;
    if (target->plane_count < 1 || target->plane_count > most)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "planes: a target of %s has %d planes, but must have 1 to %d",
                       td_target_kind_name(target->kind), target->plane_count, most);
    for (int i = 0; i < target->plane_count; i++) TD_TRY(check_plane(target, i, error));
    if (target->kind == TD_TARGET_MARKS) return check_marks(target, error);
    if (target->diameter_m != 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "diameter_m: a chessboard has none");
    return TD_OK;
}

char *td_target_describe(char *text, size_t size, const td_target *target)
{
    td_text out = {0};
    char length[LENGTH_TEXT_SIZE];
    const char *kind = td_target_kind_name(target->kind);
    td_text_format(&out, "%s", kind ? kind : "unknown target");
    if (target->plane_count > 1) td_text_format(&out, " on %d planes:", target->plane_count);
    for (int i = 0; i < target->plane_count; i++) {
        const td_target_plane *p = target->plane + i;
        td_text_format(&out, "%s %dx%d, %s", i ? ";" : "", p->columns, p->rows,
                       millimetres(length, p->spacing_m));
    }
    if (target->kind == TD_TARGET_MARKS)
        td_text_format(&out, "%s diameter %s", target->plane_count > 1 ? ";" : ",",
                       millimetres(length, target->diameter_m));
    snprintf(text, size, "%s", out.data ? out.data : "");
    free(out.data);
    return text;
}

/* ---- from a document ---- */

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

/* Index of the text among the names. */
static td_status parse_choice(int *choice, const td_field *field, const char *const names[], const char *list,
                              td_error *error)
{
    const char *text = NULL;
    TD_TRY(td_field_string(&text, field, error));
    for (int i = 0; names[i]; i++)
        if (!strcmp(text, names[i])) {
            *choice = i;
            return TD_OK;
        }
    char shown[TD_SHOWN_SIZE];
    return td_field_fail(field, error, "is '%s', but must be %s", td_text_shown(shown, text), list);
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
    if (polarity.value) TD_TRY(parse_choice(&choice, &polarity, polarity_names, "dark, light or any", error));
    target->polarity = (td_mark_polarity)choice;
    return TD_OK;
}

td_status td_target_parse(td_target *target, const td_field *field, td_error *error)
{
    static const char *const kinds[] = {"chessboard", "marks", NULL};
    static const char *const chessboard[] = {"kind", "columns", "rows", "spacing_m", NULL};
    td_target read = {.plane_count = 1, .polarity = TD_MARK_ANY};
    td_field kind = td_field_get(field, "kind");
    int choice = 0;
    if (!json_is_object(field->value)) return td_field_check_keys(field, chessboard, error);
    TD_TRY(parse_choice(&choice, &kind, kinds, "chessboard or marks", error));
    read.kind = (td_target_kind)choice;
    if (read.kind == TD_TARGET_CHESSBOARD) {
        TD_TRY(td_field_check_keys(field, chessboard, error));
        TD_TRY(parse_grid(read.plane, field, error));
    } else {
        TD_TRY(parse_marks(&read, field, error));
    }
    td_error why;
    if (td_target_check(&read, &why) != TD_OK) return td_field_fail(field, error, "%s", why.message);
    *target = read;
    return TD_OK;
}
