"""The import closure of modules: the sources that a result rests on, found by reading them. A list would lose a module that
moves."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from shadelab.errors import InfrastructureError
from shadelab.paths import PACKAGE
from shadelab.sources import syntax_of


def import_closure(*roots: str, package: Path = PACKAGE) -> list[Path]:
    """The files of these modules and of all modules of the package that they import or start as a program, directly or
    through others.

    `roots`: dotted names, "shadelab.machine.build". A program that a module starts is named in a string there ("-m",
    "shadelab.gl.client"). Raises InfrastructureError for a name that has no file."""
    found: dict[str, Path] = {}
    pending = list(roots)
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
    return sorted(found.values())


def _file(name: str, package: Path) -> Path | None:
    path = package.joinpath(*name.split(".")[1:])
    candidates = (path.with_suffix(".py"), path / "__init__.py") if path != package else (path / "__init__.py",)
    return next((file for file in candidates if file.is_file()), None)


def _named(file: Path, package: Path) -> Iterator[str]:
    """The modules of the package that a file names, also inside of functions and for type checkers alone."""
    module = re.compile(rf"{package.name}(\.[a-z_]\w*)*")
    for node in ast.walk(syntax_of(file)):
        if isinstance(node, ast.ImportFrom) and node.level:
            raise InfrastructureError(f"{file}:{node.lineno}: imports relatively; the closure follows full names alone")
        if isinstance(node, ast.ImportFrom) and module.fullmatch(node.module):
            yield node.module
            # What is imported from a package may be a module of it.
            parts = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name for name in parts if _file(name, package))
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if module.fullmatch(alias.name))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            if module.fullmatch(node.value):
                yield node.value
