/* The shapes of each kind of target. */
#include <math.h>

#include "calib/charuco_internal.h"
#include "calib/tag_dictionary.h"
#include "calib/target_sheet_internal.h"

static const double MM = 1000;         /* in a metre */
static const double TAG_QUIET = 0.25;  /* of a tag's side */
static const double SAME_PLANE = 1e-9; /* m, and of a unit vector */

static void rectangle(td_sheet *sheet, int group, double x, double y, double width, double height)
{
    td_sheet_add(sheet, (td_shape){TD_SHAPE_RECTANGLE, false, group, x, y, width, height});
}

/* Whether the square in column i and row j of the squares is dark. The one at the upper left of a chessboard
 * is, which numbers its corners (chessboard.h). */
static bool square_is_dark(const td_target *target, int i, int j)
{
    const td_charuco_layout layout = td_charuco_layout_of(target);
    return td_charuco_square_is_dark(&layout, i, j);
}

static void draw_squares(td_sheet *sheet, const td_target *target)
{
    const td_target_plane *p = target->plane;
    const double s = p->spacing_m * MM;
    for (int j = 0; j <= p->rows; j++)
        for (int i = 0; i <= p->columns; i++)
            if (square_is_dark(target, i, j))
                rectangle(sheet, td_sheet_group(sheet), (i - 1) * s, (j - 1) * s, s, s);
}

/* A tag with its upper left corner at (x, y): a rectangle for each run of dark cells in a row. */
static td_status draw_tag(td_sheet *sheet, const td_target *target, int id, double x, double y, double size,
                          td_error *error)
{
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    int side = 0, group = td_sheet_group(sheet);
    TD_TRY(td_tag_cells(cell, &side, target->dictionary, target->border, id, error));
    for (int r = 0; r < side; r++)
        for (int c = 0; c < side; c++) {
            int first = c;
            while (c < side && !cell[r * side + c]) c++;
            if (c > first)
                rectangle(sheet, group, x + size * first / side, y + size * r / side,
                          size * (c - first) / side, size / side);
        }
    return TD_OK;
}

static td_status draw_markers(td_sheet *sheet, const td_target *target, td_error *error)
{
    const td_target_plane *p = target->plane;
    const double s = p->spacing_m * MM, size = target->tag_size_m * MM, gap = (s - size) / 2;
    int id = target->first_id;
    for (int j = 0; j <= p->rows; j++)
        for (int i = 0; i <= p->columns; i++)
            if (!square_is_dark(target, i, j))
                TD_TRY(draw_tag(sheet, target, id++, (i - 1) * s + gap, (j - 1) * s + gap, size, error));
    return TD_OK;
}

/* Light marks lie on a dark ground that reaches half a spacing beyond them. */
static void draw_marks(td_sheet *sheet, const td_target *target, const td_target_plane *p)
{
    const double s = p->spacing_m * MM, d = target->diameter_m * MM;
    const bool light = target->polarity == TD_MARK_LIGHT;
    if (light) {
        td_pattern_box box;
        td_pattern_measure(&box, target, (int)(p - target->plane));
        rectangle(sheet, td_sheet_group(sheet), box.x0, box.y0, box.x1 - box.x0, box.y1 - box.y0);
    }
    for (int j = 0; j < p->rows; j++)
        for (int i = 0; i < p->columns; i++)
            td_sheet_add(sheet, (td_shape){TD_SHAPE_ELLIPSE, light, td_sheet_group(sheet), i * s - d / 2,
                                           j * s - d / 2, d, d});
}

/* Kalibr fills the places where four gaps meet: tags with a border of two cells are drawn so. */
static bool has_corner_squares(const td_target *target)
{
    return target->kind == TD_TARGET_APRILGRID && target->border == 2;
}

static td_status draw_aprilgrid(td_sheet *sheet, const td_target *target, td_error *error)
{
    const td_target_plane *p = target->plane;
    const double s = p->spacing_m * MM, size = target->tag_size_m * MM, gap = s - size;
    for (int j = 0; j < p->rows; j++)
        for (int i = 0; i < p->columns; i++) {
            int id = td_target_tag_id(target, 4 * (size_t)(j * p->columns + i));
            TD_TRY(draw_tag(sheet, target, id, i * s, j * s, size, error));
        }
    for (int j = 0; has_corner_squares(target) && j <= p->rows; j++)
        for (int i = 0; i <= p->columns; i++)
            rectangle(sheet, td_sheet_group(sheet), i * s - gap, j * s - gap, gap, gap);
    return TD_OK;
}

/* Where tag `other` lies in tag `tag`'s frame, mm; false when it lies on another plane or is turned. */
static bool on_sheet(double centre[2], const td_target *target, int tag, int other)
{
    td_pose to = td_pose_inverse(&target->tag[tag].target_from_tag);
    td_pose pose = td_pose_compose(&to, &target->tag[other].target_from_tag);
    for (int i = 0; i < 2; i++) centre[i] = pose.t[i] * MM;
    double turn = hypot(hypot(pose.q[1], pose.q[2]), pose.q[3]);
    return fabs(pose.t[2]) < SAME_PLANE && turn < SAME_PLANE;
}

static td_status draw_tags(td_sheet *sheet, const td_target *target, int tag, td_error *error)
{
    double centre[2];
    for (int i = 0; i < target->tag_count; i++) {
        const double size = target->tag[i].size_m * MM;
        if (!on_sheet(centre, target, tag, i)) continue;
        TD_TRY(draw_tag(sheet, target, target->tag[i].id, centre[0] - size / 2, centre[1] - size / 2, size,
                        error));
    }
    return TD_OK;
}

static void measure_tags(td_pattern_box *box, const td_target *target, int tag)
{
    double centre[2];
    *box = (td_pattern_box){INFINITY, INFINITY, -INFINITY, -INFINITY, 0};
    for (int i = 0; i < target->tag_count; i++) {
        const double half = target->tag[i].size_m * MM / 2;
        if (!on_sheet(centre, target, tag, i)) continue;
        box->x0 = fmin(box->x0, centre[0] - half), box->x1 = fmax(box->x1, centre[0] + half);
        box->y0 = fmin(box->y0, centre[1] - half), box->y1 = fmax(box->y1, centre[1] + half);
        box->quiet = fmax(box->quiet, TAG_QUIET * 2 * half);
    }
}

void td_pattern_measure(td_pattern_box *box, const td_target *target, int plane)
{
    if (target->kind == TD_TARGET_TAGS) {
        measure_tags(box, target, plane);
        return;
    }
    const td_target_plane *p = target->plane + plane;
    const double s = p->spacing_m * MM, d = target->diameter_m * MM, size = target->tag_size_m * MM;
    double before = s, after = s, quiet = s / 2; /* of the first point, of the last */
    if (target->kind == TD_TARGET_MARKS) {
        before = after = target->polarity == TD_MARK_LIGHT ? (d + s) / 2 : d / 2;
    } else if (target->kind == TD_TARGET_APRILGRID) {
        before = has_corner_squares(target) ? s - size : 0;
        after = before + size;
        quiet = TAG_QUIET * size;
    }
    *box = (td_pattern_box){-before, -before, (p->columns - 1) * s + after, (p->rows - 1) * s + after, quiet};
}

td_status td_pattern_draw(td_sheet *sheet, const td_target *target, int plane, td_error *error)
{
    switch (target->kind) {
    case TD_TARGET_CHESSBOARD:
        draw_squares(sheet, target);
        return TD_OK;
    case TD_TARGET_MARKS:
        draw_marks(sheet, target, target->plane + plane);
        return TD_OK;
    case TD_TARGET_APRILGRID:
        return draw_aprilgrid(sheet, target, error);
    case TD_TARGET_TAGS:
        return draw_tags(sheet, target, plane, error);
    case TD_TARGET_CHARUCO:
        draw_squares(sheet, target);
        return draw_markers(sheet, target, error);
    case TD_TARGET_KIND_COUNT:
        break;
    }
    return td_fail(error, TD_ERROR_ARGUMENT, "no drawing for targets of kind %d", (int)target->kind);
}
