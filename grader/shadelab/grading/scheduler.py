"""Runs what checks ask. Nobody else runs student code: judges yield questions and are sent what came.

The questions with which the checks of a stage begin are run together, in their order: OpenGL's share a process. What a
check asks next is run at once. Verdicts are handed on as they come.
"""

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby

from shadelab.errors import InfrastructureError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.programs import Programs
from shadelab.evidence.tasks import BuildError, Draw, Evaluate, Output, Task
from shadelab.grading.kinds import kind_of
from shadelab.grading.ledger import Ledger
from shadelab.grading.plan import Plan
from shadelab.grading.questions import Build, Built
from shadelab.machine.build import FUNCTIONS, Recipe
from shadelab.machine.sandbox import Sandbox
from shadelab.result import Check

Record = Callable[[Check, str | None], None]  # and the OpenGL driver, once it is known


class Student:
    """The submission in one language, compiled as the grading needs it."""

    def __init__(self, ledger: Ledger) -> None:
        assignment, folder, stop = ledger.assignment, ledger.folder, ledger.stop
        self.backend, self.submission = ledger.backend, ledger.submission
        sandbox = Sandbox(folder / "sandbox", stop=stop)
        self.programs = Programs(assignment, folder / "programs", ledger.submission, stop)
        if self.backend == "glsl":
            self.runner = self.drawer = GlslRunner(assignment, sandbox)
        else:
            loops = tuple(ledger.expected.facts.loops)
            self.runner = CppRunner(assignment, sandbox, FUNCTIONS, complete=True)
            self.drawer = CppRunner(assignment, sandbox, Recipe(functions=False, loops=loops), complete=True)

    def build(self, then: list[Task], draws: bool) -> Built:
        """Raises BuildError. In C++ two plugins at once: the functions alone, which is quick, and the loops that the scenes
        need. `then`: what will be asked first."""
        if self.backend == "glsl":
            self.runner.build(self.submission, then)
            return Built(warnings=self.runner.warnings)
        with ThreadPoolExecutor(2) as pool:
            wanted = [self.runner, self.drawer] if draws else [self.runner]
            for build in [pool.submit(runner.build, self.submission) for runner in wanted]:
                build.result()
        return Built(warnings=self.runner.warnings)

    def answers(self, tasks: list[Task]) -> Iterator[Output]:
        if self.backend == "glsl":  # one program for both; and the client knows this very list again
            return (output for _, output in self.runner.run(tasks))
        alike = [(draws, list(group)) for draws, group in groupby(tasks, lambda task: isinstance(task, Draw))]
        return (output for draws, group in alike for _, output in (self.drawer if draws else self.runner).run(group))

    def answer(self, task: Task) -> Output:
        if task.program is not None and (self.backend == "cpp" or isinstance(task, Evaluate) or task.program.text):
            return self.programs.answer(task)
        [output] = self.answers([task])
        return output


class Chain:
    """The checks of one language, in the order of the data flow."""

    def __init__(self, ledger: Ledger, refused: str | None, record: Record) -> None:
        """refused: why the file of this language could not be taken."""
        self.plans, self.ledger, self.refused, self._record = ledger.plans, ledger, refused, record
        self.student = Student(ledger)

    def run(self) -> None:
        """Whatever goes wrong in one language, what was earned stays, and the other language is graded."""
        try:
            self._run()
        except Exception as error:  # a fault of the grader: told, and never a silent zero
            self._fail(InfrastructureError(f"the grader failed: {type(error).__name__}: {error}"), self.plans)
        finally:
            if self.ledger.session is not None:
                self.ledger.session.close()

    def _run(self) -> None:
        build, *plans = self.plans
        stages = [list(group) for _, group in groupby(sorted(plans, key=_stage), key=_stage)]
        first = self._begun(stages.pop(0)) if stages and _together(stages[0][0]) else []
        tasks = [begun.question for begun in first]  # this very list: OpenGL compiles and answers in one process
        try:
            built = self._build(tasks, any(kind_of(plan).DRAWS for plan in plans))
        except InfrastructureError as error:
            self._fail(error, self.plans)
            return
        self._finish(Begun.of(build, self.ledger), built)
        if built.failure:
            for plan in plans:
                if plan.id not in self.ledger.checks:
                    self._enter(plan.check("skipped"))
            return
        self._ask_together(first, tasks)
        for stage in stages:
            if _together(stage[0]):
                begun = self._begun(stage)
                self._ask_together(begun, [one.question for one in begun])
            else:
                for plan in stage:
                    self._begun([plan], alone=True)

    def _build(self, then: list[Task], draws: bool) -> Built:
        try:
            if self.refused:
                raise BuildError(self.refused)
            return self.student.build(then, draws)
        except BuildError as error:
            return Built(failure=error.message)

    def _begun(self, plans: list[Plan], alone: bool = False) -> "list[Begun]":
        """Those that ask something; the others have their verdict at once. alone: and are asked to their end."""
        out = []
        for plan in plans:
            begun = Begun.of(plan, self.ledger)
            if isinstance(begun, Check):
                self._enter(begun)
            elif alone:
                self._finish(begun, self.student.answer(begun.question))
            else:
                out.append(begun)
        return out

    def _ask_together(self, begun: "list[Begun]", tasks: list[Task]) -> None:
        """When the machine fails us, every check that is left gets the error instead of a verdict."""
        outputs = self.student.answers(tasks)
        for number, one in enumerate(begun):
            try:
                output = next(outputs)
            except InfrastructureError as error:
                self._fail(error, [one.plan for one in begun[number:]])
                return
            self._finish(one, output)

    def _finish(self, begun: "Begun", answer: Output | Built) -> None:
        while True:
            try:
                question = begun.asking.send(answer)
            except StopIteration as end:
                self._enter(end.value)
                return
            answer = self.student.answer(question)

    def _enter(self, check: Check) -> None:
        self.ledger.checks[check.id] = check
        built = check.kind == "build" and check.status == "passed"
        self._record(check, getattr(self.student.runner, "gl", None) if built else None)

    def _fail(self, error: InfrastructureError, plans: list[Plan]) -> None:
        for plan in plans:
            if plan.id not in self.ledger.checks:
                self._enter(plan.our_fault(error))


@dataclass
class Begun:
    """A check that has asked its first question."""

    plan: Plan
    asking: Generator
    question: Task | Build

    @classmethod
    def of(cls, plan: Plan, ledger: Ledger) -> "Begun | Check":
        asking = kind_of(plan).judge(plan, ledger)
        try:
            return cls(plan, asking, next(asking))
        except StopIteration as end:
            return end.value


def _stage(plan: Plan) -> tuple[int, bool]:
    """Within a stage first what is asked together, then the others one by one."""
    return kind_of(plan).STAGE, not _together(plan)


def _together(plan: Plan) -> bool:
    return kind_of(plan).TOGETHER


def judge_both(plan: Plan, ledgers: dict[str, Ledger]) -> Check:
    """A check of the two languages together: the numbers are there, and nothing is asked."""
    begun = Begun.of(plan, ledgers)
    assert isinstance(begun, Check), f"{plan.kind}: asks, but is of both languages"
    return begun
