// Lights: what you write in GLSL. shading.cpp asks for the same functions in C++, and the two read almost alike.
// No #version and no main: the framework puts them around this file.
//
// Everywhere: l (towards the light) and n (the normal) are unit vectors that point AWAY from the surface; a light's own direction
// is the way in which its light TRAVELS. Angles are radians, colours and intensities linear RGB.

// A worked example: it is finished, graded nowhere, and not used by the scenes. Read how it starts with its contract (what it is
// for, each argument with its unit and range, the result), names the steps as the contract does and says why it is written this
// way; then write yours the same way. Its twin in the other language reads almost alike.
//
// Another renderer's distance falloff (POV-Ray's fade_distance and fade_power).
//   r              distance to the light, >= 0
//   fade_distance  the distance at which the result is 1, > 0; in the unit of r
//   fade_power     how fast the light fades beyond it, > 0; 2 is usual
//   result         2 at the light itself, 1 at r = fade_distance, towards 0 far away
//   slide          none; compare "Point light sources, 1/r^2 and the cheat 1/(a r^2 + b r + c)"
Real distance_fade(Real r, Real fade_distance, Real fade_power) {
    // A ratio has no unit, and it stays within range where r^fade_power and fade_distance^fade_power each would not.
    Real ratio = r / fade_distance;
    return 2.0 / (1.0 + pow(ratio, fade_power));
}

// Distance falloff: the physical 1/r^2 for (1, 0, 0); the other coefficients are the lecture's "cheat", for softer lights.
//   abc     the coefficients a, b, c, each >= 0, not all 0
//   r       distance to the light, >= 0; > 0 where c is 0
//   result  1/(a r^2 + b r + c), the factor on the light's intensity
//   slide   "Point light sources, 1/r^2 and the cheat 1/(a r^2 + b r + c)"
Real distance_falloff(vec3 abc, Real r) {
    // TODO: one over a r^2 + b r + c; a, b and c are abc.x, abc.y and abc.z
    return 1.0;
}

// A spotlight's factor: full inside of the hotspot cone, nothing outside of the falloff cone, a smooth ramp between them.
//   axis              unit, the way the light travels along the middle of the cone
//   to_light          unit, from the surface point towards the light
//   hotspot, falloff  half-angles of the cones, radians, 0 <= hotspot <= falloff
//   result            0 to 1. Between the cones 3 t^2 - 2 t^3, where t runs from 0 to 1 as the cosine of the angle to the axis
//                     runs from cos(falloff) to cos(hotspot). Equal angles make a step that is 1 at the angle itself.
//   slide             "Spotlights: hotspot and falloff"
Real spot_attenuation(vec3 axis, vec3 to_light, Real hotspot, Real falloff) {
    // TODO: compare cosines: is the point inside of the hotspot cone, outside of the falloff cone, or between them?
    return 1.0;
}

// Where a light's rays come from and how strong they are.
//   light   kind (0 point, 1 directional, 2 spot); intensity; point and spot: position, attenuation (a, b, c of
//           distance_falloff); directional and spot: direction, unit, the way the light travels; spot: hotspot, falloff, radians
//   x       the surface point, in the scene's coordinates
//   result  l  unit, from x towards the light
//           e  irradiance on a surface that faces the light: intensity times distance_falloff (point and spot) times
//              spot_attenuation (spot)
//           A light at x itself has no direction: l and e are vec3(0). A directional light is nowhere: it has no distance.
//   slide   "Incoming irradiance for point, directional and spot lights"
Incident incident_light(Light light, vec3 x) {
    // TODO: the directional light first; then direction and distance from x, the falloff, and for a spot its factor
    return Incident(vec3(0.0, 1.0, 0.0), vec3(0.5));
}

// The cosine law: a tilted surface catches less.
//   light   what arrives: l, unit, towards the light, and e, the irradiance on a surface that faces it (see incident_light)
//   n       unit, the surface's normal
//   result  irradiance on the surface: e times n.l, clamped at 0 (light from below does not count)
//   slide   "The cosine law"
vec3 irradiance(Incident light, vec3 n) {
    // TODO: e times the cosine of the angle between n and l; what is the least that it may be?
    return light.e;
}

// Ideal diffuse reflection: the same in every direction, so no direction is an argument.
//   kd      diffuse colour, each component from 0 to 1 (the lecture's kd: a 1/pi is absorbed into the light)
//   e       irradiance on the surface, >= 0; it may well exceed 1
//   result  what is reflected towards the viewer: kd times e, colour by colour
//   slide   "Ideal diffuse reflectance"
vec3 diffuse(vec3 kd, vec3 e) {
    // TODO: kd and e, component by component
    return 0.5 * e;
}

// Already written: the two materials of the scenes. The framework gives them n, l and v at a surface point, multiplies what they
// return by the e of your incident_light and adds up the lights. So they ask your irradiance about a light of e = 1.

// The lecture's diffuse material.
//   m        kd: diffuse colour
//   n, l, v  unit, away from the surface: the normal, towards the light, towards the viewer (v does not matter)
//   result   diffuse: kd times the cosine; no ambient and no specular term
//   slide    "Ideal diffuse reflectance"
Terms lambert(Lambert m, vec3 n, vec3 l, vec3 v) {
    return Terms(vec3(0.0), diffuse(m.kd, irradiance(Incident(l, vec3(1.0)), n)), vec3(0.0));
}

// The same with kd as an albedo: the share of the arriving light that leaves again, in all directions together. The same light
// spread over the half sphere is 1/pi as much in each direction.
//   m        kd: albedo
//   n, l, v  unit, away from the surface
//   result   as for lambert, divided by pi
//   slide    "Ideal diffuse reflectance"
Terms lambert_physical(Lambert m, vec3 n, vec3 l, vec3 v) {
    const Real pi = 3.141592653589793;
    return Terms(vec3(0.0), diffuse(m.kd / pi, irradiance(Incident(l, vec3(1.0)), n)), vec3(0.0));
}
