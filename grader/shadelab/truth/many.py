"""Thousands of bodies of the solution's functions in a few programs, which are told which of them to be: to compile each alone
would take an hour. For our own text only."""

import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import regions
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import Recipe, broken_lines
from shadelab.machine.sandbox import Sandbox

Bodies = Mapping[int, Mapping[str, str]]  # by number and function

CHOSEN = "SHADELAB_CHOSEN"  # the number of the body to begin with; 0 where it is not set
MOST = 500  # bodies of one program: more take the compiler long, and slow machines too long
ROWS_AT_ONCE = 200_000
_choose = f"""\
#include <cstdlib>
extern "C" __attribute__((visibility("default"))) int shadelab_chosen = std::atoi(std::getenv("{CHOSEN}") ?: "0");
"""


class ManyBodies:
    """`numbers`: of those that compile."""

    def __init__(self, assignment: Assignment, folder: Path, bodies: Bodies, double: bool) -> None:
        """`folder`: for its files; made here."""
        numbers = list(bodies)
        parts = [numbers[first : first + MOST] for first in range(0, len(numbers), MOST)]
        with ThreadPoolExecutor(2) as pool:
            self.programs = list(
                pool.map(
                    lambda k: _Program(assignment, folder / str(k), {n: bodies[n] for n in parts[k]}, double),
                    range(len(parts)),
                )
            )
        self.numbers = [number for program in self.programs for number in program.bodies]

    def evaluate(self, numbers: Sequence[int], task: Evaluate, name: str) -> Iterator[tuple[int, np.ndarray]]:
        """What those of them give that end well, (N, columns) each. `name`: of who asks, one thread at a time."""
        together = max(1, ROWS_AT_ONCE // max(1, len(task.rows)))
        for program in self.programs:
            asked = [number for number in numbers if number in program.bodies]
            runner = program.runner(name) if asked else None
            for first in range(0, len(asked), together):
                yield from _evaluated(runner, asked[first : first + together], task)


def _evaluated(runner: CppRunner, numbers: list[int], task: Evaluate) -> Iterator[tuple[int, np.ndarray]]:
    """Many to a run: a process takes longer to start than to evaluate some thousand rows."""
    array = runner.evaluate(replace(task, bodies=tuple(numbers))).array
    if array is not None:
        yield from zip(numbers, array.reshape(len(numbers), len(task.rows), -1))
    elif len(numbers) > 1:  # one of them ends the program, or never ends
        for number in numbers:
            yield from _evaluated(runner, [number], task)


class _Program:
    """Some of the bodies, compiled."""

    def __init__(self, assignment: Assignment, folder: Path, bodies: Bodies, double: bool) -> None:
        self.assignment, self.folder, self.recipe = assignment, folder, Recipe(double=double, loops=(), many=True)
        self.bodies = dict(bodies)
        folder.mkdir(parents=True)
        source, sandbox = folder / "shading.cpp", Sandbox(folder / "syntax")
        while True:
            source.write_text(self._text())
            said = broken_lines(assignment.glue, source, sandbox, self.recipe)
            broken = {int(number) for number in re.findall(r"^mutant-(\d+):", said, re.MULTILINE)} & set(self.bodies)
            if not broken:
                break
            self.bodies = {number: own for number, own in self.bodies.items() if number not in broken}
        self.runner("compiled")  # here, before two threads want it

    def runner(self, name: str) -> CppRunner:
        runner = CppRunner(self.assignment, Sandbox(self.folder / name), self.recipe)
        runner.build(self.folder)
        return runner

    def _text(self) -> str:
        bodies = {
            number: {function: f'#line 1 "mutant-{number}"\n{body}' for function, body in own.items()}
            for number, own in self.bodies.items()
        }
        source = self.assignment.directory / "shading.cpp"
        return with_choices(source.read_text(), source, bodies)


def with_choices(text: str, file: Path, bodies: Bodies) -> str:
    """A solution's text that is told which other bodies it has, by its environment (CHOSEN) or its user (plugin.hpp): of each
    number, by function. Its own stand for any other number."""
    marked = regions(text, file)
    for name in sorted(marked, key=lambda n: -marked[n].start()):
        cases = "".join(f"case {k}: {{\n{own[name]}\n}} break;\n" for k, own in bodies.items() if name in own)
        start = marked[name].start()
        text = f"{text[:start]}switch (shadelab_chosen) {{\n{cases}}}\n{text[start:]}" if cases else text
    return _choose + text
