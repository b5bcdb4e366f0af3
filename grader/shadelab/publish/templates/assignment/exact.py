"""The functions of this assignment in 50-digit arithmetic: the slides' formulas and nothing clever. The tests hold the solution
against them, in ./shadelab test; that catches a solution that is wrong in both languages.

n, l, v are unit vectors to 50 digits, numbers are mpmath's. Structs are dicts of their members.
"""

from mpmath import mpf

from shadelab.exact import dot, scale, vector


def lit_cosine(n, l):
    return max(dot(n, l), mpf(0))


def wrapped_cosine(n, l, wrap):
    return max((dot(n, l) + wrap) / (1 + wrap), mpf(0))


def __NAME___shading(m, n, l, v):
    return {
        "ambient": vector(0, 0, 0),
        "diffuse": scale(wrapped_cosine(n, l, m["wrap"]), m["kd"]),
        "specular": vector(0, 0, 0),
    }
