/* Hash-consed expressions. A node is made only when none like it is there, so equal expressions are equal
 * numbers. Signs are carried outwards: constants that are factors are positive and a - b is written with a
 * made before b, so that expressions that differ by their sign share a node. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "sim/dynamics_symbol_internal.h"

/* ---- the table ---- */

static uint64_t mix(uint64_t h, uint64_t x)
{
    h = (h ^ x) * 0x9E3779B97F4A7C15u;
    return h ^ (h >> 29);
}

static size_t slot_of(const td_graph *graph, const td_symbol_node *node)
{
    uint64_t bits;
    memcpy(&bits, &node->value, sizeof bits);
    const uint64_t operands = (uint64_t)(uint32_t)node->a << 32 | (uint32_t)node->b;
    return (size_t)mix(mix(mix(node->kind, operands), bits), 0) & (graph->slots - 1);
}

static bool same(const td_symbol_node *x, const td_symbol_node *y)
{
    return x->kind == y->kind && x->a == y->a && x->b == y->b && x->value == y->value;
}

static bool grow(td_graph *graph)
{
    const size_t capacity = graph->capacity ? 2 * graph->capacity : 1024, slots = 4 * capacity;
    td_symbol_node *node = realloc(graph->node, capacity * sizeof *node);
    if (!node) return false;
    graph->node = node;
    td_symbol *slot = malloc(slots * sizeof *slot);
    if (!slot) return false;
    free(graph->slot);
    graph->slot = slot;
    graph->slots = slots;
    graph->capacity = capacity;
    for (size_t i = 0; i < slots; i++) slot[i] = -1;
    for (size_t i = 0; i < graph->count; i++) {
        size_t at = slot_of(graph, node + i);
        while (slot[at] >= 0) at = (at + 1) & (slots - 1);
        slot[at] = (td_symbol)i;
    }
    return true;
}

static td_symbol make(td_graph *graph, td_symbol_kind kind, int a, int b, double value)
{
    const td_symbol_node node = {kind, a, b, value};
    if (graph->count == TD_GRAPH_MOST) graph->full = true;
    if (graph->failed || graph->full || (graph->count == graph->capacity && !grow(graph))) {
        graph->failed = true;
        return 0;
    }
    size_t at = slot_of(graph, &node);
    for (; graph->slot[at] >= 0; at = (at + 1) & (graph->slots - 1))
        if (same(graph->node + graph->slot[at], &node)) return graph->slot[at];
    graph->slot[at] = (td_symbol)graph->count;
    graph->node[graph->count] = node;
    return (td_symbol)graph->count++;
}

void td_graph_begin(td_graph *graph)
{
    *graph = (td_graph){0};
    make(graph, TD_SYMBOL_CONSTANT, 0, 0, 0);
    make(graph, TD_SYMBOL_CONSTANT, 0, 0, 1);
}

void td_graph_free(td_graph *graph)
{
    free(graph->node);
    free(graph->slot);
    *graph = (td_graph){0};
}

/* ---- making ---- */

static td_symbol_kind kind_of(const td_graph *graph, td_symbol a)
{
    return graph->failed ? TD_SYMBOL_CONSTANT : graph->node[a].kind;
}

static double value_of(const td_graph *graph, td_symbol a)
{
    return graph->failed ? 0 : graph->node[a].value;
}

bool td_symbol_is_constant(const td_graph *graph, td_symbol a)
{
    return kind_of(graph, a) == TD_SYMBOL_CONSTANT;
}

static bool is_negated(const td_graph *graph, td_symbol a)
{
    return kind_of(graph, a) == TD_SYMBOL_NEGATE;
}

td_symbol td_symbol_constant(td_graph *graph, double value)
{
    return make(graph, TD_SYMBOL_CONSTANT, 0, 0, value == 0 ? 0 : value);
}

td_symbol td_symbol_input(td_graph *graph, int index)
{
    return make(graph, TD_SYMBOL_INPUT, index, 0, 0);
}

td_symbol td_symbol_negate(td_graph *graph, td_symbol a)
{
    if (td_symbol_is_constant(graph, a)) return td_symbol_constant(graph, -value_of(graph, a));
    if (is_negated(graph, a)) return graph->node[a].a;
    return make(graph, TD_SYMBOL_NEGATE, a, 0, 0);
}

td_symbol td_symbol_add(td_graph *graph, td_symbol a, td_symbol b)
{
    if (a == 0) return b;
    if (b == 0) return a;
    if (td_symbol_is_constant(graph, a) && td_symbol_is_constant(graph, b))
        return td_symbol_constant(graph, value_of(graph, a) + value_of(graph, b));
    if (is_negated(graph, a) && is_negated(graph, b))
        return td_symbol_negate(graph, td_symbol_add(graph, graph->node[a].a, graph->node[b].a));
    if (is_negated(graph, a)) return td_symbol_subtract(graph, b, graph->node[a].a);
    if (is_negated(graph, b)) return td_symbol_subtract(graph, a, graph->node[b].a);
    return a < b ? make(graph, TD_SYMBOL_ADD, a, b, 0) : make(graph, TD_SYMBOL_ADD, b, a, 0);
}

td_symbol td_symbol_subtract(td_graph *graph, td_symbol a, td_symbol b)
{
    if (a == b) return 0;
    if (b == 0) return a;
    if (a == 0) return td_symbol_negate(graph, b);
    if (td_symbol_is_constant(graph, a) && td_symbol_is_constant(graph, b))
        return td_symbol_constant(graph, value_of(graph, a) - value_of(graph, b));
    if (is_negated(graph, b)) return td_symbol_add(graph, a, graph->node[b].a);
    if (is_negated(graph, a)) return td_symbol_negate(graph, td_symbol_add(graph, graph->node[a].a, b));
    if (a < b) return make(graph, TD_SYMBOL_SUBTRACT, a, b, 0);
    return td_symbol_negate(graph, make(graph, TD_SYMBOL_SUBTRACT, b, a, 0));
}

/* A constant times an expression. */
static td_symbol scale(td_graph *graph, double factor, td_symbol a)
{
    if (factor == 0) return 0;
    if (factor == 1) return a;
    if (factor < 0) return td_symbol_negate(graph, scale(graph, -factor, a));
    if (is_negated(graph, a)) return td_symbol_negate(graph, scale(graph, factor, graph->node[a].a));
    if (kind_of(graph, a) == TD_SYMBOL_MULTIPLY && td_symbol_is_constant(graph, graph->node[a].a))
        return scale(graph, factor * value_of(graph, graph->node[a].a), graph->node[a].b);
    return make(graph, TD_SYMBOL_MULTIPLY, td_symbol_constant(graph, factor), a, 0);
}

td_symbol td_symbol_multiply(td_graph *graph, td_symbol a, td_symbol b)
{
    if (td_symbol_is_constant(graph, a) && td_symbol_is_constant(graph, b))
        return td_symbol_constant(graph, value_of(graph, a) * value_of(graph, b));
    if (td_symbol_is_constant(graph, a)) return scale(graph, value_of(graph, a), b);
    if (td_symbol_is_constant(graph, b)) return scale(graph, value_of(graph, b), a);
    if (is_negated(graph, a)) return td_symbol_negate(graph, td_symbol_multiply(graph, graph->node[a].a, b));
    if (is_negated(graph, b)) return td_symbol_negate(graph, td_symbol_multiply(graph, a, graph->node[b].a));
    return a < b ? make(graph, TD_SYMBOL_MULTIPLY, a, b, 0) : make(graph, TD_SYMBOL_MULTIPLY, b, a, 0);
}

td_symbol td_symbol_divide(td_graph *graph, td_symbol a, td_symbol b)
{
    if (a == 0) return 0;
    if (td_symbol_is_constant(graph, b) && value_of(graph, b) != 0)
        return scale(graph, 1 / value_of(graph, b), a);
    return make(graph, TD_SYMBOL_DIVIDE, a, b, 0);
}

td_symbol td_symbol_angle(td_graph *graph, td_symbol a)
{
    return make(graph, TD_SYMBOL_ANGLE, a, 0, 0);
}

td_symbol td_symbol_sine(td_graph *graph, td_symbol a)
{
    if (is_negated(graph, a)) return td_symbol_negate(graph, td_symbol_sine(graph, graph->node[a].a));
    return a == 0 ? 0 : make(graph, TD_SYMBOL_SINE, a, 0, 0);
}

td_symbol td_symbol_cosine(td_graph *graph, td_symbol a)
{
    if (is_negated(graph, a)) return td_symbol_cosine(graph, graph->node[a].a);
    return a == 0 ? 1 : make(graph, TD_SYMBOL_COSINE, a, 0, 0);
}

/* ---- what is needed ---- */

/* Operands are made before what uses them, so one pass down the numbers reaches everything. */
void td_graph_mark(bool *used, const td_graph *graph, const td_symbol *root, size_t root_count)
{
    for (size_t i = 0; i < graph->count; i++) used[i] = false;
    for (size_t i = 0; i < root_count; i++) used[root[i]] = true;
    for (size_t i = graph->count; i-- > 0;) {
        const td_symbol_node *node = graph->node + i;
        if (!used[i] || node->kind <= TD_SYMBOL_INPUT) continue;
        used[node->a] = true;
        if (node->kind <= TD_SYMBOL_DIVIDE) used[node->b] = true;
    }
}

size_t td_graph_flops(const td_graph *graph, const bool *used)
{
    size_t flops = 0;
    for (size_t i = 0; i < graph->count; i++)
        flops += used[i] && graph->node[i].kind >= TD_SYMBOL_ADD && graph->node[i].kind <= TD_SYMBOL_DIVIDE;
    return flops;
}
