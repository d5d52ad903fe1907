/* Calibration targets: what is printed on the board, in metres.
 *
 * Target frame: origin at the first point, x along the columns, y along the rows, z into the board, so that a
 * board facing the camera upright has the camera's axes. Point k is row k / columns, column k % columns of
 * its plane; planes follow one another. Of a tag, the points are its black square's corners, upper left,
 * upper right, lower right, lower left as it is read: point 4 t + i is corner i of tag t, an aprilgrid's tags
 * being counted in rows from the upper left whatever their numbers. A target of single tags has its own
 * frame, and each tag is a plane of its own. */
#ifndef TELEDIMOS_CORE_TARGET_H
#define TELEDIMOS_CORE_TARGET_H

#include <stdbool.h>
#include <stddef.h>

#include "pose.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_target_kind {
    TD_TARGET_CHESSBOARD, /* the inner corners of a chessboard */
    TD_TARGET_MARKS,      /* circular marks on one or more planes */
    TD_TARGET_APRILGRID,  /* a grid of tags, four corners each */
    TD_TARGET_TAGS,       /* single tags at known poses, four corners each */
    TD_TARGET_CHARUCO,    /* the inner corners of a chessboard with a marker in each light square */
    TD_TARGET_KIND_COUNT
} td_target_kind;

typedef enum td_mark_polarity { TD_MARK_DARK, TD_MARK_LIGHT, TD_MARK_ANY } td_mark_polarity;

enum { TD_TARGET_MAX_PLANES = 6, TD_TARGET_MAX_SIDE = 200, TD_TARGET_MAX_TAGS = 64, TD_DICTIONARY_SIZE = 24 };

/* One plane's grid. */
typedef struct td_target_plane {
    int columns, rows;         /* inner corners, marks, or (aprilgrid) tags */
    double spacing_m;          /* between neighbours: corners, marks, or the same corner of two tags */
    td_pose target_from_plane; /* identity for the only plane */
} td_target_plane;

/* One single tag. Its frame: origin at its centre, x to its right, y down, z into the board. */
typedef struct td_target_tag {
    int id;
    double size_m; /* side of the black square, its border included */
    td_pose target_from_tag;
} td_target_tag;

/* In which order an aprilgrid's tags are numbered, from first_id. */
typedef enum td_tag_order {
    TD_TAGS_UPWARD,  /* the first row is the lowest, as Kalibr draws its grids */
    TD_TAGS_DOWNWARD /* the first row is the uppermost */
} td_tag_order;

typedef struct td_target {
    td_target_kind kind;
    int plane_count;
    td_target_plane plane[TD_TARGET_MAX_PLANES];
    double diameter_m;         /* marks: of the circle; others: 0 */
    td_mark_polarity polarity; /* marks: dark on light, light on dark, or find out */
    /* Tags and markers: */
    char dictionary[TD_DICTIONARY_SIZE]; /* "tag36h11", "aruco4x4_50", … (calib/tag_dictionary.h) */
    int border;                          /* cells of the black border: 1 libapriltag's, 2 Kalibr's */
    double tag_size_m;                   /* side of the black square, its border included; tags: 0 */
    int first_id;                        /* aprilgrid, charuco: number of the first tag */
    td_tag_order order;                  /* aprilgrid */
    bool legacy;                         /* charuco: OpenCV before 4.6, whose boards with an even number of
                                            rows of squares begin with a marker at the upper left */
    int tag_count;                       /* tags */
    td_target_tag tag[TD_TARGET_MAX_TAGS];
} td_target;

TD_API const char *td_target_kind_name(td_target_kind kind); /* "chessboard", "marks"; NULL if none */
TD_API size_t td_target_point_count(const td_target *target);
/* Point `index` in the target frame, m; NaN when there is none. */
TD_API void td_target_point(double p[3], const td_target *target, size_t index);
/* Which plane point `index` lies on (-1: there is no such point), and the index of that plane's first point
 * (may be NULL). Planes are fewer than the larger of TD_TARGET_MAX_PLANES and TD_TARGET_MAX_TAGS. */
TD_API int td_target_plane_of(const td_target *target, size_t index, size_t *first);
/* Pose of plane `plane`, and where point `index` lies on its plane, m; NaN when there is none. */
TD_API td_pose td_target_plane_pose(const td_target *target, int plane);
TD_API void td_target_point_on_plane(double xy[2], const td_target *target, size_t index);
/* Number of the tag that point `index` is a corner of; -1: of none. */
TD_API int td_target_tag_id(const td_target *target, size_t index);
/* Number of the markers of a charuco or the tags of an aprilgrid or of single tags; else 0. */
TD_API int td_target_tag_count(const td_target *target);
/* True when all points lie on one plane. */
TD_API bool td_target_is_flat(const td_target *target);
/* Refuses what cannot be a target, naming the field: sides of 2 (chessboard: 3) to 200, spacing of 0.1 mm to
 * 10 m, marks or tags that overlap, poses that are none, two tags of one number. Whether a dictionary exists
 * and has the tags is calib/tag_dictionary.h's to say. */
TD_API td_status td_target_check(const td_target *target, td_error *error);
/* "chessboard 9x6, 25 mm", for people. Writes at most `size` bytes and returns `text`. */
TD_API char *td_target_describe(char *text, size_t size, const td_target *target);

#ifdef __cplusplus
}
#endif
#endif
