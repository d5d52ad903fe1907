#include "core/xml_internal.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <libxml/parser.h>
#include <libxml/tree.h>

#include "core/document_internal.h"
#include "core/number.h"

typedef struct reader {
    const char *name; /* of the file */
    size_t values;
    td_error *error;
} reader;

static td_status out_of_memory(const reader *r)
{
    return td_fail(r->error, TD_ERROR_MEMORY, "%s: no memory for its content", r->name);
}

/* A text without the blanks around it, as a number if it is one. */
static td_status read_text(const reader *r, const char *text, json_t **value)
{
    while (isspace((unsigned char)*text)) text++;
    size_t length = strlen(text);
    while (length && isspace((unsigned char)text[length - 1])) length--;
    char number[64];
    long long integer = 0;
    double real = 0;
    td_number_kind kind = TD_NUMBER_NONE;
    if (length < sizeof number) {
        memcpy(number, text, length);
        number[length] = 0;
        kind = td_number_parse(&integer, &real, number);
    }
    if (kind == TD_NUMBER_TOO_LARGE)
        return td_fail(r->error, TD_ERROR_FORMAT, "%s: the number %s is too large", r->name, number);
    *value = kind == TD_NUMBER_INTEGER ? json_integer(integer)
             : kind == TD_NUMBER_REAL  ? json_real(real)
                                       : json_stringn(text, length);
    return *value ? TD_OK : out_of_memory(r);
}

/* Adds a member; the second of its name makes a list of both. */
static td_status add_member(const reader *r, json_t *object, const char *key, json_t *value)
{
    json_t *there = json_object_get(object, key);
    int failed = 0;
    if (there && json_is_array(there))
        failed = json_array_append_new(there, value);
    else if (there) {
        json_t *both = json_array();
        failed = json_array_append(both, there);
        failed |= json_array_append_new(both, value);
        failed |= json_object_set_new(object, key, both);
    } else
        failed = json_object_set_new(object, key, value);
    return failed ? out_of_memory(r) : TD_OK;
}

static td_status read_element(reader *r, const xmlNode *node, int depth, json_t **value);

static td_status read_children(reader *r, const xmlNode *node, int depth, json_t *object)
{
    char shown[TD_SHOWN_SIZE];
    for (const xmlNode *child = node->children; child; child = child->next) {
        if (child->type == XML_ENTITY_REF_NODE)
            return td_fail(r->error, TD_ERROR_FORMAT, "%s:%d: the entity &%s; is not known", r->name,
                           (int)node->line, td_text_shown(shown, (const char *)child->name));
        if (child->type != XML_ELEMENT_NODE) continue;
        const char *key = (const char *)child->name;
        if (strlen(key) > TD_DOCUMENT_KEY)
            return td_fail(r->error, TD_ERROR_FORMAT, "%s:%d: the name <%s> is longer than %d bytes", r->name,
                           (int)child->line, td_text_shown(shown, key), TD_DOCUMENT_KEY);
        json_t *value = NULL;
        TD_TRY(read_element(r, child, depth + 1, &value));
        TD_TRY(add_member(r, object, key, value));
    }
    return TD_OK;
}

static td_status read_element(reader *r, const xmlNode *node, int depth, json_t **value)
{
    if (depth >= TD_DOCUMENT_DEPTH)
        return td_fail(r->error, TD_ERROR_FORMAT, "%s:%d: nested deeper than %d levels", r->name,
                       (int)node->line, TD_DOCUMENT_DEPTH);
    if (++r->values > TD_DOCUMENT_VALUES)
        return td_fail(r->error, TD_ERROR_FORMAT, "%s: more than %d values", r->name, TD_DOCUMENT_VALUES);
    json_t *object = json_object();
    if (!object) return out_of_memory(r);
    td_status status = read_children(r, node, depth, object);
    if (status == TD_OK && json_object_size(object) == 0 && depth > 0) {
        xmlChar *text = xmlNodeGetContent(node);
        status = text ? read_text(r, (const char *)text, value) : out_of_memory(r);
        xmlFree(text);
    } else if (status == TD_OK)
        *value = json_incref(object);
    json_decref(object);
    return status;
}

static td_status read_document(reader *r, const xmlDoc *document, char root_name[32], json_t **root)
{
    const xmlNode *top = xmlDocGetRootElement(document);
    if (!top) return td_fail(r->error, TD_ERROR_FORMAT, "%s: holds no XML element", r->name);
    snprintf(root_name, 32, "%s", (const char *)top->name);
    return read_element(r, top, 0, root);
}

/* libxml2's last word on why it failed, on one line. */
static td_status parser_failed(const reader *r, xmlParserCtxt *parser)
{
    const xmlError *why = xmlCtxtGetLastError(parser);
    char shown[TD_SHOWN_SIZE], line[TD_SHOWN_SIZE] = "unknown reason";
    if (why && why->message) {
        snprintf(line, sizeof line, "%s", why->message);
        line[strcspn(line, "\n")] = 0;
    }
    return td_fail(r->error, TD_ERROR_FORMAT, "%s:%d: is not valid XML: %s", r->name, why ? why->line : 0,
                   td_text_shown(shown, line));
}

static bool holds(const char *text, size_t size, const char *word)
{
    const size_t length = strlen(word);
    for (size_t i = 0; i + length <= size; i++)
        if (!memcmp(text + i, word, length)) return true;
    return false;
}

td_status td_xml_parse(json_t **root, char root_name[32], const char *text, size_t size, const char *name,
                       td_error *error)
{
    reader r = {.name = name, .error = error};
    if (size > TD_DOCUMENT_SIZE)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is larger than the %d bytes that are accepted", name,
                       TD_DOCUMENT_SIZE);
    const size_t good = td_utf8_check(text, size);
    if (good < size) return td_fail(error, TD_ERROR_FORMAT, "%s: byte %zu: is not text in UTF-8", name, good);
    /* Entities make billions of bytes of a few lines, and reach for other files. */
    if (holds(text, size, "<!DOCTYPE") || holds(text, size, "<!ENTITY"))
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: document types (<!DOCTYPE) are not accepted; leave that part out", name);
    xmlParserCtxt *parser = xmlNewParserCtxt();
    if (!parser) return out_of_memory(&r);
    const int options =
        XML_PARSE_NONET | XML_PARSE_NOERROR | XML_PARSE_NOWARNING | XML_PARSE_IGNORE_ENC | XML_PARSE_NOCDATA;
    xmlDoc *document = xmlCtxtReadMemory(parser, text, (int)size, NULL, "UTF-8", options);
    td_status status = document ? read_document(&r, document, root_name, root) : parser_failed(&r, parser);
    xmlFreeDoc(document);
    xmlFreeParserCtxt(parser);
    return status;
}
