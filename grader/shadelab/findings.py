"""From evidence and expected data to checks: what is wrong, how much of it, and where it is worst.

Nothing here runs student code or loads a file that student code wrote; it only compares numbers.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from shadelab.expected import BACKGROUND, CHANNELS, EDGE, INTERIOR, SceneTruth, Table
from shadelab.manifest import Assignment, Column, Function, Scene, named_arrays
from shadelab.result import Check, Error, Worst

# Function checks: the largest error that passes. Correct naive code strays to 1.6e-4 in C++ and 2.2e-3 in GLSL (the rest is the
# driver's pow and acos), so the limits leave a factor of 6 and 4.5.
FUNCTION_LIMIT = {"cpp": 1e-3, "glsl": 1e-2}
# Values below this share of the table's scale are judged absolutely: a highlight's tail is not worth its relative error.
SMALL = 1e-3

# Where rounding of the inputs alone changes the truth (n.v near 0 in a model that divides by it), no formula is better than
# that: so many times the change seen under random rounding is allowed. Eight samples fall short of the worst case.
FLOOR_FACTOR = 4

# Image checks. A pixel violates when |delta| > RELATIVE |ref| + ABSOLUTE s, with s the 95th percentile of the reference.
RELATIVE, ABSOLUTE = 1e-2, 2e-3
FULL_MARKS = 1e-3  # share of interior pixels that may violate
NO_MARKS = 1e-1
EDGE_CAP = 0.25  # share of edge pixels that may violate; beyond it, and with any value that is not finite, at most half the marks


def interior_score(share: float) -> float:
    """The share of the marks for a share of violating interior pixels: all up to 0.1 %, then falling with the logarithm,
    a half at 1 %, none from 10 % on."""
    if share <= FULL_MARKS:
        return 1.0
    return float(max(0.0, 1 - np.log(share / FULL_MARKS) / np.log(NO_MARKS / FULL_MARKS)))


# ----------------------------------------------------------------------------------------------------- functions


def scaled_error(
    actual: np.ndarray, truth: np.ndarray, members: list[slice], floor: np.ndarray, limit: float
) -> np.ndarray:
    """e = |a - t| / (|t| + 1e-3 S) per number, S the 95th percentile of |t| over the table and the member. Where the floor is
    not small, the denominator grows, so that e <= limit means |a - t| <= limit (|t| + 1e-3 S) + FLOOR_FACTOR floor. Not finite
    where the truth is finite: infinity."""
    error = np.empty(truth.shape)
    for member in members:
        t, a = truth[:, member], actual[:, member].astype(np.float64)
        finite = np.isfinite(t)
        scale = np.percentile(np.abs(t[finite]), 95) if finite.any() else 1.0
        with np.errstate(all="ignore"):
            allowed = np.abs(t) + SMALL * max(scale, 1e-30) + FLOOR_FACTOR / limit * floor[:, member]
            e = np.abs(a - t) / allowed
        # A truth that is not finite asks for the same kind of value; anything else that is not finite fails.
        same = ~finite & ((np.isnan(t) & np.isnan(a)) | (a == t))
        error[:, member] = np.where(same, 0.0, np.where(np.isfinite(a) & finite, e, np.inf))
    return error


def judge_function(
    assignment: Assignment,
    function: Function,
    backend: str,
    points: float,
    table: Table,
    actual: np.ndarray,
) -> Check:
    rows, truth = table.rows, table.truth
    columns = assignment.output_columns(function)
    members = [slice(k, k + c.width) for k, c in enumerate(columns) if c.index == 0]
    limit = FUNCTION_LIMIT[backend]
    error = scaled_error(actual, truth, members, table.floor, limit)
    worst_row, worst_column = np.unravel_index(np.argmax(error), error.shape)
    largest = float(error[worst_row, worst_column])
    passed = largest <= limit
    check = Check(
        id=f"{backend}/function/{function.name}",
        kind="function",
        backend=backend,
        status="passed" if passed else "failed",
        score=points if passed else 0.0,
        max_score=points,
        error=Error(name="scaled", value=largest if np.isfinite(largest) else None, limit=limit),
        needs=[f"{backend}/build"],
    )
    if not passed:
        check.message = _describe_function(assignment, function, rows, truth, actual, error, limit, members)
        inputs = named_arrays(assignment.input_columns(function), rows[worst_row : worst_row + 1])
        check.worst = Worst(
            inputs={name: _numbers(value[0]) for name, value in inputs.items()},
            expected=_result(columns, truth[worst_row]),
            actual=_result(columns, actual[worst_row]),
        )
    return check


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


def judge_image(scene: Scene, backend: str, points: float, truth: SceneTruth, layers: np.ndarray) -> ImageJudgement:
    """layers: (H, W, 13) float32, the CHANNELS up to coverage; the edges come from our own geometry layers."""
    actual = np.ascontiguousarray(layers[..., CHANNELS["total"]])
    foreground = truth.layers["id"][..., 0] > 0
    limit = _limit(truth.total, truth.scale)
    check = Check(
        id=f"{backend}/image/{scene.name}",
        kind="image",
        backend=backend,
        status="passed",
        score=points,
        max_score=points,
        needs=[f"{backend}/build"],
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
    not_finite = int((~finite).sum())
    fraction = interior_score(share)
    if not_finite or edge_share > EDGE_CAP:
        fraction = min(fraction, 0.5)
    check.error = Error(name="interior violations", value=share, limit=FULL_MARKS)
    check.score = points * fraction
    if fraction < 1:
        check.status = "failed"
        check.message = _describe_image(truth, layers, finite, share, edge_share, interior)
        lost_for = ~finite
        if share > FULL_MARKS:
            lost_for |= violates & ~edge
        if edge_share > EDGE_CAP:
            lost_for |= violates & edge
        check.worst = _worst_pixel(truth, actual, limit, lost_for)
    return ImageJudgement(check, limit)


def _limit(reference: np.ndarray, scale: float) -> np.ndarray:
    return np.float32(RELATIVE) * np.abs(reference) + np.float32(ABSOLUTE * scale)


def _every_channel(true: np.ndarray) -> np.ndarray:
    """(H, W, 3) -> (H, W). Written out: numpy's own reduction over so short an axis takes ten times as long."""
    return true[..., 0] & true[..., 1] & true[..., 2]


def _violations(actual: np.ndarray, reference: np.ndarray, limit: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", over="ignore"):
        return ~_every_channel(np.abs(actual - reference) <= limit)  # written so that NaN violates


def _describe_image(
    truth: SceneTruth, layers: np.ndarray, finite: np.ndarray, share: float, edge_share: float, interior: np.ndarray
) -> str:
    parts = []
    if share > FULL_MARKS:
        parts.append(f"{_share(share)} of the interior pixels are off (at most {_share(FULL_MARKS)} may be)")
    if not finite.all():
        y, x = np.argwhere(~finite)[0]
        parts.append(f"{(~finite).sum()} pixels are not finite, the first at ({x}, {y})")
    if edge_share > EDGE_CAP and share <= FULL_MARKS:
        parts.append(f"{_share(edge_share)} of the edge pixels are off (at most {_share(EDGE_CAP)} may be)")
    wrong, right = [], []
    for term in ("ambient", "diffuse", "specular"):
        reference, actual = truth.layers[term], np.ascontiguousarray(layers[..., CHANNELS[term]])
        off = _violations(actual, reference, _limit(reference, truth.scale)) & interior
        (wrong if off.sum() > FULL_MARKS * interior.sum() else right).append(term)
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
