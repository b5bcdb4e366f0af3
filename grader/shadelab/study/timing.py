"""Programs that draw a scene's frames and time them.

The solution's stand by, as in the benchmark, and draw on request. A student's run behind the sandbox: each request is a process
that loads the scene, draws one frame that does not count, then those that do, and ends.
"""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from shadelab.course.assignment import Assignment, Scene
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import DRAW_LIMITS, BuildError, Draw, load_image
from shadelab.machine import renderer
from shadelab.machine.build import Recipe
from shadelab.machine.command import Command
from shadelab.machine.sandbox import Sandbox
from shadelab.measure.standing import Resident, Stand
from shadelab.measure.timing import Progress
from shadelab.paths import shown
from shadelab.words import FILES

Shift = tuple[float, float]  # pixels right and up
UNMOVED: Shift = (0.0, 0.0)
ANSWERS_KEPT = 1 << 20  # bytes; a student's code prints into the same stream


@dataclass
class DrawnFrames:
    seconds: float  # of drawing alone, summed over the frames
    image: np.ndarray | None  # their mean, (H, W, 3) float64


class Drawer(Protocol):
    def draw(self, shifts: Sequence[Shift] = (UNMOVED,), image: bool = True) -> DrawnFrames:
        """A frame for each shift."""


class Standing:
    """A program of ours that has the scene loaded. OpenGL's knows no shifts."""

    def __init__(self, resident: Resident, file: Path) -> None:
        self.resident, self.file, self.shift = resident, file, UNMOVED

    def draw(self, shifts: Sequence[Shift] = (UNMOVED,), image: bool = True) -> DrawnFrames:
        seconds, mean = 0.0, 0.0
        for shift in shifts:
            if shift != self.shift:
                self.resident.ask(f"shift {_text(shift)}")
                self.shift = shift
            seconds += self.resident.draw() / 1000
            if image:
                mean = mean + self.resident.image(self.file)[..., :3].astype(float) / len(shifts)
        return DrawnFrames(seconds, mean if image else None)


class SandboxedCpp:
    """Each request is a process of its own, with a student's plugin."""

    def __init__(self, sandbox: Sandbox, command: Command, what: str) -> None:
        self.sandbox, self.command, self.what = sandbox, command, what

    def draw(self, shifts: Sequence[Shift] = (UNMOVED,), image: bool = True) -> DrawnFrames:
        files = [self.sandbox.fresh(f"frame-{k}.npy") for k in range(len(shifts) if image else 0)]
        lines = ["draw"]
        for k, shift in enumerate(shifts):
            lines += [f"shift {_text(shift)}", "draw", *([f"write {files[k]}"] if image else [])]
        requests = self.sandbox.fresh("requests")
        requests.write_text("\n".join(lines) + "\n")
        words = ("sh", "-c", 'requests=$1; shift; exec "$@" < "$requests"', "sh", str(requests), *self.command.words)
        command = Command(words, (requests, *self.command.reads), tuple(files))
        outcome = self.sandbox.run(command, DRAW_LIMITS)
        if not outcome.ok:
            raise UserError(f"{self.what}: the render {outcome.explain(DRAW_LIMITS)}")
        times = list(_times(outcome.stdout.decode(errors="replace")))[1:]
        try:
            images = [load_image(file)[..., :3].astype(float) for file in files]
        except (OSError, ValueError):
            images = []
        if len(times) != len(shifts) or len(images) != len(files):
            raise UserError(
                f"{self.what}: the render ended without giving its frames (does the code call exit, or print a lot?)"
            )
        return DrawnFrames(sum(times), np.mean(images, axis=0) if image else None)


def _text(shift: Shift) -> str:
    return f"{float(shift[0])!r},{float(shift[1])!r}"


def _times(printed: str) -> Iterator[float]:
    """The renderer's answers among whatever the student's code prints."""
    for line in printed.splitlines():
        try:
            answer = json.loads(line)
        except ValueError:
            continue
        if isinstance(answer, dict) and isinstance(ms := answer.get("ms"), int | float) and math.isfinite(ms):
            yield ms / 1000


class SandboxedGlsl:
    def __init__(self, runner: GlslRunner, scene: Scene, packet: Path) -> None:
        self.runner, self.scene, self.packet = runner, scene, packet

    def draw(self, shifts: Sequence[Shift] = (UNMOVED,), image: bool = True) -> DrawnFrames:
        [(_, drawn)] = self.runner.run([Draw(self.scene, self.packet, frames=1)])
        if drawn.array is None:
            raise UserError(f"{shown(self.scene.file)}: the render {drawn.failure}")
        return DrawnFrames(drawn.frame, drawn.array[..., :3].astype(float))


@dataclass
class Workbench:
    """What the measurements of a study share. `student`: whose code is measured instead of the solution's."""

    folder: Path
    progress: Progress
    student: Path | None = None
    stand: Stand = field(init=False)
    drivers: set[str] = field(default_factory=set)  # of OpenGL, as they call themselves

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        # One thread: a time is then the work that is done, and not also how it was shared out; and whatever else the machine does
        # disturbs it less. The benchmark says what a second thread gains.
        self.stand = Stand(self.folder, threads=1)

    @cached_property
    def sandbox(self) -> Sandbox:
        return Sandbox(self.folder / "sandbox", ANSWERS_KEPT)

    def plugin(self, assignment: Assignment, recipe: Recipe, folder: Path) -> Path:
        if not (folder / FILES["cpp"]).is_file():
            raise UserError(f"{shown(folder / FILES['cpp'])}: is missing; --shading names a folder with it")
        runner = CppRunner(assignment, self.sandbox, recipe)
        try:
            runner.build(folder)
        except BuildError as error:
            if folder == self.student:
                raise UserError(error.message) from None
            raise InfrastructureError(f"{shown(folder)}: {error.message}") from None
        return runner.plugin.file

    @contextmanager
    def cpp(
        self,
        scene: Path,
        assignment: Assignment,
        loops: Sequence[str] = (),
        double: bool = False,
        full: bool = False,
        view: renderer.View = renderer.AS_IT_IS,
        ours: bool = False,
    ) -> Iterator[Drawer]:
        """C++ with what the scene needs (`loops`), or with everything. `ours`: the solution's code, whoever is measured."""
        student = None if ours else self.student
        lean = Recipe(double, functions=False, loops=tuple(sorted(loops)), terms=False)
        plugin = self.plugin(assignment, Recipe(double) if full else lean, student or assignment.directory)
        view = replace(view, full=full)
        if student:
            described = renderer.describe(scene, assignment.directory, view)
            command = renderer.frames(described, assignment.directory, plugin, view, self.stand.threads)
            yield SandboxedCpp(self.sandbox, command, shown(scene))
        else:
            with self.stand.frames(scene, assignment.directory, plugin, view) as resident:
                yield Standing(resident, self.folder / "frame.npy")

    @contextmanager
    def glsl(self, scene: Path, assignment: Assignment, full: bool = False) -> Iterator[Drawer]:
        view = renderer.View(full=full)
        if not self.student:
            with self.stand.opengl(scene, assignment.directory, view) as resident:
                self.drivers.add(resident.ready["gl"])
                yield Standing(resident, self.folder / "frame.npy")
            return
        source = self.student / FILES["glsl"]
        if not source.is_file():
            raise UserError(f"{shown(source)}: is missing; --shading names a folder with it")
        packet = self.folder / f"{'full' if full else 'lean'}-{scene.parent.name}-{scene.stem}.packet"
        renderer.packet(scene, assignment.directory, packet, view)
        runner = GlslRunner(assignment, self.sandbox)
        try:
            runner.build(self.student)
        except BuildError as error:
            raise UserError(error.message) from None
        self.drivers.add(runner.gl)
        yield SandboxedGlsl(runner, Scene(scene.stem, scene, assignment.directory), packet)

    def describe(self, scene: Path, assignment: Assignment) -> renderer.Description:
        return renderer.describe(scene, assignment.directory, explain=True)

    def needs(self, scene: Path, assignment: Assignment) -> renderer.Needs:
        """What the scene needs of a plugin (loops), and the names of what is left out."""
        return self.describe(scene, assignment).needs
