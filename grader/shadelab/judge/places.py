"""Where, in words: the inputs for which a function is wrong, as a condition on one quantity. Quantities come from the declared
arguments: scalars, the dot products of all pairs of directions (halfway ones included), the distance of two positions."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from shadelab.course.assignment import Function, named_arrays

# A condition describes the wrong rows when it holds for all but STRAY of them, for hardly any right row (STRAY of those that it
# leaves out is allowed to be wrong by the same token), and when at least DENSE of the rows that it holds for are wrong: where the
# right answer is 0 a wrong function may be right by chance.
STRAY = 0.01
DENSE = 0.5
RIGHT_INSIDE = 3  # so many wrong rows one that is right costs a condition that is to hold for a part of them
FEW = 3  # wrong rows describe nothing below it
TELLS = 1e-3  # of a member's scale: what is smaller is right whatever one does
EXPECTED = "the expected "
OFTEN = 0.02  # the share of the inputs on which a ramp's ends stand
SPECIAL = (0.0, 1.0, -1.0, 0.5, 2.0)


@dataclass(frozen=True)
class Condition:
    words: str  # "n.h < 0"
    rows: np.ndarray  # (N,) bool: where it holds

    @property
    def plain(self) -> bool:
        """Whether people would write it so: a threshold of another kind may stand for anything."""
        return self.words.endswith((" 0", " 1", " 0.5")) or " = " in self.words

    def __str__(self) -> str:
        return self.words


def quantities(function: Function, rows: np.ndarray, truth: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """By name; (N,) float64 each. `truth`: what is expected is a quantity, too."""
    columns = {c.path: c for c in function.inputs if c.index == 0}
    arrays = {path: np.asarray(a, np.float64) for path, a in named_arrays(function.inputs, rows).items()}
    out: dict[str, np.ndarray] = {}
    directions = directions_of(function, rows)
    for one, other in combinations([p for p, c in columns.items() if c.domain.kind == "position"], 2):
        out[f"the distance from {one} to {other}"] = np.linalg.norm(arrays[one] - arrays[other], axis=1)
    for path, column in columns.items():
        if column.width == 1:
            out[path] = arrays[path]
    given = list(directions)
    for one, other in combinations(given, 2):
        out[_dot(one, other)] = np.sum(directions[one] * directions[other], axis=1)
    for one, other, third in _thirds(given):
        bases = {columns[p].domain.base for p in (one, other) if p in columns}
        if one in columns and other in columns and not bases & {one, other}:
            half = _unit(directions[one] + directions[other])
            name = "h" if {one, other} == {"l", "v"} else f"h({one}, {other})"
            out[_dot(third, name)] = np.sum(directions[third] * half, axis=1)
            mirrored = (
                2 * np.sum(directions[one] * directions[third], axis=1)[:, None] * directions[third] - directions[one]
            )
            if third == "n":
                out[f"dot({other}, {one} mirrored about {third})"] = np.sum(directions[other] * mirrored, axis=1)
    for path in given:
        for k, letter in enumerate("xyz"):
            out.setdefault(f"{path}.{letter}", directions[path][:, k])
    scalars = [p for p, c in columns.items() if c.width == 1 and c.domain.type != "int"]
    for one, other in combinations(scalars, 2):
        out[f"{one} - {other}"] = arrays[one] - arrays[other]
    for path, column in columns.items():
        if column.width == 3 and column.domain.kind not in ("unit", "upper", "position"):
            out[f"the largest channel of {path}"] = arrays[path].max(axis=1)
            out[f"the smallest channel of {path}"] = arrays[path].min(axis=1)
    for k, column in enumerate(function.outputs if truth is not None else ()):
        out[f"{EXPECTED}{column}"] = truth[:, k]
    return out


def directions_of(function: Function, rows: np.ndarray) -> dict[str, np.ndarray]:
    """The arguments' unit vectors, (N, 3) float64 each, and those from one position to another."""
    columns = {c.path: c for c in function.inputs if c.index == 0}
    arrays = {path: np.asarray(a, np.float64) for path, a in named_arrays(function.inputs, rows).items()}
    out = {p: arrays[p] for p, c in columns.items() if c.domain.kind in ("unit", "upper")}
    bases = {columns[p].domain.base for p in out}
    out = dict(sorted(out.items(), key=lambda item: item[0] not in bases))  # n.l and not l.n
    for one, other in combinations([p for p, c in columns.items() if c.domain.kind == "position"], 2):
        out[f"unit({one} - {other})"] = _unit(arrays[one] - arrays[other])
    return out


def channels_of(function: Function, rows: np.ndarray) -> dict[str, np.ndarray]:
    """The arguments' colours, (N, 3) float64 each, and 1 minus each."""
    columns = {c.path: c for c in function.inputs if c.index == 0}
    colours = {
        path: np.asarray(a, np.float64)
        for path, a in named_arrays(function.inputs, rows).items()
        if columns[path].width == 3 and columns[path].domain.kind not in ("unit", "upper", "position")
    }
    return colours | {f"(1 - {path})": 1 - a for path, a in colours.items() if columns[path].domain.kind == "rgb"}


def telling(truth: np.ndarray, wrong: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """The rows that tell something about where it is wrong: those that are, and those that are right though not by being nearly
    0, as most of a narrow lobe is whatever one does. truth: (N, columns); wrong: those that are asked about; bad: all of them."""
    size = np.nan_to_num(np.abs(truth))
    return wrong | (~bad & (size > TELLS * np.maximum(np.percentile(size, 95, axis=0), 1e-30)).any(axis=1))


def place_of(
    function: Function, rows: np.ndarray, truth: np.ndarray, wrong: np.ndarray, whole: np.ndarray | None = None
) -> Condition | None:
    """The plainest condition that holds where `wrong`; None when no single quantity tells, or all is wrong. `whole`: the rows
    that are asked about (default all)."""
    whole = np.ones(len(rows), bool) if whole is None else whole
    if wrong.sum() < FEW or wrong.sum() > 0.97 * whole.sum():
        return None
    best: tuple[float, int, Condition] | None = None
    if place := _ramp(truth, wrong):
        return place
    for rank, (name, values) in enumerate(quantities(function, rows, truth).items()):
        for place in _conditions(name, values, wrong, whole):
            inside = place.rows & whole
            strays = (wrong & ~place.rows).sum()
            if strays > STRAY * wrong.sum() or inside.sum() == 0 or inside.sum() > 0.97 * whole.sum():
                continue
            if name.startswith(EXPECTED):  # "wherever it is not 0" says nothing
                size = np.abs(values)
                if (~inside & whole & (size > 0.01 * np.percentile(size, 95))).sum() < 0.2 * whole.sum():
                    continue
            density = (wrong & inside).sum() / inside.sum()
            if density < DENSE:
                continue
            badness = (inside.sum() - (wrong & inside).sum()) + 2 * strays
            plain = -0.02 * inside.sum() * place.plain
            if best is None or (badness + plain, rank) < best[:2]:
                best = (badness + plain, rank, place)
    return best[2] if best else None


def _ramp(truth: np.ndarray, wrong: np.ndarray) -> Condition | None:
    """Between the 0 and the 1 that are expected elsewhere."""
    between = (truth > 0).any(axis=1) & (truth < 1).any(axis=1)
    ends = (truth == 0).all(axis=1).mean(), (truth == 1).all(axis=1).mean()
    if truth.shape[1] > 1 or min(ends) < OFTEN or (wrong & ~between).sum() > STRAY * wrong.sum():
        return None
    words = f"{EXPECTED}result lies between 0 and 1"
    return Condition(words, between) if (wrong & between).sum() >= DENSE * between.sum() else None


def part_of(
    function: Function, rows: np.ndarray, truth: np.ndarray, wrong: np.ndarray, whole: np.ndarray
) -> Condition | None:
    """The condition, below or above a threshold, that holds for as many of the wrong rows as possible and for few others."""
    best: tuple[int, Condition] | None = None
    for name, values in quantities(function, rows, truth).items():
        if name.startswith(EXPECTED) or not np.isfinite(values[whole]).all():
            continue
        for sign in (1, -1):
            order = np.flatnonzero(whole)[np.argsort(sign * values[whole], kind="stable")]
            bad = wrong[order]
            gain = np.cumsum(np.where(bad, 1, -RIGHT_INSIDE))
            last = int(np.argmax(gain))
            if gain[last] < FEW:
                continue
            inside, beyond = values[order[last]], values[order[min(last + 1, len(order) - 1)]]
            threshold = _between(*sorted((inside, beyond)))
            held = values <= threshold if sign == 1 else values >= threshold
            count = int((held & wrong).sum())
            if (held & whole).sum() < 0.97 * whole.sum() and (best is None or count > best[0]):
                comparison = (
                    ("<" if inside < threshold else "<=") if sign == 1 else (">" if inside > threshold else ">=")
                )
                best = (count, Condition(f"{name} {comparison} {_number(threshold)}", held))
    return best[1] if best else None


def _conditions(name: str, values: np.ndarray, wrong: np.ndarray, whole: np.ndarray) -> Iterator[Condition]:
    """Below or above a threshold, near a number, or exactly at one."""
    bad, good = np.sort(values[wrong]), values[whole & ~wrong]
    if not np.isfinite(bad).all():
        return
    slack = int(STRAY * len(bad))
    low, high = bad[slack], bad[-1 - slack]
    above, below = good[good > high], good[good < low]
    top = _between(high, above.min() if len(above) else None)
    bottom = _between(below.max() if len(below) else None, low)
    if top is not None and np.isfinite(top):
        sign = "<=" if (values[wrong] == top).any() else "<"
        yield Condition(f"{name} {sign} {_number(top)}", values <= top if sign == "<=" else values < top)
    if bottom is not None and np.isfinite(bottom):
        sign = ">=" if (values[wrong] == bottom).any() else ">"
        yield Condition(f"{name} {sign} {_number(bottom)}", values >= bottom if sign == ">=" else values > bottom)
    if high == low:
        yield Condition(f"{name} = {_number(low)}", values == low)
    elif top is not None and bottom is not None and high - low < 0.5 * (np.ptp(values) or 1):
        yield Condition(f"{name} between {_number(bottom)} and {_number(top)}", (values >= bottom) & (values <= top))


def _between(low: float | None, high: float | None) -> float | None:
    """The plainest number from low to high."""
    if low is None or high is None:
        return low if high is None else high
    for special in SPECIAL:
        if low <= special <= high:
            return special
    for digits in range(1, 8):
        middle = float(f"{(low + high) / 2:.{digits}g}")
        if low <= middle <= high:
            return middle
    return (low + high) / 2


def _number(value: float) -> str:
    return f"{value:.6g}"


def _thirds(names: list[str]) -> Iterator[tuple[str, str, str]]:
    for one, other in combinations(names, 2):
        for third in names:
            if third != other or third == one:
                yield one, other, third


def _dot(a: str, b: str) -> str:
    return f"{a}.{b}" if len(a) == len(b) == 1 else f"dot({a}, {b})"


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30)
