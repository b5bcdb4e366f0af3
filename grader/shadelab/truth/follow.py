"""Follow-through: a function is also right when it does the right thing with what the student's own functions gave it.

The reference is evaluated with the outputs of the student's functions in the place of its own: a wrong half_vector then costs
half_vector, and not the lobe that calls it. Only numbers cross: the arguments of the reference's calls go to the student's
code, its outputs come back.
"""

import re

import numpy as np

from shadelab.course.assignment import Assignment, Function
from shadelab.evidence.tasks import Asking, Evaluate, Program, Record
from shadelab.machine.build import Recipe

FOLLOWED = Recipe(double=True, loops=(), follow=True)
# A call's arguments may depend on what an earlier call gave, so the calls are found in waves.
WAVES = 8


class FollowedSolution:
    """A solution (or a mistake: the solution with another body) in double, whose calls can be answered from records. What
    it asks without a program of its own is for the student's code."""

    def __init__(self, assignment: Assignment, text: str, what: str = "the solution") -> None:
        self.assignment = assignment
        names = [f.name for f in assignment.functions]
        self.program = Program(FOLLOWED, followed_text(text, names), what)

    def calls(self, function: Function, rows: np.ndarray) -> Asking[dict[str, np.ndarray]]:
        """With what arguments the function calls the others on these rows (float64): by name, (N, columns) float32, each once."""
        others = [f for f in self.assignment.functions if f.name != function.name]
        output = yield Evaluate(function, rows, program=self.program, records=_empty(others))
        return {name: rows for name, rows in output.missing.items() if len(rows)}

    def with_recorded(self, function: Function, rows: np.ndarray, callees: list[Function]) -> Asking[np.ndarray | None]:
        """What the function gives on these rows (float64) when the student's callees stand in for ours; None when these
        give nothing."""
        records = _empty(callees)
        for _ in range(WAVES):
            output = yield Evaluate(function, rows, program=self.program, records=records)
            asked = {name: arguments for name, arguments in output.missing.items() if len(arguments)}
            if not asked:
                return output.array
            for name, arguments in asked.items():
                came = yield Evaluate(self.assignment.function(name), arguments)
                if came.array is None:
                    return None
                old = records[name]
                records[name] = (np.vstack([old[0], arguments]), np.vstack([old[1], came.array]))
        return None


def _empty(functions: list[Function]) -> dict[str, Record]:
    return {f.name: (np.empty((0, len(f.inputs))), np.empty((0, len(f.outputs)))) for f in functions}


def followed_text(text: str, names: list[str]) -> str:
    """The functions as they are, calling each other's wrappers (follow.hpp, which the glue includes)."""
    call = re.compile(rf"\b({'|'.join(names)})\(")
    lines = text.splitlines(keepends=True)
    return "".join(
        line if re.match(r"\w+ \w+\(.*\{$", line.rstrip()) else call.sub(r"\1_followed(", line) for line in lines
    )
