/* The markup of a report under construction: growth, escaping, numbers. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "core/report_internal.h"

enum { REPLACEMENT = 0xFFFD };

void td_markup_raw(td_text *m, const char *markup)
{
    td_text_add(m, markup, strlen(markup));
}

/* The character at `text`: its bytes, and its code or U+FFFD. Bytes that are not UTF-8 are taken one by one.
 */
static size_t next_character(unsigned *code, const char *text)
{
    size_t length = td_utf8_decode(code, text, strnlen(text, 4));
    if (length) return length;
    *code = REPLACEMENT;
    return 1;
}

/* Control characters and U+xxFFFE, U+xxFFFF have no place in a document. */
static bool is_text(unsigned code)
{
    if (code < 0x20) return code == '\t' || code == '\n';
    return !(code >= 0x7F && code < 0xA0) && (code & 0xFFFE) != 0xFFFE;
}

static void add_character(td_text *m, unsigned code, const char *bytes, size_t length)
{
    switch (code) {
    case '&':
        td_markup_raw(m, "&amp;");
        break;
    case '<':
        td_markup_raw(m, "&lt;");
        break;
    case '>':
        td_markup_raw(m, "&gt;");
        break;
    case '"':
        td_markup_raw(m, "&quot;");
        break;
    case '\'':
        td_markup_raw(m, "&#39;");
        break;
    case REPLACEMENT:
        td_markup_raw(m, "\xEF\xBF\xBD");
        break;
    default:
        td_text_add(m, bytes, length);
    }
}

/* `count` characters at most; what follows them is returned. */
static const char *add_characters(td_text *m, const char *text, size_t count)
{
    for (; *text && count; count--) {
        unsigned code;
        size_t length = next_character(&code, text);
        if (!is_text(code)) code = REPLACEMENT;
        if (m) add_character(m, code, text, length);
        text += length;
    }
    return text;
}

void td_markup_text(td_text *m, const char *text)
{
    if (text) add_characters(m, text, SIZE_MAX);
}

void td_markup_text_cut(td_text *m, const char *text, size_t limit)
{
    size_t length = td_markup_length(text);
    if (length <= limit) {
        td_markup_text(m, text);
        return;
    }
    size_t tail = limit / 2, head = limit - tail - 1;
    add_characters(m, text, head);
    td_markup_raw(m, "…");
    td_markup_text(m, add_characters(NULL, text, length - tail));
}

size_t td_markup_length(const char *text)
{
    size_t count = 0;
    for (; text && *text; count++) {
        unsigned code;
        text += next_character(&code, text);
    }
    return count;
}

void td_markup_coordinate(td_text *m, double value)
{
    long long hundredths = llround(value * 100);
    unsigned long long size =
        hundredths < 0 ? 0 - (unsigned long long)hundredths : (unsigned long long)hundredths;
    char text[32];
    int length =
        snprintf(text, sizeof text, "%s%llu.%02llu", hundredths < 0 ? "-" : "", size / 100, size % 100);
    while (text[length - 1] == '0') length--;
    if (text[length - 1] == '.') length--;
    td_text_add(m, text, (size_t)length);
}

void td_markup_point(td_text *m, char command, const double p[2])
{
    if (command) td_text_add(m, &command, 1);
    td_markup_coordinate(m, p[0]);
    td_text_add(m, " ", 1);
    td_markup_coordinate(m, p[1]);
}

void td_markup_count(td_text *m, size_t value)
{
    char digits[32];
    int length = snprintf(digits, sizeof digits, "%zu", value);
    for (int i = 0; i < length; i++) {
        /* Thousands apart by a narrow blank, from five digits on. */
        if (i && length > 4 && (length - i) % 3 == 0) td_markup_raw(m, "\u202F");
        td_text_add(m, digits + i, 1);
    }
}

void td_markup_value(td_text *m, double value)
{
    char text[32];
    snprintf(text, sizeof text, "%.4g", value);
    for (char *c = text; *c; c++)
        if (*c == ',') *c = '.'; /* some locales' decimal sign */
    td_markup_raw(m, text);
}

void td_markup_base64(td_text *m, const unsigned char *bytes, size_t size)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < size; i += 3) {
        size_t left = size - i;
        uint32_t three = (uint32_t)bytes[i] << 16 | (left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0) |
                         (left > 2 ? bytes[i + 2] : 0);
        char four[4] = {digit[three >> 18], digit[three >> 12 & 63], left > 1 ? digit[three >> 6 & 63] : '=',
                        left > 2 ? digit[three & 63] : '='};
        td_text_add(m, four, sizeof four);
    }
}
