#pragma once
// The stages of draw() are compiled once for each processor level that matters, and chosen when a program starts. All levels
// compute the same bits (no fused multiply-add, nothing reordered); only the speed differs.

#include <shadelab/pipeline.hpp>

namespace shadelab {

/// What the stages need beside draw()'s arguments, computed outside of them: a level holds nothing but the stages.
struct FrameFacts {
    glm::dmat4 world_to_clip;
    std::vector<std::vector<double>> lights;  ///< flattened, in the order of features.lights
    std::vector<char> placed;                 ///< per light: whether it has a position
    std::vector<char> normals_can_cancel;     ///< per object
};

/// One level's entry points. The plugin is null when nothing is shaded.
struct DrawTable {
    template <class Real>
    using Draw = DrawStatistics (*)(const Scene&, const Features&, const FrameFacts&, const std::vector<Mesh>&,
                                    const plugin::Table<Real>*, Film&, Workspace&);
    Draw<float> draw_float;
    Draw<double> draw_double;
};

/// The version that is part of the library itself: plain C++ for the compiler's default processor.
extern const DrawTable plain_draw_table;

}  // namespace shadelab
