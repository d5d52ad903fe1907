/* Tables of comma-separated values: a header, then rows of as many cells.
 *
 * RFC 4180: cells may be quoted, a quote in them is doubled, quoted cells may hold commas and line ends;
 * lines end in LF, CRLF or CR. Besides: a byte order mark is passed over, blank lines and lines that begin
 * with '#' are left out, and blanks around cells are dropped unless quoted. Text is UTF-8. At most 64 MiB,
 * 1024 columns, 2^22 rows, 2^24 cells. */
#ifndef TELEDIMOS_CORE_CSV_H
#define TELEDIMOS_CORE_CSV_H

#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_csv {
    char *name;     /* of the file, for messages */
    size_t columns; /* at least 1; names in the header differ, but may be empty */
    size_t rows;    /* below the header */
    char **cell;    /* (1+rows,columns), the header first; lent from `text` */
    size_t *line;   /* (1+rows) the line of the file where each begins, from 1 */
    char *text;
} td_csv;

TD_API td_status td_csv_read(td_csv **csv, const char *path, td_error *error);
/* The same from memory; `name` is for messages. */
TD_API td_status td_csv_parse(td_csv **csv, const char *text, size_t size, const char *name, td_error *error);
TD_API void td_csv_free(td_csv **csv);

/* Index of the column of this name in the header, -1 if none. */
TD_API int td_csv_column(const td_csv *csv, const char *name);
/* Row 0 is the first below the header. Never NULL; lives as long as the table. */
TD_API const char *td_csv_cell(const td_csv *csv, size_t row, int column);

/* Fails with "frames.csv:12: column time_s: MESSAGE". */
TD_API td_status td_csv_fail(const td_csv *csv, size_t row, int column, td_error *error, const char *format,
                             ...) TD_PRINTF(5, 6);
/* A finite number in [low, high]; an empty cell fails like any other text that is no number. */
TD_API td_status td_csv_real(double *value, const td_csv *csv, size_t row, int column, double low,
                             double high, td_error *error);
TD_API td_status td_csv_int(int *value, const td_csv *csv, size_t row, int column, int low, int high,
                            td_error *error);

#ifdef __cplusplus
}
#endif
#endif
