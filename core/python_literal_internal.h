/* Python literals as a tree: what mrcal keeps its models in. */
#ifndef TELEDIMOS_CORE_PYTHON_LITERAL_INTERNAL_H
#define TELEDIMOS_CORE_PYTHON_LITERAL_INTERNAL_H

#include <jansson.h>
#include <stddef.h>

#include "status.h"

/* One value: dictionaries (keys are texts), lists and tuples, texts on one line, numbers, True, False, None;
 * comments. Bytes (b'…') become null: nobody asks for them here. The bounds of core/document.h hold. */
td_status td_python_parse(json_t **root, const char *text, size_t size, const char *name, td_error *error);

#endif
