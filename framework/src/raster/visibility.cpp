// Stage 4 for a tile, and the fragments that it leaves to stage 5.
#include "raster/rasterize.hpp"
#include "raster/stages.hpp"

#include <algorithm>

namespace shadelab {

template <bool Ids, class Real>
void see(const Frame<Real>& frame, const Buffers& buffers, const TileGrid& grid, int tile,
         const std::vector<glm::ivec2>& samples, TileView& view) {
    const size_t size = samples.size() * tile_size * tile_size;
    view.samples.depth.assign(size, 1.0f);
    if (Ids) view.samples.triangle.assign(size, no_triangle);
    view.triangles.clear();
    view.ranges.clear();
    float* depth = view.samples.depth.data();
    uint32_t number = 0;
    FarthestDepth farthest;
    for (const int facing : {0, 1}) {
        if (facing == 1) farthest.update(depth, samples.size());
        for (const Stretch& stretch : buffers.stretches) {
            const std::vector<uint32_t>& bin = stretch.bins[size_t(facing * grid.across * grid.down + tile)];
            const auto triangle_of = [&](uint32_t entry) {
                return entry & Stretch::is_piece ? stretch.pieces[entry & ~Stretch::is_piece].triangle : entry;
            };
            for (size_t begin = 0; begin < bin.size();) {
                const DrawnObject<Real>& object = frame.object_of(triangle_of(bin[begin]));
                const uint32_t behind = object.first_triangle + uint32_t(object.mesh->triangle_count());
                size_t end = bin.size();
                if (triangle_of(bin.back()) >= behind)
                    end = size_t(std::partition_point(bin.begin() + int64_t(begin), bin.end(),
                                                      [&](uint32_t entry) { return triangle_of(entry) < behind; }) -
                                 bin.begin());
                const TriangleList list{&bin[begin], end - begin, &buffers.screen[object.first_vertex],
                                        object.mesh->indices.data() - 3 * size_t(object.first_triangle),
                                        stretch.pieces.data()};
                rasterize<Ids>(list, grid.origin(tile), samples, facing == 1 ? &farthest : nullptr, number, depth,
                               view.samples.triangle.data());
                if (Ids) {
                    const uint32_t index = uint32_t(&object - frame.objects.data());
                    if (view.ranges.empty() || view.ranges.back().object != index)
                        view.ranges.push_back({number, index});
                    for (size_t i = begin; i < end; ++i) view.triangles.push_back(triangle_of(bin[i]));
                }
                number += uint32_t(end - begin);
                begin = end;
            }
        }
    }
}

namespace {

/// The distinct triangles that each pixel of a tile sees, with the share of its samples, row by row; returns their number.
/// `full`: whether no sample of the tile shows the background.
template <int Samples>
size_t collect_fragments(const TileView& view, int sample_count, glm::ivec2 origin, const TileGrid& grid,
                         Fragment* const out, bool& full) {
    constexpr size_t plane = size_t(tile_size) * tile_size;
    const int width = std::min(tile_size, grid.width - origin.x), height = std::min(tile_size, grid.height - origin.y);
    const int samples = Samples ? Samples : sample_count;
    const float share = 1.0f / float(samples);
    Fragment* end = out;
    full = true;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const uint32_t* id = &view.samples.triangle[size_t(y) * tile_size + x];
            bool one = true;
            for (int s = 1; s < samples; ++s) one &= id[size_t(s) * plane] == id[0];
            if (one) {
                *end = {uint16_t(x), uint16_t(y), id[0], 1.0f};
                end += id[0] != no_triangle;
                full &= id[0] != no_triangle;
                continue;
            }
            Fragment* first = end;
            for (int s = 0; s < samples; ++s) {
                const uint32_t place = id[size_t(s) * plane];
                full = false;  // a mixed pixel adds to what is there
                if (place == no_triangle) continue;
                Fragment* seen = first;
                while (seen != end && seen->place != place) ++seen;
                if (seen == end) *end++ = {uint16_t(x), uint16_t(y), place, 0};
                seen->weight += share;
            }
        }
    return size_t(end - out);
}

}  // namespace

void collect_fragments(const TileView& view, int samples, glm::ivec2 origin, const TileGrid& grid, Fragments& out) {
    out.list.resize(std::max(out.list.size(), size_t(samples) * tile_size * tile_size + 1));
    const auto collect = samples == 1   ? collect_fragments<1>
                         : samples == 4 ? collect_fragments<4>
                                        : collect_fragments<0>;
    out.count = collect(view, samples, origin, grid, out.list.data(), out.full);
}

template void see<true>(const Frame<float>&, const Buffers&, const TileGrid&, int, const std::vector<glm::ivec2>&,
                        TileView&);
template void see<false>(const Frame<float>&, const Buffers&, const TileGrid&, int, const std::vector<glm::ivec2>&,
                         TileView&);
template void see<true>(const Frame<double>&, const Buffers&, const TileGrid&, int, const std::vector<glm::ivec2>&,
                        TileView&);

}  // namespace shadelab
