"""The same frames by C++ in float and in double and by OpenGL, each with what the scene needs and with everything (--full).

All draw the same sample positions, so what differs is arithmetic, and what the two rasterizers make of an edge. The double
build is the reference.
"""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

from shadelab.course.assignment import Assignment, Scene
from shadelab.errors import UserError
from shadelab.measure.images import image_error
from shadelab.measure.timing import geometric_mean, interleaved
from shadelab.paths import shown
from shadelab.study.declaration import Study
from shadelab.study.points import Part, Point
from shadelab.study.timing import Drawer, Workbench

SERIES = ["cpp-float", "cpp-float-full", "cpp-double", "glsl", "glsl-full"]
LANGUAGES = {"C++": ("cpp-float", "cpp-float-full"), "GLSL": ("glsl", "glsl-full")}  # what is needed, and everything


def measure_backends(study: Study, work: Workbench, scenes: list[tuple[Assignment, Scene]], name: str, of: str) -> Part:
    part = Part(
        name, study.title, of,
        {"what": "C++ double, the solution's code, at the same sample positions", "samples": 1}, [], front_within="scene",
    )  # fmt: skip
    there = []
    for assignment, scene in scenes:
        if absent := scene.missing_meshes():
            part.skipped.append(f"{scene.name}: {shown(absent[0])} is absent")
        else:
            there.append((assignment, scene, work.needs(scene.file, assignment)))
    loops: dict[str, set[str]] = {}  # one plugin for all the scenes of an assignment
    for assignment, _, needs in there:
        loops.setdefault(assignment.name, set()).update(needs.loops)
    for done, (assignment, scene, needs) in enumerate(there):
        label = f"{assignment.name}/{scene.name}"
        work.progress(f"{label}: loading", done, len(there))
        images, seconds = _measure_scene(study, work, assignment, scene, sorted(loops[assignment.name]), label, part)
        for series in (s for s in SERIES if s in seconds):
            error = image_error(images[series], images["reference"])
            part.points.append(Point(series, {"scene": label}, error, seconds[series]))
        for language, (lean, full) in LANGUAGES.items():
            part.leaving_out.append({
                "scene": label, "language": language, "needed": seconds[lean], "full": seconds[full],
                "ratio": seconds[full]["median"] / seconds[lean]["median"],
                "difference": image_error(images[full], images[lean]), "left_out": needs.names,
            })  # fmt: skip
    if not part.points:
        raise UserError(f"{of}: no scene can be drawn here: {part.skipped[0]}")
    part.claims = claims(part)
    return part


def _measure_scene(
    study: Study, work: Workbench, assignment: Assignment, scene: Scene, loops: list[str], label: str, part: Part
) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Images and times by series; the image "reference" is the solution's in double."""
    with ExitStack() as stack:
        programs: dict[str, Drawer] = {
            "cpp-float": stack.enter_context(work.cpp(scene.file, assignment, loops)),
            "cpp-float-full": stack.enter_context(work.cpp(scene.file, assignment, loops, full=True)),
            "glsl": stack.enter_context(work.glsl(scene.file, assignment)),
            "glsl-full": stack.enter_context(work.glsl(scene.file, assignment, full=True)),
        }
        try:
            programs["cpp-double"] = stack.enter_context(work.cpp(scene.file, assignment, loops, double=True))
        except UserError as error:  # a student's code need not compile in double
            part.skipped.append(f"{label}, cpp-double: {str(error).splitlines()[0]}")
        draws: dict[str, Callable[[], float]] = {
            series: partial(lambda program: program.draw(image=False).seconds, program)
            for series, program in programs.items()
        }
        seconds = interleaved(draws, study.repeats, work.progress, label)
        images = {series: program.draw().image for series, program in programs.items()}
        if work.student:
            programs["reference"] = stack.enter_context(work.cpp(scene.file, assignment, loops, double=True, ours=True))
            images["reference"] = programs["reference"].draw().image
        else:
            images["reference"] = images["cpp-double"]
    return images, seconds


def claims(part: Part) -> list[str]:
    times = {s: {p.knob["scene"]: p.seconds["median"] for p in part.points if p.series == s} for s in SERIES}
    worst = {s: max((p.error["rmse"] for p in part.points if p.series == s), default=0.0) for s in SERIES}
    count = len(times["cpp-float"])
    over = "Here" if count == 1 else f"Over the {count} scenes, by geometric mean,"

    def against_float(series: str) -> str:
        shared = times[series].keys() & times["cpp-float"].keys()
        return f"{geometric_mean([times[series][s] / times['cpp-float'][s] for s in shared]):.2f}"

    slower = [f"{against_float('cpp-double')} times C++ float's in double"] if times["cpp-double"] else []
    slower.append(f"{against_float('glsl')} times with GLSL")
    saved = {
        language: geometric_mean([o["ratio"] for o in part.leaving_out if o["language"] == language])
        for language in LANGUAGES
    }
    changed = max(o["difference"]["max"] for o in part.leaving_out)
    bits = f"changes no pixel by more than {changed:.1e}" if changed else "changes no bit of the picture"
    return [
        f"{over} a frame takes {' and '.join(slower)}; the largest RMSE is {worst['cpp-float']:.1e} in C++ float and"
        f" {worst['glsl']:.1e} in GLSL.",
        f"Keeping everything takes {saved['C++']:.2f} times as long in C++ and {saved['GLSL']:.2f} times in GLSL as what is"
        f" needed, and {bits}.",
    ]
