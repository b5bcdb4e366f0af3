"""Custom checks: what no declaration can say, as pytest functions in solution/NAME/checks/test_*.py. This is pytest's
plugin.

    @pytest.mark.points(2)                    # for both languages together, half each; without it, the check costs nothing
    def test_linearity(evaluate, render):     # is cpp/custom/linearity and glsl/custom/linearity
        ...

Students read what an assert says, and nothing else of the check: say what is wrong, with the numbers. Any other exception
is a fault of the check, and told as one. Fixtures:

    evaluate(function, inputs)    the student's function over arrays, named as in `./shadelab eval` ("light.e": (N, 3)), or over
                                  (N, columns). Gives an array, or a dictionary of the members when the function returns a struct
    render(scene, layer="total")  the student's picture, (height, width, 3) linear float32; other layers are ambient, diffuse
                                  and specular. `scene`: the name of one of the assignment's, a file, or what the
                                  fixture `scene` gives
    expected                      the expected data: inputs(function), outputs(function), image(scene, layer="total")
    scene(name)                   what stands in the scene file, as a dictionary: change it and give it to `render`
    backend                       "cpp" or "glsl"; each check runs once for each

The grader runs them itself. pytest shows the same, and all other checks of `grade` beside them, with

    .shadelab/venv/bin/python -I -m pytest -p shadelab.custom solution/NAME --submission DIR

(The submission is an option because pytest would run a conftest.py in the folders that it is given.)
"""

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from shadelab.course.assignment import Assignment, Scene, flat_rows, load_assignment, named_arrays
from shadelab.course.toml_files import read_toml
from shadelab.errors import InfrastructureError, UserError
from shadelab.grading.grade import grade
from shadelab.grading.plan import Plan
from shadelab.grading.planning import plan_checks
from shadelab.grading.session import Job, Verdict
from shadelab.paths import SOLUTION
from shadelab.result import Check, Result
from shadelab.truth.expected import CHANNELS, Expected

LINES, LENGTH = 5, 1000  # of a message
LAYERS = ("total", "ambient", "diffuse", "specular")


class Wrong(AssertionError):
    """The student's code did not give what the check asked for: as good as an assert that does not hold."""


class Waits(Exception):
    """The check needs something that did not pass: it is skipped."""

    def __init__(self, needs: list[str]) -> None:
        super().__init__(f"{needs[0].split('/')[-1]} did not end in its own check")
        self.needs = needs


class Course:
    """The fixture `expected`, and the assignment's scenes."""

    def __init__(self, assignment: Assignment, data: Expected) -> None:
        self.assignment, self.data = assignment, data

    def inputs(self, function: str) -> dict[str, np.ndarray]:
        declared = self.assignment.function(function)
        return named_arrays(declared.inputs, self.data.table(declared).rows)

    def outputs(self, function: str) -> np.ndarray | dict[str, np.ndarray]:
        return self.named(function, self.data.table(self.assignment.function(function)).truth)

    def named(self, function: str, rows: np.ndarray) -> np.ndarray | dict[str, np.ndarray]:
        named = named_arrays(self.assignment.function(function).outputs, rows)
        return named["result"] if "result" in named else {k.removeprefix("result."): v for k, v in named.items()}

    def image(self, scene: str, layer: str = "total") -> np.ndarray:
        return np.array(self.data.scene(self.find(scene)).layers[layer])

    def find(self, name: str) -> Scene:
        """Hidden scenes are not for checks: a release hands these on."""
        for scene in self.assignment.public_scenes:
            if scene.name == name:
                return scene
        known = ", ".join(s.name for s in self.assignment.public_scenes)
        raise UserError(f"{name}: {self.assignment.name} has no such scene; it has {known}")

    def scene(self, name: str) -> dict[str, Any]:
        file = self.find(
            name
        ).file  # whoever asks may change it and have it drawn: so the file, and no description of it
        content = read_toml(file)
        for entry in content.get("object", []):
            entry["mesh"] = str((file.parent / entry["mesh"]).resolve())
        return content


class Submission:
    """What a check asks of the submission: the grader runs it (grading/session.py)."""

    def __init__(self, job: Job, course: Course) -> None:
        self.job, self.backend, self.folder, self.course = job, job.backend, Path(job.folder), course
        self.written = 0
        self.hears = os.fdopen(job.hears)

    def say(self, **entry: Any) -> None:
        os.write(self.job.says, json.dumps(entry).encode() + b"\n")

    def ask(self, **question: Any) -> np.ndarray:
        self.say(**question)
        answer = json.loads(self.hears.readline())
        if "waits" in answer:
            raise Waits(answer["waits"])
        if "wrong" in answer:
            raise Wrong(answer["wrong"])
        if "fault" in answer:
            raise (UserError if answer["user"] else InfrastructureError)(answer["fault"])
        return np.load(answer["array"], allow_pickle=False)

    def evaluate(self, function: str, inputs: dict[str, np.ndarray] | np.ndarray) -> np.ndarray | dict[str, np.ndarray]:
        columns = self.course.assignment.function(function).inputs
        rows = flat_rows(columns, inputs) if isinstance(inputs, dict) else np.asarray(inputs, np.float32)
        if rows.ndim != 2 or rows.shape[1] != len(columns):
            raise UserError(f"{function} takes (N, {len(columns)}) numbers, not {rows.shape}")
        file = self.folder / "rows.npy"
        np.save(file, rows)
        return self.course.named(function, self.ask(ask="evaluate", function=function, rows=str(file)))

    def render(self, scene: str | Path | dict[str, Any], layer: str = "total") -> np.ndarray:
        if layer not in LAYERS:
            raise UserError(f"{layer}: there is no such layer; there is {', '.join(LAYERS)}")
        if isinstance(scene, str):
            array = self.ask(ask="render", scene=self.course.find(scene).name)
        else:
            file = self._write(scene) if isinstance(scene, dict) else scene.resolve()
            array = self.ask(ask="render", file=str(file))
        return np.array(array[..., CHANNELS[layer]])

    def _write(self, scene: dict[str, Any]) -> Path:
        self.written += 1
        file = self.folder / f"varied-{self.written}.toml"
        file.write_text(tomli_w.dumps(scene))
        return file


@pytest.fixture
def submission(request: pytest.FixtureRequest) -> Submission:
    return request.config.stash[_submission]


@pytest.fixture
def evaluate(submission: Submission) -> Callable:
    return submission.evaluate


@pytest.fixture
def render(submission: Submission) -> Callable:
    return submission.render


@pytest.fixture
def expected(submission: Submission) -> Course:
    return submission.course


@pytest.fixture
def scene(submission: Submission) -> Callable:
    return submission.course.scene


@pytest.fixture
def backend(submission: Submission) -> str:
    return submission.backend


_submission = pytest.StashKey[Submission]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("shadelab")
    group.addoption("--submission", type=Path, metavar="DIR", help="the folder to grade (default: the solution itself)")
    group.addoption("--shadelab-job", type=Path, metavar="FILE", help="what the grader tells its own child")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "points(number): what a custom check is worth, half of it in each language")
    if file := config.getoption("--shadelab-job"):
        job = Job(**json.loads(file.read_text()))
        course = Course(load_assignment(Path(job.assignment)), Expected(Path(job.expected)))
        config.stash[_submission] = Submission(job, course)
        config.pluginmanager.register(_Child(config.stash[_submission]))
    else:
        config.pluginmanager.register(_Session(config.getoption("--submission")))


# ------------------------------------------------------------------------------------------------- in the grader's child


class _Child:
    """Tells the grader of each check at once (session.py)."""

    def __init__(self, submission: Submission) -> None:
        self.submission = submission
        self.verdict: Verdict | None = None

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            lines = [line[1:].strip() for line in str(report.longrepr).splitlines() if line.startswith("E ")]
            self.submission.say(
                broken=_clean(f"{Path(report.nodeid).name}: {lines[-1] if lines else 'cannot be loaded'}")
            )

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.name.removeprefix("test_") in self.submission.job.checks]

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.verdict = Verdict(nodeid.split("::")[-1].removeprefix("test_"), "passed")
        self.submission.say(begin=self.verdict.check)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo) -> Any:
        report = yield
        if self.verdict.status == "passed" and call.excinfo is not None:
            _judge(self.verdict, item, call)
        self.verdict.seconds += call.duration
        if call.when == "teardown":
            self.submission.say(**asdict(self.verdict))
        return report


def _judge(verdict: Verdict, item: pytest.Item, call: pytest.CallInfo) -> None:
    error = call.excinfo.value
    if isinstance(error, Waits):
        verdict.status, verdict.needs, verdict.message = "skipped", error.needs, str(error)
    elif isinstance(error, pytest.skip.Exception):
        verdict.status, verdict.message = "skipped", _clean(str(error))
    elif isinstance(error, Wrong | pytest.fail.Exception):
        verdict.status, verdict.message = "failed", _clean(str(error))
    elif call.when == "call" and isinstance(error, AssertionError):
        verdict.status, verdict.message = "failed", _clean(_asserted(error, call.excinfo.traceback[-1]))
    else:
        own = [entry for entry in call.excinfo.traceback if Path(entry.path) == item.path]
        line = f"{item.path.name}:{own[-1].lineno + 1}: " if own else ""
        verdict.status, verdict.message = "error", _clean(f"{line}{type(error).__name__}: {error}")


def _asserted(error: AssertionError, place: Any) -> str:
    """The message that the check gives; of an assert without one, what it asks and with which numbers."""
    message, found, values = str(error).rpartition("\nassert ")
    if found:
        return message
    if not str(error).startswith("assert "):  # of numpy.testing, say
        return str(error)
    asked = " ".join(str(place.statement).split()).removeprefix("assert ")
    values = str(error).splitlines()[0].removeprefix("assert ")
    return f"does not hold: {asked}" + ("" if values in (asked, "False", "not True") else f" ({values})")


def _clean(text: str) -> str:
    """For students: numbers as they are written, no paths, and not too much."""
    text = re.sub(r"np\.\w+?\d+\(([^()]*)\)", r"\1", text)
    text = re.sub(r"(?<![\w.])(?:/[^\s/:'\"]+)+/(?=[^\s/])", "", text)
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    return "\n".join(lines[:LINES])[:LENGTH]


# -------------------------------------------------------------------------------------------- pytest on a submission


class _Session:
    """Each assignment.toml below solution/ that pytest is given stands for the checks that `grade` makes."""

    def __init__(self, submission: Path | None) -> None:
        if submission is not None and not submission.is_dir():
            raise pytest.UsageError(f"--submission {submission}: there is no such folder")
        self.submission = submission
        self.score: dict[str, Result] = {}

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        """Their functions run in the grader's child."""
        return (
            True if collection_path.name == "checks" and (collection_path.parent / "assignment.toml").exists() else None
        )

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        if file_path.name != "assignment.toml" or file_path.parent.parent.resolve() != SOLUTION.resolve():
            return None
        graded = _Graded.from_parent(parent, path=file_path)
        graded.submission, graded.finished = self.submission or file_path.parent, self.score
        return graded

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        for name, result in self.score.items():
            terminalreporter.write_line(f"{name}: {result.score:.10g} of {result.max_score:.10g} points")


class _Graded(pytest.File):
    """Graded once, when the first of its checks is asked for."""

    submission: Path
    finished: dict[str, Result]

    def collect(self) -> Iterator[pytest.Item]:
        self.assignment = load_assignment(self.path.parent)
        for plans in plan_checks(self.assignment).values():
            for plan in plans:
                yield _Item.from_parent(self, name=plan.id, plan=plan)

    @cached_property
    def checks(self) -> dict[str, Check]:
        result = grade(self.assignment, self.submission, pictures=False).result
        self.finished[self.assignment.name] = result
        return {check.id: check for check in result.checks}


class _Item(pytest.Item):
    """One check: passed, failed, skipped, or an error of ours."""

    def __init__(self, *, plan: Plan, **options: Any) -> None:
        super().__init__(**options)
        self.add_marker(pytest.mark.points(plan.points))

    def setup(self) -> None:
        self.check = self.parent.checks[self.name]
        self.user_properties += [("score", self.check.score), ("max_score", self.check.max_score)]
        if self.check.status == "error":
            raise InfrastructureError(self.check.message)

    def runtest(self) -> None:
        if self.check.status == "skipped":
            why = self.check.message or f"needs {', '.join(self.check.needs)}"
            raise pytest.skip.Exception(why, _use_item_location=True)
        if self.check.status == "failed":
            hint = f"\nHint: {self.check.mistake.hint}" if self.check.mistake else ""
            raise Wrong(f"{self.check.score:g} of {self.check.max_score:g} points: {self.check.message}{hint}")

    def repr_failure(self, excinfo: pytest.ExceptionInfo, style: Any = None) -> Any:
        if isinstance(excinfo.value, Wrong | InfrastructureError | UserError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        return self.path, 0, self.name
