/* Numbers as text and back: to the last bit, and with a decimal point whatever the locale of the program. */
#ifndef TELEDIMOS_CORE_NUMBER_H
#define TELEDIMOS_CORE_NUMBER_H

#include <stdbool.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_NUMBER_SIZE = 32 };

/* "0.5", "-12.0", "1.0e-09": always with a point, so that every reader of YAML or JSON sees a real. `digits`:
 * significant digits, 1–17; 0: as few as give back the same double. Not finite: ".nan", ".inf", "-.inf".
 * Returns `text`. */
TD_API char *td_number_format(char text[TD_NUMBER_SIZE], double value, int digits);

typedef enum td_number_kind {
    TD_NUMBER_NONE, /* no number */
    TD_NUMBER_INTEGER,
    TD_NUMBER_REAL,
    TD_NUMBER_TOO_LARGE /* a number, beyond 64 bits or a double's range */
} td_number_kind;

/* What the whole text is by the core schema of YAML 1.2: decimal, 0o and 0x integers, decimal reals. Sets the
 * one that fits; either may be NULL. Blanks, digit groups, nan and inf are no numbers. */
TD_API td_number_kind td_number_parse(long long *integer, double *real, const char *text);

/* Integers and reals alike, as a real. False, *value untouched, for anything else. */
TD_API bool td_number_real(double *value, const char *text);

#ifdef __cplusplus
}
#endif
#endif
