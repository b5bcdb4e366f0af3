"""What a study declares: studies/NAME.toml, or what is built in for a scene or an assignment.

`kind` says what is varied; the table of the same name holds what only that kind asks for.
"""

from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, model_validator

from shadelab.course.toml_files import Declared, validated
from shadelab.errors import UserError
from shadelab.paths import ROOT, shown

STUDIES = ROOT / "studies"
Model = TypeVar("Model", bound=BaseModel)


class Sampling(Declared):
    """More samples a pixel: error against a converged image."""

    scene: str  # relative to the checkout
    # How many samples a pixel; strata and regular grids take the square numbers among them.
    samples: list[int] = Field([1, 2, 4, 9, 16, 36, 64], min_length=3)
    series: list[Literal["random", "stratified", "regular"]] = Field(["random", "stratified", "regular"], min_length=1)
    size: int = Field(128, ge=16, le=512)  # pixels along the longer side; the scene's picture is drawn so small
    reference: Literal[16, 32, 64] = 64  # a grid of as many by as many samples, in double


class Interpolation(Declared):
    """Flat, Gouraud and Phong interpolation over ever finer spheres: error against the analytic sphere."""

    scene: str  # whose sphere is cut; relative to the checkout
    subdivisions: list[int] = Field(list(range(8)), min_length=3)  # each cuts a triangle of the icosahedron into four
    fit_from: int = 4  # the first subdivision that the slopes are fitted to: coarser ones are not yet in the regime
    size: int = Field(256, ge=16, le=2048)
    facing: float = Field(0.5, gt=0, lt=1)  # the least n.v of a pixel that counts: the outline stays out

    @model_validator(mode="after")
    def _can_be_fitted(self) -> "Interpolation":
        if not all(0 <= level <= 8 for level in self.subdivisions):
            raise ValueError("subdivisions go from 0 to 8")
        if sum(level >= self.fit_from for level in self.subdivisions) < 3:
            raise ValueError(f"a slope takes three subdivisions from fit_from = {self.fit_from} on")
        return self


class Backends(Declared):
    """The same frames by C++ in float, in double, and by GLSL; each with what is needed and with everything."""

    assignments: list[str] = []  # all their public scenes
    scenes: list[str] = []  # and these, relative to the checkout

    @model_validator(mode="after")
    def _something(self) -> "Backends":
        if not self.assignments and not self.scenes:
            raise ValueError("names neither assignments nor scenes")
        return self


_tables: dict[str, type[Declared] | None] = {
    "sampling": Sampling, "interpolation": Interpolation, "backends": Backends, "forms": None,
}  # fmt: skip


class Study(Declared):
    title: str
    kind: Literal["sampling", "interpolation", "backends", "forms"]
    # Timed runs of everything, each point's in turn with all others'. Where samples are drawn at random, each run draws its own.
    repeats: int = Field(9, ge=3, le=1000)
    seed: int = Field(1, ge=0)
    sampling: Sampling | None = None
    interpolation: Interpolation | None = None
    backends: Backends | None = None
    forms: dict[str, Any] | None = None  # forms.py declares what stands there

    @model_validator(mode="after")
    def _one_table(self) -> "Study":
        for name in _tables:
            if (getattr(self, name) is not None) != (name == self.kind):
                missing = f"the table [{name}] is missing" if name == self.kind else f"[{name}] does not belong here"
                raise ValueError(f'kind = "{self.kind}": {missing}')
        return self


def study_names() -> list[str]:
    return sorted(file.stem for file in STUDIES.glob("*.toml"))


def study_file(name: str) -> Path:
    return STUDIES / f"{name}.toml"


def load_study(name: str) -> Study:
    return validated(Study, study_file(name))


def sub_model(model: type[Model], values: dict[str, Any], name: str, table: str) -> Model:
    """A table whose declaration stands in another module; a mistake becomes one line, as in the rest of the file."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in (table, *first["loc"]))
        raise UserError(f"{shown(study_file(name))}: {where}: {first['msg'].lower()}") from None


def declared_scene(text: str, name: str) -> Path:
    file = ROOT / text
    if not file.is_file():
        raise UserError(f"{shown(study_file(name))}: {text}: there is no such scene; paths start at the checkout")
    return file


def studied(what: str, assignments: list[str]) -> tuple[str, Study, Path | None]:
    """SCENE or NAME of the command line: the name under which results go, the study, and the scene for a default one.

    A default study of a scene is of kind "backends" here; run.py draws its samples as well.
    """
    if what in study_names():
        return what, load_study(what), None
    if what in assignments:
        title = f"Backends and leaving out: the scenes of {what}"
        return what, Study(title=title, kind="backends", repeats=11, backends=Backends(assignments=[what])), None
    scene = Path(what)
    if scene.is_file():
        if scene.suffix != ".toml":
            raise UserError(
                f"{shown(scene)}: is no scene file; scenes end in .toml, for example scenes/phong/teapot.toml"
            )
        file = str(scene.resolve())
        title = f"Error against run time: {scene.resolve().parent.name}/{scene.stem}"
        name = f"{scene.resolve().parent.name}-{scene.stem}"
        return name, Study(title=title, kind="backends", repeats=7, backends=Backends(scenes=[file])), scene
    if scene.suffix == ".toml" or "/" in what:
        raise UserError(f"{what}: cannot be read; does the file exist? Scenes stand in scenes/ASSIGNMENT")
    known = ", ".join(study_names()) or "none"
    raise UserError(
        f"{what}: is no study ({known}), no assignment ({', '.join(assignments)}) and no scene file;"
        f" declare a study in {shown(STUDIES)}/{what}.toml or give one of these"
    )
