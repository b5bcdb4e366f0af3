#include <shadelab/plugin_library.hpp>

#include <shadelab/error.hpp>

#include <dlfcn.h>

namespace shadelab {

PluginLibrary::PluginLibrary(const std::filesystem::path& file) {
    handle_ = dlopen(std::filesystem::absolute(file).c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!handle_) throw InfrastructureError(file.string() + ": cannot be loaded: " + dlerror());
    table_ = dlsym(handle_, plugin::symbol);
    // The leading members stand at the same place in both tables.
    if (!table_ || static_cast<const plugin::Table<float>*>(table_)->version != plugin::abi_version)
        throw InfrastructureError(file.string() + ": is not a plugin of this version; build it again");
}

PluginLibrary::~PluginLibrary() { dlclose(handle_); }

bool PluginLibrary::is_double() const {
    return static_cast<const plugin::Table<float>*>(table_)->real_size == int(sizeof(double));
}

template <class Real>
const plugin::Table<Real>& PluginLibrary::table() const {
    if (static_cast<const plugin::Table<Real>*>(table_)->real_size != int(sizeof(Real)))
        throw InfrastructureError("the plugin was compiled for the other Real");
    return *static_cast<const plugin::Table<Real>*>(table_);
}

template <class Real>
void PluginLibrary::follow(plugin::Answer<Real> answer) const {
    auto* place = static_cast<plugin::Answer<Real>*>(dlsym(handle_, plugin::follow_symbol));
    if (!place) throw InfrastructureError("the plugin was not compiled with -DSHADELAB_FOLLOW");
    *place = answer;
}

const char* PluginLibrary::trace(plugin::Trace told) const {
    auto* place = static_cast<plugin::Trace*>(dlsym(handle_, plugin::trace_symbol));
    if (!place) throw InfrastructureError("the plugin was not compiled with -DSHADELAB_TRACE");
    *place = told;
    Dl_info where;
    if (!dladdr(place, &where)) throw InfrastructureError("the plugin's address is not known");
    return static_cast<const char*>(where.dli_fbase);
}

void PluginLibrary::choose(int body) const {
    auto* place = static_cast<int*>(dlsym(handle_, plugin::chosen_symbol));
    if (!place) throw InfrastructureError("the plugin has no bodies to choose from");
    *place = body;
}

template void PluginLibrary::follow(plugin::Answer<float>) const;
template void PluginLibrary::follow(plugin::Answer<double>) const;
template const plugin::Table<float>& PluginLibrary::table() const;
template const plugin::Table<double>& PluginLibrary::table() const;

}  // namespace shadelab
