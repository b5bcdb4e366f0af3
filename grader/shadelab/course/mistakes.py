"""Declared mistakes and correct variants (solution/NAME/mistakes.toml): other bodies for the functions of the solution.

[[mistake]]
id = "phong-lobe-exponent-forgotten"
function = "phong_lobe"
hint = "..."                      # leads to the mistake without giving the line away
subtle = true                     # hardly to be seen: the RMSE of every image stays below SUBTLE
body = '''...'''                  # stands in both languages; cpp and glsl override it

[[variant]]                       # correct, written another way: must lose nothing
id = "slide-formulas"             # this one is what the slides say to the letter; it also measures how far that strays
bodies = { phong_lobe = '''...''' }

[[equivalent]]                    # a mutant of these that computes the same as the solution
id = "phong_lobe: ..."            # as check prints it
reason = "..."
"""

import re
from pathlib import Path

from pydantic import model_validator

from shadelab.course.assignment import Assignment
from shadelab.course.toml_files import Declared, validated
from shadelab.errors import UserError
from shadelab.paths import shown
from shadelab.words import FILES

FILE = "mistakes.toml"
SUBTLE = 0.01


class Change(Declared):
    """A mistake (one function, with a hint) or a variant (one or more functions)."""

    id: str
    function: str = ""
    hint: str = ""
    subtle: bool = False
    body: str | None = None
    cpp: str | None = None
    glsl: str | None = None
    bodies: dict[str, str] = {}

    @model_validator(mode="after")
    def _complete(self) -> "Change":
        if not self.bodies and not (self.function and (self.body or (self.cpp and self.glsl))):
            raise ValueError("needs function and body (or cpp and glsl), or bodies")
        return self

    def bodies_for(self, backend: str) -> dict[str, str]:
        if self.bodies:
            return self.bodies
        return {self.function: getattr(self, backend) or self.body}


class Equivalent(Declared):
    """A mutant that computes the same, so that no grader can tell it from the solution."""

    id: str
    reason: str


class Changes(Declared):
    mistake: list[Change] = []
    variant: list[Change] = []
    equivalent: list[Equivalent] = []


def load_changes(assignment: Assignment) -> Changes:
    file = assignment.directory / FILE
    if not file.exists():
        return Changes()
    changes: Changes = validated(Changes, file)
    names = {f.name for f in assignment.functions}
    seen: set[str] = set()
    for change in [*changes.mistake, *changes.variant]:
        if change.id in seen:
            raise UserError(f"{shown(file)}: {change.id} is declared twice")
        seen.add(change.id)
        for function in change.bodies_for("cpp"):
            if function not in names:
                raise UserError(f"{shown(file)}: {change.id}: {assignment.name} has no function {function}")
    for mistake in changes.mistake:
        if not mistake.hint or not mistake.function:
            raise UserError(f"{shown(file)}: {mistake.id}: a mistake needs its function and a hint")
    return changes


SLIDES = "slide-formulas"


def slide_formulas(assignment: Assignment) -> Change | None:
    """The variant that follows the slides to the letter."""
    return next((v for v in load_changes(assignment).variant if v.id == SLIDES), None)


_region = re.compile(
    r"^(?P<indent> *)// STUDENT BEGIN: (?P<task>.*)\n(?P<body>(?:.*\n)*?) *// STUDENT END: (?P<stub>.*)\n", re.MULTILINE
)


def regions(text: str, file: Path) -> dict[str, re.Match]:
    """The marked part of each function, by the function's name."""
    out = {}
    for match in _region.finditer(text):
        opening = [m for m in re.finditer(r"^\w+ (\w+)\([^;{]*\) \{$", text[: match.start()], re.MULTILINE)]
        if not opening:
            raise UserError(f"{shown(file)}: a STUDENT BEGIN stands outside of any function")
        out[opening[-1].group(1)] = match
    return out


def with_bodies(text: str, file: Path, bodies: dict[str, str]) -> str:
    """The solution's text with other bodies in the marked parts."""
    marked = regions(text, file)
    for name in bodies:
        if name not in marked:
            raise UserError(f"{shown(file)}: {name} has no STUDENT BEGIN … STUDENT END to put another body in")
    for name in sorted(bodies, key=lambda n: -marked[n].start()):
        match = marked[name]
        lines = [match["indent"] + line if line.strip() else line for line in bodies[name].strip("\n").splitlines()]
        text = text[: match.start()] + "\n".join(lines) + "\n" + text[match.end() :]
    return text


def write_submission(assignment: Assignment, change: Change, folder: Path) -> None:
    """A whole submission that differs from the solution by this change."""
    folder.mkdir(parents=True, exist_ok=True)
    for backend, name in FILES.items():
        source = assignment.directory / name
        (folder / name).write_text(with_bodies(source.read_text(), source, change.bodies_for(backend)))
