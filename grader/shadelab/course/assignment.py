"""What an assignment declares: functions with their domains, scenes, points. The grader knows assignments only through this.

The renderer alone reads assignment.toml. What it understood stands in the glue folder (assignment.json) and is loaded here;
the files that only the grader needs (hidden.toml, stability.toml, checks/) stand beside the manifest and are read by the
modules beside this one.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.checks import CustomCheck, custom_checks
from shadelab.course.hidden import Hidden, hidden_scene_files, load_hidden
from shadelab.course.stability import Stable, load_stability
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.machine import renderer
from shadelab.machine.glue import MANIFEST, UNDERSTOOD, glue_folder
from shadelab.paths import SOLUTION, shown

# The number of columns that a value of each type flattens to; a struct's are its members'.
WIDTHS = {"Real": 1, "int": 1, "vec2": 2, "vec3": 3, "vec4": 4}


@dataclass(frozen=True)
class Domain:
    """Where a value lies. `kind` is unit, upper, position, rgb, cosine, angle, range or struct."""

    kind: str = "range"
    type: str = "Real"
    base: str | None = None  # of upper(base) and upper(-base): the unit argument that spans the hemisphere
    opposite: bool = False  # upper(-base)
    range: tuple[float, float] | None = None
    typical: tuple[float, float] | None = None
    scale: str = "linear"

    @property
    def width(self) -> int:
        return WIDTHS[self.type]


@dataclass(frozen=True)
class Value:
    """An argument of a function or a member of a struct."""

    name: str
    domain: Domain


@dataclass(frozen=True)
class Column:
    """One number of a flattened value: `m.kd[2]` has path "m.kd", index 2, width 3."""

    path: str
    index: int
    width: int
    domain: Domain

    def __str__(self) -> str:
        return self.path if self.width == 1 else f"{self.path}.{'xyzw'[self.index]}"


@dataclass(frozen=True)
class Struct:
    name: str
    values: list[Value]
    columns: list[Column]


@dataclass(frozen=True)
class Function:
    name: str
    values: list[Value]  # its arguments
    returns: str
    inputs: list[Column]  # in the order in which plugins and shaders take them
    outputs: list[Column]  # named `result` or `result.member`
    summary: str = ""
    slide: str = ""
    points: float = 0.0
    is_model: bool = False  # a scene's `model = "..."` can name it
    # Rows of the table that stand on a stated edge case: column -> constant, or the name of the column that it copies.
    gates: list[dict[str, float | list[float] | str]] = field(default_factory=list)

    @property
    def graded(self) -> bool:
        """Without points it is a worked example, or code that students get already written."""
        return self.points > 0

    def columns(self, argument: str) -> list[Column]:
        """Those of one argument."""
        return [c for c in self.inputs if c.path.split(".")[0] == argument]


@dataclass(frozen=True)
class LightKind:
    name: str
    members: list[str]  # of Light: those that a scene file gives


@dataclass
class Scene:
    """A scene file, and the folder of the assignment that declares its models."""

    name: str
    file: Path
    assignment: Path
    points: float = 0.0
    hidden: bool = False  # students see neither its picture nor its file

    @cached_property
    def described(self) -> renderer.Description:
        """What the renderer understood of it; asked for once."""
        return renderer.describe(self.file, self.assignment)

    def missing_meshes(self) -> list[Path]:
        return self.described.missing_meshes()


@dataclass
class Assignment:
    name: str
    title: str
    directory: Path
    glue: Path  # what the renderer understood and generated
    files: list[str]
    given: list["Assignment"]
    structs: dict[str, Struct]
    functions: list[Function]
    light_kinds: list[LightKind]  # numbered as in Light.kind
    light_function: str  # what the framework calls for each light
    fragment: dict[str, str]  # what a fragment holds, by the name that arguments have: normal, position or eye
    models: list[str]  # what a scene's `model` may name, in given assignments, too
    public_scenes: list[Scene]
    hidden: Hidden

    @cached_property
    def solution(self) -> str | None:
        """The C++ of the reference; None in a release, which has none."""
        file = self.directory / "shading.cpp"
        return file.read_text() if file.exists() else None

    @cached_property
    def hidden_scenes(self) -> list[Scene]:
        """Those drawn from hidden.toml. Their files are there once somebody has called draw_hidden_scenes."""
        return [
            Scene(file.stem, file, self.directory, family.points, hidden=True)
            for file, family, _ in hidden_scene_files(self.hidden, self.directory, self.name)
        ]

    @property
    def scenes(self) -> list[Scene]:
        return [*self.public_scenes, *self.hidden_scenes]

    @property
    def check_files(self) -> list[Path]:
        return sorted((self.directory / "checks").glob("test_*.py"))

    @cached_property
    def custom(self) -> list[CustomCheck]:
        return custom_checks(self.check_files)

    @cached_property
    def stability(self) -> dict[str, Stable]:
        """What stability.toml declares, by function."""
        return load_stability(self.directory, [f.name for f in self.functions])

    def function(self, name: str) -> Function:
        for function in self.functions:
            if function.name == name:
                return function
        known = ", ".join(f.name for f in self.functions)
        raise UserError(f"{name}: {self.name} has no such function; it has {known}")

    @property
    def points(self) -> float:
        stability = sum(s.points for s in self.stability.values())
        scenes = sum(s.points for s in self.public_scenes) + sum(f.points * f.scenes for f in self.hidden.family)
        return sum(f.points for f in self.functions) + stability + scenes + sum(c.points for c in self.custom)


def named_arrays(columns: list[Column], rows: np.ndarray) -> dict[str, np.ndarray]:
    """(N, columns) -> {"n": (N, 3), "m.q": (N,), ...}"""
    out: dict[str, np.ndarray] = {}
    for k, column in enumerate(columns):
        if column.index == 0:
            out[column.path] = rows[:, k] if column.width == 1 else rows[:, k : k + column.width]
    return out


def flat_rows(columns: list[Column], arrays: dict[str, np.ndarray], dtype: type = np.float32) -> np.ndarray:
    """The inverse of named_arrays. Raises UserError for missing, unknown or wrongly shaped arrays."""
    wanted = {c.path: c.width for c in columns}
    unknown = sorted(set(arrays) - set(wanted))
    if unknown:
        raise UserError(f"unknown input {unknown[0]}; the inputs are {', '.join(wanted)}")
    parts, counts = [], set()
    for path, width in wanted.items():
        if path not in arrays:
            raise UserError(f"the input {path} is missing; the inputs are {', '.join(wanted)}")
        array = np.asarray(arrays[path], dtype)
        if array.ndim != (1 if width == 1 else 2) or (width > 1 and array.shape[1] != width):
            shape = "(N,)" if width == 1 else f"(N, {width})"
            raise UserError(f"the input {path} must have the shape {shape}, not {array.shape}")
        parts.append(array.reshape(len(array), width))
        counts.add(len(array))
    if len(counts) > 1:
        raise UserError("the inputs must all have the same first axis (the evaluations)")
    return np.ascontiguousarray(np.concatenate(parts, axis=1))


# --------------------------------------------------------------------------------------------------------- loading


def load_assignment(directory: Path) -> Assignment:
    """Raises UserError for a manifest that is wrong."""
    glue = glue_folder(directory)
    told = json.loads((glue / UNDERSTOOD).read_text())
    return Assignment(
        told["name"], told["title"], directory, glue, told["files"],
        [load_assignment(directory.parent / name) for name in told["given"]],
        {s["name"]: Struct(s["name"], _values(s["members"]), _columns(s["columns"])) for s in told["structs"]},
        [_function(f) for f in told["functions"]],
        [LightKind(k["kind"], k["members"]) for k in told["lights"]], told["light_function"],
        {attribute["name"]: attribute["from"] for attribute in told["fragment"]}, told["models"],
        [Scene(s["name"], Path(s["file"]), directory, s["points"]) for s in told["scenes"]],
        load_hidden(directory),
    )  # fmt: skip


def _function(told: Mapping[str, Any]) -> Function:
    same = {key: told[key] for key in ("name", "returns", "summary", "slide", "points", "gates")}
    return Function(
        values=_values(told["arguments"]), inputs=_columns(told["inputs"]), outputs=_columns(told["outputs"]),
        is_model=told["model"], **same,
    )  # fmt: skip


def _values(told: list[Mapping[str, Any]]) -> list[Value]:
    return [Value(v["name"], _domain(v["domain"])) for v in told]


def _columns(told: list[Mapping[str, Any]]) -> list[Column]:
    return [Column(c["path"], c["index"], c["width"], _domain(c["domain"])) for c in told]


def _domain(told: Mapping[str, Any]) -> Domain:
    pairs = {key: tuple(told[key]) for key in ("range", "typical") if told.get(key) is not None}
    return Domain(told["kind"], told["type"], told.get("base"), told["opposite"], scale=told["scale"], **pairs)


def assignment_names() -> list[str]:
    """Those that can be graded: the ones with points."""
    names = sorted(f.parent.name for f in SOLUTION.glob(f"*/{MANIFEST}"))
    return [name for name in names if load_assignment(SOLUTION / name).points > 0]


def find_assignment(submission: Path, name: str | None) -> Assignment:
    """The assignment that a submission answers: by option, by its assignment.toml, or by its folder's name.

    The manifest itself is always ours: a student's copy only tells the name.
    """
    known = assignment_names()
    if name is not None and name not in known:
        raise UserError(f"{name}: there is no such assignment; there is {', '.join(known)}")
    if not submission.is_dir():
        raise UserError(f"{shown(submission)}: there is no such folder; give the one that holds the submission")
    if name is None and (submission / MANIFEST).is_file():
        declared = read_toml(submission / MANIFEST).get("name")
        name = declared if declared in known else None
    if name is None and submission.resolve().name in known:
        name = submission.resolve().name
    if name is None:
        raise UserError(f"{shown(submission)}: which assignment is it? Give --assignment {' or '.join(known)}")
    return load_assignment(SOLUTION / name)


def assignment_of_scene(scene: Path, shading: Path | None = None) -> Assignment:
    """The assignment that declares a scene's models: that of the folder `shading`, of the scene's folder, or the first that
    has them."""
    if shading is not None:
        try:
            return find_assignment(shading, None)
        except UserError:
            if not shading.is_dir():
                raise UserError(f"{shown(shading)}: there is no such folder") from None
            # A folder of any name: the scene tells the assignment.
    names = assignment_names()
    if scene.resolve().parent.name in names:
        return load_assignment(SOLUTION / scene.resolve().parent.name)
    models = renderer.models(scene)
    for name in names:
        declared = load_assignment(SOLUTION / name)
        if models <= {f.name for f in declared.functions}:
            return declared
    raise UserError(f"{shown(scene)}: no assignment declares all of its models ({', '.join(sorted(models))})")
