#include <shadelab/manifest.hpp>

#include "text/toml_reader.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace shadelab {

namespace {

const std::map<std::string, int> columns_of_type = {{"Real", 1}, {"int", 1}, {"vec2", 2}, {"vec3", 3}, {"vec4", 4}};

// What the short names of domains mean: a type and the bounds of each number. The last four are types alone.
const std::map<std::string, Value> domains = {
    {"unit", {"", "vec3", -1, 1}},       {"position", {"", "vec3", -1e30, 1e30}}, {"rgb", {"", "vec3", 0, 1e30}},
    {"cosine", {"", "Real", -1, 1}},     {"angle", {"", "Real", -1e30, 1e30}},    {"Real", {"", "Real", -1e30, 1e30}},
    {"vec2", {"", "vec2", -1e30, 1e30}}, {"vec3", {"", "vec3", -1e30, 1e30}},     {"vec4", {"", "vec4", -1e30, 1e30}},
};

/// "unit", "upper(n)", "upper(-n)", a struct's name ...
Value short_form(TomlReader& reader, const std::string& name, const Manifest& manifest) {
    const std::string text = reader.string(name);
    Value value;
    if (text.rfind("upper(", 0) == 0 && text.back() == ')') {
        value = domains.at("unit");
        value.domain.opposite = text[6] == '-';
        const size_t begin = value.domain.opposite ? 7 : 6;
        value.domain = {"upper", text.substr(begin, text.size() - 1 - begin), value.domain.opposite};
    } else if (const auto found = domains.find(text); found != domains.end()) {
        value = found->second;
        value.domain.kind = columns_of_type.count(text) ? "range" : text;
    } else if (manifest.find_struct(text)) {
        value = {"", text, 0, 0, {"struct"}};
    } else {
        reader.fail(name, "unknown domain \"" + text + "\"");
    }
    return value;
}

/// { type, range, typical, scale }
Value long_form(TomlReader domain) {
    Value value;
    value.domain.kind = "range";
    value.type = domain.choice("type", "Real", {"Real", "int", "vec2", "vec3", "vec4"});
    const auto pair = [&](const std::string& key) {
        const std::vector<double> ends = domain.numbers(key, 2);
        if (ends[0] > ends[1]) domain.fail(key, "must go from the lower number to the higher");
        return std::array<double, 2>{ends[0], ends[1]};
    };
    value.domain.range = pair("range");
    value.min = (*value.domain.range)[0], value.max = (*value.domain.range)[1];
    if (domain.has("typical")) value.domain.typical = pair("typical");
    value.domain.log = domain.choice("scale", "linear", {"linear", "log"}) == "log";
    if (value.domain.log && (value.domain.typical ? (*value.domain.typical)[0] : value.min) <= 0)
        domain.fail("scale", "a logarithm needs typical values above 0");
    domain.finish();
    return value;
}

/// One `{ name = "domain" }` or `{ name = { type, range, typical, scale } }`.
Value read_value(const toml::table& table, const std::string& file, const std::string& key, const Manifest& manifest) {
    TomlReader reader(table, file, key);
    if (table.size() != 1) reader.fail(key, "each entry is one { name = \"domain\" }");
    const std::string name(table.begin()->first.str());
    Value value =
        table.begin()->second.is_string() ? short_form(reader, name, manifest) : long_form(reader.child(name));
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
    for (const Value& value : out) {
        const auto same = [&](const Value& other) { return other.name == value.name; };
        if (std::count_if(out.begin(), out.end(), same) > 1) reader.fail(key, value.name + " stands here twice");
        const auto base = [&](const Value& other) { return other.name == value.domain.base && &other != &value; };
        if (value.domain.kind == "upper" && std::none_of(out.begin(), out.end(), base))
            reader.fail(key, value.name + ": upper(" + value.domain.base + ") names no argument");
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

Interface read_interface(TomlReader& root, const Manifest& manifest) {
    constexpr int version = 2;
    Interface out;
    if (root.integer("version", 0, 0, 1000) != version)
        root.fail("version", "this program knows version " + std::to_string(version));
    out.light_function = root.string("light_function");
    for (TomlReader& reader : root.children("fragment")) {
        FragmentAttribute attribute;
        attribute.name = reader.string("name");
        attribute.value = short_form(reader, "domain", manifest);
        attribute.value.name = attribute.name;
        attribute.source = reader.choice("from", "", {"normal", "position", "eye"});
        reader.finish();
        out.fragment.push_back(attribute);
    }
    const Struct* light = manifest.find_struct("Light");
    for (TomlReader& reader : root.children("light")) {
        LightKind kind{reader.string("kind"), reader.strings("members")};
        for (const std::string& name : kind.members)
            if (!light || std::none_of(light->members.begin(), light->members.end(),
                                       [&](const Value& member) { return member.name == name; }))
                reader.fail("members", "a Light has no member " + name);
        reader.finish();
        out.lights.push_back(kind);
    }
    root.finish();
    return out;
}

/// The width of each column's whole: "m.kd" -> 3.
std::map<std::string, int> widths_of(const std::vector<Column>& columns) {
    std::map<std::string, int> out;
    for (const Column& column : columns) out[column.path] = column.width;
    return out;
}

std::string names_of(const std::vector<Column>& columns) {
    std::string out;
    for (const Column& column : columns)
        if (column.index == 0) out += (out.empty() ? "" : ", ") + column.path;
    return out;
}

std::vector<Gate> read_gates(TomlReader& reader, const Function& function, const Manifest& manifest) {
    std::vector<Gate> out;
    const toml::node* node = reader.find("gates");
    if (!node) return out;
    if (!node->is_array()) reader.fail("gates", "must be an array of { column = value }");
    const std::vector<Column> columns = manifest.columns(function.arguments);
    const std::map<std::string, int> widths = widths_of(columns);
    for (const toml::node& entry : *node->as_array()) {
        if (!entry.is_table()) reader.fail("gates", "must be an array of { column = value }");
        Gate gate;
        for (const auto& [key, value] : *entry.as_table()) {
            const std::string path(key.str());
            const auto width = widths.find(path);
            if (width == widths.end()) reader.fail("gates", path + " is no column; there is " + names_of(columns));
            if (const auto* other = value.as_string()) {
                const auto found = widths.find(other->get());
                if (found == widths.end() || found->second != width->second)
                    reader.fail("gates",
                                path + " = " + other->get() + ": there is no such column, or it is not as wide");
                gate.emplace_back(path, other->get());
                continue;
            }
            std::vector<double> numbers;
            if (const toml::array* array = value.as_array()) {
                for (const toml::node& number : *array) numbers.push_back(number.value<double>().value_or(NAN));
            } else {
                numbers.push_back(value.value<double>().value_or(NAN));
            }
            const bool finite = std::all_of(numbers.begin(), numbers.end(), [](double v) { return std::isfinite(v); });
            if (int(numbers.size()) != width->second || !finite)
                reader.fail("gates", path + " needs " + std::to_string(width->second) + " numbers");
            if (value.is_array())
                gate.emplace_back(path, numbers);
            else
                gate.emplace_back(path, numbers[0]);
        }
        out.push_back(gate);
    }
    return out;
}

void read_functions(TomlReader& root, const std::string& file, Manifest& manifest) {
    for (TomlReader& reader : root.children("function")) {
        Function function;
        function.name = reader.string("name");
        for (const Function& earlier : manifest.functions)
            if (earlier.name == function.name) reader.fail("name", function.name + " is declared twice");
        function.arguments = read_values(reader, "arguments", file, manifest);
        function.returns = reader.string("returns");
        if (!columns_of_type.count(function.returns) && !manifest.find_struct(function.returns))
            reader.fail("returns", "unknown type \"" + function.returns + "\"");
        function.slide = reader.string("slide", "");
        function.summary = reader.string("summary", "");
        function.points = reader.number("points", 0, Range{0});
        function.gates = read_gates(reader, function, manifest);
        reader.finish();
        manifest.functions.push_back(function);
    }
}

/// What the framework cannot give, no function that it calls may ask for: `has` is what it has, by name.
void check_arguments(const TomlReader& reader, const Function& function, size_t first, const std::vector<Value>& has) {
    for (size_t i = first; i < function.arguments.size(); ++i) {
        const Value& argument = function.arguments[i];
        const auto found =
            std::find_if(has.begin(), has.end(), [&](const Value& v) { return v.name == argument.name; });
        std::vector<std::string> known;
        for (const Value& value : has) known.push_back(value.name);
        if (found == has.end())
            reader.fail("arguments", function.name + ": the framework has no " + argument.name +
                                         " to give to it; it has " + list_of(known));
        if (found->type != argument.type)
            reader.fail("arguments", function.name + ": the framework's " + argument.name + " is a " + found->type +
                                         ", not a " + argument.type);
    }
}

void check_calls(TomlReader& root, const Manifest& manifest) {
    const Interface& interface = manifest.interface;
    const Function* light = manifest.find_function(interface.light_function);
    const Struct* incident = light ? manifest.find_struct(light->returns) : nullptr;
    std::vector<Value> fragment;
    for (const FragmentAttribute& attribute : interface.fragment) fragment.push_back(attribute.value);
    const std::vector<TomlReader> readers = root.children("function");
    for (size_t i = 0; i < manifest.functions.size(); ++i) {
        const Function& function = manifest.functions[i];
        const TomlReader& reader = readers[i];
        std::vector<Value> has = fragment;
        if (function.name == interface.light_function) {
            for (const Value& argument : function.arguments)
                if (argument.type == "Light") has.push_back(argument);
            check_arguments(reader, function, 0, has);
        }
        if (!function.is_model()) continue;
        if (!incident)
            reader.fail("returns", function.name + " is a model, and models need " + interface.light_function +
                                       ": declare it, or list an assignment that does under given");
        if (!manifest.find_struct(function.arguments[0].type))
            reader.fail("arguments", function.name + ": a model's first argument is its material, a struct");
        has.insert(has.end(), incident->members.begin(), incident->members.end());
        check_arguments(reader, function, 1, has);
    }
}

}  // namespace

const Struct* Manifest::find_struct(const std::string& type) const {
    for (const Struct& candidate : structs)
        if (candidate.name == type) return &candidate;
    return nullptr;
}

bool LightKind::has(const std::string& member) const {
    return std::find(members.begin(), members.end(), member) != members.end();
}

const Function* Manifest::find_function(const std::string& name) const {
    for (const Function& function : functions)
        if (function.name == name) return &function;
    for (const Manifest& earlier : given)
        if (const Function* function = earlier.find_function(name)) return function;
    return nullptr;
}

std::vector<FragmentAttribute> Manifest::attributes(const Function& model) const {
    std::vector<FragmentAttribute> out;
    const Function* light = find_function(interface.light_function);
    const auto takes = [](const Function& function, const std::string& name) {
        return std::any_of(function.arguments.begin(), function.arguments.end(),
                           [&](const Value& argument) { return argument.name == name; });
    };
    for (const FragmentAttribute& attribute : interface.fragment)
        if (takes(model, attribute.name) || (light && takes(*light, attribute.name))) out.push_back(attribute);
    return out;
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

std::vector<Column> Manifest::columns(const std::vector<Value>& values, const std::string& prefix) const {
    std::vector<Column> out;
    for (const Value& value : values) {
        const std::string path = prefix + value.name;
        if (const Struct* s = find_struct(value.type)) {
            const std::vector<Column> members = columns(s->members, path + ".");
            out.insert(out.end(), members.begin(), members.end());
            continue;
        }
        const int width = columns_of_type.at(value.type);
        for (int k = 0; k < width; ++k) out.push_back({path, k, width, value.domain, value.type});
    }
    return out;
}

std::vector<Column> Manifest::result_columns(const Function& function) const {
    return columns({{"result", function.returns, 0, 0, {"range"}}});
}

int Manifest::columns(const std::string& type) const {
    const Struct* s = find_struct(type);
    return s ? int(columns(s->members).size()) : columns_of_type.at(type);
}

Manifest load_manifest(const std::filesystem::path& directory, const std::filesystem::path& interface) {
    Manifest manifest;
    const toml::table shared = parse_toml(interface);
    TomlReader shared_root(shared, interface.string(), "");
    read_structs(shared_root, interface.string(), manifest);
    manifest.interface = read_interface(shared_root, manifest);

    const std::filesystem::path path = directory / "assignment.toml";
    const std::string file = path.string();
    const toml::table table = parse_toml(path);
    TomlReader root(table, file, "");
    manifest.directory = directory;
    manifest.name = root.string("name");
    manifest.title = root.string("title");
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
    read_functions(root, file, manifest);
    check_calls(root, manifest);
    for (TomlReader& reader : root.children("scene")) {
        const std::filesystem::path scene = std::filesystem::absolute(directory / reader.string("file"));
        manifest.scenes.push_back({std::filesystem::weakly_canonical(scene), reader.number("points", 0, Range{0})});
        reader.finish();
    }
    root.finish();
    return manifest;
}

}  // namespace shadelab
