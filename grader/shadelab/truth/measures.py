"""How far numbers are from the truth, and how far correct programs may be: of functions over tables, of images pixel by pixel."""

import statistics
from collections.abc import Callable

import numpy as np

from shadelab.course.assignment import Function
from shadelab.result import Render
from shadelab.truth.expected import SceneTruth, Table

# Limits are derived. making.py measures how far correct programs stray (the solution, the slides' formulas and all correct
# variants, in C++ with and without fused multiply-add and in GLSL): the floor. A limit is this many floors. The same number of
# times the conditioning of the inputs is allowed, since 8 random draws fall short of the worst rounding.
FACTOR = 4
# No floor is lower than this. C++: constants written with five digits (3.1416 for pi is 2.3e-6 off), squared and times two. GLSL:
# the same, and twice what the driver's exp, log and pow are off. Its acos is off by far more: functions that correct programs
# write with it have that in their own floor, and of others a row that is right in double is excused.
LEAST_FLOOR = {"cpp": 1e-5, "glsl": 2e-5}
# Of a picture, which may show any function: what llvmpipe's acos is off (a test measures it).
LEAST_PICTURE_FLOOR = 2.3e-4
# One row alone does not set a function's limit: another algebra loses its digits on other rows.
OUTLIERS = 1e-3
# Values below this share of the table's scale are judged absolutely: a highlight's tail is not worth its relative error.
SMALL = 1e-3

# FULL_MARKS: the share of interior pixels that may be off, 3 of 10,000, or FACTOR times the share that a correct program has by
# the limits that the others set.
FULL_MARKS = 3e-4
SMALL_PIXEL = 1e-2  # of the scene's scale: what is darker is judged absolutely


# ----------------------------------------------------------------------------------------------------- functions


def function_members(function: Function) -> list[slice]:
    """The columns of each member of the result; each is judged by its own scale."""
    return [slice(k, k + c.width) for k, c in enumerate(function.outputs) if c.index == 0]


def function_limit(floor: float, backend: str) -> float:
    return FACTOR * max(floor, LEAST_FLOOR[backend])


def scaled_error(actual: np.ndarray, table: Table, members: list[slice]) -> np.ndarray:
    """e = max(0, |a - t| - FACTOR conditioning) / (|t| + 1e-3 S) per number, S the 95th percentile of |t| over the table and the
    member. Not finite where the truth is finite: infinity."""
    error = np.empty(table.truth.shape)
    for member in members:
        t, a = table.truth[:, member], actual[:, member].astype(np.float64)
        with np.errstate(all="ignore"):
            e = np.maximum(0, np.abs(a - t) - FACTOR * table.conditioning[:, member]) / _scale(t)
        # A truth that is not finite asks for the same kind of value; anything else that is not finite fails.
        finite = np.isfinite(t)
        same = ~finite & ((np.isnan(t) & np.isnan(a)) | (a == t))
        error[:, member] = np.where(same, 0.0, np.where(np.isfinite(a) & finite, e, np.inf))
    return error


def _scale(t: np.ndarray) -> np.ndarray:
    finite = np.isfinite(t)
    scale = np.percentile(np.abs(t[finite]), 95) if finite.any() else 1.0
    return np.abs(t) + SMALL * max(scale, 1e-30)


def row_errors(actual: np.ndarray, table: Table, members: list[slice]) -> np.ndarray:
    """(N,): of each row the largest."""
    return scaled_error(actual, table, members).max(axis=1)


def spread_of(errors: np.ndarray) -> float:
    """What a correct program strays by on all but OUTLIERS of the rows: where it has those right in double, it is excused there.
    errors: (N,)"""
    return float(np.quantile(errors, 1 - OUTLIERS, method="lower"))


# -------------------------------------------------------------------------------------------------------- images


def image_limit(truth: SceneTruth, floor: float) -> np.ndarray:
    """FACTOR times what a shift of 1/16 pixel and the floor of the arithmetic make of each pixel; (H, W, 3) float32. One
    limit for both languages: a picture is a picture."""
    size = np.abs(truth.total) + np.float32(SMALL_PIXEL * truth.scale)
    return np.float32(FACTOR) * (truth.noise[..., None] + np.float32(max(floor, LEAST_PICTURE_FLOOR)) * size)


def tolerance(truth: SceneTruth) -> np.ndarray:
    """(H, W, 3): what each pixel of the total may be off."""
    return image_limit(truth, max(truth.facts.spread.values(), default=0.0))


def followed_limit(truth: SceneTruth, taken: Callable[[np.ndarray], np.ndarray], total: np.ndarray) -> np.ndarray:
    """As tolerance(), of another total than the true one at some pixels, which `taken` picks: brighter pixels are noisier."""
    true, noise = taken(truth.total), taken(truth.noise)[..., None]
    with np.errstate(all="ignore"):
        size = np.abs(total) + np.float32(SMALL_PIXEL * truth.scale)
        brighter = np.maximum(1, size / (np.abs(true) + np.float32(SMALL_PIXEL * truth.scale)))
        floor = max([LEAST_PICTURE_FLOOR, *truth.facts.spread.values()])
        return np.float32(FACTOR) * (noise * brighter + np.float32(floor) * size)


def pixel_error(total: np.ndarray, truth: SceneTruth) -> np.ndarray:
    """(H, W): what the floor of the arithmetic has to explain: the largest channel's error beyond the noise, relative."""
    size = np.abs(truth.total) + np.float32(SMALL_PIXEL * truth.scale)
    beyond = np.abs(total - truth.total) - truth.noise[..., None]
    return np.nan_to_num((np.maximum(0, beyond) / size).max(axis=2), nan=np.inf)


def violating_share(total: np.ndarray, reference: np.ndarray, limit: np.ndarray, judged: np.ndarray) -> float:
    return float((violations(total, reference, limit) & judged).sum() / judged.sum())


def violations(actual: np.ndarray, reference: np.ndarray, limit: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", over="ignore"):
        return ~every_channel(np.abs(actual - reference) <= limit)  # written so that NaN violates


def every_channel(true: np.ndarray) -> np.ndarray:
    """(H, W, 3) -> (H, W). Written out: numpy's own reduction over so short an axis takes ten times as long."""
    return true[..., 0] & true[..., 1] & true[..., 2]


def rmse(off: np.ndarray) -> float:
    """Root mean square, over all pixels and channels, of what an image is off by."""
    return float(np.sqrt(np.mean(np.square(off))))


def render_of(series: str, off: np.ndarray, frames: list[float]) -> Render:
    """off: what the image is off by; frames: seconds of each."""
    middle = statistics.median(frames)
    return Render(
        series=series, rmse=rmse(off), seconds=middle, least=min(frames), most=max(frames), frames=len(frames)
    )
