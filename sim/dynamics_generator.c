/* The generated file: its functions one after another, each from a graph of its own. */
#include <ctype.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "sim/dynamics_generator_internal.h"

/* Beyond this a compiler takes minutes over a function, and the recursive evaluation is no slower. */
enum { MOST_FLOPS = 8000 };

typedef struct maker {
    td_tree *tree; /* (2): with the base given what its children can, and spared */
    const char *prefix;
    FILE *to;
    size_t flops[TD_FUNCTION_COUNT];
    bool written[TD_FUNCTION_COUNT];
    td_error *error;
} maker;

static const char *const NAMES[TD_FUNCTION_COUNT] = {"inverse",       "inverse_still", "forward",
                                                     "forward_still", "mass",          "gravity",
                                                     "coriolis",      "regressor",     "jacobian"};
static const char *const OUTPUTS[TD_FUNCTION_COUNT] = {
    "force", "force", "acceleration", "acceleration", "mass", "force", "force", "regressor", "jacobian"};
/* The inputs, in the order of TD_INPUT_: a letter each (q, n, a, f, g). */
static const char *const INPUTS[TD_FUNCTION_COUNT] = {"qnag", "qnag", "qnfg", "qnfg", "q",
                                                      "qg",   "qn",   "qnag", "q"};

static td_status no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory to generate the dynamics");
}

static void print_opening(const maker *m, int function)
{
    static const char letters[] = "qnafg";
    static const char *const words[] = {"q", "nu", "acceleration", "force", "gravity"};
    const bool forward = function == TD_FUNCTION_FORWARD || function == TD_FUNCTION_FORWARD_STILL;
    fprintf(m->to, "\nstatic %s %s_%s(double *%s", forward ? "int" : "void", m->prefix, NAMES[function],
            OUTPUTS[function]);
    for (const char *c = INPUTS[function]; *c; c++)
        fprintf(m->to, ", const double *%s", words[strchr(letters, *c) - letters]);
    fprintf(m->to, "%s)\n{\n", function == TD_FUNCTION_JACOBIAN ? ", int link" : "");
    for (const char *c = INPUTS[function]; *c; c++)
        fprintf(m->to, "    (void)%s;\n", words[strchr(letters, *c) - letters]);
}

/* What a function computes, in symbols. False: M is singular. */
static bool write_symbols(td_writing *w, int function, td_symbol *output, td_symbol *pivot,
                          td_symbol *diagonal, bool from_base)
{
    const td_given all = {true, true, true, true}, still = {.acceleration = true, .gravity = true};
    switch (function) {
    case TD_FUNCTION_INVERSE:
    case TD_FUNCTION_INVERSE_STILL:
        td_write_inverse(w, output, function == TD_FUNCTION_INVERSE ? all : still);
        return true;
    case TD_FUNCTION_FORWARD:
    case TD_FUNCTION_FORWARD_STILL:
        return td_write_forward(w, output, pivot, diagonal, function == TD_FUNCTION_FORWARD, from_base);
    case TD_FUNCTION_MASS:
        td_write_mass(w, output);
        return true;
    case TD_FUNCTION_GRAVITY:
        td_write_inverse(w, output, (td_given){.gravity = true});
        return true;
    case TD_FUNCTION_CORIOLIS:
        td_write_inverse(w, output, (td_given){.omega = true, .rates = true});
        return true;
    default:
        td_write_regressor(w, output);
        return true;
    }
}

static size_t output_count(const maker *m, int function)
{
    const size_t n = (size_t)m->tree->body_count + 5;
    if (function == TD_FUNCTION_MASS) return n * n;
    if (function == TD_FUNCTION_REGRESSOR) return n * 10 * (size_t)m->tree->link_count;
    return function == TD_FUNCTION_JACOBIAN ? 6 * n : n;
}

/* Ways to the same function: the first are forward dynamics' alone. */
typedef struct variant {
    bool from_base;
    int pivot;
    bool spare_base;
} variant;

/* The text of a function's body; NULL: out of memory. *flops SIZE_MAX: too long. */
static char *body_text(const maker *m, int function, int link, variant v, size_t *flops)
{
    const bool forward = function == TD_FUNCTION_FORWARD || function == TD_FUNCTION_FORWARD_STILL;
    const size_t count = output_count(m, function), n = (size_t)m->tree->body_count + 5;
    char *text = NULL;
    size_t size = 0;
    FILE *to = open_memstream(&text, &size);
    td_symbol *output = malloc((count + 2 * n) * sizeof *output);
    td_writing *w = calloc(1, sizeof *w);
    bool done = to && output && w;
    if (done) {
        td_symbol *pivot = output + count, *diagonal = pivot + n;
        bool regular = true;
        w->tree = m->tree + v.spare_base;
        w->pivot = v.pivot;
        td_graph_begin(&w->graph);
        if (function == TD_FUNCTION_JACOBIAN)
            td_write_jacobian(w, output, link);
        else
            regular = write_symbols(w, function, output, pivot, diagonal, v.from_base);
        *flops = 0;
        if (w->graph.full)
            *flops = SIZE_MAX;
        else if (w->graph.failed)
            done = false;
        else if (regular)
            done = td_print_body(to, flops, &w->graph, OUTPUTS[function], output, count, pivot, diagonal,
                                 forward ? n : 0);
        if (forward) fprintf(to, "    return %d;\n", regular);
        td_graph_free(&w->graph);
    }
    free(w);
    free(output);
    if (to && (fclose(to) != 0 || !done)) {
        free(text);
        text = NULL;
    }
    return text;
}

/* The first turned body on the base; 0: none. */
static int find_pivot(const td_tree *tree)
{
    for (int i = 1; i < tree->body_count; i++)
        if (tree->body[i].parent == 0 && tree->body[i].turned) return i;
    return 0;
}

/* Of all ways, the text of the shortest. */
static char *shortest_text(const maker *m, int function, size_t *flops)
{
    const bool forward = function == TD_FUNCTION_FORWARD || function == TD_FUNCTION_FORWARD_STILL;
    const int pivot = find_pivot(m->tree), ways = forward ? (pivot ? 8 : 4) : 2;
    char *best = body_text(m, function, 0, (variant){true, 0, false}, flops);
    if (function == TD_FUNCTION_REGRESSOR || *flops > 4 * MOST_FLOPS) return best; /* none will be short */
    for (int i = 1; best && i < ways; i++) {
        const variant v = {.spare_base = i & 1, .from_base = !(i & 2), .pivot = i & 4 ? pivot : 0};
        size_t other_flops = 0;
        char *other = body_text(m, function, 0, v, &other_flops);
        if (!other || other_flops < *flops) {
            free(best);
            best = other;
            *flops = other_flops;
        } else {
            free(other);
        }
    }
    return best;
}

static td_status make_function(maker *m, int function)
{
    size_t flops = 0;
    char *text = shortest_text(m, function, &flops);
    if (!text) return no_memory(m->error);
    m->written[function] = flops <= MOST_FLOPS;
    if (m->written[function]) {
        m->flops[function] = flops;
        print_opening(m, function);
        fprintf(m->to, "%s}\n", text);
    }
    free(text);
    return TD_OK;
}

/* One function for all links, with a case each. */
static td_status make_jacobian(maker *m)
{
    char *text = NULL;
    size_t size = 0, flops = 0;
    FILE *to = open_memstream(&text, &size);
    if (!to) return no_memory(m->error);
    bool done = true;
    for (int link = 0; done && flops <= MOST_FLOPS && link < m->tree->link_count; link++) {
        size_t more = 0;
        char *body = body_text(m, TD_FUNCTION_JACOBIAN, link, (variant){true, 0, false}, &more);
        done = body != NULL;
        if (done) fprintf(to, "    case %d: {\n%s    } break;\n", link, body);
        flops = more == SIZE_MAX ? more : flops + more;
        free(body);
    }
    done &= fclose(to) == 0;
    m->written[TD_FUNCTION_JACOBIAN] = flops <= MOST_FLOPS;
    if (done && m->written[TD_FUNCTION_JACOBIAN]) {
        print_opening(m, TD_FUNCTION_JACOBIAN);
        fprintf(m->to, "    switch (link) {\n%s    default:\n        break;\n    }\n}\n", text);
    }
    free(text);
    return done ? TD_OK : no_memory(m->error);
}

static void print_table(const maker *m)
{
    fprintf(m->to, "\nextern void (*const %s_functions[])(void);\nvoid (*const %s_functions[])(void) = {\n",
            m->prefix, m->prefix);
    for (int i = 0; i < TD_FUNCTION_COUNT; i++)
        if (m->written[i])
            fprintf(m->to, "    (void (*)(void))%s_%s,\n", m->prefix, NAMES[i]);
        else
            fprintf(m->to, "    0, /* %s: too long */\n", NAMES[i]);
    fprintf(m->to, "};\n");
}

static td_status make_all(maker *m, const td_robot *robot)
{
    char hash[TD_DYNAMICS_HASH_SIZE];
    TD_TRY(td_dynamics_hash(hash, robot, m->error));
    td_print_head(m->to, robot->name, hash, m->prefix);
    for (int i = 0; i < TD_FUNCTION_JACOBIAN; i++) TD_TRY(make_function(m, i));
    TD_TRY(make_jacobian(m));
    print_table(m);
    return TD_OK;
}

static bool is_identifier(const char *name)
{
    if (!isalpha((unsigned char)*name) && *name != '_') return false;
    for (const char *c = name; *c; c++)
        if (!isalnum((unsigned char)*c) && *c != '_') return false;
    return true;
}

td_status td_dynamics_generate(td_generated *generated, const td_robot *robot, const char *prefix,
                               td_error *error)
{
    *generated = (td_generated){0};
    if (!is_identifier(prefix))
        return td_fail(error, TD_ERROR_ARGUMENT, "prefix: '%s' is no name in C", prefix);
    TD_TRY(td_dynamics_check(robot, error));
    td_tree *tree = malloc(2 * sizeof *tree);
    char *code = NULL;
    size_t size = 0;
    FILE *to = open_memstream(&code, &size);
    maker m = {.tree = tree, .prefix = prefix, .to = to, .error = error};
    td_status status = TD_OK;
    if (tree && to) {
        td_tree_build(tree, robot, false);
        td_tree_build(tree + 1, robot, true);
        status = make_all(&m, robot);
    }
    const bool whole = to && fclose(to) == 0 && tree;
    if (status == TD_OK && !whole) status = no_memory(error);
    free(tree);
    if (status != TD_OK) {
        free(code);
        return status;
    }
    *generated = (td_generated){.code = code,
                                .size = size,
                                .inverse_flops = m.flops[TD_FUNCTION_INVERSE],
                                .inverse_no_coriolis_flops = m.flops[TD_FUNCTION_INVERSE_STILL],
                                .forward_flops = m.flops[TD_FUNCTION_FORWARD],
                                .mass_flops = m.flops[TD_FUNCTION_MASS]};
    return TD_OK;
}

void td_generated_free(td_generated *generated)
{
    free(generated->code);
    *generated = (td_generated){0};
}
