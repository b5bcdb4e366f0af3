"""The functions of an assignment's exact.py over a table: the truth to 50 digits."""

import importlib.util
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from mpmath import mpf

from shadelab.course.assignment import Assignment, Function, Value
from shadelab.errors import UserError
from shadelab.exact import normalize, vector
from shadelab.paths import shown


def load(file: Path) -> ModuleType:
    """An assignment's exact.py: one function for each that it declares; structs are dicts of their members. Raises UserError
    where it cannot be run."""
    spec = importlib.util.spec_from_file_location(f"exact_{file.parent.name}", file)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise _fault(file, "cannot be loaded", error) from None
    return module


def _fault(file: Path, what: str, error: Exception) -> UserError:
    """With the line of the file at which it happened, where it did in one."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
    said = error.msg if isinstance(error, SyntaxError) else f"{type(error).__name__}: {error}".splitlines()[0]
    return UserError(f"{shown(file)}{f':{line}' if line else ''}: {what}: {said}")


def evaluate(assignment: Assignment, function: Function, rows: np.ndarray) -> np.ndarray:
    """(N, results) float64: the truth, rounded once. Directions are unit to 50 digits. Where a formula divides by zero: NaN.
    Raises UserError for what exact.py lacks."""
    file = assignment.directory / "exact.py"
    module = load(file)
    if not callable(twin := getattr(module, function.name, None)):
        arguments = ", ".join(value.name for value in function.values)
        raise UserError(
            f"{shown(file)}: has no function {function.name}; every function of {assignment.name} needs its twin there, "
            f"in 50 digits: def {function.name}({arguments})"
        )
    out = np.full((len(rows), len(function.outputs)), np.nan)
    for k, row in enumerate(rows):
        try:
            numbers = [float(x) for x in _flat(twin(*_nested(assignment, function.values, list(row))))]
        except ZeroDivisionError:
            continue
        except Exception as error:
            raise _fault(file, f"{function.name} fails", error) from None
        if len(numbers) != out.shape[1]:
            wanted = ", ".join(str(column) for column in function.outputs)
            raise UserError(f"{shown(file)}: {function.name} gives {len(numbers)} numbers; it must give {wanted}")
        out[k] = numbers
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
