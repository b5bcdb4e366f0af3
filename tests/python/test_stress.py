"""The scenes in scenes/stress/: each is drawn in both backends and compared with double. What cannot be right is declared here,
counted, and explained in scenes/stress/README.md."""

import json
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import Scene, load_assignment
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import Draw
from shadelab.gl.packet import Packet
from shadelab.machine.build import Plugin, Recipe, build_plugin
from shadelab.machine.renderer import describe
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import RENDER
from shadelab.truth.expected import CHANNELS, INTERIOR, SceneTruth, largest_nearby
from shadelab.truth.measures import FULL_MARKS, image_limit, violating_share
from shadelab.truth.scenes import SHIFTS

FOLDER = ROOT / "scenes" / "stress"
TOTAL = CHANNELS["total"]
# What the renderer counts; what a scene does not declare is 0.
COUNTS = (
    "dropped_triangles", "cancelled_vertex_normals", "not_finite_vertices", "fallback_normals", "lights_at_surface",
)  # fmt: skip


@dataclass(frozen=True)
class Stiff:
    assignment: str = "phong"
    not_finite: tuple[int, int, int] = (0, 0, 0)  # pixels: C++, GLSL, double
    counts: dict[str, int] = field(default_factory=dict)
    beyond: tuple[float, float] = (
        0.0,
        0.0,
    )  # share of the interior beyond tolerance: C++, GLSL; 0: what grading allows


STIFF = {
    "bright-lights": Stiff(not_finite=(455, 455, 56)),
    "cancelling-normals": Stiff(counts={"cancelled_vertex_normals": 1, "fallback_normals": 112}),
    "close-lights": Stiff(counts={"lights_at_surface": 2}),
    "depth-range": Stiff(beyond=(0.224, 0.238)),
    "exponent": Stiff(),
    "grazing": Stiff("microfacet"),
    "many-lights": Stiff(),
    "narrow-spots": Stiff(),
    "offset": Stiff(),
    "roughness": Stiff("microfacet"),
    "slivers": Stiff(counts={"dropped_triangles": 14}),
    "step-spots": Stiff(),
}


def render(*arguments: object) -> str:
    return subprocess.run([RENDER, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


class Studio:
    """Draws the scenes of one assignment with its solution. Plugins and the OpenGL client serve all of them."""

    def __init__(self, name: str, folder: Path) -> None:
        self.folder, self.assignment = folder, load_assignment(ROOT / "solution" / name)
        self.options = ["--assignment", self.assignment.directory]
        self.scenes = [
            Scene(s, FOLDER / f"{s}.toml", self.assignment.directory)
            for s, stiff in STIFF.items()
            if stiff.assignment == name
        ]
        needed = [s.described.needs.loops for s in self.scenes]
        self.loops = tuple(sorted({loop for loops in needed for loop in loops}))
        with ThreadPoolExecutor(2) as pool:
            self.plugins = dict(zip((False, True), pool.map(self.build, (False, True))))

    def build(self, double: bool) -> Plugin:
        recipe = Recipe(double, functions=False, loops=self.loops)
        file = self.assignment.directory / "shading.cpp"
        return build_plugin(self.assignment.glue, file, Sandbox(self.folder / f"build-{double}"), recipe)

    def packet(self, scene: Path) -> Path:
        file = self.folder / f"{scene.stem}.packet"
        render("packet", scene, *self.options, "-o", file)
        return file

    def cpp(self, scene: Path, double: bool = False, shift: tuple[float, float] = (0, 0)) -> tuple[np.ndarray, dict]:
        image, statistics = self.folder / "image.npy", self.folder / "statistics.json"
        render(
            "image", scene, *self.options, "--plugin", self.plugins[double].file, "--layers", f"--shift={shift[0]},{shift[1]}",
            "-o", image, "--statistics", statistics,
        )  # fmt: skip
        return np.load(image), json.loads(statistics.read_text())

    def glsl(self, scenes: list[Scene]) -> dict[str, np.ndarray]:
        """The totals, drawn in one client process."""
        runner = GlslRunner(self.assignment, Sandbox(self.folder / "gl"))
        runner.take(self.assignment.directory)
        images = {}
        for task, output in runner.run([Draw(s, self.packet(s.file), layers="total") for s in scenes]):
            assert output.failure is None, f"{task.scene.name}: {output.failure}"
            images[task.scene.name] = output.array[..., :3]
        return images


@pytest.fixture(scope="module")
def studios(tmp_path_factory):
    return {
        name: Studio(name, tmp_path_factory.mktemp(name)) for name in sorted({s.assignment for s in STIFF.values()})
    }


@pytest.fixture(scope="module")
def glsl(studios):
    return {name: image for studio in studios.values() for name, image in studio.glsl(studio.scenes).items()}


def finite(image: np.ndarray) -> np.ndarray:
    return np.isfinite(image[..., :3]).all(axis=2)


def double_image(studio: Studio, scene: Path, shift: tuple[float, float] = (0, 0)) -> np.ndarray:
    if scene.stem != "depth-range":
        return studio.cpp(scene, True, shift)[0].astype(np.float64)
    # Double, too, sees what the float32 depth buffer says. The upper row lies nearer than 800 and the lower one beyond it: either
    # alone needs no such range.
    rows = []
    for near, far in (("1e-3", "800"), ("500", "1e6")):
        text = scene.read_text().replace("near = 1e-3", f"near = {near}").replace("far = 1e6", f"far = {far}")
        part = studio.folder / "part.toml"
        part.write_text(text.replace("../meshes", str(ROOT / "scenes" / "meshes")))
        rows.append(studio.cpp(part, True, shift)[0].astype(np.float64))
    half = len(rows[0]) // 2
    return np.concatenate([rows[0][:half], rows[1][half:]])


def truth_of(studio: Studio, scene: Path, image: np.ndarray) -> tuple[SceneTruth, np.ndarray]:
    """The double reference with the noise that truth/scenes.py measures, and which pixels can be judged: those of the
    interior where double is finite. Float32 rounds positions and directions; how far that moves a stiff pixel is part of
    the noise, since a shift by 1/16 pixel moves them farther."""
    judged = finite(image)
    image = image.copy()
    image[..., TOTAL][~judged] = 0
    told = describe(scene, studio.assignment.directory)
    truth = SceneTruth.of(image, told.eye, told.fov_y / told.height)
    noise = np.zeros(judged.shape)
    with np.errstate(invalid="ignore"):
        for shift in SHIFTS if scene.stem != "many-lights" else ():  # which is smooth, and takes double seconds
            moved = np.abs(double_image(studio, scene, shift)[..., :3] - truth.total).max(axis=2)
            noise = np.maximum(noise, np.nan_to_num(moved, nan=np.inf))
    truth.noise = largest_nearby(noise)
    return truth, judged & (truth.mask == INTERIOR)


def cell(stiff: Stiff) -> str:
    """The last column of the README's table."""
    parts = [f"{n} {count.replace('_', ' ')}" for count, n in stiff.counts.items()]
    if any(stiff.not_finite):
        parts.append("not finite: " + " / ".join(map(str, stiff.not_finite)))
    if any(stiff.beyond):
        parts.append("beyond: " + " / ".join(f"{100 * share:.1f} %" for share in stiff.beyond))
    return "; ".join(parts) or "nothing"


def test_every_scene_is_declared():
    assert sorted(STIFF) == sorted(file.stem for file in FOLDER.glob("*.toml"))
    rows = re.findall(r"^\| \[(.+)\]\((.+)\.toml\) \| .* \| (.*) \|$", (FOLDER / "README.md").read_text(), re.MULTILINE)
    assert rows == [(name, name, cell(stiff)) for name, stiff in STIFF.items()]


@pytest.mark.parametrize("name", STIFF)
def test_stiff_scene(name, studios, glsl):
    stiff, scene = STIFF[name], FOLDER / f"{name}.toml"
    studio = studios[stiff.assignment]
    cpp, statistics = studio.cpp(scene)
    double = double_image(studio, scene)
    found = {count: statistics[count] for count in COUNTS}
    not_finite = [int((~finite(image)).sum()) for image in (cpp, glsl[name], double)]
    truth, judged = truth_of(studio, scene, double)
    with np.errstate(over="ignore"):
        limit = image_limit(truth, 0.0)
    shares = [violating_share(i[..., :3], truth.total, limit, judged & finite(i)) for i in (cpp, glsl[name])]
    assert found == {count: stiff.counts.get(count, 0) for count in COUNTS}
    assert statistics["not_finite_fragments"] == not_finite[0]
    assert not_finite[::2] == list(stiff.not_finite[::2])
    # Which side of the overflow a pixel falls on is a matter of the last bit, and drivers differ in it.
    assert abs(not_finite[1] - stiff.not_finite[1]) <= 0.05 * stiff.not_finite[1]
    assert judged.sum() > 0.3 * (truth.layers["id"] > 0).sum()
    assert truth.total[judged].max() > 1e-3
    for share, declared in zip(shares, stiff.beyond):
        assert share <= FULL_MARKS if declared == 0 else abs(share - declared) <= 0.1 * declared


MIXED = """
[film]
width = 64
height = 64
[camera]
eye = [0, 0, 5]
target = [0, 0, 0]
near = 1
far = 9
[[light]]
kind = "spot"
position = [-2, 2, 3]
direction = [0.5, -0.5, -1]
hotspot = 10
falloff = 30
intensity = [0.9, 0.3, 0.1]
grid = { columns = SPOTS, across = [0.3, 0, 0] }
[[light]]
kind = "directional"
direction = [1, 0, -1]
intensity = [0, 0.1, 0.3]
[[light]]
kind = "point"
position = [0, -2, 2]
intensity = [0.02, 0.08, 0.02]
grid = { columns = 4, across = [0.4, 0, 0], rows = 3, up = [0, 0.5, 0.1] }
[material.m]
model = "phong"
ka = [0.02, 0.02, 0.02]
kd = [0.6, 0.6, 0.6]
ks = [0.3, 0.3, 0.3]
q = 30
[[object]]
mesh = "MESHES/sphere.obj"
material = "m"
interpolation = "gouraud"
translate = [-1, 0, 0]
[[object]]
mesh = "MESHES/sphere.obj"
material = "m"
translate = [1, 0, 0]
"""


def mixed(folder: Path, spots: str) -> Scene:
    """Kinds in another order than that of the texture, shaded at vertices and at fragments."""
    file = folder / f"mixed-{spots[:4]}.toml"
    file.write_text(MIXED.replace("SPOTS", spots).replace("MESHES", str(ROOT / "scenes" / "meshes")))
    return Scene(file.stem, file, ROOT / "solution" / "phong")


def test_lights_one_by_one_and_from_a_texture(studios, tmp_path):
    studio, scenes = studios["phong"], [mixed(tmp_path, spots) for spots in ("3", "4")]
    glsl = studio.glsl(scenes)
    for scene, many in zip(scenes, (16, 17)):
        header = Packet(studio.packet(scene.file)).header
        assert len(scene.described.lights) == many
        assert bool(header["textures"]) == (many == 17)
        cpp = studio.cpp(scene.file)[0][..., TOTAL]
        assert cpp.max() > 0.2
        assert np.percentile(np.abs(cpp - glsl[scene.name]), 99) < 1e-4


def test_a_grid_is_one_line_of_what_the_scene_needs(studios, tmp_path):
    scene = mixed(tmp_path, "5").file
    scene.write_text(scene.read_text().replace("intensity = [0.02, 0.08, 0.02]", "intensity = [0, 0, 0]"))
    needs = describe(scene, studios["phong"].assignment.directory, explain=True).needs
    assert "light[0] (spot, a grid of 5): it shines" in needs.needed
    assert "light[2] (point, a grid of 12): its intensity is zero" in needs.left_out


def test_more_lights_than_a_driver_takes_are_refused(studios, tmp_path):
    """llvmpipe would leave the loop early, without a word."""
    scene = mixed(tmp_path, "1000, rows = 70").file
    command = [RENDER, "packet", scene, *studios["phong"].options, "-o", tmp_path / "x.packet"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 2
    assert "70013 lights; OpenGL clients draw at most 65000: use --backend cpp" in done.stderr
