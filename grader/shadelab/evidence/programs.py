"""C++ programs beside the submission as it is graded: it in double, our solution with a student's numbers. Each is built
when it is first asked."""

import re
import threading
from pathlib import Path

from shadelab.course.assignment import Assignment
from shadelab.errors import UserError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Asking, BuildError, Evaluate, Output, Program, T, Task
from shadelab.gl.submission import read as read_shader
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import shown


def as_cpp(shader: bytes) -> str:
    """A student's GLSL as C++: the dialects differ in their first lines alone, and in what they call a Real."""
    return "#include <shadelab/shading.hpp>\n#line 1\n" + re.sub(r"\bfloat\b", "Real", read_shader(shader).text)


class Programs:
    """`folder`: where they work. `submission`: the student's files; None where only our own code is asked."""

    def __init__(
        self, assignment: Assignment, folder: Path, submission: Path | None = None, stop: threading.Event | None = None
    ) -> None:
        self.assignment, self.folder, self.submission, self.stop = assignment, folder, submission, stop
        self.runners: dict[Program, CppRunner | BuildError] = {}

    def answer(self, task: Task) -> Output:
        """Code of ours that does not compile or gives nothing is our fault: UserError."""
        runner = self._runner(task.program)
        if isinstance(runner, BuildError):
            return Output(failure=runner.message)
        output = runner.evaluate(task) if isinstance(task, Evaluate) else runner.draw(task)
        if task.program.text is not None and output.array is None:
            name = task.function.name if isinstance(task, Evaluate) else task.scene.name
            raise UserError(f"{shown(self.assignment.directory)}: {name} {output.failure}")
        return output

    def answer_all(self, asking: Asking[T]) -> T:
        """To its end, for what asks our own code alone."""
        output = None
        while True:
            try:
                question = asking.send(output)
            except StopIteration as end:
                return end.value
            output = self.answer(question)

    def _runner(self, program: Program) -> CppRunner | BuildError:
        if program not in self.runners:
            sandbox = Sandbox(self.folder / f"program-{len(self.runners)}", stop=self.stop)
            ours, source = program.text is not None, self.submission
            runner = CppRunner(self.assignment, sandbox, program.recipe, complete=not ours)
            runner.environment = dict(program.environment)
            if program.text is not None:
                source = sandbox.folder / "source"
                source.mkdir(exist_ok=True)
                (source / "shading.cpp").write_text(program.text)
            elif program.translated:
                source = sandbox.folder / "source"
                source.mkdir(exist_ok=True)
                (source / "shading.cpp").write_text(as_cpp((self.submission / "shading.glsl").read_bytes()))
            try:
                runner.build(source)
                self.runners[program] = runner
            except BuildError as error:
                if program.text is not None:
                    where = shown(self.assignment.directory)
                    raise UserError(f"{where}: {program.what} does not compile: {error.message}") from None
                self.runners[program] = error
        return self.runners[program]
