"""bench, study: error against run time."""

from json import dumps
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from shadelab.cli.options import Json, Shading, json_option, make_folder, progress_bar
from shadelab.errors import UserError
from shadelab.paths import shown


def register(app: typer.Typer) -> None:
    for command in (bench, study):
        app.command()(command)


def bench(
    json_: json_option("write all numbers here") = None,
    only: Annotated[
        str, typer.Option(metavar="GLOB", help="only measurements whose name matches, for example 'knot-70k/depth/*'")
    ] = "*",
    pairs: Annotated[int, typer.Option(min=15, max=1000, help="at least this many pairs of frames a case")] = 15,
    level: Annotated[
        Optional[Literal["plain", "v2", "v3", "v4"]],
        typer.Option(help="of x86-64 (default: the processor's best); below v3 llvmpipe is held to SSE, too"),
    ] = None,
    threads: Annotated[
        Optional[int], typer.Option(min=1, max=256, help="for both (default: 2, where there are two processors)")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="a few cases of each kind")] = False,
    readme: Annotated[bool, typer.Option("--readme", help="rewrite the table in README.md")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="go on with a run that was interrupted")] = False,
) -> None:
    """Time our rasterizer and llvmpipe in turn, with the error of each against the double build beside the times."""
    from shadelab.measure.bench import run as run_bench
    from shadelab.measure.bench_report import print_report, write_readme

    if readme and (quick or only != "*"):
        raise UserError("--readme: the table holds all cases; leave --quick and --only out")
    json = Json(json_)
    with progress_bar() as progress:
        numbers = run_bench(only, pairs, level, threads, quick, resume, progress)
    json.write(dumps(numbers, indent=1) + "\n")
    print_report(numbers, json.console)
    if readme:
        write_readme(numbers)


def study(
    what: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|NAME", help="a scene file, a study in studies/, or an assignment: all its scenes"
        ),
    ],
    shading: Shading = None,
    out: Annotated[
        Optional[Path], typer.Option(metavar="DIR", help="where numbers and figures go (default: out/study-NAME)")
    ] = None,
    json_: json_option("also write all numbers here") = None,
) -> None:
    """Measure error against run time: what more samples, finer meshes or other arithmetic cost, and what they gain.

    `./shadelab study scenes/phong/teapot.toml` takes a minute at most: 1 to 64 samples a pixel, at random, stratified and on a
    grid, against a converged picture in double; C++ in float and double and GLSL; and what leaving out saves. `./shadelab study
    interpolation` runs studies/interpolation.toml, and `./shadelab study phong` compares the backends over all scenes of phong.

    Every time is the median of several runs, drawn in turn with all others, on one thread; the table says how far they lie apart.
    A star marks the Pareto front: nothing else is as fast and as exact. study.json, study.csv and the figures (PNG and SVG,
    for light and for dark pages) go to the folder given by --out.
    """
    from shadelab.course.assignment import assignment_names, assignment_of_scene
    from shadelab.study.declaration import studied
    from shadelab.study.report import as_text, print_study, write_files
    from shadelab.study.run import run_study

    if shading is not None and not shading.is_dir():
        raise UserError(f"--shading {shown(shading)}: there is no such folder; give the one that holds shading.cpp")
    json = Json(json_)
    name = studied(what, assignment_names())[0]
    out = make_folder(out or Path("out") / f"study-{name}")
    with progress_bar() as progress:
        numbers, parts = run_study(what, shading, lambda scene: assignment_of_scene(scene, shading), progress)
        progress("drawing the figures", 0, 1)
        files = write_files(numbers, parts, out)
    json.write(as_text(numbers))
    print_study(numbers, parts, json.console)
    for file in files:
        json.console.print(shown(file), markup=False, soft_wrap=True)
