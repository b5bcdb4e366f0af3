"""What of a submission is still the starter's: by its text, without comments and spaces.

Numbers would not do: a wrong program may give what a stub gives (a clamp that swallows everything gives 0), and whoever wrote it
has begun and needs to hear what is wrong."""

import re
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.bodies import tokens
from shadelab.course.mistakes import regions
from shadelab.result import Check
from shadelab.words import FILES, decoded

FOLDER = "stubs"  # in a release, beside the manifest: there is no solution there to make stubs of


def stub_text(assignment: Assignment, name: str) -> str | None:
    """The file as students receive it: what stands between the STUDENT marks is replaced by a stub that compiles and draws."""
    source, kept = assignment.directory / name, assignment.directory / FOLDER / name
    if kept.is_file():
        return kept.read_text()
    if not source.is_file():
        return None
    text = source.read_text()
    marked = sorted(regions(text, source).values(), key=lambda m: -m.start())
    for match in marked:
        indent = match["indent"]
        text = (
            f"{text[: match.start()]}{indent}// TODO: {match['task']}\n{indent}{match['stub']}\n{text[match.end() :]}"
        )
    return text if marked else None


def not_begun(assignment: Assignment, submission: Path) -> dict[str, set[str]]:
    """By language: the graded functions that the submission has as the starter has them."""
    out: dict[str, set[str]] = {}
    for backend, name in FILES.items():
        stub, file = stub_text(assignment, name), submission / name
        out[backend] = set()
        if stub is None or not file.is_file():
            continue
        written = _words(decoded(file.read_bytes()))
        for function in (f.name for f in assignment.functions if f.graded):
            opening = re.search(rf"^\w+ {function}\([^;{{]*\) \{{.*?^\}}$", stub, re.MULTILINE | re.DOTALL)
            if opening and _words(opening.group()) in written:
                out[backend].add(function)
    return out


def mark(check: Check, assignment: Assignment, stubs: dict[str, set[str]]) -> None:
    """Nothing was begun that a failed check asks for: reports tell that in one line. (A stub may pass by follow-through.)"""
    graded = {f.name for f in assignment.functions if f.graded}
    here = stubs[check.backend] if check.kind != "parity" else set().union(*stubs.values())
    asked = {id.split("/")[-1] for id in [check.id, *check.because]} & graded
    if check.status == "passed" and check.kind == "function":
        check.begun = not asked <= here
    elif check.status == "failed" and check.kind != "build" and (here >= graded or (asked and asked <= here)):
        check.begun, check.mistake = False, None
        if check.id.split("/")[-1] in graded:
            check.message = "not begun: the starter's stub stands there"


def _words(text: str) -> str:
    return "\0".join(["", *(token.text for token in tokens(re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL))), ""])
