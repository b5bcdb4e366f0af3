#include <shadelab/glue.hpp>

#include <shadelab/error.hpp>

#include <algorithm>
#include <fstream>
#include <sstream>

namespace shadelab {

namespace {

const char* kind_names[] = {"point", "directional", "spot"};

std::string join(const std::vector<std::string>& parts, const std::string& separator) {
    std::string out;
    for (size_t i = 0; i < parts.size(); ++i) out += (i ? separator : "") + parts[i];
    return out;
}

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

/// `model(m, n, incident.l, v)`: after the material struct come the fragment's values, by their conventional names.
std::string call_model(const Function& model) {
    std::vector<std::string> arguments = {"m"};
    for (size_t i = 1; i < model.arguments.size(); ++i) {
        const std::string& name = model.arguments[i].name;
        arguments.push_back(name == "l" ? "incident.l" : name);
    }
    return model.name + "(" + join(arguments, ", ") + ")";
}

/// Opens the #if round a shading loop.
std::string only(const std::string& model, int kind) {
    return "#if !defined(SHADELAB_ONLY) || defined(SHADELAB_LOOP_" + model + "_" + kind_names[kind] + ")\n";
}

/// The function of that name, given or the student's own; a helper of the student's with the same name does not get in the way.
std::string incident_light(const Manifest& manifest) {
    for (const Function& function : manifest.functions)
        if (function.name == "incident_light") return function.name;
    return "given::incident_light";
}

std::string read_text(const std::filesystem::path& file) {
    std::ifstream in(file);
    std::ostringstream text;
    text << in.rdbuf();
    if (!in) throw InputError(file.string() + ": cannot be read; does the file exist?");
    return text.str();
}

}  // namespace

std::string cpp_assignment_header(const Manifest& manifest) {
    std::string out =
        "#pragma once\n// Generated from assignment.toml. <shadelab/shading.hpp> includes it.\n\nnamespace "
        "shadelab::glsl {\n\n";
    for (const Struct& s : manifest.structs) out += struct_text(s);
    out += "\n}  // namespace shadelab::glsl\n";
    return out;
}

std::string cpp_glue(const Manifest& manifest, const std::string& student_file) {
    std::ostringstream out;
    out << "// Generated from assignment.toml: the student's file and the loops that call it, in one translation unit, "
           "so that the\n"
           "// compiler inlines the functions into the loops and vectorises them.\n"
           "#include \"prelude.hpp\"\n\n"
           "#ifndef SHADELAB_TERMS\n#define SHADELAB_TERMS 1\n#endif\n"
           "// -DSHADELAB_ONLY -DSHADELAB_LOOP_<model>_<kind> ...: of the loops those and no others.\n"
           "// -DSHADELAB_NO_FUNCTIONS: no function can be evaluated alone.\n"
           "// -DSHADELAB_COLUMNS: functions are evaluated over columns instead of rows, for measurements of their "
           "time.\n"
           "// -DSHADELAB_FOLLOW: calls among the functions are asked about first (plugin.hpp).\n\n";
    for (const Manifest& earlier : manifest.given)
        // In a namespace of its own: its helpers never clash with the student's.
        out << "namespace given {\n#include \""
            << std::filesystem::absolute(earlier.directory / "shading.cpp").lexically_normal().string()
            << "\"\n}\nusing namespace given;\n";
    out << "#ifdef SHADELAB_FOLLOW\n#include \"follow.hpp\"\n#endif\n#include \"" << student_file << "\"\n\n";

    // The arrays are restrict parameters and not members: otherwise the compiler must assume that they overlap.
    const char* inputs =
        "const Real* __restrict nx, const Real* __restrict ny, const Real* __restrict nz, const Real* __restrict xx,\n"
        "    const Real* __restrict xy, const Real* __restrict xz, const Real* __restrict vx, const Real* __restrict "
        "vy,\n"
        "    const Real* __restrict vz";
    const std::vector<std::string> terms = {"ambient", "diffuse", "specular"};
    const std::vector<Function> models = manifest.models();
    for (const Function& model : models) {
        const std::string material = model.arguments[0].type;
        for (const bool layers : {false, true}) {
            // Two loops are written and one is compiled: a plugin serves those who want the layers or those who do not.
            out << (layers ? "#else\n" : "#if !SHADELAB_TERMS\n");
            for (int kind = 0; kind < 3; ++kind) {
                out << only(model.name, kind);
                out << "__attribute__((noinline, flatten)) static void shade_" << model.name << "_" << kind_names[kind]
                    << "(\n    int count, " << inputs
                    << ",\n    Real* __restrict tr, Real* __restrict tg, Real* __restrict tb";
                if (layers)
                    for (const std::string& term : terms)
                        for (const char* c : {"r", "g", "b"}) out << ", Real* __restrict " << term << "_" << c;
                out << ",\n    const " << material << "& material, const Light& source) {\n"
                    << "    const " << material
                    << " m = material;\n    Light light = source;\n    light.kind = " << kind
                    << ";  // a constant: no branch on it stays in the loop\n"
                    << "    for (int i = 0; i < count; ++i) {\n"
                    << "        const vec3 n(nx[i], ny[i], nz[i]), x(xx[i], xy[i], xz[i]), v(vx[i], vy[i], vz[i]);\n"
                    << "        const Incident incident = " << incident_light(manifest)
                    << "(light, x);\n"
                    // Not const: GCC 12 would leave the whole loop scalar.
                    << "        Terms terms = " << call_model(model) << ";\n";
                for (const std::string& term : terms)
                    out << "        const vec3 " << term << " = terms." << term << " * incident.e;\n";
                out << "        const vec3 total = (ambient + diffuse) + specular;\n"
                    << "        tr[i] += total.x; tg[i] += total.y; tb[i] += total.z;\n";
                if (layers)
                    for (const std::string& term : terms)
                        out << "        " << term << "_r[i] += " << term << ".x; " << term << "_g[i] += " << term
                            << ".y; " << term << "_b[i] += " << term << ".z;\n";
                out << "    }\n}\n#endif\n";
            }
        }
        out << "#endif\n";
        for (int kind = 0; kind < 3; ++kind) {
            const std::string name = "shade_" + model.name + "_" + kind_names[kind];
            const auto column = [&](const char* array) {
                return [array](int k) { return std::string(array) + "[" + std::to_string(k) + "]"; };
            };
            int k = 0, l = 0;
            out << only(model.name, kind);
            out << "static void batch_" << model.name << "_" << kind_names[kind]
                << "(const shadelab::plugin::Batch<Real>& batch, const Real* material, const Real* light) noexcept {\n"
                << "    const Real* const* in = batch.in;\n    Real* const* out = batch.out;\n"
                << "    const " << material << " m = " << rebuild(manifest, material, k, true, column("material"))
                << ";\n"
                << "    const Light source = " << rebuild(manifest, "Light", l, true, column("light")) << ";\n"
                << "    " << name
                << "(batch.count, in[0], in[1], in[2], in[3], in[4], in[5], in[6], in[7], in[8], out[0], out[1], "
                   "out[2],\n"
                << "#if SHADELAB_TERMS\n        out[3], out[4], out[5], out[6], out[7], out[8], out[9], out[10], "
                   "out[11],\n#endif\n"
                << "        m, source);\n}\n#else\nstatic constexpr std::nullptr_t batch_" << model.name << "_"
                << kind_names[kind] << " = nullptr;\n#endif\n";
        }
    }

    out << "#ifndef SHADELAB_NO_FUNCTIONS\n";
    // noexcept, as the batches: a student's exception ends the process instead of passing for an error of the renderer.
    for (const Function& function : manifest.functions) {
        const int columns_in = manifest.columns(function.arguments), columns_out = manifest.columns(function.returns);
        std::vector<std::string> results;
        flatten(manifest, function.returns, "result", results);
        const auto expression = [&](const auto& column) { return call_with_columns(manifest, function, true, column); };

        // Columns: a loop like those that shade, which vectorises where the function allows it.
        std::vector<std::string> parameters, arguments;
        for (int k = 0; k < columns_in; ++k) {
            parameters.push_back("const Real* __restrict in" + std::to_string(k));
            arguments.push_back("in + " + std::to_string(k) + " * count");
        }
        for (int k = 0; k < columns_out; ++k) {
            parameters.push_back("Real* __restrict out" + std::to_string(k));
            arguments.push_back("out + " + std::to_string(k) + " * count");
        }
        out << "#ifdef SHADELAB_COLUMNS\n__attribute__((noinline, flatten)) static void columns_" << function.name
            << "(std::int64_t count, " << join(parameters, ", ") << ") {\n"
            << "    for (std::int64_t i = 0; i < count; ++i) {\n        " << function.returns
            << " result = " << expression([](int k) { return "in" + std::to_string(k) + "[i]"; }) << ";\n       ";
        for (size_t k = 0; k < results.size(); ++k) out << " out" << k << "[i] = " << results[k] << ";";
        out << "\n    }\n}\nstatic void evaluate_" << function.name
            << "(std::int64_t count, const Real* in, Real* out) noexcept {\n    columns_" << function.name << "(count, "
            << join(arguments, ", ") << ");\n}\n#else\n";

        out << "static void evaluate_" << function.name
            << "(std::int64_t count, const Real* in, Real* out) noexcept {\n"
            << "    for (std::int64_t i = 0; i < count; ++i, in += " << columns_in << ", out += " << columns_out
            << ") {\n"
            << "        const " << function.returns
            << " result = " << expression([](int k) { return "in[" + std::to_string(k) + "]"; }) << ";\n       ";
        for (size_t k = 0; k < results.size(); ++k) out << " out[" << k << "] = " << results[k] << ";";
        out << "\n    }\n}\n#endif\n";
    }

    out << "#endif\n\nstatic const shadelab::plugin::Model<Real> model_table[] = {\n";
    for (const Function& model : models) {
        out << "    {\"" << model.name << "\", {";
        for (int kind = 0; kind < 3; ++kind)
            out << (kind ? ", " : "") << "batch_" << model.name << "_" << kind_names[kind];
        out << "}},\n";
    }
    if (models.empty()) out << "    {nullptr, {nullptr, nullptr, nullptr}},\n";
    out << "};\nstatic const shadelab::plugin::Function<Real> function_table[] = {\n#ifndef SHADELAB_NO_FUNCTIONS\n";
    for (const Function& function : manifest.functions)
        out << "    {\"" << function.name << "\", " << manifest.columns(function.arguments) << ", "
            << manifest.columns(function.returns) << ", evaluate_" << function.name << "},\n";
    out << "#endif\n    {nullptr, 0, 0, nullptr},\n};\nextern \"C\" __attribute__((visibility(\"default\"))) const "
           "shadelab::plugin::Table<Real> "
           "shadelab_plugin = {\n"
        << "    shadelab::plugin::abi_version, int(sizeof(Real)), SHADELAB_TERMS, " << models.size() << ",\n"
        << "#ifdef SHADELAB_NO_FUNCTIONS\n    0,\n#else\n    " << manifest.functions.size()
        << ",\n#endif\n    model_table, function_table};\n";
    return out.str();
}

std::string cpp_follow_header(const Manifest& manifest) {
    std::ostringstream out;
    out << "#pragma once\n// Generated from assignment.toml: f_followed() stands in for f() where the functions call "
           "each "
           "other.\n\n"
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

std::string glsl_prelude(const Manifest& manifest, const std::string& shading_glsl) {
    std::string out = shading_glsl + "\n";
    for (const Struct& s : manifest.structs) out += struct_text(s);
    for (const Manifest& earlier : manifest.given)
        for (const Function& function : earlier.functions) out += prototype(function);
    for (const Function& function : manifest.functions) out += prototype(function);
    for (const Manifest& earlier : manifest.given) out += read_text(earlier.directory / "shading.glsl") + "\n";
    return out;
}

// The evaluator. `rows` holds the table, one line of texels per 1024 rows; a row takes ceil(columns / 4) neighbouring texels. Row
// 1024 y + x is evaluated at pixel (x, y) of a float framebuffer; its result fills as many RGBA targets as it needs. Whole numbers
// travel as floats.
std::string glsl_evaluate_main(const Manifest& manifest, const Function& function) {
    const int columns = manifest.columns(function.arguments), texels = (columns + 3) / 4;
    std::vector<std::string> results;
    flatten(manifest, function.returns, "result", results);
    const size_t targets = (results.size() + 3) / 4;
    results.resize(targets * 4, "0.0");
    std::ostringstream out;
    out << "uniform sampler2D shadelab_rows;\n";
    for (size_t k = 0; k < targets; ++k) out << "layout(location = " << k << ") out vec4 shadelab_out" << k << ";\n";
    out << "void main() {\n    ivec2 at = ivec2(gl_FragCoord.xy) * ivec2(" << texels << ", 1);\n";
    for (int k = 0; k < texels; ++k)
        out << "    vec4 c" << k << " = texelFetch(shadelab_rows, at + ivec2(" << k << ", 0), 0);\n";
    const auto column = [](int k) { return "c" + std::to_string(k / 4) + "." + "xyzw"[k % 4]; };
    out << "    " << function.returns << " result = " << call_with_columns(manifest, function, false, column) << ";\n";
    for (size_t k = 0; k < targets; ++k)
        out << "    shadelab_out" << k << " = vec4("
            << join({results.begin() + 4 * k, results.begin() + 4 * k + 4}, ", ") << ");\n";
    out << "}\n";
    return out.str();
}

namespace {

const char* transform_text =
    "uniform mat4 shadelab_to_clip;\nuniform mat4 shadelab_to_world;\nuniform mat3 shadelab_normal_to_world;\n"
    "in vec3 shadelab_position;\nin vec3 shadelab_normal;\n";

const char* transform_body =
    "    vec3 x = (shadelab_to_world * vec4(shadelab_position, 1.0)).xyz;\n"
    "    vec3 n = normalize(shadelab_normal_to_world * shadelab_normal);\n"
    "    gl_Position = shadelab_to_clip * vec4(shadelab_position, 1.0);\n";

// dFdx cross dFdy points to the viewer whichever way the triangle winds; facing and mirroring turn it to the mesh's outside.
const char* fallback_text =
    "uniform float shadelab_orientation;\n"
    "vec3 shadelab_unit_normal(vec3 n, vec3 x) {\n"
    "    vec3 face = cross(dFdx(x), dFdy(x)) * (gl_FrontFacing == (shadelab_orientation > 0.0) ? 1.0 : -1.0);\n"
    "    return dot(n, n) >= 1e-8 ? normalize(n) : normalize(face);\n}\n";

/// Lights from a texture. The kind is compiled in. The ends are where each kind's lights end in the list; they are uniforms, so that no
/// driver can unroll the loops, and floats, as all numbers of a packet.
std::string light_text(const Manifest& manifest) {
    std::ostringstream out;
    out << "uniform sampler2D shadelab_lights;\nuniform vec3 shadelab_light_ends;\n"
        << "Light shadelab_light(int kind, int i) {\n    ivec2 at = ivec2(i % " << lights_per_line << " * "
        << texels_per_light << ", i / " << lights_per_line << ");\n";
    for (int k = 0; k < texels_per_light; ++k)
        out << "    vec4 c" << k << " = texelFetch(shadelab_lights, at + ivec2(" << k << ", 0), 0);\n";
    int column = 0;
    const auto text = [](int k) {
        return k == 0 ? std::string("kind") : "c" + std::to_string((k - 1) / 4) + "." + "xyzw"[(k - 1) % 4];
    };
    out << "    return " << rebuild(manifest, "Light", column, false, text) << ";\n}\n";
    return out.str();
}

}  // namespace

std::vector<int> glsl_lights(const Scene& scene, const Features& features) {
    std::vector<int> lights = features.lights;
    if (lights.size() > most_unrolled_lights)
        std::stable_sort(lights.begin(), lights.end(),
                         [&](int a, int b) { return scene.lights[size_t(a)].kind < scene.lights[size_t(b)].kind; });
    return lights;
}

ShaderMains glsl_shade_mains(const Manifest& manifest, const Scene& scene, const Features& features,
                             const Function& model, Interpolation interpolation, bool normals_can_cancel) {
    std::ostringstream uniforms, body;
    const std::string material = model.arguments[0].type;
    std::vector<std::string> members;
    uniforms << "uniform vec3 shadelab_eye;\n";
    for (const Value& member : manifest.find_struct(material)->members) {
        uniforms << "uniform " << member.type << " shadelab_material_" << member.name << ";\n";
        members.push_back("shadelab_material_" + member.name);
    }
    body << "    vec3 v = normalize(shadelab_eye - x);\n    " << material << " m = " << material << "("
         << join(members, ", ") << ");\n"
         << "    vec3 ambient = vec3(0), diffuse = vec3(0), specular = vec3(0), total = vec3(0);\n    Incident "
            "incident;\n    Terms terms;\n";
    const auto add_light = [&](const std::string& light) {
        body << "    incident = incident_light(" << light << ", x);\n"
             << "    terms = " << call_model(model) << ";\n"
             << "    terms = Terms(terms.ambient * incident.e, terms.diffuse * incident.e, terms.specular * "
                "incident.e);\n"
             << "    ambient += terms.ambient; diffuse += terms.diffuse; specular += terms.specular;\n"
             << "    total += (terms.ambient + terms.diffuse) + terms.specular;\n";
    };
    const std::vector<int> lights = glsl_lights(scene, features);
    const bool looped = lights.size() > most_unrolled_lights;
    if (looped) {
        uniforms << light_text(manifest);
        std::string begin = "0";
        for (int kind = 0; kind < 3; ++kind) {
            if (std::none_of(lights.begin(), lights.end(),
                             [&](int i) { return int(scene.lights[size_t(i)].kind) == kind; }))
                continue;
            const std::string end = std::string("int(shadelab_light_ends.") + "xyz"[kind] + ")";
            body << "    for (int i = " << begin << "; i < " << end << "; ++i) {\n";
            add_light("shadelab_light(" + std::to_string(kind) + ", i)");
            body << "    }\n";
            begin = end;
        }
    }
    for (size_t i = 0; i < (looped ? 0 : lights.size()); ++i) {
        const std::string light = "shadelab_light" + std::to_string(i) + "_";
        std::vector<std::string> light_members;
        for (const Value& member : manifest.find_struct("Light")->members) {
            if (member.name == "kind") {
                // Compiled in, like the number of lights: the driver pays for every kind and every turn that it cannot rule out.
                light_members.push_back(std::to_string(int(scene.lights[size_t(lights[i])].kind)));
                continue;
            }
            uniforms << "uniform " << member.type << " " << light << member.name << ";\n";
            light_members.push_back(light + member.name);
        }
        add_light("Light(" + join(light_members, ", ") + ")");
    }

    const std::vector<std::string> layers = features.term_layers
                                                ? std::vector<std::string>{"total", "ambient", "diffuse", "specular"}
                                                : std::vector<std::string>{"total"};
    std::ostringstream outputs, write;
    for (size_t k = 0; k < layers.size(); ++k)
        outputs << "layout(location = " << k << ") out vec4 shadelab_out_" << layers[k] << ";\n";

    ShaderMains mains;
    mains.student_in_vertex = interpolation == Interpolation::gouraud;
    if (mains.student_in_vertex) {
        std::ostringstream vertex, fragment;
        vertex << transform_text << uniforms.str();
        for (const std::string& layer : layers) vertex << "out vec3 shadelab_" << layer << ";\n";
        vertex << "void main() {\n" << transform_body << body.str();
        for (const std::string& layer : layers) vertex << "    shadelab_" << layer << " = " << layer << ";\n";
        vertex << "}\n";
        for (const std::string& layer : layers) fragment << "in vec3 shadelab_" << layer << ";\n";
        fragment << outputs.str() << "void main() {\n";
        for (const std::string& layer : layers)
            fragment << "    shadelab_out_" << layer << " = vec4(shadelab_" << layer << ", 1.0);\n";
        fragment << "}\n";
        mains.vertex = vertex.str();
        mains.fragment = fragment.str();
        return mains;
    }
    mains.vertex = std::string(transform_text) + "out vec3 shadelab_x;\nout vec3 shadelab_n;\nvoid main() {\n" +
                   transform_body + "    shadelab_x = x;\n    shadelab_n = n;\n}\n";
    std::ostringstream fragment;
    fragment << uniforms.str() << "in vec3 shadelab_x;\nin vec3 shadelab_n;\n"
             << outputs.str() << (normals_can_cancel ? fallback_text : "")
             << "void main() {\n    vec3 x = shadelab_x;\n    vec3 n = "
             << (normals_can_cancel ? "shadelab_unit_normal(shadelab_n, x)" : "normalize(shadelab_n)") << ";\n"
             << body.str();
    for (const std::string& layer : layers)
        fragment << "    shadelab_out_" << layer << " = vec4(" << layer << ", 1.0);\n";
    fragment << "}\n";
    mains.fragment = fragment.str();
    return mains;
}

ShaderMains glsl_geometry_mains(bool normals_can_cancel) {
    ShaderMains mains;
    mains.student_in_vertex = false;
    mains.vertex = std::string(transform_text) + "out vec3 shadelab_x;\nout vec3 shadelab_n;\nvoid main() {\n" +
                   transform_body + "    shadelab_x = x;\n    shadelab_n = n;\n}\n";
    mains.fragment =
        std::string("uniform float shadelab_id;\nin vec3 shadelab_x;\nin vec3 shadelab_n;\n") +
        "layout(location = 0) out vec4 shadelab_normal_id;\nlayout(location = 1) out vec4 shadelab_position_depth;\n" +
        (normals_can_cancel ? fallback_text : "") + "void main() {\n    vec3 n = " +
        (normals_can_cancel ? "shadelab_unit_normal(shadelab_n, shadelab_x)" : "normalize(shadelab_n)") +
        ";\n    shadelab_normal_id = vec4(n, shadelab_id);\n"
        "    shadelab_position_depth = vec4(shadelab_x, gl_FragCoord.z);\n}\n";
    return mains;
}

ShaderMains glsl_depth_mains() {
    return {
        "uniform mat4 shadelab_to_clip;\nin vec3 shadelab_position;\nvoid main() {\n"
        "    gl_Position = shadelab_to_clip * vec4(shadelab_position, 1.0);\n}\n",
        "void main() {}\n", false};
}

void write_glue(const Manifest& manifest, const std::filesystem::path& include_folder,
                const std::filesystem::path& out) {
    std::filesystem::create_directories(out / "shadelab");
    std::filesystem::create_directories(out / "evaluate");
    const auto write = [&](const std::filesystem::path& file, const std::string& text) {
        std::ofstream stream(out / file);
        stream << text;
        stream.close();
        if (!stream) throw InfrastructureError((out / file).string() + ": cannot be written; is the disk full?");
    };
    write("shadelab/assignment.hpp", cpp_assignment_header(manifest));
    // One header, so that whoever compiles many plugins can precompile it.
    write("prelude.hpp", "#pragma once\n#include <shadelab/shading.hpp>\n#include <shadelab/plugin.hpp>\n");
    write("glue.cpp", cpp_glue(manifest, "shading.cpp"));
    write("follow.hpp", cpp_follow_header(manifest));
    write("prelude.glsl", glsl_prelude(manifest, read_text(include_folder / "shadelab" / "shading.glsl")));
    for (const Function& function : manifest.functions)
        write("evaluate/" + function.name + ".glsl", glsl_evaluate_main(manifest, function));
}

}  // namespace shadelab
