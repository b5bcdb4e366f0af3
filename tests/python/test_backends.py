"""The two renderers against each other, on the solution; and the two ways to OpenGL."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import Draw
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import RENDER
from shadelab.truth.expected import CHANNELS, INTERIOR
from shadelab.truth.making import load
from shadelab.truth.measures import image_limit

ASSIGNMENTS = [load_assignment(ROOT / "solution" / name) for name in assignment_names()]
PHONG = next(a for a in ASSIGNMENTS if a.name == "phong")


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """images(scene, backend): the solution's layers, each drawn once."""
    folder, cache = tmp_path_factory.mktemp("images"), {}

    def draw(scene, backend, *options):
        key = (scene.name, backend, *options)
        if key not in cache:
            file = folder / ("-".join(map(str, key)) + ".npy")
            command = [
                sys.executable,
                "-I",
                "-m",
                "shadelab",
                "render",
                scene.file,
                "--backend",
                backend,
                "--layers",
                "-o",
                file,
                *options,
            ]
            subprocess.run(command, check=True, capture_output=True, env=os.environ)
            cache[key] = np.load(file)
        return cache[key]

    return draw


@pytest.mark.parametrize(
    "assignment",
    [pytest.param(a, id=a.name, marks=[] if a.name == "lights" else [pytest.mark.slow]) for a in ASSIGNMENTS],
)
def test_cpp_and_glsl_agree_on_every_scene(assignment, tmp_path):
    scenes = [s for s in assignment.scenes if not s.missing_meshes()]
    tasks = []
    for scene in scenes:
        packet = tmp_path / f"{scene.name}.packet"
        command = [RENDER, "packet", scene.file, "--assignment", assignment.directory, "--layers", "-o", packet]
        subprocess.run(command, check=True)
        tasks.append(Draw(scene, packet, layers="all"))
    runners = [CppRunner(assignment, Sandbox(tmp_path / "cpp")), GlslRunner(assignment, Sandbox(tmp_path / "glsl"))]
    for runner in runners:
        runner.build(assignment.directory)
    expected, seen = load(assignment), 0
    for scene, (_, one), (_, other) in zip(scenes, *(runner.run(tasks) for runner in runners)):
        cpp, glsl, truth = one.array, other.array, expected.scene(scene)
        for layer in ("id", "coverage"):
            assert (cpp[..., CHANNELS[layer]] == glsl[..., CHANNELS[layer]]).mean() >= 0.9999, scene.name
        total, interior = CHANNELS["total"], truth.mask == INTERIOR
        assert interior.sum() > 0.5 * (truth.layers["id"] > 0).sum(), scene.name
        limit = image_limit(truth, max(truth.facts.spread.values()))
        for a, b in (
            (cpp[..., total], glsl[..., total]),
            (cpp[..., total], truth.total),
            (glsl[..., total], truth.total),
        ):
            assert (~(np.abs(a - b) <= limit).all(axis=2) & interior).sum() <= 1e-4 * interior.sum(), scene.name
        seen += 1
    assert seen == len(scenes) >= 6


def test_pictures_of_single_lights_add_up(images):
    lights = next(a for a in ASSIGNMENTS if a.name == "lights")
    left, right, both = (
        next(s for s in lights.scenes if s.name == f"linearity-{k}") for k in ("left", "right", "both")
    )
    cpp = [images(scene, "cpp")[..., :3] for scene in (left, right, both)]
    np.testing.assert_array_equal(cpp[0] + cpp[1], cpp[2])  # to the bit: one rounded sum per pixel in both ways
    glsl = [images(scene, "glsl")[..., :3] for scene in (left, right, both)]
    np.testing.assert_allclose(glsl[0] + glsl[1], glsl[2], rtol=2e-6, atol=1e-9)  # its compiler may fuse and reorder
    assert all((image > 0.1).any() for image in cpp)


def test_four_samples_agree(images):
    scene = next(s for s in PHONG.scenes if s.name == "knot")
    cpp, glsl = images(scene, "cpp", "--samples", "4"), images(scene, "glsl", "--samples", "4")
    coverage = CHANNELS["coverage"]
    assert set(np.unique(cpp[..., coverage])) == {0.0, 0.25, 0.5, 0.75, 1.0}
    assert (cpp[..., coverage] == glsl[..., coverage]).mean() >= 0.9999
    # Both average the same four samples; only pixels where two surfaces meet within rounding may differ.
    assert np.percentile(np.abs(cpp[..., :3] - glsl[..., :3]), 99.9) < 1e-3


def test_supersampling_agrees(images):
    scene = next(s for s in PHONG.scenes if s.name == "interpolation")
    cpp, glsl = (images(scene, b, "--supersample", "2", "--size", "128x128") for b in ("cpp", "glsl"))
    assert cpp.shape == glsl.shape == (128, 128, 21)
    assert np.percentile(np.abs(cpp[..., :3] - glsl[..., :3]), 99.9) < 1e-3


def test_osmesa_and_egl_draw_the_same(tmp_path):
    tried = subprocess.run(
        [sys.executable, "-I", "-m", "shadelab.gl.context"], check=True, capture_output=True, text=True
    )
    ways = json.loads(tried.stdout)["ways"]
    absent = {name: way["error"] for name, way in ways.items() if "error" in way}
    if absent:
        pytest.skip(f"only one way to OpenGL here: {absent}")
    scene = next(s for s in PHONG.scenes if s.name == "teapot")
    images = {}
    for way in ways:
        file = tmp_path / f"{way}.npy"
        command = [sys.executable, "-I", "-m", "shadelab", "render", scene.file, "--backend", "glsl", "-o", file]
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "SHADELAB_GL": way})
        images[way] = np.load(file)
    np.testing.assert_array_equal(images["osmesa"], images["egl"])


def test_grading_through_egl(grade):
    result = grade(ROOT / "solution" / "phong", only="glsl/*/[ps]*", SHADELAB_GL="egl")
    assert result["score"] == result["max_score"] > 0
    assert result["environment"]["gl"].endswith("through egl")


def test_no_opengl_is_our_fault_and_not_the_students(grade):
    result = grade(ROOT / "solution" / "phong", only="glsl/function/*", SHADELAB_GL="none")
    assert {c["status"] for c in result["checks"]} == {"error"}  # none passes for a zero of the student's
    assert "SHADELAB_GL=none" in result["by_id"]["glsl/build"]["message"]
    assert not any(c["status"] == "failed" for c in result["checks"])


@pytest.mark.parametrize("backend", ["cpp", "glsl"])
def test_normals_that_cancel_become_the_face_normal(shadelab, tmp_path, backend):
    """A square whose normals point up at the top and down at the bottom: along its middle row they cancel exactly."""
    corners = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvn 0 -1 0\nvn 0 1 0\n"
    (tmp_path / "square.obj").write_text(corners + "f 1//1 2//1 3//2\nf 1//1 3//2 4//2\n")
    scene = (
        "[film]\nwidth = 33\nheight = 33\n[camera]\neye = [0, 0, 3]\ntarget = [0, 0, 0]\nnear = 1\nfar = 9\n"
        '[material.m]\nmodel = "phong"\nka = [0, 0, 0]\nkd = [1, 1, 1]\nks = [0, 0, 0]\nq = 1\n'
        '[[object]]\nmesh = "square.obj"\nmaterial = "m"\nnormals = "file"\n'
    )
    (tmp_path / "scene.toml").write_text(scene)
    options = ["--shading", PHONG.directory, "--backend", backend, "--layers", "-o", "out.npy"]
    done = shadelab("render", "scene.toml", *options)
    assert done.code == 0, done.stderr
    layers = np.load(tmp_path / "out.npy")
    normal = layers[..., CHANNELS["normal"]]
    inside = layers[16, :, CHANNELS["id"]][..., 0] == 1
    assert inside.sum() > 20
    np.testing.assert_allclose(normal[16, inside], np.tile([0, 0, 1], (inside.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(normal[8, 16], [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(normal[24, 16], [0, -1, 0], atol=1e-6)
    if backend == "cpp":
        assert "vertex normals cancel; the face normal is used" in done.stderr
