"""The way of a submission: intake, build, evidence, findings, result."""

import hashlib
import platform
import shlex
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from shadelab import __version__, intake
from shadelab import expected as expected_data
from shadelab.build import BuildError, glue_folder
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence import CppRunner, Draw, Evaluate, GlslRunner, Output, Task
from shadelab.expected import TERM_CHANNELS, Expected, missing_meshes
from shadelab.findings import judge_function, judge_image
from shadelab.manifest import Assignment, Function, Scene, find_assignment, named_arrays
from shadelab.paths import shown
from shadelab.report.html import Pictures
from shadelab.result import Check, Result
from shadelab.sandbox import Sandbox, stop_everything, work_folder
from shadelab.toml_files import read_toml

BACKENDS = ("cpp", "glsl")


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
    item: Function | Scene | None  # None: the build
    calls: list[str] = field(
        default_factory=list
    )  # of a scene: which of the assignment's functions the framework calls


def plan_checks(assignment: Assignment, only: str = "*") -> dict[str, list[Plan]]:
    """Per backend, in the order of the data flow. Points of a function or scene are halved between the languages.

    A backend of which a check is wanted is built; the build's own check stands first.
    """
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
        wanted = [p for p in wanted if fnmatch(p.id, only)]
        plans[backend] = [build, *wanted] if wanted or fnmatch(build.id, only) else []
    return plans


def grade(
    assignment: Assignment,
    submission: Path,
    out: Path | None = None,
    only: str = "*",
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Grading:
    """Grades one submission. With `out`, result.json there is rewritten after each check, so a killed run keeps its marks.

    `only` restricts to checks whose id matches a shell pattern; a backend without any is not built.
    """
    glue_folder(assignment.directory)  # once, before two threads want it
    expected = expected_data.load(assignment, lambda what: progress(what, 0, 1))
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
        result.write(out / "result.json")

    def record(check: Check, pictures: Pictures | None = None, gl: str | None = None) -> None:
        with lock:
            if gl is not None:
                result.environment["gl"] = gl
            result.add(check)
            if pictures is not None:
                grading.pictures[check.id] = pictures
            if out is not None:
                result.write(out / "result.json")
            progress(check.id, len(result.checks), total)

    with work_folder("grade") as folder, ThreadPoolExecutor(len(BACKENDS)) as pool:
        files = intake.take(submission, assignment, folder / "submission")
        chains = [
            pool.submit(_grade_safely, backend, assignment, expected, plans[backend], files, folder, record)
            for backend in BACKENDS
            if plans[backend]
        ]
        try:
            for chain in chains:
                chain.result()
        except KeyboardInterrupt:
            stop_everything.set()
            raise
    order = {p.id: k for k, p in enumerate(p for backend in BACKENDS for p in plans[backend])}
    result.checks.sort(key=lambda check: order[check.id])
    result.complete = True
    if out is not None:
        result.write(out / "result.json")
    return grading


def _absent(plan: Plan) -> bool:
    return isinstance(plan.item, Scene) and bool(missing_meshes(plan.item))


def _grade_safely(backend: str, assignment: Assignment, expected: Expected, plans: list[Plan], *rest) -> None:
    """Whatever goes wrong in one language, what was earned stays, and the other language is graded."""
    files, folder, record = rest
    recorded: set[str] = set()

    def remember(check: Check, *arguments, **options) -> None:
        recorded.add(check.id)
        record(check, *arguments, **options)

    try:
        _grade_backend(backend, assignment, expected, plans, files, folder, remember)
    except Exception as error:  # a fault of the grader: told, and never a silent zero
        for plan in plans:
            if plan.id not in recorded:
                record(_our_fault(plan, InfrastructureError(f"the grader failed: {type(error).__name__}: {error}")))


def _grade_backend(
    backend: str,
    assignment: Assignment,
    expected: Expected,
    plans: list[Plan],
    files: dict[str, str | None],
    folder: Path,
    record: Callable[..., None],
) -> None:
    build, *plans = plans
    sandbox = Sandbox(folder / backend)
    source = next(name for name in assignment.files if name.endswith({"cpp": ".cpp", "glsl": ".glsl"}[backend]))
    try:
        runner = CppRunner(assignment, sandbox) if backend == "cpp" else GlslRunner(assignment, sandbox)
        if files[source]:
            raise BuildError(files[source])
        runner.build(folder / "submission")
    except BuildError as error:
        record(_check(build, "failed", error.message))
        for plan in plans:
            record(_check(plan, "skipped"))
        return
    except InfrastructureError as error:
        for plan in [build, *plans]:
            record(_our_fault(plan, error))
        return
    record(_check(build, "passed"), gl=getattr(runner, "gl", None))

    # Functions first: a scene whose model never ends would only use up the time again.
    hung: set[str] = set()
    functions = [p for p in plans if isinstance(p.item, Function)]
    tasks: list[Task] = [Evaluate(p.item, expected.table(p.item).rows) for p in functions]
    for plan, output in _outputs(runner, functions, tasks):
        if isinstance(output, InfrastructureError):
            record(_our_fault(plan, output))
            continue
        if output.array is None:
            check = _check(plan, "failed", f"{plan.item.name} {output.failure}")
            if output.hung:
                hung.add(plan.id)
        else:
            check = judge_function(assignment, plan.item, backend, plan.points, expected.table(plan.item), output.array)
        record(_finished(check, output))

    scenes = []
    for plan in plans:
        if not isinstance(plan.item, Scene):
            continue
        if missing := missing_meshes(plan.item):
            message = f"the mesh {missing[0].name} is not on this machine (./shadelab doctor says how to get it)"
            check = _check(plan, "skipped", message)
            check.max_score = 0.0  # nobody loses points for a mesh that could not be fetched
            record(check)
        elif waiting := [id for id in (f"{backend}/function/{name}" for name in plan.calls) if id in hung]:
            record(_check(plan, "skipped", f"{waiting[0].split('/')[-1]} did not end in its own check", waiting))
        else:
            scenes.append(plan)
    for plan, output in _outputs(runner, scenes, [Draw(p.item, expected.packet(p.item)) for p in scenes]):
        if isinstance(output, InfrastructureError):
            record(_our_fault(plan, output))
            continue
        truth = expected.scene(plan.item)
        total = truth.total
        if output.array is not None and output.array.shape == (*total.shape[:2], TERM_CHANNELS):
            judged = judge_image(plan.item, backend, plan.points, truth, output.array)
            pictures = Pictures(output.array[..., :3], total, truth.mask, judged.limit)
            check = judged.check
        else:
            failure = output.failure or f"gave an image of another size: {output.array.shape}"
            check = _check(plan, "failed", f"{plan.item.name}: the render {failure}")
            pictures = Pictures(None, total, truth.mask, np.ones_like(total))
        record(_finished(check, output), pictures)


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


def _check(plan: Plan, status: str, message: str = "", needs: list[str] | None = None) -> Check:
    """One without marks: a build, or a check that failed or was skipped before there were numbers to judge."""
    build = [] if plan.item is None else [f"{plan.backend}/build"]
    return Check(
        id=plan.id, kind=plan.kind, backend=plan.backend, status=status, score=0.0, max_score=plan.points,
        message=message, needs=[*build, *(needs or [])],
    )  # fmt: skip


def _our_fault(plan: Plan, error: InfrastructureError) -> Check:
    return _check(plan, "error", f"not the submission's fault: {error}")


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
        if check.kind == "function":
            (out / "worst").mkdir(exist_ok=True)
            file = out / "worst" / f"{check.backend}-{name}.npz"
            columns = assignment.input_columns(assignment.function(name))
            flat = [float(v) for values in check.worst.inputs.values() for v in values]
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
        "expected": expected.folder.name,
        "seed_digest": assignment.hidden.seed_digest,
        "version": __version__,
    }
