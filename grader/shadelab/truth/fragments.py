"""What the framework calls while it draws a scene: rows of the models and of the function that gives the light, as
fragments ask them."""

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene, named_arrays
from shadelab.truth.expected import INTERIOR, SceneTruth

PER_SCENE = 256


def recorded_rows(
    assignment: Assignment, scenes: list[Scene], truths: dict[str, SceneTruth], seed: int
) -> dict[str, dict[str, np.ndarray]]:
    """By scene and function, rows: some fragments of the scene, each under one of its lights."""
    out: dict[str, dict[str, np.ndarray]] = {}
    functions = {f.name: f for f in assignment.functions}
    rng = np.random.default_rng(seed)
    for scene in scenes:
        if scene.hidden:
            continue  # their lights and materials are not to be found in a release
        truth, described, rows = truths[scene.name], scene.described, {}
        ids = truth.layers["id"][..., 0]
        ys, xs = np.nonzero((ids > 0) & (truth.mask == INTERIOR))
        if not len(ys) or not len(described.lights):
            continue
        chosen = rng.integers(len(ys), size=PER_SCENE)
        place = ys[chosen], xs[chosen]
        lights = as_float(described.lights)[rng.integers(len(described.lights), size=PER_SCENE)]
        n, x = (truth.layers[name][place].astype(np.float64) for name in ("normal", "position"))
        values = fragment_values(assignment, n, x, truth.eye) | {
            "l": unit(to_light(assignment, lights, x)),
            "light": lights,
        }
        for number, each in enumerate(described.objects, start=1):
            model = functions.get(each.model)
            if model is not None:
                own = {model.values[0].name: np.tile(as_float(each.parameters), (PER_SCENE, 1))}
                _append(rows, model, {**values, **own}, ids[place] == number)
        light = functions.get(assignment.light_function)
        if light is not None:
            _append(rows, light, values, np.ones(PER_SCENE, bool))
        out[scene.name] = {name: np.vstack(parts) for name, parts in rows.items()}
    return out


def fragment_values(
    assignment: Assignment, normal: np.ndarray, position: np.ndarray, eye: np.ndarray
) -> dict[str, np.ndarray]:
    """What fragments hold, by the names that arguments have for it."""
    sources = {"normal": normal, "position": position, "eye": unit(eye - position)}
    return {name: sources[source] for name, source in assignment.fragment.items()}


def to_light(assignment: Assignment, lights: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N, 3): from the points x to the lights, (N, columns of Light) each; not unit. A light that has no position shines
    from afar."""
    light = named_arrays(assignment.structs["Light"].columns, lights)
    placed = np.array(["position" in kind.members for kind in assignment.light_kinds])[light["kind"].astype(int)]
    return np.where(placed[:, None], light["position"] - x, -light["direction"])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)


def as_float(numbers: np.ndarray) -> np.ndarray:
    """Rounded to float32, as uniforms and float builds hold them."""
    return numbers.astype(np.float32).astype(np.float64)


def _append(
    out: dict[str, list[np.ndarray]], function: Function, values: dict[str, np.ndarray], chosen: np.ndarray
) -> None:
    """A row of the function for each chosen fragment, where the fragments have all that it takes."""
    if not chosen.any() or any(v.name not in values for v in function.values):
        return
    rows = np.hstack([values[v.name] for v in function.values])
    out.setdefault(function.name, []).append(rows[chosen].astype(np.float32))
