// Stages 1 to 3: vertices to the screen, triangles to the tiles that they touch.
#include "raster/rasterize.hpp"
#include "raster/stages.hpp"

#include <omp.h>

#include <algorithm>

namespace shadelab {

namespace {

constexpr int block = 512;  // vertices at a time: their coordinates stay in the first-level cache

/// M (x, y, z, 1) in float32, products added column by column and nothing fused: the order in which llvmpipe adds them.
void transform(int count, const glm::vec3* __restrict positions, const glm::mat4& matrix, float* __restrict x,
               float* __restrict y, float* __restrict z, float* __restrict w) {
    const glm::mat4 m = matrix;
    for (int i = 0; i < count; ++i) {
        const glm::vec3 p = positions[i];
        x[i] = ((m[0][0] * p.x + m[1][0] * p.y) + m[2][0] * p.z) + m[3][0];
        y[i] = ((m[0][1] * p.x + m[1][1] * p.y) + m[2][1] * p.z) + m[3][1];
        z[i] = ((m[0][2] * p.x + m[1][2] * p.y) + m[2][2] * p.z) + m[3][2];
        w[i] = ((m[0][3] * p.x + m[1][3] * p.y) + m[2][3] * p.z) + m[3][3];
    }
}

glm::vec4 transform(const glm::mat4& matrix, glm::vec3 p) {
    glm::vec4 out;
    transform(1, &p, matrix, &out.x, &out.y, &out.z, &out.w);
    return out;
}

struct VertexFacts {
    unsigned codes = 0;  ///< all that some vertex has
    int64_t not_finite = 0;
};

VertexFacts project_block(const glm::vec3* positions, int count, const glm::mat4& clip_from_object,
                          const TileGrid& grid, ScreenVertex* screen, uint16_t* codes) {
    float x[block], y[block], z[block], w[block];
    transform(count, positions, clip_from_object, x, y, z, w);
    VertexFacts facts;
    facts.codes = clip_codes(count, x, y, z, w, grid.width, grid.height, codes);
    project(count, x, y, z, w, grid.width, grid.height, screen);
    if (facts.codes & clip_not_finite)
        facts.not_finite = std::count_if(codes, codes + count, [](uint16_t c) { return (c & clip_not_finite) != 0; });
    return facts;
}

/// Lists a triangle in the tiles whose samples its bounding box can hold. `mirrored`: the mesh's front faces run clockwise.
inline void list_triangle(const ScreenVertex& a, const ScreenVertex& b, const ScreenVertex& c, const TileGrid& grid,
                          int spread, bool mirrored, uint32_t entry, Stretch& stretch) {
    const int x0 = std::max((std::min(std::min(a.x, b.x), c.x) - spread + 255) >> subpixel_bits, 0);
    const int x1 = std::min((std::max(std::max(a.x, b.x), c.x) + spread) >> subpixel_bits, grid.width - 1);
    const int y0 = std::max((std::min(std::min(a.y, b.y), c.y) - spread + 255) >> subpixel_bits, 0);
    const int y1 = std::min((std::max(std::max(a.y, b.y), c.y) + spread) >> subpixel_bits, grid.height - 1);
    if (x0 > x1 || y0 > y1) return;
    const int64_t doubled_area = int64_t(b.x - a.x) * (c.y - a.y) - int64_t(c.x - a.x) * (b.y - a.y);
    if (doubled_area == 0) return;  // no area on the grid: covers no sample
    std::vector<uint32_t>* bins = &stretch.bins[((doubled_area < 0) != mirrored) * size_t(grid.across) * grid.down];
    const int left = x0 / tile_size, right = x1 / tile_size, bottom = y0 / tile_size, top = y1 / tile_size;
    for (int y = bottom; y <= top; ++y)
        for (int x = left; x <= right; ++x) bins[y * grid.across + x].push_back(entry);
}

/// The triangles [begin, end) of an object; returns how many were clipped. Codes: whether some vertex lies outside of the film
/// or is not finite; where none does, nobody looks.
template <bool Codes, class Real>
int64_t bin_triangles(const DrawnObject<Real>& object, uint32_t begin, uint32_t end, const TileGrid& grid, int spread,
                      const Buffers& buffers, Stretch& stretch) {
    const ScreenVertex* screen = &buffers.screen[object.first_vertex];
    const uint16_t* codes = &buffers.codes[object.first_vertex];
    const uint32_t* indices = object.mesh->indices.data();
    const bool mirrored = object.orientation < 0;
    int64_t clipped = 0;
    std::vector<ScreenTriangle> pieces;
    for (uint32_t t = begin; t < end; ++t) {
        const uint32_t i0 = indices[3 * size_t(t)], i1 = indices[3 * size_t(t) + 1], i2 = indices[3 * size_t(t) + 2];
        if constexpr (Codes) {
            const unsigned a = codes[i0], b = codes[i1], c = codes[i2];
            if ((a & b & c) != 0 || ((a | b | c) & clip_not_finite) != 0) continue;
            if (((a | b | c) & must_clip) != 0) {
                ++clipped;
                const glm::vec3* positions = object.mesh->positions.data();
                const glm::vec4 clip[3] = {transform(object.clip_from_object, positions[i0]),
                                           transform(object.clip_from_object, positions[i1]),
                                           transform(object.clip_from_object, positions[i2])};
                pieces.clear();
                clip_and_project(clip, grid.width, grid.height, object.first_triangle + t, pieces);
                for (const ScreenTriangle& piece : pieces) {
                    const uint32_t entry = Stretch::is_piece | uint32_t(stretch.pieces.size());
                    stretch.pieces.push_back(piece);
                    list_triangle(piece.vertex[0], piece.vertex[1], piece.vertex[2], grid, spread, mirrored, entry,
                                  stretch);
                }
                continue;
            }
        }
        list_triangle(screen[i0], screen[i1], screen[i2], grid, spread, mirrored, object.first_triangle + t, stretch);
    }
    return clipped;
}

}  // namespace

template <class Real>
void bin_scene(const std::vector<DrawnObject<Real>>& objects, const TileGrid& grid, int spread, Buffers& buffers,
               DrawStatistics& statistics) {
    if (objects.empty()) {
        buffers.stretches.clear();
        return;
    }
    const DrawnObject<Real>& last = objects.back();
    const uint32_t triangles = last.first_triangle + uint32_t(last.mesh->triangle_count());
    buffers.screen.resize(last.first_vertex + last.mesh->positions.size());
    buffers.codes.resize(buffers.screen.size());
    std::vector<unsigned> codes(objects.size());
    for (size_t o = 0; o < objects.size(); ++o) {
        const DrawnObject<Real>& object = objects[o];
        const int count = int(object.mesh->positions.size());
        unsigned any = 0;
        int64_t not_finite = 0;
#pragma omp parallel for schedule(static) reduction(| : any) reduction(+ : not_finite)
        for (int start = 0; start < count; start += block) {
            const size_t at = object.first_vertex + size_t(start);
            const VertexFacts facts =
                project_block(&object.mesh->positions[size_t(start)], std::min(block, count - start),
                              object.clip_from_object, grid, &buffers.screen[at], &buffers.codes[at]);
            any |= facts.codes;
            not_finite += facts.not_finite;
        }
        codes[o] = any;
        statistics.not_finite_vertices += not_finite;
    }
    statistics.triangles = triangles;

    const uint32_t length = std::max<uint32_t>(4096, triangles / uint32_t(4 * omp_get_max_threads()) + 1);
    buffers.stretches.resize((triangles + length - 1) / length);
    int64_t clipped = 0;
#pragma omp parallel for schedule(dynamic) reduction(+ : clipped)
    for (int s = 0; s < int(buffers.stretches.size()); ++s) {
        Stretch& stretch = buffers.stretches[size_t(s)];
        stretch.bins.resize(2 * size_t(grid.across) * grid.down);
        for (std::vector<uint32_t>& bin : stretch.bins) bin.clear();
        stretch.pieces.clear();
        const uint32_t begin = uint32_t(s) * length, end = std::min(begin + length, triangles);
        for (size_t o = 0; o < objects.size(); ++o) {
            const DrawnObject<Real>& object = objects[o];
            const uint32_t first = object.first_triangle, behind = first + uint32_t(object.mesh->triangle_count());
            if (behind <= begin || first >= end) continue;
            const uint32_t from = std::max(begin, first) - first, to = std::min(end, behind) - first;
            clipped += codes[o] ? bin_triangles<true>(object, from, to, grid, spread, buffers, stretch)
                                : bin_triangles<false>(object, from, to, grid, spread, buffers, stretch);
        }
    }
    statistics.clipped_triangles = clipped;
}

template void bin_scene(const std::vector<DrawnObject<float>>&, const TileGrid&, int, Buffers&, DrawStatistics&);
template void bin_scene(const std::vector<DrawnObject<double>>&, const TileGrid&, int, Buffers&, DrawStatistics&);

}  // namespace shadelab
