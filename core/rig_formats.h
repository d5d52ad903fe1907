/* Rigs in the files of other tools. Each writer is exact where the format can hold the model; where it
 * cannot, it refuses, or, when `approximate` is allowed, fits the format's nearest model and tells the
 * largest error in pixels over the image. No foreign format holds the covariance, vehicle_from_rig or the
 * provenance.
 *
 *             models held exactly                                    poses
 *   opencv    pinhole brown5 brown8 fisheye                          all (R and T are right_from_left)
 *   ros       pinhole brown5 brown8 fisheye                          of a pair: in its rectification, R and P
 *   kalibr    pinhole, brown5 with k3 = 0, fisheye                   all (a chain)
 *   visp      pinhole, brown5 with k1 alone, fisheye                 none
 *   mrcal     pinhole brown5 brown8                                  all
 *
 * A Brown model without distortion comes back as the pinhole that it is. Names, where the format has none,
 * are those of the file, or left and right, or camera0, camera1, … */
#ifndef TELEDIMOS_CORE_RIG_FORMATS_H
#define TELEDIMOS_CORE_RIG_FORMATS_H

#include "rig.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_rig_format {
    TD_RIG_TELEDIMOS, /* rig.yaml */
    TD_RIG_OPENCV,    /* OpenCV FileStorage YAML (and XML, JSON on reading): K, D, R, T under their usual
                       * names */
    TD_RIG_ROS,       /* camera_info YAML, a file for each camera */
    TD_RIG_KALIBR,    /* camchain.yaml */
    TD_RIG_VISP,      /* vpXmlParserCamera's XML */
    TD_RIG_MRCAL,     /* .cameramodel, a file for each camera */
    TD_RIG_FORMAT_COUNT
} td_rig_format;

TD_API const char *td_rig_format_name(td_rig_format format); /* "opencv", …; NULL */
/* TD_RIG_FORMAT_COUNT if there is no such name. */
TD_API td_rig_format td_rig_format_from_name(const char *name);
/* What a file's content looks like; TD_RIG_FORMAT_COUNT: nothing known. */
TD_API td_rig_format td_rig_format_guess(const char *text, size_t size);

typedef struct td_rig_import_options {
    td_rig_format format; /* TD_RIG_FORMAT_COUNT: guess */
    int width, height;    /* px, where the format lacks them (0: needed); a ViSP file's choice among sizes */
    double unit_m;        /* length of the file's unit of translations, m; 0: 1 */
    const char *camera;   /* only this camera of the files, by its name; NULL: all */
} td_rig_import_options;

/* What writing cost. */
typedef struct td_rig_export_report {
    double largest_error_px; /* over all cameras' images; 0: exact */
    char remark[320];        /* what was approximated or cannot be said in the format; "" */
    size_t file_count;
    char *file[TD_RIG_MAX_CAMERAS + 1]; /* names written; freed by td_rig_export_report_free */
} td_rig_export_report;

/* Reads a rig from `count` files (several where the format has a file for each camera, in the rig's order, or
 * where what belongs together lies apart, as OpenCV's intrinsics.yml and extrinsics.yml). Cameras whose poses
 * to one another the files do not hold make no rig: one of them must be named. `options` NULL: guess, all
 * cameras. */
TD_API td_status td_rig_import(td_rig **rig, const char *const *path, size_t count,
                               const td_rig_import_options *options, td_error *error);

/* The same from memory; `name` is for messages and, where the format has none, for the camera's name. */
typedef struct td_rig_text {
    const char *name, *text;
    size_t size;
} td_rig_text;
TD_API td_status td_rig_import_text(td_rig **rig, const td_rig_text *file, size_t count,
                                    const td_rig_import_options *options, td_error *error);

/* Writes into `path`: a file; a folder (one that is there, or a name that ends in /); for formats with a file
 * for each camera, a name in which %s stands for the camera's name. `report` may be NULL. */
TD_API td_status td_rig_export(const td_rig *rig, const char *path, td_rig_format format, bool approximate,
                               td_rig_export_report *report, td_error *error);
TD_API void td_rig_export_report_free(td_rig_export_report *report);

/* The text of camera `camera`'s file, or of the one file for all, to be freed with free(). largest_error_px
 * and remark are added to `report` (zeroed at first; may be NULL). */
TD_API td_status td_rig_export_text(char **text, const td_rig *rig, int camera, td_rig_format format,
                                    bool approximate, td_rig_export_report *report, td_error *error);

/* a_from_b as URDF's <origin xyz= rpy=/> (of b in its parent a), and as the arguments of ROS'
 * static_transform_publisher, x y z qx qy qz qw FRAME CHILD with frame a and child b; to be freed with
 * free(). NULL: out of memory. */
TD_API char *td_pose_to_urdf(const td_pose *a_from_b);
TD_API char *td_pose_to_ros(const td_pose *a_from_b, const char *a, const char *b);

#ifdef __cplusplus
}
#endif
#endif
