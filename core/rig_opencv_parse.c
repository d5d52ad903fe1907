/* OpenCV's FileStorage. Its YAML differs from everyone's in the first line, %YAML:1.0, and in tags before
 * matrices: both are blanked, so that lines and columns stay as they are, and the rest is read by
 * core/document.h. */
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/document_internal.h"
#include "core/number.h"
#include "core/rig_formats_internal.h"
#include "core/rig_opencv_internal.h"
#include "core/xml_internal.h"

static void blank(char *text, size_t count)
{
    memset(text, ' ', count);
}

/* Blanks "!!opencv-matrix" and its like outside quotes and comments. */
static void blank_tags(char *text, size_t size)
{
    char quote = 0;
    bool comment = false;
    for (size_t i = 0; i < size; i++) {
        const char c = text[i], before = i ? text[i - 1] : '\n';
        const bool free_standing = before == ' ' || before == '\n' || before == '\t';
        if (c == '\n') comment = false;
        if (comment) continue;
        if (quote) {
            if (c == '\\' && quote == '"') i++;
            if (c == quote) quote = 0;
        } else if ((c == '"' || c == '\'') && (free_standing || strchr(":,[{", before)))
            quote = c;
        else if (c == '#' && free_standing)
            comment = true;
        else if (c == '!' && i + 1 < size && text[i + 1] == '!' && free_standing) {
            size_t end = i;
            while (end < size && !strchr(" \t\r\n", text[end])) end++;
            blank(text + i, end - i);
        }
    }
}

static td_status parse_yaml(json_t **root, const td_rig_text *file, td_error *error)
{
    static const char directive[] = "%YAML";
    char *text = malloc(file->size + 1);
    if (!text) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its content", file->name);
    memcpy(text, file->text, file->size);
    text[file->size] = 0;
    if (!strncmp(text, directive, strlen(directive))) blank(text, strcspn(text, "\r\n"));
    blank_tags(text, file->size);
    const td_status status = td_document_parse(root, text, file->size, file->name, error);
    free(text);
    return status;
}

/* "1. 2. 3." as a list of numbers; anything else as it is. */
static td_status split_numbers(json_t **list, const char *text, const char *name, td_error *error)
{
    json_t *made = json_array();
    bool numbers = *text != 0;
    while (numbers && *(text += strspn(text, " \t\r\n"))) {
        char word[64];
        const size_t length = strcspn(text, " \t\r\n");
        double value = 0;
        numbers = length < sizeof word;
        if (!numbers) break;
        memcpy(word, text, length);
        word[length] = 0;
        numbers = td_number_real(&value, word);
        if (numbers && json_array_append_new(made, json_real(value)) != 0) {
            json_decref(made);
            return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its content", name);
        }
        text += length;
    }
    if (!numbers) {
        json_decref(made);
        made = NULL;
    }
    *list = made;
    return TD_OK;
}

/* XML has numbers of a list and quoted texts as one text: puts them right, everywhere in the tree. */
static td_status refine(json_t *object, const char *name, td_error *error)
{
    const char *key;
    json_t *value;
    void *next;
    json_object_foreach_safe(object, next, key, value)
    {
        if (json_is_object(value)) {
            TD_TRY(refine(value, name, error));
            continue;
        }
        if (!strcmp(key, "data") && json_is_number(value)) {
            json_object_set_new(object, key, json_pack("[O]", value));
            continue;
        }
        if (!json_is_string(value)) continue;
        const char *text = json_string_value(value);
        const size_t length = strlen(text);
        json_t *list = NULL;
        TD_TRY(split_numbers(&list, text, name, error));
        if (list)
            json_object_set_new(object, key, list);
        else if (length >= 2 && *text == '"' && text[length - 1] == '"')
            json_object_set_new(object, key, json_stringn(text + 1, length - 2));
    }
    return TD_OK;
}

static td_status parse_xml(json_t **root, const td_rig_text *file, td_error *error)
{
    char top[32], shown[TD_SHOWN_SIZE];
    json_t *made = NULL;
    TD_TRY(td_xml_parse(&made, top, file->text, file->size, file->name, error));
    td_status status = TD_OK;
    if (strcmp(top, "opencv_storage") != 0)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: the root element is <%s>, not <opencv_storage>",
                         file->name, td_text_shown(shown, top));
    if (status == TD_OK) status = refine(made, file->name, error);
    if (status == TD_OK)
        *root = made;
    else
        json_decref(made);
    return status;
}

td_status td_opencv_parse(json_t **root, const td_rig_text *file, td_error *error)
{
    size_t at = 0;
    if (file->size >= 3 && !memcmp(file->text, "\xEF\xBB\xBF", 3)) at = 3;
    while (at < file->size && strchr(" \t\r\n", file->text[at]) && file->text[at]) at++;
    if (at < file->size && file->text[at] == '<') return parse_xml(root, file, error);
    return parse_yaml(root, file, error);
}
