#pragma once
// What an assignment declares (assignment.toml): structs, shading functions, and the earlier assignments whose functions are
// given. Everything that differs between assignments reaches the framework through these types.

#include <filesystem>
#include <string>
#include <vector>

namespace shadelab {

/// A member of a struct or an argument of a function. `type` is "Real", "int", "vec2", "vec3", "vec4" or a struct's name;
/// `min` and `max` bound each number of it (scene files are checked against them).
struct Value {
    std::string name;
    std::string type;
    double min, max;
};

struct Struct {
    std::string name;
    std::vector<Value> members;
};

struct Function {
    std::string name;
    std::vector<Value> arguments;
    std::string returns;

    /// A model is what a scene's `model = "..."` can name: it returns Terms and takes its material struct first.
    bool is_model() const { return returns == "Terms" && !arguments.empty(); }
};

struct Manifest {
    std::string name;
    std::filesystem::path directory;
    std::vector<std::string> files;   ///< what a submission consists of, e.g. shading.cpp and shading.glsl
    std::vector<Struct> structs;      ///< the framework's own first, then those of given assignments, then this one's
    std::vector<Function> functions;  ///< this assignment's own: graded ones, worked examples, code already written
    std::vector<Manifest> given;  ///< earlier assignments whose solution the student builds on: all of them, in order

    const Struct* find_struct(const std::string& type) const;
    const Function* find_model(const std::string& model) const;  ///< among given assignments too
    std::vector<Function> models() const;  ///< this assignment's first, then those of the given ones

    /// The numbers that a value of this type flattens to (a struct's members in order): "position.x" is one column.
    int columns(const std::string& type) const;
    int columns(const std::vector<Value>& values) const;
};

/// Reads `directory`/assignment.toml, `interface` (the framework's interface.toml) and the manifests of `given` assignments,
/// which stand beside `directory`. Throws InputError with file, line and key.
Manifest load_manifest(const std::filesystem::path& directory, const std::filesystem::path& interface);

}  // namespace shadelab
