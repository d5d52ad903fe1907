/* The terminal: single keys, a status line, and the picture as text. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "apps/capture_internal.h"
#include "apps/keys.h"
#include "apps/terminal.h"

static const double PERIOD_S = 0.2;
enum { COLUMNS = 80, ROWS = 24 };

static bool has_colours(void)
{
    const char *colour = getenv("COLORTERM"), *none = getenv("NO_COLOR");
    if (none && *none) return false;
    return colour && (strstr(colour, "truecolor") || strstr(colour, "24bit"));
}

void capture_screen_open(capture_screen *s, bool keys, bool text, bool quiet)
{
    *s = (capture_screen){.keys = keys, .text = text, .tty = isatty(STDERR_FILENO)};
    s->line = s->tty && !quiet;
    s->colour = has_colours();
    s->keys = keys && keys_open();
    /* A screen of its own, without a cursor; what stood there before comes back. */
    if (text && s->tty) fputs("\033[?1049h\033[?25l", stderr);
}

void capture_screen_close(capture_screen *s)
{
    capture_screen_clear(s);
    if (s->text && s->tty) fputs("\033[?25h\033[?1049l", stderr);
    fflush(stderr);
    keys_close();
}

void capture_screen_clear(capture_screen *s)
{
    if (s->line) fputs("\r\033[K", stderr);
    fflush(stderr);
    s->drawn_s = 0;
}

const char *capture_screen_pressed(capture_screen *s)
{
    int key = s->keys ? keys_next(0) : 0;
    if (key == ' ' || key == '\n' || key == '\r' || key == 's') return "store";
    if (key == 'f') return "freeze";
    if (key == 'q' || key == 4 || key < 0) return "done"; /* 4: Ctrl-D */
    return NULL;
}

static void size_of(const capture_screen *s, int *columns, int *rows)
{
    struct winsize size;
    *columns = COLUMNS;
    *rows = ROWS;
    if (s->tty && ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 9 && size.ws_row > 3) {
        *columns = size.ws_col;
        *rows = size.ws_row;
    }
}

/* The pictures beside one another, each as high as the highest. */
static td_image *join(const td_image *const *image, int count)
{
    enum { GAP = 8 };
    int width = GAP * (count - 1), height = 1;
    td_image *all = NULL;
    for (int i = 0; i < count; i++) {
        width += image[i]->width;
        if (image[i]->height > height) height = image[i]->height;
    }
    if (td_image_new(&all, width, height, image[0]->channels, NULL) != TD_OK) return NULL;
    size_t at = 0, channels = (size_t)all->channels;
    for (int i = 0; i < count; i++) {
        const size_t row = (size_t)image[i]->width * channels;
        for (int y = 0; y < image[i]->height; y++)
            memcpy(all->data + (size_t)y * (size_t)width * channels + at, image[i]->data + (size_t)y * row,
                   row);
        at += row + GAP * channels;
    }
    return all;
}

void capture_screen_print(const capture_screen *s, const td_image *image)
{
    int columns, rows;
    size_of(s, &columns, &rows);
    char *text = live_text(image, NULL, 0, columns, rows - 1, s->colour);
    if (text) fputs(text, stderr);
    free(text);
}

static void draw_text(const capture_screen *s, const td_image *const *image, int count)
{
    td_image *all = join(image, count);
    if (!all) return;
    if (s->tty) fputs("\033[H", stderr);
    capture_screen_print(s, all);
    if (s->tty) fputs("\033[J", stderr);
    td_image_free(&all);
}

/* At most `columns` characters of UTF-8. */
static int bytes_of(const char *line, int columns)
{
    int bytes = 0;
    for (int n = 0; line[bytes]; bytes++) {
        if (((unsigned char)line[bytes] & 0xC0) == 0x80) continue;
        if (n++ == columns) break;
    }
    return bytes;
}

void capture_screen_draw(capture_screen *s, const td_image *const *image, int count, const char *line,
                         bool now)
{
    const double now_s = terminal_now_s();
    /* Without a terminal, where pictures follow one another, one a second is enough. */
    if (!now && now_s - s->drawn_s < (s->tty ? PERIOD_S : 5 * PERIOD_S)) return;
    if (!s->line && !s->text) return;
    s->drawn_s = now_s;
    if (s->text && count > 0) draw_text(s, image, count);
    int columns, rows;
    size_of(s, &columns, &rows);
    if (s->line) fprintf(stderr, "\r\033[K%.*s", bytes_of(line, columns - 1), line);
    fflush(stderr);
}
