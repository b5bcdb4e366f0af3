"""What student code is asked, and what it gives."""

import statistics
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from shadelab.course.assignment import Function, Scene
from shadelab.machine.build import Recipe
from shadelab.machine.sandbox import Limits

T = TypeVar("T")

EVALUATE_LIMITS = Limits(seconds=5)
DRAW_LIMITS = Limits(seconds=20)


Record = tuple[np.ndarray, np.ndarray]  # arguments (N, columns in) and outputs (N, columns out) of a function


@dataclass(frozen=True)
class Program:
    """Whose C++ answers, and how it is compiled, where that is not the submission as the grading compiles it."""

    recipe: Recipe
    text: str | None = None  # our own code; None: the submission's
    what: str = "the submission"
    environment: tuple[tuple[str, str], ...] = ()
    translated: bool = False  # the submission's GLSL, read as C++: what compiles as both means the same


@dataclass
class Evaluate:
    """One function over a table of rows (float32; float64 for a double plugin)."""

    function: Function
    rows: np.ndarray
    student: Path | None = None  # GLSL: another file than the runner's; for our own code
    program: Program | None = None  # None: whoever is asked
    records: dict[str, Record] | None = None  # outputs that stand in for functions, by name (follow-through)
    traced: bool = False  # whether what the function compares is asked for, too; of C++ that is compiled for it
    bodies: tuple[
        int, ...
    ] = ()  # of a program of several (truth/many.py): all rows with the first, then all with the next


@dataclass
class Draw:
    """One scene. `packet` is its frame packet, for the OpenGL client."""

    scene: Scene
    packet: Path | None = None
    layers: str = "terms"  # total | terms | all: what the C++ image holds (a packet says it for the OpenGL client)
    shift: tuple[float, float] = (0.0, 0.0)  # pixels right and up, in C++
    size: str | None = None  # WxH; None: the film's; in C++
    frames: int = 0  # drawn after the image, to measure the time of one
    program: Program | None = None  # C++; None: whoever is asked
    records: dict[str, Record] | None = None  # as of Evaluate; of a program of ours


@dataclass
class Trace:
    """What a function compared: how far left of right each comparison was, by where it stands in the code. Without what exp, log
    and the like compare in their insides, and without functions that have a check of their own."""

    sites: np.ndarray  # (S,) int64: addresses in the program's file
    least: np.ndarray  # (N, S) float32: left minus right for each row; NaN where it does not come there
    most: np.ndarray  # the same, where a row comes there more than once
    lines: dict[int, int] = field(
        default_factory=dict
    )  # of sites that stand in the text of the function that was asked

    def first(self, rows: int) -> "Trace":
        return Trace(self.sites, self.least[:rows], self.most[:rows], self.lines)


Task = Evaluate | Draw
# Asks, is told what came, and comes to an end: whoever judges never runs anything.
Asking = Generator[Task, "Output", T]


@dataclass
class Output:
    array: np.ndarray | None = None
    failure: str | None = None  # what the student's code did instead of giving numbers
    hung: bool = False
    printed: str = ""
    seconds: float = 0.0
    missing: dict[str, np.ndarray] = field(
        default_factory=dict
    )  # of each function with a record: the arguments that it lacks
    frames: list[float] = field(default_factory=list)  # seconds of further frames: without loading and compiling
    first_not_finite: str | None = None  # where, and with what inputs
    trace: Trace | None = None
    said: str = ""  # warnings, where code was only compiled
    unset: str | None = None  # what of the result was never stored, and how often

    @property
    def frame(self) -> float | None:
        """Seconds: the median."""
        return statistics.median(self.frames) if self.frames else None


@dataclass
class BuildError(Exception):
    """The student's code does not compile. `message` names the student's own file and line."""

    message: str


def is_regular(file: Path) -> bool:
    """A plain file and no link, pipe or folder: a read cannot block or lead elsewhere."""
    return file.is_file() and not file.is_symlink() and file.stat().st_size <= Limits().file_size


def load_image(file: Path) -> np.ndarray:
    if not is_regular(file):
        raise ValueError("no image")
    image = np.load(file, allow_pickle=False)
    if image.dtype != np.float32 or image.ndim != 3:
        raise ValueError("no float32 image")
    return image
