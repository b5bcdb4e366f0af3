// Microfacets: what you write in C++. shading.glsl asks for the same functions in GLSL, and the two read almost alike.
//
// Everywhere: n, l, v and h are unit vectors that point AWAY from the surface (n the normal, l towards the light, v towards the
// viewer, h halfway between l and v). Colours are linear. From the assignment on Phong you are given half_vector(l, v).
#include <shadelab/shading.hpp>

// A worked example: Trowbridge and Reitz's distribution of facets (also called GGX), which has longer tails than beckmann.
// Read how it asks for the horizon first and how it finds its angles, then write yours the same way.
//   n, h    unit, away from the surface
//   m       roughness, > 0: the larger, the wider and lower
//   result  m^2 / (cos^2 (m^2 - 1) + 1)^2 with cos = n.h; 0 unless n.h > 0. As in the lecture, D times n.h adds up to pi
//           over the hemisphere, not to 1.
//   slide   "Microfacet models: the distribution D"
Real trowbridge_reitz(vec3 n, vec3 h, Real m) {
    if (dot(n, h) <= 0.0) return 0.0;  // such a facet faces into the surface: there is none
    // The formula to the letter takes 1 - cos^2, of which little is left in float32 where h comes close to n: for m = 0.001
    // the peak is noise. The distance between n and h keeps its digits, and with x = distance^2/2 = 1 - cos,
    //   sin^2 = x (2 - x),   cos^2 (m^2 - 1) + 1 = m^2 cos^2 + sin^2.
    vec3 apart = n - h;
    Real x = 0.5 * dot(apart, apart);
    Real c = max(1.0 - x, 0.0);
    Real s2 = x * (2.0 - x);
    Real root = m / (m * m * c * c + s2);
    return root * root;
}

// Schlick's approximation of Fresnel's reflectance.
//   f0      reflectance at normal incidence, 0 to 1
//   c       cosine between the light and the facet that mirrors it (v.h, which is l.h); clamped to 0 .. 1
//   result  f0 + (1 - f0) (1 - c)^5, per colour: f0 head-on, 1 at grazing angles; 1 everywhere for f0 = 1
//   slide   "Cook-Torrance: the Fresnel term"
vec3 fresnel_schlick(vec3 f0, Real c) {
    // TODO: clamp the cosine first
    return vec3(0.5);
}

// Fresnel's reflectance of a dielectric (glass, plastic, water), exact, for unpolarised light.
//   ior     refractive index of the inside over the outside, > 0
//   c       cosine of the angle of incidence; clamped to 0 .. 1
//   result  the mean of r_s^2 and r_p^2, with g = sqrt(ior^2 - 1 + c^2),
//           r_s = (c - g) / (c + g), r_p = (ior^2 c - g) / (ior^2 c + g);
//           1 where ior^2 - 1 + c^2 <= 0 (total reflection); 0 for ior = 1, also at c = 0
//   slide   "Cook-Torrance: the Fresnel term"
Real fresnel_dielectric(Real ior, Real c) {
    // TODO: the two special cases, then the two polarisations
    return 0.5;
}

// Fresnel's reflectance of a conductor (a metal), exact, for unpolarised light.
//   eta, k  the refractive index eta + i k, per colour: eta > 0, and k > 0, which says how fast light dies away inside
//   c       cosine of the angle of incidence; clamped to 0 .. 1
//   result  the mean of R_s and R_p, per colour, with s^2 = 1 - c^2, a + i b = sqrt((eta + i k)^2 - s^2),
//           R_s = ((a - c)^2 + b^2) / ((a + c)^2 + b^2), R_p = R_s ((a c - s^2)^2 + b^2 c^2) / ((a c + s^2)^2 + b^2 c^2)
//   slide   "Cook-Torrance: the Fresnel term"
vec3 fresnel_conductor(vec3 eta, vec3 k, Real c) {
    // TODO: find a and b from a^2 - b^2 = eta^2 - k^2 - s^2 and a b = eta k, then the two polarisations
    return vec3(0.5);
}

// Beckmann's distribution: how many of the facets face h, for a surface whose slopes are normally distributed.
//   n, h    unit, away from the surface
//   m       roughness (root mean square slope of the facets), > 0: the larger, the wider and lower
//   result  1 / (m^2 cos^4) exp(-(tan / m)^2), cos and tan of the angle between n and h; 0 unless n.h > 0.
//           No pi in it, as in the lecture.
//   slide   "Cook-Torrance: the distribution D of the facets"
Real beckmann(vec3 n, vec3 h, Real m) {
    // TODO: the horizon first, then the formula
    return 0.5;
}

// The geometry term: the share of light that facets in front neither keep away (shadowing) nor hide from v (masking).
//   n, l, v  unit, away from the surface
//   result   min(1, 2 (n.h)(n.v) / (v.h), 2 (n.h)(n.l) / (v.h)), h the half vector of l and v; 0 unless n.l > 0 and n.v > 0
//   slide    "Cook-Torrance: the geometry term G"
Real geometry_term(vec3 n, vec3 l, vec3 v) {
    // TODO: ask about both horizons first; then the smallest of three
    return 1.0;
}

// Cook and Torrance's model, as the lecture gives it, with a diffuse term.
//   m        kd, rho_s: diffuse and specular colour; f0: reflectance at normal incidence; m: roughness
//   n, l, v  unit, away from the surface
//   result   ambient  0
//            diffuse  kd n.l
//            specular K n.l with K = rho_s/pi D G F / ((n.l) (n.v)), D = beckmann, G = geometry_term,
//                     F = fresnel_schlick of v.h
//            All of it is 0 unless n.l > 0 and n.v > 0.
//            The framework multiplies each by the light that arrives and adds up the lights.
//   slide    "The full Cook-Torrance lobe"
Terms cook_torrance(CookTorrance m, vec3 n, vec3 l, vec3 v) {
    // TODO: both horizons first; then K and its cosine. Which factor cancels?
    return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}

// Two lobes over one diffuse term: many measured materials have a sharp and a wide one.
//   m        kd: diffuse colour; rho_s1, f01, m1: the first lobe; rho_s2, f02, m2: the second
//   n, l, v  unit, away from the surface
//   result   ambient 0, diffuse kd n.l (once), specular: the sum of the two lobes, each as in cook_torrance;
//            all of it is 0 unless n.l > 0 and n.v > 0
//   slide    "Measured materials: when one lobe is not enough"
Terms two_lobes(TwoLobes m, vec3 n, vec3 l, vec3 v) {
    // TODO: cook_torrance does the hard part
    return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}

// Already written, from here to the end: models that scenes name, made of your functions.

// Cook and Torrance's model with the physical normalisation: no surface reflects more light than it receives.
//   m, n, l, v  as for cook_torrance; kd is an albedo
//   result      the lecture's diffuse term over pi, its specular term over 4
//   slide       "The full Cook-Torrance lobe"
Terms cook_torrance_physical(CookTorrance m, vec3 n, vec3 l, vec3 v) {
    Terms t = cook_torrance(m, n, l, v);
    return Terms(vec3(0.0), t.diffuse / 3.141592653589793, t.specular / 4.0);
}

// Cook and Torrance's model with the normalisation to which published parameters of measured materials belong (Ngan, Durand
// and Matusik 2005).
//   m, n, l, v  as for cook_torrance; kd is an albedo
//   result      the lecture's diffuse term over pi, its specular term over pi
//   slide       "Measured materials: fitted parameters"
Terms cook_torrance_ngan(CookTorrance m, vec3 n, vec3 l, vec3 v) {
    Terms t = cook_torrance(m, n, l, v);
    return Terms(vec3(0.0), t.diffuse / 3.141592653589793, t.specular / 3.141592653589793);
}

// A rough metal: the physical normalisation with Fresnel's exact reflectance, and no diffuse term.
//   m        eta, k: refractive index; m: roughness
//   n, l, v  unit, away from the surface
//   result   specular D G F / (4 pi n.v); all of it is 0 unless n.l > 0 and n.v > 0
//   slide    "Cook-Torrance: the Fresnel term"
Terms metal(Metal m, vec3 n, vec3 l, vec3 v) {
    // With f0 = 1 Schlick's F is 1 everywhere: what remains of the lobe is multiplied by the exact F.
    Terms t = cook_torrance(CookTorrance(vec3(0.0), vec3(1.0), vec3(1.0), m.m), n, l, v);
    vec3 exact = fresnel_conductor(m.eta, m.k, dot(v, half_vector(l, v)));
    return Terms(vec3(0.0), vec3(0.0), t.specular * (exact / 4.0));
}

// A rough dielectric over a diffuse base, as plastic and lacquer: the physical normalisation with Fresnel's exact reflectance.
//   m        kd: albedo of the base; ior: refractive index; m: roughness
//   n, l, v  unit, away from the surface
//   result   diffuse kd/pi n.l, specular D G F / (4 pi n.v); all of it is 0 unless n.l > 0 and n.v > 0
//   slide    "Cook-Torrance: the Fresnel term"
Terms plastic(Plastic m, vec3 n, vec3 l, vec3 v) {
    Terms t = cook_torrance(CookTorrance(m.kd, vec3(1.0), vec3(1.0), m.m), n, l, v);
    Real exact = fresnel_dielectric(m.ior, dot(v, half_vector(l, v)));
    return Terms(vec3(0.0), t.diffuse / 3.141592653589793, t.specular * (exact / 4.0));
}
