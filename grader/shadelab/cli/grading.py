"""grade, stability, report: what a submission is worth, and where it breaks."""

import os
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from shadelab.cli.options import AssignmentName, Json, Submission, console, json_option, make_folder, progress_bar
from shadelab.errors import UserError
from shadelab.files import alone_in
from shadelab.paths import shown


def register(app: typer.Typer) -> None:
    for command in (grade, report, stability):
        app.command()(command)


Formats = Annotated[
    Optional[list[str]],
    typer.Option(metavar="NAME", help="also write gradescope, classroom50, junit or markdown there; may be repeated"),
]
HiddenDetails = Annotated[
    bool, typer.Option("--hidden-details", help="for instructors: show what is wrong in hidden scenes, too")
]


def grade(
    directory: Submission,
    assignment: AssignmentName = None,
    out: Annotated[
        Optional[Path], typer.Option(help="where result.json and report.html go (default: out/ASSIGNMENT)")
    ] = None,
    json_: json_option("also write result.json here") = None,
    fail_under: Annotated[
        Optional[float], typer.Option(min=0, max=100, metavar="P", help="exit with 1 when the score is under P percent")
    ] = None,
    only: Annotated[
        Optional[list[str]],
        typer.Option(
            metavar="GLOB", help="only checks whose id matches, for example 'cpp/function/*'; may be repeated"
        ),
    ] = None,
    format: Formats = None,
    html: Annotated[bool, typer.Option(help="write report.html; without it, no picture is kept")] = True,
    hidden_details: HiddenDetails = False,
) -> None:
    """Grade one submission: build, run and compare it with the expected data, and say what is wrong.

    A table goes to stdout; result.json and report.html (pictures, worst pixels) go to the folder given by --out, and so does
    what --format asks for: results.json, classroom50.json, junit.xml, summary.md.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.grading.grade import grade as run_grade
    from shadelab.grading.planning import plan_checks
    from shadelab.grading.worst import write_worst_inputs
    from shadelab.report.formats.annotations import annotations
    from shadelab.report.formats.registry import check_formats, write_format
    from shadelab.report.html.page import write_html
    from shadelab.report.terminal import print_result

    declared = find_assignment(directory, assignment)
    for pattern in only or []:
        if not any(plan_checks(declared, pattern).values()):
            raise UserError(
                f"--only {pattern}: no check of {declared.name} has such an id; ids look like "
                f"cpp/function/{declared.functions[0].name}"
            )
    json = Json(json_)
    check_formats(format)
    out = make_folder(out or Path("out") / declared.name)

    def rewrite(result) -> None:
        for name in format or []:
            write_format(name, result, out)

    with alone_in(out):
        with progress_bar() as progress:
            grading = run_grade(declared, directory, out, only or "*", progress, rewrite, html, hidden_details)
        result = grading.result
        write_worst_inputs(declared, result, directory, out)
        rewrite(result)
        if html:
            write_html(result, grading.pictures, out / "report.html", declared.title, hidden_details)
    if os.environ.get("GITHUB_ACTIONS") == "true":  # its runner reads them from any output
        for line in annotations(result, shown(directory)):
            print(line, file=sys.stderr)
    json.write(result.to_json())
    print_result(result, json.console, out / "report.html" if html else None, hidden_details)
    if any(check.status == "error" for check in result.checks):
        raise typer.Exit(3)
    if fail_under is not None and 100 * result.score < fail_under * result.max_score - 1e-6:
        raise typer.Exit(1)


def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a graded folder: what --out of grade was")],
    format: Formats = None,
    hidden_details: HiddenDetails = False,
) -> None:
    """Make any report again from a graded folder, without running anything: the table, report.html, and what --format asks for.

    All of it comes from result.json and the pictures in evidence/. Where these were not kept (--no-html), report.html is left
    out. Pictures of hidden scenes are kept by a grade with --hidden-details alone.
    """
    from shadelab.grading.pictures import FOLDER, PictureFolder
    from shadelab.report.formats.registry import check_formats, write_format
    from shadelab.report.html.page import write_html
    from shadelab.report.terminal import print_result
    from shadelab.result import load_result

    result = load_result(directory)
    check_formats(format)
    kept, page = PictureFolder(directory / FOLDER, kept=True), directory / "report.html"
    with alone_in(directory):
        for name in format or []:
            print(f"wrote {shown(write_format(name, result, directory))}", file=sys.stderr)
        if title := kept.title():
            pictures = kept.of(result)
            write_html(result, pictures, page, title, hidden_details)
            if hidden_details and any(c.hidden and c.kind == "image" and c.id not in pictures for c in result.checks):
                print("no pictures of hidden scenes: only grade --hidden-details keeps them", file=sys.stderr)
        else:
            print(f"{shown(directory)}: holds no evidence/about.json, so report.html is not made", file=sys.stderr)
    print_result(result, console(), page if title else None, hidden_details)


def stability(
    directory: Submission,
    assignment: AssignmentName = None,
    out: Annotated[
        Optional[Path], typer.Option(help="where failing inputs are written (default: out/stability-ASSIGNMENT)")
    ] = None,
    json_: json_option("also write all figures here") = None,
) -> None:
    """Drive every function over edge and extreme inputs, in float, double and GLSL, against 50-digit arithmetic.

    Errors are counted in floors: what the rounding of the inputs alone makes of the result. A stable form stays within a few; a
    textbook form may be off by millions, or give no number at all. The first failing input is written to a file and can be
    replayed. An unstable function is a result, not an error: the exit code is 0.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.inspect.stability import measure, write_inputs
    from shadelab.report.stability import print_stability

    json = Json(json_)
    declared = find_assignment(directory, assignment)
    out = out or Path("out") / f"stability-{declared.name}"
    with progress_bar() as progress:
        found = measure(declared, directory, progress)
    try:
        find_assignment(directory, None)
        named = []
    except UserError:
        named = ["--assignment", declared.name]
    write_inputs(found, directory, out, named)
    json.write(found.to_json())
    print_stability(found, json.console)
