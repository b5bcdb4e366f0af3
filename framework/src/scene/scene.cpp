#include <shadelab/scene.hpp>

#include "text/toml_reader.hpp"

#include <glm/gtc/matrix_transform.hpp>

#include <algorithm>
#include <optional>
#include <set>

namespace shadelab {

namespace {

constexpr double largest = 1e30;  // coordinates and intensities must survive float32

FilmSettings read_film(TomlReader reader) {
    FilmSettings film;
    film.width = reader.integer("width", film.width, 1, 16384);
    film.height = reader.integer("height", film.height, 1, 16384);
    film.samples = reader.integer("samples", film.samples, 1, 64);
    if ((film.samples & (film.samples - 1)) != 0 || film.samples == 32)
        reader.fail("samples", "must be 1, 2, 4, 8, 16 or 64");
    film.background = reader.vec3("background", film.background, Range{0, largest});
    reader.finish();
    return film;
}

Camera read_camera(TomlReader reader) {
    Camera camera;
    camera.eye = reader.vec3("eye", Range{-largest, largest});
    camera.target = reader.vec3("target", Range{-largest, largest});
    camera.up = reader.vec3("up", glm::dvec3(0, 1, 0), Range{-largest, largest});
    camera.fov_y = glm::radians(reader.number("fov_y", 40, Range{1e-3, 179}));
    camera.near = reader.number("near", Range{0, largest, true});
    camera.far = reader.number("far", Range{0, largest, true});
    if (camera.far <= camera.near) reader.fail("far", "must lie beyond near");
    const glm::dvec3 forward = camera.target - camera.eye;
    if (glm::length(forward) == 0) reader.fail("target", "must differ from eye");
    const double sine = glm::length(glm::cross(glm::normalize(forward), camera.up)) / glm::length(camera.up);
    if (!(sine > 1e-9)) reader.fail("up", "must not be zero or point along the view direction");
    reader.finish();
    return camera;
}

glm::dvec3 read_direction(TomlReader& reader, const std::string& key) {
    const glm::dvec3 direction = reader.vec3(key, Range{-largest, largest});
    if (glm::length(direction) == 0) reader.fail(key, "must not be zero");
    return glm::normalize(direction);
}

/// Adds the lights of one entry of the file: one, or a grid of equal ones that starts at its position.
void read_light(TomlReader reader, int entry, const Interface& interface, std::vector<Light>& lights) {
    Light light;
    light.entry = entry;
    std::vector<std::string> kinds;
    for (const LightKind& kind : interface.lights) kinds.push_back(kind.name);
    const std::string name = reader.choice("kind", "", kinds);
    light.kind = int(std::find(kinds.begin(), kinds.end(), name) - kinds.begin());
    const LightKind& kind = interface.lights[size_t(light.kind)];
    light.placed = kind.has("position");
    light.intensity = reader.vec3("intensity", Range{0, largest});
    if (light.placed) light.position = reader.vec3("position", Range{-largest, largest});
    if (kind.has("attenuation")) {
        light.attenuation = reader.vec3("attenuation", light.attenuation, Range{0, largest});
        if (light.attenuation == glm::dvec3(0))
            reader.fail("attenuation", "must not be all zero: the light would be infinite");
    }
    if (kind.has("direction")) light.direction = read_direction(reader, "direction");
    if (kind.has("falloff")) {
        light.falloff = glm::radians(reader.number("falloff", Range{0, 90, true}));
        light.hotspot = glm::radians(reader.number("hotspot", Range{0, 90}));
        if (light.hotspot > light.falloff) reader.fail("hotspot", "must not be wider than falloff");
    }
    int columns = 1, rows = 1;
    glm::dvec3 across(0), up(0);
    if (light.placed)
        if (auto grid = reader.optional_child("grid")) {
            columns = grid->integer("columns", 1, 1, 1000);
            rows = grid->integer("rows", 1, 1, 1000);
            across = grid->vec3("across", across, Range{-largest, largest});
            up = grid->vec3("up", up, Range{-largest, largest});
            grid->finish();
            light.grid = true;
        }
    reader.finish();
    const glm::dvec3 first = light.position;
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < columns; ++column) {
            light.position = first + double(column) * across + double(row) * up;
            lights.push_back(light);
        }
}

Material read_material(const std::string& name, TomlReader reader, const Manifest& manifest) {
    Material material;
    material.name = name;
    std::vector<std::string> models;
    for (const Function& model : manifest.models()) models.push_back(model.name);
    material.model = reader.choice("model", "", models);
    const Function& function = *manifest.find_model(material.model);
    for (const Value& member : manifest.find_struct(function.arguments[0].type)->members) {
        const int count = manifest.columns(member.type);
        if (const toml::node* node = reader.find(member.name); node && node->is_table())
            reader.fail(member.name, "is a constant in this assignment, it takes no texture");
        const Range range{member.min, member.max};
        if (count == 1) {
            material.parameters.push_back(reader.number(member.name, range));
        } else {
            const std::vector<double> values = reader.numbers(member.name, count, range);
            material.parameters.insert(material.parameters.end(), values.begin(), values.end());
        }
    }
    for (const Column& column : manifest.columns({function.arguments[0]})) material.columns.push_back(column.name());
    reader.finish();
    return material;
}

Object read_object(TomlReader reader, const std::filesystem::path& folder, const std::vector<Material>& materials) {
    Object object;
    object.mesh = (folder / reader.string("mesh")).lexically_normal();
    object.mesh_where = reader.where("mesh");

    std::vector<std::string> names;
    for (const Material& material : materials) names.push_back(material.name);
    const std::string material = reader.string("material");
    const auto found = std::find(names.begin(), names.end(), material);
    if (found == names.end())
        reader.fail("material", "no [material." + material + "] in this file; there is " +
                                    (names.empty() ? "none" : list_of(names)));
    object.material = int(found - names.begin());

    const std::vector<std::string> normals = {"smooth", "flat", "file"}, interpolations = {"phong", "gouraud"};
    const std::string normal_mode = reader.choice("normals", "smooth", normals);
    object.normals = Normals(std::find(normals.begin(), normals.end(), normal_mode) - normals.begin());
    const std::string interpolation = reader.choice("interpolation", "phong", interpolations);
    object.interpolation = interpolation == "phong" ? Interpolation::phong : Interpolation::gouraud;

    object.to_world = glm::translate(glm::dmat4(1), reader.vec3("translate", glm::dvec3(0), Range{-largest, largest}));
    if (auto rotate = reader.optional_child("rotate")) {
        const glm::dvec3 axis = read_direction(*rotate, "axis");
        object.to_world = glm::rotate(object.to_world, glm::radians(rotate->number("degrees", Range{-1e6, 1e6})), axis);
        rotate->finish();
    }
    if (const toml::node* scale = reader.find("scale")) {
        const glm::dvec3 factors = scale->is_array() ? reader.vec3("scale", Range{-largest, largest})
                                                     : glm::dvec3(reader.number("scale", Range{-largest, largest}));
        if (factors.x * factors.y * factors.z == 0) reader.fail("scale", "must not be zero");
        object.to_world = glm::scale(object.to_world, factors);
    }
    reader.finish();
    return object;
}

/// Makes the camera's target the origin of the world of a scene that lies far from it.
void move_near(Scene& scene) {
    // Both renderers hold world positions in float32. Where the camera is this many times farther from 0 than from what it
    // looks at, 10 of the 24 bits would be spent on the place. Scenes that lie nearer keep the numbers of their file.
    constexpr double far_out = 1024;
    const glm::dvec3 eye = scene.camera.eye, target = scene.camera.target;
    if (std::min(glm::length(eye), glm::length(target)) <= far_out * glm::length(eye - target)) return;
    scene.origin = target;
    scene.camera.eye -= target;
    scene.camera.target = glm::dvec3(0);
    for (Light& light : scene.lights)
        if (light.placed) light.position -= target;
    for (Object& object : scene.objects) object.to_world[3] -= glm::dvec4(target, 0);
}

}  // namespace

glm::dmat4 Camera::world_to_clip(double aspect) const {
    const glm::dmat4 moved = glm::translate(glm::dmat4(1), glm::dvec3(shift, 0));
    return moved * glm::perspective(fov_y, aspect, near, far) * glm::lookAt(eye, target, up);
}

std::vector<double> Light::flatten() const {
    return {double(kind),  position.x,    position.y,    position.z,  direction.x,
            direction.y,   direction.z,   intensity.x,   intensity.y, intensity.z,
            attenuation.x, attenuation.y, attenuation.z, hotspot,     falloff};
}

std::vector<std::string> scene_models(const std::filesystem::path& file) {
    const toml::table table = parse_toml(file);
    std::set<std::string> out;
    if (const toml::table* materials = table["material"].as_table())
        for (const auto& [name, material] : *materials)
            if (const auto model =
                    material.is_table() ? (*material.as_table())["model"].value<std::string>() : std::nullopt)
                out.insert(*model);
    return {out.begin(), out.end()};
}

Scene load_scene(const std::filesystem::path& file, const Manifest& manifest) {
    const toml::table table = parse_toml(file);
    TomlReader root(table, file.string(), "");
    Scene scene;
    scene.file = file;
    if (auto film = root.optional_child("film")) scene.film = read_film(*film);
    scene.camera = read_camera(root.child("camera"));
    for (const LightKind& kind : manifest.interface.lights) scene.light_kinds.push_back(kind.name);
    int entry = 0;
    for (TomlReader& reader : root.children("light")) read_light(reader, entry++, manifest.interface, scene.lights);
    for (auto& [name, reader] : root.named_children("material"))
        scene.materials.push_back(read_material(name, reader, manifest));
    for (TomlReader& reader : root.children("object"))
        scene.objects.push_back(read_object(reader, file.parent_path(), scene.materials));
    root.finish();
    move_near(scene);
    return scene;
}

}  // namespace shadelab
