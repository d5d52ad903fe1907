#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/rig.h"
#include "core/text_internal.h"

enum { SHOWN_CHARACTERS = 48, FIRST_CAPACITY = 256 };

/* Room for `size` bytes and a 0 behind them. */
static bool reserve(td_text *text, size_t size)
{
    if (text->failed) return false;
    size_t needed = text->size + size + 1;
    if (needed <= text->capacity) return true;
    size_t capacity = text->capacity ? text->capacity : FIRST_CAPACITY;
    while (capacity < needed) capacity *= 2;
    char *larger = realloc(text->data, capacity);
    if (!larger) {
        text->failed = true;
        return false;
    }
    text->data = larger;
    text->capacity = capacity;
    return true;
}

void td_text_add(td_text *text, const char *bytes, size_t size)
{
    if (!reserve(text, size)) return;
    memcpy(text->data + text->size, bytes, size);
    text->size += size;
    text->data[text->size] = 0;
}

void td_text_format(td_text *text, const char *format, ...)
{
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    int length = vsnprintf(NULL, 0, format, arguments);
    if (length < 0)
        text->failed = true;
    else if (reserve(text, (size_t)length)) {
        vsnprintf(text->data + text->size, (size_t)length + 1, format, again);
        text->size += (size_t)length;
    }
    va_end(again);
    va_end(arguments);
}

void td_text_indent(td_text *text, int count)
{
    for (int i = 0; i < count; i++) td_text_add(text, " ", 1);
}

size_t td_utf8_decode(unsigned *code, const char *bytes, size_t size)
{
    const unsigned char *b = (const unsigned char *)bytes;
    if (size == 0) return 0;
    if (b[0] < 0x80) {
        *code = b[0];
        return 1;
    }
    size_t length = b[0] >= 0xF0 ? 4 : b[0] >= 0xE0 ? 3 : 2;
    if (b[0] < 0xC2 || b[0] > 0xF4 || length > size) return 0;
    unsigned value = b[0] & (0x7Fu >> length);
    for (size_t i = 1; i < length; i++) {
        if ((b[i] & 0xC0) != 0x80) return 0;
        value = value << 6 | (b[i] & 0x3Fu);
    }
    /* Overlong forms, halves of UTF-16 pairs, beyond Unicode. */
    if ((length == 3 && value < 0x800) || (length == 4 && value < 0x10000)) return 0;
    if ((value >= 0xD800 && value <= 0xDFFF) || value > 0x10FFFF) return 0;
    *code = value;
    return length;
}

size_t td_utf8_check(const char *bytes, size_t size)
{
    size_t at = 0;
    while (at < size) {
        unsigned code;
        size_t length = td_utf8_decode(&code, bytes + at, size - at);
        if (length == 0 || code == 0) break;
        at += length;
    }
    return at;
}

const char *td_text_shown(char shown[TD_SHOWN_SIZE], const char *text)
{
    size_t size = strlen(text), used = 0, at = 0;
    for (int n = 0; at < size && n < SHOWN_CHARACTERS; n++) {
        unsigned code = 0;
        size_t length = td_utf8_decode(&code, text + at, size - at);
        bool control =
            length == 0 || code < 0x20 || (code >= 0x7F && code < 0xA0) || code == 0x2028 || code == 0x2029;
        if (length == 0) length = 1;
        memcpy(shown + used, control ? "?" : text + at, control ? 1 : length);
        used += control ? 1 : length;
        at += length;
    }
    strcpy(shown + used, at < size ? "…" : "");
    return shown;
}

bool td_name_is_plain(const char *name)
{
    static const char allowed[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
    size_t length = strspn(name, allowed);
    return length > 0 && length < TD_NAME_SIZE && name[length] == 0;
}
