"""Every branch that a student wrote is asked. Where a program is wrong in a small place only no table can guess the place, but
the program names it: it compares something there. Of the comparisons that a table decides one way alone rows are searched that
decide them the other way, from the typical domain: fresh ones, then neighbours of those that come closest."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from shadelab.course.assignment import Assignment, Function, named_arrays
from shadelab.course.mistakes import slide_formulas, with_bodies
from shadelab.evidence.tasks import Asking, Evaluate, Program, Trace
from shadelab.machine.build import DOUBLE, FUNCTIONS
from shadelab.truth.expected import Table
from shadelab.truth.function_tables import moved_rows, truth_of
from shadelab.truth.tables import NEAREST_PLACE, bounds, make_table, nearby

FRESH_SEED = 6837  # of rows that the table does not hold
WAVES, PATIENCE = 8, 2  # of neighbours; so many may come no nearer
CLOSEST, NEIGHBOURS = 12, 32  # for each comparison: from so many rows, so many neighbours each
MOST_SIDES = 24  # that are searched for at once
KEPT = 12  # rows that are judged for each side that was found
BELOW, ABOVE, AT = "below", "above", "at"
Side = tuple[int, str]  # where a comparison stands, and on which side of it


@dataclass
class Known:
    """Rows, and on which side of each comparison they lie."""

    rows: np.ndarray  # (N, columns) float32
    margins: dict[int, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict
    )  # by site: least and most, (N,) each
    lines: dict[int, int] = field(default_factory=dict)  # by site, of those in the function's own text

    @classmethod
    def of(cls, rows: np.ndarray, trace: Trace) -> "Known":
        margins = {int(s): (trace.least[:, k], trace.most[:, k]) for k, s in enumerate(trace.sites)}
        return cls(rows, margins, trace.lines)

    def sides(self) -> Iterator[tuple[Side, np.ndarray]]:
        """And which rows lie there."""
        for site, (least, most) in self.margins.items():
            yield (site, BELOW), least < 0
            yield (site, ABOVE), most > 0
            yield (site, AT), (least <= 0) & (most >= 0)

    def met(self) -> set[Side]:
        return {side for side, here in self.sides() if here.any()}

    def distance(self, side: Side) -> np.ndarray:
        """(N,): how far a row is from that side; infinite where it does not come there."""
        least, most = self.margins.get(side[0], (np.full(len(self.rows), np.nan),) * 2)
        away = least if side[1] == BELOW else -most
        return np.where(np.isfinite(away), away, np.inf)


@dataclass
class Found:
    rows: np.ndarray  # (M, columns) float32: on sides that the table does not meet
    one_way: list[int]  # lines of comparisons of the student's own that all rows decide one way


def search(assignment: Assignment, function: Function, table: Known, program: Program | None) -> Asking[Found]:
    """program: who is asked; None: the submission as graded."""
    met, rng = table.met(), np.random.default_rng(FRESH_SEED)
    fresh = make_table(assignment, function, FRESH_SEED)
    tried, best = [table], dict[Side, list[float]]()
    candidates = _typical(function, np.vstack([fresh, *_solved(function, table, fresh, met)]))
    for _ in range(1 + WAVES):
        output = yield Evaluate(function, candidates, program=program, traced=True)
        if output.trace is None:
            break
        tried.append(Known.of(candidates, output.trace))
        wanted = [side for side in _open_sides(tried) if not _in_vain(best.setdefault(side, []), tried[-1], side)]
        if not wanted:
            break
        starts = np.vstack([_closest(tried, side) for side in wanted])
        candidates = _typical(function, nearby(function, starts.repeat(NEIGHBOURS, axis=0), fresh, rng))
    return Found(_chosen(tried[1:], met, len(function.inputs)), _one_way(tried))


def _one_way(tried: list[Known]) -> list[int]:
    """Lines of comparisons that nothing decides the other way: told, for there may be a slip in them, and not punished, for most
    are guards against what never happens."""
    met = Counter(site for site, _ in set().union(*(known.met() for known in tried)))
    return sorted({line for known in tried for site, line in known.lines.items() if met[site] == 1})


def _typical(function: Function, rows: np.ndarray) -> np.ndarray:
    """Without those in which two positions come closer than in any table: to a light itself, where its falloff overflows."""
    arrays = named_arrays(function.inputs, rows)
    places = [arrays[c.path] for c in function.inputs if c.index == 0 and c.domain.kind == "position"]
    apart = [np.linalg.norm(one - other, axis=1) >= NEAREST_PLACE for one, other in combinations(places, 2)]
    return rows[np.all(apart, axis=0)] if apart else rows


def _in_vain(distances: list[float], last: Known, side: Side) -> bool:
    """Whether the last PATIENCE waves came no nearer: most such sides are guards against what never happens."""
    before = min(distances[:-PATIENCE], default=np.inf)
    distances.append(float(last.distance(side).min()))
    return len(distances) > PATIENCE and min(distances[-PATIENCE:]) > 0.5 * before


def _open_sides(tried: list[Known]) -> list[Side]:
    """Those that no row meets, first of comparisons that were only come to behind another."""
    found = set().union(*(known.met() for known in tried))
    sites = dict.fromkeys(site for known in reversed(tried) for site in known.margins)
    behind = sorted(sites, key=lambda site: site in tried[0].margins)
    return [(site, side) for site in behind for side in (BELOW, ABOVE) if (site, side) not in found][:MOST_SIDES]


def _solved(function: Function, table: Known, fresh: np.ndarray, met: set[Side]) -> Iterator[np.ndarray]:
    """Rows exactly on a constant with which an argument itself is compared: an equality that no row meets by chance."""
    for site, (least, most) in table.margins.items():
        here = np.isfinite(least) & (least == most)
        if (site, AT) in met or here.sum() < 2:
            continue
        for k, column in enumerate(function.inputs):
            constants = table.rows[here, k].astype(np.float64) - least[here]
            middle, (low, high) = float(np.median(constants)), bounds(column.domain)
            if column.width == 1 and np.ptp(constants) <= 1e-5 * (1 + abs(middle)) and low <= middle <= high:
                rows = fresh[:CLOSEST].copy()
                # The difference was rounded: the plainest number near it is the one that is written.
                rows[:, k] = float(f"{middle:.5g}")
                yield rows


def _closest(tried: list[Known], side: Side) -> np.ndarray:
    distances = np.concatenate([known.distance(side) for known in tried])
    rows = np.vstack([known.rows for known in tried])
    return rows[np.argsort(distances, kind="stable")[:CLOSEST]]


def _chosen(tried: list[Known], met: set[Side], columns: int) -> np.ndarray:
    """Of each side that was found some rows, from its edge to its middle."""
    chosen = [np.empty((0, columns), np.float32)]
    found: dict[Side, list[np.ndarray]] = {}
    for known in tried:
        for side, here in known.sides():
            if side not in met and here.any():
                depth = np.abs(known.distance(side))[here]
                found.setdefault(side, []).append(known.rows[here][np.argsort(depth)])
    for parts in found.values():
        rows = np.vstack(parts)
        chosen.append(rows[np.unique(np.linspace(0, len(rows) - 1, KEPT).astype(int))])
    return np.unique(np.vstack(chosen), axis=0)


def with_rows(assignment: Assignment, function: Function, table: Table, rows: np.ndarray) -> Asking[Table]:
    """The table with these rows at its end, judged by the same rule, but without those on which even the slides' formulas
    overflow or divide 0 by 0 in float: what a domain declares does not say all of what a contract does."""
    source = assignment.directory / "shading.cpp"
    texts = [assignment.solution]
    if slides := slide_formulas(assignment):
        texts.append(with_bodies(texts[0], source, slides.bodies_for("cpp")))
    as_float = yield Evaluate(function, rows, program=Program(FUNCTIONS, texts[-1]))
    rows = rows[np.isfinite(as_float.array).all(axis=1)]
    if not len(rows):
        return table
    results = []
    for text in texts:
        output = yield Evaluate(function, moved_rows(function, rows), program=Program(DOUBLE, text))
        results.append(output.array)
    truth, conditioning = truth_of(results, len(rows))
    scenes = None if table.scenes is None else np.concatenate([table.scenes, np.full(len(rows), -1)])
    return Table(
        np.vstack([table.rows, rows]),
        np.vstack([table.truth, truth]),
        np.vstack([table.conditioning, conditioning]),
        table.drawn,
        scenes,
    )
