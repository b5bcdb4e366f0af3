"""Follow-through: a function is also right when it does the right thing with what the student's own functions gave it.

The reference is evaluated with the outputs of the student's functions in the place of its own: a wrong half_vector then costs
half_vector, and not the lobe that calls it. Only numbers cross: the arguments of the reference's calls go to the student's
code, its outputs come back.
"""

import re
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene
from shadelab.course.mistakes import Change
from shadelab.evidence.tasks import Asking, Draw, Evaluate, Output, Program, Record, Task
from shadelab.machine.build import Recipe
from shadelab.truth.many import CHOSEN, with_choices

FOLLOWED = Recipe(double=True, loops=(), follow=True)
# A call's arguments may depend on what an earlier call gave, so the calls are found in waves.
WAVES = 8


class FollowedSolution:
    """A solution whose calls can be answered from records. What it asks without a program of its own is for the student's
    code. With `loops` it draws, in float; else its functions are evaluated in double."""

    def __init__(self, assignment: Assignment, changes: Sequence[Change] = (), loops: Sequence[str] = ()) -> None:
        """changes: what as_if() may choose; they are compiled together."""
        self.assignment, self.changes = assignment, list(changes)
        recipe = Recipe(loops=tuple(loops), follow=True, quick=True) if loops else FOLLOWED
        bodies = {number: change.bodies_for("cpp") for number, change in enumerate(self.changes, 1)}
        text = with_choices(assignment.solution, assignment.directory / "shading.cpp", bodies)
        names = [f.name for f in assignment.functions]
        self.program = Program(recipe, followed_text(text, names), "the solution", environment=((CHOSEN, "0"),))

    def as_if(self, change: Change) -> "FollowedSolution":
        """The solution with one of its changes."""
        other = copy(self)
        chosen = str(1 + self.changes.index(change))
        other.program = replace(self.program, what=change.id, environment=((CHOSEN, chosen),))
        return other

    def calls(self, function: Function, rows: np.ndarray) -> Asking[dict[str, np.ndarray]]:
        """With what arguments the function calls the others on these rows (float64): by name, (N, columns) float32, each once."""
        others = [f for f in self.assignment.functions if f.name != function.name]
        output = yield Evaluate(function, rows, program=self.program, records=_empty(others))
        return {name: rows for name, rows in output.missing.items() if len(rows)}

    def with_recorded(self, function: Function, rows: np.ndarray, callees: list[Function]) -> Asking[np.ndarray | None]:
        """What the function gives on these rows (float64) when the student's callees stand in for ours; None when these
        give nothing."""
        results = yield from self._answered([Evaluate(function, rows, program=self.program)], callees)
        return results[0] if results else None

    def drawn(
        self, scenes: list[Scene], sizes: list[str], shifts: list[tuple[float, float]], functions: list[Function]
    ) -> Asking[dict[str, np.ndarray] | None]:
        """The scenes' totals, (H, W, 3) by name, when the student's functions stand in for ours; None when these give nothing."""
        draws = [
            Draw(scene, layers="total", shift=shift, size=size, program=self.program)
            for scene, size, shift in zip(scenes, sizes, shifts)
        ]
        images = yield from self._answered(draws, functions)
        return dict(zip([scene.name for scene in scenes], images)) if images else None

    def _answered(self, questions: Sequence[Task], callees: list[Function]) -> Asking[list[np.ndarray] | None]:
        """The student's functions are asked once for all of them, and each is told what it asked for itself."""
        records = [_empty(callees) for _ in questions]
        answers: dict[int, Output] = {}
        for _ in range(WAVES):
            for number, question in enumerate(questions):
                if number not in answers or any(len(rows) for rows in answers[number].missing.values()):
                    answers[number] = yield replace(question, records=records[number])
            asking = [n for n in answers if any(len(rows) for rows in answers[n].missing.values())]
            if not asking:
                return [answers[number].array for number in range(len(questions))]
            for function in callees:
                # Each is there once for each of the questions; to find those of several takes longer than to ask again.
                parts = [answers[number].missing[function.name] for number in asking]
                arguments = np.vstack(parts)
                if not len(arguments):
                    continue
                came = yield Evaluate(function, arguments)
                if came.array is None:
                    return None
                outputs = np.split(came.array, np.cumsum([len(part) for part in parts])[:-1])
                for number, *new in zip(asking, parts, outputs):
                    old = records[number][function.name]
                    records[number][function.name] = (np.vstack([old[0], new[0]]), np.vstack([old[1], new[1]]))
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
