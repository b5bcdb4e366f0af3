"""Beside a result: for each check that failed its worst input as a file, and the line that replays it."""

import shlex
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment, find_assignment, named_arrays
from shadelab.errors import UserError
from shadelab.files import whole
from shadelab.grading.kinds import kind_of
from shadelab.paths import shown
from shadelab.result import Result


def write_worst_inputs(assignment: Assignment, result: Result, submission: Path, out: Path) -> None:
    """Beside the reports: for each failed function check its worst input, and the line that replays it."""
    try:
        find_assignment(submission, None)
        named = []
    except UserError:  # a folder whose name and content do not tell
        named = ["--assignment", assignment.name]
    for check in result.checks:
        if check.worst is None:
            continue
        name = check.id.split("/")[-1]
        how = kind_of(check).REPLAY
        if how == "eval":
            (out / "worst").mkdir(exist_ok=True)
            kind = f"-{check.kind}" if check.kind not in ("function", "parity") else ""  # of these two one fails alone
            file = out / "worst" / f"{check.backend}-{name}{kind}.npz"
            columns = assignment.function(name).inputs
            inputs = {name: check.worst.inputs[name] for name in dict.fromkeys(c.path for c in columns)}
            flat = [float(v) for values in inputs.values() for v in values]
            with whole(file) as part:
                np.savez(part, **named_arrays(columns, np.array([flat], np.float32)))
            command = ["eval", shown(submission), name, "--backend", check.backend, "--inputs", shown(file), *named]
        elif how == "render":
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
        else:
            continue
        check.worst.replay = shlex.join(["./shadelab", *command])
    result.write(out / "result.json")
