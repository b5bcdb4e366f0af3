"""Numbers as messages and result.json have them."""

from typing import Any

import numpy as np

from shadelab.course.assignment import Column, named_arrays


def numbers(values: np.ndarray) -> list[float | str]:
    """JSON has no NaN and no infinity: they travel as words."""
    return [float(v) if np.isfinite(v) else str(float(v)) for v in np.atleast_1d(values)]


def result_of(columns: list[Column], row: np.ndarray) -> list[Any]:
    """The numbers of a result, or one dict of a struct's members."""
    named = named_arrays(columns, row[None])
    if list(named) == ["result"]:
        return numbers(named["result"][0])
    return [{path.removeprefix("result."): numbers(value[0]) for path, value in named.items()}]


def halfway(inputs: dict[str, np.ndarray]) -> dict[str, Any]:
    """h, where the inputs have an l and a v: most formulas are about it."""
    if "l" not in inputs or "v" not in inputs or "h" in inputs:
        return {}
    h = (inputs["l"][0].astype(np.float64) + inputs["v"][0]).astype(np.float64)
    length = np.linalg.norm(h)
    return {"h": numbers(h / length)} if length > 0 else {}


def finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def percent_of(share: float) -> str:
    if share > 0.995:
        return "all" if share == 1 else "nearly all"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"
