"""What correct programs give, by which limits are derived, and what the declared mistakes give, by which they are known."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shadelab.course.assignment import Assignment, Function, Scene
from shadelab.course.mistakes import Change, Changes
from shadelab.errors import UserError
from shadelab.evidence.tasks import Draw, Evaluate, Output
from shadelab.machine.build import Recipe
from shadelab.paths import shown
from shadelab.result import FRAMES
from shadelab.truth.expected import Table, with_callers
from shadelab.truth.many import ManyBodies
from shadelab.truth.measures import function_members, row_errors, spread_of
from shadelab.truth.workshop import PLAIN, Workshop
from shadelab.words import BACKENDS


@dataclass
class Spread:
    """What correct programs differ by, gathered while they run: function -> backend -> program -> its scaled error, but for
    single rows, and that of its worst row."""

    errors: dict[str, dict[str, dict[str, float]]]
    farthest: dict[str, dict[str, dict[str, float]]]
    gl: str = "none"  # the driver

    @classmethod
    def of(cls, assignment: Assignment) -> "Spread":
        return cls(*({f.name: {backend: {} for backend in BACKENDS} for f in assignment.functions} for _ in range(2)))

    def add(self, function: Function, backend: str, program: str, errors: np.ndarray) -> None:
        """errors: (N,)"""
        self.errors[function.name][backend][program] = spread_of(errors)
        self.farthest[function.name][backend][program] = float(errors.max())


@dataclass
class ProgramImages:
    """What one correct program drew. In files: the images of all programs at once would take gigabytes of memory."""

    name: str
    folder: Path
    frames: dict[str, list[float]] = field(default_factory=dict)  # by scene, the seconds of each

    def add(self, scene: Scene, output: Output) -> None:
        np.save(self.folder / f"{scene.name}.npy", output.array[..., :3])
        self.frames[scene.name] = output.frames

    def total(self, scene: Scene) -> np.ndarray:
        return np.load(self.folder / f"{scene.name}.npy")


@dataclass(frozen=True)
class CorrectProgram:
    name: str
    change: Change | None  # of the solution
    backend: str
    fused: bool = False  # multiplications and additions


def correct_programs(changes: Changes) -> list[CorrectProgram]:
    out = [
        CorrectProgram(f"{PLAIN}, C++", None, "cpp"),
        CorrectProgram(f"{PLAIN}, fused multiply-add", None, "cpp", True),
    ]
    out.append(CorrectProgram(f"{PLAIN}, GLSL", None, "glsl"))
    return out + [CorrectProgram(f"{v.id}, {name}", v, b) for v in changes.variant for b, name in BACKENDS.items()]


def run_program(
    workshop: Workshop, program: CorrectProgram, tables: dict[str, Table], scenes: list[Scene], loops: tuple[str, ...], spread: Spread
) -> ProgramImages:  # fmt: skip
    """One correct program: adds to the spread of the functions, and draws the scenes."""
    with workshop.step(program.name):
        folder = workshop.changed(program.change)
        # The solution's frames are timed; of the others nobody asks how fast they are: one quick plugin does for each.
        quick = program.change is not None
        recipe = Recipe(loops=loops, quick=True) if quick else Recipe(loops=(), contract=program.fused)
        cpp = program.backend == "cpp"
        runner = workshop.cpp(folder, recipe, program.name) if cpp else workshop.glsl(folder)
        functions = workshop.assignment.functions
        outputs = workshop.outputs(runner, [Evaluate(f, tables[f.name].rows) for f in functions], program.name)
        for function, output in zip(functions, outputs):
            table = tables[function.name]
            errors = row_errors(output.array, table, function_members(function))
            if not np.isfinite(errors).all():
                where = dict(zip(map(str, function.inputs), table.rows[np.argmax(errors)]))
                raise UserError(
                    f"{shown(workshop.assignment.directory)}: {program.name}: {function.name} is not finite at {where}"
                )
            spread.add(function, program.backend, program.name, errors)
        spread.gl = getattr(runner, "gl", spread.gl)
        if cpp and not quick:
            runner = workshop.cpp(folder, Recipe(functions=False, loops=loops, contract=program.fused), program.name)
        frames = 0 if quick else FRAMES
        draws = [Draw(scene, workshop.folder / f"{scene.name}.packet", frames=frames) for scene in scenes]
        drawn = ProgramImages(program.name, workshop.sandbox().folder)
        for scene, output in zip(scenes, workshop.run(runner, draws, program.name)):
            drawn.add(scene, output)
        return drawn


def record_mistakes(
    workshop: Workshop, changes: Changes, tables: dict[str, Table], calls: dict[str, list[str]], backend: str
) -> dict[str, np.ndarray]:
    """What each declared mistake gives on all inputs: its own function and, in C++, those that call it (the same numbers stand in
    for GLSL's, up to rounding). By ID/BACKEND/FUNCTION."""
    if not changes.mistake:
        return {}
    evaluate = _in_glsl if backend == "glsl" else _in_cpp
    found = evaluate(workshop, changes.mistake, tables, calls)
    return {f"{mistake.id}/{backend}/{name}": array for mistake, name, array in found}


Evaluated = Iterator[tuple[Change, str, np.ndarray]]  # a mistake, and what a function gives with it


def _in_glsl(
    workshop: Workshop, mistakes: list[Change], tables: dict[str, Table], calls: dict[str, list[str]]
) -> Evaluated:
    files = [workshop.changed(mistake) / "shading.glsl" for mistake in mistakes]
    functions = [workshop.assignment.function(mistake.function) for mistake in mistakes]
    tasks = [Evaluate(f, tables[f.name].rows, file) for f, file in zip(functions, files)]
    runner = workshop.glsl(files[0].parent)
    with workshop.step("mistakes, GLSL"):
        for mistake, (_, output) in zip(mistakes, runner.run(tasks)):
            if output.array is not None:
                yield mistake, mistake.function, output.array


def _in_cpp(
    workshop: Workshop, mistakes: list[Change], tables: dict[str, Table], calls: dict[str, list[str]]
) -> Evaluated:
    with workshop.step("mistakes, C++"):
        bodies = {number: mistake.bodies_for("cpp") for number, mistake in enumerate(mistakes)}
        many = ManyBodies(workshop.assignment, workshop.work / "mistakes", bodies, double=False)
        for number in bodies.keys() - set(many.numbers):  # says what the compiler says of it
            workshop.cpp(workshop.changed(mistakes[number]), Recipe(loops=()), mistakes[number].id)
        for function in workshop.assignment.functions:
            numbers = [k for k, m in enumerate(mistakes) if function.name in with_callers({m.function}, calls)]
            for number, array in many.evaluate(numbers, Evaluate(function, tables[function.name].rows), "mistakes"):
                yield mistakes[number], function.name, array
