/* Reading: libyaml's events, one after another, become the tree. */
#include "core/document.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <yaml.h>

#include "core/document_internal.h"
#include "core/file.h"
#include "core/number.h"
#include "core/text_internal.h"

typedef struct reader {
    yaml_parser_t yaml;
    const char *name; /* of the file */
    size_t values;    /* so far */
    td_error *error;
} reader;

/* Fails naming the file and the line. */
static td_status fail_at(reader *r, yaml_mark_t mark, const char *format, ...) TD_PRINTF(3, 4);

static td_status fail_at(reader *r, yaml_mark_t mark, const char *format, ...)
{
    if (!r->error) return TD_ERROR_FORMAT;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(r->error->message, sizeof r->error->message, format, arguments);
    va_end(arguments);
    return td_error_prefix(r->error, TD_ERROR_FORMAT, "%s:%zu", r->name, mark.line + 1);
}

static td_status out_of_memory(reader *r)
{
    return td_fail(r->error, TD_ERROR_MEMORY, "%s: no memory for its content", r->name);
}

static td_status parser_failed(reader *r)
{
    const yaml_parser_t *y = &r->yaml;
    if (y->error == YAML_MEMORY_ERROR) return out_of_memory(r);
    if (y->error == YAML_READER_ERROR)
        return td_fail(r->error, TD_ERROR_FORMAT, "%s: byte %zu: is not text: %s", r->name, y->problem_offset,
                       y->problem);
    return fail_at(r, y->problem_mark, "is not valid YAML: %s%s%s", y->context ? y->context : "",
                   y->context ? ", " : "", y->problem ? y->problem : "unknown reason");
}

static td_status next_event(reader *r, yaml_event_t *event)
{
    return yaml_parser_parse(&r->yaml, event) ? TD_OK : parser_failed(r);
}

static bool is_one_of(const char *text, const char *const words[])
{
    for (; *words; words++)
        if (!strcmp(text, *words)) return true;
    return false;
}

/* The core schema of YAML 1.2.2 (10.3.2); .nan and .inf stay strings: jansson has no such reals. */
static td_status read_plain(reader *r, const yaml_event_t *event, json_t **value)
{
    static const char *const nulls[] = {"", "~", "null", "Null", "NULL", NULL};
    static const char *const trues[] = {"true", "True", "TRUE", NULL};
    static const char *const falses[] = {"false", "False", "FALSE", NULL};
    const char *text = (const char *)event->data.scalar.value;
    long long integer = 0;
    double real = 0;
    char shown[TD_SHOWN_SIZE];
    if (is_one_of(text, nulls))
        *value = json_null();
    else if (is_one_of(text, trues))
        *value = json_true();
    else if (is_one_of(text, falses))
        *value = json_false();
    else {
        switch (td_number_parse(&integer, &real, text)) {
        case TD_NUMBER_INTEGER:
            *value = json_integer(integer);
            break;
        case TD_NUMBER_REAL:
            *value = json_real(real);
            break;
        case TD_NUMBER_NONE:
            *value = json_string(text);
            break;
        case TD_NUMBER_TOO_LARGE:
            return fail_at(r, event->start_mark, "the number %s is too large", td_text_shown(shown, text));
        }
    }
    return *value ? TD_OK : out_of_memory(r);
}

static td_status check_text(reader *r, const yaml_event_t *event)
{
    if (memchr(event->data.scalar.value, 0, event->data.scalar.length))
        return fail_at(r, event->start_mark, "the text holds a null character");
    return TD_OK;
}

static td_status read_scalar(reader *r, const yaml_event_t *event, json_t **value)
{
    TD_TRY(check_text(r, event));
    if (event->data.scalar.style == YAML_PLAIN_SCALAR_STYLE) return read_plain(r, event, value);
    *value = json_stringn((const char *)event->data.scalar.value, event->data.scalar.length);
    return *value ? TD_OK : out_of_memory(r);
}

/* Anchors would make a tree of a few lines into one of billions of values; tags ask for types that we do not
 * have. */
static td_status check_plainness(reader *r, const yaml_event_t *event)
{
    const yaml_char_t *anchor = NULL, *tag = NULL;
    if (event->type == YAML_SCALAR_EVENT) {
        anchor = event->data.scalar.anchor;
        tag = event->data.scalar.tag;
    } else if (event->type == YAML_SEQUENCE_START_EVENT) {
        anchor = event->data.sequence_start.anchor;
        tag = event->data.sequence_start.tag;
    } else if (event->type == YAML_MAPPING_START_EVENT) {
        anchor = event->data.mapping_start.anchor;
        tag = event->data.mapping_start.tag;
    }
    if (anchor || event->type == YAML_ALIAS_EVENT)
        return fail_at(r, event->start_mark,
                       "anchors and aliases (& and *) are not accepted; write the value out, or "
                       "quote the text if it begins with & or *");
    if (tag)
        return fail_at(r, event->start_mark,
                       "tags (!) are not accepted; leave the tag out, or quote the text if it "
                       "begins with !");
    return TD_OK;
}

static td_status read_value(reader *r, const yaml_event_t *event, int depth, json_t **value);

static td_status read_sequence(reader *r, int depth, json_t *array)
{
    for (;;) {
        yaml_event_t event;
        TD_TRY(next_event(r, &event));
        json_t *child = NULL;
        bool end = event.type == YAML_SEQUENCE_END_EVENT;
        td_status status = end ? TD_OK : read_value(r, &event, depth + 1, &child);
        yaml_event_delete(&event);
        if (end || status != TD_OK) return status;
        if (json_array_append_new(array, child) != 0) return out_of_memory(r);
    }
}

/* Checks the key that `event` is, reads the value behind it and adds both. */
static td_status read_member(reader *r, const yaml_event_t *event, int depth, json_t *object)
{
    if (event->type != YAML_SCALAR_EVENT)
        return fail_at(r, event->start_mark, "a key must be a plain word, not a list or mapping");
    TD_TRY(check_plainness(r, event));
    TD_TRY(check_text(r, event));
    char shown[TD_SHOWN_SIZE];
    const char *key = (const char *)event->data.scalar.value;
    if (event->data.scalar.length > TD_DOCUMENT_KEY)
        return fail_at(r, event->start_mark, "the key '%s' is longer than %d bytes",
                       td_text_shown(shown, key), TD_DOCUMENT_KEY);
    if (json_object_get(object, key))
        return fail_at(r, event->start_mark, "the key '%s' is given twice", td_text_shown(shown, key));
    yaml_event_t next;
    TD_TRY(next_event(r, &next));
    json_t *child = NULL;
    td_status status = read_value(r, &next, depth + 1, &child);
    yaml_event_delete(&next);
    if (status != TD_OK) return status;
    return json_object_set_new(object, key, child) == 0 ? TD_OK : out_of_memory(r);
}

static td_status read_mapping(reader *r, int depth, json_t *object)
{
    for (;;) {
        yaml_event_t event;
        TD_TRY(next_event(r, &event));
        bool end = event.type == YAML_MAPPING_END_EVENT;
        td_status status = end ? TD_OK : read_member(r, &event, depth, object);
        yaml_event_delete(&event);
        if (end || status != TD_OK) return status;
    }
}

/* The value that begins with `event`, which stays the caller's. */
static td_status read_value(reader *r, const yaml_event_t *event, int depth, json_t **value)
{
    TD_TRY(check_plainness(r, event));
    if (++r->values > TD_DOCUMENT_VALUES)
        return fail_at(r, event->start_mark, "more than %d values", TD_DOCUMENT_VALUES);
    if (event->type == YAML_SCALAR_EVENT) return read_scalar(r, event, value);
    if (depth >= TD_DOCUMENT_DEPTH)
        return fail_at(r, event->start_mark, "nested deeper than %d levels", TD_DOCUMENT_DEPTH);
    bool mapping = event->type == YAML_MAPPING_START_EVENT;
    json_t *made = mapping ? json_object() : json_array();
    if (!made) return out_of_memory(r);
    td_status status = mapping ? read_mapping(r, depth, made) : read_sequence(r, depth, made);
    if (status == TD_OK)
        *value = made;
    else
        json_decref(made);
    return status;
}

/* The root, or what stands there instead of it. */
static td_status read_root(reader *r, json_t **root)
{
    yaml_event_t event;
    TD_TRY(next_event(r, &event));
    td_status status = read_value(r, &event, 0, root);
    if (status == TD_OK && !json_is_object(*root)) {
        json_decref(*root);
        *root = NULL;
        status = fail_at(r, event.start_mark, "must be a mapping of keys to values");
    }
    yaml_event_delete(&event);
    return status;
}

/* Passes over an event; *type says what it was. */
static td_status skip_event(reader *r, yaml_event_type_t *type)
{
    yaml_event_t event;
    TD_TRY(next_event(r, &event));
    *type = event.type;
    yaml_event_delete(&event);
    return TD_OK;
}

static td_status read_document(reader *r, json_t **root)
{
    yaml_event_type_t type;
    TD_TRY(skip_event(r, &type)); /* the stream's start */
    TD_TRY(skip_event(r, &type));
    if (type == YAML_STREAM_END_EVENT)
        return td_fail(r->error, TD_ERROR_FORMAT, "%s: is empty; a mapping of keys to values is needed",
                       r->name);
    json_t *made = NULL;
    TD_TRY(read_root(r, &made));
    td_status status = skip_event(r, &type); /* the document's end */
    if (status == TD_OK) status = skip_event(r, &type);
    if (status == TD_OK && type != YAML_STREAM_END_EVENT)
        status = fail_at(r, r->yaml.mark, "a second document begins; only one is accepted");
    if (status == TD_OK)
        *root = made;
    else
        json_decref(made);
    return status;
}

td_status td_document_parse(json_t **root, const char *text, size_t size, const char *name, td_error *error)
{
    reader r = {.name = name, .error = error};
    if (size > TD_DOCUMENT_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is larger than the %d bytes that are accepted", name,
                       TD_DOCUMENT_SIZE);
    if (!yaml_parser_initialize(&r.yaml)) return out_of_memory(&r);
    yaml_parser_set_input_string(&r.yaml, (const unsigned char *)text, size);
    td_status status = read_document(&r, root);
    yaml_parser_delete(&r.yaml);
    return status;
}

td_status td_document_read(json_t **root, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    TD_TRY(td_file_read(&text, &size, path, TD_DOCUMENT_SIZE, error));
    td_status status = td_document_parse(root, text, size, path, error);
    free(text);
    return status;
}
