// Manifests: the one line that says what is wrong with one, and what the framework tells others of what it understood.
#include "support.hpp"

#include <text/json.hpp>

#include <shadelab/describe.hpp>
#include <shadelab/error.hpp>
#include <shadelab/glue.hpp>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>

using namespace shadelab;
using namespace shadelab::testing;
using Catch::Matchers::Contains;

namespace {

const std::string interface = SHADELAB_ROOT "/framework/interface.toml";

const std::string good = R"toml(name = "small"
title = "A \"small\" assignment"
files = ["shading.cpp", "shading.glsl"]
given = []

[[struct]]
name = "Plain"
members = [{ kd = "rgb" }, { q = { range = [0, 1e6], typical = [1, 512], scale = "log" } }]

[[function]]
name = "incident_light"
arguments = [{ light = "Light" }, { x = "position" }]
returns = "Incident"

[[function]]
name = "lobe"
summary = "the lobe"
slide = "Slide 3"
points = 2.5
arguments = [{ n = "unit" }, { l = "upper(n)" }, { r = "upper(-n)" }, { q = { range = [1, 9] } }, { m = "Plain" }]
returns = "Real"
gates = [{ q = 1, l = "n" }, { n = [0, 0, 1], "m.kd" = [1, 1, 1] }]

[[function]]
name = "plain"
arguments = [{ m = "Plain" }, { n = "unit" }, { l = "unit" }]
returns = "Terms"

[[scene]]
file = "scenes/one.toml"
points = 4
)toml";

Manifest load(const std::string& text) {
    const TemporaryFolder folder;
    std::filesystem::create_directory(folder / "small");
    folder.write("small/assignment.toml", text);
    return load_manifest(folder / "small", interface);
}

}  // namespace

TEST_CASE("a manifest becomes functions, columns, gates and scenes") {
    const Manifest manifest = load(good);
    CHECK((manifest.name == "small" && manifest.title == "A \"small\" assignment" && manifest.files.size() == 2));
    REQUIRE(manifest.functions.size() == 3);
    const Function& lobe = manifest.functions[1];
    CHECK((lobe.summary == "the lobe" && lobe.slide == "Slide 3" && lobe.points == 2.5 && !lobe.is_model()));
    CHECK((lobe.arguments[0].domain.kind == "unit" && lobe.arguments[1].domain.kind == "upper"));
    CHECK((lobe.arguments[1].domain.base == "n" && !lobe.arguments[1].domain.opposite));
    CHECK((lobe.arguments[2].domain.base == "n" && lobe.arguments[2].domain.opposite));
    CHECK((lobe.arguments[3].domain.kind == "range" && lobe.arguments[3].min == 1 && lobe.arguments[3].max == 9));
    CHECK(lobe.arguments[4].domain.kind == "struct");

    std::vector<std::string> names;
    for (const Column& column : manifest.columns(lobe.arguments)) names.push_back(column.name());
    CHECK(names == std::vector<std::string>{"n.x", "n.y", "n.z", "l.x", "l.y", "l.z", "r.x", "r.y", "r.z", "q",
                                            "m.kd.x", "m.kd.y", "m.kd.z", "m.q"});
    names.clear();
    for (const Column& column : manifest.result_columns(manifest.functions[0])) names.push_back(column.name());
    CHECK(names ==
          std::vector<std::string>{"result.l.x", "result.l.y", "result.l.z", "result.e.x", "result.e.y", "result.e.z"});
    REQUIRE(lobe.gates.size() == 2);  // within a gate by name
    CHECK((lobe.gates[0][0].first == "l" && std::get<std::string>(lobe.gates[0][0].second) == "n"));
    CHECK((lobe.gates[0][1].first == "q" && std::get<double>(lobe.gates[0][1].second) == 1));
    CHECK(std::get<std::vector<double>>(lobe.gates[1][1].second) == std::vector<double>{0, 0, 1});
    REQUIRE(manifest.scenes.size() == 1);
    CHECK((manifest.scenes[0].file.is_absolute() && manifest.scenes[0].file.stem() == "one"));
    CHECK(manifest.scenes[0].points == 4);

    // The loader's Light::flatten() writes them in this order.
    names.clear();
    for (const Column& column : manifest.columns(manifest.find_struct("Light")->members))
        names.push_back(column.name());
    CHECK(names == std::vector<std::string>{"kind", "position.x", "position.y", "position.z", "direction.x",
                                            "direction.y", "direction.z", "intensity.x", "intensity.y", "intensity.z",
                                            "attenuation.x", "attenuation.y", "attenuation.z", "hotspot", "falloff"});

    // What a model's loop takes of a fragment: its own arguments and those of the light function.
    std::vector<std::string> attributes;
    for (const FragmentAttribute& attribute : manifest.attributes(*manifest.find_model("plain")))
        attributes.push_back(attribute.name);
    CHECK(attributes == std::vector<std::string>{"n", "x"});
}

TEST_CASE("every mistake in a manifest is one line with file, line and key") {
    const struct {
        const char *from, *to;  // the change to the good file
        const char* says;       // from the line's number on
    } examples[] = {
        {"title = \"A \\\"small\\\" assignment\"\n", "", ": title: is missing"},
        {"points = 2.5", "points = -1", "19: function[1].points: must be at least 0"},
        {"points = 4", "points = -4", "31: scene[0].points: must be at least 0"},
        {"slide = \"Slide 3\"", "slied = \"Slide 3\"", "18: function[1].slied: unknown key; did you mean \"slide\"?"},
        {"file = \"scenes/one.toml\"", "flie = \"scenes/one.toml\"", "29: scene[0].file: is missing"},
        {"name = \"plain\"", "name = \"lobe\"", "25: function[2].name: lobe is declared twice"},
        {"returns = \"Real\"", "returns = \"float\"", "21: function[1].returns: unknown type \"float\""},
        {"{ l = \"unit\" }", "{ l = \"unitt\" }", "26: arguments.l: unknown domain \"unitt\""},
        {"{ l = \"unit\" }", "{ n = \"unit\" }", "26: function[2].arguments: n stands here twice"},
        {"upper(n)", "upper(b)", "20: function[1].arguments: l: upper(b) names no argument"},
        {"upper(-n)", "upper(-b)", "20: function[1].arguments: r: upper(b) names no argument"},
        {"upper(-n)", "upper(r)", "20: function[1].arguments: r: upper(r) names no argument"},
        {"range = [1, 9]", "range = [9, 1]", "range: must go from the lower number to the higher"},
        {"range = [1, 9]", "range = [1, 9], typical = [3, 2]", "typical: must go from the lower number to the higher"},
        {"typical = [1, 512], ", "", "scale: a logarithm needs typical values above 0"},
        {"typical = [1, 512]", "typical = [0, 512]", "scale: a logarithm needs typical values above 0"},
        {"scale = \"log\"", "scale = \"logarithmic\"", "scale: must be linear or log"},
        {"{ q = 1, l = \"n\" }", "{ p = 1 }", "22: function[1].gates: p is no column; there is n, l, r, q, m.kd, m.q"},
        {"{ q = 1, l = \"n\" }", "{ l = \"q\" }",
         "22: function[1].gates: l = q: there is no such column, or it is not as wide"},
        {"{ q = 1, l = \"n\" }", "{ l = \"h\" }", "gates: l = h: there is no such column"},
        {"{ q = 1, l = \"n\" }", "{ l = [1, 0] }", "22: function[1].gates: l needs 3 numbers"},
        {"{ q = 1, l = \"n\" }", "{ l = 1 }", "gates: l needs 3 numbers"},
        {"{ q = 1, l = \"n\" }", "{ q = nan }", "gates: q needs 1 numbers"},
        {"{ q = 1, l = \"n\" }", "1", "gates: must be an array of { column = value }"},
        // what the framework cannot give to what it calls
        {"{ l = \"unit\" }", "{ h = \"unit\" }",
         "26: function[2].arguments: plain: the framework has no h to give to it; it has n, x, v, l or e"},
        {"{ m = \"Plain\" }, { n = \"unit\" }", "{ m = \"Plain\" }, { n = \"cosine\" }",
         "26: function[2].arguments: plain: the framework's n is a vec3, not a Real"},
        {"{ x = \"position\" }", "{ y = \"position\" }",
         "12: function[0].arguments: incident_light: the framework has no y to give to it"},
        {"arguments = [{ m = \"Plain\" }, { n", "arguments = [{ m = \"rgb\" }, { n",
         "26: function[2].arguments: plain: a model's first argument is its material, a struct"},
        {"name = \"incident_light\"", "name = \"other_light\"",
         "27: function[2].returns: plain is a model, and models need incident_light"},
        {"given = []", "given = [\"absent\"]", "cannot be read; does the file exist?"},
    };
    for (const auto& example : examples) {
        CAPTURE(example.from, example.to);
        try {
            load(replaced(good, example.from, example.to));
            FAIL_CHECK("no error");
        } catch (const InputError& error) {
            const std::string message = error.what();
            CHECK(message.find('\n') == std::string::npos);
            CHECK_THAT(message, Contains("assignment.toml:") && Contains(example.says));
        }
    }
}

TEST_CASE("what a fragment holds has the names that interface.toml gives it, in both languages") {
    const TemporaryFolder folder;
    std::string declared;
    {
        std::ifstream file(interface);
        declared.assign(std::istreambuf_iterator<char>(file), {});
    }
    folder.write("interface.toml",
                 replaced(replaced(declared, "name = \"x\"", "name = \"p\""), "name = \"n\"", "name = \"m0\""));
    std::filesystem::create_directory(folder / "small");
    const std::string other = replaced(replaced(good, "{ x = \"position\" }", "{ p = \"position\" }"),
                                       "[{ m = \"Plain\" }, { n = \"unit\" }, { l = \"unit\" }]",
                                       "[{ m = \"Plain\" }, { m0 = \"unit\" }, { l = \"unit\" }, { v = \"unit\" }]");
    folder.write("small/assignment.toml", other);
    const Manifest manifest = load_manifest(folder / "small", (folder / "interface.toml").string());
    Scene scene;
    scene.light_kinds = {"point"};
    scene.lights.push_back({});
    Features features;
    features.lights = {0};
    const ShaderMains mains = glsl_shade_mains(manifest, SHADELAB_ROOT "/framework", scene, features,
                                               *manifest.find_function("plain"), Interpolation::phong, false);
    CHECK_THAT(mains.fragment, Contains("vec3 x = shadelab_x;") && Contains("falloff), x)"));
    CHECK_THAT(mains.fragment, Contains("plain(m, n, incident.l, v)"));
    std::vector<std::string> names;
    for (const FragmentAttribute& attribute : manifest.attributes(*manifest.find_function("plain")))
        names.push_back(attribute.name);
    CHECK(names == std::vector<std::string>{"m0", "p", "v"});
}

TEST_CASE("the drawing of fragments is an assignment without C++, and the studies' lobes are one without scenes") {
    for (const std::string folder : {"/grader/shadelab/truth/driver", "/studies/lobe-forms"}) {
        const Manifest manifest = load_manifest(SHADELAB_ROOT + folder, interface);
        CHECK((manifest.models().empty() && !manifest.functions.empty() && manifest.scenes.empty()));
        CHECK_THAT(describe(manifest), Contains("\"schema\" : \"shadelab/assignment/2\""));
    }
}

TEST_CASE("JSON: texts are escaped, numbers come back as they were, what is not finite is a text") {
    const double third = 1.0 / 3, tiny = 5e-324;
    const std::string text =
        json::line(toml::table{{"quote\"", "back\\slash \x01\x1f \n \xff"}, {"third", third}, {"tiny", tiny}});
    CHECK(text.find('\n') == std::string::npos);
    CHECK_THAT(text, Contains("\"quote\\\"\"") && Contains("back\\\\slash \\u0001\\u001F \\n "));
    CHECK(std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; }));
    CHECK(std::stod(text.substr(text.find("third") + 9)) == third);
    CHECK(std::strtod(text.c_str() + text.find("tiny") + 8, nullptr) == tiny);
    const std::string infinite = json::line(toml::table{{"a", INFINITY}, {"b", -INFINITY}, {"c", NAN}, {"d", -NAN}});
    CHECK_THAT(infinite, Contains("\"Infinity\"") && Contains("\"-Infinity\"") && Contains("\"NaN\""));
}
