"""What an assignment declares: functions with their domains, scenes, points. The grader knows assignments only through this."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from shadelab.course.hidden import Hidden, hidden_scene_files
from shadelab.course.stability import Stable, load_stability
from shadelab.course.toml_files import Declared, read_toml, validated
from shadelab.errors import UserError
from shadelab.paths import FRAMEWORK, SOLUTION, shown

# The number of columns that a value of each type flattens to.
_widths = {"Real": 1, "int": 1, "vec2": 2, "vec3": 3, "vec4": 4}
_types = {"unit": "vec3", "position": "vec3", "rgb": "vec3", "cosine": "Real", "angle": "Real"}


class Domain(Declared):
    """Where an argument's values lie. `kind` is unit, upper, position, rgb, cosine, angle, range or struct."""

    kind: str = "range"
    type: str = "Real"
    base: str | None = None  # of upper(base) and upper(-base): the unit argument that spans the hemisphere
    opposite: bool = False  # upper(-base)
    range: tuple[float, float] | None = None
    typical: tuple[float, float] | None = None
    scale: str = "linear"

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: Any) -> Any:
        if not isinstance(data, str):
            return data
        if data.startswith("upper(") and data.endswith(")"):
            base = data[6:-1]
            return {"kind": "upper", "type": "vec3", "base": base.removeprefix("-"), "opposite": base.startswith("-")}
        if data in _types:
            return {"kind": data, "type": _types[data]}
        return {"kind": "struct", "type": data}


@dataclass(frozen=True)
class Value:
    """An argument of a function or a member of a struct."""

    name: str
    domain: Domain


def _values(entries: list[dict[str, Domain]]) -> list[Value]:
    return [Value(name, domain) for entry in entries for name, domain in entry.items()]


class Struct(Declared):
    name: str
    members: list[dict[str, Domain]]

    @property
    def values(self) -> list[Value]:
        return _values(self.members)


class Function(Declared):
    name: str
    arguments: list[dict[str, Domain]]
    returns: str
    summary: str = ""
    slide: str = ""
    points: float = Field(0, ge=0)
    # Rows of the table that stand on a stated edge case: column -> constant, or the name of the column that it copies.
    gates: list[dict[str, float | list[float] | str]] = []

    @property
    def values(self) -> list[Value]:
        return _values(self.arguments)

    @property
    def graded(self) -> bool:
        """Without points it is a worked example, or code that students get already written."""
        return self.points > 0

    @property
    def is_model(self) -> bool:
        """A scene's `model = "..."` can name it (the same rule as in manifest.hpp)."""
        return self.returns == "Terms" and bool(self.arguments)


class SceneEntry(Declared):
    file: str
    points: float = Field(0, ge=0)


class _Manifest(Declared):
    name: str
    title: str
    files: list[str]
    given: list[str] = []
    struct: list[Struct] = []
    function: list[Function] = []
    scene: list[SceneEntry] = []


class _Interface(Declared):
    struct: list[Struct]


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
class Scene:
    name: str
    file: Path
    points: float
    hidden: bool = False  # students see neither its picture nor its file


class CustomCheck(NamedTuple):
    """A pytest function in checks/test_*.py: `linearity` is test_linearity (custom.py). Points are for both languages together."""

    name: str
    points: float


@dataclass
class Assignment:
    name: str
    title: str
    directory: Path
    files: list[str]
    given: list["Assignment"]
    structs: dict[str, Struct]
    functions: list[Function]
    public_scenes: list[Scene]
    hidden: Hidden

    @cached_property
    def scenes(self) -> list[Scene]:
        """The public ones, then those drawn from hidden.toml."""
        drawn = hidden_scene_files(self.hidden, self.directory, self.name)
        return [*self.public_scenes, *(Scene(file.stem, file, points, hidden=True) for file, points in drawn)]

    @property
    def check_files(self) -> list[Path]:
        return sorted((self.directory / "checks").glob("test_*.py"))

    @cached_property
    def custom(self) -> list[CustomCheck]:
        """By files and functions. They are read and not run: who only wants ids and points needs neither pytest nor time."""
        out = [check for file in self.check_files for check in _custom_checks(file)]
        names = [check.name for check in out]
        for name in names:
            if names.count(name) > 1:
                raise UserError(f"{shown(self.directory / 'checks')}: two functions are called test_{name}; rename one")
        return out

    def function(self, name: str) -> Function:
        for function in self.functions:
            if function.name == name:
                return function
        known = ", ".join(f.name for f in self.functions)
        raise UserError(f"{name}: {self.name} has no such function; it has {known}")

    def columns(self, values: list[Value], prefix: str = "") -> list[Column]:
        """The columns in the order in which plugins and shaders take them."""
        out = []
        for value in values:
            path = prefix + value.name
            if value.domain.kind == "struct":
                out += self.columns(self.structs[value.domain.type].values, path + ".")
            else:
                width = _widths[value.domain.type]
                out += [Column(path, k, width, value.domain) for k in range(width)]
        return out

    def input_columns(self, function: Function) -> list[Column]:
        return self.columns(function.values)

    def output_columns(self, function: Function) -> list[Column]:
        """Named `result` or `result.member`."""
        kind = "struct" if function.returns in self.structs else "range"
        return self.columns([Value("result", Domain(kind=kind, type=function.returns))])

    @cached_property
    def stability(self) -> dict[str, Stable]:
        """What stability.toml declares, by function."""
        return load_stability(self.directory, [f.name for f in self.functions])

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


def load_assignment(directory: Path) -> Assignment:
    file = directory / "assignment.toml"
    manifest: _Manifest = validated(_Manifest, file)
    interface: _Interface = validated(_Interface, FRAMEWORK / "interface.toml")
    given = [load_assignment(directory.parent / name) for name in manifest.given]
    structs = {s.name: s for s in interface.struct}
    for earlier in given:
        structs.update(earlier.structs)
    structs.update({s.name: s for s in manifest.struct})
    assignment = Assignment(
        manifest.name, manifest.title, directory, manifest.files, given, structs, manifest.function,
        [Scene(Path(s.file).stem, (directory / s.file).resolve(), s.points) for s in manifest.scene],
        validated(Hidden, hidden) if (hidden := directory / "hidden.toml").exists() else Hidden(),
    )  # fmt: skip
    for function in assignment.functions:
        _check_gates(assignment, function, file)
        names = [v.name for v in function.values]
        for value in function.values:
            if value.domain.kind == "struct" and value.domain.type not in structs:
                raise UserError(f"{shown(file)}: {function.name}.{value.name}: unknown domain {value.domain.type}")
            if value.domain.kind == "upper" and value.domain.base not in names:
                raise UserError(
                    f"{shown(file)}: {function.name}.{value.name}: upper({value.domain.base}) names no argument"
                )
    return assignment


def _custom_checks(file: Path) -> Iterator[CustomCheck]:
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError) as error:
        raise UserError(f"{shown(file)}:{getattr(error, 'lineno', None) or 1}: {error.args[0]}") from None
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
            continue
        points = 0.0
        for call in (d for d in node.decorator_list if isinstance(d, ast.Call) and isinstance(d.func, ast.Attribute)):
            where = f"{shown(file)}:{call.lineno}: {node.name}"
            if call.func.attr == "parametrize":
                raise UserError(f"{where}: one function is one check; loop inside of it instead of parametrize")
            if call.func.attr == "points":
                value = call.args[0].value if len(call.args) == 1 and isinstance(call.args[0], ast.Constant) else None
                if type(value) not in (int, float) or call.keywords:
                    raise UserError(f"{where}: points takes a number and nothing else, as in @pytest.mark.points(2)")
                points = float(value)
        yield CustomCheck(node.name.removeprefix("test_"), points)


def _check_gates(assignment: Assignment, function: Function, file: Path) -> None:
    widths = {c.path: c.width for c in assignment.input_columns(function)}
    for gate in function.gates:
        for path, value in gate.items():
            where = f"{shown(file)}: {function.name}.gates: {path}"
            if path not in widths:
                raise UserError(f"{where} is no column; there is {', '.join(widths)}")
            if isinstance(value, str) and widths.get(value) != widths[path]:
                raise UserError(f"{where} = {value}: there is no such column, or it is not as wide")
            if not isinstance(value, str) and np.size(value) != widths[path]:
                raise UserError(f"{where} needs {widths[path]} numbers")


def assignment_names() -> list[str]:
    """Those that can be graded: the ones with points."""
    names = sorted(f.parent.name for f in SOLUTION.glob("*/assignment.toml"))
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
    if name is None and (submission / "assignment.toml").is_file():
        declared = read_toml(submission / "assignment.toml").get("name")
        name = declared if declared in known else None
    if name is None and submission.resolve().name in known:
        name = submission.resolve().name
    if name is None:
        raise UserError(f"{shown(submission)}: which assignment is it? Give --assignment {' or '.join(known)}")
    return load_assignment(SOLUTION / name)
