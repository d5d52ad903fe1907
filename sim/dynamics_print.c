/* Graphs to C text: a statement an operation, in the order in which they were made. */
#include <ctype.h>
#include <stdlib.h>

#include "core/number.h"
#include "sim/dynamics_generator_internal.h"

void td_print_head(FILE *to, const char *robot, const char *hash, const char *prefix)
{
    fprintf(to, "/* Dynamics of the robot '");
    for (const char *c = robot; *c; c++) fputc(isalnum((unsigned char)*c) || *c == '-' ? *c : '_', to);
    fprintf(to,
            "', free base and %s, generated. The signatures are those of\n"
            " * sim/dynamics.h. Compile with -ffp-contract=off: the same bytes on every machine. */\n"
            "#include <math.h>\n\n"
            "typedef struct turn {\n    double s, c;\n} turn;\n\n"
            "static inline turn turn_of(double x)\n{\n    return (turn){sin(x), cos(x)};\n}\n\n"
            "extern const char %s_hash[];\nconst char %s_hash[] = \"%s\";\n",
            "joints", prefix, prefix, hash);
}

typedef struct printer {
    FILE *to;
    const td_graph *graph;
    int *number; /* of a node's variable; sines and cosines share their angle's turn */
    int *turn;   /* of an angle: the number of its turn; -1: none yet */
    int count;
} printer;

static void print_operand(const printer *p, td_symbol a)
{
    static const char *const arrays[TD_INPUT_COUNT] = {"q", "nu", "acceleration", "force", "gravity"};
    const td_symbol_node *node = p->graph->node + a;
    char text[TD_NUMBER_SIZE];
    switch (node->kind) {
    case TD_SYMBOL_CONSTANT:
        fprintf(p->to, "%s", td_number_format(text, node->value, 0));
        break;
    case TD_SYMBOL_INPUT:
        fprintf(p->to, "%s[%d]", arrays[node->a / TD_INPUT_STRIDE], node->a % TD_INPUT_STRIDE);
        break;
    case TD_SYMBOL_SINE:
    case TD_SYMBOL_COSINE:
        fprintf(p->to, "u%d.%c", p->turn[node->a], node->kind == TD_SYMBOL_SINE ? 's' : 'c');
        break;
    default:
        fprintf(p->to, "t%d", p->number[a]);
    }
}

static void print_node(printer *p, td_symbol a)
{
    static const char signs[] = {[TD_SYMBOL_ADD] = '+',
                                 [TD_SYMBOL_SUBTRACT] = '-',
                                 [TD_SYMBOL_MULTIPLY] = '*',
                                 [TD_SYMBOL_DIVIDE] = '/'};
    const td_symbol_node *node = p->graph->node + a;
    if (node->kind <= TD_SYMBOL_INPUT) return;
    if (node->kind >= TD_SYMBOL_SINE) {
        if (p->turn[node->a] >= 0) return;
        p->turn[node->a] = p->count++;
        fprintf(p->to, "    const turn u%d = turn_of(", p->turn[node->a]);
        print_operand(p, node->a);
        fprintf(p->to, ");\n");
        return;
    }
    p->number[a] = p->count++;
    fprintf(p->to, "    const double t%d = ", p->number[a]);
    if (node->kind == TD_SYMBOL_NEGATE) fputc('-', p->to);
    print_operand(p, node->a);
    if (node->kind != TD_SYMBOL_NEGATE) {
        fprintf(p->to, " %c ", signs[node->kind]);
        print_operand(p, node->b);
    }
    fprintf(p->to, ";\n");
}

static void print_checks(const printer *p, const td_symbol *pivot, const td_symbol *diagonal, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (td_symbol_is_constant(p->graph, pivot[i])) continue;
        fprintf(p->to, "    if (!(");
        print_operand(p, pivot[i]);
        fprintf(p->to, " > 1e-13 * ");
        print_operand(p, diagonal[i]);
        fprintf(p->to, ")) return 0;\n");
    }
}

bool td_print_body(FILE *to, size_t *flops, const td_graph *graph, const char *output_name,
                   const td_symbol *output, size_t output_count, const td_symbol *pivot,
                   const td_symbol *diagonal, size_t check_count)
{
    const size_t root_count = output_count + 2 * check_count;
    bool *used = malloc(graph->count * sizeof *used);
    int *number = malloc(2 * graph->count * sizeof *number);
    td_symbol *root = malloc((root_count + 1) * sizeof *root);
    const bool there = used && number && root;
    if (there) {
        printer p = {.to = to, .graph = graph, .number = number, .turn = number + graph->count};
        for (size_t i = 0; i < 2 * graph->count; i++) number[i] = -1;
        for (size_t i = 0; i < output_count; i++) root[i] = output[i];
        for (size_t i = 0; i < check_count; i++) {
            root[output_count + 2 * i] = pivot[i];
            root[output_count + 2 * i + 1] = diagonal[i];
        }
        td_graph_mark(used, graph, root, root_count);
        *flops = td_graph_flops(graph, used);
        for (size_t i = 0; i < graph->count; i++)
            if (used[i]) print_node(&p, (td_symbol)i);
        print_checks(&p, pivot, diagonal, check_count);
        for (size_t i = 0; i < output_count; i++) {
            fprintf(to, "    %s[%zu] = ", output_name, i);
            print_operand(&p, output[i]);
            fprintf(to, ";\n");
        }
    }
    free(used);
    free(number);
    free(root);
    return there;
}
