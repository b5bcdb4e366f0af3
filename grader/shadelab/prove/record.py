"""Which assignments check has passed, remembered for all that it looked at: whoever changes that has to check again."""

import hashlib
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.paths import STATE
from shadelab.truth.closure import import_closure
from shadelab.truth.digest import digest

JUDGE = "shadelab.prove.check"  # the module that checks; all of the grader that a grading needs is in its closure


def remember(assignment: Assignment, seen: str) -> None:
    """seen: looked_at before the check began, since somebody may have edited meanwhile."""
    file = _record(assignment)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(seen + "\n")


def has_passed(assignment: Assignment) -> bool:
    file = _record(assignment)
    return file.exists() and file.read_text().strip() == looked_at(assignment)


def _record(assignment: Assignment) -> Path:
    return STATE / "checked" / assignment.name


def looked_at(assignment: Assignment) -> str:
    """A digest of it: the assignment with all that its expected data rests on, and the grader."""
    draw_hidden_scenes(assignment.hidden, assignment.directory, assignment.name)
    total = hashlib.sha256(digest(assignment).encode())
    for file in [*import_closure(JUDGE), *assignment.check_files]:
        total.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()[:32]
