"""The import closure of modules: the sources that a result rests on, found by reading them. A list would lose a module that
moves."""

import ast
import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from shadelab.errors import InfrastructureError
from shadelab.files import write_whole
from shadelab.paths import PACKAGE, STATE
from shadelab.sources import syntax_of

# To read a hundred files as syntax takes a quarter of a second, of every command: what each names is remembered by its text.
REMEMBERED = STATE / "cache" / "imports.json"
MOST = 2000  # files


def import_closure(*roots: str, package: Path = PACKAGE) -> list[Path]:
    """The files of these modules and of all modules of the package that they import or start as a program, directly or
    through others.

    `roots`: dotted names, "shadelab.machine.build". A program that a module starts is named in a string there ("-m",
    "shadelab.gl.client"). Raises InfrastructureError for a name that has no file."""
    found: dict[str, Path] = {}
    before, pending = len(_remembered()), list(roots)
    while pending:
        name = pending.pop()
        if name in found:
            continue
        file = _file(name, package)
        if file is None:
            raise InfrastructureError(f"{name}: there is no such module, but expected data rests on it")
        found[name] = file
        if "." in name:  # importing a module runs the packages that it stands in
            pending.append(name.rpartition(".")[0])
        pending += _named(file, package)
    if len(known := _remembered()) > before:
        with suppress(OSError):  # a checkout that cannot be written to reads them again
            REMEMBERED.parent.mkdir(parents=True, exist_ok=True)
            write_whole(REMEMBERED, json.dumps(dict(list(known.items())[-MOST:])))
    return sorted(found.values())


def _file(name: str, package: Path) -> Path | None:
    path = package.joinpath(*name.split(".")[1:])
    candidates = (path.with_suffix(".py"), path / "__init__.py") if path != package else (path / "__init__.py",)
    return next((file for file in candidates if file.is_file()), None)


@cache
def _remembered() -> dict[str, list[str]]:
    """What files name, by a digest of their text."""
    try:
        return dict(json.loads(REMEMBERED.read_text()))
    except (OSError, ValueError):
        return {}


def _named(file: Path, package: Path) -> Iterator[str]:
    """The modules of the package that a file names, also inside of functions and for type checkers alone."""
    key = hashlib.sha256(package.name.encode() + b"\0" + file.read_bytes()).hexdigest()
    known = _remembered()
    if key not in known:
        known[key] = list(dict.fromkeys(_read(file, package.name)))
    # What is imported from a package may be a module of it, or a name in one.
    return (name.lstrip("?") for name in known[key] if not name.startswith("?") or _file(name[1:], package))


def _read(file: Path, package: str) -> Iterator[str]:
    """The same; with a question mark in front what may be a name in a module."""
    module = re.compile(rf"{package}(\.[a-z_]\w*)*")
    for node in ast.walk(syntax_of(file)):
        if isinstance(node, ast.ImportFrom) and node.level:
            raise InfrastructureError(f"{file}:{node.lineno}: imports relatively; the closure follows full names alone")
        if isinstance(node, ast.ImportFrom) and module.fullmatch(node.module):
            yield node.module
            yield from (f"?{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if module.fullmatch(alias.name))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            if module.fullmatch(node.value):
                yield node.value
