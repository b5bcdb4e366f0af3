#include <shadelab/packet.hpp>

#include <shadelab/glue.hpp>

#include "text/json.hpp"

#include <algorithm>
#include <fstream>
#include <map>

namespace shadelab {

namespace {

/// Uniforms are float32; nine digits bring the same float back.
toml::array floats(const double* values, size_t count) {
    toml::array out;
    for (size_t i = 0; i < count; ++i) out.push_back(double(float(values[i])));
    return out;
}

toml::array floats(glm::dvec3 v) { return floats(&v.x, 3); }

template <class Matrix>
toml::array float_columns(const Matrix& m) {
    toml::array out;
    for (int c = 0; c < m.length(); ++c)
        for (int r = 0; r < m[c].length(); ++r) out.push_back(double(float(m[c][r])));
    return out;
}

/// The buffers, one behind the other.
struct Buffers {
    std::string bytes;

    int64_t add(const void* values, size_t size) {
        const int64_t offset = int64_t(bytes.size());
        bytes.append(static_cast<const char*>(values), size);
        return offset;
    }
    template <class Element>
    toml::table add(const std::vector<Element>& values) {
        return toml::table{{"offset", add(values.data(), values.size() * sizeof(Element))},
                           {"count", int64_t(values.size())}};
    }
    toml::table add(const std::vector<glm::vec3>& values) {
        toml::table place = add<glm::vec3>(values);
        place.insert("components", 3);
        return place;
    }
};

/// The programs, each once.
struct Programs {
    toml::array list;
    std::map<std::string, int64_t> known;

    int64_t add(const ShaderMains& mains) {
        const auto [entry, fresh] = known.try_emplace(mains.vertex + mains.fragment, int64_t(list.size()));
        if (fresh)
            list.push_back(
                toml::table{{"vertex", stage(mains.vertex, mains.student == ShaderMains::vertex_stage)},
                            {"fragment", stage(mains.fragment, mains.student == ShaderMains::fragment_stage)}});
        return entry->second;
    }

    static toml::array stage(const std::string& main, bool with_student) {
        toml::array pieces;
        if (with_student) {
            pieces.push_back(toml::table{{"source", "prelude"}, {"line", prelude_first_line}});
            pieces.push_back(toml::table{{"student", true}, {"line", 1}});
        }
        pieces.push_back(toml::table{{"text", main}, {"line", main_first_line}});
        return pieces;
    }
};

toml::table target(const std::string& layer, glm::dvec4 clear) {
    return toml::table{{"layer", layer}, {"clear", floats(&clear.x, 4)}};
}

/// A layer of the film: which pass draws it, into which components of which target.
toml::table film_layer(const std::string& layer, int channels, int pass, int target, int first,
                       const std::string& reduce) {
    return toml::table{{"layer", layer},   {"channels", channels}, {"pass", pass},
                       {"target", target}, {"first", first},       {"reduce", reduce}};
}

/// The lights, as uniforms of their own or, when there are many, as a texture.
void add_lights(const Scene& scene, const Manifest& manifest, const std::vector<int>& lights, toml::table& uniforms,
                toml::array& textures, Buffers& buffers) {
    if (lights.size() > most_unrolled_lights) {
        constexpr size_t line = size_t(lights_per_line) * texels_per_light * 4;
        const size_t lines = (lights.size() + lights_per_line - 1) / lights_per_line;
        std::vector<float> texels(lines * line);
        std::vector<double> ends(scene.light_kinds.size(), 0);
        for (size_t l = 0; l < lights.size(); ++l) {
            const std::vector<double> light = scene.lights[size_t(lights[l])].flatten();
            std::copy(light.begin() + 1, light.end(), texels.begin() + long(4 * texels_per_light * l));
            for (size_t kind = size_t(light[0]); kind < ends.size(); ++kind) ends[kind] = double(l + 1);
        }
        textures.push_back(toml::table{{"name", "shadelab_lights"},
                                       {"offset", buffers.add(texels.data(), texels.size() * sizeof(float))},
                                       {"width", lights_per_line * texels_per_light},
                                       {"height", int64_t(lines)}});
        for (size_t kind = 0; kind < ends.size(); ++kind)
            uniforms.insert("shadelab_light_end_" + scene.light_kinds[kind], toml::array{ends[kind]});
        return;
    }
    for (size_t l = 0; l < lights.size(); ++l) {
        const std::vector<double> light = scene.lights[size_t(lights[l])].flatten();
        size_t column = 0;
        for (const Value& member : manifest.find_struct("Light")->members) {
            const size_t count = size_t(manifest.columns(member.type));
            if (member.type != "int")  // the kind, which is compiled in
                uniforms.insert("shadelab_light" + std::to_string(l) + "_" + member.name,
                                floats(&light[column], count));
            column += count;
        }
    }
}

toml::table object_table(const Manifest& manifest, const Object& object, const Material& material, const Mesh& mesh,
                         int number, const glm::dmat4& world_to_clip, bool depth_only, Buffers& buffers) {
    const glm::dmat3 linear(object.to_world);
    toml::table uniforms{{"shadelab_to_clip", float_columns(world_to_clip * object.to_world)},
                         {"shadelab_to_world", float_columns(object.to_world)},
                         {"shadelab_normal_to_world", float_columns(glm::transpose(glm::inverse(linear)))},
                         {"shadelab_orientation", toml::array{glm::determinant(linear) < 0 ? -1.0 : 1.0}},
                         {"shadelab_id", toml::array{double(number)}}};
    size_t at = 0;
    for (const Value& member : manifest.find_struct(manifest.find_model(material.model)->arguments[0].type)->members) {
        const size_t count = size_t(manifest.columns(member.type));
        uniforms.insert("shadelab_material_" + member.name, floats(&material.parameters[at], count));
        at += count;
    }
    toml::table attributes{{"shadelab_position", buffers.add(mesh.positions)}};
    if (!depth_only) attributes.insert("shadelab_normal", buffers.add(mesh.normals));
    return toml::table{{"attributes", attributes},
                       {"indices", buffers.add(mesh.indices)},
                       {"uniforms", uniforms},
                       {"to_world", json::columns(object.to_world)}};
}

}  // namespace

Packet make_packet(const Scene& scene, const Manifest& manifest, const Features& features,
                   const std::vector<Mesh>& meshes, int supersample, const std::filesystem::path& framework) {
    const int width = scene.film.width * supersample, height = scene.film.height * supersample;
    const glm::dmat4 world_to_clip = scene.camera.world_to_clip(double(width) / height);
    const std::vector<int> lights = glsl_lights(scene, features);
    if (lights.size() > most_looped_lights)
        throw InputError(scene.file.string() + ": " + std::to_string(lights.size()) +
                         " lights; OpenGL clients draw at most " + std::to_string(most_looped_lights) +
                         ": use --backend cpp");
    Buffers buffers;
    Programs programs;
    toml::array objects, textures, draws, geometry_draws;
    toml::table uniforms{{"shadelab_eye", floats(scene.camera.eye)}};
    add_lights(scene, manifest, lights, uniforms, textures, buffers);
    for (size_t i = 0; i < scene.objects.size(); ++i) {
        const Object& object = scene.objects[i];
        const Material& material = scene.materials[size_t(object.material)];
        const bool can_cancel = features.normal_fallback || normals_can_cancel(meshes[i], object.to_world);
        const ShaderMains mains = features.depth_only ? glsl_depth_mains(framework)
                                                      : glsl_shade_mains(manifest, framework, scene, features,
                                                                         *manifest.find_model(material.model),
                                                                         object.interpolation, can_cancel);
        draws.push_back(toml::table{{"object", int64_t(i)}, {"program", programs.add(mains)}});
        if (features.geometry_layers)
            geometry_draws.push_back(toml::table{
                {"object", int64_t(i)}, {"program", programs.add(glsl_geometry_mains(framework, can_cancel))}});
        objects.push_back(object_table(manifest, object, material, meshes[i], int(i) + 1, world_to_clip,
                                       features.depth_only, buffers));
    }

    toml::array targets, film;
    if (features.depth_only) {
        film.push_back(film_layer("depth", 1, 0, -1, 0, "centre"));
    } else {
        targets.push_back(target("total", glm::dvec4(scene.film.background, 0)));
        film.push_back(film_layer("total", 3, 0, 0, 0, "mean"));
    }
    if (features.term_layers) {
        int number = 1;
        for (const char* layer : {"ambient", "diffuse", "specular"}) {
            targets.push_back(target(layer, glm::dvec4(0)));
            film.push_back(film_layer(layer, 3, 0, number++, 0, "mean"));
        }
        film.push_back(film_layer("coverage", 1, 0, 0, 3, "mean"));
    }
    toml::array passes;
    passes.push_back(toml::table{{"name", features.depth_only ? "depth" : "shading"},
                                 {"samples", scene.film.samples},
                                 {"targets", targets},
                                 {"draws", draws}});
    if (features.geometry_layers) {
        passes.push_back(toml::table{
            {"name", "geometry"},
            {"samples", 1},  // the surface at the pixel's centre
            {"targets", toml::array{target("normal, id", glm::dvec4(0)), target("position, depth", {0, 0, 0, 1})}},
            {"draws", geometry_draws}});
        film.push_back(film_layer("id", 1, 1, 0, 3, "centre"));
        film.push_back(film_layer("depth", 1, 1, 1, 3, "centre"));
        film.push_back(film_layer("normal", 3, 1, 0, 0, "centre"));
        film.push_back(film_layer("position", 3, 1, 1, 0, "centre"));
    }
    const toml::table header{{"width", width},
                             {"height", height},
                             {"supersample", supersample},
                             {"glsl", toml::table{{"version", "330"}, {"precision", ""}}},
                             {"sources", toml::table{{"prelude", glsl_prelude(manifest, framework)}}},
                             {"programs", programs.list},
                             {"textures", textures},
                             {"uniforms", uniforms},
                             {"objects", objects},
                             {"camera", toml::table{{"eye", json::array(scene.camera.eye)},
                                                    {"world_to_clip", json::columns(world_to_clip)}}},
                             {"passes", passes},
                             {"film", film}};
    return {json::text(header), std::move(buffers.bytes)};
}

void write_packet(const Packet& packet, const std::filesystem::path& file) {
    std::ofstream out(file, std::ios::binary);
    out << "shadelab packet 2\n" << packet.header.size() << "\n" << packet.header << packet.buffers;
    out.close();
    if (!out)
        throw InfrastructureError(file.string() + ": cannot be written; is the folder there and the disk not full?");
}

}  // namespace shadelab
