"""stability: how functions do at the ends of their domains, in floors of what the inputs' own rounding makes: float and
double, C++ and GLSL, against 50 digits."""

import json
import platform
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Function, named_arrays
from shadelab.errors import UserError
from shadelab.evidence import intake
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import BuildError, Evaluate
from shadelab.files import whole
from shadelab.judge.stability import FLOORS, ROUNDINGS, Stability, judge_extremes, row_input, stable_inputs
from shadelab.machine.build import DOUBLE, FUNCTIONS
from shadelab.machine.sandbox import Sandbox, work_folder
from shadelab.paths import shown
from shadelab.truth import making
from shadelab.truth.expected import Expected

SERIES = {"cpp": "C++ float", "double": "C++ double", "glsl": "GLSL"}
SCHEMA = "shadelab/stability/1"


# ---------------------------------------------------------------------------------------------------- the command


@dataclass
class Line:
    """One function: what came of it in each series, or why nothing did."""

    function: Function
    found: dict[str, Stability] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    @property
    def first(self) -> tuple[str, int] | None:
        """Series and row of the first failing input; the double build is no one's grade."""
        for series in ("cpp", "glsl"):
            if series in self.found and self.found[series].faults:
                return series, self.found[series].faults[0].row
        return None

    @property
    def stable(self) -> bool:
        return self.first is None and not {"cpp", "glsl"} & set(self.failures)


@dataclass
class Report:
    assignment: Assignment
    expected: Expected
    lines: list[Line]
    notes: list[str]
    replays: dict[str, str] = field(default_factory=dict)  # by function: the line that replays its first failing input

    @property
    def stable(self) -> bool:
        return all(line.stable for line in self.lines)

    def to_json(self) -> str:
        functions = []
        for line in self.lines:
            entry: dict[str, Any] = {"function": line.function.name, "stable": line.stable, "series": {}}
            for series, found in line.found.items():
                entry["series"][series] = {
                    "worst": found.worst if np.isfinite(found.worst) else None,
                    "inputs": len(found.table.rows),
                    "faults": {
                        kind: len([f for f in found.faults if f.kind == kind])
                        for kind in sorted({f.kind for f in found.faults})
                    },
                    "cases": found.labels(),
                }
            entry["failures"] = line.failures
            declared = self.assignment.stability.get(line.function.name)
            if not line.stable and declared and declared.idea:
                entry["idea"] = declared.idea
            if line.first:
                series, row = line.first
                entry["first"] = {
                    "series": series,
                    **row_input(line.function, line.found[series], row),
                }
                entry["first"]["replay"] = self.replays.get(line.function.name, "")
            functions.append(entry)
        facts = self.expected.facts
        out = {
            "schema": SCHEMA, "assignment": self.assignment.name, "stable": self.stable, "machine": platform.machine(),
            "limit": {"floors": FLOORS, "roundings": ROUNDINGS, "driver": facts.driver, "gl": facts.gl},
            "notes": self.notes, "functions": functions,
        }  # fmt: skip
        return json.dumps(out, indent=1, allow_nan=False) + "\n"


def measure(assignment: Assignment, submission: Path, progress: Callable[[str, int, int], None]) -> Report:
    """Every declared function that the submission holds, worked examples and given models included."""
    expected = making.load(assignment, progress)
    if not expected.facts.cases:
        raise UserError(
            f"{assignment.name}: there is no exact.py, which gives the functions in 50 digits; stability is judged by it"
        )
    lines = [Line(function) for function in assignment.functions]
    notes: list[str] = []
    with work_folder("stability") as folder:
        files = intake.take(submission, assignment, folder / "submission")
        for refusal in filter(None, files.values()):
            raise UserError(refusal)
        runners = {
            "cpp": CppRunner(assignment, Sandbox(folder / "cpp"), FUNCTIONS, complete=True),
            "double": CppRunner(assignment, Sandbox(folder / "double"), DOUBLE, complete=True),
            "glsl": GlslRunner(assignment, Sandbox(folder / "glsl")),
        }
        done = 0
        for series, runner in runners.items():
            try:
                progress(f"{SERIES[series]}: compiling", done, 3 * len(lines))
                runner.build(folder / "submission")
            except BuildError as error:
                if series != "double":
                    raise UserError(error.message) from None
                notes.append(
                    "it does not compile in double, so float is not compared with double: "
                    + error.message.splitlines()[0]
                )
                continue
            tasks = [Evaluate(line.function, stable_inputs(expected, line.function, series)) for line in lines]
            for line, (_, output) in zip(lines, runner.run(tasks)):
                done += 1
                progress(f"{SERIES[series]}: {line.function.name}", done, 3 * len(lines))
                if output.array is None:
                    line.failures[series] = output.failure
                else:
                    line.found[series] = judge_extremes(assignment, expected, line.function, series, output.array)
    return Report(assignment, expected, lines, notes)


def write_inputs(report: Report, submission: Path, out: Path, named: list[str]) -> None:
    """For each unstable function its first failing input as a file, and the line that replays it."""
    for line in report.lines:
        if line.first is None:
            continue
        series, row = line.first
        out.mkdir(parents=True, exist_ok=True)
        file = out / f"{series}-{line.function.name}.npz"
        rows = line.found[series].table.rows[row : row + 1]
        with whole(file) as part:
            np.savez(part, **named_arrays(line.function.inputs, rows))
        command = ["eval", shown(submission), line.function.name, "--backend", series, "--inputs", shown(file), *named]
        report.replays[line.function.name] = shlex.join(["./shadelab", *command])
