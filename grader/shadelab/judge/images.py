"""A picture against the expected one: which pixels are off, which terms, and where it is worst."""

from dataclasses import dataclass
from math import gcd

import numpy as np

from shadelab.course.assignment import Scene
from shadelab.judge.credit import credit, size_of
from shadelab.judge.functions import informative
from shadelab.judge.words import numbers, percent_of
from shadelab.result import Check, Error, Worst
from shadelab.truth.expected import BACKGROUND, CHANNELS, EDGE, INTERIOR, SceneTruth
from shadelab.truth.measures import (
    FACTOR,
    FULL_MARKS,
    SMALL_PIXEL,
    every_channel,
    followed_limit,
    tolerance,
    violations,
)
from shadelab.words import listed

EDGE_CAP = 0.25  # share of edge pixels that may be off; beyond it, and with any value that is not finite, at most half the marks

# Follow-through looks at every so manieth pixel each way. The noise of a pixel was measured with the right functions, of which
# the wrong ones may be wilder: so many of these may differ.
EVERY, STRAY = 8, 0.01


def judge_image(scene: Scene, backend: str, points: float, truth: SceneTruth, layers: np.ndarray) -> Check:
    """layers: (H, W, 13) float32, the CHANNELS up to coverage; the edges come from our own geometry layers."""
    actual = np.ascontiguousarray(layers[..., CHANNELS["total"]])
    foreground = truth.layers["id"][..., 0] > 0
    limit = tolerance(truth)
    most = max(FULL_MARKS, FACTOR * truth.facts.share)
    check = Check(
        id=f"{backend}/image/{scene.name}",
        kind="image",
        backend=backend,
        status="passed",
        score=points,
        max_score=points,
        needs=[f"{backend}/build"],
        hidden=scene.hidden,
    )
    interior, edge, background = truth.mask == INTERIOR, truth.mask == EDGE, truth.mask == BACKGROUND
    if not foreground.any() or interior.sum() < 0.5 * foreground.sum():
        # A scene of slivers and edges says nothing about shading: the scene is at fault, not the student.
        check.status, check.score = "error", 0.0
        check.message = (
            f"the scene leaves only {percent_of(interior.sum() / max(foreground.sum(), 1))} of its foreground to judge"
        )
        return check

    violates = violations(actual, truth.total, limit)
    # Background pixels carry no shading; one that differs counts like an interior pixel.
    share = float((violates & (interior | background)).sum() / interior.sum())
    edge_share = float((violates & edge).sum() / max(edge.sum(), 1))
    finite = every_channel(np.isfinite(actual))
    size = np.abs(truth.total) + np.float32(SMALL_PIXEL * truth.scale)
    with np.errstate(all="ignore"):
        off = np.nan_to_num((np.abs(actual - truth.total) / size).max(axis=2), nan=np.inf)
    fraction = 1.0 if share <= most else credit(share, size_of(off[violates & (interior | background)]))
    if not finite.all() or edge_share > EDGE_CAP:
        fraction = min(fraction, 0.5)
    check.error = Error(name="interior violations", value=share, limit=most, floor=most / FACTOR)
    check.score = points * fraction
    if fraction < 1:
        check.status = "failed"
        check.message = _describe_image(truth, layers, limit, most, finite, share, edge_share, interior)
        lost_for = ~finite
        if share > most:
            lost_for |= violates & ~edge
        if edge_share > EDGE_CAP:
            lost_for |= violates & edge
        check.worst = _worst_pixel(truth, actual, limit, lost_for)
    return check


@dataclass(frozen=True)
class Sampled:
    """A smaller picture whose pixels are centred on pixels of the whole one."""

    every: int
    size: str
    shift: tuple[float, float]

    @classmethod
    def of(cls, scene: Scene) -> "Sampled":
        width, height = scene.described.width, scene.described.height
        every = max(k for k in range(1, EVERY + 1) if gcd(width, height) % k == 0)
        # The middle of an even number of pixels lies between two: half a pixel up and to the left of the one that is taken.
        half = 0.0 if every % 2 else 0.5 / every
        return cls(every, f"{width // every}x{height // every}", (-half, half))

    def taken(self, pixels: np.ndarray) -> np.ndarray:
        return pixels[self.every // 2 :: self.every, self.every // 2 :: self.every]


def is_followed(truth: SceneTruth, layers: np.ndarray, sampled: Sampled, total: np.ndarray) -> bool:
    """Whether a picture is the one that the student's wrong functions make of the reference. total: what they make of it, at the
    sampled pixels."""
    inside = sampled.taken(truth.mask == INTERIOR)
    if not inside.any() or not informative(total[inside]):
        return False
    actual, limit = sampled.taken(layers[..., CHANNELS["total"]]), followed_limit(truth, sampled.taken, total)
    differs = violations(actual, total, limit) & every_channel(np.isfinite(actual) | np.isfinite(total))
    return bool((differs & inside).sum() <= STRAY * inside.sum())


def _describe_image(
    truth: SceneTruth,
    layers: np.ndarray,
    limit: np.ndarray,
    most: float,
    finite: np.ndarray,
    share: float,
    edge_share: float,
    interior: np.ndarray,
) -> str:
    parts = []
    if share > most:
        parts.append(f"{percent_of(share)} of the interior pixels are off (at most {percent_of(most)} may be)")
    if not finite.all():
        y, x = np.argwhere(~finite)[0]
        parts.append(f"{(~finite).sum()} pixels are not finite, the first at ({x}, {y})")
    if edge_share > EDGE_CAP and share <= most:
        parts.append(f"{percent_of(edge_share)} of the edge pixels are off (at most {percent_of(EDGE_CAP)} may be)")
    wrong, right = [], []
    for term in ("ambient", "diffuse", "specular"):
        reference, actual = truth.layers[term], np.ascontiguousarray(layers[..., CHANNELS[term]])
        off = violations(actual, reference, limit) & interior
        (wrong if off.sum() > most * interior.sum() else right).append(term)
    if wrong and right:
        parts.append(
            f"{listed(wrong)} {'is' if len(wrong) == 1 else 'are'} wrong, {listed(right)} {'is' if len(right) == 1 else 'are'} right"
        )
    return "; ".join(parts)


def _worst_pixel(truth: SceneTruth, actual: np.ndarray, limit: np.ndarray, candidates: np.ndarray) -> Worst:
    rows, columns = np.nonzero(candidates)
    with np.errstate(all="ignore"):
        badness = (np.abs(actual[candidates] - truth.total[candidates]) / limit[candidates]).max(axis=1)
    worst = np.argmax(np.where(np.isfinite(badness), badness, np.inf))
    y, x = rows[worst], columns[worst]
    inputs = {"pixel": [int(x), int(y)], "object": int(truth.layers["id"][y, x, 0])}
    if inputs["object"]:
        position = truth.layers["position"][y, x].astype(np.float64)
        view = truth.eye - position
        inputs |= {
            "n": numbers(truth.layers["normal"][y, x]),
            "x": numbers(position),
            "v": numbers(view / np.linalg.norm(view)),
        }
    return Worst(inputs=inputs, expected=numbers(truth.total[y, x]), actual=numbers(actual[y, x]))
