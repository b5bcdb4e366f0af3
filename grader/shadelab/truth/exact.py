"""The functions of an assignment's exact.py over a table: the truth to 50 digits."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from mpmath import mpf

from shadelab.course.assignment import Assignment, Function, Value
from shadelab.exact import normalize, vector


def load(file: Path) -> ModuleType:
    """An assignment's exact.py: one function for each that it declares; structs are dicts of their members."""
    spec = importlib.util.spec_from_file_location(f"exact_{file.parent.name}", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def evaluate(assignment: Assignment, function: Function, rows: np.ndarray) -> np.ndarray:
    """(N, results) float64: the truth, rounded once. Directions are unit to 50 digits. Where a formula divides by zero: NaN."""
    module = load(assignment.directory / "exact.py")
    out = np.full((len(rows), len(function.outputs)), np.nan)
    for k, row in enumerate(rows):
        try:
            out[k] = [
                float(x)
                for x in _flat(getattr(module, function.name)(*_nested(assignment, function.values, list(row))))
            ]
        except ZeroDivisionError:
            pass
    return out


def _nested(assignment: Assignment, values: list[Value], row: list[float]) -> list[Any]:
    """A row's numbers as the arguments of an exact function; takes them off `row`."""
    out = []
    for value in values:
        if value.domain.kind == "struct":
            members = assignment.structs[value.domain.type].values
            out.append(dict(zip([m.name for m in members], _nested(assignment, members, row))))
            continue
        numbers = vector(*(float(row.pop(0)) for _ in range(value.domain.width)))
        if value.domain.kind in ("unit", "upper"):
            numbers = normalize(numbers)
        out.append(numbers if len(numbers) > 1 else numbers[0])
    return out


def _flat(value: Any) -> list[mpf]:
    if isinstance(value, dict):
        return [number for member in value.values() for number in _flat(member)]
    return list(value) if isinstance(value, tuple) else [value]
