#pragma once
// Small vectors of neighbouring pixels, in the width that this build's processor level has. The arithmetic is IEEE and lane by
// lane, so the width changes the speed and no bit.

#include <cstdint>
#include <cstring>

namespace shadelab {

#ifdef __AVX2__
inline constexpr int lanes = 8;
#else
inline constexpr int lanes = 4;  // eight-wide code would be split, and slowly, by the compiler
#endif

typedef float floats __attribute__((vector_size(4 * lanes)));
typedef int32_t ints __attribute__((vector_size(4 * lanes)));

template <class Vector, class Number>
[[gnu::always_inline]] inline Vector load(const Number* from) {
    Vector v;
    std::memcpy(&v, from, sizeof v);
    return v;
}

template <class Vector, class Number>
[[gnu::always_inline]] inline void store(Number* to, Vector v) {
    std::memcpy(to, &v, sizeof v);
}

typedef int32_t int4 __attribute__((vector_size(16)));  // of one triangle: its corners or edges

/// 0, 1, 2, ...
inline ints counting() {
    if constexpr (lanes == 8)
        return load<ints>((const int32_t[8]){0, 1, 2, 3, 4, 5, 6, 7});
    else
        return load<ints>((const int32_t[4]){0, 1, 2, 3});
}

inline floats to_floats(ints v) { return __builtin_convertvector(v, floats); }

}  // namespace shadelab
