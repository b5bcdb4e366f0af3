// packet: the frame packet of a scene, for OpenGL clients.

#include "loaded_scene.hpp"

#include <shadelab/packet.hpp>

#include <memory>

namespace shadelab {

void add_packet(CLI::App& app, const Framework& framework) {
    struct Options {
        SceneOptions scene;
        std::string output;
    };
    CLI::App* command = app.add_subcommand("packet", "write the frame packet of a scene for an OpenGL client");
    const auto options = std::make_shared<Options>();
    add_scene_options(*command, options->scene);
    command->add_option("-o,--output", options->output, "packet file")->required();
    command->callback([options, &framework] {
        const LoadedScene loaded = load(options->scene, framework);
        write_packet(make_packet(loaded.scene, loaded.manifest, loaded.features, loaded.meshes,
                                 options->scene.supersample, framework.folder),
                     options->output);
    });
}

}  // namespace shadelab
