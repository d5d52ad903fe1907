/* What the files of the marks' detector share: blobs (step one), the model of a mark (step two), lattices
 * (step three). */
#ifndef TELEDIMOS_CALIB_MARKS_INTERNAL_H
#define TELEDIMOS_CALIB_MARKS_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "calib/marks.h"

/* ---- Step one: binarise; a blob is a region of the binary image with its holes filled. ---- */

typedef struct td_blob {
    double centroid[2];   /* px */
    double covariance[3]; /* xx, xy, yy of the region, px^2 */
    double area;          /* px^2 */
    bool light;           /* lighter than what is around */
} td_blob;

/* Standard deviation of the image's noise (grey levels), quantisation included. */
double td_image_noise(const td_image *image);
/* All elliptical blobs away from the image's border. *blobs is to be freed with free(). */
td_status td_marks_blobs(td_blob **blobs, size_t *count, const td_image *image, td_mark_polarity polarity,
                         td_error *error);

/* ---- Step two: the model of a mark. ---- */

/* The edge: q(t) = c + r(t) B (cos t, sin t), with B the symmetric root of the ellipse's covariance-like
 * matrix (semi-axes as eigenvalues) and r(t) = 1 + e3c cos 3t + e3s sin 3t the bulge that distortion gives.
 */
enum {
    TD_EDGE_CX,
    TD_EDGE_CY,
    TD_EDGE_BXX,
    TD_EDGE_BXY,
    TD_EDGE_BYY,
    TD_EDGE_BLUR,
    TD_EDGE_E3C,
    TD_EDGE_E3S,
    TD_EDGE_PARAMETERS
};

/* Phi and its density, for the model's many error functions. */
enum { TD_NORMAL_STEPS = 64, TD_NORMAL_RANGE = 5 };
typedef struct td_normal_table {
    double cumulative[2 * TD_NORMAL_STEPS * TD_NORMAL_RANGE + 1];
    double density[2 * TD_NORMAL_STEPS * TD_NORMAL_RANGE + 1];
} td_normal_table;
void td_normal_table_init(td_normal_table *table);

/* Blurs that the model takes, px. */
enum { TD_MARK_MAX_BLUR = 12 };
static const double TD_MARK_MIN_BLUR = 0.2;

/* A window of pixels; `slot` gives the row of `d_edge` of each pixel, -1: not wanted. */
typedef struct td_window {
    int x0, y0, width, height; /* px */
    const int *slot;           /* (height,width) */
} td_window;

/* cover (height,width): how much of each pixel the blurred disc covers, 0 to 1; d_edge (slots,8): its
 * derivatives by the edge's parameters, added to what is there (the caller zeroes it); may be
 * NULL. */
void td_mark_cover(float *cover, float *d_edge, const td_window *window,
                   const double edge[TD_EDGE_PARAMETERS], const td_normal_table *table);

/* A pixel that a fit looks at. */
typedef struct td_mark_pixel {
    int index;   /* in the window */
    double x, y; /* px */
    double grey;
    double residual; /* grey less the model's */
    bool outlier;
} td_mark_pixel;

/* What fits to marks of one image share: working memory, used again from mark to mark. */
typedef struct td_mark_fit {
    td_normal_table table;
    double noise;         /* of the image, grey levels */
    float *cover;         /* (pixels of the window) */
    int *slot;            /* (pixels of the window) */
    size_t window_size;   /* of these two */
    td_mark_pixel *pixel; /* (slots) */
    float *d_edge;        /* (slots,8) */
    size_t row_size;      /* of these two */
} td_mark_fit;
void td_mark_fit_init(td_mark_fit *fit, const td_image *image);
void td_mark_fit_free(td_mark_fit *fit);

/* Fits the model to the image around blob[index] of (count), leaving out what belongs to other blobs. *ok =
 * false when there is no mark; an error only for want of memory. */
td_status td_mark_fit_blob(td_mark *mark, bool *ok, td_mark_fit *fit, const td_image *image,
                           const td_blob *blob, size_t count, size_t index, td_error *error);

/* ---- Step three: lattices. ---- */

/* Marks that lie on one square lattice seen in perspective. Columns and rows are right-handed in the image:
 * from the direction of the columns to that of the rows is a turn from x to y, as on a board seen from its
 * front. */
typedef struct td_lattice {
    int columns, rows; /* of its bounding box */
    size_t count;      /* marks on it */
    int *mark;         /* (rows,columns) index of the mark, -1: none */
} td_lattice;

typedef struct td_lattices {
    size_t count;
    td_lattice *lattice; /* (count), the largest first */
} td_lattices;
void td_lattices_free(td_lattices *lattices);

/* `pitch`: distance of neighbouring marks over the radius of a mark; 0: found from the marks. *pitch_seen
 * (may be NULL) = the median of what was found. Lattices of fewer than 4 marks are left out. */
td_status td_marks_lattices(td_lattices *lattices, const td_mark *mark, size_t count, double pitch,
                            td_error *error);

/* Counts the marks and takes empty outer rows and columns off the bounding box. */
void td_lattice_trim(td_lattice *lattice);
/* Takes off the lattice what does not lie on its plane. Distortion may bend the plane smoothly. */
td_status td_lattice_discard(td_lattice *lattice, const td_mark *mark, td_error *error);

/* Homography from lattice coordinates to the image; false when the marks do not determine one. */
bool td_lattice_homography(double image_from_lattice[9], const td_lattice *lattice, const td_mark *mark);

/* Where the mark at (column, row) should lie, as told by its neighbours in the lattice but not by itself:
 * `value` (3) = image position taken back to lattice coordinates by `lattice_from_image`, and logarithm of
 * the mark's area. False when there are too few neighbours. */
bool td_lattice_predict(double value[3], const td_lattice *lattice, const td_mark *mark,
                        const double lattice_from_image[9], int column, int row);

/* Sorts; NaN of none. */
double td_marks_median(double *value, size_t n);

/* Image of (x, y) by a homography, its derivatives (row-major 2x2), and the inverse; false when there is
 * none. */
void td_homography_map(double out[2], const double h[9], double x, double y);
void td_homography_jacobian(double j[4], const double h[9], double x, double y);
bool td_homography_invert(double inverse[9], const double h[9]);
/* Semi-axes of a mark, px: minor, major. */
void td_mark_axes(double axes[2], const td_mark *mark);

/* ---- Numbering. ---- */

typedef struct td_numbering {
    const td_target *target;
    const td_mark *mark; /* (marks) */
    size_t marks;
    int *of_point; /* (points of the target) index of the mark, -1: not seen */
    bool seen[TD_TARGET_MAX_PLANES];
    size_t grid_marks;           /* of the largest grid that was seen, */
    int grid_columns, grid_rows; /* and its size */
    char note[160];              /* what stood in the way; "" */
    bool refused;                /* it was the clicks */
} td_numbering;

/* Marks of a plane that must be seen. */
size_t td_marks_needed(const td_target_plane *plane);

/* Numbers the planes not yet seen by the lattices among the marks; clicks on them choose among symmetries. */
td_status td_marks_number(td_numbering *numbering, const td_click *click, size_t clicks, td_error *error);

/* Numbers the planes with at least 4 clicks by their homographies. */
td_status td_marks_number_clicked(td_numbering *numbering, const td_click *click, size_t clicks,
                                  td_error *error);

/* The nearest mark to a click, -1 when the click is far from all; *away (px) is how far. */
int td_marks_clicked(double *away, const td_numbering *numbering, const td_click *click);

/* Looks once more, where they should be, for marks of the planes seen: dirt that touches a mark spoils its
 * blob. *mark (marks) grows by those found. */
td_status td_marks_recover(td_numbering *numbering, td_mark **mark, const td_image *image, td_error *error);

/* The marks of a plane as a lattice; lattice->mark lends from the numbering. */
td_lattice td_numbered_plane(const td_numbering *numbering, int plane, size_t *first);

/* Median diameter of the plane's marks by their areas and its homography, in units of its spacing; NaN:
 * unknown. */
td_status td_numbered_diameter(double *diameter, const td_numbering *numbering, int plane, td_error *error);

#endif
