"""starter/NAME, made from solution/NAME: what stands between the STUDENT marks is replaced by a stub that compiles and draws."""

import json
import re
import subprocess
import tempfile
from hashlib import sha256
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.stubs import stub_text
from shadelab.errors import UserError
from shadelab.files import naming, write_whole
from shadelab.inspect import editor
from shadelab.paths import STARTER, STATE, shown
from shadelab.publish.rubric import MARK, rubric


def starter_files(assignment: Assignment) -> dict[str, bytes]:
    out: dict[str, bytes] = {}
    for name in assignment.files:
        text = stub_text(assignment, name)
        if text is None:
            raise UserError(
                f"{shown(assignment.directory / name)}: holds no STUDENT BEGIN … STUDENT END, so there is nothing for students to write"
            )
        out[name] = text.encode()
    out["assignment.toml"] = (assignment.directory / "assignment.toml").read_bytes()
    handout = assignment.directory / "handout.md"
    out["handout.md"] = handout.read_text().replace(MARK, rubric(assignment)).encode()
    for picture in re.findall(r"\]\(((?!https?:)[^)#]+\.(?:png|svg))\)", handout.read_text()):
        file = assignment.directory / picture
        if not file.is_file():
            raise UserError(
                f"{shown(handout)}: the picture {picture} is not there; docs/make_pictures.py makes those of scenes"
            )
        out[picture] = file.read_bytes()
    return out


def write_starter(assignment: Assignment, force: bool) -> Path:
    """Raises UserError when the folder holds what neither a commit holds nor we have written, so that nobody's work is lost;
    `force` overrides."""
    folder = STARTER / assignment.name
    git = ["git", "-C", str(STARTER.parent), "status", "--porcelain", "--", str(folder)]
    changed = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    record = STATE / "starter" / f"{assignment.name}.json"
    if changed and not force and _digests(folder) != _recorded(record):
        raise UserError(f"{shown(folder)}: holds changes that are not committed; commit or move them, or give --force")
    files = starter_files(assignment)
    STARTER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".making-", dir=STARTER) as scratch:
        made, former = Path(scratch) / "made", Path(scratch) / "former"
        for name, data in files.items():
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            with naming(folder / name):
                (made / name).write_bytes(data)
        if folder.exists():
            folder.rename(former)
        made.rename(folder)
    record.parent.mkdir(parents=True, exist_ok=True)
    write_whole(record, json.dumps(_digests(folder)))
    return folder


def _digests(folder: Path) -> dict[str, str]:
    return {str(f.relative_to(folder)): sha256(f.read_bytes()).hexdigest() for f in folder.rglob("*") if f.is_file()}


def _recorded(file: Path) -> dict[str, str] | None:
    """The digests of what was last written there."""
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError):
        return None


def differences(assignment: Assignment) -> list[str]:
    """What in starter/NAME is not what the solution generates: one line per file."""
    folder, wanted = STARTER / assignment.name, starter_files(assignment)
    present = {str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file()} if folder.is_dir() else set()
    present = {name for name in present if name != editor.COMMANDS and not name.startswith(f"{editor.FOLDER}/")}
    out = [f"{shown(folder / name)}: is missing" for name in wanted if name not in present]
    out += [f"{shown(folder / name)}: the solution does not generate it" for name in sorted(present - set(wanted))]
    out += [
        f"{shown(folder / name)}: differs from what {shown(assignment.directory / name)} generates"
        for name, data in wanted.items()
        if name in present and (folder / name).read_bytes() != data
    ]
    return out
