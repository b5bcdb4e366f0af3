#pragma once
// What draw() takes from the rasterizer beside the stages that pipeline.hpp shows.

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

/// Which planes a vertex lies outside of. A triangle whose three codes share a plane bit is not visible.
unsigned clip_code(glm::vec4 clip, int width, int height);

/// rasterize() for the triangles that a tile's bin lists, in their order: the first of equal depth stays.
void rasterize_list(const ScreenTriangle* triangles, const uint32_t* list, size_t count, glm::ivec2 origin, int samples,
                    VisibilityTile& tile);

}  // namespace shadelab
