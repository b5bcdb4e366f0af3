// The same two lobes in several forms: equal on paper, far apart in float32. studies/lobe-forms.toml says which are compared.
//
// n, h, l and v are unit vectors as far as rounding lets them be. There are no gates: the study's inputs lie in the lobe.
#include <shadelab/shading.hpp>

// ---- (n.h)^q ----

// The slide's formula, twice. Near the peak n.h = 1 - d^2/2 keeps few of d's digits, and the exponent multiplies that loss by q.
// The C library's pow is a call, one fragment at a time; the framework's is inlined, and a loop around it vectorises.
Real power_std(vec3 n, vec3 h, Real q) { return std::pow(max(dot(n, h), 0.0), q); }

Real power_own(vec3 n, vec3 h, Real q) { return pow(max(dot(n, h), 0.0), q); }

Real power_log(vec3 n, vec3 h, Real q) { return exp(q * log(max(dot(n, h), 0.0))); }

// sin = |n x h| keeps more: each component is a difference of products that rounding has touched.
Real power_cross(vec3 n, vec3 h, Real q) {
    vec3 s = cross(n, h);
    return exp(0.5 * q * log1p(-dot(s, s)));
}

// n - h is exact where h comes close to n (two floats within a factor of two of each other), and 1 - cos = |n - h|^2/2.
Real power_distance(vec3 n, vec3 h, Real q) {
    vec3 d = n - h;
    return exp(q * log1p(-0.5 * dot(d, d)));
}

// ---- Beckmann's distribution: 1 / (m^2 cos^4) exp(-(tan / m)^2) ----

Real beckmann_cosine(vec3 n, vec3 h, Real m) {
    Real c2 = dot(n, h) * dot(n, h);
    return exp((c2 - 1.0) / (m * m * c2)) / (m * m * c2 * c2);
}

Real beckmann_angle(vec3 n, vec3 h, Real m) {
    Real c = min(dot(n, h), 1.0);
    Real t = tan(acos(c)) / m;
    return exp(-t * t) / (m * m * c * c * c * c);
}

Real beckmann_cross(vec3 n, vec3 h, Real m) {
    vec3 s = cross(n, h);
    Real s2 = dot(s, s);
    Real c2 = 1.0 - s2;
    return exp(-s2 / (m * m * c2)) / (m * m * c2 * c2);
}

// One exp of everything, as in the assignment's solution: far from n the factors would be 0 and infinite.
Real beckmann_distance(vec3 n, vec3 h, Real m) {
    vec3 d = n - h;
    Real x = 0.5 * dot(d, d);
    Real t = 1.0 / ((1.0 - x) * m);
    return exp(-x * (2.0 - x) * t * t - 2.0 * log(m) - 4.0 * log1p(-x));
}

// ---- the same, given l and v: h is a rounded vector before any form begins ----

vec3 half_vector(vec3 l, vec3 v) { return normalize(l + v); }

Real power_std_lv(vec3 n, vec3 l, vec3 v, Real q) { return power_std(n, half_vector(l, v), q); }
Real power_own_lv(vec3 n, vec3 l, vec3 v, Real q) { return power_own(n, half_vector(l, v), q); }
Real power_log_lv(vec3 n, vec3 l, vec3 v, Real q) { return power_log(n, half_vector(l, v), q); }
Real power_cross_lv(vec3 n, vec3 l, vec3 v, Real q) { return power_cross(n, half_vector(l, v), q); }
Real power_distance_lv(vec3 n, vec3 l, vec3 v, Real q) { return power_distance(n, half_vector(l, v), q); }
Real beckmann_cosine_lv(vec3 n, vec3 l, vec3 v, Real m) { return beckmann_cosine(n, half_vector(l, v), m); }
Real beckmann_angle_lv(vec3 n, vec3 l, vec3 v, Real m) { return beckmann_angle(n, half_vector(l, v), m); }
Real beckmann_cross_lv(vec3 n, vec3 l, vec3 v, Real m) { return beckmann_cross(n, half_vector(l, v), m); }
Real beckmann_distance_lv(vec3 n, vec3 l, vec3 v, Real m) { return beckmann_distance(n, half_vector(l, v), m); }
