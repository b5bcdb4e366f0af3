"""Imports run downwards: a room of the package uses those before it, and no two modules use each other."""

import ast
import subprocess
import sys
from functools import cache

import pytest

from conftest import ROOT

PACKAGE = ROOT / "grader" / "shadelab"
# From the ground up. The ground is what stands in the package itself, but for its doors: who comes in by them may use all rooms,
# and no room goes out by them.
ROOMS = (
    "ground", "machine", "course", "gl", "evidence", "truth", "judge", "grading", "inspect", "prove", "publish", "measure",
    "study", "report", "cli",
)  # fmt: skip
DOORS = ("__main__", "custom")


@cache
def modules() -> dict[str, ast.Module]:
    """By name, as `report.html.page`. A package is a module like any other: `report.html` is its __init__.py."""
    found = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        if "templates" not in parts and parts != ("__init__",):
            found[".".join(parts).removesuffix(".__init__")] = ast.parse(file.read_text())
    return found


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of the package that this one imports, wherever in the file it does."""
    found = set()
    for node in ast.walk(modules()[module]):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: line {node.lineno}: imports are written out from shadelab on"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name.removeprefix("shadelab.") in modules() else node.module for name in inside}
    found = {name.removeprefix("shadelab.") for name in found if name.startswith("shadelab.")}
    assert found <= set(modules()), f"{module} imports {found - set(modules())}: there is no such module"
    return frozenset(found)


def room(module: str) -> str:
    first = module.split(".")[0]
    return first if (PACKAGE / first).is_dir() else "ground"


def test_imports_run_downwards():
    assert {room(m) for m in modules()} == set(ROOMS)
    assert len(modules()) > 100
    upwards = [
        f"{module} imports {used}"
        for module in modules()
        if module not in DOORS
        for used in imports(module)
        if used in DOORS or ROOMS.index(room(used)) > ROOMS.index(room(module))
    ]
    assert not upwards


def test_no_two_modules_use_each_other():
    done, path = set(), []

    def visit(module: str) -> None:
        if module in path:
            pytest.fail(" -> ".join([*path[path.index(module) :], module]))
        if module in done or module not in modules():
            return
        path.append(module)
        for used in sorted(imports(module)):
            visit(used)
        done.add(path.pop())

    for module in modules():
        visit(module)


def test_only_the_page_and_reports_know_how_a_finding_looks():
    """Who measures and judges gives facts: none of them prints."""
    for module in modules():
        if room(module) in ("evidence", "truth", "judge", "grading", "inspect"):
            assert not any(used == "rich" for used in _outside(module)), module


def test_the_command_line_starts_without_what_a_command_alone_needs():
    """Each of these takes longer to import than all of the command line."""
    code = "import sys; from shadelab.cli.app import program; program(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "jinja2", "PIL", "matplotlib", "moderngl", "mpmath", "pydantic"} & set(done.stdout.split())


def _outside(module: str) -> set[str]:
    found = set()
    for node in ast.walk(modules()[module]):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


def test_a_class_has_a_name_of_its_own():
    """One name means one thing, in the whole package."""
    names = [
        (node.name, module)
        for module, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    twice = {name: [m for n, m in names if n == name] for name, _ in names}
    assert names and {n: where for n, where in twice.items() if len(where) > 1} == {}
