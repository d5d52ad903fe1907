#include "recon/dense_loops_internal.h"

static void look(const dense_look *row)
{
    refine_look_span(row, 1, row->width - 1);
}
#define DENSE_LOOK look

const dense_loops dense_loops_portable = DENSE_LOOPS;
