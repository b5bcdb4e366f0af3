"""The functions of this assignment in 50-digit arithmetic: the slides' formulas and nothing clever.

n, l, v, h are unit vectors to 50 digits. Structs are dicts of their members.
"""

from mpmath import exp, mpc, mpf, pi, sqrt

from shadelab.exact import add, dot, normalize, scale, vector


def half_vector(l, v):
    total = add(l, v)
    return normalize(total) if dot(total, total) > 0 else vector(0, 0, 0)


def _clamped(c):
    return min(max(c, mpf(0)), mpf(1))


def trowbridge_reitz(n, h, m):
    c = dot(n, h)
    return m**2 / (c**2 * (m**2 - 1) + 1) ** 2 if c > 0 else mpf(0)


def fresnel_schlick(f0, c):
    return tuple(f + (1 - f) * (1 - _clamped(c)) ** 5 for f in f0)


def fresnel_dielectric(ior, c):
    c = _clamped(c)
    if ior == 1:
        return mpf(0)
    if ior**2 - 1 + c**2 <= 0:
        return mpf(1)
    g = sqrt(ior**2 - 1 + c**2)
    r_s = (c - g) / (c + g)
    r_p = (ior**2 * c - g) / (ior**2 * c + g)
    return (r_s**2 + r_p**2) / 2


def fresnel_conductor(eta, k, c):
    c = _clamped(c)

    def one(index):  # with complex numbers, another way than the solution's
        g = sqrt(index**2 - 1 + c**2)
        r_s = (c - g) / (c + g)
        r_p = (index**2 * c - g) / (index**2 * c + g)
        return (abs(r_s) ** 2 + abs(r_p) ** 2) / 2

    return tuple(one(mpc(e, x)) for e, x in zip(eta, k))


def beckmann(n, h, m):
    c = dot(n, h)
    return exp(-(1 / c**2 - 1) / m**2) / (m**2 * c**4) if c > 0 else mpf(0)


def geometry_term(n, l, v):
    nl, nv, h = dot(n, l), dot(n, v), half_vector(l, v)
    if nl <= 0 or nv <= 0:
        return mpf(0)
    return min(mpf(1), 2 * dot(n, h) * nv / dot(v, h), 2 * dot(n, h) * nl / dot(v, h))


def _terms(diffuse, specular):
    return {"ambient": vector(0, 0, 0), "diffuse": diffuse, "specular": specular}


def _above(n, l, v):
    return dot(n, l) > 0 and dot(n, v) > 0


def _lobe(n, l, v, m, fresnel):
    """D G F / (pi n.l n.v) times n.l."""
    h = half_vector(l, v)
    return scale(beckmann(n, h, m) * geometry_term(n, l, v) / (pi * dot(n, v)), fresnel(dot(v, h)))


def _cook_torrance(kd, lobes, n, l, v):
    if not _above(n, l, v):
        return _terms(vector(0, 0, 0), vector(0, 0, 0))
    specular = vector(0, 0, 0)
    for rho_s, f0, m in lobes:
        lobe = _lobe(n, l, v, m, lambda c: fresnel_schlick(f0, c))  # noqa: B023 called at once
        specular = add(specular, tuple(r * x for r, x in zip(rho_s, lobe)))
    return _terms(scale(dot(n, l), kd), specular)


def cook_torrance(m, n, l, v):
    return _cook_torrance(m["kd"], [(m["rho_s"], m["f0"], m["m"])], n, l, v)


def two_lobes(m, n, l, v):
    lobes = [(m["rho_s1"], m["f01"], m["m1"]), (m["rho_s2"], m["f02"], m["m2"])]
    return _cook_torrance(m["kd"], lobes, n, l, v)


def _divided(terms, diffuse, specular):
    return _terms(scale(1 / diffuse, terms["diffuse"]), scale(1 / specular, terms["specular"]))


def cook_torrance_physical(m, n, l, v):
    return _divided(cook_torrance(m, n, l, v), pi, mpf(4))


def cook_torrance_ngan(m, n, l, v):
    return _divided(cook_torrance(m, n, l, v), pi, pi)


def metal(m, n, l, v):
    if not _above(n, l, v):
        return _terms(vector(0, 0, 0), vector(0, 0, 0))
    lobe = _lobe(n, l, v, m["m"], lambda c: fresnel_conductor(m["eta"], m["k"], c))
    return _terms(vector(0, 0, 0), scale(mpf(1) / 4, lobe))


def plastic(m, n, l, v):
    if not _above(n, l, v):
        return _terms(vector(0, 0, 0), vector(0, 0, 0))
    lobe = _lobe(n, l, v, m["m"], lambda c: (fresnel_dielectric(m["ior"], c),) * 3)
    return _terms(scale(dot(n, l) / pi, m["kd"]), scale(mpf(1) / 4, lobe))
