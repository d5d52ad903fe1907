/* OpenCV's FileStorage as a tree. */
#ifndef TELEDIMOS_CORE_RIG_OPENCV_INTERNAL_H
#define TELEDIMOS_CORE_RIG_OPENCV_INTERNAL_H

#include <jansson.h>

#include "rig_formats.h"

/* YAML, XML or JSON, whichever it is. Matrices are {rows, cols, dt, data: [numbers]} in all three. */
td_status td_opencv_parse(json_t **root, const td_rig_text *file, td_error *error);

#endif
