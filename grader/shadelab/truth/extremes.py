"""Inputs at the ends of the domains, for stability: drawn over all of each, ends included, exactly on axes, along sweeps,
and what stability.toml declares."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Domain, Function
from shadelab.course.stability import FILE, Near, Stable
from shadelab.errors import UserError
from shadelab.paths import shown
from shadelab.truth.tables import (
    as_rows,
    axis_rows,
    draw_values,
    log_distances,
    rotated,
    unit_vectors,
)

CASE_ROWS = 24
WIDE_ROWS = 96  # drawn over all of the domains
SWEEP_ROWS = 24  # one argument moves, the others stand still
ANYWHERE, EXACT, SWAPPED = "anywhere in the domain", "exactly on axes", "arguments exchanged"


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
        parts.append((label, as_rows(function, drawn)))

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
        columns = function.inputs
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
    unknown = np.full((len(rows), len(function.outputs)), np.nan)
    return StableTable(rows, labels, *pairs, unknown, unknown, cases)


def _extreme(domain: Domain, rows: int, rng: np.random.Generator) -> np.ndarray:
    """Over all of a domain: a quarter of the values at its ends or close to them."""
    if domain.kind == "unit":
        return unit_vectors(rng.normal(size=(rows, 3)))
    if domain.kind == "position":
        return rng.uniform(-1, 1, size=(rows, 3)) * np.exp(rng.uniform(np.log(1e-3), np.log(1e3), (rows, 1)))
    width = domain.width
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
    for column in function.inputs:
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
