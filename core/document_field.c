/* Getters that name the file and the whole path of the field, and makers of values. */
#include <ctype.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "core/document.h"
#include "core/number.h"
#include "core/text_internal.h"

enum { PATH_SIZE = 512, WORD_SIZE = 64, VALUE_SIZE = TD_SHOWN_SIZE + 32 };

/* How far from 1 the length of a quaternion may be in a file, and from where on it is put right. */
static const double QUATERNION_TOLERANCE = 1e-6, QUATERNION_EXACT = 1e-12;
static const double LARGEST_TRANSLATION_M = 1e5;

td_field td_field_get(const td_field *parent, const char *key)
{
    return (td_field){parent, key, json_object_get(parent->value, key)};
}

td_field td_field_at(const td_field *parent, size_t index, char name[TD_FIELD_INDEX_SIZE])
{
    snprintf(name, TD_FIELD_INDEX_SIZE, "[%zu]", index);
    return (td_field){parent, name, json_array_get(parent->value, index)};
}

/* "cameras.left.fx", "views[2].name"; empty for the root. Returns the root. */
static const td_field *write_path(char path[PATH_SIZE], const td_field *field)
{
    if (!field->parent) {
        path[0] = 0;
        return field;
    }
    const td_field *root = write_path(path, field->parent);
    size_t used = strlen(path);
    const char *dot = used && field->name[0] != '[' ? "." : "";
    char shown[TD_SHOWN_SIZE];
    snprintf(path + used, PATH_SIZE - used, "%s%s", dot, td_text_shown(shown, field->name));
    return root;
}

td_status td_field_fail(const td_field *field, td_error *error, const char *format, ...)
{
    if (!error) return TD_ERROR_FORMAT;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(error->message, sizeof error->message, format, arguments);
    va_end(arguments);
    char path[PATH_SIZE];
    const td_field *root = write_path(path, field);
    return td_error_prefix(error, TD_ERROR_FORMAT, "%s%s%s", root->name, *path ? ": " : "", path);
}

static const char *describe(char text[VALUE_SIZE], const json_t *value)
{
    char shown[TD_SHOWN_SIZE], number[TD_NUMBER_SIZE];
    switch (json_typeof(value)) {
    case JSON_OBJECT:
        return "a mapping";
    case JSON_ARRAY:
        return "a list";
    case JSON_TRUE:
        return "true";
    case JSON_FALSE:
        return "false";
    case JSON_NULL:
        return "null";
    case JSON_STRING:
        snprintf(text, VALUE_SIZE, "the text '%s'", td_text_shown(shown, json_string_value(value)));
        break;
    case JSON_INTEGER:
        snprintf(text, VALUE_SIZE, "%" JSON_INTEGER_FORMAT, json_integer_value(value));
        break;
    case JSON_REAL:
        snprintf(text, VALUE_SIZE, "%s", td_number_format(number, json_real_value(value), 0));
        break;
    }
    return text;
}

/* `needed`: "a finite number". */
static td_status wrong_type(const td_field *field, const char *needed, td_error *error)
{
    char text[VALUE_SIZE];
    if (!field->value) return td_field_fail(field, error, "is missing; must be %s", needed);
    return td_field_fail(field, error, "must be %s, but is %s", needed, describe(text, field->value));
}

static td_status out_of_range(const td_field *field, double low, double high, td_error *error)
{
    char text[VALUE_SIZE], l[TD_NUMBER_SIZE], h[TD_NUMBER_SIZE];
    const char *seen = describe(text, field->value);
    td_number_format(l, low, 0);
    td_number_format(h, high, 0);
    if (isinf(low)) return td_field_fail(field, error, "is %s, but must be at most %s", seen, h);
    if (isinf(high)) return td_field_fail(field, error, "is %s, but must be at least %s", seen, l);
    return td_field_fail(field, error, "is %s, but must lie between %s and %s", seen, l, h);
}

td_status td_field_real(double *value, const td_field *field, double low, double high, td_error *error)
{
    if (!json_is_number(field->value)) return wrong_type(field, "a finite number", error);
    double number = json_number_value(field->value);
    if (!(number >= low && number <= high)) return out_of_range(field, low, high, error);
    *value = number;
    return TD_OK;
}

td_status td_field_int(int *value, const td_field *field, int low, int high, td_error *error)
{
    if (!json_is_integer(field->value)) return wrong_type(field, "a whole number", error);
    json_int_t number = json_integer_value(field->value);
    if (number < low || number > high) {
        char text[VALUE_SIZE];
        return td_field_fail(field, error, "is %s, but must lie between %d and %d",
                             describe(text, field->value), low, high);
    }
    *value = (int)number;
    return TD_OK;
}

td_status td_field_bool(bool *value, const td_field *field, td_error *error)
{
    if (!json_is_boolean(field->value)) return wrong_type(field, "true or false", error);
    *value = json_is_true(field->value);
    return TD_OK;
}

td_status td_field_string(const char **value, const td_field *field, td_error *error)
{
    if (json_is_number(field->value)) {
        char text[VALUE_SIZE];
        return td_field_fail(field, error, "must be a text, but is the number %s; put it in quotes",
                             describe(text, field->value));
    }
    if (!json_is_string(field->value)) return wrong_type(field, "a text", error);
    *value = json_string_value(field->value);
    return TD_OK;
}

td_status td_field_count(size_t *count, const td_field *field, size_t low, size_t high, td_error *error)
{
    if (!json_is_array(field->value)) return wrong_type(field, "a list", error);
    size_t size = json_array_size(field->value);
    if (size < low || size > high) {
        if (low == high) return td_field_fail(field, error, "must have %zu elements, but has %zu", low, size);
        return td_field_fail(field, error, "must have %zu to %zu elements, but has %zu", low, high, size);
    }
    *count = size;
    return TD_OK;
}

td_status td_field_choice(int *choice, const td_field *field, const char *const names[], const char *list,
                          td_error *error)
{
    const char *text = NULL;
    TD_TRY(td_field_string(&text, field, error));
    for (int i = 0; names[i]; i++)
        if (!strcmp(text, names[i])) {
            *choice = i;
            return TD_OK;
        }
    char shown[TD_SHOWN_SIZE];
    return td_field_fail(field, error, "is '%s', but must be %s", td_text_shown(shown, text), list);
}

td_status td_field_reals(double *value, size_t count, const td_field *field, double low, double high,
                         td_error *error)
{
    size_t size = 0;
    TD_TRY(td_field_count(&size, field, count, count, error));
    for (size_t i = 0; i < size; i++) {
        char name[TD_FIELD_INDEX_SIZE];
        td_field element = td_field_at(field, i, name);
        TD_TRY(td_field_real(value + i, &element, low, high, error));
    }
    return TD_OK;
}

td_status td_field_pose(td_pose *pose, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"q", "t_m", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field q = td_field_get(field, "q"), t = td_field_get(field, "t_m");
    td_pose read;
    TD_TRY(td_field_reals(read.q, 4, &q, -2, 2, error));
    TD_TRY(td_field_reals(read.t, 3, &t, -LARGEST_TRANSLATION_M, LARGEST_TRANSLATION_M, error));
    double length = 0;
    for (int i = 0; i < 4; i++) length += read.q[i] * read.q[i];
    length = sqrt(length);
    if (!(fabs(length - 1) <= QUATERNION_TOLERANCE)) {
        char number[TD_NUMBER_SIZE];
        return td_field_fail(&q, error, "must be a unit quaternion [w, x, y, z], but its length is %s",
                             td_number_format(number, length, 8));
    }
    if (fabs(length - 1) > QUATERNION_EXACT)
        for (int i = 0; i < 4; i++) read.q[i] /= length;
    *pose = read;
    return TD_OK;
}

static size_t smallest(size_t a, size_t b, size_t c)
{
    size_t m = a < b ? a : b;
    return m < c ? m : c;
}

/* Insertions, deletions, replacements and swaps of neighbours that make `b` of `a`, whatever their case
 * (optimal string alignment; Damerau 1964). Words too long to be mistyped names are infinitely far. */
static size_t edit_distance(const char *a, const char *b)
{
    size_t row[3][WORD_SIZE + 1], m = strlen(a), n = strlen(b);
    if (m > WORD_SIZE || n > WORD_SIZE) return SIZE_MAX;
    for (size_t j = 0; j <= n; j++) row[0][j] = j;
    for (size_t i = 1; i <= m; i++) {
        size_t *now = row[i % 3], *last = row[(i + 2) % 3], *before = row[(i + 1) % 3];
        now[0] = i;
        for (size_t j = 1; j <= n; j++) {
            int x = tolower((unsigned char)a[i - 1]), y = tolower((unsigned char)b[j - 1]);
            now[j] = smallest(last[j] + 1, now[j - 1] + 1, last[j - 1] + (x != y));
            bool swapped = i > 1 && j > 1 && x == tolower((unsigned char)b[j - 2]) &&
                           y == tolower((unsigned char)a[i - 2]);
            if (swapped && before[j - 2] + 1 < now[j]) now[j] = before[j - 2] + 1;
        }
    }
    return row[m % 3][n];
}

static td_status unknown_key(const td_field *field, const char *key, const char *const keys[],
                             td_error *error)
{
    char shown[TD_SHOWN_SIZE];
    td_text_shown(shown, key);
    const char *nearest = NULL;
    const size_t length = strlen(key);
    size_t least = length < 6 ? 1 : length < 9 ? 2 : 3; /* further is no slip of the finger */
    for (size_t i = 0; keys[i]; i++) {
        bool unit_forgotten = length > 0 && !strncmp(keys[i], key, length) && keys[i][length] == '_';
        size_t distance = unit_forgotten ? 1 : edit_distance(key, keys[i]);
        if (distance > least || (nearest && distance == least)) continue;
        least = distance;
        nearest = keys[i];
    }
    if (nearest) return td_field_fail(field, error, "unknown key '%s'; did you mean '%s'?", shown, nearest);
    char list[PATH_SIZE] = "";
    for (size_t i = 0; keys[i]; i++) {
        size_t used = strlen(list);
        snprintf(list + used, sizeof list - used, "%s%s", i ? ", " : "", keys[i]);
    }
    return td_field_fail(field, error, "unknown key '%s'; known here are %s", shown, *list ? list : "none");
}

td_status td_field_check_keys(const td_field *field, const char *const keys[], td_error *error)
{
    if (!json_is_object(field->value)) return wrong_type(field, "a mapping", error);
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)field->value, key, value)
    {
        size_t i = 0;
        while (keys[i] && strcmp(keys[i], key) != 0) i++;
        if (!keys[i]) return unknown_key(field, key, keys, error);
    }
    return TD_OK;
}

json_t *td_json_real(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

json_t *td_json_reals(const double *value, size_t count)
{
    json_t *array = json_array();
    for (size_t i = 0; i < count; i++) {
        if (json_array_append_new(array, td_json_real(value[i])) == 0) continue;
        json_decref(array);
        return NULL;
    }
    return array;
}

json_t *td_json_matrix(const double *value, size_t rows, size_t columns)
{
    json_t *array = json_array();
    for (size_t i = 0; i < rows; i++) {
        if (json_array_append_new(array, td_json_reals(value + i * columns, columns)) == 0) continue;
        json_decref(array);
        return NULL;
    }
    return array;
}
