// __TITLE__: what you write in C++. shading.glsl asks for the same functions in GLSL, and the two read almost alike.
//
// Everywhere: n, l and v are unit vectors that point AWAY from the surface (n the normal, l towards the light, v towards the
// viewer). Colours are linear.
#include <shadelab/shading.hpp>

// A worked example: a finished function. Read how it treats the case that its contract names, then write yours the same way.
//
// The cosine of a surface that light reaches from above only.
//   n, l    unit, away from the surface
//   result  n.l, clamped at 0
//   slide   none: it is the cosine law of the first assignment
Real lit_cosine(vec3 n, vec3 l) {
    return max(dot(n, l), 0.0);
}

// Wrapped lighting: the light reaches around the body, so that its dark side begins later, and softly.
//   n, l    unit, away from the surface
//   wrap    from 0 (the plain cosine) to 1 (only the point that faces away is dark)
//   result  (n.l + wrap)/(1 + wrap), clamped at 0; 1 where the light stands upright, for every wrap
//   slide   "Wrapped lighting"
Real wrapped_cosine(vec3 n, vec3 l, Real wrap) {
    // STUDENT BEGIN: move the cosine up by wrap, scale it so that its largest value is 1 again, and clamp it
    Real moved = dot(n, l) + wrap;
    return max(moved, 0.0) / (1.0 + wrap);
    // STUDENT END: return 0.0;
}

// The model: a diffuse surface under wrapped light.
//   m        kd: diffuse colour; wrap: see wrapped_cosine
//   n, l, v  unit, away from the surface (v does not matter)
//   result   diffuse: kd times wrapped_cosine; no ambient and no specular term.
//            The framework multiplies by the light that arrives and adds up the lights.
//   slide    "Wrapped lighting"
Terms __NAME___shading(__STRUCT__ m, vec3 n, vec3 l, vec3 v) {
    // STUDENT BEGIN: one term; wrapped_cosine does the hard part
    return Terms(vec3(0.0), m.kd * wrapped_cosine(n, l, m.wrap), vec3(0.0));
    // STUDENT END: return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}
