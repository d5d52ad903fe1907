// The wall around CGAL's Delaunay triangulation. Exact predicates: right at any coordinates.
#include <cstdlib>
#include <exception>

#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include "recon/tin_internal.h"

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Vertices = CGAL::Triangulation_vertex_base_with_info_2<std::uint32_t, Kernel>;
using Structure = CGAL::Triangulation_data_structure_2<Vertices>;
using Delaunay = CGAL::Delaunay_triangulation_2<Kernel, Structure>;

} // namespace

extern "C" bool td_tin_delaunay(uint32_t (**triangles)[3], size_t *count, size_t *vertices,
                                const double (*xy)[2], const uint32_t *index, size_t n)
try {
    Delaunay delaunay;
    Delaunay::Face_handle near;
    for (size_t i = 0; i < n; i++) {
        const auto vertex = delaunay.insert(Kernel::Point_2(xy[i][0], xy[i][1]), near);
        vertex->info() = index[i];
        near = vertex->face();
    }
    *vertices = delaunay.number_of_vertices();
    *count = 0;
    const size_t faces = delaunay.number_of_faces();
    auto *made = static_cast<uint32_t(*)[3]>(std::malloc((faces + 1) * sizeof(uint32_t[3])));
    if (!made) return false;
    if (delaunay.dimension() == 2)
        for (auto face = delaunay.finite_faces_begin(); face != delaunay.finite_faces_end(); ++face) {
            for (int k = 0; k < 3; k++) made[*count][k] = face->vertex(k)->info();
            ++*count;
        }
    *triangles = made;
    return true;
} catch (...) {
    return false;
}
