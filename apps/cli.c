#include "apps/cli.h"

#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void cli_complain(const char *command, const char *format, ...)
{
    fprintf(stderr, "teledimos %s: ", command);
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

/* Prints `text` in lines of at most `width` columns, all but the first indented; lines that begin with a
 * blank are kept as they are. */
static void print_wrapped(const char *text, int indent, int width)
{
    int column = indent;
    bool line_start = true;
    while (*text) {
        if (line_start && *text == ' ') {
            size_t line = strcspn(text, "\n");
            fwrite(text, 1, line, stdout);
            text += line;
        }
        size_t word = strcspn(text, " \n");
        if (column > indent && column + 1 + (int)word > width) {
            printf("\n%*s", indent, "");
            column = indent;
        } else if (column > indent) {
            putchar(' ');
            column++;
        }
        fwrite(text, 1, word, stdout);
        column += (int)word;
        text += word;
        line_start = *text == '\n';
        if (*text == '\n') {
            printf("\n%*s", text[1] ? indent : 0, "");
            column = indent;
        }
        if (*text) text++;
    }
    putchar('\n');
}

static void option_head(char *text, size_t size, const cli_option *o)
{
    char letter[8] = "    ";
    if (o->letter) snprintf(letter, sizeof letter, "-%c, ", o->letter);
    snprintf(text, size, "%s--%s%s%s", letter, o->name, o->value ? " " : "", o->value ? o->value : "");
}

static void print_help(const cli_command *c)
{
    printf("teledimos %s — %s\n\nUsage: teledimos %s %s\n\n", c->name, c->summary, c->name, c->usage);
    print_wrapped(c->text, 0, 100);
    if (c->examples) printf("\nExamples:\n%s", c->examples);
    if (c->option_count && c->option[0].type != CLI_HEADING) printf("\nOptions:\n");
    for (size_t i = 0; i < c->option_count; i++) {
        const cli_option *o = &c->option[i];
        if (o->type == CLI_HEADING) {
            printf("\n%s:\n", o->name);
            continue;
        }
        char head[80];
        option_head(head, sizeof head, o);
        if (strlen(head) > 26)
            printf("  %s\n%*s", head, 29, "");
        else
            printf("  %-26s ", head);
        print_wrapped(o->help, 29, 100);
    }
    printf("      --help                 this text\n");
}

/* roff: a dash is typed \-, a line must not begin with a dot or quote. */
static void print_roff(const char *text)
{
    bool start = true;
    for (; *text; text++) {
        if (start && (*text == '.' || *text == '\'')) fputs("\\&", stdout);
        if (*text == '-')
            fputs("\\-", stdout);
        else if (*text == '\\')
            fputs("\\e", stdout);
        else
            putchar(*text);
        start = *text == '\n';
    }
    putchar('\n');
}

static void print_man(const cli_command *c)
{
    printf(".TH TELEDIMOS-%s 1 \"\" teledimos\n.SH NAME\nteledimos\\-%s \\- ", c->name, c->name);
    print_roff(c->summary);
    printf(".SH SYNOPSIS\n.B teledimos %s\n", c->name);
    print_roff(c->usage);
    printf(".SH DESCRIPTION\n");
    print_roff(c->text);
    printf(".SH OPTIONS\n");
    for (size_t i = 0; i < c->option_count; i++) {
        const cli_option *o = &c->option[i];
        if (o->type == CLI_HEADING) {
            printf(".SS %s\n", o->name);
            continue;
        }
        char head[80];
        option_head(head, sizeof head, o);
        printf(".TP\n");
        print_roff(head + (o->letter ? 0 : 4));
        print_roff(o->help);
    }
    if (c->examples) {
        printf(".SH EXAMPLES\n.nf\n");
        print_roff(c->examples);
        printf(".fi\n");
    }
    printf(".SH EXIT STATUS\n0 done; 1 failed; 2 wrong usage; 3 done, but the quality gate refuses the "
           "result\n");
}

static void print_completion(const cli_command *c)
{
    for (size_t i = 0; i < c->option_count; i++)
        if (c->option[i].type != CLI_HEADING) printf("--%s\n", c->option[i].name);
}

static bool parse_number(double *value, const char *text)
{
    char *end;
    errno = 0;
    *value = strtod(text, &end);
    return end != text && !*end && isfinite(*value);
}

static int assign(const cli_command *c, const cli_option *o, const char *text)
{
    double number;
    switch (o->type) {
    case CLI_STRING:
        for (size_t i = 0; o->words && o->words[i]; i++)
            if (strcmp(o->words[i], text) == 0) {
                *(const char **)o->target = o->words[i];
                return -1;
            }
        if (o->words) {
            fprintf(stderr, "teledimos %s: --%s: '%s' is none of:", c->name, o->name, text);
            for (size_t i = 0; o->words[i]; i++) fprintf(stderr, " %s", o->words[i]);
            fputc('\n', stderr);
            return EXIT_USAGE;
        }
        *(const char **)o->target = text;
        return -1;
    case CLI_INT:
    case CLI_REAL:
        if (!parse_number(&number, text) || (o->type == CLI_INT && number != floor(number)) ||
            number < o->low || number > o->high) {
            cli_complain(c->name, "--%s: '%s' is not %s from %.10g to %.10g", o->name, text,
                         o->type == CLI_INT ? "a whole number" : "a number", o->low, o->high);
            return EXIT_USAGE;
        }
        if (o->type == CLI_INT)
            *(int *)o->target = (int)number;
        else
            *(double *)o->target = number;
        return -1;
    case CLI_LIST: {
        cli_list *list = o->target;
        if (list->count == sizeof list->value / sizeof *list->value) {
            cli_complain(c->name, "--%s: given too often", o->name);
            return EXIT_USAGE;
        }
        list->value[list->count++] = text;
        return -1;
    }
    case CLI_FLAG:
    case CLI_HEADING:
        break;
    }
    return -1;
}

static const cli_option *find_option(const cli_command *c, const char *name, size_t length)
{
    for (size_t i = 0; i < c->option_count; i++)
        if (c->option[i].type != CLI_HEADING && strlen(c->option[i].name) == length &&
            strncmp(c->option[i].name, name, length) == 0)
            return &c->option[i];
    return NULL;
}

static const cli_option *find_letter(const cli_command *c, char letter)
{
    for (size_t i = 0; i < c->option_count; i++)
        if (c->option[i].type != CLI_HEADING && c->option[i].letter && c->option[i].letter == letter)
            return &c->option[i];
    return NULL;
}

/* Handles argv[*i], an option; may take argv[*i + 1] as its value. */
static int parse_option(const cli_command *c, int argc, char **argv, int *i)
{
    const char *argument = argv[*i], *value = NULL;
    const cli_option *o;
    if (argument[1] == '-') {
        size_t length = strcspn(argument + 2, "=");
        o = find_option(c, argument + 2, length);
        if (argument[2 + length]) value = argument + 2 + length + 1;
    } else {
        o = find_letter(c, argument[1]);
        if (o && argument[2]) value = argument + 2;
        if (o && o->type == CLI_FLAG && argument[2]) o = NULL;
    }
    if (!o) {
        cli_complain(c->name, "there is no option %s (see teledimos %s --help)", argument, c->name);
        return EXIT_USAGE;
    }
    if (o->type == CLI_FLAG) {
        if (value) {
            cli_complain(c->name, "--%s takes no value", o->name);
            return EXIT_USAGE;
        }
        *(bool *)o->target = true;
        return -1;
    }
    if (!value && *i + 1 < argc) value = argv[++*i];
    if (!value) {
        cli_complain(c->name, "--%s needs a value: %s", o->name, o->value);
        return EXIT_USAGE;
    }
    return assign(c, o, value);
}

int cli_parse(cli_command *c, int argc, char **argv)
{
    bool options_end = false;
    c->positional_count = 0;
    for (int i = 1; i < argc; i++) {
        if (!options_end && argv[i][0] == '-' && argv[i][1]) {
            int status = -1;
            if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) {
                print_help(c);
                return EXIT_DONE;
            }
            if (strcmp(argv[i], "--man") == 0) {
                print_man(c);
                return EXIT_DONE;
            }
            if (strcmp(argv[i], "--complete") == 0) {
                print_completion(c);
                return EXIT_DONE;
            }
            if (strcmp(argv[i], "--") == 0)
                options_end = true;
            else
                status = parse_option(c, argc, argv, &i);
            if (status >= 0) return status;
            continue;
        }
        if (c->positional_count == c->most) {
            cli_complain(c->name, "'%s' is one argument too many (usage: teledimos %s %s)", argv[i], c->name,
                         c->usage);
            return EXIT_USAGE;
        }
        c->positional[c->positional_count++] = argv[i];
    }
    if (c->positional_count < c->least) {
        cli_complain(c->name, "an argument is missing (usage: teledimos %s %s)", c->name, c->usage);
        return EXIT_USAGE;
    }
    return -1;
}
