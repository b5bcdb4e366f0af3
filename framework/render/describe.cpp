// describe: what the framework understood of a scene, and what that needs. models: what it names as such.

#include "loaded_scene.hpp"

#include "text/json.hpp"

#include <shadelab/describe.hpp>

#include <iostream>
#include <memory>

namespace shadelab {

void add_describe(CLI::App& app, const Framework& framework) {
    CLI::App* command = app.add_subcommand(
        "describe", "print as JSON what a scene holds and needs; meshes are loaded with --explain alone");
    const auto options = std::make_shared<SceneOptions>();
    add_scene_options(*command, *options);
    add_visibility_option(*command, *options);
    add_explain_option(*command, *options);
    command->callback([options, &framework] {
        const LoadedScene loaded = load(*options, framework, options->explain);
        std::cout << describe(loaded.scene, loaded.manifest, loaded.features);
    });

    CLI::App* models =
        app.add_subcommand("models", "print as JSON which models a scene names, for whoever looks for an assignment");
    const auto scene = std::make_shared<std::string>();
    models->add_option("scene", *scene, "scene file (TOML)")->required();
    models->callback([scene] { std::cout << json::text(toml::table{{"models", json::array(scene_models(*scene))}}); });
}

}  // namespace shadelab
