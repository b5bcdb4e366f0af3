"""The way of a submission: intake, build, evidence, findings, diagnosis, result."""

import hashlib
import platform
import shlex
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path

import numpy as np

from shadelab import __version__
from shadelab.course.assignment import Assignment, CustomCheck, Function, Scene, find_assignment, named_arrays
from shadelab.course.mistakes import load_changes, with_bodies
from shadelab.course.toml_files import read_toml
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence import intake
from shadelab.evidence.runners import CppRunner, Draw, Evaluate, GlslRunner, Output, Task
from shadelab.grading.customrun import Job, Verdict, run_checks
from shadelab.inspect.stability import DOUBLE
from shadelab.judge.diagnosis import Candidate, Diagnosis, candidates, diagnose
from shadelab.judge.findings import (
    MISTAKE,
    Followed,
    FunctionJudgement,
    function_members,
    informative,
    judge_function,
    judge_image,
    judge_parity,
)
from shadelab.judge.stability import FLOORS, Stability, describe, first_input, judge_extremes, stable_inputs
from shadelab.machine.build import FUNCTIONS, BuildError, Recipe, glue_folder
from shadelab.machine.sandbox import Sandbox, stop_everything, work_folder
from shadelab.paths import shown
from shadelab.report.html import Pictures
from shadelab.result import FRAMES, Check, Error, Mistake, Point, Result, Worst, point_of
from shadelab.truth import making as reference
from shadelab.truth.expected import TERM_CHANNELS, Expected, missing_meshes, with_callees
from shadelab.truth.follow import Reference
from shadelab.truth.tables import jittered, renormalised

BACKENDS = ("cpp", "glsl")
LANGUAGES = {"cpp": "C++", "glsl": "GLSL"}


@dataclass
class Grading:
    """A finished run: the result, and what the reports show beside it."""

    result: Result
    pictures: dict[str, Pictures] = field(default_factory=dict)


@dataclass
class Plan:
    """One check that is to be made."""

    id: str
    kind: str
    backend: str
    points: float
    item: Function | Scene | CustomCheck | None  # None: the build
    calls: list[str] = field(
        default_factory=list
    )  # of a scene: which of the assignment's functions the framework calls


def plan_checks(assignment: Assignment, only: str | set[str] = "*") -> dict[str, list[Plan]]:
    """Per backend, in the order of the data flow. Points are halved between the languages.

    A backend of which a check is wanted is built; the build's own check stands first. only: a shell pattern for ids, or a set
    of ids.
    """

    def is_wanted(id: str) -> bool:
        return fnmatch(id, only) if isinstance(only, str) else id in only

    plans: dict[str, list[Plan]] = {}
    for backend in BACKENDS:
        build = Plan(f"{backend}/build", "build", backend, 0.0, None)
        wanted = [
            Plan(f"{backend}/function/{f.name}", "function", backend, f.points / 2, f)
            for f in assignment.functions
            if f.graded
        ]
        for scene in assignment.scenes:
            # The models of its materials, and incident_light for each light.
            calls = {m["model"] for m in read_toml(scene.file).get("material", {}).values()} | {"incident_light"}
            own = [f.name for f in assignment.functions if f.name in calls]
            wanted.append(Plan(f"{backend}/image/{scene.name}", "image", backend, scene.points / 2, scene, own))
        # Where students lose points for it; the command `stability` shows every function.
        wanted += [
            Plan(f"{backend}/stability/{f.name}", "stability", backend, assignment.stability[f.name].points / 2, f)
            for f in assignment.functions
            if f.name in assignment.stability and assignment.stability[f.name].points
        ]
        wanted += [Plan(f"{backend}/custom/{c.name}", "custom", backend, c.points / 2, c) for c in assignment.custom]
        wanted = [p for p in wanted if is_wanted(p.id)]
        plans[backend] = [build, *wanted] if wanted or is_wanted(build.id) else []
    if all(plans.values()):  # where the two languages disagree; without points
        pairs = [Plan(f"glsl/parity/{f.name}", "parity", "glsl", 0.0, f) for f in assignment.functions if f.graded]
        plans["parity"] = [p for p in pairs if is_wanted(p.id)]
    return plans


def grade(
    assignment: Assignment,
    submission: Path,
    out: Path | None = None,
    only: str | set[str] = "*",
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    rewrite: Callable[[Result], None] = lambda result: None,
    pictures: bool = True,
) -> Grading:
    """Grades one submission. With `out`, result.json there is rewritten after each check, so a killed run keeps its marks;
    `rewrite` is called as often, for further reports that shall survive. pictures: keep the images, for the HTML report, and measure
    the time of a frame more than once.

    `only` restricts to checks whose id matches a shell pattern or is in a set; a backend without any is not built.
    """
    glue_folder(assignment.directory)  # once, before two threads want it
    expected = reference.load(assignment, progress)
    plans = plan_checks(assignment, only)
    total = sum(len(p) for p in plans.values())
    result = Result(
        assignment=assignment.name,
        submission="sha256:" + submission_digest(assignment, submission),
        max_score=round(sum(p.points for backend in plans.values() for p in backend if not _absent(p)), 6),
        environment=environment(assignment, expected),
    )
    grading = Grading(result)
    lock = threading.Lock()
    if out is not None:
        # An older run's reports must not pass for this one's.
        (out / "report.html").unlink(missing_ok=True)
        shutil.rmtree(out / "worst", ignore_errors=True)

    def write() -> None:
        if out is not None:
            result.write(out / "result.json")
        rewrite(result)

    def record(check: Check, images: Pictures | None = None, gl: str | None = None) -> None:
        with lock:
            if gl is not None:
                result.environment["gl"] = gl
            result.add(check)
            if pictures and images is not None:
                grading.pictures[check.id] = images
            write()
            progress(check.id, len(result.checks), total)

    write()
    with work_folder("grade") as folder, ThreadPoolExecutor(len(BACKENDS)) as pool:
        files = intake.take(submission, assignment, folder / "submission")
        graders = [
            _BackendGrader(backend, assignment, expected, plans[backend], files, folder, record, timed=pictures)
            for backend in BACKENDS
            if plans[backend]
        ]
        try:
            for chain in [pool.submit(grader.run_safely) for grader in graders]:
                chain.result()
        except KeyboardInterrupt:
            stop_everything.set()
            raise
    for plan in plans.get("parity", []):
        judged = [(grader.outputs.get(plan.item.name), grader.judged.get(plan.item.name)) for grader in graders]
        record(_parity(plan, expected, assignment, judged))
    order = {p.id: k for k, p in enumerate(p for chain in plans.values() for p in chain)}
    result.checks.sort(key=lambda check: order[check.id])
    result.complete = True
    write()
    return grading


def _absent(plan: Plan) -> bool:
    return isinstance(plan.item, Scene) and bool(missing_meshes(plan.item))


def _parity(plan: Plan, expected: Expected, assignment: Assignment, judged: list[tuple]) -> Check:
    (cpp, in_cpp), (glsl, in_glsl) = judged
    # What is right given something wrong differs with that, and says nothing of its own.
    plain = [(b, j) for b, j in zip(BACKENDS, (in_cpp, in_glsl)) if j is not None and not j.followed]
    passed = [b for b, j in plain if j.check.status == "passed"] if len(plain) == 2 else []
    if cpp is None or glsl is None or not passed:
        needs = [f"{b}/function/{plan.item.name}" for b in BACKENDS]
        return _check(plan, "skipped", "neither language has it right yet" if not passed else "", needs)
    floors = sum(expected.floor(plan.item, backend) for backend in BACKENDS)
    return judge_parity(assignment, plan.item, expected.table(plan.item), floors, cpp, glsl, passed)


class _BackendGrader:
    """The checks of one language, in the order of the data flow."""

    def __init__(
        self,
        backend: str,
        assignment: Assignment,
        expected: Expected,
        plans: list[Plan],
        files: dict[str, str | None],
        folder: Path,
        record: Callable[..., None],
        timed: bool,
    ) -> None:
        self.backend, self.assignment, self.expected, self.folder = backend, assignment, expected, folder
        self.plan, *self.plans = plans
        self.function_plans = [p for p in self.plans if isinstance(p.item, Function)]  # stability last
        tables = [
            expected.stable_table(p.item) if p.kind == "stability" else expected.table(p.item)
            for p in self.function_plans
        ]
        self.tasks: list[Task] = [Evaluate(p.item, t.rows) for p, t in zip(self.function_plans, tables)]
        self.sandbox = Sandbox(folder / backend)
        source = next(name for name in assignment.files if name.endswith({"cpp": ".cpp", "glsl": ".glsl"}[backend]))
        self.refused = files[source]
        self._record, self.timed = record, timed
        self.recorded: set[str] = set()
        self.failed: set[str] = set()
        self.hung: set[str] = set()
        self.outputs: dict[str, np.ndarray] = {}  # by function: what came on its table
        self.judged: dict[str, FunctionJudgement] = {}
        self.diagnoses: dict[str, Diagnosis] = {}
        # By scene, the file of what was drawn or why nothing was: custom checks ask for pictures, too.
        self.drawn: dict[str, Path] = {}
        self.undrawn: dict[str, str] = {}

    def record(self, check: Check, *arguments, **options) -> None:
        self.recorded.add(check.id)
        if check.status == "failed":
            self.failed.add(check.id)
        self._record(check, *arguments, **options)

    def run_safely(self) -> None:
        """Whatever goes wrong in one language, what was earned stays, and the other language is graded."""
        try:
            self.run()
        except Exception as error:  # a fault of the grader: told, and never a silent zero
            for plan in [self.plan, *self.plans]:
                if plan.id not in self.recorded:
                    fault = InfrastructureError(f"the grader failed: {type(error).__name__}: {error}")
                    self.record(_our_fault(plan, fault))

    def run(self) -> None:
        try:
            if self.refused:
                raise BuildError(self.refused)
            self.build()
        except BuildError as error:
            self.record(_check(self.plan, "failed", error.message))
            for plan in self.plans:
                self.record(_check(plan, "skipped"))
            return
        except InfrastructureError as error:
            for plan in [self.plan, *self.plans]:
                self.record(_our_fault(plan, error))
            return
        self.record(_check(self.plan, "passed"), gl=getattr(self.runner, "gl", None))
        # Functions first: a scene whose model never ends would only use up the time again.
        self.functions()
        self.images([p for p in self.plans if isinstance(p.item, Scene)])
        self.custom([p for p in self.plans if isinstance(p.item, CustomCheck)])

    def build(self) -> None:
        """In C++ two plugins at once: the functions alone, which is quick, and the loops that the scenes need."""
        submission = self.folder / "submission"
        if self.backend == "glsl":
            self.runner = self.drawer = GlslRunner(self.assignment, self.sandbox)
            self.runner.build(submission, self.tasks)
            return
        self.runner = CppRunner(self.assignment, self.sandbox, FUNCTIONS)
        self.drawer = CppRunner(
            self.assignment, self.sandbox, Recipe(functions=False, loops=tuple(self.expected.facts.loops))
        )
        draws = any(isinstance(p.item, Scene) for p in self.plans)
        with ThreadPoolExecutor(2) as pool:
            builds = [
                pool.submit(r.build, submission) for r in ([self.runner, self.drawer] if draws else [self.runner])
            ]
            for build in builds:
                build.result()

    # ----------------------------------------------------------------------------------------------------- functions

    def functions(self) -> None:
        for plan, output in _outputs(self.runner, self.function_plans, self.tasks):
            if isinstance(output, InfrastructureError):
                self.record(_our_fault(plan, output))
            elif output.array is None:
                if output.hung:
                    self.hung.add(plan.id)
                self.record(_finished(_check(plan, "failed", f"{plan.item.name} {output.failure}"), output))
            elif plan.kind == "stability":
                self.record(_finished(self.stability(plan, output.array), output))
            else:
                self.outputs[plan.item.name] = output.array
                self.record(_finished(self.function(plan, output.array), output))

    def function(self, plan: Plan, actual: np.ndarray) -> Check:
        """By the truth; or else by the truth with what the student's own functions gave, of which some are wrong."""
        function = plan.item
        judgement = self._judge(plan, actual)
        self.judged[function.name] = judgement
        if judgement.check.status == "passed":
            return judgement.check
        wrong = [
            name
            for name in self.expected.facts.calls[function.name]
            if name in self.judged and self.judged[name].check.status == "failed"
        ]
        members, limit = function_members(self.assignment, function), judgement.check.error.limit
        known = candidates(self.expected, function, self.backend)
        followed = self._follow(function, wrong) if wrong else None
        if followed is not None:
            other = self._judge(plan, actual, followed)
            if other.check.score > judgement.check.score:
                judgement = self.judged[function.name] = other
            if judgement.check.status == "passed":
                judgement.check.message = f"right, given what your {_and(wrong)} gives"
                return judgement.check
        found = diagnose(judgement, actual, limit, known, members)
        written = len(np.unique(actual, axis=0)) > 1  # one that always gives the same is not written yet
        if found is None and followed is not None and written:
            found = diagnose(other, actual, limit, self._followed_mistakes(function, wrong), members)
        check = judgement.check
        if found is None:
            if written:
                check.message += "; not a mistake that the grader knows"
        else:
            self.diagnoses[function.name] = found
            check.mistake = found.mistake
            if found.function != function.name and found.function not in wrong:
                check.message += f"; as if {found.function} were wrong inside it"
            if found.other:
                check.message += f"; there is a second mistake ({found.other.id}): {found.other.hint}"
        return check

    def stability(self, plan: Plan, actual: np.ndarray) -> Check:
        """Of a function that is right where scenes need it: how it does at the ends of its domain."""
        function = plan.item
        used = with_callees({function.name}, self.expected.facts.calls)
        wrong = [f"{self.backend}/function/{name}" for name in self.judged if name in used and not self._right(name)]
        if wrong:
            return _check(plan, "skipped", "it is asked of functions that are right otherwise", wrong)
        found = judge_extremes(self.assignment, self.expected, function, self.backend, actual)
        check = _check(plan, "failed" if found.faults else "passed")
        check.score = plan.points * (found.right * (1 - MISTAKE) if found.faults else 1.0)
        worst = found.worst if np.isfinite(found.worst) else None
        check.error = Error(name="floors", value=worst, limit=FLOORS, floor=1.0)
        if found.faults:
            check.message = describe(found, self._in_double(function))
            first = first_input(self.assignment, function, found)
            check.worst = Worst(**{name: first[name] for name in ("inputs", "expected", "actual")})
            idea = self.assignment.stability[function.name].idea
            ratio = (worst or np.finfo(np.float32).max) / FLOORS
            check.mistake = Mistake(id="unstable-form", hint=idea, margin=max(1.0, float(ratio)))
        return check

    def _right(self, name: str) -> bool:
        judged = self.judged[name]
        return judged.check.status == "passed" and not judged.followed

    def _in_double(self, function: Function) -> Stability | None:
        """The same C++ in double, which tells bad algebra from a wrong formula. GLSL 330 has no double."""
        if self.backend != "cpp":
            return None
        runner = CppRunner(self.assignment, Sandbox(self.folder / "cpp-double"), DOUBLE)
        try:
            runner.build(self.folder / "submission")
        except BuildError:
            return None
        rows = stable_inputs(self.assignment, self.expected, function, "double")
        [(_, output)] = runner.run([Evaluate(function, rows)])
        if output.array is None:
            return None
        return judge_extremes(self.assignment, self.expected, function, "double", output.array)

    def _judge(self, plan: Plan, actual: np.ndarray, followed: Followed | None = None) -> FunctionJudgement:
        return judge_function(
            self.assignment,
            plan.item,
            self.backend,
            plan.points,
            self.expected.table(plan.item),
            self.expected.floor(plan.item, self.backend),
            actual,
            followed,
        )

    @cached_property
    def solution(self) -> str | None:
        """Its C++; a release has none, and no follow-through."""
        file = self.assignment.directory / "shading.cpp"
        return file.read_text() if file.exists() else None

    @cached_property
    def reference(self) -> Reference:
        return Reference(self.assignment, self.solution, Sandbox(self.folder / f"{self.backend}-reference"))

    def _follow(self, function: Function, wrong: list[str]) -> Followed | None:
        """The reference with the outputs of the student's functions that are wrong, and how far rounding of the inputs moves it: a
        wrong function may be wilder than the right one. None when this asks for nothing."""
        if self.solution is None:
            return None
        callees = [self.assignment.function(name) for name in wrong]
        table = self.expected.table(function)
        exact = renormalised(self.assignment, function, table.rows)
        # Wider than the truth's own: the arguments of the calls were rounded on their way, too.
        inputs = np.concatenate([exact, *jittered(self.assignment, function, exact, units=2.0)])
        results = self.reference.with_recorded(function, inputs, callees, self._evaluate)
        if results is None:
            return None
        followed, *moved = results.reshape(-1, *table.truth.shape)
        if not informative(followed):
            return None
        with np.errstate(invalid="ignore"):
            conditioning = np.nan_to_num(np.abs(np.array(moved) - followed), nan=np.inf).max(axis=0)
        not_finite = any(not np.isfinite(self.outputs[name]).all() for name in wrong)
        return Followed(followed, np.maximum(conditioning, table.conditioning), not_finite)

    def _evaluate(self, function: Function, rows: np.ndarray) -> np.ndarray | None:
        [(_, output)] = self.runner.run([Evaluate(function, rows)])
        return output.array

    def _followed_mistakes(self, function: Function, wrong: list[str]) -> list[Candidate]:
        """The function's own mistakes, on top of those of the functions that it calls."""
        out, file = [], self.assignment.directory / "shading.cpp"
        callees = [self.assignment.function(name) for name in wrong]
        exact = renormalised(self.assignment, function, self.expected.table(function).rows)
        for number, change in enumerate(load_changes(self.assignment).mistake):
            if change.function == function.name:
                text = with_bodies(self.solution, file, change.bodies_for("cpp"))
                sandbox = Sandbox(self.folder / f"{self.backend}-mistake-{number}")
                mistaken = Reference(self.assignment, text, sandbox, change.id)
                results = mistaken.with_recorded(function, exact, callees, self._evaluate)
                if results is not None:
                    out.append(Candidate(change.id, change.function, change.hint, results))
        return out

    # -------------------------------------------------------------------------------------------------------- images

    def images(self, plans: list[Plan]) -> None:
        scenes = []
        for plan in plans:
            if missing := missing_meshes(plan.item):
                message = f"the mesh {missing[0].name} is not on this machine (./shadelab doctor says how to get it)"
                check = _check(plan, "skipped", message)
                check.max_score = 0.0  # nobody loses points for a mesh that could not be fetched
                self.record(check)
            elif waiting := sorted(self.hung & {f"{self.backend}/function/{name}" for name in self.used(plan)}):
                message = f"{waiting[0].split('/')[-1]} did not end in its own check"
                self.record(_check(plan, "skipped", message, waiting))
            else:
                scenes.append(plan)
        frames = FRAMES if self.timed else 1
        tasks: list[Task] = [Draw(p.item, self.expected.packet(p.item, self.assignment), frames=frames) for p in scenes]
        for plan, output in _outputs(self.drawer, scenes, tasks):
            if isinstance(output, InfrastructureError):
                self.record(_our_fault(plan, output))
            else:
                self.image(plan, output)

    def image(self, plan: Plan, output: Output) -> None:
        truth = self.expected.scene(plan.item)
        layers, shape = output.array, (*truth.total.shape[:2], TERM_CHANNELS)
        if layers is not None and layers.shape == shape:
            if self.assignment.custom:
                self.drawn[plan.item.name] = file = self.folder / f"{self.backend}-custom" / f"{plan.item.name}.npy"
                file.parent.mkdir(exist_ok=True)
                np.save(file, layers)
            judged = judge_image(plan.item, self.backend, plan.points, truth, layers)
            check, limit = judged.check, judged.limit
            check.runs = [Point(**run) for run in truth.facts.runs]
            off = layers[..., :3].astype(np.float64) - truth.total
            if output.frames and np.isfinite(off).all():
                check.runs.insert(0, point_of("yours", off, output.frames))
        else:
            failure = output.failure or f"gave an image of another size: {layers.shape}"
            check = _check(plan, "failed", f"{plan.item.name}: the render {failure}")
            self.undrawn[plan.item.name] = failure
            layers, limit = None, np.ones_like(truth.total)
        if check.status == "failed":
            self.blame(plan, check)
        self.record(_finished(check, output), Pictures(layers, truth, limit))

    def used(self, plan: Plan) -> set[str]:
        """The functions that a scene is drawn with."""
        return with_callees(set(plan.calls), self.expected.facts.calls)

    def blame(self, plan: Plan, check: Check) -> None:
        """Of the functions that the scene draws with, the first that is wrong explains the picture."""
        used = self.used(plan)
        for function in self.assignment.functions:
            if function.name in used and function.name in self.diagnoses:
                check.mistake = self.diagnoses[function.name].mistake
                break
        failed = [f"{self.backend}/function/{f.name}" for f in self.assignment.functions if f.name in used]
        check.because = [id for id in failed if id in self.failed]
        if check.because:
            names = [id.split("/")[-1] for id in check.because]
            check.message += f"; it is drawn with {_and(names)}, which {'is' if len(names) == 1 else 'are'} wrong"

    # ------------------------------------------------------------------------------------------------- custom checks

    def custom(self, plans: list[Plan]) -> None:
        if not plans:
            return
        folder = self.folder / f"{self.backend}-custom"
        job = Job(
            assignment=str(self.assignment.directory),
            backend=self.backend,
            submission=str(self.folder / "submission"),
            expected=str(self.expected.folder),
            folder=str(folder),
            checks=[plan.item.name for plan in plans],
            drawn={name: str(file) for name, file in self.drawn.items()},
            undrawn=self.undrawn,
            hung=[id.split("/")[-1] for id in self.hung],
        )
        by_name = {plan.item.name: plan for plan in plans}
        for verdict in run_checks(self.assignment, job):
            self.record(_of_verdict(by_name[verdict.check], verdict))


def _outputs(runner: CppRunner | GlslRunner, plans: list[Plan], tasks: list[Task]):
    """(plan, output) pairs. When the machine fails us, every plan that is left gets the error instead of an output."""
    outputs, done = runner.run(tasks), 0
    while done < len(plans):
        try:
            _, output = next(outputs)
        except InfrastructureError as error:
            for plan in plans[done:]:
                yield plan, error
            return
        yield plans[done], output
        done += 1


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def _check(plan: Plan, status: str, message: str = "", needs: list[str] | None = None) -> Check:
    """One without marks: a build, or a check that failed or was skipped before there were numbers to judge."""
    build = [] if plan.item is None else [f"{plan.backend}/build"]
    return Check(
        id=plan.id, kind=plan.kind, backend=plan.backend, status=status, score=0.0, max_score=plan.points,
        message=message, needs=[*build, *(needs or [])], hidden=isinstance(plan.item, Scene) and plan.item.hidden,
    )  # fmt: skip


def _our_fault(plan: Plan, error: InfrastructureError) -> Check:
    return _check(plan, "error", f"not the submission's fault: {error}")


def _of_verdict(plan: Plan, verdict: Verdict) -> Check:
    if verdict.status == "error":
        return _our_fault(plan, InfrastructureError(verdict.message))
    check = _check(plan, verdict.status, verdict.message, verdict.needs)
    check.score = plan.points if verdict.status == "passed" else 0.0
    check.seconds, check.printed = round(verdict.seconds, 4), verdict.printed
    return check


def _finished(check: Check, output: Output) -> Check:
    check.seconds = round(output.seconds, 4)
    check.printed = output.printed
    if output.first_not_finite:
        check.message += f"; {output.first_not_finite}"
    return check


def write_worst_inputs(assignment: Assignment, grading: Grading, submission: Path, out: Path) -> None:
    """Beside the reports: for each failed function check its worst input, and the line that replays it."""
    try:
        find_assignment(submission, None)
        named = []
    except UserError:  # a folder whose name and content do not tell
        named = ["--assignment", assignment.name]
    for check in grading.result.checks:
        if check.worst is None:
            continue
        name = check.id.split("/")[-1]
        if check.kind in ("function", "parity", "stability"):
            (out / "worst").mkdir(exist_ok=True)
            kind = "-stability" if check.kind == "stability" else ""
            file = out / "worst" / f"{check.backend}-{name}{kind}.npz"
            columns = assignment.input_columns(assignment.function(name))
            inputs = {name: check.worst.inputs[name] for name in dict.fromkeys(c.path for c in columns)}
            flat = [float(v) for values in inputs.values() for v in values]
            np.savez(file, **named_arrays(columns, np.array([flat], np.float32)))
            command = ["eval", shown(submission), name, "--backend", check.backend, "--inputs", shown(file), *named]
        else:
            scene = next(s for s in assignment.scenes if s.name == name)
            image = shown(out / f"{check.backend}-{name}.png")
            command = [
                "render",
                shown(scene.file),
                "--shading",
                shown(submission),
                "--backend",
                check.backend,
                "-o",
                image,
            ]
        check.worst.replay = shlex.join(["./shadelab", *command])
    grading.result.write(out / "result.json")


def submission_digest(assignment: Assignment, submission: Path) -> str:
    total = hashlib.sha256()
    for name in assignment.files:
        file = submission / name
        total.update(name.encode() + b"\0" + (file.read_bytes() if file.is_file() else b"absent") + b"\0")
    return total.hexdigest()


def environment(assignment: Assignment, expected: Expected) -> dict[str, str]:
    cpu = platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    return {
        "cpu": cpu,
        "sandbox": Sandbox.name,
        "expected": expected.digest,
        "seed_digest": assignment.hidden.seed_digest,
        "version": __version__,
    }
