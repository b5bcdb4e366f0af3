"""What a student's C++ computes, in child processes behind the sandbox: a crash, a hang or a wrong output costs the one
task that it happened in."""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment, Function
from shadelab.errors import InfrastructureError
from shadelab.evidence.messages import readable_errors, readable_warnings
from shadelab.evidence.missing import advice, called, missing, with_stand_ins
from shadelab.evidence.tasks import (
    DRAW_LIMITS,
    EVALUATE_LIMITS,
    BuildError,
    Draw,
    Evaluate,
    Output,
    Record,
    Task,
    Trace,
    is_regular,
    load_image,
)
from shadelab.machine import renderer
from shadelab.machine.build import UNSET_BYTE, CompileError, Plugin, Recipe, build_plugin
from shadelab.machine.command import Command
from shadelab.machine.sandbox import Limits, Outcome, Sandbox
from shadelab.words import decoded, listed

_whole = Recipe()


@dataclass(frozen=True)
class ComparisonSite:
    """Where a comparison stands, before anything was inlined."""

    line: int | None = None  # of the student's file
    function: str = ""  # of the assignment
    inside_mathematics: bool = False  # in exp, log and the like


class CppRunner:
    backend = "cpp"

    def __init__(
        self, assignment: Assignment, sandbox: Sandbox, recipe: Recipe = _whole, complete: bool = False
    ) -> None:
        """complete: what does not need the functions that a file lacks can be asked all the same; of students' code."""
        self.assignment, self.sandbox, self.recipe, self.complete = assignment, sandbox, recipe, complete
        self.plugin: Plugin | None = None
        self.environment: dict[str, str] = {}  # of what is evaluated
        self.warnings = ""  # of the compiler, about the student's lines
        self._places: dict[int, ComparisonSite] = {}  # by site
        self._missing: dict[str, str] = {}  # functions that the file lacks, and what is said of each

    def build(self, folder: Path) -> None:
        """Raises BuildError."""
        source = folder / "shading.cpp"
        try:
            self.plugin = build_plugin(self.assignment.glue, source, self.sandbox, self.recipe)
        except CompileError as error:
            if not (self.complete and self._build_without(source)):
                said = readable_errors(error.stderr, self.assignment) or f"the compiler {error.ending}"
                raise BuildError(said) from None
        self.warnings = "\n".join([*self._missing.values(), readable_warnings(self.plugin.said)]).strip()

    def _build_without(self, source: Path) -> bool:
        text = decoded(source.read_bytes())
        names = missing(self.assignment, text)
        if not names:
            return False
        completed = self.sandbox.fresh("completed")
        completed.mkdir()
        (completed / source.name).write_text(with_stand_ins(self.assignment, text, names))
        try:
            self.plugin = build_plugin(self.assignment.glue, completed / source.name, self.sandbox, self.recipe)
        except CompileError:
            return False
        self._missing = {name: f"{source.name}: {name} {advice(name, text, self.assignment)}" for name in names}
        return True

    def run(self, tasks: list[Task]) -> Iterator[tuple[Task, Output]]:
        for task in tasks:
            yield task, self.evaluate(task) if isinstance(task, Evaluate) else self.draw(task)

    def _run(self, command: Command, limits: Limits) -> Outcome:
        """An exit code says nothing about whose fault it is (the student's code may call exit), but a full disk is ours."""
        outcome = self.sandbox.run(command, limits, self.environment)
        if not outcome.ok and shutil.disk_usage(self.sandbox.folder).free < limits.file_size:
            raise InfrastructureError(f"the disk is nearly full: {self.sandbox.folder}")
        return outcome

    def _explain(self, outcome: Outcome, limits: Limits) -> str:
        name = called(outcome.stderr, list(self._missing))
        return f"cannot be asked: {self._missing[name]}" if name else outcome.explain(limits)

    def evaluate(self, task: Evaluate) -> Output:
        real = np.float64 if self.recipe.double else np.float32
        rows, results = self.sandbox.fresh("rows.bin"), self.sandbox.fresh("results.bin")
        task.rows.astype(real).tofile(rows)
        follow = None if task.records is None else self._write_records(task.records, real)
        trace = self.sandbox.fresh("trace.bin") if task.traced else None
        command = renderer.evaluate(
            self.plugin.file, task.function.name, rows, results, follow, trace=trace, bodies=task.bodies
        )
        outcome = self._run(command, EVALUATE_LIMITS)
        output = Output(
            printed=outcome.stdout.decode(errors="replace"), seconds=outcome.seconds, hung=outcome.timed_out
        )
        shape = (max(1, len(task.bodies)) * len(task.rows), len(task.function.outputs))
        if not outcome.ok:
            output.failure = self._explain(outcome, EVALUATE_LIMITS)
        elif not is_regular(results) or results.stat().st_size != shape[0] * shape[1] * np.dtype(real).itemsize:
            output.failure = "ended the program without giving its results (does it call exit?)"
        else:
            output.array = np.fromfile(results, real).reshape(shape)
            output.unset = _unset(output.array, task.function)
            output.missing = self._unrecorded(task, follow)
            output.trace = self._trace(trace, task) if trace else None
        return output

    def _trace(self, file: Path, task: Evaluate) -> Trace | None:
        trace = _read_trace(file, len(task.rows))
        if trace is None:
            return None
        self._locate([int(site) for site in trace.sites if int(site) not in self._places])
        places = [self._places.get(int(site), ComparisonSite()) for site in trace.sites]
        others = {f.name for f in self.assignment.functions if f.graded} - {task.function.name}
        own = np.array([not (p.inside_mathematics or p.function in others) for p in places], bool)
        lines = {
            int(site): p.line for site, p in zip(trace.sites, places) if p.line and p.function == task.function.name
        }
        return Trace(trace.sites[own], trace.least[:, own], trace.most[:, own], lines)

    def _locate(self, sites: list[int]) -> None:
        if not sites:
            return
        # What is known is where a call returns to: its place is that of the byte before.
        words = ("addr2line", "-f", "-e", str(self.plugin.file), *(hex(site - 1) for site in sites))
        outcome = self.sandbox.run(Command(words, reads=(self.plugin.file,)), EVALUATE_LIMITS)
        said = outcome.stdout.decode(errors="replace").splitlines() if outcome.ok else []
        names = "|".join(f.name for f in self.assignment.functions)
        for site, mangled, place in zip(sites, said[::2], said[1::2]):
            # The student's file, where it was compiled, and not a given one.
            line = re.search(r"/build-[0-9a-f]+/shading\.cpp:(\d{1,9})\b", place)
            function = re.match(rf"_ZZ?\d+({names})[A-Z]", mangled)
            self._places[site] = ComparisonSite(
                int(line[1]) if line else None,
                function[1] if function else "",
                "/math.hpp:" in place,
            )

    def _unrecorded(self, task: Task, follow: Path | None) -> dict[str, np.ndarray]:
        out = {}
        for name in task.records or {}:
            columns = len(self.assignment.function(name).inputs)
            out[name] = np.fromfile(follow / f"{name}.missing", np.float32).reshape(-1, columns)
        return out

    def _write_records(self, records: dict[str, Record], real: type) -> Path:
        folder = self.sandbox.fresh("records")
        folder.mkdir()
        for name, (arguments, outputs) in records.items():
            np.hstack([arguments, outputs]).astype(real).tofile(folder / f"{name}.known")
        return folder

    def draw(self, task: Draw) -> Output:
        image, counts = self.sandbox.fresh("image.npy"), self.sandbox.fresh("statistics.json")
        follow = None if task.records is None else self._write_records(task.records, np.float32)
        files = renderer.ImageFiles(image, counts, repeat=task.frames, follow=follow)
        view = renderer.View(task.layers, size=task.size, shift=task.shift)
        command = renderer.image(task.scene.described, self.assignment.directory, self.plugin.file, view, files)
        outcome = self._run(command, DRAW_LIMITS)
        output = Output(
            printed=outcome.stdout.decode(errors="replace"), seconds=outcome.seconds, hung=outcome.timed_out
        )
        if not outcome.ok:
            output.failure = self._explain(outcome, DRAW_LIMITS)
            return output
        try:
            output.array = load_image(image)
            output.first_not_finite, output.frames = _read_statistics(counts, task.frames)
            output.missing = self._unrecorded(task, follow)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            output.array = None
            output.failure = "ended the program without giving its image (does it call exit?)"
        return output


def _read_trace(file: Path, rows: int) -> Trace | None:
    """None where the student's code has spoilt it: then nothing more is asked."""
    if not is_regular(file) or file.stat().st_size < 8:
        return None
    count = int(np.fromfile(file, np.int64, 1)[0])
    if not 0 <= count <= 1 << 16 or file.stat().st_size != 8 + 8 * count + 8 * rows * count:
        return None
    sites = np.fromfile(file, np.int64, count, offset=8)
    margins = np.fromfile(file, np.float32, offset=8 + 8 * count).reshape(rows, count, 2)
    return Trace(sites, margins[..., 0], margins[..., 1])


def _unset(array: np.ndarray, function: Function) -> str | None:
    """Which members of the result a function left as the compiler fills memory, as a sentence. No number that was worked out has
    these very bits."""
    pattern = np.frombuffer(bytes([UNSET_BYTE] * array.itemsize), array.dtype)[0]
    unset = array == pattern
    if not unset.any():
        return None
    names = list(dict.fromkeys(column.path for column, any in zip(function.outputs, unset.any(axis=0)) if any))
    rows = int(unset.any(axis=1).sum())
    return f"nothing was ever stored in {listed(names)} for {rows} of {len(array)} inputs: a variable is used before it is set"


def _read_statistics(file: Path, frames: int) -> tuple[str | None, list[float]]:
    """The renderer's note of where a value that is not finite first stood, as a sentence, and the seconds of further frames."""
    if not is_regular(file) or file.stat().st_size > 1 << 16:
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
