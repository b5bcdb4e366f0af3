#include <shadelab/features.hpp>

#include <algorithm>

namespace shadelab {

Features Features::of(const Scene& scene, bool terms, bool geometry, bool full) {
    Features features;
    features.term_layers = terms || full;
    features.geometry_layers = geometry || full;
    const auto keep_if = [&](bool needed, const std::string& what, const std::string& why_needed,
                             const std::string& why_not) {
        (needed || full ? features.needed : features.left_out)
            .push_back(what + ": " +
                       (needed ? why_needed
                        : full ? "kept by --full"
                               : why_not));
        return needed || full;
    };

    const char* kinds[] = {"point", "directional", "spot"};
    for (size_t i = 0; i < scene.lights.size(); ++i)
        if (keep_if(scene.lights[i].intensity != glm::dvec3(0),
                    "light[" + std::to_string(i) + "] (" + kinds[int(scene.lights[i].kind)] + ")", "it shines",
                    "its intensity is zero"))
            features.lights.push_back(int(i));
    for (int kind = 0; kind < 3; ++kind) {
        const auto used = std::count_if(features.lights.begin(), features.lights.end(),
                                        [&](int i) { return int(scene.lights[i].kind) == kind; });
        (used > 0 ? features.needed : features.left_out)
            .push_back(std::string("code for ") + kinds[kind] +
                       " lights: " + (used > 0 ? std::to_string(used) + " in the scene" : "no such light is drawn"));
    }
    for (size_t i = 0; i < scene.materials.size(); ++i) {
        const auto users = std::count_if(scene.objects.begin(), scene.objects.end(),
                                         [&](const Object& o) { return o.material == int(i); });
        if (keep_if(users > 0, "material." + scene.materials[i].name + " (" + scene.materials[i].model + ")",
                    std::to_string(users) + (users == 1 ? " object" : " objects"), "no object uses it"))
            features.materials.push_back(int(i));
    }
    for (const Object& object : scene.objects)
        (object.interpolation == Interpolation::gouraud ? features.gouraud : features.per_fragment) = true;
    (features.per_fragment ? features.needed : features.left_out)
        .push_back(std::string("shading at fragments: ") +
                   (features.per_fragment ? "objects with interpolation = \"phong\"" : "no object asks for it"));
    (features.gouraud ? features.needed : features.left_out)
        .push_back(std::string("shading at vertices: ") +
                   (features.gouraud ? "objects with interpolation = \"gouraud\"" : "no object asks for it"));
    keep_if(terms, "layers ambient, diffuse, specular, coverage", "asked for", "nobody asked for them");
    keep_if(geometry, "layers id, depth, normal, position", "asked for", "nobody asked for them");
    features.left_out.push_back("texture coordinates and tangents: no material of this scene reads them");
    (scene.film.samples > 1 ? features.needed : features.left_out)
        .push_back(scene.film.samples > 1
                       ? std::to_string(scene.film.samples) + " coverage samples per pixel: the film asks for them"
                       : "multisampling: one sample per pixel");
    return features;
}

}  // namespace shadelab
