"""The glue folder of an assignment: what the renderer understood of its manifest (assignment.json), and the code that it
generated."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from shadelab.errors import UserError
from shadelab.machine import renderer
from shadelab.machine.sandbox import work_folder
from shadelab.paths import FRAMEWORK, RENDER, STATE, shown

MANIFEST = "assignment.toml"
UNDERSTOOD = "assignment.json"
GLUE_KEPT, PRECOMPILED_KEPT = 96, 8  # the last are 30 MB each
GENERATOR = ("interface.toml", "include", "glsl", "glue")  # of the framework: what the glue is made from


def glue_folder(directory: Path) -> Path:
    """Made anew when a manifest, given code, the framework's headers or the renderer changed. Raises UserError for a
    manifest that is wrong."""
    manifest = directory / MANIFEST
    if not manifest.is_file():
        raise UserError(f"{shown(manifest)}: cannot be read; does the file exist?")
    own = _digest(str(directory), [RENDER, *_generator(), manifest])
    # Which assignments are given stands in the manifest, which only the renderer reads: it is remembered for this text of it.
    record = STATE / "glue" / f"{directory.name}-{own}.given.json"
    given = json.loads(record.read_text()) if record.exists() else None
    folder = _folder(directory, own, given) if given is not None else None
    if folder is None or not folder.exists():
        record.parent.mkdir(parents=True, exist_ok=True)
        with work_folder("glue") as work:
            renderer.glue(directory, work / "glue")
            given = json.loads((work / "glue" / UNDERSTOOD).read_text())["given"]
            folder = _folder(directory, own, given)
            try:
                (work / "glue").rename(folder)
            except OSError:
                pass  # another run was faster
            (work / "given.json").write_text(json.dumps(given))
            os.replace(work / "given.json", record)
        _throw_away_old(folder.parent)
    os.utime(folder)  # its age counts from the last use
    return folder


def _folder(directory: Path, own: str, given: list[str]) -> Path:
    """The code of given assignments is part of the glue, the assignment's own is not."""
    folders = [directory.parent / name for name in given]
    sources = [f for folder in folders for f in sorted([folder / MANIFEST, *folder.glob("shading.*")])]
    return STATE / "glue" / f"{directory.name}-{_digest(own, sources)}"


def given_code(glue: Path) -> list[Path]:
    """The folders whose code the glue includes."""
    understood = json.loads((glue / UNDERSTOOD).read_text())
    return [Path(understood["directory"]).parent / name for name in understood["given"]]


def _generator() -> Iterator[Path]:
    for name in GENERATOR:
        path = FRAMEWORK / name
        yield from sorted(f for f in path.rglob("*") if f.is_file()) if path.is_dir() else [path]


def _digest(seed: str, sources: Iterable[Path]) -> str:
    digest = hashlib.sha256(seed.encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _throw_away_old(parent: Path) -> None:
    oldest_first = [path for path in by_age(parent) if path.is_dir()]
    for old in oldest_first[:-GLUE_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    for old in oldest_first[:-PRECOMPILED_KEPT]:
        shutil.rmtree(old / "prelude.hpp.gch", ignore_errors=True)
    for record in sorted(parent.glob("*.given.json"), key=lambda f: f.stat().st_mtime)[: -10 * GLUE_KEPT]:
        record.unlink(missing_ok=True)


def by_age(folder: Path) -> list[Path]:
    """Oldest first. Another run may remove some meanwhile."""

    def age(path: Path) -> float:
        try:
            return path.stat().st_mtime
        except OSError:
            return 0.0

    return sorted(folder.iterdir(), key=age)
