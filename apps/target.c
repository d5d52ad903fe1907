/* teledimos target: a calibration target on paper, at true scale. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "calib/tag_dictionary.h"
#include "calib/target_drawing.h"
#include "core/document.h"
#include "core/schema.h"

static const double MM = 1000;
static const double GAP_RATIO = 0.3, MARKER_SHARE = 0.75, MARK_SHARE = 0.5, SHEET_STEP = 1.5;
static const double FIT_SPACING_MM = 25, FIT_TAG_MM = 50; /* on a page that has no size of its own */
enum { LARGEST_MM = 5000 };

static const char *kind_name, *output, *dictionary, *order = "upward", *polarity = "dark", *page = "a4",
                                                    *measured, *ids = "0";
static int columns, rows, border, first_id;
static double spacing_mm, tag_size_mm, diameter_mm, margin_mm, dpi = 600;
static bool legacy, no_text, no_ruler, json, list_schema, quiet;

static const char *const order_words[] = {"upward", "downward", NULL};
static const char *const polarity_words[] = {"dark", "light", NULL};

static cli_option options[] = {
    {.type = CLI_HEADING, .name = "The target"},
    {CLI_INT, "columns", 0, &columns, "N",
     "inner corners, marks or tags along a row; default: 9 (aprilgrid 6, marks 7, tags: as many as make a "
     "square)",
     1, 200, NULL},
    {CLI_INT, "rows", 0, &rows, "N", "rows of them; default: 6 (aprilgrid 4, marks 5)", 1, 200, NULL},
    {CLI_REAL, "spacing-mm", 0, &spacing_mm, "MM",
     "side of a square, or from one mark or tag to the next; default: the largest whole number that fits the "
     "page",
     0.1, 10000, NULL},
    {CLI_REAL, "tag-size-mm", 0, &tag_size_mm, "MM",
     "side of a tag's black square; default: aprilgrid: spacing/1.3, charuco: 3/4 of a square, tags: the "
     "largest "
     "whole number that fits the page",
     0.1, 10000, NULL},
    {CLI_REAL, "diameter-mm", 0, &diameter_mm, "MM", "of a mark; default: half the spacing", 0.1, 10000,
     NULL},
    {CLI_STRING, "polarity", 0, &polarity, "WORD", "marks: dark (default) or light", 0, 0, polarity_words},
    {CLI_STRING, "dictionary", 0, &dictionary, "NAME",
     "tag36h11 (default), tag25h9, tag16h5, aruco4x4_50 to aruco7x7_1000, aruco_original; charuco: the "
     "smallest of "
     "aruco4x4_… that has enough markers",
     0, 0, NULL},
    {CLI_INT, "border", 0, &border, "N",
     "cells of a tag's black border: 1 as libapriltag's, 2 as Kalibr's, drawn with its small corner squares; "
     "default: aprilgrid 2, others 1",
     1, 2, NULL},
    {CLI_STRING, "ids", 0, &ids, "LIST", "tags: their numbers, as 0,3,7-9; default: 0", 0, 0, NULL},
    {CLI_INT, "first-id", 0, &first_id, "N", "aprilgrid, charuco: number of the first tag; default: 0", 0,
     1000000, NULL},
    {CLI_STRING, "order", 0, &order, "WORD",
     "aprilgrid: numbered upward from the lowest row (default, as Kalibr does) or downward", 0, 0,
     order_words},
    {CLI_FLAG, "legacy", 0, &legacy, NULL,
     "charuco: as OpenCV before 4.6 drew boards with an even number of rows of squares, a marker at the "
     "upper left",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "The paper"},
    {CLI_STRING, "output", 'o', &output, "FILE", "drawing to write: .pdf, .svg or .png (needed)", 0, 0, NULL},
    {CLI_STRING, "page", 0, &page, "SIZE",
     "a4 (default), a3, a2, a1, a0, letter, 420x594 (mm), upright or not as fits better; fit: as large as "
     "needed",
     0, 0, NULL},
    {CLI_REAL, "margin-mm", 0, &margin_mm, "MM",
     "white around the target; never less than detectors need, the default: half a square or a quarter of a "
     "tag",
     0, 1000, NULL},
    {CLI_REAL, "dpi", 0, &dpi, "N", "of a PNG; default: 600", 10, 4800, NULL},
    {CLI_STRING, "measured", 0, &measured, "READING/LENGTH",
     "what the printed rulers measure over what they say, to correct a printer's scale: 200.3/200, or across "
     "and "
     "down: 200.3/200,149.8/150",
     0, 0, NULL},
    {CLI_FLAG, "no-ruler", 0, &no_ruler, NULL, "no rulers", 0, 0, NULL},
    {CLI_FLAG, "no-text", 0, &no_text, NULL, "no parameters beside the target", 0, 0, NULL},
    {.type = CLI_HEADING, .name = "Everywhere"},
    {CLI_FLAG, "json", 0, &json, NULL, "the result as JSON on standard output instead of a table", 0, 0,
     NULL},
    {CLI_FLAG, "schema", 0, &list_schema, NULL, "list the result's keys with types and units, and end", 0, 0,
     NULL},
    {CLI_FLAG, "quiet", 'q', &quiet, NULL, "nothing on standard output but --json", 0, 0, NULL},
};

static cli_command command = {
    .name = "target",
    .summary = "print a calibration target at true scale",
    .usage = "chessboard|marks|aprilgrid|charuco|tags -o FILE [options]",
    .text = "Draws a target with rulers beside it, and says what to put into dataset.yaml. Print it at 100 "
            "%, measure "
            "the rulers, and if they differ draw it again with --measured. Glue it to something stiff and "
            "flat: paper "
            "alone bends by millimetres.",
    .examples = "  teledimos target chessboard -o board.pdf\n"
                "  teledimos target charuco --columns 11 --rows 8 --spacing-mm 27 --page a3 -o board.svg\n"
                "  teledimos target aprilgrid --columns 6 --rows 6 --tag-size-mm 88 --page fit -o grid.pdf\n"
                "  teledimos target tags --ids 0-3 --tag-size-mm 60 -o tags.pdf\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &kind_name,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "target"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"description", TD_SCHEMA_STRING, true, false, "of the target, for people"},
    {"dataset_line", TD_SCHEMA_STRING, true, false, "to put into dataset.yaml"},
    {"page_size_m", TD_SCHEMA_REALS, true, false, "width, height"},
    {"printer_scale", TD_SCHEMA_REALS, true, false, "the drawing was divided by, across and down"},
    {"products", TD_SCHEMA_STRINGS, true, false, "file names"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

/* ---- From the options ---- */

static td_status parse_ids(td_target *target, td_error *error)
{
    const char *at = ids;
    target->tag_count = 0;
    do {
        int first, last, used = 0;
        if (sscanf(at, "%d%n", &first, &used) != 1) break;
        at += used, last = first, used = 0;
        if (*at == '-' && sscanf(at, "-%d%n", &last, &used) == 1) at += used;
        if (last < first || last - first >= TD_TARGET_MAX_TAGS - target->tag_count)
            return td_fail(error, TD_ERROR_ARGUMENT, "--ids %s: a sheet has 1 to %d tags, in rising ranges",
                           ids, TD_TARGET_MAX_TAGS);
        while (first <= last) target->tag[target->tag_count++].id = first++;
    } while (*at == ',' && *++at);
    if (*at || !target->tag_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "--ids %s: write numbers and ranges with commas, as 0,3,7-9",
                       ids);
    return TD_OK;
}

static int markers_needed(const td_target *target)
{
    return target->first_id + td_target_tag_count(target);
}

/* The smallest dictionary of 4x4 cells that has enough markers. */
static const char *default_dictionary(const td_target *target)
{
    static const char *const name[] = {"aruco4x4_50", "aruco4x4_100", "aruco4x4_250", "aruco4x4_1000"};
    if (target->kind != TD_TARGET_CHARUCO) return "tag36h11";
    int i = 0;
    while (i < 3 && td_tag_count(name[i]) < markers_needed(target)) i++;
    return name[i];
}

static td_status choose_dictionary(td_target *target, td_error *error)
{
    if (target->kind == TD_TARGET_CHESSBOARD || target->kind == TD_TARGET_MARKS) return TD_OK;
    const char *name = dictionary ? dictionary : default_dictionary(target);
    const int count = td_tag_count(name);
    if (!count) {
        uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
        int side;
        return td_error_prefix(error, td_tag_cells(cell, &side, name, 1, 0, error), "--dictionary %s", name);
    }
    snprintf(target->dictionary, sizeof target->dictionary, "%s", name);
    if (target->kind != TD_TARGET_TAGS && markers_needed(target) > count)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--dictionary %s: has %d tags, but this target needs the numbers %d to %d", name,
                       count, target->first_id, markers_needed(target) - 1);
    return TD_OK;
}

static td_status begin_target(td_target *target, td_error *error)
{
    static const int usual[TD_TARGET_KIND_COUNT][2] = {{9, 6}, {7, 5}, {6, 4}, {0, 0}, {9, 6}};
    *target = (td_target){.kind = TD_TARGET_KIND_COUNT, .plane_count = 1};
    for (int k = 0; k < TD_TARGET_KIND_COUNT; k++)
        if (strcmp(kind_name, td_target_kind_name((td_target_kind)k)) == 0) target->kind = (td_target_kind)k;
    if (target->kind == TD_TARGET_KIND_COUNT)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "'%.60s' is no kind of target; there are chessboard, marks, aprilgrid, charuco and tags",
            kind_name);
    td_target_plane *p = target->plane;
    p->columns = columns ? columns : usual[target->kind][0];
    p->rows = rows ? rows : usual[target->kind][1];
    p->target_from_plane = td_pose_identity();
    target->polarity = strcmp(polarity, "light") == 0 ? TD_MARK_LIGHT : TD_MARK_DARK;
    target->order = strcmp(order, "downward") == 0 ? TD_TAGS_DOWNWARD : TD_TAGS_UPWARD;
    if (target->kind != TD_TARGET_MARKS) target->polarity = TD_MARK_DARK;
    if (target->kind == TD_TARGET_TAGS) {
        target->plane_count = 0;
        TD_TRY(parse_ids(target, error));
    }
    target->border = border ? border : target->kind == TD_TARGET_APRILGRID ? 2 : 1;
    target->first_id = first_id;
    target->legacy = legacy;
    return choose_dictionary(target, error);
}

/* Options that another kind of target has are refused, lest one be thought to have had an effect. */
static td_status check_kind_options(const td_target *target, td_error *error)
{
    const unsigned chessboard = 1u << TD_TARGET_CHESSBOARD, marks = 1u << TD_TARGET_MARKS,
                   grid = 1u << TD_TARGET_APRILGRID, tags = 1u << TD_TARGET_TAGS,
                   charuco = 1u << TD_TARGET_CHARUCO;
    const struct {
        const char *name;
        bool given;
        unsigned kinds;
    } option[] = {{"rows", rows != 0, chessboard | marks | grid | charuco},
                  {"tag-size-mm", tag_size_mm > 0, grid | tags | charuco},
                  {"diameter-mm", diameter_mm > 0, marks},
                  {"polarity", strcmp(polarity, "dark") != 0, marks},
                  {"dictionary", dictionary != NULL, grid | tags | charuco},
                  {"border", border != 0, grid | tags | charuco},
                  {"ids", strcmp(ids, "0") != 0, tags},
                  {"first-id", first_id != 0, grid | charuco},
                  {"order", strcmp(order, "upward") != 0, grid},
                  {"legacy", legacy, charuco}};
    for (size_t i = 0; i < sizeof option / sizeof *option; i++)
        if (option[i].given && !(option[i].kinds & 1u << target->kind))
            return td_fail(error, TD_ERROR_ARGUMENT, "--%s: a target of kind %s has none", option[i].name,
                           kind_name);
    return TD_OK;
}

static void place_tags(td_target *target, double size_mm)
{
    const double step = spacing_mm > 0 ? spacing_mm : SHEET_STEP * size_mm;
    const int across = columns ? columns : (int)ceil(sqrt(target->tag_count));
    for (int i = 0; i < target->tag_count; i++) {
        target->tag[i].size_m = size_mm / MM;
        target->tag[i].target_from_tag = td_pose_identity();
        target->tag[i].target_from_tag.t[0] = i % across * step / MM;
        target->tag[i].target_from_tag.t[1] = i / across * step / MM;
    }
}

/* Every length from the one that leads, mm: the tag's size for tags and aprilgrids, else the spacing. */
static void set_lengths(td_target *target, double lead_mm)
{
    double spacing = lead_mm;
    if (target->kind == TD_TARGET_TAGS) {
        place_tags(target, lead_mm);
        return;
    }
    if (target->kind == TD_TARGET_APRILGRID) {
        spacing = spacing_mm > 0 ? spacing_mm : lead_mm * (1 + GAP_RATIO);
        target->tag_size_m = lead_mm / MM;
    }
    if (target->kind == TD_TARGET_CHARUCO)
        target->tag_size_m = (tag_size_mm > 0 ? tag_size_mm : MARKER_SHARE * spacing) / MM;
    if (target->kind == TD_TARGET_MARKS)
        target->diameter_m = (diameter_mm > 0 ? diameter_mm : MARK_SHARE * spacing) / MM;
    target->plane[0].spacing_m = spacing / MM;
}

static bool led_by_tag(const td_target *target)
{
    return target->kind == TD_TARGET_TAGS || target->kind == TD_TARGET_APRILGRID;
}

/* The leading length, as far as the options say it; else 0. */
static double given_length(const td_target *target)
{
    if (!led_by_tag(target)) return spacing_mm;
    if (tag_size_mm > 0 || target->kind == TD_TARGET_TAGS) return tag_size_mm;
    return spacing_mm / (1 + GAP_RATIO);
}

static td_status parse_page(double size_m[2], bool *fixed, td_error *error)
{
    static const struct {
        const char *name;
        double width, height;
    } known[] = {{"fit", 0, 0},    {"a4", 210, 297},  {"a3", 297, 420},        {"a2", 420, 594},
                 {"a1", 594, 841}, {"a0", 841, 1189}, {"letter", 215.9, 279.4}};
    double width, height;
    int used = 0;
    *fixed = true;
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (strcmp(page, known[i].name) == 0) {
            size_m[0] = known[i].width / MM, size_m[1] = known[i].height / MM;
            *fixed = i > 0;
            return TD_OK;
        }
    if (sscanf(page, "%lfx%lf%n", &width, &height, &used) != 2 || page[used] ||
        !(width >= 10 && width <= 10000) || !(height >= 10 && height <= 10000))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "--page %.60s: must be a4, a3, a2, a1, a0, letter, fit, or width and height in mm as 420x594",
            page);
    size_m[0] = width / MM, size_m[1] = height / MM;
    return TD_OK;
}

static td_status parse_measured(double scale[2], td_error *error)
{
    double reading[2], length[2];
    int used = 0;
    if (!measured) return TD_OK;
    int count = sscanf(measured, "%lf/%lf%n,%lf/%lf%n", &reading[0], &length[0], &used, &reading[1],
                       &length[1], &used);
    if (count == 2) reading[1] = reading[0], length[1] = length[0];
    if ((count != 2 && count != 4) || measured[used] || !(length[0] > 0) || !(length[1] > 0))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "--measured %.60s: write what the ruler measures over what it says, as 200.3/200, or for both "
            "rulers 200.3/200,149.8/150",
            measured);
    for (int i = 0; i < 2; i++) scale[i] = reading[i] / length[i];
    for (int i = 0; i < 2; i++)
        if (!(scale[i] >= 0.8 && scale[i] <= 1.25))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "--measured %.60s: a scale of %.4g is no printer's error; was it printed at 100 %%?",
                measured, scale[i]);
    return TD_OK;
}

/* ---- Fitting the page ---- */

typedef struct sheet {
    td_target target;
    td_target_drawing_options drawing;
    double page[2]; /* m, as asked for; 0: fit */
    bool fixed;
} sheet;

static bool fits(sheet *s, bool turned)
{
    double size[2];
    s->drawing.page_width_m = s->page[turned], s->drawing.page_height_m = s->page[!turned];
    return td_target_page_needed(size, &s->target, 0, &s->drawing, NULL) == TD_OK &&
           size[0] <= s->drawing.page_width_m + 1e-9 && size[1] <= s->drawing.page_height_m + 1e-9;
}

/* Turns the page if the target fits only so. */
static bool fits_somehow(sheet *s)
{
    return fits(s, false) || fits(s, true);
}

/* The largest leading length in whole mm that fits; 0: none. */
static int largest(sheet *s)
{
    int low = 0, high = LARGEST_MM;
    while (low + 1 < high) {
        const int middle = (low + high) / 2;
        set_lengths(&s->target, middle);
        if (td_target_check(&s->target, NULL) == TD_OK && fits_somehow(s))
            low = middle;
        else
            high = middle;
    }
    return low;
}

static td_status refuse_size(sheet *s, double length, td_error *error)
{
    td_target_drawing_options bare = s->drawing;
    sheet other = *s;
    double size[2];
    char hint[128] = "", what[256];
    other.drawing.ruler = other.drawing.text = false;
    const int with = largest(s), without = largest(&other);
    set_lengths(&s->target, length);
    bare.page_width_m = bare.page_height_m = 0;
    TD_TRY(td_target_page_needed(size, &s->target, 0, &bare, error));
    const char *lead = led_by_tag(&s->target) ? "--tag-size-mm" : "--spacing-mm";
    if (with) snprintf(hint, sizeof hint, "; the largest %s that fits is %d", lead, with);
    if (without > with)
        snprintf(hint + strlen(hint), sizeof hint - strlen(hint), "%s%s %d",
                 with ? " (" : "; without rulers and text ", with ? "without rulers and text" : lead,
                 without);
    if (without > with && with) strncat(hint, ")", sizeof hint - strlen(hint) - 1);
    return td_fail(
        error, TD_ERROR_ARGUMENT,
        "%s needs %.0f x %.0f mm with its margin%s%s, more than the page of %.0f x %.0f mm, either way up%s",
        td_target_describe(what, sizeof what, &s->target), ceil(size[0] * MM), ceil(size[1] * MM),
        bare.ruler ? ", rulers" : "", bare.text ? ", text" : "", s->page[0] * MM, s->page[1] * MM, hint);
}

/* Sizes the target and turns the page. */
static td_status fit_page(sheet *s, td_error *error)
{
    double length = given_length(&s->target);
    if (!s->fixed) {
        set_lengths(&s->target, length > 0 ? length : led_by_tag(&s->target) ? FIT_TAG_MM : FIT_SPACING_MM);
        return td_target_check(&s->target, error);
    }
    if (!(length > 0)) length = largest(s);
    set_lengths(&s->target, length > 0 ? length : 1);
    TD_TRY(td_target_check(&s->target, error));
    return fits_somehow(s) ? TD_OK : refuse_size(s, length > 0 ? length : 1, error);
}

/* ---- What is said ---- */

static td_status print_result(const sheet *s, td_error *error)
{
    enum { LONGEST = 12000 };
    char what[256], *line = malloc(LONGEST), *text = NULL;
    double size[2];
    td_status status = td_target_page_needed(size, &s->target, 0, &s->drawing, error);
    if (!line) status = td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) {
        if (s->fixed) size[0] = s->drawing.page_width_m, size[1] = s->drawing.page_height_m;
        td_target_describe(what, sizeof what, &s->target);
        td_target_dataset_line(line, LONGEST, &s->target);
    }
    if (status == TD_OK && json) {
        json_t *result =
            json_pack("{s:s, s:s, s:s, s:s, s:o, s:o, s:[s]}", "job", "target", "version", TD_VERSION,
                      "description", what, "dataset_line", line, "page_size_m", td_json_reals(size, 2),
                      "printer_scale", td_json_reals(s->drawing.printer_scale, 2), "products", output);
        status = result ? td_schema_check(result, schema, SCHEMA_COUNT, error)
                        : td_fail(error, TD_ERROR_ARGUMENT, "%s: the name is not UTF-8", output);
        if (status == TD_OK) status = td_document_to_json(&text, result, 15, error);
        if (text) fputs(text, stdout);
        json_decref(result);
    } else if (status == TD_OK && !quiet) {
        printf("%s: %s, on a page of %g x %g mm\nPrint it at 100 %%, measure the %s, and put into "
               "dataset.yaml:\n%s\n",
               output, what, round(size[0] * MM * 10) / 10, round(size[1] * MM * 10) / 10,
               s->drawing.ruler ? "rulers" : "target", line);
    }
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    free(text);
    free(line);
    return status;
}

static td_status run(td_error *error)
{
    sheet s = {.drawing = td_target_drawing_options_default()};
    TD_TRY(begin_target(&s.target, error));
    TD_TRY(check_kind_options(&s.target, error));
    TD_TRY(parse_page(s.page, &s.fixed, error));
    TD_TRY(parse_measured(s.drawing.printer_scale, error));
    s.drawing.margin_m = margin_mm / MM;
    s.drawing.dots_per_inch = dpi;
    s.drawing.ruler = !no_ruler;
    s.drawing.text = !no_text;
    TD_TRY(fit_page(&s, error));
    TD_TRY(td_target_draw(output, &s.target, 0, &s.drawing, error));
    return print_result(&s, error);
}

int main(int argc, char **argv)
{
    int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    if (list_schema) {
        char *text = td_schema_describe(schema, SCHEMA_COUNT);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    if (!kind_name || !output || !*output) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)",
                     kind_name ? "-o FILE" : "the kind of target", command.name, command.usage);
        return EXIT_USAGE;
    }
    td_error error = {0};
    td_status status = run(&error);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    return status == TD_OK ? EXIT_DONE : status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
