/* --target: a few words, or a mapping as in dataset.yaml. */
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/capture_internal.h"
#include "core/dataset.h"
#include "core/document.h"
#include "core/number.h"

static const char FORMS[] =
    "write for example 'chessboard 9x6 25mm' (inner corners and square), 'marks 7x5 30mm "
    "12mm' (marks, spacing and diameter) or '{kind: chessboard, columns: 9, rows: 6, "
    "spacing_m: 0.025}'";

/* "25mm", "2.5cm" or "0.025m" in metres. */
static bool parse_length(double *metres, const char *text)
{
    static const struct {
        const char *unit;
        double metres;
    } units[] = {{"mm", 1e3}, {"cm", 1e2}, {"m", 1}};
    char number[32];
    const size_t digits = strspn(text, "0123456789.");
    if (digits == 0 || digits >= sizeof number) return false;
    memcpy(number, text, digits);
    number[digits] = 0;
    for (size_t i = 0; i < sizeof units / sizeof *units; i++)
        if (!strcmp(text + digits, units[i].unit)) {
            if (!td_number_real(metres, number)) return false;
            *metres /= units[i].metres; /* dividing keeps 25 mm at 0.025 */
            return true;
        }
    return false;
}

static bool parse_words(json_t *target, const char *text)
{
    char kind[16], length[2][32] = {"", ""}, rest[2];
    int columns, rows;
    double metres;
    const int got =
        sscanf(text, " %15[a-z] %4d x %4d %31s %31s %1s", kind, &columns, &rows, length[0], length[1], rest);
    const bool marks = got >= 1 && !strcmp(kind, "marks");
    if (got != (marks ? 5 : 4) || (!marks && strcmp(kind, "chessboard") != 0)) return false;
    json_object_set_new(target, "kind", json_string(kind));
    json_object_set_new(target, "columns", json_integer(columns));
    json_object_set_new(target, "rows", json_integer(rows));
    for (int i = 0; i < got - 3; i++) {
        if (!parse_length(&metres, length[i])) return false;
        json_object_set_new(target, i ? "diameter_m" : "spacing_m", json_real(metres));
    }
    return true;
}

/* A dataset that holds nothing else shows whether the target can be read. */
static td_status check(json_t *target, td_error *error)
{
    static const char csv[] = "camera\nimage.png\n";
    json_t *root = json_pack("{s:s, s:O, s:[{s:s, s:s}]}", "name", "target", "target", target, "cameras",
                             "name", "camera", "model", "brown5");
    char *yaml = NULL;
    td_dataset *dataset = NULL;
    td_status status =
        root ? td_document_to_yaml(&yaml, root, 0, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK)
        status = td_dataset_parse(&dataset, yaml, strlen(yaml), csv, sizeof csv - 1, "--target", error);
    td_dataset_free(&dataset);
    free(yaml);
    json_decref(root);
    return status == TD_OK ? TD_OK : TD_ERROR_ARGUMENT;
}

td_status capture_target(json_t **target, const char *text, td_error *error)
{
    json_t *made = NULL;
    while (isspace((unsigned char)*text)) text++;
    if (*text == '{') {
        if (td_document_parse(&made, text, strlen(text), "--target", error) != TD_OK)
            return TD_ERROR_ARGUMENT;
    } else {
        made = json_object();
        if (!made || !parse_words(made, text)) {
            json_decref(made);
            return td_fail(error, TD_ERROR_ARGUMENT, "--target: '%.60s' is no target; %s", text, FORMS);
        }
    }
    td_status status = check(made, error);
    if (status == TD_OK)
        *target = made;
    else
        json_decref(made);
    return status;
}
