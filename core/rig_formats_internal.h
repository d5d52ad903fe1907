/* What the rooms of foreign rig formats share: how one is described, and the readers and writers of what they
 * have in common. */
#ifndef TELEDIMOS_CORE_RIG_FORMATS_INTERNAL_H
#define TELEDIMOS_CORE_RIG_FORMATS_INTERNAL_H

#include "document.h"
#include "rig_formats.h"
#include "text_internal.h"

/* A camera model as a format knows it: one of ours, in which some parameters are 0. */
typedef struct td_rig_shape {
    const char *name; /* in the format's words */
    td_camera_model model;
    unsigned held; /* bit i: parameter i is 0 */
} td_rig_shape;

/* A rig being read. Poses are camera_from_ANY, any frame that the cameras share. A width of 0: not told. */
typedef struct td_rig_reading {
    td_rig *rig;
    const td_rig_import_options *options;
    bool poses_unknown; /* the files do not hold them */
} td_rig_reading;

typedef struct td_rig_room {
    const char *name, *title; /* "kalibr"; "Kalibr's camchain" */
    const char *file;         /* name in a folder, %s: the camera's name */
    bool file_per_camera;
    const td_rig_shape *shape; /* simplest first */
    size_t shape_count;
    td_status (*read)(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error);
    /* Writes a rig whose cameras all have one of the shapes; `camera`: for formats with a file for each. */
    void (*write)(td_text *out, const td_rig *rig, int camera);
    /* Adds to the remark what of this rig the format cannot say besides the models; may be NULL. */
    void (*remark)(char *remark, size_t size, const td_rig *rig);
} td_rig_room;

extern const td_rig_room td_rig_room_opencv, td_rig_room_ros, td_rig_room_kalibr, td_rig_room_visp,
    td_rig_room_mrcal;

/* ---- reading ---- */

/* The next camera of the rig, zeroed, at identity; fails when there are too many. */
td_status td_rig_next(td_rig_camera **camera, td_rig *rig, const char *file, td_error *error);
/* Names the camera after `text` (NULL: `otherwise`), what is not plain in it replaced, and made unique. */
void td_rig_name(td_rig *rig, td_rig_camera *camera, const char *text, const char *otherwise);
/* The name of a file without folder and extension; to be freed with free(). */
char *td_rig_stem(const char *path);
/* {rows, cols, data}: OpenCV's and ROS' matrices, of just this size. */
td_status td_rig_read_matrix(double *value, size_t rows, size_t columns, const td_field *field,
                             td_error *error);
/* The same of any shape with `low` to `high` values in all. */
td_status td_rig_read_values(double *value, size_t *count, size_t low, size_t high, const td_field *field,
                             td_error *error);
/* fx fy cx cy of K (3,3); refuses skew and what is no camera matrix. */
td_status td_rig_take_matrix(td_camera *camera, const double k[9], const td_field *field, td_error *error);
/* A rotation (3,3), put right when rounded, refused when it is none (1e-3). */
td_status td_rig_take_pose(td_pose *pose, const double r[9], const double t[3], const td_field *field,
                           td_error *error);
/* Distortion coefficients in OpenCV's order, k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [taux tauy]]]]; refuses
 * what we have no model for. */
td_status td_rig_take_brown(td_camera *camera, const double *d, size_t count, const td_field *field,
                            td_error *error);

/* ---- writing ---- */

/* "1.0, 2.5" to the last bit. */
void td_rig_add_reals(td_text *out, const double *value, size_t count);
/* The distortion in OpenCV's order; returns the number of coefficients (5, 8; fisheye 4). */
size_t td_rig_distortion(double d[8], const td_camera *camera);
/* Adds a sentence to a remark. */
void td_rig_add_remark(char *remark, size_t size, const char *format, ...) TD_PRINTF(3, 4);

/* ---- a pair, rectified ---- */

typedef struct td_rig_pair {
    double r[2][9]; /* rectified from camera */
    double f, c[2]; /* of both rectified cameras, px */
    double t[3];    /* rectified second from rectified first: along x, or y when vertical */
    bool vertical;
} td_rig_pair;

/* Of the first two cameras. False when no rotation makes their rows (or columns) epipolar lines: no baseline,
 * or one that lies nearly along the view. */
bool td_rig_rectified(td_rig_pair *pair, const td_rig *rig);

/* ---- fitting ---- */

/* The camera in one of the room's shapes: exactly if it can be, else the one whose largest error is least. */
td_status td_rig_express(td_camera *expressed, const td_rig_shape **shape, double *largest_px,
                         const td_camera *camera, const td_rig_shape *shapes, size_t count, td_error *error);
bool td_rig_holds(const td_camera *camera, const td_rig_shape *shapes, size_t count);

#endif
