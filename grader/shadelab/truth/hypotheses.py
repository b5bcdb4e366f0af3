"""What mistakes that nobody declared would give: the reference with one thing changed (course/mutants.py), and the reference on
changed arguments (transforms.py), evaluated on the tables when expected data is made. A submission that gives the numbers of one
is told what is changed; diagnosis.py decides. Everything comes from the declaration and the solution's text."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from shadelab.course.assignment import Function, named_arrays
from shadelab.course.mistakes import SLIDES, load_changes, regions
from shadelab.course.mutants import InnerQuantity, Mutant, Scope, mutants, probes
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import DOUBLE
from shadelab.truth.expected import Hypothesis, Table, with_callers
from shadelab.truth.many import ROWS_AT_ONCE, ManyBodies
from shadelab.truth.measures import function_members, scaled_error
from shadelab.truth.tables import renormalised
from shadelab.truth.transforms import Transform, transforms
from shadelab.truth.workshop import Workshop

# What differs from the truth on at most NARROW rows (a gate's, say) is kept whole; of what differs on more, KEPT rows, the same
# for all of a function.
NARROW, KEPT = 1500, 512
# Two that differ by less are one: the sentence of the first is told.
SAME = 1e-5
LONG = 12  # words
# Of a function: the slides' body, its own and its first variants', of which mutants are bred; and those of which inner quantities
# are kept.
BODIES, PROBED = 4, 2


def make_hypotheses(workshop: Workshop, tables: dict[str, Table], calls: dict[str, list[str]]) -> dict[str, np.ndarray]:
    """The arrays of hypotheses.npz."""
    with workshop.step("changed references"):
        changed = _ChangedReferences(workshop)
        functions = [f for f in workshop.assignment.functions if f.graded]
        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(lambda f: _of_function(workshop, f, tables[f.name], changed, calls), functions))
    return {key: array for arrays in found for key, array in arrays.items()}


# ----------------------------------------------------------------------------------------------- how they are made


def _of_function(
    workshop: Workshop, function: Function, table: Table, changed: "_ChangedReferences", calls: dict[str, list[str]]
) -> dict[str, np.ndarray]:
    kept = _Kept(function, table)
    exact = renormalised(function, table.rows)
    for transform, output in _transformed(workshop, function, exact):
        kept.add(transform.words, function.name, output)
    for sister in _sisters(workshop, function):
        output = workshop.solution(DOUBLE).evaluate(Evaluate(sister, exact))
        kept.add(f"with {sister.name} in the place of {function.name}", function.name, output.array)
    kept.transforms = len(kept.found)
    for mutant, output in changed.outputs(function, calls, exact):
        kept.add(mutant.words, mutant.function, output)
    inner = {f"inner.{name}": values for name, values in changed.inner(function, exact).items()}
    return {f"{function.name}.{part}": array for part, array in (kept.arrays() | inner).items()}


def _sisters(workshop: Workshop, function: Function) -> list[Function]:
    """Those that could be called in its place."""

    def signature(f: Function) -> list[str]:
        return [f.returns, *(v.domain.type for v in f.values)]

    return [f for f in workshop.assignment.functions if f.name != function.name and signature(f) == signature(function)]


def _transformed(workshop: Workshop, function: Function, exact: np.ndarray) -> Iterator[tuple[Transform, np.ndarray]]:
    """Many to a run: a process takes longer to start than to evaluate some thousand rows."""
    runner = workshop.solution(DOUBLE)
    arrays = named_arrays(function.inputs, exact)
    pending: list[tuple[Transform, np.ndarray]] = []

    def run() -> Iterator[tuple[Transform, np.ndarray]]:
        inputs = np.concatenate([rows for _, rows in pending])
        output = runner.evaluate(Evaluate(function, inputs))
        if output.array is not None:
            for (transform, _), array in zip(pending, output.array.reshape(len(pending), len(exact), -1)):
                yield transform, array
        pending.clear()

    for transform in transforms(function):
        with np.errstate(all="ignore"):
            pending.append((transform, transform.rows(function, arrays)))
        if len(pending) * len(exact) > ROWS_AT_ONCE:
            yield from run()
    if pending:
        yield from run()


def number_of_words(text: str) -> int:
    return len(text.split())


class _Kept:
    """The hypotheses of one function, without those that cannot be told from the truth or from an earlier one."""

    def __init__(self, function: Function, table: Table) -> None:
        self.table, self.members = table, function_members(function)
        self.some = np.sort(np.random.default_rng(len(table.rows)).permutation(len(table.rows))[:KEPT])
        self.found: list[Hypothesis] = []
        self.alike: dict[tuple[bool, bytes], list[int]] = {}  # places in `found`, by everywhere and rows
        self.transforms = 0  # how many of them are of changed arguments
        self.doubled: set[str] = set()  # words of those that have two

    def add(self, words: str, function: str, output: np.ndarray) -> None:
        differs = scaled_error(output, self.table, self.members).max(axis=1) > SAME
        if not differs.any():
            return
        narrow = bool(differs.sum() <= NARROW)
        rows = np.flatnonzero(differs) if narrow else self.some
        with np.errstate(over="ignore"):  # infinite, as in the student's float32
            one = Hypothesis(words, function, rows, output[rows].astype(np.float32), narrow)
        alike = self.alike.setdefault((one.everywhere, one.rows.tobytes()), [])
        k = self._same(one, alike)
        if k is None:
            alike.append(len(self.found))
            self.found.append(one)
            return
        other = self.found[k]
        # A changed argument may do what a changed line does: both are told, or the one that says what the other does and more.
        if k < self.transforms and other.words not in self.doubled and number_of_words(words) < LONG:
            if words in other.words:
                return
            both = words if other.words in words else f"{other.words}, or {words}"
            self.doubled.add(both)
            self.found[k] = replace(other, words=both)

    def _same(self, one: Hypothesis, alike: list[int]) -> int | None:
        """The first of them that gives the same."""

        def close(values: np.ndarray, others: np.ndarray) -> np.ndarray:
            near = np.isclose(values, others, rtol=SAME, atol=0, equal_nan=True)
            return near.reshape(len(others), -1).mean(axis=1) >= 0.99

        few = slice(0, 8)  # most differ there already
        if alike:
            for place in np.flatnonzero(close(one.values[few], np.stack([self.found[k].values[few] for k in alike]))):
                k = alike[place]
                if close(one.values, self.found[k].values[None])[0]:
                    return k
        return None

    def arrays(self) -> dict[str, np.ndarray]:
        if not self.found:
            return {}
        return {
            "words": np.array([h.words for h in self.found]), "functions": np.array([h.function for h in self.found]),
            "ends": np.cumsum([len(h.rows) for h in self.found]), "rows": np.concatenate([h.rows for h in self.found]).astype(np.uint16),
            "values": np.concatenate([h.values for h in self.found]), "everywhere": np.array([h.everywhere for h in self.found]),
        }  # fmt: skip


class _ChangedReferences:
    """The mutants that have words, in one program."""

    def __init__(self, workshop: Workshop) -> None:
        self.assignment = workshop.assignment
        self.reaching: set[str] = (
            set()
        )  # bodies of which callers are asked, too: what they may do over again themselves
        self.probes: list[InnerQuantity] = []
        self.mutants = dict(enumerate(self._bred(), 1))
        bodies = {number: {mutant.function: mutant.body} for number, mutant in self.mutants.items()}
        self.asked: dict[int, InnerQuantity] = {}  # by the number of its body; the moved one has the next
        for probe in self.probes:
            number = len(bodies) + 1
            self.asked[number] = probe
            bodies[number], bodies[number + 1] = {probe.function: probe.body}, {probe.function: probe.moved}
        self.many = ManyBodies(self.assignment, workshop.work / "changed", bodies, double=True)

    def _bred(self) -> list[Mutant]:
        """Of each function's own body and of variants', for another algebra has other places to go wrong. Loops are left out: a
        mutant of one may never end."""
        out: dict[tuple[str, str], Mutant] = {}
        source = self.assignment.directory / "shading.cpp"
        text, variants = source.read_text(), load_changes(self.assignment).variant
        marked = regions(text, source)
        for function in (f for f in self.assignment.functions if f.name in marked):
            scope = Scope.of(self.assignment, function, text)
            # The slides' form first: what is told is told in its terms.
            variants.sort(key=lambda v: v.id != SLIDES)
            bodies = [v.bodies_for("cpp").get(function.name, "") for v in variants]
            bodies.insert(1 if bodies and bodies[0] else 0, marked[function.name]["body"])
            plain = [body for body in bodies if body and not re.search(r"\b(for|while)\b", body)]
            for number, body in enumerate(plain[:BODIES]):
                self.probes += probes(function, body, scope) if number < PROBED else []
                for mutant in mutants(function.name, body, scope):
                    if mutant.words:
                        out.setdefault((function.name, mutant.body), mutant)
                        self.reaching |= {mutant.body} if number == 0 else set()
        # Of two that give the same numbers the first is told: constants last, for "4 for 5" tells least.
        return sorted(out.values(), key=lambda mutant: ("constant" in mutant.words, "throughout" in mutant.words))

    def outputs(
        self, function: Function, calls: dict[str, list[str]], rows: np.ndarray
    ) -> Iterator[tuple[Mutant, np.ndarray]]:
        """What this function gives with those that may change it, its own first."""
        own = [number for number, mutant in self.mutants.items() if mutant.function == function.name]
        callees = [
            number
            for number, mutant in self.mutants.items()
            if mutant.function != function.name
            and mutant.body in self.reaching
            and function.name in with_callers({mutant.function}, calls)
        ]
        for numbers in (own, callees):
            for number, output in self.many.evaluate(numbers, Evaluate(function, rows), function.name):
                yield self.mutants[number], output

    def inner(self, function: Function, rows: np.ndarray) -> dict[str, np.ndarray]:
        """(N, 1) or (N, 3) by name: the quantities that the reference computes on its way; NaN where it does not come to one."""
        own = {number: probe for number, probe in self.asked.items() if probe.function == function.name}
        numbers = [body for number in own for body in (number, number + 1)]
        values, out = dict(self.many.evaluate(numbers, Evaluate(function, rows), function.name)), {}
        for number, probe in own.items():
            if probe.words not in out and number in values and number + 1 in values:
                value, moved = (values[k][:, : probe.width] for k in (number, number + 1))
                with np.errstate(over="ignore"):
                    out[probe.words] = np.where(value == moved, np.nan, value).astype(np.float32)
        return out
