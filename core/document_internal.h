/* The bounds that readers and writers of documents share. */
#ifndef TELEDIMOS_CORE_DOCUMENT_INTERNAL_H
#define TELEDIMOS_CORE_DOCUMENT_INTERNAL_H

#include "text_internal.h"

enum {
    TD_DOCUMENT_SIZE = 16 << 20,  /* bytes of text */
    TD_DOCUMENT_DEPTH = 64,       /* mappings and sequences inside one another */
    TD_DOCUMENT_VALUES = 1 << 20, /* nodes of the tree */
    TD_DOCUMENT_KEY = 128,        /* bytes: six times as many when escaped must stay below libyaml's 1024 */
    TD_DOCUMENT_REAL_DIGITS = 17
};

/* Adds a text as YAML wants it: as it is when it is plainly a word, else in quotes. */
void td_document_add_word(td_text *out, const char *text);

#endif
