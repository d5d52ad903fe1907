/* Lines for messages: the text is read once more, only where something failed, as far as the field. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <yaml.h>

#include "core/document.h"
#include "core/document_internal.h"
#include "core/text_internal.h"

enum { MESSAGE_SIZE = sizeof((td_error *)NULL)->message };

typedef struct finder {
    yaml_parser_t yaml;
    size_t line; /* from 1, of the last part of the path that was found; 0: none */
} finder;

static bool begins(yaml_event_type_t type)
{
    return type == YAML_MAPPING_START_EVENT || type == YAML_SEQUENCE_START_EVENT;
}

static bool ends(yaml_event_type_t type)
{
    return type == YAML_MAPPING_END_EVENT || type == YAML_SEQUENCE_END_EVENT;
}

/* Passes over the rest of a value that began with an event of this type. */
static bool pass_value(finder *f, yaml_event_type_t type)
{
    size_t depth = begins(type) ? 1 : 0;
    while (depth > 0) {
        yaml_event_t event;
        if (!yaml_parser_parse(&f->yaml, &event)) return false;
        if (begins(event.type)) depth++;
        if (ends(event.type)) depth--;
        yaml_event_delete(&event);
    }
    return true;
}

/* What of `path` is left behind this key, as messages write it; NULL: the path does not go there. */
static const char *behind_key(const char *path, const char *key)
{
    char shown[TD_SHOWN_SIZE];
    const size_t size = strlen(td_text_shown(shown, key));
    if (strncmp(path, shown, size) != 0) return NULL;
    if (path[size] == '.') return path + size + 1;
    return path[size] == '[' || path[size] == 0 ? path + size : NULL;
}

/* The next value of the mapping or sequence that is on the path: *type is what it begins with. False: none.
 */
static bool next_on_path(finder *f, bool mapping, const char **path, yaml_event_type_t *type)
{
    char *end = NULL;
    const unsigned long wanted = mapping ? 0 : strtoul(*path + 1, &end, 10);
    if (!mapping && (**path != '[' || *end != ']')) return false;
    for (unsigned long index = 0;; index++) {
        yaml_event_t event;
        const char *rest = NULL;
        if (!yaml_parser_parse(&f->yaml, &event)) return false;
        if (mapping && event.type == YAML_SCALAR_EVENT)
            rest = behind_key(*path, (const char *)event.data.scalar.value);
        if (!mapping && index == wanted && !ends(event.type)) rest = end[1] == '.' ? end + 2 : end + 1;
        const bool over = ends(event.type);
        const size_t line = event.start_mark.line + 1;
        *type = event.type;
        yaml_event_delete(&event);
        if (over) return false;
        if (mapping) {
            if (!yaml_parser_parse(&f->yaml, &event)) return false;
            *type = event.type;
            yaml_event_delete(&event);
        }
        if (rest) {
            f->line = line;
            *path = rest;
            return true;
        }
        if (!pass_value(f, *type)) return false;
    }
}

static void follow(finder *f, const char *path)
{
    yaml_event_type_t type = YAML_NO_EVENT;
    for (int i = 0; i < 3; i++) { /* the stream, the document, its root */
        yaml_event_t event;
        if (!yaml_parser_parse(&f->yaml, &event)) return;
        type = event.type;
        yaml_event_delete(&event);
    }
    while (*path && begins(type))
        if (!next_on_path(f, type == YAML_MAPPING_START_EVENT, &path, &type)) return;
}

size_t td_document_line(const char *text, size_t size, const char *path)
{
    finder f = {.line = 0};
    if (!yaml_parser_initialize(&f.yaml)) return 0;
    yaml_parser_set_input_string(&f.yaml, (const unsigned char *)text, size);
    follow(&f, path);
    yaml_parser_delete(&f.yaml);
    return f.line;
}

/* The path that a message of td_field_fail names behind the file's name, with an unknown key that it names.
 */
static void path_of(char path[MESSAGE_SIZE], const char *message)
{
    static const char unknown[] = "unknown key '";
    const char *word = strstr(message, unknown), *end = word;
    size_t size = 0;
    path[0] = 0;
    if (word != message) {
        end = strstr(message, ": ");
        if (!end) return;
        size = (size_t)(end - message);
        memcpy(path, message, size);
        path[size] = 0;
        end += 2;
    }
    if (strncmp(end, unknown, sizeof unknown - 1) != 0) return;
    const char *key = end + sizeof unknown - 1, *close = strchr(key, '\'');
    if (close) snprintf(path + size, MESSAGE_SIZE - size, "%s%.*s", size ? "." : "", (int)(close - key), key);
}

td_status td_document_locate(td_error *error, td_status status, const char *text, size_t size,
                             const char *name)
{
    const size_t known = strlen(name);
    if (!error || strncmp(error->message, name, known) != 0 || strncmp(error->message + known, ": ", 2) != 0)
        return status;
    char rest[MESSAGE_SIZE], path[MESSAGE_SIZE];
    strcpy(rest, error->message + known + 2);
    path_of(path, rest);
    const size_t line = td_document_line(text, size, path);
    if (line == 0) return status;
    snprintf(error->message, sizeof error->message, "%s:%zu: %s", name, line, rest);
    return status;
}
