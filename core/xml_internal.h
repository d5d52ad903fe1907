/* XML as the same tree that documents are. */
#ifndef TELEDIMOS_CORE_XML_INTERNAL_H
#define TELEDIMOS_CORE_XML_INTERNAL_H

#include <jansson.h>
#include <stddef.h>

#include "status.h"

/* The root element's children as a mapping, *root_name being its name ("root"; at most 31 bytes): an element
 * with children becomes a mapping, one without its text, a number where it is one; elements of one name are
 * gathered in a list; attributes and comments are passed over. UTF-8 only; document types, and with them
 * entities of one's own, are refused; nothing is fetched. */
td_status td_xml_parse(json_t **root, char root_name[32], const char *text, size_t size, const char *name,
                       td_error *error);

#endif
