"""Studies of kind "forms": the lobes' forms against 50-digit arithmetic, Fresnel's reflectances, and the emulated half."""

import json

import numpy as np
import pytest

from conftest import ROOT
from shadelab import exact
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.errors import UserError
from shadelab.evidence.cpp import CppRunner
from shadelab.evidence.tasks import Evaluate
from shadelab.machine import renderer
from shadelab.machine.build import FUNCTIONS, Recipe
from shadelab.machine.sandbox import Sandbox
from shadelab.study.declaration import load_study, sub_model
from shadelab.study.forms import (
    CONDITIONING,
    EVALUATIONS,
    PRECISIONS,
    Forms,
    _Code,
    _exact,
    deviation,
    draw_inputs,
    measure_forms,
)
from shadelab.study.timing import Workbench


@pytest.fixture
def work(tmp_path):
    return Workbench(tmp_path / "work", lambda what, done, of: None)


def declared(name: str) -> Forms:
    return sub_model(Forms, load_study(name).forms, name, "forms")


def measured(work, name: str, x: list[float], precisions: list[str], panels: list[str], timed: bool = False) -> dict:
    """{(part, series, x): Point} of a small run: these settings alone, few inputs."""
    forms = declared(name)
    forms.rows = 96
    forms.panel = [panel for panel in forms.panel if panel.name in panels]
    for panel in forms.panel:
        panel.precisions = precisions
        panel.knobs = [knob for knob in panel.knobs if knob[panel.x] in x]
        panel.orders = []  # two points have no slope
        assert len(panel.knobs) == len(x)
    study = load_study(name)
    study.repeats = 3
    parts = measure_forms(study, forms, work, "t", timed)
    points = {(part.name, p.series, p.knob[part.knob]): p for part in parts for p in part.points}
    return {"parts": {part.name: part for part in parts}, "points": points}


def test_distance_beats_pow(work):
    """Given n and h, by four orders at q = 1e6; given l and v by two, and there nothing is left to gain: the error is what half a
    unit in the inputs changes."""
    points = measured(work, "lobe-forms", [1e2, 1e6], ["float"], ["power", "power-lights"])["points"]

    def error(part: str, series: str, q: float) -> float:
        return points[f"t-{part}-float", series, q].error["max"]

    for q in (1e2, 1e6):
        assert error("power", "|n - h|", q) < 3e-6
        for form in ("std::pow", "pow", "exp(q log)"):
            assert 2e-8 * q < error("power", form, q) < 4e-7 * q
    assert error("power", "std::pow", 1e6) > 1e4 * error("power", "|n - h|", 1e6)
    assert 1e-5 < error("power", "|n x h|", 1e6) < 1e-3
    assert error("power-lights", "std::pow", 1e6) > 50 * error("power-lights", "|n - h|", 1e6)
    for form in ("|n x h|", "|n - h|"):
        assert 0.5 < error("power-lights", form, 1e6) / error("power-lights", CONDITIONING, 1e6) < 6
    # Given n and h, |n - h| is better than such inputs deserve: it takes them as exact.
    assert error("power", "|n - h|", 1e6) < 0.1 * error("power", CONDITIONING, 1e6)


def test_the_truth_takes_directions(work):
    """The choice that the study states: were lengths that are 1 only up to rounding part of the truth, no form could be exact."""
    assignment = load_assignment(ROOT / "studies" / "lobe-forms")
    panel = declared("lobe-forms").panel[0]
    inputs, truth = draw_inputs(assignment, panel, {"q": 1e6}, np.float32, 96, 1)
    n, h = (inputs[name].astype(float) for name in ("n", "h"))
    as_they_stand = [float(exact.dot(exact.vector(*a), exact.vector(*b)) ** 1000000) for a, b in zip(n, h)]
    value = _Code(assignment, work).evaluate("power_distance", inputs, "float")
    assert deviation(value, truth, "relative")["max"] < 3e-6
    assert 0.01 < deviation(value[:, 0], np.array(as_they_stand), "relative")["max"] < 0.2


def test_beckmann(work):
    points = measured(work, "lobe-forms", [0.5, 1e-4], ["float"], ["beckmann", "beckmann-lights"])["points"]
    assert points["t-beckmann-float", "|n - h|", 1e-4].error["max"] < 5e-6
    assert points["t-beckmann-float", "1 - cos^2", 1e-4].error["max"] > 1e6
    assert 1e-4 < points["t-beckmann-float", "|n x h|", 1e-4].error["max"] < 1e-2
    assert 1e-3 < points["t-beckmann-lights-float", "|n - h|", 1e-4].error["max"] < 1e-2  # about 3.3e-7 / m
    for (_, _, m), point in points.items():
        assert m < 0.5 or point.error["max"] < 2e-5, "all forms are good where the lobe is wide"


def test_half_and_double(work):
    """Double takes the same forms to its own rounding; half cannot hold q = 1e5, which is said and not drawn."""
    small = measured(work, "lobe-forms", [1e3, 1e5], ["double", "half"], ["power"])
    points = small["points"]
    assert points["t-power-double", "|n - h|", 1e5].error["max"] < 1e-14
    assert points["t-power-double", "std::pow", 1e5].error["max"] > 1e-12
    assert points["t-power-half", "|n - h|", 1e3].error["max"] < 0.02
    assert points["t-power-half", "std::pow", 1e3].error["max"] > 0.5
    assert ("t-power-half", "|n - h|", 1e5) not in points
    assert any("100000" in line and "65504" in line for line in small["parts"]["t-power-half"].skipped)
    assert points["t-power-half", "|n - h|", 1e3].seconds is None


def test_schlick_is_as_wrong_as_known(work):
    """max |dF| over all angles, from independent computations: as an approximation and beside the exact form's rounding."""
    known = {1.1: 0.21, 1.33: 0.060, 1.5: 0.0357, 1.8: 0.0345, 2.4: 0.074}
    panel = declared("fresnel").panel[0]
    assignment = load_assignment(ROOT / "solution" / "microfacet")
    for knob in panel.knobs:
        inputs, truth = draw_inputs(assignment, panel, knob, np.float64, 200, 1)
        error = deviation(_exact(assignment, "fresnel_schlick", inputs), truth, "absolute")["max"]
        assert error == pytest.approx(known[knob["ior"]], rel=0.03)


def test_times_are_measured(work):
    small = measured(work, "lobe-forms", [1e2, 1e6], ["float"], ["power"], timed=True)
    for (_, series, _), point in small["points"].items():
        if series == CONDITIONING:
            assert point.seconds is None
            continue
        times = point.seconds
        assert times["runs"] == 3 and times["min"] <= times["median"] <= times["max"]
        assert 1e-11 < times["median"] / EVALUATIONS < 1e-5
    claims = " ".join(small["parts"]["t-power-float"].claims)
    assert "largest error at q = 100, 1e+06: std::pow " in claims and "Nanoseconds" in claims and "of 3 runs" in claims


def test_columns_give_the_same_bits(work):
    """What is timed is what is graded: only the order of the numbers in memory differs."""
    assignment = load_assignment(ROOT / "studies" / "lobe-forms")
    panel = next(panel for panel in declared("lobe-forms").panel if panel.name == "power-lights")
    inputs, _ = draw_inputs(assignment, panel, {"q": 1e4}, np.float32, 100, 1)
    rows = np.concatenate([inputs[name].reshape(len(inputs["q"]), -1) for name in ("n", "l", "v", "q")], axis=1)
    plain = CppRunner(assignment, Sandbox(work.folder / "plain"), FUNCTIONS)
    plain.build(assignment.directory)
    code = _Code(assignment, work)
    for form in panel.forms:
        expected = plain.evaluate(Evaluate(assignment.function(form.function), rows)).array
        assert np.array_equal(code.evaluate(form.function, inputs, "float"), expected)


HALF_TOML = """
name = "arithmetic"
title = "Arithmetic"
files = ["shading.cpp"]

[[function]]
name = "chain"
arguments = [{ a = { range = [-1, 1] } }, { b = { range = [-1, 1] } }, { c = { range = [-1, 1] } }]
returns = "Real"

[[function]]
name = "vectors"
arguments = [{ a = { type = "vec3", range = [-1, 1] } }, { b = { type = "vec3", range = [-1, 1] } }]
returns = "vec3"
"""
HALF_CPP = """
#include <shadelab/shading.hpp>
Real chain(Real a, Real b, Real c) {
    Real sum = a * b + c / 3;
    sum -= 0.1;
    return std::sqrt(abs(sum)) * c;
}
vec3 vectors(vec3 a, vec3 b) { return cross(a, b) * 0.1 - a / dot(a, b); }
"""


def test_half_rounds_as_numpy(work, tmp_path):
    """Every operation, literals included, overflow and subnormal numbers too."""
    folder = tmp_path / "arithmetic"
    folder.mkdir()
    (folder / "assignment.toml").write_text(HALF_TOML)
    (folder / "shading.cpp").write_text(HALF_CPP)
    code = _Code(load_assignment(folder), work)
    rng = np.random.default_rng(3)
    f16 = np.float16

    def drawn(*shape: int) -> np.ndarray:
        return (rng.normal(size=shape) * 10.0 ** rng.uniform(-4, 3, shape)).astype(f16)

    a, b, c = drawn(5000), drawn(5000), drawn(5000)
    va, vb = drawn(5000, 3), drawn(5000, 3)
    with np.errstate(all="ignore"):
        total = a * b + c / f16(3)
        total -= f16(0.1)
        chain = np.sqrt(np.abs(total)) * c
        (ax, ay, az), (bx, by, bz) = va.T, vb.T
        dot = ax * bx + ay * by + az * bz
        # In the order of operations of GLM's cross.
        cross = np.stack([ay * bz - by * az, az * bx - bz * ax, ax * by - bx * ay], axis=1)
        vectors = cross * f16(0.1) - va / dot[:, None]
    ours = code.evaluate("chain", {"a": a, "b": b, "c": c}, "half")[:, 0]
    np.testing.assert_array_equal(ours.astype(f16), chain)
    assert np.isinf(chain).any() and (np.abs(chain[chain != 0]) < 6e-5).any()
    np.testing.assert_array_equal(code.evaluate("vectors", {"a": va, "b": vb}, "half").astype(f16), vectors)


def test_forms_are_no_assignment():
    assert "lobe-forms" not in assignment_names()
    assert load_assignment(ROOT / "studies" / "lobe-forms").points == 0


def test_declared_functions_exist():
    """Every form of every declaration, with the truth beside it."""
    for name in ("lobe-forms", "fresnel"):
        forms = declared(name)
        assignment = load_assignment(forms.folder)
        for panel in forms.panel:
            for function in [panel.truth, *(form.function for form in panel.forms)]:
                assert assignment.function(function)
            assert set(panel.precisions) <= set(PRECISIONS) and set(panel.what) <= set(panel.precisions)


def test_mistakes_in_a_declaration_are_named():
    values = json.loads(json.dumps(load_study("lobe-forms").forms))
    values["panel"][0]["compare"] = ["|n - h|", "sine"]
    with pytest.raises(UserError, match='forms.panel.0.*"sine" is no form'):
        sub_model(Forms, values, "lobe-forms", "forms")
    values = json.loads(json.dumps(load_study("lobe-forms").forms))
    del values["panel"][1]["knobs"][0]["q"]
    with pytest.raises(UserError, match="forms.panel.1.*number q"):
        sub_model(Forms, values, "lobe-forms", "forms")


def test_evaluate_writes_the_time_of_each_repeat(work):
    assignment = load_assignment(ROOT / "studies" / "lobe-forms")
    plugin = work.plugin(assignment, Recipe(loops=()), assignment.directory)
    rows, out, statistics = (work.folder / name for name in ("rows", "out", "statistics"))
    np.ones((10, 7), np.float32).tofile(rows)
    assert work.sandbox.run(renderer.evaluate(plugin, "power_std", rows, out, repeat=5, statistics=statistics)).ok
    written = json.loads(statistics.read_text())
    assert written["rows"] == 10 and len(written["seconds"]) == 5 and min(written["seconds"]) > 0
