#pragma once
// What the framework understood of a manifest and of a scene, as JSON: the facts that everybody else goes by, so that nobody
// reads these files a second time.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>
#include <shadelab/scene.hpp>

#include <string>

namespace shadelab {

/// assignment.json, which stands in the glue folder:
///     schema, name, title, directory, files[], given[] (names), models[] (what a scene's `model` may name)
///     structs[]: name, members[] (name, domain), columns[]
///     functions[]: name, summary, slide, points, returns, model (bool), arguments[] (name, domain), inputs[], outputs[], gates[]
///     scenes[]: name, file (absolute), points;   light_function, fragment[], lights[]: as interface.toml declares them
/// A domain: kind, type, opposite, scale (linear | log) and, where they are given, base, range, typical. A column: path, index,
/// width, domain.
std::string describe(const Manifest& manifest);

/// One scene. Numbers are the loader's, in double; places are relative to `origin`, as both renderers use them; angles are
/// radians.
///     schema, film (width, height, samples, background), origin, calls[] (functions that the framework calls)
///     camera: eye, target, up, fov_y, near, far, world_to_clip (16 numbers by column)
///     lights[]: kind, entry (of the file), columns[] (the Light, flattened);   materials[]: name, model, parameters[]
///     objects[]: mesh (absolute), material, model, normals, interpolation, to_world (16 numbers by column)
///     needs: terms, loops[], needed[], left_out[], names[] (of what is left out)
std::string describe(const Scene& scene, const Manifest& manifest, const Features& features);

}  // namespace shadelab
