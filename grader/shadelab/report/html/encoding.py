"""What the viewers read: planes of 16 bits in blobs.

Colours are float16: three planes, of which the fourth digit is rounded. Positions and normals, where that would be coarse, are
fractions of their range. What is far finer than float16, how a difference compares with the tolerance, is a plane of its own, in
steps of 1/16 of a doubling. A plane is stored as differences, which are small where the picture is smooth: from the same plane of
the scene where most pixels are equal, otherwise from left + above - above left. The differences as unsigned numbers
(0, -1, 1, -2, ...), their high bytes before their low bytes, deflated, in base64. report.js reads this.
"""

import base64
import math
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from markupsafe import Markup

FRACTIONS = 4095  # positions and normals: 12 bits, a quarter of a thousandth of what they range over; more is mostly noise to pack


def as_planes(layer: np.ndarray) -> np.ndarray:
    """(H, W, n) -> (n, H, W), a copy"""
    return np.array(np.moveaxis(layer, 2, 0), np.float32, order="C")


def as_halves(planes: np.ndarray) -> np.ndarray:
    """The bits of float16. What is finite stays finite. (numpy's own conversion takes three times as long.)"""
    finite = np.isfinite(planes)
    x = np.clip(planes, -65504, 65504)
    if not finite.all():
        x[~finite] = 0
    negative = x < 0
    np.abs(x, out=x)
    x *= np.float32(2.0**-112)  # moves the exponent to where float16 has it
    bits = x.view(np.uint32)
    bits += 1 << 12
    bits >>= 13
    halves = bits.astype(np.uint16)
    if negative.any():
        halves[negative] |= 0x8000
    if not finite.all():
        with np.errstate(invalid="ignore"):
            halves[~finite] = planes[~finite].astype(np.float16).view(np.uint16)
    return halves


def excess_of_planes(student: np.ndarray, expected: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Each pixel's largest |delta| / limit over the planes; infinite where the student's pixel is not finite."""
    with np.errstate(all="ignore"):
        ratio = student - expected
        np.abs(ratio, out=ratio)
        ratio /= np.maximum(limit, 1e-37)
        ratio = np.maximum(np.maximum(ratio[0], ratio[1]), ratio[2])  # NaN stays
    ratio[np.isnan(ratio)] = np.inf
    return ratio


def as_steps(ratio: np.ndarray) -> np.ndarray:
    """1 at 1/4 of the tolerance, 16 steps a doubling; 0 below that, where all correct programs are; 65535: infinite."""
    out = np.zeros(ratio.shape, np.uint16)
    told = ratio >= 0.25
    with np.errstate(over="ignore"):
        steps = 33 + 16 * np.log2(np.minimum(ratio[told], 2.0**127))
    out[told] = np.where(np.isinf(ratio[told]), 65535, np.maximum(np.rint(steps), 1)).astype(np.uint16)
    return out


def as_fractions(layer: np.ndarray) -> tuple[np.ndarray, list[float], list[float]]:
    """(H, W, n) -> (n, H, W): 0 to FRACTIONS between each channel's smallest and largest value."""
    planes = np.nan_to_num(as_planes(layer))
    low, high = planes.min(axis=(1, 2)), planes.max(axis=(1, 2))
    unit = (planes - low[:, None, None]) * (FRACTIONS / np.maximum(high - low, 1e-30))[:, None, None]
    return np.rint(unit).astype(np.uint16), exact(low), exact(high)


def packed(planes: np.ndarray, base: np.ndarray | None = None) -> tuple[Markup, list[int]]:
    """The blob, and which planes are stored as differences from those of `base`."""
    against: list[int] = []
    squeeze = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    parts = []
    for k, plane in enumerate(planes):
        change = None if base is None or k >= len(base) else plane - base[k]
        if change is not None and np.count_nonzero(change) < change.size / 4:
            against.append(k)
        else:
            change = plane.copy()
            change[1:] -= plane[:-1]
            down = change.copy()
            change[:, 1:] -= down[:, :-1]
        change = (change << 1) ^ (change.view(np.int16) >> 15).view(np.uint16)
        parts += [squeeze.compress((change >> 8).astype(np.uint8)), squeeze.compress(change.astype(np.uint8))]
    return Markup(base64.b64encode(b"".join([*parts, squeeze.flush()])).decode()), against


def exact(values: Iterable[Any]) -> list[float | str]:
    """For JSON, which has no NaN and no infinity: they travel as words."""
    numbers = [float(v) for v in values]
    return [
        float(f"{v:.7g}") if math.isfinite(v) else {"nan": "NaN", "inf": "Infinity"}.get(str(v), "-Infinity")
        for v in numbers
    ]
