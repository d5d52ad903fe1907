/* One table for each command: from it come parsing, --help, the man page and shell completion. */
#ifndef TELEDIMOS_APPS_CLI_H
#define TELEDIMOS_APPS_CLI_H

#include <stdbool.h>
#include <stddef.h>

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_REFUSED = 3 };

typedef enum cli_type {
    CLI_FLAG,   /* bool *: set to true */
    CLI_STRING, /* const char ** */
    CLI_INT,    /* int *, within low and high */
    CLI_REAL,   /* double *, within low and high */
    CLI_LIST,   /* cli_list *: may be given several times */
    CLI_HEADING /* no option: a heading in the help */
} cli_type;

typedef struct cli_list {
    const char *value[64];
    size_t count;
} cli_list;

typedef struct cli_option {
    cli_type type;
    const char *name; /* "json" for --json; the text of a heading */
    char letter;      /* 'o' for -o; 0: none */
    void *target;
    const char *value; /* what stands for the value in the help: "DIR" */
    const char *help;
    double low, high;         /* for numbers */
    const char *const *words; /* the words allowed for a string, NULL-terminated; NULL: any */
} cli_option;

typedef struct cli_command {
    const char *name;     /* "calibrate" */
    const char *summary;  /* one line */
    const char *usage;    /* "DATASET -o DIR [options]" */
    const char *text;     /* paragraphs */
    const char *examples; /* lines that work as typed */
    cli_option *option;
    size_t option_count;
    size_t least, most;      /* positional arguments */
    const char **positional; /* (most) out */
    size_t positional_count; /* out */
} cli_command;

/* The options every job has. */
typedef struct cli_common {
    bool quiet, verbose, json, schema;
    int threads, seed;
    const char *output;
} cli_common;

/* Their rows of the table; `products` is the help of -o, `draws` what the seed is for. */
#define CLI_COMMON_OPTIONS(common, products, draws)                                                           \
    {.type = CLI_HEADING, .name = "Everywhere"},                                                              \
        {CLI_STRING, "output", 'o', &(common).output, "DIR", products, 0, 0, NULL},                           \
        {CLI_FLAG, "json",                                                                                    \
         0,        &(common).json,                                                                            \
         NULL,     "the result as JSON on standard output instead of a table",                                \
         0,        0,                                                                                         \
         NULL},                                                                                               \
        {CLI_FLAG, "schema",                                                                                  \
         0,        &(common).schema,                                                                          \
         NULL,     "list the result's keys with types and units, and end",                                    \
         0,        0,                                                                                         \
         NULL},                                                                                               \
        {CLI_INT, "threads",                                                                                  \
         0,       &(common).threads,                                                                          \
         "N",     "threads; default: one per processor. The products do not depend on it",                    \
         0,       256,                                                                                        \
         NULL},                                                                                               \
        {CLI_INT, "seed", 0, &(common).seed, "N", "seed of random numbers (" draws ")", 0, 2147483647, NULL}, \
        {CLI_FLAG, "quiet", 'q', &(common).quiet, NULL, "no progress, no warnings", 0, 0, NULL},              \
    {                                                                                                         \
        CLI_FLAG, "verbose", 'v', &(common).verbose, NULL, "say more", 0, 0, NULL                             \
    }

/* Parses argv. Returns -1 to go on, else the exit status: --help, --man and --complete print and end with 0,
 * wrong usage prints one sentence on stderr and ends with 2. */
int cli_parse(cli_command *command, int argc, char **argv);

/* "teledimos calibrate: SENTENCE" on stderr. */
void cli_complain(const char *command, const char *format, ...);

#endif
