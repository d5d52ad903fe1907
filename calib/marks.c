/* The detector of marks as a whole, and its words. */
#include "calib/marks.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/homography.h"
#include "calib/marks_internal.h"

/* Share by which the marks' diameter may differ from the target's before it is worth a remark. */
static const double DIAMETER_TOLERANCE = 0.15;
/* Blur above which, and width below which (px), the message mentions it. */
static const double BLURRED = 2.5, NARROW = 3;

/* Appends to a text of limited size. */
TD_PRINTF(3, 4) static void append(char *text, size_t size, const char *format, ...)
{
    size_t length = strlen(text);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text + length, size - length, format, arguments);
    va_end(arguments);
}

/* ---- What is asked. ---- */

/* At least one choice of 4 clicks of a plane must have no three on a line. */
static td_status check_spread(const td_target *target, int plane, const td_click *click, size_t clicks,
                              td_error *error)
{
    double point[2 * TD_MAX_CLICKS], h[9];
    size_t n = 0, first;
    for (size_t i = 0; i < clicks; i++) {
        if (td_target_plane_of(target, click[i].index, &first) != plane) continue;
        size_t columns = (size_t)target->plane[plane].columns;
        point[2 * n] = (double)((click[i].index - first) % columns);
        point[2 * n + 1] = (double)((click[i].index - first) / columns);
        n++;
    }
    if (n >= 4 && td_homography(h, point, point, n, NULL) != TD_OK)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "the %zu clicks on plane %d lie on a line but for one: choose marks of which no three are in "
            "line, such as the corners",
            n, plane + 1);
    return TD_OK;
}

static td_status check_clicks(const td_target *target, const td_click *click, size_t clicks, td_error *error)
{
    if (clicks == 0) return TD_OK;
    const size_t points = td_target_point_count(target);
    if (!click) return td_fail(error, TD_ERROR_ARGUMENT, "clicks are announced but not given");
    if (clicks < 4 || clicks > TD_MAX_CLICKS)
        return td_fail(error, TD_ERROR_ARGUMENT, "%zu clicks: give 4 to %d, or none", clicks, TD_MAX_CLICKS);
    for (size_t i = 0; i < clicks; i++) {
        if (click[i].index >= points)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "click %zu: there is no mark %zu, the target has %zu (from 0)", i + 1,
                           click[i].index, points);
        if (!isfinite(click[i].pixel[0]) || !isfinite(click[i].pixel[1]))
            return td_fail(error, TD_ERROR_ARGUMENT, "click %zu: its pixel is not a number", i + 1);
        for (size_t k = 0; k < i; k++)
            if (click[k].index == click[i].index)
                return td_fail(error, TD_ERROR_ARGUMENT, "clicks %zu and %zu are both for mark %zu", k + 1,
                               i + 1, click[i].index);
    }
    for (int p = 0; p < target->plane_count; p++) TD_TRY(check_spread(target, p, click, clicks, error));
    return TD_OK;
}

/* ---- Numbering the marks of one polarity. ---- */

static size_t covered(const td_numbering *n)
{
    size_t sum = 0, points = td_target_point_count(n->target);
    for (size_t i = 0; i < points; i++) sum += n->of_point[i] >= 0;
    return sum;
}

static td_status number_marks(td_numbering *n, const td_target *target, const td_mark *mark, size_t marks,
                              const td_click *click, size_t clicks, td_error *error)
{
    size_t points = td_target_point_count(target);
    *n = (td_numbering){.target = target, .mark = mark, .marks = marks};
    n->of_point = malloc(points * sizeof *n->of_point);
    if (!n->of_point) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", points);
    for (size_t i = 0; i < points; i++) n->of_point[i] = -1;
    td_status status = td_marks_number_clicked(n, click, clicks, error);
    if (status == TD_OK && !n->refused) status = td_marks_number(n, click, clicks, error);
    for (size_t i = 0; i < points && n->refused; i++) n->of_point[i] = -1;
    return status;
}

/* The numbering that tells more. */
static bool is_better(const td_numbering *a, const td_numbering *b)
{
    size_t ca = covered(a), cb = covered(b);
    if (ca != cb) return ca > cb;
    if (a->grid_marks != b->grid_marks) return a->grid_marks > b->grid_marks;
    return a->marks > b->marks;
}

/* Dark marks first; returns how many. */
static size_t sort_dark_first(td_mark *mark, size_t count)
{
    size_t dark = 0;
    for (size_t i = 0; i < count; i++) {
        if (mark[i].inside > mark[i].outside) continue;
        td_mark m = mark[i];
        mark[i] = mark[dark];
        mark[dark++] = m;
    }
    return dark;
}

/* The better numbering of the dark and of the light marks. */
static td_status number_any(td_numbering *n, bool *light, const td_target *target, td_mark *mark,
                            size_t count, const td_click *click, size_t clicks, td_error *error)
{
    td_numbering other;
    size_t dark = sort_dark_first(mark, count);
    *light = false;
    TD_TRY(number_marks(n, target, mark, dark, click, clicks, error));
    if (dark == count) return TD_OK;
    td_status status = number_marks(&other, target, mark + dark, count - dark, click, clicks, error);
    if (status == TD_OK && is_better(&other, n)) {
        td_numbering worse = *n;
        *n = other;
        other = worse;
        *light = true;
    }
    free(other.of_point);
    return status;
}

/* ---- What is told. ---- */

static const char *polarity_word(td_mark_polarity polarity)
{
    return polarity == TD_MARK_DARK ? "dark " : polarity == TD_MARK_LIGHT ? "light " : "";
}

/* Appends "6x6 dark marks", "5x4 and 5x4 marks". */
static void describe_wanted(char *text, size_t size, const td_target *target)
{
    for (int i = 0; i < target->plane_count; i++)
        append(text, size, "%s%dx%d", i ? " and " : "", target->plane[i].columns, target->plane[i].rows);
    append(text, size, " %smarks", polarity_word(target->polarity));
}

/* What stands against the largest grid that was seen. */
static const char *objection(const td_numbering *n)
{
    for (int i = 0; i < n->target->plane_count; i++) {
        const td_target_plane *p = &n->target->plane[i];
        bool along = n->grid_columns == p->columns && n->grid_rows == p->rows;
        bool across = n->grid_columns == p->rows && n->grid_rows == p->columns;
        if (along || across) return "too few of its marks are seen to be sure";
        int longer = p->columns > p->rows ? p->columns : p->rows, shorter = p->columns + p->rows - longer;
        int seen = n->grid_columns > n->grid_rows ? n->grid_columns : n->grid_rows;
        if (seen > longer || n->grid_columns + n->grid_rows - seen > shorter)
            return "is the target's size right?";
    }
    return "is an outer row hidden, or is the target's size wrong?";
}

/* What makes marks hard to find, if it shows. */
static td_status tell_quality(char *text, size_t size, const td_numbering *n, td_error *error)
{
    double *value = malloc((n->marks + 1) * sizeof *value), axes[2];
    if (!value) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", n->marks);
    for (size_t i = 0; i < n->marks; i++) value[i] = n->mark[i].blur;
    double blur = td_marks_median(value, n->marks);
    for (size_t i = 0; i < n->marks; i++) {
        td_mark_axes(axes, &n->mark[i]);
        value[i] = 2 * axes[0];
    }
    double width = td_marks_median(value, n->marks);
    free(value);
    if (blur > BLURRED) append(text, size, "; they are blurred by %.1f px", blur);
    if (width < NARROW) append(text, size, "; they are only %.1f px wide", width);
    return TD_OK;
}

/* Why the target was not found. */
static td_status tell_missing(char *text, size_t size, const td_numbering *n, td_error *error)
{
    append(text, size, "looked for ");
    describe_wanted(text, size, n->target);
    if (!n->marks) {
        append(text, size, ", saw no round %smark", polarity_word(n->target->polarity));
        return TD_OK;
    }
    append(text, size, ", saw %zu round mark%s", n->marks, n->marks > 1 ? "s" : "");
    if (n->refused)
        append(text, size, ", but %s", n->note);
    else if (!n->grid_marks)
        append(text, size, " and no grid among %s", n->marks > 1 ? "them" : "it");
    else {
        if (n->grid_marks == n->marks)
            append(text, size, ", all");
        else
            append(text, size, ", %zu", n->grid_marks);
        append(text, size, " of them in a %dx%d grid: %s", n->grid_columns, n->grid_rows,
               n->note[0] ? n->note : objection(n));
    }
    return tell_quality(text, size, n, error);
}

/* What a user should know of a target that was found. */
static td_status tell_remarks(char *text, size_t size, const td_numbering *n, td_error *error)
{
    size_t points = td_target_point_count(n->target), seen = covered(n);
    if (seen < points) append(text, size, "%zu of %zu marks seen", seen, points);
    for (int i = 0; i < n->target->plane_count; i++)
        if (!n->seen[i]) append(text, size, "; plane %d not seen", i + 1);
    if (n->note[0]) append(text, size, ": %s", n->note);
    for (int i = 0; i < n->target->plane_count; i++) {
        double diameter, wanted = n->target->diameter_m;
        if (!n->seen[i]) continue;
        TD_TRY(td_numbered_diameter(&diameter, n, i, error));
        diameter *= n->target->plane[i].spacing_m;
        if (!(fabs(diameter - wanted) > DIAMETER_TOLERANCE * wanted)) continue;
        append(text, size, "%sthe marks are about %.3g mm wide, the target says %.3g mm", text[0] ? "; " : "",
               1e3 * diameter, 1e3 * wanted);
        break;
    }
    return TD_OK;
}

/* If the target is there in the other polarity, the message says so. */
static td_status hint_polarity(char *text, size_t size, const td_image *image, const td_target *target,
                               td_error *error)
{
    if (target->polarity == TD_MARK_ANY) return TD_OK;
    td_mark_polarity other = target->polarity == TD_MARK_DARK ? TD_MARK_LIGHT : TD_MARK_DARK;
    td_mark *mark;
    size_t count;
    td_numbering n = {0};
    TD_TRY(td_marks_find(&mark, &count, image, other, error));
    td_status status = number_marks(&n, target, mark, count, NULL, 0, error);
    if (status == TD_OK && covered(&n))
        append(text, size, "; but %zu %smarks form such a grid: is the polarity right?", covered(&n),
               polarity_word(other));
    free(n.of_point);
    free(mark);
    return status;
}

static td_status fill(td_detection *detection, const td_numbering *n, td_error *error)
{
    double *blur = malloc(detection->count * sizeof *blur);
    if (!blur) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", detection->count);
    size_t seen = 0;
    for (size_t i = 0; i < detection->count; i++) {
        if (n->of_point[i] < 0) continue;
        const td_mark *m = &n->mark[n->of_point[i]];
        detection->point[2 * i] = m->centre[0];
        detection->point[2 * i + 1] = m->centre[1];
        detection->sigma[i] = m->sigma;
        blur[seen++] = m->blur;
    }
    detection->blur_px = td_marks_median(blur, seen);
    free(blur);
    detection->found = true;
    return tell_remarks(detection->reason, sizeof detection->reason, n, error);
}

static td_status detect(td_detection *detection, td_mark **mark, td_numbering *n, const td_image *image,
                        const td_target *target, const td_click *click, size_t clicks, td_error *error)
{
    size_t count;
    bool light;
    TD_TRY(td_marks_find(mark, &count, image, target->polarity, error));
    TD_TRY(number_any(n, &light, target, *mark, count, click, clicks, error));
    if (covered(n)) {
        TD_TRY(td_marks_recover(n, mark, image, error));
        return fill(detection, n, error);
    }
    TD_TRY(tell_missing(detection->reason, sizeof detection->reason, n, error));
    return hint_polarity(detection->reason, sizeof detection->reason, image, target, error);
}

td_status td_marks_detect(td_detection *detection, const td_image *image, const td_target *target,
                          const td_click *click, size_t click_count, td_error *error)
{
    *detection = (td_detection){.blur_px = NAN};
    TD_TRY(td_target_check(target, error));
    if (target->kind != TD_TARGET_MARKS)
        return td_fail(error, TD_ERROR_ARGUMENT, "the target is a %s, not marks",
                       td_target_kind_name(target->kind));
    TD_TRY(check_clicks(target, click, click_count, error));
    TD_TRY(td_detection_init(detection, td_target_point_count(target), error));
    td_mark *mark = NULL;
    td_numbering n = {0};
    td_status status = detect(detection, &mark, &n, image, target, click, click_count, error);
    free(n.of_point);
    free(mark);
    if (status != TD_OK) td_detection_free(detection);
    return status;
}
