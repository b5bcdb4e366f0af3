"""The way of a submission: intake, plan, questions, answers, judgement, result."""

import hashlib
import json
import platform
import shutil
import threading
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from shadelab import __version__
from shadelab.course import stubs
from shadelab.course.assignment import Assignment, Scene
from shadelab.evidence import intake
from shadelab.grading.ledger import Ledger
from shadelab.grading.pictures import FOLDER, PictureFolder, Pictures
from shadelab.grading.plan import Plan
from shadelab.grading.planning import plan_checks
from shadelab.grading.scheduler import Chain, judge_both
from shadelab.machine.processor import processor_level
from shadelab.machine.sandbox import Sandbox, work_folder
from shadelab.paths import RECORD, ROOT, shown
from shadelab.result import Check, Result
from shadelab.truth import making
from shadelab.truth.expected import Expected
from shadelab.words import BACKENDS, FILES


@dataclass
class Grading:
    """A finished run: the result, and the pictures, where they were kept."""

    result: Result
    folder: PictureFolder | None = None

    @property
    def pictures(self) -> dict[str, Pictures]:
        return self.folder.of(self.result) if self.folder else {}


def grade(
    assignment: Assignment,
    submission: Path,
    out: Path | None = None,
    only: str | Collection[str] = "*",
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    rewrite: Callable[[Result], None] = lambda result: None,
    pictures: bool = True,
    hidden_pictures: bool = False,
) -> Grading:
    """Grades one submission. With `out`, result.json there is rewritten after each check, so a killed run keeps its marks;
    `rewrite` is called as often, for further reports that shall survive. pictures: with `out`, keep the images there, for reports
    (of hidden scenes with `hidden_pictures` alone), and measure the time of a frame more than once.

    `only` restricts to checks whose id matches a shell pattern, or one of several; a backend without any is not built.
    """
    expected = making.load(assignment, progress)
    plans = plan_checks(assignment, only)
    order = {plan.id: k for k, plan in enumerate(plan for chain in plans.values() for plan in chain)}
    result = Result(
        assignment=assignment.name,
        submission="sha256:" + submission_digest(assignment, submission),
        max_score=round(sum(p.points for chain in plans.values() for p in chain if not _absent(p)), 6),
        environment=environment(assignment, expected),
        elsewhere=_elsewhere(),
    )
    lock, stop = threading.Lock(), threading.Event()
    kept = PictureFolder(out / FOLDER, True, hidden_pictures) if out is not None and pictures else None
    if out is not None:
        # An older run's reports must not pass for this one's.
        (out / "report.html").unlink(missing_ok=True)
        shutil.rmtree(out / "worst", ignore_errors=True)
        PictureFolder(out / FOLDER, kept=False).clear()
    if kept:
        kept.write_about(title=assignment.title, submission=shown(submission))

    def write() -> None:
        if out is not None:
            result.write(out / "result.json")
        rewrite(result)

    def record(check: Check, gl: str | None) -> None:
        with lock:
            stubs.mark(check, assignment, untouched)
            if gl is not None:
                result.environment["gl"] = gl
            result.add(check)
            write()
            progress(check.id, len(result.checks), len(order))

    write()
    with work_folder("grade") as work, ThreadPoolExecutor(len(BACKENDS)) as pool:
        taken = work / "submission"
        refused = intake.take(submission, assignment, taken)
        untouched = stubs.not_begun(assignment, taken)
        drawn = kept or PictureFolder(work / FOLDER, kept=False)
        ledgers = {
            backend: Ledger(
                backend,
                assignment,
                expected,
                drawn,
                pictures,
                taken,
                work / backend,
                stop,
                plans[backend],
                untouched[backend],
            )
            for backend in BACKENDS
            if plans[backend]
        }
        chains = [Chain(ledger, refused[_source(assignment, backend)], record) for backend, ledger in ledgers.items()]
        try:
            for chain in [pool.submit(chain.run) for chain in chains]:
                chain.result()
        except KeyboardInterrupt:
            stop.set()
            raise
    if kept:
        kept.flush()
    for plan in plans.get("both", []):
        record(judge_both(plan, ledgers), None)
    result.checks.sort(key=lambda check: order[check.id])
    result.complete = True
    write()
    return Grading(result, kept)


def _elsewhere() -> float | None:
    """Written by `release` beside what it hands out."""
    file = ROOT / RECORD
    return float(json.loads(file.read_text())["hidden_points"]) if file.is_file() else None


def _absent(plan: Plan) -> bool:
    return isinstance(plan.item, Scene) and bool(plan.item.missing_meshes())


def _source(assignment: Assignment, backend: str) -> str:
    return next(name for name in assignment.files if name.endswith(Path(FILES[backend]).suffix))


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
        "level": processor_level(),
        "sandbox": Sandbox.name,
        "expected": expected.digest,
        "seed_digest": assignment.hidden.seed_digest,
        "version": __version__,
    }
