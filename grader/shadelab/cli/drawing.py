"""render, eval, probe: what shading functions draw and compute."""

import shutil
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from shadelab.cli.options import (
    AssignmentName,
    Backend,
    Json,
    Shading,
    Submission,
    existing_scene,
    json_option,
    progress_bar,
)
from shadelab.errors import UserError
from shadelab.files import whole
from shadelab.machine.sandbox import Limits, Sandbox, work_folder
from shadelab.paths import ROOT, shown

if TYPE_CHECKING:  # they bring numpy, which takes as long as all the rest of a command's start
    import numpy as np

    from shadelab.course.assignment import Column
    from shadelab.machine.renderer import Needs, View

SHOWN = 1 << 20  # bytes of a program's output that render and eval show
RENDER_LIMITS = Limits(seconds=600, memory=8 << 30)


def register(app: typer.Typer) -> None:
    app.command()(render)
    app.command("eval")(evaluate)
    app.command()(probe)


def _assignment(scene: Path, shading: Path | None):
    from shadelab.course.assignment import assignment_of_scene

    return assignment_of_scene(scene, shading)


def _own_folder(declared) -> Path:
    """The solution's; a release has none: there it is the student's folder."""
    return declared.directory if (declared.directory / declared.files[0]).exists() else ROOT / declared.name


def _student_build(runner, folder: Path) -> float:
    """Returns the seconds that it took: next to nothing when it was built before."""
    from shadelab.evidence.tasks import BuildError

    start = time.perf_counter()
    try:
        runner.build(folder)
    except BuildError as error:
        raise UserError(error.message) from None
    return time.perf_counter() - start


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file, for example scenes/phong/teapot.toml")],
    backend: Annotated[Backend, typer.Option(help="the C++ rasterizer or OpenGL")] = "cpp",
    shading: Shading = None,
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
    from shadelab.evidence.glsl import GlslRunner
    from shadelab.evidence.tasks import Draw
    from shadelab.machine import renderer

    existing_scene(scene)
    if double and backend == "glsl":
        raise UserError("--double: GLSL 330 computes in float only; use --backend cpp")
    allowed = (1, 2, 4) if backend == "glsl" else (1, 2, 4, 8, 16, 64)
    if samples is not None and samples not in allowed:
        raise UserError(
            f"--samples {samples}: {backend} has {', '.join(map(str, allowed))}; --supersample takes any number"
        )
    declared = _assignment(scene, shading)
    folder = shading or _own_folder(declared)
    view = renderer.View("all" if layers else "total", size, samples, supersample, full=full)
    output = output or (None if packet else Path("out") / f"{scene.stem}.png")
    if output is not None:
        if output.suffix not in (".png", ".exr", ".npy"):
            raise UserError(f"{shown(output)}: unknown image format; end the name in .png, .exr or .npy")
        output.parent.mkdir(parents=True, exist_ok=True)

    with work_folder("render") as work:
        packet_file = work / "frame.packet"
        if packet or backend == "glsl":
            print(renderer.packet(scene, declared.directory, packet_file, view), end="", file=sys.stderr)
        if packet:
            _hand_over(packet_file, packet)
        if packet and output is None:
            if explain:
                _print_needs(renderer.describe(scene, declared.directory, view, explain=True).needs)
            print(shown(packet))
            return
        if backend == "cpp":
            _render_cpp(declared, scene, folder, view, double, exposure, threads, explain, output, work)
        else:
            gl = GlslRunner(declared, Sandbox(work))
            _student_build(gl, folder)
            if explain:
                _explain_glsl(gl, scene, declared.directory, view, work)
            [(_, drawn)] = gl.run([Draw(Scene(scene.stem, scene, declared.directory), packet_file)])
            if drawn.array is None:
                raise UserError(f"{shown(scene)}: the render {drawn.failure}")
            _write_image(drawn.array if layers else drawn.array[..., :3], output, exposure, work)
    print(shown(output))


def _render_cpp(
    declared, scene: Path, folder: Path, view: "View", double: bool, exposure: float, threads: int | None, explain: bool,
    output: Path, work: Path,
) -> None:  # fmt: skip
    from shadelab.evidence.cpp import CppRunner
    from shadelab.machine import renderer
    from shadelab.machine.build import Recipe

    sandbox = Sandbox(work, SHOWN)
    described = renderer.describe(scene, declared.directory, view)
    loops = None if view.full else tuple(described.needs.loops)
    runner = CppRunner(
        declared, sandbox, Recipe(double, functions=view.full, loops=loops, terms=described.needs.terms), complete=True
    )
    seconds = _student_build(runner, folder)
    drawn = work / "drawn"  # with --layers there are several files
    drawn.mkdir()
    files = renderer.ImageFiles(drawn / output.name, exposure=exposure, threads=threads, explain=explain)
    compare = explain and not view.full
    if compare:
        everything = CppRunner(declared, sandbox, Recipe(double))
        full_seconds = _student_build(everything, folder)
        files = replace(files, full_plugin=everything.plugin.file)
    command = renderer.image(described, declared.directory, runner.plugin.file, view, files)
    _show(sandbox.run(command, RENDER_LIMITS, cwd=Path.cwd()))
    for file in drawn.iterdir():
        _hand_over(file, output.with_name(file.name))
    if compare and min(seconds, full_seconds) > 0.3:  # neither was there already
        print(f"compiled in {seconds:.2f} s instead of {full_seconds:.2f} s with every loop and layer")


def _explain_glsl(gl, scene: Path, assignment: Path, view: "View", work: Path) -> None:
    """What the scene needs and what is left out, as the renderer prints it for C++; what an omission saves is measured by
    drawing the packet with it and without, in turn."""
    from shadelab.course.assignment import Scene
    from shadelab.evidence.tasks import Draw
    from shadelab.machine import renderer

    needs = renderer.describe(scene, assignment, view, explain=True).needs
    # The compiler drops what a shader does not use; of the rest there is a packet with each thing kept.
    kept = [name for name in needs.names if name in ("terms", "geometry", "fallback") or name.startswith("light[")]
    tasks = {}
    for index, name in enumerate(["", *kept]):
        file = work / f"keep-{index}.packet"
        print(renderer.packet(scene, assignment, file, replace(view, keep=name)), end="", file=sys.stderr)
        tasks[name] = Draw(Scene(scene.stem, scene, assignment), file)
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


def _print_needs(needs: "Needs", saved: dict[str, str] | None = None) -> None:
    """Both lists; `saved`: what was measured for an omission, by its name."""
    print("needed")
    for line in needs.needed:
        print(f"  + {line}")
    print("left out")
    for name, line in zip(needs.names, needs.left_out):
        print(f"  - {line}{(saved or {}).get(name, '')}")


def _show(outcome) -> None:
    """--explain's lists and what the student's code prints are a result (stdout); notes and warnings are messages (stderr)."""
    print(outcome.stdout.decode(errors="replace"), end="")
    print(outcome.stderr, end="", file=sys.stderr)
    if outcome.returncode in (2, 3):
        raise typer.Exit(outcome.returncode)
    if not outcome.ok:
        raise UserError(f"the render {outcome.explain(RENDER_LIMITS)}")


def _hand_over(file: Path, target: Path) -> None:
    with whole(target) as part:
        shutil.copyfile(file, part)


def _write_image(image, output: Path, exposure: float, work: Path) -> None:
    """What the C++ film writes, for an image of the OpenGL client."""
    import numpy as np

    from shadelab.machine import renderer

    with whole(output) as part:
        if output.suffix == ".npy":
            np.save(part, image)
            return
        raw = work / "image.npy"
        np.save(raw, image)
        renderer.convert(raw, part, exposure)


def evaluate(
    directory: Submission,
    function: Annotated[
        str, typer.Argument(metavar="FUNCTION", help="a function of the assignment, for example phong_lobe")
    ],
    inputs: Annotated[
        Optional[Path],
        typer.Option(
            "--inputs", metavar="IN.npz", help="arrays named as the arguments; a struct's members as arg.member"
        ),
    ] = None,
    set_: Annotated[
        Optional[list[str]],
        typer.Option(
            "--set", metavar="NAME=VALUE", help="one input by hand, for example q=32 or n=0,0,1; may be repeated"
        ),
    ] = None,
    output: Annotated[
        Optional[Path], typer.Option("-o", "--output", metavar="OUT.npz", help="holds result, or result.member")
    ] = None,
    backend: Annotated[Backend, typer.Option(help="the C++ or the GLSL function")] = "cpp",
    double: Annotated[bool, typer.Option("--double", help="C++ only: the double build")] = False,
    assignment: AssignmentName = None,
) -> None:
    """Evaluate one function over arrays and show what it computes and prints.

    Inputs by hand:

        ./shadelab eval starter/phong phong_lobe --set n=0,1,0 --set l=0,1,0 --set v=0,0.6,0.8 --set q=32

    Many at once: IN.npz holds one array per argument; the first axis is the evaluation. For example, in Python:

        np.savez("in.npz", n=[[0, 1, 0]], l=[[0, 1, 0]], v=[[0, 0.6, 0.8]], q=[32])

    Both: --set takes the place of an array, for all rows.
    """
    import numpy as np

    from shadelab.course.assignment import find_assignment, flat_rows, named_arrays
    from shadelab.evidence.cpp import CppRunner
    from shadelab.evidence.glsl import GlslRunner
    from shadelab.evidence.tasks import Evaluate
    from shadelab.machine.build import Recipe

    if double and backend == "glsl":
        raise UserError("--double: GLSL 330 computes in float only; use --backend cpp")
    declared = find_assignment(directory, assignment)
    wanted = declared.function(function)
    columns = wanted.inputs
    if inputs is None and not set_:
        raise UserError(f"which inputs? Give --inputs IN.npz, or --set for each of {', '.join(_paths(columns))}")
    try:
        arrays = dict(np.load(inputs, allow_pickle=False)) if inputs else {}
        arrays = {name: np.asarray(array, float) for name, array in arrays.items()}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        raise UserError(f"{shown(inputs)}: cannot be read as .npz; write it with numpy.savez") from None
    arrays |= _by_hand(set_ or [], columns, max((len(np.atleast_1d(a)) for a in arrays.values()), default=1))
    rows = flat_rows(columns, arrays, np.float64 if double else np.float32)
    with work_folder("eval") as work:
        sandbox = Sandbox(work, SHOWN)
        recipe = Recipe(double, loops=())
        runner = (
            CppRunner(declared, sandbox, recipe, complete=True) if backend == "cpp" else GlslRunner(declared, sandbox)
        )
        _student_build(runner, directory)
        [(_, result)] = runner.run([Evaluate(wanted, rows)])
    if runner.warnings:
        print(runner.warnings, file=sys.stderr)
    if result.printed:
        print(result.printed, end="" if result.printed.endswith("\n") else "\n")
    if result.array is None:
        raise UserError(f"{function} {result.failure}")
    results = named_arrays(wanted.outputs, result.array)
    if output:
        with whole(output) as part:
            np.savez(part, **results)
    for row in range(min(len(rows), 10)):
        given = ", ".join(f"{name} = {_short(a[row])}" for name, a in named_arrays(columns, rows).items())
        came = ", ".join(f"{name} = {_short(a[row])}" for name, a in results.items())
        print(f"{function}({given})\n    {came}")
    if len(rows) > 10:
        print(f"... {len(rows) - 10} more" + ("" if output else "; -o OUT.npz writes them all"))


def _paths(columns: list["Column"]) -> dict[str, int]:
    """The inputs by name, and how many numbers each takes."""
    return {column.path: column.width for column in columns}


def _by_hand(settings: list[str], columns: list["Column"], rows: int) -> dict[str, "np.ndarray"]:
    """What --set says, once for each row. Raises UserError."""
    import numpy as np

    arrays, widths = {}, _paths(columns)
    for setting in settings:
        name, _, text = setting.partition("=")
        if name not in widths:
            raise UserError(f"--set {setting}: the inputs are {', '.join(widths)}")
        try:
            numbers = [float(number) for number in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != widths[name]:
            example = ",".join(["0", "0", "1", "0"][: widths[name]]) if widths[name] > 1 else "32"
            count = "a number" if widths[name] == 1 else f"{widths[name]} numbers"
            raise UserError(f"--set {setting}: {name} takes {count}, as in {name}={example}")
        arrays[name] = np.tile(numbers, (rows, 1)) if widths[name] > 1 else np.full(rows, numbers[0])
    return arrays


def _short(value) -> str:
    import numpy as np

    value = np.atleast_1d(value)
    text = ", ".join(f"{float(v):.7g}" for v in value)
    return text if len(value) == 1 else f"({text})"


def probe(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file, for example scenes/phong/sphere.toml")],
    pixel: Annotated[str, typer.Argument(metavar="X,Y", help="which pixel; 0,0 is the one at the top left")],
    shading: Shading = None,
    json_: json_option("also write everything here") = None,
) -> None:
    """Printf for shaders: what takes part at one pixel, and what every function gives there.

    Shows n, v, x, the material and, for each light, l and h, then the values of all functions: C++, GLSL, and what is expected
    where that may be shown. What is off is marked; the last line names the first function that is wrong.
    """
    from shadelab.inspect.probe import as_json, pixel_of
    from shadelab.inspect.probe import probe as run_probe
    from shadelab.report.probe import print_probe

    existing_scene(scene)
    json = Json(json_)
    place = pixel_of(pixel)
    declared = _assignment(scene, shading)
    with progress_bar() as progress:
        found = run_probe(declared, scene, place, shading or _own_folder(declared), progress)
    json.write(as_json(found))
    print_probe(found, json.console)
