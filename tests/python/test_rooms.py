"""Imports run downwards: a room of the package uses those before it, and no two modules use each other."""

import ast
from functools import cache

import pytest

from conftest import ROOT

PACKAGE = ROOT / "grader" / "shadelab"
# From the ground up. The ground is what stands in the package itself; who writes a check may use its doors.
ROOMS = (
    "ground", "machine", "course", "gl", "evidence", "truth", "judge", "grading", "inspect", "prove", "publish", "measure",
    "study", "report", "cli",
)  # fmt: skip
DOORS = ("__main__", "custom", "exact")


@cache
def modules() -> dict[str, ast.Module]:
    found = {}
    for file in PACKAGE.rglob("*.py"):
        if "templates" not in file.parts:
            found[".".join(file.relative_to(PACKAGE).with_suffix("").parts)] = ast.parse(file.read_text())
    return found


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of the package that this one imports, wherever in the file it does."""
    found = set()
    for node in ast.walk(modules()[module]):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name.removeprefix("shadelab.") in modules() else node.module for name in inside]
        found |= {name.removeprefix("shadelab.") for name in names if name.startswith("shadelab.")}
    return frozenset(found)


def room(module: str) -> str:
    return module.split(".")[0] if "." in module else "ground"


def test_imports_run_downwards():
    assert {room(m) for m in modules()} == set(ROOMS)
    assert len(modules()) > 100
    upwards = [
        f"{module} imports {used}"
        for module in modules()
        if module not in DOORS
        for used in imports(module)
        if ROOMS.index(room(used)) > ROOMS.index(room(module))
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


def _outside(module: str) -> set[str]:
    found = set()
    for node in ast.walk(modules()[module]):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found
