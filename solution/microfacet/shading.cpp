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
    // STUDENT BEGIN: clamp the cosine first
    // (1 - c)^5 as a product: a pow of a base that rounding made negative is not defined.
    Real x = 1.0 - clamp(c, 0.0, 1.0);
    Real x2 = x * x;
    return f0 + (1.0 - f0) * (x2 * x2 * x);
    // STUDENT END: return vec3(0.5);
}

// Fresnel's reflectance of a dielectric (glass, plastic, water), exact, for unpolarised light.
//   ior     refractive index of the inside over the outside, > 0
//   c       cosine of the angle of incidence; clamped to 0 .. 1
//   result  the mean of r_s^2 and r_p^2, with g = sqrt(ior^2 - 1 + c^2),
//           r_s = (c - g) / (c + g), r_p = (ior^2 c - g) / (ior^2 c + g);
//           1 where ior^2 - 1 + c^2 <= 0 (total reflection); 0 for ior = 1, also at c = 0
//   slide   "Cook-Torrance: the Fresnel term"
Real fresnel_dielectric(Real ior, Real c) {
    // STUDENT BEGIN: the two special cases, then the two polarisations
    if (ior == 1.0) return 0.0;
    c = clamp(c, 0.0, 1.0);
    Real i2 = ior * ior;
    Real g2 = i2 - 1.0 + c * c;
    if (g2 <= 0.0) return 1.0;
    Real g = sqrt(g2);
    // These differences lose digits near ior = 1, but no more than rounding ior itself does: no better form is needed.
    Real r_s = (c - g) / (c + g);
    Real r_p = (i2 * c - g) / (i2 * c + g);
    return 0.5 * (r_s * r_s + r_p * r_p);
    // STUDENT END: return 0.5;
}

// Fresnel's reflectance of a conductor (a metal), exact, for unpolarised light.
//   eta, k  the refractive index eta + i k, per colour: eta > 0, and k > 0, which says how fast light dies away inside
//   c       cosine of the angle of incidence; clamped to 0 .. 1
//   result  the mean of R_s and R_p, per colour, with s^2 = 1 - c^2, a + i b = sqrt((eta + i k)^2 - s^2),
//           R_s = ((a - c)^2 + b^2) / ((a + c)^2 + b^2), R_p = R_s ((a c - s^2)^2 + b^2 c^2) / ((a c + s^2)^2 + b^2 c^2)
//   slide   "Cook-Torrance: the Fresnel term"
vec3 fresnel_conductor(vec3 eta, vec3 k, Real c) {
    // STUDENT BEGIN: find a and b from a^2 - b^2 = eta^2 - k^2 - s^2 and a b = eta k, then the two polarisations
    c = clamp(c, 0.0, 1.0);
    Real c2 = c * c;
    Real s2 = 1.0 - c2;
    // 2 a^2 = sqrt(t^2 + 4 eta^2 k^2) + t and 2 b^2 = sqrt(t^2 + 4 eta^2 k^2) - t: one of the two is a difference of nearly equal
    // numbers. The larger one comes first, and the other from a b = eta k.
    vec3 t = (eta - k) * (eta + k) - s2;
    vec3 larger = sqrt(0.5 * (sqrt(t * t + 4.0 * eta * eta * k * k) + abs(t)));
    vec3 smaller = eta * k / larger;
    vec3 metallic = 0.5 - 0.5 * sign(t);  // 1 where b is the larger one
    vec3 a = mix(larger, smaller, metallic);
    vec3 b = mix(smaller, larger, metallic);
    vec3 b2 = b * b;
    vec3 r_s = ((a - c) * (a - c) + b2) / ((a + c) * (a + c) + b2);
    vec3 r_p = r_s * ((a * c - s2) * (a * c - s2) + b2 * c2) / ((a * c + s2) * (a * c + s2) + b2 * c2);
    return 0.5 * (r_s + r_p);
    // STUDENT END: return vec3(0.5);
}

// Beckmann's distribution: how many of the facets face h, for a surface whose slopes are normally distributed.
//   n, h    unit, away from the surface
//   m       roughness (root mean square slope of the facets), > 0: the larger, the wider and lower
//   result  1 / (m^2 cos^4) exp(-(tan / m)^2), cos and tan of the angle between n and h; 0 unless n.h > 0.
//           No pi in it, as in the lecture.
//   slide   "Cook-Torrance: the distribution D of the facets"
Real beckmann(vec3 n, vec3 h, Real m) {
    // STUDENT BEGIN: the horizon first, then the formula
    // As on the slide: exp(-tan2 / (m * m)) / (m * m * c * c * c * c). The stable form as in trowbridge_reitz; and one exp of
    // everything, because far from n the slide's factors are 0 and infinite.
    vec3 d = n - h;
    Real x = 0.5 * dot(d, d);
    if (x >= 1.0 || dot(n, h) <= 0.0) return 0.0;
    Real t = 1.0 / ((1.0 - x) * m);
    return exp(-x * (2.0 - x) * t * t - 2.0 * log(m) - 4.0 * log1p(-x));
    // STUDENT END: return 0.5;
}

// The geometry term: the share of light that facets in front neither keep away (shadowing) nor hide from v (masking).
//   n, l, v  unit, away from the surface
//   result   min(1, 2 (n.h)(n.v) / (v.h), 2 (n.h)(n.l) / (v.h)), h the half vector of l and v; 0 unless n.l > 0 and n.v > 0
//   slide    "Cook-Torrance: the geometry term G"
Real geometry_term(vec3 n, vec3 l, vec3 v) {
    // STUDENT BEGIN: ask about both horizons first; then the smallest of three
    Real nl = dot(n, l);
    Real nv = dot(n, v);
    if (nl <= 0.0 || nv <= 0.0) return 0.0;
    // As on the slide, with h = half_vector(l, v). For sum = l + v, v.h = |sum| / 2 and n.h = (n.l + n.v) / |sum|: no h is
    // needed, which is noise where l and v are nearly opposite.
    vec3 sum = l + v;
    return min(1.0, 4.0 * (nl + nv) * min(nl, nv) / dot(sum, sum));
    // STUDENT END: return 1.0;
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
    // STUDENT BEGIN: both horizons first; then K and its cosine. Which factor cancels?
    Real nl = dot(n, l);
    Real nv = dot(n, v);
    if (nl <= 0.0 || nv <= 0.0) return Terms(vec3(0.0), vec3(0.0), vec3(0.0));
    vec3 h = half_vector(l, v);
    // As on the slide: K = rho_s/pi * D * G * F / (nl * nv), times nl. That nl cancels, and 0/0 with it. Near the viewer's
    // horizon G has n.v as a factor, and G / nv stays finite.
    Real d = beckmann(n, h, m.m);
    vec3 f = fresnel_schlick(m.f0, dot(v, h));
    Real g = geometry_term(n, l, v);
    return Terms(vec3(0.0), m.kd * nl, m.rho_s * f * (d * (g / nv) / 3.141592653589793));
    // STUDENT END: return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}

// Two lobes over one diffuse term: many measured materials have a sharp and a wide one.
//   m        kd: diffuse colour; rho_s1, f01, m1: the first lobe; rho_s2, f02, m2: the second
//   n, l, v  unit, away from the surface
//   result   ambient 0, diffuse kd n.l (once), specular: the sum of the two lobes, each as in cook_torrance;
//            all of it is 0 unless n.l > 0 and n.v > 0
//   slide    "Measured materials: when one lobe is not enough"
Terms two_lobes(TwoLobes m, vec3 n, vec3 l, vec3 v) {
    // STUDENT BEGIN: cook_torrance does the hard part
    Terms one = cook_torrance(CookTorrance(m.kd, m.rho_s1, m.f01, m.m1), n, l, v);
    Terms two = cook_torrance(CookTorrance(vec3(0.0), m.rho_s2, m.f02, m.m2), n, l, v);
    return Terms(vec3(0.0), one.diffuse, one.specular + two.specular);
    // STUDENT END: return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
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
