"""Studies of kind "forms": one function computed in several ways and precisions, against 50-digit arithmetic.

What is compared stands in a folder that looks like an assignment: assignment.toml declares one function per form,
shading.cpp holds them, exact.py the truth. The same file is compiled with Real = float, double and half; a formula exists
once.

Directions are drawn in double and rounded to the precision that is measured, so their length is 1 only up to its rounding.
Which truth is fair then? The lobes are defined for directions, and a length is an accident of rounding: the truth makes all
directions unit, to 50 digits. This decides what one sees. |n - h|^2 takes the lengths' errors squared, n.h takes them once,
and an exponent of 1e6 makes 6 % of one. A truth of the numbers as they stand, (n.h)^q with whatever lengths, would blame
|n - h| for these 6 %, and find pow at 12 % instead of 15.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from shadelab.course.assignment import Assignment, Function, flat_rows, load_assignment
from shadelab.course.toml_files import Declared
from shadelab.errors import InfrastructureError, UserError
from shadelab.machine import renderer
from shadelab.machine.build import Recipe
from shadelab.machine.sandbox import Limits
from shadelab.measure.timing import interleaved
from shadelab.paths import ROOT, SOLUTION
from shadelab.study.declaration import STUDIES, Study
from shadelab.study.points import Guide, Part, Point, Slope, fit_slope
from shadelab.study.timing import Workbench
from shadelab.truth import exact
from shadelab.truth.measures import rmse

LIMITS = Limits(seconds=60)
IN_LOBE = 1e-3  # of the lobe's peak: what is smaller does not show
TIMED_ROWS = 2048  # they stay in the cache, and are enough for the clock
EVALUATIONS = 1e6  # whose seconds are given
PASSES = 200  # over them in one process; their median is its time
WIDEST = 1.55  # radians from n
CONDITIONING = "inputs off by half a unit"  # the series of what no form is to blame for
TILT = 1.05  # at most so far are l and v from h


@dataclass(frozen=True)
class Precision:
    dtype: type  # of the inputs
    real: type  # of the numbers that the plugin takes and gives
    recipe: Recipe
    timed: bool = True


PRECISIONS = {
    "float": Precision(np.float32, np.float32, Recipe(loops=(), columns=True)),
    "double": Precision(np.float64, np.float64, Recipe(double=True, loops=(), columns=True)),
    # Emulated: its time says nothing.
    "half": Precision(np.float16, np.float32, Recipe(half=True, loops=(), columns=True), timed=False),
}


Knob = dict[str, float | str]


class Form(Declared):
    function: str
    label: str


class Order(Declared):
    """The power of x with which the error of a form grows."""

    form: str
    expected: float
    over: tuple[float, float]  # where it is the largest part of the error


class FormsPanel(Declared):
    """Forms of one function over one knob."""

    name: str
    title: str
    what: dict[Literal["float", "double", "half"], str] = {}  # what one sees, in two sentences
    truth: str  # the function whose exact value is the truth for all forms
    forms: list[Form] = Field(min_length=1)
    precisions: list[Literal["float", "double", "half"]] = Field(["float", "double"], min_length=1)
    # Arguments that are the same for all inputs; texts only name the setting. Directions n, h, l, v and the cosine c are drawn.
    knobs: list[Knob] = Field(min_length=1)
    x: str  # which of them is the axis
    x_label: str
    measure: Literal["relative", "absolute"] = "relative"
    # Arguments that are the truth's value at the given arguments: Schlick's f0 is the exact reflectance at c = 1.
    from_truth: dict[str, dict[str, float]] = {}
    conditioning: bool = False  # also: what half a unit in the last place of the directions alone changes
    compare: tuple[str, str] | None = None  # the better, the worse; a claim says by how much
    orders: list[Order] = []

    @model_validator(mode="after")
    def _known(self) -> "FormsPanel":
        if any(not isinstance(knob.get(self.x), int | float) for knob in self.knobs):
            raise ValueError(f"each of knobs needs a number {self.x}")
        known = [form.label for form in self.forms]
        for label in [*(self.compare or ()), *(order.form for order in self.orders)]:
            if label not in known:
                raise ValueError(f'"{label}" is no form; there is {", ".join(known)}')
        return self


class Forms(Declared):
    """The table [forms] of a study."""

    code: str  # a folder beside the declaration, or an assignment
    rows: int = Field(512, ge=16, le=65536)  # inputs per setting
    panel: list[FormsPanel] = Field(min_length=1)

    @property
    def folder(self) -> Path:
        beside = STUDIES / self.code
        return beside if beside.is_dir() else SOLUTION / self.code


Arrays = dict[str, np.ndarray]


def measure_forms(study: Study, forms: Forms, work: Workbench, name: str, timed: bool = True) -> list[Part]:
    """A part for each panel and precision. Their times are those of a million evaluations: what counts as
    milliseconds are the nanoseconds of one."""
    code = _Code(load_assignment(forms.folder), work)
    asked = [(panel, precision) for panel in forms.panel for precision in panel.precisions]
    parts: list[Part] = []
    timers: dict[tuple[int, int], Callable[[], float]] = {}
    for done, (panel, precision) in enumerate(asked):
        work.progress("errors", done, len(asked))
        part = Part(
            f"{name}-{panel.name}-{precision}", f"{panel.title}: {precision}", str(forms.folder.relative_to(ROOT)),
            {"what": f"50-digit arithmetic on the same inputs, directions made unit; errors are {panel.measure}",
             "samples": forms.rows, "seconds": "of a million evaluations"},
            [], claims=[panel.what[precision]] if precision in panel.what else [],
            knob=panel.x, knob_label=panel.x_label, time_label="time of an evaluation (ns)", front_within=panel.x,
        )  # fmt: skip
        for point, timer in _points(panel, precision, code, forms.rows, study.seed, part.skipped):
            if timer and timed:
                timers[len(parts), len(part.points)] = timer
            part.points.append(point)
        parts.append(part)
    for (k, index), seconds in interleaved(timers, study.repeats, work.progress).items():
        parts[k].points[index].seconds = seconds
    for (panel, precision), part in zip(asked, parts):
        _conclude(study, panel, precision, part)
    return parts


def _points(
    panel: FormsPanel, precision: str, code: "_Code", rows: int, seed: int, skipped: list[str]
) -> Iterator[tuple[Point, Callable[[], float] | None]]:
    """The points, with what measures their time; what cannot be shown goes to `skipped`."""
    reasons: dict[str, list[str]] = {}  # why: at which x
    for knob in panel.knobs:
        try:
            inputs, truth = draw_inputs(code.assignment, panel, knob, PRECISIONS[precision].dtype, rows, seed)
        except OverflowError as error:
            reasons.setdefault(f"{panel.x} is larger than {error}", []).append(f"{knob[panel.x]:g}")
            continue
        for form in panel.forms:
            value = code.evaluate(form.function, inputs, precision)
            if not np.isfinite(value).all():
                why = f"{form.label}: some results are infinite or no number"
                reasons.setdefault(why, []).append(f"{knob[panel.x]:g}")
                continue
            point = Point(form.label, dict(knob), deviation(value, truth, panel.measure), None)
            yield point, code.timer(form.function, inputs, precision) if PRECISIONS[precision].timed else None
        if panel.conditioning and precision == "float":
            moved = _exact(code.assignment, panel.truth, _moved(inputs, seed))
            yield Point(CONDITIONING, dict(knob), deviation(moved, truth, panel.measure), None), None
    skipped += [f"{panel.x} = {', '.join(where)}: {why}" for why, where in reasons.items()]


def deviation(value: np.ndarray, truth: np.ndarray, measure: str) -> dict[str, float]:
    """A truth of one column stands for all of the value's."""
    difference = np.abs(value - truth)
    if measure == "relative":
        difference = difference / np.abs(truth)
    return {"rmse": rmse(difference), "max": float(difference.max())}


# ------------------------------------------------------------------------------------------------------- inputs


def draw_inputs(
    assignment: Assignment, panel: FormsPanel, knob: Knob, dtype: type, rows: int, seed: int
) -> tuple[Arrays, np.ndarray]:
    """What the panel's functions take, rounded to `dtype`, and the truth. Directions lie in the lobe: h so near to
    n that the truth is at least IN_LOBE of its peak. Raises OverflowError for a knob that `dtype` cannot hold."""
    rng = np.random.default_rng(seed)
    constants: Arrays = {}
    for name, value in knob.items():
        if isinstance(value, str):
            continue
        with np.errstate(over="ignore"):
            constants[name] = np.asarray(value, dtype)
        if not np.isfinite(constants[name]):
            raise OverflowError(f"{np.finfo(dtype).max:g}")
    for name, at in panel.from_truth.items():
        given = {key: np.full(1, value) for key, value in {**constants, **at}.items()}
        constants[name] = np.squeeze(_exact(assignment, panel.truth, given)[0]).astype(dtype)

    wanted = {value.name for value in assignment.function(panel.truth).values}
    if "n" not in wanted:
        c = np.cos(np.linspace(0, np.pi / 2, rows))
        inputs = _as_rows({"c": c.astype(dtype)}, constants, rows)
        return inputs, _exact(assignment, panel.truth, inputs)
    width = _width(assignment, panel.truth, constants)
    # Half of the angles evenly spaced, half by their logarithm: the peak, where n and h almost agree, has its share.
    even = rows // 2
    angle = np.concatenate([np.linspace(0, width, even + 1)[1:], width * np.logspace(-3, 0, rows - even)])
    n = _unit(rng.normal(size=(rows, 3)))
    h = _turned(n, angle, rng)
    tilt = rng.uniform(0, TILT, rows)
    l = _turned(h, tilt, rng)
    v = 2 * np.sum(h * l, axis=1, keepdims=True) * h - l
    directions = {name: d.astype(dtype) for name, d in (("n", n), ("h", h), ("l", l), ("v", v)) if name in wanted}
    inputs = _as_rows(directions, constants, rows)
    # Rounding moves h; in half precision across the lobe's edge.
    truth = _exact(assignment, panel.truth, inputs)
    inside = truth[:, 0] >= IN_LOBE * _on_axis(assignment, panel.truth, constants, 0.0)
    return {name: array[inside] for name, array in inputs.items()}, truth[inside]


def _as_rows(drawn: Arrays, constants: Arrays, rows: int) -> Arrays:
    return {**drawn, **{name: np.broadcast_to(value, (rows, *value.shape)) for name, value in constants.items()}}


def _on_axis(assignment: Assignment, truth: str, constants: Arrays, angle: float) -> float:
    """The lobe's value where h is at `angle` from n."""
    h = np.array([[np.sin(angle), 0.0, np.cos(angle)]])
    drawn = {"n": np.array([[0.0, 0.0, 1.0]]), "h": h, "l": h, "v": h}
    return _exact(assignment, truth, _as_rows(drawn, constants, 1))[0, 0]


def _width(assignment: Assignment, truth: str, constants: Arrays) -> float:
    """The angle between n and h at which the lobe has fallen to IN_LOBE of its peak, by bisection."""
    least = IN_LOBE * _on_axis(assignment, truth, constants, 0.0)
    low, high = 1e-7, WIDEST
    if _on_axis(assignment, truth, constants, high) > least:
        return high
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _on_axis(assignment, truth, constants, middle) > least else (low, middle)
    return float(low)


def _moved(inputs: Arrays, seed: int) -> Arrays:
    """float64 inputs, each number of a direction off by at most half a unit in its last place."""
    rng = np.random.default_rng([seed, 1])
    return {
        name: array
        if array.ndim == 1
        else array + rng.uniform(-0.5, 0.5, array.shape) * np.spacing(np.abs(array)).astype(float)
        for name, array in inputs.items()
    }


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _turned(v: np.ndarray, angle: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each direction turned by its angle, whichever way."""
    aside = _unit(np.cross(v, rng.normal(size=v.shape)))
    return v * np.cos(angle)[:, None] + aside * np.sin(angle)[:, None]


# -------------------------------------------------------------------------------------------------------- values


def _arguments(assignment: Assignment, function: Function, inputs: Arrays, dtype: type) -> np.ndarray:
    """The inputs as the function's rows; a number stands for all components of a vector."""
    columns = function.inputs
    arrays = {}
    for column in columns:
        array = inputs[column.path]
        if column.width > 1:
            array = np.broadcast_to(array.reshape(len(array), -1), (len(array), column.width))
        arrays[column.path] = array
    return flat_rows(columns, arrays, dtype)


def _exact(assignment: Assignment, name: str, inputs: Arrays) -> np.ndarray:
    function = assignment.function(name)
    return exact.evaluate(assignment, function, _arguments(assignment, function, inputs, np.float64))


class _Code:
    """The functions of a folder in all precisions, compiled as the shading loops of a renderer are: over columns of
    numbers, which vectorises where the function allows it."""

    def __init__(self, assignment: Assignment, work: Workbench) -> None:
        self.assignment, self.work, self.sandbox = assignment, work, work.sandbox
        self.plugins: dict[str, Path] = {}
        self.timers = 0

    def evaluate(self, name: str, inputs: Arrays, precision: str) -> np.ndarray:
        """(rows, columns) float64."""
        rows = _arguments(self.assignment, self.assignment.function(name), inputs, PRECISIONS[precision].real)
        output = self.sandbox.fresh("results.bin")
        self._run(name, self._file(rows, "rows.bin"), output, precision)
        return np.fromfile(output, PRECISIONS[precision].real).reshape(-1, len(rows)).T.astype(np.float64)

    def timer(self, name: str, inputs: Arrays, precision: str) -> Callable[[], float]:
        """A callable that runs the function over the inputs in a process of its own and returns the seconds of EVALUATIONS."""
        rows = _arguments(self.assignment, self.assignment.function(name), inputs, PRECISIONS[precision].real)
        rows = np.resize(rows, (TIMED_ROWS, rows.shape[1]))
        self.timers += 1
        file = self._file(rows, f"timed-{self.timers}.bin")

        def run() -> float:
            statistics = self.sandbox.fresh("statistics.json")
            self._run(name, file, self.sandbox.fresh("results.bin"), precision, statistics)
            return float(np.median(json.loads(statistics.read_text())["seconds"])) * EVALUATIONS / TIMED_ROWS

        return run

    def _file(self, rows: np.ndarray, name: str) -> Path:
        file = self.sandbox.fresh(name)
        np.ascontiguousarray(rows.T).tofile(file)
        return file

    def _run(self, name: str, rows: Path, output: Path, precision: str, statistics: Path | None = None) -> None:
        if precision not in self.plugins:
            folder = self.work.student or self.assignment.directory
            self.plugins[precision] = self.work.plugin(self.assignment, PRECISIONS[precision].recipe, folder)
        command = renderer.evaluate(self.plugins[precision], name, rows, output, repeat=PASSES, statistics=statistics)
        outcome = self.sandbox.run(command, LIMITS)
        if not outcome.ok or not output.is_file():
            kind = UserError if self.work.student else InfrastructureError
            why = "gave no results (does the code call exit?)" if outcome.ok else outcome.explain(LIMITS)
            raise kind(f"{self.assignment.name}: {name} {why}")


# --------------------------------------------------------------------------------------------------- conclusions


def _conclude(study: Study, panel: FormsPanel, precision: str, part: Part) -> None:
    def series(label: str) -> dict[float, Point]:
        return {p.knob[panel.x]: p for p in part.points if p.series == label}

    # Half has too few settings that can be shown.
    for order in panel.orders if precision != "half" else []:
        low, high = order.over
        points = {x: p.error["rmse"] for x, p in series(order.form).items() if low <= x <= high}
        if len(points) < 3:
            continue
        slope, error = fit_slope(points, points.values())
        fit = f"{panel.x} from {low:g} to {high:g}"
        part.slopes.append(Slope(order.form, panel.x, f"{order.expected:g}", slope, error, fit))
        part.guides.append(Guide(order.form, order.expected, f"${panel.x}^{{{order.expected:g}}}$"))
    if not panel.compare:
        return
    better, worse = (series(label) for label in panel.compare)
    both = [x for x in better if x in worse]
    if not both:
        return
    last = both[-1]
    told = both if len(both) <= 5 else [both[0], last]

    def errors(points: dict[float, Point]) -> str:
        return ", ".join(f"{points[x].error['max']:.2g}" for x in told)

    part.claims.append(
        f"The largest error at {panel.x} = {', '.join(f'{x:g}' for x in told)}: {panel.compare[1]} {errors(worse)};"
        f" {panel.compare[0]} {errors(better)}, at the last {worse[last].error['max'] / better[last].error['max']:.2g} times smaller."
    )
    times = {form.label: series(form.label).get(last) for form in panel.forms}
    if all(point and point.seconds for point in times.values()):
        each = ", ".join(f"{name} {1e9 * point.seconds['median'] / EVALUATIONS:.1f}" for name, point in times.items())
        part.claims.append(
            f"Nanoseconds of an evaluation at {panel.x} = {last:g}: {each} (medians of {study.repeats} runs)."
        )
