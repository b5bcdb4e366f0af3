"""Expected data: all that grading knows of a solution. making.py makes it; a release carries its public part.

In its folder stand
    facts.json          what holds for the whole assignment: which functions call which, the measured spread of correct programs
    extremes.npz        per function: the members of its StableTable, for stability
    functions.npz       per function: FUNCTION.rows (float32 inputs), FUNCTION.truth and FUNCTION.conditioning (float64), and
                        FUNCTION.scenes, of which scene each row is
    mistakes.npz        ID/BACKEND/FUNCTION: what the declared mistakes give for the same inputs
    hypotheses.npz      per function, one after the other: what the reference gives with one thing changed; and inner quantities
    SCENE.npz           the film's layers (float32), the mask of pixels that are judged, and the noise of each pixel
    SCENE.json          what holds for the whole scene: eye, lights, scale, spread, the solution's run times
    SCENE.packet        the frame packet for the OpenGL client
    done                the digest of all that it depends on; written last: a set without it is made again
"""

import hashlib
import io
import json
import os
import threading
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene
from shadelab.machine import renderer
from shadelab.machine.glue import glue_folder
from shadelab.paths import STATE
from shadelab.truth.extremes import StableTable

# The film's channels with all layers, in the order of film.hpp.
CHANNELS = {
    "total": slice(0, 3), "ambient": slice(3, 6), "diffuse": slice(6, 9), "specular": slice(9, 12),
    "coverage": slice(12, 13), "id": slice(13, 14), "depth": slice(14, 15), "normal": slice(15, 18), "position": slice(18, 21),
}  # fmt: skip

TERM_CHANNELS = 13  # those up to coverage: what a submission's image holds

# Values of a mask.
BACKGROUND, INTERIOR, EDGE = 0, 1, 2


# ------------------------------------------------------------------------------------------------------- functions


@dataclass
class Table:
    """What a function is judged by."""

    rows: np.ndarray  # (N, columns) float32: `drawn` ones from the domains, then those recorded from scenes
    truth: np.ndarray  # (N, results) float64
    conditioning: np.ndarray  # as truth: how far rounding of the inputs alone moves it
    drawn: int
    scenes: np.ndarray | None = (
        None  # (N,) of which recorded scene a row is, by its place in Facts.recorded; -1: of none
    )

    @cached_property
    def scales(self) -> list[float]:
        """The 95th percentile of |truth| of each column."""
        return np.percentile(np.where(np.isfinite(self.truth), np.abs(self.truth), 0.0), 95, axis=0).tolist()


@dataclass(frozen=True)
class Hypothesis:
    """What the reference gives with one thing changed (hypotheses.py)."""

    words: str  # what is changed: after "as those of the reference"
    function: str  # in which the change stands
    rows: np.ndarray  # (K,) those of the table that are known
    values: np.ndarray  # (K, results) float32
    everywhere: bool  # whether it equals the truth on all other rows; else nothing is known of them


TABLE = ("rows", "truth", "conditioning", "scenes")


@dataclass
class Facts:
    calls: dict[str, list[str]]  # function -> those of the assignment that it calls, directly or through others
    loops: list[str]  # the shading loops that the scenes need
    # function -> backend -> program -> its scaled error: what correct programs differ by, but for single rows
    spread: dict[str, dict[str, dict[str, float]]]
    farthest: dict[str, dict[str, dict[str, float]]]  # as spread: what each differs by on its worst row
    mistakes: list[dict[str, str]]  # id, function and hint of each
    gl: str  # the driver that the spread was measured with
    changes: dict[str, list[str]]  # function -> the inputs that its result changes with
    recorded: list[str]  # the scenes of which tables hold rows
    cases: dict[str, list[str]]  # function -> the names of its cases for stability
    driver: dict[str, float]  # how far its own functions are off: exp, log, pow5, sin, inversesqrt


@dataclass
class Expected:
    folder: Path

    @cached_property
    def digest(self) -> str:
        return (self.folder / "done").read_text().strip()

    @cached_property
    def facts(self) -> Facts:
        return Facts(**json.loads((self.folder / "facts.json").read_text()))

    @cached_property
    def functions(self) -> dict[str, np.ndarray]:
        return dict(np.load(self.folder / "functions.npz", allow_pickle=False))

    @cached_property
    def mistakes(self) -> Mapping[str, np.ndarray]:
        return np.load(self.folder / "mistakes.npz", allow_pickle=False)  # reads a member when it is asked for

    @cached_property
    def _hypotheses(self) -> Mapping[str, np.ndarray]:
        return np.load(self.folder / "hypotheses.npz", allow_pickle=False)

    def hypotheses(self, function: Function) -> list["Hypothesis"]:
        """Those of one function, the plainest first."""
        arrays, name = self._hypotheses, function.name
        if f"{name}.words" not in arrays:
            return []
        parts = (arrays[f"{name}.{part}"] for part in ("words", "functions", "ends", "everywhere", "rows", "values"))
        words, functions, ends, everywhere, rows, values = parts
        return [
            Hypothesis(str(w), str(f), r, v, bool(e))
            for w, f, e, r, v in zip(
                words, functions, everywhere, np.split(rows, ends[:-1]), np.split(values, ends[:-1])
            )
        ]

    def inner(self, function: Function) -> dict[str, np.ndarray]:
        """The quantities that the reference computes on its way to a result, by name: (N, 1) or (N, 3), NaN where it does not."""
        start = f"{function.name}.inner."
        return {key.removeprefix(start): self._hypotheses[key] for key in self._hypotheses if key.startswith(start)}

    def table(self, function: Function) -> Table:
        parts = {part: self.functions[f"{function.name}.{part}"] for part in TABLE}
        return Table(**parts, drawn=int(self.functions["drawn"]))

    @cached_property
    def extremes(self) -> Mapping[str, np.ndarray]:
        return np.load(self.folder / "extremes.npz", allow_pickle=False)

    def stable_table(self, function: Function) -> StableTable:
        parts = [part for part in StableTable.__dataclass_fields__ if part != "cases"]
        arrays = {part: self.extremes[f"{function.name}.{part}"] for part in parts}
        return StableTable(**arrays, cases=self.facts.cases[function.name])

    def driver(self, backend: str) -> float:
        """What the driver's own functions may be off; the compiler's library is exact beside that."""
        return max(self.facts.driver.values()) if backend == "glsl" else 0.0

    def floor(self, function: Function, backend: str, strays: bool = False) -> float:
        """The largest scaled error of a correct program (measures.py says what is done with it). strays: on single rows, too."""
        errors = self.facts.farthest if strays else self.facts.spread
        return max(errors[function.name][backend].values())

    def scene(self, scene: Scene) -> "SceneTruth":
        return SceneTruth.load(self.folder / f"{scene.name}.npz")

    def packet(self, scene: Scene) -> Path:
        """A release carries none: they repeat the meshes, of which one is not ours to hand on. There they are made when they are
        wanted, and kept by what they are made from."""
        file = self.folder / f"{scene.name}.packet"
        if file.exists():
            return file
        sources = [scene.file, *scene.described.meshes]
        made_from = hashlib.sha256(b"".join(f.read_bytes() for f in sources)).hexdigest()[:16]
        glue = glue_folder(scene.assignment).name
        file = STATE / "packets" / f"{glue}-{scene.name}-{made_from}.packet"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            temporary = file.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
            renderer.packet(scene.file, scene.assignment, temporary, renderer.View("terms"))
            os.replace(temporary, file)
        return file


def with_callers(names: set[str], calls: dict[str, list[str]]) -> set[str]:
    """These functions and those that call them, directly or through others."""
    while True:
        grown = names | {f for f, callees in calls.items() if names & set(callees)}
        if grown == names:
            return names
        names = grown


def with_callees(names: set[str], calls: dict[str, list[str]]) -> set[str]:
    """These functions and those that they call, directly or through others."""
    while True:
        grown = names.union(*(calls.get(f, []) for f in names))
        if grown == names:
            return names
        names = grown


# ---------------------------------------------------------------------------------------------------------- scenes


@dataclass
class SceneFacts:
    eye: list[float]
    scale: float  # the 95th percentile of |total| over the foreground
    lights: list[dict[str, Any]] = field(default_factory=list)  # members of Light, by name
    # What correct programs differ by, relative to |total| + 1 % of the scale, but for FULL_MARKS of the pixels; by program
    spread: dict[str, float] = field(default_factory=dict)
    share: float = 0.0  # of the interior that a correct program has beyond the limits that the others set
    runs: list[dict[str, Any]] = field(default_factory=list)  # the solution's points of error against run time


@dataclass
class SceneTruth:
    layers: Mapping[str, np.ndarray]  # by the names of CHANNELS, (H, W, n) float32
    mask: np.ndarray  # (H, W) uint8
    facts: SceneFacts
    noise: np.ndarray  # (H, W): how far a shift of 1/16 pixel moves the total here

    @classmethod
    def of(cls, image: np.ndarray, eye: np.ndarray, pixel_angle: float) -> "SceneTruth":
        """From an image with all CHANNELS; the noise is not measured yet."""
        layers = {name: np.ascontiguousarray(image[..., channels]) for name, channels in CHANNELS.items()}
        foreground = layers["id"][..., 0] > 0
        scale = float(np.percentile(np.abs(layers["total"][foreground]), 95)) if foreground.any() else 1.0
        facts = SceneFacts(eye=np.asarray(eye, float).tolist(), scale=scale)
        return cls(layers, scene_mask(image, eye, pixel_angle), facts, np.zeros(image.shape[:2], np.float32))

    @classmethod
    def load(cls, file: Path) -> "SceneTruth":
        data = np.load(file, allow_pickle=False)  # reads a member when it is asked for
        facts = SceneFacts(**json.loads(file.with_suffix(".json").read_text()))
        return cls(data, data["mask"], facts, data["noise"])

    def save(self, file: Path) -> None:
        """Compressed to a third, at the level that takes least time: to read it back costs a hundredth of a second a layer."""
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in {"mask": self.mask, "noise": self.noise, **self.layers}.items():
                np.save(written := io.BytesIO(), array)
                archive.writestr(f"{name}.npy", written.getvalue())
        file.with_suffix(".json").write_text(json.dumps(asdict(self.facts)))

    @cached_property
    def total(self) -> np.ndarray:
        return self.layers["total"]

    @property
    def eye(self) -> np.ndarray:
        return np.array(self.facts.eye)

    @property
    def scale(self) -> float:
        return self.facts.scale

    @property
    def lights(self) -> list[dict[str, Any]]:
        return self.facts.lights


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
    wide = largest_nearby(edge)
    return np.where(wide, EDGE, np.where(ids > 0, INTERIOR, BACKGROUND)).astype(np.uint8)


def largest_nearby(values: np.ndarray) -> np.ndarray:
    """(H, W): the largest of each pixel and its eight neighbours."""
    out = values.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            rows, columns = slice(max(0, dy), len(out) + min(0, dy)), slice(max(0, dx), out.shape[1] + min(0, dx))
            source = (slice(max(0, -dy), len(out) + min(0, -dy)), slice(max(0, -dx), out.shape[1] + min(0, -dx)))
            out[rows, columns] = np.maximum(out[rows, columns], values[source])
    return out


def public_files(expected: Expected, assignment: Assignment) -> list[Path]:
    """What a release may carry: nothing of hidden scenes."""
    hidden = {scene.name for scene in assignment.scenes if scene.hidden}
    return sorted(f for f in expected.folder.iterdir() if f.is_file() and f.stem not in hidden)
