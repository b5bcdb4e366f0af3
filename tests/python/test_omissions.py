"""What a scene does not need is left out, and the image stays the same: to the last bit in C++, within 1e-6 in GLSL.

An omission that leaned on what a shading function ought to return would show here: mistakes are drawn as well.
"""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.course.mistakes import load_changes, write_submission
from shadelab.machine import renderer
from shadelab.machine.build import Recipe, build_plugin
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import RENDER

ASSIGNMENTS = {name: load_assignment(ROOT / "solution" / name) for name in assignment_names()}
for name, assignment in ASSIGNMENTS.items():
    draw_hidden_scenes(assignment.hidden, assignment.directory, name)
SIZE = ["--size", "96x96"]


def needs(scene, assignment, full=False):
    return renderer.describe(scene, assignment.directory, renderer.View(full=full)).needs


def draw(scene, assignment, plugin, output, *options):
    command = [RENDER, "image", scene, "--assignment", assignment.directory, "--plugin", plugin.file, "-o", output]
    subprocess.run([*map(str, command), *SIZE, *options], check=True, capture_output=True)
    return np.load(output)


def differing_scenes(assignment, folder, scenes, tmp_path, samples="1"):
    """Scenes whose image with --full is not the lean one, bit for bit. The lean plugin holds what the scenes need alone."""
    sandbox = Sandbox(tmp_path / "build")
    loops = sorted({loop for scene in scenes for loop in needs(scene, assignment).loops})
    lean = build_plugin(
        assignment.glue, folder / "shading.cpp", sandbox, Recipe(functions=False, loops=tuple(loops), terms=False)
    )
    full = build_plugin(assignment.glue, folder / "shading.cpp", sandbox)
    options = ["--samples", samples]
    return [
        scene.stem
        for scene in scenes
        if draw(scene, assignment, lean, tmp_path / "lean.npy", *options).tobytes()
        != draw(scene, assignment, full, tmp_path / "full.npy", "--full", *options).tobytes()
    ]


@pytest.mark.parametrize("name", ASSIGNMENTS)
@pytest.mark.parametrize("samples", ["1", "4"])
def test_cpp_gives_the_same_bits_with_and_without(name, samples, tmp_path):
    assignment = ASSIGNMENTS[name]
    scenes = [scene.file for scene in assignment.scenes if not scene.missing_meshes()]
    assert len(scenes) >= 8
    assert differing_scenes(assignment, assignment.directory, scenes, tmp_path, samples) == []


def mistakes():
    for name, assignment in ASSIGNMENTS.items():
        changes = load_changes(assignment).mistake
        quick = {changes[len(changes) // 2].id}
        for change in changes:
            marks = [] if change.id in quick else [pytest.mark.slow]
            yield pytest.param(name, change, id=change.id, marks=marks)


@pytest.mark.parametrize("name, mistake", list(mistakes()))
def test_a_mistake_shows_the_same_with_and_without(name, mistake, tmp_path):
    assignment = ASSIGNMENTS[name]
    write_submission(assignment, mistake, tmp_path / "submission")
    scenes = [scene.file for scene in assignment.scenes if not scene.missing_meshes()][:4]
    assert differing_scenes(assignment, tmp_path / "submission", scenes, tmp_path) == []


@pytest.mark.parametrize("scene", ["phong/interpolation", "microfacet/metals", "lights/spots"])
def test_glsl_agrees_with_and_without(scene, shadelab, tmp_path):
    file = ROOT / "scenes" / f"{scene}.toml"
    images = []
    for options in ([], ["--full"]):
        done = shadelab("render", file, "--backend", "glsl", *SIZE, *options, "-o", tmp_path / "image.npy")
        assert done.code == 0, done.stderr
        images.append(np.load(tmp_path / "image.npy"))
    assert images[0].max() > 0.05
    # Relative to the image's scale: the compiler may reorder sums.
    assert np.abs(images[0] - images[1]).max() <= 1e-6 * max(1.0, np.abs(images[1]).max())


def test_only_the_loops_that_a_scene_needs_are_compiled():
    phong = ASSIGNMENTS["phong"]
    assert needs(ROOT / "scenes/phong/sphere.toml", phong).loops == ["phong_point"]
    everything = needs(ROOT / "scenes/phong/sphere.toml", phong, full=True)
    assert everything.terms and {"phong_spot", "blinn_phong_directional"} <= set(everything.loops)


def test_a_plugin_without_the_loop_is_refused(tmp_path):
    phong = ASSIGNMENTS["phong"]
    plugin = build_plugin(
        phong.glue, phong.directory / "shading.cpp", Sandbox(tmp_path / "b"), Recipe(loops=("phong_spot",))
    )
    command = [RENDER, "image", ROOT / "scenes/phong/sphere.toml", "--assignment", phong.directory]
    done = subprocess.run([*command, "--plugin", plugin.file], capture_output=True, text=True)
    assert done.returncode == 3 and "was built without phong_point" in done.stderr


def test_explain_lists_both_and_says_what_is_saved(shadelab, tmp_path):
    scene = (ROOT / "scenes/phong/sphere.toml").read_text().replace("../meshes", str(ROOT / "scenes/meshes"))
    (tmp_path / "dark.toml").write_text(
        scene + '\n[[light]]\nkind = "directional"\ndirection = [0, -1, 0]\nintensity = [0, 0, 0]\n'
    )
    done = shadelab("render", "dark.toml", "--explain", "-o", "image.png")
    assert done.code == 0, done.stderr
    needed, left_out = done.stdout.split("left out")
    assert "light[0] (point): it shines" in needed and "code: phong under point lights: 1 light" in needed
    assert "shading loops: no object has the model, or no such light is drawn" in left_out
    saved = r"; saves (nothing that shows in )?[\d.]+ (of [\d.]+ )?ms a frame"
    assert re.search(r"light\[1\] \(directional\): its intensity is zero" + saved, left_out)
    assert re.search(
        r"ambient, diffuse, specular, coverage: nobody asked for them" + saved + r" and 10\.0 MiB", left_out
    )
    full = shadelab("render", "dark.toml", "--full", "--explain", "-o", "image.png")
    needed, left_out = full.stdout.split("left out")
    assert "light[1] (directional): kept by --full" in needed and "layers" not in left_out


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_cpp_render_opens_no_opengl():
    scene = ROOT / "scenes/phong/sphere.toml"
    command = [RENDER, "frames", scene, "--assignment", ASSIGNMENTS["phong"].directory, "--depth"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        assert json.loads(program.stdout.readline())["ready"]
        program.stdin.write("draw\n")
        program.stdin.flush()
        assert json.loads(program.stdout.readline())["ms"] > 0
        mapped = open(f"/proc/{program.pid}/maps").read()
    assert "shadelab-render" in mapped
    assert not re.search(r"lib(GL|EGL|OSMesa|glfw|X11|wayland|python)", mapped)
