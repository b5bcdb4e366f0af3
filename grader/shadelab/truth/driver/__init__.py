"""What an OpenGL driver computes itself, and how far that is off. An assignment in form only (beside this file): it is
measured, and nobody writes it."""

from pathlib import Path

import numpy as np

from shadelab.course.assignment import load_assignment
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.truth.workshop import Workshop

DRIVER = Path(__file__).parent
FILES = ("assignment.toml", "shading.glsl")
ROWS = 4096
TRUTHS = {"exp": np.exp, "log": np.log, "pow5": lambda x: x**5, "sin": np.sin, "inversesqrt": lambda x: x**-0.5}


def measure_driver(workshop: Workshop) -> dict[str, float]:
    """How far the OpenGL driver's own functions are off: relative errors; of the logarithm, which is mostly taken the exp of, the
    absolute one."""
    own = load_assignment(DRIVER)
    runner = GlslRunner(own, workshop.sandbox())
    runner.take(DRIVER)
    tasks = []
    for function in own.functions:
        low, high = function.values[0].domain.range
        x = -np.geomspace(1e-6, -low, ROWS) if low < 0 else np.geomspace(low, high, ROWS)
        tasks.append(Evaluate(function, x[:, None].astype(np.float32)))
    out = {}
    with workshop.step("the driver's functions"):
        for task, output in zip(tasks, workshop.run(runner, tasks, "the driver")):
            name = task.function.name.removeprefix("driver_")
            truth = TRUTHS[name](task.rows.astype(np.float64))
            size = 1.0 if name == "log" else np.abs(truth)
            out[name] = float((np.abs(output.array - truth) / size).max())
    return out
