// image: draws a scene with a plugin.

#include "followed.hpp"
#include "loaded_scene.hpp"

#include "text/json.hpp"

#include <shadelab/pipeline.hpp>

#include <omp.h>

#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <optional>

namespace shadelab {

namespace {

struct ImageOptions {
    SceneOptions scene;
    std::string plugin, full_plugin, output, statistics, follow;
    int threads = 0, repeat = 0;
    double exposure = 0;
};

// ---- what is told of a frame

/// `repeats`: seconds of further frames, if any.
void write_statistics(const DrawStatistics& s, const LoadedScene& loaded, const std::vector<double>& repeats,
                      const std::string& file) {
    int dropped = 0, cancelled = 0;
    for (const Mesh& mesh : loaded.meshes) {
        dropped += mesh.dropped_triangles;
        cancelled += mesh.cancelled_normals;
    }
    toml::table out{{"triangles", s.triangles},
                    {"clipped_triangles", s.clipped_triangles},
                    {"dropped_triangles", dropped},
                    {"cancelled_vertex_normals", cancelled},
                    {"not_finite_vertices", s.not_finite_vertices},
                    {"fragments", s.fragments},
                    {"fallback_normals", s.fallback_normals},
                    {"lights_at_surface", s.lights_at_surface},
                    {"milliseconds", toml::table{{"vertices", s.vertex_ms}, {"bins", s.bin_ms}, {"tiles", s.tile_ms}}},
                    {"not_finite_fragments", s.not_finite_fragments},
                    {"repeats", json::array(repeats)}};
    if (s.first_not_finite) {
        const NotFinite& f = *s.first_not_finite;
        out.insert("first_not_finite", toml::table{{"x", f.x},
                                                   {"y", f.y},
                                                   {"material", f.material},
                                                   {"model", f.model},
                                                   {"n", json::array(f.n)},
                                                   {"position", json::array(f.position)},
                                                   {"v", json::array(f.v)},
                                                   {"value", json::array(f.value)}});
    }
    std::ofstream stream(file);
    stream << json::text(out);
    stream.close();
    if (!stream) throw InfrastructureError(file + ": cannot be written");
}

void report(const DrawStatistics& s) {
    if (s.not_finite_vertices)
        std::cerr << "warning: " << s.not_finite_vertices
                  << " vertices are not finite; their triangles are not drawn\n";
    if (s.fallback_normals)
        std::cerr << "note: at " << s.fallback_normals
                  << " fragments the vertex normals cancel; the face normal is used\n";
    if (s.lights_at_surface)
        std::cerr << "note: " << s.lights_at_surface
                  << " times a light stands at the very point that is shaded; it has no direction there and should "
                     "give nothing\n";
    if (!s.first_not_finite) return;
    const NotFinite& f = *s.first_not_finite;
    std::fprintf(stderr,
                 "warning: %lld fragments are not finite. The first stands at pixel (%d, %d), material %s (%s):\n"
                 "  n = (%.9g, %.9g, %.9g), x = (%.9g, %.9g, %.9g), v = (%.9g, %.9g, %.9g) -> (%g, %g, %g)\n",
                 static_cast<long long>(s.not_finite_fragments), f.x, f.y, f.material.c_str(), f.model.c_str(), f.n.x,
                 f.n.y, f.n.z, f.position.x, f.position.y, f.position.z, f.v.x, f.v.y, f.v.z, f.value.x, f.value.y,
                 f.value.z);
}

// ---- --explain

/// Prints what the scene needs and what is left out; `saved` is what was measured for a decision, or "".
void explain(const Features& features, const std::function<std::string(const Decision&)>& saved) {
    std::cout << "needed\n";
    for (const std::string& line : features.lines(true)) std::cout << "  + " << line << "\n";
    std::cout << "left out\n";
    for (const Decision& decision : features.decisions)
        if (!decision.needed) {
            const std::string gain = saved(decision);
            std::cout << "  - " << decision.what << ": " << decision.why << (gain.empty() ? "" : "; " + gain)
                      << std::endl;
        }
}

/// What an omission saves: the scene drawn in turn with it and without, and the difference of the shortest times. `full`: a
/// plugin that holds every loop and the terms, for what the scene's own plugin was compiled without.
template <class Real>
std::string saved_by(const SceneOptions& options, const LoadedScene& loaded, const plugin::Table<Real>& lean,
                     const plugin::Table<Real>* full, const Decision& decision) {
    constexpr int turns = 11;
    if (decision.name.empty()) return "";
    Request request = options.request();
    request.keep = decision.name;
    const Features kept = Features::of(loaded.scene, request, &loaded.manifest);
    bool as_it_is = kept.term_layers <= bool(lean.terms);
    for (const std::string& loop : kept.loops) as_it_is &= has_loop(lean, loaded.scene, loop);
    if (decision.name == "loops") return "";  // they cost no time once they are compiled
    if (!as_it_is && !full) return "";
    std::vector<double> with, without;
    Workspace workspace;
    Film small = empty_film(options, loaded);
    const FilmSettings& settings = loaded.scene.film;
    Film large(small.width, small.height, kept, settings.background, settings.samples);
    for (int turn = 0; turn < turns; ++turn) {
        double start = now_ms();
        draw<Real>(loaded.scene, loaded.features, loaded.meshes, lean, small, &workspace);
        without.push_back(now_ms() - start);
        start = now_ms();
        draw<Real>(loaded.scene, kept, loaded.meshes, as_it_is ? lean : *full, large, &workspace);
        with.push_back(now_ms() - start);
    }
    // Minima: whatever else the machine does only adds to a time.
    const double before = *std::min_element(without.begin(), without.end()),
                 gain = *std::min_element(with.begin(), with.end()) - before;
    const double mebibytes =
        double(large.channel_count() - small.channel_count()) * small.width * small.height * 4 / (1 << 20);
    char text[120];
    if (gain > 0.01 * before)
        std::snprintf(text, sizeof text, "saves %.2f of %.2f ms a frame", gain, before + gain);
    else
        std::snprintf(text, sizeof text, "saves nothing that shows in %.2f ms a frame", before);
    std::string out = text;
    if (mebibytes > 0) {
        std::snprintf(text, sizeof text, " and %.1f MiB", mebibytes);
        out += text;
    }
    return out;
}

// ---- the image

template <class Real>
void draw_image(const ImageOptions& options, const LoadedScene& loaded, const PluginLibrary& library) {
    const plugin::Table<Real>& table = checked_table<Real>(options.plugin, loaded, library);
    if (options.scene.explain) {
        std::optional<PluginLibrary> full;
        if (!options.full_plugin.empty()) full.emplace(options.full_plugin);
        explain(loaded.features, [&](const Decision& decision) {
            return saved_by<Real>(options.scene, loaded, table, full ? &full->table<Real>() : nullptr, decision);
        });
    }
    if (!options.follow.empty()) start_following<Real>(options.follow, library);
    Film image = empty_film(options.scene, loaded);
    const DrawStatistics statistics = draw<Real>(loaded.scene, loaded.features, loaded.meshes, table, image);
    report(statistics);
    std::vector<double> repeats;  // the image has warmed caches and clock
    if (options.repeat) {
        Workspace workspace;
        Film again = empty_film(options.scene, loaded);
        for (int turn = 0; turn < options.repeat; ++turn) {
            const double start = now_ms();
            draw<Real>(loaded.scene, loaded.features, loaded.meshes, table, again, &workspace);
            repeats.push_back((now_ms() - start) / 1000);
        }
    }
    if (!options.follow.empty()) write_missing<Real>(options.follow);
    if (!options.statistics.empty()) write_statistics(statistics, loaded, repeats, options.statistics);
    if (!options.output.empty()) write_image(options.scene, image, options.output, options.exposure);
}

}  // namespace

void add_image(CLI::App& app, const Framework& framework) {
    CLI::App* command = app.add_subcommand("image", "draw a scene with a plugin");
    const auto options = std::make_shared<ImageOptions>();
    add_scene_options(*command, options->scene);
    add_visibility_option(*command, options->scene);
    add_explain_option(*command, options->scene);
    command->add_option("--plugin", options->plugin, "plugin built from a student's shading.cpp")->required();
    command->add_option("-o,--output", options->output, "FILE.png, .exr or .npy");
    command->add_option("--exposure", options->exposure, "PNG only: times 2^EXPOSURE");
    command->add_option("--threads", options->threads, "number of threads (default: all cores)")
        ->check(CLI::Range(1, 1024));
    command->add_option("--statistics", options->statistics, "write counts and times as JSON");
    command->add_option("--repeat", options->repeat, "draw so many further frames, for --statistics")
        ->check(CLI::Range(0, 1000));
    command->add_option("--full-plugin", options->full_plugin,
                        "with --explain: a plugin that leaves nothing out, to measure with");
    command->add_option("--follow", options->follow,
                        "folder of FUNCTION.known: recorded outputs that stand in for those functions; "
                        "FUNCTION.missing is written there (draws with one thread)");
    command->callback([options, &framework] {
        if (options->threads) omp_set_num_threads(options->threads);
        if (!options->follow.empty()) omp_set_num_threads(1);
        const LoadedScene loaded = load(options->scene, framework);
        const PluginLibrary library(options->plugin);
        library.is_double() ? draw_image<double>(*options, loaded, library)
                            : draw_image<float>(*options, loaded, library);
    });
}

}  // namespace shadelab
