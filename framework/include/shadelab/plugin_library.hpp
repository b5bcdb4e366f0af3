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
    /// Who is told what the plugin's functions compare. Returns an address from which each site is at a fixed distance. Throws
    /// as above.
    const char* trace(plugin::Trace told) const;

private:
    void* handle_;
    const void* table_;
};

}  // namespace shadelab
