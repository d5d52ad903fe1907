/* Writing: the tree as YAML or JSON, in a layout of our own that is stable and good to read: a mapping's
 * members below one another, a sequence of scalars on one line however long, so that a matrix stands row by
 * row. */
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/document_internal.h"
#include "core/number.h"
#include "core/text_internal.h"

typedef struct writer {
    td_text text;
    bool json; /* else YAML */
    int digits;
    td_error *error;
} writer;

static bool is_container(const json_t *value)
{
    return json_is_object(value) || json_is_array(value);
}

/* True for what stands on one line: scalars, and sequences of nothing else. */
static bool is_flat(const json_t *value)
{
    if (!is_container(value)) return true;
    if (json_is_object(value)) return json_object_size(value) == 0;
    size_t index;
    json_t *child;
    json_array_foreach(value, index, child) if (is_container(child)) return false;
    return true;
}

/* True for a text that needs no quotes in YAML: plainly a word, and not one that some reader takes for
 * something else (yes, no, on and off were booleans in YAML 1.1; whatever begins like a number or a date is
 * quoted). */
static bool is_word(const char *text)
{
    static const char first[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_/(";
    static const char rest[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_/()0123456789 .+-;=";
    static const char *const taken[] = {"null", "true", "false", "yes", "no", "on", "off", NULL};
    size_t length = strlen(text);
    if (length == 0 || !strchr(first, text[0]) || text[strspn(text, rest)] || text[length - 1] == ' ')
        return false;
    for (size_t w = 0; taken[w]; w++) {
        size_t i = 0;
        while (taken[w][i] && (text[i] | 0x20) == taken[w][i]) i++;
        if (!taken[w][i] && !text[i]) return false;
    }
    return true;
}

/* In double quotes, with escapes that JSON and YAML understand alike, for what neither or only one takes as
 * it is. */
static void add_quoted(td_text *out, const char *text, size_t size)
{
    td_text_add(out, "\"", 1);
    for (size_t at = 0; at < size;) {
        unsigned code = 0;
        size_t length = td_utf8_decode(&code, text + at, size - at);
        bool odd = code < 0x20 || (code >= 0x7F && code < 0xA0) || code == 0x2028 || code == 0x2029 ||
                   code == 0xFEFF || code == 0xFFFE || code == 0xFFFF;
        if (code == '"' || code == '\\')
            td_text_format(out, "\\%c", (int)code);
        else if (code == '\n')
            td_text_add(out, "\\n", 2);
        else if (code == '\t')
            td_text_add(out, "\\t", 2);
        else if (odd)
            td_text_format(out, "\\u%04x", code);
        else
            td_text_add(out, text + at, length);
        at += length;
    }
    td_text_add(out, "\"", 1);
}

void td_document_add_word(td_text *out, const char *text)
{
    const size_t size = strlen(text);
    if (is_word(text))
        td_text_add(out, text, size);
    else
        add_quoted(out, text, size);
}

static td_status add_string(writer *w, const char *text, size_t size)
{
    char shown[TD_SHOWN_SIZE];
    if (td_utf8_check(text, size) != size)
        return td_fail(w->error, TD_ERROR_ARGUMENT,
                       "the text '%s' holds a null character, so it cannot be written",
                       td_text_shown(shown, text));
    if (!w->json && is_word(text))
        td_text_add(&w->text, text, size);
    else
        add_quoted(&w->text, text, size);
    return TD_OK;
}

static td_status add_key(writer *w, const char *key)
{
    char shown[TD_SHOWN_SIZE];
    size_t size = strlen(key);
    if (size > TD_DOCUMENT_KEY)
        return td_fail(w->error, TD_ERROR_ARGUMENT,
                       "the key '%s' is longer than %d bytes, so it cannot be written",
                       td_text_shown(shown, key), TD_DOCUMENT_KEY);
    TD_TRY(add_string(w, key, size));
    td_text_add(&w->text, ":", 1);
    return TD_OK;
}

/* A flat value on the line where we stand. */
static td_status add_flat(writer *w, const json_t *value)
{
    char number[TD_NUMBER_SIZE];
    td_text *out = &w->text;
    size_t index;
    json_t *child;
    switch (json_typeof(value)) {
    case JSON_NULL:
        td_text_format(out, "null");
        break;
    case JSON_TRUE:
        td_text_format(out, "true");
        break;
    case JSON_FALSE:
        td_text_format(out, "false");
        break;
    case JSON_INTEGER:
        td_text_format(out, "%" JSON_INTEGER_FORMAT, json_integer_value(value));
        break;
    case JSON_REAL:
        td_text_format(out, "%s", td_number_format(number, json_real_value(value), w->digits));
        break;
    case JSON_STRING:
        return add_string(w, json_string_value(value), json_string_length(value));
    case JSON_OBJECT:
        td_text_format(out, "{}");
        break;
    case JSON_ARRAY:
        td_text_add(out, "[", 1);
        json_array_foreach(value, index, child)
        {
            if (index > 0) td_text_add(out, ", ", 2);
            TD_TRY(add_flat(w, child));
        }
        td_text_add(out, "]", 1);
        break;
    }
    return TD_OK;
}

static td_status check_depth(const writer *w, int depth)
{
    /* A tree that holds itself ends here too. */
    if (depth < TD_DOCUMENT_DEPTH) return TD_OK;
    return td_fail(w->error, TD_ERROR_ARGUMENT, "values nested deeper than %d levels cannot be written",
                   TD_DOCUMENT_DEPTH);
}

static td_status add_json(writer *w, const json_t *value, int depth)
{
    if (is_container(value)) TD_TRY(check_depth(w, depth));
    if (is_flat(value)) return add_flat(w, value);
    const int indent = 2 * (depth + 1);
    const bool object = json_is_object(value);
    size_t index = 0;
    const char *key;
    json_t *child;
    td_text_add(&w->text, object ? "{" : "[", 1);
    if (object) {
        json_object_foreach((json_t *)value, key, child)
        {
            td_text_format(&w->text, "%s\n%*s", index++ ? "," : "", indent, "");
            TD_TRY(add_key(w, key));
            td_text_add(&w->text, " ", 1);
            TD_TRY(add_json(w, child, depth + 1));
        }
    } else {
        json_array_foreach(value, index, child)
        {
            td_text_format(&w->text, "%s\n%*s", index ? "," : "", indent, "");
            TD_TRY(add_json(w, child, depth + 1));
        }
    }
    td_text_format(&w->text, "\n%*s%s", indent - 2, "", object ? "}" : "]");
    return TD_OK;
}

static td_status add_yaml(writer *w, const json_t *value, int indent, int depth);

/* The members of a mapping at `indent`; the first where we stand when `inline_first`. */
static td_status add_yaml_members(writer *w, const json_t *object, int indent, int depth, bool inline_first)
{
    const char *key;
    json_t *child;
    json_object_foreach((json_t *)object, key, child)
    {
        if (!inline_first) td_text_indent(&w->text, indent);
        inline_first = false;
        TD_TRY(add_key(w, key));
        TD_TRY(add_yaml(w, child, indent, depth + 1));
    }
    return TD_OK;
}

/* What stands behind "key:" or "-" at `indent`, with the end of its line. */
static td_status add_yaml(writer *w, const json_t *value, int indent, int depth)
{
    if (is_container(value)) TD_TRY(check_depth(w, depth));
    if (is_flat(value)) {
        td_text_add(&w->text, " ", 1);
        TD_TRY(add_flat(w, value));
        td_text_add(&w->text, "\n", 1);
        return TD_OK;
    }
    td_text_add(&w->text, "\n", 1);
    if (json_is_object(value)) return add_yaml_members(w, value, indent + 2, depth, false);
    size_t index;
    json_t *child;
    json_array_foreach(value, index, child)
    {
        td_text_format(&w->text, "%*s-", indent + 2, "");
        if (json_is_object(child) && !is_flat(child)) {
            TD_TRY(check_depth(w, depth + 1));
            td_text_add(&w->text, " ", 1);
            TD_TRY(add_yaml_members(w, child, indent + 4, depth + 1, true));
        } else {
            TD_TRY(add_yaml(w, child, indent + 2, depth + 1));
        }
    }
    return TD_OK;
}

static td_status add_root(writer *w, const json_t *root)
{
    if (!json_is_object(root))
        return td_fail(w->error, TD_ERROR_ARGUMENT, "the root of a document must be a mapping");
    if (w->digits < 0 || w->digits > TD_DOCUMENT_REAL_DIGITS)
        return td_fail(w->error, TD_ERROR_ARGUMENT, "digits: is %d, must lie between 0 and %d", w->digits,
                       TD_DOCUMENT_REAL_DIGITS);
    if (!w->json && !is_flat(root)) return add_yaml_members(w, root, 0, 0, false);
    TD_TRY(add_json(w, root, 0));
    td_text_add(&w->text, "\n", 1);
    return TD_OK;
}

static td_status write_document(char **text, writer *w, const json_t *root)
{
    td_status status = add_root(w, root);
    if (status == TD_OK && w->text.failed)
        status = td_fail(w->error, TD_ERROR_MEMORY, "no memory for the text of a document");
    if (status == TD_OK && w->text.size > TD_DOCUMENT_SIZE)
        status = td_fail(w->error, TD_ERROR_ARGUMENT,
                         "a document of %zu bytes is larger than the %d that can be read", w->text.size,
                         TD_DOCUMENT_SIZE);
    if (status == TD_OK)
        *text = w->text.data;
    else
        free(w->text.data);
    return status;
}

td_status td_document_to_yaml(char **text, const json_t *root, int digits, td_error *error)
{
    writer w = {.digits = digits, .error = error};
    return write_document(text, &w, root);
}

td_status td_document_to_json(char **text, const json_t *root, int digits, td_error *error)
{
    writer w = {.json = true, .digits = digits, .error = error};
    return write_document(text, &w, root);
}
