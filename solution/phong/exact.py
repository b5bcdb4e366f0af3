"""The functions of this assignment in 50-digit arithmetic: the slides' formulas and nothing clever.

n, l, v are unit vectors to 50 digits. Structs are dicts of their members.
"""

from mpmath import mpf, pi

from shadelab.exact import add, dot, normalize, scale, vector


def mirror_direction(l, n):
    return add(scale(2 * dot(n, l), n), scale(mpf(-1), l))


def half_vector(l, v):
    total = add(l, v)
    return normalize(total) if dot(total, total) > 0 else vector(0, 0, 0)


def _power(cosine, q):
    return max(cosine, mpf(0)) ** q  # mpmath: 0 ** 0 = 1


def retro_lobe(n, l, v, q):
    return _power(dot(v, l), q) if dot(n, l) > 0 else mpf(0)


def phong_lobe(n, l, v, q):
    return _power(dot(v, mirror_direction(l, n)), q) if dot(n, l) > 0 else mpf(0)


def blinn_lobe(n, l, v, q):
    return _power(dot(n, half_vector(l, v)), q) if dot(n, l) > 0 else mpf(0)


def _terms(m, n, l, lobe):
    return {
        "ambient": m["ka"],
        "diffuse": scale(max(dot(n, l), mpf(0)), m["kd"]),
        "specular": scale(lobe, m["ks"]),
    }


def phong(m, n, l, v):
    return _terms(m, n, l, phong_lobe(n, l, v, m["q"]))


def blinn_phong(m, n, l, v):
    return _terms(m, n, l, blinn_lobe(n, l, v, m["q"]))


def _brdf_terms(m, n, l, lobe):
    cosine = max(dot(n, l), mpf(0))
    return {
        "ambient": vector(0, 0, 0),
        "diffuse": scale(cosine / pi, m["kd"]),
        "specular": scale(cosine * (m["q"] + 2) / (2 * pi) * lobe, m["ks"]),
    }


def phong_physical(m, n, l, v):
    return _brdf_terms(m, n, l, phong_lobe(n, l, v, m["q"]))


def blinn_phong_ngan(m, n, l, v):
    return _brdf_terms(m, n, l, blinn_lobe(n, l, v, m["q"]))
