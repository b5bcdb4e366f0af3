#include <shadelab/packet.hpp>

#include <shadelab/glue.hpp>

#include "toml_reader.hpp"

#include <algorithm>
#include <fstream>
#include <map>
#include <sstream>

namespace shadelab {

namespace {

toml::array numbers(const double* values, size_t count) {
    toml::array out;
    // As float32: what the uniforms hold. Nine digits bring the same float back.
    for (size_t i = 0; i < count; ++i) out.push_back(double(float(values[i])));
    return out;
}

toml::array numbers(glm::dvec3 v) { return numbers(&v.x, 3); }

template <class Matrix>
toml::array columns(const Matrix& m) {
    toml::array out;
    for (int c = 0; c < m.length(); ++c)
        for (int r = 0; r < m[c].length(); ++r) out.push_back(double(float(m[c][r])));
    return out;
}

toml::table program_text(const ShaderMains& mains) {
    return toml::table{
        {"vertex", mains.vertex}, {"fragment", mains.fragment}, {"student_in_vertex", mains.student_in_vertex}};
}

}  // namespace

void write_packet(const Scene& scene, const Manifest& manifest, const Features& features,
                  const std::vector<Mesh>& meshes, int supersample, const std::filesystem::path& include_folder,
                  const std::filesystem::path& file) {
    std::ifstream shading_file(include_folder / "shadelab" / "shading.glsl");
    std::ostringstream shading;
    shading << shading_file.rdbuf();

    const int width = scene.film.width * supersample, height = scene.film.height * supersample;
    const glm::dmat4 world_to_clip = scene.camera.world_to_clip(double(width) / height);
    toml::array programs, geometry_programs, draws;
    std::map<std::string, int64_t> known;
    const auto program_index = [&](toml::array& list, const ShaderMains& mains) {
        const auto [entry, fresh] = known.try_emplace(mains.vertex + mains.fragment, int64_t(list.size()));
        if (fresh) list.push_back(program_text(mains));
        return entry->second;
    };

    std::string buffers;
    const auto add_buffer = [&](const auto& values) {
        const toml::table place{{"offset", int64_t(buffers.size())}, {"count", int64_t(values.size())}};
        buffers.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(values[0]));
        return place;
    };

    const std::vector<int> drawn_lights = glsl_lights(scene, features);
    const bool looped = drawn_lights.size() > most_unrolled_lights;
    if (drawn_lights.size() > most_looped_lights)
        throw InputError(scene.file.string() + ": " + std::to_string(drawn_lights.size()) +
                         " lights; OpenGL clients draw at most " + std::to_string(most_looped_lights) +
                         ": use --backend cpp");
    toml::table light_texels;
    glm::dvec3 light_ends(0);
    if (looped) {
        constexpr size_t line = size_t(lights_per_line) * texels_per_light * 4;
        std::vector<float> texels((drawn_lights.size() + lights_per_line - 1) / lights_per_line * line);
        for (size_t l = 0; l < drawn_lights.size(); ++l) {
            const std::vector<double> light = scene.lights[size_t(drawn_lights[l])].flatten();
            std::copy(light.begin() + 1, light.end(), texels.begin() + long(4 * texels_per_light * l));
            for (int kind = int(light[0]); kind < 3; ++kind) light_ends[kind] = double(l + 1);
        }
        light_texels = add_buffer(texels);
        light_texels.insert("width", lights_per_line * texels_per_light);
    }

    for (size_t i = 0; i < scene.objects.size(); ++i) {
        const Object& object = scene.objects[i];
        const Material& material = scene.materials[object.material];
        const Function& model = *manifest.find_model(material.model);
        const glm::dmat3 linear(object.to_world);
        toml::table uniforms;
        uniforms.insert("shadelab_to_clip", columns(world_to_clip * object.to_world));
        uniforms.insert("shadelab_to_world", columns(object.to_world));
        uniforms.insert("shadelab_normal_to_world", columns(glm::transpose(glm::inverse(linear))));
        uniforms.insert("shadelab_orientation", toml::array{glm::determinant(linear) < 0 ? -1.0 : 1.0});
        uniforms.insert("shadelab_eye", numbers(scene.camera.eye));
        uniforms.insert("shadelab_id", toml::array{double(i + 1)});
        size_t at = 0;
        for (const Value& member : manifest.find_struct(model.arguments[0].type)->members) {
            const size_t count = size_t(manifest.columns(member.type));
            uniforms.insert("shadelab_material_" + member.name, numbers(&material.parameters[at], count));
            at += count;
        }
        if (looped) uniforms.insert("shadelab_light_ends", numbers(light_ends));
        for (size_t l = 0; l < (looped ? 0 : drawn_lights.size()); ++l) {
            const std::vector<double> light = scene.lights[size_t(drawn_lights[l])].flatten();
            size_t column = 0;
            for (const Value& member : manifest.find_struct("Light")->members) {
                const size_t count = size_t(manifest.columns(member.type));
                if (member.type != "int")
                    uniforms.insert("shadelab_light" + std::to_string(l) + "_" + member.name,
                                    numbers(&light[column], count));
                column += count;
            }
        }
        const bool can_cancel = features.normal_fallback || normals_can_cancel(meshes[i], object.to_world);
        const ShaderMains mains =
            features.depth_only ? glsl_depth_mains()
                                : glsl_shade_mains(manifest, scene, features, model, object.interpolation, can_cancel);
        toml::table draw{{"program", program_index(programs, mains)}};
        if (features.geometry_layers)
            draw.insert("geometry_program", program_index(geometry_programs, glsl_geometry_mains(can_cancel)));
        draw.insert("positions", add_buffer(meshes[i].positions));
        if (!features.depth_only) draw.insert("normals", add_buffer(meshes[i].normals));
        draw.insert("indices", add_buffer(meshes[i].indices));
        draw.insert("uniforms", uniforms);
        draws.push_back(draw);
    }
    // What the scene says, for whoever has the packet and not the scene file.
    toml::array lights, objects;
    for (const Light& light : scene.lights) {
        const std::vector<double> columns = light.flatten();
        lights.push_back(numbers(columns.data(), columns.size()));
    }
    for (const Object& object : scene.objects) {
        const Material& material = scene.materials[object.material];
        objects.push_back(toml::table{{"model", material.model},
                                      {"material", numbers(material.parameters.data(), material.parameters.size())}});
    }
    const toml::table facts{
        {"eye", numbers(scene.camera.eye)}, {"fov_y", scene.camera.fov_y}, {"lights", lights}, {"objects", objects}};
    toml::table header{{"width", width},
                       {"height", height},
                       {"supersample", supersample},
                       {"samples", scene.film.samples},
                       {"background", numbers(scene.film.background)},
                       {"terms", features.term_layers},
                       {"geometry", features.geometry_layers},
                       {"depth", features.depth_only},
                       {"scene", facts},
                       {"prelude", glsl_prelude(manifest, shading.str())},
                       {"programs", programs},
                       {"geometry_programs", geometry_programs},
                       {"draws", draws},
                       {"lines", toml::table{{"prelude", prelude_first_line}, {"main", main_first_line}}}};
    if (looped) header.insert("light_texels", light_texels);
    std::ostringstream json;
    json << toml::json_formatter(header);
    std::ofstream out(file, std::ios::binary);
    out << "shadelab packet 1\n" << json.str().size() << "\n" << json.str() << buffers;
    out.close();
    if (!out)
        throw InfrastructureError(file.string() + ": cannot be written; is the folder there and the disk not full?");
}

}  // namespace shadelab
