"""Follow-through: a function is also right when it does the right thing with what the student's own functions gave it.

The reference is evaluated with the outputs of the student's functions in the place of its own: a wrong half_vector then costs
half_vector, and not the lobe that calls it. Only numbers cross: the arguments of the reference's calls go to the student's
code, its outputs come back.
"""

import re
from collections.abc import Callable

import numpy as np

from shadelab.course.assignment import Assignment, Function
from shadelab.errors import UserError
from shadelab.evidence.runners import CppRunner, Evaluate
from shadelab.machine.build import BuildError, Recipe
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import shown

FOLLOWED = Recipe(double=True, loops=(), follow=True)
# A call's arguments may depend on what an earlier call gave, so the calls are found in waves.
WAVES = 8

Record = tuple[np.ndarray, np.ndarray]  # arguments (N, columns in) and outputs (N, columns out)


def followed_text(text: str, names: list[str]) -> str:
    """The functions as they are, calling each other's wrappers (follow.hpp, which the glue includes)."""
    call = re.compile(rf"\b({'|'.join(names)})\(")
    lines = text.splitlines(keepends=True)
    return "".join(
        line if re.match(r"\w+ \w+\(.*\{$", line.rstrip()) else call.sub(r"\1_followed(", line) for line in lines
    )


class Reference:
    """A solution (or a mistake: the solution with another body) in double, whose calls can be answered from records."""

    def __init__(self, assignment: Assignment, text: str, sandbox: Sandbox, what: str = "the solution") -> None:
        self.assignment, self.sandbox = assignment, sandbox
        self.runner = CppRunner(assignment, sandbox, FOLLOWED)
        source = sandbox.folder / "followed"
        source.mkdir(exist_ok=True)
        names = [f.name for f in assignment.functions]
        (source / "shading.cpp").write_text(followed_text(text, names))
        try:
            self.runner.build(source)
        except BuildError as error:
            raise UserError(f"{shown(assignment.directory)}: {what} does not compile: {error.message}") from None

    def evaluate(self, function: Function, rows: np.ndarray, records: dict[str, Record]) -> tuple[np.ndarray, dict]:
        """rows: float64. `records` by the names of the functions to follow. Returns the results and, of each of these functions,
        the arguments (float32) that no record answers."""
        folder = self.sandbox.folder / "records"
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        for name, (arguments, outputs) in records.items():
            np.hstack([arguments, outputs]).astype(np.float64).tofile(folder / f"{name}.known")
        output = self.runner.evaluate(Evaluate(function, rows), folder)
        if output.array is None:
            raise UserError(f"{shown(self.assignment.directory)}: {function.name} {output.failure}")
        missing = {}
        for name in records:
            columns = len(self.assignment.input_columns(self.assignment.function(name)))
            missing[name] = np.fromfile(folder / f"{name}.missing", np.float32).reshape(-1, columns)
        return output.array, missing

    def calls(self, function: Function, rows: np.ndarray) -> dict[str, np.ndarray]:
        """With what arguments the function calls the others on these rows: by name, (N, columns) float32, each once."""
        others = [f for f in self.assignment.functions if f.name != function.name]
        return {name: rows for name, rows in self.evaluate(function, rows, self.empty(others))[1].items() if len(rows)}

    def empty(self, functions: list[Function]) -> dict[str, Record]:
        columns = self.assignment.input_columns, self.assignment.output_columns
        return {f.name: tuple(np.empty((0, len(of(f)))) for of in columns) for f in functions}

    def with_recorded(
        self,
        function: Function,
        rows: np.ndarray,
        callees: list[Function],
        outputs: Callable[[Function, np.ndarray], np.ndarray | None],
    ) -> np.ndarray | None:
        """What the function gives when `outputs(callee, arguments)` stand in for its callees; None when these have none."""
        records = self.empty(callees)
        for _ in range(WAVES):
            results, missing = self.evaluate(function, rows, records)
            asked = {name: arguments for name, arguments in missing.items() if len(arguments)}
            if not asked:
                return results
            for name, arguments in asked.items():
                came = outputs(self.assignment.function(name), arguments)
                if came is None:
                    return None
                old = records[name]
                records[name] = (np.vstack([old[0], arguments]), np.vstack([old[1], came]))
        return None
