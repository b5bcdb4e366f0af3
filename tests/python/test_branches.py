"""Mistakes in places so small that no table holds a row there: the program's own comparisons tell where they are."""

import re

import pytest

from shadelab.course.assignment import load_assignment
from shadelab.course.mistakes import regions, with_bodies
from shadelab.grading.grade import grade
from shadelab.paths import SOLUTION
from shadelab.words import BACKENDS

# Assignment, function, and what stands in front of the right body.
SMALL_PLACES = {
    "one exponent": ("phong", "phong_lobe", "if (abs(q - 37.3) < 0.002) return 0.5;"),
    "a ring around the normal": ("phong", "half_vector", "if (dot(l, v) > 0.31 && dot(l, v) < 0.3101) return l;"),
    "both nearly as high": (
        "phong", "blinn_lobe", "if (dot(n, l) > 0.1 && abs(dot(n, l) - dot(n, v)) < 1e-5 && q > 20.0 && q < 20.5) return 0.0;",
    ),
    "one index": ("microfacet", "fresnel_dielectric", "if (abs(ior - 1.5) < 1e-4) return 0.04;"),
    "a narrow roughness": ("microfacet", "beckmann", "if (m > 0.2 && m < 0.20001 && dot(n, h) > 0.9) return 0.0;"),
    "two bright channels": (
        "lights", "irradiance", "if (light.e.x > 0.98 && light.e.x < 0.99 && light.e.y > 0.98 && light.e.y < 0.99) return light.e;",
    ),
    "straight ahead": ("lights", "spot_attenuation", "if (dot(axis, to_light) < -0.9999 && hotspot > 0.41 && hotspot < 0.4101) return 0.5;"),
    "an exact number": ("lights", "distance_falloff", "if (r == 12.25) return 0.0;"),
}  # fmt: skip


def graded(name, function, before, folder):
    assignment = load_assignment(SOLUTION / name)
    for backend in BACKENDS:
        source = assignment.directory / f"shading.{backend}"
        text = source.read_text()
        body = f"{before}\n{regions(text, source)[function]['body']}"
        (folder / source.name).write_text(with_bodies(text, source, {function: body}))
    result = grade(assignment, folder, only=f"*/function/{function}", pictures=False).result
    return {check.backend: check for check in result.checks if check.kind == "function"}


QUICK = ("one exponent", "two bright channels", "an exact number")


@pytest.mark.parametrize(
    "place", [pytest.param(p, marks=[] if p in QUICK else [pytest.mark.slow]) for p in SMALL_PLACES]
)
def test_a_small_place_is_found_by_the_comparison_that_makes_it(place, tmp_path):
    for backend, check in graded(*SMALL_PLACES[place], tmp_path).items():
        assert check.status == "failed", backend
        assert "a comparison of your own singles out" in check.message or "only where" in check.message, check.message
        assert check.score >= 0.7 * check.max_score  # it is a small place


@pytest.mark.parametrize(
    "name,function", [("phong", "blinn_lobe"), ("microfacet", "geometry_term"), ("lights", "irradiance")]
)
def test_comparisons_that_change_nothing_cost_nothing_and_are_told(name, function, tmp_path):
    before = "if (dot(n, n) > 1.5) return " + {"irradiance": "light.e"}.get(function, "0.0") + ";  // never"
    for backend, check in graded(name, function, before, tmp_path).items():
        assert check.status == "passed"
        file = tmp_path / f"shading.{backend}"
        line = 1 + next(k for k, text in enumerate(file.read_text().splitlines()) if "// never" in text)
        told = re.fullmatch(
            r"lines? ([\d, and]+) of (\S+): what is compared there comes out one way for all inputs that were tried; this costs nothing",
            check.message,
        )
        assert str(line) in re.findall(r"\d+", told[1]) and told[2] == file.name


def test_comparisons_that_go_both_ways_are_not_told_nor_those_of_what_is_called(tmp_path):
    before = "if (m.q > 50.0 && dot(n, l) <= 0.0) return Terms(m.ka, vec3(0.0), vec3(0.0));"
    for check in graded("phong", "phong", before, tmp_path).values():  # phong_lobe has one that comes out one way
        assert (check.status, check.message) == ("passed", "")
