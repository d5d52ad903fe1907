/* What the wizard shows: lines that stay, and below them a panel that is drawn anew with each picture. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "apps/wizard_internal.h"

#define DEGREES 57.29577951308232

enum { CELL_WIDTH = 2, MAP_WIDTH = CELL_WIDTH * TD_COVERAGE_COLUMNS };

void wizard_clear(wizard *w)
{
    if (w->panel_lines) fprintf(stderr, "\033[%dA\033[J", w->panel_lines);
    w->panel_lines = 0;
}

void wizard_say(wizard *w, const char *format, ...)
{
    va_list arguments;
    wizard_clear(w);
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
    fflush(stderr);
}

static const char *style(const wizard *w, const char *code)
{
    return w->colour ? code : "";
}

#define BOLD "\033[1m"
#define DIM "\033[2m"
#define WISH "\033[1;33m"
#define PLAIN "\033[0m"

/* What was found in the newest picture; NULL: there is none. */
static const td_detection *newest(const wizard *w, int c)
{
    if (w->seen[c].count) return &w->seen[c];
    return w->count ? &w->view[w->count - 1].detection[c] : NULL;
}

/* ---- The coverage of each camera's image, and where the board should go ---- */

static void mark_line(bool wish[TD_COVERAGE_ROWS][MAP_WIDTH], const double a[2], const double b[2], int width,
                      int height)
{
    enum { STEPS = 96 };
    for (int i = 0; i <= STEPS; i++) {
        double t = (double)i / STEPS;
        int column = (int)floor((a[0] + t * (b[0] - a[0]) + 0.5) / width * MAP_WIDTH);
        int row = (int)floor((a[1] + t * (b[1] - a[1]) + 0.5) / height * TD_COVERAGE_ROWS);
        if (column >= 0 && column < MAP_WIDTH && row >= 0 && row < TD_COVERAGE_ROWS) wish[row][column] = true;
    }
}

static void mark_wish(const wizard *w, int camera, bool wish[TD_COVERAGE_ROWS][MAP_WIDTH])
{
    memset(wish, 0, TD_COVERAGE_ROWS * sizeof *wish);
    if (!w->has_next || w->next.enough || w->next.camera != camera) return;
    for (int i = 0; i < 4; i++)
        mark_line(wish, w->next.outline + 2 * i, w->next.outline + 2 * ((i + 1) % 4), w->width[camera],
                  w->height[camera]);
}

static void map_row(FILE *out, const wizard *w, int camera, int row)
{
    static const char *const shade[] = {" ", "░", "▒", "▓"};
    bool wish[TD_COVERAGE_ROWS][MAP_WIDTH];
    mark_wish(w, camera, wish);
    fputs("│", out);
    for (int x = 0; x < MAP_WIDTH; x++) {
        size_t points = w->coverage[camera].points[row * TD_COVERAGE_COLUMNS + x / CELL_WIDTH];
        int level = points == 0 ? 0 : points < 8 ? 1 : points < 24 ? 2 : 3;
        if (wish[row][x])
            fprintf(out, "%s#%s", style(w, WISH), style(w, PLAIN));
        else
            fputs(shade[level], out);
    }
    fputs("│", out);
}

static void maps(FILE *out, const wizard *w)
{
    for (int row = -1; row <= TD_COVERAGE_ROWS; row++) {
        for (int c = 0; c < w->answers.camera_count; c++) {
            fputs(c ? "  " : "", out);
            if (row >= 0 && row < TD_COVERAGE_ROWS) {
                map_row(out, w, c, row);
                continue;
            }
            fputs(row < 0 ? "┌" : "└", out);
            int done = row < 0 ? fprintf(out, " %.16s ", w->answers.name[c]) : 0;
            for (int x = done; x < MAP_WIDTH; x++) fputs("─", out);
            fputs(row < 0 ? "┐" : "┘", out);
        }
        fputc('\n', out);
    }
}

/* ---- Facts ---- */

static void coverage_lines(FILE *out, const wizard *w, int c)
{
    const td_coverage *k = &w->coverage[c];
    const char *name = w->answers.name[c];
    fprintf(out, "%s: board in %zu picture%s, over %.0f %% of the image", name, k->views,
            k->views == 1 ? "" : "s", 100 * k->image_share);
    if (!isfinite(k->nearest_m)) {
        fputc('\n', out);
        return;
    }
    fprintf(out, ", %.2f to %.2f m\n", k->nearest_m, k->farthest_m);
    fprintf(out, "%s, sides away: right %zu, left %zu, lower %zu, upper %zu\n", name, k->tilted[0],
            k->tilted[1], k->tilted[2], k->tilted[3]);
}

static void facts(FILE *out, const wizard *w)
{
    for (int c = 0; c < w->answers.camera_count; c++) coverage_lines(out, w, c);
    const td_calibration *k = w->calibration;
    if (!k) {
        fprintf(out, "%s\n", *w->trouble ? w->trouble : "no calibration yet");
        return;
    }
    fprintf(out, "fit: %.2f px RMS", k->rms_px);
    if (k->pair_count)
        fprintf(out, ", baseline %.2f ± %.2f mm", 1e3 * k->pair[0].baseline_m,
                1e3 * k->pair[0].sigma_baseline_m);
    if (w->has_next && isfinite(w->next.sigma_px)) {
        fprintf(out, "; a projected point is known to %.2f px", w->next.sigma_px);
        if (!w->next.enough) fprintf(out, ", with the next picture to about %.2f", w->next.predicted_px);
    }
    fputc('\n', out);
}

static const char *headline(const wizard *w)
{
    if (w->frozen) return "frozen: z goes on";
    if (w->has_next && w->next.enough) return "more pictures no longer help: Enter calculates the result";
    if (w->has_next) return w->next.text;
    return "show the target to the camera";
}

static void keys_line(FILE *out, const wizard *w)
{
    bool folder = td_source_kind_of(w->source[0]) == TD_SOURCE_FOLDER;
    fprintf(out, "%s[Enter] finish  [s] suggest another%s  [q] leave, to go on later%s", style(w, DIM),
            folder ? "" : "  [space] take this one  [z] freeze", style(w, PLAIN));
    if (w->page) fprintf(out, "  live: %s", live_url(w->page));
    fputc('\n', out);
}

/* Found points, and the outline of where the board should go. */
static size_t picture_marks(const wizard *w, int c, live_mark **out)
{
    const td_detection *d = newest(w, c);
    live_mark *mark = calloc((d ? d->count : 0) + 4, sizeof *mark);
    size_t n = 0;
    *out = mark;
    for (size_t i = 0; mark && d && i < d->count; i++)
        if (isfinite(d->point[2 * i]))
            mark[n++] =
                (live_mark){.kind = LIVE_POINT, .x = (float)d->point[2 * i], .y = (float)d->point[2 * i + 1]};
    for (int i = 0; mark && w->has_next && !w->next.enough && w->next.camera == c && i < 4; i++) {
        const double *a = w->next.outline + 2 * i, *b = w->next.outline + 2 * ((i + 1) % 4);
        mark[n++] = (live_mark){LIVE_WISH, (float)a[0], (float)a[1], (float)b[0], (float)b[1]};
    }
    return n;
}

static void text_picture(FILE *out, const wizard *w)
{
    if (!w->text_picture || !w->frame[0].image) return;
    live_mark *mark = NULL;
    size_t n = picture_marks(w, 0, &mark);
    char *text = mark ? live_text(w->frame[0].image, mark, n, 72, 22, w->colour) : NULL;
    if (text) fputs(text, out);
    if (text && *text && text[strlen(text) - 1] != '\n') fputc('\n', out);
    free(text);
    free(mark);
}

/* Writes the text with its lines broken between words at the terminal's width, and returns their number.
 * Escape sequences take no room, and other characters one column each. */
static int put_lines(FILE *out, const char *text, int width)
{
    int lines = 0, column = 0;
    while (*text) {
        size_t length = strcspn(text, " \n");
        int room = 0;
        for (size_t i = 0; i < length; i++) {
            if (text[i] == '\033')
                while (i < length && text[i] != 'm') i++;
            else
                room += ((unsigned char)text[i] & 0xc0) != 0x80;
        }
        if (column > 0 && column + room > width) {
            fputs("\n  ", out);
            column = 2;
            lines++;
        }
        fwrite(text, 1, length, out);
        column += room;
        text += length;
        if (*text == ' ' && column < width) {
            putc(' ', out);
            column++;
        }
        if (*text == '\n') {
            putc('\n', out);
            column = 0;
            lines++;
        }
        text += *text != 0;
    }
    return lines;
}

static void screen_size(int *columns, int *rows)
{
    struct winsize size = {0};
    bool known = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 20 && size.ws_row > 5;
    *columns = known ? size.ws_col : 80;
    *rows = known ? size.ws_row : 24;
}

static char *panel(const wizard *w, bool pictures)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (!out) return NULL;
    fputc('\n', out);
    if (pictures) {
        text_picture(out, w);
        maps(out, w);
    }
    facts(out, w);
    fprintf(out, "%sNEXT: %s%s\n", style(w, BOLD), headline(w), style(w, PLAIN));
    keys_line(out, w);
    if (fclose(out) == 0) return text;
    free(text);
    return NULL;
}

/* The panel as it comes on the screen; what does not fit into its height is left out. */
void wizard_draw(wizard *w)
{
    int columns, rows;
    screen_size(&columns, &rows);
    for (int pictures = 1; pictures >= 0; pictures--) {
        char *text = panel(w, pictures), *lines = NULL;
        size_t size = 0;
        FILE *out = text ? open_memstream(&lines, &size) : NULL;
        int count = out ? put_lines(out, text, columns) : 0;
        free(text);
        bool fits = out && fclose(out) == 0 && (count < rows || !pictures);
        if (fits) {
            wizard_clear(w);
            fwrite(lines, 1, size, stderr);
            fflush(stderr);
            w->panel_lines = count < rows ? count : rows - 1;
        }
        free(lines);
        if (fits) break;
    }
    wizard_show_live(w);
}

/* ---- The page ---- */

void wizard_show_live(wizard *w)
{
    char *text = NULL;
    size_t size = 0;
    live_mark *mark[WIZARD_CAMERAS] = {NULL};
    if (!w->page) return;
    FILE *out = open_memstream(&text, &size);
    if (!out) return;
    facts(out, w);
    live_view view = {
        .count = w->answers.camera_count, .headline = headline(w), .done = NAN, .frozen = w->frozen};
    if (td_source_kind_of(w->source[0]) == TD_SOURCE_FOLDER) view.buttons = "done skip";
    for (int c = 0; c < w->answers.camera_count; c++) {
        view.image[c] = w->frame[c].image;
        view.label[c] = w->answers.name[c];
        view.mark_count[c] = picture_marks(w, c, &mark[c]);
        view.mark[c] = mark[c];
    }
    if (fclose(out) == 0) {
        view.facts = text;
        live_show(w->page, &view, NULL);
    }
    free(text);
    for (int c = 0; c < WIZARD_CAMERAS; c++) free(mark[c]);
}
