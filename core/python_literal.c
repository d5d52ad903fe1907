#include "core/python_literal_internal.h"

#include <ctype.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/document_internal.h"
#include "core/number.h"

enum { WORD_SIZE = 64 };

typedef struct reader {
    const char *at, *end;
    const char *name; /* of the file */
    size_t line, values;
    td_error *error;
} reader;

static td_status out_of_memory(const reader *r)
{
    return td_fail(r->error, TD_ERROR_MEMORY, "%s: no memory for its content", r->name);
}

static td_status fail(const reader *r, const char *what)
{
    return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: %s", r->name, r->line, what);
}

/* The next character behind blanks and comments; 0 at the end. */
static char peek(reader *r)
{
    bool comment = false;
    for (; r->at < r->end; r->at++) {
        const char c = *r->at;
        if (c == '\n') {
            r->line++;
            comment = false;
        } else if (c == '#')
            comment = true;
        else if (!comment && !isspace((unsigned char)c))
            return c ? c : 1; /* a 0 in the text is no end */
    }
    return 0;
}

/* 'text' or "text"; escapes \\ \' \" \n \t only. */
static td_status read_string(reader *r, json_t **value)
{
    const char quote = *r->at++;
    td_text text = {0};
    td_text_add(&text, "", 0);
    for (; r->at < r->end && *r->at != quote && *r->at != '\n'; r->at++) {
        static const char letters[] = "\\'\"nt", meant[] = "\\'\"\n\t";
        const char *escape = NULL;
        if (*r->at == '\\' && r->at + 1 < r->end && r->at[1] && (escape = strchr(letters, r->at[1]))) r->at++;
        td_text_add(&text, escape ? meant + (escape - letters) : r->at, 1);
    }
    td_status status = TD_OK;
    if (r->at >= r->end || *r->at != quote)
        status = fail(r, "a text does not end on its line");
    else if (text.failed)
        status = out_of_memory(r);
    else if (td_utf8_check(text.data, text.size) != text.size)
        status = fail(r, "a text is not UTF-8");
    else {
        r->at++;
        *value = json_stringn(text.data, text.size);
        if (!*value) status = out_of_memory(r);
    }
    free(text.data);
    return status;
}

/* A number, True, False, None or, as Python writes them, nan and inf, which become texts. */
static td_status read_word(reader *r, json_t **value)
{
    char word[WORD_SIZE];
    size_t length = 0;
    while (r->at + length < r->end && length + 1 < WORD_SIZE &&
           (isalnum((unsigned char)r->at[length]) || (r->at[length] && strchr("+-._", r->at[length]))))
        length++;
    memcpy(word, r->at, length);
    word[length] = 0;
    long long integer = 0;
    double real = 0;
    const td_number_kind kind = td_number_parse(&integer, &real, word);
    if (kind == TD_NUMBER_TOO_LARGE) return fail(r, "a number is too large");
    if (kind == TD_NUMBER_INTEGER)
        *value = json_integer(integer);
    else if (kind == TD_NUMBER_REAL)
        *value = json_real(real);
    else if (!strcmp(word, "True") || !strcmp(word, "False"))
        *value = json_boolean(*word == 'T');
    else if (!strcmp(word, "None"))
        *value = json_null();
    else if (!strcmp(word, "nan") || !strcmp(word, "inf") || !strcmp(word, "-inf"))
        *value = json_string(word);
    else
        return fail(r, "is not valid: a dictionary, list, text or number is expected here");
    r->at += length;
    return *value ? TD_OK : out_of_memory(r);
}

static td_status read_value(reader *r, int depth, json_t **value);

/* "key": value. */
static td_status read_member(reader *r, int depth, json_t *object)
{
    char shown[TD_SHOWN_SIZE];
    json_t *key = NULL, *value = NULL;
    TD_TRY(read_value(r, depth, &key));
    td_status status = TD_OK;
    if (!json_is_string(key) || json_string_length(key) > TD_DOCUMENT_KEY ||
        strlen(json_string_value(key)) != json_string_length(key))
        status = fail(r, "a key must be a short text");
    else if (json_object_get(object, json_string_value(key)))
        status = td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: the key '%s' is given twice", r->name, r->line,
                         td_text_shown(shown, json_string_value(key)));
    else if (peek(r) != ':')
        status = fail(r, "a ':' is missing behind a key");
    if (status == TD_OK) {
        r->at++;
        status = read_value(r, depth, &value);
    }
    if (status == TD_OK && json_object_set_new(object, json_string_value(key), value) != 0)
        status = out_of_memory(r);
    json_decref(key);
    return status;
}

/* Members or elements up to the closing bracket, commas between. */
static td_status read_container(reader *r, int depth, char close, json_t *made)
{
    r->at++;
    for (;;) {
        char c = peek(r);
        if (c == close) {
            r->at++;
            return TD_OK;
        }
        if (!c) return fail(r, "ends in the middle of a dictionary or list; the file is cut short");
        if (json_is_object(made))
            TD_TRY(read_member(r, depth, made));
        else {
            json_t *value = NULL;
            TD_TRY(read_value(r, depth, &value));
            if (json_array_append_new(made, value) != 0) return out_of_memory(r);
        }
        c = peek(r);
        if (c == ',')
            r->at++;
        else if (c != close)
            return fail(r, c ? "a ',' is missing"
                             : "ends in the middle of a dictionary or list; the file is cut short");
    }
}

static td_status read_value(reader *r, int depth, json_t **value)
{
    const char c = peek(r), next = r->at + 1 < r->end ? r->at[1] : 0;
    if (++r->values > TD_DOCUMENT_VALUES) return fail(r, "more than 1048576 values");
    if (depth > TD_DOCUMENT_DEPTH) return fail(r, "nested deeper than 64 levels");
    if (c == '\'' || c == '"') return read_string(r, value);
    if (c == 'b' && (next == '\'' || next == '"')) {
        json_t *bytes = NULL;
        r->at++;
        TD_TRY(read_string(r, &bytes));
        json_decref(bytes);
        *value = json_null();
        return TD_OK;
    }
    if (c != '{' && c != '[' && c != '(') return read_word(r, value);
    json_t *made = c == '{' ? json_object() : json_array();
    if (!made) return out_of_memory(r);
    const td_status status = read_container(r, depth + 1, c == '{' ? '}' : c == '[' ? ']' : ')', made);
    if (status == TD_OK)
        *value = made;
    else
        json_decref(made);
    return status;
}

td_status td_python_parse(json_t **root, const char *text, size_t size, const char *name, td_error *error)
{
    reader r = {.at = text, .end = text + size, .name = name, .line = 1, .error = error};
    if (size > TD_DOCUMENT_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is larger than the %d bytes that are accepted", name,
                       TD_DOCUMENT_SIZE);
    if (!peek(&r)) return td_fail(error, TD_ERROR_FORMAT, "%s: is empty", name);
    json_t *made = NULL;
    TD_TRY(read_value(&r, 0, &made));
    td_status status = peek(&r) ? fail(&r, "something follows the end of the value") : TD_OK;
    if (status == TD_OK)
        *root = made;
    else
        json_decref(made);
    return status;
}
