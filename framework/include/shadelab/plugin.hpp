#pragma once
// The binary interface between the prebuilt renderer and a plugin: the shared library made of one student's shading.cpp and
// the generated glue. Only plain arrays of Real cross it (float or double, as the plugin was compiled), so neither side needs
// the other's types. Structs travel as their members, flattened in the order of the manifest.

#include <cstdint>

namespace shadelab::plugin {

inline constexpr int abi_version = 2;
inline constexpr const char* symbol = "shadelab_plugin";

/// One batch of fragments, structure of arrays. `in`: one array for each of the model's columns, in its order. `out`: total.rgb
/// and, in a plugin with terms, ambient.rgb, diffuse.rgb, specular.rgb behind it; the light's contribution is added to what is
/// there.
template <class Real>
struct Batch {
    int count;
    const Real* const* in;
    Real* const* out;
};

template <class Real>
using Shade = void (*)(const Batch<Real>& batch, const Real* material, const Real* light);

template <class Real>
struct Model {
    const char* name;
    /// What its loops read of each fragment: "n.x", as interface.toml declares it, or a member of the material that is not the
    /// same everywhere, "m.kd.x" (compiled with -DSHADELAB_COLUMN_<model>_<member>).
    int column_count;
    const char* const* columns;
    /// One for each kind of light, so that no branch on the kind stands in the loop. Null: the plugin was compiled for scenes
    /// that do not need it.
    const Shade<Real>* shade;
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
    int real_size;    ///< sizeof(Real); checked before anything else is read
    int terms;        ///< 1: compiled with -DSHADELAB_TERMS=1, so that it gives the single terms beside the total
    int light_kinds;  ///< how many a model has loops for
    int model_count, function_count;
    const Model<Real>* models;
    const Function<Real>* functions;
};

// A plugin that was compiled with -DSHADELAB_FOLLOW asks before each call of one of the assignment's functions, from another or
// from a loop, whether the result is known already: follow-through, where recorded outputs stand in for a function.

inline constexpr const char* follow_symbol = "shadelab_follow";

/// `function`: its index in the table. Writes `out` and returns true, or returns false, and the function itself is called.
template <class Real>
using Answer = bool (*)(int function, const Real* in, Real* out);

// A plugin that was compiled with -DSHADELAB_TRACE tells what its functions compare (trace.hpp).

inline constexpr const char* trace_symbol = "shadelab_trace";

/// `site`: where the comparison stands in the code.
using Trace = void (*)(const void* site, double left, double right);

// A plugin of several bodies of the same functions reads here which of them it is to be: an int. For our own code.

inline constexpr const char* chosen_symbol = "shadelab_chosen";

}  // namespace shadelab::plugin
