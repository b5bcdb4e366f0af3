#pragma once
// A Real of 16 bits for studies of what half precision costs (GLSL's mediump on phones): float arithmetic, rounded to
// binary16 after every operation and every call of a function. float holds more than twice half's digits, so that
// + - * / and sqrt come out as a processor's own half arithmetic would have them; exp and the like are the C library's,
// rounded once. It is slow, and only its numbers are of use. A plugin of it passes for one of float: the numbers that
// go in and come out are floats that a half can hold.
//
//     -DSHADELAB_REAL=shadelab::half -include shadelab/half.hpp

#include <glm/glm.hpp>

#include <concepts>
#include <cstdint>
#include <limits>
#include <type_traits>

namespace shadelab {

class half {
public:
    half() = default;
    template <typename T>
        requires std::is_arithmetic_v<T>
    half(T x) : value_(static_cast<float>(static_cast<_Float16>(x))) {}

    // Conversions go both ways without a word, as a float's do: so std::pow and literals work. The operators are
    // templates, which fit better than a built-in operator of the two floats that this would also allow.
    operator float() const { return value_; }

    half operator-() const { return -value_; }
    half& operator+=(half b) { return *this = value_ + b.value_; }
    half& operator-=(half b) { return *this = value_ - b.value_; }
    half& operator*=(half b) { return *this = value_ * b.value_; }
    half& operator/=(half b) { return *this = value_ / b.value_; }

private:
    float value_;
};

template <typename A, typename B>
concept HalfPair = (std::same_as<A, half> && (std::same_as<B, half> || std::is_arithmetic_v<B>)) ||
                   (std::same_as<B, half> && std::is_arithmetic_v<A>);

// An operand of another type counts as a half: it is rounded first.
#define SHADELAB_HALF_OPERATOR(OP, RESULT)                                 \
    template <typename A, typename B>                                      \
        requires HalfPair<A, B>                                            \
    inline RESULT operator OP(A a, B b) {                                  \
        return static_cast<float>(half(a)) OP static_cast<float>(half(b)); \
    }
SHADELAB_HALF_OPERATOR(+, half)
SHADELAB_HALF_OPERATOR(-, half)
SHADELAB_HALF_OPERATOR(*, half)
SHADELAB_HALF_OPERATOR(/, half)
SHADELAB_HALF_OPERATOR(==, bool)
SHADELAB_HALF_OPERATOR(!=, bool)
SHADELAB_HALF_OPERATOR(<, bool)
SHADELAB_HALF_OPERATOR(>, bool)
SHADELAB_HALF_OPERATOR(<=, bool)
SHADELAB_HALF_OPERATOR(>=, bool)
#undef SHADELAB_HALF_OPERATOR

}  // namespace shadelab

// GLM asks whether a number is a floating-point one.
template <>
class std::numeric_limits<shadelab::half> {
public:
    static constexpr bool is_specialized = true, is_signed = true, is_integer = false, is_exact = false;
    static constexpr bool is_iec559 = true, has_infinity = true, has_quiet_NaN = true;
    static constexpr int radix = 2, digits = 11, min_exponent = -13, max_exponent = 16;
    static shadelab::half epsilon() { return 0x1p-10f; }
    static shadelab::half min() { return 0x1p-14f; }
    static shadelab::half max() { return 65504.0f; }
    static shadelab::half infinity() { return std::numeric_limits<float>::infinity(); }
};
