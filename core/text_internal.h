/* Text that grows, and what text may hold. */
#ifndef TELEDIMOS_CORE_TEXT_INTERNAL_H
#define TELEDIMOS_CORE_TEXT_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "status.h"

/* Begin with a zeroed one. The first failure is kept, so that writers need no checks of their own. `data`
 * ends in a 0 and is to be freed with free(); NULL while nothing was added. */
typedef struct td_text {
    char *data;
    size_t size, capacity;
    bool failed; /* out of memory */
} td_text;

void td_text_add(td_text *text, const char *bytes, size_t size);
void td_text_format(td_text *text, const char *format, ...) TD_PRINTF(2, 3);
/* `count` blanks. */
void td_text_indent(td_text *text, int count);

/* Bytes of the UTF-8 character at the start of `bytes`, its code in *code; 0: not UTF-8 (RFC 3629). */
size_t td_utf8_decode(unsigned *code, const char *bytes, size_t size);
/* Offset of the first byte that is not UTF-8 or is a 0; `size` when all is well. */
size_t td_utf8_check(const char *bytes, size_t size);

/* What of a stranger's text may stand in a message: at most 48 characters on one line, controls replaced by
 * '?', "…" at the end when cut. Returns `shown`. */
enum { TD_SHOWN_SIZE = 200 };
const char *td_text_shown(char shown[TD_SHOWN_SIZE], const char *text);

/* True for 1 … TD_NAME_SIZE-1 letters, digits, - and _. */
bool td_name_is_plain(const char *name);

#endif
