/* The shape of a result, documented and checked from one table. */
#ifndef TELEDIMOS_CORE_SCHEMA_H
#define TELEDIMOS_CORE_SCHEMA_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_schema_type {
    TD_SCHEMA_OBJECT,
    TD_SCHEMA_ARRAY, /* of objects: their fields are rows below "path[]" */
    TD_SCHEMA_STRING,
    TD_SCHEMA_STRINGS,
    TD_SCHEMA_REAL, /* or integer, finite */
    TD_SCHEMA_REALS,
    TD_SCHEMA_MATRIX,
    TD_SCHEMA_INT,
    TD_SCHEMA_BOOL,
    TD_SCHEMA_TYPE_COUNT
} td_schema_type;

/* One row. `path` is dotted; "*" stands for any key ("cameras.*.rms_px"), "[]" for each element of an array
 * ("views[].name"). Every mapping and array below the root has a row of its own ("cameras", "cameras.*",
 * "views"). */
typedef struct td_schema_row {
    const char *path;
    td_schema_type type;
    bool required;    /* wherever its parent is present; of "*": there is at least one */
    bool nullable;    /* may be null: unknown; so may the numbers in REALS and MATRIX */
    const char *text; /* meaning, unit */
} td_schema_row;

/* Every value has a row of its type, every required row a value; else fails naming the path. Where a name and
 * "*" both fit, the name's row counts. A matrix has rows of one length. */
TD_API td_status td_schema_check(const json_t *root, const td_schema_row *row, size_t count, td_error *error);
/* The table as aligned text for people; to be freed with free(). */
TD_API char *td_schema_describe(const td_schema_row *row, size_t count);

#ifdef __cplusplus
}
#endif
#endif
