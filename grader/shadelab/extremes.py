"""Numerical stability: inputs at the ends of the domains, their truth, and how far a function may be off there.

stability.toml beside an assignment's manifest declares what cannot be read off the domains:

[[function]]
name = "beckmann"
points = 3                               # both languages together
idea = "..."                             # the better form, for whoever loses these points
reciprocal = { swap = ["l", "v"] }       # promised: equal when these change places; per = "n.l" divides each by its own n.l first
ordered = [["hotspot", "falloff"]]       # the first is never larger
[[function.case]]                        # rows for one stiff case
name = "m = 1e-4"
hazards = [6]                            # numbers of docs/stability.md
pin = { m = 1e-4, h = { near = "n", by = [1e-6, 1e-3] } }

A pinned column is a constant, a copy of another ("light.position", "-v"), or lies close to one: `near` another direction or to
"mirror(l)", `by` an angle in radians between the two (positions: a distance), spread over its logarithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from shadelab.errors import UserError
from shadelab.manifest import Assignment, Column, Domain, Function, named_arrays
from shadelab.paths import shown
from shadelab.tables import (
    as_rows,
    axis_rows,
    draw_values,
    log_distances,
    rotated,
    unit_vectors,
)
from shadelab.toml_files import Declared, validated

FILE = "stability.toml"

CASE_ROWS = 24
WIDE_ROWS = 96  # drawn over all of the domains
SWEEP_ROWS = 24  # one argument moves, the others stand still
ANYWHERE, EXACT, SWAPPED = "anywhere in the domain", "exactly on axes", "arguments exchanged"

# The floor of a value: what half a unit in the last place of each input moves it by, added up; this many roundings of the result;
# and the smallest normal number (smaller ones may be flushed to zero). In GLSL also what the driver's own functions are off.
ROUNDINGS = 8
EPSILON = 2.0**-23
SMALLEST, LARGEST = 2.0**-126, 3.4e38
# A value may be off by this many floors: what is computed on the way is rounded like the inputs, and several times.
FLOORS = 4


# ---------------------------------------------------------------------------------------------------- declarations


class Near(Declared):
    near: str
    by: tuple[float, float]


class Case(Declared):
    name: str
    hazards: list[int] = []
    pin: dict[str, float | list[float] | str | Near] = {}


class Reciprocal(Declared):
    swap: tuple[str, str]
    per: str | None = None  # "n.l": divided by the dot product of these two arguments first


class Stable(Declared):
    """What is declared of one function."""

    name: str
    points: float = Field(0, ge=0)
    idea: str = ""
    reciprocal: Reciprocal | None = None
    ordered: list[tuple[str, str]] = []
    case: list[Case] = []


class _File(Declared):
    function: list[Stable] = []


def load_stability(directory: Path, functions: Sequence[Function]) -> dict[str, Stable]:
    """By function; empty where nothing is declared."""
    file = directory / FILE
    if not file.exists():
        return {}
    declared: _File = validated(_File, file)
    names = {f.name for f in functions}
    for stable in declared.function:
        if stable.name not in names:
            raise UserError(f"{shown(file)}: {stable.name}: the manifest declares no such function")
        if stable.points and not stable.idea:
            raise UserError(f"{shown(file)}: {stable.name}: whoever loses its points needs an idea")
    return {stable.name: stable for stable in declared.function}


# ---------------------------------------------------------------------------------------------------------- tables


@dataclass
class StableTable:
    """Extreme inputs of one function, and what they ask."""

    rows: np.ndarray  # (N, columns) float32
    labels: np.ndarray  # (N,): the case that a row belongs to, an index into `cases`
    rising: np.ndarray  # (P, 2) rows that follow each other on a sweep
    swapped: np.ndarray  # (S, 2) rows of which one is the other with two arguments exchanged
    truth: np.ndarray  # (N, results) float64, from 50 digits; NaN: nothing is asked
    conditioning: np.ndarray  # as truth
    cases: list[str]

    def arrays(self) -> dict[str, np.ndarray]:
        return {name: value for name, value in vars(self).items() if name != "cases"}

    def case(self, row: int) -> str:
        return self.cases[self.labels[row]]


def extreme_table(assignment: Assignment, function: Function, seed: int) -> StableTable:
    """Still without truth and conditioning (NaN)."""
    stable = assignment.stability.get(function.name, Stable(name=function.name))
    rng = np.random.default_rng([seed, *function.name.encode()])
    parts: list[tuple[str, np.ndarray]] = []

    def add(label: str, drawn: dict[str, np.ndarray]) -> None:
        for low, high in stable.ordered:
            drawn[low] = np.minimum(drawn[low], drawn[high])
        parts.append((label, as_rows(assignment, function, drawn)))

    def draw(rows: int, pinned: dict[str, Any]) -> dict[str, np.ndarray]:
        drawn: dict[str, np.ndarray] = {}
        constant = {path: value for path, value in pinned.items() if isinstance(value, (int, float, list))}
        draw_values(assignment, function.values, "", rows, rng, drawn, _extreme, constant)
        for path, value in pinned.items():
            if path not in drawn:
                raise UserError(
                    f"{shown(assignment.directory / FILE)}: {function.name}: pin {path} is no column; there is {', '.join(drawn)}"
                )
            if isinstance(value, str):
                drawn[path] = _other(drawn, value, function)
            elif isinstance(value, Near):
                drawn[path] = _close(_other(drawn, value.near, function), value.by, path, rows, rng)
        return drawn

    for case in stable.case:
        add(case.name, draw(CASE_ROWS, case.pin))
    add(ANYWHERE, draw(WIDE_ROWS, {}))
    directions = sum(v.domain.kind in ("unit", "upper") for v in function.values)
    if directions > 1:
        exact = draw(6**directions, {})
        axis_rows(function, exact)
        add(EXACT, exact)
    rising = []
    for path, values in _sweeps(assignment, function):
        drawn = {name: np.repeat(column[:1], SWEEP_ROWS, axis=0) for name, column in draw(1, {}).items()}
        if isinstance(values, str):  # away from this direction, in a plane
            tangent = unit_vectors(np.cross(drawn[values], rng.normal(size=3)))
            angle = np.geomspace(1e-5, 1.5, SWEEP_ROWS)[:, None]
            drawn[path] = drawn[values] * np.cos(angle) + tangent * np.sin(angle)
        else:
            drawn[path] = values
        first = sum(len(rows) for _, rows in parts)
        add(f"along {path}", drawn)
        rising += [(first + k, first + k + 1) for k in range(SWEEP_ROWS - 1)]
    swapped = []
    if stable.reciprocal:
        columns = assignment.input_columns(function)
        own = np.vstack([rows for label, rows in parts if label == ANYWHERE])
        one, two = ([k for k, c in enumerate(columns) if c.path == path] for path in stable.reciprocal.swap)
        other = own.copy()
        other[:, one], other[:, two] = own[:, two], own[:, one]
        start = sum(len(rows) for _, rows in parts)
        first = next(sum(len(r) for _, r in parts[:k]) for k, (label, _) in enumerate(parts) if label == ANYWHERE)
        parts.append((SWAPPED, other))
        swapped = [(first + k, start + k) for k in range(len(own))]
    rows = np.vstack([rows for _, rows in parts])
    cases = list(dict.fromkeys(label for label, _ in parts))
    labels = np.concatenate([np.full(len(rows), cases.index(label)) for label, rows in parts])
    pairs = [np.array(p, int).reshape(-1, 2) for p in (rising, swapped)]
    unknown = np.full((len(rows), len(assignment.output_columns(function))), np.nan)
    return StableTable(rows, labels, *pairs, unknown, unknown, cases)


def _extreme(domain: Domain, rows: int, rng: np.random.Generator) -> np.ndarray:
    """Over all of a domain: a quarter of the values at its ends or close to them."""
    if domain.kind == "unit":
        return unit_vectors(rng.normal(size=(rows, 3)))
    if domain.kind == "position":
        return rng.uniform(-1, 1, size=(rows, 3)) * np.exp(rng.uniform(np.log(1e-3), np.log(1e3), (rows, 1)))
    width = {"Real": 1, "int": 1, "vec2": 2, "vec3": 3, "vec4": 4}[domain.type]
    size = (rows, width)
    low, high = {"rgb": (0.0, 1.0), "cosine": (0.0, 1.0), "angle": (0.0, np.pi / 2)}.get(domain.kind) or domain.range
    if domain.type == "int":
        values = rng.integers(int(low), int(high) + 1, size=size).astype(float)
    else:
        if domain.scale == "log":
            least = low or 1e-3 * domain.typical[0]
            values = np.exp(rng.uniform(np.log(least), np.log(high), size=size))
        else:
            values = rng.uniform(low, high, size=size)
        near = log_distances(rows * width, 1e-7, rng).reshape(size) * (high - low) * (rng.random(size) < 0.5)
        end = np.where(rng.random(size) < 0.5, low + near, high - near)
        values = np.where(rng.random(size) < 0.25, end, values)
    return values[:, 0] if width == 1 else values


def _other(drawn: dict[str, np.ndarray], name: str, function: Function) -> np.ndarray:
    """`name`, "-name", or "mirror(name)" about the normal of name's hemisphere."""
    if name.startswith("mirror("):
        path = name[7:-1]
        normal = drawn[next(v.domain.base for v in function.values if v.name == path)]
        return 2 * np.sum(normal * drawn[path], axis=1, keepdims=True) * normal - drawn[path]
    return -drawn[name[1:]] if name.startswith("-") else drawn[name].copy()


def _close(to: np.ndarray, by: tuple[float, float], path: str, rows: int, rng: np.random.Generator) -> np.ndarray:
    distance = np.geomspace(*by, rows)
    if path.split(".")[-1] in ("position", "x"):
        return to + distance[:, None] * unit_vectors(rng.normal(size=to.shape))
    return rotated(to, distance, rng)


def _sweeps(assignment: Assignment, function: Function) -> list[tuple[str, np.ndarray | str]]:
    """What moves along a sweep, from low to high; a direction moves away from the normal of its hemisphere."""
    out: list[tuple[str, np.ndarray | str]] = []
    for column in assignment.input_columns(function):
        domain = column.domain
        if domain.kind == "upper" and column.index == 0 and not domain.opposite:
            out.append((column.path, domain.base))
        elif domain.kind == "cosine":
            out.append((column.path, np.linspace(0, 1, SWEEP_ROWS)))
        elif column.width == 1 and domain.kind == "range" and domain.type == "Real":
            low, high = domain.range
            log = domain.scale == "log"
            values = np.geomspace(low or 1e-3 * domain.typical[0], high, SWEEP_ROWS) if log else None
            out.append((column.path, values if log else np.linspace(low, high, SWEEP_ROWS)))
    return out


# --------------------------------------------------------------------------------------------------------- verdict


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
    """Asked where the truth is reciprocal itself: gates may look at one side only. To a floor each, as above: two values that are each
    within their own limit may still break the promise."""
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
