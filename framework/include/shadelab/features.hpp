#pragma once
// What a scene needs, and so what is left out. Computed once per scene; it decides which lights are shaded, what is compiled into
// the GLSL, and which layers are computed and written. An omission rests only on facts of the scene and the framework, never on what a
// shading function ought to return: a student's mistake must show with and without it.

#include <shadelab/scene.hpp>

#include <string>
#include <vector>

namespace shadelab {

struct Features {
    bool term_layers = false;      ///< ambient, diffuse, specular and coverage beside the total
    bool geometry_layers = false;  ///< id, depth, normal, position
    bool depth_only = false;       ///< nothing but the depth of each pixel's first sample: nothing is shaded
    bool gouraud = false;          ///< some object is shaded at its vertices
    bool per_fragment = false;     ///< some object is shaded at its fragments
    std::vector<int> lights;       ///< indices of the scene's lights that can add anything
    std::vector<int> materials;    ///< indices of the materials that an object uses

    std::vector<std::string> needed, left_out;  ///< one line each, for `render --explain`

    /// `terms` and `geometry`: which layers somebody asks for beside the total. `full`: leave nothing out.
    static Features of(const Scene& scene, bool terms, bool geometry, bool full);
};

}  // namespace shadelab
