// Which compiled version of the stages runs: the best that the processor has, or what SHADELAB_LEVEL names.
#include "frame/levels.hpp"

#include <shadelab/error.hpp>

#include <dlfcn.h>

#include <cstdlib>

namespace shadelab {

namespace {

std::string best_level() {
#if defined(__x86_64__)
    __builtin_cpu_init();
    // Asked by feature and not by "x86-64-v3": compilers learned those names late.
    const bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    const bool v3 =
        v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                    __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                    __builtin_cpu_supports("avx512vl");
    return v4 ? "v4" : v3 ? "v3" : v2 ? "v2" : "plain";
#else
    return "plain";
#endif
}

const DrawTable& load_level(const std::string& level) {
    if (level == "plain") return plain_draw_table;
    const std::string file = SHADELAB_LEVELS_DIR "/shadelab-draw-" + level + ".so";
    void* handle = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);  // stays loaded
    const void* table = handle ? dlsym(handle, "shadelab_draw_table") : nullptr;
    if (!table) throw InfrastructureError(file + ": cannot be loaded: " + dlerror());
    return *static_cast<const DrawTable*>(table);
}

}  // namespace

std::string processor_level() {
    const std::string best = best_level();
    const char* asked = std::getenv("SHADELAB_LEVEL");
    if (!asked || !*asked) return best;
    const std::string levels = "plain v2 v3 v4", level = asked;
    const size_t at = levels.find(level);
    if (level.size() < 2 || level.find(' ') != std::string::npos || at == std::string::npos)
        throw InputError("SHADELAB_LEVEL=" + level + ": must be plain, v2, v3 or v4");
    if (at > levels.find(best))
        throw InputError("SHADELAB_LEVEL=" + level + ": this processor has " + best + " at most");
    return level;
}

template <class Real>
DrawStatistics draw(const Scene& scene, const Features& features, const std::vector<Mesh>& meshes,
                    const plugin::Table<Real>& plugin, Film& film, Workspace* workspace) {
    static const DrawTable& table = load_level(processor_level());
    FrameFacts facts{scene.camera.world_to_clip(double(film.width) / film.height), {}, {}, {}};
    for (int i : features.lights) {
        facts.lights.push_back(scene.lights[size_t(i)].flatten());
        facts.placed.push_back(scene.lights[size_t(i)].placed);
    }
    for (size_t i = 0; i < meshes.size(); ++i)
        facts.normals_can_cancel.push_back(features.normal_fallback ||
                                           normals_can_cancel(meshes[i], scene.objects[i].to_world));
    Workspace own;
    Workspace& memory = workspace ? *workspace : own;
    const plugin::Table<Real>* shading = features.depth_only || features.visibility ? nullptr : &plugin;
    if constexpr (std::is_same_v<Real, float>)
        return table.draw_float(scene, features, facts, meshes, shading, film, memory);
    else
        return table.draw_double(scene, features, facts, meshes, shading, film, memory);
}

template DrawStatistics draw(const Scene&, const Features&, const std::vector<Mesh>&, const plugin::Table<float>&,
                             Film&, Workspace*);
template DrawStatistics draw(const Scene&, const Features&, const std::vector<Mesh>&, const plugin::Table<double>&,
                             Film&, Workspace*);

}  // namespace shadelab
