#include <stdio.h>
#include <stdlib.h>

#include "calib/target_sheet_internal.h"

void td_sheet_free(td_sheet *sheet)
{
    free(sheet->shape);
    free(sheet->text);
    *sheet = (td_sheet){0};
}

int td_sheet_group(td_sheet *sheet)
{
    return sheet->groups++;
}

/* Room for one more; false, and the sheet has failed, when there is none. */
static bool grow(td_sheet *sheet, void **array, size_t count, size_t *capacity, size_t size)
{
    if (sheet->failed || count < *capacity) return !sheet->failed;
    size_t wanted = *capacity ? 2 * *capacity : 64;
    void *larger = realloc(*array, wanted * size);
    sheet->failed = !larger;
    if (!larger) return false;
    *array = larger;
    *capacity = wanted;
    return true;
}

void td_sheet_add(td_sheet *sheet, td_shape shape)
{
    void *array = sheet->shape;
    bool room = grow(sheet, &array, sheet->shape_count, &sheet->shape_capacity, sizeof shape);
    sheet->shape = array;
    if (room) sheet->shape[sheet->shape_count++] = shape;
}

void td_sheet_write(td_sheet *sheet, double x, double y, double size, td_anchor anchor, const char *text)
{
    void *array = sheet->text;
    bool room = grow(sheet, &array, sheet->text_count, &sheet->text_capacity, sizeof *sheet->text);
    sheet->text = array;
    if (!room) return;
    td_sheet_text *line = &sheet->text[sheet->text_count++];
    *line = (td_sheet_text){.x = x, .y = y, .size = size, .anchor = anchor};
    snprintf(line->text, sizeof line->text, "%s", text);
}
