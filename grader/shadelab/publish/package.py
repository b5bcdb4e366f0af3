"""package: the zip that an autograding service takes: its two scripts and a checkout that grades one assignment.

    setup.sh, run_autograder    templates/gradescope
    shadelab/                   shadelab, framework/, grader/, scenes/ as here; solution/ with this assignment and the given ones

It holds the solution and the seed of the hidden scenes: it is for instructors and the service, never for students.
"""

import json
import re
import secrets
import shutil
import zipfile
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.errors import UserError
from shadelab.files import whole
from shadelab.machine.sandbox import work_folder
from shadelab.paths import shown
from shadelab.prove.record import has_passed
from shadelab.publish.release import TEMPLATES, copy_checkout, copy_scenes, write_given

TARGETS = ("gradescope",)
# Of a solution: what people read. The rest is graded with.
READ_BY_PEOPLE = ("handout.md", "pictures")
SCRIPTS = ("setup.sh", "run_autograder", "shadelab/shadelab")


def write_package(assignment: Assignment, target: str, output: Path, seed: str | None, force: bool) -> str:
    """Returns the digest of the seed, which results record; without `seed` one is drawn, which nobody gets to see. Raises
    UserError for an assignment that `check` has not passed as it is now, unless `force`."""
    if target not in TARGETS:
        raise UserError(f"--for {target}: is not known; there is {', '.join(TARGETS)}")
    if output.suffix != ".zip" or output.is_dir():
        raise UserError(f"{shown(output)}: must be the name of a .zip file")
    if not output.absolute().parent.is_dir():
        raise UserError(f"{shown(output)}: there is no folder {shown(output.parent)}")
    if seed is not None and not seed.strip():
        raise UserError("--seed: is empty; leave it out to have one drawn")
    if not force and not has_passed(assignment):
        raise UserError(
            f"{assignment.name}: ./shadelab check {assignment.name} has not passed for it as it is now; run that, "
            "or give --force"
        )
    seed = seed or secrets.token_hex(16)

    with work_folder("package") as folder:
        checkout = folder / "shadelab"
        copy_checkout(checkout)
        bases = [(assignment.directory / family.base).resolve() for family in assignment.hidden.family]
        copy_scenes([*(scene.file for scene in assignment.public_scenes), *bases], checkout)
        write_given(assignment, checkout / "solution")
        _write_solution(assignment, checkout / "solution" / assignment.name, seed)
        for file in (TEMPLATES / target).iterdir():
            (folder / file.name).write_text(file.read_text().replace("__NAME__", assignment.name))
        _zip(folder, output)
    return assignment.hidden.model_copy(update={"seed": seed}).seed_digest


def _write_solution(assignment: Assignment, folder: Path, seed: str) -> None:
    source = assignment.directory
    for file in sorted(f for f in source.rglob("*") if f.is_file()):
        inside = file.relative_to(source)
        if inside.parts[0] in READ_BY_PEOPLE or "__pycache__" in inside.parts:
            continue
        (folder / inside).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, folder / inside)
    if (hidden := folder / "hidden.toml").exists():
        line = f"seed = {json.dumps(seed, ensure_ascii=False)}"
        hidden.write_text(re.sub(r"^seed *=.*$", lambda _: line, hidden.read_text(), flags=re.MULTILINE))


def _zip(folder: Path, output: Path) -> None:
    """Equal content gives equal bytes: no times, sorted names."""
    with whole(output) as part, zipfile.ZipFile(part, "w") as archive:
        for file in sorted(f for f in folder.rglob("*") if f.is_file()):
            entry = zipfile.ZipInfo(str(file.relative_to(folder)))  # of 1980: older than all that is made from it
            entry.external_attr = (0o100755 if entry.filename in SCRIPTS else 0o100644) << 16
            archive.writestr(entry, file.read_bytes(), zipfile.ZIP_DEFLATED)
