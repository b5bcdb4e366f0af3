"""Whether a function computes the same in both languages."""

from dataclasses import replace

import numpy as np

from shadelab.course.assignment import Function, named_arrays
from shadelab.judge.words import finite_or_none, halfway, numbers, percent_of, result_of
from shadelab.result import Check, Error, Worst
from shadelab.truth.expected import Table
from shadelab.truth.measures import FACTOR, function_limit, function_members, scaled_error


def judge_parity(
    function: Function,
    table: Table,
    floor: float,
    cpp: np.ndarray,
    glsl: np.ndarray,
    right: list[str],
) -> Check:
    """Whether the student's two languages compute the same. floor: of both together. `right`: the languages that pass."""
    columns, members = function.outputs, function_members(function)
    limit = function_limit(floor, "glsl")
    error = scaled_error(
        glsl, replace(table, truth=cpp.astype(np.float64), conditioning=2 * table.conditioning), members
    )
    wrong = error.max(axis=1) > limit
    check = Check(
        id=f"glsl/parity/{function.name}", kind="parity", backend="glsl", status="failed" if wrong.any() else "passed",
        score=0.0, max_score=0.0, needs=["cpp/build", "glsl/build"],
        error=Error(name="scaled", value=finite_or_none(error.max()), limit=limit, floor=limit / FACTOR),
    )  # fmt: skip
    if wrong.any():
        row = int(np.argmax(error.max(axis=1)))
        inputs = named_arrays(function.inputs, table.rows[row : row + 1])
        check.message = f"C++ and GLSL disagree for {percent_of(wrong.mean())} of the inputs; " + (
            "C++ is right"
            if right == ["cpp"]
            else "GLSL is right"
            if right == ["glsl"]
            else "each is within its own limit"
        )
        check.worst = Worst(
            inputs={name: numbers(value[0]) for name, value in inputs.items()} | halfway(inputs),
            expected=result_of(columns, cpp[row]),
            actual=result_of(columns, glsl[row]),
        )
    return check
