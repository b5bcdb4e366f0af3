"""reference, check, starter: what instructors do to an assignment."""

import sys
from typing import Annotated, Optional

import typer
from rich import box
from rich.table import Table

from shadelab.cli.options import console, progress_bar
from shadelab.paths import SOLUTION, shown


def register(app: typer.Typer) -> None:
    for command in (reference, check, starter):
        app.command()(command)


def reference(name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")]) -> None:
    """Make the expected data of an assignment from its solution's double build (grade does it when it is missing)."""
    from shadelab.course.assignment import find_assignment
    from shadelab.truth import making
    from shadelab.truth.measures import function_limit

    declared = find_assignment(SOLUTION / name, name)
    with progress_bar() as progress:
        made = making.load(declared, progress)
    print(shown(made.folder))
    table = Table("function", "language", "floor", "limit", "set by", box=box.SIMPLE_HEAD, pad_edge=False)
    for function, languages in made.facts.spread.items():
        for backend, programs in languages.items():
            floor, farthest = max((error, name) for name, error in programs.items())
            table.add_row(function, backend, f"{floor:.2g}", f"{function_limit(floor, backend):.2g}", farthest)
    console().print(table)


def check(
    names: Annotated[
        Optional[list[str]], typer.Argument(metavar="[NAME]...", help="assignments (default: all)")
    ] = None,
    images: Annotated[
        bool, typer.Option("--images", help="draw the scenes for the mistakes, too (takes several times as long)")
    ] = False,
) -> None:
    """Grade the grader: every declared mistake must lose points and be named, every correct variant must lose none.

    Below every correct variant of a function every mistake of those that it calls is graded, too: it is right on top of them.
    Single tokens of every graded function are changed as well (mutants); none may pass. Notes say what is left open: a graded
    function without a declared mistake or without a scene, mistakes that only a sister function has, points that are not 100.
    `package` takes only what has passed.
    """
    from shadelab.course.assignment import assignment_names, find_assignment
    from shadelab.prove.check import check as run_check
    from shadelab.prove.record import looked_at, remember
    from shadelab.report.matrix import print_matrix

    missed = 0
    for name in names or assignment_names():
        declared = find_assignment(SOLUTION / name, name)
        seen = looked_at(declared)
        with progress_bar() as progress:
            matrix = run_check(declared, progress, images)
        missed += (here := print_matrix(declared.name, matrix, console()))
        if not here:
            remember(declared, seen)
    if missed:
        raise typer.Exit(1)


def starter(
    name: Annotated[Optional[str], typer.Argument(metavar="[NAME]", help="an assignment (default: all)")] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="write nothing; exit with 1 when starter/ is out of step")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="overwrite changes that are not committed")] = False,
) -> None:
    """Generate starter/NAME from solution/NAME: the marked parts become stubs."""
    from shadelab.course.assignment import assignment_names, find_assignment
    from shadelab.publish.starter import differences, write_starter

    lines = []
    for each in [name] if name else assignment_names():
        declared = find_assignment(SOLUTION / each, each)
        if verify:
            lines += differences(declared)
        else:
            print(shown(write_starter(declared, force)))
    for line in lines:
        print(line)
    if lines:
        print("Run ./shadelab starter and commit what it writes.", file=sys.stderr)
        raise typer.Exit(1)
