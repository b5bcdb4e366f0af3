#pragma once
// What an assignment declares (assignment.toml): structs, shading functions, scenes, and the earlier assignments whose functions
// are given. Everything that differs between assignments reaches the framework through these types, and the grader through what
// describe() makes of them: nobody else reads a manifest.

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace shadelab {

/// Where a value lies: what input tables are drawn from.
struct Domain {
    std::string kind;       ///< unit, upper, position, rgb, cosine, angle, range or struct
    std::string base = {};  ///< of upper(base) and upper(-base): the unit argument that spans the hemisphere
    bool opposite = false;  ///< upper(-base)
    std::optional<std::array<double, 2>> range = {}, typical = {};
    bool log = false;  ///< spread over the logarithm
};

/// A member of a struct or an argument of a function. `type` is "Real", "int", "vec2", "vec3", "vec4" or a struct's name;
/// `min` and `max` bound each number of it (scene files are checked against them).
struct Value {
    std::string name;
    std::string type;
    double min, max;
    Domain domain = {};
};

struct Struct {
    std::string name;
    std::vector<Value> members;
};

/// Rows of a function's input table that stand on a stated edge case: column -> constant, or the column that it copies.
using GateValue = std::variant<double, std::vector<double>, std::string>;
using Gate = std::vector<std::pair<std::string, GateValue>>;

struct Function {
    std::string name;
    std::vector<Value> arguments;
    std::string returns;
    std::string summary, slide;
    double points = 0;
    std::vector<Gate> gates;

    /// A model is what a scene's `model = "..."` can name: it returns Terms and takes its material struct first.
    bool is_model() const { return returns == "Terms" && !arguments.empty(); }
};

/// One number of a flattened value: `m.kd[2]` has path "m.kd", index 2, width 3.
struct Column {
    std::string path;
    int index, width;
    Domain domain;
    std::string type;  ///< of the whole: "vec3"

    std::string name() const { return width == 1 ? path : path + "." + "xyzw"[index]; }
};

/// What a fragment holds, as interface.toml declares it. `source`: normal, position or eye.
struct FragmentAttribute {
    std::string name, source;
    Value value;
};

struct LightKind {
    std::string name;
    std::vector<std::string> members;  ///< of Light: those that a scene file gives
    bool has(const std::string& member) const;
};

/// interface.toml: what the framework and every assignment share.
struct Interface {
    std::string light_function;  ///< what arrives from a light at a point
    std::vector<FragmentAttribute> fragment;
    std::vector<LightKind> lights;
};

struct SceneEntry {
    std::filesystem::path file;  ///< absolute
    double points;
};

struct Manifest {
    std::string name, title;
    std::filesystem::path directory;
    std::vector<std::string> files;   ///< what a submission consists of, e.g. shading.cpp and shading.glsl
    std::vector<Struct> structs;      ///< the framework's own first, then those of given assignments, then this one's
    std::vector<Function> functions;  ///< this assignment's own: graded ones, worked examples, code already written
    std::vector<SceneEntry> scenes;
    Interface interface;
    std::vector<Manifest> given;  ///< earlier assignments whose solution the student builds on: all of them, in order

    const Struct* find_struct(const std::string& type) const;
    const Function* find_model(const std::string& model) const;  ///< among given assignments too
    const Function* find_function(const std::string& function) const;
    std::vector<Function> models() const;  ///< this assignment's first, then those of the given ones

    /// The numbers that values flatten to, in the order in which plugins and shaders take them (a struct's members in order).
    std::vector<Column> columns(const std::vector<Value>& values, const std::string& prefix = "") const;
    /// Of a function's result: named `result` or `result.member`.
    std::vector<Column> result_columns(const Function& function) const;
    /// What a model's shading loop takes of a fragment: what its arguments and the light function's name, as declared.
    std::vector<FragmentAttribute> attributes(const Function& model) const;
    /// How many they are: "position.x" is one.
    int columns(const std::string& type) const;
};

/// Reads `directory`/assignment.toml, `interface` (the framework's interface.toml) and the manifests of `given` assignments,
/// which stand beside `directory`. Throws InputError with file, line and key.
Manifest load_manifest(const std::filesystem::path& directory, const std::filesystem::path& interface);

}  // namespace shadelab
