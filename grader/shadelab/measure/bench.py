"""The benchmark: our rasterizer and llvmpipe draw the same frames in turn, and each is held against the double build.

Both stand by as programs that draw one frame per request, so that a pair of frames sees the same machine: a ratio is the
median over pairs, and never one median over another. Only the solution's code runs here, so no sandbox stands round it.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import date
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.course.assignment import Scene, assignment_names, load_assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.errors import InfrastructureError, UserError
from shadelab.files import write_whole
from shadelab.machine import renderer
from shadelab.machine.build import CompileError, Recipe, build_plugin
from shadelab.machine.sandbox import Sandbox, work_folder
from shadelab.measure.bars import assemble
from shadelab.measure.declaration import Declaration, Look, load_declaration, mesh_file
from shadelab.measure.images import image_error
from shadelab.measure.machine import describe_machine
from shadelab.measure.standing import Resident, Stand, last_line
from shadelab.measure.timing import PAUSE, Progress, alternate, pairwise_ratio, spread
from shadelab.paths import SCENES, SOLUTION, STATE

WARM = 3  # frames of each before any counts
SUPERSAMPLES = [1, 2, 3, 4, 6, 8]
REFERENCE_SUPERSAMPLE = 64  # 64 x 64 = 4096 samples a pixel
LOADS = 5


# --------------------------------------------------------------------------------------------------------- frames


@dataclass(frozen=True)
class BenchFrame:
    """One frame that both draw. `full`: all layers, and on our side nothing left out."""

    mesh: str
    look: Look
    samples: int
    full: bool = False

    def __hash__(self) -> int:
        return hash(self.name)

    @property
    def name(self) -> str:
        return f"full/{self.mesh}" if self.full else f"{self.mesh}/{self.look.name}/{self.samples}s"

    def view(self, size: int, ours: bool, supersample: int | None = None) -> renderer.View:
        layers = "all" if self.full else "total" if self.look.shaded else "depth"
        return renderer.View(layers, f"{size}x{size}", self.samples, supersample, full=self.full and ours)


def all_frames(declared: Declaration) -> list[BenchFrame]:
    return [BenchFrame(mesh, look, n) for mesh in declared.meshes for look in declared.look for n in declared.samples]


def make_missing_meshes(meshes: set[str], progress: Progress) -> None:
    """The large ones are made when somebody measures with them; the scan may be absent."""
    missing = sorted(mesh for mesh in meshes - {"bunny"} if not mesh_file(mesh).exists())
    if not missing:
        return
    print(f"making {', '.join(missing)} in scenes/meshes ...", file=sys.stderr)
    progress("making meshes", 0, 1)
    made = subprocess.run(
        [sys.executable, "-I", str(SCENES / "make_meshes.py"), "--bench"], capture_output=True, text=True
    )
    if made.returncode or not all(mesh_file(mesh).exists() for mesh in missing):
        raise InfrastructureError(f"scenes/make_meshes.py --bench: {last_line(made.stderr) or 'a mesh is missing'}")


@dataclass
class Bench:
    """What all measurements share."""

    declared: Declaration
    stand: Stand
    pairs: int
    size: int

    @property
    def folder(self) -> Path:
        return self.stand.folder

    def scene(self, frame: BenchFrame) -> Path:
        return self.declared.write_scene(frame.look.scene, frame.mesh, self.folder / "scene.toml")

    def plugin(self, directory: Path, recipe: Recipe, source: Path | None = None) -> Path:
        glue = load_assignment(directory).glue
        try:
            return build_plugin(glue, source or directory / "shading.cpp", Sandbox(self.folder / "build"), recipe).file
        except CompileError as error:
            raise InfrastructureError(f"solution/{directory.name}: {last_line(error.stderr)}") from None

    @contextmanager
    def ours(self, frame: BenchFrame, scene: Path, double: bool = False) -> Iterator[Resident]:
        recipe, view = Recipe(double, terms=frame.full, level=self.stand.level), frame.view(self.size, ours=True)
        plugin = self.plugin(frame.look.directory, recipe) if frame.look.shaded else None
        with self.stand.frames(scene, frame.look.directory, plugin, view, double) as program:
            yield program

    def reference(self, frame: BenchFrame, scene: Path) -> np.ndarray:
        with self.ours(frame, scene, double=True) as program:
            program.draw()
            return program.image(self.folder / "reference.npy")


# ---------------------------------------------------------------------------------------------------- measurements


def measure_frame(bench: Bench, frame: BenchFrame) -> dict[str, Any]:
    scene = bench.scene(frame)
    reference = bench.reference(frame, scene)
    view = frame.view(bench.size, ours=False)
    with bench.ours(frame, scene) as ours, bench.stand.opengl(scene, frame.look.directory, view) as peer:
        warm(ours, peer)
        pairs = alternate(ours.draw, peer.draw, bench.pairs)
        errors = [image_error(p.image(bench.folder / "image.npy"), reference) for p in (ours, peer)]
        errors = [{"error": e["rmse"], "max_error": e["max"]} for e in errors]
        return {
            "name": frame.name, "unit": "ms", "mesh": frame.mesh, "shading": frame.look.name, "samples": frame.samples,
            "ours": {**spread([a for a, _ in pairs]), **errors[0]},
            "peer": {"name": peer.ready["gl"], **spread([b for _, b in pairs]), **errors[1]},
            "ratio": pairwise_ratio(pairs),
            "load_ms": ours.ready["load_ms"], "geometry_bytes": ours.ready["geometry_bytes"],
            "framebuffer_bytes": ours.ready["framebuffer_bytes"], "peak_bytes": ours.peak_bytes(),
        }  # fmt: skip


def warm(*programs: Resident) -> None:
    for program in programs:
        for _ in range(WARM):
            program.draw()


def measure_threads(bench: Bench, frame: BenchFrame) -> dict[str, Any]:
    """What a second thread gains a frame, over what it gains pure arithmetic in the same minute."""
    rounds = []
    with bench.ours(frame, bench.scene(frame)) as ours:
        warm(ours)
        for index in range(bench.pairs):
            times = {}
            for threads in (1, 2) if index % 2 == 0 else (2, 1):
                ours.ask(f"threads {threads}")
                time.sleep(PAUSE)
                ours.draw()  # the first frame after the change starts or ends threads
                times[threads] = ours.draw(), ours.ask("arithmetic")["ms"]
            rounds.append([one / two for one, two in zip(times[1], times[2])])
    gain, arithmetic = (statistics.median(gains) for gains in zip(*rounds))
    share = statistics.median(f / a for f, a in rounds)
    return {"name": f"threads/{frame.name}", "frame_gain": gain, "arithmetic_gain": arithmetic, "share": share}


def measure_supersampling(bench: Bench, name: str) -> dict[str, Any]:
    """Error against run time: n x n samples a pixel, float and double, against 4096 in double."""
    declared = bench.declared.supersampling
    scene = bench.declared.write_scene(declared.scenes[name], None, bench.folder / "scene.toml")
    directory, size = SOLUTION / declared.assignment, f"{declared.size}x{declared.size}"
    plugins = {real: bench.plugin(directory, Recipe(real == "double", terms=False)) for real in ("float", "double")}

    def drawing(real: str, n: int):
        view = renderer.View(size=size, supersample=n if n > 1 else None)
        return bench.stand.frames(scene, directory, plugins[real], view)

    with drawing("double", REFERENCE_SUPERSAMPLE) as ours:
        ours.draw()
        reference = ours.image(bench.folder / "reference.npy")
    points = []
    for real in plugins:
        for n in SUPERSAMPLES:
            with drawing(real, n) as ours:
                warm(ours)
                times = [ours.draw() for _ in range(bench.pairs)]
                error = image_error(ours.image(bench.folder / "image.npy"), reference)
            told = {"error": error["rmse"], "max_error": error["max"]}
            points.append({"series": f"ours-{real}", "supersample": n, "samples": n * n, **told, "ms": spread(times)})
    return {"name": f"supersampling/{name}", "scene": declared.scenes[name], "size": declared.size, "points": points}


def measure_load(bench: Bench, frame: BenchFrame) -> dict[str, Any]:
    scene, times = bench.scene(frame), []
    for _ in range(LOADS):
        with bench.ours(frame, scene) as ours:
            times.append(ours.ready["load_ms"])
    return {"name": f"load/{frame.mesh}", "unit": "ms", **spread(times)}


def measure_omissions(bench: Bench, scene: Scene) -> dict[str, Any]:
    """A scene as it is and with --full: frames in turn, and the set-up (compiling the plugin, loading) of each."""
    directory = scene.assignment
    source = bench.folder / "shading.cpp"  # nothing that was compiled before has this text
    source.write_text((directory / "shading.cpp").read_text() + f"\n// {time.time_ns()}\n")
    level = bench.stand.level
    lean = Recipe(functions=False, loops=tuple(scene.described.needs.loops), terms=False, level=level)
    programs, setup = {}, {}
    with ExitStack() as stack:
        for name, view, recipe in (
            ("lean", renderer.View(), lean),
            ("full", renderer.View(full=True), Recipe(level=level)),
        ):
            start = time.perf_counter()
            plugin = bench.plugin(directory, recipe, source)
            compiled = 1000 * (time.perf_counter() - start)
            programs[name] = stack.enter_context(bench.stand.frames(scene.file, directory, plugin, view))
            setup[name] = {"compile_ms": compiled, "load_ms": programs[name].ready["load_ms"]}
        warm(*programs.values())
        pairs = alternate(programs["lean"].draw, programs["full"].draw, bench.pairs, 0.5, 0.005)
    times = {name: statistics.median(t) for name, t in zip(("lean", "full"), zip(*pairs))}
    whole = {name: times[name] + sum(setup[name].values()) for name in times}
    return {
        "name": f"omissions/{directory.name}/{scene.file.stem}", "unit": "ms",
        "lean": {"frame_ms": times["lean"], **setup["lean"]}, "full": {"frame_ms": times["full"], **setup["full"]},
        "frame_ratio": pairwise_ratio(pairs), "ratio": whole["lean"] / whole["full"],
    }  # fmt: skip


# ------------------------------------------------------------------------------------------------------- the run


@dataclass
class Measurement:
    name: str
    meshes: set[str]
    run: Callable[[Bench], dict[str, Any]]


def all_measurements(declared: Declaration) -> list[Measurement]:
    def placed(places, full: bool = False) -> list[BenchFrame]:
        return [BenchFrame(place.mesh, declared.look_named(place.look), 1, full) for place in places]

    frames = [*all_frames(declared), *placed(declared.full, full=True)]
    out = [Measurement(f.name, {f.mesh}, partial(measure_frame, frame=f)) for f in frames]
    for frame in placed(declared.threads):
        out.append(Measurement(f"threads/{frame.name}", {frame.mesh}, partial(measure_threads, frame=frame)))
    for name in declared.supersampling.scenes:
        out.append(Measurement(f"supersampling/{name}", set(), partial(measure_supersampling, name=name)))
    unshaded = next(look for look in declared.look if not look.shaded)
    for mesh in declared.load:
        frame = BenchFrame(mesh, unshaded, 1)
        out.append(Measurement(f"load/{mesh}", {mesh}, partial(measure_load, frame=frame)))
    return [*out, *_omissions()]


def _omissions() -> list[Measurement]:
    out = []
    for name in assignment_names():
        assignment = load_assignment(SOLUTION / name)
        draw_hidden_scenes(assignment.hidden, assignment.directory, name)
        for scene in assignment.scenes:
            meshes = {mesh.stem for mesh in scene.described.meshes}
            run = partial(measure_omissions, scene=scene)
            out.append(Measurement(f"omissions/{name}/{scene.file.stem}", meshes, run))
    return out


def chosen_measurements(declared: Declaration, only: str, quick: bool) -> list[Measurement]:
    every = all_measurements(declared)
    chosen = [m for m in every if fnmatch(m.name, only) and (not quick or m.name in declared.quick)]
    if not chosen:
        raise UserError(f"--only {only}: no measurement has such a name; names look like {every[0].name}")
    return chosen


def run(
    only: str, pairs: int, level: str | None, threads: int | None, quick: bool, resume: bool, progress: Progress
) -> dict[str, Any]:
    """Measures and returns the JSON. What is measured is kept at once, so that `resume` can go on after an interruption."""
    declared = load_declaration()
    chosen = chosen_measurements(declared, only, quick)
    processors = len(os.sched_getaffinity(0))
    threads = threads or min(2, processors)
    settings = {"threads": threads, "level": level or "the processor's best", "pairs": pairs, "size": declared.size}
    machine = describe_machine()
    kept, key = STATE / "bench" / "run.json", {**machine, **settings}
    results = kept_results(kept, key) if resume else {}
    make_missing_meshes(set().union(*(m.meshes for m in chosen)), progress)
    skipped = []
    with work_folder("bench") as folder:
        bench = Bench(declared, Stand(folder, threads, level), pairs, declared.size)
        for done, measurement in enumerate(chosen):
            progress(measurement.name, done, len(chosen))
            absent = [mesh for mesh in measurement.meshes if not mesh_file(mesh).exists()]
            if absent:
                skipped.append({"name": measurement.name, "why": f"scenes/meshes/{absent[0]}.obj is absent"})
            elif measurement.name.startswith("threads/") and processors < 2:
                skipped.append({"name": measurement.name, "why": "this machine has one processor"})
            elif measurement.name not in results:
                results[measurement.name] = measurement.run(bench)
                keep_results(kept, key, results)
    machine["date"] = date.today().isoformat()
    done = [results[m.name] for m in chosen if m.name in results]
    return assemble(declared, machine, settings, done, skipped)


def kept_results(file: Path, key: dict[str, Any]) -> dict[str, Any]:
    """What an interrupted run measured on this machine with the same settings."""
    try:
        kept = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
    return kept["results"] if kept["key"] == key else {}


def keep_results(file: Path, key: dict[str, Any], results: dict[str, Any]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, json.dumps({"key": key, "results": results}))
