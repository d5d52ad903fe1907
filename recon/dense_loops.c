#include "recon/dense_loops_internal.h"

const dense_loops dense_loops_portable = DENSE_LOOPS;
