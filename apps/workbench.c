/* teledimos workbench: pictures worked on for another program, which asks by lines of JSON on standard input
 * and reads lines on standard output. The panel runs it, so that what is heavy stays out of its process. */
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "apps/cli.h"
#include "apps/terminal.h"
#include "apps/workbench_internal.h"
#include "core/linalg.h"

static const char *positional[1 + WORKBENCH_PLACES];
static const char *output, *target_words;
static double rate_hz = 10;

static cli_option options[] = {
    {CLI_REAL, "rate", 0, &rate_hz, "HZ", "acquire: pictures a second; default 10", 0.1, 100, NULL},
    {CLI_STRING, "target", 0, &target_words, "TARGET",
     "acquire: what is seen, for dataset.yaml of what is stored (see teledimos capture)", 0, 0, NULL},
    {CLI_STRING, "output", 'o', &output, "DIR", "folder for what is stored: acquired, calibrated, points", 0,
     0, NULL},
};

static cli_command command = {
    .name = "workbench",
    .summary = "pictures worked on for another program, by lines of JSON",
    .usage = "acquire SOURCE [SOURCE2] -o DIR | pictures DATASET… -o DIR",
    .text =
        "What the panel runs for its views of pictures, in a process of its own; other programs and scripts "
        "may run it too. A request is a line on standard input, {\"id\": 1, \"op\": \"Benches\", …}; each is "
        "answered by a line on standard output: 'answer 1 {…}', or 'failure 1' and a sentence. It ends with "
        "its input.\n\n"
        "acquire shows a source, or two, as teledimos capture takes them: lines 'message left {…}' with "
        "foxglove.CompressedImage, and 'message state {…}' with focus and skew. Freeze {on} holds the "
        "picture, Store {} puts it into DIR/acquired, a dataset.\n\n"
        "pictures works on datasets, or folders of pictures, that the command line names, and on "
        "DIR/acquired: Benches {}; OpenBench {bench, for}, for calibrate, match or (left out) both; Picture "
        "{frame, camera, for}; FindMarks {frame, camera, "
        "clicks: [{mark, x, y}]}, up to nine clicks; Coverage {}; Calibrate {}, which runs teledimos "
        "calibrate into DIR/calibrated; MatchOpen {frame, rig}; MatchCheck {}, whether the pictures belong "
        "to the rig; InterestPoints {}; MatchPoint {x, y}; "
        "MatchChoose {candidate} or {x, y}; MatchUndo {}; MatchExport {}, into DIR/points.",
    .examples =
        "  echo '{\"id\": 1, \"op\": \"Benches\"}' | teledimos workbench pictures datasets/visp-marks "
        "-o bench\n"
        "  (sleep 1; echo '{\"id\": 1, \"op\": \"Store\"}') | teledimos workbench acquire "
        "'/usr/share/doc/opencv-doc/examples/data/left??.jpg' -o bench\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = sizeof positional / sizeof *positional,
    .positional = positional,
};

/* ---- lines out ---- */

static void put_line(const char *word, json_int_t id, const char *text, size_t size)
{
    printf("%s %" JSON_INTEGER_FORMAT " ", word, id);
    fwrite(text, 1, size, stdout);
    putchar('\n');
    fflush(stdout);
}

void workbench_fail(json_int_t id, const td_error *error)
{
    char text[sizeof error->message];
    size_t n = 0;
    const char *from = error->message[0] ? error->message : td_status_text(error->status);
    for (; from[n] && n + 1 < sizeof text; n++) text[n] = (unsigned char)from[n] < ' ' ? ' ' : from[n];
    put_line("failure", id, text, n);
}

void workbench_answer(json_int_t id, json_t *json)
{
    char *text = json ? json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(12)) : NULL;
    const td_error error = {.status = TD_ERROR_MEMORY};
    json_decref(json);
    if (text)
        put_line("answer", id, text, strlen(text));
    else
        workbench_fail(id, &error);
    free(text);
}

void workbench_message(const char *channel, const char *json, size_t size)
{
    printf("message %s ", channel);
    fwrite(json, 1, size, stdout);
    putchar('\n');
    fflush(stdout);
}

/* ---- lines in ---- */

static const struct {
    const char *name;
    workbench_work *work;
} works[] = {
    {"Benches", workbench_benches},         {"OpenBench", workbench_open},
    {"Picture", workbench_picture},         {"FindMarks", workbench_marks},
    {"Coverage", workbench_coverage},       {"Calibrate", workbench_calibrate},
    {"MatchOpen", workbench_pair},          {"MatchCheck", workbench_check},
    {"InterestPoints", workbench_interest}, {"MatchPoint", workbench_click},
    {"MatchChoose", workbench_choose},      {"MatchUndo", workbench_undo},
    {"MatchExport", workbench_export},
};

static td_status do_request(json_t **answer, workbench *w, const json_t *request, td_error *error)
{
    const char *op = json_string_value(json_object_get(request, "op"));
    const td_field arguments = {NULL, op ? op : "request", request};
    for (size_t i = 0; op && i < sizeof works / sizeof *works; i++)
        if (strcmp(op, works[i].name) == 0) return works[i].work(answer, w, &arguments, error);
    return td_fail(error, TD_ERROR_ARGUMENT, "there is no operation '%.40s'", op ? op : "");
}

static void take_line(workbench *w, const char *line, size_t size)
{
    td_error error = {0};
    json_t *answer = NULL, *request = json_loadb(line, size, JSON_REJECT_DUPLICATES, NULL);
    const json_int_t id = json_integer_value(json_object_get(request, "id"));
    td_status status = json_is_object(request)
                           ? do_request(&answer, w, request, &error)
                           : td_fail(&error, TD_ERROR_FORMAT, "a request that is no JSON object on a line");
    if (status == TD_OK)
        workbench_answer(id, answer);
    else
        workbench_fail(id, &error);
    json_decref(request);
}

/* A line that is longer than any request is told, and passed over. */
static void serve(workbench *w)
{
    static char line[WORKBENCH_LINE + 2];
    const td_error too_long = {.message = "a request of more than 4096 bytes"};
    while (!terminal_interrupted() && fgets(line, sizeof line, stdin)) {
        const size_t size = strlen(line);
        if (size > 0 && line[size - 1] == '\n') {
            take_line(w, line, size - 1);
            continue;
        }
        for (int c = getchar(); c != '\n' && c != EOF;) c = getchar();
        if (size >= WORKBENCH_LINE) workbench_fail(0, &too_long);
    }
}

/* ---- what is asked for ---- */

static void name_place(workbench *w, const char *path)
{
    workbench_place *p = w->place + w->places;
    size_t end = strlen(path), begin;
    while (end > 1 && path[end - 1] == '/') end--;
    for (begin = end; begin > 0 && path[begin - 1] != '/'; begin--) {
    }
    p->path = path;
    for (int again = 1; again < 100; again++) {
        if (again == 1)
            snprintf(p->name, sizeof p->name, "%.*s", (int)(end - begin < 58 ? end - begin : 58),
                     path + begin);
        else
            snprintf(p->name, sizeof p->name, "%.*s-%d", (int)(end - begin < 58 ? end - begin : 58),
                     path + begin, again);
        if (!workbench_find(w, p->name)) break;
    }
    w->places++;
}

static td_status pictures(td_error *error)
{
    char self[1024], *acquired = NULL;
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) return td_fail(error, TD_ERROR_EXTERNAL, "the place of the program cannot be found");
    self[length] = 0;
    *strrchr(self, '/') = 0;
    TD_TRY(workbench_folder(&acquired, output, "acquired", error));
    workbench *w = calloc(1, sizeof *w);
    if (!w) {
        free(acquired);
        return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    }
    w->output = output;
    w->self = self;
    name_place(w, acquired);
    for (size_t i = 1; i < command.positional_count && w->places < WORKBENCH_PLACES; i++)
        name_place(w, positional[i]);
    serve(w);
    workbench_close(w);
    free(w);
    free(acquired);
    return TD_OK;
}

static td_status run(td_error *error)
{
    const char *what = positional[0] ? positional[0] : "";
    const int sources = (int)command.positional_count - 1;
    if (!output || !*output)
        return td_fail(error, TD_ERROR_ARGUMENT, "-o DIR is missing (usage: teledimos %s %s)", command.name,
                       command.usage);
    if (strcmp(what, "pictures") == 0) return pictures(error);
    if (strcmp(what, "acquire") != 0 || sources < 1 || sources > 2)
        return td_fail(error, TD_ERROR_ARGUMENT, "say what is done (usage: teledimos %s %s)", command.name,
                       command.usage);
    const workbench_source source = {.where = positional + 1,
                                     .count = sources,
                                     .output = output,
                                     .target = target_words,
                                     .rate_hz = rate_hz};
    return workbench_acquire(&source, error);
}

/* It gives way to everything in time, ends with who began it, and cannot take the machine's memory. Files of
 * who began it are not its own. */
static void be_modest(void)
{
    enum { OURS = 3, MOST_FILES = 8192 };
    (void)prctl(PR_SET_PDEATHSIG, SIGKILL);
    (void)setpriority(PRIO_PROCESS, 0, 10);
    const struct rlimit none = {0, 0};
    (void)setrlimit(RLIMIT_CORE, &none);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
    const struct rlimit memory = {(rlim_t)4 << 30, (rlim_t)4 << 30};
    (void)setrlimit(RLIMIT_AS, &memory);
#endif
    for (int fd = OURS; fd < MOST_FILES; fd++) close(fd);
}

int main(int argc, char **argv)
{
    be_modest();
    const int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    td_error error = {0};
    terminal_catch_signals();
    td_linalg_single_thread();
    const td_status status = run(&error);
    if (status == TD_OK) return EXIT_DONE;
    cli_complain(command.name, "%s", error.message[0] ? error.message : td_status_text(status));
    return status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
