#pragma once
// What a scene needs, and so what is left out. Computed once per scene; it decides which lights are shaded, which loops and light
// kinds are compiled, what is interpolated, and which layers are computed and written. An omission rests only on facts of the
// scene and the framework, never on what a shading function ought to return: a student's mistake must show with and without it.

#include <shadelab/scene.hpp>

#include <string>
#include <vector>

namespace shadelab {

/// What somebody asks of a frame.
struct Request {
    bool terms = false;       ///< ambient, diffuse, specular and coverage beside the total
    bool geometry = false;    ///< id, depth, normal, position
    bool depth_only = false;  ///< nothing but the depth of each pixel's first sample: nothing is shaded
    bool visibility = false;  ///< nothing but which triangle each sample sees, and its depth: nothing is shaded
    bool full = false;        ///< leave nothing out
    std::string keep = {};    ///< leave out all that can be but this: a Decision's name, to measure what it saves
};

/// One thing that a scene may need or not, and why it does or does not.
struct Decision {
    std::string name;  ///< e.g. "light[1]", "terms", "view"; empty: nothing that could be kept
    std::string what, why;
    bool needed;
};

struct Features {
    bool term_layers = false, geometry_layers = false, depth_only = false, visibility = false;  ///< as requested
    bool gouraud = false;                       ///< some object is shaded at its vertices
    bool per_fragment = false;                  ///< some object is shaded at its fragments
    bool surface = true;                        ///< fragments of Gouraud objects get normal, position and view, too
    bool view = true;                           ///< the unit vector to the eye is computed: some model takes it
    bool normal_fallback = false;               ///< also where no triangle's normals can cancel
    std::vector<int> lights;                    ///< indices of the scene's lights that can add anything
    std::vector<int> materials;                 ///< indices of the materials that an object uses
    std::vector<FragmentAttribute> attributes;  ///< what the models that are drawn take of a fragment
    std::vector<std::string> loops;             ///< MODEL_KIND: the shading loops to compile, e.g. "phong_point"
    std::vector<Decision> decisions;

    /// What is needed, or what is left out, a line each: "what: why".
    std::vector<std::string> lines(bool needed) const;
    /// `manifest`: what the models take; without one, everything.
    static Features of(const Scene& scene, const Request& request, const Manifest* manifest = nullptr);
};

}  // namespace shadelab
