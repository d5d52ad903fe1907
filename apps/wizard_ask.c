/* What the wizard asks before the first picture. */
#define _XOPEN_SOURCE 700 /* realpath */
#include <ctype.h>
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "apps/wizard_internal.h"
#include "core/target_words.h"

enum { MOST_DEVICES = 16, MOST_GROUPS = 8 };

/* A line from the person, without blanks around it; the default when it is empty. False: no more input. */
static bool ask(char *answer, size_t size, const char *question, const char *fallback)
{
    if (*fallback)
        fprintf(stderr, "%s [%s] ", question, fallback);
    else
        fprintf(stderr, "%s ", question);
    fflush(stderr);
    char line[WIZARD_PATH];
    if (terminal_interrupted() || !fgets(line, sizeof line, stdin) || terminal_interrupted()) {
        fputc('\n', stderr);
        return false;
    }
    char *begin = line + strspn(line, " \t"), *end = begin + strlen(begin);
    while (end > begin && strchr(" \t\r\n", end[-1])) end--;
    *end = 0;
    snprintf(answer, size, "%s", *begin ? begin : fallback);
    return true;
}

static td_status no_answer(td_error *error)
{
    return td_fail(error, TD_ERROR_CANCELLED, "ended before the first picture");
}

/* ---- Sources ---- */

static void tell(const td_error *error)
{
    fprintf(stderr, "  %s\n", error->message);
}

/* Opens what was answered, to see whether it can be. "1" is the first device of the list. */
static bool try_source(wizard *w, int c, const char *text, const td_camera_device *device, size_t devices)
{
    wizard_answers *a = &w->answers;
    td_error error = {0};
    char *end;
    long number = strtol(text, &end, 10);
    if (*text && !*end && number >= 1 && (size_t)number <= devices) text = device[number - 1].path;
    struct stat info;
    bool folder = strncmp(text, "folder:", 7) == 0;
    const char *path = folder ? text + 7 : text;
    char *whole = stat(path, &info) == 0 && S_ISDIR(info.st_mode) ? realpath(path, NULL) : NULL;
    snprintf(a->source[c], sizeof a->source[c], "%s", whole ? whole : text);
    free(whole);
    td_source_options options = td_source_options_default();
    if (*a->pattern[c]) options.pattern = a->pattern[c];
    td_source_free(&w->source[c]);
    if (td_source_open(&w->source[c], a->source[c], &options, &error) == TD_OK) return true;
    tell(&error);
    return false;
}

static td_status ask_source(wizard *w, int c, const char *given, const char *question, td_error *error)
{
    td_camera_device device[MOST_DEVICES];
    size_t devices = 0;
    char text[WIZARD_PATH];
    if (given) {
        if (try_source(w, c, given, NULL, 0)) return TD_OK;
        return td_fail(error, TD_ERROR_ARGUMENT, "--source %s cannot be used", given);
    }
    devices = td_camera_devices(device, MOST_DEVICES);
    if (c == 0)
        for (size_t i = 0; i < devices; i++)
            fprintf(stderr, "  %zu  %s  %s%s\n", i + 1, device[i].path, device[i].name,
                    device[i].usable ? "" : " (cannot be opened)");
    do {
        if (!ask(text, sizeof text, question, "")) return no_answer(error);
    } while (!*text || !try_source(w, c, text, device, devices));
    return TD_OK;
}

/* ---- A pair in one folder: left01.jpg, right01.jpg ---- */

/* Names that begin alike and go on with a number. */
typedef struct name_group {
    char prefix[64];
    int count;
} name_group;

static void add_name(name_group *group, int *groups, const char *name)
{
    size_t length = strcspn(name, "0123456789");
    const char *ending = strrchr(name, '.');
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".pgm", ".ppm"};
    bool image = false;
    for (size_t i = 0; ending && i < sizeof endings / sizeof *endings; i++)
        image |= strcasecmp(ending, endings[i]) == 0;
    if (!image || !isdigit((unsigned char)name[length]) || length == 0 || length >= sizeof group->prefix)
        return;
    for (int i = 0; i < *groups; i++)
        if (strlen(group[i].prefix) == length && strncmp(group[i].prefix, name, length) == 0) {
            group[i].count++;
            return;
        }
    if (*groups == MOST_GROUPS) return;
    name_group *g = &group[(*groups)++];
    memcpy(g->prefix, name, length);
    g->prefix[length] = 0;
    g->count = 1;
}

static bool side(const name_group *g, const char *word)
{
    char lower[sizeof g->prefix];
    size_t i = 0;
    for (; g->prefix[i]; i++) lower[i] = (char)tolower((unsigned char)g->prefix[i]);
    lower[i] = 0;
    return strstr(lower, word) != NULL;
}

/* Two groups of names, one of which says left and the other right; or 0 and 1. */
static bool find_pair(const char *path, name_group pair[2])
{
    name_group group[MOST_GROUPS] = {0};
    int groups = 0;
    DIR *folder = opendir(path);
    if (!folder) return false;
    for (struct dirent *entry; (entry = readdir(folder));) add_name(group, &groups, entry->d_name);
    closedir(folder);
    for (int i = 0; i < groups; i++)
        for (int k = 0; k < groups; k++)
            if (i != k && side(&group[i], "left") && side(&group[k], "right")) {
                pair[0] = group[i];
                pair[1] = group[k];
                return true;
            }
    return false;
}

static void name_pair(wizard_answers *a)
{
    a->camera_count = 2;
    snprintf(a->name[0], sizeof a->name[0], "left");
    snprintf(a->name[1], sizeof a->name[1], "right");
}

/* Asks whether the names of a folder are a pair's. */
static td_status ask_pair(wizard *w, bool *pair, td_error *error)
{
    wizard_answers *a = &w->answers;
    name_group group[2];
    char text[16], question[400];
    *pair = false;
    if (td_source_kind_of(w->source[0]) != TD_SOURCE_FOLDER || !find_pair(a->source[0], group)) return TD_OK;
    snprintf(question, sizeof question,
             "The folder holds %d pictures %s… and %d %s…: are they a stereo pair?", group[0].count,
             group[0].prefix, group[1].count, group[1].prefix);
    if (!ask(text, sizeof text, question, "yes")) return no_answer(error);
    if (tolower((unsigned char)text[0]) != 'y') return TD_OK;
    *pair = true;
    name_pair(a);
    for (int c = 0; c < 2; c++) {
        snprintf(a->pattern[c], sizeof a->pattern[c], "%s*", group[c].prefix);
        if (c > 0) memcpy(a->source[c], a->source[0], sizeof a->source[c]);
        td_source_options options = td_source_options_default();
        options.pattern = a->pattern[c];
        td_source_free(&w->source[c]);
        TD_TRY(td_source_open(&w->source[c], a->source[c], &options, error));
    }
    return TD_OK;
}

/* "SOURCE" or "SOURCE/names*.png": a folder's pattern may stand behind it. */
static const char *split_pattern(wizard_answers *a, int c, const char *given, char store[WIZARD_PATH])
{
    const char *slash = strrchr(given, '/');
    if (!slash || !strpbrk(slash, "*?[")) return given;
    snprintf(a->pattern[c], sizeof a->pattern[c], "%s", slash + 1);
    snprintf(store, WIZARD_PATH, "%.*s", slash == given ? 1 : (int)(slash - given), given);
    return store;
}

static td_status ask_sources(wizard *w, td_error *error)
{
    wizard_answers *a = &w->answers;
    const cli_list *given = w->setup->sources;
    char store[WIZARD_PATH], text[WIZARD_PATH];
    snprintf(a->name[0], sizeof a->name[0], "camera");
    a->camera_count = 1;
    if (given->count > WIZARD_CAMERAS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--source: %zu are given, but the wizard takes two cameras at most", given->count);
    if (given->count == 2) name_pair(a);
    for (size_t c = 0; c < given->count; c++)
        TD_TRY(ask_source(w, (int)c, split_pattern(a, (int)c, given->value[c], store), NULL, error));
    if (given->count == 2) return TD_OK;
    bool pair = false;
    if (!given->count)
        TD_TRY(ask_source(w, 0, NULL,
                          "Where do pictures come from: a folder (it may still fill), a video, or a camera?",
                          error));
    if (!*a->pattern[0]) TD_TRY(ask_pair(w, &pair, error));
    if (pair || given->count) return TD_OK;
    do {
        if (!ask(text, sizeof text, "The second camera's folder, video or camera, if it is a pair?", "none"))
            return no_answer(error);
        if (strcmp(text, "none") == 0) return TD_OK;
    } while (!try_source(w, 1, text, NULL, 0));
    name_pair(a);
    return TD_OK;
}

/* ---- Target and lens ---- */

static td_status ask_target(wizard *w, td_error *error)
{
    wizard_answers *a = &w->answers;
    char text[WIZARD_PATH];
    td_error why = {0};
    if (w->setup->target)
        return td_target_from_words(&a->target, &a->target_mapping, w->setup->target, error);
    fputs("What is the target? Kind, columns x rows (of inner corners, marks or tags), size. For example:\n"
          "  chessboard 9x6 25mm          aprilgrid 6x6 tag 88mm gap 0.3\n"
          "  marks 7x5 30mm diameter 12mm charuco 7x4 30mm tag 22mm aruco5x5_100\n"
          "(none at hand: teledimos target chessboard -o board.pdf)\n",
          stderr);
    for (;;) {
        if (!ask(text, sizeof text, "Target:", "")) return no_answer(error);
        if (td_target_from_words(&a->target, &a->target_mapping, text, &why) == TD_OK) return TD_OK;
        tell(&why);
    }
}

static td_status ask_lens(wizard *w, td_error *error)
{
    wizard_answers *a = &w->answers;
    char text[64];
    a->model = TD_CAMERA_BROWN5;
    if (w->setup->model) {
        a->model = td_camera_model_from_name(w->setup->model);
        return TD_OK;
    }
    for (;;) {
        if (!ask(text, sizeof text, "The lens: normal, or fisheye (sees 120 degrees or more)?", "normal"))
            return no_answer(error);
        if (tolower((unsigned char)text[0]) == 'f') a->model = TD_CAMERA_FISHEYE;
        if (strchr("nNfF", text[0])) return TD_OK;
        td_camera_model named = td_camera_model_from_name(text);
        if (named != TD_CAMERA_MODEL_COUNT) {
            a->model = named;
            return TD_OK;
        }
        fputs("  say normal or fisheye\n", stderr);
    }
}

static td_status ask_folder(wizard *w, td_error *error)
{
    char text[WIZARD_PATH];
    for (;;) {
        if (!w->setup->folder && !ask(text, sizeof text, "Folder for the results?", "calibration"))
            return no_answer(error);
        free(w->folder);
        w->folder = strdup(w->setup->folder ? w->setup->folder : text);
        char *begun = w->folder ? malloc(strlen(w->folder) + 16) : NULL;
        if (!begun) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
        sprintf(begun, "%s/wizard.yaml", w->folder);
        bool there = access(begun, F_OK) == 0;
        sprintf(begun, "%s/dataset.yaml", w->folder);
        bool dataset = !there && access(begun, F_OK) == 0;
        free(begun);
        if (!there && !dataset) return TD_OK;
        td_error why = {0};
        td_fail(&why, TD_ERROR_ARGUMENT,
                there ? "%s: a calibration was begun there; go on with --resume -o %s, or name another folder"
                      : "%s holds a dataset; name another folder (or: teledimos calibrate %s -o DIR)",
                w->folder, w->folder);
        if (w->setup->folder) {
            if (error) *error = why;
            return TD_ERROR_ARGUMENT;
        }
        tell(&why);
    }
}

td_status wizard_ask(wizard *w, td_error *error)
{
    const wizard_setup *s = w->setup;
    if (!s->sources->count || !s->target)
        fputs("Calibration: pictures of a board are looked at as they come; you are told which one to take "
              "next,\n"
              "and when to stop. Enter takes the answer in [brackets]; Ctrl-C ends, and nothing is lost.\n\n",
              stderr);
    TD_TRY(ask_sources(w, error));
    TD_TRY(ask_target(w, error));
    TD_TRY(ask_lens(w, error));
    return ask_folder(w, error);
}
