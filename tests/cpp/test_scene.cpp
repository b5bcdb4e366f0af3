// Scene files: what a good one means, and the one line that says what is wrong with another.
#include "support.hpp"

#include <shadelab/error.hpp>
#include <shadelab/mesh.hpp>

#include <glm/gtc/matrix_transform.hpp>

#include <catch2/catch.hpp>

#include <algorithm>

using namespace shadelab;
using namespace shadelab::testing;
using Catch::Matchers::Contains;

namespace {

const Manifest& manifest() {
    static const Manifest loaded =
        load_manifest(SHADELAB_ROOT "/solution/phong", SHADELAB_ROOT "/framework/interface.toml");
    return loaded;
}

Scene load(const std::string& text) {
    const TemporaryFolder folder;
    return load_scene(folder.write("scene.toml", text), manifest());
}

/// The message of the error that the text causes, from the file's name on.
std::string error_of(const std::string& text) {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.write("scene.toml", text);
    try {
        load_scene(file, manifest());
    } catch (const InputError& error) {
        const std::string message = error.what(), prefix = file.parent_path().string() + "/";
        CHECK(message.find('\n') == std::string::npos);
        REQUIRE(message.rfind(prefix, 0) == 0);
        return message.substr(prefix.size());
    }
    return "no error";
}

const std::string good = R"([film]
width = 64
height = 48
samples = 4
background = [0.1, 0.2, 0.3]

[camera]
eye = [0, 1, 5]
target = [0, 0, 0]
up = [0, 2, 0]
fov_y = 60
near = 0.1
far = 50

[[light]]
kind = "point"
position = [2, 3, 2]
intensity = [12, 11, 10]
attenuation = [1, 0.5, 0.25]

[[light]]
kind = "directional"
direction = [0, -3, -4]
intensity = [1, 1, 1]

[[light]]
kind = "spot"
position = [0, 4, 0]
direction = [0, -2, 0]
intensity = [5, 5, 5]
hotspot = 15
falloff = 30

[material.clay]
model = "phong"
ka = [0.02, 0.02, 0.02]
kd = [0.6, 0.3, 0.2]
ks = [0.4, 0.4, 0.4]
q = 32

[material.brass]
model = "blinn_phong"
ka = [0, 0, 0]
kd = [0.1, 0.1, 0.1]
ks = [1, 1, 1]
q = 100

[[object]]
mesh = "../meshes/a.obj"
material = "clay"
normals = "flat"
interpolation = "gouraud"
translate = [1, 2, 3]
scale = [1, 2, 4]

[object.rotate]
axis = [0, 0, 5]
degrees = 90

[[object]]
mesh = "b.obj"
material = "brass"
scale = 2
)";

int line_of(const std::string& text, const std::string& part) {
    const size_t at = text.find(part);
    REQUIRE(at != std::string::npos);
    return 1 + int(std::count(text.begin(), text.begin() + long(at), '\n'));
}

}  // namespace

TEST_CASE("a scene file becomes radians, unit directions and numbers in the manifest's order") {
    const Scene scene = load(good);
    CHECK((scene.film.width == 64 && scene.film.height == 48 && scene.film.samples == 4));
    CHECK(scene.film.background == glm::dvec3(0.1, 0.2, 0.3));
    CHECK((scene.camera.eye == glm::dvec3(0, 1, 5) && scene.camera.target == glm::dvec3(0) &&
           scene.camera.up == glm::dvec3(0, 2, 0)));
    CHECK(scene.camera.fov_y == Approx(1.0471975511965976).epsilon(1e-15));
    CHECK((scene.camera.near == 0.1 && scene.camera.far == 50));

    REQUIRE(scene.lights.size() == 3);
    const Light &point = scene.lights[0], &sun = scene.lights[1], &spot = scene.lights[2];
    CHECK((point.kind == 0 && sun.kind == 1 && spot.kind == 2 && point.placed && !sun.placed && spot.placed));
    CHECK((point.position == glm::dvec3(2, 3, 2) && point.intensity == glm::dvec3(12, 11, 10) &&
           point.attenuation == glm::dvec3(1, 0.5, 0.25)));
    CHECK(glm::length(sun.direction - glm::dvec3(0, -0.6, -0.8)) < 1e-15);
    CHECK(sun.attenuation == glm::dvec3(1, 0, 0));
    CHECK((spot.direction == glm::dvec3(0, -1, 0) && spot.attenuation == glm::dvec3(1, 0, 0)));
    CHECK(spot.hotspot == Approx(0.2617993877991494).epsilon(1e-15));
    CHECK(spot.falloff == Approx(0.5235987755982988).epsilon(1e-15));
    const std::vector<double> flat = spot.flatten();
    CHECK(flat == std::vector<double>{2, 0, 4, 0, 0, -1, 0, 5, 5, 5, 1, 0, 0, spot.hotspot, spot.falloff});
    CHECK(int(flat.size()) == manifest().columns("Light"));

    REQUIRE(scene.materials.size() == 2);
    const int clay = scene.materials[0].name == "clay" ? 0 : 1;
    CHECK((scene.materials[size_t(clay)].name == "clay" && scene.materials[size_t(clay)].model == "phong"));
    CHECK(scene.materials[size_t(clay)].parameters ==
          std::vector<double>{0.02, 0.02, 0.02, 0.6, 0.3, 0.2, 0.4, 0.4, 0.4, 32});
    CHECK(scene.materials[size_t(1 - clay)].model == "blinn_phong");

    REQUIRE(scene.objects.size() == 2);
    const Object &a = scene.objects[0], &b = scene.objects[1];
    CHECK((a.material == clay && b.material == 1 - clay));
    CHECK((a.normals == Normals::flat && a.interpolation == Interpolation::gouraud));
    CHECK((b.normals == Normals::smooth && b.interpolation == Interpolation::phong));
    CHECK((a.mesh.is_absolute() && a.mesh.filename() == "a.obj" && a.mesh.parent_path().filename() == "meshes"));
    CHECK(a.mesh.string().find("..") == std::string::npos);
    CHECK(b.mesh.parent_path() == scene.file.parent_path());
    CHECK_THAT(a.mesh_where,
               Catch::Matchers::EndsWith("scene.toml:" + std::to_string(line_of(good, "mesh = \"../meshes")) +
                                         ": object[0].mesh"));
    // Scaled first, then turned, then moved: (1, 1, 1) -> (1, 2, 4) -> (-2, 1, 4) -> (-1, 3, 7). The turn's axis was made unit.
    CHECK(glm::length(glm::dvec3(a.to_world * glm::dvec4(1, 1, 1, 1)) - glm::dvec3(-1, 3, 7)) < 1e-14);
    CHECK(b.to_world ==
          glm::dmat4(glm::dvec4(2, 0, 0, 0), glm::dvec4(0, 2, 0, 0), glm::dvec4(0, 0, 2, 0), glm::dvec4(0, 0, 0, 1)));
}

TEST_CASE("what a scene file does not say has a default") {
    const Scene scene = load("[camera]\neye = [0, 0, 5]\ntarget = [0, 0, 0]\nnear = 1\nfar = 10\n");
    CHECK((scene.film.width == 512 && scene.film.height == 512 && scene.film.samples == 1 &&
           scene.film.background == glm::dvec3(0)));
    CHECK(scene.camera.up == glm::dvec3(0, 1, 0));
    CHECK(scene.camera.fov_y == Approx(glm::radians(40.0)).epsilon(1e-15));
    CHECK((scene.lights.empty() && scene.materials.empty() && scene.objects.empty()));
    CHECK(load(replaced(good, "samples = 4", "samples = 64")).film.samples == 64);
    CHECK(load(replaced(good, "hotspot = 15", "hotspot = 30")).lights[2].hotspot ==
          load(good).lights[2].falloff);  // equal is allowed
    CHECK(load(replaced(good, "eye = [0, 1, 5]", "eye = [0, 1, -5.5e3]")).camera.eye.z == -5500);
    CHECK(load(good + "\n# the end").objects.size() == 2);
    std::string windows = good;
    for (size_t at = 0; (at = windows.find('\n', at)) != std::string::npos; at += 2) windows.replace(at, 1, "\r\n");
    CHECK(load(windows).objects.size() == 2);
}

TEST_CASE("a grid makes equal lights that differ in position") {
    const Scene plain = load(good);
    const std::string grid = "falloff = 30\ngrid = { columns = 3, across = [0.5, 0, 0], rows = 2, up = [0, 0, -2] }";
    const Scene scene = load(replaced(good, "falloff = 30", grid));
    REQUIRE(scene.lights.size() == plain.lights.size() + 5);
    for (int k = 0; k < 6; ++k) {
        Light expected = plain.lights[2];
        expected.position += glm::dvec3(0.5 * (k % 3), 0, -2.0 * (k / 3));
        CHECK(scene.lights[size_t(2 + k)].flatten() == expected.flatten());
        CHECK((scene.lights[size_t(2 + k)].grid && scene.lights[size_t(2 + k)].entry == 2));
    }
    CHECK((!plain.lights[2].grid && plain.lights[2].entry == 2));

    CHECK_THAT(error_of(replaced(good, "falloff = 30", "falloff = 30\ngrid = { columns = 0 }")),
               Contains("light[2].grid.columns: must be at least 1 and at most 1000, not 0"));
    CHECK_THAT(error_of(replaced(good, "falloff = 30", "falloff = 30\ngrid = { colums = 2 }")),
               Contains("light[2].grid.colums: unknown key; did you mean \"columns\"?"));
}

TEST_CASE("a scene far from the world's origin is the same scene about the camera's target") {
    const auto moved = [](glm::dvec3 by) {
        const auto at = [&](double x, double y, double z) {
            char text[120];
            std::snprintf(text, sizeof text, "[%.1f, %.1f, %.1f]", by.x + x, by.y + y, by.z + z);  // exact in double
            return std::string(text);
        };
        std::string text = good;
        const auto change = [&](const std::string& key, const std::string& from, const std::string& to) {
            const size_t place = text.find(key + " = " + from);
            REQUIRE(place != std::string::npos);
            text.replace(place + key.size() + 3, from.size(), to);
        };
        change("eye", "[0, 1, 5]", at(0, 1, 5));
        change("target", "[0, 0, 0]", at(0, 0, 0));
        change("position", "[2, 3, 2]", at(2, 3, 2));
        change("position", "[0, 4, 0]", at(0, 4, 0));
        change("translate", "[1, 2, 3]", at(1, 2, 3));
        return load(text);
    };
    const Scene here = load(good);
    CHECK(here.origin == glm::dvec3(0));
    for (const glm::dvec3 by : {glm::dvec3(1e6, -2e6, 5e5), glm::dvec3(0, 0, 1e8), glm::dvec3(6000)}) {
        const Scene there = moved(by);
        CHECK(there.origin == by);
        CHECK((there.camera.eye == here.camera.eye && there.camera.target == here.camera.target));
        CHECK(there.camera.world_to_clip(1.5) == here.camera.world_to_clip(1.5));
        for (size_t i = 0; i < here.lights.size(); ++i) CHECK(there.lights[i].flatten() == here.lights[i].flatten());
        CHECK(there.objects[0].to_world == here.objects[0].to_world);
        // This one's mesh stayed at the world's origin, which is now far away.
        glm::dmat4 back = here.objects[1].to_world;
        back[3] -= glm::dvec4(by, 0);
        CHECK(there.objects[1].to_world == back);
    }
    // Not far for a camera that is 5 away from its target; nor where the target or the eye is near 0.
    const Scene near = moved(glm::dvec3(1000));
    CHECK((near.origin == glm::dvec3(0) && near.camera.target == glm::dvec3(1000)));
    CHECK(load(replaced(good, "eye = [0, 1, 5]", "eye = [0, 1, 1e8]")).origin == glm::dvec3(0));
    CHECK(load(replaced(good, "target = [0, 0, 0]", "target = [0, 0, -1e8]")).origin == glm::dvec3(0));
}

TEST_CASE("a mesh file with large coordinates of its own comes back before the camera") {
    // What the renderer multiplies: to_world, less the scene's origin, times the mesh's.
    const TemporaryFolder folder;
    const double far = 1e8;
    folder.write("b.obj", "v 100000000 0 0\nv 100000001 0 0\nv 100000000 1 0.125\nf 1 2 3\n");
    const std::string text =
        "[camera]\neye = [1e8, 0, 5]\ntarget = [1e8, 0, 0]\nnear = 1\nfar = 10\n"
        "[material.clay]\nmodel = \"lambert\"\nkd = [1, 1, 1]\n"
        "[[object]]\nmesh = \"b.obj\"\nmaterial = \"clay\"\n";
    const Scene scene = load_scene(folder.write("scene.toml", text), manifest());
    REQUIRE(scene.origin == glm::dvec3(far, 0, 0));
    const Mesh mesh = load_mesh(scene.objects[0].mesh, Normals::smooth);
    const glm::dmat4 to_world = glm::translate(scene.objects[0].to_world, mesh.origin);
    const glm::dvec3 expected[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0.125}};
    for (size_t i = 0; i < 3; ++i)
        CHECK(glm::dvec3(to_world * glm::dvec4(glm::dvec3(mesh.positions[i]), 1)) == expected[i]);
}

TEST_CASE("the camera sees the target in the middle and the field of view from edge to edge") {
    const Camera camera = load(good).camera;
    const glm::dmat4 to_clip = camera.world_to_clip(2);
    const auto ndc = [&](glm::dvec3 p) {
        const glm::dvec4 q = to_clip * glm::dvec4(p, 1);
        return glm::dvec3(q) / q.w;
    };
    CHECK(glm::length(glm::dvec2(ndc(camera.target))) < 1e-14);
    const glm::dvec3 forward = glm::normalize(camera.target - camera.eye), right(1, 0, 0),
                     up = glm::cross(right, forward);
    CHECK(ndc(camera.eye + forward * camera.near).z == Approx(-1).epsilon(1e-12));
    CHECK(ndc(camera.eye + forward * camera.far).z == Approx(1).epsilon(1e-12));
    CHECK(ndc(camera.eye + forward + up * std::tan(glm::radians(30.0))).y == Approx(1).epsilon(1e-12));
    CHECK(ndc(camera.eye + forward + 2.0 * right * std::tan(glm::radians(30.0))).x == Approx(1).epsilon(1e-12));
}

TEST_CASE("the camera's shift moves the picture on the film, and nothing nearer or farther") {
    Camera camera = load(good).camera;
    const glm::dmat4 still = camera.world_to_clip(2);
    camera.shift = {2.0 / 64, -4.0 / 48};  // of a film of 64 x 48: a pixel to the right, two down
    const glm::dmat4 moved = camera.world_to_clip(2);
    Random random(17);
    for (int k = 0; k < 100; ++k) {
        const glm::dvec4 p(random.in_box(2), 1);
        const glm::dvec4 a = still * p, b = moved * p;
        CHECK(glm::length(glm::dvec2(b) / b.w - glm::dvec2(a) / a.w - camera.shift) < 1e-14);
        CHECK((b.z == a.z && b.w == a.w));
    }
}

TEST_CASE("every mistake in a scene file is one line with file, line and key") {
    const struct {
        const char *from, *to;  // the change to the good file
        const char* key;        // how the message names the key
        const char* says;       // part of what it says
    } examples[] = {
        // unknown keys, with the nearest known one
        {"width = 64", "widht = 64", "film.widht", "unknown key; did you mean \"width\"?"},
        {"[camera]", "[camara]", "camara", "unknown key; did you mean \"camera\"?"},
        {"fov_y = 60", "fovy = 60", "camera.fovy", "unknown key; did you mean \"fov_y\"?"},
        {"attenuation = [1, 0.5", "atenuation = [1, 0.5", "light[0].atenuation", "did you mean \"attenuation\"?"},
        {"q = 32", "q = 32\nshininess = 3", "material.clay.shininess", "unknown key; known here: "},
        {"q = 32", "q = 32\nkx = [1, 1, 1]", "material.clay.kx", "unknown key"},
        {"degrees = 90", "degrees = 90\naxes = 1", "object[0].rotate.axes", "did you mean \"axis\"?"},
        {"scale = 2", "scale = 2\ntransalte = [0, 0, 0]", "object[1].transalte", "did you mean \"translate\"?"},
        {"[film]", "[flim]", "flim", "did you mean \"film\"?"},
        {"[camera]", "hidden = 1\n[camera]", "film.hidden", "unknown key; known here: "},
        {"direction = [0, -3, -4]", "direction = [0, -3, -4]\nposition = [0, 0, 0]", "light[1].position",
         "unknown key"},
        // types
        {"width = 64", "width = \"64\"", "film.width", "must be a whole number, not a string"},
        {"width = 64", "width = 64.5", "film.width", "must be a whole number"},
        {"width = 64", "width = true", "film.width", "must be a whole number, not true or false"},
        {"fov_y = 60", "fov_y = \"wide\"", "camera.fov_y", "must be a number, not a string"},
        {"fov_y = 60", "fov_y = true", "camera.fov_y", "must be a number, not true or false"},
        {"fov_y = 60", "fov_y = [60]", "camera.fov_y", "must be a number, not an array"},
        {"fov_y = 60", "fov_y = nan", "camera.fov_y", "must be finite"},
        {"near = 0.1", "near = inf", "camera.near", "must be finite"},
        {"eye = [0, 1, 5]", "eye = 5", "camera.eye", "must be an array of 3 numbers, not a number"},
        {"eye = [0, 1, 5]", "eye = [0, 1, \"5\"]", "camera.eye", "each number must be a number, not a string"},
        {"kind = \"point\"", "kind = 0", "light[0].kind", "must be a string, not a number"},
        {"[camera]\neye", "[[camera]]\neye", "camera", "must be a table, not an array"},
        {"material = \"clay\"", "material = 1", "object[0].material", "must be a string, not a number"},
        {"[object.rotate]\naxis = [0, 0, 5]", "rotate = 90\n[other]\naxis = [0, 0, 5]", "object[0].rotate",
         "must be a table, not a number"},
        {"scale = [1, 2, 4]", "scale = \"big\"", "object[0].scale", "must be a number, not a string"},
        // array lengths
        {"eye = [0, 1, 5]", "eye = [0, 1]", "camera.eye", "must hold 3 numbers, not 2"},
        {"background = [0.1, 0.2, 0.3]", "background = [0.1, 0.2, 0.3, 1]", "film.background",
         "must hold 3 numbers, not 4"},
        {"kd = [0.6, 0.3, 0.2]", "kd = []", "material.clay.kd", "must hold 3 numbers, not 0"},
        {"scale = [1, 2, 4]", "scale = [1, 2]", "object[0].scale", "must hold 3 numbers, not 2"},
        // ranges
        {"width = 64", "width = 0", "film.width", "must be at least 1 and at most 16384, not 0"},
        {"height = 48", "height = 16385", "film.height", "must be at least 1 and at most 16384"},
        {"width = 64", "width = 99999999999999", "film.width", "at most 16384"},
        {"samples = 4", "samples = 3", "film.samples", "must be 1, 2, 4, 8, 16 or 64"},
        {"samples = 4", "samples = 32", "film.samples", "must be 1, 2, 4, 8, 16 or 64"},
        {"samples = 4", "samples = 128", "film.samples", "at most 64"},
        {"background = [0.1, 0.2, 0.3]", "background = [0.1, -0.2, 0.3]", "film.background",
         "each number must be at least 0"},
        {"fov_y = 60", "fov_y = 0", "camera.fov_y", "must be at least 0.001 and at most 179, not 0"},
        {"fov_y = 60", "fov_y = 180", "camera.fov_y", "at most 179, not 180"},
        {"near = 0.1", "near = 0", "camera.near", "must be above 0"},
        {"near = 0.1", "near = 50", "camera.far", "must lie beyond near"},
        {"eye = [0, 1, 5]", "eye = [0, 1, 1e31]", "camera.eye", "at most 1e+30"},
        {"intensity = [12, 11, 10]", "intensity = [12, -11, 10]", "light[0].intensity", "at least 0"},
        {"kd = [0.6, 0.3, 0.2]", "kd = [0.6, -0.3, 0.2]", "material.clay.kd", "at least 0"},
        {"q = 32", "q = -1", "material.clay.q", "must be at least 0 and at most 1e+06, not -1"},
        {"q = 32", "q = 1e7", "material.clay.q", "at most 1e+06"},
        {"falloff = 30", "falloff = 91", "light[2].falloff", "at most 90"},
        {"falloff = 30", "falloff = 0", "light[2].falloff", "must be above 0"},
        // values that make no sense together
        {"hotspot = 15", "hotspot = 31", "light[2].hotspot", "must not be wider than falloff"},
        {"up = [0, 2, 0]", "up = [0, 0.2, 1]", "camera.up", "must not be zero or point along the view direction"},
        {"up = [0, 2, 0]", "up = [0, 0, 0]", "camera.up", "must not be zero"},
        {"target = [0, 0, 0]", "target = [0, 1, 5]", "camera.target", "must differ from eye"},
        {"direction = [0, -3, -4]", "direction = [0, 0, 0]", "light[1].direction", "must not be zero"},
        {"attenuation = [1, 0.5, 0.25]", "attenuation = [0, 0, 0]", "light[0].attenuation", "must not be all zero"},
        {"axis = [0, 0, 5]", "axis = [0, 0, 0]", "object[0].rotate.axis", "must not be zero"},
        {"scale = [1, 2, 4]", "scale = [1, 0, 4]", "object[0].scale", "must not be zero"},
        // names
        {"kind = \"point\"", "kind = \"area\"", "light[0].kind", "must be point, directional or spot, not \"area\""},
        {"model = \"phong\"", "model = \"cook_torrance\"", "material.clay.model",
         "blinn_phong_ngan, lambert or lambert_physical, not \"cook_torrance\""},
        {"material = \"clay\"", "material = \"gold\"", "object[0].material",
         "no [material.gold] in this file; there is brass or clay"},
        {"normals = \"flat\"", "normals = \"hard\"", "object[0].normals", "must be smooth, flat or file, not \"hard\""},
        {"interpolation = \"gouraud\"", "interpolation = \"gourad\"", "object[0].interpolation",
         "must be phong or gouraud"},
        // textures belong to a later assignment
        {"kd = [0.6, 0.3, 0.2]", "kd = { texture = \"wood.png\" }", "material.clay.kd",
         "is a constant in this assignment, it takes no texture"},
        {"q = 32", "q = { texture = \"wood.png\" }", "material.clay.q", "it takes no texture"},
        // syntax
        {"fov_y = 60", "fov_y = ", nullptr, "not valid TOML"},
        {"[camera]", "[camera", nullptr, "not valid TOML"},
        {"near = 0.1", "near = 0.1\nnear = 0.2", nullptr, "not valid TOML"},
        {"eye = [0, 1, 5]", "eye = [0, 1 5]", nullptr, "not valid TOML"},
        // line breaks in what is quoted must not break the message
        {"kind = \"point\"", "kind = \"po\\nint\"", "light[0].kind", "must be point, directional or spot"},
        {"material = \"clay\"", "material = \"cl\\nay\"", "object[0].material", "no [material."},
    };
    for (const auto& example : examples) {
        const std::string text = replaced(good, example.from, example.to), message = error_of(text);
        CAPTURE(example.from, example.to, message);
        REQUIRE_THAT(message, Catch::Matchers::StartsWith("scene.toml:"));
        CHECK_THAT(message, Contains(example.says));
        if (!example.key) {
            // Up to where the parser got: the line itself or, for the repeated key, the line after it.
            const int line = std::stoi(message.substr(11)), changed_line = line_of(text, example.to);
            CHECK((line >= changed_line && line <= changed_line + 1));
            continue;
        }
        CHECK_THAT(message, Contains(std::string(": ") + example.key + ": "));
        // The line of the key that is named: that of its last part, searched from where the text was changed.
        const std::string key = std::string(example.key).substr(std::string(example.key).rfind('.') + 1);
        const int line = std::stoi(message.substr(11)), from = line_of(text, example.to);
        int expected = from;
        std::string rest = text.substr(text.find(example.to));
        while (rest.find(key) != std::string::npos && rest.find(key) > rest.find('\n')) {
            rest = rest.substr(rest.find('\n') + 1);
            ++expected;
        }
        CHECK(line == expected);
    }
}

TEST_CASE("what is missing from a scene file is named, with the line of the table that lacks it") {
    const struct {
        const char *part, *key, *table;
    } examples[] = {
        {"eye = [0, 1, 5]\n", "camera.eye", "[camera]"},
        {"target = [0, 0, 0]\n", "camera.target", "[camera]"},
        {"near = 0.1\n", "camera.near", "[camera]"},
        {"far = 50\n", "camera.far", "[camera]"},
        {"kind = \"point\"\n", "light[0].kind", "[[light]]"},
        {"position = [2, 3, 2]\n", "light[0].position", "[[light]]"},
        {"intensity = [12, 11, 10]\n", "light[0].intensity", "[[light]]"},
        {"model = \"phong\"\n", "material.clay.model", "[material.clay]"},
        {"kd = [0.6, 0.3, 0.2]\n", "material.clay.kd", "[material.clay]"},
        {"q = 32\n", "material.clay.q", "[material.clay]"},
        {"mesh = \"../meshes/a.obj\"\n", "object[0].mesh", "[[object]]"},
        {"material = \"clay\"\n", "object[0].material", "[[object]]"},
        {"axis = [0, 0, 5]\n", "object[0].rotate.axis", "[object.rotate]"},
        {"degrees = 90\n", "object[0].rotate.degrees", "[object.rotate]"},
    };
    for (const auto& example : examples) {
        const std::string text = replaced(good, example.part, ""), message = error_of(text);
        CAPTURE(example.part);
        CHECK_THAT(message, Catch::Matchers::StartsWith("scene.toml:" + std::to_string(line_of(text, example.table)) +
                                                        ": " + example.key + ": is missing"));
    }
    CHECK_THAT(error_of(replaced(good, "falloff = 30\n", "")), Contains("light[2].falloff: is missing"));

    const size_t camera = good.find("[camera]"), light = good.find("[[light]]");
    const std::string without = good.substr(0, camera) + good.substr(light);
    CHECK_THAT(error_of(without),
               Catch::Matchers::StartsWith("scene.toml") && Contains(": camera: is missing; add a [camera] table"));
    CHECK_THAT(error_of(""), Contains("camera: is missing"));
    const std::string camera_alone = good.substr(0, light);
    CHECK(error_of(camera_alone + "[light]\nkind = \"point\"\n") ==
          "scene.toml:" + std::to_string(line_of(good, "[[light]]")) +
              ": light: must be an array of tables: write [[light]]");
    CHECK_THAT(error_of(camera_alone + "[material]\nclay = 3\n"),
               Contains(": material.clay: must be a table, not a number"));
}

TEST_CASE("a scene file or an assignment that is not there is an error that names it") {
    const TemporaryFolder folder;
    CHECK_THROWS_WITH(load_scene(folder / "absent.toml", manifest()),
                      (folder / "absent.toml").string() + ": cannot be read; does the file exist?");
    CHECK_THROWS_AS(load_scene(folder / ".", manifest()), InputError);
    CHECK_THROWS_AS(load_manifest(folder / "absent", SHADELAB_ROOT "/framework/interface.toml"), InputError);
}

TEST_CASE("the manifest: structs of the framework and of given assignments, models, columns") {
    const Manifest& phong = manifest();
    CHECK(phong.name == "phong");
    REQUIRE(phong.given.size() == 1);
    CHECK(phong.given[0].name == "lights");
    std::vector<std::string> models;
    for (const Function& model : phong.models()) models.push_back(model.name);
    CHECK(models == std::vector<std::string>{"phong", "blinn_phong", "phong_physical", "blinn_phong_ngan", "lambert",
                                             "lambert_physical"});
    REQUIRE(phong.find_model("phong"));
    CHECK(phong.find_model("phong")->arguments[0].type == "Phong");
    CHECK(phong.find_model("mirror_direction") == nullptr);  // a function, not a model
    CHECK(phong.columns("Phong") == 10);
    CHECK(phong.columns("Terms") == 9);
    CHECK(phong.columns("Real") == 1);
    CHECK(phong.columns(phong.find_model("phong")->arguments).size() == 10 + 3 * 3);
    CHECK(phong.find_struct("Nothing") == nullptr);
}

TEST_CASE("given assignments stand in the order in which they build on each other") {
    const TemporaryFolder folder;
    const auto declare = [&](const std::string& name, const std::string& given) {
        std::filesystem::create_directory(folder / name);
        std::ofstream(folder / name / "assignment.toml")
            << "name = \"" << name << "\"\ntitle = \"\"\nfiles = []\ngiven = [" << given << "]\n"
            << "[[function]]\nname = \"" << name
            << "_model\"\narguments = [{ light = \"Light\" }]\nreturns = \"Terms\"\n"
            << (name != "first" ? ""
                                : "[[function]]\nname = \"incident_light\"\nreturns = \"Incident\"\n"
                                  "arguments = [{ light = \"Light\" }, { x = \"position\" }]\n");
    };
    const auto load = [&](const std::string& name) {
        return load_manifest(folder / name, SHADELAB_ROOT "/framework/interface.toml");
    };
    declare("first", "");
    declare("second", "\"first\"");
    declare("third", "\"first\", \"second\"");
    CHECK(load("third").models().size() == 3);  // each once, however many build on it
    for (const std::string given : {"\"second\"", "\"second\", \"first\""}) {
        declare("wrong", given);
        CHECK_THROWS_WITH(load("wrong"),
                          Contains("assignment.toml:4: given: second builds on first: list first before it"));
    }
}
