/* Any bytes as a document: no crash; and what is read, written as YAML and as JSON, comes back the same. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_round_trip(const json_t *root, bool json)
{
    char *text = NULL;
    json_t *back = NULL;
    td_status status =
        json ? td_document_to_json(&text, root, 0, NULL) : td_document_to_yaml(&text, root, 0, NULL);
    if (status != TD_OK) abort();
    if (td_document_parse(&back, text, strlen(text), "written", NULL) != TD_OK) abort();
    if (!json_equal(root, back)) abort();
    json_decref(back);
    if (json) {
        back = json_loads(text, 0, NULL);
        if (!json_equal(root, back)) abort();
        json_decref(back);
    }
    free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    json_t *root = NULL;
    td_status status = td_document_parse(&root, (const char *)data, size, "fuzz.yaml", &error);
    if ((status == TD_OK) != (root != NULL)) abort();
    if (status != TD_OK) {
        if (strncmp(error.message, "fuzz.yaml:", 10) != 0) abort();
        return 0;
    }
    check_round_trip(root, false);
    check_round_trip(root, true);
    json_decref(root);
    return 0;
}
