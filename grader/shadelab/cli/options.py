"""What commands share: options, where output goes, and progress."""

import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from shadelab.errors import UserError
from shadelab.files import naming, write_whole
from shadelab.paths import SCENES, shown

NARROWEST, USUAL = 20, 80  # columns of a terminal
FIRST_LINE, NEXT_LINE = 5.0, 5.0  # seconds until progress is told where no bar can be drawn, and between two lines


def console(stderr: bool = False) -> Console:
    """COLUMNS of 0 (an editor's or a build server's) is no width that a table fits into."""
    made = Console(stderr=stderr, highlight=False)
    if made.width < NARROWEST:
        made.width = USUAL
    return made


errors = console(stderr=True)

Backend = Literal["cpp", "glsl"]
Submission = Annotated[Path, typer.Argument(metavar="DIR", help="the folder with shading.cpp and shading.glsl")]
AssignmentName = Annotated[
    Optional[str],
    typer.Option("--assignment", help="which assignment (default: from assignment.toml or the folder's name)"),
]
Shading = Annotated[
    Optional[Path], typer.Option(metavar="DIR", help="whose shading functions (default: the solution's)")
]


def json_option(what: str):
    """--json FILE|-"""
    return Annotated[Optional[str], typer.Option("--json", metavar="FILE|-", help=f"{what}; - is stdout")]


@contextmanager
def progress_bar():
    """A callable (what, done, total) that tells on stderr how far it is: a bar on a terminal, elsewhere a line now and then."""
    if not errors.is_terminal:
        with progress_lines() as note:
            yield note
        return
    columns = [
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        TimeElapsedColumn(),
    ]
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task("starting", total=1)
        yield lambda what, done, total: progress.update(task, description=what, completed=done, total=total)


@contextmanager
def progress_lines():
    """A line every few seconds says where it is, also while a single step takes long. What is done soon says nothing. The
    callable is called from several threads."""
    start, over, state = time.monotonic(), threading.Event(), ["starting"]

    def tell() -> None:
        wait = FIRST_LINE
        while not over.wait(wait):
            print(f"{state[0]}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
            wait = NEXT_LINE

    def note(what: str, done: float, total: float) -> None:
        state[0] = f"{what} ({done:.0f} of {total:.0f})"

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield note
    finally:
        over.set()
        teller.join()


class Json:
    """Where --json goes. What people read goes to stdout, or to stderr when the JSON takes stdout."""

    def __init__(self, target: str | None) -> None:
        if target and target != "-" and not Path(target).absolute().parent.is_dir():
            raise UserError(f"--json {target}: there is no folder {shown(Path(target).parent)}")
        if target == "-" and sys.stdout is None:
            raise UserError("--json -: stdout is closed; give a file")
        self.target = target

    @property
    def console(self) -> Console:
        return errors if self.target == "-" else console()

    def write(self, text: str) -> None:
        if self.target == "-":
            print(text, end="")
        elif self.target:
            target = Path(self.target)
            if target.exists() and not target.is_file():  # a pipe or a device
                with naming(target):
                    target.write_text(text)
            else:
                write_whole(target, text)


def existing_scene(scene: Path) -> Path:
    if not scene.is_file():
        raise UserError(f"{shown(scene)}: cannot be read; does the file exist? Scenes stand in {shown(SCENES)}")
    return scene


def make_folder(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{shown(out)}: cannot be made: {error.strerror}; choose another folder with --out") from None
    return out
