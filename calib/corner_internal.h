/* The model that corner.c fits, apart so that its derivatives can be tested. */
#ifndef TELEDIMOS_CALIB_CORNER_INTERNAL_H
#define TELEDIMOS_CALIB_CORNER_INTERNAL_H

#include "corner.h"

/* x, y of the corner relative to the window's origin, px; directions of the two lines, rad; blur, px; mean
 * grey; half the contrast; slope of the light across the window, grey levels per px. */
enum {
    CORNER_X,
    CORNER_Y,
    CORNER_ANGLE_1,
    CORNER_ANGLE_2,
    CORNER_BLUR,
    CORNER_MEAN,
    CORNER_HALF,
    CORNER_SLOPE_X,
    CORNER_SLOPE_Y,
    CORNER_PARAMETERS
};

enum { CORNER_LANES = 16 }; /* of vector code: arrays are filled up with zeros to a multiple */
/* A disc of radius 20 holds fewer pixels than pi (20 + sqrt 0.5)^2 = 1347. */
enum { CORNER_MAX_RADIUS = 20, CORNER_MAX_PIXELS = 1360 };

/* The pixels of a disc, one array for each quantity, so that the compiler makes vector code. */
typedef struct corner_window {
    int origin[2]; /* a pixel near the corner, px */
    int count;
    bool wedge; /* one quadrant is dark; else two, opposite one another */
    float x[CORNER_MAX_PIXELS], y[CORNER_MAX_PIXELS]; /* relative to the origin, px */
    float grey[CORNER_MAX_PIXELS];
    float residual[CORNER_MAX_PIXELS];                      /* grey minus model */
    float derivative[CORNER_PARAMETERS][CORNER_MAX_PIXELS]; /* of the model */
} corner_window;

/* Fills residual and derivative of every pixel of the window. */
void td_corner_model(corner_window *window, const double parameter[CORNER_PARAMETERS]);

/* What surrounds a corner of a tag. */
typedef struct tag_shape {
    bool wedge;         /* the corner is alone; else a dark square touches it from outside */
    double along[2][2]; /* px: a cell's length from the corner along both sides of the tag */
    double side;        /* cells of the tag's side */
    double inside;      /* cells from the corner to the code: the border */
    double outside;     /* cells from the corner to the next thing outside */
} tag_shape;

/* Refines a tag's corner, known to within a cell or 2.5 px, by the pixels that show its two edges and nothing
 * else. False as for td_corner_refine. */
bool td_corner_refine_tag(td_corner *corner, const td_image *image, const double start[2],
                          const tag_shape *shape);

#endif
