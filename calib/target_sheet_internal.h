/* A sheet of paper as a list of shapes, and its ways into a file: what target_pattern.c and target_drawing.c
 * fill, and target_svg.c and target_cairo.c write. Lengths are mm on paper, from its upper left corner. */
#ifndef TELEDIMOS_CALIB_TARGET_SHEET_INTERNAL_H
#define TELEDIMOS_CALIB_TARGET_SHEET_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/image.h"
#include "core/target.h"

typedef enum td_shape_kind { TD_SHAPE_RECTANGLE, TD_SHAPE_ELLIPSE } td_shape_kind;

/* Shapes of one group follow one another and are filled as one, so that no seam shows where they touch. */
typedef struct td_shape {
    td_shape_kind kind;
    bool light; /* white over what lies below; else black */
    int group;
    double x, y, width, height;
} td_shape;

typedef enum td_anchor { TD_ANCHOR_LEFT, TD_ANCHOR_MIDDLE, TD_ANCHOR_RIGHT } td_anchor;

enum { TD_SHEET_LINE = 256 };
typedef struct td_sheet_text {
    double x, y, size; /* of the baseline's anchor; of the type, mm */
    td_anchor anchor;
    char text[TD_SHEET_LINE];
} td_sheet_text;

typedef struct td_sheet {
    double width, height;
    td_shape *shape;
    td_sheet_text *text;
    size_t shape_count, shape_capacity, text_count, text_capacity;
    int groups;
    bool failed; /* out of memory */
} td_sheet;

/* Width of a letter of the typewriter face over its size; wider than that of any such face in use. */
#define TD_SHEET_ADVANCE 0.61

void td_sheet_free(td_sheet *sheet);
int td_sheet_group(td_sheet *sheet); /* a new one */
void td_sheet_add(td_sheet *sheet, td_shape shape);
void td_sheet_write(td_sheet *sheet, double x, double y, double size, td_anchor anchor, const char *text);

/* What a target's plane shows, in its own frame. */
typedef struct td_pattern_box {
    double x0, y0, x1, y1; /* around the ink, mm */
    double quiet;          /* white that the detector needs around it, mm */
} td_pattern_box;

void td_pattern_measure(td_pattern_box *box, const td_target *target, int plane);
/* Adds its shapes to the sheet, mm in the plane's frame. */
td_status td_pattern_draw(td_sheet *sheet, const td_target *target, int plane, td_error *error);

/* The sheet as SVG and PDF; *bytes is to be freed with free(). */
td_status td_sheet_to_svg(char **bytes, size_t *size, const td_sheet *sheet, const char *title,
                          td_error *error);
td_status td_sheet_to_pdf(char **bytes, size_t *size, const td_sheet *sheet, const char *title,
                          td_error *error);
/* As a grey image of `scale` px per mm. */
td_status td_sheet_to_image(td_image **image, const td_sheet *sheet, double scale, td_error *error);

#endif
