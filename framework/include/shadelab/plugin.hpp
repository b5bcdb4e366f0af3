#pragma once
// The binary interface between the prebuilt renderer and a plugin: the shared library made of one student's shading.cpp and
// the generated glue. Only plain arrays of Real cross it (float or double, as the plugin was compiled), so neither side needs
// the other's types. Structs travel as their members, flattened in the order of the manifest.

#include <cstdint>

namespace shadelab::plugin {

inline constexpr int abi_version = 1;
inline constexpr int light_kinds = 3;
inline constexpr const char* symbol = "shadelab_plugin";

/// One batch of fragments, structure of arrays. `in`: n.xyz, x.xyz (world position), v.xyz. `out`: total.rgb and, in a plugin
/// with terms, ambient.rgb, diffuse.rgb, specular.rgb behind it; the light's contribution is added to what is there.
template <class Real>
struct Batch {
    int count;
    const Real* in[9];
    Real* out[12];
};

template <class Real>
struct Model {
    const char* name;
    /// One entry per light kind (0 point, 1 directional, 2 spot), so that no branch on the kind stands in the loop. Null: the
    /// plugin was compiled for scenes that do not need it.
    void (*shade[light_kinds])(const Batch<Real>& batch, const Real* material, const Real* light);
};

template <class Real>
struct Function {
    const char* name;
    int columns_in, columns_out;
    /// Evaluates `count` rows: row-major, columns as declared in the manifest; ints travel as whole Reals.
    void (*evaluate)(std::int64_t count, const Real* in, Real* out);
};

template <class Real>
struct Table {
    int version;
    int real_size;  ///< sizeof(Real); checked before anything else is read
    int terms;      ///< 1: compiled with -DSHADELAB_TERMS=1, so that it gives the single terms beside the total
    int model_count, function_count;
    const Model<Real>* models;
    const Function<Real>* functions;
};

// A plugin that was compiled with -DSHADELAB_FOLLOW asks before each call from one function of the assignment to another whether
// the result is known already: follow-through, where outputs that were recorded elsewhere stand in for a function.

inline constexpr const char* follow_symbol = "shadelab_follow";

/// `function`: its index in the table. Writes `out` and returns true, or returns false, and the function itself is called.
template <class Real>
using Answer = bool (*)(int function, const Real* in, Real* out);

}  // namespace shadelab::plugin
