"""Thousands of bodies of the solution's functions in a few programs, which are told by their environment which one it is to
be: to compile each alone would take an hour. For our own text only."""

import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import regions
from shadelab.course.mutants import Mutant
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Evaluate, Output
from shadelab.machine.build import Recipe, broken_lines
from shadelab.machine.sandbox import Sandbox

CHOSEN = "SHADELAB_CHOSEN"
MOST = 1000  # bodies of one program: more take the compiler long, and slow machines too long
_choose = f"""\
#include <cstdlib>
static const int shadelab_chosen = std::atoi(std::getenv("{CHOSEN}"));
"""


class ManyBodies:
    """`bodies`: those that compile, by number."""

    def __init__(self, assignment: Assignment, folder: Path, mutants: Mapping[int, Mutant], double: bool) -> None:
        """`folder`: for its files; made here."""
        numbers = list(mutants)
        parts = [numbers[first : first + MOST] for first in range(0, len(numbers), MOST)]
        with ThreadPoolExecutor(2) as pool:
            self.programs = list(
                pool.map(
                    lambda k: _Program(assignment, folder / str(k), {n: mutants[n] for n in parts[k]}, double),
                    range(len(parts)),
                )
            )
        self.bodies = {number: mutant for program in self.programs for number, mutant in program.bodies.items()}

    def runner(self, name: str) -> "Chosen":
        return Chosen(self, name)


class Chosen:
    """Runs any of them, for one thread. `name`: of its folders."""

    def __init__(self, many: ManyBodies, name: str) -> None:
        self.programs, self.name = many.programs, name
        self.runners: dict[int, CppRunner] = {}

    def evaluate(self, number: int, task: Evaluate) -> Output:
        """With the body of that number."""
        which = next(k for k, program in enumerate(self.programs) if number in program.bodies)
        if which not in self.runners:
            self.runners[which] = self.programs[which].runner(self.name)
        self.runners[which].environment = {CHOSEN: str(number)}
        return self.runners[which].evaluate(task)


class _Program:
    """Some of the bodies, compiled."""

    def __init__(self, assignment: Assignment, folder: Path, mutants: Mapping[int, Mutant], double: bool) -> None:
        self.assignment, self.folder, self.recipe = assignment, folder, Recipe(double=double, loops=(), many=True)
        self.bodies = dict(mutants)
        folder.mkdir(parents=True)
        source, sandbox = folder / "shading.cpp", Sandbox(folder / "syntax")
        while True:
            source.write_text(self._text())
            said = broken_lines(assignment.glue, source, sandbox, self.recipe)
            broken = {int(number) for number in re.findall(r"^mutant-(\d+):", said, re.MULTILINE)} & set(self.bodies)
            if not broken:
                break
            self.bodies = {number: mutant for number, mutant in self.bodies.items() if number not in broken}
        self.runner("compiled")  # here, before two threads want it

    def runner(self, name: str) -> CppRunner:
        runner = CppRunner(self.assignment, Sandbox(self.folder / name), self.recipe)
        runner.build(self.folder)
        return runner

    def _text(self) -> str:
        bodies = {
            number: {mutant.function: f'#line 1 "mutant-{number}"\n{mutant.body}'}
            for number, mutant in self.bodies.items()
        }
        source = self.assignment.directory / "shading.cpp"
        return with_choices(source.read_text(), source, bodies)


def with_choices(text: str, file: Path, bodies: Mapping[int, Mapping[str, str]]) -> str:
    """A solution's text that is told by its environment (CHOSEN) which other bodies it has: of each number, by function. Its own
    stand for any other number."""
    marked = regions(text, file)
    for name in sorted(marked, key=lambda n: -marked[n].start()):
        cases = "".join(f"case {k}: {{\n{own[name]}\n}} break;\n" for k, own in bodies.items() if name in own)
        start = marked[name].start()
        text = f"{text[:start]}switch (shadelab_chosen) {{\n{cases}}}\n{text[start:]}" if cases else text
    return _choose + text
