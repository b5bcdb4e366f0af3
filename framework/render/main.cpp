// shadelab-render: the one door between the C++ framework and everything else. It draws images, writes frame packets and glue,
// and evaluates functions over tables. Data goes to files, never to stdout: stdout is what a student's code prints.

#include <shadelab/error.hpp>
#include <shadelab/glue.hpp>
#include <shadelab/packet.hpp>
#include <shadelab/pipeline.hpp>
#include <shadelab/plugin_library.hpp>

#include <CLI/CLI.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <malloc.h>
#include <omp.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <optional>
#include <sstream>

using namespace shadelab;

namespace {

struct Options {
    std::string framework = SHADELAB_FRAMEWORK_DIR, assignment, scene, plugin, full_plugin, output, size, shift,
                statistics, function, input, keep, follow;
    int samples = 0, supersample = 1, threads = 0, repeat = 0;
    double exposure = 0;
    bool layers = false, terms = false, depth = false, visibility = false, double_depth = false, full = false,
         explain = false;

    Request request() const { return {layers || terms, layers, depth, visibility, full, keep}; }
    std::filesystem::path interface() const { return std::filesystem::path(framework) / "interface.toml"; }
    std::filesystem::path include_folder() const { return std::filesystem::path(framework) / "include"; }
};

struct LoadedScene {
    Manifest manifest;
    Scene scene;
    Features features;
    std::vector<Mesh> meshes;  ///< one per object
};

/// Moves the picture by "X,Y" pixels right and up.
void set_shift(Scene& scene, const std::string& text) {
    glm::dvec2 pixels;
    char rest;
    if (std::sscanf(text.c_str(), "%lf,%lf%c", &pixels.x, &pixels.y, &rest) != 2)
        throw InputError("--shift: give X,Y in pixels, for example 0.0625,0, not \"" + text + "\"");
    scene.camera.shift = 2.0 * pixels / glm::dvec2(scene.film.width, scene.film.height);
}

LoadedScene load(const Options& options, bool with_meshes = true) {
    LoadedScene loaded;
    loaded.manifest = load_manifest(options.assignment, options.interface());
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

std::string json_number(double value) {
    // JSON has no NaN or infinity; they travel as strings, which Python's float() takes.
    char text[40];
    std::snprintf(text, sizeof text, std::isfinite(value) ? "%.17g" : "\"%g\"", value);
    return text;
}

std::string json_vector(glm::dvec3 v) {
    return "[" + json_number(v.x) + ", " + json_number(v.y) + ", " + json_number(v.z) + "]";
}

/// repeats: seconds of further frames, if any.
void write_statistics(const DrawStatistics& s, const LoadedScene& loaded, const std::vector<double>& repeats,
                      const std::string& file) {
    std::ofstream out(file);
    int dropped = 0, cancelled = 0;
    for (const Mesh& mesh : loaded.meshes) {
        dropped += mesh.dropped_triangles;
        cancelled += mesh.cancelled_normals;
    }
    out << "{\"triangles\": " << s.triangles << ", \"clipped_triangles\": " << s.clipped_triangles
        << ", \"dropped_triangles\": " << dropped << ", \"cancelled_vertex_normals\": " << cancelled
        << ", \"not_finite_vertices\": " << s.not_finite_vertices << ", \"fragments\": " << s.fragments
        << ", \"fallback_normals\": " << s.fallback_normals << ", \"lights_at_surface\": " << s.lights_at_surface
        << ", \"milliseconds\": {\"vertices\": " << s.vertex_ms << ", \"bins\": " << s.bin_ms
        << ", \"tiles\": " << s.tile_ms << "}, \"not_finite_fragments\": " << s.not_finite_fragments
        << ", \"repeats\": [";
    for (size_t i = 0; i < repeats.size(); ++i) out << (i ? ", " : "") << repeats[i];
    out << "]";
    if (s.first_not_finite) {
        const NotFinite& f = *s.first_not_finite;
        out << ", \"first_not_finite\": {\"x\": " << f.x << ", \"y\": " << f.y << ", \"material\": \"" << f.material
            << "\", \"model\": \"" << f.model << "\", \"n\": " << json_vector(f.n)
            << ", \"position\": " << json_vector(f.position) << ", \"v\": " << json_vector(f.v)
            << ", \"value\": " << json_vector(f.value) << "}";
    }
    out << "}\n";
    if (!out) throw InfrastructureError(file + ": cannot be written");
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

template <class Real>
bool has_loop(const plugin::Table<Real>& table, const std::string& loop) {
    const char* kinds[] = {"point", "directional", "spot"};
    for (int k = 0; k < table.model_count; ++k)
        for (int kind = 0; kind < plugin::light_kinds; ++kind)
            if (loop == std::string(table.models[k].name) + "_" + kinds[kind])
                return table.models[k].shade[kind] != nullptr;
    return false;
}

template <class Real>
const plugin::Table<Real>& checked_table(const Options& options, const LoadedScene& loaded,
                                         const PluginLibrary& library) {
    const plugin::Table<Real>& table = library.table<Real>();
    for (const Material& material : loaded.scene.materials) {
        bool found = false;
        for (int k = 0; k < table.model_count; ++k) found |= material.model == table.models[k].name;
        if (!found)
            throw InfrastructureError(options.plugin + ": the plugin does not hold the model " + material.model +
                                      "; build it again");
    }
    for (const std::string& loop : loaded.features.loops)
        if (!has_loop(table, loop))
            throw InfrastructureError(options.plugin + ": the plugin was built without " + loop);
    if (loaded.features.term_layers && !table.terms)
        throw InfrastructureError(options.plugin + ": the plugin was built without terms");
    return table;
}

Film empty_film(const Options& options, const LoadedScene& loaded) {
    const FilmSettings& film = loaded.scene.film;
    return Film(film.width * options.supersample, film.height * options.supersample, loaded.features, film.background,
                film.samples);
}

void write_image(const Options& options, Film& image, const std::string& file) {
    if (!options.layers && !options.depth && !options.visibility)
        image.layers.resize(options.terms ? 5 : 1);  // --full computes more than it is asked to write
    write_film(options.supersample > 1 ? image.downsampled(options.supersample) : image, file, options.exposure);
}

double now_ms() {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// What an omission saves: the scene drawn in turn with it and without, and the difference of the shortest times. `full`: a plugin that holds
/// every loop and the terms, for what the scene's own plugin was compiled without.
template <class Real>
std::string saved_by(const Options& options, const LoadedScene& loaded, const plugin::Table<Real>& lean,
                     const plugin::Table<Real>* full, const Decision& decision) {
    constexpr int turns = 11;
    if (decision.name.empty()) return "";
    Request request = options.request();
    request.keep = decision.name;
    const Features kept = Features::of(loaded.scene, request, &loaded.manifest);
    bool as_it_is = kept.term_layers <= bool(lean.terms);
    for (const std::string& loop : kept.loops) as_it_is &= has_loop(lean, loop);
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

template <class Real>
void draw_image(const Options& options, const LoadedScene& loaded, const PluginLibrary& library) {
    const plugin::Table<Real>& table = checked_table<Real>(options, loaded, library);
    if (options.explain) {
        std::optional<PluginLibrary> full;
        if (!options.full_plugin.empty()) full.emplace(options.full_plugin);
        explain(loaded.features, [&](const Decision& decision) {
            return saved_by<Real>(options, loaded, table, full ? &full->table<Real>() : nullptr, decision);
        });
    }
    Film image = empty_film(options, loaded);
    const DrawStatistics statistics =
        draw<Real>(loaded.scene, loaded.features, loaded.meshes, checked_table<Real>(options, loaded, library), image);
    report(statistics);
    std::vector<double> repeats;  // the image has warmed caches and clock
    if (options.repeat) {
        Workspace workspace;
        Film again = empty_film(options, loaded);
        for (int turn = 0; turn < options.repeat; ++turn) {
            const double start = now_ms();
            draw<Real>(loaded.scene, loaded.features, loaded.meshes, table, again, &workspace);
            repeats.push_back((now_ms() - start) / 1000);
        }
    }
    if (!options.statistics.empty()) write_statistics(statistics, loaded, repeats, options.statistics);
    if (!options.output.empty()) write_image(options, image, options.output);
}

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

std::string json_strings(const std::vector<std::string>& texts) {
    std::string out;
    for (const std::string& text : texts) {
        out += out.empty() ? "\"" : ", \"";
        for (const char c : text) out += c == '"' || c == '\\' ? std::string("\\") + c : std::string(1, c);
        out += "\"";
    }
    return "[" + out + "]";
}

void print_needs(const LoadedScene& loaded) {
    const Features& features = loaded.features;
    std::vector<std::string> names;
    for (const Decision& decision : features.decisions)
        if (!decision.needed) names.push_back(decision.name);
    std::cout << "{\"terms\": " << (features.term_layers ? "true" : "false")
              << ", \"loops\": " << json_strings(features.loops)
              << ", \"needed\": " << json_strings(features.lines(true))
              << ", \"left_out\": " << json_strings(features.lines(false)) << ", \"names\": " << json_strings(names)
              << "}\n";
}

/// Answers the lines of stdin, one JSON line each, until they end: draw, write FILE, shift X,Y, threads N, arithmetic. For
/// benchmarks and studies.
template <class Real>
void serve_frames(const Options& options, LoadedScene& loaded, const plugin::Table<Real>& table, double load_ms) {
    malloc_trim(0);
    std::ofstream("/proc/self/clear_refs") << 5;  // the peak of memory from here on: loading is not part of a frame
    Film image = empty_film(options, loaded);
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
    std::cout << "{\"ready\": true, \"load_ms\": " << load_ms << ", \"geometry_bytes\": " << geometry
              << ", \"framebuffer_bytes\": " << framebuffers << ", \"memory_bytes\": " << resident() << "}"
              << std::endl;
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string command, argument;
        words >> command;
        std::getline(words >> std::ws, argument);
        if (command == "draw") {
            const double start = now_ms();
            const DrawStatistics s = draw<Real>(loaded.scene, loaded.features, loaded.meshes, table, image, &workspace);
            std::cout << "{\"ms\": " << now_ms() - start << ", \"vertices\": " << s.vertex_ms
                      << ", \"bins\": " << s.bin_ms << ", \"tiles\": " << s.tile_ms
                      << ", \"fragments\": " << s.fragments << ", \"memory_bytes\": " << resident() << "}" << std::endl;
        } else if (command == "write") {
            Film copy = image;
            write_image(options, copy, argument);
            std::cout << "{\"written\": \"" << argument << "\"}" << std::endl;
        } else if (command == "shift") {
            set_shift(loaded.scene, argument);
            std::cout << "{\"shift\": \"" << argument << "\"}" << std::endl;
        } else if (command == "threads") {
            omp_set_num_threads(std::max(1, std::atoi(argument.c_str())));
            std::cout << "{\"threads\": " << omp_get_max_threads() << "}" << std::endl;
        } else if (command == "arithmetic") {
            std::cout << "{\"ms\": " << arithmetic_ms() << "}" << std::endl;
        } else {
            throw InputError("frames: unknown command \"" + line +
                             "\": draw, write FILE, shift X,Y, threads N or arithmetic");
        }
    }
}

/// Reads what write_film wrote as .npy (height x width x channels, float32): the way back for images of an OpenGL client.
Film read_npy(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    std::string header(10, ' ');
    in.read(header.data(), 10);
    header.resize(10 + (uint8_t(header[8]) | uint8_t(header[9]) << 8));
    in.read(header.data() + 10, std::streamsize(header.size() - 10));
    int height = 0, width = 0, channels = 0;
    const size_t shape = header.find("'shape': (");
    if (!in || shape == std::string::npos || header.find("'<f4'") == std::string::npos ||
        std::sscanf(header.c_str() + shape, "'shape': (%d, %d, %d)", &height, &width, &channels) != 3)
        throw InputError(file + ": is not an image as .npy (height x width x channels, float32)");
    Features features;
    features.term_layers = channels > 3;
    features.geometry_layers = channels > 13;
    Film film(width, height, features, glm::dvec3(0));
    if (film.channel_count() != channels)
        throw InputError(file + ": has " + std::to_string(channels) + " channels, not 3 or all layers");
    for (size_t i = 0; i < size_t(width) * height; ++i)
        for (Layer& layer : film.layers)
            in.read(reinterpret_cast<char*>(layer.pixel(i)), std::streamsize(sizeof(float) * layer.channels));
    if (!in) throw InputError(file + ": ends before its last pixel");
    return film;
}

std::vector<char> read_bytes(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file + ": cannot be read");
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Answers the calls of a plugin that is followed (plugin.hpp) from recorded outputs, and collects what is not recorded.
/// Arguments count as equal when they are the same float32 numbers: that is how they were recorded.
template <class Real>
struct Followed {
    struct Record {
        std::map<std::vector<float>, std::vector<Real>> known;
        std::map<std::vector<float>, int64_t> missing;  ///< arguments, and the order in which they came
    };
    static inline std::map<int, Record> records;  ///< by the function's index in the plugin's table
    static inline const plugin::Table<Real>* table;

    static bool answer(int index, const Real* in, Real* out) {
        const auto record = records.find(index);
        if (record == records.end()) return false;
        std::vector<float> key(in, in + table->functions[index].columns_in);
        for (float& value : key) value += 0.0f;  // -0 and 0 are the same argument
        const auto found = record->second.known.find(key);
        if (found == record->second.known.end()) {
            record->second.missing.try_emplace(std::move(key), int64_t(record->second.missing.size()));
            return false;
        }
        std::copy(found->second.begin(), found->second.end(), out);
        return true;
    }
};

/// FOLDER/FUNCTION.known for each function that is to be followed: rows of Real, arguments and then results; may be empty.
template <class Real>
void start_following(const std::string& folder, const PluginLibrary& library) {
    using F = Followed<Real>;
    F::table = &library.table<Real>();
    for (int k = 0; k < F::table->function_count; ++k) {
        const plugin::Function<Real>& function = F::table->functions[k];
        const std::string file = folder + "/" + function.name + ".known";
        if (!std::filesystem::exists(file)) continue;
        auto& record = F::records[k];
        const std::vector<char> bytes = read_bytes(file);
        const size_t width = size_t(function.columns_in + function.columns_out);
        const Real* row = reinterpret_cast<const Real*>(bytes.data());
        for (size_t left = bytes.size() / (width * sizeof(Real)); left > 0; --left, row += width) {
            std::vector<float> key(row, row + function.columns_in);
            for (float& value : key) value += 0.0f;
            record.known.try_emplace(std::move(key), row + function.columns_in, row + width);
        }
    }
    library.follow<Real>(F::answer);
}

/// FOLDER/FUNCTION.missing: the float32 arguments of the calls that no record answered, each once, in the order of the calls.
template <class Real>
void write_missing(const std::string& folder) {
    for (const auto& [index, record] : Followed<Real>::records) {
        const plugin::Function<Real>& function = Followed<Real>::table->functions[index];
        std::vector<float> rows(record.missing.size() * size_t(function.columns_in));
        for (const auto& [arguments, place] : record.missing)
            std::copy(arguments.begin(), arguments.end(), rows.begin() + place * function.columns_in);
        const std::string file = folder + "/" + function.name + ".missing";
        std::ofstream out(file, std::ios::binary);
        out.write(reinterpret_cast<const char*>(rows.data()), std::streamsize(rows.size() * sizeof(float)));
        out.close();
        if (!out) throw InfrastructureError(file + ": cannot be written");
    }
}

template <class Real>
void evaluate(const Options& options, const PluginLibrary& library) {
    if (!options.follow.empty()) start_following<Real>(options.follow, library);
    const plugin::Table<Real>& table = library.table<Real>();
    const plugin::Function<Real>* function = nullptr;
    for (int k = 0; k < table.function_count; ++k)
        if (options.function == table.functions[k].name) function = &table.functions[k];
    if (!function) throw InputError("the plugin has no function " + options.function);
    std::ifstream in(options.input, std::ios::binary | std::ios::ate);
    if (!in) throw InputError(options.input + ": cannot be read");
    const size_t row_bytes = sizeof(Real) * size_t(function->columns_in), bytes = size_t(in.tellg());
    if (bytes % row_bytes != 0)
        throw InputError(options.input + ": holds no whole number of rows of " + std::to_string(function->columns_in) +
                         " columns");
    const int64_t count = int64_t(bytes / row_bytes);
    std::vector<Real> rows(size_t(count) * function->columns_in), results(size_t(count) * function -> columns_out);
    in.seekg(0);
    in.read(reinterpret_cast<char*>(rows.data()), std::streamsize(bytes));
    function->evaluate(count, rows.data(), results.data());
    if (options.repeat && !options.statistics.empty()) {  // what came so far has warmed caches and clock
        std::ofstream statistics(options.statistics);
        statistics << "{\"rows\": " << count << ", \"seconds\": [";
        for (int turn = 0; turn < options.repeat; ++turn) {
            const double start = now_ms();
            function->evaluate(count, rows.data(), results.data());
            statistics << (turn ? ", " : "") << (now_ms() - start) / 1000;
        }
        statistics << "]}\n";
        if (!statistics) throw InfrastructureError(options.statistics + ": cannot be written");
    }
    if (!options.follow.empty()) write_missing<Real>(options.follow);
    std::ofstream out(options.output, std::ios::binary);
    out.write(reinterpret_cast<const char*>(results.data()), std::streamsize(results.size() * sizeof(Real)));
    out.close();
    if (!out) throw InfrastructureError(options.output + ": cannot be written");
}

}  // namespace

int main(int argc, char** argv) {
    Options options;
    CLI::App app{
        "Draws scenes, writes frame packets and glue, and evaluates shading functions. ./shadelab is the comfortable "
        "way in."};
    app.require_subcommand(1);
    app.add_option("--framework", options.framework, "the framework's folder (interface.toml, include/)");

    const auto add_scene_options = [&](CLI::App* command) {
        command->add_option("scene", options.scene, "scene file (TOML)")->required();
        command
            ->add_option("--assignment", options.assignment, "folder of the assignment.toml that declares the models")
            ->required();
        command->add_option("--size", options.size, "WIDTHxHEIGHT instead of the film's");
        command->add_option("--shift", options.shift, "X,Y: the picture moves so many pixels right and up");
        command->add_option("--samples", options.samples, "coverage samples per pixel instead of the film's")
            ->check(CLI::IsMember({1, 2, 4, 8, 16, 64}));
        command->add_option("--supersample", options.supersample, "draw N times larger and average N x N pixels")
            ->check(CLI::Range(1, 64));
        command->add_flag("--layers", options.layers, "all layers: terms and geometry beside the total");
        command->add_flag("--terms", options.terms,
                          "the layers of the terms only: ambient, diffuse, specular, coverage");
        command->add_flag("--depth", options.depth,
                          "nothing but the depth of each pixel's first sample; nothing is shaded");
        command->add_flag("--visibility", options.visibility,
                          "nothing but which triangle each sample sees, and its depth; nothing is shaded");
        command->add_flag("--full", options.full, "leave nothing out");
        command->add_option("--keep", options.keep, "keep this one omission, as --explain names it (for measurements)");
        command->add_flag("--explain", options.explain, "print what the scene needs and what is left out");
    };
    CLI::App* image = app.add_subcommand("image", "draw a scene with a plugin");
    add_scene_options(image);
    image->add_option("--plugin", options.plugin, "plugin built from a student's shading.cpp")->required();
    image->add_option("-o,--output", options.output, "FILE.png, .exr or .npy");
    image->add_option("--exposure", options.exposure, "PNG only: times 2^EXPOSURE");
    image->add_option("--threads", options.threads, "number of threads (default: all cores)")
        ->check(CLI::Range(1, 1024));
    image->add_option("--statistics", options.statistics, "write counts and times as JSON");
    image->add_option("--repeat", options.repeat, "draw so many further frames, for --statistics")
        ->check(CLI::Range(0, 1000));
    image->add_option("--full-plugin", options.full_plugin,
                      "with --explain: a plugin that leaves nothing out, to measure with");
    CLI::App* needs = app.add_subcommand(
        "needs", "print as JSON what a scene's plugin must hold; with --explain all that is needed and left out");
    add_scene_options(needs);
    CLI::App* frames = app.add_subcommand("frames", "draw a scene as often as stdin asks, for benchmarks");
    add_scene_options(frames);
    frames->add_option("--plugin", options.plugin, "plugin; not needed with --depth");
    frames->add_flag("--double", options.double_depth, "with --depth: in double; otherwise the plugin decides");
    frames->add_option("--threads", options.threads, "number of threads (default: all cores)")
        ->check(CLI::Range(1, 1024));
    CLI::App* convert = app.add_subcommand("convert", "write an image that is an .npy file as .png or .exr");
    convert->add_option("input", options.input, "image (.npy)")->required();
    convert->add_option("-o,--output", options.output, "FILE.png, .exr or .npy")->required();
    convert->add_option("--exposure", options.exposure, "PNG only: times 2^EXPOSURE");
    CLI::App* packet = app.add_subcommand("packet", "write the frame packet of a scene for an OpenGL client");
    add_scene_options(packet);
    packet->add_option("-o,--output", options.output, "packet file")->required();
    CLI::App* glue = app.add_subcommand("glue", "write the generated code of an assignment");
    glue->add_option("assignment", options.assignment, "folder of the assignment.toml")->required();
    glue->add_option("output", options.output, "folder to write to")->required();
    CLI::App* evaluation = app.add_subcommand("evaluate", "evaluate one function over rows of raw numbers");
    evaluation->add_option("plugin", options.plugin, "plugin")->required();
    evaluation->add_option("function", options.function, "function")->required();
    evaluation->add_option("input", options.input, "rows: float32 (float64 for a double plugin), columns as declared")
        ->required();
    evaluation->add_option("output", options.output, "result rows, the same type")->required();
    evaluation->add_option("--follow", options.follow,
                           "folder of FUNCTION.known: recorded outputs that stand in for those functions when the "
                           "evaluated one calls them; FUNCTION.missing is written there");
    evaluation->add_option("--repeat", options.repeat, "evaluate all rows so many times more, for --statistics")
        ->check(CLI::Range(1, 1000000));
    evaluation->add_option("--statistics", options.statistics, "with --repeat: write each repeat's seconds as JSON");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        if (error.get_exit_code() == 0) return app.exit(error);  // --help
        std::cerr << error.what() << "\n";
        return 2;
    }

    if (options.threads) omp_set_num_threads(options.threads);
    try {
        if (*glue) {
            write_glue(load_manifest(options.assignment, options.interface()), options.include_folder(),
                       options.output);
        } else if (*convert) {
            write_film(read_npy(options.input), options.output, options.exposure);
        } else if (*evaluation) {
            const PluginLibrary library(options.plugin);
            library.is_double() ? evaluate<double>(options, library) : evaluate<float>(options, library);
        } else {
            const double start = now_ms();
            LoadedScene loaded = load(options, !*needs || options.explain);
            const double load_ms = now_ms() - start;
            if (*needs) {
                print_needs(loaded);
            } else if (*packet) {
                write_packet(loaded.scene, loaded.manifest, loaded.features, loaded.meshes, options.supersample,
                             options.include_folder(), options.output);
            } else if (*frames && (options.depth || options.visibility)) {
                options.double_depth ? serve_frames<double>(options, loaded, {}, load_ms)
                                     : serve_frames<float>(options, loaded, {}, load_ms);
            } else if (*frames) {
                const PluginLibrary library(options.plugin);
                library.is_double()
                    ? serve_frames(options, loaded, checked_table<double>(options, loaded, library), load_ms)
                    : serve_frames(options, loaded, checked_table<float>(options, loaded, library), load_ms);
            } else {
                const PluginLibrary library(options.plugin);
                library.is_double() ? draw_image<double>(options, loaded, library)
                                    : draw_image<float>(options, loaded, library);
            }
        }
    } catch (const InputError& error) {
        std::cerr << error.what() << "\n";
        return 2;
    } catch (const std::bad_alloc&) {
        std::cerr << "out of memory\n";
        return 3;
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 3;
    }
    return 0;
}
