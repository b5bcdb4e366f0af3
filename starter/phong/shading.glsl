// The Phong model: what you write in GLSL. shading.cpp asks for the same functions in C++, and the two read almost alike.
// No #version and no main: the framework puts them around this file.
//
// Everywhere: n, l and v are unit vectors that point AWAY from the surface (n the normal, l towards the light, v towards the
// viewer). Colours are linear. A dot product that is negative means "from below": clamp it at 0.

// A worked example: a finished function. Read how it treats each case that its contract names, then write yours the same way.
//
// The retro-reflective lobe: light goes back to where it came from, as on road signs and in cats' eyes.
//   n, l, v  unit, away from the surface
//   q        exponent, >= 0: the larger, the narrower the beam that comes back
//   result   (v.l)^q, v.l clamped at 0; 0 unless n.l > 0 (a light below the surface sends nothing back); 1 for q = 0 even
//            where v.l = 0
//   slide    none: the form is Phong's, with l itself in the place of its mirror direction
Real retro_lobe(vec3 n, vec3 l, vec3 v, Real q) {
    // First the gate. It asks where the light is, and nothing else.
    if (dot(l, n) <= 0.0) return 0.0;
    // The clamp is a case of its own, because pow(0.0, 0.0) is undefined in GLSL. Here only q = 0 gives more than 0.
    Real c = dot(v, l);
    if (c <= 0.0) return q == 0.0 ? 1.0 : 0.0;
    // What is left is the formula. Both vectors are unit vectors: their dot product is the cosine, and at most 1.
    return pow(c, q);
}

// The mirror direction r of l about n.
//   l, n    unit, away from the surface
//   result  unit, away from the surface; n lies halfway between l and r
//   slide   "Ideal specular reflectance: how to compute the mirror direction"
vec3 mirror_direction(vec3 l, vec3 n) {
    // TODO: twice the part of l along n, minus l
    return vec3(0.0);
}

// The half vector h: the normal that a tiny mirror would need to reflect l into v.
//   l, v    unit, away from the surface
//   result  unit; vec3(0) when l and v are exactly opposite
//   slide   "Blinn-Torrance variation of Phong: the half-vector"
vec3 half_vector(vec3 l, vec3 v) {
    // TODO: the unit vector halfway between l and v
    return vec3(0.0);
}

// Phong's specular lobe: how much of the mirrored light goes towards v.
//   n, l, v  unit, away from the surface
//   q        exponent, >= 0: the larger, the smaller and sharper the highlight
//   result   (v.r)^q with r the mirror direction, v.r clamped at 0; 0 unless n.l > 0 (a light below the surface gives no
//            highlight); 1 for q = 0 even where v.r = 0
//   slide    "The Phong model: specular term"
Real phong_lobe(vec3 n, vec3 l, vec3 v, Real q) {
    // TODO: first ask whether the light is above the surface; then raise the clamped cosine to q
    return 0.0;
}

// The half-vector lobe (Blinn, after Torrance): large where h comes close to n.
//   n, l, v  unit, away from the surface
//   q        exponent, >= 0
//   result   (n.h)^q, n.h clamped at 0; 0 unless n.l > 0; 1 for q = 0 even where n.h = 0
//   slide    "Blinn-Torrance variation of Phong"
Real blinn_lobe(vec3 n, vec3 l, vec3 v, Real q) {
    // TODO: as phong_lobe, with the cosine between n and the half vector
    return 0.0;
}

// The complete Phong model, as the lecture gives it.
//   m        ka, kd, ks: ambient, diffuse and specular colour; q: exponent
//   n, l, v  unit, away from the surface
//   result   ambient  ka, always (also for a light below the surface)
//            diffuse  kd n.l, clamped at 0
//            specular ks times phong_lobe; no cosine, as in the lecture
//            The framework multiplies each by the light that arrives and adds up the lights.
//   slide    "The complete Phong model"
Terms phong(Phong m, vec3 n, vec3 l, vec3 v) {
    // TODO: three terms; phong_lobe does the hard part
    return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}

// The same model with the half-vector lobe.
//   m, n, l, v, result  as for phong, with blinn_lobe in the place of phong_lobe
//   slide               "Blinn-Torrance variation of Phong"
Terms blinn_phong(Phong m, vec3 n, vec3 l, vec3 v) {
    // TODO: as phong, with the other lobe
    return Terms(vec3(0.0), 0.5 * m.kd, vec3(0.0));
}

// Already written, for the scene `energy` and its section in the handout. Two BRDFs from your lobes: kd and ks are fractions of
// the light now, and every term takes the cosine n.l.

// The modified Phong model of Lafortune and Willems (1994): the lobe is scaled so that at normal incidence it reflects ks.
//   m        kd, ks: the reflected fractions; kd + ks <= 1 conserves energy; ka is not used; q: exponent
//   n, l, v  unit, away from the surface
//   result   f n.l with f = kd/pi + ks (q+2)/(2 pi) (v.r)^q, n.l clamped at 0; no ambient term: 0
//   slide    none: the handout's section on energy
Terms phong_physical(Phong m, vec3 n, vec3 l, vec3 v) {
    Real pi = 3.141592653589793;
    Real cosine = max(dot(n, l), 0.0);
    Real lobe = (m.q + 2.0) / (2.0 * pi) * phong_lobe(n, l, v, m.q);
    return Terms(vec3(0.0), m.kd / pi * cosine, m.ks * lobe * cosine);
}

// Blinn's model as Ngan, Durand and Matusik (2005) fitted it to measured materials. (q+2)/(2 pi) is the normalisation of Phong's
// lobe; on the wider half-vector lobe it reflects more than ks, up to four times as much.
//   m        kd, ks: as published with the fits; ka is not used; q: exponent
//   n, l, v  unit, away from the surface
//   result   f n.l with f = kd/pi + ks (q+2)/(2 pi) (n.h)^q, n.l clamped at 0; no ambient term: 0
//   slide    none: the handout's section on energy
Terms blinn_phong_ngan(Phong m, vec3 n, vec3 l, vec3 v) {
    Real pi = 3.141592653589793;
    Real cosine = max(dot(n, l), 0.0);
    Real lobe = (m.q + 2.0) / (2.0 * pi) * blinn_lobe(n, l, v, m.q);
    return Terms(vec3(0.0), m.kd / pi * cosine, m.ks * lobe * cosine);
}
