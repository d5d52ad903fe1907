/* Any bytes as a table: no crash; every cell is there, and numbers can be asked for anywhere. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/csv.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_csv *csv = NULL;
    if (td_csv_parse(&csv, (const char *)data, size, "fuzz.csv", &error) != TD_OK) {
        if (csv || strncmp(error.message, "fuzz.csv:", 9) != 0) abort();
        return 0;
    }
    size_t length = 0;
    for (size_t row = 0; row < csv->rows; row++)
        for (size_t column = 0; column < csv->columns; column++) {
            double value = NAN;
            length += strlen(td_csv_cell(csv, row, (int)column));
            td_status status = td_csv_real(&value, csv, row, (int)column, -1e6, 1e6, &error);
            if (status == TD_OK && !(fabs(value) <= 1e6)) abort();
        }
    if (length > size) abort();
    td_csv_free(&csv);
    return 0;
}
