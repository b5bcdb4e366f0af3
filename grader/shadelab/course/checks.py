"""Custom checks, as pytest functions beside a manifest. Here they are read and not run: who only wants ids and points needs
neither pytest nor time."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from shadelab.errors import UserError
from shadelab.paths import shown
from shadelab.sources import syntax_of


class CustomCheck(NamedTuple):
    """A pytest function in checks/test_*.py: `linearity` is test_linearity (shadelab/custom.py). Points are for both
    languages together."""

    name: str
    points: float


def custom_checks(files: list[Path]) -> list[CustomCheck]:
    """By files and functions."""
    out = [check for file in files for check in _checks_of(file)]
    names = [check.name for check in out]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{shown(files[0].parent)}: two functions are called test_{name}; rename one")
    return out


def _checks_of(file: Path) -> Iterator[CustomCheck]:
    try:
        tree = syntax_of(file)
    except (SyntaxError, ValueError) as error:
        raise UserError(f"{shown(file)}:{getattr(error, 'lineno', None) or 1}: {error.args[0]}") from None
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
            continue
        points = 0.0
        for call in (d for d in node.decorator_list if isinstance(d, ast.Call) and isinstance(d.func, ast.Attribute)):
            where = f"{shown(file)}:{call.lineno}: {node.name}"
            if call.func.attr == "parametrize":
                raise UserError(f"{where}: one function is one check; loop inside of it instead of parametrize")
            if call.func.attr == "points":
                value = call.args[0].value if len(call.args) == 1 and isinstance(call.args[0], ast.Constant) else None
                if type(value) not in (int, float) or call.keywords:
                    raise UserError(f"{where}: points takes a number and nothing else, as in @pytest.mark.points(2)")
                points = float(value)
        yield CustomCheck(node.name.removeprefix("test_"), points)
