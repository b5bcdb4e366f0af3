"""printf for shaders: what takes part at one pixel, and what each function gives there: the student's C++ and GLSL beside what is
expected.

Where a fragment lies our rasterizer's geometry layers say. The framework calls the models and incident_light; with what arguments
these call the other functions, the solution in double tells (follow.py). Without it, or where its values are not to be shown,
the student's own C++ tells; of what it does not call, those functions appear whose arguments have the names of what is known.
"""

import json
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene, named_arrays
from shadelab.course.bodies import tokens
from shadelab.course.mistakes import slide_formulas, write_submission
from shadelab.errors import UserError
from shadelab.evidence import intake
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.programs import Programs
from shadelab.evidence.tasks import BuildError, Draw, Evaluate
from shadelab.machine import renderer
from shadelab.machine.build import Recipe
from shadelab.machine.sandbox import Sandbox, work_folder
from shadelab.paths import SET_UP, STATE, shown
from shadelab.truth import making
from shadelab.truth.expected import CHANNELS, TERM_CHANNELS, Expected, Table, with_callees
from shadelab.truth.follow import FollowedSolution
from shadelab.truth.fragments import as_float, fragment_values, to_light, unit
from shadelab.truth.measures import function_limit, function_members, scaled_error
from shadelab.truth.tables import jittered, renormalised
from shadelab.words import BACKENDS, decoded, plain

TERMS = ("total", "ambient", "diffuse", "specular")
ALL_CHANNELS = max(channels.stop for channels in CHANNELS.values())
# Two calls with arguments as near as this are one: the solution's are double, and rounded on their way.
SAME = {"rtol": 1e-5, "atol": 1e-6}

# What is known by name, and its type: a material's roughness and the material itself may both be called m.
Named = dict[tuple[str, str], np.ndarray]


@dataclass
class Call:
    """One evaluation of a function. Where a side gave nothing, `values` holds None."""

    light: int
    function: Function
    row: np.ndarray  # (columns,) float32
    values: dict[str, np.ndarray | None] = field(default_factory=dict)  # by side
    wrong: dict[str, np.ndarray] = field(default_factory=dict)  # by backend: which numbers are off; only where judged


@dataclass
class Probe:
    assignment: Assignment
    scene: Path
    pixel: tuple[int, int]
    object: int = 0
    material: str = ""
    model: str = ""
    known: list[Named] = field(default_factory=list)  # per light; what does not depend on lights stands in each
    kinds: list[str] = field(default_factory=list)  # of the lights
    calls: list[Call] = field(default_factory=list)
    rendered: dict[str, np.ndarray] = field(default_factory=dict)  # by side: (TERM_CHANNELS,)
    failures: dict[str, list[str]] = field(default_factory=dict)  # by backend: what did not work
    printed: dict[str, str] = field(default_factory=dict)  # by function: what the student's C++ prints
    notes: list[str] = field(default_factory=list)
    judged: bool = False

    def first_wrong(self) -> dict[str, str]:
        """By backend, the first function in data-flow order of which a value is off: what it calls is right."""
        out = {}
        for function in self.assignment.functions:
            for call in self.calls:
                if call.function is function:
                    for backend, wrong in call.wrong.items():
                        if wrong.any():
                            out.setdefault(backend, function.name)
        return out


def pixel_of(text: str) -> tuple[int, int]:
    if not (found := re.fullmatch(r"\s*(\d{1,6})\s*,\s*(\d{1,6})\s*", text)):
        raise UserError(f"{text}: give a pixel as X,Y, for example 200,150; 0,0 is the one at the top left")
    return int(found[1]), int(found[2])


def probe(
    assignment: Assignment,
    scene: Path,
    pixel: tuple[int, int],
    submission: Path,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Probe:
    expected = making.load(assignment, progress)
    listed = next((s for s in assignment.scenes if s.file.resolve() == scene.resolve()), None)
    # Hidden scenes of another time, with other numbers, are no less hidden.
    hidden = any(place / "hidden" in scene.resolve().parents for place in (STATE.resolve(), SET_UP.resolve()))
    drawn = listed or Scene(scene.stem, scene.resolve(), assignment.directory, hidden=hidden)
    if listed and (missing := listed.missing_meshes()):  # of any other scene the renderer tells file and line
        raise UserError(
            f"{shown(scene)}: the mesh {missing[0].name} is not on this machine (./shadelab doctor says how to get it)"
        )
    out = Probe(assignment, scene, pixel)
    hidden, here = drawn.hidden, (assignment.directory / "shading.cpp").exists()
    with work_folder("probe") as work:
        packet_file = expected.packet(listed) if listed else work / "scene.packet"
        if not listed:
            renderer.packet(scene, assignment.directory, packet_file, renderer.View("all"))
        width, height = drawn.described.width, drawn.described.height
        if pixel[0] >= width or pixel[1] >= height:
            size, last = f"{width} x {height} pixels", f"{width - 1},{height - 1}"
            raise UserError(f"{shown(scene)}: the image has {size}: X,Y is at most {last}")
        # Of a scene of the assignment the layers are known; of any other, whoever draws it first tells them.
        layers = expected.scene(listed).layers if listed else None
        if layers is not None:
            _look_up(out, layers, drawn.described)
        solution = _Solution(assignment, expected, drawn, work) if here and not hidden else None
        if solution is None:
            why = "the scene is hidden" if hidden else "they need the solution, which is not here"
            out.notes.append(f"No expected values of functions: {why}.")
        elif layers is None:
            _look_up(out, layers := solution.draw(), drawn.described)
        files = intake.take(submission, assignment, work / "submission")
        draw = Draw(drawn, packet_file, "terms" if listed else "all")
        shape = (height, width, TERM_CHANNELS if listed else ALL_CHANNELS)
        students = [Language(backend, out, work, draw, shape, files) for backend in BACKENDS]
        with ThreadPoolExecutor(len(students)) as pool:
            list(pool.map(Language.start, students))
        images = [s.image for s in students if s.image is not None]
        if layers is None:
            if not images:
                raise UserError("; ".join(f"{BACKENDS[b]}: {words[0]}" for b, words in out.failures.items()))
            _look_up(out, _layers(images[0]), drawn.described)
        x, y = pixel
        out.rendered = {s.backend: s.image[y, x, :TERM_CHANNELS] for s in students if s.image is not None}
        if layers is not None and not hidden:
            terms = [layers[name][y, x] for name in CHANNELS]
            out.rendered["expected"] = np.concatenate(terms)[:TERM_CHANNELS]
        own = None
        if solution is None and students[0].built:
            own = _OwnCalls(assignment, work)
            out.notes += own.notes
        _find_calls(out, expected, solution, own)
        with ThreadPoolExecutor(len(students)) as pool:
            list(pool.map(Language.evaluate, students))
        if solution is not None:
            solution.judge(out)
    return out


def _layers(image: np.ndarray) -> dict[str, np.ndarray]:
    return {name: image[..., channels] for name, channels in CHANNELS.items()}


# ----------------------------------------------------------------------------------------------------- what is known


def _look_up(out: Probe, layers: dict[str, np.ndarray], described: renderer.Description) -> None:
    """The fragment's facts. Raises UserError where there is none."""
    x, y = out.pixel
    ids = layers["id"][..., 0]
    if not ids[y, x]:
        rows, columns = np.nonzero(ids)
        if not len(rows):
            raise UserError(f"{shown(out.scene)}: pixel {x},{y} is background, as is every other")
        nearest = np.argmin((rows - y) ** 2 + (columns - x) ** 2)
        raise UserError(
            f"{shown(out.scene)}: pixel {x},{y} is background; the nearest of an object is {columns[nearest]},{rows[nearest]}"
        )
    assignment = out.assignment
    out.object = int(ids[y, x])
    shaded = described.objects[out.object - 1]
    out.material, out.model = shaded.material, shaded.model
    if shaded.interpolation == "gouraud":
        out.notes.append(
            "This object is shaded at its vertices, and the colours are interpolated: not with these values."
        )
    n, position = (layers[name][y, x].astype(np.float64) for name in ("normal", "position"))
    held = fragment_values(assignment, n, position, as_float(described.eye))
    always: Named = {(name, "vec3"): numbers for name, numbers in held.items()}
    v = unit(as_float(described.eye) - position)
    for model in assignment.functions:
        if model.name == out.model:
            struct = model.values[0]
            always[struct.name, struct.domain.type] = as_float(shaded.parameters)
    for flat in as_float(described.lights):
        l = unit(to_light(assignment, flat[None], position)[0])
        own: Named = {("light", "Light"): flat, ("l", "vec3"): l, ("h", "vec3"): unit(l + v)}
        out.known.append({**always, **own})
        out.kinds.append(assignment.light_kinds[int(flat[0])].name)
    if not out.known:
        out.known.append(always)
        out.notes.append("The scene has no light: no function takes part.")


def _named(assignment: Assignment, struct: str, numbers: np.ndarray) -> dict[str, np.ndarray]:
    return named_arrays(assignment.structs[struct].columns, numbers[None])


def _members(assignment: Assignment, known: Named) -> Named:
    """The members of the material by their own names."""
    out: Named = {}
    for (_, kind), numbers in known.items():
        if kind in assignment.structs and kind != "Light":
            values = _named(assignment, kind, numbers)
            for value in assignment.structs[kind].values:
                out[value.name, value.domain.type] = np.atleast_1d(values[value.name][0])
    return out


def _row(function: Function, known: Named) -> np.ndarray | None:
    """What the function takes, where all of it is known by name."""
    keys = [(value.name, value.domain.type) for value in function.values]
    return np.hstack([known[k] for k in keys]).astype(np.float32) if all(k in known for k in keys) else None


# -------------------------------------------------------------------------------------------- who is called with what


def _find_calls(out: Probe, expected: Expected, solution: "_Solution | None", own: "_OwnCalls | None") -> None:
    """Per light in data-flow order: the framework's calls, and those that follow from them."""
    functions = out.assignment.functions
    framework = {f.name for f in functions if f.name in (out.model, out.assignment.light_function)}
    part = with_callees(framework, expected.facts.calls)
    left_out: set[str] = set()
    for light, known in enumerate(out.known if out.kinds else []):
        asked: dict[str, list[np.ndarray]] = {f.name: [] for f in functions}
        # From the last function on: callees are defined before their callers.
        for function in reversed(functions):
            by_name = known if solution or function.name in framework else {**_members(out.assignment, known), **known}
            if function.name in (framework if solution else part) and not asked[function.name]:
                if (row := _row(function, by_name)) is not None:
                    asked[function.name].append(row)
                else:
                    left_out.add(function.name)
            caller = solution or own
            if caller and (own or expected.facts.calls[function.name]):
                for row in asked[function.name]:
                    for name, rows in caller.calls(function, row).items():
                        asked[name] += [r for r in rows if not any(np.allclose(r, a, **SAME) for a in asked[name])]
        out.calls += [Call(light, f, row) for f in functions for row in asked[f.name]]
    if left_out:
        names = ", ".join(f.name for f in functions if f.name in left_out)
        out.notes.append(f"Left out, because what they take is not known by name here: {names}.")
    if out.kinds and out.model not in framework:
        out.notes.append(f"The model {out.model} is none of {out.assignment.name}'s functions.")


def _by_function(calls: list[Call]) -> list[tuple[Function, list[Call]]]:
    names = dict.fromkeys(call.function.name for call in calls)
    groups = [[call for call in calls if call.function.name == name] for name in names]
    return [(group[0].function, group) for group in groups]


class Language:
    """One language of the submission. What goes wrong is told, and costs its values alone."""

    def __init__(
        self, backend: str, out: Probe, work: Path, draw: Draw, shape: tuple[int, ...], files: dict[str, str | None]
    ) -> None:
        self.backend, self.out, self.draw, self.shape = backend, out, draw, shape
        self.folder = work / "submission"
        self.refused = files[f"shading.{backend}"]
        sandbox = Sandbox(work / backend)
        if backend == "cpp":  # one plugin for both, the functions and the picture
            self.runner = CppRunner(
                out.assignment, sandbox, Recipe(loops=tuple(draw.scene.described.needs.loops)), complete=True
            )
        else:
            self.runner = GlslRunner(out.assignment, sandbox)
        self.built, self.image = False, None

    def fail(self, words: str) -> None:
        self.out.failures.setdefault(self.backend, []).append(plain(words))

    def start(self) -> None:
        tasks = [self.draw]
        try:
            if self.refused:
                raise BuildError(self.refused)
            self.runner.build(self.folder, *([tasks] if self.backend == "glsl" else []))
        except BuildError as error:
            self.fail(error.message)
            return
        self.built = True
        [(_, output)] = self.runner.run(tasks)
        if output.array is None:
            self.fail(f"the render {output.failure}")
        elif output.array.shape != self.shape:
            self.fail(f"the render gave an image of another size: {output.array.shape}")
        else:
            self.image = output.array

    def evaluate(self) -> None:
        groups = _by_function(self.out.calls) if self.built else []
        tasks = [Evaluate(function, np.array([call.row for call in calls])) for function, calls in groups]
        for (function, calls), (_, output) in zip(groups, self.runner.run(tasks)):
            if output.array is None:
                self.fail(f"{function.name} {output.failure}")
            if output.printed:
                self.out.printed[function.name] = plain(output.printed)
            for k, call in enumerate(calls):
                call.values[self.backend] = None if output.array is None else output.array[k]


class _OwnCalls:
    """With what arguments the student's functions call each other: their C++, with each such call recorded (follow.hpp)."""

    def __init__(self, assignment: Assignment, work: Path) -> None:
        self.assignment, self.notes, self.runner = assignment, [], None
        folder = work / "own-calls"
        folder.mkdir()
        text = decoded((work / "submission/shading.cpp").read_bytes())
        names = {f.name for f in assignment.functions}
        (folder / "shading.cpp").write_text(recorded_text(text, names))
        runner = CppRunner(assignment, Sandbox(work / "own"), Recipe(loops=(), follow=True))
        try:
            runner.build(folder)
            self.runner = runner
            self.notes.append("What functions are called with is what your C++ calls them with.")
        except BuildError:  # it compiles as it is, so it writes something that is no call as if it were one
            self.notes.append("What your functions call each other with could not be found out.")

    def calls(self, function: Function, row: np.ndarray) -> dict[str, np.ndarray]:
        if self.runner is None:
            return {}
        others = [f for f in self.assignment.functions if f.name != function.name]
        nothing_known = {f.name: (np.empty((0, len(f.inputs))), np.empty((0, len(f.outputs)))) for f in others}
        output = self.runner.evaluate(Evaluate(function, row[None], records=nothing_known))
        return {name: rows for name, rows in output.missing.items() if len(rows)}


def recorded_text(text: str, names: set[str]) -> str:
    """A student's text, with the calls inside of functions going to the recording wrappers: f_followed() for f()."""
    text = re.sub(r"/\*.*?\*/", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL)
    found, out, depth, at = tokens(text), [], 0, 0
    for before, token, after in zip([None, *found], found, [*found[1:], None]):
        depth += {"{": 1, "}": -1}.get(token.text, 0)
        # Behind a name stands a declaration: vec3 diffuse(0.0);
        declared = before and re.match(r"\w", before.text) and before.text not in ("return", "else", "do")
        if depth > 0 and token.text in names and after and after.text == "(" and not declared:
            out += [text[at : token.end], "_followed"]
            at = token.end
    return "".join([*out, text[at:]])


class _Solution:
    """The truth: what is called, and what comes of it."""

    def __init__(self, assignment: Assignment, expected: Expected, scene: Scene, work: Path) -> None:
        self.assignment, self.expected, self.scene, self.work = assignment, expected, scene, work
        self.followed = FollowedSolution(assignment)
        self.programs = Programs(assignment, work / "followed")
        folders = [assignment.directory]
        if slides := slide_formulas(assignment):  # as for the tables: they say how much rounding of the inputs may move
            write_submission(assignment, slides, work / "slides")
            folders.append(work / "slides")
        self.forms = [self._built(folder, ()) for folder in folders]

    def _built(self, folder: Path, loops: tuple[str, ...]) -> CppRunner:
        runner = CppRunner(self.assignment, Sandbox(self.work / "solution"), Recipe(double=True, loops=loops))
        runner.build(folder)
        return runner

    def draw(self) -> dict[str, np.ndarray]:
        runner = self._built(self.assignment.directory, tuple(self.scene.described.needs.loops))
        output = runner.draw(Draw(self.scene, layers="all"))
        if output.array is None:
            raise UserError(f"{shown(self.scene.file)}: the render {output.failure}")
        return _layers(output.array)

    def calls(self, function: Function, row: np.ndarray) -> dict[str, np.ndarray]:
        return self.programs.answer_all(self.followed.calls(function, self._exact(function, row[None])))

    def _exact(self, function: Function, rows: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            exact = renormalised(function, rows)
        return np.where(np.isnan(exact), rows, exact)  # no direction at all: the h of opposite l and v

    def judge(self, out: Probe) -> None:
        """By the same limits as the checks of the functions, their tables' scale included."""
        out.judged = True
        for function, calls in _by_function(out.calls):
            rows, table = np.array([call.row for call in calls]), self.expected.table(function)
            exact = self._exact(function, rows)
            inputs = np.concatenate([exact, *jittered(function, exact)])
            outputs = [form.evaluate(Evaluate(function, inputs)) for form in self.forms]
            if failed := next((o.failure for o in outputs if o.array is None), None):
                raise UserError(f"{shown(self.assignment.directory)}: {function.name} {failed}")
            results = np.concatenate([o.array.reshape(-1, len(rows), o.array.shape[1]) for o in outputs])
            truth = results[0]
            with np.errstate(invalid="ignore"):
                conditioning = np.nan_to_num(np.abs(results[1:] - truth)).max(axis=0)
            parts = zip((rows, truth, conditioning), (table.rows, table.truth, table.conditioning))
            whole = Table(*(np.vstack(part) for part in parts), table.drawn)
            for k, call in enumerate(calls):
                call.values["expected"] = truth[k]
            for backend in BACKENDS:
                came = [call.values[backend] for call in calls if backend in call.values]
                if not came:  # it does not compile
                    continue
                if any(values is None for values in came):
                    came = np.full(truth.shape, np.nan)
                limit = function_limit(self.expected.floor(function, backend), backend)
                members = function_members(function)
                error = scaled_error(np.vstack([came, table.truth]), whole, members)[: len(rows)]
                for call, off in zip(calls, error > limit):
                    call.wrong[backend] = off


def facts(out: Probe, known: Named) -> list[tuple[str, np.ndarray]]:
    """What does not depend on the lights: what the fragment holds, and the material's members."""
    facts = [(name, known[name, "vec3"]) for name in sorted(out.assignment.fragment)]
    for (name, kind), numbers in known.items():
        if kind in out.assignment.structs and kind != "Light":
            facts += [(f"{name}.{m}", v[0]) for m, v in _named(out.assignment, kind, numbers).items()]
    return facts


def as_json(out: Probe) -> str:
    def plain_numbers(value: Any) -> Any:
        """JSON has no NaN and no infinity: they travel as words."""
        if np.ndim(value):
            return [plain_numbers(v) for v in value]
        return float(value) if np.isfinite(value) else str(float(value))

    def named(columns: list, row: np.ndarray | None) -> dict[str, Any] | None:
        return (
            None if row is None else {name: plain_numbers(v[0]) for name, v in named_arrays(columns, row[None]).items()}
        )

    def call_data(call: Call) -> dict[str, Any]:
        columns = call.function.outputs
        return {
            "function": call.function.name,
            "arguments": named(call.function.inputs, call.row),
            **{side: named(columns, values) for side, values in call.values.items()},
            "wrong": [backend for backend, off in call.wrong.items() if off.any()],
        }

    lights = [
        {
            "kind": kind,
            **{name: plain_numbers(out.known[k][name, "vec3"]) for name in ("l", "h")},
            "calls": [call_data(call) for call in out.calls if call.light == k],
        }
        for k, kind in enumerate(out.kinds)
    ]
    data = {
        "assignment": out.assignment.name, "scene": shown(out.scene), "pixel": list(out.pixel), "object": out.object,
        "material": out.material, "model": out.model,
        **{name: plain_numbers(value) for name, value in facts(out, out.known[0])},
        "lights": lights,
        "rendered": {s: {t: plain_numbers(v[CHANNELS[t]]) for t in TERMS} for s, v in out.rendered.items()},
        "first_wrong": out.first_wrong() if out.judged else None,
        "failures": out.failures, "printed": out.printed, "notes": out.notes,
    }  # fmt: skip
    return json.dumps(data, indent=1) + "\n"
