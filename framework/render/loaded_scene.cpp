#include "loaded_scene.hpp"

#include <glm/gtc/matrix_transform.hpp>

#include <cstdio>
#include <iostream>
#include <map>

namespace shadelab {

void add_scene_options(CLI::App& command, SceneOptions& options) {
    command.add_option("scene", options.scene, "scene file (TOML)")->required();
    command.add_option("--assignment", options.assignment, "folder of the assignment.toml that declares the models")
        ->required();
    command.add_option("--size", options.size, "WIDTHxHEIGHT instead of the film's");
    command.add_option("--shift", options.shift, "X,Y: the picture moves so many pixels right and up");
    command.add_option("--samples", options.samples, "coverage samples per pixel instead of the film's")
        ->check(CLI::IsMember({1, 2, 4, 8, 16, 64}));
    command.add_option("--supersample", options.supersample, "draw N times larger and average N x N pixels")
        ->check(CLI::Range(1, 64));
    command.add_flag("--layers", options.layers, "all layers: terms and geometry beside the total");
    command.add_flag("--terms", options.terms, "the layers of the terms only: ambient, diffuse, specular, coverage");
    command.add_flag("--depth", options.depth, "nothing but the depth of each pixel's first sample; nothing is shaded");
    command.add_flag("--full", options.full, "leave nothing out");
    command.add_option("--keep", options.keep, "keep this one omission, as --explain names it (for measurements)");
}

void add_visibility_option(CLI::App& command, SceneOptions& options) {
    command.add_flag("--visibility", options.visibility,
                     "nothing but which triangle each sample sees, and its depth; nothing is shaded");
}

void add_explain_option(CLI::App& command, SceneOptions& options) {
    command.add_flag("--explain", options.explain, "say what the scene needs and what is left out");
}

void set_shift(Scene& scene, const std::string& text) {
    glm::dvec2 pixels;
    char rest;
    if (std::sscanf(text.c_str(), "%lf,%lf%c", &pixels.x, &pixels.y, &rest) != 2)
        throw InputError("--shift: give X,Y in pixels, for example 0.0625,0, not \"" + text + "\"");
    scene.camera.shift = 2.0 * pixels / glm::dvec2(scene.film.width, scene.film.height);
}

LoadedScene load(const SceneOptions& options, const Framework& framework, bool with_meshes) {
    LoadedScene loaded;
    loaded.manifest = load_manifest(options.assignment, framework.interface());
    loaded.scene = load_scene(options.scene, loaded.manifest);
    FilmSettings& film = loaded.scene.film;
    if (!options.size.empty()) {
        char rest;
        if (std::sscanf(options.size.c_str(), "%dx%d%c", &film.width, &film.height, &rest) != 2 || film.width < 1 ||
            film.height < 1 || film.width > 16384 || film.height > 16384)
            throw InputError("--size: give WIDTHxHEIGHT in pixels, for example 512x512 (at most 16384), not \"" +
                             options.size + "\"");
    }
    if (!options.shift.empty()) set_shift(loaded.scene, options.shift);
    if (options.samples) film.samples = options.samples;
    if (int64_t(std::max(film.width, film.height)) * options.supersample > 16384)
        throw InputError("--supersample: the enlarged image would be wider or higher than 16384 pixels");
    loaded.features = Features::of(loaded.scene, options.request(), &loaded.manifest);
    if (!with_meshes) return loaded;
    std::map<std::pair<std::filesystem::path, Normals>, size_t> first_use;
    for (const Object& object : loaded.scene.objects) {
        const auto [entry, fresh] = first_use.try_emplace({object.mesh, object.normals}, loaded.meshes.size());
        if (!fresh) {
            loaded.meshes.push_back(Mesh(loaded.meshes[entry->second]));
            continue;
        }
        loaded.meshes.push_back(load_mesh(object.mesh, object.normals, object.mesh_where));
        for (const std::string& note : loaded.meshes.back().notes) std::cerr << "note: " << note << "\n";
    }
    for (size_t i = 0; i < loaded.meshes.size(); ++i) {
        Object& object = loaded.scene.objects[i];
        object.to_world = glm::translate(object.to_world, loaded.meshes[i].origin);
    }
    bool can_cancel = false;
    for (size_t i = 0; i < loaded.meshes.size(); ++i)
        can_cancel |= normals_can_cancel(loaded.meshes[i], loaded.scene.objects[i].to_world);
    loaded.features.decisions.push_back({"fallback", "fallback for normals that cancel",
                                         can_cancel                        ? "a triangle's vertex normals may oppose"
                                         : loaded.features.normal_fallback ? "kept by --full"
                                                                           : "no triangle's vertex normals can oppose",
                                         can_cancel || loaded.features.normal_fallback});
    return loaded;
}

Film empty_film(const SceneOptions& options, const LoadedScene& loaded) {
    const FilmSettings& film = loaded.scene.film;
    return Film(film.width * options.supersample, film.height * options.supersample, loaded.features, film.background,
                film.samples);
}

void write_image(const SceneOptions& options, Film& image, const std::string& file, double exposure) {
    if (!options.layers && !options.depth && !options.visibility) image.layers.resize(options.terms ? 5 : 1);
    write_film(options.supersample > 1 ? image.downsampled(options.supersample) : image, file, exposure);
}

}  // namespace shadelab
