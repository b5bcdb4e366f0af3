"""Input tables for function checks, drawn from the declared domains.

Uniform directions miss a narrow lobe (at q = 512 one input in eighty sees it), so half of the rows lie close to where shading
functions change quickly: for a direction declared upper(n) that is n itself, the horizon, and, when an earlier direction l of
the same hemisphere stands in the row, l and the mirror image of l (for which the half vector is n). Distances are log-spaced.
"""

from collections.abc import Callable, Mapping
from itertools import combinations
from types import MappingProxyType
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Column, Domain, Function, Value

ROWS = 4096
# float32 inputs decide which side of the horizon a direction lies on only down to about 1e-7; nearer rows would judge rounding.
NEAREST_HORIZON = 1e-6
NEAREST_PEAK = 1e-4
GATE_STRIDE = 16
PLACE_STRIDE, PLACE_ROW, BESIDE_ROW = 64, 13, 29  # rows on which no gate stands
NEAREST_PLACE = 1e-2
NEAREST_MOVE = 1e-5
SOME = 128  # rows on which it is asked what a result changes with
JITTERS = 8


def make_table(assignment: Assignment, function: Function, seed: int, rows: int = ROWS) -> np.ndarray:
    """(rows, columns) float32 over the typical domains and the gates. The same seed gives the same table."""
    rng = np.random.default_rng([seed, *function.name.encode()])
    drawn: dict[str, np.ndarray] = {}
    draw_values(assignment, function.values, "", rows, rng, drawn)
    axis_rows(function, drawn)
    _place_rows(function, drawn, rng)
    _beside_gates(function, drawn)
    _gate_rows(function, drawn)
    return as_rows(function, drawn)


def as_rows(function: Function, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """(rows, columns) float32 of what was drawn for each column."""
    paths = dict.fromkeys(c.path for c in function.inputs)
    return np.concatenate([drawn[p].reshape(len(drawn[p]), -1) for p in paths], axis=1).astype(np.float32)


Sampler = Callable[[Domain, int, np.random.Generator], np.ndarray]


def draw_values(
    assignment: Assignment,
    values: list[Value],
    prefix: str,
    rows: int,
    rng: np.random.Generator,
    drawn: dict[str, np.ndarray],
    sample: Sampler | None = None,
    pinned: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Fills `drawn` by path. `sample` draws what is no direction of a hemisphere (default: the typical domain); `pinned`
    paths have a constant."""
    # A hemisphere's normal is drawn before the directions that refer to it, wherever it stands in the argument list.
    for value in sorted(values, key=lambda v: v.domain.kind == "upper"):
        path = prefix + value.name
        if value.domain.kind == "struct":
            members = assignment.structs[value.domain.type].values
            draw_values(assignment, members, path + ".", rows, rng, drawn, sample, pinned)
        elif path in pinned:
            constant = np.array(pinned[path], float)
            drawn[path] = np.broadcast_to(constant, (rows, *constant.shape)).copy()
        elif value.domain.kind == "upper":
            normal = drawn[prefix + value.domain.base] * (-1 if value.domain.opposite else 1)
            others = [
                drawn[prefix + v.name]
                for v in values
                if (v.domain.kind, v.domain.base, v.domain.opposite)
                == ("upper", value.domain.base, value.domain.opposite)
                and prefix + v.name in drawn
            ]
            drawn[path] = _upper(normal, others, rng)
        else:
            drawn[path] = (sample or _typical)(value.domain, rows, rng)


def _typical(domain: Domain, rows: int, rng: np.random.Generator) -> np.ndarray:
    if domain.kind == "unit":
        return unit_vectors(rng.normal(size=(rows, 3)))
    if domain.kind == "position":
        return rng.uniform(-5, 5, size=(rows, 3))
    if domain.kind == "rgb":
        return rng.uniform(0, 1, size=(rows, 3))
    if domain.kind == "cosine":
        return _half_near_ends(rng.uniform(0, 1, rows), 0.0, 1.0, rng)
    if domain.kind == "angle":
        return rng.uniform(0, np.pi / 2, rows)
    low, high = domain.typical or domain.range
    width = domain.width
    if domain.type == "int":
        values = rng.integers(int(low), int(high) + 1, size=(rows, width)).astype(float)
    elif domain.scale == "log":
        values = np.exp(rng.uniform(np.log(low), np.log(high), size=(rows, width)))
    else:
        values = rng.uniform(low, high, size=(rows, width))
    return values[:, 0] if width == 1 else values


def _half_near_ends(values: np.ndarray, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    near = rng.random(len(values)) < 0.5
    distance = log_distances(len(values), NEAREST_HORIZON, rng) * (high - low) / 2
    ends = np.where(rng.random(len(values)) < 0.5, low + distance, high - distance)
    return np.where(near, ends, values)


def log_distances(rows: int, nearest: float, rng: np.random.Generator) -> np.ndarray:
    return np.exp(rng.uniform(np.log(nearest), 0, rows))


def _upper(normal: np.ndarray, others: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """Half of the rows: uniform over the hemisphere, one in eight of them below it. The other half: near a landmark."""
    rows = len(normal)
    uniform = unit_vectors(rng.normal(size=(rows, 3)))
    side = np.sign(np.sum(uniform * normal, axis=1)) * np.where(rng.random(rows) < 1 / 8, -1, 1)
    uniform *= side[:, None]

    landmarks = [normal]
    for other in others:
        landmarks += [other, 2 * np.sum(normal * other, axis=1, keepdims=True) * normal - other]
    choice = rng.integers(len(landmarks) + 1, size=rows)  # the last one is the horizon
    near = unit_vectors(rng.normal(size=(rows, 3)))
    for k, landmark in enumerate(landmarks):
        near = np.where((choice == k)[:, None], rotated(landmark, log_distances(rows, NEAREST_PEAK, rng), rng), near)
    elevation = log_distances(rows, NEAREST_HORIZON, rng) * np.where(rng.random(rows) < 0.5, 1, -1)
    tangent = unit_vectors(np.cross(normal, rng.normal(size=(rows, 3))))
    horizon = tangent * np.cos(elevation)[:, None] + normal * np.sin(elevation)[:, None]
    near = np.where((choice == len(landmarks))[:, None], horizon, near)
    return unit_vectors(np.where((rng.random(rows) < 0.5)[:, None], uniform, near))


def axis_rows(function: Function, drawn: dict[str, np.ndarray]) -> None:
    """The last rows stand exactly on the horizon, opposite and equal: every combination of axis-aligned directions, whose dot
    products are exact in every arithmetic."""
    directions = [v.name for v in function.values if v.domain.kind in ("unit", "upper")]
    if len(directions) < 2:
        return
    axes = np.concatenate([np.eye(3), 0.0 - np.eye(3)])  # 0 - x: no negative zeros in messages
    for row in range(6 ** len(directions)):
        for k, name in enumerate(directions):
            drawn[name][-1 - row] = axes[(row // 6**k) % 6]


def _place_rows(function: Function, drawn: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    """Some positions stand along an axis from one another, so that two components of their difference are 0, or close by."""
    places = [path for path, column in _first_columns(function).items() if column.domain.kind == "position"]
    for one, other in combinations(places, 2):
        chosen = np.arange(PLACE_ROW, len(drawn[one]), PLACE_STRIDE)
        apart = unit_vectors(rng.normal(size=(len(chosen), 3)))
        axes = np.concatenate([np.eye(3), 0.0 - np.eye(3)])
        apart[::2] = axes[np.arange(len(apart[::2])) % 6]
        drawn[other][chosen] = drawn[one][chosen] + apart * log_distances(len(chosen), NEAREST_PLACE, rng)[:, None]


def _beside_gates(function: Function, drawn: dict[str, np.ndarray]) -> None:
    """Some rows stand beside a declared edge case: x (1 +- 10^-k)."""
    columns = _first_columns(function)
    numbers = [
        (path, value)
        for gate in function.gates
        for path, value in gate.items()
        if isinstance(value, int | float) and value and columns[path].width == 1 and columns[path].domain.type != "int"
    ]
    for k, (path, value) in enumerate(dict.fromkeys(numbers)):
        chosen = np.arange(BESIDE_ROW + PLACE_STRIDE * k, len(drawn[path]), PLACE_STRIDE * len(numbers))
        steps = np.array([sign * 10.0**-power for power in range(1, 5) for sign in (1, -1)])
        beside = value * (1 + steps[np.arange(len(chosen)) % len(steps)])
        low, high = columns[path].domain.range or (-np.inf, np.inf)
        drawn[path][chosen] = np.clip(beside, low, high)


def _first_columns(function: Function) -> dict[str, Column]:
    return {column.path: column for column in function.inputs if column.index == 0}


def _gate_rows(function: Function, drawn: dict[str, np.ndarray]) -> None:
    """Each declared gate is put into every 16th row, axis-aligned ones included, from another row on."""
    for k, gate in enumerate(function.gates):
        for path, value in gate.items():
            drawn[path][k::GATE_STRIDE] = drawn[value][k::GATE_STRIDE] if isinstance(value, str) else value


def unit_vectors(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def rotated(v: np.ndarray, angle: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    tangent = unit_vectors(np.cross(v, rng.normal(size=v.shape)))
    return v * np.cos(angle)[:, None] + tangent * np.sin(angle)[:, None]


def renormalised(function: Function, rows: np.ndarray) -> np.ndarray:
    """float64 rows for the truth: arguments declared unit or upper are what the float32 numbers stand for, unit vectors."""
    out = rows.astype(np.float64)
    for k, column in enumerate(function.inputs):
        if column.index == 0 and column.domain.kind in ("unit", "upper"):
            vectors = out[:, k : k + 3]
            out[:, k : k + 3] = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return out


def jittered(function: Function, rows: np.ndarray, units: float = 0.5) -> list[np.ndarray]:
    """The rows several times over, each number off by at most `units` in float32's last place; half a unit is what any
    float32 computation does to its inputs. Zeros stay zero, so that axis-aligned directions stay on the horizon; numbers of
    a row that are equal, or opposite, stay so: a spotlight without a ramp has none, opposite directions have no half vector."""
    rng = np.random.default_rng(JITTERS)
    whole = np.array([c.domain.type == "int" for c in function.inputs])
    size = np.where(whole, 0.0, units * 2.0**-23)
    first = _first_alike(rows)
    return [
        rows * (1 + size * np.take_along_axis(rng.uniform(-1, 1, rows.shape), first, axis=1)) for _ in range(JITTERS)
    ]


def moved_one_by_one(function: Function, rows: np.ndarray, units: float = 0.5) -> np.ndarray:
    """(columns, 2, N, columns): the rows with one number at a time `units` of float32's last place larger, then smaller. As
    above, zeros stay zero and equal or opposite numbers of a row move together."""
    columns = function.inputs
    first = _first_alike(rows)
    out = np.repeat(rows[None, None], 2, axis=1).repeat(len(columns), axis=0)
    for k, column in enumerate(columns):
        if column.domain.type != "int":
            together = first == k  # empty where an earlier column holds the same number
            for sign, moved in zip((1, -1), out[k]):
                moved[together] *= 1 + sign * units * 2.0**-23
    return out


def nearby(function: Function, rows: np.ndarray, others: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The rows, each with one argument changed: it is another row's, or moved a little or far, within the typical domain."""
    out = rows.astype(np.float64)
    firsts = [(k, column) for k, column in enumerate(function.inputs) if column.index == 0]
    which, taken = rng.integers(len(firsts), size=len(rows)), rng.random(len(rows)) < 0.4
    from_others = others[rng.integers(len(others), size=len(rows))]
    for number, (k, column) in enumerate(firsts):
        columns, here = slice(k, k + column.width), which == number
        change = here & (taken | (column.domain.type == "int"))
        out[change, columns] = from_others[change, columns]
        if column.domain.type != "int":
            change = here & ~taken
            out[change, columns] = _moved(column.domain, out[change, columns], rng)
    return out.astype(np.float32)


def _moved(domain: Domain, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    far = log_distances(len(values), NEAREST_MOVE, rng)
    if domain.kind in ("unit", "upper"):
        return unit_vectors(rotated(values, np.pi * far, rng))
    way = rng.uniform(-1, 1, size=values.shape) * far[:, None]
    if domain.kind == "position":
        return values + 10 * way
    low, high = bounds(domain)
    if domain.scale == "log":
        return np.clip(values * np.exp(way * np.log(high / low)), low, high)
    return np.clip(values + way * (high - low), low, high)


def bounds(domain: Domain) -> tuple[float, float]:
    """Between which typical numbers lie."""
    if domain.kind in ("rgb", "cosine"):
        return 0.0, 1.0
    return (0.0, np.pi / 2) if domain.kind == "angle" else domain.typical or domain.range or (-np.inf, np.inf)


def one_by_one(function: Function, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Some of the rows as they are, under "", and with one input at a time taken from another row; by its path."""
    base = rows[:: max(1, len(rows) // SOME)]
    other = np.roll(base, len(base) // 2, axis=0)
    out = {"": base}
    for path in dict.fromkeys(c.path for c in function.inputs):
        columns = [k for k, c in enumerate(function.inputs) if c.path == path]
        out[path] = base.copy()
        out[path][:, columns] = other[:, columns]
    return out


def changing(rows: dict[str, np.ndarray], results: np.ndarray) -> list[str]:
    """The inputs that results of one_by_one's rows change with. results: of all, one after the other."""
    base, *others = np.split(results, len(rows))
    return [
        path
        for path, result in zip(list(rows)[1:], others)
        if not ((result == base) | (np.isnan(result) & np.isnan(base))).all()
    ]


def _first_alike(rows: np.ndarray) -> np.ndarray:
    """Of each number, the first column of its row that holds it, with either sign."""
    size = np.abs(rows)
    return (size[:, :, None] == size[:, None, :]).argmax(axis=2)


def on_gate(function: Function, drawn: int, rows: int) -> np.ndarray:
    """Which of the rows stand on a declared gate: some of the `drawn` ones, which come first. Their inputs are exact, so rounding
    is no excuse there."""
    row = np.arange(rows)
    return (row % GATE_STRIDE < len(function.gates)) & (row < drawn)


def axis_aligned(function: Function, rows: np.ndarray) -> np.ndarray:
    """(N,) bool: the rows of which all directions are axes, so that their dot products are exact in every arithmetic."""
    directions = [k for k, column in enumerate(function.inputs) if column.domain.kind in ("unit", "upper")]
    if not directions:
        return np.zeros(len(rows), bool)
    return np.isin(rows[:, directions], (-1.0, 0.0, 1.0)).all(axis=1)


def exact_rows(function: Function, drawn: int, rows: np.ndarray) -> np.ndarray:
    """(N,) bool: those of a table whose inputs hold no rounding."""
    return on_gate(function, drawn, len(rows)) | axis_aligned(function, rows)
