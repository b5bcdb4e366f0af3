"""What a student's GLSL computes, by the OpenGL client in child processes behind the sandbox. Many tasks share a process;
one that dies or hangs costs its task, and another process does the rest."""

import json
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment
from shadelab.errors import InfrastructureError
from shadelab.evidence.messages import readable_shader_errors, readable_shader_warnings
from shadelab.evidence.missing import advice, leading_to, missing, with_empty
from shadelab.evidence.tasks import DRAW_LIMITS, EVALUATE_LIMITS, BuildError, Evaluate, Output, Task, load_image
from shadelab.gl.environment import ENVIRONMENT
from shadelab.machine.command import Command
from shadelab.machine.sandbox import Limits, Sandbox
from shadelab.paths import PACKAGE, ROOT
from shadelab.words import FILES, decoded

# llvmpipe and numpy reserve more address space than they use.
GL_MEMORY = 4 << 30
START_SECONDS = 30  # for the client to start, on a machine that is busy with other things


class GlslRunner:
    backend = "glsl"

    def __init__(self, assignment: Assignment, sandbox: Sandbox) -> None:
        self.assignment, self.sandbox = assignment, sandbox
        self.glue = assignment.glue
        self.student: Path | None = None
        self.gl = "unknown"
        self.warnings = ""  # of the driver's compiler, about the student's lines
        self.missing: dict[str, str] = {}  # functions that the file lacks or that lead to one, and what is said of it
        self.begun: tuple[list[Task], Iterator] | None = None
        self.runs = 0  # one may begin while another goes on; each has files of its own

    def take(self, folder: Path) -> None:
        """Without compiling it by itself: whoever runs a task sees whether it compiles."""
        self.student = (folder / "shading.glsl").resolve()  # the client runs in the sandbox's folder

    def build(self, folder: Path, then: list[Task] = []) -> None:  # noqa: B006
        """What does not need the functions that the file lacks can be asked all the same. Raises BuildError. `then`: the tasks
        that run() will be asked for next."""
        self.take(folder)
        output = self._begin(then)
        if output.failure:
            if not self._complete() or self._begin(then).failure:
                raise BuildError(output.failure)
        self.warnings = "\n".join([*dict.fromkeys(self.missing.values()), output.said]).strip()

    def _begin(self, then: list[Task]) -> Output:
        # In the same process as the first tasks: to start one takes as long as several tasks.
        self.begun = (then, self._jobs(*self._prepared(self._possible(then), compile=True)))
        return next(self.begun[1])[1]

    def _complete(self) -> bool:
        """With stand-ins for the functions that the file lacks."""
        text = decoded(self.student.read_bytes())
        names = missing(self.assignment, text)
        completed = self.sandbox.fresh("completed.glsl")
        completed.write_text(with_empty(self.assignment, text, names))
        self.student = completed
        said = {name: f"{FILES['glsl']}: {name} {advice(name, text, self.assignment)}" for name in names}
        self.missing = {name: said[why] for name, why in leading_to(names, text).items()}
        return bool(names)

    def _lacks(self, task: Task) -> str | None:
        """Why a task cannot be asked, where it needs a function that the file lacks."""
        if isinstance(task, Evaluate):
            return None if task.student else self.missing.get(task.function.name)
        return next((self.missing[name] for name in task.scene.described.calls if name in self.missing), None)

    def _possible(self, tasks: list[Task]) -> list[Task]:
        return [task for task in tasks if not self._lacks(task)] if self.missing else tasks

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        if self.begun and tasks and self.begun[0] is tasks:
            jobs, self.begun = self.begun[1], None
        else:
            jobs = self._jobs(*self._prepared(self._possible(tasks)))
        for task in tasks:
            lacks = self._lacks(task) if self.missing else None
            yield task, Output(failure=f"cannot be asked: {lacks}") if lacks else next(jobs)[1]

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
                columns_out = len(task.function.outputs)
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
                    self._client(task_file, [job for job, _, _ in jobs[first:]], folder),
                    Limits(seconds=START_SECONDS + sum(seconds), memory=GL_MEMORY),
                    {
                        "SHADELAB_ROOT": str(ROOT),
                        "MESA_SHADER_CACHE_DIR": str(self.sandbox.folder / "tmp"),
                        **ENVIRONMENT,
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

    def _client(self, task_file: Path, jobs: list[dict], folder: Path) -> Command:
        read = [job[key] for job in jobs for key in ("main", "packet", "student") if key in job]
        return Command(
            (sys.executable, "-I", "-m", "shadelab.gl.client", str(task_file)),
            reads=(PACKAGE, self.glue, self.student, *dict.fromkeys(map(Path, read))), writes=(folder,),
        )  # fmt: skip

    def _output(self, job: tuple[dict, tuple | None, Limits], result: dict) -> Output:
        output = Output(
            seconds=result["seconds"], frames=result["frames"], said=readable_shader_warnings(result["said"])
        )
        if result["error"] and not result["students"]:
            raise InfrastructureError(result["error"])
        if result["error"]:
            student = Path(job[0].get("student", self.student)).read_bytes()
            output.failure = readable_shader_errors(result["error"], self.assignment, decoded(student))
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
