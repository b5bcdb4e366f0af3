"""What people do to a function's arguments by mistake, from the declared types: two exchanged, one negated, another of the same
kind in its place, a scalar squared or in degrees. The reference evaluated on such rows is what that mistake gives."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from shadelab.course.assignment import Column, Function

Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]

_scalars: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
    ("twice {}", lambda s: 2 * s), ("half of {}", lambda s: s / 2), ("4 times {}", lambda s: 4 * s), ("{} / 4", lambda s: s / 4),
    ("{} squared", lambda s: s * s), ("the square root of {}", lambda s: np.sqrt(np.abs(s))), ("1 / {}", lambda s: 1 / s),
    ("{} + 1", lambda s: s + 1), ("{} - 1", lambda s: s - 1), ("{} + 2", lambda s: s + 2), ("1 - {}", lambda s: 1 - s), ("-{}", lambda s: -s),
    ("the absolute value of {}", np.abs), ("1 / {} squared", lambda s: 1 / (s * s)), ("{} to the fourth power", lambda s: s**4),
    ("pi times {}", lambda s: np.pi * s), ("{} / pi", lambda s: s / np.pi), ("sqrt(2) times {}", lambda s: np.sqrt(2) * s),
    ("{} / sqrt(2)", lambda s: s / np.sqrt(2)), ("{} taken as degrees", np.radians), ("{} turned into degrees", np.degrees),
    ("the whole part of {}", np.floor), ("{} rounded", np.round), ("{} rounded up", np.ceil), ("{} clamped to 0 .. 1", lambda s: np.clip(s, 0, 1)),
    ("the cosine of {}", np.cos), ("the sine of {}", np.sin), ("the tangent of {}", np.tan), ("the arc cosine of {}", lambda s: np.arccos(np.clip(s, -1, 1))),
    ("{} cubed", lambda s: s**3), ("{} + 1e-3", lambda s: s + 1e-3), ("{} + 1e-4", lambda s: s + 1e-4), ("2 - {}", lambda s: 2 - s),
    ("((1 - {0}) / (1 + {0}))^2", lambda s: ((1 - s) / (1 + s)) ** 2),
]  # fmt: skip
_colours: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
    ("1 - {}", lambda c: 1 - c), ("{} squared", lambda c: c * c), ("((1 - {0}) / (1 + {0}))^2", lambda c: ((1 - c) / (1 + c)) ** 2), ("the square root of {}", lambda c: np.sqrt(np.abs(c))),
    ("half of {}", lambda c: c / 2), ("twice {}", lambda c: 2 * c), ("the first channel of {} for all", lambda c: c[:, [0, 0, 0]]),
    ("the second channel of {} for all", lambda c: c[:, [1, 1, 1]]), ("the third channel of {} for all", lambda c: c[:, [2, 2, 2]]),
    ("the mean of {}'s channels for all", lambda c: np.repeat(c.mean(axis=1, keepdims=True), 3, axis=1)),
    ("the largest of {}'s channels for all", lambda c: np.repeat(c.max(axis=1, keepdims=True), 3, axis=1)),
    ("{} with its first and third exchanged", lambda c: c[:, [2, 1, 0]]), ("{} with its first two exchanged", lambda c: c[:, [1, 0, 2]]),
    ("{} with its last two exchanged", lambda c: c[:, [0, 2, 1]]), ("{} with gamma 2.2 taken off", lambda c: np.abs(c) ** 2.2),
    ("{} with gamma 2.2 put on", lambda c: np.abs(c) ** (1 / 2.2)), ("{} clamped to 0 .. 1", lambda c: np.clip(c, 0, 1)),
    ("{} normalised", lambda c: c / np.maximum(np.linalg.norm(c, axis=1, keepdims=True), 1e-30)),
]  # fmt: skip


@dataclass(frozen=True)
class Transform:
    words: str  # after "as those of the reference"
    change: Change

    def rows(self, function: Function, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """(N, columns) float64."""
        changed = arrays | self.change(arrays)
        return np.concatenate([changed[p].reshape(len(changed[p]), -1) for p in paths(function)], axis=1)


def paths(function: Function) -> dict[str, Column]:
    """The first column of each value, by its path."""
    return {c.path: c for c in function.inputs if c.index == 0}


def directions(function: Function) -> list[str]:
    return [p for p, c in paths(function).items() if c.domain.kind in ("unit", "upper")]


def transforms(function: Function) -> Iterator[Transform]:
    """All of them; nothing of it depends on what the function computes."""
    kinds = paths(function)
    yield from _of_directions(directions(function))
    others = {p: c for p, c in kinds.items() if c.domain.kind not in ("unit", "upper")}
    pairs = [(p, q) for p, q in combinations(others, 2) if _alike(others[p], others[q])]
    for p, q in pairs:
        yield Transform(f"with {p} and {q} exchanged", lambda a, p=p, q=q: {p: a[q], q: a[p]})
        for one, other in ((p, q), (q, p)):
            yield _instead(one, f"{other} in the place of {one}", lambda a, o=other: a[o])
    for path, column in others.items():
        if column.domain.type == "int":
            yield from _of_choice(path, *map(int, column.domain.range))
            continue
        for value in (0, 1):
            yield _instead(path, f"{value} in the place of {path}", lambda a, p=path, v=value: np.full_like(a[p], v))
        for words, change in _scalars if column.width == 1 else _colours if column.width == 3 else ():
            yield _instead(path, f"{words.format(path)} in the place of {path}", lambda a, p=path, c=change: c(a[p]))
    for p, q in pairs:
        for one, other in ((p, q), (q, p)):
            yield _instead(one, f"{one} + {other} in the place of {one}", lambda a, p=one, q=other: a[p] + a[q])
            yield _instead(one, f"{one} - {other} in the place of {one}", lambda a, p=one, q=other: a[p] - a[q])
            yield _instead(one, f"{other} - {one} in the place of {one}", lambda a, p=one, q=other: a[q] - a[p])
            yield _instead(one, f"{one} times {other} in the place of {one}", lambda a, p=one, q=other: a[p] * a[q])
        if others[p].width == 1:
            for words, change in _scalars:
                both = f"with {words.format(p)} and {words.format(q)} in the places of {p} and {q}"
                yield Transform(both, lambda a, p=p, q=q, c=change: {p: c(a[p]), q: c(a[q])})


def _alike(a: Column, b: Column) -> bool:
    return a.width == b.width and a.domain.type == b.domain.type != "int"


def _of_choice(path: str, low: int, high: int) -> Iterator[Transform]:
    """A number that says which of several kinds it is."""
    for one, other in combinations(range(low, high + 1), 2):
        exchanged = lambda a, p=path, i=one, j=other: np.where(a[p] == i, j, np.where(a[p] == j, i, a[p]))  # noqa: E731
        yield Transform(f"with {path} {one} and {other} exchanged", lambda a, p=path, e=exchanged: {p: e(a)})
        for i, j in ((one, other), (other, one)):
            yield Transform(
                f"with {path} {i} treated as {j}", lambda a, p=path, i=i, j=j: {p: np.where(a[p] == i, j, a[p])}
            )


def _instead(path: str, words: str, value: Callable[[dict[str, np.ndarray]], np.ndarray]) -> Transform:
    return Transform(f"with {words}", lambda a: {path: value(a)})


def _of_directions(names: list[str]) -> Iterator[Transform]:
    for one in names:
        yield _instead(one, f"{one} pointing the other way", lambda a, p=one: -a[p])
        for k, letter in enumerate("xyz"):
            yield _instead(
                one, f"{one}.{letter} negated", lambda a, p=one, k=k: a[p] * np.where(np.arange(3) == k, -1.0, 1.0)
            )
        for k, axis in enumerate(("(1, 0, 0)", "(0, 1, 0)", "(0, 0, 1)")):
            yield _instead(
                one, f"{axis} in the place of {one}", lambda a, p=one, k=k: np.zeros_like(a[p]) + np.eye(3)[k]
            )
        for factor in (0.5, 2.0):
            yield _instead(one, f"{one} {factor:g} times as long", lambda a, p=one, f=factor: f * a[p])
    for p, q in combinations(names, 2):
        yield Transform(f"with {p} and {q} exchanged", lambda a, p=p, q=q: {p: a[q], q: a[p]})
        yield Transform(f"with {p} and {q} pointing the other way", lambda a, p=p, q=q: {p: -a[p], q: -a[q]})
        for one, other in ((p, q), (q, p)):
            yield _instead(one, f"{other} in the place of {one}", lambda a, o=other: a[o])
            yield _instead(one, f"-{other} in the place of {one}", lambda a, o=other: -a[o])
            yield _instead(
                one, f"{one} mirrored about {other}", lambda a, p=one, o=other: 2 * _dot(a[p], a[o]) * a[o] - a[p]
            )
            yield _instead(
                one,
                f"{one} mirrored about {other} and turned round",
                lambda a, p=one, o=other: a[p] - 2 * _dot(a[p], a[o]) * a[o],
            )
            yield Transform(f"with {one} mirrored about {other} and the two exchanged", lambda a, p=one, o=other: {
                p: a[o], o: 2 * _dot(a[p], a[o]) * a[o] - a[p]})  # fmt: skip
        for one in names:
            for sign, said in ((1, "the half vector of"), (-1, "the difference of")):
                yield _instead(
                    one, f"{said} {p} and {q} in the place of {one}", lambda a, p=p, q=q, s=sign: _unit(a[p] + s * a[q])
                )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=1, keepdims=True)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30)
