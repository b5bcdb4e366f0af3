"""What the steps of making expected data share: folders, progress, and programs of our own code. No student's code takes part."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.course.mistakes import Change, write_submission
from shadelab.errors import UserError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import BuildError, Evaluate, Output, Task
from shadelab.machine.build import Recipe
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import shown

Progress = Callable[[str, int, int], None]

PLAIN = "the solution"


class Workshop:
    def __init__(self, assignment: Assignment, folder: Path, steps: int, progress: Progress) -> None:
        """folder: for what is to stay; what is not stands below `work`."""
        self.assignment, self.folder, self.work = assignment, folder, folder / "work"
        self.progress, self.done, self.steps = progress, 0, steps
        self.lock, self.numbers = threading.Lock(), count(1)
        self.work.mkdir()

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        self.progress(f"reference {self.assignment.name}: {what}", self.done, self.steps)
        yield
        with self.lock:
            self.done += 1

    def sandbox(self) -> Sandbox:
        with self.lock:
            return Sandbox(self.work / str(next(self.numbers)))

    def cpp(self, folder: Path, recipe: Recipe, what: str = PLAIN) -> CppRunner:
        runner = CppRunner(self.assignment, self.sandbox(), recipe)
        try:
            runner.build(folder)
        except BuildError as error:
            raise UserError(f"{shown(self.assignment.directory)}: {what} does not compile: {error.message}") from None
        return runner

    def solution(self, recipe: Recipe) -> CppRunner:
        return self.cpp(self.assignment.directory, recipe)

    def glsl(self, folder: Path) -> GlslRunner:
        runner = GlslRunner(self.assignment, self.sandbox())
        runner.take(folder)
        return runner

    def changed(self, change: Change | None) -> Path:
        """The folder of the solution with this change."""
        if change is None:
            return self.assignment.directory
        with self.lock:  # both languages may want it at once
            write_submission(self.assignment, change, self.work / change.id)
        return self.work / change.id

    def run(self, runner: CppRunner | GlslRunner, tasks: list[Task], what: str = PLAIN) -> Iterator[Output]:
        """Our own code gives numbers, or it is at fault."""
        for task, output in runner.run(tasks):
            name = task.function.name if isinstance(task, Evaluate) else task.scene.name
            if output.array is None:
                raise UserError(f"{shown(self.assignment.directory)}: {what}: {name} {output.failure}")
            yield output

    def outputs(self, runner: CppRunner | GlslRunner, tasks: list[Task], what: str = PLAIN) -> list[Output]:
        return list(self.run(runner, tasks, what))
