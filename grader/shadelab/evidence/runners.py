"""What a student's code computes: function outputs and images, as raw numbers. It runs in child processes behind the sandbox;
a crash, a hang or a wrong output costs the one task that it happened in."""

import json
import os
import shutil
import statistics
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene
from shadelab.errors import InfrastructureError
from shadelab.machine.build import BuildError, Plugin, Recipe, build_plugin, glue_folder, readable_shader_errors
from shadelab.machine.sandbox import Limits, Outcome, Sandbox
from shadelab.paths import RENDER, ROOT

EVALUATE_LIMITS = Limits(seconds=5)
DRAW_LIMITS = Limits(seconds=20)
# llvmpipe and numpy reserve more address space than they use.
GL_MEMORY = 4 << 30
START_SECONDS = 30  # for the client to start, on a machine that is busy with other things


@dataclass
class Evaluate:
    """One function over a table of rows (float32; float64 for a double plugin)."""

    function: Function
    rows: np.ndarray
    student: Path | None = None  # GLSL: another file than the runner's; for our own code


@dataclass
class Draw:
    """One scene. `packet` is its frame packet, for the OpenGL client."""

    scene: Scene
    packet: Path | None = None
    layers: str = "terms"  # total | terms | all: what the C++ image holds (a packet says it for the OpenGL client)
    shift: tuple[float, float] = (0.0, 0.0)  # pixels right and up, in C++
    frames: int = 0  # drawn after the image, to measure the time of one


Task = Evaluate | Draw


@dataclass
class Output:
    array: np.ndarray | None = None
    failure: str | None = None  # what the student's code did instead of giving numbers
    hung: bool = False
    printed: str = ""
    seconds: float = 0.0
    frames: list[float] = field(default_factory=list)  # seconds of further frames: without loading and compiling
    first_not_finite: str | None = None  # where, and with what inputs

    @property
    def frame(self) -> float | None:
        """Seconds: the median."""
        return statistics.median(self.frames) if self.frames else None


def _printed(raw: bytes) -> str:
    return raw.decode(errors="replace")


class CppRunner:
    backend = "cpp"

    def __init__(self, assignment: Assignment, sandbox: Sandbox, recipe: Recipe = Recipe()) -> None:  # noqa: B008
        self.assignment, self.sandbox, self.recipe = assignment, sandbox, recipe
        self.plugin: Plugin | None = None

    def build(self, folder: Path) -> None:
        """Raises BuildError."""
        self.plugin = build_plugin(self.assignment, folder / "shading.cpp", self.sandbox, self.recipe)

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        for task in tasks:
            yield task, self.evaluate(task) if isinstance(task, Evaluate) else self.draw(task)

    def _run(self, command: list[str], limits: Limits) -> Outcome:
        """An exit code says nothing about whose fault it is (the student's code may call exit), but a full disk is ours."""
        outcome = self.sandbox.run(command, limits)
        if not outcome.ok and shutil.disk_usage(self.sandbox.folder).free < limits.file_size:
            raise InfrastructureError(f"the disk is nearly full: {self.sandbox.folder}")
        return outcome

    def evaluate(self, task: Evaluate, follow: Path | None = None) -> Output:
        """`follow`: the folder of records that stand in for functions (follow.py)."""
        real = np.float64 if self.recipe.double else np.float32
        rows, results = self.sandbox.fresh("rows.bin"), self.sandbox.fresh("results.bin")
        task.rows.astype(real).tofile(rows)
        command = [str(RENDER), "evaluate", str(self.plugin.file), task.function.name, str(rows), str(results)]
        command += ["--follow", str(follow)] if follow else []
        outcome = self._run(command, EVALUATE_LIMITS)
        output = Output(printed=_printed(outcome.stdout), seconds=outcome.seconds, hung=outcome.timed_out)
        shape = (len(task.rows), len(self.assignment.output_columns(task.function)))
        if not outcome.ok:
            output.failure = outcome.explain(EVALUATE_LIMITS)
        elif not _regular(results) or results.stat().st_size != shape[0] * shape[1] * np.dtype(real).itemsize:
            output.failure = "ended the program without giving its results (does it call exit?)"
        else:
            output.array = np.fromfile(results, real).reshape(shape)
        return output

    def draw(self, task: Draw) -> Output:
        image, counts = self.sandbox.fresh("image.npy"), self.sandbox.fresh("statistics.json")
        command = [
            str(RENDER), "image", str(task.scene.file), "--assignment", str(self.assignment.directory),
            "--plugin", str(self.plugin.file), "-o", str(image), "--statistics", str(counts),
            "--repeat", str(task.frames), *({"total": [], "terms": ["--terms"], "all": ["--layers"]}[task.layers]),
            *([f"--shift={task.shift[0]},{task.shift[1]}"] if any(task.shift) else []),
        ]  # fmt: skip
        outcome = self._run(command, DRAW_LIMITS)
        output = Output(printed=_printed(outcome.stdout), seconds=outcome.seconds, hung=outcome.timed_out)
        if not outcome.ok:
            output.failure = outcome.explain(DRAW_LIMITS)
            return output
        try:
            output.array = load_image(image)
            output.first_not_finite, output.frames = _read_statistics(counts, task.frames)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            output.array = None
            output.failure = "ended the program without giving its image (does it call exit?)"
        return output


def _regular(file: Path) -> bool:
    """A plain file and no link, pipe or folder: a read cannot block or lead elsewhere."""
    return file.is_file() and not file.is_symlink() and file.stat().st_size <= Limits().file_size


def load_image(file: Path) -> np.ndarray:
    if not _regular(file):
        raise ValueError("no image")
    image = np.load(file, allow_pickle=False)
    if image.dtype != np.float32 or image.ndim != 3:
        raise ValueError("no float32 image")
    return image


def _read_statistics(file: Path, frames: int) -> tuple[str | None, list[float]]:
    """The renderer's note of where a value that is not finite first stood, as a sentence, and the seconds of further frames."""
    if not _regular(file) or file.stat().st_size > 1 << 16:
        raise ValueError("no statistics")
    counts = json.loads(file.read_text())
    seconds = [float(s) for s in counts["repeats"][:frames]]
    if not all(0 < s < DRAW_LIMITS.seconds for s in seconds):
        raise ValueError("no seconds")
    first = counts.get("first_not_finite")
    if first is None:
        return None, seconds
    n, x, v = ("(" + ", ".join(f"{float(c):.6g}" for c in first[name]) + ")" for name in ("n", "position", "v"))
    place = f"pixel ({int(first['x'])}, {int(first['y'])}), material {str(first['material'])[:80]}"
    return f"not finite first at {place}: n = {n}, x = {x}, v = {v}", seconds


class GlslRunner:
    backend = "glsl"

    def __init__(self, assignment: Assignment, sandbox: Sandbox) -> None:
        self.assignment, self.sandbox = assignment, sandbox
        self.glue = glue_folder(assignment.directory)
        self.student: Path | None = None
        self.gl = "unknown"
        self.begun: tuple[list[Task], Iterator] | None = None
        self.runs = 0  # one may begin while another goes on; each has files of its own

    def take(self, folder: Path) -> None:
        """Without compiling it by itself: whoever runs a task sees whether it compiles."""
        self.student = (folder / "shading.glsl").resolve()  # the client runs in the sandbox's folder

    def build(self, folder: Path, then: list[Task] = []) -> None:  # noqa: B006
        """Raises BuildError. `then`: the tasks that run() will be asked for next."""
        self.take(folder)
        # In the same process as the first tasks: to start one takes as long as several tasks.
        self.begun = (then, self._jobs(*self._prepared(then, compile=True)))
        _, output = next(self.begun[1])
        if output.failure:
            raise BuildError(output.failure)

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        if self.begun and tasks and self.begun[0] is tasks:
            jobs, first, self.begun = self.begun[1], 1, None
        else:
            jobs, first = self._jobs(*self._prepared(tasks)), 0
        for index, output in jobs:
            yield tasks[index - first], output

    def _prepared(
        self, tasks: list[Task], compile: bool = False
    ) -> tuple[list[tuple[dict, tuple | None, Limits]], Path]:
        """The client's jobs, and the folder for their files."""
        jobs: list[tuple[dict, tuple | None, Limits]] = []
        if compile:
            jobs.append(({"kind": "compile"}, None, DRAW_LIMITS))
        self.runs += 1
        folder = self.sandbox.folder / f"run-{self.runs}"
        folder.mkdir(exist_ok=True)
        for index, task in enumerate(tasks):
            target = folder / f"output-{index}"
            if isinstance(task, Evaluate):
                rows = folder / f"rows-{index}.bin"
                task.rows.astype(np.float32).tofile(rows)
                columns_out = len(self.assignment.output_columns(task.function))
                main = self.glue / "evaluate" / f"{task.function.name}.glsl"
                job = {
                    "kind": "evaluate", "main": str(main), "columns_in": task.rows.shape[1], "columns_out": columns_out,
                    "rows": str(rows), "output": str(target.with_suffix(".bin")),
                    **({"student": str(task.student.resolve())} if task.student else {}),
                }  # fmt: skip
                jobs.append((job, (len(task.rows), columns_out), EVALUATE_LIMITS))
            else:
                job = {
                    "kind": "draw",
                    "packet": str(Path(task.packet).resolve()),
                    "frames": task.frames,
                    "output": str(target.with_suffix(".npy")),
                }
                jobs.append((job, None, DRAW_LIMITS))
        return jobs, folder

    def _jobs(self, jobs: list[tuple[dict, tuple | None, Limits]], folder: Path) -> Iterator[tuple[int, Output]]:
        """Runs jobs in as few client processes as possible: one that dies or hangs is followed by another for the rest."""
        first = 0
        while first < len(jobs):
            status, task_file = folder / "status.jsonl", folder / "jobs.json"
            for stale in [status, *(Path(job["output"]) for job, _, _ in jobs[first:] if "output" in job)]:
                stale.unlink(missing_ok=True)
            task_file.write_text(json.dumps({
                "student": str(self.student), "prelude": str(self.glue / "prelude.glsl"), "status": str(status),
                "jobs": [job for job, _, _ in jobs[first:]],
            }))  # fmt: skip
            seconds = [limits.seconds for _, _, limits in jobs[first:]]
            progress = _Progress(status, seconds)
            with ThreadPoolExecutor(1) as pool:
                client = pool.submit(
                    self.sandbox.run,
                    [sys.executable, "-I", "-m", "shadelab.gl.client", str(task_file)],
                    Limits(seconds=START_SECONDS + sum(seconds), memory=GL_MEMORY),
                    {
                        "SHADELAB_ROOT": str(ROOT),
                        "MESA_SHADER_CACHE_DIR": str(self.sandbox.folder / "tmp"),
                        **_gl_choice(),
                    },
                    watch=_Progress(status, seconds).overdue,
                )
                # What has ended is handed on while the client works: a run that is killed keeps it.
                given = 0
                while True:
                    over = client.done()
                    progress.read()
                    self.gl = progress.gl or self.gl
                    while given < progress.ended:
                        yield first + given, self._output(jobs[first + given], progress.results[given])
                        given += 1
                    if over:
                        break
                    time.sleep(0.02)
                outcome = client.result()
            if progress.gl is None:
                last = outcome.stderr.strip().splitlines()
                raise InfrastructureError(
                    "the OpenGL client did not start: " + (last[-1] if last else outcome.explain(Limits(START_SECONDS)))
                )
            if given < len(jobs) - first:
                limits = jobs[first + given][2]
                output = Output(hung=outcome.timed_out, seconds=limits.seconds if outcome.timed_out else 0.0)
                output.failure = outcome.explain(limits)
                yield first + given, output
                given += 1
            first += given

    def _output(self, job: tuple[dict, tuple | None, Limits], result: dict) -> Output:
        output = Output(seconds=result["seconds"], frames=result["frames"])
        if result["error"] and not result["students"]:
            raise InfrastructureError(result["error"])
        if result["error"]:
            output.failure = readable_shader_errors(result["error"], self.assignment)
            return output
        try:
            if job[0]["kind"] == "evaluate":
                output.array = np.fromfile(job[0]["output"], np.float32).reshape(job[1])
            elif job[0]["kind"] == "draw":
                output.array = load_image(Path(job[0]["output"]))
        except (OSError, ValueError):
            output.failure = "gave no output"
        return output


def _gl_choice() -> dict[str, str]:
    return {"SHADELAB_GL": os.environ["SHADELAB_GL"]} if "SHADELAB_GL" in os.environ else {}


class _Progress:
    """Reads the client's status file: which job runs, since when, and whether it has used up its time."""

    def __init__(self, file: Path, seconds: list[float]) -> None:
        self.file, self.seconds = file, seconds
        self.gl: str | None = None
        self.ended = 0
        self.results: dict[int, dict] = {}
        self._size = -1
        self._since: float | None = None

    def read(self) -> None:
        if not self.file.exists():
            return
        for line in self.file.read_text().splitlines():
            try:
                entry = json.loads(line)
            except ValueError:
                continue  # half a line: the client is still writing it
            if "gl" in entry:
                self.gl = entry["gl"]
            elif "end" in entry:
                self.results[entry["end"]] = entry
        self.ended = len(self.results)

    def overdue(self) -> bool:
        size = self.file.stat().st_size if self.file.exists() else -1
        if size != self._size:  # something began or ended: the clock starts anew
            self._size, self._since = size, time.perf_counter()
            self.read()
        limit = self.seconds[min(self.ended, len(self.seconds) - 1)] if self.gl else START_SECONDS
        return time.perf_counter() - (self._since or time.perf_counter()) > limit
