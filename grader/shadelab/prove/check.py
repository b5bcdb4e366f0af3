"""check: grades the grader. Every declared mistake must lose points in each language and be named, in its own function's
check and in no other; every correct variant and the solution must lose none; the starter must stay at or below 15 %.
Mutants of the solution must not survive."""

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import FILE as MISTAKES
from shadelab.course.mistakes import SUBTLE, Change, Changes, load_changes, write_submission
from shadelab.grading.grade import Grading, grade
from shadelab.grading.planning import plan_checks
from shadelab.judge.diagnosis import UNDECLARED
from shadelab.machine.sandbox import work_folder
from shadelab.paths import STARTER
from shadelab.prove.mutants import Mutation, mutate
from shadelab.truth import making
from shadelab.truth.expected import Expected, with_callees, with_callers
from shadelab.words import BACKENDS, listed, points

STARTER_LIMIT = 0.15


@dataclass
class Row:
    """One graded submission of the matrix."""

    name: str
    kind: str  # solution | starter | mistake | variant | crossed (a mistake below a variant)
    lost: dict[str, float]  # backend -> points lost
    failed: dict[str, list[str]]  # backend -> ids of the failed checks
    named: dict[str, float]  # backend -> the margin by which the mistake was named; absent: it was not
    rmse: float | None  # of the public image that is farthest off, in either language; None: no image was drawn
    faults: list[str] = field(default_factory=list)  # why the grader misses here; empty when all is well


@dataclass
class Matrix:
    rows: list[Row]
    crossed: int  # mistakes on top of which functions in another algebra were graded
    mutations: list[Mutation]
    remarks: list[str]  # what the declarations leave open: said, and no fault of the grader


def check(assignment: Assignment, progress: Callable[[str, int, int], None], images: bool = False) -> Matrix:
    """images: draw the scenes for the mistakes, too. The tables tell what each does; pictures say how much of it is seen."""
    changes = load_changes(assignment)
    subjects: list[tuple[str, str, Change | Crossed | None]] = [
        ("solution", "solution", None),
        ("starter", "starter", None),
    ]
    subjects += [(m.id, "mistake", m) for m in changes.mistake] + [(v.id, "variant", v) for v in changes.variant]
    expected = making.load(assignment, progress)  # once, before several want it
    crossed = list(_crossed(assignment, changes, expected))
    subjects += [(change.id, "crossed", change) for change in crossed]
    done = 0

    def judge(subject: tuple[str, str, Change | Crossed | None]) -> Row:
        nonlocal done
        name, kind, change = subject
        folder = {"solution": assignment.directory, "starter": STARTER / assignment.name}.get(kind, scratch / name)
        if change is not None:
            write_submission(assignment, change, folder)
        # What a mistake may change: its own function and those that call it.
        only: str | set[str] = "*"
        if kind == "crossed" or (kind == "mistake" and not images):
            functions = with_callers({change.function}, expected.facts.calls)
            languages = ["cpp"] if kind == "crossed" else BACKENDS  # the algebra is the same in both
            only = {f"{backend}/function/{name}" for backend in languages for name in functions}
        grading = grade(assignment, folder, only=only, pictures=False)
        row = _judge(assignment, name, kind, change, grading, images)
        shutil.rmtree(scratch / name, ignore_errors=True)
        done += 1
        progress(f"{assignment.name}: {name}", done, len(subjects))
        return row

    # Two at a time: a grading alone waits for the slower of its two languages.
    with work_folder("check") as scratch:
        progress(assignment.name, 0, len(subjects))
        with ThreadPoolExecutor(2) as pool:
            rows = [row for row in pool.map(judge, subjects) if row.kind != "crossed" or row.faults]
        mutations = mutate(assignment, expected, scratch / "mutants", progress)
        return Matrix(rows, len(crossed), mutations, _remarks(assignment, changes, expected))


@dataclass
class Crossed:
    """A mistake below a variant of the functions that call it."""

    id: str
    function: str  # in which the mistake is
    bodies: dict[str, dict[str, str]]  # by language and function

    def bodies_for(self, backend: str) -> dict[str, str]:
        return self.bodies[backend]


def _crossed(assignment: Assignment, changes: Changes, expected: Expected) -> Iterator[Crossed]:
    """Every mistake below every correct variant of the functions that call it: on top of a wrong function another algebra gives
    other numbers, and is right all the same."""
    graded = {f.name for f in assignment.functions if f.graded}
    for mistake in changes.mistake:
        callers = (with_callers({mistake.function}, expected.facts.calls) - {mistake.function}) & graded
        for variant in changes.variant:
            bodies = {
                b: {f: body for f, body in variant.bodies_for(b).items() if f in callers} | mistake.bodies_for(b)
                for b in BACKENDS
            }
            if callers & set(variant.bodies_for("cpp")):
                yield Crossed(f"{mistake.id}+{variant.id}", mistake.function, bodies)


def _remarks(assignment: Assignment, changes: Changes, expected: Expected) -> list[str]:
    graded = [f.name for f in assignment.functions if f.graded]
    mistaken = {m.function for m in changes.mistake}
    drawn = with_callees({name for scene in assignment.scenes for name in scene.described.calls}, expected.facts.calls)
    out = [f"{name}: no mistake of it is declared in {MISTAKES}" for name in graded if name not in mistaken]
    out += [f"{name}: no scene calls it, so no picture shows a mistake of it" for name in graded if name not in drawn]
    out += _holes(assignment, changes)
    if abs(assignment.points - 100) > 1e-6:
        out.append(
            f"its points add up to {points(assignment.points)}, not to 100 (hidden scenes and stability included)"
        )
    return out


def _holes(assignment: Assignment, changes: Changes) -> list[str]:
    """Of functions with the same arguments, what is declared for one and not for its sister: a mistake ID is FUNCTION-KIND."""
    sisters: dict[tuple, list[str]] = {}
    for f in (f for f in assignment.functions if f.graded):
        sisters.setdefault((f.returns, *(v.domain.type for v in f.values)), []).append(f.name)
    out = []
    for names in (group for group in sisters.values() if len(group) > 1):
        kinds: dict[str, list[str]] = {}
        for m in (m for m in changes.mistake if m.function in names):
            kinds.setdefault(m.id.removeprefix(m.function.replace("_", "-") + "-"), []).append(m.function)
        holes = {kind: [n for n in names if n not in mistaken] for kind, mistaken in kinds.items()}
        for name in names:
            if missing := [kind for kind, without in holes.items() if name in without]:
                others = listed([n for n in names if n != name])
                out.append(f"{name}: not declared, though {others} has it: {listed(missing)}")
    return out


def worst_rmse(assignment: Assignment, grading: Grading) -> float | None:
    """Over all numbers of linear float images; infinite when one is missing or not finite."""
    public = {scene.name for scene in assignment.public_scenes}
    drawn = [c for c in grading.result.checks if c.kind == "image" and c.id.split("/")[-1] in public]
    yours = [next((run.rmse for run in c.runs if run.series == "yours"), np.inf) for c in drawn if c.max_score]
    return max(yours, default=None)


def _judge(
    assignment: Assignment, name: str, kind: str, change: Change | Crossed | None, grading: Grading, images: bool
) -> Row:
    result = grading.result
    # A correct variant may well be unstable: that is what the points for stability are for.
    judged = [c for c in result.checks if not (kind == "variant" and c.kind == "stability")]
    lost = {b: sum(c.max_score - c.score for c in judged if c.backend == b) for b in BACKENDS}
    failed = {b: [c.id for c in judged if c.backend == b and c.status == "failed"] for b in BACKENDS}
    row = Row(name, kind, lost, failed, {}, worst_rmse(assignment, grading))
    row.faults += [f"{c.id}: {c.message}" for c in result.checks if c.status == "error"]
    row.faults += [
        f"{c.id} does not build: {c.message}" for c in result.checks if c.kind == "build" and c.status == "failed"
    ]
    if kind == "starter":
        if result.score > STARTER_LIMIT * result.max_score:
            row.faults.append(
                f"the starter has {result.score:g} of {result.max_score:g} points, more than {STARTER_LIMIT:.0%}"
            )
    elif kind == "crossed":
        own = {f"{backend}/function/{change.function}" for backend in BACKENDS}
        row.faults += [
            f"{c.id} costs {c.max_score - c.score:g} points, though it is right on top of {change.function}: {c.message}"
            for c in judged
            if c.status == "failed" and c.id not in own
        ]
    elif kind == "mistake":
        if images and change.subtle and row.rmse >= SUBTLE:
            row.faults.append(f"is declared subtle, but an image's RMSE is {row.rmse:.3g} (subtle is below {SUBTLE:g})")
        for backend in BACKENDS:
            _judge_mistake(row, change, backend, grading, assignment)
    else:
        row.faults += [
            f"{c.id} costs a correct {kind} {c.max_score - c.score:g} points: {c.message}"
            for c in judged
            if c.status == "failed"
        ]
    return row


def _judge_mistake(row: Row, change: Change, backend: str, grading: Grading, assignment: Assignment) -> None:
    """Its own function's check fails and names it. No other function's does: what is right given that one stays right."""
    own = f"{backend}/function/{change.function}"
    found = next(c for c in grading.result.checks if c.id == own)
    if found.status != "failed" or found.score >= found.max_score:
        row.faults.append(f"{own} does not see it")
    elif found.mistake is None or found.mistake.id == UNDECLARED:
        row.faults.append(f"{own} does not name it: {found.mistake.hint if found.mistake else found.message}")
    elif change.id not in (found.mistake.id, *found.mistake.alike):
        row.faults.append(f"{own} calls it {found.mistake.id}")
    else:
        row.named[backend] = found.mistake.margin
    others = [id for id in row.failed[backend] if id != own and "/function/" in id]
    if others:
        row.faults.append(f"{', '.join(others)}: fails although only {change.function} is wrong")
    allowed = {
        p.id for plans in plan_checks(assignment).values() for p in plans if p.kind in ("image", "parity", "custom")
    }
    if beyond := [id for id in row.failed[backend] if id != own and id not in others and id not in allowed]:
        row.faults.append(f"{', '.join(beyond)}: fails although {change.function} has no part in it")
