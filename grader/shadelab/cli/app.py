"""The program: its groups of commands, and what becomes of errors.

Exit codes: 0 done (a low score is still 0); 1 only for --fail-under or a failed check or test; 2 bad usage or bad input;
3 infrastructure.
"""

import errno
import functools
import importlib
import os
import re
import sys
from pathlib import Path

import typer

from shadelab.cli.options import NARROWEST, USUAL
from shadelab.cli.streams import exit_code, guard_streams
from shadelab.errors import InfrastructureError, UserError
from shadelab.paths import ROOT, STATE, shown

# In the order of `--help`. A release holds no solution: what instructors use is not there.
GROUPS = ("grading", "drawing", "course", "measuring", "release", "machine")
INSTRUCTORS = ("course", "measuring", "release")
PLANNED = ("view", "lecture", "site", "fit", "acquire", "cohort")  # commands whose names are settled

FULL, CLOSED = "; make room, or write elsewhere", "; write elsewhere: --out, or -o, says where"
MENDS = {
    errno.ENOSPC: FULL, errno.EDQUOT: FULL, errno.EIO: FULL, errno.EFBIG: FULL,
    errno.EROFS: CLOSED, errno.EACCES: CLOSED, errno.EPERM: CLOSED,
}  # fmt: skip

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""Write shading functions in C++ and GLSL, see them rendered, and have them graded.

Start with

    ./shadelab grade starter/phong

which grades the unfinished assignment and says for each function what is wrong. Fill in shading.cpp and shading.glsl there,
and grade again. `./shadelab COMMAND --help` explains each command.""",
)


_UsageError = typer.BadParameter.__bases__[0]  # click's class; typer has it from click or carries it itself


@functools.cache
def program() -> typer.Typer:
    """`app` with the commands that this checkout can run."""
    for group in GROUPS:
        if group not in INSTRUCTORS or (ROOT / "solution").is_dir():
            importlib.import_module(f"shadelab.cli.{group}").register(app)
    return app


def _mend_width_of_help() -> None:
    """typer asks the terminal itself; COLUMNS of 0 would print help of no width."""
    if os.environ.get("COLUMNS", "").isdigit() and int(os.environ["COLUMNS"]) < NARROWEST:
        from typer import rich_utils

        rich_utils.MAX_WIDTH = USUAL


def _told(usage: str) -> str:
    """What a usage error says, in one line."""
    asked = re.match(r"No such command '(\w+)'", usage)
    if asked and asked[1] in PLANNED:
        return f"{asked[1]}: is planned and not there yet; ./shadelab --help lists what is"
    return usage


def _of_another_user() -> Path | None:
    """The first thing below the folder of what is made that is not this user's and cannot be written to."""
    for path in sorted([STATE, *STATE.glob("*"), *STATE.glob("*/*"), *STATE.glob("*/*/*")]):
        if path.stat().st_uid != os.getuid() and not os.access(path, os.W_OK):
            return path
    return None


def main() -> None:
    guard_streams()
    _mend_width_of_help()
    sys.exit(exit_code(_run()))


def _run() -> int:
    """The exit code."""
    try:
        return program()(standalone_mode=False, prog_name="./shadelab") or 0
    except typer.Exit as done:
        return done.exit_code
    except _UsageError as error:
        print(_told(" ".join(error.format_message().split())), file=sys.stderr)
        return 2
    except typer.Abort:
        print("interrupted", file=sys.stderr)
        return 130
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except InfrastructureError as error:
        print(error, file=sys.stderr)
        return 3
    except OSError as error:
        if isinstance(error, PermissionError) and (foreign := _of_another_user()):
            print(
                f"{foreign}: belongs to another user (was ./shadelab run with sudo?); mend it: sudo chown -R $(id -un) {STATE}",
                file=sys.stderr,
            )
            return 3
        where = (
            f"{shown(name)}: " if (name := error.filename2 or error.filename) else ""
        )  # writing into an open file names none
        print(f"{where}{error.strerror or error}{MENDS.get(error.errno, '')}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except Exception as error:  # whoever runs this in CI must not take it for a low score, which is 1
        import traceback

        traceback.print_exc()
        print(
            f"a fault of Shadelab, not yours ({type(error).__name__}): show this to the course staff", file=sys.stderr
        )
        return 3
