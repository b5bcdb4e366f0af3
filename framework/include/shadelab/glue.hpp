#pragma once
// Code in both languages that stands between the renderer and a student's file, generated from the manifest: the structs, the
// prototypes, the batch kernels of the C++ plugin and the main functions of the shaders.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>

#include <filesystem>
#include <string>

namespace shadelab {

/// A shader is four texts in this order: `#version`, the prelude, the student's file, the main function. Each starts with its own
/// #line, so that a line number in the compiler's message tells which text it means: the student's lines count from 1.
inline constexpr int prelude_first_line = 1'000'001, main_first_line = 2'000'001;

/// <shadelab/assignment.hpp>: the structs. No prototypes: a student may take arguments by value or by reference.
std::string cpp_assignment_header(const Manifest& manifest);
/// The plugin's one translation unit; it includes `student_file` (as written, relative to the compiler's -I or working folder).
std::string cpp_glue(const Manifest& manifest, const std::string& student_file);

/// For plugins with -DSHADELAB_FOLLOW: of each function f a wrapper f_followed, which asks for a recorded result first.
std::string cpp_follow_header(const Manifest& manifest);

/// `shading_glsl`: the text of the framework's shading.glsl, which opens the prelude.
std::string glsl_prelude(const Manifest& manifest, const std::string& shading_glsl);
/// main() that evaluates one function over a table in texture `rows` (the layout stands in glue.cpp).
std::string glsl_evaluate_main(const Manifest& manifest, const Function& function);
/// main() of the fragment (or, for Gouraud objects, vertex) shader that shades with `model` under the scene's lights.
struct ShaderMains {
    std::string vertex, fragment;
    bool
        student_in_vertex;  ///< the prelude and the student's file belong to the vertex shader instead of the fragment shader
};
ShaderMains glsl_shade_mains(const Manifest& manifest, const Scene& scene, const Features& features,
                             const Function& model, Interpolation interpolation, bool normals_can_cancel);
/// The mains of the pass that draws id, depth, normal and position; no student code is in it.
ShaderMains glsl_geometry_mains(bool normals_can_cancel);
/// The mains of the pass that draws depth and nothing else.
ShaderMains glsl_depth_mains();

/// Writes shadelab/assignment.hpp, glue.cpp, prelude.glsl and evaluate/FUNCTION.glsl below `out`.
void write_glue(const Manifest& manifest, const std::filesystem::path& include_folder,
                const std::filesystem::path& out);

}  // namespace shadelab
