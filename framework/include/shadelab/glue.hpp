#pragma once
// Code in both languages that stands between the renderer and a student's file, generated from the manifest: the structs, the
// prototypes, the batch kernels of the C++ plugin and the main functions of the shaders. What does not depend on a manifest
// stands in files with gaps: framework/glue (C++) and framework/glsl.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>

#include <filesystem>
#include <string>

namespace shadelab {

/// A shader is four texts in this order: `#version`, the prelude, the student's file, the main function. Each starts with its own
/// #line, so that a line number in the compiler's message tells which text it means: the student's lines count from 1.
inline constexpr int prelude_first_line = 1'000'001, main_first_line = 2'000'001;

/// Writes below `out`: assignment.json (describe.hpp), shadelab/assignment.hpp (the structs), prelude.hpp, glue.cpp (a plugin's
/// one translation unit), follow.hpp, prelude.glsl, and evaluate/FUNCTION.glsl (main() that evaluates one function over a
/// table).
void write_glue(const Manifest& manifest, const std::filesystem::path& framework, const std::filesystem::path& out);

/// What stands before a student's GLSL: the counterpart of shading.hpp, the structs, the prototypes, the code of given
/// assignments.
std::string glsl_prelude(const Manifest& manifest, const std::filesystem::path& framework);

/// The main functions of a program.
struct ShaderMains {
    std::string vertex, fragment;
    enum Stage {
        neither,
        vertex_stage,
        fragment_stage
    } student;  ///< where prelude and student's file stand before the main
};

/// Up to so many lights stand one by one in the shader, each with uniforms and a kind of its own. More come from a texture, in a
/// loop for each kind: llvmpipe draws a light up to half as long again (0.19 to 0.25 instead of 0.17 ms), and compiles all of
/// them in half a second instead of 0.11 s each. (A loop with a constant bound is no third way: it is unrolled.)
inline constexpr size_t most_unrolled_lights = 16;
/// llvmpipe leaves a shader's loops after 65,535 turns in all, without a word; loops in a student's functions count as well.
inline constexpr size_t most_looped_lights = 65'000;
/// The texture's layout: light i of the list stands in line i / 256, in four neighbouring texels from 4 (i % 256) on: the
/// columns of a Light behind its kind.
inline constexpr int lights_per_line = 256, texels_per_light = 4;
/// The scene's lights that can add anything, in the order of the shader: grouped by kind when a texture holds them.
std::vector<int> glsl_lights(const Scene& scene, const Features& features);

ShaderMains glsl_shade_mains(const Manifest& manifest, const std::filesystem::path& framework, const Scene& scene,
                             const Features& features, const Function& model, Interpolation interpolation,
                             bool normals_can_cancel);
/// The mains of the pass that draws id, depth, normal and position; no student code is in it.
ShaderMains glsl_geometry_mains(const std::filesystem::path& framework, bool normals_can_cancel);
/// The mains of the pass that draws depth and nothing else.
ShaderMains glsl_depth_mains(const std::filesystem::path& framework);

}  // namespace shadelab
