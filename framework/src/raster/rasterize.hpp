#pragma once
// Stages 2 and 4 in the shapes that draw() asks for: many vertices at once, one triangle into plain arrays.

#include <shadelab/pipeline.hpp>

namespace shadelab {

enum ClipCode : unsigned {
    clip_near = 1,
    clip_far = 2,
    clip_guard_x = 4,
    clip_guard_y = 8,
    must_clip = clip_near | clip_far | clip_guard_x | clip_guard_y,
    outside_left = 16,
    outside_right = 32,
    outside_bottom = 64,
    outside_top = 128,
    clip_not_finite = 256,
};

/// Which planes each vertex lies outside of. A triangle whose three codes share a plane bit is not visible. Returns all bits
/// that some vertex has.
unsigned clip_codes(int count, const float* x, const float* y, const float* z, const float* w, int width, int height,
                    uint16_t* out);
unsigned clip_code(glm::vec4 clip, int width, int height);
/// project() for many; what it writes for a vertex that must be clipped has no meaning.
void project(int count, const float* x, const float* y, const float* z, const float* w, int width, int height,
             ScreenVertex* out);

/// The farthest depth in each 8 x 8 block of a tile: a triangle whose nearest corner is not nearer cannot be seen there.
struct FarthestDepth {
    static constexpr int block = 8, across = tile_size / block;
    float block_depth[across * across];

    void update(const float* depth, size_t samples);
    bool hides(int x0, int x1, int y0, int y1, float nearest) const {
        for (int y = y0 / block; y <= y1 / block; ++y)
            for (int x = x0 / block; x <= x1 / block; ++x)
                if (nearest < block_depth[y * across + x]) return false;
        return true;
    }
};

/// Triangles of one object that a tile's bin lists (Stretch::bins).
struct TriangleList {
    const uint32_t* entries;
    size_t count;
    const ScreenVertex* screen;  ///< the object's vertices
    const uint32_t* indices;     ///< where the indices of the scene's triangle 0 would stand
    const ScreenTriangle* pieces;
};

/// Stage 4 for a list, in its order: the first of equal depth stays. The i-th triangle counts as first_number + i. Without Ids
/// only depth is written.
template <bool Ids>
void rasterize(const TriangleList& list, glm::ivec2 origin, const std::vector<glm::ivec2>& samples,
               const FarthestDepth* farthest, uint32_t first_number, float* depth, uint32_t* triangle);

}  // namespace shadelab
