"""How a function does at the ends of its domain: each value held against 50 digits, in floors of what the rounding of the
inputs makes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Column, Function, named_arrays
from shadelab.course.stability import Reciprocal
from shadelab.judge.words import numbers, result_of
from shadelab.truth.expected import Expected
from shadelab.truth.extremes import StableTable
from shadelab.truth.tables import renormalised

# The floor of a value: what half a unit in the last place of each input moves it by, added up; this many roundings of the result;
# and the smallest normal number (smaller ones may be flushed to zero). In GLSL also what the driver's own functions are off.
ROUNDINGS = 8
EPSILON = 2.0**-23
SMALLEST, LARGEST = 2.0**-126, 3.4e38
# A value may be off by this many floors: what is computed on the way is rounded like the inputs, and several times.
FLOORS = 4


def stable_inputs(expected: Expected, function: Function, series: str) -> np.ndarray:
    """In double, directions are unit vectors in double, too: what is compared is the algebra, not what float32 made of the
    inputs."""
    rows = expected.stable_table(function).rows
    return renormalised(function, rows) if series == "double" else rows


@dataclass
class Fault:
    """One row that is wrong, and how."""

    row: int
    kind: str  # "not finite" | "wrong sign" | "inaccurate" | "not monotone" | "not reciprocal"


@dataclass
class Stability:
    """How one function did over its table."""

    table: StableTable
    actual: np.ndarray
    error: np.ndarray  # (N,) floors; infinite where a value is not finite and should be
    faults: list[Fault]  # the first of each row, by row

    @property
    def worst(self) -> float:
        return float(self.error.max(initial=0.0))

    def labels(self, kind: str | None = None) -> list[str]:
        """The cases with faults (of this kind), in the table's order."""
        return list(dict.fromkeys(self.table.case(f.row) for f in self.faults if kind in (None, f.kind)))

    @property
    def right(self) -> float:
        """The share of the cases that are without a fault."""
        return 1 - len(self.labels()) / len(self.table.cases)


def judge(
    columns_in: list[Column],
    columns_out: list[Column],
    table: StableTable,
    actual: np.ndarray,
    driver: float = 0.0,
    reciprocal: Reciprocal | None = None,
) -> Stability:
    """driver: the relative error of the driver's own functions; 0 in C++."""
    actual = actual.astype(np.float64)
    truth, size = table.truth, np.empty_like(table.truth)
    for k, column in enumerate(columns_out):  # a vector is judged by its length: no component of a direction is exact
        if column.index == 0:
            member = slice(k, k + column.width)
            size[:, member] = np.abs(truth[:, member]).max(axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        floor = table.conditioning + (ROUNDINGS * EPSILON + driver) * size + SMALLEST
        asked = np.isfinite(truth) & np.isfinite(floor)
        inside = asked & (np.abs(truth) < LARGEST)
        error = np.where(inside, np.abs(actual - truth) / floor, 0.0)
        error = np.where(inside & ~np.isfinite(actual), np.inf, error)
        error = np.where(np.isnan(actual) & ~np.isnan(truth), np.inf, error)  # an overflow is infinite, and no NaN
        opposite = inside & (actual * truth < 0) & (np.abs(actual) > floor)

    first: dict[int, str] = {}

    def fault(rows: np.ndarray, kind: str) -> None:
        for row in rows:
            first.setdefault(int(row), kind)

    fault(np.flatnonzero(~np.isfinite(error).all(axis=1)), "not finite")
    fault(np.flatnonzero(opposite.any(axis=1)), "wrong sign")
    fault(np.flatnonzero((error > FLOORS).any(axis=1)), "inaccurate")
    fault(_not_monotone(table, actual, floor, inside), "not monotone")
    if reciprocal:
        fault(_not_reciprocal(columns_in, table, actual, floor, reciprocal), "not reciprocal")
    faults = [Fault(row, first[row]) for row in sorted(first)]
    return Stability(table, actual, error.max(axis=1), faults)


def judge_extremes(
    assignment: Assignment, expected: Expected, function: Function, backend: str, actual: np.ndarray
) -> Stability:
    """backend: cpp | double | glsl; all by the limits of float32, the driver's functions excused in GLSL."""
    declared = assignment.stability.get(function.name)
    return judge(
        function.inputs,
        function.outputs,
        expected.stable_table(function),
        actual,
        expected.driver(backend),
        declared.reciprocal if declared else None,
    )


def _not_monotone(table: StableTable, actual: np.ndarray, floor: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Rows of a sweep at which the truth rises and the function falls by more than a floor, or the other way round."""
    if not len(table.rising):
        return np.empty(0, int)
    one, two = table.rising.T
    with np.errstate(all="ignore"):
        truly, really = table.truth[two] - table.truth[one], actual[two] - actual[one]
        wrong = (truly * really < 0) & (np.abs(really) > floor[one] + floor[two]) & inside[one] & inside[two]
    return two[wrong.any(axis=1)]


def _not_reciprocal(
    columns: list[Column], table: StableTable, actual: np.ndarray, floor: np.ndarray, reciprocal: Reciprocal
) -> np.ndarray:
    """Asked where the truth is reciprocal itself: gates may look at one side only. To a floor each, as above: two values
    that are each within their own limit may still break the promise."""
    one, two = table.swapped.T
    scale = np.ones((len(table.rows), 1))
    if reciprocal.per:
        inputs = named_arrays(columns, table.rows.astype(np.float64))
        a, b = (inputs[name] for name in reciprocal.per.split("."))
        scale = np.sum(a * b, axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        truth, value, slack = table.truth / scale, actual / scale, floor / np.abs(scale)
        same = np.abs(truth[one] - truth[two]) <= 1e-6 * np.abs(truth[one]) + slack[one]
        wrong = same & (np.abs(value[one] - value[two]) > slack[one] + slack[two])
    return two[wrong.any(axis=1)]


# ------------------------------------------------------------------------------------------------------- in words


def describe(stability: Stability, double: Stability | None = None) -> str:
    """What is wrong, in a sentence. `double`: how the same lines do in double."""
    if not stability.faults:
        return ""
    parts = []
    for kind in dict.fromkeys(fault.kind for fault in stability.faults):
        rows = [fault.row for fault in stability.faults if fault.kind == kind]
        parts.append(
            f"{kind} for {len(rows)} of {len(stability.table.rows)} extreme inputs ({_some(stability.labels(kind))})"
        )
    if np.isfinite(stability.worst):
        parts.append(f"up to {stability.worst:.3g} times what rounding of the inputs explains")
    if double is not None and not double.faults:
        parts.append("the same lines are right in double: the algebra loses digits that float32 does not have")
    return "; ".join(parts)


def _some(names: list[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def first_input(function: Function, stability: Stability) -> dict[str, Any]:
    """The first failing input: case, kind, inputs, expected and actual, as numbers or, where not finite, words."""
    return row_input(function, stability, stability.faults[0].row)


def row_input(function: Function, stability: Stability, row: int) -> dict[str, Any]:
    inputs = named_arrays(function.inputs, stability.table.rows[row : row + 1])
    kind = next((fault.kind for fault in stability.faults if fault.row == row), "")
    return {
        "case": stability.table.case(row),
        "kind": kind,
        "inputs": {name: numbers(value[0]) for name, value in inputs.items()},
        "expected": result_of(function.outputs, stability.table.truth[row]),
        "actual": result_of(function.outputs, stability.actual[row]),
    }
