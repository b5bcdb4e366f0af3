#include <shadelab/describe.hpp>

#include "text/json.hpp"

#include <algorithm>

namespace shadelab {

namespace {

toml::table domain_table(const Domain& domain, const std::string& type) {
    toml::table out{
        {"kind", domain.kind}, {"type", type}, {"opposite", domain.opposite}, {"scale", domain.log ? "log" : "linear"}};
    if (!domain.base.empty()) out.insert("base", domain.base);
    if (domain.range) out.insert("range", json::array(domain.range->data(), 2));
    if (domain.typical) out.insert("typical", json::array(domain.typical->data(), 2));
    return out;
}

toml::array values_array(const std::vector<Value>& values) {
    toml::array out;
    for (const Value& value : values)
        out.push_back(toml::table{{"name", value.name}, {"domain", domain_table(value.domain, value.type)}});
    return out;
}

toml::array columns_array(const std::vector<Column>& columns) {
    toml::array out;
    for (const Column& column : columns)
        out.push_back(toml::table{{"path", column.path},
                                  {"index", column.index},
                                  {"width", column.width},
                                  {"domain", domain_table(column.domain, column.type)}});
    return out;
}

toml::array gates_array(const std::vector<Gate>& gates) {
    toml::array out;
    for (const Gate& gate : gates) {
        toml::table entry;
        for (const auto& [path, value] : gate) {
            if (const auto* number = std::get_if<double>(&value)) entry.insert(path, *number);
            if (const auto* numbers = std::get_if<std::vector<double>>(&value))
                entry.insert(path, json::array(*numbers));
            if (const auto* other = std::get_if<std::string>(&value)) entry.insert(path, *other);
        }
        out.push_back(entry);
    }
    return out;
}

}  // namespace

std::string describe(const Manifest& manifest) {
    toml::array given, models, structs, functions, scenes;
    for (const Manifest& earlier : manifest.given) given.push_back(earlier.name);
    for (const Function& model : manifest.models()) models.push_back(model.name);
    for (const Struct& s : manifest.structs)
        structs.push_back(toml::table{{"name", s.name},
                                      {"members", values_array(s.members)},
                                      {"columns", columns_array(manifest.columns(s.members))}});
    for (const Function& function : manifest.functions)
        functions.push_back(toml::table{{"name", function.name},
                                        {"summary", function.summary},
                                        {"slide", function.slide},
                                        {"points", function.points},
                                        {"returns", function.returns},
                                        {"model", function.is_model()},
                                        {"arguments", values_array(function.arguments)},
                                        {"inputs", columns_array(manifest.columns(function.arguments))},
                                        {"outputs", columns_array(manifest.result_columns(function))},
                                        {"gates", gates_array(function.gates)}});
    for (const SceneEntry& scene : manifest.scenes)
        scenes.push_back(
            toml::table{{"name", scene.file.stem().string()}, {"file", scene.file.string()}, {"points", scene.points}});
    toml::array fragment, lights;
    for (const FragmentAttribute& attribute : manifest.interface.fragment)
        fragment.push_back(toml::table{{"name", attribute.name},
                                       {"domain", domain_table(attribute.value.domain, attribute.value.type)},
                                       {"from", attribute.source}});
    for (const LightKind& kind : manifest.interface.lights)
        lights.push_back(toml::table{{"kind", kind.name}, {"members", json::array(kind.members)}});
    return json::text(toml::table{
        {"schema", "shadelab/assignment/2"},
        {"light_function", manifest.interface.light_function},
        {"fragment", fragment},
        {"lights", lights},
        {"name", manifest.name},
        {"title", manifest.title},
        {"directory", std::filesystem::weakly_canonical(std::filesystem::absolute(manifest.directory)).string()},
        {"files", json::array(manifest.files)},
        {"given", given},
        {"models", models},
        {"structs", structs},
        {"functions", functions},
        {"scenes", scenes}});
}

namespace {

/// The manifests that were read: the assignment's, and those of given ones.
void add_manifests(const Manifest& manifest, toml::array& out) {
    out.push_back(std::filesystem::absolute(manifest.directory / "assignment.toml").lexically_normal().string());
    for (const Manifest& earlier : manifest.given) add_manifests(earlier, out);
}

}  // namespace

std::string describe(const Scene& scene, const Manifest& manifest, const Features& features) {
    toml::array lights, materials, objects, calls, manifests;
    add_manifests(manifest, manifests);
    for (const Light& light : scene.lights)
        lights.push_back(toml::table{{"kind", scene.light_kinds[size_t(light.kind)]},
                                     {"entry", light.entry},
                                     {"columns", json::array(light.flatten())}});
    std::vector<std::string> called;
    for (const Material& material : scene.materials) {
        materials.push_back(toml::table{
            {"name", material.name}, {"model", material.model}, {"parameters", json::array(material.parameters)}});
        called.push_back(material.model);
    }
    called.push_back(manifest.interface.light_function);
    for (size_t i = 0; i < called.size(); ++i)
        if (std::find(called.begin(), called.begin() + long(i), called[i]) == called.begin() + long(i))
            calls.push_back(called[i]);
    const char* normals[] = {"smooth", "flat", "file"};
    for (const Object& object : scene.objects) {
        const Material& material = scene.materials[size_t(object.material)];
        objects.push_back(
            toml::table{{"mesh", std::filesystem::absolute(object.mesh).lexically_normal().string()},
                        {"material", material.name},
                        {"model", material.model},
                        {"normals", normals[int(object.normals)]},
                        {"interpolation", object.interpolation == Interpolation::gouraud ? "gouraud" : "phong"},
                        {"to_world", json::columns(object.to_world)}});
    }
    std::vector<std::string> left_out_names;
    for (const Decision& decision : features.decisions)
        if (!decision.needed) left_out_names.push_back(decision.name);
    const Camera& camera = scene.camera;
    const FilmSettings& film = scene.film;
    return json::text(toml::table{
        {"schema", "shadelab/scene/2"},
        {"film", toml::table{{"width", film.width},
                             {"height", film.height},
                             {"samples", film.samples},
                             {"background", json::array(film.background)}}},
        {"camera",
         toml::table{{"eye", json::array(camera.eye)},
                     {"target", json::array(camera.target)},
                     {"up", json::array(camera.up)},
                     {"fov_y", camera.fov_y},
                     {"near", camera.near},
                     {"far", camera.far},
                     {"world_to_clip", json::columns(camera.world_to_clip(double(film.width) / film.height))}}},
        {"origin", json::array(scene.origin)},
        {"lights", lights},
        {"materials", materials},
        {"objects", objects},
        {"calls", calls},
        {"manifests", manifests},
        {"needs", toml::table{{"terms", features.term_layers},
                              {"loops", json::array(features.loops)},
                              {"needed", json::array(features.lines(true))},
                              {"left_out", json::array(features.lines(false))},
                              {"names", json::array(left_out_names)}}}});
}

}  // namespace shadelab
