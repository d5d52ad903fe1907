/* Rigs in the files of other tools. Each writer is exact where the format can hold the model; where it
 * cannot, it refuses, or, when `approximate` is allowed, fits the format's nearest model and tells the
 * largest error in pixels over the image. */
#ifndef TELEDIMOS_CORE_RIG_FORMATS_H
#define TELEDIMOS_CORE_RIG_FORMATS_H

#include "rig.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_rig_format {
    TD_RIG_TELEDIMOS, /* rig.yaml */
    TD_RIG_OPENCV, /* OpenCV FileStorage YAML (and XML, JSON on reading): K, D, R, T under their usual names
                    */
    TD_RIG_ROS,    /* camera_info YAML, a file for each camera */
    TD_RIG_KALIBR, /* camchain.yaml */
    TD_RIG_VISP,   /* vpXmlParserCamera's XML */
    TD_RIG_MRCAL,  /* .cameramodel, a file for each camera */
    TD_RIG_FORMAT_COUNT
} td_rig_format;

TD_API const char *td_rig_format_name(td_rig_format format); /* "opencv", …; NULL */
/* TD_RIG_FORMAT_COUNT if there is no such name. */
TD_API td_rig_format td_rig_format_from_name(const char *name);
/* What a file's content looks like; TD_RIG_FORMAT_COUNT: nothing known. */
TD_API td_rig_format td_rig_format_guess(const char *text, size_t size);

/* Reads a rig from `count` files (several where the format has a file for each camera; in the rig's order).
 * `format` TD_RIG_FORMAT_COUNT: guess. Sizes that the format lacks are taken from width, height (0: needed).
 */
typedef struct td_rig_import_options {
    td_rig_format format;
    int width, height;
} td_rig_import_options;
TD_API td_status td_rig_import(td_rig **rig, const char *const *path, size_t count,
                               const td_rig_import_options *options, td_error *error);

/* What writing cost. */
typedef struct td_rig_export_report {
    double largest_error_px; /* over all cameras' images; 0: exact */
    char remark[320];        /* what was approximated or cannot be said in the format; "" */
    size_t file_count;
    char *file[TD_RIG_MAX_CAMERAS + 1]; /* names written; freed by td_rig_export_report_free */
} td_rig_export_report;

/* Writes into `path`, a file for formats that hold a whole rig, else a name with %s for the camera's name (or
 * a folder). */
TD_API td_status td_rig_export(const td_rig *rig, const char *path, td_rig_format format, bool approximate,
                               td_rig_export_report *report, td_error *error);
TD_API void td_rig_export_report_free(td_rig_export_report *report);

/* a_from_b as URDF's <origin xyz= rpy=/> and as a ROS static transform's arguments; to be freed with free().
 */
TD_API char *td_pose_to_urdf(const td_pose *a_from_b);
TD_API char *td_pose_to_ros(const td_pose *a_from_b, const char *a, const char *b);

#ifdef __cplusplus
}
#endif
#endif
