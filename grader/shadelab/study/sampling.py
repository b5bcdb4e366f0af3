"""Supersampling: more samples a pixel, at random, in strata, or on a regular grid.

A frame of our rasterizer has one sample in each pixel, all at the same place of theirs; the mean of N frames that are shifted by
parts of a pixel has N. A regular grid is one frame, drawn larger. The time is that of drawing all the frames; to average them
costs less and is left out.

Theory: random samples leave an error of N^-1/2. With one sample in each of N = k x k strata only strata across which the picture
changes contribute: along an edge these are k of the k^2, and the error goes with N^-3/4; where the picture is smooth, all of them
do, each by its size 1/k, and it goes with N^-1. A picture with both lies between the two.
"""

import math
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.machine.renderer import View
from shadelab.measure.images import image_error
from shadelab.measure.timing import interleaved
from shadelab.paths import ROOT, shown
from shadelab.study.declaration import Sampling, Study
from shadelab.study.images import ONE_FRAME, converged, small_size
from shadelab.study.points import Guide, Part, Point, Slope, fit_slope
from shadelab.study.timing import UNMOVED, Drawer, Shift, Workbench

EXPECTED = {"random": ("-1/2", -0.5), "stratified": ("-3/4 at edges to -1 where smooth", -0.75)}


def random_shifts(count: int, rng: np.random.Generator) -> list[Shift]:
    return [tuple(shift) for shift in rng.uniform(-0.5, 0.5, (count, 2)).tolist()]


def stratified_shifts(count: int, rng: np.random.Generator) -> list[Shift]:
    """One in each of k x k equal squares; `count` = k^2."""
    k = math.isqrt(count)
    corners = np.stack(np.meshgrid(np.arange(k), np.arange(k)), axis=-1).reshape(-1, 2)
    return [tuple(shift) for shift in ((corners + rng.uniform(0, 1, (count, 2))) / k - 0.5).tolist()]


def unmoved(count: int, rng: np.random.Generator) -> list[Shift]:
    """A regular grid stands in one larger frame."""
    return [UNMOVED]


SHIFTS = {"random": random_shifts, "stratified": stratified_shifts, "regular": unmoved}


def measure_sampling(study: Study, spec: Sampling, work: Workbench, scene: Path, assignment: Assignment) -> Part:
    described = work.describe(scene, assignment)  # first: it says what is wrong with a scene
    loops, size = described.needs.loops, small_size(described, spec.size)
    rng = np.random.default_rng(study.seed)
    work.progress(f"{scene.stem}: the converged picture", 0, 1)
    view = View(size=size, supersample=ONE_FRAME)
    with work.cpp(scene, assignment, loops, True, view=view, ours=True) as program:
        truth, reference_error = converged(program, spec.reference)
    errors: dict[tuple[str, int], list[dict[str, float]]] = {}

    def measure(key: tuple[str, int], program: Drawer, shifts: Callable[[], list[Shift]]) -> float:
        drawn = program.draw(shifts())
        errors.setdefault(key, []).append(image_error(drawn.image, truth))
        return drawn.seconds

    with ExitStack() as stack:
        draws: dict[tuple[str, int], Callable[[], float]] = {}
        one = stack.enter_context(work.cpp(scene, assignment, loops, view=View(size=size)))
        for series in spec.series:
            for count in spec.samples:
                k = math.isqrt(count)
                if series != "random" and k * k != count:
                    continue
                program, shifts = one, partial(SHIFTS[series], count, rng)
                if series == "regular":
                    larger = View(size=size, supersample=k)
                    program = stack.enter_context(work.cpp(scene, assignment, loops, view=larger))
                draws[series, count] = partial(measure, (series, count), program, shifts)
        seconds = interleaved(draws, study.repeats, work.progress, f"{scene.stem}: sampling")

    points = [
        Point(series, knob_of(series, count), mean_error(errors[series, count]), seconds[series, count])
        for series, count in draws
    ]
    part = Part(
        "sampling", f"Samples a pixel: {scene.stem}", scene_name(scene),
        {"what": f"C++ double, a regular grid of {spec.reference} x {spec.reference} samples a pixel", "samples": spec.reference**2,
         "pixels": size},
        points, noise={"reference_error": reference_error}, knob="samples", knob_label="samples a pixel",
    )  # fmt: skip
    part.slopes = list(filter(None, (slope_of(points, series) for series in spec.series)))
    part.guides = [
        Guide(s.series, EXPECTED[s.series][1], f"$N^{{{EXPECTED[s.series][0].split()[0]}}}$") for s in part.slopes
    ]
    part.claims = claims(points, part.slopes, reference_error)
    if work.student:
        part.claims.append(
            "What does not fall with more samples is what these functions do otherwise than the solution's."
        )
    return part


def scene_name(scene: Path) -> str:
    """From the checkout, where it lies there."""
    return str(scene.relative_to(ROOT)) if scene.is_relative_to(ROOT) else shown(scene)


def knob_of(series: str, count: int) -> dict[str, int]:
    return {"samples": count, **({"supersample": math.isqrt(count)} if series == "regular" else {})}


def mean_error(errors: list[dict[str, float]]) -> dict[str, float]:
    """Over the runs, each with samples of its own: the root of the mean square, and the largest difference of all."""
    rmse = math.sqrt(np.mean([e["rmse"] ** 2 for e in errors]))
    return {"rmse": rmse, "max": max(e["max"] for e in errors)}


def slope_of(points: list[Point], series: str) -> Slope | None:
    """Strata begin to differ from random samples at four."""
    if series not in EXPECTED:
        return None
    least = 4 if series == "stratified" else 1
    fitted = [p for p in points if p.series == series and p.knob["samples"] >= least and p.error["rmse"] > 0]
    if len(fitted) < 3:
        return None
    slope, error = fit_slope([p.knob["samples"] for p in fitted], [p.error["rmse"] for p in fitted])
    return Slope(
        series, "samples", EXPECTED[series][0], slope, error, f"{least} to {fitted[-1].knob['samples']} samples"
    )


def claims(points: list[Point], slopes: list[Slope], reference_error: float) -> list[str]:
    out = []
    if slopes:
        fits = [
            f"{s.series} samples with N^{s.fitted:.3f} ± {s.standard_error:.3f} (theory: {s.expected})" for s in slopes
        ]
        out.append(f"The error falls for {' and for '.join(fits)}.")
    most = {p.series: p for p in points}  # the last of each: the most samples
    if "random" in most and len(most) > 1:
        random = most.pop("random")
        better = [
            f"{random.error['rmse'] / p.error['rmse']:.1f} times smaller in {name} ones, in"
            f" {p.seconds['median'] / random.seconds['median']:.2f} of the time"
            for name, p in most.items()
            if p.knob["samples"] == random.knob["samples"] and p.error["rmse"] > 0
        ]
        if better:
            out.append(
                f"At {random.knob['samples']} samples the error is {random.error['rmse']:.1e} with random samples and"
                f" {'; '.join(better)} (the reference itself is off by {reference_error:.0e} at most)."
            )
    return out
