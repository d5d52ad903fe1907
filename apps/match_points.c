/* The tables of teledimos match: left points, candidates with a person's picks, finished matches. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/match_internal.h"
#include "core/csv.h"
#include "core/file.h"

enum { MOST_POINTS = 100000 };

static td_status column_of(int *column, const td_csv *csv, const char *name, td_error *error)
{
    *column = td_csv_column(csv, name);
    if (*column >= 0) return TD_OK;
    return td_fail(error, TD_ERROR_DATA, "%s: there is no column %s", csv->name, name);
}

static td_status real_in_image(double *value, const td_csv *csv, size_t row, int column, int size,
                               td_error *error)
{
    TD_TRY(td_csv_real(value, csv, row, column, -1e6, 1e6, error));
    if (*value < 0 || *value > size - 1)
        return td_csv_fail(csv, row, column, error, "%g is outside the image, which goes from 0 to %d",
                           *value, size - 1);
    return TD_OK;
}

/* The window around a left point must lie in the image. */
static td_status real_in_window(double *value, const td_csv *csv, size_t row, int column, int size,
                                int half_window, td_error *error)
{
    TD_TRY(real_in_image(value, csv, row, column, size, error));
    if (lround(*value) < half_window || lround(*value) > size - 1 - half_window)
        return td_csv_fail(csv, row, column, error,
                           "%g is nearer than the window's %d px to the image's edge (0 to %d): pick a point "
                           "further in, or a smaller --window",
                           *value, half_window, size - 1);
    return TD_OK;
}

static td_status name_of(match_point *p, const td_csv *csv, size_t row, int column, td_error *error)
{
    const char *given = column >= 0 ? td_csv_cell(csv, row, column) : "";
    p->row = row;
    if (strlen(given) >= sizeof p->name)
        return td_csv_fail(csv, row, column, error, "a name of at most %zu characters is wanted",
                           sizeof p->name - 1);
    for (const char *c = given; *c; c++)
        if ((unsigned char)*c < ' ')
            return td_csv_fail(csv, row, column, error, "a line end or a tab in the name of a point");
    if (*given)
        snprintf(p->name, sizeof p->name, "%s", given);
    else
        snprintf(p->name, sizeof p->name, "%zu", row + 1);
    return TD_OK;
}

static int by_name(const void *a, const void *b)
{
    const match_point *p = *(const match_point *const *)a, *q = *(const match_point *const *)b;
    const int order = strcmp(p->name, q->name);
    return order ? order : (p->row > q->row) - (p->row < q->row);
}

/* A name means one point, or picks could not be taken back in. `what`: what is wrong with two of a name. */
static td_status check_names(const match_job *m, const td_csv *csv, const char *what, td_error *error)
{
    const match_point **sorted = malloc((m->point_count + 1) * sizeof *sorted);
    td_status status = TD_OK;
    if (!sorted) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < m->point_count; i++) sorted[i] = &m->point[i];
    qsort(sorted, m->point_count, sizeof *sorted, by_name);
    for (size_t i = 1; i < m->point_count && status == TD_OK; i++)
        if (strcmp(sorted[i]->name, sorted[i - 1]->name) == 0)
            status = td_csv_fail(csv, sorted[i]->row, td_csv_column(csv, "point"), error, "point %s is %s",
                                 sorted[i]->name, what);
    free(sorted);
    return status;
}

static td_status open_table(td_csv **csv, match_job *m, td_error *error)
{
    TD_TRY(td_csv_read(csv, m->points_path, error));
    size_t rows = (*csv)->rows;
    if (rows == 0 || rows > MOST_POINTS)
        return td_fail(error, TD_ERROR_DATA, "%s: %zu points; 1 to %d are wanted", m->points_path, rows,
                       MOST_POINTS);
    m->point = calloc(rows, sizeof *m->point);
    return m->point ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", rows);
}

static td_status read_points(match_job *m, const td_csv *csv, td_error *error)
{
    int x, y, name = td_csv_column(csv, "point");
    TD_TRY(column_of(&x, csv, "x_px", error));
    TD_TRY(column_of(&y, csv, "y_px", error));
    for (size_t r = 0; r < csv->rows; r++) {
        match_point *p = &m->point[r];
        const int k = m->options.half_window;
        TD_TRY(name_of(p, csv, r, name, error));
        p->chosen = -1;
        TD_TRY(real_in_window(&p->left[0], csv, r, x, m->image[0]->width, k, error));
        TD_TRY(real_in_window(&p->left[1], csv, r, y, m->image[0]->height, k, error));
        m->point_count++;
    }
    return check_names(m, csv, "given twice: give each a name of its own", error);
}

td_status match_points_read(match_job *m, td_error *error)
{
    td_csv *csv = NULL;
    td_status status = open_table(&csv, m, error);
    if (status == TD_OK) status = read_points(m, csv, error);
    td_csv_free(&csv);
    return status;
}

static td_status read_choice(match_job *m, const td_csv *csv, const int column[4], size_t row, int name,
                             td_error *error)
{
    double at[4];
    for (int k = 0; k < 4; k++) {
        const td_image *image = m->image[k / 2];
        TD_TRY(real_in_image(&at[k], csv, row, column[k], k % 2 ? image->height : image->width, error));
    }
    match_point *p = &m->point[m->point_count];
    TD_TRY(name_of(p, csv, row, name, error));
    p->candidate = calloc(1, sizeof *p->candidate);
    if (!p->candidate) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    memcpy(p->left, at, sizeof p->left);
    *p->candidate = (td_match){.left = {at[0], at[1]},
                               .right = {at[2], at[3]},
                               .zncc = NAN,
                               .runner_up = NAN,
                               .covariance = {NAN, NAN, NAN, NAN}};
    p->count = 1;
    m->point_count++;
    return TD_OK;
}

static td_status read_choices(match_job *m, const td_csv *csv, td_error *error)
{
    static const char *const names[] = {"left_x_px", "left_y_px", "right_x_px", "right_y_px"};
    int column[4], name = td_csv_column(csv, "point"), chosen = td_csv_column(csv, "chosen");
    for (int k = 0; k < 4; k++) TD_TRY(column_of(&column[k], csv, names[k], error));
    for (size_t r = 0; r < csv->rows; r++) {
        int picked = 1;
        if (chosen >= 0 && !*td_csv_cell(csv, r, chosen)) continue;
        if (chosen >= 0) TD_TRY(td_csv_int(&picked, csv, r, chosen, 0, 1, error));
        if (picked) TD_TRY(read_choice(m, csv, column, r, name, error));
    }
    if (!m->point_count)
        return td_fail(error, TD_ERROR_DATA, "%s: no row is chosen: write 1 in its column `chosen`",
                       csv->name);
    return check_names(m, csv, "chosen twice: leave one candidate of it chosen", error);
}

td_status match_choices_read(match_job *m, td_error *error)
{
    td_csv *csv = NULL;
    td_status status = open_table(&csv, m, error);
    if (status == TD_OK) status = read_choices(m, csv, error);
    td_csv_free(&csv);
    return status;
}

/* ---- writing ---- */

/* In quotes where a reader of CSV would take it for something else. */
static void write_name(FILE *f, const char *name)
{
    if (!strpbrk(name, ",\"#") && name[0] != ' ' && name[strlen(name) - 1] != ' ') {
        fputs(name, f);
        return;
    }
    fputc('"', f);
    for (; *name; name++) fprintf(f, *name == '"' ? "\"\"" : "%c", *name);
    fputc('"', f);
}

static void write_number(FILE *f, double value, int digits)
{
    if (isfinite(value))
        fprintf(f, ",%.*f", digits, value);
    else
        fputc(',', f);
}

static void write_space(FILE *f, const td_point3 *p, bool found)
{
    for (int k = 0; k < 3; k++) write_number(f, found ? p->p[k] : NAN, 5);
    write_number(f, found ? match_sigma(p->covariance) : NAN, 5);
    write_number(f, found ? match_sigma(p->matching) : NAN, 5);
    write_number(f, found ? match_sigma(p->calibration) : NAN, 5);
}

static void write_pixels(FILE *f, const td_match *c)
{
    write_number(f, c->left[0], 4);
    write_number(f, c->left[1], 4);
    write_number(f, c->right[0], 4);
    write_number(f, c->right[1], 4);
    write_number(f, sqrt(c->covariance[0]), 4);
    write_number(f, sqrt(c->covariance[3]), 4);
    write_number(f, c->zncc, 4);
}

static td_status end_table(FILE *f, char **text, size_t *size, const char *path, td_error *error)
{
    bool failed = ferror(f) != 0;
    td_status status = fclose(f) == 0 && !failed ? td_file_write(path, *text, *size, error)
                                                 : td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    free(*text);
    return status;
}

td_status match_candidates_write(const match_job *m, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    fputs(
        "# Candidates of each left point, best first. Leave 1 in `chosen` of the right one, 0 in the others, "
        "and "
        "give this file to --choose. Lengths in m, in the map's frame.\n"
        "point,rank,chosen,left_x_px,left_y_px,right_x_px,right_y_px,sigma_x_px,sigma_y_px,zncc,x_m,y_m,z_m,"
        "sigma_m,sigma_matching_m,sigma_calibration_m\n",
        f);
    for (size_t i = 0; i < m->point_count; i++)
        for (size_t c = 0; c < m->point[i].count; c++) {
            td_point3 p;
            const td_match *candidate = &m->point[i].candidate[c];
            bool found = td_triangulate(&p, &m->pair, candidate);
            if (found) match_to_frame(m, &p);
            write_name(f, m->point[i].name);
            fprintf(f, ",%zu,%d", c + 1, (int)c == m->point[i].chosen);
            write_pixels(f, candidate);
            write_space(f, &p, found);
            fputc('\n', f);
        }
    return end_table(f, &text, &size, path, error);
}

td_status match_matches_write(const match_job *m, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    fprintf(f,
            "# Matches, and their points in frame %s.\n"
            "point,left_x_px,left_y_px,right_x_px,right_y_px,sigma_x_px,sigma_y_px,zncc,x_m,y_m,z_m,sigma_m,"
            "sigma_matching_m,sigma_calibration_m\n",
            m->frame);
    for (size_t i = 0; i < m->count; i++) {
        write_name(f, m->point[m->index[i]].name);
        write_pixels(f, &m->match[i]);
        write_space(f, &m->space[i], true);
        fputc('\n', f);
    }
    return end_table(f, &text, &size, path, error);
}
