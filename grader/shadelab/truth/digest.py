"""What expected data is keyed by: a digest of everything that its numbers rest on."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import FILE as MISTAKES
from shadelab.course.stability import FILE as STABILITY
from shadelab.errors import InfrastructureError
from shadelab.machine.glue import MANIFEST
from shadelab.paths import FRAMEWORK, ROOT, shown
from shadelab.truth.closure import import_closure
from shadelab.truth.driver import DRIVER, FILES

MAKER = "shadelab.truth.making"  # the module that makes it; a program that it starts is in its closure, too
TOOLS = FRAMEWORK / "tools"  # which measure what was built, and which a release does without


def digest(assignment: Assignment) -> str:
    """Of everything that the expected data rests on: our code, the framework, solution, declarations, scenes, meshes."""
    total = hashlib.sha256()
    for file in dict.fromkeys(made_from(assignment)):
        total.update(str(file.name).encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()[:32]


def made_from(assignment: Assignment) -> Iterator[Path]:
    """Those files. Raises an error for one that is missing, but for what need not be there: declarations that an assignment
    may do without, and meshes, whose scenes are skipped then."""
    yield from import_closure(MAKER)
    yield from (DRIVER / name for name in FILES)
    yield ROOT / "CMakeLists.txt"
    yield from (file for file in _all_files(FRAMEWORK) if TOOLS not in file.parents)
    pending = [assignment]
    while pending:
        one = pending.pop()
        yield from (one.directory / name for name in (MANIFEST, *one.files))
        pending += one.given
    optional = [assignment.directory / name for name in (MISTAKES, "exact.py", STABILITY)]
    for scene in assignment.scenes:
        yield scene.file
        optional += scene.described.meshes
    yield from (file for file in optional if file.exists())


def _all_files(folder: Path) -> list[Path]:
    if not (files := sorted(f for f in folder.rglob("*") if f.is_file())):
        raise InfrastructureError(f"{shown(folder)}: is missing or empty, but expected data rests on it")
    return files
