/* Generated code, compiled by the machine's compiler and loaded. Files are named after a hash of the code
 * itself, so a file that is there is the one wanted, whatever version wrote it; it comes into being whole, by
 * a rename, so that several processes may compile the same robot at once. */
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/file.h"
#include "core/hash.h"
#include "sim/dynamics_generator.h"
#include "sim/dynamics_internal.h"

extern char **environ;

#define PREFIX "td_generated"

/* ---- the compiler ---- */

enum { COMPILER_SIZE = 1024, COMPILER_WORDS = 32 };

/* A command line in pieces: no shell reads it. */
typedef struct command {
    char words[COMPILER_SIZE];
    const char *argv[COMPILER_WORDS];
    int count;
} command;

/* Adds a word while there is room for it and the NULL at the end. */
static void add_word(command *c, const char *word)
{
    if (c->count < COMPILER_WORDS - 1) c->argv[c->count++] = word;
}

/* $CC is a program and perhaps arguments, parted by blanks; they come after our flags, so that they win. */
static td_status make_command(command *c, const char *source, const char *library, td_error *error)
{
    static const char *const flags[] = {"-std=c17",        "-O2",   "-ffp-contract=off",
                                        "-fno-math-errno", "-fPIC", "-shared"};
    const char *chosen = getenv("CC");
    char *rest = NULL;
    *c = (command){0};
    if (!chosen || !*chosen) chosen = "cc";
    if (strlen(chosen) >= sizeof c->words)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "CC in the environment is too long; name a C compiler there");
    strcpy(c->words, chosen);
    const char *program = strtok_r(c->words, " \t", &rest);
    if (!program) return td_fail(error, TD_ERROR_ARGUMENT, "CC in the environment names no compiler");
    add_word(c, program);
    for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) add_word(c, flags[i]);
    const char *const last[] = {"-o", library, source, "-lm"};
    const int room = COMPILER_WORDS - 1 - (int)(sizeof last / sizeof *last);
    for (const char *word; c->count < room && (word = strtok_r(NULL, " \t", &rest));) add_word(c, word);
    for (size_t i = 0; i < sizeof last / sizeof *last; i++) add_word(c, last[i]);
    return TD_OK;
}

/* Starts it with nothing to read and all it says in the file `messages`; an error number, or 0. */
static int start(pid_t *child, const command *c, const char *messages)
{
    posix_spawn_file_actions_t actions;
    int failed = posix_spawn_file_actions_init(&actions);
    if (failed) return failed;
    failed = posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    if (!failed)
        failed = posix_spawn_file_actions_addopen(&actions, 1, messages, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (!failed) failed = posix_spawn_file_actions_adddup2(&actions, 1, 2);
    if (!failed)
        failed =
            posix_spawnp(child, c->argv[0], &actions, NULL, (char *const *)(const void *)c->argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    return failed;
}

static td_status cannot_start(const char *program, const char *why, td_error *error)
{
    return td_fail(error, TD_ERROR_NOT_FOUND,
                   "the C compiler '%.200s' cannot be started (%s); install one or name it in CC, or use the "
                   "evaluation that needs none",
                   program, why);
}

static td_status run_compiler(const char *source, const char *library, const char *messages, td_error *error)
{
    command c;
    pid_t child;
    int ended = 0;
    TD_TRY(make_command(&c, source, library, error));
    const int failed = start(&child, &c, messages);
    if (failed) return cannot_start(c.argv[0], strerror(failed), error);
    while (waitpid(child, &ended, 0) < 0)
        if (errno != EINTR)
            return td_fail(error, TD_ERROR_IO, "the C compiler was lost: %s", strerror(errno));
    if (WIFEXITED(ended) && WEXITSTATUS(ended) == 0) return TD_OK;
    if (WIFEXITED(ended) && WEXITSTATUS(ended) == 127) return cannot_start(c.argv[0], "not found", error);
    char *said = NULL;
    size_t size = 0;
    if (td_file_read(&said, &size, messages, 1 << 20, NULL) != TD_OK) said = NULL;
    td_fail(error, TD_ERROR_EXTERNAL, "the C compiler '%.200s' failed: %.300s", c.argv[0],
            said && *said ? said : "it said nothing");
    free(said);
    return TD_ERROR_EXTERNAL;
}

/* ---- files ---- */

typedef struct names {
    char *library;                       /* where it stays */
    char *source, *temporary, *messages; /* of this process alone */
} names;

static char *name_in(const char *folder, const char *stem, const char *end)
{
    char name[200];
    snprintf(name, sizeof name, "%s%s", stem, end);
    return td_path_join(folder, name);
}

static void free_names(names *n)
{
    free(n->library);
    free(n->source);
    free(n->temporary);
    free(n->messages);
}

static td_status make_names(names *n, const char *folder, const char *hash, td_error *error)
{
    char stem[100], own[160], unique[] = "XXXXXX";
    *n = (names){0};
    snprintf(stem, sizeof stem, "dynamics-%.32s", hash);
    n->library = name_in(folder, stem, ".so");
    char *probe = name_in(folder, "dynamics-", unique);
    if (!n->library || !probe) {
        free(probe);
        return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to compile", folder);
    }
    const int file = mkstemp(probe);
    if (file < 0) {
        free(probe);
        return td_fail(error, TD_ERROR_IO, "%s: no file can be made in it: %s", folder, strerror(errno));
    }
    close(file);
    snprintf(own, sizeof own, "%s", strrchr(probe, '/') + 1);
    n->messages = probe; /* the empty file holds the name for this process */
    n->source = name_in(folder, own, ".c");
    n->temporary = name_in(folder, own, ".so");
    if (n->source && n->temporary) return TD_OK;
    return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to compile", folder);
}

static void remove_files(const names *n)
{
    if (n->source) unlink(n->source);
    if (n->temporary) unlink(n->temporary);
    if (n->messages) unlink(n->messages);
}

static td_status compile(const names *n, const td_generated *generated, td_error *error)
{
    TD_TRY(td_file_write(n->source, generated->code, generated->size, error));
    TD_TRY(run_compiler(n->source, n->temporary, n->messages, error));
    const int file = open(n->temporary, O_RDONLY);
    const bool safe = file >= 0 && fsync(file) == 0;
    if (file >= 0) close(file);
    if (safe && rename(n->temporary, n->library) == 0) return TD_OK;
    return td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s", n->library, strerror(errno));
}

/* ---- loading ---- */

static td_status load(td_dynamics *dynamics, const char *library, td_error *error)
{
    char hash[TD_DYNAMICS_HASH_SIZE];
    TD_TRY(td_dynamics_hash(hash, &dynamics->robot, error));
    dynamics->library = dlopen(library, RTLD_NOW | RTLD_LOCAL);
    if (!dynamics->library) {
        const char *why = dlerror();
        return td_fail(error, TD_ERROR_EXTERNAL, "%s: cannot be loaded (%s); delete it and try again",
                       library, why ? why : "no reason given");
    }
    const td_function *functions = dlsym(dynamics->library, PREFIX "_functions");
    const char *its = dlsym(dynamics->library, PREFIX "_hash");
    if (!functions || !its || strcmp(hash, its) != 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: is not the dynamics of '%s'; delete it and try again",
                       library, dynamics->robot.name);
    memcpy(dynamics->function, functions, sizeof dynamics->function);
    return TD_OK;
}

static td_status compile_and_load(td_dynamics *dynamics, const td_generated *generated, const char *folder,
                                  td_error *error)
{
    char hash[TD_HASH_HEX_SIZE];
    names n;
    TD_TRY(td_hash_bytes(hash, generated->code, generated->size, error));
    TD_TRY(td_folder_make(folder, error));
    td_status status = make_names(&n, folder, hash, error);
    if (status == TD_OK && access(n.library, R_OK) != 0) status = compile(&n, generated, error);
    remove_files(&n);
    if (status == TD_OK) status = load(dynamics, n.library, error);
    free_names(&n);
    return status;
}

td_status td_dynamics_compile(td_dynamics **dynamics, const td_robot *robot, const char *folder,
                              td_error *error)
{
    td_generated generated;
    if (!*folder) return td_fail(error, TD_ERROR_ARGUMENT, "folder: name one for the compiled code");
    TD_TRY(td_dynamics_generate(&generated, robot, PREFIX, error));
    td_dynamics *made = NULL;
    td_status status = td_dynamics_begin(&made, robot, error);
    if (status == TD_OK) status = compile_and_load(made, &generated, folder, error);
    td_generated_free(&generated);
    if (status == TD_OK)
        *dynamics = made;
    else
        td_dynamics_free(&made);
    return status;
}
