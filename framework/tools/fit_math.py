#!/usr/bin/env python3
"""Derives the polynomial coefficients of framework/include/shadelab/math.hpp.

    python3 fit_math.py            prints the constants and the error that each polynomial alone makes
    python3 fit_math.py --check    compares them with the header; exit status 1 where they differ

Each polynomial is a weighted least-squares fit on Chebyshev nodes in 40-digit arithmetic, which comes within a small
factor of the minimax error. The weight turns an error of the polynomial into a relative error of the function. Then
the coefficients are rounded to float32 one at a time, lowest power first, and the rest are fitted again: the higher
powers take up what the rounding of the lower ones left over.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpmath import cos, exp, expm1, log, log1p, matrix, mp, mpf, pi, qr_solve, sqrt

mp.dps = 40
HEADER = Path(__file__).parents[1] / "include" / "shadelab" / "math.hpp"


@dataclass(frozen=True)
class Fit:
    name: str  # of the array in the header
    meaning: str
    degree: int
    low: mpf
    high: mpf
    target: Callable  # the polynomial should equal this
    weight: Callable  # times this: the relative error of the function that is built on it


# m runs over [sqrt(1/2), sqrt(2)], so s = (m - 1) / (m + 1) over +-0.1716 and z = s^2 up to 0.0295. The lowest z stays
# away from 0, where the quotients below are 0/0; the polynomial is smooth there.
Z_LOW = mpf("1e-9")
Z_HIGH = ((sqrt(2) - 1) / (sqrt(2) + 1)) ** 2
HALF_LN2 = log(2) / 2


def log_of_s(z: mpf) -> mpf:
    """log((1 + s) / (1 - s)) for s = sqrt(z)."""
    s = sqrt(z)
    return log1p(s) - log1p(-s)


FITS = [
    Fit(
        name="log_tail",
        meaning="log((1 + s) / (1 - s)) = 2 s + s z P(z), z = s^2",
        degree=2,
        low=Z_LOW,
        high=Z_HIGH,
        target=lambda z: (log_of_s(z) / sqrt(z) - 2) / z,
        weight=lambda z: sqrt(z) * z / log_of_s(z),
    ),
    Fit(
        name="log2_odd",
        meaning="log2((1 + s) / (1 - s)) = s P(z), z = s^2",
        degree=3,
        low=Z_LOW,
        high=Z_HIGH,
        target=lambda z: log_of_s(z) / sqrt(z) / log(2),
        weight=lambda z: sqrt(z) * log(2) / log_of_s(z),
    ),
    Fit(
        name="exp_tail",
        meaning="exp(f) - 1 = f + f^2 P(f), |f| <= ln(2) / 2; the error is expm1's, exp's is smaller",
        degree=4,
        low=-HALF_LN2,
        high=HALF_LN2,
        target=lambda f: (expm1(f) - f) / (f * f),
        weight=lambda f: f * f / expm1(f),
    ),
    Fit(
        name="exp2_tail",
        meaning="2^f = 1 + f P(f), |f| <= 1/2",
        degree=5,
        low=mpf("-0.5"),
        high=mpf("0.5"),
        target=lambda f: expm1(f * log(2)) / f,
        weight=lambda f: f / exp(f * log(2)),
    ),
]


def chebyshev_nodes(low: mpf, high: mpf, count: int) -> list[mpf]:
    """`count` (even, so that 0 is never one of them on a symmetric interval) nodes, dense at both ends."""
    return [(low + high) / 2 - (high - low) / 2 * cos(pi * (2 * i + 1) / (2 * count)) for i in range(count)]


def to_float32(x: mpf) -> mpf:
    return mpf(float(np.float32(float(x))))


def fit(job: Fit) -> list[mpf]:
    nodes = chebyshev_nodes(job.low, job.high, 64)
    weights = [job.weight(x) for x in nodes]
    targets = [job.target(x) for x in nodes]
    rounded: list[mpf] = []
    for power in range(job.degree + 1):
        left = job.degree + 1 - power
        rows, values = matrix(len(nodes), left), matrix(len(nodes), 1)
        for i, (x, w, t) in enumerate(zip(nodes, weights, targets)):
            for j in range(left):
                rows[i, j] = w * x ** (power + j)
            values[i] = w * (t - sum(c * x**p for p, c in enumerate(rounded)))
        solution, _ = qr_solve(rows, values)
        rounded.append(to_float32(solution[0]))
    return rounded


def largest_error(job: Fit, coefficients: list[mpf]) -> mpf:
    def error(x: mpf) -> mpf:
        return abs(job.weight(x) * (sum(c * x**p for p, c in enumerate(coefficients)) - job.target(x)))

    return max(error(x) for x in chebyshev_nodes(job.low, job.high, 1000))


def cpp_float(x: mpf) -> str:
    """Nine significant digits name a float32 exactly."""
    text = f"{float(x):.9g}"
    return text + ("f" if any(c in text for c in ".e") else ".0f")


def split_ln2() -> tuple[mpf, mpf]:
    """ln(2) as high + low. The high part has 12 trailing zero bits, so that an exponent (8 bits) times it is exact."""
    high = mpf(int(log(2) * 2**12)) / 2**12
    return high, to_float32(log(2) - high)


def lines() -> list[str]:
    out = []
    for job in FITS:
        coefficients = fit(job)
        out.append(f"// {job.meaning}; relative error {float(largest_error(job, coefficients)):.1e}")
        body = ", ".join(cpp_float(c) for c in coefficients)
        line = f"inline constexpr float {job.name}[] = {{{body}}};"
        out += [line] if len(line) <= 120 else [f"inline constexpr float {job.name}[] = {{", f"    {body}}};"]
    high, low = split_ln2()
    out.append("// ln(2) in two parts: an exponent times the first is exact")
    out.append(f"inline constexpr float ln2_high = {cpp_float(high)}, ln2_low = {cpp_float(low)};")
    out.append(f"inline constexpr float log2_e = {cpp_float(to_float32(1 / log(2)))};")
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare with the header instead of printing")
    made = lines()
    if not parser.parse_args().check:
        print("\n".join(made))
        return 0
    header = HEADER.read_text(encoding="utf-8").splitlines()
    missing = [line for line in made if line not in header]
    for line in missing:
        print(f"not in {HEADER.name}: {line}", file=sys.stderr)
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
