"""From evidence and expected data to checks: what is wrong, how much of it, and where it is worst.

Nothing here runs student code or loads a file that student code wrote; it only compares numbers.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Column, Function, Scene, named_arrays
from shadelab.result import Check, Error, Worst
from shadelab.truth.expected import BACKGROUND, CHANNELS, EDGE, INTERIOR, SceneTruth, Table

# Limits are derived. reference.py measures how far correct programs stray (the solution, the slides' formulas and all correct
# variants, in C++ with and without fused multiply-add and in GLSL): the floor. A limit is this many floors. The same number of
# times the conditioning of the inputs is allowed, since 8 random draws fall short of the worst rounding.
FACTOR = 4
# No floor is lower than this. C++: constants written with five digits (3.1416 for pi is 2.3e-6 off), squared and times two. GLSL:
# what the driver's own functions are off; the farthest is llvmpipe's acos (a test measures it).
LEAST_FLOOR = {"cpp": 1e-5, "glsl": 2.3e-4}
# Values below this share of the table's scale are judged absolutely: a highlight's tail is not worth its relative error.
SMALL = 1e-3

# Follow-through: the least share of the inputs for which the result differs from its most frequent value.
VARIED = 0.01

# Image checks. FULL_MARKS: the share of interior pixels that may be off, 3 of 10,000, or FACTOR times the share that a correct
# program has by the limits that the others set.
FULL_MARKS = 3e-4
SMALL_PIXEL = 1e-2  # of the scene's scale: what is darker is judged absolutely
EDGE_CAP = 0.25  # share of edge pixels that may be off; beyond it, and with any value that is not finite, at most half the marks

# Partial credit: by the share of inputs or pixels that are wrong, falling with its logarithm from LITTLE to NO_MARKS. Something
# that is wrong loses at least MISTAKE of the points.
LITTLE, NO_MARKS = 1e-3, 1e-1
MISTAKE = 0.25


def credit(share: float) -> float:
    """The share of the points for a share of wrong inputs or pixels: three quarters up to 0.1 %, half of that at 1 %, none from
    10 % on."""
    fallen = np.log(max(share, LITTLE) / LITTLE) / np.log(NO_MARKS / LITTLE)
    return (1 - MISTAKE) * float(np.clip(1 - fallen, 0, 1))


# ----------------------------------------------------------------------------------------------------- functions


def function_members(assignment: Assignment, function: Function) -> list[slice]:
    """The columns of each member of the result; each is judged by its own scale."""
    columns = assignment.output_columns(function)
    return [slice(k, k + c.width) for k, c in enumerate(columns) if c.index == 0]


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


def largest_error(actual: np.ndarray, table: Table, members: list[slice]) -> tuple[float, int]:
    """And its row."""
    error = scaled_error(actual, table, members).max(axis=1)
    row = int(np.argmax(error))
    return float(error[row]), row


@dataclass
class Followed:
    """The truth of a function when the student's own functions stand in for those that it calls."""

    truth: np.ndarray  # (N, results) float64; where it is not finite, nothing is asked
    conditioning: np.ndarray  # as truth
    not_finite: bool  # whether these functions give values that are not finite for some inputs


@dataclass
class FunctionJudgement:
    check: Check
    table: Table  # by which it was judged: with follow-through, another truth
    followed: bool
    wrong: np.ndarray  # (N,) bool


def judge_function(
    assignment: Assignment,
    function: Function,
    backend: str,
    points: float,
    table: Table,
    floor: float,
    actual: np.ndarray,
    followed: Followed | None = None,
) -> FunctionJudgement:
    rows, limit = table.rows, function_limit(floor, backend)
    columns, members = assignment.output_columns(function), function_members(assignment, function)
    if followed is not None:
        table = replace(table, truth=followed.truth, conditioning=followed.conditioning)
    error = scaled_error(actual, table, members)
    if followed is not None:
        error[~np.isfinite(table.truth + table.conditioning).all(axis=1)] = 0.0
        # A callee's last bit may decide whether it is finite; a few such rows are its fault.
        spoilt = ~np.isfinite(actual).all(axis=1)
        if followed.not_finite and spoilt.mean() < VARIED:
            error[spoilt] = 0.0
    wrong = error.max(axis=1) > limit
    worst_row, worst_column = np.unravel_index(np.argmax(error), error.shape)
    largest = float(error[worst_row, worst_column])
    passed = not wrong.any()
    check = Check(
        id=f"{backend}/function/{function.name}",
        kind="function",
        backend=backend,
        status="passed" if passed else "failed",
        score=points * (1.0 if passed else credit(float(wrong.mean()))),
        max_score=points,
        error=Error(name="scaled", value=_finite(largest), limit=limit, floor=limit / FACTOR),
        needs=[f"{backend}/build"],
    )
    if not passed:
        check.message = _describe_function(assignment, function, rows, table.truth, actual, error, limit, members)
        inputs = named_arrays(assignment.input_columns(function), rows[worst_row : worst_row + 1])
        check.worst = Worst(
            inputs={name: _numbers(value[0]) for name, value in inputs.items()} | _half(inputs),
            expected=_result(columns, table.truth[worst_row]),
            actual=_result(columns, actual[worst_row]),
        )
    return FunctionJudgement(check, table, followed is not None, wrong)


def judge_parity(
    assignment: Assignment,
    function: Function,
    table: Table,
    floor: float,
    cpp: np.ndarray,
    glsl: np.ndarray,
    right: list[str],
) -> Check:
    """Whether the student's two languages compute the same. floor: of both together. `right`: the languages that pass."""
    columns, members = assignment.output_columns(function), function_members(assignment, function)
    limit = function_limit(floor, "glsl")
    error = scaled_error(
        glsl, replace(table, truth=cpp.astype(np.float64), conditioning=2 * table.conditioning), members
    )
    wrong = error.max(axis=1) > limit
    check = Check(
        id=f"glsl/parity/{function.name}", kind="parity", backend="glsl", status="failed" if wrong.any() else "passed",
        score=0.0, max_score=0.0, needs=["cpp/build", "glsl/build"],
        error=Error(name="scaled", value=_finite(error.max()), limit=limit, floor=limit / FACTOR),
    )  # fmt: skip
    if wrong.any():
        row = int(np.argmax(error.max(axis=1)))
        inputs = named_arrays(assignment.input_columns(function), table.rows[row : row + 1])
        check.message = f"C++ and GLSL disagree for {_share(wrong.mean())} of the inputs; " + (
            "C++ is right"
            if right == ["cpp"]
            else "GLSL is right"
            if right == ["glsl"]
            else "each is within its own limit"
        )
        check.worst = Worst(
            inputs={name: _numbers(value[0]) for name, value in inputs.items()} | _half(inputs),
            expected=_result(columns, cpp[row]),
            actual=_result(columns, glsl[row]),
        )
    return check


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def informative(followed: np.ndarray) -> bool:
    """Whether follow-through still asks for something. Callees that always give the same may leave nothing to be right about: a
    function that is not written yet, and always gives 0, is not right because everything it calls gives 0."""
    finite = np.isfinite(followed).all(axis=1)
    if finite.mean() < 0.5:
        return False
    counts = np.unique(followed[finite].astype(np.float32), axis=0, return_counts=True)[1]
    return bool(1 - counts.max() / finite.sum() >= VARIED)


def _half(inputs: dict[str, np.ndarray]) -> dict[str, Any]:
    """h, where the inputs have an l and a v: most formulas are about it."""
    if "l" not in inputs or "v" not in inputs or "h" in inputs:
        return {}
    h = (inputs["l"][0].astype(np.float64) + inputs["v"][0]).astype(np.float64)
    length = np.linalg.norm(h)
    return {"h": _numbers(h / length)} if length > 0 else {}


def _describe_function(
    assignment: Assignment,
    function: Function,
    rows: np.ndarray,
    truth: np.ndarray,
    actual: np.ndarray,
    error: np.ndarray,
    limit: float,
    members: list[slice],
) -> str:
    bad = error.max(axis=1) > limit
    columns = assignment.output_columns(function)
    parts = []
    names = [columns[m.start].path.removeprefix("result.") for m in members]
    wrong = [name for name, m in zip(names, members) if (error[:, m] > limit).any()]
    where = _share(bad.mean()) + " of the inputs"
    if len(members) > 1 and len(wrong) < len(members):
        right = [name for name in names if name not in wrong]
        where += f", only in {_and(wrong)} ({_and(right)} {'is' if len(right) == 1 else 'are'} right)"
    parts.append(f"wrong for {where}")
    if not_finite := int((~np.isfinite(actual) & np.isfinite(truth)).any(axis=1).sum()):
        parts.append(f"not finite for {not_finite} of {len(rows)} inputs")
    for sentence in (_side(assignment, function, rows, bad), _relation(truth, actual, error, limit)):
        if sentence:
            parts.append(sentence)
    return "; ".join(parts)


def _side(assignment: Assignment, function: Function, rows: np.ndarray, bad: np.ndarray) -> str:
    """Whether the wrong inputs are those with a direction below the surface: the sign of a missing gate or clamp."""
    inputs = named_arrays(assignment.input_columns(function), rows)
    for value in function.values:
        if value.domain.kind == "upper":
            cosine = np.sum(inputs[value.name] * inputs[value.domain.base], axis=1)
            below = cosine >= 0 if value.domain.opposite else cosine <= 0
            if not (bad & ~below).any():
                cosine = f"({value.domain.base}.{value.name} {'>=' if value.domain.opposite else '<='} 0)"
                if value.domain.opposite:
                    return f"only where {value.name} points the way of {value.domain.base} {cosine}"
                return f"only where {value.name} does not point above the surface {cosine}"
    return ""


def _relation(truth: np.ndarray, actual: np.ndarray, error: np.ndarray, limit: float) -> str:
    """A constant factor between what came and what was expected, where there is one. Judged where the truth is not small."""
    scale = np.percentile(np.abs(truth), 95)
    use = np.isfinite(actual) & (np.abs(truth) > 0.05 * scale) & (error > limit)
    if use.sum() < 20:
        return ""
    ratio = actual[use] / truth[use]
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    if high - low > 0.01 * abs(middle) + 1e-6:
        return ""
    return "yours is always 0" if middle == 0 else f"yours is always {middle:.4g} times what is expected"


def _numbers(values: np.ndarray) -> list[float | str]:
    """JSON has no NaN and no infinity: they travel as words."""
    return [float(v) if np.isfinite(v) else str(float(v)) for v in np.atleast_1d(values)]


def _result(columns: list[Column], row: np.ndarray) -> list[Any]:
    """The numbers of a result, or one dict of a struct's members."""
    named = named_arrays(columns, row[None])
    if list(named) == ["result"]:
        return _numbers(named["result"][0])
    return [{path.removeprefix("result."): _numbers(value[0]) for path, value in named.items()}]


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def _share(share: float) -> str:
    if share > 0.995:
        return "all" if share == 1 else "nearly all"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


# -------------------------------------------------------------------------------------------------------- images


@dataclass
class ImageJudgement:
    check: Check
    limit: np.ndarray  # (H, W, 3): what each pixel of the total may be off


def image_limit(truth: SceneTruth, floor: float) -> np.ndarray:
    """FACTOR times what a shift of 1/16 pixel and the floor of the arithmetic make of each pixel; (H, W, 3) float32. One limit for
    both languages: a picture is a picture."""
    size = np.abs(truth.total) + np.float32(SMALL_PIXEL * truth.scale)
    return np.float32(FACTOR) * (truth.noise[..., None] + np.float32(max(floor, LEAST_FLOOR["glsl"])) * size)


def pixel_error(total: np.ndarray, truth: SceneTruth) -> np.ndarray:
    """(H, W): what the floor of the arithmetic has to explain: the largest channel's error beyond the noise, relative."""
    size = np.abs(truth.total) + np.float32(SMALL_PIXEL * truth.scale)
    beyond = np.abs(total - truth.total) - truth.noise[..., None]
    return np.nan_to_num((np.maximum(0, beyond) / size).max(axis=2), nan=np.inf)


def violating_share(total: np.ndarray, reference: np.ndarray, limit: np.ndarray, judged: np.ndarray) -> float:
    return float((_violations(total, reference, limit) & judged).sum() / judged.sum())


def judge_image(scene: Scene, backend: str, points: float, truth: SceneTruth, layers: np.ndarray) -> ImageJudgement:
    """layers: (H, W, 13) float32, the CHANNELS up to coverage; the edges come from our own geometry layers."""
    actual = np.ascontiguousarray(layers[..., CHANNELS["total"]])
    foreground = truth.layers["id"][..., 0] > 0
    limit = image_limit(truth, max(truth.facts.spread.values(), default=0.0))
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
            f"the scene leaves only {_share(interior.sum() / max(foreground.sum(), 1))} of its foreground to judge"
        )
        return ImageJudgement(check, limit)

    violates = _violations(actual, truth.total, limit)
    # Background pixels carry no shading; one that differs counts like an interior pixel.
    share = float((violates & (interior | background)).sum() / interior.sum())
    edge_share = float((violates & edge).sum() / max(edge.sum(), 1))
    finite = _every_channel(np.isfinite(actual))
    fraction = 1.0 if share <= most else credit(share)
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
    return ImageJudgement(check, limit)


def _every_channel(true: np.ndarray) -> np.ndarray:
    """(H, W, 3) -> (H, W). Written out: numpy's own reduction over so short an axis takes ten times as long."""
    return true[..., 0] & true[..., 1] & true[..., 2]


def _violations(actual: np.ndarray, reference: np.ndarray, limit: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", over="ignore"):
        return ~_every_channel(np.abs(actual - reference) <= limit)  # written so that NaN violates


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
        parts.append(f"{_share(share)} of the interior pixels are off (at most {_share(most)} may be)")
    if not finite.all():
        y, x = np.argwhere(~finite)[0]
        parts.append(f"{(~finite).sum()} pixels are not finite, the first at ({x}, {y})")
    if edge_share > EDGE_CAP and share <= most:
        parts.append(f"{_share(edge_share)} of the edge pixels are off (at most {_share(EDGE_CAP)} may be)")
    wrong, right = [], []
    for term in ("ambient", "diffuse", "specular"):
        reference, actual = truth.layers[term], np.ascontiguousarray(layers[..., CHANNELS[term]])
        off = _violations(actual, reference, limit) & interior
        (wrong if off.sum() > most * interior.sum() else right).append(term)
    if wrong and right:
        parts.append(
            f"{_and(wrong)} {'is' if len(wrong) == 1 else 'are'} wrong, {_and(right)} {'is' if len(right) == 1 else 'are'} right"
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
            "n": _numbers(truth.layers["normal"][y, x]),
            "x": _numbers(position),
            "v": _numbers(view / np.linalg.norm(view)),
        }
    return Worst(inputs=inputs, expected=_numbers(truth.total[y, x]), actual=_numbers(actual[y, x]))
