"""A function's outputs against the truth: how many are wrong, where, and by what relation."""

from dataclasses import dataclass, replace

import numpy as np

from shadelab.course.assignment import Function, named_arrays
from shadelab.judge.credit import credit, size_of
from shadelab.judge.places import place_of, telling
from shadelab.judge.words import finite_or_none, halfway, numbers, percent_of, result_of
from shadelab.result import Check, Error, Worst
from shadelab.truth.expected import Table
from shadelab.truth.measures import FACTOR, function_limit, function_members, scaled_error
from shadelab.words import listed

# What a program has right in double, on the same inputs, is no mistake of the function: another algebra loses digits in other
# places, or the driver's acos does, and that is what the points for stability are for. But a function that is garbage, off by
# more than OFF, for a larger share than this is wrong.
GARBAGE, OFF = 0.05, 1e-2
# Follow-through: the least share of the inputs for which the result differs from its most frequent value.
VARIED = 0.01
OFTEN = 0.05  # the share of the inputs for which a constant is expected often


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
    error: np.ndarray  # (N,) the largest scaled error of each row; infinite for what is not finite


def judge_function(
    function: Function,
    backend: str,
    points: float,
    table: Table,
    floor: float,
    actual: np.ndarray,
    followed: Followed | None = None,
    excused: np.ndarray | None = None,
) -> FunctionJudgement:
    """excused: (N,) bool, rows on which only rounding is wrong (see GARBAGE)."""
    rows, limit = table.rows, function_limit(floor, backend)
    columns, members = function.outputs, function_members(function)
    if followed is not None:
        table = replace(table, truth=followed.truth, conditioning=followed.conditioning)
    error = scaled_error(actual, table, members)
    if followed is not None:
        error[~np.isfinite(table.truth + table.conditioning).all(axis=1)] = 0.0
        # A callee's last bit may decide whether it is finite; a few such rows are its fault.
        spoilt = ~np.isfinite(actual).all(axis=1)
        if followed.not_finite and spoilt.mean() < VARIED:
            error[spoilt] = 0.0
    if excused is not None:
        error[excused] = 0.0
    wrong = error.max(axis=1) > limit
    worst_row, worst_column = np.unravel_index(np.argmax(error), error.shape)
    largest = float(error[worst_row, worst_column])
    passed = not wrong.any()
    check = Check(
        id=f"{backend}/function/{function.name}",
        kind="function",
        backend=backend,
        status="passed" if passed else "failed",
        score=points * (1.0 if passed else credit(float(wrong.mean()), size_of(error.max(axis=1)[wrong]))),
        max_score=points,
        error=Error(name="scaled", value=finite_or_none(largest), limit=limit, floor=limit / FACTOR),
        needs=[f"{backend}/build"],
    )
    if not passed:
        check.message = _describe_function(function, rows, table.truth, actual, error, limit, members)
        inputs = named_arrays(function.inputs, rows[worst_row : worst_row + 1])
        told = {name: numbers(value[0]) for name, value in inputs.items()}
        # What differs from row to row first: of a long line a narrow terminal shows the beginning.
        of_structs = {name: value for name, value in told.items() if "." in name}
        check.worst = Worst(
            inputs={name: value for name, value in told.items() if name not in of_structs}
            | halfway(inputs)
            | of_structs,
            expected=result_of(columns, table.truth[worst_row]),
            actual=result_of(columns, actual[worst_row]),
        )
    return FunctionJudgement(check, table, followed is not None, wrong, error.max(axis=1))


def may_be_rounding(judgement: FunctionJudgement, exact: np.ndarray) -> np.ndarray | None:
    """(N,) bool: the wrong rows that double may excuse; None when there are none, or too much is garbage. exact: rows whose
    inputs hold no rounding, on which it excuses nothing; nor does it excuse what is not finite."""
    asked = judgement.wrong & ~exact & np.isfinite(judgement.error)
    garbage = judgement.wrong & (judgement.error > OFF)
    return asked if asked.any() and garbage.mean() <= GARBAGE else None


def _constant_not_met(truth: np.ndarray, bad: np.ndarray) -> str:
    """What is expected again and again, and hardly ever given: 1 inside of a cone, say; empty where there is none."""
    values, which, counts = np.unique(truth, axis=0, return_inverse=True, return_counts=True)
    for k in np.argsort(-counts)[:3]:
        here = which.ravel() == k
        if counts[k] >= OFTEN * len(truth) and values[k].any() and bad[here].mean() > 0.5 > bad.mean():
            return f"{values[k][0]:.4g}" if len(set(values[k].tolist())) == 1 else ""
    return ""


def informative(followed: np.ndarray) -> bool:
    """Whether follow-through still asks for something. Callees that always give the same may leave nothing to be right about: a
    function that is not written yet, and always gives 0, is not right because everything it calls gives 0."""
    finite = np.isfinite(followed).all(axis=1)
    if finite.mean() < 0.5:
        return False
    counts = np.unique(followed[finite].astype(np.float32), axis=0, return_counts=True)[1]
    return bool(1 - counts.max() / finite.sum() >= VARIED)


def _describe_function(
    function: Function,
    rows: np.ndarray,
    truth: np.ndarray,
    actual: np.ndarray,
    error: np.ndarray,
    limit: float,
    members: list[slice],
) -> str:
    bad = error.max(axis=1) > limit
    columns = function.outputs
    parts = []
    names = [columns[m.start].path.removeprefix("result.") for m in members]
    wrong = [name for name, m in zip(names, members) if (error[:, m] > limit).any()]
    where = percent_of(bad.mean()) + " of the inputs"
    if len(members) > 1 and len(wrong) < len(members):
        right = [name for name in names if name not in wrong]
        where += f", only in {listed(wrong)} ({listed(right)} {'is' if len(right) == 1 else 'are'} right)"
    parts.append(f"wrong for {where}")
    if not_finite := int((~np.isfinite(actual) & np.isfinite(truth)).any(axis=1).sum()):
        parts.append(f"not finite for {not_finite} of {len(rows)} inputs")
    if not_met := _constant_not_met(truth, bad):
        parts.append(f"not {not_met} where {not_met} is expected")
    if (same := np.unique(actual, axis=0)).shape[0] == 1:
        constant = same[0].tolist()
        said = f"{constant[0]:.4g}" if len(set(constant)) == 1 else f"({', '.join(f'{v:.4g}' for v in constant)})"
        parts.append(f"yours is always {said}")
    elif (condition := place_of(function, rows, truth, bad, telling(truth, bad, bad))) and not (
        bad & ~condition.rows
    ).any():
        parts.append(f"only where {condition}")
    return "; ".join(parts)
