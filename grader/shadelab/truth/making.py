"""Makes the expected data of an assignment from its solution: the truth in double, what correct programs differ by, and what the
declared mistakes give. No student's code takes part."""

import fcntl
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene, load_assignment, named_arrays
from shadelab.course.mistakes import Change, load_changes, slide_formulas, write_submission
from shadelab.course.stability import FILE as STABILITY
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence.runners import CppRunner, Draw, Evaluate, GlslRunner, Output, Task
from shadelab.gl.packet import Packet
from shadelab.judge.findings import (
    FULL_MARKS,
    function_members,
    image_limit,
    largest_error,
    pixel_error,
    violating_share,
)
from shadelab.machine.build import BuildError, Recipe, glue_folder
from shadelab.machine.sandbox import Limits, Sandbox
from shadelab.paths import EXPECTED, FRAMEWORK, RENDER, ROOT, SHIPPED, shown
from shadelab.result import FRAMES, point_of
from shadelab.truth.closure import import_closure
from shadelab.truth.expected import (
    INTERIOR,
    Expected,
    Facts,
    SceneTruth,
    Table,
    largest_nearby,
    missing_meshes,
    scene_meshes,
    with_callers,
)
from shadelab.truth.extremes import extreme_table
from shadelab.truth.follow import Reference
from shadelab.truth.tables import jittered, make_table, moved_one_by_one, on_gate, renormalised

PUBLIC_SEED = 6837
FRAGMENTS = 1024  # rows of a function's table that are recorded from scenes, at most
FRAGMENTS_PER_SCENE = 256
DRIVER_ROWS = 4096
SHIFTS = [(1 / 16, 0.0), (0.0, 1 / 16)]  # pixels: as far as rasterizers may place a fragment differently
PLAIN = "the solution"


def load(assignment: Assignment, progress: Callable[[str, int, int], None] = lambda *_: None) -> Expected:
    """The expected data: that of a release, or else made for the present solution and scenes unless it is there."""
    if (SHIPPED / assignment.name / "done").exists():
        return Expected(SHIPPED / assignment.name)
    name = digest(assignment)
    folder = EXPECTED / assignment.name / name
    if not (folder / "done").exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with open(folder.parent / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # whoever wants the same waits for it
            if not (folder / "done").exists():
                make(assignment, folder, name, progress)
    os.utime(folder)  # its age counts from the last use
    return Expected(folder)


def digest(assignment: Assignment) -> str:
    """Of everything that the expected data rests on: our code, the framework, solution, declarations, scenes, meshes."""
    total = hashlib.sha256()
    for file in dict.fromkeys(made_from(assignment)):
        total.update(str(file.name).encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()[:32]


def made_from(assignment: Assignment) -> Iterator[Path]:
    """Those files. Raises an error for one that is missing, but for what need not be there: declarations that an assignment may do
    without, and meshes, whose scenes are skipped then."""
    driver = Path(__file__).parent / "driver"
    yield from import_closure(__name__)
    yield from (driver / name for name in ("assignment.toml", "shading.glsl"))
    yield from (FRAMEWORK / "interface.toml", ROOT / "CMakeLists.txt")
    for folder in ("include", "src", "render"):
        yield from _all_files(FRAMEWORK / folder)
    pending = [assignment]
    while pending:
        one = pending.pop()
        yield from (one.directory / name for name in ("assignment.toml", *one.files))
        pending += one.given
    optional = [assignment.directory / name for name in ("mistakes.toml", "exact.py", STABILITY)]
    for scene in assignment.scenes:
        yield scene.file
        optional += scene_meshes(scene)
    yield from (file for file in optional if file.exists())


def _all_files(folder: Path) -> list[Path]:
    if not (files := sorted(f for f in folder.rglob("*") if f.is_file())):
        raise InfrastructureError(f"{shown(folder)}: is missing or empty, but expected data rests on it")
    return files


def make(assignment: Assignment, folder: Path, name: str, progress: Callable[[str, int, int], None]) -> None:
    # Its own: two runs may make the same data at once, where the file system knows no locks.
    scratch = Path(tempfile.mkdtemp(prefix="making-", dir=folder.parent))
    try:
        _Making(assignment, scratch, progress).all()
        shutil.rmtree(scratch / "work")
        (scratch / "done").write_text(name + "\n")
        try:
            scratch.rename(folder)
        except OSError:  # another run was faster, or one was cut off before it was done
            if (folder / "done").exists():
                return
            shutil.rmtree(folder)
            scratch.rename(folder)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    # Older data of this assignment serves nobody for long: its digest will not come back. A run may still be reading it.
    for other in folder.parent.iterdir():
        try:
            unused = time.time() - other.stat().st_mtime
        except FileNotFoundError:
            continue
        if other.is_dir() and other != folder and unused > 3600:
            shutil.rmtree(other, ignore_errors=True)


@dataclass
class Drawn:
    """What one correct program drew. In files: the images of all programs at once would take gigabytes of memory."""

    name: str
    folder: Path
    frames: dict[str, list[float]] = field(default_factory=dict)  # by scene, the seconds of each

    def add(self, scene: Scene, output: Output) -> None:
        np.save(self.folder / f"{scene.name}.npy", output.array[..., :3])
        self.frames[scene.name] = output.frames

    def total(self, scene: Scene) -> np.ndarray:
        return np.load(self.folder / f"{scene.name}.npy")


class _Making:
    def __init__(self, assignment: Assignment, folder: Path, progress: Callable[[str, int, int], None]) -> None:
        self.assignment, self.folder, self.progress = assignment, folder, progress
        self.changes = load_changes(assignment)
        self.scenes = [scene for scene in assignment.scenes if not missing_meshes(scene)]
        self.done, self.steps = 0, len(self.changes.mistake) + 2 * len(self.changes.variant) + 7 + len(self.scenes)
        (folder / "work").mkdir()
        glue_folder(assignment.directory)  # once, before two threads want it
        self.sandboxes = 0

    def all(self) -> None:
        self.tables: dict[str, Table] = {}
        self.spread = {f.name: {"cpp": {}, "glsl": {}} for f in self.assignment.functions}
        self.gl, self.cases = "none", {}
        packets = {scene.name: self._packet(scene) for scene in self.scenes}
        self.loops = tuple(sorted({loop for scene in self.scenes for loop in self._loops(scene)}))
        double = self._cpp(self.assignment.directory, Recipe(double=True, functions=False, loops=self.loops), PLAIN)
        truths = {scene.name: self._truth(scene, packets[scene.name], double) for scene in self.scenes}
        self._make_tables(packets, truths)
        self._make_extremes()
        driver = self._measure_driver()
        # Function by function and scene by scene, what other correct programs and the mistakes give: two at a time.
        with ThreadPoolExecutor(2) as pool:
            mistakes = pool.map(self._mistakes, ("cpp", "glsl"))
            drawn = list(pool.map(lambda program: self._program(*program), self._programs()))
            recorded = {key: array for arrays in mistakes for key, array in arrays.items()}
        np.savez_compressed(self.folder / "mistakes.npz", **recorded)
        for scene in self.scenes:
            self._finish_scene(scene, truths[scene.name], double, drawn)
        mistakes = [{"id": m.id, "function": m.function, "hint": m.hint} for m in self.changes.mistake]
        facts = Facts(self.calls, list(self.loops), self.spread, mistakes, self.gl, self.cases, driver)
        (self.folder / "facts.json").write_text(json.dumps(asdict(facts), indent=1))
        arrays = {"drawn": np.array(next(iter(self.tables.values())).drawn)}
        for name, table in self.tables.items():
            for part in ("rows", "truth", "conditioning"):
                arrays[f"{name}.{part}"] = getattr(table, part)
        np.savez(self.folder / "functions.npz", **arrays)

    @contextmanager
    def _step(self, what: str) -> Iterator[None]:
        self.progress(f"reference {self.assignment.name}: {what}", self.done, self.steps)
        yield
        self.done += 1

    def _sandbox(self) -> Sandbox:
        self.sandboxes += 1
        return Sandbox(self.folder / "work" / str(self.sandboxes))

    def _cpp(self, folder: Path, recipe: Recipe, what: str) -> CppRunner:
        runner = CppRunner(self.assignment, self._sandbox(), recipe)
        try:
            runner.build(folder)
        except BuildError as error:
            raise UserError(f"{shown(self.assignment.directory)}: {what} does not compile: {error.message}") from None
        return runner

    def _run(self, runner: CppRunner | GlslRunner, tasks: list[Task], what: str) -> Iterator[Output]:
        for task, output in runner.run(tasks):
            name = task.function.name if isinstance(task, Evaluate) else task.scene.name
            if output.array is None:
                raise UserError(f"{shown(self.assignment.directory)}: {what}: {name} {output.failure}")
            yield output

    def _outputs(self, runner: CppRunner | GlslRunner, tasks: list[Task], what: str) -> list[Output]:
        return list(self._run(runner, tasks, what))

    # -------------------------------------------------------------------------------------------------------- scenes

    def _render(self, *arguments: Any) -> str:
        outcome = self._sandbox().run([str(RENDER), *map(str, arguments)], Limits(seconds=60))
        if not outcome.ok:
            raise InfrastructureError(outcome.stderr.strip() or outcome.explain(Limits(seconds=60)))
        return outcome.stdout.decode()

    def _packet(self, scene: Scene) -> Packet:
        file = self.folder / f"{scene.name}.packet"
        with self._step(scene.name):
            self._render("packet", scene.file, "--assignment", self.assignment.directory, "--terms", "-o", file)
            return Packet(file)

    def _loops(self, scene: Scene) -> list[str]:
        return json.loads(self._render("needs", scene.file, "--assignment", self.assignment.directory))["loops"]

    def _truth(self, scene: Scene, packet: Packet, double: CppRunner) -> SceneTruth:
        [drawn] = self._outputs(double, [Draw(scene, layers="all", frames=FRAMES)], PLAIN)
        facts = packet.header["scene"]
        truth = SceneTruth.of(drawn.array, np.array(facts["eye"]), facts["fov_y"] / packet.header["height"])
        truth.facts.runs.append(point_of(f"{PLAIN}, C++ double", np.zeros(1), drawn.frames).model_dump())
        names = [(value.name, self.assignment.columns([value])) for value in self.assignment.structs["Light"].values]
        for flat in facts["lights"]:
            light, at = {}, 0
            for name, columns in names:
                values = flat[at : at + len(columns)]
                light[name] = values if len(columns) > 1 else values[0]
                at += len(columns)
            truth.facts.lights.append(light)
        return truth

    def _finish_scene(self, scene: Scene, truth: SceneTruth, double: CppRunner, programs: list[Drawn]) -> None:
        """Noise and spread of one scene, and where the solution stands in error against run time."""
        moved = self._outputs(double, [Draw(scene, layers="total", shift=shift) for shift in SHIFTS], "a shift")
        for output in moved:
            truth.noise = np.maximum(truth.noise, np.abs(output.array[..., :3] - truth.total).max(axis=2))
        truth.noise = largest_nearby(truth.noise).astype(np.float32)
        interior = truth.mask == INTERIOR
        errors = {}
        for program in programs:
            total = program.total(scene)
            errors[program.name] = pixel_error(total, truth)[interior]
            if program.name.startswith(PLAIN) and "fused" not in program.name:
                off = total.astype(np.float64) - truth.total
                truth.facts.runs.append(point_of(program.name, off, program.frames[scene.name]).model_dump())
        if interior.any():
            truth.facts.spread = {name: float(np.quantile(e, 1 - FULL_MARKS)) for name, e in errors.items()}
            # Each by the limits that the others set.
            for program in programs:
                others = [floor for name, floor in truth.facts.spread.items() if name != program.name]
                limit = image_limit(truth, max(others, default=0.0))
                share = violating_share(program.total(scene), truth.total, limit, interior)
                truth.facts.share = max(truth.facts.share, share)
        truth.save(self.folder / f"{scene.name}.npz")

    # -------------------------------------------------------------------------------------------------------- tables

    def _make_tables(self, packets: dict[str, Packet], truths: dict[str, SceneTruth]) -> None:
        """Inputs from the domains and from the scenes; their truth and conditioning from the solution and from the slides."""
        assignment = self.assignment
        with self._step("tables"):
            text = (assignment.directory / "shading.cpp").read_text()
            reference = Reference(assignment, text, self._sandbox())
            forms = [self._cpp(assignment.directory, Recipe(double=True, loops=()), PLAIN)]
            if slides := slide_formulas(assignment):
                write_submission(assignment, slides, self.folder / "work" / "slides")
                forms.append(self._cpp(self.folder / "work" / "slides", Recipe(double=True, loops=()), slides.id))
            drawn = {f.name: make_table(assignment, f, PUBLIC_SEED) for f in assignment.functions}
            recorded = self._fragments(packets, truths)
            self.calls = {}
            # Callees are defined before their callers: from the last function on, what a scene asks of one reaches those it calls.
            for function in reversed(assignment.functions):
                rows = _some(recorded.get(function.name, []), len(assignment.input_columns(function)))
                calls = reference.calls(function, renormalised(assignment, function, drawn[function.name]))
                self.calls[function.name] = sorted(calls)
                if len(rows):
                    for name, arguments in reference.calls(function, renormalised(assignment, function, rows)).items():
                        recorded.setdefault(name, []).append(arguments)
                self.tables[function.name] = self._judged(function, drawn[function.name], rows, forms)
            self.tables = {f.name: self.tables[f.name] for f in assignment.functions}

    def _judged(self, function: Function, drawn: np.ndarray, recorded: np.ndarray, forms: list[CppRunner]) -> Table:
        """The forms are equal on exact unit vectors; how much rounding of the inputs moves them depends on the form, and nobody
        has to know a better one than the slides'."""
        rows = np.vstack([drawn, recorded])
        exact = renormalised(self.assignment, function, rows)
        inputs = np.concatenate([exact, *jittered(self.assignment, function, exact)])
        results = []
        for form in forms:
            [output] = self._outputs(form, [Evaluate(function, inputs)], PLAIN)
            results.append(output.array.reshape(-1, len(rows), output.array.shape[1]))
        truth = results[0][0]
        with np.errstate(invalid="ignore"):
            conditioning = np.nan_to_num(np.abs(np.concatenate(results)[1:] - truth)).max(axis=0)
        conditioning[on_gate(function, len(drawn), len(rows))] = 0.0
        return Table(rows, truth, conditioning, len(drawn))

    def _fragments(self, packets: dict[str, Packet], truths: dict[str, SceneTruth]) -> dict[str, list[np.ndarray]]:
        """What the framework calls while it draws the public scenes: rows of the models and of incident_light."""
        out: dict[str, list[np.ndarray]] = {}
        functions = {f.name: f for f in self.assignment.functions}
        rng = np.random.default_rng(PUBLIC_SEED)
        for scene in self.scenes:
            if scene.hidden:
                continue  # their lights and materials are not to be found in a release
            truth, facts = truths[scene.name], packets[scene.name].header["scene"]
            ids = truth.layers["id"][..., 0]
            ys, xs = np.nonzero((ids > 0) & (truth.mask == INTERIOR))
            if not len(ys) or not facts["lights"]:
                continue
            chosen = rng.integers(len(ys), size=FRAGMENTS_PER_SCENE)
            place = ys[chosen], xs[chosen]
            lights = np.array(facts["lights"])[rng.integers(len(facts["lights"]), size=FRAGMENTS_PER_SCENE)]
            light = named_arrays(self.assignment.columns(self.assignment.structs["Light"].values), lights)
            n, x = (truth.layers[name][place].astype(np.float64) for name in ("normal", "position"))
            to_light = np.where((light["kind"] == 1)[:, None], -light["direction"], light["position"] - x)
            values = {"n": n, "x": x, "v": _unit(truth.eye - x), "l": _unit(to_light), "light": lights}
            for number, each in enumerate(facts["objects"], start=1):
                here = ids[place] == number
                values["m"] = np.tile(each["material"], (FRAGMENTS_PER_SCENE, 1))
                _append(out, functions.get(each["model"]), values, here)
            _append(out, functions.get("incident_light"), values, np.ones(FRAGMENTS_PER_SCENE, bool))
        return out

    # ------------------------------------------------------------------------------------------------------ stability

    def _make_extremes(self) -> None:
        """Extreme inputs of every function, their truth from 50 digits, their conditioning from the solution in double."""
        file = self.assignment.directory / "exact.py"
        if not file.exists():
            if self.assignment.stability:
                raise UserError(
                    f"{shown(file)}: is missing; it gives the functions in 50 digits, by which stability is judged"
                )
            return
        from shadelab.truth import exact

        double = self._cpp(self.assignment.directory, Recipe(double=True, loops=()), PLAIN)
        arrays: dict[str, np.ndarray] = {}
        with self._step("extreme inputs"):
            for function in self.assignment.functions:
                table = extreme_table(self.assignment, function, PUBLIC_SEED)
                rows, self.cases[function.name] = table.rows, table.cases
                table.truth = exact.evaluate(self.assignment, function, rows)
                inputs = renormalised(self.assignment, function, rows)
                moved = moved_one_by_one(self.assignment, function, inputs)
                every = np.concatenate([inputs, moved.reshape(-1, inputs.shape[1])])
                [output] = self._outputs(double, [Evaluate(function, every)], PLAIN)
                still, changed = output.array[: len(rows)], output.array[len(rows) :]
                with np.errstate(invalid="ignore"):
                    away = np.abs(changed.reshape(*moved.shape[:3], still.shape[1]) - still)
                table.conditioning = away.max(axis=1).sum(axis=0)
                arrays |= {f"{function.name}.{part}": array for part, array in table.arrays().items()}
        np.savez(self.folder / "extremes.npz", **arrays)

    def _measure_driver(self) -> dict[str, float]:
        """How far the OpenGL driver's own functions are off: relative errors; of the logarithm, which is mostly taken the exp of, the
        absolute one."""
        own = load_assignment(Path(__file__).parent / "driver")
        runner = GlslRunner(own, self._sandbox())
        runner.take(own.directory)
        truths = {"exp": np.exp, "log": np.log, "pow5": lambda x: x**5, "sin": np.sin, "inversesqrt": lambda x: x**-0.5}
        tasks = []
        for function in own.functions:
            low, high = function.values[0].domain.range
            x = -np.geomspace(1e-6, -low, DRIVER_ROWS) if low < 0 else np.geomspace(low, high, DRIVER_ROWS)
            tasks.append(Evaluate(function, x[:, None].astype(np.float32)))
        out = {}
        with self._step("the driver's functions"):
            for task, output in zip(tasks, self._run(runner, tasks, "the driver")):
                name = task.function.name.removeprefix("driver_")
                truth = truths[name](task.rows.astype(np.float64))
                size = 1.0 if name == "log" else np.abs(truth)
                out[name] = float((np.abs(output.array - truth) / size).max())
        return out

    # ---------------------------------------------------------------------------------- correct programs and mistakes

    def _both(self, changes: Iterable[Change]) -> list[tuple[Change, str]]:
        return [(change, backend) for change in changes for backend in ("cpp", "glsl")]

    def _programs(self) -> list[tuple[str, Change | None, str, bool]]:
        """Name, what is changed of the solution, language, whether multiplications and additions are fused."""
        out = [(f"{PLAIN}, C++", None, "cpp", False), (f"{PLAIN}, fused multiply-add", None, "cpp", True)]
        out.append((f"{PLAIN}, GLSL", None, "glsl", False))
        names = {"cpp": "C++", "glsl": "GLSL"}
        return out + [(f"{v.id}, {names[b]}", v, b, False) for v, b in self._both(self.changes.variant)]

    def _runner(self, change: Change | None, backend: str, recipe: Recipe, what: str) -> CppRunner | GlslRunner:
        folder = self.assignment.directory
        if change is not None:
            folder = self.folder / "work" / change.id
            write_submission(self.assignment, change, folder)
        if backend == "cpp":
            return self._cpp(folder, recipe, what)
        runner = GlslRunner(self.assignment, self._sandbox())
        runner.take(folder)
        return runner

    def _program(self, name: str, change: Change | None, backend: str, fused: bool) -> Drawn:
        """One correct program: adds to the spread of the functions, and draws the scenes."""
        with self._step(name):
            # The solution's frames are timed; of the others nobody asks how fast they are: one quick plugin does for each.
            quick = change is not None
            recipe = Recipe(loops=self.loops, quick=True) if quick else Recipe(loops=(), contract=fused)
            runner = self._runner(change, backend, recipe, name)
            functions = self.assignment.functions
            outputs = self._outputs(runner, [Evaluate(f, self.tables[f.name].rows) for f in functions], name)
            for function, output in zip(functions, outputs):
                members = function_members(self.assignment, function)
                error, row = largest_error(output.array, self.tables[function.name], members)
                if not np.isfinite(error):
                    where = dict(
                        zip(map(str, self.assignment.input_columns(function)), self.tables[function.name].rows[row])
                    )
                    raise UserError(
                        f"{shown(self.assignment.directory)}: {name}: {function.name} is not finite at {where}"
                    )
                self.spread[function.name][backend][name] = error
            self.gl = getattr(runner, "gl", self.gl)
            if backend == "cpp" and not quick:
                runner = self._runner(change, backend, Recipe(functions=False, loops=self.loops, contract=fused), name)
            frames = 0 if quick else FRAMES
            draws = [Draw(scene, self.folder / f"{scene.name}.packet", frames=frames) for scene in self.scenes]
            drawn = Drawn(name, self._sandbox().folder)
            for scene, output in zip(self.scenes, self._run(runner, draws, name)):
                drawn.add(scene, output)
            return drawn

    def _mistakes(self, backend: str) -> dict[str, np.ndarray]:
        """What each declared mistake gives on all inputs: its own function and, in C++, those that call it (the same numbers stand in
        for GLSL's, up to rounding)."""
        work, tasks, keys = self.folder / "work", [], []
        for mistake in self.changes.mistake:
            write_submission(self.assignment, mistake, work / mistake.id)
            names = with_callers({mistake.function}, self.calls) if backend == "cpp" else {mistake.function}
            for function in (f for f in self.assignment.functions if f.name in names):
                tasks.append(Evaluate(function, self.tables[function.name].rows, work / mistake.id / "shading.glsl"))
                keys.append((mistake.id, function.name))
        if backend == "glsl":
            runner = GlslRunner(self.assignment, self._sandbox())
            runner.take(work / self.changes.mistake[0].id) if tasks else None
            with self._step("mistakes, GLSL"):
                outputs = [output for _, output in runner.run(tasks)]
        else:
            outputs, runners = [], {}
            for (id, _), task in zip(keys, tasks):
                if id not in runners:
                    with self._step(id):
                        runners[id] = self._cpp(work / id, Recipe(loops=()), id)
                outputs.append(runners[id].evaluate(task))
        named = zip(keys, outputs)
        return {f"{id}/{backend}/{name}": o.array for (id, name), o in named if o.array is not None}


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30)


def _append(out: dict, function: Function | None, values: dict[str, np.ndarray], chosen: np.ndarray) -> None:
    """A row of the function for each chosen fragment, where the fragments have all that it takes."""
    if function is None or not chosen.any() or any(v.name not in values for v in function.values):
        return
    rows = np.hstack([values[v.name] for v in function.values])
    out.setdefault(function.name, []).append(rows[chosen].astype(np.float32))


def _some(parts: list[np.ndarray], columns: int) -> np.ndarray:
    """At most FRAGMENTS rows, as many of each part."""
    if not parts:
        return np.empty((0, columns), np.float32)
    each = max(1, FRAGMENTS // len(parts))
    rng = np.random.default_rng(PUBLIC_SEED)
    return np.vstack([part[rng.permutation(len(part))[:each]] for part in parts])[:FRAGMENTS]
