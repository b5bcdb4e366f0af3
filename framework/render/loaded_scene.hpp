#pragma once
// A scene with all that belongs to it, as the commands that draw load it.

#include "commands.hpp"

#include <shadelab/error.hpp>
#include <shadelab/features.hpp>
#include <shadelab/film.hpp>
#include <shadelab/manifest.hpp>
#include <shadelab/mesh.hpp>
#include <shadelab/plugin_library.hpp>

#include <algorithm>
#include <string>
#include <vector>

namespace shadelab {

/// Which scene, and how it is to be drawn.
struct SceneOptions {
    std::string scene, assignment, size, shift, keep;
    int samples = 0, supersample = 1;
    bool layers = false, terms = false, depth = false, visibility = false, full = false, explain = false;

    Request request() const { return {layers || terms, layers, depth, visibility, full, keep}; }
};

void add_scene_options(CLI::App& command, SceneOptions& options);
void add_visibility_option(CLI::App& command, SceneOptions& options);
void add_explain_option(CLI::App& command, SceneOptions& options);

struct LoadedScene {
    Manifest manifest;
    Scene scene;
    Features features;
    std::vector<Mesh> meshes;  ///< one per object
};

/// Throws InputError. Notes of the mesh loader go to stderr.
LoadedScene load(const SceneOptions& options, const Framework& framework, bool with_meshes = true);

/// Moves the picture by "X,Y" pixels right and up.
void set_shift(Scene& scene, const std::string& text);

Film empty_film(const SceneOptions& options, const LoadedScene& loaded);
/// By extension (film.hpp); what --full computes beyond what was asked for is left out.
void write_image(const SceneOptions& options, Film& image, const std::string& file, double exposure);

/// Whether a plugin holds a shading loop, MODEL_KIND.
template <class Real>
bool has_loop(const plugin::Table<Real>& table, const Scene& scene, const std::string& loop) {
    for (int k = 0; k < table.model_count; ++k)
        for (size_t kind = 0; kind < scene.light_kinds.size(); ++kind)
            if (loop == table.models[k].name + ("_" + scene.light_kinds[kind]))
                return table.models[k].shade[kind] != nullptr;
    return false;
}

/// The plugin's table. Throws InfrastructureError when it lacks something that the scene needs.
template <class Real>
const plugin::Table<Real>& checked_table(const std::string& file, const LoadedScene& loaded,
                                         const PluginLibrary& library) {
    const plugin::Table<Real>& table = library.table<Real>();
    if (table.light_kinds != int(loaded.scene.light_kinds.size()))
        throw InfrastructureError(file + ": the plugin was built for other kinds of lights; build it again");
    for (const Material& material : loaded.scene.materials) {
        bool found = false;
        for (int k = 0; k < table.model_count; ++k) found |= material.model == table.models[k].name;
        if (!found)
            throw InfrastructureError(file + ": the plugin does not hold the model " + material.model +
                                      "; build it again");
    }
    for (const std::string& loop : loaded.features.loops)
        if (!has_loop(table, loaded.scene, loop))
            throw InfrastructureError(file + ": the plugin was built without " + loop);
    if (loaded.features.term_layers && !table.terms)
        throw InfrastructureError(file + ": the plugin was built without terms");
    return table;
}

}  // namespace shadelab
