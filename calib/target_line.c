/* A target as the line that a dataset.yaml holds. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "calib/target_drawing.h"
#include "core/number.h"

typedef struct line {
    char *text;
    size_t size, length; /* the length it would have */
} line;

static void put(line *l, const char *format, ...) TD_PRINTF(2, 3);
static void put(line *l, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    size_t at = l->length < l->size ? l->length : l->size;
    l->length += (size_t)vsnprintf(l->text + at, l->size - at, format, arguments);
    va_end(arguments);
}

/* Twelve digits: 0.088 times 1.3 is 0.1144. */
static void put_real(line *l, const char *before, double value)
{
    char number[TD_NUMBER_SIZE];
    put(l, "%s%s", before, td_number_format(number, value, 12));
}

static void put_pose(line *l, const char *name, const td_pose *pose)
{
    put(l, ", %s: {q: [", name);
    for (int i = 0; i < 4; i++) put_real(l, i ? ", " : "", pose->q[i] + 0.0);
    put(l, "], t_m: [");
    for (int i = 0; i < 3; i++) put_real(l, i ? ", " : "", pose->t[i] + 0.0);
    put(l, "]}");
}

static void put_grid(line *l, const td_target_plane *p)
{
    put(l, "columns: %d, rows: %d", p->columns, p->rows);
    put_real(l, ", spacing_m: ", p->spacing_m);
}

static void put_marks(line *l, const td_target *target)
{
    static const char *const polarity[] = {"dark", "light", "any"};
    if (target->plane_count == 1) {
        put(l, ", ");
        put_grid(l, target->plane);
    } else {
        put(l, ", planes: [");
        for (int i = 0; i < target->plane_count; i++) {
            put(l, "%s{", i ? ", " : "");
            put_grid(l, target->plane + i);
            put_pose(l, "target_from_plane", &target->plane[i].target_from_plane);
            put(l, "}");
        }
        put(l, "]");
    }
    put_real(l, ", diameter_m: ", target->diameter_m);
    put(l, ", polarity: %s", polarity[target->polarity]);
}

static void put_tag_grid(line *l, const td_target *target)
{
    const bool grid = target->kind == TD_TARGET_APRILGRID;
    put(l, ", ");
    put_grid(l, target->plane);
    put_real(l, ", tag_size_m: ", target->tag_size_m);
    put(l, ", dictionary: %s", target->dictionary);
    if (grid) put(l, ", border: %d", target->border);
    if (target->first_id) put(l, ", first_id: %d", target->first_id);
    if (grid && target->order == TD_TAGS_DOWNWARD) put(l, ", order: downward");
    if (!grid && target->legacy) put(l, ", legacy: true");
}

static void put_tags(line *l, const td_target *target)
{
    put(l, ", dictionary: %s, border: %d, tags: [", target->dictionary, target->border);
    for (int i = 0; i < target->tag_count; i++) {
        const td_target_tag *tag = target->tag + i;
        put(l, "%s{id: %d", i ? ", " : "", tag->id);
        put_real(l, ", size_m: ", tag->size_m);
        if (target->tag_count > 1) put_pose(l, "target_from_tag", &tag->target_from_tag);
        put(l, "}");
    }
    put(l, "]");
}

char *td_target_dataset_line(char *text, size_t size, const td_target *target)
{
    line l = {text, size, 0};
    const char *kind = td_target_kind_name(target->kind);
    put(&l, "target: {kind: %s", kind ? kind : "unknown");
    if (target->kind == TD_TARGET_CHESSBOARD) {
        put(&l, ", ");
        put_grid(&l, target->plane);
    } else if (target->kind == TD_TARGET_MARKS) {
        put_marks(&l, target);
    } else if (target->kind == TD_TARGET_TAGS) {
        put_tags(&l, target);
    } else if (kind) {
        put_tag_grid(&l, target);
    }
    put(&l, "}");
    return text;
}
