"""Images that count as the truth, and how far others lie from them."""

import math

import numpy as np

from shadelab.course.assignment import Assignment, named_arrays
from shadelab.errors import InfrastructureError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import DOUBLE
from shadelab.machine.renderer import Description
from shadelab.machine.sandbox import Sandbox
from shadelab.measure.images import image_error
from shadelab.study.timing import Drawer, Workbench
from shadelab.truth.fragments import unit


def small_size(described: Description, longest: int) -> str:
    """WxH with the scene's shape and at most `longest` pixels along a side."""
    shrink = min(1.0, longest / max(described.width, described.height))
    return f"{max(1, round(described.width * shrink))}x{max(1, round(described.height * shrink))}"


ONE_FRAME = 16  # samples along a side of a pixel that the reference's frames have; shifts make them more


def converged(program: Drawer, grid: int) -> tuple[np.ndarray, float]:
    """The mean over grid x grid regular samples a pixel, and an upper estimate of its own error.

    `program` draws ONE_FRAME x ONE_FRAME of them at once; frames shifted by parts of their spacing fill the rest. The error: the
    grid falls into two like the colours of a chessboard, each half as dense. The whole lies between them, at half their distance
    were they independent; as they complement each other, it lies nearer to the truth than that.
    """
    steps = grid // ONE_FRAME
    offsets = ((np.arange(steps) + 0.5) / steps - 0.5) / ONE_FRAME
    halves = [program.draw([(x, y) for i, x in enumerate(offsets) for j, y in enumerate(offsets) if (i + j) % 2 == colour])
              for colour in (0, 1)] if steps > 1 else [program.draw()] * 2  # fmt: skip
    first, second = (half.image for half in halves)
    return (first + second) / 2, image_error(first, second)["rmse"] / 2


# ---------------------------------------------------------------------------------------------- the analytic sphere


def analytic_sphere(described: Description, facing: float, functions: "Functions") -> tuple[np.ndarray, np.ndarray]:
    """The picture of the unit sphere at the origin without any triangle: (H, W, 3), and the pixels with n.v >= `facing`.

    Each pixel's ray through its centre meets the sphere in closed form; the point is its normal; the functions of the
    solution, in double, shade it."""
    width, height, eye = described.width, described.height, described.eye
    target, up = (np.array(described.camera[key], float) for key in ("target", "up"))
    ahead = unit(target - eye)
    right = unit(np.cross(ahead, up))
    above = np.cross(right, ahead)
    tangent = math.tan(described.fov_y / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * tangent * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * tangent
    rays = unit(ahead + x[None, :, None] * right + y[:, None, None] * above)
    along = rays @ -eye  # the point of the ray that is nearest to the centre
    inside = 1 - (eye @ eye - along**2)
    distance = along - np.sqrt(np.maximum(inside, 0))
    points = eye + distance[..., None] * rays
    seen = (inside > 0) & (np.sum(points * -rays, axis=-1) >= facing)
    n = unit(points[seen])
    image = np.zeros((height, width, 3))
    image[seen] = functions.shade(described, {"n": n, "x": n, "v": unit(eye - n)})
    return image, seen


class Functions:
    """The functions of a solution and of what is given with it, in double, over arrays."""

    def __init__(self, work: Workbench, assignment: Assignment) -> None:
        self.assignment, self.runners = assignment, {}
        for each in [*assignment.given, assignment]:
            runner = CppRunner(each, Sandbox(work.folder / f"functions-{each.name}"), DOUBLE)
            runner.build(each.directory)
            self.runners |= {f.name: (f, runner) for f in each.functions}

    def shade(self, described: Description, fragments: dict[str, np.ndarray]) -> np.ndarray:
        """(N, 3): what the model of the only object gives for fragments with these attributes, under all lights."""
        [shaded] = described.objects
        count = len(next(iter(fragments.values())))
        total = np.zeros((count, 3))
        for light in described.lights:
            values = {**fragments, "light": np.tile(light, (count, 1))}
            incident = self.call(self.assignment.light_function, values)
            model, _ = self.runners[shaded.model]
            values |= {model.values[0].name: np.tile(shaded.parameters, (count, 1)), **incident}
            total += sum(self.call(shaded.model, values).values()) * incident["e"]
        return total

    def call(self, name: str, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """`values` by argument, structs flattened. The members of the result by name."""
        function, runner = self.runners[name]
        rows = np.hstack([values[value.name].reshape(len(values[value.name]), -1) for value in function.values])
        output = runner.evaluate(Evaluate(function, rows))
        if output.array is None:
            raise InfrastructureError(f"{name} {output.failure}")
        named = named_arrays(function.outputs, output.array)
        return {path.removeprefix("result."): array for path, array in named.items()}
