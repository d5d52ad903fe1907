// CGAL's Delaunay triangulation as its user manual calls it, on the same points: no check, no order, no copy
// out.
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>

#include "tests/bench/bench.h"

extern "C" void bench_cgal_delaunay(void *user)
{
    using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
    auto *in = static_cast<bench_points *>(user);
    std::vector<Kernel::Point_2> points;
    points.reserve(in->count);
    for (size_t i = 0; i < in->count; i++) points.emplace_back(in->xyz[3 * i], in->xyz[3 * i + 1]);
    const CGAL::Delaunay_triangulation_2<Kernel> delaunay(points.begin(), points.end());
    in->triangles = delaunay.number_of_faces();
}
