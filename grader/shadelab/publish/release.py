"""release: what students receive of an assignment: a checkout of its own that holds this assignment alone.

shadelab, framework/, grader/ ...   as here, without what only instructors use
NAME/                               what students write, as `starter` makes it
assignments/                        manifests; of the given assignments the code, too: it is compiled with the student's
expected/NAME/                      what the solution computes, in the place of the solution; nothing of hidden scenes
scenes/                             those of the assignment, and the script that makes the meshes
README.md, Dockerfile, .github/ ... from templates/release
release.json                        names these files, so that --force replaces them and nothing else
"""

import hashlib
import json
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from shadelab import __version__
from shadelab.course import stubs
from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import regions
from shadelab.course.stability import FILE as STABILITY
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.files import naming
from shadelab.paths import RECORD, ROOT, SCENES, shown
from shadelab.publish.rubric import hidden_points
from shadelab.publish.starter import starter_files
from shadelab.truth import making
from shadelab.truth.expected import Expected, public_files

TEMPLATES = Path(__file__).parent / "templates"
MAKING = ".making-"  # how the folder begins in which a release is put together
# Folders of a release, which no assignment can be called: its own stands beside them.
RESERVED = ("assignments", "build", "expected", "out")

# Set-up and grading need these, and nothing else of a checkout.
CHECKOUT = (
    "shadelab", "packages.apt", "CMakeLists.txt", "CMakePresets.json", "pyproject.toml", "LICENSE", ".gitignore",
    "framework", "grader", "scenes/make_meshes.py", "scenes/teapot_patches.txt", "scenes/SOURCES.md",
)  # fmt: skip
# Of these, what only instructors' commands use.
INSTRUCTORS = (
    "cli/course.py", "cli/measuring.py", "cli/release.py", "measure", "prove", "publish", "study", "report/matrix.py",
)  # fmt: skip
SHORT = 16  # a marked line of fewer characters says nothing by itself: `return vec3(0.0);` and shorter ones


def write_release(
    assignment: Assignment, out: Path, force: bool, progress: Callable[[str, int, int], None] = lambda *_: None
) -> list[str]:
    """Returns what an instructor should know about it, a line each. Whatever interrupts it, `out` holds a whole release, the old
    or the new one, or is as it was but for what --force can replace."""
    if (ROOT / assignment.name).exists() or assignment.name in RESERVED:
        raise UserError(f"{assignment.name}: a release has something else of this name; call the assignment otherwise")
    former = _former(out, force)
    made = making.load(assignment, progress)
    for scene in assignment.public_scenes:
        if missing := scene.missing_meshes():
            raise UserError(
                f"{shown(scene.file)}: the mesh {missing[0].name} is not on this machine, so there is no expected image "
                "to release (./shadelab doctor says how to get it)"
            )
    begun = not out.exists()
    out.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(prefix=MAKING, dir=out) as scratch, naming(out, Path(scratch)):
            warnings = _compose(assignment, made, Path(scratch), progress)
            _exchange(former, Path(scratch), out)
    except BaseException:
        if begun and not any(out.iterdir()):
            out.rmdir()
        raise
    return warnings


def _compose(assignment: Assignment, made: Expected, out: Path, progress: Callable[[str, int, int], None]) -> list[str]:
    copy_checkout(out)
    shutil.rmtree(out / "framework" / "tools", ignore_errors=True)
    for name in INSTRUCTORS:
        room = out / "grader" / "shadelab" / name
        shutil.rmtree(room) if room.is_dir() else room.unlink()
    copy_scenes([scene.file for scene in assignment.public_scenes], out)
    write_given(assignment, out / "assignments")
    own = out / "assignments" / assignment.name
    own.mkdir(exist_ok=True)
    for name in ("assignment.toml", STABILITY):
        if (assignment.directory / name).exists():
            shutil.copy(assignment.directory / name, own)
    # What is not begun is told by comparison with these, and they stay when students' own copies are lost.
    (own / stubs.FOLDER).mkdir()
    for name in assignment.files:
        (own / stubs.FOLDER / name).write_bytes(starter_files(assignment)[name])
    for file in assignment.check_files:  # they give points here, too, and say nothing of how the solution does it
        (own / "checks").mkdir(exist_ok=True)
        shutil.copy(file, own / "checks")
    shipped = out / "expected" / assignment.name
    shipped.mkdir(parents=True, exist_ok=True)
    # Packets repeat the meshes, of which one is not ours to hand on; students' machines make them.
    data_files = [file for file in public_files(made, assignment) if file.suffix != ".packet"]
    for done, file in enumerate(data_files):
        progress(f"release {assignment.name}: {file.name}", done, len(data_files))
        _copy_smaller(file, shipped / file.name)
    for name, data in starter_files(assignment).items():
        (out / assignment.name / name).parent.mkdir(parents=True, exist_ok=True)
        if name == "handout.md":
            data = data.replace(f"starter/{assignment.name}".encode(), assignment.name.encode())
        (out / assignment.name / name).write_bytes(data)
    _write_templates(assignment, out)
    digests = {str(f.relative_to(out)): _digest(f) for f in _files(out)}
    record = {
        "shadelab": __version__, "assignment": assignment.name, "hidden_points": hidden_points(assignment), "files": digests,
    }  # fmt: skip
    (out / RECORD).write_text(json.dumps(record, indent=1) + "\n")
    warnings = [
        f"it holds the solution of {given.name}, which {assignment.name} builds on"
        for given in given_assignments(assignment)
    ]
    return warnings + [f"{where} holds a line of the solution: {line}" for where, line in leaks(assignment, out)]


def _former(out: Path, force: bool) -> list[Path]:
    """The files of a former release that are there. Raises UserError for a folder that holds anything else instead."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{shown(out)}: is a file; give a folder that is empty or not there yet")
    if not out.exists() or not any(out.iterdir()):
        return []
    try:
        former = json.loads((out / RECORD).read_text())["files"]
    except (OSError, ValueError, KeyError, TypeError):
        raise UserError(f"{shown(out)}: is not empty, nor a former release; give another folder") from None
    if not force:
        raise UserError(f"{shown(out)}: holds a former release; --force replaces its files")
    present = [file for file in _files(out) if str(file.relative_to(out)) in former]
    for file in present:
        if _digest(file) != former[str(file.relative_to(out))]:
            raise UserError(f"{shown(file)}: was changed since the release; move it away first")
    return present


def _exchange(former: list[Path], made: Path, out: Path) -> None:
    """The record is there from the first new file on: what is cut off here, --force replaces."""
    for file in former:
        file.unlink()
    os.replace(made / RECORD, out / RECORD)
    for file in _files(made):
        target = out / file.relative_to(made)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, target)


def _files(out: Path) -> list[Path]:
    """Those of a release, without what git, ./shadelab and the build keep in its folder."""
    others = (".git", ".shadelab", "build", "out", "scenes/meshes", RECORD)
    found = (
        file for file in out.rglob("*") if file.is_file() and not any(file.is_relative_to(out / o) for o in others)
    )
    return sorted(file for file in found if not file.relative_to(out).parts[0].startswith(MAKING))


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


# ------------------------------------------------------------------------------------- parts that `package` needs, too


def copy_checkout(out: Path) -> None:
    """What set-up and grading need, but for assignments, scenes and expected data."""
    for name in CHECKOUT:
        source, target = ROOT / name, out / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", ".*")
            shutil.copytree(source, target, ignore=ignored, dirs_exist_ok=True)
        else:
            shutil.copy(source, target)


def copy_scenes(scenes: list[Path], out: Path) -> None:
    """Scene files, and those that they name (textures, say), at their places; make_meshes.py makes the meshes there."""
    for scene in dict.fromkeys(scenes):
        named = [(scene.parent / text).resolve() for text in _texts(read_toml(scene))]
        for file in [scene, *(f for f in named if f.is_file() and f.parent != SCENES.resolve() / "meshes")]:
            if not file.is_relative_to(SCENES.resolve()):
                raise UserError(
                    f"{shown(scene)}: {shown(file)} does not stand below scenes/, so it cannot be handed out"
                )
            target = out / "scenes" / file.relative_to(SCENES.resolve())
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, target)


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, (dict, list)):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)


def given_assignments(assignment: Assignment) -> list[Assignment]:
    """All that it builds on, also through others; each once."""
    found: dict[str, Assignment] = {}
    for given in assignment.given:
        for each in [*given_assignments(given), given]:
            found.setdefault(each.name, each)
    return list(found.values())


def write_given(assignment: Assignment, folder: Path) -> None:
    """The code of the given assignments. Their manifests lose scenes and points: here nothing of them is graded."""
    folder.mkdir(parents=True, exist_ok=True)
    for given in given_assignments(assignment):
        (folder / given.name).mkdir(exist_ok=True)
        text = (given.directory / "assignment.toml").read_text()
        text = re.sub(r"^\[\[scene\]\]\n(?:(?!\[\[).*\n?)*", "", text, flags=re.MULTILINE)
        text = re.sub(r"^points = .*\n", "", text, flags=re.MULTILINE)
        (folder / given.name / "assignment.toml").write_text(text)
        for name in given.files:
            code = (given.directory / name).read_text()
            code = re.sub(r"^ *// STUDENT (BEGIN|END)\b.*\n", "", code, flags=re.MULTILINE)
            (folder / given.name / name).write_text(code)


# ----------------------------------------------------------------------------------------------------------------------


def _copy_smaller(source: Path, target: Path) -> None:
    """Arrays compressed, to about a quarter: numpy reads either."""
    if source.suffix != ".npz":
        shutil.copy(source, target)
        return
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.namelist():
            new.writestr(zipfile.ZipInfo(member), old.read(member), zipfile.ZIP_DEFLATED)


def _write_templates(assignment: Assignment, out: Path) -> None:
    """templates/release at the top of the folder; a leading underscore stands for a dot."""
    given, hidden = given_assignments(assignment), hidden_points(assignment)
    words = {
        "__NAME__": assignment.name,
        "__TITLE__": assignment.title,
        "__SCENE__": str(assignment.public_scenes[0].file.relative_to(ROOT.resolve())),
        "__FILES__": " and ".join(f"`{name}`" for name in assignment.files),
        "__GIVEN__": (
            f"Your code is compiled with that of {' and '.join(g.name for g in given)}, which stands in `assignments/`.\n"
            if given
            else ""
        ),
        "__HIDDEN__": (
            f"{hidden:g} more points are given for scenes that you do not see here: the checks here give up to "
            f"{assignment.points - hidden:g}.\n"
            if hidden
            else ""
        ),
    }
    source = TEMPLATES / "release"
    for file in sorted(f for f in source.rglob("*") if f.is_file()):
        target = out / "/".join(re.sub("^_", ".", part) for part in file.relative_to(source).parts)
        target.parent.mkdir(parents=True, exist_ok=True)
        text = file.read_text()
        for word, meaning in words.items():
            text = text.replace(word, meaning)
        target.write_text(text)


def folder_size(folder: Path) -> int:
    """Bytes of what a release wrote."""
    return sum(file.stat().st_size for file in _files(folder))


def marked_lines(assignment: Assignment) -> list[str]:
    """The lines of the solution that students are to write, but for those that starter or given code show anyway."""
    starter, shown_lines, lines = starter_files(assignment), set(), {}
    for name in assignment.files:
        texts = [starter[name].decode(), *((g.directory / name).read_text() for g in given_assignments(assignment))]
        shown_lines |= {line.strip() for text in texts for line in text.splitlines()}
        for match in regions((assignment.directory / name).read_text(), assignment.directory / name).values():
            lines |= dict.fromkeys(line.strip() for line in match["body"].splitlines())
    return [line for line in lines if len(line) >= SHORT and line not in shown_lines]


def leaks(assignment: Assignment, folder: Path) -> list[tuple[str, str]]:
    """(file, line): where a marked line stands in the folder, in whatever kind of file."""
    lines = marked_lines(assignment)
    out = []
    for file in _files(folder):
        data = file.read_bytes()
        out += [(str(file.relative_to(folder)), line) for line in lines if line.encode() in data]
    return out
