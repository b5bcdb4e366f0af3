#pragma once

#include <shadelab/plugin.hpp>

#include <filesystem>
#include <memory>

namespace shadelab {

/// A loaded plugin. The table lives as long as this object.
class PluginLibrary {
public:
    /// Throws InfrastructureError when the file is not a plugin of this version.
    explicit PluginLibrary(const std::filesystem::path& file);
    ~PluginLibrary();
    PluginLibrary(const PluginLibrary&) = delete;

    bool is_double() const;
    template <class Real>
    const plugin::Table<Real>& table() const;
    /// Whom the plugin asks before it calls a function. Throws InfrastructureError when it was not compiled for that.
    template <class Real>
    void follow(plugin::Answer<Real> answer) const;
    /// Who is told what the plugin's functions compare. Returns where the plugin begins in memory: a site less this is its
    /// address in the file. Throws as above.
    const char* trace(plugin::Trace told) const;
    /// Which of several bodies it is from now on. Throws as above.
    void choose(int body) const;

private:
    void* handle_;
    const void* table_;
};

}  // namespace shadelab
