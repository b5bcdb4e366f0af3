"""The one door to the C++ framework: each call of shadelab-render, typed, with the files that it reads and writes.

describe, packet, glue and convert run no student's code: they are run here, and what goes wrong is one line, the user's
fault (exit code 2) or ours. image, evaluate and frames load a plugin: they are commands, for whoever runs them behind a
sandbox and knows whose code it is.
"""

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shadelab.errors import InfrastructureError, UserError
from shadelab.machine.command import Command
from shadelab.paths import FRAMEWORK, RENDER

SECONDS = 600  # a call without a student's code ends long before

Layers = Literal["total", "terms", "all", "depth", "visibility"]
_layers = {"total": [], "terms": ["--terms"], "all": ["--layers"], "depth": ["--depth"], "visibility": ["--visibility"]}


@dataclass(frozen=True)
class View:
    """How a scene is to be drawn. What is not given is as the scene's film says."""

    layers: Layers = "total"
    size: str | None = None  # WxH
    samples: int | None = None
    supersample: int | None = None
    shift: tuple[float, float] = (0.0, 0.0)  # the picture moves so many pixels right and up
    full: bool = False  # leave nothing out
    keep: str = ""  # leave all out but this, as `Needs.names` calls it

    def arguments(self) -> list[str]:
        out = list(_layers[self.layers])
        for name, value in {"--size": self.size, "--samples": self.samples, "--supersample": self.supersample}.items():
            out += [name, str(value)] if value is not None else []
        out += [f"--shift={float(self.shift[0])!r},{float(self.shift[1])!r}"] if any(self.shift) else []
        return [*out, *(["--full"] if self.full else []), *(["--keep", self.keep] if self.keep else [])]


AS_IT_IS = View()


# ------------------------------------------------------------------------------------------------- without student code


@dataclass(frozen=True)
class Needs:
    """What a scene's plugin must hold, and what is left out."""

    terms: bool
    loops: list[str]  # MODEL_KIND
    needed: list[str]  # a line each
    left_out: list[str]
    names: list[str]  # of what is left out, in the same order; "": nothing that could be kept


@dataclass(frozen=True)
class SceneObject:
    mesh: Path
    material: str
    model: str
    interpolation: str  # phong | gouraud
    to_world: np.ndarray  # (4, 4) float64
    parameters: np.ndarray  # of its material: the members of the model's struct, flattened, float64


@dataclass(frozen=True)
class Description:
    """A scene as the renderer understood it. Places are relative to `origin`, which is 0 but for scenes far from it."""

    file: Path
    width: int
    height: int
    samples: int
    eye: np.ndarray  # (3,) float64
    fov_y: float  # radians
    camera: dict[str, Any]
    world_to_clip: np.ndarray  # (4, 4) float64
    origin: np.ndarray
    lights: np.ndarray  # (N, columns of Light) float64
    objects: list[SceneObject]
    calls: list[str]  # the functions that the framework calls: the models, and those that give the light
    manifests: list[Path]  # that declare them: the assignment's, and those of given ones
    needs: Needs

    @property
    def meshes(self) -> list[Path]:
        return list(dict.fromkeys(o.mesh for o in self.objects))

    def missing_meshes(self) -> list[Path]:
        """Those that this machine lacks (a scanned one is fetched at set-up, where that is possible)."""
        return [mesh for mesh in self.meshes if not mesh.exists()]


def describe(scene: Path, assignment: Path, view: View = AS_IT_IS, explain: bool = False) -> Description:
    """Loads no mesh, unless `explain` asks for all that is needed and left out."""
    options = [*view.arguments(), *(["--explain"] if explain else [])]
    told = _told("describe", str(scene), "--assignment", str(assignment), *options)
    camera, film = told["camera"], told["film"]
    materials = {m["name"]: np.array(m["parameters"], float) for m in told["materials"]}
    return Description(
        scene, film["width"], film["height"], film["samples"], np.array(camera["eye"], float), camera["fov_y"], camera,
        _matrix(camera["world_to_clip"]), np.array(told["origin"], float),
        np.array([light["columns"] for light in told["lights"]], float),
        [
            SceneObject(
                Path(o["mesh"]), o["material"], o["model"], o["interpolation"], _matrix(o["to_world"]), materials[o["material"]]
            )
            for o in told["objects"]
        ],
        told["calls"], [Path(m) for m in told["manifests"]], Needs(**told["needs"]),
    )  # fmt: skip


def models(scene: Path) -> set[str]:
    """What its materials name as models: nothing else of the scene is looked at, and no assignment is needed."""
    return set(_told("models", str(scene))["models"])


def packet(scene: Path, assignment: Path, output: Path, view: View = AS_IT_IS) -> str:
    """Writes a frame packet. Returns the renderer's notes."""
    return _run("packet", str(scene), "--assignment", str(assignment), *view.arguments(), "-o", str(output)).stderr


def glue(assignment: Path, folder: Path) -> None:
    """Writes what the renderer understood of a manifest (assignment.json), and the code that it generated from it."""
    _run("glue", str(assignment), str(folder))


def convert(image: Path, output: Path, exposure: float = 0.0) -> None:
    """Writes an image that is an .npy file as .png or .exr."""
    _run("convert", str(image), "-o", str(output), "--exposure", str(exposure))


def _told(*arguments: str) -> dict[str, Any]:
    try:
        return json.loads(_run(*arguments).stdout)
    except ValueError:
        raise InfrastructureError(f"{RENDER.name} {arguments[0]}: what it prints is no JSON") from None


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    try:
        done = subprocess.run(
            [str(RENDER), *arguments], stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=SECONDS
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InfrastructureError(f"{RENDER.name} {arguments[0]}: {error}") from None
    if done.returncode == 2:
        raise UserError(done.stderr.strip())
    if done.returncode:
        said = done.stderr.strip() or f"ended with exit code {done.returncode}"
        raise InfrastructureError(f"{RENDER.name} {arguments[0]}: {said}")
    return done


def _matrix(columns: Sequence[float]) -> np.ndarray:
    return np.array(columns, float).reshape(4, 4).T


# --------------------------------------------------------------------------------------------------- with a plugin


@dataclass(frozen=True)
class ImageFiles:
    """Where an image goes, and what is told beside it."""

    output: Path | None = None
    statistics: Path | None = None
    repeat: int = 0  # further frames, whose seconds stand in the statistics
    exposure: float | None = None
    threads: int | None = None
    explain: bool = False
    full_plugin: Path | None = None  # with explain: what leaves nothing out, to measure with
    follow: Path | None = (
        None  # a folder of recorded outputs that stand in for functions (truth/follow.py); written to as well
    )


def image(description: Description, assignment: Path, plugin: Path, view: View, files: ImageFiles) -> Command:
    arguments = ["image", *_scene(description.file, assignment, view), "--plugin", str(plugin)]
    for name, value in {
        "-o": files.output, "--statistics": files.statistics, "--exposure": files.exposure, "--threads": files.threads,
        "--full-plugin": files.full_plugin, "--follow": files.follow,
    }.items():  # fmt: skip
        arguments += [name, str(value)] if value is not None else []
    arguments += ["--repeat", str(files.repeat)] if files.repeat else []
    arguments += ["--explain"] if files.explain else []
    reads = [*_scene_files(description), plugin, *(f for f in (files.full_plugin, files.follow) if f)]
    return _command(arguments, reads, [f for f in (files.output, files.statistics, files.follow) if f])


def evaluate(
    plugin: Path, function: str, rows: Path, results: Path, follow: Path | None = None, repeat: int = 0,
    statistics: Path | None = None, trace: Path | None = None, bodies: tuple[int, ...] = (),
) -> Command:  # fmt: skip
    """`follow`: as of ImageFiles. `trace`: what the function compares goes there (traced.hpp). `bodies`: as of Evaluate."""
    arguments = ["evaluate", str(plugin), function, str(rows), str(results)]
    arguments += ["--follow", str(follow)] if follow else []
    arguments += ["--repeat", str(repeat), "--statistics", str(statistics)] if statistics else []
    arguments += ["--trace", str(trace)] if trace else []
    arguments += ["--bodies", ",".join(map(str, bodies))] if bodies else []
    writes = [f for f in (results, follow, statistics, trace) if f]
    return _command(arguments, [plugin, rows, *([follow] if follow else [])], writes)


def frames(
    description: Description, assignment: Path, plugin: Path | None, view: View, threads: int | None = None, double: bool = False
) -> Command:  # fmt: skip
    """Stands by and draws on request, a line on stdin each. Without a plugin nothing is shaded; `double` is for depth alone."""
    arguments = ["frames", *_scene(description.file, assignment, view)]
    arguments += ["--plugin", str(plugin)] if plugin else []
    arguments += ["--threads", str(threads)] if threads else []
    arguments += ["--double"] if double else []
    return _command(arguments, [*_scene_files(description), *([plugin] if plugin else [])], [])


def _scene(scene: Path, assignment: Path, view: View) -> list[str]:
    return [str(scene), "--assignment", str(assignment), *view.arguments()]


def _scene_files(description: Description) -> list[Path]:
    return [description.file, *description.meshes, *description.manifests, FRAMEWORK / "interface.toml"]


def _command(arguments: list[str], reads: Sequence[Path], writes: Sequence[Path]) -> Command:
    return Command((str(RENDER), *arguments), reads=(RENDER.parent, *reads), writes=tuple(writes))
