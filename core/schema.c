#include "core/schema.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/document_internal.h"
#include "core/text_internal.h"

enum { NAME_SIZE = 64 };

/* What is being checked. */
typedef struct checker {
    const td_schema_row *row;
    size_t count;
    td_error *error;
} checker;

static const char *type_name(td_schema_type type)
{
    switch (type) {
    case TD_SCHEMA_OBJECT:
        return "mapping";
    case TD_SCHEMA_ARRAY:
        return "list of mappings";
    case TD_SCHEMA_STRING:
        return "text";
    case TD_SCHEMA_STRINGS:
        return "list of texts";
    case TD_SCHEMA_REAL:
        return "number";
    case TD_SCHEMA_REALS:
        return "list of numbers";
    case TD_SCHEMA_MATRIX:
        return "matrix";
    case TD_SCHEMA_INT:
        return "whole number";
    case TD_SCHEMA_BOOL:
        return "true or false";
    case TD_SCHEMA_TYPE_COUNT:
        break;
    }
    return "unknown type";
}

/* The next part of a path: a key, "*" or "[]". Its length; 0 at the end. */
static size_t next_part(const char **part, const char **path)
{
    const char *p = *path;
    if (*p == '.') p++;
    *part = p;
    const size_t length = *p == '[' ? 2 : strcspn(p, ".[");
    *path = p + length;
    return length;
}

static bool is_element(const td_field *field)
{
    return json_is_array(field->parent->value);
}

/* True when the first parts of `path` are those of the field; *rest is what is left of it, *stars how many
 * keys were matched by "*". */
static bool fits(const char *path, const td_field *field, const char **rest, int *stars)
{
    if (!field->parent) {
        *rest = path;
        *stars = 0;
        return true;
    }
    if (!fits(path, field->parent, rest, stars)) return false;
    const char *part;
    const size_t length = next_part(&part, rest);
    if (length == 0) return false;
    if (is_element(field)) return *part == '[';
    if (length == 1 && *part == '*') {
        ++*stars;
        return true;
    }
    return strlen(field->name) == length && !strncmp(part, field->name, length);
}

/* The row of a value: of several that fit, the one with fewest stars. */
static const td_schema_row *find_row(const checker *c, const td_field *field)
{
    const td_schema_row *best = NULL;
    int least = 0;
    for (size_t i = 0; i < c->count; i++) {
        const char *rest;
        int stars;
        if (!fits(c->row[i].path, field, &rest, &stars) || *rest) continue;
        if (best && stars >= least) continue;
        best = c->row + i;
        least = stars;
    }
    return best;
}

static bool are_all(const json_t *array, bool (*is_one)(const json_t *value, bool nullable), bool nullable)
{
    size_t index;
    json_t *value;
    if (!json_is_array(array)) return false;
    json_array_foreach(array, index, value) if (!is_one(value, nullable)) return false;
    return true;
}

static bool is_real(const json_t *value, bool nullable)
{
    return json_is_number(value) || (nullable && json_is_null(value));
}

static bool is_text(const json_t *value, bool nullable)
{
    (void)nullable;
    return json_is_string(value);
}

static bool is_mapping(const json_t *value, bool nullable)
{
    (void)nullable;
    return json_is_object(value);
}

static bool is_matrix(const json_t *value, bool nullable)
{
    if (!json_is_array(value)) return false;
    for (size_t i = 0; i < json_array_size(value); i++) {
        const json_t *row = json_array_get(value, i);
        if (!are_all(row, is_real, nullable)) return false;
        if (json_array_size(row) != json_array_size(json_array_get(value, 0))) return false;
    }
    return true;
}

static bool has_type(const json_t *value, const td_schema_row *row)
{
    if (json_is_null(value)) return row->nullable;
    switch (row->type) {
    case TD_SCHEMA_OBJECT:
        return json_is_object(value);
    case TD_SCHEMA_ARRAY:
        return are_all(value, is_mapping, false);
    case TD_SCHEMA_STRING:
        return json_is_string(value);
    case TD_SCHEMA_STRINGS:
        return are_all(value, is_text, false);
    case TD_SCHEMA_REAL:
        return json_is_number(value);
    case TD_SCHEMA_REALS:
        return are_all(value, is_real, row->nullable);
    case TD_SCHEMA_MATRIX:
        return is_matrix(value, row->nullable);
    case TD_SCHEMA_INT:
        return json_is_integer(value);
    case TD_SCHEMA_BOOL:
        return json_is_boolean(value);
    case TD_SCHEMA_TYPE_COUNT:
        break;
    }
    return false;
}

/* The rows one level below a mapping that must be there are there. */
static td_status check_required(const checker *c, const td_field *field)
{
    for (size_t i = 0; i < c->count; i++) {
        const char *rest, *part;
        int stars;
        if (!c->row[i].required || !fits(c->row[i].path, field, &rest, &stars)) continue;
        const size_t length = next_part(&part, &rest);
        if (length == 0 || *rest || *part == '[') continue;
        if (length == 1 && *part == '*') {
            if (json_object_size(field->value) > 0) continue;
            return td_field_fail(field, c->error, "is empty");
        }
        char name[NAME_SIZE];
        snprintf(name, sizeof name, "%.*s", (int)length, part);
        td_field child = td_field_get(field, name);
        if (!child.value) return td_field_fail(&child, c->error, "is missing (%s)", c->row[i].text);
    }
    return TD_OK;
}

static td_status check_mapping(const checker *c, const td_field *field, int depth);

static td_status check_value(const checker *c, const td_field *field, int depth)
{
    const td_schema_row *row = find_row(c, field);
    if (!row) return td_field_fail(field, c->error, "is not in the schema");
    if (!has_type(field->value, row))
        return td_field_fail(field, c->error, "must be a %s%s (%s)", type_name(row->type),
                             row->nullable ? " or null" : "", row->text);
    if (json_is_object(field->value)) return check_mapping(c, field, depth + 1);
    if (row->type != TD_SCHEMA_ARRAY) return TD_OK;
    for (size_t i = 0; i < json_array_size(field->value); i++) {
        char name[TD_FIELD_INDEX_SIZE];
        td_field element = td_field_at(field, i, name);
        TD_TRY(check_mapping(c, &element, depth + 1));
    }
    return TD_OK;
}

static td_status check_mapping(const checker *c, const td_field *field, int depth)
{
    if (depth > TD_DOCUMENT_DEPTH) return td_field_fail(field, c->error, "is nested too deep");
    TD_TRY(check_required(c, field));
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)field->value, key, value)
    {
        td_field child = {field, key, value};
        TD_TRY(check_value(c, &child, depth));
    }
    return TD_OK;
}

td_status td_schema_check(const json_t *root, const td_schema_row *row, size_t count, td_error *error)
{
    const checker c = {row, count, error};
    const td_field field = {NULL, "result", root};
    if (!json_is_object(root)) return td_field_fail(&field, error, "must be a mapping");
    return check_mapping(&c, &field, 0);
}

/* "number or null, optional"; returns its length. */
static int write_type(char text[NAME_SIZE], const td_schema_row *row)
{
    return snprintf(text, NAME_SIZE, "%s%s%s", type_name(row->type), row->nullable ? " or null" : "",
                    row->required ? "" : ", optional");
}

char *td_schema_describe(const td_schema_row *row, size_t count)
{
    char type[NAME_SIZE];
    int path_width = 0, type_width = 0;
    for (size_t i = 0; i < count; i++) {
        const int path = (int)strlen(row[i].path), wide = write_type(type, row + i);
        if (path > path_width) path_width = path;
        if (wide > type_width) type_width = wide;
    }
    td_text out = {0};
    td_text_add(&out, "", 0);
    for (size_t i = 0; i < count; i++) {
        write_type(type, row + i);
        td_text_format(&out, "%-*s  %-*s  %s\n", path_width, row[i].path, type_width, type, row[i].text);
    }
    if (!out.failed) return out.data;
    free(out.data);
    return NULL;
}
