#pragma once
// The commands of shadelab-render. Each adds itself to the program with options of its own, and runs when it was asked for.

#include <CLI/CLI.hpp>

#include <chrono>
#include <filesystem>

namespace shadelab {

/// The framework's folder: interface.toml, include/, glsl/, glue/.
struct Framework {
    std::filesystem::path folder;
    std::filesystem::path interface() const { return folder / "interface.toml"; }
};

void add_image(CLI::App& app, const Framework& framework);
void add_describe(CLI::App& app, const Framework& framework);
void add_frames(CLI::App& app, const Framework& framework);
void add_convert(CLI::App& app);
void add_packet(CLI::App& app, const Framework& framework);
void add_glue(CLI::App& app, const Framework& framework);
void add_evaluate(CLI::App& app);

inline double now_ms() {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace shadelab
