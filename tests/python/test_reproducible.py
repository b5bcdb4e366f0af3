"""One scene, one image: to the last bit, whatever the number of threads, the processor and the C library's code for it."""

import hashlib
import os
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment
from shadelab.errors import UserError
from shadelab.machine.build import Recipe, build_plugin
from shadelab.machine.processor import LEVELS, processor_level
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import RENDER
from shadelab.truth.expected import CHANNELS

# Smooth normals (atan2) and two kinds of light; cones (cos) and pow; exact conductors; falloffs and all kinds of light; Gouraud
# and flat normals.
SCENES = ["phong/teapot", "phong/spots", "phong/interpolation", "microfacet/metals", "lights/studio"]
# Each assignment is compiled once per level, where the plugin is not known yet: the microfacet models for ten seconds each.
PARAMETERS = [pytest.param(s, marks=() if s.startswith("lights/") else pytest.mark.slow) for s in SCENES]

# The C library picks its code for exp, sin and their like by the processor, too: with fused multiply-add where it has one.
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}


@cache
def levels() -> list[str]:
    """Those that this machine has, the plainest first."""
    asked = os.environ.pop("SHADELAB_LEVEL", None)
    try:
        best = processor_level.__wrapped__()
    finally:
        if asked is not None:
            os.environ["SHADELAB_LEVEL"] = asked
    return list(LEVELS[: LEVELS.index(best) + 1])


@cache
def fma_can_be_switched_off() -> bool:
    """Whether WITHOUT_FMA is more than words here: sin and exp in double give other last bits."""
    program = "import math; print([(math.sin(k / 1000), math.exp(k / 1000)) for k in range(10000)])"
    outputs = {
        subprocess.run([sys.executable, "-I", "-c", program], capture_output=True, check=True, env=environment).stdout
        for environment in ({**os.environ}, {**os.environ, **WITHOUT_FMA})
    }
    return len(outputs) == 2


@dataclass
class Renderer:
    """Draws a scene in 160 x 120 pixels, with all layers, with the solution's functions."""

    folder: Path
    plugins: dict = field(default_factory=dict)

    def plugin(self, assignment: str, level: str, double: bool) -> Path:
        key = (assignment, level, double)
        if key not in self.plugins:
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("SHADELAB_LEVEL", level)
                processor_level.cache_clear()
                declared = load_assignment(ROOT / "solution" / assignment)
                source = declared.directory / "shading.cpp"
                sandbox = Sandbox(self.folder / f"{assignment}-{level}-{double}")
                self.plugins[key] = build_plugin(declared.glue, source, sandbox, Recipe(double)).file
            processor_level.cache_clear()
        return self.plugins[key]

    def draw(
        self, scene: str, level: str, threads: int = 1, samples: int = 1, double: bool = False, **environment
    ) -> Path:
        assignment, name = scene.split("/")
        file = self.folder / f"{name}-{level}-{threads}-{samples}-{double}-{len(environment)}.npy"
        command = [
            RENDER, "image", ROOT / "scenes" / f"{scene}.toml", "--assignment", ROOT / "solution" / assignment,
            "--plugin", self.plugin(assignment, level, double), "--layers", "--size", "160x120",
            "--samples", samples, "--threads", threads, "-o", file,
        ]  # fmt: skip
        subprocess.run(
            list(map(str, command)), check=True, env={**os.environ, "SHADELAB_LEVEL": level, **environment}, timeout=60
        )
        return file


@pytest.fixture(scope="module")
def renderer(tmp_path_factory):
    return Renderer(tmp_path_factory.mktemp("reproducible"))


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def assert_same(one: Path, other: Path, what: str) -> None:
    if digest(one) == digest(other):
        return
    a, b = np.load(one), np.load(other)
    assert a.shape == b.shape, what
    differing = []
    for layer, channels in CHANNELS.items():
        pixels = (a[..., channels].view(np.uint32) != b[..., channels].view(np.uint32)).any(axis=2)
        if pixels.any():
            y, x = np.argwhere(pixels)[0]
            farthest = np.nanmax(np.abs(a[..., channels].astype(float) - b[..., channels]))
            differing.append(f"{layer}: {pixels.sum()} pixels, the first at ({x}, {y}), by {farthest:g} at most")
    pytest.fail(f"{what}: " + ("; ".join(differing) or "the header"))


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("scene", PARAMETERS)
def test_image_does_not_depend_on_threads_or_processor(renderer, scene, samples):
    plain = renderer.draw(scene, "plain", samples=samples)
    image = np.load(plain)
    assert image.shape == (120, 160, 21)
    assert (image[..., CHANNELS["id"]] > 0).mean() > 0.1  # the picture shows something
    assert np.ptp(image[..., CHANNELS["total"]]) > 0.1
    if samples > 1:
        assert len(np.unique(image[..., CHANNELS["coverage"]])) == samples + 1
    for level in levels():
        for threads in (1, 2, 3, 7) if level in ("plain", levels()[-1]) else (2,):
            other = renderer.draw(scene, level, threads, samples)
            assert_same(plain, other, f"{scene}, {samples} samples: {level} with {threads} threads")


@pytest.mark.parametrize("double", [False, True], ids=["float", "double"])
@pytest.mark.parametrize("scene", PARAMETERS)
def test_image_does_not_depend_on_the_c_librarys_variant(renderer, scene, double):
    if not fma_can_be_switched_off():
        pytest.skip("this processor has no fused multiply-add, or this C library no setting that switches it off")
    level = levels()[-1]
    usual = renderer.draw(scene, level, double=double)
    other = renderer.draw(scene, level, double=double, **WITHOUT_FMA)
    assert_same(usual, other, f"{scene}: C library without fused multiply-add")


def test_a_level_is_what_is_asked_for_or_an_error(renderer):
    """Otherwise the tests above compare an image with itself."""
    assert len({renderer.plugin("phong", level, False) for level in levels()}) == len(levels())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SHADELAB_LEVEL", "v5")
        with pytest.raises(UserError, match="SHADELAB_LEVEL=v5"):
            processor_level.__wrapped__()
    with pytest.raises(subprocess.CalledProcessError) as caught:
        renderer.draw("phong/teapot", "plain", SHADELAB_LEVEL="v5")
    assert caught.value.returncode == 2
