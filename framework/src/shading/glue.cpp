#include <shadelab/glue.hpp>

#include <shadelab/describe.hpp>
#include <shadelab/error.hpp>

#include "text/templates.hpp"

#include <algorithm>
#include <fstream>
#include <sstream>

namespace shadelab {

namespace {

using Words = std::map<std::string, std::string>;

std::string join(const std::vector<std::string>& parts, const std::string& separator) {
    std::string out;
    for (size_t i = 0; i < parts.size(); ++i) out += (i ? separator : "") + parts[i];
    return out;
}

// ---- texts that both languages share

std::string struct_text(const Struct& s) {
    std::string out = "struct " + s.name + " { ";
    for (const Value& member : s.members) out += member.type + " " + member.name + "; ";
    return out + "};\n";
}

std::string prototype(const Function& function) {
    std::vector<std::string> arguments;
    for (const Value& argument : function.arguments) arguments.push_back(argument.type + " " + argument.name);
    return function.returns + " " + function.name + "(" + join(arguments, ", ") + ");\n";
}

/// The expression that rebuilds a value from its flattened columns; column(k) is the text that reads column k. The two
/// languages differ only in how a struct is constructed.
template <class Column>
std::string rebuild(const Manifest& manifest, const std::string& type, int& k, bool cpp, Column column) {
    if (type == "Real") return column(k++);
    if (type == "int") return "int(" + column(k++) + ")";
    std::vector<std::string> parts;
    if (const Struct* s = manifest.find_struct(type)) {
        for (const Value& member : s->members) parts.push_back(rebuild(manifest, member.type, k, cpp, column));
        return type + (cpp ? "{" : "(") + join(parts, ", ") + (cpp ? "}" : ")");
    }
    for (int i = 0; i < manifest.columns(type); ++i) parts.push_back(column(k++));
    return type + "(" + join(parts, ", ") + ")";
}

/// The expressions that read the columns of `value` in order.
void flatten(const Manifest& manifest, const std::string& type, const std::string& value,
             std::vector<std::string>& out) {
    if (type == "Real" || type == "int") {
        out.push_back(value);
    } else if (const Struct* s = manifest.find_struct(type)) {
        for (const Value& member : s->members) flatten(manifest, member.type, value + "." + member.name, out);
    } else {
        for (int i = 0; i < manifest.columns(type); ++i) out.push_back(value + "." + "xyzw"[i]);
    }
}

template <class Column>
std::string call_with_columns(const Manifest& manifest, const Function& function, bool cpp, Column column) {
    std::vector<std::string> arguments;
    int k = 0;
    for (const Value& argument : function.arguments)
        arguments.push_back(rebuild(manifest, argument.type, k, cpp, column));
    return function.name + "(" + join(arguments, ", ") + ")";
}

/// How the code around a call names what a fragment holds: in C++ as it is declared (the loop makes a variable for each), in
/// GLSL as the files of framework/glsl name what comes from there. Empty for what no fragment holds.
std::string fragment_variable(const Manifest& manifest, const std::string& declared, bool cpp) {
    for (const FragmentAttribute& attribute : manifest.interface.fragment)
        if (attribute.name == declared)
            return cpp ? declared : attribute.source == "normal" ? "n" : attribute.source == "position" ? "x" : "v";
    return "";
}

/// Whether the assignment declares the function itself; else an earlier one gives it.
bool is_own(const Manifest& manifest, const std::string& name) {
    return std::any_of(manifest.functions.begin(), manifest.functions.end(),
                       [&](const Function& function) { return function.name == name; });
}

/// How a loop calls one of the assignment's functions: with -DSHADELAB_FOLLOW, what is recorded stands in for it.
std::string followable(const std::string& function) { return "SHADELAB_CALL(" + function + ")"; }

/// `model(m, n, incident.l, v)`: after the material come what the fragment holds and members of what the light function gives.
std::string call_model(const Manifest& manifest, const Function& model, bool cpp) {
    std::vector<std::string> arguments = {"m"};
    for (size_t i = 1; i < model.arguments.size(); ++i) {
        const std::string& name = model.arguments[i].name;
        const std::string own = fragment_variable(manifest, name, cpp);
        arguments.push_back(own.empty() ? "incident." + name : own);
    }
    const bool followed = cpp && is_own(manifest, model.name);
    return (followed ? followable(model.name) : model.name) + "(" + join(arguments, ", ") + ")";
}

/// `incident_light(light, x)`. In C++ it is the function of that name, given or the student's own: a helper of the student's with
/// the same name does not get in the way.
std::string call_light(const Manifest& manifest, const std::string& light, bool cpp) {
    const std::string& name = manifest.interface.light_function;
    const bool own = is_own(manifest, name);
    std::vector<std::string> arguments;
    for (const Value& argument : manifest.find_function(name)->arguments)
        arguments.push_back(argument.type == "Light" ? light : fragment_variable(manifest, argument.name, cpp));
    return (!cpp ? name : own ? followable(name) : "given::" + name) + "(" + join(arguments, ", ") + ")";
}

// ---- C++

std::string assignment_header(const Manifest& manifest) {
    std::string out =
        "#pragma once\n// Generated from assignment.toml. <shadelab/shading.hpp> includes it.\n\nnamespace "
        "shadelab::glsl {\n\n";
    for (const Struct& s : manifest.structs) out += struct_text(s);
    return out + "\n}  // namespace shadelab::glsl\n";
}

/// "n_x" for "n.x": how a loop's parameter is called.
std::string parameter(std::string column) {
    std::replace(column.begin(), column.end(), '.', '_');
    return column;
}

/// The shading loops of a model, one for each kind of light, and the list of the columns that they take.
std::string model_text(const Manifest& manifest, const std::filesystem::path& folder, const Function& model) {
    const std::string material = model.arguments[0].type, member_of = model.arguments[0].name + ".";
    std::vector<Value> values;
    for (const FragmentAttribute& attribute : manifest.attributes(model)) values.push_back(attribute.value);
    const std::vector<Column> columns = manifest.columns(values);
    Words words{{"model", model.name},
                {"material", material},
                {"light_call", call_light(manifest, "light", true)},
                {"model_call", call_model(manifest, model, true)}};
    for (size_t k = 0; k < columns.size(); ++k) {
        words["columns"] += (k ? ", " : "") + ("\"" + columns[k].name() + "\"");
        words["parameters"] += ", const Real* __restrict " + parameter(columns[k].name());
        words["arguments"] += ", in[" + std::to_string(k) + "]";
    }
    if (!columns.empty()) words["columns"] += ",";
    words.try_emplace("parameters", "");
    words.try_emplace("arguments", "");
    for (const Value& value : values) {
        std::vector<std::string> parts;
        for (const Column& column : manifest.columns({value})) parts.push_back(parameter(column.name()) + "[i]");
        words["fragment"] += "        const " + value.type + " " + value.name + "(" + join(parts, ", ") + ");\n";
    }

    // Members of the material that are compiled to be columns: SHADELAB_WIDTH_... is how many columns each takes.
    std::vector<std::string> widths;
    for (const Value& member : manifest.find_struct(material)->members) {
        const std::string flag = "SHADELAB_COLUMN_" + model.name + "_" + member.name,
                          width = "SHADELAB_WIDTH_" + model.name + "_" + member.name, when = "#ifdef " + flag + "\n";
        const std::vector<Column> own = manifest.columns({member}, member_of);
        words["widths"] +=
            when + "#define " + width + " " + std::to_string(own.size()) + "\n#else\n#define " + width + " 0\n#endif\n";
        std::string names, parameters, arguments;
        std::vector<std::string> parts;
        const std::string before = std::to_string(columns.size()) + (widths.empty() ? "" : " + " + join(widths, " + "));
        for (size_t k = 0; k < own.size(); ++k) {
            names += "    \"" + own[k].name() + "\",\n";
            parameters += "    , const Real* __restrict " + parameter(own[k].name()) + "\n";
            arguments += "        , in[" + before + " + " + std::to_string(k) + "]\n";
            parts.push_back(parameter(own[k].name()) + "[i]");
        }
        words["member_columns"] += when + names + "#endif\n";
        words["member_parameters"] += when + parameters + "#endif\n";
        words["member_arguments"] += when + arguments + "#endif\n";
        words["members"] +=
            when + "        m." + member.name + " = " + member.type + "(" + join(parts, ", ") + ");\n#endif\n";
        widths.push_back(width);
    }
    words["varied"] = widths.empty() ? "0" : join(widths, " + ") + " > 0";

    std::string loops;
    std::vector<std::string> batches;
    const std::vector<LightKind>& kinds = manifest.interface.lights;
    for (size_t kind = 0; kind < kinds.size(); ++kind) {
        int k = 0, l = 0;
        words["kind"] = kinds[kind].name;
        words["kind_number"] = std::to_string(kind);
        words["rebuilt_material"] =
            rebuild(manifest, material, k, true, [](int i) { return "material[" + std::to_string(i) + "]"; });
        words["rebuilt_light"] =
            rebuild(manifest, "Light", l, true, [](int i) { return "light[" + std::to_string(i) + "]"; });
        loops += filled(folder / "loop.cpp.in", words);
        batches.push_back("batch_" + model.name + "_" + kinds[kind].name);
    }
    words["loops"] = loops;
    words["batches"] = join(batches, ", ");
    return filled(folder / "model.cpp.in", words);
}

/// What evaluates one function over a table.
std::string function_text(const Manifest& manifest, const std::filesystem::path& folder, const Function& function) {
    const size_t columns_in = manifest.columns(function.arguments).size();
    std::vector<std::string> results, parameters, arguments, write_columns, write_row;
    flatten(manifest, function.returns, "result", results);
    for (size_t k = 0; k < columns_in; ++k) {
        parameters.push_back("const Real* __restrict in" + std::to_string(k));
        arguments.push_back("in + " + std::to_string(k) + " * count");
    }
    for (size_t k = 0; k < results.size(); ++k) {
        const std::string number = std::to_string(k);
        parameters.push_back("Real* __restrict out" + number);
        arguments.push_back("out + " + number + " * count");
        write_columns.push_back("out" + number + "[i] = " + results[k] + ";");
        write_row.push_back("out[" + number + "] = " + results[k] + ";");
    }
    const auto call = [&](const auto& column) { return call_with_columns(manifest, function, true, column); };
    return filled(folder / "function.cpp.in",
                  {{"function", function.name},
                   {"returns", function.returns},
                   {"columns_in", std::to_string(columns_in)},
                   {"columns_out", std::to_string(results.size())},
                   {"column_parameters", join(parameters, ", ")},
                   {"column_arguments", join(arguments, ", ")},
                   {"call_on_columns", call([](int k) { return "in" + std::to_string(k) + "[i]"; })},
                   {"call_on_row", call([](int k) { return "in[" + std::to_string(k) + "]"; })},
                   {"write_columns", join(write_columns, " ")},
                   {"write_row", join(write_row, " ")}});
}

/// A plugin's one translation unit; it includes the student's file.
std::string plugin_text(const Manifest& manifest, const std::filesystem::path& folder) {
    const std::vector<Function> models = manifest.models();
    Words words{{"student", "shading.cpp"},
                {"light_kinds", std::to_string(manifest.interface.lights.size())},
                {"model_count", std::to_string(models.size())},
                {"function_count", std::to_string(manifest.functions.size())},
                {"given", ""},
                {"models", ""},
                {"model_table", ""},
                {"functions", ""},
                {"function_table", ""}};
    for (const Manifest& earlier : manifest.given)
        // In a namespace of its own: its helpers never clash with the student's.
        words["given"] += "namespace given {\n#include \"" +
                          std::filesystem::absolute(earlier.directory / "shading.cpp").lexically_normal().string() +
                          "\"\n}\nusing namespace given;\n";
    for (const Function& model : models) {
        words["models"] += model_text(manifest, folder, model);
        words["model_table"] += "    {\"" + model.name + "\", int(sizeof columns_" + model.name +
                                " / sizeof *columns_" + model.name + ") - 1, columns_" + model.name + ", loops_" +
                                model.name + "},\n";
    }
    for (const Function& function : manifest.functions) {
        words["functions"] += function_text(manifest, folder, function);
        words["function_table"] +=
            "    {\"" + function.name + "\", " + std::to_string(manifest.columns(function.arguments).size()) + ", " +
            std::to_string(manifest.columns(function.returns)) + ", evaluate_" + function.name + "},\n";
    }
    return filled(folder / "plugin.cpp.in", words);
}

/// For plugins with -DSHADELAB_FOLLOW: of each function f a wrapper f_followed, which asks for a recorded result first.
std::string follow_header(const Manifest& manifest) {
    std::ostringstream out;
    out << "#pragma once\n// Generated from assignment.toml: f_followed() stands in for f() where the functions "
           "or the loops call it.\n\n"
           "extern \"C\" __attribute__((visibility(\"default\"))) shadelab::plugin::Answer<Real> shadelab_follow = "
           "nullptr;\n\n";
    for (size_t index = 0; index < manifest.functions.size(); ++index) {
        const Function& function = manifest.functions[index];
        std::vector<std::string> parameters, names, inputs;
        for (const Value& argument : function.arguments) {
            parameters.push_back(argument.type + " " + argument.name);
            names.push_back(argument.name);
            flatten(manifest, argument.type, argument.name, inputs);
        }
        for (std::string& input : inputs) input = "Real(" + input + ")";
        int k = 0;
        out << prototype(function) << "[[maybe_unused]] static " << function.returns << " " << function.name
            << "_followed(" << join(parameters, ", ") << ") {\n    const Real in[] = {" << join(inputs, ", ")
            << "};\n    Real out[" << manifest.columns(function.returns)
            << "];\n    if (shadelab_follow && shadelab_follow(" << index << ", in, out)) return "
            << rebuild(manifest, function.returns, k, true, [](int i) { return "out[" + std::to_string(i) + "]"; })
            << ";\n    return " << function.name << "(" << join(names, ", ") << ");\n}\n";
    }
    return out.str();
}

// ---- GLSL

/// Whole numbers travel as floats.
std::string evaluate_main(const Manifest& manifest, const std::filesystem::path& folder, const Function& function) {
    const int columns = int(manifest.columns(function.arguments).size()), texels = (columns + 3) / 4;
    std::vector<std::string> results;
    flatten(manifest, function.returns, "result", results);
    const size_t targets = (results.size() + 3) / 4;
    results.resize(targets * 4, "0.0");
    const auto column = [](int k) { return "c" + std::to_string(k / 4) + "." + "xyzw"[k % 4]; };
    Words words{{"function", function.name},
                {"returns", function.returns},
                {"texels", std::to_string(texels)},
                {"call", call_with_columns(manifest, function, false, column)},
                {"outputs", ""},
                {"fetches", ""},
                {"writes", ""}};
    for (size_t k = 0; k < targets; ++k) {
        const std::string number = std::to_string(k);
        words["outputs"] += "layout(location = " + number + ") out vec4 shadelab_out" + number + ";\n";
        words["writes"] += "    shadelab_out" + number + " = vec4(" +
                           join({results.begin() + 4 * long(k), results.begin() + 4 * long(k) + 4}, ", ") + ");\n";
    }
    for (int k = 0; k < texels; ++k)
        words["fetches"] += "    vec4 c" + std::to_string(k) + " = texelFetch(shadelab_rows, at + ivec2(" +
                            std::to_string(k) + ", 0), 0);\n";
    return filled(folder / "evaluate.glsl", words);
}

/// Lights from a texture, and where each kind's end.
std::string light_text(const Manifest& manifest, const std::filesystem::path& folder) {
    Words words{{"lights_per_line", std::to_string(lights_per_line)},
                {"texels_per_light", std::to_string(texels_per_light)},
                {"ends", ""},
                {"fetches", ""}};
    for (const LightKind& kind : manifest.interface.lights)
        words["ends"] += "uniform float shadelab_light_end_" + kind.name + ";\n";
    for (int k = 0; k < texels_per_light; ++k)
        words["fetches"] += "    vec4 c" + std::to_string(k) + " = texelFetch(shadelab_lights, at + ivec2(" +
                            std::to_string(k) + ", 0), 0);\n";
    int column = 0;
    words["light"] = rebuild(manifest, "Light", column, false, [](int k) {
        return k == 0 ? std::string("kind") : "c" + std::to_string((k - 1) / 4) + "." + "xyzw"[(k - 1) % 4];
    });
    return filled(folder / "light_texture.glsl", words);
}

/// The uniforms and the statements that shade with every light.
struct Shading {
    std::string uniforms, body;
};

Shading shading_text(const Manifest& manifest, const std::filesystem::path& folder, const Scene& scene,
                     const Features& features, const Function& model) {
    Shading out;
    const std::string material = model.arguments[0].type;
    std::vector<std::string> members;
    out.uniforms = "uniform vec3 shadelab_eye;\n";
    for (const Value& member : manifest.find_struct(material)->members) {
        out.uniforms += "uniform " + member.type + " shadelab_material_" + member.name + ";\n";
        members.push_back("shadelab_material_" + member.name);
    }
    out.body = filled(folder / "shading.glsl", {{"material", material}, {"members", join(members, ", ")}});
    const auto add_light = [&](const std::string& light) {
        out.body += filled(folder / "light.glsl", {{"light_call", call_light(manifest, light, false)},
                                                   {"model_call", call_model(manifest, model, false)}});
    };
    const std::vector<int> lights = glsl_lights(scene, features);
    if (lights.size() > most_unrolled_lights) {
        out.uniforms += light_text(manifest, folder);
        std::string begin = "0";
        for (size_t kind = 0; kind < scene.light_kinds.size(); ++kind) {
            if (std::none_of(lights.begin(), lights.end(),
                             [&](int i) { return scene.lights[size_t(i)].kind == int(kind); }))
                continue;
            const std::string end = "int(shadelab_light_end_" + scene.light_kinds[kind] + ")";
            out.body += "    for (int i = " + begin + "; i < " + end + "; ++i) {\n";
            add_light("shadelab_light(" + std::to_string(kind) + ", i)");
            out.body += "    }\n";
            begin = end;
        }
        return out;
    }
    for (size_t i = 0; i < lights.size(); ++i) {
        const std::string light = "shadelab_light" + std::to_string(i) + "_";
        std::vector<std::string> light_members;
        for (const Value& member : manifest.find_struct("Light")->members) {
            if (member.name == "kind") {
                // Compiled in, like the number of lights: the driver pays for every kind and every turn that it cannot rule out.
                light_members.push_back(std::to_string(scene.lights[size_t(lights[i])].kind));
                continue;
            }
            out.uniforms += "uniform " + member.type + " " + light + member.name + ";\n";
            light_members.push_back(light + member.name);
        }
        add_light("Light(" + join(light_members, ", ") + ")");
    }
    return out;
}

/// What a fragment's main says of normals that cancel.
Words unit_normal(const std::filesystem::path& folder, bool normals_can_cancel) {
    return {
        {"fallback", normals_can_cancel ? filled(folder / "fallback.glsl") : ""},
        {"unit_normal", normals_can_cancel ? "shadelab_unit_normal(shadelab_n, shadelab_x)" : "normalize(shadelab_n)"}};
}

Words transform(const std::filesystem::path& folder) { return {{"transform", filled(folder / "transform.glsl")}}; }

}  // namespace

std::string glsl_prelude(const Manifest& manifest, const std::filesystem::path& framework) {
    std::string out = read_text(framework / "glsl" / "prelude.glsl") + "\n";
    for (const Struct& s : manifest.structs) out += struct_text(s);
    for (const Manifest& earlier : manifest.given)
        for (const Function& function : earlier.functions) out += prototype(function);
    for (const Function& function : manifest.functions) out += prototype(function);
    for (const Manifest& earlier : manifest.given) out += read_text(earlier.directory / "shading.glsl") + "\n";
    return out;
}

std::vector<int> glsl_lights(const Scene& scene, const Features& features) {
    std::vector<int> lights = features.lights;
    if (lights.size() > most_unrolled_lights)
        std::stable_sort(lights.begin(), lights.end(),
                         [&](int a, int b) { return scene.lights[size_t(a)].kind < scene.lights[size_t(b)].kind; });
    return lights;
}

ShaderMains glsl_shade_mains(const Manifest& manifest, const std::filesystem::path& framework, const Scene& scene,
                             const Features& features, const Function& model, Interpolation interpolation,
                             bool normals_can_cancel) {
    const std::filesystem::path folder = framework / "glsl";
    const Shading shading = shading_text(manifest, folder, scene, features, model);
    std::vector<std::string> layers = {"total"};
    if (features.term_layers) layers.insert(layers.end(), {"ambient", "diffuse", "specular"});
    std::string outputs, varyings_out, varyings_in, vertex_writes, colour_writes, fragment_writes;
    for (size_t k = 0; k < layers.size(); ++k) {
        const std::string& layer = layers[k];
        outputs += "layout(location = " + std::to_string(k) + ") out vec4 shadelab_out_" + layer + ";\n";
        varyings_out += "out vec3 shadelab_" + layer + ";\n";
        varyings_in += "in vec3 shadelab_" + layer + ";\n";
        vertex_writes += "    shadelab_" + layer + " = " + layer + ";\n";
        colour_writes += "    shadelab_out_" + layer + " = vec4(shadelab_" + layer + ", 1.0);\n";
        fragment_writes += "    shadelab_out_" + layer + " = vec4(" + layer + ", 1.0);\n";
    }
    if (interpolation == Interpolation::gouraud)
        return {filled(folder / "shade_vertex.glsl", {{"transform", filled(folder / "transform.glsl")},
                                                      {"uniforms", shading.uniforms},
                                                      {"varyings", varyings_out},
                                                      {"shading", shading.body},
                                                      {"writes", vertex_writes}}),
                filled(folder / "colours.glsl",
                       {{"varyings", varyings_in}, {"outputs", outputs}, {"writes", colour_writes}}),
                ShaderMains::vertex_stage};
    Words words = unit_normal(folder, normals_can_cancel);
    words.insert(
        {{"uniforms", shading.uniforms}, {"outputs", outputs}, {"shading", shading.body}, {"writes", fragment_writes}});
    return {filled(folder / "vertex.glsl", transform(folder)), filled(folder / "shade_fragment.glsl", words),
            ShaderMains::fragment_stage};
}

ShaderMains glsl_geometry_mains(const std::filesystem::path& framework, bool normals_can_cancel) {
    const std::filesystem::path folder = framework / "glsl";
    return {filled(folder / "vertex.glsl", transform(folder)),
            filled(folder / "geometry_fragment.glsl", unit_normal(folder, normals_can_cancel)), ShaderMains::neither};
}

ShaderMains glsl_depth_mains(const std::filesystem::path& framework) {
    const std::filesystem::path folder = framework / "glsl";
    return {filled(folder / "depth_vertex.glsl"), filled(folder / "depth_fragment.glsl"), ShaderMains::neither};
}

void write_glue(const Manifest& manifest, const std::filesystem::path& framework, const std::filesystem::path& out) {
    std::filesystem::create_directories(out / "shadelab");
    std::filesystem::create_directories(out / "evaluate");
    const auto write = [&](const std::filesystem::path& file, const std::string& text) {
        std::ofstream stream(out / file);
        stream << text;
        stream.close();
        if (!stream) throw InfrastructureError((out / file).string() + ": cannot be written; is the disk full?");
    };
    write("assignment.json", describe(manifest));
    write("shadelab/assignment.hpp", assignment_header(manifest));
    // One header, so that whoever compiles many plugins can precompile it.
    write("prelude.hpp", "#pragma once\n#include <shadelab/shading.hpp>\n#include <shadelab/plugin.hpp>\n");
    write("glue.cpp", plugin_text(manifest, framework / "glue"));
    write("follow.hpp", follow_header(manifest));
    write("prelude.glsl", glsl_prelude(manifest, framework));
    for (const Function& function : manifest.functions)
        write("evaluate/" + function.name + ".glsl", evaluate_main(manifest, framework / "glsl", function));
}

}  // namespace shadelab
