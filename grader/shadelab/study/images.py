"""Images that count as the truth, and how far others lie from them."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, flat_rows, named_arrays
from shadelab.course.toml_files import read_toml
from shadelab.errors import InfrastructureError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.machine.build import FUNCTIONS, Recipe
from shadelab.measure import bench
from shadelab.study.timing import Program, Workbench


def image_error(image: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Root mean square and largest difference over everything."""
    both = bench.image_error(image, truth)
    return {"rmse": both["error"], "max": both["max_error"]}


def small_size(scene: Path, longest: int) -> str:
    """WxH with the scene's shape and at most `longest` pixels along a side."""
    film = read_toml(scene).get("film", {})
    width, height = (film.get(side, 512) for side in ("width", "height"))
    shrink = min(1.0, longest / max(width, height))
    return f"{max(1, round(width * shrink))}x{max(1, round(height * shrink))}"


ONE_FRAME = 16  # samples along a side of a pixel that the reference's frames have; shifts make them more


def converged(program: Program, grid: int) -> tuple[np.ndarray, float]:
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


def analytic_sphere(
    scene: dict[str, Any], facing: float, phong: "Functions", lights: "Functions"
) -> tuple[np.ndarray, np.ndarray]:
    """The picture of the unit sphere at the origin without any triangle: (H, W, 3), and the pixels with n.v >= `facing`.

    Each pixel's ray through its centre meets the sphere in closed form; the point is its normal; the functions of the solution, in
    double, shade it.
    """
    camera, film = scene["camera"], scene["film"]
    width, height = film["width"], film["height"]
    eye, target, up = (np.array(camera[key], float) for key in ("eye", "target", "up"))
    ahead = _unit(target - eye)
    right = _unit(np.cross(ahead, up))
    above = np.cross(right, ahead)
    tangent = math.tan(math.radians(camera["fov_y"]) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * tangent * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * tangent
    rays = _unit(ahead + x[None, :, None] * right + y[:, None, None] * above)
    along = rays @ -eye  # the point of the ray that is nearest to the centre
    inside = 1 - (eye @ eye - along**2)
    distance = along - np.sqrt(np.maximum(inside, 0))
    points = eye + distance[..., None] * rays
    seen = (inside > 0) & (np.sum(points * -rays, axis=-1) >= facing)
    n = _unit(points[seen])
    image = np.zeros((height, width, 3))
    image[seen] = _shaded(scene, n, _unit(eye - n), phong, lights)
    return image, seen


def _shaded(scene: dict[str, Any], n: np.ndarray, v: np.ndarray, phong: "Functions", lights: "Functions") -> np.ndarray:
    [material] = scene["material"].values()
    total = np.zeros_like(n)
    for light in scene["light"]:
        incident = lights.call("incident_light", len(n), {
            "light.kind": 0, "light.position": light["position"], "light.direction": [0, 0, 0],
            "light.intensity": light["intensity"], "light.attenuation": [1, 0, 0], "light.hotspot": 0, "light.falloff": 0,
            "x": n,
        })  # fmt: skip
        members = {f"m.{name}": material[name] for name in ("ka", "kd", "ks", "q")}
        terms = phong.call(material["model"], len(n), {**members, "n": n, "l": incident["result.l"], "v": v})
        total += (terms["result.ambient"] + terms["result.diffuse"] + terms["result.specular"]) * incident["result.e"]
    return total


class Functions:
    """The functions of a solution in double, over arrays."""

    def __init__(self, work: Workbench, assignment: Assignment) -> None:
        self.assignment = assignment
        self.runner = CppRunner(assignment, work.sandbox, Recipe(double=True, loops=FUNCTIONS.loops))
        self.runner.build(assignment.directory)

    def call(self, name: str, count: int, arguments: dict[str, Any]) -> dict[str, np.ndarray]:
        """`arguments` by column path; what is the same for all evaluations is given once."""
        function = self.assignment.function(name)
        columns = function.inputs
        widths = {c.path: c.width for c in columns}
        arrays = {}
        for path, value in arguments.items():
            shape = (count,) if widths[path] == 1 else (count, widths[path])
            arrays[path] = np.broadcast_to(np.asarray(value, float), shape)
        output = self.runner.evaluate(Evaluate(function, flat_rows(columns, arrays, np.float64)))
        if output.array is None:
            raise InfrastructureError(f"{self.assignment.name}: {name} {output.failure}")
        return named_arrays(function.outputs, output.array)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
