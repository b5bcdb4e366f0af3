"""Expected data: what the double build of the solution computes. It is all that grading knows of the solution.

Below .shadelab/expected/NAME/DIGEST/ stand, named by a digest of everything that they depend on:
    functions.npz       per function: FUNCTION.rows (float32 inputs), FUNCTION.truth and FUNCTION.floor (float64)
    SCENE.npz           the film's layers (float32), the mask of pixels that are judged, eye and scale
    SCENE.packet        the frame packet for the OpenGL client
    done                written last: a set without it is made again
"""

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from shadelab.build import BuildError
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence import CppRunner, Draw, Evaluate
from shadelab.manifest import Assignment, Function, Scene
from shadelab.mistakes import slide_formulas, write_submission
from shadelab.paths import EXPECTED, FRAMEWORK, RENDER, ROOT, shown
from shadelab.sandbox import Limits, Sandbox
from shadelab.tables import jittered, make_table, on_gate, renormalised
from shadelab.toml_files import read_toml

PUBLIC_SEED = 6837

# The film's channels with all layers, in the order of film.hpp.
CHANNELS = {
    "total": slice(0, 3), "ambient": slice(3, 6), "diffuse": slice(6, 9), "specular": slice(9, 12),
    "coverage": slice(12, 13), "id": slice(13, 14), "depth": slice(14, 15), "normal": slice(15, 18), "position": slice(18, 21),
}  # fmt: skip

TERM_CHANNELS = 13  # those up to coverage: what a submission's image holds

# Values of a mask.
BACKGROUND, INTERIOR, EDGE = 0, 1, 2


@dataclass
class SceneTruth:
    layers: Mapping[str, np.ndarray]  # by the names of CHANNELS, (H, W, n) float32
    mask: np.ndarray  # (H, W) uint8
    eye: np.ndarray
    scale: float  # of the scene: the 95th percentile of |total| over the foreground

    @classmethod
    def of(cls, image: np.ndarray, eye: np.ndarray, pixel_angle: float) -> "SceneTruth":
        """From an image with all CHANNELS."""
        layers = {name: np.ascontiguousarray(image[..., channels]) for name, channels in CHANNELS.items()}
        foreground = layers["id"][..., 0] > 0
        scale = np.percentile(np.abs(layers["total"][foreground]), 95) if foreground.any() else 1.0
        return cls(layers, scene_mask(image, eye, pixel_angle), eye, float(scale))

    @classmethod
    def load(cls, file: Path) -> "SceneTruth":
        data = np.load(file, allow_pickle=False)  # reads a member when it is asked for
        return cls(data, data["mask"], data["eye"], float(data["scale"]))

    def save(self, file: Path) -> None:
        np.savez(file, mask=self.mask, eye=self.eye, scale=self.scale, **self.layers)

    @cached_property
    def total(self) -> np.ndarray:
        return self.layers["total"]


@dataclass
class Table:
    """What a function is judged by."""

    rows: np.ndarray  # (N, columns) float32
    truth: np.ndarray  # (N, results) float64
    floor: np.ndarray  # as truth: what rounding of the inputs alone may change


@dataclass
class Expected:
    folder: Path

    @cached_property
    def functions(self) -> dict[str, np.ndarray]:
        return dict(np.load(self.folder / "functions.npz", allow_pickle=False))

    def table(self, function: Function) -> Table:
        return Table(*(self.functions[f"{function.name}.{part}"] for part in ("rows", "truth", "floor")))

    def scene(self, scene: Scene) -> SceneTruth:
        return SceneTruth.load(self.folder / f"{scene.name}.npz")

    def packet(self, scene: Scene) -> Path:
        return self.folder / f"{scene.name}.packet"


def scene_meshes(scene: Scene) -> list[Path]:
    """The mesh files that the scene names."""
    objects = read_toml(scene.file).get("object", [])
    meshes = [
        (scene.file.parent / o["mesh"]).resolve()
        for o in objects
        if isinstance(o, dict) and isinstance(o.get("mesh"), str)
    ]
    return list(dict.fromkeys(meshes))


def missing_meshes(scene: Scene) -> list[Path]:
    """Those that this machine lacks (a scanned one is fetched at set-up, where that is possible)."""
    return [mesh for mesh in scene_meshes(scene) if not mesh.exists()]


def scene_mask(layers: np.ndarray, eye: np.ndarray, pixel_angle: float) -> np.ndarray:
    """Which pixels are judged strictly. An edge is a change of object, a jump of depth or a jump of the normal between
    neighbours, dilated by one pixel; never a change of triangle, which would leave no interior on dense meshes.

    pixel_angle: the angle that a pixel spans, radians.
    """
    ids, normal = layers[..., CHANNELS["id"]][..., 0], layers[..., CHANNELS["normal"]]
    position = layers[..., CHANNELS["position"]].astype(np.float64)
    footprint = np.linalg.norm(position - eye, axis=2) * pixel_angle
    edge = np.zeros(ids.shape, bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, ids.shape[0] - dy), slice(max(0, -dx), ids.shape[1] - max(0, dx)))
        b = (slice(dy, None), slice(max(0, dx), ids.shape[1] + min(0, dx)))
        # A neighbour farther from the tangent plane than three pixels' footprints lies on another part of the surface.
        off_plane = np.abs(np.sum((position[b] - position[a]) * normal[a], axis=2))
        jump = (ids[a] != ids[b]) | (off_plane > 3 * np.maximum(footprint[a], footprint[b]))
        jump |= (ids[a] > 0) & (np.sum(normal[a] * normal[b], axis=2) < 0.95)
        edge[a] |= jump
        edge[b] |= jump
    wide = edge.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            rows, columns = slice(max(0, dy), ids.shape[0] + min(0, dy)), slice(max(0, dx), ids.shape[1] + min(0, dx))
            source = (slice(max(0, -dy), ids.shape[0] + min(0, -dy)), slice(max(0, -dx), ids.shape[1] + min(0, -dx)))
            wide[rows, columns] |= edge[source]
    return np.where(wide, EDGE, np.where(ids > 0, INTERIOR, BACKGROUND)).astype(np.uint8)


def digest(assignment: Assignment) -> str:
    """Of everything that the expected data depends on: code, manifests, scenes, meshes."""
    here = Path(__file__).parent
    files = [
        here / name for name in ("build.py", "evidence.py", "expected.py", "hidden.py", "manifest.py", "tables.py")
    ]
    files += [FRAMEWORK / "interface.toml", ROOT / "CMakeLists.txt"]
    for folder in ("include", "src", "render"):
        files += sorted(f for f in (FRAMEWORK / folder).rglob("*") if f.is_file())
    pending = [assignment]
    while pending:
        one = pending.pop()
        files += [one.directory / "assignment.toml", *(one.directory / name for name in one.files)]
        pending += one.given
    for scene in assignment.scenes:
        files.append(scene.file)
        objects = read_toml(scene.file).get("object", [])
        files += [(scene.file.parent / o["mesh"]).resolve() for o in objects]
    total = hashlib.sha256()
    if slides := slide_formulas(assignment):
        total.update(repr(slides.bodies).encode())
    for file in dict.fromkeys(files):
        total.update(str(file.name).encode() + b"\0" + (file.read_bytes() if file.exists() else b"absent") + b"\0")
    return total.hexdigest()[:32]


def load(assignment: Assignment, progress: Callable[[str], None] = lambda _: None) -> Expected:
    """The expected data, made first when there is none for the present solution and scenes."""
    folder = EXPECTED / assignment.name / digest(assignment)
    if not (folder / "done").exists():
        make(assignment, folder, progress)
    os.utime(folder)  # its age counts from the last use
    return Expected(folder)


def make_truth(assignment: Assignment, function: Function, forms: list[CppRunner]) -> Table:
    """forms: the solution, and the slides' formulas. They are equal on exact unit vectors; how much rounding of the inputs changes
    depends on the form, and nobody has to know a better one than the slides'."""
    rows = make_table(assignment, function, PUBLIC_SEED)
    exact = renormalised(assignment, function, rows)
    inputs = np.concatenate([exact, *jittered(assignment, function, exact)])
    results = []
    for form in forms:
        output = form.evaluate(Evaluate(function, inputs))
        if output.array is None:
            raise UserError(f"{shown(assignment.directory)}: {function.name} {output.failure}")
        results.append(output.array.reshape(-1, len(rows), output.array.shape[1]))
    truth = results[0][0]
    with np.errstate(invalid="ignore"):
        floor = np.nan_to_num(np.abs(np.concatenate(results)[1:] - truth)).max(axis=0)
    return Table(rows, truth, np.where(on_gate(function, len(rows))[:, None], 0.0, floor))


def make(assignment: Assignment, folder: Path, progress: Callable[[str], None]) -> None:
    progress(f"reference {assignment.name}: building the solution in double")
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(
        tempfile.mkdtemp(prefix="making-", dir=folder.parent)
    )  # its own: two runs may make the same data at once
    sandbox = Sandbox(scratch / "work")
    runner = CppRunner(assignment, sandbox, double=True)
    try:
        runner.build(assignment.directory)
    except BuildError as error:
        raise UserError(f"{shown(assignment.directory)}: the solution does not compile: {error.message}") from None
    forms = [runner]
    if slides := slide_formulas(assignment):
        write_submission(assignment, slides, scratch / "slides")
        forms.append(CppRunner(assignment, sandbox, double=True))
        try:
            forms[-1].build(scratch / "slides")
        except BuildError as error:
            raise UserError(f"{shown(assignment.directory)}: {slides.id} does not compile: {error.message}") from None
        shutil.rmtree(scratch / "slides")
    arrays: dict[str, np.ndarray] = {}
    for function in assignment.functions:
        progress(f"reference {assignment.name}: {function.name}")
        table = make_truth(assignment, function, forms)
        for part in ("rows", "truth", "floor"):
            arrays[f"{function.name}.{part}"] = getattr(table, part)
    np.savez(scratch / "functions.npz", **arrays)
    for scene in assignment.scenes:
        if missing_meshes(scene):
            continue
        progress(f"reference {assignment.name}: {scene.name}")
        output = runner.draw(Draw(scene, layers="all"))
        if output.array is None:
            raise UserError(f"{shown(scene.file)}: {output.failure}")
        camera = read_toml(scene.file)["camera"]
        eye = np.array(camera["eye"], float)
        pixel_angle = np.radians(camera.get("fov_y", 40)) / output.array.shape[0]
        SceneTruth.of(output.array, eye, pixel_angle).save(scratch / f"{scene.name}.npz")
        packet = [
            str(RENDER), "packet", str(scene.file), "--assignment", str(assignment.directory), "--terms",
            "-o", str(scratch / f"{scene.name}.packet"),
        ]  # fmt: skip
        outcome = sandbox.run(packet, Limits(seconds=60))
        if not outcome.ok:
            raise InfrastructureError(f"{shown(scene.file)}: {outcome.stderr.strip()}")
    shutil.rmtree(scratch / "work")
    (scratch / "done").touch()
    try:
        scratch.rename(folder)
    except OSError:  # another run was faster, or one was cut off before it was done
        if not (folder / "done").exists():
            shutil.rmtree(folder)
            scratch.rename(folder)
        else:
            shutil.rmtree(scratch)
    # Older data of this assignment serves nobody for long: its digest will not come back. A run may still be reading it.
    for other in folder.parent.iterdir():
        try:
            unused = time.time() - other.stat().st_mtime
        except FileNotFoundError:
            continue
        if other != folder and unused > 3600:
            shutil.rmtree(other, ignore_errors=True)
