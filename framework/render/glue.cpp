// glue: what the framework understood of a manifest, and the code that it generates from it.

#include "commands.hpp"

#include <shadelab/glue.hpp>

#include <memory>

namespace shadelab {

void add_glue(CLI::App& app, const Framework& framework) {
    struct Options {
        std::string assignment, output;
    };
    CLI::App* command = app.add_subcommand("glue", "write assignment.json and the generated code of an assignment");
    const auto options = std::make_shared<Options>();
    command->add_option("assignment", options->assignment, "folder of the assignment.toml")->required();
    command->add_option("output", options->output, "folder to write to")->required();
    command->callback([options, &framework] {
        write_glue(load_manifest(options->assignment, framework.interface()), framework.folder, options->output);
    });
}

}  // namespace shadelab
