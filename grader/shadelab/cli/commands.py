"""The command line. stdout carries the result, stderr progress and messages.

Exit codes: 0 done (a low score is still 0); 1 only for --fail-under or a failed check or test; 2 bad usage or bad input;
3 infrastructure.
"""

import json
import os
import subprocess
import sys
import time
import zipfile
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from shadelab.errors import InfrastructureError, UserError
from shadelab.machine.sandbox import Limits, Sandbox, work_folder
from shadelab.paths import RENDER, ROOT, SCENES, SOLUTION, shown

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

errors = Console(stderr=True, highlight=False)
SHOWN = 1 << 20  # bytes of a program's output that render and eval show
Backend = Literal["cpp", "glsl"]


@contextmanager
def progress_bar():
    """A callable (what, done, total) that draws on stderr, where somebody looks at it."""
    if not errors.is_terminal:
        yield lambda what, done, total: None
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


# --------------------------------------------------------------------------------------------------------- grade


@app.command()
def grade(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="the folder with shading.cpp and shading.glsl")],
    assignment: Annotated[
        Optional[str], typer.Option(help="which assignment (default: from assignment.toml or the folder's name)")
    ] = None,
    out: Annotated[
        Optional[Path], typer.Option(help="where result.json and report.html go (default: out/ASSIGNMENT)")
    ] = None,
    json_: Annotated[
        Optional[str], typer.Option("--json", metavar="FILE|-", help="also write result.json here; - is stdout")
    ] = None,
    fail_under: Annotated[
        Optional[float], typer.Option(min=0, max=100, metavar="P", help="exit with 1 when the score is under P percent")
    ] = None,
    only: Annotated[
        str, typer.Option(metavar="GLOB", help="only checks whose id matches, for example 'cpp/function/*'")
    ] = "*",
    format: Annotated[
        Optional[list[str]],
        typer.Option(
            metavar="NAME", help="also write gradescope, classroom50, junit or markdown there; may be repeated"
        ),
    ] = None,
    html: Annotated[bool, typer.Option(help="write report.html; without it, no picture is kept in memory")] = True,
    hidden_details: Annotated[
        bool, typer.Option("--hidden-details", help="for instructors: show what is wrong in hidden scenes, too")
    ] = False,
) -> None:
    """Grade one submission: build, run and compare it with the expected data, and say what is wrong.

    A table goes to stdout; result.json and report.html (pictures, worst pixels) go to the folder given by --out, and so does
    what --format asks for: results.json, classroom50.json, junit.xml, summary.md.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.grading.grade import grade as run_grade
    from shadelab.grading.grade import plan_checks, write_worst_inputs
    from shadelab.report import formats
    from shadelab.report.annotations import annotations
    from shadelab.report.html import write_html
    from shadelab.report.terminal import print_result

    declared = find_assignment(directory, assignment)
    if not any(plan_checks(declared, only).values()):
        raise UserError(
            f"--only {only}: no check of {declared.name} has such an id; ids look like cpp/function/{declared.functions[0].name}"
        )
    if json_ and json_ != "-" and not Path(json_).parent.is_dir():
        raise UserError(f"--json {json_}: there is no folder {shown(Path(json_).parent)}")
    for name in format or []:
        if name not in formats.FORMATS:
            raise UserError(f"--format {name}: there is {', '.join(formats.FORMATS)}")
    out = out or Path("out") / declared.name
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{shown(out)}: cannot be made: {error.strerror}; choose another folder with --out") from None

    def rewrite(result) -> None:
        for name in format or []:
            formats.write(name, result, out)

    with progress_bar() as progress:
        grading = run_grade(declared, directory, out, only, progress, rewrite, pictures=html)
    write_worst_inputs(declared, grading, directory, out)
    rewrite(grading.result)
    if html:
        write_html(grading.result, grading.pictures, out / "report.html", declared.title, hidden_details)
    if os.environ.get("GITHUB_ACTIONS") == "true":  # its runner reads them from any output
        for line in annotations(grading.result, shown(directory)):
            print(line, file=sys.stderr)
    if json_ and json_ != "-":
        Path(json_).write_text(grading.result.to_json())
    if json_ == "-":
        print(grading.result.to_json(), end="")
    console = errors if json_ == "-" else Console(highlight=False)
    print_result(grading.result, console, out / "report.html" if html else None, hidden_details)
    result = grading.result
    if any(check.status == "error" for check in result.checks):
        raise typer.Exit(3)
    if fail_under is not None and 100 * result.score < fail_under * result.max_score - 1e-6:
        raise typer.Exit(1)


# ----------------------------------------------------------------------------------------------------- stability


@app.command()
def stability(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="the folder with shading.cpp and shading.glsl")],
    assignment: Annotated[
        Optional[str], typer.Option(help="which assignment (default: from assignment.toml or the folder's name)")
    ] = None,
    out: Annotated[
        Optional[Path], typer.Option(help="where failing inputs are written (default: out/stability-ASSIGNMENT)")
    ] = None,
    json_: Annotated[
        Optional[str], typer.Option("--json", metavar="FILE|-", help="also write all figures here; - is stdout")
    ] = None,
) -> None:
    """Drive every function over edge and extreme inputs, in float, double and GLSL, against 50-digit arithmetic.

    Errors are counted in floors: what the rounding of the inputs alone makes of the result. A stable form stays within a few; a
    textbook form may be off by millions, or give no number at all. The first failing input is written to a file and can be replayed.
    An unstable function is a result, not an error: the exit code is 0.
    """
    from shadelab.course.assignment import find_assignment
    from shadelab.inspect.stability import measure, write_inputs
    from shadelab.report.stability import print_stability

    declared = find_assignment(directory, assignment)
    out = out or Path("out") / f"stability-{declared.name}"
    with progress_bar() as progress:
        report = measure(declared, directory, progress)
    try:
        find_assignment(directory, None)
        named = []
    except UserError:
        named = ["--assignment", declared.name]
    write_inputs(report, directory, out, named)
    if json_ and json_ != "-":
        if not Path(json_).parent.is_dir():
            raise UserError(f"--json {json_}: there is no folder {shown(Path(json_).parent)}")
        Path(json_).write_text(report.to_json())
    if json_ == "-":
        print(report.to_json(), end="")
    print_stability(report, errors if json_ == "-" else Console(highlight=False))


# --------------------------------------------------------------------------------------------------- render, eval


def _assignment_of_scene(scene: Path, shading: Path | None):
    """The assignment that declares a scene's models: that of --shading, of the scene's folder, or the first that has them."""
    from shadelab.course.assignment import assignment_names, find_assignment, load_assignment
    from shadelab.course.toml_files import read_toml

    if shading is not None:
        try:
            return find_assignment(shading, None)
        except UserError:
            if not shading.is_dir():
                raise UserError(f"{shown(shading)}: there is no such folder") from None
            # A folder of any name: the scene tells the assignment.
    names = assignment_names()
    materials = read_toml(scene).get("material", {})
    materials = materials.values() if isinstance(materials, dict) else []  # the renderer says what is wrong with it
    models = {m.get("model") for m in materials if isinstance(m, dict)}
    candidates = [scene.resolve().parent.name] if scene.resolve().parent.name in names else names
    for name in candidates:
        declared = load_assignment(SOLUTION / name)
        if len(candidates) == 1 or models <= {f.name for f in declared.functions}:
            return declared
    raise UserError(f"{shown(scene)}: no assignment declares all of its models ({', '.join(sorted(map(str, models)))})")


def _student_build(runner, folder: Path) -> float:
    """Returns the seconds that it took: next to nothing when it was built before."""
    from shadelab.machine.build import BuildError

    start = time.perf_counter()
    try:
        runner.build(folder)
    except BuildError as error:
        raise UserError(error.message) from None
    return time.perf_counter() - start


def _needs(scene: Path, options: list[str]) -> dict:
    """Which loops and layers the scene's plugin must hold; with --explain among the options, all that it needs."""
    outcome = subprocess.run([str(RENDER), "needs", str(scene), *options], capture_output=True, text=True)
    if outcome.returncode:
        print(outcome.stderr, end="", file=sys.stderr)
        raise typer.Exit(outcome.returncode if outcome.returncode in (2, 3) else 3)
    return json.loads(outcome.stdout)


@app.command()
def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file, for example scenes/phong/teapot.toml")],
    backend: Annotated[Backend, typer.Option(help="the C++ rasterizer or OpenGL")] = "cpp",
    shading: Annotated[
        Optional[Path], typer.Option(metavar="DIR", help="whose shading functions (default: the solution's)")
    ] = None,
    double: Annotated[
        bool, typer.Option("--double", help="C++ only: compute in double, as the reference does")
    ] = False,
    size: Annotated[Optional[str], typer.Option(metavar="WxH", help="pixels, instead of the scene's")] = None,
    samples: Annotated[
        Optional[int], typer.Option(help="coverage samples per pixel: 1 2 4 8 16 64 (glsl: 1 2 4)")
    ] = None,
    supersample: Annotated[
        Optional[int], typer.Option(min=1, max=64, help="draw N times larger and average N x N pixels")
    ] = None,
    layers: Annotated[
        bool, typer.Option("--layers", help="write ambient, diffuse, specular, id, depth, normal, position too")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="print what the scene needs and what was left out")
    ] = False,
    full: Annotated[bool, typer.Option("--full", help="leave nothing out")] = False,
    packet: Annotated[
        Optional[Path], typer.Option(metavar="FILE", help="write the frame packet that an OpenGL client draws")
    ] = None,
    exposure: Annotated[float, typer.Option(help="PNG only: brighten by 2^EXPOSURE")] = 0.0,
    threads: Annotated[Optional[int], typer.Option(min=1, max=256, help="C++ only: number of threads")] = None,
    output: Annotated[
        Optional[Path],
        typer.Option("-o", "--output", metavar="FILE", help=".png, .exr or .npy (default: out/SCENE.png)"),
    ] = None,
) -> None:
    """Render one image with the solution's or a student's shading functions, in C++ or in GLSL."""
    from shadelab.course.assignment import Scene
    from shadelab.evidence.runners import CppRunner, Draw, GlslRunner
    from shadelab.machine.build import Recipe

    if not scene.is_file():
        raise UserError(f"{shown(scene)}: cannot be read; does the file exist? Scenes stand in {shown(SCENES)}")
    if double and backend == "glsl":
        raise UserError("--double: GLSL 330 computes in float only; use --backend cpp")
    allowed = (1, 2, 4) if backend == "glsl" else (1, 2, 4, 8, 16, 64)
    if samples is not None and samples not in allowed:
        raise UserError(
            f"--samples {samples}: {backend} has {', '.join(map(str, allowed))}; --supersample takes any number"
        )
    declared = _assignment_of_scene(scene, shading)
    solution = declared.directory
    if not (solution / declared.files[0]).exists():  # a release has none: there it is the student's folder
        solution = ROOT / declared.name
    folder = shading or solution
    options = ["--assignment", str(declared.directory)]
    for name, value in {"--size": size, "--samples": samples, "--supersample": supersample}.items():
        options += [name, str(value)] if value is not None else []
    options += [name for name, value in {"--layers": layers, "--full": full, "--explain": explain}.items() if value]
    output = output or (None if packet else Path("out") / f"{scene.stem}.png")
    if output is not None:
        if output.suffix not in (".png", ".exr", ".npy"):
            raise UserError(f"{shown(output)}: unknown image format; end the name in .png, .exr or .npy")
        output.parent.mkdir(parents=True, exist_ok=True)

    with work_folder("render") as work:
        packet_file = packet or work / "frame.packet"
        if packet or backend == "glsl":
            plain = [o for o in options if o != "--explain"]
            _run_renderer(["packet", str(scene), *plain, "-o", str(packet_file)])
        if packet and output is None:
            if explain:
                _print_needs(_needs(scene, options))
            print(shown(packet))
            return
        if backend == "cpp":
            sandbox = Sandbox(work, SHOWN)
            needs = _needs(scene, [o for o in options if o != "--explain"])
            loops = None if full else tuple(needs["loops"])
            runner = CppRunner(declared, sandbox, Recipe(double, functions=full, loops=loops, terms=needs["terms"]))
            seconds = _student_build(runner, folder)
            numbers = ["--exposure", str(exposure), *(["--threads", str(threads)] if threads else [])]
            if explain and not full:
                everything = CppRunner(declared, sandbox, Recipe(double))
                full_seconds = _student_build(everything, folder)
                numbers += ["--full-plugin", str(everything.plugin.file)]
            image = [
                "image",
                str(scene),
                *options,
                "--plugin",
                str(runner.plugin.file),
                "-o",
                str(output.resolve()),
                *numbers,
            ]
            _show(runner.sandbox.run([str(RENDER), *image], Limits(seconds=600, memory=8 << 30), cwd=Path.cwd()))
            if explain and not full and min(seconds, full_seconds) > 0.3:  # neither was there already
                print(f"compiled in {seconds:.2f} s instead of {full_seconds:.2f} s with every loop and layer")
        else:
            gl = GlslRunner(declared, Sandbox(work))
            _student_build(gl, folder)
            if explain:
                _explain_glsl(gl, scene, options, work)
            [(_, drawn)] = gl.run([Draw(Scene(scene.stem, scene, 0), packet_file)])
            if drawn.array is None:
                raise UserError(f"{shown(scene)}: the render {drawn.failure}")
            _write_image(drawn.array if layers else drawn.array[..., :3], output, exposure)
    print(shown(output))


def _explain_glsl(gl, scene: Path, options: list[str], work: Path) -> None:
    """What the scene needs and what is left out, as the renderer prints it for C++; what an omission saves is measured by
    drawing the packet with it and without, in turn."""
    from shadelab.course.assignment import Scene
    from shadelab.evidence.runners import Draw

    needs = _needs(scene, options)
    # The compiler drops what a shader does not use; of the rest there is a packet with each thing kept.
    kept = [name for name in needs["names"] if name in ("terms", "geometry", "fallback") or name.startswith("light[")]
    packets = {name: work / f"keep-{index}.packet" for index, name in enumerate(["", *kept])}
    plain = [o for o in options if o != "--explain"]
    for name, file in packets.items():
        _run_renderer(["packet", str(scene), *plain, *(["--keep", name] if name else []), "-o", str(file)])
    tasks = {name: Draw(Scene(scene.stem, scene, 0), file) for name, file in packets.items()}
    names = [name for _ in range(5) for name in tasks]
    times = {name: [] for name in tasks}
    for name, (_, drawn) in zip(names, gl.run([tasks[name] for name in names])):
        times[name].append(drawn.seconds)
    best = {name: 1000 * min(t[1:]) for name, t in times.items()}  # the first of each compiles
    saved = {}
    for name in kept:
        gain = max(0.0, best[name] - best[""])
        saved[name] = f"; saves {gain:.2f} of {best[''] + gain:.2f} ms, upload and read-back included"
    _print_needs(needs, saved)
    compiling = 1000 * times[""][0] - best[""]
    print(f"compiling the shaders takes {max(0.0, compiling):.0f} ms before the first frame")


def _print_needs(needs: dict, saved: dict[str, str] | None = None) -> None:
    """Both lists; `saved`: what was measured for an omission, by its name."""
    print("needed")
    for line in needs["needed"]:
        print(f"  + {line}")
    print("left out")
    for name, line in zip(needs["names"], needs["left_out"]):
        print(f"  - {line}{(saved or {}).get(name, '')}")


def _run_renderer(arguments: list[str]) -> None:
    """The renderer without student code: no sandbox."""
    code = subprocess.run([str(RENDER), *arguments]).returncode
    if code:
        raise typer.Exit(code if code in (2, 3) else 3)


def _show(outcome) -> None:
    """--explain's lists and what the student's code prints are a result (stdout); notes and warnings are messages (stderr)."""
    print(outcome.stdout.decode(errors="replace"), end="")
    print(outcome.stderr, end="", file=sys.stderr)
    if outcome.returncode in (2, 3):
        raise typer.Exit(outcome.returncode)
    if not outcome.ok:
        raise UserError(f"the render {outcome.explain(Limits(seconds=600))}")


def _write_image(image, output: Path, exposure: float) -> None:
    """What the C++ film writes, for an image of the OpenGL client."""
    import numpy as np

    if output.suffix == ".npy":
        np.save(output, image)
        return
    raw = output.with_suffix(".part.npy")
    np.save(raw, image)
    try:
        _run_renderer(["convert", str(raw), "-o", str(output), "--exposure", str(exposure)])
    finally:
        raw.unlink()


@app.command("eval")
def evaluate(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="the folder with shading.cpp and shading.glsl")],
    function: Annotated[
        str, typer.Argument(metavar="FUNCTION", help="a function of the assignment, for example phong_lobe")
    ],
    inputs: Annotated[
        Path,
        typer.Option(
            "--inputs", metavar="IN.npz", help="arrays named as the arguments; a struct's members as arg.member"
        ),
    ],
    output: Annotated[
        Optional[Path], typer.Option("-o", "--output", metavar="OUT.npz", help="holds result, or result.member")
    ] = None,
    backend: Annotated[Backend, typer.Option(help="the C++ or the GLSL function")] = "cpp",
    double: Annotated[bool, typer.Option("--double", help="C++ only: the double build")] = False,
    assignment: Annotated[
        Optional[str], typer.Option(help="which assignment (default: from assignment.toml or the folder's name)")
    ] = None,
) -> None:
    """Evaluate one function over arrays and show what it computes and prints.

    IN.npz holds one array per argument; the first axis is the evaluation. For example, in Python:

        np.savez("in.npz", n=[[0, 1, 0]], l=[[0, 1, 0]], v=[[0, 0.6, 0.8]], q=[32])
    """
    import numpy as np

    from shadelab.course.assignment import find_assignment, flat_rows, named_arrays
    from shadelab.evidence.runners import CppRunner, Evaluate, GlslRunner
    from shadelab.machine.build import Recipe

    if double and backend == "glsl":
        raise UserError("--double: GLSL 330 computes in float only; use --backend cpp")
    declared = find_assignment(directory, assignment)
    wanted = declared.function(function)
    try:
        arrays = dict(np.load(inputs, allow_pickle=False))
        arrays = {name: np.asarray(array, float) for name, array in arrays.items()}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        raise UserError(f"{shown(inputs)}: cannot be read as .npz; write it with numpy.savez") from None
    columns = declared.input_columns(wanted)
    rows = flat_rows(columns, arrays, np.float64 if double else np.float32)
    with work_folder("eval") as work:
        sandbox = Sandbox(work, SHOWN)
        recipe = Recipe(double, loops=())
        runner = CppRunner(declared, sandbox, recipe) if backend == "cpp" else GlslRunner(declared, sandbox)
        _student_build(runner, directory)
        [(_, result)] = runner.run([Evaluate(wanted, rows)])
    if result.printed:
        print(result.printed, end="" if result.printed.endswith("\n") else "\n")
    if result.array is None:
        raise UserError(f"{function} {result.failure}")
    results = named_arrays(declared.output_columns(wanted), result.array)
    if output:
        np.savez(output, **results)
    for row in range(min(len(rows), 10)):
        given = ", ".join(f"{name} = {_short(a[row])}" for name, a in named_arrays(columns, rows).items())
        came = ", ".join(f"{name} = {_short(a[row])}" for name, a in results.items())
        print(f"{function}({given})\n    {came}")
    if len(rows) > 10:
        print(f"... {len(rows) - 10} more" + ("" if output else "; -o OUT.npz writes them all"))


def _short(value) -> str:
    import numpy as np

    value = np.atleast_1d(value)
    text = ", ".join(f"{float(v):.7g}" for v in value)
    return text if len(value) == 1 else f"({text})"


@app.command()
def probe(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file, for example scenes/phong/sphere.toml")],
    pixel: Annotated[str, typer.Argument(metavar="X,Y", help="which pixel; 0,0 is the one at the top left")],
    shading: Annotated[
        Optional[Path], typer.Option(metavar="DIR", help="whose shading functions (default: the solution's)")
    ] = None,
    json_: Annotated[
        Optional[str], typer.Option("--json", metavar="FILE|-", help="also write everything here; - is stdout")
    ] = None,
) -> None:
    """Printf for shaders: what takes part at one pixel, and what every function gives there.

    Shows n, v, x, the material and, for each light, l and h, then the values of all functions: C++, GLSL, and what is expected
    where that may be shown. What is off is marked; the last line names the first function that is wrong.
    """
    from shadelab.inspect.probe import as_json, pixel_of, print_probe
    from shadelab.inspect.probe import probe as run_probe

    if not scene.is_file():
        raise UserError(f"{shown(scene)}: cannot be read; does the file exist? Scenes stand in {shown(SCENES)}")
    if json_ and json_ != "-" and not Path(json_).absolute().parent.is_dir():
        raise UserError(f"--json {json_}: there is no folder {shown(Path(json_).parent)}")
    place = pixel_of(pixel)
    declared = _assignment_of_scene(scene, shading)
    own = declared.directory if (declared.directory / declared.files[0]).exists() else ROOT / declared.name
    with progress_bar() as progress:
        found = run_probe(declared, scene, place, shading or own, progress)
    if json_ == "-":
        print(as_json(found), end="")
    elif json_:
        Path(json_).write_text(as_json(found))
    print_probe(found, errors if json_ == "-" else Console(highlight=False))


# ------------------------------------------------------------------------------------------ instructors' commands


@app.command()
def reference(name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")]) -> None:
    """Make the expected data of an assignment from its solution's double build (grade does it when it is missing)."""
    from shadelab.course.assignment import find_assignment
    from shadelab.judge.findings import function_limit
    from shadelab.truth import making as references

    declared = find_assignment(SOLUTION / name, name)
    with progress_bar() as progress:
        made = references.load(declared, progress)
    print(shown(made.folder))
    table = Table("function", "language", "floor", "limit", "set by", box=box.SIMPLE_HEAD, pad_edge=False)
    for function, languages in made.facts.spread.items():
        for backend, programs in languages.items():
            floor, farthest = max((error, name) for name, error in programs.items())
            table.add_row(function, backend, f"{floor:.2g}", f"{function_limit(floor, backend):.2g}", farthest)
    Console(highlight=False).print(table)


@app.command()
def check(
    names: Annotated[
        Optional[list[str]], typer.Argument(metavar="[NAME]...", help="assignments (default: all)")
    ] = None,
    images: Annotated[
        bool, typer.Option("--images", help="draw the scenes for the mistakes, too (takes several times as long)")
    ] = False,
) -> None:
    """Grade the grader: every declared mistake must lose points and be named, every correct variant must lose none.

    Where mistakes.toml says so, single tokens of the solution are changed as well (mutants); none may pass.
    """
    from shadelab.course.assignment import assignment_names, find_assignment
    from shadelab.prove.check import check as run_check
    from shadelab.report.matrix import print_matrix

    missed = 0
    for name in names or assignment_names():
        declared = find_assignment(SOLUTION / name, name)
        with progress_bar() as progress:
            matrix = run_check(declared, progress, images)
        missed += print_matrix(declared.name, matrix, Console(highlight=False))
    if missed:
        raise typer.Exit(1)


@app.command()
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


@app.command()
def bench(
    json_: Annotated[
        Optional[str], typer.Option("--json", metavar="FILE|-", help="write all numbers here; - is stdout")
    ] = None,
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
    from shadelab.measure.bench import print_report, write_readme
    from shadelab.measure.bench import run as run_bench

    if readme and (quick or only != "*"):
        raise UserError("--readme: the table holds all cases; leave --quick and --only out")
    if json_ and json_ != "-" and not Path(json_).absolute().parent.is_dir():
        raise UserError(f"--json {json_}: there is no folder {shown(Path(json_).parent)}")
    with progress_bar() as progress:
        numbers = run_bench(only, pairs, level, threads, quick, resume, progress)
    text = json.dumps(numbers, indent=1) + "\n"
    if json_ == "-":
        print(text, end="")
    elif json_:
        Path(json_).write_text(text)
    print_report(numbers, errors if json_ == "-" else Console(highlight=False))
    if readme:
        write_readme(numbers)


@app.command()
def study(
    what: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|NAME", help="a scene file, a study in studies/, or an assignment: all its scenes"
        ),
    ],
    shading: Annotated[
        Optional[Path], typer.Option(metavar="DIR", help="whose shading functions (default: the solution's)")
    ] = None,
    out: Annotated[
        Optional[Path], typer.Option(metavar="DIR", help="where numbers and figures go (default: out/study-NAME)")
    ] = None,
    json_: Annotated[
        Optional[str], typer.Option("--json", metavar="FILE|-", help="also write all numbers here; - is stdout")
    ] = None,
) -> None:
    """Measure error against run time: what more samples, finer meshes or other arithmetic cost, and what they gain.

    `./shadelab study scenes/phong/teapot.toml` takes a minute at most: 1 to 64 samples a pixel, at random, stratified and on a
    grid, against a converged picture in double; C++ in float and double and GLSL; and what leaving out saves. `./shadelab study
    interpolation` runs studies/interpolation.toml, and `./shadelab study phong` compares the backends over all scenes of phong.

    Every time is the median of several runs, drawn in turn with all others, on one thread; the table says how far they lie apart.
    A star marks the Pareto front: nothing else is as fast and as exact. study.json, study.csv and the figures (PNG and SVG,
    for light and for dark pages) go to the folder given by --out.
    """
    from shadelab.course.assignment import assignment_names
    from shadelab.study.declaration import studied
    from shadelab.study.report import as_text, print_study, write_files
    from shadelab.study.run import run_study

    if shading is not None and not shading.is_dir():
        raise UserError(f"--shading {shown(shading)}: there is no such folder; give the one that holds shading.cpp")
    if json_ and json_ != "-" and not Path(json_).absolute().parent.is_dir():
        raise UserError(f"--json {json_}: there is no folder {shown(Path(json_).parent)}")
    name = studied(what, assignment_names())[0]
    out = out or Path("out") / f"study-{name}"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{shown(out)}: cannot be made: {error.strerror}; choose another folder with --out") from None
    with progress_bar() as progress:
        numbers, parts = run_study(what, shading, lambda scene: _assignment_of_scene(scene, shading), progress)
        progress("drawing the figures", 0, 1)
        files = write_files(numbers, parts, out)
    if json_ == "-":
        print(as_text(numbers), end="")
    elif json_:
        Path(json_).write_text(as_text(numbers))
    output = errors if json_ == "-" else Console(highlight=False)
    print_study(numbers, parts, output)
    for file in files:
        output.print(shown(file), markup=False, soft_wrap=True)


@app.command()
def release(
    name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="a folder that is empty or not there yet")],
    force: Annotated[bool, typer.Option("--force", help="replace the files of a former release")] = False,
) -> None:
    """Write what students receive: a checkout that holds this assignment alone, its expected data, and no solution of it."""
    from shadelab.course.assignment import find_assignment
    from shadelab.publish.release import folder_size, write_release

    declared = find_assignment(SOLUTION / name, name)
    for warning in write_release(declared, out, force):
        print(f"{shown(out)}: {warning}", file=sys.stderr)
    print(
        f"{shown(out)}: {folder_size(out) / 1e6:.0f} MB; students start with: cd {shown(out)} && ./shadelab grade {name}"
    )


@app.command()
def package(
    name: Annotated[str, typer.Argument(metavar="NAME", help="an assignment, for example phong")],
    target: Annotated[str, typer.Option("--for", metavar="SYSTEM", help="gradescope")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.zip")],
    seed: Annotated[
        Optional[str], typer.Option(help="what hidden scenes are drawn from (default: drawn at random)")
    ] = None,
) -> None:
    """Write the zip that an autograding service takes. Its hidden scenes are drawn from a seed of its own."""
    from shadelab.course.assignment import find_assignment
    from shadelab.publish.package import write_package

    digest = write_package(find_assignment(SOLUTION / name, name), target, output, seed)
    print(f"{shown(output)}: {output.stat().st_size / 1e6:.1f} MB; digest of the seed: {digest}")


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="small letters, digits, single underscores")],
    title: Annotated[Optional[str], typer.Option(help="how handout and reports call it (default: from NAME)")] = None,
) -> None:
    """Start an assignment: a small one that works, to replace piece by piece."""
    from shadelab.publish.new import next_steps, write_assignment

    for file in write_assignment(name, title):
        print(shown(file))
    print(next_steps(name), file=sys.stderr)


@app.command()
def doctor() -> None:
    """Say what this machine can do, and how to mend what it can't."""
    from shadelab.inspect.doctor import examine

    output = Console(highlight=False)
    findings = examine()
    for finding in findings:
        mark = {"ok": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]bad [/]"}[finding.state]
        output.print(f"{mark}  {finding.what}: ", end="")
        output.print(finding.says, markup=False)
        if finding.mend:
            output.print(f"      {finding.mend}", markup=False)
    if any(f.state == "bad" for f in findings):
        raise typer.Exit(3)


@app.command()
def test(
    slow: Annotated[bool, typer.Option("--slow", help="also the tests marked slow and oracle")] = False,
    select: Annotated[
        Optional[str], typer.Option("-k", metavar="WORDS", help="only Python tests whose name matches")
    ] = None,
) -> None:
    """Run all tests: C++ (ctest) and Python (pytest). The output ends with pytest's summary."""
    environment = {**os.environ, "SHADELAB_ROOT": str(ROOT)}
    # Only those who run the tests compile them; set-up builds the renderer alone.
    print("building the C++ tests", file=sys.stderr)
    build = subprocess.run(["ninja", "-C", str(ROOT / "build"), "--quiet"], capture_output=True, text=True)
    if build.returncode:
        print(build.stdout[-4000:], build.stderr[-1000:], "the C++ tests do not compile", sep="\n", file=sys.stderr)
        raise typer.Exit(1)
    cpp = subprocess.run(
        ["ctest", "--test-dir", str(ROOT / "build"), "--output-on-failure", "--no-tests=error", "-j2"], env=environment
    ).returncode
    # -I: a submission's numpy.py in the working folder must never be imported by us.
    command = [sys.executable, "-I", "-m", "pytest", "-q", "--rootdir", str(ROOT), str(ROOT / "tests" / "python")]
    # A file's tests stay together: they share what their fixtures have graded.
    command += ["-n", str(os.cpu_count() or 1), "--dist", "loadfile"]
    command += [] if slow else ["-m", "not slow and not oracle"]
    command += ["-k", select] if select else []
    python = subprocess.run(command, cwd=ROOT, env=environment).returncode
    if cpp:
        print("the C++ tests failed (above)", file=sys.stderr)
    if cpp or python:
        raise typer.Exit(1)


if not (ROOT / "solution").is_dir():  # a release: what instructors' commands need is not there
    theirs = (reference, check, starter, bench, study, release, package, new, test)
    app.registered_commands = [c for c in app.registered_commands if c.callback not in theirs]

_UsageError = typer.BadParameter.__bases__[0]  # click's class; typer has it from click or carries it itself


def main() -> None:
    try:
        sys.exit(app(standalone_mode=False, prog_name="./shadelab") or 0)
    except typer.Exit as done:
        sys.exit(done.exit_code)
    except _UsageError as error:
        print(" ".join(error.format_message().split()), file=sys.stderr)
        sys.exit(2)
    except typer.Abort:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except InfrastructureError as error:
        print(error, file=sys.stderr)
        sys.exit(3)
    except OSError as error:
        print(f"{error.filename or ''}: {error.strerror}", file=sys.stderr)
        sys.exit(3)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
