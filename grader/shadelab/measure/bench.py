"""The benchmark: our rasterizer and llvmpipe draw the same frames in turn, and each is held against the double build.

Both stand by as programs that draw one frame per request, so that a pair of frames sees the same machine: a ratio is the
median over pairs, and never one median over another. Only the solution's code runs here, so no sandbox stands round it.
"""

import json
import math
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
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
import tomli_w
from rich.console import Console
from rich.table import Table

from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.errors import InfrastructureError, UserError
from shadelab.evidence.tasks import BuildError
from shadelab.machine.build import Recipe, build_plugin
from shadelab.machine.sandbox import Sandbox, work_folder
from shadelab.paths import RENDER, ROOT, SCENES, SOLUTION, STATE
from shadelab.truth.expected import scene_meshes

SIZE = 1024  # pixels, width and height
MESHES = ["sphere-1k", "sphere-70k", "sphere-1m", "knot-70k", "knot-1m", "teapot", "bunny"]
SHADINGS = [("depth", 0), ("phong", 1), ("phong", 4), ("cook-torrance", 1), ("cook-torrance", 4)]  # and lights
SAMPLES = [1, 4]
QUICK = ["sphere-1k/depth/1s", "sphere-70k/phong-1/1s", "sphere-70k/cook-torrance-4/4s", "knot-70k/depth/4s",
         "knot-70k/phong-4/4s", "teapot/cook-torrance-1/1s", "bunny/phong-1/1s", "full/knot-70k",
         "threads/knot-70k/phong-1/1s", "omissions/phong/teapot"]  # fmt: skip

LEVELS = ["plain", "v2", "v3", "v4"]
WITHOUT_AVX2 = ["plain", "v2"]

WARM = 3  # frames of each before any counts
PAIRS = 15  # at least
MORE_PAIRS, MORE_SECONDS = 45, 1.5  # short frames get more pairs, until one of these is reached
# Threads of OpenMP spin for a while after a frame; the other program must not meet them.
PAUSE = 0.025  # seconds before each frame

SUPERSAMPLES = [1, 2, 3, 4, 6, 8]
SUPERSAMPLED_SIZE, REFERENCE_SUPERSAMPLE = 96, 64  # pixels; 64 x 64 = 4096 samples each
# The whole sphere, whose outline decides the error, and a narrow highlight alone.
SUPERSAMPLED = {"sphere": {"q": 32.0}, "highlight": {"q": 1e4, "close": True}}
LOADS = 5

Progress = Callable[[str, float, float], None]


# --------------------------------------------------------------------------------------------------------- scenes


@dataclass(frozen=True)
class Case:
    """One frame that both draw. `full`: all layers, and on our side nothing left out."""

    mesh: str
    shading: str  # depth | phong | cook-torrance
    lights: int
    samples: int
    full: bool = False

    @property
    def look(self) -> str:
        return f"{self.shading}-{self.lights}" if self.lights else self.shading

    @property
    def name(self) -> str:
        return f"full/{self.mesh}" if self.full else f"{self.mesh}/{self.look}/{self.samples}s"

    @property
    def assignment(self) -> str:
        return "microfacet" if self.shading == "cook-torrance" else "phong"

    @property
    def our_options(self) -> list[str]:
        return ["--layers", "--full"] if self.full else ["--depth"] if self.shading == "depth" else []

    @property
    def packet_options(self) -> list[str]:
        return ["--layers"] if self.full else self.our_options


def all_cases() -> list[Case]:
    return [Case(mesh, *shading, samples) for mesh in MESHES for shading in SHADINGS for samples in SAMPLES]


_lights = [
    {"position": [2, 2, 3], "intensity": [10, 9, 8]},
    {"position": [-3, 1, 2], "intensity": [4, 6, 9]},
    {"position": [0, -3, 2], "intensity": [3, 4, 3]},
    {"position": [1, 3, -1], "intensity": [6, 6, 6]},
]
_phong = {"model": "phong", "ka": [0.02] * 3, "kd": [0.6, 0.3, 0.2], "ks": [0.4] * 3, "q": 32.0}
_cook_torrance = {
    "model": "cook_torrance",
    "kd": [0.3, 0.25, 0.2],
    "rho_s": [0.4] * 3,
    "f0": [0.9, 0.85, 0.8],
    "m": 0.3,
}
# Spheres and knots have radius 1 about the origin; the others are 1 tall and stand on y = 0. Each fills the picture.
_views = {"teapot": ([0.37, 0.98, 2.65], [0.07, 0.48, 0]), "bunny": ([0.23, 0.79, 1.56], [0, 0.5, 0])}


def scene_text(case: Case, size: int, q: float = 32.0, close: bool = False) -> str:
    eye, target = _views.get(case.mesh, ([0.4, 0.5, 2.7], [0, 0, 0]))
    if close:
        target = [0.33, 0.35, 0.88]  # where the first light's highlight stands on the unit sphere
    material = _cook_torrance if case.shading == "cook-torrance" else {**_phong, "q": q}
    scene = {
        "film": {"width": size, "height": size, "samples": case.samples, "background": [0, 0, 0]},
        "camera": {"eye": eye, "target": target, "fov_y": 10 if close else 45, "near": 0.1, "far": 20},
        "light": [{"kind": "point", **light} for light in _lights[: max(case.lights, 1)]],
        "material": {"body": material},
        "object": [{"mesh": str(mesh_file(case.mesh)), "material": "body"}],
    }
    return tomli_w.dumps(scene)


def mesh_file(mesh: str) -> Path:
    return SCENES / "meshes" / f"{mesh}.obj"


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


def last_line(text: str) -> str:
    return text.strip().splitlines()[-1] if text.strip() else ""


# ----------------------------------------------------------------------------------------------- resident programs


class Resident:
    """A program that has a frame ready and draws it on request: one line in, one line of JSON out."""

    def __init__(self, name: str, command: list[str], environment: dict[str, str]) -> None:
        self.name = name
        self.messages = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.messages, text=True, env=environment
        )
        self.ready: dict[str, Any] = {}

    def wait_until_ready(self) -> None:
        self.ready = self._answer()

    def ask(self, request: str) -> dict[str, Any]:
        try:
            self.process.stdin.write(request + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended; the answer, which does not come, says why
        return self._answer()

    def draw(self) -> float:
        """Milliseconds of one frame."""
        return self.ask("draw")["ms"]

    def image(self, file: Path) -> np.ndarray:
        """The last frame, by way of `file`: (H, W, channels) float32, row 0 at the top."""
        self.ask(f"write {file}")
        image = np.load(file)
        file.unlink()
        return image

    def peak_bytes(self) -> int:
        """The most memory that it has held so far."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status).group(1))

    def close(self) -> None:
        """The end of its input ends it."""
        try:
            self.process.stdin.close()
            self.process.wait(timeout=5)
        except (BrokenPipeError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.messages.close()

    def _answer(self) -> dict[str, Any]:
        line = self.process.stdout.readline()
        try:
            answer = json.loads(line)
        except ValueError:
            if not line:
                self.process.wait()
            self.messages.seek(0)
            why = last_line(self.messages.read().decode(errors="replace")) or line.strip() or "it ended"
            raise InfrastructureError(f"{self.name}: {why}") from None
        if "error" in answer:
            raise InfrastructureError(f"{self.name}: {answer['error']}")
        return answer


@dataclass
class Bench:
    """What all measurements share."""

    folder: Path
    threads: int
    level: str | None
    pairs: int
    size: int = SIZE

    def environment(self) -> dict[str, str]:
        """For the children. The two programs get the same number of threads and, without AVX2, both do without."""
        held = {"GALLIUM_OVERRIDE_CPU_CAPS": "sse4.1"} if self.level in WITHOUT_AVX2 else {}
        level = {"SHADELAB_LEVEL": self.level} if self.level else {}
        threads = {"OMP_NUM_THREADS": str(self.threads), "LP_NUM_THREADS": str(self.threads)}
        cache = {"MESA_SHADER_CACHE_DIR": str(self.folder / "shaders")}
        return {**os.environ, "SHADELAB_ROOT": str(ROOT), **threads, **level, **held, **cache}

    def scene(self, case: Case, size: int | None = None, q: float = 32.0, close: bool = False) -> Path:
        file = self.folder / "scene.toml"
        file.write_text(scene_text(case, size or self.size, q, close))
        return file

    def plugin(self, case: Case, double: bool) -> Path:
        assignment = load_assignment(SOLUTION / case.assignment)
        source = SOLUTION / case.assignment / "shading.cpp"
        try:
            return build_plugin(
                assignment, source, Sandbox(self.folder / "build"), Recipe(double, terms=case.full)
            ).file
        except BuildError as error:
            raise InfrastructureError(f"solution/{case.assignment}: {error.message}") from None

    @contextmanager
    def ours(self, case: Case, scene: Path, double: bool = False, supersample: int = 1) -> Iterator[Resident]:
        options = [*case.our_options, *(["--double"] if double else [])]
        options += ["--supersample", str(supersample)] if supersample > 1 else []
        plugin = None if case.shading == "depth" else self.plugin(case, double)
        with self.frames(scene, SOLUTION / case.assignment, options, plugin) as program:
            yield program

    @contextmanager
    def peer(self, case: Case, scene: Path) -> Iterator[Resident]:
        with self.llvmpipe(scene, SOLUTION / case.assignment, case.packet_options) as program:
            yield program

    @contextmanager
    def frames(self, scene: Path, assignment: Path, options: list[str], plugin: Path | None) -> Iterator[Resident]:
        """Our rasterizer, standing by with any scene. `assignment`: the folder; without a plugin nothing is shaded."""
        command = frames_command(scene, assignment, [*options, "--threads", str(self.threads)], plugin)
        with resident("shadelab-render frames", command, self.environment()) as program:
            yield program

    @contextmanager
    def llvmpipe(self, scene: Path, assignment: Path, options: list[str]) -> Iterator[Resident]:
        """OpenGL with the solution's shading.glsl, standing by with any scene."""
        packet = self.folder / "frame.packet"
        make_packet(scene, assignment, options, packet)
        command = [sys.executable, "-I", "-m", "shadelab.measure.peer", str(packet), str(assignment / "shading.glsl")]
        with resident("llvmpipe", command, self.environment()) as program:
            packet.unlink()
            yield program

    def reference(self, case: Case, scene: Path, supersample: int = 1) -> np.ndarray:
        with self.ours(case, scene, double=True, supersample=supersample) as program:
            program.draw()
            return program.image(self.folder / "reference.npy")


def frames_command(scene: Path, assignment: Path, options: list[str], plugin: Path | None) -> list[str]:
    command = [str(RENDER), "frames", str(scene), "--assignment", str(assignment), *options]
    return [*command, *(["--plugin", str(plugin)] if plugin else [])]


def make_packet(scene: Path, assignment: Path, options: list[str], packet: Path) -> None:
    command = [str(RENDER), "packet", str(scene), "--assignment", str(assignment), *options, "-o", str(packet)]
    made = subprocess.run(command, capture_output=True, text=True)
    if made.returncode:
        raise InfrastructureError(f"shadelab-render packet: {last_line(made.stderr)}")


@contextmanager
def resident(name: str, command: list[str], environment: dict[str, str]) -> Iterator[Resident]:
    program = Resident(name, command, environment)
    try:
        program.wait_until_ready()
        yield program
    finally:
        program.close()


# ---------------------------------------------------------------------------------------------------- measurements


def alternate(
    ours: Callable[[], float],
    peer: Callable[[], float],
    least: int,
    seconds: float = MORE_SECONDS,
    pause: float = PAUSE,
) -> list[tuple[float, float]]:
    """Pairs of times, drawn in turn; who begins changes from pair to pair."""
    pairs: list[tuple[float, float]] = []
    start = time.perf_counter()
    while len(pairs) < least or (len(pairs) < MORE_PAIRS and time.perf_counter() - start < seconds):
        times = {}
        for draw in (ours, peer) if len(pairs) % 2 == 0 else (peer, ours):
            time.sleep(pause)
            times[draw] = draw()
        pairs.append((times[ours], times[peer]))
    return pairs


def pairwise_ratio(pairs: list[tuple[float, float]]) -> float:
    return statistics.median(one / other for one, other in pairs)


def geometric_mean(values: list[float]) -> float:
    return math.exp(statistics.fmean(math.log(value) for value in values))


def spread(times: list[float]) -> dict[str, float]:
    return {"median": statistics.median(times), "min": min(times), "max": max(times), "runs": len(times)}


def image_error(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Root mean square and largest difference over all pixels, of the total's three channels or of the depth."""
    difference = image[..., :3].astype(float) - reference[..., :3]
    return {"error": float(np.sqrt(np.mean(difference**2))), "max_error": float(np.abs(difference).max())}


def measure_case(bench: Bench, case: Case) -> dict[str, Any]:
    scene = bench.scene(case)
    reference = bench.reference(case, scene)
    with bench.ours(case, scene) as ours, bench.peer(case, scene) as peer:
        for program in (ours, peer):
            for _ in range(WARM):
                program.draw()
        pairs = alternate(ours.draw, peer.draw, bench.pairs)
        errors = [image_error(p.image(bench.folder / "image.npy"), reference) for p in (ours, peer)]
        return {
            "name": case.name, "unit": "ms", "mesh": case.mesh, "shading": case.look, "samples": case.samples,
            "ours": {**spread([a for a, _ in pairs]), **errors[0]},
            "peer": {"name": peer.ready["gl"], **spread([b for _, b in pairs]), **errors[1]},
            "ratio": pairwise_ratio(pairs),
            "load_ms": ours.ready["load_ms"], "geometry_bytes": ours.ready["geometry_bytes"],
            "framebuffer_bytes": ours.ready["framebuffer_bytes"], "peak_bytes": ours.peak_bytes(),
        }  # fmt: skip


def measure_threads(bench: Bench, case: Case) -> dict[str, Any]:
    """What a second thread gains a frame, over what it gains pure arithmetic in the same minute."""
    rounds = []
    with bench.ours(case, bench.scene(case)) as ours:
        for _ in range(WARM):
            ours.draw()
        for index in range(bench.pairs):
            times = {}
            for threads in (1, 2) if index % 2 == 0 else (2, 1):
                ours.ask(f"threads {threads}")
                time.sleep(PAUSE)
                ours.draw()  # the first frame after the change starts or ends threads
                times[threads] = ours.draw(), ours.ask("arithmetic")["ms"]
            rounds.append([one / two for one, two in zip(times[1], times[2])])
    frame, arithmetic = (statistics.median(gain) for gain in zip(*rounds))
    share = statistics.median(f / a for f, a in rounds)
    return {"name": f"threads/{case.name}", "frame_gain": frame, "arithmetic_gain": arithmetic, "share": share}


def measure_supersampling(bench: Bench, name: str) -> dict[str, Any]:
    """Error against run time: n x n samples a pixel, float and double, against 4096 in double."""
    case = Case("sphere-70k", "phong", 1, 1)
    scene = bench.scene(case, size=SUPERSAMPLED_SIZE, **SUPERSAMPLED[name])
    reference = bench.reference(case, scene, REFERENCE_SUPERSAMPLE)
    points = []
    for real in ("float", "double"):
        for n in SUPERSAMPLES:
            with bench.ours(case, scene, double=real == "double", supersample=n) as ours:
                for _ in range(WARM):
                    ours.draw()
                times = [ours.draw() for _ in range(bench.pairs)]
                error = image_error(ours.image(bench.folder / "image.npy"), reference)
            points.append({"series": f"ours-{real}", "supersample": n, "samples": n * n, **error, "ms": spread(times)})
    view = SUPERSAMPLED[name]
    return {"name": f"supersampling/{name}", "mesh": case.mesh, **view, "size": SUPERSAMPLED_SIZE, "points": points}


def measure_load(bench: Bench, mesh: str) -> dict[str, Any]:
    case = Case(mesh, "depth", 0, 1)
    scene, times = bench.scene(case), []
    for _ in range(LOADS):
        with bench.ours(case, scene) as ours:
            times.append(ours.ready["load_ms"])
    return {"name": f"load/{mesh}", "unit": "ms", **spread(times)}


def measure_omissions(bench: Bench, assignment: str, scene: Path) -> dict[str, Any]:
    """A scene as it is and with --full: frames in turn, and the set-up (compiling the plugin, loading) of each."""
    declared = load_assignment(SOLUTION / assignment)
    source = bench.folder / "shading.cpp"  # nothing that was compiled before has this text
    source.write_text((SOLUTION / assignment / "shading.cpp").read_text() + f"\n// {time.time_ns()}\n")
    command = [str(RENDER), "needs", str(scene), "--assignment", str(declared.directory)]
    loops = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["loops"]
    programs, setup = {}, {}
    with ExitStack() as stack:
        for name, options, only in (("lean", [], loops), ("full", ["--full"], None)):
            start = time.perf_counter()
            recipe = Recipe() if only is None else Recipe(functions=False, loops=tuple(only), terms=False)
            plugin = build_plugin(declared, source, Sandbox(bench.folder / "build"), recipe)
            compiled = 1000 * (time.perf_counter() - start)
            programs[name] = stack.enter_context(bench.frames(scene, declared.directory, options, plugin.file))
            setup[name] = {"compile_ms": compiled, "load_ms": programs[name].ready["load_ms"]}
        for program in programs.values():
            for _ in range(WARM):
                program.draw()
        pairs = alternate(programs["lean"].draw, programs["full"].draw, bench.pairs, 0.5, 0.005)
    frame = pairwise_ratio(pairs)
    times = {name: statistics.median(t) for name, t in zip(("lean", "full"), zip(*pairs))}
    whole = {name: times[name] + sum(setup[name].values()) for name in times}
    return {
        "name": f"omissions/{assignment}/{scene.stem}", "unit": "ms",
        "lean": {"frame_ms": times["lean"], **setup["lean"]}, "full": {"frame_ms": times["full"], **setup["full"]},
        "frame_ratio": frame, "ratio": whole["lean"] / whole["full"],
    }  # fmt: skip


# ------------------------------------------------------------------------------------------------------- the run


@dataclass
class Task:
    name: str
    meshes: set[str]
    run: Callable[[Bench], dict[str, Any]]


def all_tasks() -> list[Task]:
    full = [Case(mesh, "phong", 1, 1, full=True) for mesh in ("knot-70k", "sphere-70k")]
    cases = [Task(c.name, {c.mesh}, partial(measure_case, case=c)) for c in [*all_cases(), *full]]
    scaled = [Case("knot-70k", "phong", 1, 1), Case("sphere-70k", "cook-torrance", 4, 1)]
    threads = [Task(f"threads/{c.name}", {c.mesh}, partial(measure_threads, case=c)) for c in scaled]
    supersampling = [
        Task(f"supersampling/{name}", {"sphere-70k"}, partial(measure_supersampling, name=name))
        for name in SUPERSAMPLED
    ]
    load = Task("load/knot-1m", {"knot-1m"}, partial(measure_load, mesh="knot-1m"))
    return [*cases, *threads, *supersampling, load, *omission_tasks()]


def omission_tasks() -> list[Task]:
    tasks = []
    for name in assignment_names():
        for scene in load_assignment(SOLUTION / name).scenes:
            meshes = {mesh.stem for mesh in scene_meshes(scene)}
            run = partial(measure_omissions, assignment=name, scene=scene.file)
            tasks.append(Task(f"omissions/{name}/{scene.file.stem}", meshes, run))
    return tasks


def chosen_tasks(only: str, quick: bool) -> list[Task]:
    tasks = [t for t in all_tasks() if fnmatch(t.name, only) and (not quick or t.name in QUICK)]
    if not tasks:
        raise UserError(f"--only {only}: no measurement has such a name; names look like {all_cases()[0].name}")
    return tasks


def run(
    only: str, pairs: int, level: str | None, threads: int | None, quick: bool, resume: bool, progress: Progress
) -> dict[str, Any]:
    """Measures and returns the JSON. What is measured is kept at once, so that `resume` can go on after an interruption."""
    tasks = chosen_tasks(only, quick)
    if level:
        os.environ["SHADELAB_LEVEL"] = level  # what the plugins are built for, too
    processors = len(os.sched_getaffinity(0))
    threads = threads or min(2, processors)
    settings = {"threads": threads, "level": level or "the processor's best", "pairs": pairs}
    machine = describe_machine()
    kept, key = STATE / "bench" / "run.json", {**machine, **settings}
    results = kept_results(kept, key) if resume else {}
    make_missing_meshes(set().union(*(t.meshes for t in tasks)), progress)
    skipped = []
    with work_folder("bench") as folder:
        bench = Bench(folder, threads, level, pairs)
        for done, task in enumerate(tasks):
            progress(task.name, done, len(tasks))
            absent = [mesh for mesh in task.meshes if not mesh_file(mesh).exists()]
            if absent:
                skipped.append({"name": task.name, "why": f"scenes/meshes/{absent[0]}.obj is absent"})
            elif task.name.startswith("threads/") and processors < 2:
                skipped.append({"name": task.name, "why": "this machine has one processor"})
            elif task.name not in results:
                results[task.name] = task.run(bench)
                keep_results(kept, key, results)
    machine["date"] = date.today().isoformat()
    return assemble(machine, settings, [results[t.name] for t in tasks if t.name in results], skipped)


def kept_results(file: Path, key: dict[str, Any]) -> dict[str, Any]:
    """What an interrupted run measured on this machine with the same settings."""
    try:
        kept = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
    return kept["results"] if kept["key"] == key else {}


def keep_results(file: Path, key: dict[str, Any], results: dict[str, Any]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps({"key": key, "results": results}))
    part.replace(file)


def describe_machine() -> dict[str, Any]:
    cpu = re.search(r"^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    try:
        system = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        system = platform.system()
    compiler = subprocess.run(["g++", "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    return {
        "cpu": cpu.group(1) if cpu else platform.processor(),
        "processors": len(os.sched_getaffinity(0)),
        "system": system,
        "compiler": compiler,
    }


# ------------------------------------------------------------------------------------------------------ summary


def assemble(
    machine: dict[str, Any], settings: dict[str, Any], results: list[dict[str, Any]], skipped: list[dict[str, str]]
) -> dict[str, Any]:
    """The JSON of a run (contracts: machine, cases; the rest is ours)."""

    def section(name: str) -> list[dict[str, Any]]:
        return [r for r in results if r["name"].startswith(f"{name}/")]

    apart = {name: section(name) for name in ("full", "threads", "supersampling", "load", "omissions")}
    cases = [r for r in results if not any(r in part for part in apart.values())]
    peers = sorted({c["peer"]["name"] for c in [*cases, *apart["full"]]})
    kinds = ("name", "geometry_bytes", "framebuffer_bytes", "peak_bytes")
    memory = [{kind: c[kind] for kind in kinds} for c in cases if c["mesh"].endswith("-1m")]
    beside = [m["peak_bytes"] - m["geometry_bytes"] - m["framebuffer_bytes"] for m in memory]
    bars = held_against_bars(cases, apart, settings["level"], beside)
    return {"machine": {**machine, "peer": peers}, "settings": settings, "cases": cases, **apart,
            "memory": memory, "skipped": skipped, "bars": bars}  # fmt: skip


def held_against_bars(
    cases: list[dict[str, Any]], apart: dict[str, list[dict[str, Any]]], level: str, memory: list[int]
) -> list[dict[str, Any]]:
    """What must hold, what came out, and whether it does. Bars of which nothing was measured are left out."""
    ratios = [c["ratio"] for c in cases]
    depth = [c["ratio"] for c in cases if c["shading"] == "depth"]
    four = [c["ratio"] for c in cases if c["samples"] == 4]
    bars = [bar("geometric mean of ours/llvmpipe", ratios, geometric_mean, 0.75 if level in WITHOUT_AVX2 else 0.33)]
    if level not in WITHOUT_AVX2:
        bars += [
            bar("the same, depth only", depth, geometric_mean, 0.25),
            bar("the same, 4 samples", four, geometric_mean, 0.28),
            bar("the largest ours/llvmpipe", ratios, max, 0.75),
            bar("--full: the largest ours/llvmpipe, all layers", [c["ratio"] for c in apart["full"]], max, 0.45),
        ]
    bars.append(bar("the largest image error, ours/llvmpipe", [error_ratio(c) for c in cases], max, 1.0))
    bars.append(
        bar("two threads over one, of arithmetic's gain", [t["share"] for t in apart["threads"]], min, 0.9, True)
    )
    omitted = apart["omissions"]
    bars.append(
        bar(
            "leaving out, frame and set-up: --full over needed",
            [1 / o["ratio"] for o in omitted],
            geometric_mean,
            1.3,
            True,
        )
    )
    bars.append(
        bar("leaving out, the slowest frame: needed over --full", [o["frame_ratio"] for o in omitted], max, 1.03)
    )
    bars.append(bar("memory beside geometry and framebuffers, MiB", [m / 2**20 for m in memory], max, 64.0))
    bars.append(bar("loading a million triangles, ms", [t["median"] for t in apart["load"]], max, 1500.0))
    return [b for b in bars if b is not None]


def bar(
    name: str, values: list[float], reduce: Callable, limit: float, at_least: bool = False
) -> dict[str, Any] | None:
    if not values:
        return None
    value = reduce(values)
    met = value >= limit if at_least else value <= limit
    return {"name": name, "value": value, "limit": limit, "sense": "at least" if at_least else "at most", "met": met}


def error_ratio(case: dict[str, Any]) -> float:
    return case["ours"]["error"] / max(case["peer"]["error"], 1e-30)  # none may be without any error


# ------------------------------------------------------------------------------------------------------- reports


def print_report(bench: dict[str, Any], output: Console) -> None:
    """Times beside errors, ratios, and then the bars."""
    table = Table(title="one frame, ours and llvmpipe's: time and RMSE against the double build", title_justify="left")
    for heading in ("case", "ours ms", "peer ms", "ratio", "our error", "peer's error"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    for c in [*bench["cases"], *bench["full"]]:
        times, errors = ([c[who][what] for who in ("ours", "peer")] for what in ("median", "error"))
        table.add_row(c["name"], *map(milliseconds, times), f"{c['ratio']:.3f}", *(f"{e:.2e}" for e in errors))
    if table.row_count:
        output.print(table)
    lines = [
        f"{t['name']}: {t['frame_gain']:.2f} times as fast with two threads, arithmetic {t['arithmetic_gain']:.2f} times"
        for t in bench["threads"]
    ]
    for each in bench["supersampling"]:
        lines.append(f"{each['name']}: {each['size']} x {each['size']} pixels, RMSE against 4096 samples in double")
        lines += [
            f"    {p['series']:<11} {p['samples']:>2} samples  {milliseconds(p['ms']['median']):>6} ms  {p['error']:.2e}"
            for p in each["points"]
        ]
    lines += [f"{each['name']}: {milliseconds(each['median'])} ms" for each in bench["load"]]
    lines += [
        f"{m['name']}: {m['peak_bytes'] / 2**20:.0f} MiB at most, with {m['geometry_bytes'] / 2**20:.0f} MiB of geometry and"
        f" {m['framebuffer_bytes'] / 2**20:.0f} MiB of framebuffers"
        for m in bench["memory"]
    ]
    lines += [
        f"{o['name']}: frame {milliseconds(o['lean']['frame_ms'])} ms, with --full {milliseconds(o['full']['frame_ms'])} ms"
        f" ({o['frame_ratio']:.2f}); with set-up {o['ratio']:.2f}"
        for o in bench["omissions"]
    ]
    lines += [f"skipped {each['name']}: {each['why']}" for each in bench["skipped"]]
    for line in lines:
        output.print(line, markup=False, soft_wrap=True)
    for b in bench["bars"]:
        verdict = "[green]met   [/]" if b["met"] else "[red]missed[/]"
        output.print(f"{verdict} {b['name']}: {b['value']:.3g} ({b['sense']} {b['limit']:g})", soft_wrap=True)


def milliseconds(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def markdown(bench: dict[str, Any]) -> str:
    """The README's table: a row for each mesh and sample count, cells with both times in ms."""
    by_place = {(c["mesh"], c["samples"], c["shading"]): c for c in bench["cases"]}
    looks = [Case("", *shading, 1).look for shading in SHADINGS]
    heads = ["depth only", "Phong, 1 light", "Phong, 4", "Cook-Torrance, 1", "Cook-Torrance, 4"]
    lines = [f"| ours / llvmpipe, ms | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads)]
    for samples in SAMPLES:
        for mesh in MESHES:
            cells = [markdown_cell(by_place.get((mesh, samples, look))) for look in looks]
            if any(cells):
                plural = "sample" if samples == 1 else "samples"
                lines.append(f"| `{mesh}`, {samples} {plural} | {' | '.join(cells)} |")
    bars = ["| | measured | bar | |", "|---|---:|---:|---|"]
    for b in bench["bars"]:
        sign = "≥" if b["sense"] == "at least" else "≤"
        bars.append(f"| {b['name']} | {b['value']:.3g} | {sign} {b['limit']:g} | {'met' if b['met'] else 'missed'} |")
    return "\n".join([*lines, "", errors_sentence(bench), "", *bars, "", machine_sentence(bench)])


def markdown_cell(case: dict[str, Any] | None) -> str:
    return f"{milliseconds(case['ours']['median'])} / {milliseconds(case['peer']['median'])}" if case else ""


def errors_sentence(bench: dict[str, Any]) -> str:
    cases = bench["cases"]
    if not cases:
        return ""
    ours, peer = ([c[who]["error"] for c in cases] for who in ("ours", "peer"))
    no_worse = sum(error_ratio(c) <= 1 for c in cases)
    return (
        f"{SIZE} x {SIZE} pixels, the same layers read back. Error (RMSE against our double build): ours {min(ours):.1e} to"
        f" {max(ours):.1e}, llvmpipe {min(peer):.1e} to {max(peer):.1e}; ours is no worse in {no_worse} of {len(cases)} cases."
    )


def machine_sentence(bench: dict[str, Any]) -> str:
    machine, settings = bench["machine"], bench["settings"]
    return (
        f"{settings['threads']} threads of {machine['processors']} on {machine['cpu']}, code for {level_name(settings['level'])};"
        f" {machine['system']}, {machine['compiler']};"
        f" {'; '.join(machine['peer'])}; {machine['date']}. Ratios are medians over at least {settings['pairs']} pairs of"
        f" frames drawn in turn. `./shadelab bench{level_option(settings['level'])} --readme` measures anew and rewrites this."
    )


def level_name(level: str) -> str:
    return f"x86-64-{level}" if level in LEVELS[1:] else level


def level_option(level: str) -> str:
    return f" --level {level}" if level in LEVELS else ""


def replace_block(text: str, block: str) -> str:
    """`text` with `block` between the lines <!-- bench --> and <!-- /bench -->."""
    begin, end = "<!-- bench -->", "<!-- /bench -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise UserError(f"README.md: there must be one line {begin} and below it one line {end}")
    head, rest = text.split(begin)
    return f"{head}{begin}\n{block}\n{end}{rest.split(end)[1]}"


def write_readme(bench: dict[str, Any]) -> None:
    file = ROOT / "README.md"
    file.write_text(replace_block(file.read_text(), markdown(bench)))
