// What every shading.cpp includes first: GLSL's types and functions, in C++.
//
// In scope, without a prefix:
//     Real                                float (the checks also build your file with Real = double)
//     vec2 vec3 vec4  mat2 mat3 mat4      of Real; ivec, uvec and bvec as in GLSL. Components: v.x v.y v.z v.w,
//                                         v.r v.g v.b v.a or v[i]; no swizzles: write vec2(v.x, v.y) for GLSL's v.xy
//     radians degrees  sin cos tan  asin acos atan(y / x) atan(y, x)  sinh cosh tanh asinh acosh atanh
//     pow exp log exp2 log2 sqrt inversesqrt
//     log1p expm1                         log(1 + x) and exp(x) - 1, accurate where x is tiny; in our GLSL too
//     abs sign floor ceil trunc round roundEven fract mod min max clamp mix step smoothstep isnan isinf
//     length distance dot cross normalize faceforward reflect refract
//     lessThan lessThanEqual greaterThan greaterThanEqual equal notEqual any all  (GLSL's `not` is `not_` in C++)
//     matrixCompMult outerProduct transpose determinant inverse
//     the structs of the assignment, and the functions that you are to write
//
// Everyday GLSL arithmetic compiles unchanged: 2 * n, 2.0 * n, n / 2.0, 1 - c, v *= 2, vec3(0), vec3(1, 0.5, 2),
// max(dot(n, l), 0), clamp(x, 0.0, 1.0), clamp(v, 0, 1), mix(a, b, 0.5), pow(x, 5), pow(v, vec3(2.2)). Literals of any
// kind count as Real, except where C++ and GLSL agree on something else: 1 / 2 is 0 in both, and max(1, 2) is an int.
//
// Conventions, the same in both languages and in every assignment:
//     Direction vectors (n, l, v, h, t) are unit vectors; n, l, v and h point AWAY from the surface: l to the light, v
//     to the eye. Colours are linear RGB. Angles are radians. Nothing clamps a dot product for you.
//     normalize(vec3(0)) divides by zero and gives NaN, as in GLSL. Do not call pow with a negative base: GLSL leaves
//     it undefined, and here it is NaN in the float build, which is the graded one.
//
// Speed: in the float build all of these but the trigonometric and hyperbolic functions (they call the C library) run
// on 4 to 16 fragments at once. std::pow and the like are right but slower, and after `#include <math.h>` or `using
// namespace std` a plain pow(x, y) of two floats means std::pow.
//
// Standard headers and helper functions of your own are welcome, also with names such as `reflect`: yours win.

#pragma once

#if !defined(GLM_FORCE_INLINE) && !defined(SHADELAB_CALLS)
#define GLM_FORCE_INLINE
#endif
#include <glm/glm.hpp>

#include <cmath>
#include <type_traits>

#include <shadelab/math.hpp>

#ifndef SHADELAB_REAL
#define SHADELAB_REAL float
#endif

// A namespace of its own rather than functions at global scope, where pow would collide with C's, and rather than all
// of `shadelab`, whose other names (a scene, a mesh, a light) are none of a student's business. Every function here is
// a template, so that a student's plain function of the same name and parameters wins instead of being ambiguous.
//
// Most functions of vectors are GLM's, which argument-dependent lookup finds. Here are those of scalars, those that GLM
// would not match because of a literal's type, and those where ours vectorise and GLM's do not.
namespace shadelab {
class half;  // half.hpp, for studies
}

namespace shadelab::glsl {
using Real = SHADELAB_REAL;
}

// What the functions below are written with. Apart, so that `vec` and the like stay free for students.
namespace shadelab::gen {

using glsl::Real;
static_assert(std::is_same_v<Real, float> || std::is_same_v<Real, double> || std::is_same_v<Real, half>,
              "SHADELAB_REAL is float or double");

template <glm::length_t L>
using vec = glm::vec<L, Real>;
template <glm::length_t C, glm::length_t R>
using mat = glm::mat<C, R, Real>;

// GLM's templates want every scalar beside a vec3 to be a Real. An overload for a Number would be ambiguous with them
// for Real itself, so it is for the other ones.
template <typename T>
concept Number = std::is_arithmetic_v<T> || std::is_same_v<T, half>;
template <typename T>
concept OtherNumber = Number<T> && !std::is_same_v<T, Real>;

// The float build has its own exp, log, pow, so that they vectorise and are the same on every machine; the double build
// is there to be accurate.
inline constexpr bool own_math = std::is_same_v<Real, float>;

// GLSL has abs, sign, min, max and clamp of integers too; whatever else is mixed becomes a Real.
template <typename T>
inline constexpr bool is_integer = std::is_integral_v<T> && !std::is_same_v<T, bool>;
template <bool integers, typename... T>
struct MixedType {
    using type = Real;
};
template <typename... T>
struct MixedType<true, T...> {
    using type = std::common_type_t<T...>;
};
template <typename... T>
using Mixed = typename MixedType<(is_integer<T> && ...), T...>::type;

template <glm::length_t L, typename F>
SHADELAB_INLINE vec<L> each(const vec<L>& v, F f) {
    if constexpr (L == 2) {
        return vec<L>(f(v.x), f(v.y));
    } else if constexpr (L == 3) {
        return vec<L>(f(v.x), f(v.y), f(v.z));
    } else {
        return vec<L>(f(v.x), f(v.y), f(v.z), f(v.w));
    }
}

template <glm::length_t L, typename F>
SHADELAB_INLINE vec<L> each(const vec<L>& a, const vec<L>& b, F f) {
    if constexpr (L == 2) {
        return vec<L>(f(a.x, b.x), f(a.y, b.y));
    } else if constexpr (L == 3) {
        return vec<L>(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z));
    } else {
        return vec<L>(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z), f(a.w, b.w));
    }
}

}  // namespace shadelab::gen

namespace shadelab::glsl {

using vec2 = gen::vec<2>;
using vec3 = gen::vec<3>;
using vec4 = gen::vec<4>;
using mat2 = gen::mat<2, 2>;
using mat3 = gen::mat<3, 3>;
using mat4 = gen::mat<4, 4>;
using glm::bvec2, glm::bvec3, glm::bvec4;
using glm::ivec2, glm::ivec3, glm::ivec4;
using glm::uvec2, glm::uvec3, glm::uvec4;

// ---- functions of one number -------------------------------------------------------------------------------------

#define SHADELAB_SCALAR(NAME, EXPRESSION)    \
    template <gen::Number A>                 \
    SHADELAB_INLINE Real NAME(A a) {         \
        const Real x = static_cast<Real>(a); \
        return EXPRESSION;                   \
    }

// The vector form is more specialised than GLM's template of the same name and wins over it.
#define SHADELAB_SCALAR_AND_VECTOR(NAME, EXPRESSION)                       \
    SHADELAB_SCALAR(NAME, EXPRESSION)                                      \
    template <glm::length_t L>                                             \
    SHADELAB_INLINE gen::vec<L> NAME(const gen::vec<L>& v) {               \
        const auto f = [](Real x) SHADELAB_INLINED { return EXPRESSION; }; \
        return gen::each(v, f);                                            \
    }

#define SHADELAB_OWN(NAME) static_cast<Real>(gen::own_math ? math::NAME(static_cast<float>(x)) : std::NAME(x))
SHADELAB_SCALAR_AND_VECTOR(exp, SHADELAB_OWN(exp))
SHADELAB_SCALAR_AND_VECTOR(exp2, SHADELAB_OWN(exp2))
SHADELAB_SCALAR_AND_VECTOR(log, SHADELAB_OWN(log))
SHADELAB_SCALAR_AND_VECTOR(log2, SHADELAB_OWN(log2))
SHADELAB_SCALAR_AND_VECTOR(log1p, SHADELAB_OWN(log1p))
SHADELAB_SCALAR_AND_VECTOR(expm1, SHADELAB_OWN(expm1))
#undef SHADELAB_OWN

SHADELAB_SCALAR_AND_VECTOR(sqrt, std::sqrt(x))
SHADELAB_SCALAR_AND_VECTOR(inversesqrt, Real(1) / std::sqrt(x))
// GLSL leaves round's ties open. To even, as GPUs have it, is one instruction; std::round's away-from-zero is a call.
SHADELAB_SCALAR_AND_VECTOR(round, std::rint(x))
SHADELAB_SCALAR_AND_VECTOR(roundEven, std::rint(x))

SHADELAB_SCALAR(floor, std::floor(x))
SHADELAB_SCALAR(ceil, std::ceil(x))
SHADELAB_SCALAR(trunc, std::trunc(x))
SHADELAB_SCALAR(fract, x - std::floor(x))
SHADELAB_SCALAR(radians, static_cast<Real>(0.017453292519943295) * x)
SHADELAB_SCALAR(degrees, static_cast<Real>(57.29577951308232) * x)

// Calls of the C library: a loop that holds one does not vectorise.
SHADELAB_SCALAR(sin, std::sin(x))
SHADELAB_SCALAR(cos, std::cos(x))
SHADELAB_SCALAR(tan, std::tan(x))
SHADELAB_SCALAR(asin, std::asin(x))
SHADELAB_SCALAR(acos, std::acos(x))
SHADELAB_SCALAR(atan, std::atan(x))
SHADELAB_SCALAR(sinh, std::sinh(x))
SHADELAB_SCALAR(cosh, std::cosh(x))
SHADELAB_SCALAR(tanh, std::tanh(x))
SHADELAB_SCALAR(asinh, std::asinh(x))
SHADELAB_SCALAR(acosh, std::acosh(x))
SHADELAB_SCALAR(atanh, std::atanh(x))

#undef SHADELAB_SCALAR_AND_VECTOR
#undef SHADELAB_SCALAR

template <gen::Number A>
SHADELAB_INLINE bool isnan(A a) {
    return std::isnan(static_cast<Real>(a));
}

template <gen::Number A>
SHADELAB_INLINE bool isinf(A a) {
    return std::isinf(static_cast<Real>(a));
}

template <gen::Number A>
SHADELAB_INLINE gen::Mixed<A> abs(A a) {
    if constexpr (gen::is_integer<A>) {
        return a < A(0) ? -a : a;
    } else {
        return std::abs(static_cast<Real>(a));
    }
}

template <glm::length_t L>
SHADELAB_INLINE gen::vec<L> abs(const gen::vec<L>& v) {
    const auto f = [](Real x) SHADELAB_INLINED { return std::abs(x); };
    return gen::each(v, f);
}

// A difference of comparisons: GLM's sign keeps a loop from being vectorised. 0 for NaN.
template <gen::Number A>
SHADELAB_INLINE gen::Mixed<A> sign(A a) {
    using Result = gen::Mixed<A>;
    return static_cast<Result>(a > A(0)) - static_cast<Result>(a < A(0));
}

template <glm::length_t L>
SHADELAB_INLINE gen::vec<L> sign(const gen::vec<L>& v) {
    return gen::each(
        v, [](Real x) SHADELAB_INLINED { return static_cast<Real>(x > Real(0)) - static_cast<Real>(x < Real(0)); });
}

// ---- functions of several numbers --------------------------------------------------------------------------------

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real pow(A a, B b) {
    if constexpr (gen::own_math) {
        return math::pow(static_cast<Real>(a), static_cast<Real>(b));
    } else {
        return std::pow(static_cast<Real>(a), static_cast<Real>(b));
    }
}

template <glm::length_t L>
SHADELAB_INLINE gen::vec<L> pow(const gen::vec<L>& a, const gen::vec<L>& b) {
    const auto f = [](Real x, Real y) SHADELAB_INLINED { return glsl::pow(x, y); };
    return gen::each(a, b, f);
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real atan(A y, B x) {
    return std::atan2(static_cast<Real>(y), static_cast<Real>(x));
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real mod(A a, B b) {
    const Real x = static_cast<Real>(a), y = static_cast<Real>(b);
    return x - y * std::floor(x / y);
}

// GLSL's definitions to the letter, also for NaN: min and max return the first argument unless the second one compares
// as better.
template <gen::Number A, gen::Number B>
SHADELAB_INLINE gen::Mixed<A, B> min(A a, B b) {
    const auto x = static_cast<gen::Mixed<A, B>>(a), y = static_cast<gen::Mixed<A, B>>(b);
    return y < x ? y : x;
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE gen::Mixed<A, B> max(A a, B b) {
    const auto x = static_cast<gen::Mixed<A, B>>(a), y = static_cast<gen::Mixed<A, B>>(b);
    return x < y ? y : x;
}

template <gen::Number A, gen::Number B, gen::Number C>
SHADELAB_INLINE gen::Mixed<A, B, C> clamp(A x, B low, C high) {
    using Result = gen::Mixed<A, B, C>;
    return glsl::min(glsl::max(static_cast<Result>(x), static_cast<Result>(low)), static_cast<Result>(high));
}

template <gen::Number A, gen::Number B, gen::Number C>
SHADELAB_INLINE Real mix(A a, B b, C t) {
    return static_cast<Real>(a) * (Real(1) - static_cast<Real>(t)) + static_cast<Real>(b) * static_cast<Real>(t);
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real step(A edge, B x) {
    return static_cast<Real>(x) < static_cast<Real>(edge) ? Real(0) : Real(1);
}

template <gen::Number A, gen::Number B, gen::Number C>
SHADELAB_INLINE Real smoothstep(A edge0, B edge1, C x) {
    const Real low = static_cast<Real>(edge0), high = static_cast<Real>(edge1);
    const Real t = glsl::clamp((static_cast<Real>(x) - low) / (high - low), Real(0), Real(1));
    return t * t * (Real(3) - Real(2) * t);
}

// GLSL takes a number for a vector of one component.
template <gen::Number A>
SHADELAB_INLINE Real length(A a) {
    return std::abs(static_cast<Real>(a));
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real distance(A a, B b) {
    return std::abs(static_cast<Real>(a) - static_cast<Real>(b));
}

template <gen::Number A, gen::Number B>
SHADELAB_INLINE Real dot(A a, B b) {
    return static_cast<Real>(a) * static_cast<Real>(b);
}

// ---- vectors beside numbers that are no Real: an int, or a 2.0 in the float build --------------------------------

template <glm::length_t L, gen::OtherNumber B>
SHADELAB_INLINE gen::vec<L> min(const gen::vec<L>& a, B b) {
    return glm::min(a, static_cast<Real>(b));
}

template <glm::length_t L, gen::OtherNumber B>
SHADELAB_INLINE gen::vec<L> max(const gen::vec<L>& a, B b) {
    return glm::max(a, static_cast<Real>(b));
}

template <glm::length_t L, gen::OtherNumber B>
SHADELAB_INLINE gen::vec<L> mod(const gen::vec<L>& a, B b) {
    return glm::mod(a, static_cast<Real>(b));
}

template <glm::length_t L, gen::Number A, gen::Number B>
    requires(gen::OtherNumber<A> || gen::OtherNumber<B>)
SHADELAB_INLINE gen::vec<L> clamp(const gen::vec<L>& v, A low, B high) {
    return glm::clamp(v, static_cast<Real>(low), static_cast<Real>(high));
}

// For Real too: more specialised than GLM's, which multiplies in the type of t (2.0: double) and refuses integers.
template <glm::length_t L, gen::Number C>
SHADELAB_INLINE gen::vec<L> mix(const gen::vec<L>& a, const gen::vec<L>& b, C t) {
    return a * (Real(1) - static_cast<Real>(t)) + b * static_cast<Real>(t);
}

template <glm::length_t L, gen::OtherNumber A>
SHADELAB_INLINE gen::vec<L> step(A edge, const gen::vec<L>& v) {
    return glm::step(static_cast<Real>(edge), v);
}

template <glm::length_t L, gen::Number A, gen::Number B>
    requires(gen::OtherNumber<A> || gen::OtherNumber<B>)
SHADELAB_INLINE gen::vec<L> smoothstep(A edge0, B edge1, const gen::vec<L>& v) {
    return glm::smoothstep(static_cast<Real>(edge0), static_cast<Real>(edge1), v);
}

template <glm::length_t L, gen::OtherNumber A>
SHADELAB_INLINE gen::vec<L> refract(const gen::vec<L>& incident, const gen::vec<L>& n, A eta) {
    return glm::refract(incident, n, static_cast<Real>(eta));
}

#define SHADELAB_OPERATOR(OP)                                                  \
    template <glm::length_t L, gen::OtherNumber S>                             \
    SHADELAB_INLINE gen::vec<L> operator OP(const gen::vec<L>& v, S s) {       \
        return v OP static_cast<Real>(s);                                      \
    }                                                                          \
    template <glm::length_t L, gen::OtherNumber S>                             \
    SHADELAB_INLINE gen::vec<L> operator OP(S s, const gen::vec<L>& v) {       \
        return static_cast<Real>(s) OP v;                                      \
    }                                                                          \
    template <glm::length_t C, glm::length_t R, gen::OtherNumber S>            \
    SHADELAB_INLINE gen::mat<C, R> operator OP(const gen::mat<C, R>& m, S s) { \
        return m OP static_cast<Real>(s);                                      \
    }                                                                          \
    template <glm::length_t C, glm::length_t R, gen::OtherNumber S>            \
    SHADELAB_INLINE gen::mat<C, R> operator OP(S s, const gen::mat<C, R>& m) { \
        return static_cast<Real>(s) OP m;                                      \
    }
SHADELAB_OPERATOR(+)
SHADELAB_OPERATOR(-)
SHADELAB_OPERATOR(*)
SHADELAB_OPERATOR(/)
#undef SHADELAB_OPERATOR

}  // namespace shadelab::glsl

using namespace shadelab::glsl;

// Made from the assignment's manifest: its structs.
#if __has_include(<shadelab/assignment.hpp>)
#include <shadelab/assignment.hpp>
#endif
