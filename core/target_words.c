#include "core/target_words.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/number.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

enum { MOST_WORDS = 2 * TD_TARGET_MAX_TAGS, WORD_SIZE = 48 };

/* Words, taken one by one. */
typedef struct reader {
    char word[MOST_WORDS][WORD_SIZE];
    int count, next;
    json_t *mapping;
    td_error *error;
} reader;

static td_status split(reader *r, const char *words)
{
    for (const char *at = words; *at;) {
        at += strspn(at, " \t,;:");
        size_t length = strcspn(at, " \t,;:");
        if (!length) break;
        if (r->count == MOST_WORDS || length >= WORD_SIZE)
            return td_fail(r->error, TD_ERROR_ARGUMENT, "target: too long to be a target");
        memcpy(r->word[r->count++], at, length);
        at += length;
    }
    for (int i = 0; i < r->count; i++)
        for (char *c = r->word[i]; *c; c++) *c = (char)tolower((unsigned char)*c);
    return TD_OK;
}

static td_status puzzled(const reader *r, const char *word, const char *wanted)
{
    char shown[TD_SHOWN_SIZE];
    return td_fail(r->error, TD_ERROR_ARGUMENT, "target: '%s' is not %s", td_text_shown(shown, word), wanted);
}

/* "25mm", or "25" with the unit as the next word. */
static bool read_length(double *metres, reader *r)
{
    static const struct {
        const char *name;
        double metres;
    } unit[] = {{"mm", 1e-3}, {"cm", 1e-2}, {"m", 1}, {"in", 0.0254}, {"inch", 0.0254}};
    if (r->next >= r->count) return false;
    const char *word = r->word[r->next];
    size_t digits = strspn(word, "0123456789.");
    char number[WORD_SIZE];
    memcpy(number, word, digits);
    number[digits] = 0;
    double value;
    if (!td_number_real(&value, number)) return false;
    bool apart = !word[digits] && r->next + 1 < r->count;
    const char *name = apart ? r->word[r->next + 1] : word + digits;
    for (size_t i = 0; i < sizeof unit / sizeof *unit; i++)
        if (strcmp(name, unit[i].name) == 0) {
            /* 25 mm is the double 0.025, not 25 times 0.001. */
            *metres = unit[i].metres < 0.02 ? value / (double)(unit[i].metres < 0.002 ? 1000 : 100)
                                            : value * unit[i].metres;
            r->next += apart ? 2 : 1;
            return true;
        }
    return false;
}

static td_status set_length(reader *r, const char *key, const char *what)
{
    double metres;
    if (!read_length(&metres, r)) return puzzled(r, r->next < r->count ? r->word[r->next] : "", what);
    json_object_set_new(r->mapping, key, json_real(metres));
    return TD_OK;
}

static td_status set_number(reader *r, const char *key, bool whole, const char *what)
{
    long long integer;
    double real;
    const char *word = r->next < r->count ? r->word[r->next] : "";
    td_number_kind kind = td_number_parse(&integer, &real, word);
    if (kind == TD_NUMBER_INTEGER)
        json_object_set_new(r->mapping, key, json_integer(integer));
    else if (kind == TD_NUMBER_REAL && !whole)
        json_object_set_new(r->mapping, key, json_real(real));
    else
        return puzzled(r, word, what);
    r->next++;
    return TD_OK;
}

static bool read_size(reader *r)
{
    int columns, rows, used = 0;
    const char *word = r->word[r->next];
    if (sscanf(word, "%4dx%4d%n", &columns, &rows, &used) != 2 || word[used]) return false;
    json_object_set_new(r->mapping, "columns", json_integer(columns));
    json_object_set_new(r->mapping, "rows", json_integer(rows));
    r->next++;
    return true;
}

/* A bare number of a target of single tags. */
static bool read_tag(reader *r, const char *kind)
{
    long long id;
    if (strcmp(kind, "tags") != 0) return false;
    if (td_number_parse(&id, NULL, r->word[r->next]) != TD_NUMBER_INTEGER) return false;
    json_t *tags = json_object_get(r->mapping, "tags");
    if (!tags) json_object_set_new(r->mapping, "tags", tags = json_array());
    json_array_append_new(tags, json_pack("{s:I}", "id", (json_int_t)id));
    r->next++;
    return true;
}

static td_status read_word(reader *r, const char *kind)
{
    static const struct {
        const char *word, *key, *value;
    } plain[] = {{"upward", "order", "upward"},
                 {"downward", "order", "downward"},
                 {"dark", "polarity", "dark"},
                 {"light", "polarity", "light"}};
    const char *word = r->word[r->next];
    bool grid = strcmp(kind, "aprilgrid") == 0 || strcmp(kind, "tags") == 0;
    double metres;
    for (size_t i = 0; i < sizeof plain / sizeof *plain; i++)
        if (strcmp(word, plain[i].word) == 0) {
            json_object_set_new(r->mapping, plain[i].key, json_string(plain[i].value));
            r->next++;
            return TD_OK;
        }
    if (strcmp(word, "legacy") == 0) {
        json_object_set_new(r->mapping, "legacy", json_true());
        r->next++;
        return TD_OK;
    }
    if (strncmp(word, "aruco", 5) == 0 || (strncmp(word, "tag", 3) == 0 && isdigit((unsigned char)word[3]))) {
        json_object_set_new(r->mapping, "dictionary", json_string(word));
        r->next++;
        return TD_OK;
    }
    if (read_size(r)) return TD_OK;
    if (read_length(&metres, r)) {
        json_object_set_new(r->mapping, grid ? "tag_size_m" : "spacing_m", json_real(metres));
        return TD_OK;
    }
    if (read_tag(r, kind)) return TD_OK;
    r->next++;
    if (strcmp(word, "tag") == 0)
        return set_length(r, "tag_size_m", "the length of a tag's side, as in 22mm");
    if (strcmp(word, "diameter") == 0) return set_length(r, "diameter_m", "a mark's diameter, as in 10mm");
    if (strcmp(word, "spacing") == 0) return set_length(r, "spacing_m", "a spacing, as in 25mm");
    if (strcmp(word, "gap") == 0)
        return set_number(r, "gap_ratio", false, "a gap as a share of the tag's side");
    if (strcmp(word, "border") == 0) return set_number(r, "border", true, "a border of 1 or 2 cells");
    if (strcmp(word, "first") == 0) return set_number(r, "first_id", true, "the number of the first tag");
    return puzzled(r, word,
                   "understood: a size is columns x rows as in 9x6, a length has its unit as in 25mm");
}

/* The side of single tags, and where the only one lies: in the middle of its target. */
static void finish_tags(json_t *mapping)
{
    json_t *tags = json_object_get(mapping, "tags"), *size = json_object_get(mapping, "tag_size_m"), *tag;
    size_t i;
    if (!tags) return;
    json_array_foreach(tags, i, tag) if (size) json_object_set(tag, "size_m", size);
    json_object_del(mapping, "tag_size_m");
}

static td_status map_words(json_t **mapping, const char *words, td_error *error)
{
    reader *r = calloc(1, sizeof *r);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    r->error = error;
    r->mapping = json_object();
    td_status status = split(r, words);
    if (status == TD_OK && !r->count)
        status =
            td_fail(error, TD_ERROR_ARGUMENT, "target: nothing is given; for example: chessboard 9x6 25mm");
    bool known = false;
    for (int k = 0; status == TD_OK && k < TD_TARGET_KIND_COUNT; k++)
        known |= strcmp(r->word[0], td_target_kind_name((td_target_kind)k)) == 0;
    if (status == TD_OK && !known)
        status = puzzled(r, r->word[0], "a kind of target: chessboard, marks, aprilgrid, charuco or tags");
    if (status == TD_OK) json_object_set_new(r->mapping, "kind", json_string(r->word[0]));
    r->next = 1;
    while (status == TD_OK && r->next < r->count) status = read_word(r, r->word[0]);
    if (status == TD_OK) finish_tags(r->mapping);
    *mapping = r->mapping;
    free(r);
    return status;
}

td_status td_target_from_words(td_target *target, json_t **mapping, const char *words, td_error *error)
{
    json_t *read = NULL;
    td_status status = words[strspn(words, " \t")] == '{'
                           ? td_document_parse(&read, words, strlen(words), "target", error)
                           : map_words(&read, words, error);
    if (status == TD_OK) {
        const td_field field = {NULL, "target", read};
        status = td_target_parse(target, &field, error);
    }
    if (status == TD_OK && mapping)
        *mapping = read;
    else
        json_decref(read);
    return status;
}
