/* Graphs to C text: a statement an operation, in the order in which they were made. */
#include <ctype.h>
#include <stdlib.h>

#include "core/number.h"
#include "sim/dynamics_generator_internal.h"

/* Sine and cosine together, without a branch: x = n pi / 2 + r, |r| <= pi / 4, with pi / 2 in three parts of
 * 33 bits (Cody and Waite 1980), and the best polynomials of their degrees on that interval (Remez' exchange;
 * relative error 6e-18 and 2e-19 before rounding). Four cost a third of the C library's, and give the same
 * bytes with every C library. Sums of 64 angles below 1e4 stay below 2^20 quarter turns, where n times the
 * first part is exact; larger angles are first brought within a turn. */
static const char TURN_OF[] =
    "typedef struct turn {\n"
    "    double s, c;\n"
    "} turn;\n"
    "\n"
    "static inline double angle_of(double q)\n"
    "{\n"
    "    return fabs(q) < 1e4 ? q : atan2(sin(q), cos(q));\n"
    "}\n"
    "\n"
    "static inline turn turn_of(double x)\n"
    "{\n"
    "    const union {\n"
    "        double number;\n"
    "        unsigned long long bits;\n"
    "    } shifted = {x * 0.63661977236758138 + 6755399441055744.0};\n"
    "    const double n = shifted.number - 6755399441055744.0;\n"
    "    const double r = x - n * 1.5707963267341256 - n * 6.077100506303966e-11 - n * "
    "2.0222662487959506e-21;\n"
    "    const double z = r * r, zz = z * z;\n"
    "    const double s = r + r * z *\n"
    "        ((-0.1666666666666664 + z * 0.008333333333323662) +\n"
    "         zz * ((-0.00019841269830144618 + z * 2.7557313651928634e-06) +\n"
    "               zz * (-2.5050734582538527e-08 + z * 1.5894711226561679e-10)));\n"
    "    const double c = 1 - 0.5 * z + zz *\n"
    "        ((0.04166666666666665 + z * -0.001388888888888284) +\n"
    "         zz * ((2.4801587294627947e-05 + z * -2.7557315738595897e-07) +\n"
    "               zz * (2.0875897736341786e-09 + z * -1.1367981761897865e-11)));\n"
    "    const union {\n"
    "        double number;\n"
    "        unsigned long long bits;\n"
    "    } sine = {s}, cosine = {c};\n"
    "    const unsigned long long swap = -(shifted.bits & 1), differ = (sine.bits ^ cosine.bits) & swap;\n"
    "    const union {\n"
    "        unsigned long long bits;\n"
    "        double number;\n"
    "    } to_s = {sine.bits ^ differ ^ (shifted.bits & 2) << 62},\n"
    "      to_c = {cosine.bits ^ differ ^ ((shifted.bits + 1) & 2) << 62};\n"
    "    return (turn){to_s.number, to_c.number};\n"
    "}\n";

void td_print_head(FILE *to, const char *robot, const char *hash, const char *prefix)
{
    fprintf(to, "/* Dynamics of the robot '");
    for (const char *c = robot; *c; c++) fputc(isalnum((unsigned char)*c) || *c == '-' ? *c : '_', to);
    fprintf(to,
            "' with a free base, generated. The signatures are those of sim/dynamics.h.\n"
            " * Compile with -ffp-contract=off: the same bytes on every machine. */\n"
            "#include <math.h>\n\n%s\n"
            "extern const char %s_hash[];\nconst char %s_hash[] = \"%s\";\n",
            TURN_OF, prefix, prefix, hash);
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
    if (node->kind == TD_SYMBOL_ANGLE) fprintf(p->to, "angle_of(");
    print_operand(p, node->a);
    if (node->kind <= TD_SYMBOL_DIVIDE) {
        fprintf(p->to, " %c ", signs[node->kind]);
        print_operand(p, node->b);
    }
    fprintf(p->to, node->kind == TD_SYMBOL_ANGLE ? ");\n" : ";\n");
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
