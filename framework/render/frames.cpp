// frames: stands by with a scene and draws it as often as stdin asks, for benchmarks and studies.

#include "loaded_scene.hpp"

#include "text/json.hpp"

#include <shadelab/pipeline.hpp>

#include <malloc.h>
#include <omp.h>

#include <fstream>
#include <iostream>
#include <memory>
#include <sstream>

namespace shadelab {

namespace {

struct FramesOptions {
    SceneOptions scene;
    std::string plugin;
    bool double_depth = false;
    int threads = 0;
};

/// Fixed work without memory, split over the threads: what more threads can gain on this machine at this moment.
double arithmetic_ms() {
    const double start = now_ms();
    double sum = 0;
#pragma omp parallel for schedule(static) reduction(+ : sum)
    for (int i = 0; i < 64; ++i) {
        float a[64];
        for (int k = 0; k < 64; ++k) a[k] = float(i + k);
        for (int turn = 0; turn < 4000; ++turn)
            for (int k = 0; k < 64; ++k) a[k] = a[k] * 0.9999f + 0.5f;
        sum += double(a[0]) + a[63];
    }
    const volatile double keep = sum;
    (void)keep;
    return now_ms() - start;
}

void answer(const toml::table& words) { std::cout << json::line(words) << std::endl; }

/// Answers the lines of stdin, one JSON line each, until they end: draw, write FILE, shift X,Y, threads N, arithmetic.
template <class Real>
void serve(const FramesOptions& options, LoadedScene& loaded, const plugin::Table<Real>& table, double load_ms) {
    malloc_trim(0);
    std::ofstream("/proc/self/clear_refs") << 5;  // the peak of memory from here on: loading is not part of a frame
    Film image = empty_film(options.scene, loaded);
    Workspace workspace;
    size_t geometry = 0, framebuffers = 0;
    for (const Mesh& mesh : loaded.meshes)
        geometry += (mesh.positions.size() + mesh.normals.size()) * sizeof(glm::vec3) + mesh.indices.size() * 4;
    for (const Layer& layer : image.layers) framebuffers += layer.data.size() * sizeof(float);
    const auto resident = [] {
        long pages = 0, resident_pages = 0;
        std::ifstream("/proc/self/statm") >> pages >> resident_pages;
        return size_t(resident_pages) * 4096;
    };
    answer(toml::table{{"ready", true},
                       {"load_ms", load_ms},
                       {"geometry_bytes", int64_t(geometry)},
                       {"framebuffer_bytes", int64_t(framebuffers)},
                       {"memory_bytes", int64_t(resident())}});
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string command, argument;
        words >> command;
        std::getline(words >> std::ws, argument);
        if (command == "draw") {
            const double start = now_ms();
            const DrawStatistics s = draw<Real>(loaded.scene, loaded.features, loaded.meshes, table, image, &workspace);
            answer(toml::table{{"ms", now_ms() - start},
                               {"vertices", s.vertex_ms},
                               {"bins", s.bin_ms},
                               {"tiles", s.tile_ms},
                               {"fragments", s.fragments},
                               {"memory_bytes", int64_t(resident())}});
        } else if (command == "write") {
            Film copy = image;
            write_image(options.scene, copy, argument, 0);
            answer(toml::table{{"written", argument}});
        } else if (command == "shift") {
            set_shift(loaded.scene, argument);
            answer(toml::table{{"shift", argument}});
        } else if (command == "threads") {
            omp_set_num_threads(std::max(1, std::atoi(argument.c_str())));
            answer(toml::table{{"threads", omp_get_max_threads()}});
        } else if (command == "arithmetic") {
            answer(toml::table{{"ms", arithmetic_ms()}});
        } else {
            throw InputError("frames: unknown command \"" + line +
                             "\": draw, write FILE, shift X,Y, threads N or arithmetic");
        }
    }
}

}  // namespace

void add_frames(CLI::App& app, const Framework& framework) {
    CLI::App* command = app.add_subcommand("frames", "draw a scene as often as stdin asks, for benchmarks");
    const auto options = std::make_shared<FramesOptions>();
    add_scene_options(*command, options->scene);
    add_visibility_option(*command, options->scene);
    command->add_option("--plugin", options->plugin, "plugin; not needed with --depth or --visibility");
    command->add_flag("--double", options->double_depth, "with --depth: in double; otherwise the plugin decides");
    command->add_option("--threads", options->threads, "number of threads (default: all cores)")
        ->check(CLI::Range(1, 1024));
    command->callback([options, &framework] {
        if (options->threads) omp_set_num_threads(options->threads);
        const double start = now_ms();
        LoadedScene loaded = load(options->scene, framework);
        const double load_ms = now_ms() - start;
        if (options->scene.depth || options->scene.visibility) {
            options->double_depth ? serve<double>(*options, loaded, {}, load_ms)
                                  : serve<float>(*options, loaded, {}, load_ms);
            return;
        }
        const PluginLibrary library(options->plugin);
        library.is_double() ? serve(*options, loaded, checked_table<double>(options->plugin, loaded, library), load_ms)
                            : serve(*options, loaded, checked_table<float>(options->plugin, loaded, library), load_ms);
    });
}

}  // namespace shadelab
