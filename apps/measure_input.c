/* What teledimos measure reads besides maps, and the table it writes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/measure_internal.h"
#include "core/csv.h"
#include "core/file.h"
#include "core/number.h"

enum { MOST_CORNERS = 100000 };

static td_status read_corners(measure_job *m, const td_csv *csv, td_error *error)
{
    const int column[2] = {td_csv_column(csv, "x_m"), td_csv_column(csv, "y_m")};
    for (int k = 0; k < 2; k++)
        if (column[k] < 0)
            return td_fail(error, TD_ERROR_DATA, "%s: there is no column %s", csv->name, k ? "y_m" : "x_m");
    if (csv->rows < 3 || csv->rows > MOST_CORNERS)
        return td_fail(error, TD_ERROR_DATA, "%s: a polygon has 3 to %d corners, not %zu", csv->name,
                       MOST_CORNERS, csv->rows);
    m->polygon = malloc(csv->rows * sizeof *m->polygon);
    if (!m->polygon) return td_fail(error, TD_ERROR_MEMORY, "no memory for a polygon");
    for (size_t r = 0; r < csv->rows; r++)
        for (int k = 0; k < 2; k++)
            TD_TRY(td_csv_real(&m->polygon[r][k], csv, r, column[k], -1e9, 1e9, error));
    m->polygon_count = csv->rows;
    return TD_OK;
}

td_status measure_polygon_read(measure_job *m, const char *path, td_error *error)
{
    td_csv *csv = NULL;
    TD_TRY(td_csv_read(&csv, path, error));
    td_status status = read_corners(m, csv, error);
    td_csv_free(&csv);
    return status;
}

td_status measure_point_parse(double point[2], const char *option, const char *text, td_error *error)
{
    char copy[100], *comma;
    if (strlen(text) < sizeof copy) {
        strcpy(copy, text);
        comma = strchr(copy, ',');
        if (comma) {
            *comma = 0;
            if (td_number_real(&point[0], copy) && td_number_real(&point[1], comma + 1)) return TD_OK;
        }
    }
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "--%s %.60s: write two numbers in m with a comma between, as 3.5,-2", option, text);
}

static void write_value(FILE *f, double value)
{
    if (isfinite(value))
        fprintf(f, ",%.6f", value);
    else
        fputc(',', f);
}

td_status measure_profile_write(const measure_job *m, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    fprintf(
        f,
        "# From (%g, %g) to (%g, %g) in frame %s; empty: not known.\ndistance_m,x_m,y_m,height_m,sigma_m\n",
        m->from[0], m->from[1], m->to[0], m->to[1], m->map[0]->frame);
    const double length = m->profile[m->count - 1].distance_m;
    for (size_t i = 0; i < m->count; i++) {
        const td_profile_point *p = &m->profile[i];
        const double part = p->distance_m / length;
        fprintf(f, "%.6f,%.6f,%.6f", p->distance_m, (1 - part) * m->from[0] + part * m->to[0],
                (1 - part) * m->from[1] + part * m->to[1]);
        write_value(f, p->height_m);
        write_value(f, p->sigma_m);
        fputc('\n', f);
    }
    const bool failed = ferror(f) != 0;
    td_status status = fclose(f) == 0 && !failed ? td_file_write(path, text, size, error)
                                                 : td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    free(text);
    return status;
}
