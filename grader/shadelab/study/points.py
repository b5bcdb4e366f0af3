"""What a study measures: points of error and run time, their Pareto front, and slopes fitted to them."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np


@dataclass
class Point:
    """One setting of a knob: how wrong it is, and how long it takes."""

    series: str
    knob: dict[str, Any]
    error: dict[str, float]  # rmse, max
    seconds: dict[str, float] | None  # median, min, max, runs; None: not timed
    front: bool = False


@dataclass
class Slope:
    """The order with which a series converges: error ~ x^order."""

    series: str
    against: str  # what x is, for example "samples"
    expected: str  # what theory predicts, in words: "-1/2"
    fitted: float
    standard_error: float
    fit: str  # which points were taken, and why those


@dataclass
class Guide:
    """A line of a known slope to compare a series with, through that series' last point and a little above it."""

    series: str
    slope: float
    label: str


@dataclass
class Part:
    """Points that share a reference, and what they say. A study has one or more. `name` is that of its figure's file."""

    name: str
    title: str
    scene: str
    reference: dict[str, Any]  # what, samples; and whatever else describes it
    points: list[Point]
    slopes: list[Slope] = field(default_factory=list)
    claims: list[str] = field(default_factory=list)  # two sentences on what one sees, with the measured numbers in them
    noise: dict[str, float] = field(
        default_factory=dict
    )  # of the errors, by what causes it; that of the times is added
    # What --full costs: scene, language, needed and full (seconds as a point's), ratio, difference (of the images), left_out.
    leaving_out: list[dict[str, Any]] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)  # what was not measured, and why
    # What is drawn beside error against run time: error against this member of `knob`, with this label and these lines.
    knob: str | None = None
    knob_label: str = ""
    guides: list[Guide] = field(default_factory=list)
    time_label: str = "time of drawing (ms)"
    # Points with the same value of this member of `knob` compete for the front; None: all of them.
    front_within: str | None = None

    def mark_front(self) -> None:
        groups: dict[Any, list[Point]] = {}
        for point in self.points:
            groups.setdefault(point.knob.get(self.front_within), []).append(point)
        for group in groups.values():
            front(group)

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name, "title": self.title, "scene": self.scene, "reference": self.reference,
            "noise": {**timing_noise(self.points), **self.noise}, "slopes": [asdict(s) for s in self.slopes],
            "claims": self.claims, "skipped": self.skipped,
        }  # fmt: skip


def front(points: Iterable[Point]) -> None:
    """Marks the Pareto front: the points than which no other is as fast and as exact, and better in one of the two."""
    timed = [p for p in points if p.seconds is not None]
    for point in timed:
        here = point.seconds["median"], point.error["rmse"]
        point.front = not any(
            t <= here[0] and e <= here[1] and (t, e) != here
            for t, e in ((other.seconds["median"], other.error["rmse"]) for other in timed)
        )


def fit_slope(x: Iterable[float], y: Iterable[float]) -> tuple[float, float]:
    """(slope, its standard error) of log y over log x by least squares. It takes three points; two have no residuals."""
    known = [np.asarray(list(values), float) for values in (x, y)]
    count = len(known[0])
    if count < 3 or not all(np.isfinite(values).all() and (values > 0).all() for values in known):
        raise ValueError("a slope is fitted to three or more positive points")
    logs = [np.log(values) for values in known]
    from_middle = logs[0] - logs[0].mean()
    spread_of_x = float(from_middle @ from_middle)
    slope = float(from_middle @ logs[1]) / spread_of_x
    residuals = logs[1] - logs[1].mean() - slope * from_middle
    return slope, math.sqrt(float(residuals @ residuals) / (count - 2) / spread_of_x)


def timing_noise(points: Iterable[Point]) -> dict[str, float]:
    """How far the repeats of a point lie apart, as (max - min) / median: the median over the points, and the largest."""
    spreads = [(p.seconds["max"] - p.seconds["min"]) / p.seconds["median"] for p in points if p.seconds is not None]
    return {"median_spread": float(np.median(spreads)), "largest_spread": max(spreads)} if spreads else {}
