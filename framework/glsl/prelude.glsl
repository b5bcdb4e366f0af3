// What stands before every shading.glsl, after the #version line: the counterpart of shading.hpp, for GLSL 330.

#define Real float

// log(1 + x) and exp(x) - 1, accurate where x is tiny. Near 0 they are series: log(1.0 + x) would lose the digits of x
// that the sum rounds away, and the usual repair, log(u) * x / (u - 1.0), leans on a log that is exact to the last bit
// near 1. Software GL's is not: (n.h)^q was 13 % off with it at q = 1e6.

Real log1p(Real x) {
    if (abs(x) < 0.25) {
        // 2 artanh(s); the first term left out is 2e-8 of the result
        Real s = x / (2.0 + x);
        Real z = s * s;
        return 2.0 * s * (1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z / 7.0)));
    }
    return log(1.0 + x);
}

Real expm1(Real x) {
    if (abs(x) < 0.4) {
        // Taylor's; the first term left out is 4e-8 of the result
        return x * (1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0
            + x / 5040.0))))));
    }
    return exp(x) - 1.0;
}

vec2 log1p(vec2 v) {
    return vec2(log1p(v.x), log1p(v.y));
}

vec3 log1p(vec3 v) {
    return vec3(log1p(v.x), log1p(v.y), log1p(v.z));
}

vec4 log1p(vec4 v) {
    return vec4(log1p(v.xyz), log1p(v.w));
}

vec2 expm1(vec2 v) {
    return vec2(expm1(v.x), expm1(v.y));
}

vec3 expm1(vec3 v) {
    return vec3(expm1(v.x), expm1(v.y), expm1(v.z));
}

vec4 expm1(vec4 v) {
    return vec4(expm1(v.xyz), expm1(v.w));
}
