"""What the benchmark measures: scenes/bench/bench.toml."""

from pathlib import Path

import tomli_w
from pydantic import Field

from shadelab.course.toml_files import Declared, read_toml, validated
from shadelab.paths import SCENES, SOLUTION

FOLDER = SCENES / "bench"


class Look(Declared):
    """A scene of the folder, drawn with an assignment's solution."""

    name: str  # as in the names of measurements: sphere-1k/LOOK/1s
    heading: str  # of its column in the README
    scene: str
    assignment: str
    shaded: bool = True  # otherwise depth alone

    @property
    def directory(self) -> Path:
        return SOLUTION / self.assignment


class Viewpoint(Declared):
    eye: list[float]
    target: list[float]


class Place(Declared):
    mesh: str
    look: str


class Supersampling(Declared):
    size: int
    assignment: str
    scenes: dict[str, str]


class Declaration(Declared):
    size: int = Field(ge=16)
    meshes: list[str]
    samples: list[int]
    quick: list[str]
    load: list[str]
    full: list[Place]
    threads: list[Place]
    look: list[Look]
    view: dict[str, Viewpoint] = {}
    supersampling: Supersampling

    def look_named(self, name: str) -> Look:
        return next(look for look in self.look if look.name == name)

    def write_scene(self, scene: str, mesh: str | None, file: Path) -> Path:
        """The scene with another mesh in the place of its own, and the camera where that is seen whole."""
        content = read_toml(FOLDER / scene)
        for entry in content["object"]:
            entry["mesh"] = str(mesh_file(mesh) if mesh else (FOLDER / entry["mesh"]).resolve())
        if mesh in self.view:
            content["camera"] |= self.view[mesh].model_dump()
        file.write_text(tomli_w.dumps(content))
        return file


def load_declaration() -> Declaration:
    return validated(Declaration, FOLDER / "bench.toml")


def mesh_file(mesh: str) -> Path:
    return SCENES / "meshes" / f"{mesh}.obj"
