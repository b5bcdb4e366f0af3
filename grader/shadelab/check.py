"""check: grades the grader. Every declared mistake must lose points, in its function's own check and in none that the function
has no part in; every correct variant and the solution must lose none; the starter must stay at or below 15 %."""

import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from shadelab import expected
from shadelab.grade import BACKENDS, Grading, grade, plan_checks
from shadelab.manifest import Assignment
from shadelab.mistakes import SUBTLE, Change, callers, load_changes, write_submission
from shadelab.paths import STARTER
from shadelab.sandbox import work_folder

STARTER_LIMIT = 0.15


@dataclass
class Row:
    """One graded submission of the matrix."""

    name: str
    kind: str  # solution | starter | mistake | variant
    lost: dict[str, float]  # backend -> points lost
    failed: dict[str, list[str]]  # backend -> ids of the failed checks
    rmse: float  # of the public image that is farthest off, in either language
    faults: list[str] = field(default_factory=list)  # why the grader misses here; empty when all is well


def involved(assignment: Assignment, functions: set[str]) -> set[str]:
    """The ids of the checks that these functions can make fail: their own, their callers' and their scenes'."""
    affected = callers(assignment, functions)
    out = set()
    for plans in plan_checks(assignment).values():
        for plan in plans:
            if affected & set(plan.calls) or (plan.kind == "function" and plan.item.name in affected):
                out.add(plan.id)
    return out


def check(assignment: Assignment, progress: Callable[[str, int, int], None]) -> list[Row]:
    changes = load_changes(assignment)
    subjects: list[tuple[str, str, Change | None]] = [("solution", "solution", None), ("starter", "starter", None)]
    subjects += [(m.id, "mistake", m) for m in changes.mistake] + [(v.id, "variant", v) for v in changes.variant]
    expected.load(assignment)  # once, before several want it
    done = 0

    def judge(subject: tuple[str, str, Change | None]) -> Row:
        nonlocal done
        name, kind, change = subject
        folder = {"solution": assignment.directory, "starter": STARTER / assignment.name}.get(kind, scratch / name)
        if change is not None:
            write_submission(assignment, change, folder)
        row = _judge(assignment, name, kind, change, grade(assignment, folder))
        shutil.rmtree(scratch / name, ignore_errors=True)
        done += 1
        progress(f"{assignment.name}: {name}", done, len(subjects))
        return row

    # Two at a time: a grading alone waits for the slower of its two languages.
    with work_folder("check") as scratch, ThreadPoolExecutor(2) as pool:
        progress(assignment.name, 0, len(subjects))
        return list(pool.map(judge, subjects))


def worst_rmse(assignment: Assignment, grading: Grading) -> float:
    """Over all numbers of linear float images; infinite when one is missing or not finite."""
    public = {scene.name for scene in assignment.public_scenes}
    worst = 0.0
    for id, pictures in grading.pictures.items():
        if id.split("/")[-1] in public:
            actual = pictures.student
            known = actual is not None and np.isfinite(actual).all()
            off = actual.astype(np.float64) - pictures.expected if known else np.inf
            worst = max(worst, float(np.sqrt(np.mean(np.square(off)))))
    return worst


def _judge(assignment: Assignment, name: str, kind: str, change: Change | None, grading: Grading) -> Row:
    result = grading.result
    lost = {b: sum(c.max_score - c.score for c in result.checks if c.backend == b) for b in BACKENDS}
    failed = {b: [c.id for c in result.checks if c.backend == b and c.status == "failed"] for b in BACKENDS}
    row = Row(name, kind, lost, failed, worst_rmse(assignment, grading))
    row.faults += [f"{c.id}: {c.message}" for c in result.checks if c.status == "error"]
    row.faults += [
        f"{c.id} does not build: {c.message}" for c in result.checks if c.kind == "build" and c.status == "failed"
    ]
    if kind == "starter":
        if result.score > STARTER_LIMIT * result.max_score:
            row.faults.append(
                f"the starter has {result.score:g} of {result.max_score:g} points, more than {STARTER_LIMIT:.0%}"
            )
    elif kind == "mistake":
        if change.subtle and row.rmse >= SUBTLE:
            row.faults.append(f"is declared subtle, but an image's RMSE is {row.rmse:.3g} (subtle is below {SUBTLE:g})")
        allowed = involved(assignment, {change.function})
        for backend in BACKENDS:
            own = f"{backend}/function/{change.function}"
            if own not in failed[backend]:
                row.faults.append(f"{own} does not see it")
            if beyond := [id for id in failed[backend] if id not in allowed]:
                row.faults.append(f"{', '.join(beyond)}: fails although {change.function} has no part in it")
    else:
        row.faults += [
            f"{c.id} costs a correct {kind} {c.max_score - c.score:g} points: {c.message}"
            for c in result.checks
            if c.status == "failed"
        ]
    return row
