"""release, package, new: what leaves the house, and what begins."""

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from shadelab.cli.options import progress_bar
from shadelab.paths import SOLUTION, shown


def register(app: typer.Typer) -> None:
    for command in (release, package, new):
        app.command()(command)


def release(
    name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="a folder that is empty or not there yet")],
    force: Annotated[bool, typer.Option("--force", help="replace the files of a former release")] = False,
) -> None:
    """Write what students receive: a checkout that holds this assignment alone, its expected data, and no solution of it."""
    from shadelab.course.assignment import find_assignment
    from shadelab.publish.release import folder_size, write_release

    declared = find_assignment(SOLUTION / name, name)
    with progress_bar() as progress:
        warnings = write_release(declared, out, force, progress)
    for warning in warnings:
        print(f"{shown(out)}: {warning}", file=sys.stderr)
    print(
        f"{shown(out)}: {folder_size(out) / 1e6:.0f} MB; students start with: cd {shown(out)} && ./shadelab grade {name}"
    )


def package(
    name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")],
    target: Annotated[str, typer.Option("--for", metavar="SYSTEM", help="gradescope")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.zip")],
    seed: Annotated[
        Optional[str], typer.Option(help="what hidden scenes are drawn from (default: drawn at random)")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="also an assignment that check has not passed")] = False,
) -> None:
    """Write the zip that an autograding service takes. Its hidden scenes are drawn from a seed of its own.

    It takes an assignment that `check` has passed as it is now.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.publish.package import write_package

    digest = write_package(find_assignment(SOLUTION / name, name), target, output, seed, force)
    print(f"{shown(output)}: {output.stat().st_size / 1e6:.1f} MB; digest of the seed: {digest}")


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="small letters, digits, single underscores")],
    title: Annotated[Optional[str], typer.Option(help="how handout and reports call it (default: from NAME)")] = None,
) -> None:
    """Start an assignment: a small one that works, to replace piece by piece."""
    from shadelab.publish.new import next_steps, write_assignment

    for file in write_assignment(name, title):
        print(shown(file))
    print(next_steps(name), file=sys.stderr)
