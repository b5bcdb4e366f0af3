"""The functions of this assignment in 50-digit arithmetic: the slides' formulas and nothing clever.

Directions are unit vectors to 50 digits. Structs are dicts of their members.
"""

from mpmath import cos, mpf, pi, sqrt

from shadelab.exact import add, dot, scale, vector


def distance_fade(r, fade_distance, fade_power):
    return 2 / (1 + (r / fade_distance) ** fade_power)


def distance_falloff(abc, r):
    a, b, c = abc
    return 1 / (a * r**2 + b * r + c)


def spot_attenuation(axis, to_light, hotspot, falloff):
    cosine = -dot(axis, to_light)
    if cosine >= cos(hotspot):
        return mpf(1)
    if cosine <= cos(falloff):
        return mpf(0)
    t = (cosine - cos(falloff)) / (cos(hotspot) - cos(falloff))
    return 3 * t**2 - 2 * t**3


def incident_light(light, x):
    point, directional, spot = range(3)
    if light["kind"] == directional:
        return {"l": scale(mpf(-1), light["direction"]), "e": light["intensity"]}
    to_light = add(light["position"], scale(mpf(-1), x))
    r = sqrt(dot(to_light, to_light))
    if r == 0:
        return {"l": vector(0, 0, 0), "e": vector(0, 0, 0)}
    l = scale(1 / r, to_light)
    factor = distance_falloff(light["attenuation"], r)
    if light["kind"] == spot:
        factor *= spot_attenuation(light["direction"], l, light["hotspot"], light["falloff"])
    return {"l": l, "e": scale(factor, light["intensity"])}


def irradiance(light, n):
    return scale(max(dot(n, light["l"]), mpf(0)), light["e"])


def diffuse(kd, e):
    return tuple(a * b for a, b in zip(kd, e))


def lambert(m, n, l, v):
    none = vector(0, 0, 0)
    return {"ambient": none, "diffuse": scale(max(dot(n, l), mpf(0)), m["kd"]), "specular": none}


def lambert_physical(m, n, l, v):
    return lambert({"kd": scale(1 / pi, m["kd"])}, n, l, v)
