#include <shadelab/features.hpp>

#include <algorithm>

namespace shadelab {

namespace {

/// What the models of the materials that are drawn take, as declared; everything where nobody knows.
std::vector<FragmentAttribute> attributes_of(const Scene& scene, const Features& features, const Manifest* manifest) {
    if (!manifest) return {{"n", "normal", {}}, {"x", "position", {}}, {"v", "eye", {}}};
    std::vector<FragmentAttribute> out;
    for (const FragmentAttribute& attribute : manifest->interface.fragment) {
        const auto takes = [&](int m) {
            const Function* model = manifest->find_model(scene.materials[size_t(m)].model);
            const std::vector<FragmentAttribute> taken = manifest->attributes(*model);
            return std::any_of(taken.begin(), taken.end(),
                               [&](const FragmentAttribute& a) { return a.name == attribute.name; });
        };
        if (std::any_of(features.materials.begin(), features.materials.end(), takes)) out.push_back(attribute);
    }
    return out;
}

std::string count(long n, const std::string& what) { return std::to_string(n) + " " + what + (n == 1 ? "" : "s"); }

}  // namespace

std::vector<std::string> Features::lines(bool needed) const {
    std::vector<std::string> out;
    for (const Decision& decision : decisions)
        if (decision.needed == needed) out.push_back(decision.what + ": " + decision.why);
    return out;
}

Features Features::of(const Scene& scene, const Request& request, const Manifest* manifest) {
    Features features;
    features.depth_only = request.depth_only;
    features.visibility = request.visibility;
    /// Enters a decision; returns whether the thing is computed, which --full and `keep` may force.
    const auto decide = [&](const std::string& name, const std::string& what, bool needed,
                            const std::string& why_needed, const std::string& why_not) {
        const bool forced = !needed && (request.full || request.keep == name);
        features.decisions.push_back({name, what,
                                      needed         ? why_needed
                                      : request.full ? "kept by --full"
                                                     : why_not,
                                      needed || forced});
        return needed || forced;
    };

    for (size_t i = 0, entry = 0; i < scene.lights.size(); ++entry) {
        const Light& light = scene.lights[i];
        const auto end = !light.grid ? scene.lights.begin() + long(i) + 1
                                     : std::find_if(scene.lights.begin() + long(i), scene.lights.end(),
                                                    [&](const Light& other) { return other.entry != light.entry; });
        const size_t many = size_t(end - scene.lights.begin()) - i;
        const std::string name = "light[" + std::to_string(entry) + "]";
        const std::string times = !light.grid ? "" : ", a grid of " + std::to_string(many);
        const bool kept = decide(name, name + " (" + scene.light_kinds[size_t(light.kind)] + times + ")",
                                 light.intensity != glm::dvec3(0), "it shines", "its intensity is zero");
        for (const size_t next = i + many; i < next; ++i)
            if (kept) features.lights.push_back(int(i));
    }
    for (size_t i = 0; i < scene.materials.size(); ++i) {
        const auto users = std::count_if(scene.objects.begin(), scene.objects.end(),
                                         [&](const Object& o) { return o.material == int(i); });
        const Material& material = scene.materials[i];
        if (decide("material." + material.name, "material." + material.name + " (" + material.model + ")", users > 0,
                   count(users, "object"), "no object uses it"))
            features.materials.push_back(int(i));
    }

    const auto drawn_with = [&](const std::string& model) {
        return std::any_of(features.materials.begin(), features.materials.end(),
                           [&](int m) { return scene.materials[size_t(m)].model == model; });
    };
    std::vector<long> lights(scene.light_kinds.size());  // of each kind
    for (int i : features.lights) ++lights[size_t(scene.lights[size_t(i)].kind)];
    std::vector<std::string> models;
    if (manifest)
        for (const Function& model : manifest->models()) models.push_back(model.name);
    const bool every_loop = request.full || request.keep == "loops";
    size_t left = 0;
    for (const std::string& model : models)
        for (size_t kind = 0; kind < lights.size(); ++kind) {
            const std::string& name = scene.light_kinds[kind];
            const bool needed = drawn_with(model) && lights[kind] > 0;
            if (needed || every_loop) features.loops.push_back(model + "_" + name);
            if (needed)
                features.decisions.push_back(
                    {"", "code: " + model + " under " + name + " lights", count(lights[kind], "light"), true});
            else
                ++left;
        }
    if (left > 0)
        decide("loops", "code: " + std::to_string(left) + " shading loops", false, "",
               "no object has the model, or no such light is drawn");

    for (const Object& object : scene.objects)
        (object.interpolation == Interpolation::gouraud ? features.gouraud : features.per_fragment) = true;
    // Of these there is nothing to keep: the scene says which way it is drawn.
    const auto note = [&](const std::string& what, bool needed, const std::string& why) {
        features.decisions.push_back({"", what, why, needed});
    };
    const std::string nobody = "no object asks for it";
    note("shading at fragments", features.per_fragment,
         features.per_fragment ? "objects with interpolation = \"phong\"" : nobody);
    note("shading at vertices", features.gouraud,
         features.gouraud ? "objects with interpolation = \"gouraud\"" : nobody);
    note("samples for coverage", scene.film.samples > 1,
         scene.film.samples > 1 ? std::to_string(scene.film.samples) + " per pixel: the film asks for them"
                                : "one per pixel is enough");
    features.term_layers = decide("terms", "layers ambient, diffuse, specular, coverage", request.terms, "asked for",
                                  "nobody asked for them");
    features.geometry_layers = decide("geometry", "layers id, depth, normal, position", request.geometry, "asked for",
                                      "nobody asked for them");
    features.surface =
        decide("surface", "normal and position of fragments", features.per_fragment || features.geometry_layers,
               features.per_fragment ? "they are shaded" : "layers show them", "colours are interpolated instead");
    features.attributes = attributes_of(scene, features, manifest);
    // Normals and positions are always computed: the fallback and what is told of values that are not finite rest on them.
    const bool takes_view = std::any_of(features.attributes.begin(), features.attributes.end(),
                                        [](const FragmentAttribute& attribute) { return attribute.source == "eye"; });
    features.view =
        decide("view", "the vector to the eye", takes_view, "a model takes it", "no model of this scene takes it");
    // Textures need no decision yet: no function can be declared that takes one, and meshes are read without coordinates.
    features.normal_fallback = request.full || request.keep == "fallback";
    return features;
}

}  // namespace shadelab
