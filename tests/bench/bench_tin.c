/* Delaunay triangles of random points, near the origin and at UTM's coordinates: what our wall around CGAL
 * costs (numbers checked, indices, triangles sorted). Beside the times stand the numbers of triangles, which
 * must agree. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "recon/tin.h"
#include "tests/bench/bench.h"

static void run_ours(void *user)
{
    bench_points *in = user;
    uint32_t(*t)[3] = NULL;
    td_error error = {0};
    if (td_tin_triangulate(&t, &in->triangles, (const double(*)[3])in->xyz, in->count, &error) != TD_OK)
        fprintf(stderr, "%s\n", error.message);
    free(t);
}

/* One after the other by turns, so that a load of the machine meets both. */
static void time_both(bench_row *r, bench_points *in, int runs)
{
    double ours[9], peer[9];
    for (int i = 0; i < runs; i++) {
        double began = bench_now();
        run_ours(in);
        ours[i] = 1e3 * (bench_now() - began);
        r->error_ours = (double)in->triangles;
        began = bench_now();
        bench_cgal_delaunay(in);
        peer[i] = 1e3 * (bench_now() - began);
        r->error_peer = (double)in->triangles;
    }
    r->ours = bench_median(ours, (size_t)runs);
    r->peer = bench_median(peer, (size_t)runs);
}

static void row(const bench *b, const char *name, double far, size_t count, int runs)
{
    td_random random = td_random_seed(1, 1);
    bench_points in = {.count = count};
    if (!bench_wanted(b, name)) return;
    double *xyz = malloc(3 * count * sizeof *xyz);
    for (size_t i = 0; xyz && i < 3 * count; i++)
        xyz[i] = far * (i % 3 == 0 ? 691000 : i % 3 == 1 ? 5334000 : 0) + 100 * td_random_uniform(&random);
    in.xyz = xyz;
    bench_row r = {
        .name = name, .unit = "ms", .peer_name = "CGAL alone", .runs = runs, .error_unit = "triangles"};
    if (xyz) {
        time_both(&r, &in, runs);
        bench_print(b, &r);
    }
    free(xyz);
}

void bench_tin(const bench *b)
{
    const char *full = getenv("TELEDIMOS_FULL");
    row(b, "tin, 100k points", 0, 100000, 9);
    row(b, "tin, 100k points of UTM", 1, 100000, 9);
    if (full && !strcmp(full, "1")) row(b, "tin, 1M points", 0, 1000000, 5);
    if (full && !strcmp(full, "1")) row(b, "tin, 1M points of UTM", 1, 1000000, 5);
}
