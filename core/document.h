/* A tree of named values, read from YAML or JSON and written as either: the one place behind dataset, rig and
 * result files. The tree is jansson's json_t (object order is kept); only this room knows how it is spelled
 * in a file.
 *
 * Reading is strict: anchors, aliases and tags are refused, so are a key given twice, a second document and
 * numbers that do not fit; nesting (64), size (16 MiB), values (2^20) and the length of a key (128
 * bytes) are bounded. Plain scalars become null (null, ~), booleans (true, false), integers, reals or strings
 * (YAML 1.2 core schema); .nan and .inf are kept as strings, and so refused where a number is asked for.
 * Getters name the file and the whole path of the field: "rig.yaml: cameras.left.fx: …". What the writers
 * write, within the same bounds, is read back as the same tree. */
#ifndef TELEDIMOS_CORE_DOCUMENT_H
#define TELEDIMOS_CORE_DOCUMENT_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

#include "pose.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Parses YAML (JSON is YAML too). The root must be a mapping. *root: json_decref when done. `name` is for
 * messages. */
TD_API td_status td_document_read(json_t **root, const char *path, td_error *error);
TD_API td_status td_document_parse(json_t **root, const char *text, size_t size, const char *name,
                                   td_error *error);

/* Text in *text, to be freed with free(). The root must be a mapping. `digits`: significant digits of reals,
 * 1–17; 0: as few as give back the same double. Sequences of scalars are written on one line. */
TD_API td_status td_document_to_yaml(char **text, const json_t *root, int digits, td_error *error);
TD_API td_status td_document_to_json(char **text, const json_t *root, int digits, td_error *error);

/* Where a value stands, for messages; chained on the stack of the reader. */
typedef struct td_field {
    const struct td_field *parent; /* NULL: the root */
    const char *name;              /* of the file at the root; else of the key */
    const json_t *value;           /* may be NULL: absent */
} td_field;

/* The child `key` of a mapping; value NULL when absent. `parent` must outlive it. */
TD_API td_field td_field_get(const td_field *parent, const char *key);
/* Element `index` of a sequence, called "[index]" in messages; `name` is where that is kept. */
enum { TD_FIELD_INDEX_SIZE = 24 };
TD_API td_field td_field_at(const td_field *parent, size_t index, char name[TD_FIELD_INDEX_SIZE]);
/* Fails with "NAME: PATH: MESSAGE". */
TD_API td_status td_field_fail(const td_field *field, td_error *error, const char *format, ...)
    TD_PRINTF(3, 4);

/* The line, from 1, where `path` ("steps[2].press.force_n", as messages have it) stands in a text that
 * td_document_parse accepts: that of the deepest part of it that is there; 0: none is. */
TD_API size_t td_document_line(const char *text, size_t size, const char *path);
/* Puts the line into what td_field_fail, or a getter, said of the text called `name`: "NAME:LINE: PATH:
 * MESSAGE"; for an unknown key the key's own line. Other messages stay as they are. Returns `status`. */
TD_API td_status td_document_locate(td_error *error, td_status status, const char *text, size_t size,
                                    const char *name);

/* Each fails, naming the field, when it is absent, of another type, not finite or outside [low, high]. */
TD_API td_status td_field_real(double *value, const td_field *field, double low, double high,
                               td_error *error);
TD_API td_status td_field_int(int *value, const td_field *field, int low, int high, td_error *error);
TD_API td_status td_field_bool(bool *value, const td_field *field, td_error *error);
/* The string lives as long as the document. */
TD_API td_status td_field_string(const char **value, const td_field *field, td_error *error);
/* Index of the string among `names` (NULL-terminated); `list` says them for people: "dark, light or any". */
TD_API td_status td_field_choice(int *choice, const td_field *field, const char *const names[],
                                 const char *list, td_error *error);
/* Exactly `count` reals. */
TD_API td_status td_field_reals(double *value, size_t count, const td_field *field, double low, double high,
                                td_error *error);
/* The number of elements of a sequence, in [low, high]. */
TD_API td_status td_field_count(size_t *count, const td_field *field, size_t low, size_t high,
                                td_error *error);
/* A mapping {q: [w, x, y, z], t_m: [x, y, z]} and nothing else. |q| = 1 within 1e-6; q is renormalised only
 * when it is further than 1e-12 from 1, so that what was written comes back bit for bit. |t| up to 1e5 m. */
TD_API td_status td_field_pose(td_pose *pose, const td_field *field, td_error *error);
/* Fails when the value is no mapping, or has a key that is not among `keys` (NULL-terminated), suggesting the
 * nearest. */
TD_API td_status td_field_check_keys(const td_field *field, const char *const keys[], td_error *error);

/* For writers: a real, null when not finite; an array of reals; rows x columns nested. */
TD_API json_t *td_json_real(double value);
TD_API json_t *td_json_reals(const double *value, size_t count);
TD_API json_t *td_json_matrix(const double *value, size_t rows, size_t columns);

#ifdef __cplusplus
}
#endif
#endif
