"""By what relation wrong numbers and the reference's belong together: the student's values explained as U(f(T(inputs))). f with T
inside (changed arguments, or the reference with one thing changed) are the hypotheses of the expected data; U, what happens to
the result, is found here: a factor, a power, a clamp, members exchanged. Nothing here knows what a function computes."""

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations

import numpy as np

from shadelab.course.assignment import Function
from shadelab.judge.places import channels_of, directions_of, quantities
from shadelab.truth.expected import Table
from shadelab.truth.measures import FACTOR, SMALL

# A hypothesis explains a row when it gives the student's numbers within this relative error (or the function's limit, where
# that is wider): the same mistake written in other words rounds differently. But it has to be that much NEARER than the truth.
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
TRUTH = "what is expected"
FITTED = 900  # numbers that a factor is fitted to
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
    share: float = 0.0  # of what is wrong, the part that it leaves


class Compared:
    """A student's numbers in some columns on some rows of a table, beside what hypotheses give there."""

    def __init__(
        self,
        function: Function,
        table: Table,
        actual: np.ndarray,
        members: list[slice],
        limit: float,
        rows: np.ndarray,
        inner: dict[str, np.ndarray] | None = None,
    ) -> None:
        """inner: (N, 1 | 3) by name, of the whole table."""
        self.inner = {name: values[rows] for name, values in (inner or {}).items()}
        self.function, self.rows, self.members = function, rows, members
        self.truth, self.actual = table.truth[rows], actual[rows].astype(np.float64)
        self.conditioning, self.inputs = FACTOR * table.conditioning[rows], table.rows[rows]
        # What is small is judged absolutely, by the truth's own scale over the whole table: a wild hypothesis excuses nothing.
        self.scales = {m.start: table.scales[m.start] for m in members}
        self.tolerance = max(ALIKE, limit)
        with np.errstate(all="ignore"):
            size = np.abs(self.truth) + SMALL * max(self.scales.values())
            off = np.nan_to_num(np.abs(self.actual - self.truth) / size, nan=np.inf)[:, _columns(members)].max(axis=1)
        if (wrong := off[off > limit]).size:
            self.tolerance = min(self.tolerance, max(limit, NEARER * float(np.median(wrong))))
        self.wrong = ~self.explained(self.truth)

    def as_if(self, output: np.ndarray) -> "Compared":
        """Whether something gives `output`, in the place of what came."""
        other = copy(self)
        other.actual = output.astype(np.float64)
        return other

    def on(self, rows: np.ndarray) -> "Compared":
        """Some of the rows."""
        other = copy(self)
        for part in ("truth", "actual", "conditioning", "inputs", "wrong"):
            setattr(other, part, getattr(self, part)[rows])
        other.inner = {name: values[rows] for name, values in self.inner.items()}
        return other

    def shows(self) -> np.ndarray:
        """(K,) bool: the rows on which something came."""
        least = [10 * self.tolerance * SMALL * self.scales[m.start] for m in self.members]
        return np.any([(np.abs(self.actual[:, m]) > s).any(axis=1) for m, s in zip(self.members, least)], axis=0)

    def explained(self, output: np.ndarray) -> np.ndarray:
        """(..., K, results) -> (..., K) bool: the rows where `output` is what came."""
        alike = np.ones(output.shape[:-1], bool)
        with np.errstate(all="ignore"):
            for member in self.members:
                a, c = self.actual[:, member], output[..., member]
                size = np.where(np.isfinite(c), np.abs(c), 0.0)
                allowed = self.tolerance * (size + SMALL * self.scales[member.start]) + self.conditioning[:, member]
                same = (np.abs(a - c) <= allowed) | (a == c) | (np.isnan(a) & np.isnan(c))
                alike &= same.all(axis=-1)
        return alike


def _columns(members: list[slice]) -> list[int]:
    return [k for m in members for k in range(m.start, m.stop)]


# --------------------------------------------------------------------------------------- what happens to a result


def of_result(compared: Compared, output: np.ndarray, plain: bool) -> Iterator[tuple[str, np.ndarray, int]]:
    """U(output) that may be what came: words, values, and how far from plain. `plain`: output is the truth, so that factors of
    any size are looked for."""
    a, columns = compared.actual, _columns(compared.members)
    use = np.zeros(a.shape, bool)
    with np.errstate(all="ignore"):
        size = np.abs(output)
        finite = size[:, columns][np.isfinite(size[:, columns])]
        scale = np.percentile(finite, 95) if finite.size else 1.0
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
            half = round(2 * power) / 2
            p = half if abs(half - power) < 0.02 else power
            if 0.1 < abs(p) < 16 and abs(p - 1) > 0.01 and (plain or p == half):
                yield _power(p), np.sign(output) * np.abs(output) ** p, 2
            if plain and np.ptp(x) > 0.1:
                p, k = np.polyfit(x, y, 1)
                yield f"{np.exp(k):.4g} times the power {p:.4g} of", np.exp(k) * np.abs(output) ** p, 4
        for member in compared.members:
            if member.stop - member.start == 3:
                length = np.linalg.norm(output[:, member], axis=1, keepdims=True)
                yield (
                    "the normalised",
                    _with(output, (member, np.where(length > 0, output[:, member] / length, 0.0))),
                    1,
                )
        yield "1 minus", 1 - output, 1
        yield "the absolute value of", np.abs(output), 1
        yield "the clamped (to 0 .. 1)", np.clip(output, 0, 1), 1
        yield "the clamped (at 0)", np.maximum(output, 0), 1
        if plain:
            finite = a[:, columns][np.isfinite(a[:, columns])]
            if finite.size:
                for bound, words, limited in (
                    (finite.max(), "the smaller one of {} and", np.minimum), (finite.min(), "the larger one of {} and", np.maximum)
                ):  # fmt: skip
                    yield words.format(f"{bound:.4g}"), limited(output, bound), 2
            offset = float(np.median((a - output)[:, columns][np.isfinite((a - output)[:, columns])]))
            if abs(offset) > 1e-12:
                yield f"{offset:.4g} more than", output + offset, 3


FACTOR_OF = "a factor"
PAIRED, FEWEST_PAIRED, MOST_PAIRS = (
    64,
    12,
    4,
)  # numbers that two hypotheses at once are held against; pairs that are offered
Again = Callable[[np.ndarray], Iterator[tuple[str, np.ndarray, int]]]  # of one hypothesis on more rows: as of_result


def of_factors(compared: Compared, outputs: np.ndarray) -> Iterator[tuple[np.ndarray, Callable[..., Again]]]:
    """A quantity of the inputs as a factor on what many hypotheses give, (C, K, results): the values, and how to try one of them
    on other rows. A straight factor such as (q + 2)/(2 pi) is fitted, for scalars."""
    columns, function = _columns(compared.members), compared.function
    scalars = {c.path for c in function.inputs if c.width == 1 and c.domain.type != "int"}
    with np.errstate(all="ignore"):
        for name, x in quantities(function, compared.inputs).items():
            if not np.isfinite(x).all() or np.ptp(x) < 1e-6 * np.abs(x).max() or name[-2:] in (".x", ".y", ".z"):
                continue
            for power, words in ((1, f"{name} times"), (-1, f"1/{_bracketed(name)} times")):
                yield outputs * (x**power)[:, None], partial(_times_a_quantity, name, power, words)
            if name in scalars:
                size = np.abs(outputs[..., columns])
                largest = np.max(np.where(np.isfinite(size), size, 0.0), axis=(1, 2), keepdims=True)
                large = np.isfinite(size) & (size > 0.02 * largest)
                ratio = np.where(large, compared.actual[:, columns] / outputs[..., columns], np.nan)
                y = np.nansum(ratio, axis=2) / np.isfinite(ratio).sum(axis=2)  # (C, K); NaN where there is none
                at = np.where(large.any(axis=2), x, np.nan)
                weight = 1 / np.maximum(np.abs(y), 1e-9) ** 2
                total = np.nansum(np.where(np.isfinite(y * at), weight, 0), axis=1)
                mean_x, mean_y = np.nansum(weight * at, axis=1) / total, np.nansum(weight * y, axis=1) / total
                away = at - mean_x[:, None]
                slope = np.nansum(weight * away * (y - mean_y[:, None]), axis=1) / np.nansum(weight * away**2, axis=1)
                factor = slope[:, None] * x + (mean_y - slope * mean_x)[:, None]
                yield outputs * factor[:, :, None], partial(_times_straight, name)


def of_pairs(compared: Compared, outputs: np.ndarray) -> Iterator[tuple[int, int]]:
    """Two of many hypotheses, (C, K, results), that multiply what is expected, both at once: which two may do it."""
    columns = _columns(compared.members)
    with np.errstate(all="ignore"):
        truth = compared.truth[:, columns]
        use = (
            compared.wrong[:, None]
            & np.isfinite(truth)
            & (np.abs(truth) > 0.01 * np.nanmax(np.abs(truth), initial=0.0))
        )
        ratios = np.where(use, outputs[..., columns] / truth, np.nan).reshape(len(outputs), -1)
        mine = np.where(use, compared.actual[:, columns] / truth, np.nan).ravel()
        good = (np.isfinite(mine) & (mine > 0)).nonzero()[0][:PAIRED]
        if len(good) < FEWEST_PAIRED:
            return
        logs, goal = np.log(ratios[:, good]), np.log(mine[good])
    known = np.flatnonzero(np.isfinite(logs).all(axis=1) & (np.abs(logs).max(axis=1) > 10 * compared.tolerance))
    # One number for each, in which sums stay sums; of those that fit, all numbers are compared.
    along = np.random.default_rng(3).normal(size=len(good))
    sums, wanted = logs[known] @ along, float(goal @ along)
    order = np.argsort(sums)
    slack, tried = 2 * compared.tolerance * np.abs(along).sum(), 0
    for k, i in enumerate(known):
        first, last = np.searchsorted(sums[order], [wanted - sums[k] - slack, wanted - sums[k] + slack])
        for j in known[order[first:last]]:
            if j > i and (np.abs(logs[i] + logs[j] - goal) < 3 * compared.tolerance).mean() > 0.9:
                yield int(i), int(j)
                tried += 1
                if tried == MOST_PAIRS:
                    return


def _times_a_quantity(name: str, power: int, words: str, compared: Compared) -> Again:
    def again(output: np.ndarray) -> Iterator[tuple[str, np.ndarray, int]]:
        x = quantities(compared.function, compared.inputs)[name]
        with np.errstate(all="ignore"):
            yield words, output * (x**power)[:, None], 1

    return again


def _times_straight(name: str, compared: Compared) -> Again:
    def again(output: np.ndarray) -> Iterator[tuple[str, np.ndarray, int]]:
        columns, x = _columns(compared.members), quantities(compared.function, compared.inputs)[name]
        with np.errstate(all="ignore"):
            ratio = compared.actual[:, columns] / output[:, columns]
            size = np.abs(output[:, columns])
            use = np.isfinite(ratio) & (size > 0.02 * np.nanmax(size)) & (ratio != 0)
            if use.sum() < 12:
                return
            at, y = np.broadcast_to(x[:, None], ratio.shape)[use], ratio[use]
            slope, start = np.polyfit(at, y, 1, w=1 / np.abs(y))
            if abs(slope) * np.ptp(at) > 0.05 * np.abs(y).mean():
                yield f"{_straight(slope, start, name)} times", output * (slope * x + start)[:, None], 2

    return again


def _bracketed(name: str) -> str:
    return f"({name})" if " " in name else name


def of_results(compared: Compared, outputs: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The like of many hypotheses at once, (C, K, results): the words of of_result, or FACTOR_OF, and the values."""
    columns = _columns(compared.members)
    with np.errstate(all="ignore"):
        size = np.abs(outputs[..., columns])
        large = np.isfinite(size) & (
            size > 0.02 * np.max(np.where(np.isfinite(size), size, 0), axis=(1, 2), keepdims=True)
        )
        ratio = np.where(large, compared.actual[:, columns] / outputs[..., columns], np.nan).reshape(len(outputs), -1)
        ratio.sort(axis=1)  # what is left out comes last
        counts = np.isfinite(ratio).sum(axis=1)
        factor = ratio[np.arange(len(outputs)), np.maximum(counts - 1, 0) // 2]
        yield FACTOR_OF, outputs * factor[:, None, None]
        yield "the square of", outputs * np.abs(outputs)
        yield "the square root of", np.sqrt(np.abs(outputs))
        yield "1 minus", 1 - outputs
        yield "the absolute value of", np.abs(outputs)
        yield "the clamped (to 0 .. 1)", np.clip(outputs, 0, 1)
        yield "the clamped (at 0)", np.maximum(outputs, 0)
        if all(m.stop - m.start == 3 for m in compared.members) and len(compared.members) == 1:
            length = np.linalg.norm(outputs[..., columns], axis=-1, keepdims=True)
            normalised = outputs.copy()
            normalised[..., columns] = outputs[..., columns] / length
            yield "the normalised", normalised


def _power(p: float) -> str:
    return {2.0: "the square of", 0.5: "the square root of", -1.0: "1 over", 3.0: "the cube of"}.get(
        p, f"the power {p:.4g} of"
    )


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
            for words, reduced in (("the mean", np.mean), ("the largest", np.max), ("the sum", np.sum)):
                same = reduced(truth[:, one], axis=1, keepdims=True) + np.zeros(3)
                yield f"{words} of the channels of {mine} for all", _with(truth, (one, same)), 1
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


def of_directions(compared: Compared) -> Iterator[tuple[str, np.ndarray, int]]:
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
        for names in (
            list(named),
            [n for n in basis if n.startswith("(")],
            [n for n in basis if not n.startswith("cross")],
            [n for n in basis if n.startswith("cross")],
        ):
            if not names or len(names) > 6:
                continue
            columns = np.stack([np.cross(unit, basis[n][use]).ravel() for n in names], axis=1)
            if not np.isfinite(columns).all():
                continue
            values, vectors = np.linalg.svd(columns, full_matrices=False)[1:]
            c = vectors[-1]
            if not np.isfinite(c).all() or values[-1] > 1e-3 * np.sqrt(use.sum()):
                continue
            pointing = sum(k * basis[n] for k, n in zip(c, names))
            sign = np.sign(np.median(np.sum(pointing[use] * unit, axis=1)))
            if sign == 0:
                continue
            c, pointing = sign * c, sign * pointing
            smallest = np.abs(c)[np.abs(c) > 0.02 * np.abs(c).max()].min()
            said = _combination({n: k / smallest for n, k in zip(names, c) if abs(k) > 0.02 * np.abs(c).max()})
            size = np.linalg.norm(pointing, axis=1)
            with np.errstate(all="ignore"):
                ratio = np.median(length[use] / size[use])
                constant = np.abs(length[use] / size[use] / ratio - 1) < 0.01
            factor = (
                ratio
                if constant.mean() > 0.9
                else np.where(length > 1e-6, length / np.maximum(size, 1e-30), np.nan)[:, None]
            )
            if constant.mean() > 0.9:
                terms = {n: k * ratio for n, k in zip(names, c) if abs(k) > 0.02 * np.abs(c).max()}
                simple = len(terms) == 1 and next(iter(terms)) in named
                yield _combination(terms), _with(compared.truth, (member, factor * pointing)), 1 if simple else 3
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


def of_quantities(compared: Compared) -> Iterator[tuple[str, np.ndarray, int]]:
    """A factor made of the inputs' quantities: powers of one or two of them, forgotten or too many (the lobe times n.l); one that
    is straight in a quantity ((q + 2)/(2 pi)), or that depends on it alone; a number added to a divisor."""
    columns = _columns(compared.members)
    with np.errstate(all="ignore"):
        truth, came = compared.truth[:, columns], compared.actual[:, columns]
        known = quantities(compared.function, compared.inputs)
        by_channel = {
            name: values[:, :3]
            for name, values in channels_of(compared.function, compared.inputs).items()
            if all(m.stop - m.start == 3 for m in compared.members)
        }
        spread = {n: np.repeat(x[:, None], len(columns), axis=1) for n, x in known.items()}
        tiled = {n: np.tile(x, (1, len(columns) // 3)) for n, x in by_channel.items()}
        everything = spread | tiled
        finite = np.isfinite(came) & np.isfinite(truth)
        if finite.sum() < 12:
            return
        usable = finite & (np.abs(truth) > 1e-4 * np.percentile(np.abs(truth[finite]), 95))
        if usable.sum() < 12:
            usable = finite & (came != 0)
        if usable.sum() < 12:
            return
        ratio = came / truth
        rng = np.random.default_rng(1)
        chosen = np.flatnonzero(usable.ravel())
        chosen = chosen[rng.permutation(len(chosen))[:FITTED]]
        flat = {n: x.ravel()[chosen] for n, x in everything.items()}
        flat = {n: x for n, x in flat.items() if np.isfinite(x).all() and np.ptp(x) > 1e-6 * np.abs(x).max()}
        r = ratio.ravel()[chosen]

        def values(factor: np.ndarray) -> np.ndarray:
            out = compared.truth.copy()
            out[:, columns] = np.where(truth == 0, 0.0, truth * factor)
            return out

        if found := _monomial(r, flat, compared.tolerance):
            powers, constant = found
            factor = constant * _raised_product(everything, powers)
            yield _product(powers, constant, compared.tolerance), values(factor), 2
        own = came.ravel()[chosen]
        if (own > 0).mean() > 0.95 and (
            found := _monomial(own, flat | {TRUTH: np.abs(truth.ravel()[chosen])}, compared.tolerance)
        ):
            powers, constant = found
            if powers != {TRUTH: 1} and len(powers) < 3:
                out = compared.truth.copy()
                product = constant * _raised_product(everything | {TRUTH: np.abs(truth)}, powers)
                out[:, columns] = np.where((truth == 0) & (came == 0), 0.0, product)
                yield f"ONLY {_product(powers, constant, compared.tolerance).removeprefix('times ')}", out, 3
        for inverse in (1, -1):
            excess = r**inverse - 1
            if found := _monomial(np.abs(excess), flat, 20 * compared.tolerance):
                powers, constant = found
                constant *= np.sign(np.median(excess))
                factor = (1 + constant * _raised_product(everything, powers)) ** inverse
                said = _product(powers, abs(constant), compared.tolerance).removeprefix("times ")
                verb, sign = ("times" if inverse == 1 else "divided by"), "+" if constant > 0 else "-"
                if inverse == -1 and all(p < 0 for p in powers.values()):
                    divisor = _product({n: -p for n, p in powers.items()}, 1.0, 1e-3).removeprefix("times ")
                    yield f", but with {constant:.3g} added to the divisor {divisor}", values(factor), 3
                else:
                    yield f"{verb} (1 {sign} {said})", values(factor), 4
        for name, x in flat.items():
            for inverse in (1, -1):
                y = r**inverse
                if not np.isfinite(y).all():
                    continue
                slope, start = np.polyfit(x, y, 1, w=1 / np.maximum(np.abs(y), 1e-9))
                if (np.abs(slope * x + start - y) <= 2 * compared.tolerance * np.abs(y)).mean() > 0.9 and (
                    abs(slope) * np.ptp(x) > 0.05 * np.abs(y).mean()
                ):
                    factor = (slope * everything[name] + start) ** inverse
                    verb = "times" if inverse == 1 else "divided by"
                    yield f"{verb} {_straight(slope, start, name)}", values(factor), 3
        for name, x in flat.items():
            here = (r > 0) & np.isfinite(r)
            if here.mean() > 0.95 and name in spread:  # what a medium lets through: exp(-r)
                along, y = x[here] - x[here].mean(), np.log(r[here])
                rate = (along @ y) / (along @ along)
                start = y.mean() - rate * x[here].mean()
                near = np.abs(rate * x[here] + start - y) <= 3 * compared.tolerance + 1e-4 * np.abs(rate * x[here])
                if near.mean() > 0.9 and abs(rate) * np.ptp(x) > 0.5:
                    constant = "" if abs(start) < 1e-3 else f"{np.exp(start):.4g} "
                    said = f"times {constant}exp({rate:.4g} {name})".replace("exp(1 ", "exp(").replace(
                        "exp(-1 ", "exp(-"
                    )
                    yield said, values(np.exp(rate * everything[name] + start)), 3
        for name, x in flat.items():
            order = np.argsort(x)
            step = np.abs(np.diff(r[order])) / (np.abs(r[order][1:]) + 0.02 * np.abs(r).max())
            if len(r) >= 60 and np.mean(step < 0.05) > 0.95 and np.ptp(r) > 0.1 * np.abs(r).max() and name in spread:
                inside = np.interp(everything[name], x[order], r[order])
                low, high = x[order][len(x) // 20], x[order][-len(x) // 20 - 1]
                at = " and ".join(f"{np.interp(k, x[order], r[order]):.3g} at {name} = {k:.3g}" for k in (low, high))
                yield (
                    f"times a factor that depends on {name} alone: {at}",
                    np.where(
                        np.abs(values(inside) - compared.actual) < 0.1 * np.abs(compared.actual),
                        compared.actual,
                        values(inside),
                    ),
                    5,
                )
                break


def of_inner(compared: Compared) -> Iterator[tuple[str, np.ndarray, int]]:
    """What the reference computes on its way, forgotten, too many, or alone, where the two differ: times (1 - F), t^3."""
    columns, wrong = _columns(compared.members), np.flatnonzero(compared.wrong)
    threes = all(m.stop - m.start == 3 for m in compared.members)
    usable = {name: v for name, v in compared.inner.items() if v.shape[1] == 1 or threes}
    if len(wrong) < 12 or not usable:
        return

    def tiled(values: np.ndarray) -> np.ndarray:
        return np.tile(values, (1, len(columns) // values.shape[1]))

    with np.errstate(all="ignore"):
        everything = {name: tiled(values.astype(np.float64)) for name, values in usable.items()}
        given = {
            n: tiled(x[:, None])
            for n, x in quantities(compared.function, compared.inputs).items()
            if n not in everything
        }
        truth, came = compared.truth[:, columns], compared.actual[:, columns]
        met = np.all([np.isfinite(x) for x in everything.values()], axis=0) & compared.wrong[:, None]
        # All of them at once, or one by one where no row comes to all.
        for names in [list(everything)] if met.sum() >= 12 else [[n] for n in everything]:
            own = {n: everything[n] for n in names}
            here = np.all([np.isfinite(x) for x in own.values()], axis=0) & compared.wrong[:, None] & np.isfinite(came)
            if here.sum() < 12:
                continue
            flat = {n: x[here] for n, x in (own | given).items()}
            flat = {n: x for n, x in flat.items() if np.isfinite(x).all() and np.ptp(x) > 1e-6 * np.abs(x).max()}

            def values(result: np.ndarray, here: np.ndarray = here) -> np.ndarray:
                out = compared.truth.copy()
                out[:, columns] = np.where(here, result, truth)
                return out

            def told(powers: dict[str, float], own: dict[str, np.ndarray] = own) -> bool:
                return any(n in own for n in powers)

            ratio, known = came / truth, own | given
            if (found := _monomial(ratio[here], flat, compared.tolerance)) and told(found[0]):
                powers, constant = found
                said = _product(powers, constant, compared.tolerance)
                yield f"what is expected {said}", values(truth * constant * _raised_product(known, powers)), 2
            if (found := _monomial(came[here], flat, compared.tolerance)) and told(found[0]):
                powers, constant = found
                said = _product(powers, constant, compared.tolerance).removeprefix("times ")
                yield f"{said}, where they are wrong", values(constant * _raised_product(known, powers)), 3
            excess = ratio[here] - 1
            found = _monomial(np.abs(excess), {n: x for n, x in flat.items() if n in own}, 20 * compared.tolerance)
            if found and abs(found[1] - 1) < 0.01:
                powers, sign = found[0], float(np.sign(np.median(excess)))
                said = _product(powers, 1.0, compared.tolerance).removeprefix("times ")
                factor = 1 + sign * _raised_product(known, powers)
                yield f"what is expected times (1 {'+' if sign > 0 else '-'} {said})", values(truth * factor), 3


def of_curve(compared: Compared) -> Iterator[tuple[str, np.ndarray, int]]:
    """A curve of what is expected alone: another ramp, a tone curve."""
    columns = _columns(compared.members)
    truth, came = compared.truth[:, columns].ravel(), compared.actual[:, columns].ravel()
    use = np.isfinite(truth) & np.isfinite(came)
    if use.sum() < 60:
        return
    order = np.flatnonzero(use)[np.argsort(truth[use], kind="stable")]
    x, y = truth[order], came[order]
    ramp = np.abs(y - x) > compared.tolerance * (np.abs(x) + SMALL * np.ptp(x))
    if ramp.sum() < 30:
        return
    x, y = x[ramp], y[ramp]
    gap = np.maximum(x[2:] - x[:-2], 1e-300)
    between = y[:-2] + (y[2:] - y[:-2]) * (x[1:-1] - x[:-2]) / gap
    bends = np.abs(y[1:-1] - between)  # a curve goes between its neighbours
    if (
        np.mean(bends < 0.02 * np.abs(y[1:-1]) + 1e-3 * np.ptp(y)) < 0.95
        or np.corrcoef(np.argsort(np.argsort(x)), y)[0, 1] ** 2 < 0.1
    ):
        return
    if np.abs(y - x).max() < 0.02 * np.ptp(x):
        return
    at = [np.percentile(x, k) for k in (10, 50, 90)]
    said = ", ".join(f"{np.interp(k, x, y):.3g} where it is {k:.3g}" for k in at)
    through = np.interp(compared.truth[:, columns], x, y)
    near = np.abs(through - compared.actual[:, columns]) < 0.02 * np.ptp(y)
    values = compared.truth.copy()
    values[:, columns] = np.where(near, compared.actual[:, columns], through)
    yield f"on a curve of their own over what is expected: {said}", values, 5


def of_sums(compared: Compared) -> Iterator[tuple[str, np.ndarray, int]]:
    """A sum of two quantities, or of one and a constant: kd + e, a little kd where nothing is expected."""
    columns = _columns(compared.members)
    came = compared.actual[:, columns].ravel()
    known = {TRUTH: compared.truth[:, columns].ravel(), "1": np.ones(len(came))}
    if all(m.stop - m.start == 3 for m in compared.members):
        of_inputs = channels_of(compared.function, compared.inputs)
        known |= {n: np.tile(x, (1, len(columns) // 3)).ravel() for n, x in of_inputs.items()}
    else:
        known |= {n: np.repeat(x, len(columns)) for n, x in quantities(compared.function, compared.inputs).items()}
    use = np.isfinite(came) & np.isfinite(known[TRUTH])
    known = {n: x for n, x in known.items() if np.isfinite(x).all() and np.abs(x[use]).max(initial=0) > 0}
    if use.sum() < 12 or len(known) > 60:
        return
    x, y = np.stack([v[use] for v in known.values()], axis=1), came[use]
    weight = 1 / (np.abs(y) + 0.01 * np.percentile(np.abs(y), 95) + 1e-30)
    x, y, names = x * weight[:, None], y * weight, list(known)
    gram, with_y = x.T @ x, x.T @ y
    tried = []
    for i, j in [*((k, k) for k in range(len(names))), *combinations(range(len(names)), 2)]:
        chosen = [i] if i == j else [i, j]
        part = gram[np.ix_(chosen, chosen)]
        if np.linalg.det(part) > 1e-9 * np.prod(np.diag(part)):
            c = np.linalg.solve(part, with_y[chosen])
            tried.append((float(y @ y - c @ with_y[chosen]), chosen))
    for _, chosen in sorted(tried, key=lambda t: (t[0] + 1e-9, len(t[1])))[:4]:
        c = np.linalg.lstsq(x[:, chosen], y, rcond=None)[0]
        c = [round(k, 2) if abs(round(k, 2) - k) < 1e-4 * abs(k) + 1e-6 else float(k) for k in c]
        rest = np.abs(x[:, chosen] @ c - y)
        if np.mean(rest < 5 * compared.tolerance) > 0.9:
            values = compared.truth.copy()
            values[:, columns] = np.reshape(sum(k * known[names[n]] for k, n in zip(c, chosen)), (-1, len(columns)))
            sizes = [abs(k) * np.abs(x[:, n]).mean() for k, n in zip(c, chosen)]
            if min(sizes) < 0.01 * max(sizes) or names[chosen[0]] == TRUTH and len(chosen) == 1:
                continue  # one of the two is nothing, or it is a factor
            yield _combination({names[n]: k for k, n in zip(c, chosen)}).replace(" 1", "").replace("  ", " "), values, 3


def _monomial(
    ratio: np.ndarray, known: dict[str, np.ndarray], tolerance: float
) -> tuple[dict[str, float], float] | None:
    """The powers of at most three quantities, with a constant, that give the ratio."""
    if not (ratio > 0).mean() > 0.95:
        return None
    y = np.log(np.abs(ratio))
    logs = {n: np.log(x) for n, x in known.items()}
    logs = {n: x for n, x in logs.items() if np.isfinite(x).mean() > 0.95 and np.nanstd(x) > 0.02}
    if not np.isfinite(y).any() or np.ptp(y[np.isfinite(y)]) < 10 * tolerance:
        return None
    names = [n for n, x in logs.items() if np.isfinite(x).mean() > 0.99] if len(logs) > 40 else list(logs)
    use = np.isfinite(y) & np.all([np.isfinite(logs[n]) for n in names], axis=0) if names else np.zeros(len(y), bool)
    if use.sum() < 12:
        return None
    x = np.stack([logs[n][use] for n in names], axis=1)
    x, mine = x - x.mean(axis=0), y[use] - y[use].mean()
    gram, with_y = x.T @ x, x.T @ mine
    groups = [((k,), with_y[k] ** 2 / gram[k, k]) for k in range(len(names))]
    for i, j in combinations(range(len(names)), 2):
        det = gram[i, i] * gram[j, j] - gram[i, j] ** 2
        if det > 1e-6 * gram[i, i] * gram[j, j]:
            p, q = (
                (with_y[i] * gram[j, j] - with_y[j] * gram[i, j]) / det,
                (with_y[j] * gram[i, i] - with_y[i] * gram[i, j]) / det,
            )
            groups.append(((i, j), p * with_y[i] + q * with_y[j]))
    pairs = sorted((g for g in groups if len(g[0]) == 2), key=lambda g: -g[1])[:3]
    for (i, j), k in ((pair, k) for pair, _ in pairs for k in range(len(names)) if k not in pair):
        three = [i, j, k]
        part = gram[np.ix_(three, three)]
        if np.linalg.det(part) > 1e-6 * np.prod(np.diag(part)):
            groups.append(((i, j, k), float(np.linalg.solve(part, with_y[three]) @ with_y[three])))
    best = None
    # One quantity before two; of those that leave least, the few best are tried with the powers that people write.
    for size in (1, 2, 3):
        for group, _ in sorted((g for g in groups if len(g[0]) == size), key=lambda g: -g[1])[:6]:
            chosen = list(group)
            solution = np.linalg.lstsq(x[:, chosen], mine, rcond=None)[0]
            powers = [min(MONOMIALS, key=lambda p: abs(p - s)) for s in solution]
            if max(abs(p - s) for p, s in zip(powers, solution)) > 0.3:
                continue
            rest = y[use] - sum(p * logs[names[k]][use] for p, k in zip(powers, chosen))
            constant = float(np.median(rest))
            share = float((np.abs(rest - constant) <= 3 * tolerance).mean())
            if share > 0.9 and (best is None or share > best[0] + 0.02):
                best = (share, {names[k]: p for k, p in zip(chosen, powers)}, float(np.exp(constant)))
        if best is not None:
            return best[1:]
    return None


def _raised_product(known: dict[str, np.ndarray], powers: dict[str, float]) -> np.ndarray:
    """Of quantities that are negative in places, a power is one of the clamped quantity."""
    return np.prod([np.maximum(known[n], 0.0) ** p for n, p in powers.items()], axis=0)


def _product(powers: dict[str, float], constant: float, tolerance: float) -> str:
    """times 2 pi and n.l, divided by m^2"""
    named, _ = _nearest(constant, 10 * tolerance)
    times = [] if abs(constant - 1) < 1e-3 else [named or f"{constant:.4g}"]
    times += [_raised(n, p) for n, p in powers.items() if p > 0]
    divided = [_raised(n, -p) for n, p in powers.items() if p < 0]
    said = ([f"times {' times '.join(times)}"] if times else []) + (
        [f"divided by {' and '.join(divided)}"] if divided else []
    )
    return " and ".join(said)


def _straight(slope: float, start: float, name: str) -> str:
    """0.159155 (q + 2)"""
    if abs(start) < 1e-6 * abs(slope):
        return f"{slope:.6g} {name}"
    shift = start / slope
    near = round(shift, 2)
    shift = near if abs(near - shift) < 0.01 * abs(shift) else shift
    named, _ = _nearest(slope, 1e-3)
    size = "" if named == "1" or abs(slope - 1) < 1e-3 else f"{named or f'{slope:.4g}'} "
    return f"{size}({name} {'+' if shift > 0 else '-'} {abs(shift):.4g})"


def _raised(name: str, power: float) -> str:
    if power == 1:
        return name
    return f"{name}^{power:g}" if name.replace(".", "").isalnum() else f"({name})^{power:g}"
