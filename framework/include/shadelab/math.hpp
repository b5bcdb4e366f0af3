// exp, log, pow and their kin for float, as code that a compiler can inline and vectorise.
//
// Why not the C library's: a call to powf cannot be vectorised, so one `pow` makes a whole shading loop run one
// fragment at a time, several times slower, and glibc picks its code by CPU, so results differ between machines. These
// functions use IEEE 754 single-precision arithmetic and integer operations alone, so their results are the same bits
// on every x86-64 level, at every optimisation level and in scalar and vector code, provided that the compiler neither
// fuses
// (-ffp-contract=off) nor reorders (no -ffast-math).
//
// Largest relative error (held by tests/python/test_expressions.py):
//     exp, exp2, log     1e-7
//     expm1              2e-7      also near 0
//     log2, log1p        2.5e-7    also near 1 and near 0
//     pow(x, y)          2e-6      for any exponent to 1e6, of the x it is given, while the result is in [1e-3, 1]
// pow's error grows with |log2(result)|: 2.5e-5 at the ends of float's range. The rounding error that x comes with is
// not in these figures, and at y = 1e6 it weighs far more: where x is 1 - d, exp(y * log1p(-d)) does not have it.
//
// Special values follow IEEE 754 and C, with these simplifications, most of which GPUs share:
//     subnormal numbers count as 0, as arguments (of log, log2 and pow) and as results (of exp, exp2 and pow);
//     pow of a negative base (-0 is none) is NaN whatever the exponent; GLSL leaves it undefined;
//     pow of NaN, and pow(1, infinity), are NaN; pow(-0, y) is pow(0, y).
// Otherwise: NaN gives NaN, overflow +infinity, underflow 0; log(0) is -infinity, log of a negative number NaN;
// pow(x, 0) is 1 also for x = 0 and infinity, pow(1, y) exactly 1, pow(0, y) 0 for y > 0 and infinity for y < 0.
//
// No body has a branch or a ?:, on purpose. GCC makes control flow of ?: early on and merges it with that of its
// neighbours, and with the caller's own `if`, into shapes that its vectoriser refuses. `select` stays straight-line.

#pragma once

#include <bit>
#include <cstdint>
#include <limits>

namespace shadelab::math {

// -DSHADELAB_CALLS: calls stay calls, for programs that take longer to compile than to run.
#ifdef SHADELAB_CALLS
#define SHADELAB_INLINE inline
#define SHADELAB_INLINED
#else
#define SHADELAB_INLINE [[gnu::always_inline]] inline
#define SHADELAB_INLINED __attribute__((always_inline))
#endif

namespace detail {

// ---- made by framework/tools/fit_math.py (--check compares) ----
// clang-format off
// log((1 + s) / (1 - s)) = 2 s + s z P(z), z = s^2; relative error 8.1e-10
inline constexpr float log_tail[] = {0.666667759f, 0.399775922f, 0.298704594f};
// log2((1 + s) / (1 - s)) = s P(z), z = s^2; relative error 1.3e-08
inline constexpr float log2_odd[] = {2.88539004f, 0.961808801f, 0.576037288f, 0.444889963f};
// exp(f) - 1 = f + f^2 P(f), |f| <= ln(2) / 2; the error is expm1's, exp's is smaller; relative error 1.4e-08
inline constexpr float exp_tail[] = {0.49999997f, 0.16666542f, 0.0416675247f, 0.00836667325f, 0.00138624036f};
// 2^f = 1 + f P(f), |f| <= 1/2; relative error 3.6e-09
inline constexpr float exp2_tail[] = {
    0.693147182f, 0.240226448f, 0.0555035919f, 0.00961884111f, 0.00133911369f, 0.00015238006f};
// ln(2) in two parts: an exponent times the first is exact
inline constexpr float ln2_high = 0.693115234f, ln2_low = 3.19461833e-05f;
inline constexpr float log2_e = 1.44269502f;
// clang-format on
// ---- end of what fit_math.py makes ----

inline constexpr float infinity = std::numeric_limits<float>::infinity();
inline constexpr float nan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float smallest_normal = std::numeric_limits<float>::min();
inline constexpr float largest = std::numeric_limits<float>::max();

// Integers are unsigned because shifts and sums may wrap: out-of-range arguments make nonsense that `select` drops.
SHADELAB_INLINE constexpr std::uint32_t bits(float x) { return std::bit_cast<std::uint32_t>(x); }

SHADELAB_INLINE constexpr float from_bits(std::uint32_t i) { return std::bit_cast<float>(i); }

// `condition ? a : b` without control flow.
SHADELAB_INLINE constexpr float select(bool condition, float a, float b) {
    const std::uint32_t mask = 0u - static_cast<std::uint32_t>(condition);
    return from_bits((bits(a) & mask) | (bits(b) & ~mask));
}

template <int N>
SHADELAB_INLINE constexpr float horner(const float (&c)[N], float x) {
    float sum = c[N - 1];
    for (int i = N - 2; i >= 0; --i) {
        sum = sum * x + c[i];
    }
    return sum;
}

// The nearest integer (ties to even) as a float and as the exponent to add; both right for |x| < 2^22. At 1.5 * 2^23
// floats are one apart, so adding it rounds, and leaves the integer in the low bits.
struct Nearest {
    float value;
    std::uint32_t integer;
};

SHADELAB_INLINE constexpr Nearest nearest(float x) {
    constexpr float anchor = 12582912.0f;
    const float shifted = x + anchor;
    return {shifted - anchor, bits(shifted) - bits(anchor)};
}

// x * 2^k, by adding to x's exponent: right where x and the result are normal.
SHADELAB_INLINE constexpr float scale(float x, std::uint32_t k) { return from_bits(bits(x) + (k << 23)); }

// x = mantissa * 2^exponent with mantissa in [sqrt(1/2), sqrt(2)), so that x near 1 has exponent 0 and no cancellation
// between exponent and logarithm of the mantissa. Right for positive, finite, normal x.
struct Split {
    float mantissa;
    float exponent;
};

SHADELAB_INLINE constexpr Split split(float x) {
    constexpr std::uint32_t sqrt_half = 0x3f3504f3u;
    const std::int32_t exponent = static_cast<std::int32_t>(bits(x) - sqrt_half) >> 23;
    return {from_bits(bits(x) - (static_cast<std::uint32_t>(exponent) << 23)), static_cast<float>(exponent)};
}

// What a logarithm of x is where it is no finite number, and `result` elsewhere.
SHADELAB_INLINE constexpr float logarithm_specials(float x, float result) {
    result = select(x < smallest_normal, -infinity, result);
    result = select(x <= largest, result, x + x);  // infinity and NaN stay what they are
    return select(x < 0.0f, nan, result);
}

// log2 of a positive, finite, normal x. The form s P(s^2), s = (m - 1) / (m + 1), has m - 1 exact, so the relative
// error stays at rounding level as x goes to 1, where a lobe with a large exponent has its peak.
SHADELAB_INLINE constexpr float log2_finite(float x) {
    const Split part = split(x);
    const float s = (part.mantissa - 1.0f) / (part.mantissa + 1.0f);
    return part.exponent + s * horner(log2_odd, s * s);
}

// log(1 + f) + exponent * ln(2). With s = f / (2 + f), 2 s = f - s f: f enters exactly and the rest is small.
SHADELAB_INLINE constexpr float log_finite(float f, float exponent) {
    const float s = f / (2.0f + f);
    const float z = s * s;
    const float correction = s * (f - z * horner(log_tail, z));
    return exponent * ln2_high + (f - (correction - exponent * ln2_low));
}

// f and k with x = f + k ln(2), |f| <= ln(2) / 2.
struct Reduced {
    float f;
    Nearest k;
};

SHADELAB_INLINE constexpr Reduced reduce(float x) {
    const Nearest k = nearest(x * log2_e);
    return {(x - k.value * ln2_high) - k.value * ln2_low, k};
}

}  // namespace detail

// 2^x.
SHADELAB_INLINE constexpr float exp2(float x) {
    using namespace detail;
    const Nearest k = nearest(x);
    const float f = x - k.value;
    // Just below x = 128 the integer is 128, which no float has as exponent, but then 2^f < 1 and the sum is right.
    float result = scale(1.0f + f * horner(exp2_tail, f), k.integer);
    result = select(x < 128.0f, result, x + infinity);  // overflow and NaN
    return select(x < -126.0f, 0.0f, result);
}

// e^x.
SHADELAB_INLINE constexpr float exp(float x) {
    using namespace detail;
    const Reduced part = reduce(x);
    const float f = part.f;
    float result = scale(1.0f + (f + f * f * horner(exp_tail, f)), part.k.integer);
    result = select(x <= 88.7228317f, result, x + infinity);  // log(largest), rounded down; also NaN
    return select(x < -87.3365402f, 0.0f, result);            // log(smallest_normal), rounded up
}

// e^x - 1, accurate for x near 0.
SHADELAB_INLINE constexpr float expm1(float x) {
    using namespace detail;
    const Reduced part = reduce(x);
    const float f = part.f;
    // 2^k (e^f - 1) + (2^k - 1), at half the scale because 2^128 is no float while the result still may be one.
    const float half = scale(0.5f, part.k.integer);
    float result = 2.0f * (half * (f + f * f * horner(exp_tail, f)) + (half - 0.5f));
    result = select(x <= 88.7228317f, result, x + infinity);
    return select(x < -25.0f, -1.0f, result);
}

SHADELAB_INLINE constexpr float log2(float x) { return detail::logarithm_specials(x, detail::log2_finite(x)); }

// Natural logarithm.
SHADELAB_INLINE constexpr float log(float x) {
    using namespace detail;
    const Split part = split(x);
    return logarithm_specials(x, log_finite(part.mantissa - 1.0f, part.exponent));
}

// log(1 + x), accurate for x near 0.
SHADELAB_INLINE constexpr float log1p(float x) {
    using namespace detail;
    const float sum = 1.0f + x;
    const Split part = split(sum);
    // Near 0 take x itself and not what is left of it in the sum. Elsewhere |log| > 0.34 and the sum is good enough.
    const float f = select(part.exponent == 0.0f, x, part.mantissa - 1.0f);
    return logarithm_specials(sum, log_finite(f, part.exponent));
}

// x^y for x >= 0.
SHADELAB_INLINE constexpr float pow(float x, float y) {
    using namespace detail;
    float logarithm = log2_finite(x);
    logarithm = select(x < smallest_normal, -infinity, logarithm);
    logarithm = select(x <= largest, logarithm, x + x);
    // 0^0 and infinity^0 would be 0 * infinity here; with an exponent of 0 any finite logarithm gives 1.
    logarithm = select(y == 0.0f, 0.0f, logarithm);
    const float result = exp2(y * logarithm);
    return select(x >= 0.0f, result, nan);
}

}  // namespace shadelab::math
