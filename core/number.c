#include "core/number.h"

#include <errno.h>
#include <float.h>
#include <locale.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* printf and strtod write and expect the decimal point of the locale; these two lend the calling thread the C
 * locale. */
static locale_t enter_c_locale(locale_t *c)
{
    *c = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    return *c ? uselocale(*c) : (locale_t)0;
}

static void leave_c_locale(locale_t c, locale_t before)
{
    if (!c) return;
    uselocale(before);
    freelocale(c);
}

/* Fewest digits that give back `value`. A double holds every decimal of 15 digits, so that fewer need not be
 * tried: %g drops the zeros behind them. Numbers near zero (subnormal) hold less, down to one digit. */
static void format_shortest(char *text, size_t size, double value)
{
    for (int digits = fabs(value) < DBL_MIN ? 1 : 15; digits <= 17; digits++) {
        snprintf(text, size, "%.*g", digits, value);
        if (strtod(text, NULL) == value) return;
    }
}

char *td_number_format(char text[TD_NUMBER_SIZE], double value, int digits)
{
    if (!isfinite(value)) return strcpy(text, isnan(value) ? ".nan" : value > 0 ? ".inf" : "-.inf");
    char plain[TD_NUMBER_SIZE];
    locale_t c, before = enter_c_locale(&c);
    if (digits >= 1 && digits <= 17) snprintf(plain, sizeof plain, "%.*g", digits, value);
    /* The largest doubles, rounded to few digits, would be read back as infinite. */
    if (digits < 1 || digits > 17 || isinf(strtod(plain, NULL))) format_shortest(plain, sizeof plain, value);
    leave_c_locale(c, before);
    size_t mantissa = strcspn(plain, "e");
    const char *point = memchr(plain, '.', mantissa) ? "" : ".0";
    snprintf(text, TD_NUMBER_SIZE, "%.*s%s%s", (int)mantissa, plain, point, plain + mantissa);
    return text;
}

static size_t skip_digits(const char *text)
{
    return strspn(text, "0123456789");
}

/* [-+]? (\.[0-9]+ | [0-9]+(\.[0-9]*)?) ([eE][-+]?[0-9]+)?   (YAML 1.2.2, 10.3.2) */
static td_number_kind decimal_kind(const char *text)
{
    td_number_kind kind = TD_NUMBER_INTEGER;
    if (*text == '-' || *text == '+') text++;
    size_t whole = skip_digits(text), fraction = 0;
    text += whole;
    if (*text == '.') {
        kind = TD_NUMBER_REAL;
        fraction = skip_digits(++text);
        text += fraction;
    }
    if (whole + fraction == 0) return TD_NUMBER_NONE;
    if (*text == 'e' || *text == 'E') {
        kind = TD_NUMBER_REAL;
        text++;
        if (*text == '-' || *text == '+') text++;
        size_t exponent = skip_digits(text);
        if (exponent == 0) return TD_NUMBER_NONE;
        text += exponent;
    }
    return *text ? TD_NUMBER_NONE : kind;
}

static td_number_kind parse_integer(long long *integer, const char *text, int base)
{
    errno = 0;
    long long value = strtoll(text, NULL, base);
    if (errno == ERANGE) return TD_NUMBER_TOO_LARGE;
    if (integer) *integer = value;
    return TD_NUMBER_INTEGER;
}

static td_number_kind parse_real(double *real, const char *text)
{
    locale_t c, before = enter_c_locale(&c);
    double value = strtod(text, NULL);
    leave_c_locale(c, before);
    if (isinf(value)) return TD_NUMBER_TOO_LARGE;
    if (real) *real = value;
    return TD_NUMBER_REAL;
}

td_number_kind td_number_parse(long long *integer, double *real, const char *text)
{
    if (text[0] == '0' && (text[1] == 'x' || text[1] == 'o')) {
        const char *digits = text + 2, *allowed = text[1] == 'x' ? "0123456789abcdefABCDEF" : "01234567";
        size_t count = strspn(digits, allowed);
        if (count == 0 || digits[count]) return TD_NUMBER_NONE;
        return parse_integer(integer, digits, text[1] == 'x' ? 16 : 8);
    }
    td_number_kind kind = decimal_kind(text);
    if (kind == TD_NUMBER_INTEGER) return parse_integer(integer, text, 10);
    return kind == TD_NUMBER_REAL ? parse_real(real, text) : kind;
}

bool td_number_real(double *value, const char *text)
{
    long long integer;
    td_number_kind kind = td_number_parse(&integer, value, text);
    if (kind == TD_NUMBER_INTEGER) *value = (double)integer;
    return kind == TD_NUMBER_INTEGER || kind == TD_NUMBER_REAL;
}
