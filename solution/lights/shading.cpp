// Lights: how much light reaches a surface point, and from where.
// l points from the surface towards the light; angles are radians; colours are linear.
#include <shadelab/shading.hpp>

// Distance falloff 1/(a r^2 + b r + c). (1, 0, 0) is the physical 1/r^2; the other coefficients are the lecture's "cheat".
//   abc     the coefficients, each >= 0, not all 0
//   r       distance to the light, >= 0
//   result  the factor on the light's intensity
Real distance_falloff(vec3 abc, Real r) {
    return 1.0 / ((abc.x * r + abc.y) * r + abc.z);
}

// Full inside the hotspot cone, nothing outside the falloff cone, and the smoothstep of the cosine between them.
//   axis              unit, the way the light travels
//   to_light          unit, from the surface point towards the light
//   hotspot, falloff  half-angles, hotspot <= falloff; equal ones make a step that is 1 at the angle itself
//   result            0 to 1
Real spot_attenuation(vec3 axis, vec3 to_light, Real hotspot, Real falloff) {
    Real c = -dot(axis, to_light);
    Real full = cos(hotspot), none = cos(falloff);
    if (c >= full) return 1.0;
    if (c <= none) return 0.0;
    Real t = (c - none) / (full - none);
    return t * t * (3.0 - 2.0 * t);
}

// Where a light's rays come from and how strong they are.
//   light   see Light; its position, direction and attenuation are read as its kind needs them
//   x       the surface point, world
//   result  l: unit, towards the light; e: irradiance on a surface that faces the light
//           A light at x itself has no direction: it gives nothing.
Incident incident_light(Light light, vec3 x) {
    if (light.kind == 1) return Incident(-light.direction, light.intensity);
    vec3 to_light = light.position - x;
    Real r = length(to_light);
    if (r == 0.0) return Incident(vec3(0.0), vec3(0.0));
    vec3 l = to_light / r;
    vec3 e = light.intensity * distance_falloff(light.attenuation, r);
    if (light.kind == 2) e *= spot_attenuation(light.direction, l, light.hotspot, light.falloff);
    return Incident(l, e);
}

// The cosine law: a tilted surface catches less.
//   light   what arrives, see incident_light
//   n       unit normal
//   result  irradiance on the surface
vec3 irradiance(Incident light, vec3 n) {
    return light.e * max(dot(n, light.l), 0.0);
}

// Ideal diffuse reflection.
//   kd      diffuse colour (the lecture's kd: pi is absorbed into the light)
//   e       irradiance
//   result  reflected radiance, the same in every direction
vec3 diffuse(vec3 kd, vec3 e) {
    return kd * e;
}
