"""What a student's code computes: function outputs and images, as raw numbers. It runs in child processes behind the sandbox;
a crash, a hang or a wrong output costs the one task that it happened in."""

import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadelab.build import BuildError, Plugin, build_plugin, glue_folder, readable_shader_errors
from shadelab.errors import InfrastructureError
from shadelab.manifest import Assignment, Function, Scene
from shadelab.paths import RENDER, ROOT
from shadelab.sandbox import Limits, Outcome, Sandbox

EVALUATE_LIMITS = Limits(seconds=5)
DRAW_LIMITS = Limits(seconds=20)
# llvmpipe and numpy reserve more address space than they use.
GL_MEMORY = 4 << 30


@dataclass
class Evaluate:
    """One function over a table of rows (float32; float64 for a double plugin)."""

    function: Function
    rows: np.ndarray


@dataclass
class Draw:
    """One scene. `packet` is its frame packet, for the OpenGL client."""

    scene: Scene
    packet: Path | None = None
    layers: str = "terms"  # total | terms | all: what the C++ image holds (a packet says it for the OpenGL client)


Task = Evaluate | Draw


@dataclass
class Output:
    array: np.ndarray | None = None
    failure: str | None = None  # what the student's code did instead of giving numbers
    hung: bool = False
    printed: str = ""
    seconds: float = 0.0
    statistics: dict | None = None


def _printed(raw: bytes) -> str:
    return raw.decode(errors="replace")


class CppRunner:
    backend = "cpp"

    def __init__(self, assignment: Assignment, sandbox: Sandbox, double: bool = False, terms: bool = True) -> None:
        self.assignment, self.sandbox, self.double, self.terms = assignment, sandbox, double, terms
        self.plugin: Plugin | None = None

    def build(self, folder: Path) -> None:
        """Raises BuildError."""
        self.plugin = build_plugin(self.assignment, folder / "shading.cpp", self.sandbox, self.double, self.terms)

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        for task in tasks:
            yield task, self.evaluate(task) if isinstance(task, Evaluate) else self.draw(task)

    def _run(self, command: list[str], limits: Limits) -> Outcome:
        """An exit code says nothing about whose fault it is (the student's code may call exit), but a full disk is ours."""
        outcome = self.sandbox.run(command, limits)
        if not outcome.ok and shutil.disk_usage(self.sandbox.folder).free < limits.file_size:
            raise InfrastructureError(f"the disk is nearly full: {self.sandbox.folder}")
        return outcome

    def evaluate(self, task: Evaluate) -> Output:
        real = np.float64 if self.double else np.float32
        rows, results = self.sandbox.folder / "rows.bin", self.sandbox.folder / "results.bin"
        results.unlink(missing_ok=True)
        task.rows.astype(real).tofile(rows)
        command = [str(RENDER), "evaluate", str(self.plugin.file), task.function.name, str(rows), str(results)]
        outcome = self._run(command, EVALUATE_LIMITS)
        output = Output(printed=_printed(outcome.stdout), seconds=outcome.seconds, hung=outcome.timed_out)
        shape = (len(task.rows), len(self.assignment.output_columns(task.function)))
        if not outcome.ok:
            output.failure = outcome.explain(EVALUATE_LIMITS)
        elif not results.is_file() or results.stat().st_size != shape[0] * shape[1] * np.dtype(real).itemsize:
            output.failure = "ended the program without giving its results (does it call exit?)"
        else:
            output.array = np.fromfile(results, real).reshape(shape)
        return output

    def draw(self, task: Draw) -> Output:
        image, statistics = self.sandbox.folder / "image.npy", self.sandbox.folder / "statistics.json"
        image.unlink(missing_ok=True)
        statistics.unlink(missing_ok=True)
        command = [
            str(RENDER), "image", str(task.scene.file), "--assignment", str(self.assignment.directory),
            "--plugin", str(self.plugin.file), "-o", str(image), "--statistics", str(statistics),
            *({"total": [], "terms": ["--terms"], "all": ["--layers"]}[task.layers]),
        ]  # fmt: skip
        outcome = self._run(command, DRAW_LIMITS)
        output = Output(printed=_printed(outcome.stdout), seconds=outcome.seconds, hung=outcome.timed_out)
        if not outcome.ok:
            output.failure = outcome.explain(DRAW_LIMITS)
            return output
        try:
            output.array = np.load(image, allow_pickle=False)
            output.statistics = json.loads(statistics.read_text())
        except (OSError, ValueError):
            output.failure = "ended the program without giving its image (does it call exit?)"
        return output


class GlslRunner:
    backend = "glsl"

    def __init__(self, assignment: Assignment, sandbox: Sandbox) -> None:
        self.assignment, self.sandbox = assignment, sandbox
        self.glue = glue_folder(assignment.directory)
        self.student: Path | None = None
        self.gl = "unknown"

    def build(self, folder: Path) -> None:
        """Raises BuildError."""
        self.student = folder / "shading.glsl"
        [(_, output)] = self._jobs([({"kind": "compile"}, None, DRAW_LIMITS)])
        if output.failure:
            raise BuildError(output.failure)

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        jobs = []
        for index, task in enumerate(tasks):
            target = self.sandbox.folder / f"gl-output-{index}"
            if isinstance(task, Evaluate):
                rows = self.sandbox.folder / f"gl-rows-{index}.bin"
                task.rows.astype(np.float32).tofile(rows)
                columns_out = len(self.assignment.output_columns(task.function))
                main = self.glue / "evaluate" / f"{task.function.name}.glsl"
                job = {
                    "kind": "evaluate", "main": str(main), "columns_in": task.rows.shape[1], "columns_out": columns_out,
                    "rows": str(rows), "output": str(target.with_suffix(".bin")),
                }  # fmt: skip
                jobs.append((job, (len(task.rows), columns_out), EVALUATE_LIMITS))
            else:
                job = {"kind": "draw", "packet": str(task.packet), "output": str(target.with_suffix(".npy"))}
                jobs.append((job, None, DRAW_LIMITS))
        for index, output in self._jobs(jobs):
            yield tasks[index], output

    def _jobs(self, jobs: list[tuple[dict, tuple | None, Limits]]) -> Iterator[tuple[int, Output]]:
        """Runs jobs in as few client processes as possible: one that dies or hangs is followed by another for the rest."""
        first = 0
        while first < len(jobs):
            status, task_file = self.sandbox.folder / "status.jsonl", self.sandbox.folder / "jobs.json"
            for stale in [status, *(Path(job["output"]) for job, _, _ in jobs[first:] if "output" in job)]:
                stale.unlink(missing_ok=True)
            task_file.write_text(json.dumps({
                "student": str(self.student), "prelude": str(self.glue / "prelude.glsl"), "status": str(status),
                "jobs": [job for job, _, _ in jobs[first:]],
            }))  # fmt: skip
            progress = _Progress(status, [limits.seconds for _, _, limits in jobs[first:]])
            outcome = self.sandbox.run(
                [sys.executable, "-I", "-m", "shadelab.glclient", str(task_file)],
                Limits(seconds=progress.total, memory=GL_MEMORY),
                {"SHADELAB_ROOT": str(ROOT), "MESA_SHADER_CACHE_DIR": str(self.sandbox.folder / "tmp"), **_gl_choice()},
                watch=progress.overdue,
            )
            progress.read()
            if progress.gl is None:
                last = outcome.stderr.strip().splitlines()
                raise InfrastructureError(
                    "the OpenGL client did not start: " + (last[-1] if last else outcome.explain(Limits()))
                )
            self.gl = progress.gl
            for index in range(progress.ended):
                yield first + index, self._output(jobs[first + index], progress.results[index])
            if progress.ended < len(jobs) - first:
                limits = jobs[first + progress.ended][2]
                output = Output(hung=outcome.timed_out, seconds=limits.seconds if outcome.timed_out else 0.0)
                output.failure = outcome.explain(limits)
                yield first + progress.ended, output
                progress.ended += 1
            first += progress.ended

    def _output(self, job: tuple[dict, tuple | None, Limits], result: dict) -> Output:
        output = Output(seconds=result["seconds"])
        if result["error"]:
            output.failure = readable_shader_errors(result["error"])
            return output
        try:
            if job[0]["kind"] == "evaluate":
                output.array = np.fromfile(job[0]["output"], np.float32).reshape(job[1])
            elif job[0]["kind"] == "draw":
                output.array = np.load(job[0]["output"], allow_pickle=False)
        except (OSError, ValueError):
            output.failure = "gave no output"
        return output


def _gl_choice() -> dict[str, str]:
    return {"SHADELAB_GL": os.environ["SHADELAB_GL"]} if "SHADELAB_GL" in os.environ else {}


class _Progress:
    """Reads the client's status file: which job runs, since when, and whether it has used up its time."""

    def __init__(self, file: Path, seconds: list[float]) -> None:
        self.file, self.seconds = file, seconds
        self.total = 30 + sum(seconds)
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
        limit = self.seconds[min(self.ended, len(self.seconds) - 1)] if self.gl else 30
        return time.perf_counter() - (self._since or time.perf_counter()) > limit
