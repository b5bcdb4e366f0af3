"""50-digit vectors, for the exact.py of assignments. A vector is a tuple of mpmath numbers."""

from mpmath import mp, mpf, sqrt

mp.dps = 50

Vector = tuple[mpf, ...]


def vector(*values: float) -> Vector:
    return tuple(mpf(v) for v in values)


def dot(a: Vector, b: Vector) -> mpf:
    return sum((x * y for x, y in zip(a, b)), mpf(0))


def add(a: Vector, b: Vector) -> Vector:
    return tuple(x + y for x, y in zip(a, b))


def scale(s: mpf, a: Vector) -> Vector:
    return tuple(s * x for x in a)


def normalize(a: Vector) -> Vector:
    return scale(1 / sqrt(dot(a, a)), a)
