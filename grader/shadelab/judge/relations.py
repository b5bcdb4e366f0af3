"""By what relation wrong numbers and the reference's belong together: the student's values explained as U(f(T(inputs))). f with T
inside (changed arguments, or the reference with one thing changed) are the hypotheses of the expected data; U, what happens to the
result, is found here: a factor, a power, an offset, a sign, a clamp, members exchanged. Nothing here knows what a function computes."""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from shadelab.course.assignment import Function
from shadelab.judge.places import directions_of, quantities
from shadelab.truth.expected import Table
from shadelab.truth.measures import FACTOR, SMALL

# A hypothesis explains a row when it gives the student's numbers within this relative error (or the function's limit, where that is
# wider): the same mistake written in other words rounds differently. But it has to be NEARER times nearer than the truth.
ALIKE = 1e-3
NEARER = 0.1
# It is told when the truth and every other explanation leave at least MARGIN times as many rows unexplained, one added to both
# counts: two rows that agree for no other reason are no coincidence, one may be. And when it explains all but a tenth of what is
# wrong.
MARGIN = 3.0
UNEXPLAINED = 0.1
# Factors, powers and offsets that people write; others are told as numbers, of the truth alone.
CONSTANTS = {
    "pi": np.pi, "1/pi": 1 / np.pi, "2 pi": 2 * np.pi, "1/(2 pi)": 0.5 / np.pi, "4 pi": 4 * np.pi, "1/(4 pi)": 0.25 / np.pi, "pi/4": np.pi / 4,
    "4/pi": 4 / np.pi, "pi/2": np.pi / 2, "2/pi": 2 / np.pi, "sqrt(2)": 2**0.5, "1/sqrt(2)": 2**-0.5, "1/sqrt(pi)": np.pi**-0.5, "sqrt(pi)": np.pi**0.5,
    "pi squared": np.pi**2, "1/pi squared": np.pi**-2, "1/3": 1 / 3, "2/3": 2 / 3, "1/180": 1 / 180, "pi/180": np.pi / 180, "180/pi": 180 / np.pi,
    "1/255": 1 / 255,
    **{f"{k:g}": k for k in (-1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 10.0, 0.5, 0.25, 0.125, 0.1, -2.0, -0.5)},
}  # fmt: skip
CHANCE = 4  # parameters of a fit cost so many rows
MONOMIALS = (1, -1, 2, -2, 0.5, -0.5, 3, -3, 4, -4, 5, -5)


@dataclass
class Candidate:
    """What a mistake gives: on all rows of the table, or on some."""

    id: str  # of a declared one; empty
    function: str  # where the mistake is made: the judged function or one that it calls
    hint: str
    output: np.ndarray  # (K, results)
    rows: np.ndarray | None = None  # (K,) of the table; None: all
    words: str = ""  # of one that nobody declared: after "as those of the reference"
    everywhere: bool = True  # whether it equals the truth on the rows that are not there


@dataclass
class Explanation:
    """`words` is a sentence's end: "yours are ..."."""

    words: str
    explained: np.ndarray  # (N,) bool
    left: int  # rows that stay unexplained
    candidate: Candidate | None = None
    plain: int = 0  # how far from plain: 0 a declared mistake
    alike: list[str] = field(default_factory=list)
    margin: float = 1.0


class Comparison:
    """A student's numbers in some columns on some rows of a table, beside what hypotheses give there."""

    def __init__(
        self, function: Function, table: Table, actual: np.ndarray, members: list[slice], limit: float, rows: np.ndarray
    ) -> None:
        self.function, self.rows, self.members = function, rows, members
        self.truth, self.actual = table.truth[rows], actual[rows].astype(np.float64)
        self.conditioning, self.inputs = FACTOR * table.conditioning[rows], table.rows[rows]
        self.tolerance = max(ALIKE, limit)
        with np.errstate(all="ignore"):
            off = np.abs(self.actual - self.truth) / (np.abs(self.truth) + SMALL * np.nanmax(np.abs(self.truth)))
        off = np.nan_to_num(off[:, _columns(members)].max(axis=1), nan=np.inf)
        if (wrong := off[off > limit]).size:
            self.tolerance = min(self.tolerance, max(limit, NEARER * float(np.median(wrong))))
        self.wrong = ~self.explained(self.truth)

    def as_if(self, output: np.ndarray) -> "Comparison":
        """Whether something gives `output`, in the place of what came."""
        other = copy(self)
        other.actual = output.astype(np.float64)
        return other

    def on(self, rows: np.ndarray) -> "Comparison":
        """Some of the rows."""
        other = copy(self)
        for part in ("truth", "actual", "conditioning", "inputs", "wrong"):
            setattr(other, part, getattr(self, part)[rows])
        return other

    def explained(self, output: np.ndarray) -> np.ndarray:
        """(..., K, results) -> (..., K) bool: the rows where `output` is what came."""
        alike = np.ones(output.shape[:-1], bool)
        with np.errstate(all="ignore"):
            for member in self.members:
                a, c = self.actual[:, member], output[..., member]
                size = np.where(np.isfinite(c), np.abs(c), 0.0)
                scale = np.percentile(size, 95, axis=(-2, -1), keepdims=True)
                allowed = self.tolerance * (size + SMALL * scale) + self.conditioning[:, member]
                same = (np.abs(a - c) <= allowed) | (a == c) | (np.isnan(a) & np.isnan(c))
                alike &= same.all(axis=-1)
        return alike


def _columns(members: list[slice]) -> list[int]:
    return [k for m in members for k in range(m.start, m.stop)]


# --------------------------------------------------------------------------------------- what happens to a result


def of_result(compared: Comparison, output: np.ndarray, plain: bool) -> Iterator[tuple[str, np.ndarray, int]]:
    """U(output) that may be what came: words, values, and how far from plain. `plain`: output is the truth, so that factors of any
    size are looked for."""
    a, columns = compared.actual, _columns(compared.members)
    use = np.zeros(a.shape, bool)
    with np.errstate(all="ignore"):
        size = np.abs(output)
        scale = np.nanpercentile(np.where(np.isfinite(size), size, np.nan)[:, columns], 95)
        use[:, columns] = (np.isfinite(a) & np.isfinite(output) & (size > 0.02 * scale))[:, columns]
        if use.sum() < 3:
            return
        factor = float(np.median(a[use] / output[use]))
        named, value = _nearest(factor, compared.tolerance)
        if named or plain:
            yield named or f"{factor:.6g}", value * output, 1 if named else 3
        positive = use & (a > 0) & (output > 0) & (np.abs(np.log(np.abs(output))) > 0.05)
        if positive.sum() >= 8:
            x, y = np.log(output[positive]), np.log(a[positive])
            power = float(np.median(y / x))
            for p in (power, round(2 * power) / 2):
                if 0.1 < abs(p) < 16 and abs(p - 1) > 0.01 and abs(p - power) < 0.02 and (plain or p == round(2 * p) / 2):
                    yield _power(p), np.sign(output) * np.abs(output) ** p, 2
            if plain and np.ptp(x) > 0.1:
                p, k = np.polyfit(x, y, 1)
                yield f"{np.exp(k):.4g} times the power {p:.4g} of", np.exp(k) * np.abs(output) ** p, 4
        for member in compared.members:
            if member.stop - member.start == 3:
                length = np.linalg.norm(output[:, member], axis=1, keepdims=True)
                yield "the normalised", _with(output, (member, np.where(length > 0, output[:, member] / length, 0.0))), 1
        yield "1 minus", 1 - output, 1
        yield "the absolute value of", np.abs(output), 1
        yield "the clamped (to 0 .. 1)", np.clip(output, 0, 1), 1
        yield "the clamped (at 0)", np.maximum(output, 0), 1
        yield "1 over", 1 / output, 1
        yield "the rounded", np.round(output), 2
        if plain:
            offset = float(np.median((a - output)[:, columns][np.isfinite((a - output)[:, columns])]))
            if abs(offset) > 1e-12:
                yield f"{offset:.4g} more than", output + offset, 3


def _power(p: float) -> str:
    return {2.0: "the square of", 0.5: "the square root of", -1.0: "1 over", 3.0: "the cube of"}.get(p, f"the power {p:.4g} of")


def _nearest(factor: float, tolerance: float) -> tuple[str, float]:
    """A constant that people write, if the factor is one."""
    for words, value in CONSTANTS.items():
        if abs(factor - value) <= tolerance * abs(value):
            return words, value
    return "", factor


def of_members(function: Function, members: list[slice], truth: np.ndarray) -> Iterator[tuple[str, np.ndarray, int]]:
    """Members exchanged, or one in the place of another; channels of a colour; a vector's length."""
    for k, one in enumerate(members):
        mine = _name(function, one)
        if one.stop - one.start == 3:
            for words, order in {
                "the first channel of {} for all": [0, 0, 0], "the second channel of {} for all": [1, 1, 1],
                "the third channel of {} for all": [2, 2, 2], "{} with its first and third exchanged": [2, 1, 0],
                "{} with its first and second exchanged": [1, 0, 2], "{} with its second and third exchanged": [0, 2, 1],
            }.items():  # fmt: skip
                yield words.format(mine), _with(truth, (one, truth[:, one][:, order])), 1
        for other in members[k + 1 :]:
            if one.stop - one.start == other.stop - other.start:
                theirs = _name(function, other)
                yield f"{mine} and {theirs} exchanged", _with(truth, (one, truth[:, other]), (other, truth[:, one])), 1
                yield f"{mine} in {theirs}, too", _with(truth, (other, truth[:, one])), 1
                yield f"{theirs} in {mine}, too", _with(truth, (one, truth[:, other])), 1
                for a, b, said in ((one, other, theirs), (other, one, mine)):
                    both = (b, truth[:, one] + truth[:, other])
                    yield f"all of it in {said}", _with(truth, both, (a, np.zeros_like(truth[:, a]))), 1
                    yield f"{_name(function, a)} added to {said}", _with(truth, both), 1


def of_directions(compared: Comparison) -> Iterator[tuple[str, np.ndarray, int]]:
    """A vector that is made of the arguments' directions: which way it points, whatever its length. The coefficients are the
    smallest singular vector of what must vanish, the cross product of what came with each of them."""
    named = {p: d for p, d in directions_of(compared.function, compared.inputs).items()}
    basis = dict(named)
    for (p, a), (q, b) in combinations(named.items(), 2):
        c = np.sum(a * b, axis=1, keepdims=True)
        basis |= {f"({_dot(p, q)}) {p}": c * a, f"({_dot(p, q)}) {q}": c * b}
        basis[f"cross({p}, {q})"] = np.cross(a, b)
    for member in compared.members:
        came = compared.actual[:, member]
        length = np.linalg.norm(came, axis=1)
        use = np.isfinite(length) & (length > 1e-6)
        if member.stop - member.start != 3 or use.sum() < 12 or not named:
            continue
        unit = came[use] / length[use, None]
        for names in (list(named), [n for n in basis if not n.startswith("cross")], [n for n in basis if n.startswith("cross")]):
            if not names or len(names) > 6:
                continue
            columns = np.stack([np.cross(unit, basis[n][use]).ravel() for n in names], axis=1)
            values, vectors = np.linalg.svd(columns, full_matrices=False)[1:]
            c = vectors[-1]
            if values[-1] > 1e-3 * np.sqrt(use.sum()):
                continue
            pointing = sum(k * basis[n] for k, n in zip(c, names))
            sign = np.sign(np.median(np.sum(pointing[use] * unit, axis=1)))
            c, pointing = sign * c, sign * pointing
            smallest = np.abs(c)[np.abs(c) > 0.02 * np.abs(c).max()].min()
            said = _combination({n: k / smallest for n, k in zip(names, c) if abs(k) > 0.02 * np.abs(c).max()})
            size = np.linalg.norm(pointing, axis=1)
            ratio = np.median(length[use] / size[use])
            constant = np.abs(length[use] / size[use] / ratio - 1) < 0.01
            factor = ratio if constant.mean() > 0.9 else (length / np.maximum(size, 1e-30))[:, None]
            if constant.mean() > 0.9:
                said = _combination({n: k * ratio for n, k in zip(names, c) if abs(k) > 0.02 * np.abs(c).max()})
                yield said, _with(compared.truth, (member, factor * pointing)), 3
            else:
                even = " and of length 1" if np.abs(length[use] - 1).max() < 1e-3 else ""
                yield f"parallel to {said}{even}", _with(compared.truth, (member, factor * pointing)), 3


def _combination(terms: dict[str, float]) -> str:
    """2 (n.l) n - l"""
    out = ""
    for name, k in terms.items():
        size = "" if abs(abs(k) - 1) < 2e-4 else f"{abs(k):.5g} "
        sign = (" - " if k < 0 else " + ") if out else ("-" if k < 0 else "")
        out += f"{sign}{size}{name}"
    return out


def _dot(p: str, q: str) -> str:
    return f"{p}.{q}" if len(p) == len(q) == 1 else f"dot({p}, {q})"


def _name(function: Function, member: slice) -> str:
    path = function.outputs[member.start].path
    return path.removeprefix("result.")


def _with(values: np.ndarray, *replaced: tuple[slice, np.ndarray]) -> np.ndarray:
    out = values.copy()
    for member, array in replaced:
        out[:, member] = array
    return out


def monomial(compared: Comparison) -> tuple[str, np.ndarray] | None:
    """A factor that is a power of one quantity of the inputs, or of two: forgotten, or too many."""
    columns = _columns(compared.members)
    with np.errstate(all="ignore"):
        ratio = compared.actual[:, columns] / compared.truth[:, columns]
        size = np.abs(compared.truth[:, columns])
        usable = np.isfinite(ratio) & (ratio > 0) & (size > 1e-4 * np.nanpercentile(size, 95))
        y = np.where(usable.any(axis=1), _row_median(np.where(usable, np.log(np.abs(ratio)), np.nan)), np.nan)
        known = {name: np.log(values) for name, values in quantities(compared.function, compared.inputs).items()}
        use = np.isfinite(y)
        if use.sum() < 12:
            return None
        best = None
        logs = {n: x for n, x in known.items() if np.isfinite(x[use]).mean() > 0.9 and np.nanstd(x[use]) > 0.02}
        for name, x in logs.items():
            found = _fitted(y, [x], use, compared.tolerance)
            if found and (best is None or found[0] > best[0]):
                best = (found[0], [(name, found[1][0])], found[2])
        if best is None or best[0] < 0.9:
            names = list(logs)[:24]
            for i, one in enumerate(names):
                for other in names[i + 1 :]:
                    found = _fitted(y, [logs[one], logs[other]], use, compared.tolerance)
                    if found and (best is None or found[0] > best[0]):
                        best = (found[0], [(one, found[1][0]), (other, found[1][1])], found[2])
        if best is None or best[0] < 1 - UNEXPLAINED:
            return None
        _, powers, constant = best
        factor = np.exp(constant + sum(p * known[name] for name, p in powers))
        values = compared.truth * np.where(np.isfinite(factor), factor, 0.0)[:, None]
        named, value = _nearest(float(np.exp(constant)), 10 * compared.tolerance)
        said = [] if abs(constant) < 1e-3 else [named or f"{np.exp(constant):.4g}"]
        said += [_raised(name, p) for name, p in powers]
        return " times ".join(said), values


def _row_median(values: np.ndarray) -> np.ndarray:
    """Of the numbers of each row that are none left out."""
    counts = np.isfinite(values).sum(axis=1)
    ordered = np.sort(np.where(np.isfinite(values), values, np.inf), axis=1)
    return ordered[np.arange(len(values)), np.maximum(counts - 1, 0) // 2]


def _fitted(y: np.ndarray, xs: list[np.ndarray], use: np.ndarray, tolerance: float):
    """Powers that people write, with a constant: (share of rows that fit, powers, constant)."""
    use = use & np.isfinite(np.sum(xs, axis=0))
    if use.sum() < 12:
        return None
    a = np.column_stack([*[x[use] for x in xs], np.ones(use.sum())])
    try:
        solution, *_ = np.linalg.lstsq(a, y[use], rcond=None)
    except np.linalg.LinAlgError:
        return None
    powers = [min(MONOMIALS, key=lambda p: abs(p - s)) for s in solution[:-1]]
    if max(abs(p - s) for p, s in zip(powers, solution)) > 0.25:
        return None
    rest = y[use] - sum(p * x[use] for p, x in zip(powers, xs))
    constant = float(np.median(rest))
    return float((np.abs(rest - constant) <= 4 * tolerance).mean()), powers, constant


def _raised(name: str, power: float) -> str:
    base = name if "(" not in name or name.endswith(")") else f"({name})"
    if power == 1:
        return base
    return f"1 / {base}" if power == -1 else f"{base}^{power:g}"
