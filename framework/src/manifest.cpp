#include <shadelab/manifest.hpp>

#include "toml_reader.hpp"

#include <algorithm>
#include <map>

namespace shadelab {

namespace {

// What the short names of domains mean: a type and the bounds of each number.
const std::map<std::string, Value> domains = {
    {"unit", {"", "vec3", -1, 1}},       {"position", {"", "vec3", -1e30, 1e30}}, {"rgb", {"", "vec3", 0, 1e30}},
    {"cosine", {"", "Real", -1, 1}},     {"angle", {"", "Real", -1e30, 1e30}},    {"Real", {"", "Real", -1e30, 1e30}},
    {"vec2", {"", "vec2", -1e30, 1e30}}, {"vec3", {"", "vec3", -1e30, 1e30}},     {"vec4", {"", "vec4", -1e30, 1e30}},
};

const std::map<std::string, int> columns_of_type = {{"Real", 1}, {"int", 1}, {"vec2", 2}, {"vec3", 3}, {"vec4", 4}};

// One `{ name = "domain" }` or `{ name = { type, range, typical, scale } }`.
Value read_value(const toml::table& table, const std::string& file, const std::string& key, const Manifest& manifest) {
    TomlReader reader(table, file, key);
    if (table.size() != 1) reader.fail(key, "each entry is one { name = \"domain\" }");
    const std::string name(table.begin()->first.str());
    Value value;
    if (table.begin()->second.is_string()) {
        std::string domain = reader.string(name);
        if (domain.rfind("upper(", 0) == 0) domain = "unit";
        if (const auto found = domains.find(domain); found != domains.end())
            value = found->second;
        else if (manifest.find_struct(domain))
            value = {"", domain, 0, 0};
        else
            reader.fail(name, "unknown domain \"" + domain + "\"");
    } else {
        TomlReader domain = reader.child(name);
        value.type = domain.choice("type", "Real", {"Real", "int", "vec2", "vec3", "vec4"});
        const std::vector<double> range = domain.numbers("range", 2);
        value.min = range[0];
        value.max = range[1];
        if (domain.has("typical")) domain.numbers("typical", 2);
        domain.choice("scale", "linear", {"linear", "log"});
        domain.finish();
    }
    value.name = name;
    return value;
}

std::vector<Value> read_values(TomlReader& reader, const std::string& key, const std::string& file,
                               const Manifest& manifest) {
    std::vector<Value> out;
    const toml::node* node = reader.find(key);
    const toml::array* array = node ? node->as_array() : nullptr;
    if (!array) reader.fail(key, "must be an array of { name = \"domain\" }");
    for (const toml::node& element : *array) {
        if (!element.is_table()) reader.fail(key, "must be an array of { name = \"domain\" }");
        out.push_back(read_value(*element.as_table(), file, key, manifest));
    }
    return out;
}

void read_structs(TomlReader& root, const std::string& file, Manifest& manifest) {
    for (TomlReader& reader : root.children("struct")) {
        Struct declared;
        declared.name = reader.string("name");
        declared.members = read_values(reader, "members", file, manifest);
        reader.finish();
        manifest.structs.push_back(declared);
    }
}

}  // namespace

const Struct* Manifest::find_struct(const std::string& type) const {
    for (const Struct& candidate : structs)
        if (candidate.name == type) return &candidate;
    return nullptr;
}

const Function* Manifest::find_model(const std::string& model) const {
    for (const Function& function : functions)
        if (function.name == model && function.is_model()) return &function;
    for (const Manifest& earlier : given)
        if (const Function* function = earlier.find_model(model)) return function;
    return nullptr;
}

std::vector<Function> Manifest::models() const {
    std::vector<Function> out;
    const auto add = [&](const Manifest& manifest) {
        for (const Function& function : manifest.functions)
            if (function.is_model()) out.push_back(function);
    };
    add(*this);
    for (const Manifest& earlier : given) add(earlier);
    return out;
}

int Manifest::columns(const std::string& type) const {
    if (const auto found = columns_of_type.find(type); found != columns_of_type.end()) return found->second;
    return columns(find_struct(type)->members);
}

int Manifest::columns(const std::vector<Value>& values) const {
    int sum = 0;
    for (const Value& value : values) sum += columns(value.type);
    return sum;
}

Manifest load_manifest(const std::filesystem::path& directory, const std::filesystem::path& interface) {
    Manifest manifest;
    const toml::table shared = parse_toml(interface);
    TomlReader shared_root(shared, interface.string(), "");
    read_structs(shared_root, interface.string(), manifest);

    const std::filesystem::path path = directory / "assignment.toml";
    const std::string file = path.string();
    const toml::table table = parse_toml(path);
    TomlReader root(table, file, "");
    manifest.directory = directory;
    manifest.name = root.string("name");
    root.string("title");
    manifest.files = root.strings("files");
    const std::vector<std::string> given = root.strings("given");
    for (size_t i = 0; i < given.size(); ++i) {
        manifest.given.push_back(load_manifest(directory / ".." / given[i], interface));
        for (const Manifest& needed : manifest.given.back().given)
            if (std::find(given.begin(), given.begin() + i, needed.name) == given.begin() + i)
                root.fail("given", given[i] + " builds on " + needed.name + ": list " + needed.name + " before it");
        for (const Struct& earlier : manifest.given.back().structs)
            if (!manifest.find_struct(earlier.name)) manifest.structs.push_back(earlier);
    }
    read_structs(root, file, manifest);
    for (TomlReader& reader : root.children("function")) {
        Function function;
        function.name = reader.string("name");
        function.arguments = read_values(reader, "arguments", file, manifest);
        function.returns = reader.string("returns");
        if (!columns_of_type.count(function.returns) && !manifest.find_struct(function.returns))
            reader.fail("returns", "unknown type \"" + function.returns + "\"");
        reader.string("slide", "");
        reader.string("summary", "");
        reader.number("points", 0, Range{0});
        reader.find("gates");  // the grader's, as the points and the scenes below
        reader.finish();
        manifest.functions.push_back(function);
    }
    for (TomlReader& reader : root.children("scene")) {  // read here only to name a slip of the pen
        reader.string("file");
        reader.number("points", 0, Range{0});
        reader.finish();
    }
    root.finish();
    return manifest;
}

}  // namespace shadelab
