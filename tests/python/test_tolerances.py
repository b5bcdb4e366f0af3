"""Limits are measured, not chosen: how far correct programs stray, and how much room is left to them."""

import re
import subprocess

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.mistakes import load_changes
from shadelab.evidence.glsl import GlslRunner
from shadelab.evidence.tasks import Draw, Evaluate
from shadelab.grading.grade import grade
from shadelab.machine.build import Recipe, build_plugin
from shadelab.machine.sandbox import Sandbox
from shadelab.paths import RENDER
from shadelab.truth.expected import INTERIOR, Table
from shadelab.truth.making import load
from shadelab.truth.measures import (
    FACTOR,
    FULL_MARKS,
    LEAST_FLOOR,
    LEAST_PICTURE_FLOOR,
    function_limit,
    image_limit,
    scaled_error,
    violating_share,
)
from shadelab.truth.workshop import PLAIN

ASSIGNMENTS = [load_assignment(ROOT / "solution" / name) for name in assignment_names()]
LIGHTS, PHONG = (next(a for a in ASSIGNMENTS if a.name == name) for name in ("lights", "phong"))
every_assignment = pytest.mark.parametrize("assignment", ASSIGNMENTS, ids=lambda a: a.name)


def spreads(assignment):
    """(function, backend, program -> largest scaled error)"""
    spread = load(assignment).facts.spread
    return [(name, backend, programs) for name, languages in spread.items() for backend, programs in languages.items()]


def test_the_factor_is_at_least_three():
    assert FACTOR >= 3


@every_assignment
def test_limits_leave_the_factor_to_whatever_was_measured(assignment):
    assert {name for name, _, _ in spreads(assignment)} == {f.name for f in assignment.functions}
    variants = {v.id for v in load_changes(assignment).variant}
    for name, backend, programs in spreads(assignment):
        measured = {re.sub(r", (C\+\+|GLSL|fused multiply-add)$", "", program) for program in programs}
        assert measured == {PLAIN} | variants
        floor = max(programs.values())
        assert np.isfinite(floor), f"{name}, {backend}"
        assert function_limit(floor, backend) >= FACTOR * max(floor, LEAST_FLOOR[backend])
        # What is measured is rounding. Were it more, a mistake of a percent would hide behind a variant.
        assert function_limit(floor, backend) < 5e-3, f"{name}, {backend}: {programs}"


@every_assignment
def test_every_picture_is_measured_with_the_same_programs(assignment):
    expected, [*functions] = load(assignment), spreads(assignment)
    programs = {program for _, _, measured in functions for program in measured}
    for scene in assignment.scenes:
        if not scene.missing_meshes():
            truth = expected.scene(scene)
            assert set(truth.facts.spread) == programs, scene.name
            # By limits that the others set, none loses a pixel more than the share that is anybody's.
            assert truth.facts.share <= FULL_MARKS, scene.name


@every_assignment
def test_every_correct_program_passes_by_limits_that_were_set_without_it(assignment):
    for name, backend, programs in spreads(assignment):
        for program, error in programs.items():
            others = max(e for other, e in programs.items() if other != program)
            assert error <= function_limit(others, backend), f"{name}: {program}"


@pytest.fixture(scope="module")
def drivers_acos(tmp_path_factory):
    """The largest scaled error of acos in the driver's GLSL, over its whole domain."""
    folder = tmp_path_factory.mktemp("acos")
    text = (LIGHTS.directory / "shading.glsl").read_text()
    [call] = re.findall(r"\n    return 2\.0 / \(1\.0 \+ pow\(.*;", text)
    (folder / "shading.glsl").write_text(text.replace(call, "\n    return acos(r);"))
    runner = GlslRunner(LIGHTS, Sandbox(folder / "sandbox"))
    runner.build(folder)
    rows = np.zeros((1 << 16, 3), np.float32)
    rows[:, 0] = np.linspace(-1, 1, len(rows))
    rows[-4096:, 0] = 1 - np.geomspace(2.0**-24, 0.1, 4096)  # close to 1, where the angle is small
    [(_, output)] = runner.run([Evaluate(LIGHTS.function("distance_fade"), rows)])
    truth = np.arccos(rows[:, :1].astype(float))
    return scaled_error(output.array, Table(rows, truth, np.zeros_like(truth), len(rows)), [slice(0, 1)]).max()


def test_the_least_floor_in_glsl_is_what_the_drivers_functions_are_off(drivers_acos):
    assert drivers_acos <= LEAST_PICTURE_FLOOR <= 4 * drivers_acos


def test_the_least_floor_in_cpp_is_what_five_digits_of_pi_are_off():
    off = 3.1416 / np.pi - 1
    assert (1 + off) ** 2 - 1 <= LEAST_FLOOR["cpp"] <= 5 * off


@every_assignment
def test_pictures_leave_a_factor_of_three_to_the_solution_in_glsl(assignment, tmp_path):
    """And with no share of pixels to spare: the allowed share is for what other machines round differently."""
    expected = load(assignment)
    scenes = [s for s in assignment.scenes if not s.missing_meshes()]
    runner = GlslRunner(assignment, Sandbox(tmp_path / "glsl"))
    runner.build(assignment.directory)
    tasks = [Draw(scene, expected.packet(scene)) for scene in scenes]
    shares = {}
    for scene, (_, output) in zip(scenes, runner.run(tasks)):
        truth = expected.scene(scene)
        limit = image_limit(truth, max(truth.facts.spread.values()))
        judged, total = truth.mask == INTERIOR, output.array[..., :3]
        shares[scene.name] = violating_share(total, truth.total, limit / 3, judged)
        assert shares[scene.name] <= max(FULL_MARKS, FACTOR * truth.facts.share), scene.name
        assert truth.facts.share <= FULL_MARKS, scene.name
        assert truth.noise.shape == truth.mask.shape and (truth.noise >= 0).all()
        # Not all of the room is made by noise: between edges and highlights the arithmetic sets the limit.
        assert np.median(limit[judged]) < 0.02 * truth.scale, scene.name
    assert len(shares) >= 6


def test_a_shift_of_a_pixel_moves_the_picture_by_a_pixel(shadelab, tmp_path):
    """The noise is measured by shifting: --shift of the renderer, as a picture of its own shows it."""
    plugin = build_plugin(
        PHONG.glue,
        PHONG.directory / "shading.cpp",
        Sandbox(tmp_path / "b"),
        Recipe(True, functions=False, loops=("phong_point",)),
    )
    images = []
    for shift in ("0,0", "2,-1"):
        command = [RENDER, "image", ROOT / "scenes/phong/sphere.toml", "--assignment", PHONG.directory]
        command += ["--plugin", plugin.file, "--size", "128x128", f"--shift={shift}", "-o", tmp_path / "image.npy"]
        subprocess.run(list(map(str, command)), check=True, capture_output=True)
        images.append(np.load(tmp_path / "image.npy"))
    still, moved = images
    assert (np.abs(still - moved).max(axis=2) > 0.01).sum() > 100
    # Two to the right and one down; rows run from the top.
    a, b = still[:-1, :-2], moved[1:, 2:]
    assert (np.abs(a - b).max(axis=2) > 1e-3).mean() < 1e-3


def test_results_say_the_floor_beside_the_limit():
    result = grade(LIGHTS, LIGHTS.directory, only="*/[fip]*/[is][rt]*").result
    kinds = {c.kind for c in result.checks}
    assert kinds >= {"function", "image", "parity"}
    for check in result.checks:
        if check.kind != "build":
            assert check.status == "passed"
            assert check.error.limit == pytest.approx(FACTOR * check.error.floor) and check.error.floor > 0
            assert check.error.value <= check.error.limit


@every_assignment
def test_the_least_floor_in_glsl_is_the_one_in_cpp_and_the_drivers_own(assignment):
    driver = max(load(assignment).facts.driver.values())  # of exp, log, pow and the like; acos is another matter
    assert LEAST_FLOOR["cpp"] + 2 * driver <= LEAST_FLOOR["glsl"] <= LEAST_FLOOR["cpp"] + 5 * driver
